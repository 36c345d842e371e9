"""The estimate of one fabric by network or refinement: samples of its properties, density."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from common.errors import InputError
from common.findings import Finding
from common.types import Density, Theta
from data.fabrics.fabrics import ClothProperties, fabric_from_theta, from_theta
from data.fabrics.nuisances import Nuisances
from data.readings import QUANTITIES
from sim.material import (
    DIRECTIONS,
    FIRST,
    REFERENCE_DENSITY,
    SECOND,
    STIFF_SOFT,
    SWAPPED,
    Fabric,
    is_admissible,
    torque,
)

if TYPE_CHECKING:
    from drapenet.network.checkpoint import Header
    from drapenet.network.predict import Draws
    from drapenet.views.observation import Observation

MAX_INADMISSIBLE_SHARE = 0.2  # of the network's samples


@dataclass(frozen=True, repr=False)
class Estimate:
    """Posterior of a fabric's moduli.

    Attributes:
        cloth: S samples.
        names: of the directions: warp, bias, weft or stiff, bias, soft.
        spread: (7,) standard deviations over fabrics of theta and of the logarithm of the ratio of
            the yarns' alphas.
        warnings: of the samples alone.
        contradictions: a finding for each source that contradicts others.
        captures: those that it is from, as the network reads them; None: not at hand.
    """

    cloth: ClothProperties
    names: tuple[str, str, str]
    density: Density
    spread: np.ndarray
    warnings: tuple[Finding, ...] = ()
    contradictions: tuple[Finding, ...] = ()
    captures: "tuple[Observation, ...] | None" = None

    def __repr__(self) -> str:
        return (f"Estimate({', '.join(self.names)}: {self.fabric}, {len(self.samples)} samples, "
                f"{len(self.warnings)} warnings)")

    @property
    def samples(self) -> Theta:
        """(S, 6) samples of the moduli."""
        return self.cloth.theta

    @property
    def theta(self) -> Theta:
        """The fabric in the middle of the samples."""
        return central(self.samples, self.spread[:6])

    @property
    def fabric(self) -> Fabric:
        """The fabric of :attr:`theta` at its density, with the first yarns as warp."""
        return fabric_from_theta(self.theta).at_density(self.density)

    @property
    def nuisances(self) -> Nuisances:
        """Medians of the other properties, with the marked face up."""
        curl = np.median(self.cloth.curl, axis=0)
        return Nuisances(membrane=float(np.median(self.cloth.membrane)), curl_warp=curl[0],
                         curl_weft=curl[1], hysteresis=float(np.median(self.cloth.hysteresis)))

    @property
    def modulus_names(self) -> list[str]:
        """Names of theta's entries."""
        return [f"{what} {name}" for what in ("alpha", "beta/alpha") for name in self.names]

    @property
    def constraint(self) -> dict[str, float]:
        """Standard deviations of theta's entries, and of the logarithm of the ratio of the yarns'
        alphas, divided by their spreads over fabrics."""
        names = [*self.modulus_names, f"alpha {self.names[FIRST]}/{self.names[SECOND]}"]
        ratio = self.samples[:, FIRST] - self.samples[:, SECOND]
        share = np.column_stack([self.samples, ratio]).std(axis=0) / self.spread
        return dict(zip(names, share.tolist(), strict=True))

    def moduli(self, density: Density | None = None) -> tuple[np.ndarray, np.ndarray]:
        """alpha (S, 3) N·m and beta (S, 3) N·m² at this ``density``, kg/m², or at the fabric's."""
        alpha, beta = from_theta(self.samples)
        scale = (self.density if density is None else density) / REFERENCE_DENSITY
        return alpha * scale, beta * scale

    def reading(self, quantity: str) -> np.ndarray:
        """(S, 3) samples along the directions, or (S, 1), of what a tester would measure, by its
        key in :data:`data.readings.QUANTITIES`, such as ``bending_length_mm`` and
        ``kes_b_gf_cm2_per_cm``, in the unit that the key names; of cloth bent beyond the
        law, that of its straight line. InputError for an unknown key."""
        if quantity not in QUANTITIES:
            raise InputError(f"no tester reads {quantity}; choose from {', '.join(QUANTITIES)}")
        return QUANTITIES[quantity].of(self.cloth, self.density)

    def torques(self, direction: int, curvature: np.ndarray) -> np.ndarray:
        """(S, C) torque per width, N, of each sample at ``curvature`` (C,), 1/m."""
        return torque(curvature, *(part[:, direction, None] for part in self.moduli()))


def interval(samples: np.ndarray, level: float = 0.68) -> np.ndarray:
    """(2, ...) ends of the interval that contains the middle share ``level`` of samples (S, ...),
    of those that are not NaN."""
    if not 0 < level < 1:
        raise InputError(f"level={level:g}: give a share, such as 0.9 for 90 %")
    return np.nanquantile(samples, [0.5 - level / 2, 0.5 + level / 2], axis=0)


def central(samples: Theta, spread: Theta) -> Theta:
    """Medians of samples; if these are not admissible, the sample nearest to them, in units of the
    ``spread``."""
    middle = np.median(samples, axis=0)
    if is_admissible(*from_theta(middle)):
        return middle
    away = (samples - middle) / spread
    return samples[np.square(away).sum(axis=1).argmin()]


def make_estimate(draws: "Draws", *, density: Density, header: "Header") -> Estimate:
    """Make an estimate of posterior samples: warp, bias and weft, or, where the direction of the
    warp is not known, the stiffer yarns first.
    """
    names = DIRECTIONS if draws.known else STIFF_SOFT
    estimate = Estimate(draws.cloth, names, density,
                        np.append(header.spread, header.fabrics.ratio))
    warnings = _extrapolations(estimate, header)
    if draws.impossible > MAX_INADMISSIBLE_SHARE:
        warnings.append(Finding("samples_impossible", {"value": float(draws.impossible),
                                                       "limit": MAX_INADMISSIBLE_SHARE}))
    return replace(estimate, warnings=tuple(warnings))


def _extrapolations(estimate: Estimate, header: "Header") -> list[Finding]:
    """A finding for each modulus outside the fabrics trained on, in either order of the yarns."""
    edges = np.array([header.fabrics.low, header.fabrics.high])
    low, high = np.stack([edges, edges[:, SWAPPED]], axis=1)
    outside = (estimate.theta < low.min(axis=0)) | (estimate.theta > high.max(axis=0))
    return [Finding("modulus_extrapolated", {"modulus": name})
            for name, out in zip(estimate.modulus_names, outside, strict=True) if out]
