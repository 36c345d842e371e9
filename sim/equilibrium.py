"""Static equilibrium of a cloth in a scene: which energies, which unknowns, which scales."""

import numpy as np

from sim.energies.contact import CylinderContact
from sim.energies.fold_limit import FoldLimit
from sim.energies.gravity import Gravity
from sim.energies.membrane import CorotationalMembrane
from sim.energies.midedge import MidEdgeBending, split_of_angles
from sim.material import Fabric
from sim.newton import NewtonOptions, NewtonResult, minimise
from sim.potential import Potential
from sim.scene import Scene, State

MEMBRANE_STIFFNESS = 200.0  # N/m, section 4.1
CONTACT_PRESSURE = 20.0  # carried at a depth of 0.1 mm, as a multiple of the cloth's weight
STEP_UNIT = 1e-3  # m: steps are reported in mm


def build_potential(
    scene: Scene,
    fabric: Fabric,
    state: State,
    *,
    membrane_stiffness: float = MEMBRANE_STIFFNESS,
) -> Potential:
    """Energy of ``fabric`` in ``scene`` around ``state``, whose held vertices stay put.

    Unknowns: coordinates of the free vertices and rotations of the edges that have one.
    Residuals are in units of the mean weight of a vertex (for rotations: times the mean edge
    length), steps in mm (for rotations: mm per mean edge length).
    """
    mesh = scene.mesh
    weight_per_area = fabric.density * scene.gravity
    energies = [
        CorotationalMembrane(mesh, scene.active, stiffness=membrane_stiffness),
        MidEdgeBending(mesh, scene.active, fabric=fabric),
        FoldLimit(mesh, scene.active, stiffness=float(fabric.alpha.min())),
        Gravity(mesh, density=fabric.density, gravity=scene.gravity),
    ]
    if scene.cylinder_radius is not None:
        energies.append(
            CylinderContact(
                mesh.vertex_areas * ~scene.held,
                radius=scene.cylinder_radius,
                pressure=CONTACT_PRESSURE * weight_per_area,
            )
        )
    _, sign = split_of_angles(mesh, scene.active)
    rotating = np.zeros(len(mesh.edges), dtype=bool)
    rotating[mesh.face_edges[scene.active][sign != 0]] = True

    ends = mesh.rest[mesh.edges]
    edge_length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).mean()
    weight = weight_per_area * mesh.vertex_areas.mean()
    coordinates, edges = 3 * len(mesh.rest), len(mesh.edges)
    return Potential(
        energies,
        template=np.concatenate([state.positions.ravel(), state.rotations]),
        free=np.concatenate([np.repeat(~scene.held, 3), rotating]),
        force_scale=np.repeat([weight, weight * edge_length], [coordinates, edges]),
        length_scale=np.repeat([STEP_UNIT, STEP_UNIT / edge_length], [coordinates, edges]),
    )


def find_equilibrium(
    scene: Scene,
    fabric: Fabric,
    start: State,
    *,
    options: NewtonOptions | None = None,
    membrane_stiffness: float = MEMBRANE_STIFFNESS,
) -> tuple[State, NewtonResult]:
    """Equilibrium of ``fabric`` in ``scene`` next to ``start``; see the result's status."""
    potential = build_potential(scene, fabric, start, membrane_stiffness=membrane_stiffness)
    q = np.concatenate([start.positions.ravel(), start.rotations])
    result = minimise(potential, potential.free_part(q), options)
    q = potential.full(result.y)
    vertices = len(scene.mesh.rest)
    return State(q[: 3 * vertices].reshape(-1, 3), q[3 * vertices :]), result
