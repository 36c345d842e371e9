"""Forward sensitivities: how every vertex moves with every parameter."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim.drape import DrapeResult
from sim.material import Fabric
from sim.sensitivity.parameters import combinations
from sim.sensitivity.tangent import Tangent


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Derivatives of an equilibrium by P parameters; NaN where there are none.

    Attributes:
        names: (P,) parameters, such as "log_alpha_warp".
        moves: (P, 3 V + E) of all unknowns, m and rad per unit of the parameter.
        vertices: V.
        ok: whether the derivatives exist.
        message: why not, in a sentence.
        softest: see :class:`sim.sensitivity.tangent.Tangent`.
    """

    names: tuple[str, ...]
    moves: np.ndarray
    vertices: int
    ok: bool
    message: str
    softest: float

    @property
    def positions(self) -> np.ndarray:
        """(P, V, 3) m per unit of the parameter."""
        return self.moves[:, : 3 * self.vertices].reshape(len(self.names), -1, 3)


def sensitivities(
    result: DrapeResult, *, parameters: Sequence[str] = ("log_alpha", "ratio")
) -> Sensitivities:
    """Derivatives of a drape by parameters of its fabric, on the mesh it has.

    Args:
        parameters: any of :data:`sim.sensitivity.parameters.PARAMETERS`, three each for warp,
            bias and weft, others constant:

            "log_alpha"  per unit of log alpha at fixed beta/alpha; with
            "ratio"      per m of beta/alpha, the derivatives by theta (:mod:`data.fabrics`);
            "alpha", "beta"  per N·m at fixed beta, per N·m² at fixed alpha;
            "density"    one, per kg/m² at fixed moduli and in-plane stiffness;
            "membrane"   one, per unit of the logarithm of the in-plane stiffness.

            Moduli and density are the fabric's own. A drape is simulated at the reference density
            with the membrane of its laws: the in-plane stiffness is that of cloth of that density.

    Raises:
        InputError: unknown parameter.
    """
    return tangent_sensitivities(Tangent.of(result), result.fabric, parameters)


def tangent_sensitivities(
    tangent: Tangent, fabric: Fabric, parameters: Sequence[str]
) -> Sensitivities:
    """Derivatives of the equilibrium of ``tangent``; arguments as for :func:`sensitivities`.

    ``fabric`` has the moduli and density that the derivatives refer to, those of the tangent but
    for a common factor.
    """
    names, rows = combinations(parameters, fabric)
    moves = np.full((len(names), tangent.cloth.potential.unknowns), np.nan)
    if tangent.ok:
        for move, push in zip(moves, rows @ tangent.force_derivatives(), strict=True):
            move[:] = -tangent.response(push)
    return Sensitivities(
        names=names,
        moves=moves,
        vertices=len(tangent.cloth.scene.mesh.rest),
        ok=tangent.ok,
        message=tangent.message,
        softest=tangent.softest,
    )
