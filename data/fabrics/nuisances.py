"""Nuisance parameters: properties of cloth and specimens, beside the moduli, that affect the drape.

Datasets draw them at random and the network learns the resulting uncertainty; ``configs/nuisances``
states their distributions with reasons.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from common.configs import Key, Share, limits, pair, si, up_to
from common.errors import InputError
from sim.material import KES_CURVATURE, MEMBRANE_STIFFNESS, MICRO, REFERENCE_DENSITY, gravity_length
from sim.rig import Rig

if TYPE_CHECKING:
    from sim.cloth import Laws

_Pair = tuple[float, float]
_PERCENTILE = 1.96  # deviations of a normal distribution to its 97.5th percentile
ISOTROPIC = 2.6  # Young's modulus over shear modulus of an isotropic sheet of Poisson's ratio 0.3
_SAMPLES = 4000
_SKEW = -0.8, 0.8
CURLED = 20e-3
"""Gravity length, m, of cloth of 24 µN·m, for which natural curvatures are stated."""
KINDS = ("woven", "knit", "coated")
"""Kinds of cloth; the last are also films."""


@dataclass(frozen=True)
class Nuisances:
    """Nuisance parameters of one specimen.

    Attributes:
        kind: number of the kind of cloth among :data:`KINDS`.
        membrane: geometric mean of the stiffness along warp and weft, N/m.
        stretch: logarithm of the ratio of the two.
        shear: shear stiffness, relative to that of an isotropic membrane of this stiffness.
        hysteresis: see :class:`sim.energies.bending_variants.Hysteresis`, also for skew.
        curl_warp, curl_weft, curl_twist: natural curvature as the specimen lies, 1/m.
        uneven, uneven_length, pattern: random natural curvature, 1/m, its correlation length, m,
            and its seed (:mod:`sim.energies.uneven`, also for the following five).
        hem_curl, hem_layers: curvature of the hem, 1/m, and width of a doubled one, m.
        crease, crease_across: curvatures of two crossing creases, 1/m.
        crease_azimuth, crease_distance: of the first, rad and m.
        size, plate: deviations of both of the specimen's sides, and of the plate's diameter, m.
        cut: angle from the warp to the specimen's first side, rad.
    """

    kind: float = 0.0
    membrane: float = MEMBRANE_STIFFNESS
    stretch: float = 0.0
    shear: float = 1.0
    hysteresis: float = 0.0
    skew: float = 0.0
    curl_warp: float = 0.0
    curl_weft: float = 0.0
    curl_twist: float = 0.0
    uneven: float = 0.0
    uneven_length: float = 0.04
    pattern: float = 0.0
    hem_curl: float = 0.0
    hem_layers: float = 0.0
    crease: float = 0.0
    crease_across: float = 0.0
    crease_azimuth: float = 0.0
    crease_distance: float = 0.0
    size: float = 0.0
    plate: float = 0.0
    cut: float = 0.0

    @property
    def vector(self) -> np.ndarray:
        """Values (N,) in the order of :data:`NAMES`."""
        return np.array([getattr(self, name) for name in NAMES])

    @property
    def laws(self) -> "Laws":
        """The cloth's energies; the defaults of :class:`sim.cloth.Laws` where they are equivalent.
        """
        from sim.cloth import Laws  # compiled
        from sim.energies.bending_variants import Hysteresis
        from sim.energies.membrane import Corotational, Membrane, OrthotropicStVK
        from sim.energies.uneven import Crease, HemWeight, Uneven

        isotropic = Corotational(self.membrane)
        membrane: Membrane = isotropic
        if self.shear != 1.0 or self.stretch:
            ratio = math.exp(self.stretch)
            membrane = OrthotropicStVK(
                warp=self.membrane * ratio**0.5, weft=self.membrane / ratio**0.5,
                poisson=isotropic.poisson * min(ratio, 1.0), shear=self.shear * isotropic.mu)
        creases = (Crease(self.crease, self.crease_azimuth, self.crease_distance),
                   Crease(self.crease_across, self.crease_azimuth + np.pi / 2))
        uneven = Uneven(self.uneven, self.uneven_length, int(self.pattern), self.hem_curl,
                        self.hem_layers, tuple(one for one in creases if one.curvature))
        varied = self.uneven or self.hem_curl or self.hem_layers or uneven.creases
        curvature = (self.curl_warp, self.curl_weft, self.curl_twist)
        others = (HemWeight(self.hem_layers),) if self.hem_layers else ()
        if self.hysteresis or self.skew or any(curvature) or varied:
            return Laws(Hysteresis(self.hysteresis, curvature=curvature, skew=self.skew,
                                   uneven=uneven if varied else None), membrane, others)
        return Laws(membrane=membrane)

    def turned(self, face: int) -> "Nuisances":
        """Those of the specimen turned over about its warp if ``face`` is -1; 1: unchanged."""
        return replace(self, **{name: face * getattr(self, name) for name in TURNED})

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
TURNED = ("curl_warp", "curl_weft", "skew", "hem_curl", "crease", "crease_across")
"""Parameters with another sign when the specimen is turned over."""


def at_density(values: Mapping[str, float], old: float, new: float) -> dict[str, float]:
    """Values by :data:`NAMES` at the density ``old``, kg/m², as those at ``new`` of equal drape."""
    return {name: value * new / old if name in PROPORTIONAL else value
            for name, value in values.items()}


def hysteresis_share(ratio: np.ndarray | float) -> np.ndarray | float:
    """Share of the loading torque at KES's curvature of readings HB/B, 1/m, of any shape."""
    return ratio / (KES_CURVATURE + ratio)


