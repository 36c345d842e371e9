"""Refinement of an estimate by simulation: ``refine=`` of ``infer.py``.

The network's estimate gives initial guesses only. The posterior combines the fabric prior, the
prior of specimens (``configs/nuisances/real.yaml``) and the capture; the network is not counted as
another measurement of the same pixels.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from tqdm import tqdm

from common.command import compose_config
from common.configs import read_option
from data.captures.capture import Capture
from data.dataset.config import Options, config_from_options
from data.fabrics.fabrics import THETA_NAMES
from data.fabrics.nuisances import LOGARITHMIC, NuisanceConfig, at_density
from data.render.rays import DepthRenderer
from drapenet.network.predict import Draws
from drapenet.refine.objective import fit_nuisances
from drapenet.refine.scans import flat_turn
from drapenet.refine.search import CapturedScan, CapturedViews, Found, Seen, search
from drapenet.refine.surface import Fidelity, fidelity
from drapenet.refine.unknowns import LAWS, OFFSET, UNKNOWNS, Cloth, Knowledge
from drapenet.report.drape import Resimulation, turned
from drapenet.result.estimate import Estimate
from drapenet.result.joint import fabric_prior
from drapenet.views.located import LocatedViews
from sim.drape import DrapeResult
from sim.material import REFERENCE_DENSITY

MAX_REDUCED_CHI2 = 10.0
"""Beyond this, no simulated cloth fits the captured surface; correct captures have 0.8 to 2.5."""
MAX_DISPLACEMENT_MM = 6.0
"""Mean displacement of the estimate's drape from the scan; for 20 simulated scans at most 2.7."""
_DRAWS = 4000  # samples of the refined moduli
_PRINTED = {"membrane": ("membrane_n_per_m", 1.0), "shear": ("shear_share", 1.0),
            "curl_warp": ("curl_warp_per_m", 1.0),
            "curl_weft": ("curl_weft_per_m", 1.0), "offset_warp": ("offset_warp_mm", 1e3),
            "offset_weft": ("offset_weft_mm", 1e3)}


@dataclass(frozen=True)
class Refined:
    """Result of the refinement of one capture.

    Attributes:
        draws: of the posterior; None if the refinement gave no improvement.
        content: the part ``refined`` of ``estimate.json``.
        found: the search's result.
        resimulation: the refined drape beside the capture.
        warnings: one line each.
    """

    draws: Draws | None
    content: dict[str, Any]
    found: Found
    resimulation: Resimulation
    warnings: tuple[str, ...]


def refined_capture(
    estimate: Estimate, capture: Capture, located: LocatedViews, *,
    seen: CapturedScan | None, known: Mapping[str, float],
    settings: Mapping[str, Any] | None = None,
    progress: Callable[[int, int, float], None] | None = None,
) -> Refined | None:
    """Refine an ``estimate`` by simulation, with a progress bar; None if no cloth converges.

    An interruption from the keyboard returns the best result so far.

    Args:
        seen: the scan of the capture; None for views.
        known: fixed values of :data:`data.fabrics.nuisances.NAMES`, SI, of cloth of 300 g/m².
        settings: content of a file of ``configs/refine``; None: the default.
        progress: called with the simulated and the expected number of drapes, and the misfit.
    """
    axis = 0.0
    settings = settings or read_option("refine", "scan" if seen else "depth")
    if seen is None:
        source: Seen = CapturedViews(
            located, turn=estimate.axis, edge=1e-3 * settings["edge_mm"],
            coarse=1e-3 * settings["coarse_mm"])
    else:
        source, axis = seen, flat_turn(seen.shape)
    found = _search(estimate, source, axis=axis, count=int(settings["starts"]), known=known,
                    progress=progress)
    if found is None:
        return None
    theta, best = _samples(found), found.best
    drape = found.released or best.drape
    if seen is None:
        turn = float(best.nuisance[0])
        positions = turned(drape.positions, turn)
        simulated = best_view(found, drape)
    else:
        turn = axis + best.cloth["warp"]
        positions = drape.positions
        simulated = DepthRenderer(drape.positions, drape.faces).views(
            located.camera, 0.0, located.turns)
    draws = None
    if theta is not None and found.improved and found.uncertainty.reduced_chi2 < MAX_REDUCED_CHI2:
        draws = Draws.possible(theta, np.full(len(theta), turn))
    shown = Resimulation(located, simulated.astype(np.float32), drape, positions,
                         (drape.status.value,))
    near = fidelity(seen.shape, found.released) if seen and found.released else None
    scan = seen is not None
    return Refined(draws, _content(found, near, capture.density, scan=scan), found, shown,
                   tuple(_warnings(found, theta, near, scan=scan)))


