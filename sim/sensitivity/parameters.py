"""What a fabric's equilibrium can be differentiated by, and how the forces depend on it.

All are combinations of eight (:data:`BASIC`): log alpha at fixed beta/alpha and beta/alpha of the
three directions, log density and log membrane stiffness, each with all others fixed. They do not
change when moduli, stiffness and density are scaled together, as :func:`sim.drape.drape` does.
"""

from collections.abc import Sequence

import numpy as np

from common.errors import InputError
from sim.cloth import Cloth
from sim.energies.base import Energy
from sim.material import DIRECTIONS, Fabric

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


def force_derivatives(cloth: Cloth, q: np.ndarray) -> np.ndarray:
    """(BASIC, U) derivatives of the energy's gradient at the state ``q``.

    The membrane's forces are proportional to its stiffness, all that are not the cloth's own
    (weight, contact) to the density: these derivatives are the forces themselves. The energies of
    ``laws.others`` are those of cloth of the reference density, so for cloth of another they are
    proportional to the density too, and made of the moduli over the density. By the moduli,
    central differences of the forces, without another equilibrium: the laws are smooth in
    them but for creases, such as the one at isotropic moduli, where this is the mean of both sides.
    The error is below 1e-9 of the bending forces.
    """
    scene, laws, size = cloth.scene, cloth.laws, cloth.potential.unknowns

    def made(fabric: Fabric) -> tuple[list[Energy], list[Energy]]:
        # Only where the law is the energy's class: others may make more of the fabric.
        if laws.bending_law is type(cloth.bending) and hasattr(cloth.bending, "with_fabric"):
            bending = cloth.bending.with_fabric(fabric)
        else:
            bending = laws.bending_law(scene.mesh, scene.active, fabric=fabric)
        others = [law(scene.mesh, scene.active, fabric=fabric) for law in laws.others]
        return [bending], others

    result = np.zeros((BASIC, size))
    result[_MEMBRANE] = forces([cloth.membrane], q, size)
    result[_DENSITY] = forces([*cloth.outer, *cloth.others], q, size)
    for row in range(6):
        step = _LOG_STEP if row < 3 else _RATIO_STEP
        ahead, behind = made(_changed(cloth.fabric, row, step)), made(
            _changed(cloth.fabric, row, -step))
        bending, others = ((forces(a, q, size) - forces(b, q, size)) / (2 * step)
                           for a, b in zip(ahead, behind, strict=True))
        result[row] = bending + others
        if row < 3:
            result[_DENSITY] -= others
    return result


def _changed(fabric: Fabric, row: int, step: float) -> Fabric:
    """``fabric`` with one of the basic parameters of its moduli increased by ``step``."""
    log_alpha, ratio = np.log(fabric.alpha), fabric.beta / fabric.alpha
    (log_alpha if row < 3 else ratio)[row % 3] += step
    alpha = np.exp(log_alpha)
    return Fabric(alpha, ratio * alpha, fabric.density)


def forces(energies: Sequence[Energy], q: np.ndarray, size: int) -> np.ndarray:
    """(U,) derivatives of a sum of energies by all unknowns, of which there are ``size``."""
    return sum((_gathered(energy, energy.gradient(q), size) for energy in energies),
               start=np.zeros(size))


def hessian_product(
    energies: Sequence[Energy], q: np.ndarray, move: np.ndarray, *, convex: bool = False
) -> np.ndarray:
    """(U,) change of :func:`forces` at ``q`` when the unknowns move by ``move`` (U,)."""
    total = np.zeros(len(move))
    for energy in energies:
        blocks = energy.hessian(q, convex)
        if blocks is not None:
            local = np.where(energy.dofs >= 0, move[energy.dofs], 0.0)
            total += _gathered(energy, np.einsum("nij,nj->ni", blocks, local), len(total))
    return total


def _gathered(energy: Energy, parts: np.ndarray, size: int) -> np.ndarray:
    """(size,) sums of what the elements of an energy have for their unknowns, parts (N, K)."""
    return np.bincount(energy.dofs.ravel() + 1, parts.ravel(), minlength=size + 1)[1:]
