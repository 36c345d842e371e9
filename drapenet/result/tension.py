"""What ``estimate.json`` states of strips under weights."""

from typing import TYPE_CHECKING

from pydantic import Field

from common.documents import Excerpt
from common.files import printable
from data.readings.known import Known
from drapenet.result.quantity import Quantity, Recorded, Text, intervals
from sim.material import DIRECTIONS

if TYPE_CHECKING:
    from data.tension.folder import TensionSet


class Stretch(Excerpt):
    """Along the yarns."""

    warp: Quantity
    weft: Quantity


class TensionRecord(Excerpt):
    """Strips under weights: stiffnesses at the fabric's density, ``measured`` or of usual fabrics.
    """

    source: Text
    density_g_m2: float
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
    known: Known | None = None

    @classmethod
    def of_strips(cls, tension: "TensionSet") -> "TensionRecord":
        """Of strips, estimated."""
        found = tension.evidence
        warp, weft, shear = found.stiffness
        names = [DIRECTIONS[k] for k in found.measured]
        return cls.model_validate({
            "source": printable(tension.path), "density_g_m2": round(1e3 * tension.density, 6),
            "strips": len(tension.strips), "measured": names,
            "shear_n_per_m": intervals(shear),
            "stretch_n_per_m": {"warp": intervals(warp), "weft": intervals(weft)},
            "friction_n_per_m": {name: float(found.friction[DIRECTIONS.index(name)])
                                 for name in tension.directions},
            "weight_for_10_percent_g": tension.loads(found),
            "readings": {key: intervals(values) for key, values in found.readings().items()},
            "along_yarns": tension.along_yarns, "findings": list(found.findings),
            "known": tension.known})

    @property
    def rows(self) -> list[tuple[str, str, Quantity]]:
        """The direction of the strips, name and value, N/m, of each stiffness."""
        return [("warp", "stretch along the warp", self.stretch_n_per_m.warp),
                ("bias", "shear", self.shear_n_per_m),
                ("weft", "stretch along the weft", self.stretch_n_per_m.weft)]

    def measured_along(self, direction: str) -> Quantity | None:
        """Stretch along warp or weft, or for the bias shear, N/m; None if not measured."""
        return next((value for key, _, value in self.rows
                     if key == direction and key in self.measured), None)

    @property
    def lines(self) -> list[str]:
        """The stiffnesses in words."""
        found = [f"{name} {value} N/m" + ("" if direction in self.measured else
                                          ", not measured: of usual fabrics")
                 for direction, name, value in self.rows]
        loads = ", ".join(f"{direction} {value:.0f} g" for direction, value in
                          self.weight_for_10_percent_g.items())
        return found + [f"weight that stretches these strips by 10 %: {loads}"] * bool(loads)
