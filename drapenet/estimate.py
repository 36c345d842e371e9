"""From a prediction to ``estimate.json``."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from data.captures import Capture
from data.fabrics import from_theta
from data.prior.gaussian import GaussianPrior
from drapenet.checkpoint import Header
from drapenet.convention import LINEAR, RATIO, STIFF_SOFT
from drapenet.predict import Prediction, in_order
from drapenet.table import error_table, moduli_table
from sim.material import MICRO, REFERENCE_DENSITY, Fabric, bias_limit

SCHEMA = "drapenet-estimate"
SCHEMA_VERSION = 1
LEAST_CONFIDENCE = 0.2
"""Confidence in the stiff axis below which warp and weft are not told apart."""

NAMES = {"stiff/soft": STIFF_SOFT, "warp stiff": ("warp", "bias", "weft"),
         "weft stiff": ("weft", "bias", "warp")}


@dataclass(frozen=True)
class Estimate:
    """A fabric's moduli with their circumstances.

    Attributes:
        fabric: moduli in the order stiff, bias, soft, at the fabric's density.
        names: of the three directions: stiff, bias, soft, or warp, bias, weft in the order of
            ``fabric``.
        convention: ``stiff/soft`` or ``warp/weft``.
        prediction: what the network said, its mean error on cloth not taken off; after a
            refinement its targets and axis are what was found.
        warnings: one line each.
    """

    fabric: Fabric
    names: tuple[str, str, str]
    convention: str
    prediction: Prediction
    warnings: tuple[str, ...]


def make_estimate(prediction: Prediction, *, capture: Capture, header: Header) -> Estimate:
    """Name the directions, scale to the fabric's density, and say what is doubtful."""
    warnings = [*capture.warnings, *_doubts(prediction, header)]
    names, direction_doubts = _name_directions(prediction, capture.warp_direction)
    alpha, beta = from_theta(belief(prediction, header).mean)
    limit = bias_limit(alpha)
    if alpha[1] <= limit * 1.001:
        warnings.append("no plate is as soft along the bias as the predicted "
                        f"{alpha[1] / MICRO:.3g} µN·m at 300 g/m²; the nearest possible value is "
                        "given")
        beta = beta * np.array([1, 1.01 * limit / alpha[1], 1])
        alpha = np.array([alpha[0], 1.01 * limit, alpha[2]])
    fabric = Fabric(alpha=alpha, beta=beta, density=REFERENCE_DENSITY).at_density(capture.density)
    convention = "warp/weft" if "warp" in names else "stiff/soft"
    return Estimate(fabric, names, convention, prediction, (*warnings, *direction_doubts))


def _doubts(prediction: Prediction, header: Header) -> list[str]:
    """Where the estimate leaves the training data, or the view orders disagree."""
    targets = header.content["targets"]
    doubts = []
    for part, what in ((LINEAR, "alpha"), (RATIO, "beta/alpha")):
        values = prediction.targets[part]
        outside = (values < targets["low"][part]) | (values > targets["high"][part])
        if outside.any():
            directions = ", ".join(np.array(STIFF_SOFT)[outside])
            doubts.append(f"{what} ({directions}) lies outside the fabrics of the training set: "
                          "an extrapolation")
    errors = header.errors.deviation
    if (prediction.spread[LINEAR] > errors[LINEAR]).any():
        doubts.append("the view orders disagree more than the network's usual error: look for "
                      "a wrong view order, a wrong turn, or noise")
    return doubts


def belief(prediction: Prediction, header: Header) -> GaussianPrior:
    """What the network's word says of the theta of real cloth, its errors being what they are.

    Their mean is taken off, and they go together (:attr:`.checkpoint.Header.errors`). Beyond the
    fabrics trained on, the distance to them is added.
    """
    targets, values = header.content["targets"], prediction.targets
    beyond = np.maximum(np.maximum(targets["low"] - values, values - targets["high"]), 0.0)
    errors = header.errors
    return GaussianPrior(in_order(values - errors.mean_at(values)),
                         errors.covariance + np.diag(beyond**2), fabrics=0)


def _name_directions(
    prediction: Prediction, warp_direction: float | None
) -> tuple[tuple[str, str, str], list[str]]:
    """Names of the directions in the order stiff, bias, soft, and doubts about them."""
    certain = prediction.axis_confidence >= LEAST_CONFIDENCE
    if not certain:
        doubts = ["the direction of the stiff axis is not identifiable (confidence "
                  f"{prediction.axis_confidence:.2f}): the fabric drapes alike along both yarns, "
                  "or the views are not upright or not in their order"]
        if warp_direction is not None:
            doubts.append("warp and weft are not told apart although the warp is marked; "
                          "the larger alpha is called stiff")
        return NAMES["stiff/soft"], doubts
    if warp_direction is None:
        return NAMES["stiff/soft"], []
    turned = (prediction.axis - warp_direction) % math.pi
    angle = math.degrees(min(turned, math.pi - turned))
    doubts = []
    if 30 < angle < 60:
        doubts.append(f"the stiff axis lies {angle:.0f}° from the marked warp, between the yarns: "
                      "check warp_direction_deg")
    return NAMES["warp stiff" if angle <= 45 else "weft stiff"], doubts


def to_json(estimate: Estimate, *, capture: Capture, header: Header) -> dict[str, Any]:
    """The content of ``estimate.json``; every key names its unit."""
    prediction, names = estimate.prediction, estimate.names
    return {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "convention": estimate.convention,
        "capture": {
            "folder": str(capture.path),
            "density_g_m2": round(capture.density * 1e3, 6),
            "rig": capture.rig,
        },
        "moduli": moduli_table(names, estimate.fabric),
        "moduli_at_300_g_m2": moduli_table(names, estimate.fabric.at_density(REFERENCE_DENSITY)),
        "spread_over_view_orders": error_table(names, prediction.spread),
        "typical_error": error_table(names, belief(prediction, header).deviation),
        "stiff_axis": {
            "direction_deg": math.degrees(prediction.axis),
            "meaning": "in the first view, 0 to the right, 90 away from the camera, modulo 180",
            "confidence": prediction.axis_confidence,
        },
        "checkpoint": header.identity,
        "warnings": list(estimate.warnings),
    }
