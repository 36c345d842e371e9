"""Newton's Style3D solver, on the CPU: another simulator, whose cloth is made of hinges.

Its bending energy is the quadratic one of hinges, ½ (modulus/3) · 3/(A0 + A1) |Σ wᵢ xᵢ|², its
membrane Baraff's and Witkin's; it marches in time, in single precision. It needs the packages of
the extra ``studies``, and imports them where it is used.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from common.errors import InputError
from drapenet.export import STYLE3D
from sim.material import BIAS, WARP, WEFT
from sim.mesh import Mesh
from sim.mesh.specimens import Specimen
from sim.scene import GRAVITY, Rig

if TYPE_CHECKING:
    from newton import ModelBuilder

INSTALL = "pip install --constraint constraints.txt --editable '.[newton]'"
RADIUS = 1e-4  # m, of the particles, which touch at that distance
YOUNG, SHEAR = 200.0, 77.0
"""N/m, along the yarns and in shear, as this project's membrane has at Poisson's ratio 0.3."""
_CONTACT = 5.0  # N/m at a particle; vertices then enter the cylinder by 0.2 mm at most
_NEAR = 0.01  # m, within which vertices are tested for contact
_RATE, _LINEAR = 4000, 4
"""Steps a second of one projection each, and steps of conjugate gradients in it. The projection's
matrix has the membrane's stiffness in all directions: with long steps, cloth creeps for minutes."""
_CONTACTS = 40  # steps between looks for vertices near the cylinder


def installed() -> bool:
    """Whether Newton is there."""
    return find_spec("newton") is not None


def require() -> None:
    """InputError unless Newton is there."""
    if not installed():
        raise InputError(f"Newton is not installed: {INSTALL}")


def left_out(what: str) -> bool:
    """Whether Newton is missing, which is then said on stderr."""
    if installed():
        return False
    print(f"{what} left out: Newton is not installed: {INSTALL}", file=sys.stderr)
    return True


def edge_stiffness(modulus: Sequence[float]) -> np.ndarray:
    """(3,) ``edge_aniso_ke`` of moduli (3,) N·m of hinges along warp, bias and weft."""
    return np.asarray(modulus)[[WEFT, WARP, BIAS]] / STYLE3D


def cloth(
    mesh: Mesh, held: np.ndarray, positions: np.ndarray, *, density: float,
    stiffness: Sequence[float], young: float = YOUNG, shear: float = SHEAR, angle: float = 0.0,
) -> "ModelBuilder":
    """A model's builder with a cloth in it.

    Args:
        held: (V,) bool, vertices that do not move. positions: (V, 3) m.
        density: kg/m².
        stiffness: (3,) ``edge_aniso_ke``.
        young, shear: N/m, along the yarns and in shear.
        angle: rad, from the mesh's x to the warp.
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
        density=density, particle_radius=RADIUS,
        panel_verts=np.column_stack([mesh.rest @ weft, mesh.rest @ warp]).tolist(),
        panel_indices=mesh.faces.tolist(), tri_aniso_ke=wp.vec3(young, young, shear),
        edge_aniso_ke=wp.vec3(*stiffness))
    for k in np.flatnonzero(held):
        builder.particle_mass[k] = 0.0
        builder.particle_flags[k] = builder.particle_flags[k] & ~newton.ParticleFlags.ACTIVE
    return builder


@dataclass(frozen=True)
class Settled:
    """Where a cloth has come.

    Attributes:
        positions: (V, 3) m.
        motion: of the vertices in the last quarter of the time, mean, mm.
    """

    positions: np.ndarray
    motion: float


def draped(
    specimen: Specimen, positions: np.ndarray, rig: Rig, *, density: float,
    modulus: Sequence[float], seconds: float,
) -> Settled:
    """A specimen comes to rest on the cylinder of ``rig`` from ``positions`` (V, 3), m.

    The solver's own damping, 0.2 % of the velocity a step, keeps it from swinging. Contact of the
    cloth with itself is left out. So is friction, which the solver takes from the slip between the
    projections of a step: with one there is none.

    Args:
        density: kg/m². modulus: (3,) N·m, of hinges along warp, bias and weft.
        seconds: of simulated time.
    """
    import newton
    import warp as wp
    from newton.solvers import SolverStyle3D

    builder = cloth(specimen.mesh, specimen.held, positions, density=density,
                    stiffness=edge_stiffness(modulus))
    half = rig.specimen_size
    builder.add_shape_cylinder(
        -1, xform=wp.transform(wp.vec3(0, 0, -half - RADIUS), wp.quat_identity()),
        radius=rig.plate_radius - RADIUS, half_height=half,
        cfg=newton.ModelBuilder.ShapeConfig(mu=0.0, margin=0.0, gap=_NEAR))
    model = builder.finalize()
    model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_mu = _CONTACT, 0.0, 0.0
    solver = SolverStyle3D(model=model, config=SolverStyle3D.Config(
        iterations=1, linear_iterations=_LINEAR))
    touching = solver.collision
    touching.stiff_vf = touching.stiff_ee = touching.stiff_ef = 0.0  # of the cloth with itself
    touching.frame_begin = lambda *_: None  # would look for it all the same
    pipeline = newton.CollisionPipeline(model, soft_contact_gap=_NEAR)
    contacts, control = pipeline.contacts(), model.control()
    now, then = model.state(), model.state()
    steps = round(seconds * _RATE)
    for step in range(steps):
        if step % _CONTACTS == 0:
            pipeline.collide(now, contacts)
        if step == 3 * steps // 4:
            before = now.particle_q.numpy().astype(np.float64)
        solver.step(now, then, control, contacts, 1 / _RATE)
        now, then = then, now
    found = now.particle_q.numpy().astype(np.float64)
    return Settled(found, float(1e3 * np.linalg.norm(found - before, axis=1).mean()))
