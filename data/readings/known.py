"""What a laboratory knows already of a fabric: the key ``known`` of ``capture.yaml`` and
``strips.yaml``, with the keys of :data:`data.readings.QUANTITIES`."""

from typing import Annotated, Any, Literal

from pydantic import Field, create_model, field_validator, model_validator

from common.documents import Schema
from data.fabrics.nuisances import KINDS
from data.readings import QUANTITIES
from sim.material import DIRECTIONS

MIN_COEFFICIENT = 0.02  # of a drape, from 0 to 1; the plate alone has 0
_Positive = Annotated[float, Field(gt=0)]


class ByDirection(Schema):
    """Values along warp, bias and weft."""

    warp: _Positive | None = None
    bias: _Positive | None = None
    weft: _Positive | None = None


_Slope = Annotated[float, Field(ge=3, le=70)]


class Friction(Schema):
    """Slope, in degrees, at which a piece of the fabric begins to slide."""

    fabric: _Slope | None = None  # on the fabric itself
    board: _Slope | None = None


class _Stated(Schema):
    """At the fabric's density; thickness and friction are not evidence, and go into exports, the
    kind of cloth is read by networks that know kinds."""

    remedy = ("known has values such as bending_length_mm: {warp: 22, weft: 18} or "
              "membrane_n_per_m: 600, and error_percent; stretch_warp_n_per_m, shear_n_per_m and "
              "values of FAST-3 and KES-FB1 stand beside it, in values.yaml or tension.yaml")
    error_percent: dict[str, Annotated[float, Field(gt=0, le=100)]] = Field(
        default_factory=dict, title="standard deviations in place of the assumed ones, such as "
                                    "{bending_length_mm: 3}")
    cloth: Literal[KINDS] | None = Field(  # type: ignore[valid-type]
        None, title="no evidence: kind of cloth, for networks that read it; coated: also films")
    thickness_mm: float | None = Field(None, ge=0.03, le=10, title="thickness, no evidence")
    thickness_kpa: float | None = Field(
        None, ge=0.01, le=100, title="pressure at which it was measured; of a book on A4 0.2")
    friction_deg: Friction | None = Field(
        None, title="no evidence: slopes, 3 to 70, at which the fabric slides on itself and on a "
                    "board: {fabric: 24, board: 18.5}")

    @model_validator(mode="after")
    def _pressed(self) -> "_Stated":
        if self.thickness_kpa is not None and self.thickness_mm is None:
            raise ValueError("has thickness_kpa, the pressure of a thickness; give thickness_mm")
        return self

    @model_validator(mode="after")
    def _of_cloth(self) -> "_Stated":
        for (name, k), value in self.values().items():
            low, high = QUANTITIES[name].limits
            if not low <= value <= high:
                raise ValueError(f"has {QUANTITIES[name].stated(k, value)}; it must be {low:g} to "
                                 f"{high:g}: check unit and decimal point")
        return self

    @field_validator("error_percent")
    @classmethod
    def _of_quantities(cls, errors: dict[str, float]) -> dict[str, float]:
        for name in errors:
            if name not in QUANTITIES:
                raise ValueError(f"has no quantity {name}; it has {', '.join(QUANTITIES)}")
        return errors

    def values(self) -> dict[tuple[str, int], float]:
        """Values by quantity and direction, 0 for those without one."""
        found: dict[tuple[str, int], float] = {}
        for name in QUANTITIES:
            stated = getattr(self, name)
            if isinstance(stated, ByDirection):
                found |= {(name, k): value for k, direction in enumerate(DIRECTIONS)
                          if (value := getattr(stated, direction)) is not None}
            elif stated is not None:
                found[name, 0] = stated
        return found

    @property
    def handling(self) -> list[str]:
        """Kind, thickness and friction in words."""
        slopes = self.friction_deg.model_dump(exclude_none=True) if self.friction_deg else {}
        found = [f"slides on {name} at: {value:g}°" for name, value in slopes.items()]
        if self.thickness_mm is not None:
            pressure = f"{self.thickness_kpa:g} kPa" if self.thickness_kpa else "unknown pressure"
            found.insert(0, f"thickness: {self.thickness_mm:g} mm at {pressure}")
        return [f"kind of cloth: {self.cloth}", *found] if self.cloth else found

    @property
    def along_yarns(self) -> bool:
        """Whether any value is along warp, bias or weft."""
        return any(QUANTITIES[name].directions > 1 for name, _ in self.values())

    def error(self, name: str) -> float:
        """Relative standard deviation of a quantity."""
        return self.error_percent.get(name, 100 * QUANTITIES[name].error) / 100


_FIELDS: dict[str, Any] = {
    name: (ByDirection | None if each.directions > 1 else _Positive | None, None)
    for name, each in QUANTITIES.items()}
Known = create_model("Known", __base__=_Stated, **_FIELDS)
"""Content of the key ``known``."""


class Reported(Known):
    """Values of testers, and what a drape tester without pictures reports."""

    drape_coefficient_percent: float | None = Field(
        None, gt=0, lt=100, title="of a capture without pictures")
    nodes: int | None = Field(None, ge=0, le=30, title="number of its folds")

    @field_validator("drape_coefficient_percent")
    @classmethod
    def _of_cloth_on_a_plate(cls, percent: float | None) -> float | None:
        if percent is not None and percent < 100 * MIN_COEFFICIENT:
            raise ValueError(f"is too small for a drape; a share? {percent:g} is "
                             f"{100 * percent:g} %")
        return percent
