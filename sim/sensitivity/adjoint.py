"""Equilibria as differentiable functions for PyTorch."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor
from torch.autograd.function import once_differentiable

from common.arguments import require, wrong
from sim.cloth import Law, Laws
from sim.draping import Drape, follow, light
from sim.energies.membrane import Corotational
from sim.material import REFERENCE_DENSITY, Fabric
from sim.sensitivity.forward import combinations, force_derivatives
from sim.sensitivity.tangent import Tangent
from sim.solver.newton import NewtonOptions

Values = Tensor | ArrayLike


@dataclass(frozen=True)
class Equilibria:
    """Equilibria of B cloths."""

    positions: list[Tensor]
    """(V, 3) m each, differentiable; for a failure the last positions, with NaN as derivatives."""
    results: list[Drape]
    ok: list[bool]  # whether each and its derivatives exist
    messages: list[str]  # reasons if not


def equilibria(
    starts: Sequence[Drape], *, alpha: Values, beta: Values, density: Values | None = None,
    membrane: Values | None = None,
    bending: str | Law | None = None, others: tuple[Law, ...] | None = None,
    options: NewtonOptions | None = None
) -> Equilibria:
    """Equilibria of cloths with other parameters near those of ``starts``, on the same meshes, with
    ``bending`` and ``others`` as in :class:`sim.cloth.Laws`; None: those of each start.

    The backward pass takes one solve per sample, with the factor that verified its minimum. A
    numerical failure affects only its sample.

    Args:
        alpha, beta: (B, 3) or (3,) for all, moduli warp, bias, weft, N·m and N·m².
        density: (B,) or one for all, kg/m²; None: that of each start.
        membrane: (B,) or one for all, N/m, in-plane stiffness of the cloth at this density. None:
            as in a drape, proportional to the density, also in the derivatives by the density.
    """
    require(starts=(starts, Sequence, "[near]"))
    for start in starts:
        require(start=(start, Drape))
    count = len(starts)
    if density is None:
        density = [start.fabric.density for start in starts]
    density = _tensor("density", density, count)
    if membrane is None:
        membrane = Corotational().stiffness / REFERENCE_DENSITY * density
    inputs = list(zip(_tensor("alpha", alpha, count, 3), _tensor("beta", beta, count, 3), density,
                      _tensor("membrane", membrane, count), strict=True))
    results = []
    for start, values in zip(starts, inputs, strict=True):
        alpha, beta, density, membrane = map(_array, values)
        fabric = Fabric(alpha, beta, float(density))
        stiffness = float(membrane) * REFERENCE_DENSITY / fabric.density
        used = Laws(start.laws.bending if bending is None else bending,
                    Corotational(stiffness=stiffness),
                    start.laws.others if others is None else others)
        results.append(follow(start, fabric, laws=used, options=options, keep=True))
    tangents = [Tangent.of(result) for result in results]
    return Equilibria(
        positions=[_Equilibrium.apply(tangent, result.fabric, *values)
                   for tangent, result, values in zip(tangents, results, inputs, strict=True)],
        results=[light(result) for result in results],
        ok=[tangent.ok for tangent in tangents],
        messages=[tangent.message for tangent in tangents],
    )


def _tensor(name: str, values: Values, *shape: int) -> Tensor:
    """``values`` of all cloths, or one for all; in float64 unless they are a tensor."""
    try:
        if not isinstance(values, Tensor):
            values = torch.from_numpy(np.array(values, dtype=np.float64))
        return values.expand(shape)
    except (TypeError, ValueError, RuntimeError):
        raise wrong(name, values, f"a tensor {shape}, of each cloth, or one for all") from None


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
            ctx.tangent, ctx.fabric, _array(upstream), membrane=float(inputs[3]))
        return None, None, *(
            torch.as_tensor(gradient, dtype=value.dtype, device=value.device) if need else None
            for gradient, value, need in zip(gradients, inputs, needed, strict=True)
        )


def adjoint_gradients(
    tangent: Tangent, fabric: Fabric, by_positions: np.ndarray, *, membrane: float
) -> tuple[np.ndarray, ...]:
    """Derivatives of a scalar by the parameters of the equilibrium, from those by its positions
    (V, 3), at ``fabric``'s moduli and density and an in-plane stiffness ``membrane``, N/m: by alpha
    (3,), beta (3,), density () and membrane (); NaN if the tangent is not ok."""
    if not tangent.ok:
        return tuple(np.full(shape, np.nan) for shape in ((3,), (3,), (), ()))
    by_unknowns = np.zeros(tangent.cloth.potential.unknowns)
    by_unknowns[: tangent.coordinates] = by_positions.ravel()
    weights = tangent.response(by_unknowns)
    _, rows = combinations(("alpha", "beta", "density", "membrane"), fabric)
    by_fabric = -rows @ (force_derivatives(tangent.cloth, tangent.q) @ weights)
    return by_fabric[:3], by_fabric[3:6], by_fabric[6], by_fabric[7] / membrane


def _array(values: Tensor) -> np.ndarray:
    return values.detach().cpu().double().numpy()
