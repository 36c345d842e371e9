"""Derivatives by the rest shape: forwards along given moves, backwards to every vertex.

Contact of the cloth with itself counts with areas of the rest shape, which decide how near two
sheets come under a force, not how large it is. This is left out, forwards and backwards.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from sim.batched.energies import batch_energies
from sim.batched.energies.base import ElementBatch
from sim.energies.base import Energy
from sim.energies.contact import ObstacleContact
from sim.energies.fold_limit import FoldLimit
from sim.energies.gravity import Gravity
from sim.energies.hinge_stencils import find_hinges
from sim.energies.membrane import CorotationalMembrane
from sim.energies.midedge import MidEdgeBending
from sim.energies.self_contact import SelfContact
from sim.equilibrium import cloth_terms
from sim.mesh import Mesh
from sim.scene import Rig, Scene, State
from sim.sensitivity.parameters import forces
from sim.sensitivity.tangent import Tangent

_STEP = 1e-5  # of the mean edge, in central differences


def moves_with_rest(tangent: Tangent, moves: np.ndarray) -> np.ndarray:
    """(K, V, 3) how the equilibrium moves while its rest points move by ``moves`` (K, V, 2).

    Held vertices stay in place. By central differences of the forces, for any laws.
    """
    scene = tangent.scene
    state = State(tangent.positions, tangent.q[tangent.coordinates:])
    edges = scene.mesh.rest[scene.mesh.edges]
    edge = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1).mean()

    def forces_at(rest: np.ndarray) -> np.ndarray:
        moved = replace(scene, mesh=Mesh(rest, scene.mesh.faces))
        terms = cloth_terms(moved, tangent.fabric, state, laws=tangent.laws)
        return forces([energy for stage in terms.stages for energy in stage], tangent.q)

    result = np.zeros((len(moves), *state.positions.shape))
    for k, move in enumerate(moves):
        step = _STEP * edge / np.abs(move).max()
        rest = scene.mesh.rest
        push = (forces_at(rest + step * move) - forces_at(rest - step * move)) / (2 * step)
        result[k] = -tangent.response(push)[: tangent.coordinates].reshape(-1, 3)
    return result


def moves_with_offset(tangent: Tangent, rig: Rig) -> np.ndarray:
    """(2, V, 3) how a drape moves with the offset of the specimen from the plate, m per m.

    The offset along warp and weft, as in :func:`sim.drape.drape`. Under the plate and next to it
    the mesh stays and the cloth slides through it; outwards the mesh follows the cloth more and
    more. Vertices thus move as the surface does, but not as points of the cloth.
    """
    radius = np.linalg.norm(tangent.scene.mesh.rest, axis=1)
    width = rig.specimen_size / 2 - rig.plate_radius
    share = np.clip((radius - rig.plate_radius) / width, 0.0, 1.0)
    share[tangent.scene.held] = 0.0
    return moves_with_rest(tangent, share[:, None] * np.eye(2)[:, None])


def pull_on_rest(tangent: Tangent, weights: np.ndarray) -> np.ndarray:
    """(V, 2) derivatives by the rest points of the energy's gradient times ``weights`` (Q,).

    Gradients are those of :mod:`sim.batched.energies`; their constants as functions of the rest
    points are written down here once more, for automatic differentiation. NaN where there is an
    energy without, that is, for other laws than the default.
    """
    if not all(type(energy) in _CONSTANTS for energy in _energies(tangent)):
        return np.full_like(tangent.scene.mesh.rest, np.nan)
    rest = torch.tensor(tangent.scene.mesh.rest, requires_grad=True)
    q = torch.from_numpy(tangent.q)[None]
    w = torch.from_numpy(np.append(weights, 0.0))  # the zero at the end for dofs of -1
    with torch.enable_grad():  # which is off where this is part of a backward pass
        total = sum(
            (twin.gradient(q)[0] * w[torch.from_numpy(energy.dofs)]).sum()
            for energy, twin in zip(_energies(tangent), energies_of(tangent, rest), strict=True)
        )
        return torch.autograd.grad(total, rest)[0].numpy()


def energies_of(tangent: Tangent, rest: Tensor) -> list[ElementBatch]:
    """The twins of the tangent's energies, in a batch of one, on the rest points (V, 2) m."""
    twins = batch_energies([_energies(tangent)])
    triangles = _Triangles(tangent.scene, rest)
    result = []
    for energy, twin in zip(_energies(tangent), twins, strict=True):
        constants = _CONSTANTS[type(energy)](triangles, energy)
        # Constants of one sample, the elements first; twins have the elements last.
        result.append(replace(twin, **{k: torch.movedim(v, 0, -1)[None]
                                       for k, v in constants.items()}))
    return result


