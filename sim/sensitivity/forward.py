"""Forward sensitivities: how every vertex moves with every parameter."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim.drape import DrapeResult
from sim.energies.base import Energy
from sim.laws import Laws
from sim.material import Fabric
from sim.sensitivity.parameters import combinations
from sim.sensitivity.tangent import Tangent


@dataclass(frozen=True)
class Sensitivities:
    """Derivatives of an equilibrium by P parameters; NaN where there are none.

    Attributes:
        names: (P,) parameters, such as "log_alpha_warp".
        positions: (P, V, 3) m per unit of the parameter.
        rotations: (P, E) rad per unit.
        ok: whether the derivatives exist.
        message: why not, in a sentence.
        softest: see :class:`sim.sensitivity.tangent.Tangent`.
    """

    names: tuple[str, ...]
    positions: np.ndarray
    rotations: np.ndarray
    ok: bool
    message: str
    softest: float


def sensitivities(
    result: DrapeResult,
    *,
    laws: Laws | None = None,
    extra: Sequence[Energy] = (),
    parameters: Sequence[str] = ("log_alpha", "ratio"),
) -> Sensitivities:
    """Derivatives of a drape by parameters of its fabric, on the mesh it has.

    Args:
        laws: with which it was made.
        extra: more energies that it is in balance with.
        parameters: any of :data:`sim.sensitivity.parameters.PARAMETERS`, three each for warp,
            bias and weft, others constant:

            "log_alpha"  per unit of log alpha at fixed beta/alpha; with
            "ratio"      per m of beta/alpha, the derivatives by theta (:mod:`data.fabrics`);
            "alpha", "beta"  per N·m at fixed beta, per N·m² at fixed alpha;
            "density"    one, per kg/m² at fixed moduli and in-plane stiffness;
            "membrane"   one, per unit of the logarithm of the in-plane stiffness.

            Moduli and density are the fabric's own. A drape is simulated at the reference density
            with the membrane of ``laws``: the in-plane stiffness is that of cloth of that density.

    Raises:
        InputError: unknown parameter, or a law that has no derivative.
    """
    return tangent_sensitivities(
        Tangent.of(result, laws=laws, extra=extra), result.fabric, parameters)


def tangent_sensitivities(
    tangent: Tangent, fabric: Fabric, parameters: Sequence[str]
) -> Sensitivities:
    """Derivatives of the equilibrium of ``tangent``; arguments as for :func:`sensitivities`.

    ``fabric`` has the moduli and density that the derivatives refer to, those of the tangent but
    for a common factor.
    """
    names, rows = combinations(parameters, fabric)
    moves = np.full((len(names), len(tangent.q)), np.nan)
    if tangent.ok:
        for move, push in zip(moves, rows @ tangent.force_derivatives(), strict=True):
            move[:] = -tangent.response(push)
    positions, rotations = np.split(moves, [tangent.coordinates], axis=1)
    return Sensitivities(
        names=names,
        positions=positions.reshape(len(names), -1, 3),
        rotations=rotations,
        ok=tangent.ok,
        message=tangent.message,
        softest=tangent.softest,
    )