@dataclass(frozen=True)
class Kind:
    """Distributions for one kind of cloth, in SI units.

    Attributes:
        share: of the fabrics, before their stiffness is known.
        alpha: mean alpha at 300 g/m² of such cloth, 2.5th and 97.5th percentile of a log-normal
            distribution, as the next two.
        membrane: geometric mean of the stiffness along warp and weft, at 300 g/m².
        shear: shear stiffness, at most that of an isotropic sheet.
        together: exponent of alpha to which the medians of both are proportional.
        stretch: mean and standard deviation of the logarithm of warp over weft.
        elastic: share of the fabrics with one yarn ten times less stiff.
        skew: standard deviation.
        curl, curl_both, curl_opposed, twist: scales of Laplace distributions of natural curvature:
            along each yarn, of both alike, of both with opposite signs, and of twist; as the next,
            of cloth whose gravity length is :data:`CURLED`, and inversely proportional to it.
        uneven: deviation of the random natural curvature, log-normal.
        hem_curl: share of the specimens with a curled hem, and the deviation of its curvature over
            that of a hem of 1 1/m.
    """

    share: Annotated[float, Key("", Share)] = 1.0
    alpha: Annotated[_Pair, Key("un", limits(1e-6, 1e6))] = (1 * MICRO, 100 * MICRO)
    membrane: Annotated[_Pair, Key("n_per_m", limits(1e-3, 1e9))] = (MEMBRANE_STIFFNESS,) * 2
    shear: Annotated[_Pair, Key("n_per_m", limits(1e-3, 1e9))] = (MEMBRANE_STIFFNESS,) * 2
    stretch: Annotated[_Pair, Key("", pair(float))] = (0.0, 0.0)
    together: Annotated[float, Key("", up_to(1))] = 0.0
    elastic: Annotated[float, Key("", Share)] = 0.0
    skew: Annotated[float, Key("", up_to(0.5))] = 0.0
    curl: Annotated[float, Key("per_m", up_to(1e3))] = 0.0
    curl_both: Annotated[float, Key("per_m", up_to(1e3))] = 0.0
    curl_opposed: Annotated[float, Key("per_m", up_to(1e3))] = 0.0
    twist: Annotated[float, Key("per_m", up_to(1e3))] = 0.0
    uneven: Annotated[_Pair, Key("per_m", limits(0, 1e3))] = (0.0, 0.0)
    hem_curl: Annotated[_Pair, Key("", pair(up_to(1e3)))] = (0.0, 0.0)


