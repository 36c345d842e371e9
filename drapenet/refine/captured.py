"""Refinement of a captured shape whose points are known: a scan registered to a mesh.

A simulation begins at the captured shape itself, so that its folds need not be found (Feng et al.
2022, section 7.2; Larionov et al., section 5), or at the drape of another trial, and ends where
the cloth of the tried moduli comes to rest. Unknown are theta, the membrane's stiffness, the
direction of the warp and, if wanted, a natural curvature.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from data.fabrics import fabric_from_theta, from_theta
from data.prior.gaussian import GaussianPrior
from drapenet.refine.objective import Objective, value
from drapenet.refine.problem import (
    ALPHA_RANGE,
    RATIO_RANGE,
    RATIO_SCALE,
    prior_value,
    with_prior,
)
from sim.drape import DrapeResult, scene_on
from sim.energies.base import Energy
from sim.energies.natural_curvature import NaturallyCurved
from sim.laws import Laws
from sim.material import Fabric, is_admissible
from sim.membranes import Corotational
from sim.mesh import Mesh
from sim.mesh.specimens import Specimen
from sim.newton import NewtonOptions, Status
from sim.scene import Rig
from sim.sensitivity import Tangent, follow
from sim.sensitivity.forward import tangent_sensitivities
from sim.sensitivity.parameters import forces
from sim.sensitivity.rest_shape import moves_with_rest
from sim.sensitivity.tangent import possible_contact

MEMBRANE_RANGE = (20.0, 5000.0)
"""N/m at 300 g/m². Softer cloth would stretch by its own weight; a scan whose vertices have slid
along the cloth asks for that."""
USUAL_MEMBRANE, MEMBRANE_SPREAD = 200.0, 0.3
"""N/m at 300 g/m², and how far log membrane may be from it. A drape hardly tells it, and errors of
a scan's vertices pass for stretch: without this knowledge soft cloth ends at the lower bound."""
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
        held_share: of the plate's radius, within which the plate holds the cloth; further out
            cloth lies on it, may lift and slide, and turns over the rim as it likes.
    """

    positions: np.ndarray
    rest: np.ndarray
    faces: np.ndarray
    rig: Rig
    held_share: float = 1.0

    @property
    def held(self) -> np.ndarray:
        """(V,) bool, vertices that the plate holds."""
        return self._within(self.held_share)

    @property
    def hanging(self) -> np.ndarray:
        """(V,) bool, vertices beyond the plate."""
        return ~self._within(1.0)

    def _within(self, share: float) -> np.ndarray:
        return np.linalg.norm(self.rest, axis=1) <= _ON_PLATE * share * self.rig.plate_radius

    def as_drape(self, fabric: Fabric, warp: float = 0.0) -> DrapeResult:
        """The shape as a drape of ``fabric`` that has not settled yet.

        Args:
            warp: direction of the warp in the axes of ``rest``, rad.
        """
        mesh = Mesh(turned_rest(self.rest, warp), self.faces)
        ends = mesh.rest[mesh.edges]
        lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        state = scene_on(Specimen(mesh, self.held), self.rig).state(self.positions)
        drape = DrapeResult(
            fabric=fabric, rig=self.rig, mesh=mesh, held=self.held, state=state, laws=Laws(),
            extra=(), touches=False, edge=float(lengths.mean()), status=Status.MAX_ITERATIONS,
            message="captured", residual=math.inf, step=math.inf, positive_definite=False,
            self_intersections=0, iterations=0, seconds=0.0, time_spent={})
        contact = possible_contact(drape).value(state.q)
        return replace(drape, touches=0 < contact < math.inf)

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


@dataclass
class Effort:
    """What a search has spent.

    Attributes:
        solves: simulations. failures: messages of those that did not end.
        seconds: wall time in simulations and in derivatives.
    """

    solves: int = 0
    failures: list[str] = field(default_factory=list)
    seconds: dict[str, float] = field(
        default_factory=lambda: {"simulation": 0.0, "derivatives": 0.0})


class CapturedProblem:
    """The refinement of a captured shape (:class:`.optimisers.LeastSquares`).

    Args:
        shape: captured.
        objective: without nuisances, of the vertices of ``shape``.
        start: cloth to begin with.
        prior: of theta; None for none.
        free: (11,) bool, which of :data:`NAMES` are unknown; all but the natural curvature unless
            given.
        spread: how far log membrane may be from the usual one; infinite: anywhere.
        near: where simulations begin: at this drape on the shape's mesh, later at the best one.
            None: every one is let go at the captured shape.
        springs: energies that hold the simulated cloth.
        effort: to count in; a new one unless given.

    Attributes:
        start, low, high: (n,) in units of :data:`SCALE`.
        best, last: None before the first simulation.
    """

    def __init__(
        self,
        shape: CapturedShape,
        objective: Objective,
        start: Cloth,
        *,
        prior: GaussianPrior | None = None,
        free: np.ndarray | None = None,
        spread: float = MEMBRANE_SPREAD,
        near: DrapeResult | None = None,
        springs: Sequence[Energy] = (),
        effort: Effort | None = None,
    ) -> None:
        self.shape, self.objective, self.prior = shape, objective, prior
        self.free = np.arange(len(NAMES)) < 8 if free is None else free
        self.effort = effort or Effort()
        self._spread, self._near, self._springs = spread, near, tuple(springs)
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
        self.effort.solves += 1
        began = time.perf_counter()
        drape = self._simulate(cloth)
        self.effort.seconds["simulation"] += time.perf_counter() - began
        if not drape.converged:
            self.effort.failures.append(f"{drape.status.value}: {drape.message}")
            return math.inf
        total = value(self.objective.residuals(drape.positions, np.zeros(0)))
        total += prior_value(self.prior, cloth.theta) + value(self._unusual(cloth))
        self.last = Settled(np.array(x), cloth, drape, total)
        if self.best is None or total < self.best.value:
            self.best = self.last
        return total

    def _simulate(self, cloth: Cloth) -> DrapeResult:
        near = self._near
        if near is None:
            near = self.shape.as_drape(cloth.fabric)
        elif self.best is not None:
            near = self.best.drape
        near = replace(near, mesh=near.mesh.with_rest(turned_rest(self.shape.rest, cloth.warp)))
        return follow(near, cloth.fabric, laws=cloth.laws, extra=self._springs, options=SETTLING,
                      keep=True)

    def linearised(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Residuals (N,) and derivatives (N, n) at x (n,), the last or the best one simulated."""
        here = next((s for s in (self.last, self.best)
                     if s is not None and np.array_equal(s.x, x)), None)
        if here is None:
            return None
        began = time.perf_counter()
        moves = cloth_moves(here.drape, here.cloth, self.free)
        self.effort.seconds["derivatives"] += time.perf_counter() - began
        if moves is None:
            return None
        found = self.objective.linearised(here.drape.positions, np.zeros(0))
        unknowns = np.eye(len(NAMES))[:, self.free]
        residuals, jacobian = with_prior(
            self.prior, here.cloth.theta, found.residuals, found.along(moves), unknowns[:6])
        return (np.concatenate([residuals, self._unusual(here.cloth)]),
                np.concatenate([jacobian, unknowns[6:7] / self._spread]) * SCALE[self.free])

    def _unusual(self, cloth: Cloth) -> np.ndarray:
        """(1,) how far the membrane is from the usual one, in units of its spread."""
        return np.array([math.log(cloth.membrane / USUAL_MEMBRANE) / self._spread])


def cloth_moves(drape: DrapeResult, cloth: Cloth, free: np.ndarray) -> np.ndarray | None:
    """Derivatives (n, V, 3) of a drape's vertices by the unknowns ``free`` (11,) of ``cloth``.

    None where the equilibrium has no derivatives.
    """
    tangent = Tangent.of(drape)
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
    own = tangent.cloth
    pushes = []
    for sign in (1, -1):
        curvature = np.array(cloth.curvature)
        curvature[k] += sign * _CURVATURE_STEP
        law = NaturallyCurved(tuple(curvature.tolist()))
        bending = law(own.scene.mesh, own.scene.active, fabric=own.fabric)
        pushes.append(forces([bending], tangent.q, own.potential.unknowns))
    push = (pushes[0] - pushes[1]) / (2 * _CURVATURE_STEP)
    return -tangent.response(push)[: tangent.coordinates].reshape(-1, 3)
