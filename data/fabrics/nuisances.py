"""Nuisance parameters: properties of specimens and rig, beside the moduli, that affect the drape.

Datasets draw them at random and the network learns the resulting uncertainty; ``configs/nuisances``
states their distributions with reasons.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np

from common.configs import Key, limits, up_to
from common.errors import InputError
from sim.material import KES_CURVATURE, MEMBRANE_STIFFNESS
from sim.rig import Rig

if TYPE_CHECKING:
    from sim.cloth import Laws

_Pair = tuple[float, float]
_PERCENTILE = 1.96  # deviations of a normal distribution to its 97.5th percentile


@dataclass(frozen=True)
class Nuisances:
    """Nuisance parameters of one specimen.

    Attributes:
        membrane: stiffness along the yarns, N/m.
        shear: shear stiffness, relative to that of an isotropic membrane of this stiffness.
        hysteresis: see :class:`sim.energies.bending_variants.Hysteresis`.
        curl_warp, curl_weft: natural curvature as the specimen lies, 1/m.
        size, plate: deviations of both of the specimen's sides, and of the plate's diameter, m.
        cut: angle from the warp to the specimen's first side, rad.
    """

    membrane: float = MEMBRANE_STIFFNESS
    shear: float = 1.0
    hysteresis: float = 0.0
    curl_warp: float = 0.0
    curl_weft: float = 0.0
    size: float = 0.0
    plate: float = 0.0
    cut: float = 0.0

    @property
    def vector(self) -> np.ndarray:
        """Values (8,) in the order of :data:`NAMES`."""
        return np.array([getattr(self, name) for name in NAMES])

    @property
    def laws(self) -> "Laws":
        """The cloth's energies; the defaults of :class:`sim.cloth.Laws` where they are equivalent.
        """
        from sim.cloth import Laws  # compiled
        from sim.energies.bending_variants import Hysteresis
        from sim.energies.membrane import Corotational, Membrane, OrthotropicStVK

        isotropic = Corotational(self.membrane)
        membrane: Membrane = isotropic
        if self.shear != 1.0:
            membrane = OrthotropicStVK(warp=self.membrane, weft=self.membrane,
                                       poisson=isotropic.poisson, shear=self.shear * isotropic.mu)
        curvature = (self.curl_warp, self.curl_weft, 0.0)
        if self.hysteresis or any(curvature):
            return Laws(Hysteresis(self.hysteresis, curvature=curvature), membrane)
        return Laws(membrane=membrane)

    def turned(self, face: int) -> "Nuisances":
        """Those of the specimen turned over if ``face`` is -1; 1: unchanged."""
        return replace(self, curl_warp=face * self.curl_warp, curl_weft=face * self.curl_weft)

    def rig(self, nominal: Rig) -> Rig:
        """The ``nominal`` rig with the deviations in size, plate and cut of this specimen."""
        first, second = nominal.sides
        return replace(nominal, sides=(first + self.size, second + self.size),
                       plate_diameter=nominal.plate_diameter + self.plate,
                       cut=0.0 if nominal.specimen == "disc" else self.cut)


NAMES = tuple(field.name for field in fields(Nuisances))
"""Components of :attr:`Nuisances.vector`."""
LOGARITHMIC = ("membrane", "shear")
"""Parameters of which the logarithm is distributed and differentiated."""
PROPORTIONAL = ("membrane",)
"""Parameters that, like the moduli, are proportional to the density at equal drape."""


def at_density(values: Mapping[str, float], old: float, new: float) -> dict[str, float]:
    """Values by :data:`NAMES` at the density ``old``, kg/m², as those at ``new`` of equal drape."""
    return {name: value * new / old if name in PROPORTIONAL else value
            for name, value in values.items()}


def hysteresis_share(ratio: np.ndarray | float) -> np.ndarray | float:
    """Share of the loading torque at KES's curvature of readings HB/B, 1/m, of any shape."""
    return ratio / (KES_CURVATURE + ratio)


