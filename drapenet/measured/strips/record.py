"""What ``estimate.json`` states of hanging strips."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from common.documents import Excerpt
from common.files import printable
from data.readings.known import Known
from drapenet.measured.base import Quantity, Text, intervals
from sim.material import MICRO, NANO

if TYPE_CHECKING:
    from drapenet.measured.strips.folder import StripSet
    from drapenet.measured.strips.posterior import StripEvidence


class LinearRecord(Excerpt):
    """Evidence of log alpha (N·m), beta/alpha (m) and natural curvature (1/m) at the fabric's
    density: :class:`common.normal.Linear`."""

    rows: list[list[float]]
    values: list[float]


class DirectionStrips(Excerpt):
    """Moduli along one direction by its strips alone."""

    alpha_uN_m: Quantity  # noqa: N815
    beta_nN_m2: Quantity  # noqa: N815
    natural_curvature_1_m: float
    natural_curvature_deviation_1_m: float
    misfit: float
    scatter_of_specimens_percent: float
    evidence: LinearRecord


class StripsRecord(Excerpt):
    """Strips of a folder."""

    source: Text
    density_g_m2: float
    strips: int
    moduli: dict[str, DirectionStrips]
    known: Known | None = None

    @classmethod
    def of_evidence(
        cls, strips: "StripSet", found: Mapping[str, "StripEvidence"]
    ) -> "StripsRecord":
        """Of strips with their evidence by direction."""
        moduli = {}
        for direction, strip in found.items():
            alpha, beta = strip.samples()
            moduli[direction] = {
                "alpha_uN_m": intervals(alpha / MICRO), "beta_nN_m2": intervals(beta / NANO),
                "natural_curvature_1_m": strip.curl[0],
                "natural_curvature_deviation_1_m": strip.curl[1], "misfit": strip.misfit,
                "scatter_of_specimens_percent": round(100 * strip.scatter, 1),
                "evidence": {"rows": strip.measured.rows.tolist(),
                             "values": strip.measured.values.tolist()}}
        return cls.model_validate({
            "source": printable(strips.path), "density_g_m2": round(1e3 * strips.density, 6),
            "strips": len(strips), "moduli": moduli, "known": strips.known})
