"""Forward sensitivities: derivatives of all vertices by the parameters of the cloth.

All parameters are combinations of eight (:data:`BASIC`): log alpha at fixed beta/alpha and
beta/alpha of the three directions, log density and log membrane stiffness, each with all others
fixed. They are invariant under a common scaling of moduli, stiffness and density, as in
:func:`sim.draping.drape`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from common.errors import InputError
from sim.cloth import Cloth, Laws
from sim.draping import Drape
from sim.energies.base import Energy
from sim.energies.bending_variants import Hysteresis
from sim.material import DIRECTIONS, Fabric
from sim.sensitivity.tangent import Tangent
from sim.solver.potential import forces
from sim.solver.state import State

PARAMETERS = ("log_alpha", "ratio", "alpha", "beta", "density", "membrane")
"""Names of (groups of) parameters: the first four are groups of warp, bias and weft."""
BASIC = 8
_DENSITY, _MEMBRANE = 6, 7
_LOG_STEP = 1e-5  # of log alpha
_RATIO_STEP = 1e-7  # m, of beta/alpha: about 1e-5 of the radii to which cloth bends


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Derivatives of an equilibrium by P parameters; NaN where they do not exist."""

    names: tuple[str, ...]  # such as "log_alpha_warp"
    moves: np.ndarray  # (P, 3 V + E) of all unknowns, m and rad per unit of the parameter
    vertices: int
    ok: bool  # this and the next two are those of the tangent
    message: str
    softest: float

    @property
    def positions(self) -> np.ndarray:
        """Derivatives (P, V, 3) of the positions, m per unit of the parameter."""
        return self.moves[:, : 3 * self.vertices].reshape(len(self.names), -1, 3)

    def prediction(
        self, near: Drape, fabric: Fabric, *, laws: Laws, extra: Sequence[Energy] = ()
    ) -> State:
        """Linear prediction from the drape ``near`` for another fabric, if the energy allows it and
        is lower there; else the state of ``near``. Needs "log_alpha" and "ratio"."""
        if not self.ok:
            return near.state
        cloth = Cloth(near.scene, fabric, laws=laws, extra=extra)
        old, new = near.cloth.fabric, cloth.fabric
        change = np.concatenate([np.log(new.alpha / old.alpha),
                                 new.beta / new.alpha - old.beta / old.alpha])
        rows = [self.names.index(f"{name}_{direction}")
                for name in ("log_alpha", "ratio") for direction in DIRECTIONS]
        potential, q = cloth.potential, near.state.q
        ahead = potential.moved(q, potential.free_unknowns(change @ self.moves[rows]))
        with np.errstate(all="ignore"):
            lower = potential.value(ahead) < potential.value(q)
        accepted = lower and potential.allows(q, ahead)
        return State.of(ahead, self.vertices) if accepted else near.state


def sensitivities(
    result: Drape, *, parameters: Sequence[str] = ("log_alpha", "ratio")
) -> Sensitivities:
    """Derivatives of a drape by parameters of its fabric (:data:`PARAMETERS`), on its mesh.

    Each with all others constant, the first four for warp, bias and weft: "log_alpha" per unit of
    log alpha at fixed beta/alpha and "ratio" per m of beta/alpha (together, by theta); "alpha" per
    N·m at fixed beta; "beta" per N·m² at fixed alpha; "density" per kg/m² at fixed moduli and
    in-plane stiffness; "membrane" per unit of the logarithm of the in-plane stiffness. The in-plane
    stiffness of laws is that of cloth of the reference density.
    """
    return tangent_sensitivities(Tangent.of(result), result.fabric, parameters)


def tangent_sensitivities(
    tangent: Tangent, fabric: Fabric, parameters: Sequence[str]
) -> Sensitivities:
    """Derivatives of the equilibrium of ``tangent``, at the moduli and density of ``fabric``, which
    equal those of the tangent up to a common factor."""
    names, rows = combinations(parameters, fabric)
    moves = np.full((len(names), tangent.cloth.potential.unknowns), np.nan)
    if tangent.ok:
        by_parameters = rows @ force_derivatives(tangent.cloth, tangent.q)
        moves = np.array([-tangent.response(force) for force in by_parameters])
    return Sensitivities(names, moves, len(tangent.cloth.scene.mesh.rest), tangent.ok,
                         tangent.message, tangent.softest)


def combinations(names: Sequence[str], fabric: Fabric) -> tuple[tuple[str, ...], np.ndarray]:
    """Labels (P,) of the parameters ``names`` of ``fabric``, and (P, BASIC) the derivatives of the
    basic parameters by each; InputError for an unknown name."""
    names = (names,) if isinstance(names, str) else names
    basic, alpha = np.eye(BASIC), fabric.alpha[:, None]
    log_alpha, ratio = basic[:3], basic[3:6]
    rows = {"log_alpha": log_alpha, "ratio": ratio,
            "alpha": (log_alpha - fabric.beta[:, None] / alpha * ratio) / alpha,
            "beta": ratio / alpha,
            "density": basic[[_DENSITY]] / fabric.density, "membrane": basic[[_MEMBRANE]]}
    for name in names:
        if name not in rows:
            raise InputError(f"unknown parameter '{name}'; choose from {', '.join(PARAMETERS)}")
    labels = [label for name in names for label in (
        [name] if len(rows[name]) == 1 else [f"{name}_{direction}" for direction in DIRECTIONS])]
    return tuple(labels), np.concatenate([np.empty((0, BASIC)), *(rows[name] for name in names)])


def force_derivatives(cloth: Cloth, q: np.ndarray) -> np.ndarray:
    """Derivatives (BASIC, U) of the energy's gradient at the state ``q`` by the basic parameters.

    The membrane's forces are proportional to its stiffness, external forces (weight, contact) to
    the density: their derivatives by the logarithms are the forces. The energies of ``laws.others``
    are proportional to the density, at the moduli over the density. Derivatives by the moduli are
    central differences of the forces (error below 1e-9); where the laws have a kink, such as at
    isotropic moduli, means of the one-sided derivatives.
    """
    scene, laws, size = cloth.scene, cloth.laws, cloth.potential.unknowns

    def made(fabric: Fabric) -> tuple[list[Energy], list[Energy]]:
        # Only if the law is the energy's own: other laws may use the fabric in another way.
        is_own = type(laws.bending_law) is Hysteresis or laws.bending_law is type(cloth.bending)
        if is_own and hasattr(cloth.bending, "with_fabric"):
            bending = cloth.bending.with_fabric(fabric)
        else:
            bending = laws.bending_law(scene.mesh, scene.active, fabric=fabric)
        others = [law(scene.mesh, scene.active, fabric=fabric) for law in laws.others]
        return [bending], others

    result = np.zeros((BASIC, size))
    result[_MEMBRANE] = forces([cloth.membrane], q, size)
    result[_DENSITY] = forces([*cloth.external, *cloth.others], q, size)
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
