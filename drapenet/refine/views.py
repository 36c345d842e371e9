"""Refinement from four depth views: the captured folds are found, and the moduli corrected.

1. A specimen is pulled onto the captured surface (:mod:`.guided`, :mod:`.attraction`): the
   captured fold configuration.
2. It is released with several fabrics around the first estimate, and the one whose equilibrium
   the views fit best goes on: the multiple starts, which cost one simulation each.
3. Levenberg-Marquardt on theta, the specimen's turn and the camera's pose brings these near.
   Then a specimen is pulled and released again, for the first shape was that of the wrong fabric,
   seen from a little beside.
4. Twice more a specimen is pulled onto the surface, and Levenberg-Marquardt goes on while weak
   springs hold the cloth to it (:mod:`.held`), weaker the second time, and then on a finer mesh:
   in the end it is the mesh that errs (``benchmarks/refine_bias.py``). The value is the misfit.

What is known beforehand, such as the network's word with its usual error, counts as a measurement,
by as much more as the views are met worse than their assumed errors say.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from common.ctrl_c import require_interruption
from data.cameras import Camera
from data.fabrics import fabric_from_theta, from_theta
from data.prior.gaussian import GaussianPrior
from drapenet.refine.attraction import captured_shape
from drapenet.refine.depth import DepthViews, DepthWeights
from drapenet.refine.held import springs_to_surface
from drapenet.refine.objective import fit_nuisances, value
from drapenet.refine.optimisers import Limits, Outcome, Status, minimise
from drapenet.refine.problem import DrapeProblem, Trial
from drapenet.refine.uncertainty import Uncertainty, laplace
from sim.drape import DrapeResult, drape
from sim.energies.base import Energy
from sim.material import is_admissible
from sim.mesh.specimens import TOPOLOGIES, make_specimen
from sim.newton import NewtonOptions
from sim.scene import Rig
from sim.sensitivity import follow

FREE_ROUNDS = (4, 5)
"""Simulations of each Levenberg-Marquardt of free cloth."""
HELD_ROUNDS = ((8, 0.3), (4, 0.1))
"""The same of held cloth, and how strongly it is held, see :data:`.held.PULL`."""
COARSE, FINE = 3.5e-3, 1.75e-3
"""m, edges at the plate's rim until the last round, where folds and pose are found as well, and in
it."""
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
        start: theta (6,) that it began with.
        start_value: of the last objective there; None if that cloth did not converge.
        best: the best trial; turn and pose (:data:`.depth.POSE`) go with it. Its drape is held.
        drape: the free drape of the best fabric, next to it; ``best.drape`` if that did not
            converge.
        objective: that was minimised.
        uncertainty: None where the drape has no derivatives, or after an interruption.
        simulations: equilibria computed.
        seconds: in all.
        status, message: how it ended.
    """

    start: np.ndarray
    start_value: float | None
    best: Trial
    drape: DrapeResult
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
    edge: float = FINE,
    seed: int = 0,
    shape: str = "captured",
    prior: GaussianPrior | None = None,
    weights: DepthWeights | None = None,
    progress: Progress | None = None,
) -> RefinedViews | None:
    """Refine theta (6,) so that its drape looks like the views; None if no drape converges.

    Interrupted from the keyboard, it hands back the best so far. What is handed back is never
    worse than ``theta`` by the objective that was under way.

    Args:
        views: (4, H, W) z-depth, m, background 0.
        camera: of all of them, as well as it is known.
        turns: possible directions of the warp in the first view, rad; all are tried.
        edge: m, at the rim of the specimen's mesh in the last round, before it :data:`COARSE` at
            least; seed: of its meshes, and of the other shapes.
        shape: initial state, one of :data:`SHAPES`; the others where no drape of it converges.
        prior: what is known of theta beforehand, such as :attr:`drapenet.estimate.Estimate.normal`.
        weights: of the pixels; on coarser meshes they count less (:meth:`.DepthWeights.on_mesh`).
    """
    began = time.perf_counter()
    meshes = {}
    for level in (max(edge, COARSE), edge):
        specimen = make_specimen(rig or Rig(), edge=level, topology=seed % TOPOLOGIES)
        own = (weights or DepthWeights()).on_mesh(level)
        meshes[level] = _Mesh(rig or Rig(), level, seed, DepthViews(
            views, camera, specimen.mesh.faces, weights=own))
    rounds = meshes[max(edge, COARSE)], meshes[edge]
    run = _Run(rounds[0], np.asarray(theta, np.float64), prior, progress)
    try:
        for initial in dict.fromkeys((shape, *SHAPES)):
            run.start(initial, turns)
            if run.best is not None:
                break
        else:
            return None
        for number, evaluations in enumerate(FREE_ROUNDS):
            if number and initial == "captured":
                run.pull_again()
            run.weigh_prior()
            run.compare_again()
            run.improve(run.problem(run.best), evaluations)
        for mesh, (evaluations, pull) in zip(rounds, HELD_ROUNDS, strict=True):
            run.hold(mesh, evaluations, pull)
        run.conclude()
    except (KeyboardInterrupt, SystemError) as error:
        require_interruption(error)
        if run.best is None:
            raise KeyboardInterrupt from None
        run.status, run.message = Status.INTERRUPTED, "interrupted; the best so far"
        if run.held and not run.drape:
            run.message += ", its drape still held to the views by springs"
    return RefinedViews(
        run.theta, run.start_value if math.isfinite(run.start_value) else None, run.best,
        run.drape or run.best.drape, run.mesh.objective, run.uncertainty, run.simulations,
        time.perf_counter() - began, run.status, run.message)


