"""Refinement from four depth views: where the folds are found, and the moduli corrected.

1. A specimen is pulled onto the captured surface (:mod:`.guided`, :mod:`.attraction`): the
   captured fold configuration.
2. It is released with several fabrics around the first estimate, and the one whose equilibrium
   the views fit best goes on: the multiple starts, which cost one simulation each.
3. Levenberg-Marquardt on theta, the specimen's turn and the camera's pose.
4. With the better fabric and pose, a specimen is pulled and released again, and 3 goes on from it
   if it is the better one: the first shape was that of the wrong fabric, seen from a little
   beside. ``ROUNDS`` times in all.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from data.cameras import Camera
from data.fabrics import fabric_from_theta, from_theta
from drapenet.refine.attraction import captured_shape
from drapenet.refine.depth import DepthViews, DepthWeights
from drapenet.refine.objective import fit_nuisances
from drapenet.refine.optimisers import Limits, Point, Status, minimise
from drapenet.refine.problem import DrapeProblem, Gaussian, Trial
from drapenet.refine.uncertainty import Uncertainty, laplace
from sim.drape import DrapeResult, drape
from sim.material import is_admissible
from sim.newton import NewtonOptions
from sim.scene import Rig
from sim.sensitivity import follow
from sim.specimens import make_specimen

ROUNDS = (4, 5, 9)
"""Simulations of each round's Levenberg-Marquardt."""
SPREAD = (0.0, 0.7, -0.7)
"""What is added to log alpha for the starts."""
SHAPES = ("captured", "sine", "fold")
"""Initial states: the captured shape, or made at random as for any drape."""

RELEASE = NewtonOptions(residual=1e-2, step=1e-2, max_iterations=200)
"""When a released shape is at rest well enough to be compared and improved."""

Progress = Callable[[int, float], None]
"""Called after each simulation with the number of simulations so far and the best value."""


@dataclass(frozen=True)
class RefinedViews:
    """What a refinement found.

    Attributes:
        start: theta (6,) that it began with, drawn in to the bounds.
        start_value: of the objective there; None if that fabric's drape did not converge.
        best: the best trial; its drape, turn and pose (:data:`.depth.POSE`) go with it.
        objective: that was minimised.
        uncertainty: None where the drape has no derivatives, or after an interruption.
        simulations: equilibria computed.
        seconds: in all.
        status, message: how it ended.
    """

    start: np.ndarray
    start_value: float | None
    best: Trial
    objective: DepthViews
    uncertainty: Uncertainty | None
    simulations: int
    seconds: float
    status: Status
    message: str


def refine_views(
    views: np.ndarray,
    camera: Camera,
    theta: np.ndarray,
    *,
    turns: Sequence[float],
    rig: Rig | None = None,
    resolution: int = 41,
    seed: int = 0,
    shape: str = "captured",
    prior: Gaussian | None = None,
    others: Sequence[np.ndarray] = (),
    rounds: Sequence[int] = ROUNDS,
    weights: DepthWeights | None = None,
    progress: Progress | None = None,
) -> RefinedViews | None:
    """Refine theta (6,) so that its drape looks like the views; None if no drape converges.

    Interrupted from the keyboard, it hands back the best so far.

    Args:
        views: (4, H, W) z-depth, m, background 0.
        camera: of all of them, as well as it is known.
        turns: possible directions of the warp in the first view, rad; all are tried.
        resolution: vertices a side of the specimen; seed: of its mesh, and of the other shapes.
        shape: initial state, one of :data:`SHAPES`; the others where no drape of it converges.
        prior: what is known of theta beforehand.
        others: more fabrics (6,) to start from.
        rounds: simulations of each round.
    """
    run = _Run(views, camera, np.asarray(theta, np.float64), rig or Rig(), resolution, seed, shape,
               prior, weights, progress)
    status, message = Status.FAILED, "no drape converges"
    try:
        for initial in dict.fromkeys((shape, *SHAPES)):
            run.shape = initial
            run.start(turns, others)
            if run.best is not None:
                break
        else:
            return None
        for number, evaluations in enumerate(rounds):
            if number:
                run.pull_again()
            status, message = run.round(evaluations)
            if status is Status.INTERRUPTED:
                break
    except KeyboardInterrupt:
        if run.best is None:
            raise
        status, message = Status.INTERRUPTED, "interrupted; the best so far"
    return run.result(status, message)


