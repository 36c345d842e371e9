"""What ``estimate.json`` states of hanging strips."""

import numpy as np

from common.documents import Excerpt
from common.normal import Linear
from drapenet.evidence.source import Source, of_strips
from drapenet.measured.base import Quantity, Record
from sim.material import MICRO


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


class StripsRecord(Record):
    """Strips of a folder."""

    kind = "strips"
    strips: int
    moduli: dict[str, DirectionStrips]

    @property
    def needs_warp(self) -> bool:
        return bool(self.moduli)

    def sources(self) -> list[Source]:
        return [of_strips(direction, Linear(np.array(moduli.evidence.rows),
                                            np.array(moduli.evidence.values)),
                          MICRO * moduli.alpha_uN_m.median, 1e-3 * self.density_g_m2)
                for direction, moduli in self.moduli.items()]

    def counted(self) -> tuple[int, str, str]:
        return self.strips, "strip", "strips"

    def lines(self) -> list[str]:
        return [f"by strips alone, along the {name}: alpha {moduli.alpha_uN_m} µN·m, beta "
                f"{moduli.beta_nN_m2} nN·m², natural curvature "
                f"{moduli.natural_curvature_1_m:.2g} ± "
                f"{moduli.natural_curvature_deviation_1_m:.1g} 1/m"
                for name, moduli in self.moduli.items()]
