"""Refinement of an estimate by simulation: ``refine=`` of ``infer.py``.

The search combines the fabric prior, the prior of specimens and the capture; the network gives it
initial guesses. The result has half of its samples from the search and half from the network: they
read the same pixels, so that their densities must not be multiplied, but their errors are equally
large and differ (docs/validation.md).
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from tqdm import tqdm

from common.configs import read_option
from common.findings import Finding
from common.normal import Normal
from common.types import Density, Radians
from data.fabrics.fabrics import THETA_NAMES, ClothProperties
from data.fabrics.nuisances import LOGARITHMIC, at_density
from data.fabrics.prior import GaussianPrior
from data.render.raster import rasterise
from drapenet.evidence.state import STATE, cloth_of_state, fabric_prior, state_of
from drapenet.network.checkpoint import Header
from drapenet.network.predict import Draws
from drapenet.refine.depth import DepthViews
from drapenet.refine.objective import fit_nuisances
from drapenet.refine.positions import Fidelity, fidelity
from drapenet.refine.search import (
    CapturedDrape,
    CapturedScan,
    CapturedViews,
    SearchResult,
    search,
)
from drapenet.refine.unknowns import LAW_NAMES, NAMES, OFFSET_NAMES, SpecimenPrior, Unknowns
from drapenet.report.drape import Resimulation, turned
from drapenet.result.estimate import central
from drapenet.surface.registration import flat_turn
from drapenet.surface.shape import CapturedShape
from drapenet.views.located import LocatedViews
from sim.material import REFERENCE_DENSITY

MAX_REDUCED_CHI2 = 10.0  # beyond, no cloth fits the capture; correct captures have 0.8 to 2.5
MAX_DISPLACEMENT_MM = 6.0  # of the estimate's drape from the scan; 20 simulated scans: up to 2.7
SEARCHED = STATE[:-1]  # all but hysteresis
NARROWED = 0.85
"""Width of the pooled posteriors relative to their original one: a pool of calibrated posteriors is
too wide. Of 40 squares, 54, 72 and 90 % of the true moduli lie in its 50, 68 and 90 % intervals."""
_PRINTED = {"membrane": ("membrane_n_per_m", 1.0), "shear": ("shear_share", 1.0),
            "curl_warp": ("curl_warp_per_m", 1.0),
            "curl_weft": ("curl_weft_per_m", 1.0), "offset_warp": ("offset_warp_mm", 1e3),
            "offset_weft": ("offset_weft_mm", 1e3)}


@dataclass(frozen=True)
class Refinement:
    """Result of the refinement of one capture."""

    draws: Draws | None  # of the pool; None if the refinement gave no improvement
    searched: Normal | None  # the posterior of the search alone
    content: dict[str, Any]  # the part ``refined`` of ``estimate.json``
    resimulation: Resimulation  # the refined drape beside the capture
    warnings: tuple[Finding, ...]


def refine_capture(
    samples: ClothProperties, captured: LocatedViews, header: Header, *, density: Density,
    warp: Radians, face: int = 1, scan: CapturedShape | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Refinement | None:
    """Refine an estimate by simulation, with a progress bar; None if no cloth converges.

    Args:
        samples: of the network's posterior.
        header: of the network, whose fabrics are the prior.
        warp: its direction in the first view.
        face: 1 if the marked face is up, else -1.
        scan: whose rendered views are ``captured``; None for a capture.
        settings: content of a file of ``configs/refine``; None: the default.
    """
    settings = settings or read_option("refine", "simulation")
    axis = flat_turn(scan) if scan else 0.0
    sought: CapturedDrape = CapturedScan(scan) if scan else CapturedViews(
        captured, turn=warp, edge=1e-3 * settings["edge_mm"], coarse=1e-3 * settings["coarse_mm"])
    result = _search(samples, header, sought, warp=warp - axis if scan else None,
                     count=int(settings["starts"]))
    if result is None:
        return None
    resimulation = _beside(result, captured, axis, scan is not None)
    near = fidelity(scan, result.released) if scan and result.released else None
    warnings = _search_warnings(result)
    draws = None
    searched = None
    content = _content(result, near, density)
    if not warnings:
        searched = _posterior(result, face)
        draws = Draws.possible(_cloth(samples, searched), known=True)
        content["posterior"] = _record(Normal.of(state_of(draws.cloth)[:, :len(SEARCHED)]))
    if scan:
        warnings += _scan_warnings(near)
    return Refinement(draws, searched, content, resimulation, tuple(warnings))


def _beside(
    result: SearchResult, captured: LocatedViews, axis: Radians, scan: bool
) -> Resimulation:
    """The refined drape beside the capture; ``axis``: of a scan's mesh in the first view."""
    drape = result.released or result.best.drape
    statuses = (drape.searched.status.value,)
    if scan:
        views = rasterise(drape.positions, drape.faces, captured.camera, captured.turns)
        placed = turned(drape.positions, axis + result.best.unknowns["warp"])
        return Resimulation.beside(captured, views, drape, placed, statuses)
    placed = turned(drape.positions, float(result.best.nuisance[0]))
    nuisance = fit_nuisances(result.objective, drape.positions, result.best.nuisance)
    assert isinstance(result.objective, DepthViews)
    views = result.objective.render(drape.positions, nuisance)
    return Resimulation.beside(captured, views.astype(np.float32), drape, placed, statuses)