class _Run:
    """One refinement: its objective, its mesh, and the best trial over all rounds."""

    def __init__(
        self,
        views: np.ndarray,
        camera: Camera,
        theta: np.ndarray,
        rig: Rig,
        resolution: int,
        seed: int,
        shape: str,
        prior: Gaussian | None,
        weights: DepthWeights | None,
        progress: Progress | None,
    ) -> None:
        self.began = time.perf_counter()
        faces = make_specimen(rig, resolution=resolution, seed=seed).mesh.faces
        self.objective = DepthViews(views, camera, faces, weights=weights)
        self.rig, self.resolution, self.seed, self.shape = rig, resolution, seed, shape
        self.prior, self.progress = prior, progress
        self.theta = theta
        self.simulations = 0
        self.best: Trial | None = None
        self.start_value: float | None = None

    def start(self, turns: Sequence[float], others: Sequence[np.ndarray]) -> None:
        """Release the captured shape with several fabrics, in every turn."""
        wide = [self.theta + np.repeat([shift, 0.0], 3) for shift in SPREAD]
        for turn in turns:
            nuisance = self.objective.start.copy()
            nuisance[0] = turn
            shape = self._shape(self.theta, nuisance)
            for theta in (*wide, *others):
                self._try(shape, theta, nuisance)

    def pull_again(self) -> None:
        """Release the captured shape of the best fabric, seen from where it fits best."""
        if self.shape == "captured":
            theta, nuisance = self.best.theta, self.best.nuisance
            self._try(self._shape(theta, nuisance), theta, nuisance)

    def round(self, evaluations: int) -> tuple[Status, str]:
        """Improve on the best trial."""
        before, problem = self.simulations, self._problem(self.best)
        outcome = minimise(
            problem, limits=Limits(evaluations=evaluations),
            report=lambda point, _: self._report(before + problem.solves, point))
        self.simulations = before + problem.solves
        self._keep(problem.best)
        return outcome.status, outcome.message

    def result(self, status: Status, message: str) -> RefinedViews:
        """The best of all, and how certain it is."""
        uncertainty = None
        if status is not Status.INTERRUPTED:
            problem = self._problem(self.best)
            problem.value(problem.start)
            uncertainty = laplace(problem, problem.last)
        return RefinedViews(
            self.theta, self.start_value, self.best, self.objective, uncertainty,
            self.simulations, time.perf_counter() - self.began, status, message)

    def _problem(self, trial: Trial) -> DrapeProblem:
        return DrapeProblem(trial.drape, trial.theta, self.objective, nuisance=trial.nuisance,
                            prior=self.prior)

    def _shape(self, theta: np.ndarray, nuisance: np.ndarray) -> DrapeResult:
        """Where simulations start: the captured shape, or a drape of ``theta``."""
        fabric = fabric_from_theta(theta)
        self._report(self.simulations + 1)
        self.simulations += 1
        options = {"rig": self.rig, "resolution": self.resolution, "seed": self.seed}
        if self.shape == "captured":
            return captured_shape(fabric, *self.objective.points(nuisance), **options)
        return drape(fabric, start=self.shape, **options)

    def _try(self, shape: DrapeResult, theta: np.ndarray, nuisance: np.ndarray) -> None:
        """Let ``shape`` go with the fabric ``theta``, and keep it if it is the best."""
        if not is_admissible(*from_theta(theta)):
            return
        self.simulations += 1
        released = follow(shape, fabric_from_theta(theta), options=RELEASE)
        if released.converged:
            nuisance = fit_nuisances(self.objective, released.positions, nuisance)
            problem = DrapeProblem(released, theta, self.objective, nuisance=nuisance,
                                   prior=self.prior)
            problem.value(problem.start)
            self.simulations += problem.solves
            self._keep(problem.best)
            if problem.best and np.array_equal(theta, self.theta):
                known = float("inf") if self.start_value is None else self.start_value
                self.start_value = min(known, problem.best.value)
        self._report(self.simulations)

    def _keep(self, trial: Trial | None) -> None:
        if trial is not None and (self.best is None or trial.value < self.best.value):
            self.best = trial

    def _report(self, simulations: int, point: Point | None = None) -> None:
        if self.progress:
            values = [t.value for t in (self.best, point) if t is not None]
            self.progress(simulations, min(values, default=float("inf")))
