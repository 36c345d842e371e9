"""Nuisance parameters: properties of specimens and rig, beside the moduli, that affect the drape.

They are unknown for a captured specimen, so datasets draw them at random and the network learns the
resulting uncertainty. ``configs/nuisances`` states their distributions with reasons.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from common.errors import InputError
from sim.energies.bending_friction import BendingFriction
from sim.energies.natural_curvature import NaturallyCurved
from sim.laws import Laws
from sim.membranes import Corotational, OrthotropicStVK
from sim.scene import Rig

_PERCENTILE = 1.96  # deviations of a normal distribution to its 97.5th percentile


@dataclass(frozen=True)
class Nuisances:
    """Nuisance parameters of one specimen.

    Attributes:
        membrane: stiffness along the yarns, N/m.
        shear: shear stiffness, relative to that of an isotropic membrane of this stiffness.
        friction: frictional bending torque between the yarns, N·m per metre.
        curl_warp, curl_weft: natural curvature, 1/m.
        size, plate: deviations of the specimen's size and of the plate's diameter, m.
        cut: angle from the warp to the specimen's side, rad.
    """

    membrane: float = Corotational().stiffness
    shear: float = 1.0
    friction: float = 0.0
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
    def laws(self) -> Laws:
        """The cloth's energies; the defaults of :class:`sim.laws.Laws` where they are equivalent.
        """
        membrane = isotropic = Corotational(self.membrane)
        if self.shear != 1.0:
            membrane = OrthotropicStVK(warp=self.membrane, weft=self.membrane,
                                       poisson=isotropic.poisson, shear=self.shear * isotropic.mu)
        curvature = (self.curl_warp, self.curl_weft, 0.0)
        if self.friction:
            return Laws(BendingFriction(self.friction, curvature=curvature), membrane)
        return Laws(NaturallyCurved(curvature) if any(curvature) else Laws().bending, membrane)

    def rig(self, nominal: Rig) -> Rig:
        """The ``nominal`` rig with the deviations in size, plate and cut of this specimen."""
        return replace(nominal, specimen_size=nominal.specimen_size + self.size,
                       plate_diameter=nominal.plate_diameter + self.plate,
                       cut=0.0 if nominal.specimen == "disc" else self.cut)


NAMES = tuple(field.name for field in fields(Nuisances))
"""Components of :attr:`Nuisances.vector`."""
LOGARITHMIC = ("membrane", "shear")
"""Parameters of which the logarithm is distributed and differentiated."""
PROPORTIONAL = ("membrane", "friction")
"""Parameters that, like the moduli, are proportional to the density at equal drape."""


def at_density(values: Mapping[str, float], old: float, new: float) -> dict[str, float]:
    """Convert ``values`` by :data:`NAMES`, SI, of a fabric of density ``old``, kg/m², to those of
    the fabric of density ``new`` with the same drape."""
    return {name: value * new / old if name in PROPORTIONAL else value
            for name, value in values.items()}


@dataclass(frozen=True)
class NuisanceConfig:
    """Distributions of the nuisance parameters.

    Attributes:
        membrane: 2.5th and 97.5th percentile of a log-normal distribution, N/m.
        shear: limits of a log-uniform distribution.
        friction: upper limit of a uniform distribution from 0, N·m per metre.
        curl: standard deviation along warp and weft each, 1/m.
        size, plate: standard deviations, m. cut: standard deviation, rad.

    Raises:
        InputError: limits or standard deviations out of range.
    """

    membrane: tuple[float, float] = (Corotational().stiffness,) * 2
    shear: tuple[float, float] = (1.0, 1.0)
    friction: float = 0.0
    curl: float = 0.0
    size: float = 0.0
    plate: float = 0.0
    cut: float = 0.0

    def __post_init__(self) -> None:
        for name in ("membrane", "shear"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
            limits = getattr(self, name)
            if len(limits) != 2 or not 0 < limits[0] <= limits[1] < math.inf:
                raise InputError(f"nuisances.{name}: give two numbers above 0, the smaller one "
                                 "first")
        for name in ("friction", "curl", "size", "plate", "cut"):
            if not 0 <= getattr(self, name) < math.inf:
                raise InputError(f"nuisances: {name}={getattr(self, name):g} must not be negative")
        if not (max(self.size, self.plate) <= 0.005 and self.cut <= math.radians(10)):
            raise InputError(f"nuisances: size_mm={1e3 * self.size:g} plate_mm="
                             f"{1e3 * self.plate:g} cut_deg={math.degrees(self.cut):g}: at most 5, "
                             "5 and 10 are allowed")

    def sample(self, cloth: np.random.Generator, specimen: np.random.Generator) -> Nuisances:
        """Draw the parameters of a cloth and of one specimen, each from a separate generator."""
        def between(limits: tuple[float, float], share: float) -> float:
            return float(limits[0] * (limits[1] / limits[0]) ** share)

        normal = specimen.standard_normal(5)
        return Nuisances(
            membrane=between(self.membrane, 0.5 + cloth.standard_normal() / (2 * _PERCENTILE)),
            shear=between(self.shear, cloth.random()),
            friction=self.friction * cloth.random(),
            curl_warp=self.curl * normal[0], curl_weft=self.curl * normal[1],
            size=self.size * normal[2], plate=self.plate * normal[3], cut=self.cut * normal[4],
        )

    @property
    def means(self) -> dict[str, float]:
        """Means by :data:`NAMES`; of the logarithms for :data:`LOGARITHMIC`."""
        middle = {"membrane": math.log(math.prod(self.membrane)) / 2,
                  "shear": math.log(math.prod(self.shear)) / 2, "friction": self.friction / 2}
        return dict.fromkeys(NAMES, 0.0) | middle

    @property
    def deviations(self) -> dict[str, float]:
        """Standard deviations, likewise, also of the uniform distributions."""
        (softest, stiffest), (least, most) = self.membrane, self.shear
        return {"membrane": math.log(stiffest / softest) / (2 * _PERCENTILE),
                "shear": math.log(most / least) / math.sqrt(12),
                "friction": self.friction / math.sqrt(12),
                "curl_warp": self.curl, "curl_weft": self.curl,
                "size": self.size, "plate": self.plate, "cut": self.cut}
