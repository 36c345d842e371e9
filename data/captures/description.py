"""What a capture states of itself, in ``capture.yaml`` or a form of the service."""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import date
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar

import numpy as np
from pydantic import BeforeValidator, Field, PlainValidator, model_validator

from common.documents import Schema
from common.errors import InputError, shortened, shown
from common.findings import Finding
from common.types import Density, Metres, Radians, Turns
from data.captures.depth import Lens
from data.readings.known import Reported
from data.render.cameras import Intrinsics
from data.rigs import Tester, read_tester

DENSITY_RANGE = (16.0, 3000.0)  # g/m2; from 3 to 15 oz/yd² is common for heavier cloth
LIGHT_DENSITY = 35.0  # g/m2; few fabrics are lighter, and many have this number of momme
HEAVY_DENSITY = 1000.0  # g/m2; only coated cloth and leather are heavier
MAX_COEFFICIENT = 1.15  # of a drape, from 0 to 1; sound captures of stiff cloth have up to 0.98
MAX_VIEWS = 8
MIN_PICTURE, MAX_PICTURE = (80, 60), (4096, 4096)
MILLIMETRE = 1e-3  # m per count
INTRINSICS_KEYS = ("fx", "fy", "cx", "cy")
MIN_EQUAL_TURNS = 4  # views, from which on equally spaced turns are the default
MIN_TURN = 6.3  # degrees; the largest turn given in radians is 6.28
PLATE_HEIGHTS = (20.0, 600.0)  # mm above the mat
MAT_BARS = (180.0, 220.0)  # mm, of the scale of 200 mm on a mat that was not printed at 100 %
CAMERA_HEIGHTS = (200.0, 20_000.0)  # mm above the plate, of a photograph's camera
OUTLINE_TABLES = (".csv", ".txt")  # suffixes of outlines in numbers
PARALLEL = "parallel"
"""Height of a camera infinitely far away, such as the light of a drapemeter."""
NEED_WARP = "need captures whose warp is marked: state its direction (warp_direction_deg)"
MAX_LABEL_LENGTH = 80  # characters
PRINTABLE = r"^[[^\p{C}\p{Zl}\p{Zp}]\x{AD}\x{200C}\x{200D}]*$"  # with hyphens and joiners
_Label = Annotated[str, Field(min_length=1, max_length=MAX_LABEL_LENGTH, pattern=PRINTABLE)]
_OR = " / "  # between different labels
_UNTIL = " to "  # between the first and the last day
_STANDARD = "ISO 139"
_LABEL = f"up to {MAX_LABEL_LENGTH} printable characters, in quotes if they are a number"


def _days(value: object) -> object:
    """A day, or its text, as YYYY-MM-DD, or the first and the last of several."""
    try:
        if isinstance(value, date):
            return str(value)[:10]
        return _UNTIL.join(str(date.fromisoformat(day)) for day in value.split(_UNTIL))  # type: ignore
    except (AttributeError, TypeError, ValueError):
        raise ValueError("is not a date; give YYYY-MM-DD, such as 2026-11-26") from None


def _period(dates: Sequence[str]) -> str:
    """The first and the last day of dates."""
    days = sorted(day for each in dates for day in each.split(_UNTIL))
    return _UNTIL.join(dict.fromkeys([days[0], days[-1]]))


def _within(low: float, high: float, other: str = "", slip: str = "") -> BeforeValidator:
    """Takes numbers from ``low`` to ``high`` or an ``other`` text; ``slip``: what others may be."""
    def read(value: object) -> str:
        with suppress(ValueError):
            if all(one == other or low <= float(one) <= high for one in str(value).split(_OR)):
                return str(value)
        raise ValueError(f"is not {low:g} to {high:g}" + f", or {other}" * bool(other) + slip)

    return BeforeValidator(read)


