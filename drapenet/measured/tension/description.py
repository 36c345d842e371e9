"""What a folder states of strips stretched by weights, in ``tension.yaml``."""

from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from common.documents import Schema
from data.captures.description import MAX_LABEL_LENGTH
from drapenet.measured.base import Described
from drapenet.measured.tension.law import E100, EB5, EMT, KES_SHEAR, Machine
from sim.material import BIAS, DIRECTIONS, WARP, WEFT

FILE = "tension.yaml"
MAX_STRIPS = 60
MAX_EXTENSION = 0.3  # relative; beyond, cloth is far from the law
READING = 0.3  # mm, of an extension between two marks by a ruler

_File = Annotated[str, Field(min_length=1, max_length=200)]
_Two = Field(min_length=2, max_length=2)
_Place = Annotated[list[float], _Two]
Percent = Annotated[float | None, Field(ge=0.1, le=100 * MAX_EXTENSION)]


class MarksPixels(Schema):
    """Column and row, in pixels of the file, of the two marks in the middle of the strip's width,
    in both pictures."""

    without: Annotated[list[_Place], _Two]
    under: Annotated[list[_Place], _Two] = Field(alias="with")


class StretchedStrip(Schema):
    """A strip under a weight: how much farther its two marks are apart than without it, or two
    photographs over the mat."""

    direction: Literal["warp", "bias", "weft"] = Field(title="of the strip")
    width_mm: float = Field(ge=10, le=200, description="the width of the cut strip")
    gauge_mm: float = Field(ge=20, le=1000, description="the distance of the marks without weight")
    load_g: float = Field(ge=1, le=20_000, description="the weight in grams")
    extension_mm: float | None = Field(
        None, description="how much farther the marks are apart with the weight")
    without: _File | None = Field(
        None, title="photograph without the weight, in place of extension_mm")
    under: _File | None = Field(None, alias="with", title="photograph with the weight")
    marks_px: MarksPixels | None = Field(
        None, title="both marks in both photographs, in the middle of the strip's width: {without: "
                    "[[x, y], [x, y]], with: [[x, y], [x, y]]}")
    clamped_mm: float | None = Field(
        None, ge=20, le=2000, title="length between the clamps, with the marks in its middle; by "
                                    "default they are far away")
    specimen: str = Field("", max_length=MAX_LABEL_LENGTH,
                          title="name of the strip, if there are several of a direction")

    @model_validator(mode="after")
    def _possible(self) -> "StretchedStrip":
        if (self.without is None) != (self.under is None) or (
                (self.extension_mm is None) == (self.without is None)):
            raise ValueError("give each strip its extension_mm, or two photographs over the mat: "
                             "without: a.jpg, with: b.jpg")
        if self.without is not None and self.without == self.under:
            raise ValueError(f"has {self.without} as both photographs; give one without the weight "
                             "and one with it")
        if self.marks_px and not self.without:
            raise ValueError("has marks_px, which are of photographs; give without and with, or "
                             "leave them out")
        if self.extension_mm is not None:
            self.require_within(self.extension_mm)
        if self.clamped_mm is not None and self.clamped_mm < self.gauge_mm:
            raise ValueError(
                f"has clamped_mm {self.clamped_mm:g}, less than gauge_mm {self.gauge_mm:g}: give "
                "the length between the clamps, in which the marks lie")
        return self

    def require_within(self, extension: float) -> None:
        """ValueError for an extension, mm, beyond the law."""
        if extension <= 0:
            raise ValueError(f"has extension_mm {extension:g}: give how much farther the marks are "
                             "apart with the weight; if nothing is seen, take a heavier one")
        if extension > MAX_EXTENSION * self.gauge_mm:
            raise ValueError(
                f"has extension_mm {extension:.3g}, {extension / self.gauge_mm:.0%} of gauge_mm "
                f"{self.gauge_mm:g}, at most {MAX_EXTENSION:.0%}: give the difference with and "
                "without the weight, or take a lighter one")