def _search(
    estimate: Estimate, seen: Seen, *, axis: float, count: int, known: Mapping[str, float],
    progress: Callable[[int, int, float], None] | None,
) -> Found | None:
    """The search from ``count`` fabrics, with a progress bar (:func:`refined_capture`)."""
    spread = specimen_spread()
    beforehand = Knowledge.of(fabric_prior(estimate.names), spread)
    scan = isinstance(seen, CapturedScan)
    free = [*THETA_NAMES, *(name for name in (*LAWS, *OFFSET) if name not in known),
            *(["warp"] if scan else [])]
    first = beforehand.mean.copy()
    for name, value in known.items():
        first[UNKNOWNS.index(name)] = math.log(value) if name in LOGARITHMIC else value
    if scan:
        first[UNKNOWNS.index("warp")] = estimate.axis - axis
    rng = np.random.default_rng(0)
    rows = rng.integers(len(estimate.samples), size=count - 1)
    starts = [Cloth(first).with_theta(theta) for theta in (estimate.theta, *estimate.samples[rows])]
    total = count + 2 + sum((level.evaluations + 1) * len(level.pulls) for level in seen.rounds)
    with tqdm(total=total, desc="refining", unit="sim", leave=False,
              disable=progress is not None) as bar:
        def show(simulations: int, value: float) -> None:
            bar.update(simulations - bar.n)
            bar.set_postfix(misfit=f"{value:.0f}")
            if progress:
                progress(simulations, total, value)

        return search(seen, starts, free=free, known=beforehand, progress=show)


def best_view(found: Found, drape: DrapeResult) -> np.ndarray:
    """(K, H, W) views of a drape with the pose that fits the captured ones best."""
    nuisance = fit_nuisances(found.objective, drape.positions, found.best.nuisance)
    return found.objective.render(drape.positions, nuisance)


def specimen_spread() -> NuisanceConfig:
    """Distribution of the nuisances over specimens, ``configs/nuisances/real.yaml``."""
    options = compose_config("generate", ["nuisances=real"], schema=Options)
    return config_from_options(options).sampling.nuisances


def _samples(found: Found) -> np.ndarray | None:
    """(S, 6) samples of theta; None without an uncertainty."""
    if found.uncertainty is None or not np.isfinite(found.uncertainty.theta).all():
        return None
    rng = np.random.default_rng(0)
    return rng.multivariate_normal(found.best.cloth.theta, found.uncertainty.theta, size=_DRAWS)


def _warnings(
    found: Found, theta: np.ndarray | None, near: Fidelity | None, *, scan: bool
) -> list[str]:
    """One line for each fault of a search; ``near``: of the released drape of a ``scan``."""
    warnings = []
    if theta is not None and found.uncertainty.reduced_chi2 >= MAX_REDUCED_CHI2:
        warnings.append("no simulated cloth fits the captured surface (squared misfit "
                      f"{found.uncertainty.reduced_chi2:.0f} times the measurement's errors, at "
                      f"most {MAX_REDUCED_CHI2:g}): the network's estimate stands; check tester, "
                      "specimen, cut-out and intrinsics")
    elif not found.improved:
        warnings.append("the refinement found no fabric that agrees better with the capture: the "
                      "network's estimate stands")
    elif theta is None:
        warnings.append("the refinement gives no uncertainty: the network's estimate stands")
    if (scan and not near) or (near and near.displacement_mm > MAX_DISPLACEMENT_MM):
        ends = (f"comes to rest {near.displacement_mm:.0f} mm from the scan (sound scans: up to "
                f"{MAX_DISPLACEMENT_MM:g} mm)" if near else "does not come to rest at the scan")
        warnings.append(f"the estimate's drape {ends}: check the specimen's size and the support, "
                      "and that the cloth hung freely")
    return warnings


def _content(
    found: Found, near: Fidelity | None, density: float, *, scan: bool
) -> dict[str, Any]:
    """The part ``refined`` of ``estimate.json``, of a fabric of ``density``, kg/m²."""
    content = {
        "by": "scan" if scan else "depth",
        "misfit_before": found.start_value, "misfit": found.best.value,
        "simulations": found.effort.solves, "failed_simulations": len(found.effort.failures),
        "status": found.status.value, "message": found.message,
        "specimen": _specimen(found, density),
    }
    if found.uncertainty is not None:
        content["reduced_chi2"] = found.uncertainty.reduced_chi2
    if near:
        content["fidelity"] = asdict(near)
    return content


def _specimen(found: Found, density: float) -> dict[str, Any]:
    """Medians and 68 % intervals of the specimen's nuisances, at the fabric's ``density``, kg/m².
    """
    if found.uncertainty is None:
        return {}
    deviations = np.sqrt(np.diag(found.uncertainty.covariance))
    table = {}
    for name, deviation in zip(found.uncertainty.names, deviations, strict=True):
        if name in _PRINTED:
            label, unit = _PRINTED[name]
            middle = found.best.cloth[name]
            ends = np.array([middle - deviation, middle, middle + deviation])
            ends = np.exp(ends) if name in LOGARITHMIC else ends
            unit *= at_density({name: 1.0}, REFERENCE_DENSITY, density)[name]
            low, middle, high = unit * ends
            table[label] = {"median": float(middle), "interval_68": [float(low), float(high)]}
    return table