class Labels(Schema):
    """What a report states of a capture, as it was given."""

    fabric: _Label | None = Field(None, title="name of the fabric", description=_LABEL)
    date: Annotated[str, BeforeValidator(_days)] | None = Field(
        None, title="day of the test, or 2026-11-25 to 2026-11-26")
    laboratory: _Label | None = Field(None, title="name", description=_LABEL)
    operator: _Label | None = Field(None, title="name", description=_LABEL)
    camera: _Label | None = Field(None, title="name", description=_LABEL)
    remarks: _Label | None = Field(None, title="anything else", description=_LABEL)
    temperature_c: Annotated[str, _within(-20, 60)] | None = Field(
        None, title="of the air, -20 to 60 °C")
    humidity_percent: Annotated[str, _within(1, 100, slip="; a share?")] | None = Field(
        None, title="relative, of the air, 1 to 100")
    conditioning_h: Annotated[str, _within(0, 1000, _STANDARD)] | None = Field(
        None, title=f"hours in this air before the test, or {_STANDARD}, by that standard")

    @classmethod
    def joined(cls, labels: Sequence["Labels"]) -> "Labels":
        """What captures of one fabric state: different values separated by " / ", shortened, and
        the first and the last date."""
        found: dict[str, dict[str, None]] = {}
        for each in labels:
            for key, value in each.stated().items():
                found.setdefault(key, {})[value] = None
        return cls(**{key: _period([*values]) if key == "date" else
                      shortened(_OR.join(values), MAX_LABEL_LENGTH)
                      for key, values in found.items()})

    def named(self, fabric: str) -> "Labels":
        """The labels with the name by which a door calls the fabric, if it has one."""
        return Labels(**self.stated() | ({"fabric": fabric} if fabric else {}))

    def stated(self) -> dict[str, str]:
        """The labels that are given, by key."""
        return {key: value for key in Labels.model_fields if (value := getattr(self, key))}

    @property
    def labels(self) -> "Labels":
        """What a report states."""
        return Labels(**self.stated())

    @property
    def conditions(self) -> str:
        """Of the air, in words; empty if none is stated."""
        return ", ".join(filter(None, [
            self.temperature_c and f"{self.temperature_c} °C",
            self.humidity_percent and f"{self.humidity_percent} % r.h.",
            self.conditioning_h and f"conditioned (h): {self.conditioning_h}"]))

    @property
    def columns(self) -> dict[str, str]:
        """All labels as columns of a table, empty where not given; the fabric's name is its label,
        beside the name of its folder."""
        return {"label" if key == "fabric" else key: getattr(self, key) or ""
                for key in Labels.model_fields}


UNLABELLED = Labels()


class Weighed(Schema):
    """What is stated of the fabric."""

    density_g_m2: float = Field(
        ge=DENSITY_RANGE[0], le=DENSITY_RANGE[1], title="mass per area",
        description="weigh the specimen, give its g/m² and check the unit (1 oz/yd² is 33.9 g/m², "
                    "1 momme 4.34 g/m², 1 kg/m² 1000 g/m²)")

    @property
    def density(self) -> Density:
        """Density of the fabric."""
        return 1e-3 * self.density_g_m2

    @property
    def questions(self) -> tuple[Finding, ...]:
        """A warning of a density that few fabrics have."""
        density = self.density_g_m2
        code = "density_light" if density < LIGHT_DENSITY else "density_heavy"
        return () if LIGHT_DENSITY <= density <= HEAVY_DENSITY else (
            Finding(code, {"value": density}),)


class Specimen(Weighed):
    """What is stated of the cloth."""

    warp_direction_deg: float | None = Field(
        None, ge=-360, le=360, title="direction of the warp in the first view or the photograph, 0 "
                                     "to the right, counter-clockwise; over a mat from its arrow")

    @property
    def warp_direction(self) -> Radians | None:
        """Direction of the warp in the first view, in [0, pi)."""
        direction = self.warp_direction_deg
        return None if direction is None else math.radians(direction) % math.pi


W = TypeVar("W", bound="WeighedPiece")


class WeighedPiece(Weighed):
    """A fabric whose mass per area may be stated by the weight of a piece of it."""

    weight_g: float | None = Field(
        None, gt=0, title="of the whole specimen, or of specimen_cm2, in place of density_g_m2",
        description="the specimen's weight in grams")
    specimen_cm2: float | None = Field(
        None, ge=10, le=20_000, title="area of the weighed piece, where it is not the tester's")
    tester: Tester | None = Field(
        None, title="name, such as disc300_support180, or numbers: {specimen: disc, size_mm: 300, "
                    "plate_mm: 180} and rim_radius_mm, 0 to 10, of a rounded rim; required")
    known: Reported | None = Field(
        None, title="values of other tests", description=Reported.remedy)

    @property
    def reported(self) -> bool:
        """Whether a drape coefficient is stated."""
        return self.known is not None and self.known.drape_coefficient_percent is not None

    @model_validator(mode="before")
    @classmethod
    def _by_weight(cls, content: Any) -> Any:
        """The content, with the density of a weighed piece."""
        weight = content.get("weight_g") if isinstance(content, Mapping) else None
        if not isinstance(weight, int | float):
            return content
        if content.get("density_g_m2") is not None:
            raise ValueError("weight_g and density_g_m2 both state the density; give one of them")
        area, tester = content.get("specimen_cm2"), content.get("tester")
        sized, (low, high) = isinstance(area, int | float) and area > 0, DENSITY_RANGE
        if tester is None and not sized:
            raise ValueError("weight_g is of the whole specimen; state tester, which has its size, "
                             "or specimen_cm2")
        try:
            area = area if sized else 1e4 * read_tester(tester).specimen_area
        except InputError as error:
            raise ValueError(f"tester={shown(tester)} {error}") from None
        if not low <= (density := 1e4 * weight / area) <= high:
            raise ValueError(f"weight_g={weight:g} of {area:.4g} cm² is {density:.3g} g/m², not "
                             f"{low:g} to {high:g}: give grams, and its area")
        return {**content, "density_g_m2": density}

    @model_validator(mode="after")
    def _weighed(self: W) -> W:
        if self.specimen_cm2 and not self.weight_g:
            raise ValueError("specimen_cm2 is the area of a weighed piece; state weight_g, too")
        return self


