"""What a laboratory knows already of a fabric: the key ``known`` of ``capture.yaml``."""

from typing import Annotated

from pydantic import Field

from common.documents import Schema

ERRORS = {"bending_length_mm": 0.05, "kes_b_gf_cm2_per_cm": 0.10, "kes_2hb_gf_cm_per_cm": 0.15,
          "membrane_n_per_m": 0.20, "hysteresis_share": 0.20}
"""Relative standard deviations, between specimens and operators, of values without a stated error.
Assumed: the standards at hand state none for these quantities."""
_Positive = Annotated[float, Field(gt=0)]
_Errors = dict[str, Annotated[float, Field(gt=0, le=100)]]


class ByDirection(Schema):
    """Values along warp, bias and weft."""

    warp: _Positive | None = None
    bias: _Positive | None = None
    weft: _Positive | None = None


class Known(Schema):
    """The key ``known`` of ``capture.yaml``; at the fabric's density."""

    bending_length_mm: ByDirection = ByDirection()
    kes_b_gf_cm2_per_cm: ByDirection = ByDirection()
    kes_2hb_gf_cm_per_cm: ByDirection = ByDirection()
    membrane_n_per_m: _Positive | None = None
    hysteresis_share: Annotated[float, Field(gt=0, lt=1)] | None = None
    drape_coefficient_percent: Annotated[float, Field(gt=0, lt=100)] | None = None
    nodes: Annotated[int, Field(ge=0, le=30)] | None = None
    error_percent: _Errors = Field(default_factory=dict)

    def values(self) -> dict[tuple[str, int], float]:
        """Values by quantity and direction, 0 for those without one, but those of pictures."""
        found: dict[tuple[str, int], float] = {}
        for name in ERRORS:
            stated = getattr(self, name)
            if isinstance(stated, ByDirection):
                found |= {(name, k): value for k, value in
                          enumerate(stated.model_dump().values()) if value is not None}
            elif stated is not None:
                found[name, 0] = stated
        return found

    def error(self, name: str) -> float:
        """Relative standard deviation of a quantity."""
        return self.error_percent.get(name, 100 * ERRORS[name]) / 100
