"""Lowering: the start of a drape test (BS 5058, ISO 9073-9).

The specimen lies flat on the plate and on a ring around it, with sub-millimetre waviness. The ring
sinks, and the cloth follows by implicit time steps (:mod:`sim.solver.dynamics`; docs/physics.md).
"""

import copy
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from common.types import Metres, Points, StateVector
from sim.cloth import Cloth, Laws
from sim.energies.base import Energy
from sim.energies.bending_variants import Hysteresis, HystereticBending
from sim.equilibrium import Equilibrium
from sim.material import REFERENCE_DENSITY, Fabric
from sim.mesh.specimen import GRADING
from sim.rig import GRAVITY, Rig
from sim.scene import Scene
from sim.solver.dynamics import Inertia, Motion
from sim.solver.linear import make_solver
from sim.solver.newton import NewtonResult, Status
from sim.start import waves


class LoweringMesh(NamedTuple):
    """A mesh on which cloth is lowered."""

    edge: Metres  # at the rim
    grading: float
    limp: bool  # whether it is for limp cloth, too


LOWERING_MESHES = LoweringMesh(10e-3, GRADING, False), LoweringMesh(7e-3, 2.0, True)
"""The second where the first is too coarse."""
SPEEDS = (0.13, 0.39)
"""Range of the ring's speed, log-uniform, in units of sqrt(g o) with the overhang o: 0.1 to 0.3 m/s
for the standard 60 mm, which a hand lowers in 0.2 to 0.6 s."""
RELAXATION = 0.16
"""Relaxation time of the cloth's viscosity in units of sqrt(o/g): 12.5 ms for 60 mm, a loss factor
of 0.4 at the pace of a forming fold, a fifth of a second."""
STEP = 0.16
"""Time step in the same units. Half of it changes the mean number of folds of six drapes by
0.4 at most (docs/physics.md)."""
SETTLING = 2.5
"""Time from the ring's last contact to the search for the equilibrium, in the same units."""
GAP = 1e-3  # m, of the ring below the cloth at the start
RING_STIFFNESS = 50.0 / 1e-6  # 1/m²: cloth 1 mm inside the ring feels 50 times its weight
MAX_STEPS = 400
_WAVINESS = 3e-4  # m


class Ring(Energy):
    """Plane that supports vertices (M,) of weights (M,), N: the penalty k d³/3 on the depth d below
    its ``height``, m; 0 at first."""

    def __init__(self, vertices: np.ndarray, weights: np.ndarray) -> None:
        self.dofs = 3 * vertices[:, None] + 2
        self._stiffness = RING_STIFFNESS * weights  # N/m²
        self.height = 0.0

    def lowered_to(self, height: Metres) -> "Ring":
        """The ring at another ``height``."""
        other = copy.copy(self)
        other.height = height
        return other

    def depths(self, q: StateVector) -> np.ndarray:
        """Depths (M,), m, of the vertices below the plane; 0 above it."""
        return np.maximum(self.height - q[self.dofs[:, 0]], 0.0)

    def value(self, q: StateVector) -> float:
        return float(self._stiffness @ self.depths(q) ** 3) / 3

    def gradient(self, q: StateVector) -> np.ndarray:
        return -(self._stiffness * self.depths(q) ** 2)[:, None]

    def hessian(self, q: StateVector, convex: bool = False) -> np.ndarray:
        return (2 * self._stiffness * self.depths(q))[:, None, None]


def lowered(scene: Scene, fabric: Fabric, rig: Rig, *, laws: Laws, seed: int) -> Equilibrium:
    """Cloth lowered over the plate of ``rig``, in motion close to its equilibrium: the status is
    NOT_FINITE if a time step fails, else MAX_ITERATIONS; its laws have the origins of hysteresis
    that the cloth has reached. The ``seed`` is that of waviness and speed."""
    flat, ring_speed, time = on_ring(scene, rig, seed=seed)
    step, relaxation, held = STEP * time, RELAXATION * time, scene.held
    inertia = Inertia(scene.mesh, density=REFERENCE_DENSITY)
    ring = Ring(np.flatnonzero(~held), inertia.masses[~held] * GRAVITY)
    cloth = Cloth(scene, fabric, laws=laws, extra=[inertia, ring])
    solver = make_solver(cloth.potential.pattern)
    motion, free, bending = Motion.at_rest(scene.state(flat)), 0.0, cloth.bending
    last = Equilibrium(cloth=cloth, state=motion.state,
                       outcome=NewtonResult(motion.state.q, Status.MAX_ITERATIONS, "at rest"))
    for _ in range(MAX_STEPS):
        now = ring.lowered_to(-GAP - ring_speed * (motion.time + relaxation))
        potential = cloth.potential.exchanged({ring: now, cloth.bending: bending})
        motion, result = motion.advanced(potential, inertia, step, relaxation=relaxation,
                                         solver=solver)
        last = Equilibrium(cloth=cloth, state=motion.state, outcome=result).after(last)
        if result.status is Status.NOT_FINITE:
            break
        if isinstance(bending, HystereticBending):
            bending = bending.with_origin(bending.origin_at(motion.state.q))
        free = 0.0 if now.depths(result.q).any() else free + step
        if free >= SETTLING * time:
            break
    if last.status is not Status.NOT_FINITE:
        last = last.ended(Status.MAX_ITERATIONS, "in motion")
    if isinstance(laws.bending, Hysteresis) and isinstance(bending, HystereticBending):
        last = replace(last, cloth=replace(cloth, laws=laws.with_origin(bending.origin)))
    return last


def on_ring(scene: Scene, rig: Rig, *, seed: int) -> tuple[Points, float, float]:
    """Flat cloth with the waviness of its ``seed``, m; the ring's speed, m/s, of the seed; the unit
    of time sqrt(o/g), s."""
    rng = np.random.default_rng([seed, 1])
    overhang = (rig.specimen_size - rig.plate_diameter) / 2
    time = float(np.sqrt(overhang / GRAVITY))
    speed = float(np.exp(rng.uniform(*np.log(SPEEDS))) * overhang / time)
    rest, free = scene.mesh.rest, ~scene.held
    flat = np.column_stack([rest, np.zeros(len(rest))])
    flat[free] += waves(rest, rig, rng, amplitude=_WAVINESS)[free]
    return flat, speed, time


def nearest_triangles(before: Scene, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """The three active triangles (T, 3) of ``before`` nearest to each of ``scene``, and weights
    (T, 3) of their means, the inverse distances."""
    centres, places = (at.mesh.rest[at.mesh.faces[at.active]].mean(axis=1)
                       for at in (before, scene))
    distance, near = cKDTree(centres).query(places, k=3)
    weight = 1 / (distance + 1e-6)
    return near, weight / weight.sum(axis=1, keepdims=True)


def with_origins(laws: Laws, lowered: Equilibrium, scene: Scene) -> Laws:
    """``laws`` for the mesh of ``scene``, with the hysteresis of ``lowered`` cloth: each triangle
    has the mean origin S1 of :func:`nearest_triangles`."""
    law = lowered.cloth.laws.bending
    if not (isinstance(law, Hysteresis) and law.origin is not None and law.origin.any()):
        return laws
    near, weight = nearest_triangles(lowered.cloth.scene, scene)
    origin = (law.origin[near] * weight[:, :, None]).sum(axis=1)
    return laws.with_origin(origin)
