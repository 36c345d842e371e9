"""A folder of strips of one fabric that were stretched by weights."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from common.errors import InputError
from common.findings import Finding
from common.types import Density
from data.captures.description import Labels
from data.pictures.mat import BAR
from data.readings.known import Known
from data.readings.quantity import STANDARD_GRAVITY
from drapenet.measured.tension.description import (
    FILE,
    MAX_EXTENSION,
    READING,
    StretchedStrip,
    TensionDescription,
    read_description,
)
from drapenet.measured.tension.photograph import PhotographedExtension, read_extension
from drapenet.measured.tension.posterior import (
    KES_SHEAR,
    LOAD_ERROR,
    MeasuredExtension,
    TensionEvidence,
    fast_strip,
    tension_evidence,
)
from sim.material import BIAS, DIRECTIONS

AIM = 0.1
"""Extension at which a strip tells most: well above the errors of reading, and within the law."""

WIDTH_DIFFERS = (0.08, 1.0)  # of the stated width, and mm, by which a strip is seen wider or not
ERROR_SHARE = 0.25  # of an extension, that its error may be
TURNED = np.radians(3.0)  # that marks may be turned by a weight: beyond, a band is askew


@dataclass(frozen=True)
class TensionSet:
    """The strips of one fabric.

    Attributes:
        shear: stiffness by KES-FB1, N/m, if it is stated.
        known: other values of the fabric.
        photographs: what pairs of photographs say, by the strip's number.
    """

    kind: ClassVar[Literal["tension"]] = "tension"
    path: Path
    density: Density
    strips: tuple[MeasuredExtension, ...]
    shear: float | None
    known: Known | None
    labels: Labels
    photographs: Mapping[int, PhotographedExtension] = field(default_factory=dict)
    warnings: tuple[Finding, ...] = ()

    @property
    def directions(self) -> list[str]:
        """Those of the strips."""
        return list(dict.fromkeys(DIRECTIONS[strip.direction] for strip in self.strips))

    @property
    def along_yarns(self) -> bool:
        """Whether warp and weft must be told apart."""
        return any(strip.direction != BIAS for strip in self.strips)

    @cached_property
    def evidence(self) -> TensionEvidence:
        """What the strips say, at the density of the fabric."""
        found = tension_evidence(self.strips, self.density, self.shear)
        return replace(found, findings=(*self.warnings, *found.findings))

    def loads(self, found: TensionEvidence) -> dict[str, float]:
        """For each direction the weight, g, that stretches its first strip by :data:`AIM`."""
        warp, weft, shear = np.exp(found.posterior.mean)
        return {DIRECTIONS[strip.direction]: float(1e3 * strip.width / STANDARD_GRAVITY * (
            found.friction[strip.direction]
            + strip.needed((warp, weft, shear), found.poisson, AIM)))
            for strip in reversed(self.strips)}


def read_tension(folder: str | Path) -> TensionSet:
    """Read ``tension.yaml`` and the photographs it names; InputError for the first fault."""
    folder = Path(folder)
    description = read_description(folder)
    shear = description.kes_g_gf_per_cm_deg
    read = {k: _photographed(folder, strip, description)
            for k, strip in enumerate(description.tension) if strip.without}
    try:
        for k, found in read.items():
            description.tension[k].require_within(1e3 * found.extension)
        description.require_ordered([
            1e3 * read[k].extension if k in read else strip.extension_mm
            for k, strip in enumerate(description.tension)])
    except ValueError as error:
        raise InputError(f"{folder / FILE}: {error}") from None
    return TensionSet(
        folder, description.density,
        (*(_measured(strip, description, read.get(k))
           for k, strip in enumerate(description.tension)),
         *(fast_strip(direction, percent) for direction, percent in description.fast.items())),
        KES_SHEAR * shear if shear else None, description.known, description.labels, read,
        tuple(one for k, found in read.items() for one in _doubts(found, description.tension[k])))


def _photographed(folder: Path, strip: StretchedStrip, description: TensionDescription
                  ) -> PhotographedExtension:
    assert strip.without and strip.under  # of an entry with photographs
    bar, marks = description.mat_bar_mm, strip.marks_px
    return read_extension(
        folder, (strip.without, strip.under), width=1e-3 * strip.width_mm,
        gauge=1e-3 * strip.gauge_mm, most=MAX_EXTENSION, above=1e-3 * description.above_mat_mm,
        scale=1e-3 * bar / BAR if bar else 1.0,
        marks=(marks.without, marks.under) if marks else None)


def _doubts(found: PhotographedExtension, strip: StretchedStrip) -> list[Finding]:
    """Warnings of photographs that are read all the same."""
    (file, under), doubts = (picture.name for picture in found.pictures), []
    if abs(found.turned) > TURNED:
        doubts.append(Finding("tension_askew", {
            "file": file, "other": under, "value": float(np.degrees(abs(found.turned)))}))
    if abs(1e3 * found.width - strip.width_mm) > WIDTH_DIFFERS[0] * strip.width_mm + (
            WIDTH_DIFFERS[1]):
        doubts.append(Finding("tension_width_differs", {
            "file": file, "value": 1e3 * found.width, "stated": strip.width_mm}))
    if found.error > max(ERROR_SHARE * found.extension, 1e-3 * READING):
        doubts.append(Finding("tension_unsure", {
            "file": file, "value": 1e3 * found.extension, "error": 1e3 * found.error}))
    return doubts


def _measured(strip: StretchedStrip, description: TensionDescription,
              found: PhotographedExtension | None) -> MeasuredExtension:
    gauge, extension, error = (
        (found.gauge, found.extension, found.error) if found else
        (1e-3 * strip.gauge_mm, 1e-3 * (strip.extension_mm or 0.0),
         1e-3 * description.extension_error_mm))
    # The clip was on the strip or not when it was measured without weight: half of it counts.
    grams, width = strip.load_g + description.clip_g / 2, 1e-3 * strip.width_mm
    clamped = np.inf if strip.clamped_mm is None else strip.clamped_mm
    return MeasuredExtension(
        DIRECTIONS.index(strip.direction), 1e-3 * grams * STANDARD_GRAVITY / width,
        float(np.hypot(LOAD_ERROR, description.clip_g / np.sqrt(12) / grams)), width,
        gauge, float(1e-3 * (clamped - strip.gauge_mm) / 2), extension, error, strip.specimen)
