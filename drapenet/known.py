"""What a laboratory knows already of a fabric, as evidence beside its captures.

The samples of the posterior are weighed by the likelihood of the known values, whose errors are
log-normal, and drawn again (importance sampling; the weights' effective number is reported).
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from common.errors import InputError
from common.types import Density
from data.captures.known import ByDirection, Known
from drapenet.result.estimate import Estimate
from drapenet.result.readings import GF_CM, GF_CM_PER_CM, bending_length, kes
from sim.material import DIRECTIONS, REFERENCE_DENSITY

MIN_EFFECTIVE = 100  # of the samples; fewer make their quantiles uncertain
CONTRADICTION = 3.0  # standard deviations between a known value and the posterior before it


def predicted(estimate: Estimate) -> Mapping[str, np.ndarray]:
    """Quantities of :data:`data.captures.known.ERRORS` of each sample, (S, 3) or (S, 1)."""
    alpha, beta = estimate.moduli()
    secant, hysteresis, outside = kes(alpha, beta)
    return {"bending_length_mm": 1e3 * bending_length(alpha, beta, estimate.density),
            "kes_b_gf_cm2_per_cm": np.where(outside, np.nan, secant) / GF_CM,
            "kes_2hb_gf_cm_per_cm": np.where(outside, np.nan, hysteresis) / GF_CM_PER_CM,
            "membrane_n_per_m": scaled(estimate.cloth.membrane, estimate.density)[:, None],
            "hysteresis_share": estimate.cloth.hysteresis[:, None]}


def scaled(membrane: np.ndarray, density: Density) -> np.ndarray:
    """Membrane stiffness at a density, of that at 300 g/m²; N/m, of the same shape."""
    return membrane * density / REFERENCE_DENSITY


def weigh(estimate: Estimate, known: Known) -> Estimate:
    """The estimate with the ``known`` values as evidence, and a warning of contradictions."""
    values = known.values()
    if not values:
        return estimate
    if estimate.names != DIRECTIONS and any(
            isinstance(getattr(known, name), ByDirection) for name, _ in values):
        raise InputError("known values along the yarns need warp_direction_deg in capture.yaml")
    logarithm, lines = np.zeros(len(estimate.samples)), []
    quantities = predicted(estimate)
    for (name, k), value in values.items():
        with np.errstate(invalid="ignore", divide="ignore"):
            gap = np.log(quantities[name][:, k]) - np.log(value)
        error = known.error(name)
        possible = np.isfinite(gap)
        logarithm += np.where(possible, -0.5 * (gap / error) ** 2, -np.inf)
        if not np.isfinite(logarithm).any():
            raise InputError("no fabric of the posterior has the known values; check them")
        spread = np.hypot(gap[possible].std(), error)
        if abs(gap[possible].mean()) > CONTRADICTION * spread:
            direction = f" {DIRECTIONS[k]}" if quantities[name].shape[1] > 1 else ""
            lines.append(f"the known {name}{direction} = {value:g} contradicts the captures, which "
                         f"say {np.nanmedian(quantities[name][:, k]):.3g}: check both")
    weights = np.exp(logarithm - logarithm.max())
    effective = weights.sum() ** 2 / np.square(weights).sum()
    if effective < MIN_EFFECTIVE:
        lines.append(f"the known values agree with only {effective:.0f} of {len(weights)} samples: "
                     "intervals are uncertain")
    # Systematic resampling: the same samples for the same weights.
    places = (np.arange(len(weights)) + 0.5) / len(weights)
    rows = np.searchsorted(np.cumsum(weights) / weights.sum(), places).clip(max=len(weights) - 1)
    return replace(estimate, cloth=estimate.cloth.chosen(rows),
                   warnings=(*estimate.warnings, *lines))