class TensionDescription(Described):
    """``tension.yaml``."""

    remedy = "docs/use.md shows an example; density_g_m2 is needed, weight_g is of whole specimens"
    nothing: ClassVar[str] = ("nothing is measured; give tension, a list of strips, "
                              "kes_g_gf_per_cm_deg, or values of FAST-3 (fast_eb5_percent)")
    file, content = FILE, "density_g_m2 and tension, a list of strips"
    entries, pictures = "tension", ("without", "with")
    tension: list[StretchedStrip] = Field(
        [], max_length=MAX_STRIPS, title="entries with the keys tension. below")
    clip_g: float = Field(0.0, ge=0, le=1000, title="of the lower clip, where load_g is without it")
    extension_error_mm: float = Field(
        READING, ge=0.01, le=5, title="standard deviation of extension_mm")
    above_mat_mm: float = Field(
        0.0, ge=0, le=100, title="height of photographed strips above the mat")
    mat_bar_mm: float | None = Field(
        None, ge=150, le=250, title="length of the mat's scale of 200 mm as printed")
    kes_g_gf_per_cm_deg: float | None = Field(
        None, ge=0.02, le=50, description="G of KES-FB1, mean of warp and weft, in gf/(cm °)")
    kes_emt_warp_percent: Percent = Field(None, description="EMT of KES-FB1, at 500 gf/cm")
    kes_emt_weft_percent: Percent = Field(None, description="EMT of KES-FB1")
    fast_eb5_percent: Percent = Field(None, description="EB5 of FAST-3, along the bias")
    fast_e100_warp_percent: Percent = Field(None, description="E100 of FAST-3")
    fast_e100_weft_percent: Percent = Field(None, description="E100 of FAST-3")
    stretch_warp_n_per_m: float | None = Field(
        None, ge=10, le=1e5,
        description="stretch stiffness along the warp, of any tester; 1000 g/s² of CLO are 1 N/m")
    stretch_weft_n_per_m: float | None = Field(
        None, ge=10, le=1e5, description="the same along the weft")
    shear_n_per_m: float | None = Field(
        None, ge=1, le=1e4, description="shear stiffness, in place of kes_g_gf_per_cm_deg")

    @property
    def by_machines(self) -> list[tuple[Machine, int, float]]:
        """Extensions by FAST-3 and KES-FB1: the number of their direction, and per cent."""
        return [(machine, direction, percent) for machine, direction, percent in (
            (E100, WARP, self.fast_e100_warp_percent), (EB5, BIAS, self.fast_eb5_percent),
            (E100, WEFT, self.fast_e100_weft_percent), (EMT, WARP, self.kes_emt_warp_percent),
            (EMT, WEFT, self.kes_emt_weft_percent)) if percent]

    @property
    def stiffness(self) -> dict[int, float]:
        """Stated stiffnesses, N/m, by the number of the direction of strips that measure them."""
        sheared = self.kes_g_gf_per_cm_deg
        read = {WARP: self.stretch_warp_n_per_m, WEFT: self.stretch_weft_n_per_m,
                BIAS: KES_SHEAR * sheared if sheared else self.shear_n_per_m}
        return {direction: value for direction, value in read.items() if value}

    @property
    def measures(self) -> bool:
        """Whether anything is measured."""
        return bool(self.tension or self.stiffness or self.by_machines)

    @model_validator(mode="after")
    def _sound(self) -> "TensionDescription":
        if not self.measures:
            raise ValueError(self.nothing)
        if self.kes_g_gf_per_cm_deg and self.shear_n_per_m:
            raise ValueError("kes_g_gf_per_cm_deg and shear_n_per_m are one quantity; give one")
        self.require_ordered([strip.extension_mm for strip in self.tension])
        return self

    def require_ordered(self, extensions: Sequence[float | None]) -> None:
        """ValueError if a larger weight does not stretch a strip more; ``extensions``: mm, of all
        strips, None where not read yet."""
        read = [(strip, mm) for strip, mm in zip(self.tension, extensions, strict=True) if mm]
        for strip, own in read:
            if lighter := [(one, mm) for one, mm in read if one.load_g < strip.load_g
                           and mm >= own and self.same_strip(one, strip)]:
                raise ValueError(
                    f"has extension_mm {own:.3g} along the {strip.direction} with "
                    f"load_g {strip.load_g:g}, not more than {lighter[0][1]:.3g} with "
                    f"{lighter[0][0].load_g:g}: measure again, a clamp has slipped or a mark was "
                    "misread; name other strips of a direction with specimen")

    @staticmethod
    def same_strip(one: StretchedStrip, other: StretchedStrip) -> bool:
        """Whether two entries are of the same strip."""
        return all(getattr(one, key) == getattr(other, key) for key in (
            "direction", "specimen", "width_mm", "gauge_mm", "clamped_mm"))

    @property
    def needs_warp(self) -> bool:
        """Strips along the bias do not tell warp and weft apart."""
        return super().needs_warp or any(direction != BIAS for direction in (
            *self.stiffness, *(direction for _, direction, _ in self.by_machines),
            *(DIRECTIONS.index(strip.direction) for strip in self.tension)))