_Focal = Annotated[float, Field(ge=10, le=1e5)]


class Pixels(Schema):
    """Intrinsics in pixels, and coefficients of a lens that distorts the pictures."""

    fx: _Focal
    fy: _Focal
    cx: float
    cy: float
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0


LENS_KEYS = tuple(Pixels.model_fields)[4:]  # in OpenCV's order


class PlateInPicture(Schema):
    """The support's top in a photograph, in pixels."""

    x: float
    y: float
    diameter: float = Field(ge=20, le=1e5)


def _height(value: object) -> float:
    """A camera's height, mm, infinite for parallel light."""
    low, high = CAMERA_HEIGHTS
    if value == PARALLEL:
        return math.inf
    if isinstance(value, (int, float)) and low <= value <= high:
        return float(value)
    raise ValueError(f"is not a height above the plate; give {low:g} to {high:g} mm, or {PARALLEL}")


class OutlineSource(Schema):
    """Key ``outline``: how a drape was seen from above, or what the numbers of a file mean.

    A photograph has the keys ``OF_PHOTOGRAPHS``: a ``mat`` under the stand, ``plate_px`` or
    ``mm_per_px``, or none of them, with a board in the picture or ``plate.jpg`` beside it; a text
    file has the keys ``OF_TABLES``.
    """

    OF_PHOTOGRAPHS: ClassVar = ("mat", "ground", "plate_height_mm", "mat_bar_mm", "arrow",
                                "mm_per_px", "plate_px")
    OF_TABLES: ClassVar = ("unit", "centred", "y_axis", "angles")

    mat: Literal["a3", "a2"] | None = Field(None, title="the printed mat under the stand")
    ground: Literal["white", "grey", "blue"] = Field(
        "white", title="colour of a plain mat; one with the code shows that itself")
    plate_height_mm: float | None = Field(
        None, ge=PLATE_HEIGHTS[0], le=PLATE_HEIGHTS[1], title="top of the plate above the mat")
    mat_bar_mm: float | None = Field(
        None, ge=MAT_BARS[0], le=MAT_BARS[1], title="length of the mat's scale of 200 mm, measured "
                                                    "on the print")
    arrow: Literal["warp", "none"] = Field("warp", title="what lies along the mat's arrow")
    mm_per_px: float | None = Field(
        None, gt=0, le=10, title="size of a pixel at the height of the plate; the centroid of the "
                                 "outline stands for the plate's centre")
    plate_px: PlateInPicture | None = Field(
        None, title="the plate's top: x (to the right), y (down) and diameter, pixels of the "
                    "upright file")
    camera_height_mm: Annotated[float, PlainValidator(_height)] | None = Field(
        None, title="of the lens above the plate, 200 to 20000, or parallel, of the light of a "
                    "drapemeter")
    unit: Literal["mm", "m"] | None = Field(
        None, title="of a table's lengths; by default that of its header")
    centred: bool = Field(True, title="whether the origin of a table is the plate's centre; else "
                                      "the outline's centroid stands for it")
    y_axis: Literal["up", "down"] | None = Field(
        None, title="where y of a table points; down: as rows of pixels, seen from above")
    angles: Literal["counter-clockwise", "clockwise"] | None = Field(
        None, title="how angles of a table grow, seen from above; 0 is to the right")

    @model_validator(mode="after")
    def _one_scale(self) -> "OutlineSource":
        if self.mm_per_px and self.plate_px:
            raise ValueError("mm_per_px and plate_px both state the scale; give one of them")
        if self.mat and (self.mm_per_px or self.plate_px or self.camera_height_mm):
            raise ValueError("the mat states scale, centre and camera height; leave out mm_per_px, "
                             "plate_px and camera_height_mm")
        if self.mat_bar_mm and not self.mat:
            raise ValueError("mat_bar_mm is the measured length of the scale on a mat; state mat, "
                             "too")
        if self.ground != "white" and not self.mat:
            raise ValueError("ground is the colour of a mat around its markers; state mat, too")
        if bool(self.mat) != bool(self.plate_height_mm):
            raise ValueError("mat and plate_height_mm belong together: the height of the plate's "
                             "top above the mat, such as {mat: a3, plate_height_mm: 150}")
        return self

    @property
    def height(self) -> Metres:
        """Height of the camera above the plate; infinite for parallel light, NaN if unknown."""
        return math.nan if self.camera_height_mm is None else 1e-3 * self.camera_height_mm


