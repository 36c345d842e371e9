"""Parameters of a specimen in a refinement, their prior, and derivatives of the drape by them.

The parameters are the moduli, the nuisances of a specimen (:mod:`data.fabrics.nuisances`), its
offset on the plate and, for a scan, the direction of its warp.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from data.fabrics.fabrics import THETA_NAMES, fabric_from_theta
from data.fabrics.nuisances import LOGARITHMIC, NuisanceConfig, Nuisances
from data.fabrics.prior import GaussianPrior
from sim.cloth import Laws
from sim.energies.plate_variants import Hysteresis
from sim.material import MICRO, Fabric
from sim.mesh.specimen import share_of_offset
from sim.rig import Rig
from sim.sensitivity import Sensitivities, Tangent
from sim.sensitivity.forward import tangent_sensitivities
from sim.sensitivity.rest_shape import moves_with_offset, moves_with_rest
from sim.solver.potential import forces

LAWS = ("membrane", "shear", "curl_warp", "curl_weft")
"""Entries of :data:`data.fabrics.nuisances.NAMES` that the cloth's energies depend on."""
OFFSET = ("offset_warp", "offset_weft")
"""m, of the specimen's centre from the plate's axis."""
UNKNOWNS = (*THETA_NAMES, *LAWS, *OFFSET, "warp")
"""All parameters: theta, logarithm of membrane (N/m) and shear, curl, 1/m, offset, m,
and direction of the warp in the axes of the rest points, rad."""
SCALE = np.array([1.0] * 3 + [2e-3] * 3 + [1.0, 0.5, 3.0, 3.0, 4e-3, 4e-3, 0.3])
"""(U,) unit of each parameter."""
ALPHA_RANGE = (0.3 * MICRO, 300 * MICRO)  # N·m at 300 g/m²
RATIO_RANGE = (-10e-3, 2e-3)  # m; contains 99 % of the prior's fabrics
BOUNDS = np.array(
    [np.log(ALPHA_RANGE)] * 3 + [RATIO_RANGE] * 3
    + [(math.log(20.0), math.log(5000.0)), (math.log(0.1), math.log(0.99)),
       (-15.0, 15.0), (-15.0, 15.0), (-0.02, 0.02), (-0.02, 0.02), (-math.inf, math.inf)])
"""(U, 2) limits of each."""
DRIFT = 4e-3  # m, standard deviation of the offset along warp and weft
_STEPS = {"membrane": 1e-3, "shear": 1e-3, "hysteresis": 1e-3, "curl_warp": 0.1, "curl_weft": 0.1}


@dataclass(frozen=True)
class Cloth:
    """A specimen, given by the (U,) values of :data:`UNKNOWNS`."""

    values: np.ndarray

    @classmethod
    def of(
        cls, theta: np.ndarray, nuisances: Nuisances | None = None, *, warp: float = 0.0
    ) -> "Cloth":
        """A specimen of theta (6,), centred on its plate."""
        known = nuisances or Nuisances()
        laws = [math.log(getattr(known, name)) if name in LOGARITHMIC else getattr(known, name)
                for name in LAWS]
        return cls(np.array([*theta, *laws, 0.0, 0.0, warp]))

    def __getitem__(self, name: str) -> float:
        return float(self.values[UNKNOWNS.index(name)])

    @property
    def theta(self) -> np.ndarray:
        """(6,), see :mod:`data.fabrics.fabrics`."""
        return self.values[:6]

    @property
    def fabric(self) -> Fabric:
        """The moduli, at 300 g/m²."""
        return fabric_from_theta(self.theta)

    @property
    def nuisances(self) -> Nuisances:
        """The nuisances of its energies."""
        return Nuisances(**{name: math.exp(self[name]) if name in LOGARITHMIC else self[name]
                            for name in LAWS})

    @property
    def laws(self) -> Laws:
        """The laws of its energies."""
        return self.nuisances.laws

    def with_theta(self, theta: np.ndarray) -> "Cloth":
        """The same specimen of another fabric."""
        return Cloth(np.concatenate([theta, self.values[6:]]))

    def rest(self, base: np.ndarray, rig: Rig) -> np.ndarray:
        """Rest points (V, 2), m, of a mesh that has ``base`` (V, 2) centred on the plate."""
        offset = np.array([self[name] for name in OFFSET])
        moved = base
        if offset.any():
            moved = base + share_of_offset(base, rig)[:, None] * offset
        return _turned(moved, self["warp"]) if self["warp"] else moved


def _turned(points: np.ndarray, warp: float) -> np.ndarray:
    """Points (V, 2) in the axes of a warp at the angle ``warp``, rad."""
    c, s = math.cos(warp), math.sin(warp)
    return points @ np.array([[c, -s], [s, c]])


@dataclass(frozen=True)
class Knowledge:
    """Normal prior of a specimen.

    Attributes:
        mean: (U,) of :data:`UNKNOWNS`.
        root: (U, U) whitening matrix of differences from the mean; zero rows without a prior.
    """

    mean: np.ndarray
    root: np.ndarray

    @classmethod
    def of(cls, prior: GaussianPrior, spread: NuisanceConfig | None = None) -> "Knowledge":
        """Prior of fabrics and of the specimens' nuisances; ``spread`` None: moduli only."""
        mean, root = Cloth.of(prior.mean).values, np.zeros((len(UNKNOWNS),) * 2)
        root[:6, :6] = np.linalg.inv(np.linalg.cholesky(prior.covariance))
        if spread is not None:
            for name in (*LAWS, *OFFSET):
                k = UNKNOWNS.index(name)
                mean[k] = spread.means.get(name, 0.0)
                root[k, k] = 1 / spread.deviations.get(name, DRIFT)
        return cls(mean, root)

    def residuals(self, cloth: Cloth) -> np.ndarray:
        """(U,) residuals of unit variance."""
        return self.root @ (cloth.values - self.mean)


def cloth_moves(
    tangent: Tangent, cloth: Cloth, rig: Rig, names: Iterable[str]
) -> tuple[np.ndarray, Sensitivities]:
    """(n, V, 3) derivatives of the vertices by the unknowns ``names``, and those by the moduli.

    Args:
        tangent: with derivatives, of a drape of ``cloth`` on ``rig``.
    """
    parameters = ("log_alpha", "ratio")
    by_moduli = tangent_sensitivities(tangent, cloth.fabric, parameters)
    moves = dict(zip(THETA_NAMES, by_moduli.positions, strict=True))
    wanted = list(names)
    moves |= law_moves(tangent, cloth.nuisances, [name for name in LAWS if name in wanted])
    if set(OFFSET) & set(wanted):
        # The offset is defined in the axes without the warp's turn.
        moves |= zip(OFFSET, np.tensordot(_turned(np.eye(2), cloth["warp"]),
                                          moves_with_offset(tangent, rig), 1), strict=True)
    if "warp" in wanted:
        # A turn of the warp rotates rest points backwards in the material axes.
        rest = tangent.cloth.scene.mesh.rest
        turning = np.column_stack([rest[:, 1], -rest[:, 0]])
        moves["warp"], = moves_with_rest(tangent, turning[None])
    return np.stack([moves[name] for name in wanted]), by_moduli


def law_moves(
    tangent: Tangent, nuisances: Nuisances, names: Iterable[str] = LAWS
) -> dict[str, np.ndarray]:
    """(V, 3) derivatives of a drape by nuisances of its cloth's energies, by name.

    Per unit of log membrane, log shear and hysteresis, 1/m of curl. Forces are linear in the
    parameters, so that finite differences at one state are exact; by the hysteresis, at the
    curvatures without friction of this drape, they are nearly so.
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
