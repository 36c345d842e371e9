"""Estimate the six bending moduli of a fabric from captures: depth images or photographs.

    python infer.py capture=DIR [refine=simulation] [out=DIR] [checkpoint=FILE]
    python infer.py capture=[DIR,DIR,...]      captures of one fabric: one estimate
    python infer.py scan=FILE [refine=simulation] [out=DIR]
    python infer.py strips=DIR [capture=...]   photographs of strips, alone or beside captures
    python infer.py tension=DIR [capture=...]  strips under weights: stretch and shear
    python infer.py captures=ROOT out=DIR      FABRIC/SAMPLE/CAPTURE, or a CSV list: a table
    ... export=jfab,usd                        files for other tools as well, or export=all
    ... preview=true                           skirts of twelve samples: garment.png, garment.glb

Prints the moduli and writes ``estimate.json``, ``report.png``, ``report.html``, ``drape.glb`` and
``torque.svg`` to ``out``. What a capture consists of is described in ``docs/use.md``.
"""

import common.interrupt  # noqa: F401

# isort: split
import sys
from pathlib import Path

from common.command import command
from common.errors import InputError
from common.files import folder_named, locked
from drapenet.config import EstimateOptions, InferConfig

# Others are imported late: --help and mistakes do not wait half a second for them.


@command("infer", InferConfig)
def main(config: InferConfig) -> None:
    """Estimate one fabric or many, print the estimates, and write the files."""
    options = options_of(config)
    targets = []
    if config.export:
        from drapenet.export.formats import targets_named

        targets = targets_named(config.export, "export")  # unknown ones are refused before any work
    if config.captures:
        from drapenet.fabric.many import estimate_fabrics

        out = folder_named(config.out)
        with locked(out):
            files = estimate_fabrics(Path(config.captures), out, options,
                                     checkpoint=config.checkpoint, workers=config.workers)
    else:
        files = [estimate_one(config, options)]
    if targets:
        from drapenet.export.formats import export_beside

        for file in files:
            print(export_beside(file, targets))
    if config.preview:
        preview_estimates(files, config.workers)


def estimate_one(config: InferConfig, options: EstimateOptions) -> Path:
    """Estimate the fabric of the captures, scans and strips that are named in ``config``; its
    ``estimate.json``."""
    from data.captures.description import Specimen
    from drapenet.fabric.sources import sources_of
    from drapenet.network.checkpoint import read_header
    from drapenet.result.files import ESTIMATE, require_output, result_name

    named = config.scan or config.capture
    places = [Path(str(path)) for path in (named if isinstance(named, list) else [named]) if named]
    stated = {key: value for key in Specimen.model_fields
              if (value := getattr(config, key)) is not None}
    sources = sources_of(places, strips=config.strips, tension=config.tension,
                         scan=stated if config.scan else None)
    header, paths = read_header(config.checkpoint), [source.path for source in sources]
    out = Path(config.out or Path("outputs/infer") / result_name(paths))
    with locked(out):
        require_output(out, paths)
        if sys.stderr.isatty():
            print("the estimate of a capture with its report takes about 15 s", file=sys.stderr,
                  flush=True)
        from drapenet.fabric.estimate import estimate_fabric  # after faults
        from drapenet.result.terminal import print_estimate

        estimate_fabric(sources, header, options, folder=out, on_estimate=print_estimate)
    return out / ESTIMATE


def preview_estimates(files: list[Path], workers: int | None) -> None:
    """Write skirts of samples beside each ``estimate.json``."""
    import joblib

    from drapenet.report.garment import preview
    from drapenet.result.files import GARMENTS, read_estimate

    for file in files:
        garments = preview(read_estimate(file)[0], workers=workers or joblib.cpu_count())
        garments.write(file.parent)
        failed = "".join(f"; sample {row} is missing: {reason}"
                         for row, reason in garments.failures.items())
        print(f"garment:  {', '.join(str(file.with_name(name)) for name in GARMENTS)}{failed}")


def options_of(config: InferConfig) -> EstimateOptions:
    """The options in SI units; InputError for keys that do not fit each other."""
    from sim.mesh.specimen import check_edge

    sources = [key for key in ("capture", "captures", "scan") if getattr(config, key)]
    if len(sources) > 1:
        raise InputError(f"give {sources[0]}= or {sources[1]}=, not both")
    if not (sources or config.strips or config.tension):
        raise InputError("capture= is missing; give the folder of the capture: capture=DIR")
    for key in ("strips", "tension"):
        if getattr(config, key) and config.captures:
            raise InputError(f"give {key}= or captures=, not both")
    for key in ("density_g_m2", "warp_direction_deg"):
        if not config.scan and getattr(config, key) is not None:
            raise InputError(f"{key}= is of a scan; state it in the capture's capture.yaml")
    for key, value in config.refine.items():
        integer = key == "starts"
        if key != "by" and not (isinstance(value, int if integer else int | float) and value > 0):
            raise InputError(f"refine.{key}={value} must be a positive {'whole ' * integer}number")
        if key.endswith("_mm"):
            check_edge(1e-3 * value)
    check_edge(1e-3 * config.edge_mm)
    return EstimateOptions(
        refine=None if config.refine["by"] == "none" else config.refine,
        drapes=(0 if config.captures else 2) if config.drapes is None else config.drapes,
        edge=1e-3 * config.edge_mm, strict=config.strict)


if __name__ == "__main__":
    main()
