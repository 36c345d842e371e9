"""Bending moduli of fabrics from their drapes.

    import drapenet
    estimate = drapenet.estimate("examples/captures/twill")   # or several captures of a fabric
    alpha, beta = estimate.moduli()                            # N·m, N·m²: samples, by direction
    print(estimate.names, 1e6 * estimate.fabric.alpha, estimate.warnings)
    again = drapenet.load("outputs/demo")                      # what infer.py has written

The simulator is :mod:`sim`, captures are read by :mod:`data.captures`.
"""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from data.captures.capture import Capture
    from drapenet.result.estimate import Estimate

__all__ = ["estimate", "load"]


def load(path: str | Path) -> "Estimate":
    """The estimate of an ``estimate.json``, or of that in a folder, with its posterior samples.

    InputError if it is not sound.
    """
    from drapenet.result.files import read_estimate

    found, _ = read_estimate(Path(path))
    return found


def estimate(
    *captures: "str | Path | Capture", strips: str | Path = "", checkpoint: str | Path = "",
    refine: bool = False,
) -> "Estimate":
    """Estimate one fabric as ``infer.py`` does, without writing files; InputError for bad input.

    Args:
        captures: folders of captures, or captures made of arrays.
        strips: folder of photographed strips, beside captures or alone.
        checkpoint: FILE.safetensors of ``train.py``; empty: the bundled one.
        refine: whether captures are refined by simulation, half a minute each.
    """
    from dataclasses import replace

    from common.configs import read_option
    from common.errors import InputError
    from data.captures.capture import read_capture, require_one_fabric
    from data.strips.folder import read_strips
    from drapenet.config import EstimateOptions
    from drapenet.inference import estimate_capture, joint_estimate
    from drapenet.network.checkpoint import read_header

    if not (captures or strips):
        raise InputError("give a capture, or strips=FOLDER")
    read = [read_capture(each) if isinstance(each, str | Path) else each for each in captures]
    measured = read_strips(strips) if strips else None
    require_one_fabric([part.density for part in (*read, measured) if part],
                       [(str(each.path), each.digest) for each in read])
    header = read_header(str(checkpoint))
    options = EstimateOptions(refine=read_option("refine", "simulation") if refine else None,
                              drapes=0)
    results = [estimate_capture(each, header, options) for each in read]
    if len(results) == 1 and not measured:
        found, document = results[0].estimate, results[0].document
    else:
        found, document = joint_estimate([result.observation for result in results],
                                         [result.document for result in results], header, measured)
    return replace(found, warnings=tuple(document.warnings))  # as load
