"""What a fabric's equilibrium can be differentiated by, and how the forces depend on it.

All are combinations of eight (:data:`BASIC`): log alpha at fixed beta/alpha and beta/alpha of the
three directions, log density and log membrane stiffness, each with all others fixed. They do not
change when moduli, stiffness and density are scaled together, as :func:`sim.drape.drape` does.
"""

from collections.abc import Sequence

import numpy as np

from common.errors import InputError
from sim.energies.base import Energy
from sim.laws import Law, Laws
from sim.material import DIRECTIONS, Fabric
from sim.potential import Potential
from sim.scene import Scene

PARAMETERS = ("log_alpha", "ratio", "alpha", "beta", "density", "membrane")
"""Names of (groups of) parameters: the first four stand for warp, bias and weft."""
BASIC = 8
_DENSITY, _MEMBRANE = 6, 7
_LOG_STEP = 1e-5  # of log alpha
_RATIO_STEP = 1e-7  # m, of beta/alpha: some 1e-5 of the radii to which cloth bends


def combinations(names: Sequence[str], fabric: Fabric) -> tuple[tuple[str, ...], np.ndarray]:
    """Labels (P,) of the parameters ``names`` of ``fabric``, and (P, BASIC) what they are made of.

    A row holds the derivatives of the basic parameters by the parameter.

    Raises:
        InputError: unknown name.
    """
    labels, rows = [], []
    basic = np.eye(BASIC)
    ratio = fabric.beta / fabric.alpha
    for name in names:
        if name in ("density", "membrane"):
            labels.append(name)
            rows.append(basic[_DENSITY] / fabric.density if name == "density"
                        else basic[_MEMBRANE])
            continue
        if name not in PARAMETERS:
            raise InputError(f"unknown parameter '{name}'; choose from {', '.join(PARAMETERS)}")
        for k, direction in enumerate(DIRECTIONS):
            labels.append(f"{name}_{direction}")
            rows.append({
                "log_alpha": basic[k],
                "ratio": basic[3 + k],
                "alpha": (basic[k] - ratio[k] * basic[3 + k]) / fabric.alpha[k],
                "beta": basic[3 + k] / fabric.alpha[k],
            }[name])
    return tuple(labels), np.array(rows).reshape(-1, BASIC)


def force_derivatives(
    potential: Potential, scene: Scene, fabric: Fabric, laws: Laws, q: np.ndarray
) -> np.ndarray:
    """(BASIC, Q) derivatives of the energy's gradient at the unknowns ``q`` (Q,).

    The membrane's forces are proportional to its stiffness, all that are not the cloth's own
    (weight, contact) to the density: these derivatives are the forces themselves. The energies of
    ``laws.others`` are those of cloth of the reference density, so for cloth of another they are
    proportional to the density too, and made of the moduli over the density. By the moduli,
    central differences of the forces, without another equilibrium: the laws are smooth in
    them but for creases, such as the one at isotropic moduli, where this is the mean of both sides.
    The error is below 1e-9 of the bending forces.

    Args:
        potential: of the cloth's energies and others, in the order of
            :func:`sim.equilibrium.cloth_terms`; ``fabric`` and ``laws`` those it was made of.
    """
    membrane, bending, fold_limit = own = potential.energies[:3]
    others = list(zip(laws.others, potential.energies[3:], strict=False))

    def made(law: Law, energy: Energy, fabric: Fabric) -> Energy:
        # Only where the law is the energy's class: others may make more of the fabric.
        if law is type(energy) and hasattr(energy, "with_fabric"):
            return energy.with_fabric(fabric)
        return law(scene.mesh, scene.active, fabric=fabric)

    def by_moduli(pairs: Sequence[tuple[Law, Energy]], row: int, step: float) -> np.ndarray:
        ahead, behind = (
            forces([made(law, energy, _changed(fabric, row, s)) for law, energy in pairs], q)
            for s in (step, -step)
        )
        return (ahead - behind) / (2 * step)

    result = np.zeros((BASIC, len(q)))
    result[_MEMBRANE] = forces([membrane], q)
    result[_DENSITY] = forces(potential.energies, q) - forces(own, q)
    for k in range(3):
        for row, step in ((k, _LOG_STEP), (3 + k, _RATIO_STEP)):
            result[row] = by_moduli([(laws.bending_law, bending), *others], row, step)
    if laws.others:
        result[_DENSITY] -= sum(by_moduli(others, k, _LOG_STEP) for k in range(3))
    result[fabric.alpha.argmin()] += forces([fold_limit], q)  # its stiffness is that alpha
    return result


def _changed(fabric: Fabric, row: int, step: float) -> Fabric:
    """``fabric`` with one of the basic parameters of its moduli increased by ``step``."""
    log_alpha, ratio = np.log(fabric.alpha), fabric.beta / fabric.alpha
    (log_alpha if row < 3 else ratio)[row % 3] += step
    alpha = np.exp(log_alpha)
    return Fabric(alpha, ratio * alpha, fabric.density)


def forces(energies: Sequence[Energy], q: np.ndarray) -> np.ndarray:
    """(Q,) derivatives of a sum of energies by all unknowns."""
    return sum(gathered(energy, energy.gradient(q), len(q)) for energy in energies)


def hessian_product(
    energies: Sequence[Energy], q: np.ndarray, move: np.ndarray, *, convexity: float = 0.0
) -> np.ndarray:
    """(Q,) change of :func:`forces` at ``q`` when the unknowns move by ``move`` (Q,).

    By the energies' own blocks, which know of no frames; ``convexity`` as for
    :meth:`sim.energies.base.Energy.hessian`.
    """
    total = np.zeros_like(q)
    for energy in energies:
        blocks = energy.hessian(q, convexity)
        if blocks is not None:
            local = np.where(energy.dofs >= 0, move[energy.dofs], 0.0)
            total += gathered(energy, np.einsum("nij,nj->ni", blocks, local), len(total))
    return total


def gathered(energy: Energy, parts: np.ndarray, size: int) -> np.ndarray:
    """(size,) sums of what the elements of an energy have for their unknowns, parts (N, K)."""
    return np.bincount(energy.dofs.ravel() + 1, parts.ravel(), minlength=size + 1)[1:]
