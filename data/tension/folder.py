"""A folder of strips of one fabric that were stretched by weights."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from common.types import Density
from data.captures.description import Labels
from data.readings.known import Known
from data.readings.quantity import STANDARD_GRAVITY
from data.tension.description import StretchedStrip, TensionDescription, read_description
from data.tension.posterior import (
    KES_SHEAR,
    LOAD_ERROR,
    MeasuredExtension,
    TensionEvidence,
    tension_evidence,
)
from sim.material import BIAS, DIRECTIONS

AIM = 0.1
"""Extension at which a strip tells most: well above the errors of reading, and within the law."""


@dataclass(frozen=True)
class TensionSet:
    """The strips of one fabric.

    Attributes:
        shear: stiffness by KES-FB1, N/m, if it is stated.
        known: other values of the fabric.
    """

    kind: ClassVar[Literal["tension"]] = "tension"
    path: Path
    density: Density
    strips: tuple[MeasuredExtension, ...]
    shear: float | None
    known: Known | None
    labels: Labels

    @property
    def directions(self) -> list[str]:
        """Those of the strips."""
        return list(dict.fromkeys(DIRECTIONS[strip.direction] for strip in self.strips))

    @property
    def along_yarns(self) -> bool:
        """Whether warp and weft must be told apart."""
        return any(strip.direction != BIAS for strip in self.strips)

    def evidence(self) -> TensionEvidence:
        """What the strips say, at the density of the fabric."""
        return tension_evidence(self.strips, self.density, self.shear)

    def loads(self, found: TensionEvidence) -> dict[str, float]:
        """For each direction the weight, g, that stretches its first strip by :data:`AIM`."""
        warp, weft, shear = np.exp(found.posterior.mean)
        return {DIRECTIONS[strip.direction]: float(1e3 * strip.width / STANDARD_GRAVITY * (
            found.friction[strip.direction]
            + strip.needed((warp, weft, shear), found.poisson, AIM)))
            for strip in reversed(self.strips)}


def read_tension(folder: str | Path) -> TensionSet:
    """Read ``tension.yaml``; InputError for the first fault."""
    folder = Path(folder)
    description = read_description(folder)
    shear = description.kes_g_gf_per_cm_deg
    return TensionSet(
        folder, description.density,
        tuple(_measured(strip, description) for strip in description.tension),
        KES_SHEAR * shear if shear else None, description.known, description.labels)


def _measured(strip: StretchedStrip, description: TensionDescription) -> MeasuredExtension:
    # The clip was on the strip or not when it was measured without weight: half of it counts.
    grams, width = strip.load_g + description.clip_g / 2, 1e-3 * strip.width_mm
    clamped = np.inf if strip.clamped_mm is None else strip.clamped_mm
    return MeasuredExtension(
        DIRECTIONS.index(strip.direction), 1e-3 * grams * STANDARD_GRAVITY / width,
        float(np.hypot(LOAD_ERROR, description.clip_g / np.sqrt(12) / grams)), width,
        1e-3 * strip.gauge_mm, float(1e-3 * (clamped - strip.gauge_mm) / 2),
        1e-3 * strip.extension_mm, 1e-3 * description.extension_error_mm, strip.specimen)
