"""Estimate the six bending moduli of a fabric from captures: depth images of its drape.

    python infer.py capture=DIR [refine=depth] [out=DIR] [checkpoint=FILE]
    python infer.py capture=[DIR,DIR,...]      captures of one fabric: one estimate
    python infer.py scan=FILE [refine=scan] [out=DIR]
    python infer.py captures=ROOT out=DIR      FABRIC/SAMPLE/CAPTURE, or a CSV list: a table
    ... export=jfab,usd                        files for other tools as well, or export=all

Prints the moduli and writes ``estimate.json``, ``report.png``, ``report.html``, ``drape.glb`` and
``torque.svg`` to ``out``. What a capture consists of is described in ``docs/use.md``.
"""

import common.interrupt  # noqa: F401

# isort: split
import sys
from functools import partial
from pathlib import Path
from typing import Any

from common.command import command
from common.errors import InputError
from common.files import folder_named
from data.captures.capture import Capture, captures_in, read_capture
from data.captures.description import checked_density
from drapenet.config import InferConfig
from drapenet.export.formats import export_all, targets_named
from drapenet.export.material import read_material
from drapenet.network.checkpoint import header_for
from drapenet.result.output import ESTIMATE, keep_estimate, require_output, result_name, show_result
from sim.mesh.specimen import check_edge


@command("infer", InferConfig)
def main(config: InferConfig) -> None:
    """Estimate, print, and write the files."""
    check(config)
    exports = targets_named(config.export, "export") if config.export else []
    drapes = (0 if config.captures else 2) if config.drapes is None else config.drapes
    membrane = config.membrane_n_per_m
    options = {"refine": config.refine, "edge": config.edge_mm * 1e-3, "strict": config.strict,
               "drapes": drapes, "known": {} if membrane is None else {"membrane": membrane}}
    if config.captures:
        from drapenet.batch.batch import estimate_tree

        estimates = estimate_tree(Path(config.captures), folder_named(config.out),
                                  checkpoint=config.checkpoint, workers=config.workers, **options)
        export_estimates(estimates, exports)
        return
    sources = read_sources(config)
    captures = [capture for capture, _ in sources]
    header = header_for(captures, config.checkpoint)
    paths = [capture.path for capture in captures]
    out = Path(config.out or Path("outputs/infer") / result_name(paths))
    folders = [out] if len(captures) == 1 else [out / f"capture_{k}" for k in range(len(captures))]
    require_output(out, paths)
    for folder in folders:
        require_output(folder)
    # Importing torch takes seconds; input errors come first.
    from drapenet.inference import estimate_capture
    from drapenet.result.joint import joint_result

    found = []
    for (capture, seen), folder in zip(sources, folders, strict=True):
        # Keep the network's estimate if the refinement, which takes minutes, is killed.
        first = None if config.refine["by"] == "none" else partial(keep_estimate, folder)
        if sys.stderr.isatty():
            print(f"{capture.path}: {len(capture.views)} views; the estimate takes about half a "
                  "minute", file=sys.stderr, flush=True)
        found.append(estimate_capture(capture, header, seen=seen, first=first, **options))
        show_result(folder, found[-1])
    if len(found) > 1:
        show_result(out, joint_result(found))
    export_estimates([out / ESTIMATE], exports)


def export_estimates(files: list[Path], targets: list[str]) -> None:
    """Write the exports ``targets`` beside each ``estimate.json`` of ``files``."""
    for file in files if targets else ():
        written = export_all(read_material(file), targets, file.parent)
        print(f"exports:  {', '.join(str(path) for path in written)}")


def check(config: InferConfig) -> None:
    """Raise InputError for values out of range or incompatible keys."""
    kind, ways = ("scan", ("none", "scan")) if config.scan else ("capture", ("none", "depth"))
    if config.refine["by"] not in ways:
        raise InputError(f"refine={config.refine['by']} does not fit a {kind}; use refine="
                         f"{' or '.join(ways)}")
    for key, value in config.refine.items():
        integer = key == "starts"
        if key != "by" and not (isinstance(value, int if integer else int | float) and value > 0):
            raise InputError(f"refine.{key}={value} must be a positive {'whole ' * integer}number")
        if key.endswith("_mm"):
            check_edge(1e-3 * value)
    given = [key for key in ("capture", "captures", "scan") if getattr(config, key)]
    if len(given) > 1:
        raise InputError(f"give {given[0]}= or {given[1]}=, not both")
    if not given:
        raise InputError("capture= is missing; give the folder with the depth images: capture=DIR")
    check_edge(1e-3 * config.edge_mm)


def read_sources(config: InferConfig) -> list[tuple[Capture, Any]]:
    """Read the captures given in ``config``, each with its scan or None."""
    key = "scan" if config.scan else "capture"
    named = getattr(config, key)
    paths = [Path(str(path)) for path in (named if isinstance(named, list) else [named])]
    if key == "capture":
        paths = [one for path in paths for one in captures_in(path)]
        return [(read_capture(path), None) for path in paths]
    density = checked_density(config.density_g_m2)
    from drapenet.refine.scans import read_scan_capture

    return [read_scan_capture(path, density=density) for path in paths]


if __name__ == "__main__":
    main()
