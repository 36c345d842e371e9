"""Drapes simulated with Newton's Style3D solver, on the CPU.

Its bending energy is the quadratic one of hinges, ½ (modulus/3) · 3/(A0 + A1) |Σ wᵢ xᵢ|², its
membrane that of Baraff and Witkin. It integrates in time, in single precision. It needs the
packages of the extra ``newton``, which are imported on use.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from common.errors import InputError
from common.types import Density, Points, Radians
from drapenet.export.simulators import STYLE3D
from sim.material import BIAS, WARP, WEFT
from sim.mesh import Mesh
from sim.rig import GRAVITY
from sim.scene import Scene

if TYPE_CHECKING:
    from newton import ModelBuilder

INSTALL = "pip install --constraint constraints.txt --editable '.[newton]'"
PARTICLE_RADIUS = 1e-4  # m, of the particles
YOUNG, SHEAR = 200.0, 77.0
"""N/m, along the yarns and in shear, as in this project's membrane at Poisson's ratio 0.3."""
_CONTACT_STIFFNESS = 5.0  # N/m per particle; vertices penetrate the cylinder by at most 0.2 mm
_CONTACT_GAP = 0.01  # m
_STEPS_PER_SECOND, _LINEAR_ITERATIONS = 4000, 4
"""Steps per second of one projection each, and iterations of conjugate gradients in it. The matrix
of the projection has the membrane stiffness in all directions: with long steps, cloth creeps for
minutes."""
_STEPS_PER_DETECTION = 40


def installed() -> bool:
    """Whether Newton is installed."""
    return find_spec("newton") is not None


def require() -> None:
    """Raise InputError if Newton is not installed."""
    if not installed():
        raise InputError(f"Newton is not installed: {INSTALL}")


def missing(what: str) -> bool:
    """Whether Newton is missing; prints a line on stderr in this case."""
    if installed():
        return False
    print(f"{what} omitted: Newton is not installed: {INSTALL}", file=sys.stderr)
    return True


def edge_stiffness(modulus: Sequence[float]) -> np.ndarray:
    """``edge_aniso_ke`` (3,) for hinge moduli (3,), N·m, along warp, bias and weft."""
    return np.asarray(modulus)[[WEFT, WARP, BIAS]] / STYLE3D


def cloth(
    mesh: Mesh, held: np.ndarray, positions: Points, *, density: Density,
    stiffness: Sequence[float], young: float = YOUNG, shear: float = SHEAR, angle: Radians = 0.0,
) -> "ModelBuilder":
    """Builder of a model that contains a cloth, whose ``held`` vertices do not move.

    Args:
        stiffness: (3,) ``edge_aniso_ke``.
        young, shear: N/m, along the yarns and in shear.
        angle: from the mesh's x to the warp.
    """
    import newton
    import warp as wp
    from newton.solvers import SolverStyle3D, style3d

    wp.config.log_level = wp.LOG_ERROR
    wp.ScopedTimer.enabled = False
    wp.set_device("cpu")
    builder = newton.ModelBuilder(up_axis=newton.Axis.Z, gravity=(0.0, 0.0, -GRAVITY))
    SolverStyle3D.register_custom_attributes(builder)
    warp = np.array([np.cos(angle), np.sin(angle)])
    weft = np.array([warp[1], -warp[0]])
    style3d.add_cloth_mesh(
        builder, pos=wp.vec3(0, 0, 0), rot=wp.quat_identity(), scale=1.0, vel=wp.vec3(0, 0, 0),
        vertices=[wp.vec3(*point) for point in positions], indices=mesh.faces.ravel().tolist(),
        density=density, particle_radius=PARTICLE_RADIUS,
        panel_verts=np.column_stack([mesh.rest @ weft, mesh.rest @ warp]).tolist(),
        panel_indices=mesh.faces.tolist(), tri_aniso_ke=wp.vec3(young, young, shear),
        edge_aniso_ke=wp.vec3(*stiffness))
    for k in np.flatnonzero(held):
        builder.particle_mass[k] = 0.0
        builder.particle_flags[k] = builder.particle_flags[k] & ~newton.ParticleFlags.ACTIVE
    return builder


@dataclass(frozen=True)
class FinalState:
    """Final state of a simulation."""

    positions: Points
    motion: float
    """Mean displacement of the vertices in the last quarter of the time, mm."""


def simulate(
    specimen: Scene, positions: np.ndarray, *, density: float, modulus: Sequence[float],
    seconds: float,
) -> FinalState:
    """Simulate a specimen and its cylinder, if any, started from ``positions`` (V, 3), m.

    The solver damps 0.2 % of the velocity per step. Self-contact is disabled. There is no
    friction, because the solver computes it from the slip between the projections of a step, of
    which there is one.

    Args:
        density: kg/m². modulus: (3,) N·m, of hinges along warp, bias and weft.
        seconds: simulated time.
    """
    import newton
    import warp as wp
    from newton.solvers import SolverStyle3D

    builder = cloth(specimen.mesh, specimen.held, positions, density=density,
                    stiffness=edge_stiffness(modulus))
    half = float(np.ptp(specimen.mesh.rest))  # longer than the cloth hangs down
    for cylinder in specimen.obstacles:
        builder.add_shape_cylinder(
            -1, xform=wp.transform(wp.vec3(0, 0, -half - PARTICLE_RADIUS), wp.quat_identity()),
            radius=cylinder.radius - PARTICLE_RADIUS, half_height=half,
            cfg=newton.ModelBuilder.ShapeConfig(mu=0.0, margin=0.0, gap=_CONTACT_GAP))
    model = builder.finalize()
    model.soft_contact_ke = _CONTACT_STIFFNESS
    model.soft_contact_kd, model.soft_contact_mu = 0.0, 0.0
    solver = SolverStyle3D(model=model, config=SolverStyle3D.Config(
        iterations=1, linear_iterations=_LINEAR_ITERATIONS))
    collision = solver.collision
    collision.stiff_vf = collision.stiff_ee = collision.stiff_ef = 0.0  # no self-contact
    collision.frame_begin = lambda *_: None  # skips its detection
    pipeline = newton.CollisionPipeline(model, soft_contact_gap=_CONTACT_GAP)
    contacts, control = pipeline.contacts(), model.control()
    now, then = model.state(), model.state()
    steps = round(seconds * _STEPS_PER_SECOND)
    for step in range(steps):
        if step % _STEPS_PER_DETECTION == 0:
            pipeline.collide(now, contacts)
        if step == 3 * steps // 4:
            before = now.particle_q.numpy().astype(np.float64)
        solver.step(now, then, control, contacts, 1 / _STEPS_PER_SECOND)
        now, then = then, now
    found = now.particle_q.numpy().astype(np.float64)
    return FinalState(found, float(1e3 * np.linalg.norm(found - before, axis=1).mean()))