class Description(Specimen, WeighedPiece, Labels):
    """``capture.yaml``; point clouds are projected to ``size_px``, ``face`` is the upper one.
    ``weight_g`` of the whole specimen may stand for the density."""

    depth_unit_m: float | None = Field(
        None, gt=0, title="of the counts of depth pictures; by default that of the recording, or "
                          "0.001", description="0.001 for millimetres")
    intrinsics: Pixels | None = Field(
        None, title="of depth pictures: fx, fy, cx, cy, pixels; of a lens that distorts also k1 to "
                    "k6, p1, p2",
        description="give fx, fy, cx and cy in pixels, as the camera's software states them "
                          "for pictures of this size")
    turns_deg: list[float] | None = Field(
        None, title="angle of the table in each view; required of two or three views, else equal "
                    "parts of a turn",
        description="one angle for each view, such as [0, 90, 180, 270]")
    face: Literal["up", "down"] = Field("up", title="where the fabric's marked face is")
    size_px: list[Annotated[int, Field(ge=1, le=max(MAX_PICTURE))]] | None = Field(
        None, min_length=2, max_length=2, title="width and height of the picture to which the "
                                                "intrinsics of a view in ply belong",
        description="width and height, such as [640, 480]")
    outline: OutlineSource | None = Field(
        None, title="of a photograph or a table: the keys below",
        description="outline is such as {mat: a3, plate_height_mm: 150}, or {plate_px: {x: "
                          "960, y: 540, diameter: 700}, camera_height_mm: 1200}")

    @property
    def marked(self) -> bool:
        """Whether the direction of the warp is stated, or that of the mat's arrow."""
        source = self.outline
        return self.warp_direction_deg is not None or bool(
            source and source.mat and source.arrow == "warp")

    def stated_camera(self, width: int, height: int) -> Intrinsics:
        """The stated intrinsics, of pictures of this size."""
        if self.intrinsics is None:
            remedy = Description.model_fields["intrinsics"].description
            raise InputError(f"intrinsics is missing; {remedy}")
        numbers = self.intrinsics.model_dump(include=set(INTRINSICS_KEYS))
        return Intrinsics(**numbers, width=width, height=height)

    @property
    def lens(self) -> Lens | None:
        """The lens that distorts the pictures, if one is stated."""
        return Lens.of("rational_polynomial", np.array(
            [getattr(self.intrinsics, key, 0.0) for key in LENS_KEYS]))

    def turns(self, count: int) -> Turns:
        """The stated turns of ``count`` views since the first."""
        degrees = self.turns_deg
        example = [round(360 * k / max(count, 4)) for k in range(count)]
        if degrees is None:
            if 1 < count < MIN_EQUAL_TURNS:
                raise InputError(f"turns_deg is missing, and {count} views need not be equally "
                                 "spaced; state the table's angles, such as turns_deg: "
                                 f"{example}")
            return whole_turns(count)
        if len(degrees) != count:
            raise InputError(f"turns_deg={shown(degrees)}: give one angle for each of the {count} "
                             f"views, such as {example}")
        if 0 < (largest := max(map(abs, degrees))) <= MIN_TURN:
            raise InputError(f"turns_deg={shown(degrees)} reach only {largest:.3g}° (a full turn "
                             "in radians is 6.28); give degrees, of views from several sides")
        return np.radians(degrees) - np.radians(degrees[0])


def whole_turns(count: int) -> Turns:
    """Equally spaced turns of the table."""
    return np.arange(count) * (2 * np.pi / count)


def require_size(file: Path | None, width: int, height: int) -> None:
    """InputError for pictures, of a ``file`` or of a recording, with too few or too many pixels."""
    (narrow, low), (wide, high) = MIN_PICTURE, MAX_PICTURE
    if not (narrow <= width <= wide and low <= height <= high):
        raise InputError(f"{'' if file else 'depth pictures: '}{width}x{height} pixels; views have "
                         f"from {narrow}x{low} to {wide}x{high}", source=file or "")


def checked_density(value: object, what: str = "") -> Density:
    """Density from g/m², a number or its text; ``what`` begins the message of an InputError."""
    with suppress(TypeError, ValueError):
        value = float(value) if isinstance(value, str) else value
    return Specimen.of({} if value is None else {"density_g_m2": value}, what).density
