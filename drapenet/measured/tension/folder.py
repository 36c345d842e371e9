"""A folder of strips of one fabric that were stretched by weights."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np

from common.errors import InputError
from common.files import printable
from common.findings import Finding
from data.captures.description import Weighed
from data.pictures.mat import BAR
from data.readings.quantity import STANDARD_GRAVITY
from data.render.setups import Setups
from drapenet.measured.base import Measured, Observed, Prior, Record, intervals
from drapenet.measured.tension.description import (
    MAX_EXTENSION,
    READING,
    StretchedStrip,
    TensionDescription,
)
from drapenet.measured.tension.photograph import PhotographedExtension, read_extension
from drapenet.measured.tension.posterior import (
    LOAD_ERROR,
    MACHINE_ERROR,
    MeasuredExtension,
    TensionEvidence,
    tension_evidence,
)
from drapenet.measured.tension.record import TensionRecord
from sim.material import BIAS, DIRECTIONS

AIM = 0.1
"""Extension at which a strip tells most: well above the errors of reading, and within the law."""

WIDTH_DIFFERS = (0.08, 1.0)  # of the stated width, and mm, by which a strip is seen wider or not
ERROR_SHARE = 0.25  # of an extension, that its error may be
TURNED = np.radians(3.0)  # that marks may be turned by a weight: beyond, a band is askew

T = TypeVar("T", bound="TensionSet")


@dataclass(frozen=True, kw_only=True)
class TensionSet(Measured):
    """The strips of one fabric."""

    name, noun = "tension", "strips under weights"
    schema: ClassVar[type[Weighed]] = TensionDescription
    recorded: ClassVar[type[Record]] = TensionRecord
    strips: tuple[MeasuredExtension, ...]
    stiffness: Mapping[int, float] = field(default_factory=dict)  # stated, N/m, by direction
    photographs: Mapping[int, PhotographedExtension] = field(default_factory=dict)  # by strip

    @classmethod
    def read(cls, place: Path, stated: Mapping[str, Any]) -> "TensionSet":
        return read_tension(place)

    @property
    def alone(self) -> bool:
        return bool(self.strips or self.stiffness)

    @property
    def needs_warp(self) -> bool:
        """Strips along the bias do not tell warp and weft apart."""
        return any(k != BIAS for k in (*self.stiffness, *(one.direction for one in self.strips)))

    @cached_property
    def evidence(self) -> TensionEvidence:
        """What the strips say, at the density of the fabric."""
        return tension_evidence(self.strips, self.density, self.stiffness,
                                knit=bool(self.known and self.known.cloth == "knit"))

    def record(self, prior: Prior) -> TensionRecord:
        """The stiffnesses, which the prior of bending says nothing of."""
        found = self.evidence
        warp, weft, shear = found.stiffness
        return TensionRecord.model_validate({
            "source": printable(self.path), "density_g_m2": round(1e3 * self.density, 6),
            "strips": len(self.strips), "measured": [DIRECTIONS[k] for k in found.measured],
            "shear_n_per_m": intervals(shear),
            "stretch_n_per_m": {"warp": intervals(warp), "weft": intervals(weft)},
            "friction_n_per_m": {DIRECTIONS[strip.direction]: float(found.friction[strip.direction])
                                 for strip in self.strips},
            "weight_for_10_percent_g": self.loads(),
            "readings": {key: intervals(values) for key, values in found.readings().items()},
            "along_yarns": self.needs_warp, "findings": [*self.warnings, *found.findings],
            "known": self.known})

    def findings(self, observed: Observed | None, setups: Setups) -> list[Finding]:
        return [*self.evidence.findings] if self.alone else []

    def shown(self) -> bytes:
        if not self.strips:
            return b""
        from data.captures.preview import png  # Matplotlib
        from drapenet.measured.tension.preview import tension_figure

        return png(tension_figure(self.strips, self.photographs, self.evidence))

    def loads(self) -> dict[str, float]:
        """For each direction the weight, g, that stretches its first strip by :data:`AIM`."""
        found = self.evidence
        warp, weft, shear = np.exp(found.posterior.mean)
        return {DIRECTIONS[strip.direction]: float(1e3 * strip.width / STANDARD_GRAVITY * (
            found.friction[strip.direction]
            + strip.needed((warp, weft, shear), found.poisson, AIM)))
            for strip in reversed(self.strips) if not strip.typed}


def read_tension(folder: str | Path) -> TensionSet:
    """Read ``tension.yaml`` and the photographs it names; InputError for the first fault."""
    folder = Path(folder)
    return described_strips(TensionSet, TensionDescription.in_folder(folder), folder)


def described_strips(
    kind: type[T], description: TensionDescription, folder: Path, **further: Any
) -> T:
    """The strips of a description, in whose ``folder`` their photographs lie, as a kind with
    ``further`` fields."""
    read = {k: _photographed(folder, strip, description)
            for k, strip in enumerate(description.tension) if strip.without}
    try:
        for k, found in read.items():
            description.tension[k].require_within(1e3 * found.extension)
        description.require_ordered([
            1e3 * read[k].extension if k in read else strip.extension_mm
            for k, strip in enumerate(description.tension)])
    except ValueError as error:
        raise InputError(f"{folder / description.file}: {error}") from None
    strips = [_measured(strip, description, read.get(k))
              for k, strip in enumerate(description.tension)]
    strips += [MeasuredExtension(k, by.load, by.error, by.width, by.length, 0.0,
                                 by.length * percent / 100, MACHINE_ERROR, by.name, typed=True)
               for by, k, percent in description.by_machines]
    found = kind(**description.common(folder), strips=tuple(strips),
                 stiffness=description.stiffness, photographs=read, **further)
    return found.changed(warnings=(*found.warnings, *(
        one for k, seen in read.items() for one in _doubts(seen, description.tension[k]))))


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