def _posterior(result: SearchResult, face: int) -> Normal:
    """The normal posterior of :data:`SEARCHED` with the marked face up."""
    assert result.uncertainty
    names = result.uncertainty.names
    places = [names.index(name) for name in SEARCHED]
    sign = np.where([name.startswith("curl") for name in SEARCHED], face, 1)
    mean = np.array([result.best.unknowns[name] for name in SEARCHED])
    covariance = result.uncertainty.covariance[np.ix_(places, places)]
    return Normal(sign * mean, sign[:, None] * covariance * sign)


def pooled(network: np.ndarray, searched: np.ndarray) -> np.ndarray:
    """Samples (2 S, n) of the spread-adjusted linear pool of two posteriors with samples (S, n)
    (Gneiting and Ranjan 2013, Combining predictive distributions, section 3)."""
    return np.concatenate([
        samples.mean(axis=0) + NARROWED * (samples - samples.mean(axis=0))
        for samples in (network, searched)])


def _cloth(samples: ClothProperties, searched: Normal) -> ClothProperties:
    """Their pool, with the network's shares of hysteresis."""
    drawn = np.random.default_rng(0).multivariate_normal(
        searched.mean, searched.covariance, size=len(samples.theta))
    cloth = cloth_of_state(pooled(state_of(samples), np.column_stack([drawn, samples.hysteresis])))
    return replace(cloth, hysteresis=np.tile(samples.hysteresis, 2))


def _record(posterior: Normal) -> dict[str, list]:
    """In JSON's types."""
    return {"names": list(SEARCHED), "mean": posterior.mean.tolist(),
            "covariance": posterior.covariance.tolist()}


def _search(
    samples: ClothProperties, header: Header, sought: CapturedDrape, *, warp: Radians | None,
    count: int,
) -> SearchResult | None:
    """The search from ``count`` fabrics; ``warp``: initial guess, None if it is not free."""
    fabrics = Normal.of(fabric_prior(header).theta)
    prior = SpecimenPrior.of(GaussianPrior(fabrics.mean, fabrics.covariance, fabrics=0),
                             header.nuisances)
    free = [*THETA_NAMES, *LAW_NAMES, *OFFSET_NAMES]
    first = prior.mean.copy()
    if warp is not None:
        free.append("warp")
        first[NAMES.index("warp")] = warp
    rng = np.random.default_rng(0)
    rows = rng.integers(len(samples.theta), size=count - 1)
    starts = [Unknowns(first).with_theta(theta)
              for theta in (central(samples.theta, header.spread), *samples.theta[rows])]
    total = count + 2 + sum((level.evaluations + 1) * len(level.pulls)
                            for level in sought.rounds)
    with tqdm(total=total, desc="refining", unit="sim", leave=False) as bar:
        return search(sought, starts, free=free, prior=prior,
                      progress=lambda simulations: bar.update(simulations - bar.n))


def _search_warnings(result: SearchResult) -> list[Finding]:
    """Why the network's estimate stands; empty if it does not."""
    certain = result.uncertainty
    if certain is not None and not np.isfinite(certain.theta).all():
        certain = None
    if certain and certain.reduced_chi2 >= MAX_REDUCED_CHI2:
        return [Finding("refinement_fits_nothing", {"value": float(certain.reduced_chi2),
                                                    "limit": MAX_REDUCED_CHI2})]
    if not result.improved:
        return [Finding("refinement_no_better")]
    return [] if certain else [Finding("refinement_uncertain")]


def _scan_warnings(near: Fidelity | None) -> list[Finding]:
    """A warning if the released drape does not stay at the scan."""
    if not near:
        return [Finding("drape_leaves_scan")]
    return [] if near.displacement_mm <= MAX_DISPLACEMENT_MM else [Finding("drape_off_scan", {
        "value": float(near.displacement_mm), "limit": MAX_DISPLACEMENT_MM})]


def _content(result: SearchResult, near: Fidelity | None, density: Density) -> dict[str, Any]:
    content = {
        "misfit_before": result.start_value, "misfit": result.best.value,
        "simulations": result.effort.solves,
        "failed_simulations": len(result.effort.failures),
        "status": result.status.value, "message": result.message,
        "specimen": _specimen(result, density),
    }
    if result.uncertainty is not None:
        content["reduced_chi2"] = result.uncertainty.reduced_chi2
    if near:
        content["fidelity"] = asdict(near)
    return content


def _specimen(result: SearchResult, density: Density) -> dict[str, Any]:
    """Medians and 68 % intervals of the specimen's nuisances, at the fabric's ``density``."""
    if result.uncertainty is None:
        return {}
    deviations = np.sqrt(np.diag(result.uncertainty.covariance))
    table = {}
    for name, deviation in zip(result.uncertainty.names, deviations, strict=True):
        if name in _PRINTED:
            label, unit = _PRINTED[name]
            middle = result.best.unknowns[name]
            ends = np.array([middle - deviation, middle, middle + deviation])
            ends = np.exp(ends) if name in LOGARITHMIC else ends
            unit *= at_density({name: 1.0}, REFERENCE_DENSITY, density)[name]
            low, middle, high = unit * ends
            table[label] = {"median": float(middle), "interval_68": [float(low), float(high)]}
    return table
