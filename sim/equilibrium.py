"""Static equilibrium of a cloth in a scene: which energies, which unknowns, which scales."""

from collections.abc import Sequence

import numpy as np

from sim.energies.base import Energy
from sim.energies.contact import Obstacle, ObstacleContact
from sim.energies.gravity import Gravity
from sim.laws import Laws
from sim.material import Fabric
from sim.newton import NewtonOptions, NewtonResult, minimise
from sim.potential import Potential, Terms
from sim.scene import Scene, State

STEP_UNIT = 1e-3  # m: steps are reported in mm


def build_potential(
    scene: Scene,
    fabric: Fabric,
    state: State,
    *,
    laws: Laws | None = None,
    extra: Sequence[Energy] = (),
) -> Potential:
    """Energy of ``fabric`` in ``scene`` around ``state``; arguments as for :func:`cloth_terms`."""
    return Potential(**vars(cloth_terms(scene, fabric, state, laws=laws, extra=extra)))


def cloth_terms(
    scene: Scene,
    fabric: Fabric,
    state: State,
    *,
    laws: Laws | None = None,
    extra: Sequence[Energy] = (),
) -> Terms:
    """What the potential of ``fabric`` in ``scene`` consists of.

    Held vertices stay where they are in ``state``. Unknowns: coordinates of the free vertices and
    the rotations that an energy depends on.
    Residuals are in units of the mean weight of a vertex (for rotations: times the mean edge
    length), steps in mm (for rotations: mm per mean edge length).

    Args:
        laws: of bending and membrane.
        extra: energies beside those of the cloth, its weight and the scene's obstacles.
    """
    mesh = scene.mesh
    weight_per_area = fabric.density * scene.gravity
    membrane, *others = (laws or Laws()).energies(mesh, scene.active, fabric)
    energies = [
        *others,
        Gravity(mesh, density=fabric.density, gravity=scene.gravity),
        *extra,
    ]
    for obstacle in scene.obstacles:
        energies += _contact(scene, obstacle, scene.contact_pressure * weight_per_area)
    coordinates, edges = 3 * len(mesh.rest), len(mesh.edges)
    used = np.zeros(coordinates + edges, dtype=bool)
    for energy in (membrane, *energies):
        used[energy.dofs[energy.dofs >= 0]] = True
    used[:coordinates] &= np.repeat(~scene.held, 3)

    ends = mesh.rest[mesh.edges]
    edge_length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).mean()
    weight = weight_per_area * mesh.vertex_areas.mean()
    # A convex membrane alone nearly always makes the whole Hessian positive definite.
    return Terms(
        stages=[[membrane], energies],
        template=state.unknowns,
        free=used,
        force_scale=np.repeat([weight, weight * edge_length], [coordinates, edges]),
        length_scale=np.repeat([STEP_UNIT, STEP_UNIT / edge_length], [coordinates, edges]),
    )


def _contact(scene: Scene, obstacle: Obstacle, pressure: float) -> list[ObstacleContact]:
    """Contact at the free vertices and at the middles of the edges.

    Edges between touching vertices cut through a convex obstacle; with points twice as dense,
    a quarter as deep. Areas are shared out as on the mesh refined by these points.
    """
    mesh = scene.mesh
    free = ~scene.held
    around = np.bincount(
        mesh.face_edges.ravel(), np.repeat(mesh.areas, 3), minlength=len(mesh.edges)
    )
    points = [
        (np.arange(len(mesh.rest))[:, None], mesh.vertex_areas, free),
        (mesh.edges, around, free[mesh.edges].any(axis=1)),
    ]
    return [
        ObstacleContact(vertices[moves], areas[moves] / 4, obstacle=obstacle, pressure=pressure)
        for vertices, areas, moves in points
    ]


def find_equilibrium(
    scene: Scene,
    fabric: Fabric,
    start: State,
    *,
    laws: Laws | None = None,
    extra: Sequence[Energy] = (),
    options: NewtonOptions | None = None,
) -> tuple[State, NewtonResult]:
    """Equilibrium of ``fabric`` in ``scene`` next to ``start``; see the result's status.

    ``laws`` and ``extra`` as for :func:`build_potential`.
    """
    potential = build_potential(scene, fabric, start, laws=laws, extra=extra)
    q = start.unknowns
    result = minimise(potential, potential.free_part(q), options)
    q = potential.full(result.y)
    vertices = len(scene.mesh.rest)
    return State(q[: 3 * vertices].reshape(-1, 3), q[3 * vertices :]), result
