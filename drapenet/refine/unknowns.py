"""Parameters of a specimen in a refinement, their prior, and derivatives of the drape by them.

The parameters are the moduli, the nuisances of a specimen (:mod:`data.fabrics.nuisances`), its
offset on the plate and, for a scan, the direction of its warp.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from common.types import Radians, RestPoints, Theta
from data.fabrics.fabrics import THETA_NAMES, fabric_from_theta
from data.fabrics.nuisances import LOGARITHMIC, NuisanceConfig, Nuisances
from data.fabrics.prior import GaussianPrior
from drapenet.refine.objective import Moves
from sim.cloth import Laws
from sim.energies.bending_variants import Hysteresis
from sim.material import MICRO, Fabric
from sim.mesh.specimen import share_of_offset
from sim.rig import Rig
from sim.sensitivity import Sensitivities, Tangent
from sim.sensitivity.forward import tangent_sensitivities
from sim.sensitivity.rest_shape import moves_with_offset, moves_with_rest
from sim.solver.potential import forces

LAW_NAMES = ("membrane", "shear", "curl_warp", "curl_weft")
"""Entries of :data:`data.fabrics.nuisances.NAMES` that the cloth's energies depend on."""
OFFSET_NAMES = ("offset_warp", "offset_weft")  # m, of the specimen from the plate's axis
NAMES = (*THETA_NAMES, *LAW_NAMES, *OFFSET_NAMES, "warp")
"""Theta, logarithms of membrane (N/m) and shear, curl, 1/m, offset, m, and direction of the warp in
the axes of the rest points, rad."""
SCALE = np.array([1.0] * 3 + [2e-3] * 3 + [1.0, 0.5, 3.0, 3.0, 4e-3, 4e-3, 0.3])
ALPHA_RANGE = (0.3 * MICRO, 300 * MICRO)  # N·m at 300 g/m²
RATIO_RANGE = (-10e-3, 2e-3)  # m; contains 99 % of the prior's fabrics
BOUNDS = np.array(
    [np.log(ALPHA_RANGE)] * 3 + [RATIO_RANGE] * 3
    + [(math.log(20.0), math.log(5000.0)), (math.log(0.1), math.log(0.99)),
       (-15.0, 15.0), (-15.0, 15.0), (-0.02, 0.02), (-0.02, 0.02), (-math.inf, math.inf)])
DRIFT = 4e-3  # m, standard deviation of the offset along warp and weft
_STEPS = {"membrane": 1e-3, "shear": 1e-3, "curl_warp": 0.1, "curl_weft": 0.1}


@dataclass(frozen=True)
class Unknowns:
    """A specimen, given by the (U,) values of :data:`NAMES`."""

    values: np.ndarray

    @classmethod
    def of(
        cls, theta: Theta, nuisances: Nuisances | None = None, *, warp: Radians = 0.0
    ) -> "Unknowns":
        """A specimen centred on its plate."""
        nuisances = nuisances or Nuisances()
        laws = [math.log(getattr(nuisances, name)) if name in LOGARITHMIC
                else getattr(nuisances, name) for name in LAW_NAMES]
        return cls(np.array([*theta, *laws, 0.0, 0.0, warp]))

    def __getitem__(self, name: str) -> float:
        return float(self.values[NAMES.index(name)])

    @property
    def theta(self) -> Theta:
        return self.values[:6]

    @property
    def fabric(self) -> Fabric:
        """The moduli, at 300 g/m²."""
        return fabric_from_theta(self.theta)

    @property
    def nuisances(self) -> Nuisances:
        return Nuisances(**{name: math.exp(self[name]) if name in LOGARITHMIC else self[name]
                            for name in LAW_NAMES})

    @property
    def laws(self) -> Laws:
        return self.nuisances.laws

    def with_theta(self, theta: Theta) -> "Unknowns":
        return Unknowns(np.concatenate([theta, self.values[6:]]))

    def rest(self, base: RestPoints, rig: Rig) -> RestPoints:
        """Rest points of a mesh that has ``base`` centred on the plate."""
        offset = np.array([self[name] for name in OFFSET_NAMES])
        if offset.any():
            base = base + share_of_offset(base, rig)[:, None] * offset
        return _turned(base, self["warp"]) if self["warp"] else base


