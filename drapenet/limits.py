"""What one capture can tell of its fabric, set beside the errors of its estimate.

No estimate is more certain than the Cramér-Rao bound of the views it is made from
(:mod:`drapenet.information`): typical errors below it are raised to it, and moduli that a drape of
this fabric hardly shows are named.
"""

from typing import Any

from data.prior import load_prior
from drapenet.convention import stiff_first
from drapenet.information import CAMERA, SPECIMEN, bounds, bounds_alone, depth_information
from drapenet.refine.depth import DepthWeights
from drapenet.resimulate import Resimulation
from drapenet.table import error_table

HARDLY = 0.5
"""Share of the fabrics' spread: a modulus whose bound is above it is hardly told,"""
WELL = 0.2
"""below this, well."""


def add_limits(content: dict[str, Any], drape: Resimulation) -> None:
    """Complete ``estimate.json`` by the bounds of its drape: intervals, ``limits``, warnings.

    Args:
        content: as :func:`drapenet.estimate.to_json` gives it, directions in the order stiff, bias,
            soft; changed in place.
        drape: of the estimate.
    """
    # As many independent pixels as a refinement counts, whose errors have been measured.
    found = depth_information(drape.drape, drape.camera, orientation=drape.turn,
                              pixels_per_measurement=DepthWeights().patch ** 2)
    if not found.ok:
        content["warnings"].append("what the drape can tell of the moduli is not known: "
                                   f"{found.message}")
        return
    covariance = found.covariance((*SPECIMEN, *CAMERA))
    order = stiff_first(drape.drape.fabric.alpha)
    least, others_known = bounds(covariance)[order], bounds_alone(covariance)[order]
    names = list(content["moduli"])
    content["limits"] = error_table(names, least)
    for name, limit in content["limits"].items():
        own = content["typical_error"][name]
        own |= {key: max(own[key], limit[key]) for key in own}
    spread = load_prior("gaussian").deviation
    moduli = [f"{what} {name}" for what in ("alpha", "beta/alpha") for name in names]
    for text, bound, known, usual in zip(moduli, least, others_known, spread, strict=True):
        if bound > HARDLY * usual:
            alone = ", but well if the other moduli are known" if known < WELL * usual else ""
            best = f": at best to {bound / usual:.0%} of what fabrics differ by"
            tells = f"hardly tells {text}{best}" if bound < usual else f"does not tell {text}"
            content["warnings"].append(f"a drape of this fabric {tells}{alone}")
