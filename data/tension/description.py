"""What a folder states of strips stretched by weights, in ``tension.yaml``."""

import os
from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from common.documents import Schema, misnamed, read_yaml, rename_remedy
from common.errors import InputError
from data.captures.description import MAX_LABEL_LENGTH, Labels, Weighed
from data.readings.known import Known

FILE = "tension.yaml"
MAX_STRIPS = 60
MAX_EXTENSION = 0.3  # relative; beyond, cloth is far from the law
READING = 0.3  # mm, of an extension between two marks by a ruler


class StretchedStrip(Schema):
    """A strip under a weight: how much farther its two marks are apart than without it.

    ``clamped_mm``: length between the clamps, with the marks in its middle; without it they are
    taken to be far from them. ``specimen``: name of the strip, if there are several of a direction.
    """

    direction: Literal["warp", "bias", "weft"]
    width_mm: float = Field(ge=10, le=200, description="the width of the cut strip")
    gauge_mm: float = Field(ge=20, le=1000, description="the distance of the marks without weight")
    load_g: float = Field(ge=1, le=20_000, description="the weight in grams")
    extension_mm: float = Field(gt=0, description="how much farther the marks are apart with the "
                                "weight; take a heavier one if nothing is seen")
    clamped_mm: float | None = Field(None, ge=20, le=2000)
    specimen: str = Field("", max_length=MAX_LABEL_LENGTH)

    @model_validator(mode="after")
    def _possible(self) -> "StretchedStrip":
        if self.extension_mm > MAX_EXTENSION * self.gauge_mm:
            raise ValueError(
                f"has extension_mm {self.extension_mm:g}, {self.extension_mm / self.gauge_mm:.0%} "
                f"of gauge_mm {self.gauge_mm:g}, at most {MAX_EXTENSION:.0%}: give the difference "
                "with and without the weight, or take a lighter one")
        if self.clamped_mm is not None and self.clamped_mm < self.gauge_mm:
            raise ValueError(
                f"has clamped_mm {self.clamped_mm:g}, less than gauge_mm {self.gauge_mm:g}: give "
                "the length between the clamps, in which the marks lie")
        return self


class TensionDescription(Weighed, Labels):
    """``tension.yaml``. ``clip_g``: of the clip that bears the weights, where it is not among them.
    """

    remedy = "docs/use.md shows an example"
    tension: list[StretchedStrip] = Field([], max_length=MAX_STRIPS)
    clip_g: float = Field(0.0, ge=0, le=1000)
    extension_error_mm: float = Field(READING, ge=0.01, le=5)
    kes_g_gf_per_cm_deg: float | None = Field(
        None, ge=0.02, le=50, description="G of KES-FB1, mean of warp and weft, in gf/(cm °)")
    known: Known | None = Field(None, description=Known.remedy)

    @model_validator(mode="after")
    def _sound(self) -> "TensionDescription":
        if not (self.tension or self.kes_g_gf_per_cm_deg):
            raise ValueError("nothing is measured; give tension, a list of strips, or "
                             "kes_g_gf_per_cm_deg")
        for strip in self.tension:
            if lighter := [one for one in self.tension if one.load_g < strip.load_g
                           and one.extension_mm >= strip.extension_mm
                           and self.same_strip(one, strip)]:
                raise ValueError(
                    f"has extension_mm {strip.extension_mm:g} along the {strip.direction} with "
                    f"load_g {strip.load_g:g}, not more than {lighter[0].extension_mm:g} with "
                    f"{lighter[0].load_g:g}: measure again, a clamp has slipped or a mark was "
                    "misread; name other strips of a direction with specimen")
        return self

    @staticmethod
    def same_strip(one: StretchedStrip, other: StretchedStrip) -> bool:
        """Whether two entries are of the same strip."""
        return all(getattr(one, key) == getattr(other, key) for key in (
            "direction", "specimen", "width_mm", "gauge_mm", "clamped_mm"))

    @property
    def labels(self) -> Labels:
        """What a report states."""
        return Labels(**self.stated())


def read_description(folder: Path) -> TensionDescription:
    """The file ``tension.yaml`` of a folder."""
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder; give the one that holds {FILE}")
    file = folder / FILE
    if not file.exists():
        if other := misnamed(os.listdir(folder), FILE):
            raise InputError(f"{folder / other}: {rename_remedy(FILE)}")
        raise InputError(f"{folder} has no {FILE}; write it with density_g_m2 and tension, a list "
                         "of strips (docs/use.md)")
    return TensionDescription.of(read_yaml(file), file)
