"""Refinement of a captured shape whose points are known: a scan registered to a mesh.

Every simulation begins at the captured shape itself, so that its folds need not be found
(Feng et al. 2022, section 7.2; Larionov et al., section 5), and ends where the cloth of the tried
moduli comes to rest. Unknown are theta, the membrane's stiffness, the direction of the warp and,
if wanted, a natural curvature.
"""

import math
import time
from dataclasses import dataclass

import numpy as np

from data.fabrics import fabric_from_theta, from_theta
from data.prior.gaussian import GaussianPrior
from drapenet.refine.objective import Linearised, Objective, value
from drapenet.refine.problem import (
    ALPHA_RANGE,
    RATIO_RANGE,
    RATIO_SCALE,
    prior_value,
    with_prior,
)
from sim.drape import DrapeResult
from sim.energies.natural_curvature import NaturallyCurved
from sim.laws import Laws
from sim.material import Fabric, is_admissible
from sim.membranes import Corotational
from sim.newton import NewtonOptions, Status
from sim.scene import Rig
from sim.sensitivity import Tangent, follow
from sim.sensitivity.forward import tangent_sensitivities
from sim.sensitivity.parameters import forces
from sim.sensitivity.rest_shape import moves_with_rest

MEMBRANE_RANGE = (20.0, 5000.0)
"""N/m at 300 g/m². Softer cloth would stretch by its own weight; a scan whose vertices have slid
along the cloth asks for that."""
WARP_SCALE = 0.3  # rad
CURVATURE_RANGE = 60.0  # 1/m
CURVATURE_SCALE = 25.0  # 1/m
_CURVATURE_STEP = 1e-3  # 1/m; the torque is linear in the natural curvature
_ON_PLATE = 1.003  # of the plate's radius: vertices on its rim are held
SETTLING = NewtonOptions(residual=1e-3, step=1e-3, max_iterations=300)
"""When a simulation ends: a thousandth of a millimetre from its end at most."""


@dataclass(frozen=True)
class CapturedShape:
    """A captured drape whose vertices belong to points of the flat specimen.

    Attributes:
        positions: (V, 3) m, on the rig's axes.
        rest: (V, 2) m, in any material axes.
        faces: (F, 3), counter-clockwise at rest.
        rig: with a plate.
    """

    positions: np.ndarray
    rest: np.ndarray
    faces: np.ndarray
    rig: Rig

    @property
    def held(self) -> np.ndarray:
        """(V,) bool, vertices on the plate."""
        return np.linalg.norm(self.rest, axis=1) <= _ON_PLATE * self.rig.plate_radius

    def as_drape(self, fabric: Fabric, warp: float = 0.0) -> DrapeResult:
        """The shape as a drape of ``fabric`` that has not settled yet.

        Args:
            warp: direction of the warp in the axes of ``rest``, rad.
        """
        rest = turned_rest(self.rest, warp)
        edges = len(np.unique(np.sort(
            self.faces[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2), axis=1), axis=0))
        return DrapeResult(
            fabric=fabric, rig=self.rig, positions=self.positions, rotations=np.zeros(edges),
            rest=rest, faces=self.faces, diagonals=None, held=self.held,
            resolution=round(math.sqrt(len(rest))), status=Status.MAX_ITERATIONS,
            message="captured", residual=math.inf, step=math.inf, positive_definite=False,
            self_intersections=0, iterations=0, seconds=0.0, time_spent={})

    def settle(
        self, fabric: Fabric, *, warp: float = 0.0, laws: Laws | None = None,
        options: NewtonOptions = SETTLING,
    ) -> DrapeResult:
        """The equilibrium that ``fabric`` falls into when it is let go at the captured shape."""
        return follow(self.as_drape(fabric, warp), fabric, laws=laws, options=options)


def turned_rest(rest: np.ndarray, warp: float) -> np.ndarray:
    """Rest points (V, 2) in the axes of a warp that lies at the angle ``warp``, rad."""
    c, s = math.cos(warp), math.sin(warp)
    return rest @ np.array([[c, -s], [s, c]])


@dataclass(frozen=True)
class Cloth:
    """What a captured shape is refined by.

    Attributes:
        theta: (6,) moduli, see :mod:`data.fabrics`.
        membrane: N/m, in-plane stiffness at 300 g/m².
        warp: direction of the warp in the axes of the captured rest points, rad.
        curvature: (3,) natural curvature, 1/m.
    """

    theta: np.ndarray
    membrane: float = 200.0
    warp: float = 0.0
    curvature: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def fabric(self) -> Fabric:
        """The moduli, at 300 g/m²."""
        return fabric_from_theta(self.theta)

    @property
    def laws(self) -> Laws:
        """With the membrane and the natural curvature."""
        bending = NaturallyCurved(self.curvature) if any(self.curvature) else "midedge"
        return Laws(bending=bending, membrane=Corotational(self.membrane))