def _energies(tangent: Tangent) -> list[Energy]:
    return [e for e in tangent.potential.energies if not isinstance(e, SelfContact)]


class _Triangles:
    """What a mesh's energies need, as functions of its rest points (V, 2)."""

    def __init__(self, scene: Scene, rest: Tensor) -> None:
        self.scene, self.rest = scene, rest
        self.faces = torch.from_numpy(scene.mesh.faces)
        self.active = torch.from_numpy(scene.active)
        corners = rest[self.faces]
        self.opposite = corners.roll(-2, 1) - corners.roll(-1, 1)  # edge opposite each corner
        self.areas = _area(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])

    def around(self, places: np.ndarray, count: int) -> Tensor:
        """(count,) areas of the triangles at each of the ``places`` (F, 3)."""
        total = self.areas.new_zeros(count)
        return total.index_add(0, torch.from_numpy(places).flatten(),
                               self.areas.repeat_interleave(3))


def _area(one: Tensor, other: Tensor) -> Tensor:
    return 0.5 * (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])


def _membrane(t: _Triangles, energy: CorotationalMembrane) -> dict[str, Tensor]:
    turned = torch.stack([-t.opposite[..., 1], t.opposite[..., 0]], dim=-1)
    shape = turned / (2 * t.areas[:, None, None])
    return {"areas": t.areas[t.active], "shape": shape[t.active]}


def _midedge(t: _Triangles, energy: MidEdgeBending) -> dict[str, Tensor]:
    # nᵢ nᵢᵀ 2/hᵢ with the normal n = (ey, -ex)/|e| and 2/h = |e|/A
    ex, ey = t.opposite.unbind(-1)
    scale = 1 / (torch.hypot(ex, ey) * t.areas[:, None])
    maps = torch.stack([ey * ey * scale, ex * ex * scale, -ex * ey * scale], dim=1)
    # Next to a clamp (sim.energies.clamp) a first row of triangles weighs more, a second row as
    # much less as leaves the sum of compliances unchanged.
    areas = t.areas[t.active]
    weight = torch.from_numpy(energy.areas / t.scene.mesh.areas[t.scene.active])
    first, second = weight > 1 + 1e-9, weight < 1 - 1e-9
    if second.any():
        ratio = areas[first].sum() / areas[second].sum()
        moved = (1 / weight[second][0] - 1) * ratio / ratio.detach()
        weight = torch.where(second, 1 / (1 + moved), weight)
    return {"maps": maps[t.active], "areas": weight * areas}


def _fold_limit(t: _Triangles, energy: FoldLimit) -> dict[str, Tensor]:
    corners = t.rest[torch.from_numpy(find_hinges(t.scene.mesh, t.scene.active).corners)]
    edge, one, other = (corners[:, k] - corners[:, 0] for k in (1, 2, 3))
    shape = (edge**2).sum(1) / (_area(edge, one).abs() + _area(edge, other).abs())
    return {"scale": _scaled(energy.scale, shape)}


def _gravity(t: _Triangles, energy: Gravity) -> dict[str, Tensor]:
    return {"weights": _scaled(energy.weights, t.around(t.scene.mesh.faces, len(t.rest)))}


def _contact(t: _Triangles, energy: ObstacleContact) -> dict[str, Tensor]:
    mesh, vertices = t.scene.mesh, energy.dofs[:, ::3] // 3
    if vertices.shape[1] == 1:
        areas = t.around(mesh.faces, len(mesh.rest))[torch.from_numpy(vertices[:, 0])]
    else:
        number = {tuple(edge): k for k, edge in enumerate(mesh.edges.tolist())}
        here = torch.tensor([number[tuple(edge)] for edge in vertices.tolist()])
        areas = t.around(mesh.face_edges, len(mesh.edges))[here]
    return {"scale": _scaled(energy.scale, areas)}


def _scaled(constant: np.ndarray, size: Tensor) -> Tensor:
    """``constant`` (N,), known to be proportional to ``size`` (N,), as a function of it."""
    return torch.from_numpy(constant) * size / size.detach()


_CONSTANTS: dict[type, Callable[..., dict[str, Tensor]]] = {
    CorotationalMembrane: _membrane,
    MidEdgeBending: _midedge,
    FoldLimit: _fold_limit,
    Gravity: _gravity,
    ObstacleContact: _contact,
}
