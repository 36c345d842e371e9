"""What ``estimate.json`` states of strips under weights."""

import math

from pydantic import Field

from common.documents import Excerpt
from drapenet.measured.base import Quantity, Record, Recorded
from sim.material import REFERENCE_DENSITY

COLUMNS = {"warp": "stretch_warp_n_per_m", "weft": "stretch_weft_n_per_m",
           "bias": "shear_n_per_m"}
"""Of tables, by the direction of the strips."""


class Stretch(Excerpt):
    """Along the yarns."""

    warp: Quantity
    weft: Quantity


class TensionRecord(Record):
    """Strips under weights: stiffnesses at the fabric's density, measured or of usual fabrics."""

    kind = "tension"
    names = tuple(COLUMNS.values())
    strips: int
    measured: list[str] = Field(title="directions; the others have values of usual fabrics")
    shear_n_per_m: Quantity = Field(title="shear stiffness")
    stretch_n_per_m: Stretch = Field(title="along warp and weft")
    friction_n_per_m: dict[str, float] = Field(title="borne before yarns slip, by direction")
    weight_for_10_percent_g: dict[str, float] = Field(
        title="that would stretch these strips by 10 %")
    readings: dict[str, Quantity] = Field(
        title="what FAST-3 (EB5, E100) and KES-FB1 (G) would read")
    along_yarns: bool
    findings: list[Recorded]

    @property
    def needs_warp(self) -> bool:
        return self.along_yarns

    @property
    def membrane(self) -> float | None:
        stretch = self.along("warp"), self.along("weft")
        return math.prod(one.median for one in stretch if one) ** 0.5 * 1e3 * (
            REFERENCE_DENSITY / self.density_g_m2) if all(stretch) else None

    def counted(self) -> tuple[int, str, str]:
        return (self.strips, "strip under a weight", "strips under weights") if (
            self.weight_for_10_percent_g) else (
            self.strips, "value of a tester", "values of testers")

    @property
    def rows(self) -> list[tuple[str, str, Quantity]]:
        """The direction of the strips, name and value, N/m, of each stiffness."""
        return [("warp", "stretch along the warp", self.stretch_n_per_m.warp),
                ("bias", "shear", self.shear_n_per_m),
                ("weft", "stretch along the weft", self.stretch_n_per_m.weft)]

    def along(self, direction: str, *, usual: bool = False) -> Quantity | None:
        return next((value for key, _, value in self.rows
                     if key == direction and (usual or key in self.measured)), None)

    def columns(self) -> dict[str, Quantity | None]:
        return {name: self.along(direction) for direction, name in COLUMNS.items()}

    def lines(self) -> list[str]:
        found = [f"{name} {value} N/m" + ("" if direction in self.measured else
                                          ", not measured: of usual fabrics")
                 for direction, name, value in self.rows]
        loads = ", ".join(f"{direction} {value:.0f} g" for direction, value in
                          self.weight_for_10_percent_g.items())
        found += [f"weight that stretches these strips by 10 %: {loads}"] * bool(loads)
        return [f"by {self.counted()[2]}: {line}" for line in found]