@dataclass(frozen=True)
class _Mesh:
    """What a specimen and its mesh are made from, and the objective that knows its triangles."""

    rig: Rig
    edge: float
    seed: int
    objective: DepthViews


class _Run:
    """One refinement: its mesh with the objective, and the best trial of what is under way."""

    def __init__(
        self,
        mesh: _Mesh,
        theta: np.ndarray,
        prior: GaussianPrior | None,
        progress: Progress | None,
    ) -> None:
        self.mesh, self.theta, self.progress = mesh, theta, progress
        self.known = self.prior = prior
        self.simulations = 0
        self.best: Trial | None = None
        self.held: DrapeProblem | None = None
        self.drape: DrapeResult | None = None
        self.start_value = math.inf
        self.uncertainty: Uncertainty | None = None
        self.status, self.message = Status.FAILED, ""

    def start(self, initial: str, turns: Sequence[float]) -> None:
        """Release the initial shape with several fabrics, in every turn."""
        wide = [self.theta + np.repeat([shift, 0.0], 3) for shift in SPREAD]
        for turn in turns:
            nuisance = self.mesh.objective.start.copy()
            nuisance[0] = turn
            if initial == "captured":
                shape = self.shape(self.mesh, self.theta, nuisance)
            else:
                self.simulations += 1
                shape = drape(fabric_from_theta(self.theta), start=initial, rig=self.mesh.rig,
                              edge=self.mesh.edge, seed=self.mesh.seed)
            for theta in wide:
                self.release(shape, theta, nuisance)

    def shape(self, mesh: _Mesh, theta: np.ndarray, nuisance: np.ndarray) -> DrapeResult:
        """The captured shape, as a specimen of ``theta`` takes it."""
        self.simulations += 1
        self.report()
        return captured_shape(fabric_from_theta(theta), *mesh.objective.points(nuisance),
                              rig=mesh.rig, edge=mesh.edge, topology=mesh.seed % TOPOLOGIES)

    def release(self, shape: DrapeResult, theta: np.ndarray, nuisance: np.ndarray) -> None:
        """Let ``shape`` go with the fabric ``theta``, and keep it if it is the best."""
        if not is_admissible(*from_theta(theta)):
            return
        self.simulations += 1
        released = follow(shape, fabric_from_theta(theta), options=RELEASE)
        if released.converged:
            problem = self.refit(self.problem(released, theta, nuisance))
            if problem.best:
                self.keep(problem.best)
                if np.array_equal(theta, self.theta):
                    self.start_value = min(self.start_value, problem.best.value)
        self.report()

    def pull_again(self) -> None:
        """Release the captured shape of the best fabric, seen from where it fits best."""
        theta, nuisance = self.best.theta, self.best.nuisance
        self.release(self.shape(self.mesh, theta, nuisance), theta, nuisance)

    def problem(
        self, drape: DrapeResult | Trial, theta: np.ndarray | None = None,
        nuisance: np.ndarray | None = None, mesh: _Mesh | None = None, **more: object,
    ) -> DrapeProblem:
        """The problem that starts at a trial, or at a drape of theta."""
        if isinstance(drape, Trial):
            drape, theta, nuisance = drape.drape, drape.theta, drape.nuisance
        return DrapeProblem(drape, theta, (mesh or self.mesh).objective, nuisance=nuisance,
                            prior=self.prior, **more)

    def refit(self, problem: DrapeProblem) -> DrapeProblem:
        """``problem``, its start evaluated, and again with the nuisances that fit that best."""
        problem.value(problem.start)
        self.simulations += problem.solves
        if problem.best:
            trial = problem.best
            nuisance = fit_nuisances(problem.objective, trial.drape.positions, trial.nuisance)
            problem.value(np.concatenate([trial.x[: -len(nuisance)],
                                          nuisance / problem.objective.scale]))
        return problem

    def improve(self, problem: DrapeProblem, evaluations: int) -> Outcome:
        """Minimise from where ``problem`` starts; the best is kept."""
        before = self.simulations

        def report(*_: object) -> None:
            self.simulations = before + problem.solves
            self.report(problem.best)

        outcome = minimise(problem, limits=Limits(evaluations=evaluations), report=report)
        self.simulations = before + problem.solves
        self.keep(problem.best)
        if outcome.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        self.status, self.message = outcome.status, outcome.message
        return outcome

    def hold(self, mesh: _Mesh, evaluations: int, pull: float) -> None:
        """A round on ``mesh`` with springs to the surface as the best trial sees it."""
        trial = self.best
        self.weigh_prior()
        points = self.mesh.objective.points(trial.nuisance)
        # Pulled from afar, the specimen may end entangled; the best drape has the folds as well.
        for own, shape in ((mesh, self.shape(mesh, trial.theta, trial.nuisance)),
                           (self.mesh, trial.drape)):
            springs = springs_to_surface(shape, *points, pull=pull)
            found, first = (self.held_trial(springs, own, shape, theta, trial.nuisance)
                            for theta in (trial.theta, self.theta))
            trials = [t for t in (found, first) if t is not None]
            if trials:
                break
        else:
            self.compare_again()
            return
        # Values with other springs are not compared.
        self.mesh, self.best = own, min(trials, key=lambda t: t.value)
        self.start_value = math.inf if first is None else first.value
        self.held = self.problem(self.best, springs=[springs])
        self.improve(self.held, evaluations)

    def weigh_prior(self) -> None:
        """Let the prior count as much as the views do: they say less, the less they are met."""
        if self.known is not None:
            best = self.best
            found = self.mesh.objective.linearised(best.drape.positions, best.nuisance)
            misfit = max(2 * value(found.residuals) / found.count, 1.0)
            self.prior = replace(self.known, covariance=self.known.covariance / misfit)

    def compare_again(self) -> None:
        """The value of the best under the prior as it weighs now."""
        if self.known is not None:
            self.best = self.refit(self.problem(self.best)).best or self.best

    def held_trial(
        self, springs: Energy, mesh: _Mesh, shape: DrapeResult, theta: np.ndarray,
        nuisance: np.ndarray,
    ) -> Trial | None:
        """The fabric ``theta`` held to the surface; None where that does not converge."""
        if not is_admissible(*from_theta(theta)):
            return None
        self.simulations += 1
        held = follow(shape, fabric_from_theta(theta), extra=[springs], keep=True)
        self.report()
        if not held.converged:
            return None
        return self.refit(self.problem(held, theta, nuisance, mesh, springs=[springs])).best

    def conclude(self) -> None:
        """The free drape of what was found, and how certain it is."""
        found = self.held or self.problem(self.best)
        if found.best is None:
            found.value(found.start)
        self.uncertainty = laplace(found, found.best)
        self.simulations += 1
        free = follow(self.best.drape, fabric_from_theta(self.best.theta), options=RELEASE)
        self.drape = free if free.converged else None

    def keep(self, trial: Trial | None) -> None:
        """Take ``trial`` if it is better than the best."""
        if trial is not None and (self.best is None or trial.value < self.best.value):
            self.best = trial

    def report(self, trial: Trial | None = None) -> None:
        """Tell the progress."""
        if self.progress:
            values = [t.value for t in (self.best, trial) if t is not None]
            self.progress(self.simulations, min(values, default=math.inf))
