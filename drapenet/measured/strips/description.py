"""What a folder of strips states of them, in ``strips.yaml``."""

import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from common.documents import Schema
from common.errors import InputError
from common.types import Metres
from data.captures.description import MAX_LABEL_LENGTH
from data.readings.cantilever import BENDING_LENGTHS
from drapenet.measured.base import Described

FILE = "strips.yaml"
MAX_STRIPS = 60
FREE_LENGTHS = (10.0, 300.0)  # mm
_Coordinate = Annotated[float, Field(ge=-1e5, le=1e5)]
_Point = Annotated[list[_Coordinate], Field(min_length=2, max_length=2)]
_SCALES = "mm_per_px: 0.05, or {ruler_px: [[100, 900], [1100, 900]], ruler_mm: 50}, or {by: board}"


class Scale(Schema):
    """Key ``scale``: how large a pixel is in the middle of the strip's width."""

    mm_per_px: float | None = Field(None, gt=0, le=1, title="size of a pixel")
    ruler_px: list[_Point] | None = Field(
        None, min_length=2, max_length=2, title="two points of a ruler in the picture")
    ruler_mm: float | None = Field(None, ge=5, le=1000, title="length between them")
    by: Literal["board", "free_length"] | None = Field(
        None, title="the printed board in the picture, or the stated free length")

    @model_validator(mode="after")
    def _one(self) -> "Scale":
        if (self.ruler_px is None) != (self.ruler_mm is None):
            raise ValueError("states half of a ruler; give ruler_px, its two points in the "
                             "picture, and ruler_mm, the length between them")
        given = [key for key in ("mm_per_px", "ruler_px", "by") if getattr(self, key) is not None]
        if len(given) != 1:
            raise ValueError(f"states {' and '.join(given) or 'nothing'}; give one of {_SCALES}")
        if self.ruler_px and math.dist(*self.ruler_px) < 20:
            raise ValueError("has a ruler of less than 20 pixels; give two distant points of it")
        return self


class View(Schema):
    """How strips are seen: for all of them, or in one entry for one strip."""

    scale: Scale | None = Field(None, title="the keys scale. below")
    clamp_px: _Point | None = Field(
        None, title="[x, y], where the strip leaves the clamp, in the middle of its thickness")
    roll_deg: float | None = Field(
        None, ge=-15, le=15, title="how far the picture is turned clockwise")
    hangs: Literal["left", "right"] | None = Field(
        None, title="side of the clamp on which strips hang")
    camera_distance_mm: float | None = Field(
        None, ge=150, le=20_000, title="from the lens to the middle of the strip's width")


class StripEntry(View):
    """One strip: a photograph, or the bending length that a laboratory has read at 41.5°."""

    direction: Literal["warp", "bias", "weft"] = Field(title="of the strip")
    face: Literal["up", "down"] = Field("up", title="where the marked face is")
    file: str | None = Field(None, min_length=1, max_length=200, title="name of a photograph")
    free_length_mm: float | None = Field(
        None, ge=FREE_LENGTHS[0], le=FREE_LENGTHS[1], title="of its strip, from clamp to tip on "
                                                            "the flat strip")
    bending_length_mm: float | None = Field(
        None, ge=BENDING_LENGTHS[0], le=BENDING_LENGTHS[1], title="in place of both, read at 41.5°")
    specimen: str = Field("", max_length=MAX_LABEL_LENGTH,
                          title="name of the strip, if several entries are of the same")

    @property
    def sign(self) -> int:
        """1 if the marked face is up, else -1."""
        return 1 if self.face == "up" else -1

    @model_validator(mode="after")
    def _one_kind(self) -> "StripEntry":
        if (self.file is None) == (self.bending_length_mm is None):
            raise ValueError("give each strip a file with its free_length_mm, or the "
                             "bending_length_mm of the standard test")
        if self.file is not None and self.free_length_mm is None:
            raise ValueError("free_length_mm is missing: the length from clamp to tip, measured "
                             "on the flat strip")
        if self.file is None and (wrong := sorted(self.model_fields_set - {
                "direction", "face", "specimen", "bending_length_mm"})):
            raise ValueError(f"{wrong[0]} is of a photograph, but the entry is a bending length; "
                             "leave it out")
        return self


class StripsDescription(Described, View):
    """``strips.yaml``; numbers of a view are those of all strips that do not state them.

    Values of testers alone, without strips, are ``known``.
    """

    file, content = FILE, "density_g_m2, scale and strips"
    entries, pictures, typed = "strips", ("file",), False
    thickness_mm: float | None = Field(None, ge=0.03, le=10, title="of the cloth")
    width_mm: float = Field(30.0, ge=5, le=100, title="of the strips")
    clamp_width_mm: float = Field(
        40.0, ge=5, le=200, title="of the clamp, along the line of sight")
    clamp_slope_deg: float = Field(
        0.0, ge=-45, le=90, title="of the clamp below the horizontal, towards the strip")
    strips: list[StripEntry] = Field(
        [], max_length=MAX_STRIPS, title="entries with the keys strips. below")

    @model_validator(mode="after")
    def _something(self) -> "StripsDescription":
        if not (self.strips or (self.known and self.known.values())):
            raise ValueError("nothing is measured; give strips, or known values")
        return self

    @property
    def needs_warp(self) -> bool:
        return bool(self.strips) or super().needs_warp

    def view(self, entry: StripEntry) -> View:
        """The view of one strip."""
        keys = View.model_fields
        return View(**{key: getattr(self if getattr(entry, key) is None else entry, key)
                       for key in keys})

    @property
    def thickness(self) -> Metres | None:
        """Thickness of the cloth, if it is stated."""
        return None if self.thickness_mm is None else 1e-3 * self.thickness_mm


def read_description(folder: Path) -> StripsDescription:
    """The file ``strips.yaml`` of a folder."""
    description = StripsDescription.in_folder(folder)
    names = [entry.file for entry in description.strips if entry.file]
    if repeated := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(f"{folder / FILE}: {repeated[0]} is the file of two strips; give each "
                         "photograph once")
    return description
