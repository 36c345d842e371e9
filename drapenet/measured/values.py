"""Values of testers without any picture: bending, stretch and shear, a drape coefficient."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from pydantic import model_validator

from common.files import printable
from data.captures.capture import ReportedCapture
from data.captures.description import WeighedPiece
from data.readings.known import Reported
from drapenet.measured.base import Observed, Prior, Record
from drapenet.measured.captures import observe
from drapenet.measured.tension.description import TensionDescription
from drapenet.measured.tension.folder import TensionSet, described_strips
from sim.rig import Rig

FILE = "values.yaml"


class ValuesDescription(WeighedPiece, TensionDescription):
    """``values.yaml``: the keys of ``tension.yaml``, and a drape coefficient in ``known``."""

    remedy = "docs/use.md shows an example"
    nothing: ClassVar[str] = ("nothing tells how it bends or stretches; a strip and a ruler are "
                              "enough: known, such as overhang_mm: {warp: 44}; or give "
                              "bending_length_mm, or stretch and shear, as kes_g_gf_per_cm_deg")
    file, content, typed = FILE, "density_g_m2 and known, or stretch and shear", False

    @property
    def measures(self) -> bool:
        return super().measures or self.reported or bool(self.known and self.known.values())

    @model_validator(mode="after")
    def _of_a_tester(self) -> "ValuesDescription":
        if self.reported and self.tester is None:
            raise ValueError("known has a drape coefficient without its tester; give tester, such "
                             "as disc300_support180")
        return self


class ValuesRecord(Record):
    """Values alone, which are its ``known``."""

    kind = "values"

    def counted(self) -> tuple[int, str, str]:
        return 0, "value", "values"


@dataclass(frozen=True, kw_only=True)
class ValueSet(TensionSet):
    """The values of one fabric; a drape coefficient among them is read by the network."""

    name, noun, schema = "values", "values of testers", ValuesDescription
    recorded = ValuesRecord
    rig: Rig | None = None  # of the drape coefficient

    @classmethod
    def read(cls, place: Path, stated: Mapping[str, Any]) -> "ValueSet":
        return cls.of(ValuesDescription.in_folder(place), place)

    @classmethod
    def of(cls, description: ValuesDescription, path: Path) -> "ValueSet":
        """What a description at a path states."""
        return described_strips(cls, description, path.parent if path.is_file() else path,
                                rig=description.tester).changed(path=path)

    @property
    def capture(self) -> ReportedCapture | None:
        """The drape coefficient, if one is stated, of cloth whose directions all have names."""
        if not (self.rig and isinstance(self.known, Reported)
                and self.known.drape_coefficient_percent):
            return None
        return ReportedCapture(density=self.density, rig=self.rig, warp_direction=0.0,
                               path=self.path, known=self.known, labels=self.labels,
                               warnings=self.warnings)

    @property
    def marked(self) -> bool | None:
        return True if self.capture else None

    def observed(self) -> Observed | None:
        return observe(self.capture) if self.capture else None

    def record(self, prior: Prior) -> Record | None:  # type: ignore[override]
        known = None if self.capture else self.known  # which the capture has
        if self.alone:
            return super().record(prior).model_copy(update={"known": known})
        return None if self.capture else ValuesRecord(
            source=printable(self.path), density_g_m2=round(1e3 * self.density, 6), known=known)