@dataclass(frozen=True)
class NuisanceConfig:
    """Distributions of the nuisance parameters, as in ``configs/nuisances``, in SI units.

    Attributes:
        cloth: by names of :data:`KINDS`.
        hysteresis: limits of a log-uniform distribution of KES's HB/B; both 0: none.
        uneven_length: of the random natural curvature, log-normal, as of a :class:`Kind`.
        curl_specimen, size, plate, cut: standard deviations between specimens.
        creased: share of the specimens with creases, and the deviation of their curvature, 1/m.
        doubled: share of the specimens with a doubled hem, and its largest width, m.
    """

    cloth: dict[str, Kind] = field(default_factory=lambda: {KINDS[0]: Kind()})
    hysteresis: Annotated[_Pair, Key("per_m", limits(0, KES_CURVATURE))] = (0.0, 0.0)
    uneven_length: Annotated[_Pair, Key("mm", limits(5, 500))] = (0.04, 0.04)
    curl_specimen: Annotated[float, Key("per_m", up_to(1e3))] = 0.0
    creased: Annotated[_Pair, Key("", pair(up_to(1e3)))] = (0.0, 0.0)
    doubled: Annotated[_Pair, Key("", pair(up_to(1)))] = (0.0, 0.0)
    size: Annotated[float, Key("mm", up_to(5))] = 0.0
    plate: Annotated[float, Key("mm", up_to(5))] = 0.0
    cut: Annotated[float, Key("deg", up_to(10))] = 0.0

    def __post_init__(self) -> None:
        least, most = self.hysteresis
        if not least and most:
            raise InputError(f"nuisances.hysteresis={list(self.hysteresis)}: give two numbers "
                             "above 0, or twice 0")
        if unknown := set(self.cloth) - set(KINDS):
            raise InputError(f"nuisances.cloth has {', '.join(sorted(unknown))}; give some of "
                             f"{', '.join(KINDS)}")
        if not sum(kind.share for kind in self.cloth.values()):
            raise InputError("nuisances.cloth: give at least one kind a share above 0")

    @classmethod
    def of_options(cls, settings: Mapping[str, Any]) -> "NuisanceConfig":
        """The distributions that a file in ``configs/nuisances`` states, as a mapping."""
        cloth = {name: Kind(**si(kind)) for name, kind in settings["cloth"].items()}
        return cls(**(si(settings) | {"cloth": cloth}))

    @classmethod
    def of_json(cls, settings: Mapping[str, Any]) -> "NuisanceConfig":
        """The distributions with these fields, lists in place of tuples, kinds as mappings."""
        def exact(values: Mapping[str, Any]) -> dict[str, Any]:
            return {name: tuple(value) if isinstance(value, list) else value
                    for name, value in values.items()}

        cloth = {name: Kind(**exact(kind)) for name, kind in settings["cloth"].items()}
        return cls(**(exact(settings) | {"cloth": cloth}))

    def sample(
        self, cloth: np.random.Generator, specimen: np.random.Generator, *,
        alpha: float | None = None, face: int = 1
    ) -> Nuisances:
        """Draw the parameters of a cloth and of a specimen; ``face``: 1, or -1 if turned over.
        ``alpha``: geometric mean of its alphas at 300 g/m², N·m; None: any."""
        name = self._kind(cloth, alpha)
        kind = self.cloth[name]
        normal, drawn = cloth.standard_normal(5), cloth.random(2)
        elastic = math.log(10) * np.sign(drawn[0] - kind.elastic / 2) if (
            drawn[0] < kind.elastic) else 0.0
        laplace, usual = cloth.laplace(size=6), math.sqrt(math.prod(kind.alpha))
        alpha = alpha or usual
        # Layers that differ in strain by a share bend by that over the thickness, about as alpha^⅓.
        bent = CURLED / gravity_length(alpha, REFERENCE_DENSITY)
        both, opposed = kind.curl_both * laplace[2], kind.curl_opposed * laplace[3]
        curls = bent * (kind.curl * laplace[:2] + [both + opposed, both - opposed])
        stiffer = (alpha / usual) ** kind.together
        membrane = stiffer * _log_normal(kind.membrane, normal[0]) * math.exp(-abs(elastic) / 2)
        shear = stiffer * _log_normal(kind.shear, normal[1]) * ISOTROPIC / membrane
        uneven = bent * _log_normal(kind.uneven, normal[2])
        length = _log_normal(self.uneven_length, normal[3])
        here, share = specimen.standard_normal(9), specimen.random(6)
        curls += self.curl_specimen * here[:2]
        creases = self.creased[1] * here[5:7] * (share[0] < self.creased[0])
        if share[1] < 0.5:  # a single one
            creases[1] = 0.0
        hem = kind.hem_curl[1] * here[7] * (share[2] < kind.hem_curl[0])
        ratio = self.hysteresis[0] * (self.hysteresis[1] / self.hysteresis[0]) ** drawn[1] if any(
            self.hysteresis) else 0.0
        found = Nuisances(
            kind=KINDS.index(name), membrane=membrane, shear=min(shear, 1.0),
            stretch=kind.stretch[0] + kind.stretch[1] * normal[4] + elastic,
            hysteresis=float(hysteresis_share(ratio)),
            skew=float(np.clip(kind.skew * laplace[4] / math.sqrt(2), *_SKEW)),
            curl_warp=curls[0], curl_weft=curls[1],
            curl_twist=bent * kind.twist * laplace[5],
            uneven=uneven, uneven_length=length,
            pattern=float(specimen.integers(2**31)) if uneven else 0.0,
            hem_curl=hem, crease=creases[0], crease_across=creases[1],
            crease_azimuth=math.pi * share[3], crease_distance=0.02 * here[8],
            hem_layers=self.doubled[1] * (0.4 + 0.6 * share[5]) * (share[4] < self.doubled[0]),
            size=self.size * here[2], plate=self.plate * here[3], cut=self.cut * here[4])
        return found.turned(face)

    def _kind(self, rng: np.random.Generator, alpha: float | None) -> str:
        """A kind of cloth, of those that are as stiff as ``alpha``."""
        odds = np.array([kind.share * (1.0 if alpha is None else _density(kind.alpha, alpha))
                         for kind in self.cloth.values()])
        below = np.cumsum(odds / odds.sum())
        return list(self.cloth)[min(int(np.searchsorted(below, rng.random())), len(odds) - 1)]

    def normal(self, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Mean (K,) and covariance (K, K) of some of the :data:`NAMES`; of the logarithms for
        :data:`LOGARITHMIC`."""
        rng = np.random.default_rng(0)
        values = np.array([self.sample(rng, rng).vector for _ in range(_SAMPLES)])
        drawn = {name: np.log(column) if name in LOGARITHMIC else column
                 for name, column in zip(NAMES, values.T, strict=True)}
        chosen = np.array([drawn[name] for name in names])
        return chosen.mean(axis=1), np.cov(chosen)


def _log_normal(ends: _Pair, normal: float) -> float:
    """The value at a ``normal`` deviate of the distribution with 95 % between these ``ends``."""
    if not ends[0]:
        return 0.0
    return float(ends[0] * (ends[1] / ends[0]) ** (0.5 + normal / (2 * _PERCENTILE)))


def _density(ends: _Pair, value: float) -> float:
    """Density of the logarithm of the same distribution."""
    deviation = math.log(ends[1] / ends[0]) / (2 * _PERCENTILE)
    off = (math.log(value) - math.log(math.prod(ends)) / 2) / deviation
    return math.exp(-(off**2) / 2) / deviation
