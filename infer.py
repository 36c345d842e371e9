"""Estimate the six bending moduli of a fabric from a capture: four depth images of its drape.

    python infer.py capture=DIR [refine=depth] [out=DIR] [checkpoint=FILE]
    python infer.py scan=FILE refine=scan [out=DIR]

Prints the moduli and writes ``estimate.json`` and ``report.png`` to ``out``. What a capture
consists of is described in ``README.md``, "Your own fabric", all keys in ``configs/infer.yaml``.
"""

import common.interrupt  # noqa: F401

# isort: split
from pathlib import Path
from typing import NoReturn

import numpy as np

from common.cli import parse_overrides, run_command
from common.ctrl_c import deferred, require_interruption
from common.errors import InputError
from data.captures import Capture, read_capture
from data.configs import read_config
from drapenet.checkpoint import BUNDLED, Header, load_model, read_header
from drapenet.output import require_output, write_estimate, write_report
from drapenet.table import format_table


def infer(
    capture: Capture, header: Header, *, refine: str = "none", drapes: int = 2,
    edge: float = 0.0,
) -> tuple[dict, bytes | None]:
    """The content of ``estimate.json`` and, unless ``drapes`` is 0, the bytes of ``report.png``."""
    # Imported here because torch takes seconds, and a bad capture should be told at once.
    with deferred():
        from data.cameras import CameraRig
        from data.captures import to_camera
        from drapenet.canonical import drape_map, turn_doubts
        from drapenet.estimate import belief, make_estimate, to_json
        from drapenet.predict import predict
        from drapenet.preprocess import crop_doubts
        from drapenet.registration import camera_doubts, locate_camera
        from sim.scene import Rig

    rig, specimen = CameraRig.load(header.rig), Rig.from_name(header.rig)
    views = to_camera(capture, rig)
    cut = crop_doubts(views, form=header.form)
    camera = locate_camera(views, rig.nominal(), plate_radius=specimen.plate_radius)
    turns = drape_map(views, camera, specimen).turns
    prediction = predict(load_model(header), views, form=header.form, scale=header.scale)
    estimate = make_estimate(prediction, capture=capture, header=header)
    refined = None
    if refine == "depth":
        from drapenet.refine.capture_report import refine_capture
        from drapenet.refine.views import FINE

        refined = refine_capture(estimate, capture, views, camera, rig=specimen,
                                 known=belief(prediction, header), edge=edge or FINE)
        estimate = refined.estimate if refined else estimate
    content = to_json(estimate, capture=capture, header=header)
    if refined:
        content |= refined.content
    elif refine == "depth":
        content["warnings"].append("no drape of the estimate converged; it is not refined")
    content["capture"]["turns_deg"] = (np.degrees(turns).round(1) + 0.0).tolist()  # no -0.0
    content["warnings"] += [*cut, *camera_doubts(camera, rig), *turn_doubts(turns)]
    drape, picture = refined.resimulation if refined else None, None
    try:
        if drapes and not drape:
            from drapenet.resimulate import EDGE, resimulate

            drape = resimulate(
                estimate.fabric, views, camera, rig=specimen,
                edge=edge or EDGE, drapes=drapes)
        if drape:
            from drapenet.limits import add_limits

            content["resimulation"] = drape.as_dict()
            content["warnings"] += drape.doubts
            add_limits(content, drape)
        if drapes:
            from drapenet.report import draw_report

            if not drape:
                content["warnings"].append("no drape of the estimate converged; the report shows "
                                           "none")
            picture = draw_report(
                estimate, views, drape, content=content,
                title=f"{capture.path.resolve().name}: {capture.density * 1e3:g} g/m²")
    except (KeyboardInterrupt, SystemError) as error:
        require_interruption(error)
        # A minute of refinement must not be lost for it.
        content["warnings"].append("interrupted: there is no report, and typical errors may be "
                                   "smaller than what a drape can tell")
    return content, picture


def main(argv: list[str]) -> None:
    """The command line: words ``key=value`` over ``configs/infer.yaml``."""
    config = parse_overrides(read_config("infer"), argv)
    unused = ("checkpoint", "drapes", "edge_mm") if config["scan"] else ("held",)
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
        raise InputError("no capture; give capture=DIR, a folder with four depth images")
    header = read_header(config["checkpoint"] or BUNDLED)
    capture = read_capture(config["capture"])
    if capture.rig != header.rig:
        raise InputError(f"the capture is of the rig '{capture.rig}' but the checkpoint of "
                         f"'{header.rig}'; choose a checkpoint trained for this rig")
    if config["refine"] not in ("none", "depth"):
        raise InputError(f"refine={config['refine']}: a capture takes none or depth")
    if not 0 <= config["drapes"] <= 4:
        raise InputError(f"drapes={config['drapes']} must lie between 0 and 4")
    out = Path(config["out"] or Path("outputs/infer") / capture.path.resolve().name)
    require_output(out)

    content, picture = infer(capture, header, refine=config["refine"], drapes=config["drapes"],
                             edge=config["edge_mm"] * 1e-3)
    write_estimate(out, content, format_table(content))
    if picture is not None:
        write_report(out, picture)


def entry() -> NoReturn:
    """Console script."""
    run_command(main, usage=__doc__)


if __name__ == "__main__":
    entry()
