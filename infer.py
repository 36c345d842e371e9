"""Estimate the six bending moduli of a fabric from a capture: depth images of its drape.

    python infer.py capture=DIR [refine=depth] [out=DIR] [checkpoint=FILE]
    python infer.py scan=FILE refine=scan [out=DIR]

Prints the moduli and writes ``estimate.json`` and ``report.png`` to ``out``. What a capture
consists of is described in ``README.md``, "Your own fabric", all keys in ``configs/infer.yaml``.
"""

import common.interrupt  # noqa: F401

# isort: split
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from common.cli import parse_overrides, run_command
from common.ctrl_c import deferred, require_interruption
from common.errors import InputError
from data.captures import Capture, read_capture
from data.configs import read_config
from drapenet.checkpoint import Header, bundled, read_header
from drapenet.output import require_output, write_estimate, write_report
from drapenet.table import format_table


def infer(
    capture: Capture, header: Header, *, refine: str = "none", drapes: int = 2, edge: float = 0.0,
    known: dict[str, float] | None = None,
) -> tuple[dict[str, Any], bytes | None]:
    """The content of ``estimate.json`` and, unless ``drapes`` is 0, the bytes of ``report.png``.

    Args:
        refine: "none" or "depth".
        edge: m, of the meshes for both; 0: as each has it.
        known: ``membrane``, N/m, and ``friction``, N·m per metre, where the user knows them.
    """
    # Imported here because torch takes seconds, and a bad capture should be refused at once.
    with deferred():
        from drapenet.canonical import drape_coefficient, turn_doubts
        from drapenet.estimate import to_json
        from drapenet.inference import infer_capture
        from drapenet.registration import camera_doubts
        from sim.scene import Rig

    rig = Rig.from_name(header.rig)
    inferred = infer_capture(capture, header, **(known or {}))
    estimate, camera, found = inferred.estimate, inferred.camera, inferred.found
    content: dict[str, Any] = {}
    doubts = [*camera_doubts(camera, header.setups), *turn_doubts(found.turns, capture.turns)]
    drape, picture = None, None
    if refine == "depth":
        from drapenet.refine.capture_report import refine_capture
        from drapenet.refine.views import FINE

        refined = refine_capture(estimate, capture.views, camera, rig=rig, edge=edge or FINE)
        if refined:
            estimate, content, drape = refined.estimate, refined.content, refined.resimulation
        else:
            doubts.append("no drape of the estimate converged; it is not refined")
    try:
        if drapes and not drape:
            from drapenet.resimulate import EDGE, resimulate

            drape = resimulate(estimate.fabric, capture.views, camera, rig=rig,
                               edge=edge or EDGE, drapes=drapes, turns=found.turns)
            doubts += drape.doubts if drape else ["no drape of the estimate converged; the report "
                                                  "shows none"]
        if drape:
            content["resimulation"] = drape.as_dict()
        if drapes:
            from drapenet.report import draw_report

            picture = draw_report(
                estimate, capture.views, drape, warnings=[*estimate.warnings, *doubts],
                title=f"{capture.path.resolve().name}: {capture.density * 1e3:g} g/m²")
    except (KeyboardInterrupt, SystemError) as error:
        require_interruption(error)
        # A minute of refinement must not be lost for it.
        doubts.append("interrupted: there is no report")
    about = {"folder": str(capture.path), "density_g_m2": round(capture.density * 1e3, 6),
             "rig": capture.rig, "views": len(capture.views),
             "turns_deg": (np.degrees(found.turns).round(1) + 0.0).tolist(),  # no -0.0
             "drape_coefficient_percent": percent(drape_coefficient(found, rig))}
    content = to_json(estimate, capture=about, source={"checkpoint": header.identity, **content})
    content["warnings"] += doubts
    return content, picture


def main(argv: list[str]) -> None:
    """The command line: words ``key=value`` over ``configs/infer.yaml``."""
    config = parse_overrides(read_config("infer"), argv)
    unused = (("checkpoint", "drapes", "edge_mm", "membrane_n_per_m", "friction_un")
              if config["scan"] else ("held",))
    given = {word.partition("=")[0] for word in argv}
    if wrong := [key for key in unused if key in given]:
        raise InputError(f"{wrong[0]}= has no effect with "
                         f"{'scan=FILE' if config['scan'] else 'capture=DIR'}; leave it out")
    if config["scan"]:
        with deferred():
            from drapenet.refine.scan_report import infer_scan

        infer_scan(config)
        return
    if not config["capture"]:
        raise InputError("no capture; give capture=DIR, a folder with depth images")
    capture = read_capture(config["capture"])
    header = read_header(config["checkpoint"] or bundled(capture.rig))
    if capture.rig != header.rig:
        raise InputError(f"the capture is of the rig '{capture.rig}' but the checkpoint of "
                         f"'{header.rig}'; choose a checkpoint trained for this rig")
    if config["refine"] not in ("none", "depth"):
        raise InputError(f"refine={config['refine']}: a capture takes none or depth")
    if config["refine"] == "depth":
        require_refinable(capture)
    if not 0 <= config["drapes"] <= 4:
        raise InputError(f"drapes={config['drapes']} must lie between 0 and 4")
    if config["membrane_n_per_m"] < 0:
        raise InputError(f"membrane_n_per_m={config['membrane_n_per_m']:g} must be positive")
    known = {}
    if config["membrane_n_per_m"]:
        known["membrane"] = config["membrane_n_per_m"]
    if config["friction_un"] >= 0:
        known["friction"] = 1e-6 * config["friction_un"]
    out = Path(config["out"] or Path("outputs/infer") / capture.path.resolve().name)
    require_output(out)

    content, picture = infer(
        capture, header, refine=config["refine"], drapes=config["drapes"],
        edge=config["edge_mm"] * 1e-3, known=known)
    write_estimate(out, content, format_table(content))
    if picture is not None:
        write_report(out, picture)


def percent(share: float) -> float | None:
    """``share`` in per cent for a JSON file, which has no NaN."""
    return round(100 * share, 1) if np.isfinite(share) else None


def require_refinable(capture: Capture) -> None:
    """InputError for a capture that refine=depth cannot work on."""
    quarters = np.arange(4) * (np.pi / 2)
    if len(capture.views) != 4 or not np.allclose(capture.turns, quarters, atol=0.1):
        raise InputError(f"{capture.path}: refine=depth takes four views a quarter turn apart, "
                         f"this capture has {len(capture.views)} views at "
                         f"{np.degrees(capture.turns).round().tolist()}°; leave refine= out")
    if capture.rig != "square300_cylinder100":
        raise InputError(f"refine=depth knows squares only, this capture is of the rig "
                         f"'{capture.rig}'; leave refine= out")


def entry() -> NoReturn:
    """Console script."""
    run_command(main, usage=__doc__)


if __name__ == "__main__":
    entry()