NAMES = ("log_alpha_warp", "log_alpha_bias", "log_alpha_weft", "beta_over_alpha_warp",
         "beta_over_alpha_bias", "beta_over_alpha_weft", "log_membrane", "warp",
         "curvature_warp", "curvature_weft", "curvature_twist")  # fmt: skip
SCALE = np.array([1.0] * 3 + [RATIO_SCALE] * 3 + [1.0, WARP_SCALE] + [CURVATURE_SCALE] * 3)
"""Units of the unknowns."""


@dataclass(frozen=True)
class Settled:
    """One simulation: unknowns x (n,), cloth, drape and the objective's value there."""

    x: np.ndarray
    cloth: Cloth
    drape: DrapeResult
    value: float


class CapturedProblem:
    """The refinement of a captured shape (:class:`.optimisers.LeastSquares`).

    Args:
        shape: captured.
        objective: without nuisances, of the vertices of ``shape``.
        start: cloth to begin with.
        prior: of theta; None for none.
        free: (11,) bool, which of :data:`NAMES` are unknown; all but the natural curvature unless
            given.

    Attributes:
        start, low, high: (n,) in units of :data:`SCALE`.
        best: None before the first simulation.
        solves: simulations. failures: messages of those that did not end.
        seconds: wall time in simulations and in derivatives.
    """

    def __init__(
        self,
        shape: CapturedShape,
        objective: Objective,
        start: Cloth,
        *,
        prior: GaussianPrior | None = None,
        free: np.ndarray | None = None,
    ) -> None:
        self.shape, self.objective, self.prior = shape, objective, prior
        self.free = np.arange(len(NAMES)) < 8 if free is None else free
        self._all = np.concatenate([start.theta, [math.log(start.membrane), start.warp],
                                    start.curvature])
        alpha, membrane = np.log(ALPHA_RANGE), np.log(MEMBRANE_RANGE)
        low, high = (
            np.concatenate([[alpha[k]] * 3, [RATIO_RANGE[k]] * 3, [membrane[k]],
                            [start.warp + (2 * k - 1) * math.pi],
                            [(2 * k - 1) * CURVATURE_RANGE] * 3])
            for k in (0, 1))
        self.low, self.high = ((bound / SCALE)[self.free] for bound in (low, high))
        self.start = np.clip((self._all / SCALE)[self.free], self.low, self.high)
        self.best: Settled | None = None
        self.last: Settled | None = None
        self.solves = 0
        self.failures: list[str] = []
        self.seconds = {"simulation": 0.0, "derivatives": 0.0}

    def cloth(self, x: np.ndarray) -> Cloth:
        """The cloth of the unknowns x (n,)."""
        values = self._all.copy()
        values[self.free] = x * SCALE[self.free]
        return Cloth(values[:6], math.exp(values[6]), float(values[7]),
                     tuple(values[8:].tolist()))

    def value(self, x: np.ndarray) -> float:
        """The value at x (n,); infinite where no cloth or no equilibrium is."""
        for known in (self.last, self.best):
            if known is not None and np.array_equal(known.x, x):
                return known.value
        cloth = self.cloth(x)
        if not is_admissible(*from_theta(cloth.theta)):
            return math.inf
        self.solves += 1
        began = time.perf_counter()
        drape = self.shape.settle(cloth.fabric, warp=cloth.warp, laws=cloth.laws)
        self.seconds["simulation"] += time.perf_counter() - began
        if not drape.converged:
            self.failures.append(f"{drape.status.value}: {drape.message}")
            return math.inf
        total = value(self.objective.residuals(drape.positions, np.zeros(0)))
        total += prior_value(self.prior, cloth.theta)
        self.last = Settled(np.array(x), cloth, drape, total)
        if self.best is None or total < self.best.value:
            self.best = self.last
        return total

    def linearised(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Residuals (N,) and derivatives (N, n) at x (n,), the last or the best one simulated."""
        here = next((s for s in (self.last, self.best)
                     if s is not None and np.array_equal(s.x, x)), None)
        if here is None:
            return None
        began = time.perf_counter()
        moves = cloth_moves(here.drape, here.cloth, self.free)
        self.seconds["derivatives"] += time.perf_counter() - began
        if moves is None:
            return None
        found = self.objective.linearised(here.drape.positions, np.zeros(0))
        residuals, jacobian = with_prior(
            self.prior, here.cloth.theta, found.residuals, found.along(moves),
            np.eye(len(NAMES))[:6, self.free])
        return residuals, jacobian * SCALE[self.free]


def cloth_moves(drape: DrapeResult, cloth: Cloth, free: np.ndarray) -> np.ndarray | None:
    """Derivatives (n, V, 3) of a drape's vertices by the unknowns ``free`` (11,) of ``cloth``.

    None where the equilibrium has none.
    """
    tangent = Tangent.of(drape, laws=cloth.laws)
    if not tangent.ok:
        return None
    moves = list(tangent_sensitivities(
        tangent, drape.fabric, ("log_alpha", "ratio", "membrane")).positions)
    # The material axes turn backwards below the warp that turns forwards.
    turning = np.column_stack([drape.rest[:, 1], -drape.rest[:, 0]])
    moves.append(moves_with_rest(tangent, turning[None])[0] if free[7]
                 else np.zeros_like(drape.positions))
    for k in range(3):
        moves.append(_curving(tangent, cloth, k) if free[8 + k]
                     else np.zeros_like(drape.positions))
    return np.stack(moves)[free]


def _curving(tangent: Tangent, cloth: Cloth, k: int) -> np.ndarray:
    """(V, 3) derivatives by one component of the natural curvature."""
    mesh, active = tangent.scene.mesh, tangent.scene.active
    pushes = []
    for sign in (1, -1):
        curvature = np.array(cloth.curvature)
        curvature[k] += sign * _CURVATURE_STEP
        law = NaturallyCurved(tuple(curvature.tolist()))
        pushes.append(forces([law(mesh, active, fabric=tangent.fabric)], tangent.q))
    push = (pushes[0] - pushes[1]) / (2 * _CURVATURE_STEP)
    return -tangent.response(push)[: tangent.coordinates].reshape(-1, 3)


class RobustPositions:
    """Objective: distances between vertices and their captured places, far ones counting less.

    Value: that of Huber's function of the distances in units of ``sigma``, half its mean over
    ``vertices`` times ``independent``.

    Args:
        target: (V, 3) m, on the same mesh.
        vertices: (V,) bool, those that count.
        sigma: m, standard deviation of a distance.
        limit: in units of ``sigma``, from which the value grows linearly.
        independent: how many of the distances are independent: of one fold, hardly more than one.
    """

    nuisances = ()
    start = scale = np.zeros(0)

    def __init__(
        self, target: np.ndarray, *, vertices: np.ndarray, sigma: float = 1e-3,
        limit: float = 2.0, independent: float = 100.0,
    ) -> None:
        self._target, self._vertices = target, np.flatnonzero(vertices)
        self._sigma, self._limit = sigma, limit
        self._factor = math.sqrt(independent / len(self._vertices))

    @classmethod
    def of(cls, shape: CapturedShape) -> "RobustPositions":
        """For a registered scan: its hanging vertices, whose distances of 2 mm already are far."""
        return cls(shape.positions, vertices=~shape.held, sigma=2e-3, limit=1.0)

    def residuals(self, positions: np.ndarray, nuisance: np.ndarray) -> np.ndarray:
        """Residuals (3 N,)."""
        return self._bent(positions)[0].ravel()

    def linearised(self, positions: np.ndarray, nuisance: np.ndarray) -> Linearised:
        """The same with derivatives."""
        residuals, scale, across = self._bent(positions)

        def along(moves: np.ndarray) -> np.ndarray:
            chosen = moves[:, self._vertices]
            inward = (across * chosen).sum(-1, keepdims=True)
            return (scale[:, None] * chosen + residuals * inward).reshape(len(moves), -1).T

        return Linearised(residuals.ravel(), along, np.zeros((residuals.size, 0)))

    def _bent(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residuals (N, 3), their factor (N,), and its relative derivative by the gap (N, 3)."""
        gap = (positions - self._target)[self._vertices]
        distance = np.maximum(np.linalg.norm(gap, axis=1) / self._sigma, 1e-12)
        far = distance > self._limit
        bent = np.sqrt(np.where(far, 2 * self._limit * distance - self._limit**2, 1.0))
        scale = np.where(far, bent / distance, 1.0) * self._factor / self._sigma
        # d log(bent/d)/dd = limit/bent² - 1/d, along the gap's direction
        slope = np.where(far, self._limit / bent**2 - 1 / distance, 0.0)
        across = (slope / distance)[:, None] * gap / self._sigma**2
        return scale[:, None] * gap, scale, across
