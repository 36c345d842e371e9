"""Equilibria as differentiable functions for PyTorch."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy import sparse
from torch import Tensor
from torch.autograd.function import once_differentiable

from common.errors import InputError
from sim.drape import DrapeResult
from sim.laws import Law, Laws
from sim.material import REFERENCE_DENSITY, Fabric
from sim.membranes import Corotational
from sim.newton import NewtonOptions
from sim.scene import Scene
from sim.sensitivity.follow import follow
from sim.sensitivity.forward import combinations, force_derivatives
from sim.sensitivity.rest_shape import rest_gradient
from sim.sensitivity.tangent import Tangent


@dataclass(frozen=True)
class Equilibria:
    """Equilibria of B cloths.

    Attributes:
        positions: (V, 3) m each, differentiable; for a failure the last positions, with NaN as
            derivatives.
        results, ok, messages: the drapes, whether each and its derivatives exist, reasons if not.
    """

    positions: list[Tensor]
    results: list[DrapeResult]
    ok: list[bool]
    messages: list[str]


def equilibria(
    starts: Sequence[DrapeResult], *, alpha: Tensor, beta: Tensor,
    density: Tensor | float = REFERENCE_DENSITY, membrane: Tensor | float | None = None,
    held: Sequence[Tensor] | None = None, rest: Sequence[Tensor] | None = None,
    bending: str | Law = "midedge", others: tuple[Law, ...] = (),
    options: NewtonOptions | None = None
) -> Equilibria:
    """Equilibria of cloths with other parameters near those of ``starts``, on the same meshes.

    The backward pass takes one solve per sample, with the factor that verified its minimum, for
    derivatives by all tensor arguments. A numerical failure affects only its sample.

    Args:
        starts: B drapes, of any meshes and rigs.
        alpha, beta: (B, 3) moduli warp, bias, weft, N·m and N·m².
        density: (B,) or one for all, kg/m².
        membrane: (B,) or one for all, N/m, in-plane stiffness of the cloth at this density (that of
            :mod:`sim.laws` is of cloth of the reference density). None: as in a drape, proportional
            to the density, also in the derivatives by the density.
        held: positions (H, 3), m, of the held vertices, in their order; None for those of
            ``starts``.
        rest: rest points (V, 2), m; None for those of ``starts``. Positions of held vertices do not
            depend on their rest points.
        bending, others: bending law and laws of further energies, as in :class:`sim.laws.Laws`,
            the ``others`` for cloth of the reference density. Derivatives by ``rest`` are NaN
            unless "midedge" is the only law.
        options: stopping criteria of the minimisations.

    InputError for inconsistent shapes or invalid values.
    """
    count = len(starts)
    density = torch.as_tensor(density, dtype=torch.float64)
    if membrane is None:
        membrane = Corotational().stiffness / REFERENCE_DENSITY * density
    density, membrane = (torch.as_tensor(v, dtype=torch.float64).expand(count)
                         for v in (density, membrane))
    if held is None:
        held = [torch.from_numpy(start.positions[start.held]) for start in starts]
    rest = [torch.from_numpy(start.rest) for start in starts] if rest is None else rest
    given = {"alpha": alpha, "beta": beta, "density": density, "membrane": membrane, "held": held,
             "rest": rest}
    for name, values in given.items():
        if len(values) != count:
            raise InputError(f"{name} has {len(values)} entries for {count} cloths")
    inputs = list(zip(*given.values(), strict=True))
    laws = Laws(bending=bending, others=others)
    tasks = [_task(start, laws, *map(_array, values))
             for start, values in zip(starts, inputs, strict=True)]
    results = [follow(start, fabric, laws=laws, options=options, keep=True)
               for start, fabric, laws in tasks]
    tangents = [Tangent.of(result) for result in results]
    return Equilibria(
        positions=[_Equilibrium.apply(tangent, result.fabric, *values)
                   for tangent, result, values in zip(tangents, results, inputs, strict=True)],
        results=[replace(result, equilibrium=None) for result in results],
        ok=[tangent.ok for tangent in tangents],
        messages=[tangent.message for tangent in tangents],
    )


def _task(
    start: DrapeResult, laws: Laws, alpha: np.ndarray, beta: np.ndarray, density: np.ndarray,
    membrane: np.ndarray, held: np.ndarray, rest: np.ndarray
) -> tuple[DrapeResult, Fabric, Laws]:
    """Start, fabric and laws of one sample; its membrane replaces that of ``laws``."""
    if held.shape != (int(start.held.sum()), 3) or rest.shape != start.rest.shape:
        raise InputError(f"held {held.shape} and rest {rest.shape} do not fit a mesh of "
                         f"{len(start.rest)} vertices, {int(start.held.sum())} of them held")
    fabric = Fabric(alpha, beta, float(density))
    stiffness = float(membrane) * REFERENCE_DENSITY / fabric.density
    if not np.array_equal(rest, start.rest):
        start = replace(start, mesh=start.mesh.with_rest(rest))
        if not (smallest := start.mesh.areas.min()) > 0:
            raise InputError(f"rest: a triangle has the area {1e6 * smallest:.3g} mm²; move its "
                             "corners less, so that all areas stay above 0")
    if not np.array_equal(held, start.positions[start.held]):
        positions = start.positions.copy()
        positions[start.held] = held
        start = start.at(positions)
    return start, fabric, replace(laws, membrane=Corotational(stiffness=stiffness))


class _Equilibrium(torch.autograd.Function):
    """Positions (V, 3) of a known equilibrium as a differentiable function of its parameters."""

    @staticmethod
    def forward(ctx, tangent: Tangent, fabric: Fabric, *inputs: Tensor) -> Tensor:
        ctx.tangent, ctx.fabric = tangent, fabric
        ctx.save_for_backward(*inputs)
        return torch.from_numpy(tangent.positions.copy()).to(inputs[0])

    @staticmethod
    @once_differentiable
    def backward(ctx, upstream: Tensor) -> tuple[Tensor | None, ...]:
        inputs = ctx.saved_tensors
        needed = ctx.needs_input_grad[2:]
        gradients = adjoint_gradients(
            ctx.tangent, ctx.fabric, _array(upstream), membrane=float(inputs[3]),
            by_held=needed[4], by_rest=needed[5])
        return None, None, *(
            torch.as_tensor(gradient, dtype=value.dtype, device=value.device) if need else None
            for gradient, value, need in zip(gradients, inputs, needed, strict=True)
        )


def adjoint_gradients(
    tangent: Tangent, fabric: Fabric, by_positions: np.ndarray, *, membrane: float,
    by_held: bool = True, by_rest: bool = True
) -> tuple[np.ndarray | None, ...]:
    """Derivatives of a scalar by the parameters of the equilibrium, from those by its positions
    (V, 3), at ``fabric``'s moduli and density and an in-plane stiffness ``membrane``, N/m.

    Returns:
        Derivatives by alpha (3,), beta (3,), density (), membrane (), held positions (H, 3) and
        rest points (V, 2); NaN if the tangent is not ok.
    """
    scene = tangent.cloth.scene
    if not tangent.ok:
        held, rest = (int(scene.held.sum()), 3), scene.mesh.rest.shape
        return tuple(np.full(shape, np.nan) for shape in ((3,), (3,), (), (), held, rest))
    by_unknowns = np.zeros(tangent.cloth.potential.unknowns)
    by_unknowns[: tangent.coordinates] = by_positions.ravel()
    weights = tangent.response(by_unknowns)
    _, rows = combinations(("alpha", "beta", "density", "membrane"), fabric)
    by_fabric = -rows @ (force_derivatives(tangent.cloth, tangent.q) @ weights)
    held = rest = None
    if by_held:
        forces = tangent.force_of(weights)
        coordinates, turns = np.split(forces, [tangent.coordinates])
        coordinates += clamp_levers(scene, tangent.positions).T @ turns
        held = (by_positions - coordinates.reshape(-1, 3))[scene.held]
    if by_rest:
        rest = -rest_gradient(tangent, weights)
    return by_fabric[:3], by_fabric[3:6], by_fabric[6], by_fabric[7] / membrane, held, rest


def clamp_levers(scene: Scene, positions: np.ndarray) -> sparse.csr_matrix:
    """Derivatives (E, 3 V), rad/m, of the rotations of held triangles' edge normals by the corners:
    the opposite corner's move along the normal, less that of the height's foot, over the height."""
    mesh = scene.mesh
    face, side = np.nonzero(scene.held_edges[mesh.face_edges] & ~scene.active[:, None])
    start, end, corner = (mesh.faces[face, (side + k) % 3] for k in (1, 2, 0))
    edge, arm = positions[end] - positions[start], positions[corner] - positions[start]
    normal = np.cross(edge, arm)
    squared = (edge**2).sum(1)
    lever = (np.sqrt(squared) / (normal**2).sum(1))[:, None] * normal
    # Rotations are about mesh.edges. An edge of two held triangles, which has no effect on free
    # ones, gets the sum of both.
    lever *= np.where(start < end, 1.0, -1.0)[:, None]
    foot = ((arm * edge).sum(1) / squared)[:, None]
    rows = np.repeat(mesh.face_edges[face, side], 9)
    columns = 3 * np.stack([corner, end, start], axis=1)[:, :, None] + np.arange(3)
    values = np.stack([lever, -foot * lever, (foot - 1) * lever], axis=1)
    shape = (len(mesh.edges), positions.size)
    return sparse.csr_matrix((values.ravel(), (rows, columns.ravel())), shape=shape)


def _array(values: Tensor) -> np.ndarray:
    return values.detach().cpu().double().numpy()