def _turned(points: RestPoints, warp: Radians) -> RestPoints:
    c, s = math.cos(warp), math.sin(warp)
    return points @ np.array([[c, -s], [s, c]])


@dataclass(frozen=True)
class SpecimenPrior:
    """Normal prior of the unknowns."""

    mean: np.ndarray  # (U,)
    root: np.ndarray  # (U, U) whitens differences from it; zero rows without a prior

    @classmethod
    def of(cls, fabrics: GaussianPrior, spread: NuisanceConfig | None = None) -> "SpecimenPrior":
        """Prior of fabrics and of the specimens' nuisances; ``spread`` None: moduli only."""
        mean = Unknowns.of(fabrics.mean).values
        root = np.zeros((len(NAMES),) * 2)
        root[:6, :6] = np.linalg.inv(np.linalg.cholesky(fabrics.covariance))
        if spread is not None:
            laws = slice(6, 6 + len(LAW_NAMES))
            mean[laws], covariance = spread.normal(LAW_NAMES)
            root[laws, laws] = np.linalg.inv(np.linalg.cholesky(covariance))
            for name in OFFSET_NAMES:
                root[NAMES.index(name), NAMES.index(name)] = 1 / DRIFT
        return cls(mean, root)

    def residuals(self, unknowns: Unknowns) -> np.ndarray:
        """(U,) residuals of unit variance."""
        return self.root @ (unknowns.values - self.mean)


def drape_moves(
    tangent: Tangent, unknowns: Unknowns, rig: Rig, names: Iterable[str]
) -> tuple[Moves, Sensitivities]:
    """Derivatives of the vertices of a drape by the unknowns ``names``, and those by the moduli."""
    names = list(names)
    by_moduli = tangent_sensitivities(tangent, unknowns.fabric, ("log_alpha", "ratio"))
    moves = dict(zip(THETA_NAMES, by_moduli.positions, strict=True))
    moves |= law_moves(tangent, unknowns.nuisances, [name for name in LAW_NAMES if name in names])
    if set(OFFSET_NAMES) & set(names):
        # The offset is defined in the axes without the warp's turn.
        moves |= zip(OFFSET_NAMES, np.tensordot(_turned(np.eye(2), unknowns["warp"]),
                                                moves_with_offset(tangent, rig), 1), strict=True)
    if "warp" in names:
        # A turn of the warp rotates rest points backwards in the material axes.
        rest = tangent.cloth.scene.mesh.rest
        turning = np.column_stack([rest[:, 1], -rest[:, 0]])
        moves["warp"], = moves_with_rest(tangent, turning[None])
    return np.stack([moves[name] for name in names]), by_moduli


def law_moves(
    tangent: Tangent, nuisances: Nuisances, names: Iterable[str]
) -> dict[str, np.ndarray]:
    """(V, 3) derivatives of a drape by nuisances of its cloth's energies, or their logarithms.

    Forces are linear in the parameters, so that finite differences at one state are exact.
    """
    cloth, size = tangent.cloth, tangent.cloth.potential.unknowns
    mesh, active = cloth.scene.mesh, cloth.scene.active
    origin = getattr(cloth.bending, "origin", None)

    def forces_with(name: str, value: float) -> np.ndarray:
        laws = replace(nuisances, **{name: value}).laws
        if isinstance(laws.bending, Hysteresis):
            laws = replace(laws, bending=replace(laws.bending, origin=origin))
        energies = [laws.membrane.energy(mesh, active),
                    laws.bending_law(mesh, active, fabric=cloth.fabric)]
        return forces(energies, tangent.q, size)

    moves = {}
    for name in names:
        step, value = _STEPS[name], getattr(nuisances, name)
        # Not at a shear of exactly 1, which is another law.
        low, high = ((value * (1 - step), value * (1 + step)) if name in LOGARITHMIC
                     else (value, value + step))
        push = (forces_with(name, high) - forces_with(name, low)) / (high - low)
        push *= value if name in LOGARITHMIC else 1.0
        moves[name] = -tangent.response(push)[: tangent.coordinates].reshape(-1, 3)
    return moves
