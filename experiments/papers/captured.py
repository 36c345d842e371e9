"""Simulated drapes and captures of known fabrics, with estimates by the bundled network."""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from data.captures.capture import Capture
from data.dataset.plan import DrapePlan
from data.fabrics.nuisances import Nuisances
from data.render.setups import Setups, SyntheticCapture
from drapenet.inference import Inferred, infer_capture
from drapenet.network.checkpoint import Header, bundled, read_header
from drapenet.result.estimate import Estimate
from drapenet.views.checks import view_warnings
from experiments import known
from experiments.result import read_report
from sim.cloth import Laws
from sim.drape import DrapeResult
from sim.material import LINEAR, REFERENCE_DENSITY, SWAPPED
from sim.rig import SQUARE_RIG

RIG = SQUARE_RIG
IDEAL = known.CLEAN | {"roll": 0.0, "pitch": (np.radians(38.0),) * 2, "distance": (0.527, 0.527),
                 "fill": (1.0, 1.0), "above": (0.036, 0.036), "aside": (0.0, 0.0)}
"""Changes to a set-up that remove all faults: smooth sensor, nominal pose, exact quarter turns."""


@dataclass(frozen=True)
class NetworkEstimate:
    """Estimate by the network from a capture.

    Attributes:
        theta: (6,) posterior mean in the true warp's frame (:mod:`data.fabrics.fabrics`).
        samples: (S, 6) posterior samples in the same frame.
        inferred: result of the network. capture: its input.
    """

    theta: np.ndarray
    samples: np.ndarray
    inferred: Inferred
    capture: Capture

    @property
    def warnings(self) -> list[str]:
        """Warnings of ``infer.py``."""
        one = self.inferred
        return [*one.estimate.warnings,
                *view_warnings(one.located, one.drape, header().setups)]


@cache
def header() -> Header:
    """Header of the bundled network."""
    return read_header(bundled(RIG))


def spread() -> np.ndarray:
    """(6,) standard deviation of theta over fabrics."""
    return header().scale.std[:6]


def posterior_bound() -> float:
    """Posterior bound of log alpha with all nuisances unknown, in units of :func:`spread`.

    Root mean square over directions and the fabrics of docs/validation/information.json.
    """
    bounds = np.array([fabric["bounds"]["all nuisances unknown"]
                       for fabric in read_report("information")["fabrics"]])
    return rms(bounds[:, LINEAR] / spread()[LINEAR])


def specimen(number: int, *, seed: int, nuisances: str = "none") -> DrapePlan:
    """Plan of a specimen of fabric ``number`` of the prior."""
    return known.plan_specimen(number, rig=RIG, nuisances=nuisances, seed=seed)


def drape_specimen(
    plan: DrapePlan, *, edge: float, start: str = "", seed: int | None = None,
    offset: tuple[float, float] = (0.0, 0.0), nuisances: Nuisances | None = None,
    laws: Laws | None = None,
) -> DrapeResult:
    """Simulate a drape of the specimen.

    Args:
        edge: m, at the rim.
        start, seed, laws: instead of those of the plan.
        offset: m, of the specimen's centre from the plate's axis.

    Raises:
        InputError: the simulation does not converge.
    """
    return known.drape_plan(plan, rig=RIG, edge=edge, start=start or plan.fallback, seed=seed,
                        offset=offset, nuisances=nuisances, laws=laws)


def ideal_setups(**changes: object) -> Setups:
    """Set-up without faults, with ``changes``."""
    return replace(Setups.load("real"), **IDEAL | changes)


def capture_drape(shape: DrapeResult, setups: Setups, rng: np.random.Generator) -> SyntheticCapture:
    """Capture a drape with a random set-up."""
    return setups.capture(shape.positions, shape.faces, rng,
                          rig=RIG)


def infer(synthetic: SyntheticCapture, *, density: float = REFERENCE_DENSITY) -> NetworkEstimate:
    """Estimate the moduli from a capture with the network.

    Args:
        density: kg/m², as stated by the user.
    """
    capture = Capture(synthetic.views, synthetic.intrinsics, synthetic.turns, density, None, RIG,
                      Path(), ())
    inferred = infer_capture(capture, header())
    samples = along_warp(inferred.estimate, synthetic.orientation)
    return NetworkEstimate(samples.mean(axis=0), samples, inferred, capture)


def along_warp(estimate: Estimate, orientation: float) -> np.ndarray:
    """Samples (S, 6) of theta in the frame of the true warp at angle ``orientation``, rad."""
    along = np.cos(2 * (estimate.axis - orientation)) >= 0
    return estimate.samples if along else estimate.samples[:, SWAPPED]


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.square(values).mean()))
