"""A further kind of measurement: a disc whose mass and diameter give the density of the fabric."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, model_validator

from common.files import printable
from drapenet.measured.base import Described, Measured, Prior, Quantity, Record, intervals

FILE = "disc.yaml"
BALANCE = 0.01  # g, standard deviation of a reading


def density(mass_g: float, diameter_mm: float) -> float:
    """g/m²."""
    return mass_g / (np.pi * (5e-4 * diameter_mm) ** 2)


class DiscDescription(Described):
    """``disc.yaml``."""

    file, content = FILE, "mass_g and diameter_mm"
    remedy = "mass_g and diameter_mm are those of the disc"
    mass_g: float = Field(gt=0, le=1000, title="mass of the disc")
    diameter_mm: float = Field(ge=50, le=1000, title="diameter of the disc")

    @model_validator(mode="before")
    @classmethod
    def _weighed(cls, content: Any) -> Any:
        """The content, with the density that the disc has."""
        given = [content.get(key) for key in ("mass_g", "diameter_mm")]
        if not all(isinstance(value, int | float) and value > 0 for value in given):
            return content
        return {**content, "density_g_m2": density(*given)}


class DiscRecord(Record):
    """The density with the error of the balance."""

    kind = "disc"
    weighed_g_m2: Quantity

    def counted(self) -> tuple[int, str, str]:
        """One disc."""
        return 1, "weighed disc", "weighed discs"

    def lines(self) -> list[str]:
        """The density."""
        return [f"weighed disc: {self.weighed_g_m2} g/m²"]

    def columns(self) -> dict[str, Quantity | None]:
        """The same."""
        return {"weighed_g_m2": self.weighed_g_m2}


@dataclass(frozen=True, kw_only=True)
class WeighedDisc(Measured):
    """A disc on a balance."""

    name, noun, schema, recorded = "disc", "weighed discs", DiscDescription, DiscRecord
    error: float

    @classmethod
    def read(cls, place: Path, stated: Mapping[str, Any]) -> "WeighedDisc":
        """Read a folder."""
        found = DiscDescription.in_folder(place)
        return cls(**found.common(place), error=density(BALANCE, found.diameter_mm))

    def record(self, prior: Prior) -> DiscRecord:
        """The density, of which the stiffness is not known better."""
        samples = np.random.default_rng(0).normal(1e3 * self.density, self.error, 4000)
        return DiscRecord.model_validate({
            "source": printable(self.path), "density_g_m2": round(1e3 * self.density, 6),
            "known": self.known, "weighed_g_m2": intervals(samples)})