@dataclass(frozen=True)
class NuisanceConfig:
    """Distributions of the nuisance parameters, as in ``configs/nuisances``, in SI units.

    Attributes:
        membrane: 2.5th and 97.5th percentile of a log-normal distribution.
        shear, hysteresis: limits of log-uniform distributions, of KES's HB/B; both 0: none.
        curl: scale of the Laplace distribution of the fabric's curvature along warp and weft each.
        curl_specimen, size, plate, cut: standard deviations between specimens.
    """

    membrane: Annotated[_Pair, Key("n_per_m", limits(1e-3, 1e9))] = (MEMBRANE_STIFFNESS,) * 2
    shear: Annotated[_Pair, Key("", limits(1e-6, 1e6))] = (1.0, 1.0)
    hysteresis: Annotated[_Pair, Key("per_m", limits(0, KES_CURVATURE))] = (0.0, 0.0)
    curl: Annotated[float, Key("per_m", up_to(1e3))] = 0.0
    curl_specimen: Annotated[float, Key("per_m", up_to(1e3))] = 0.0
    size: Annotated[float, Key("mm", up_to(5))] = 0.0
    plate: Annotated[float, Key("mm", up_to(5))] = 0.0
    cut: Annotated[float, Key("deg", up_to(10))] = 0.0

    def __post_init__(self) -> None:
        least, most = self.hysteresis
        if not least and most:
            raise InputError(f"nuisances.hysteresis={list(self.hysteresis)}: give two numbers "
                             "above 0, or twice 0")

    def sample(
        self, cloth: np.random.Generator, specimen: np.random.Generator, *, face: int = 1
    ) -> Nuisances:
        """Draw the parameters of a cloth and of a specimen; ``face``: 1, or -1 if turned over."""
        def between(limits: tuple[float, float], share: float) -> float:
            return float(limits[0] * (limits[1] / limits[0]) ** share)

        membrane, shear, ratio = cloth.standard_normal(), cloth.random(), cloth.random()
        curls = self.curl * cloth.laplace(size=2)
        normal = specimen.standard_normal(5)
        curls = face * (curls + self.curl_specimen * normal[:2])
        return Nuisances(
            membrane=between(self.membrane, 0.5 + membrane / (2 * _PERCENTILE)),
            shear=between(self.shear, shear),
            hysteresis=float(hysteresis_share(
                between(self.hysteresis, ratio) if any(self.hysteresis) else 0.0)),
            curl_warp=curls[0], curl_weft=curls[1],
            size=self.size * normal[2], plate=self.plate * normal[3], cut=self.cut * normal[4],
        )

    @property
    def means(self) -> dict[str, float]:
        """Means by :data:`NAMES`; of the logarithms for :data:`LOGARITHMIC`."""
        middle = {"membrane": math.log(math.prod(self.membrane)) / 2,
                  "shear": math.log(math.prod(self.shear)) / 2,
                  "hysteresis": float(self._shares.mean())}
        return dict.fromkeys(NAMES, 0.0) | middle

    @property
    def deviations(self) -> dict[str, float]:
        """Standard deviations, likewise, also of the uniform and the Laplace distributions."""
        (softest, stiffest), (least, most) = self.membrane, self.shear
        curl = math.hypot(math.sqrt(2) * self.curl, self.curl_specimen)
        return {"membrane": math.log(stiffest / softest) / (2 * _PERCENTILE),
                "shear": math.log(most / least) / math.sqrt(12),
                "hysteresis": float(self._shares.std()),
                "curl_warp": curl, "curl_weft": curl,
                "size": self.size, "plate": self.plate, "cut": self.cut}

    @property
    def _shares(self) -> np.ndarray:
        """Equally probable shares of hysteresis."""
        if not any(self.hysteresis):
            return np.zeros(1)
        return np.asarray(hysteresis_share(np.geomspace(*self.hysteresis, 201)))
