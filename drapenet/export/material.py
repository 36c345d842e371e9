"""Material for exports: moduli of an estimate, and of hinges on the meshes of other tools."""

import hashlib
import json
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from common.documents import Schema
from common.errors import InputError
from common.findings import Finding, texts
from common.types import Density, Moduli, QuadraticModuli
from data.captures.description import MAX_LABEL_LENGTH, PRINTABLE
from drapenet.result.document import EstimateDocument
from drapenet.result.files import ESTIMATE, read_document, result_name
from sim.energies.hinges import mean_modulus
from sim.material import (
    BIAS,
    DIRECTIONS,
    DRAPE_CURVATURE,
    MICRO,
    NANO,
    SOFTENING_LIMIT,
    WARP,
    WEFT,
    secant,
)
from sim.rig import DISC_RIG, GRAVITY, Rig

MESHES = {"unstructured": ("random", 0.2), "alternating": ("alternating", 0.0),
          "equal": ("equal", 0.0), "random": ("random", 0.0)}
"""Diagonals and jitter (:func:`sim.mesh.strip`) of the meshes that a tool may have."""
MIN_CELLS, MAX_CELLS = 6, 40  # along the strip that calibrates a mesh
_POWER = -3.0  # of the mean over directions
GAMMA = 10.0  # rho g L³/alpha of that strip, similar to that of hanging cloth in a drape
BESIDE = {"stretch_warp": "stretch along the warp", "stretch_weft": "stretch along the weft",
          "shear": "shear", "thickness_mm": "thickness", "friction": "friction"}
"""What tools ask for beside bending and weight, by its key in :attr:`Material.known`."""


class ExportSettings(Schema):
    """What a user states for an export: ``configs/export.yaml``."""

    curvature_1_m: float = Field(DRAPE_CURVATURE, ge=0, le=1000)
    mesh: Literal[tuple(MESHES)] = "unstructured"  # type: ignore[valid-type]
    edge_mm: float = Field(5.0, ge=0.1, le=100)
    name: str = Field("", max_length=MAX_LABEL_LENGTH, pattern=PRINTABLE,
                      description=f"up to {MAX_LABEL_LENGTH} printable characters")


class Buckling(NamedTuple):
    """Two bending stiffnesses of a hinge: one up to an angle, and a share of it beyond.

    Attributes:
        modulus: (3,) N·m, of a hinge that is bent by less than pi (1 - ratio).
        share: (3,) of it, at most 1, of one that is bent further.
        ratio: 0: no hinge buckles.
    """

    modulus: Moduli
    share: np.ndarray
    ratio: float


@dataclass(frozen=True)
class Material:
    """An estimate with the settings of an export; moduli are medians, the first yarns warp."""

    document: EstimateDocument
    settings: ExportSettings
    identity: str  # SHA-256 of estimate.json
    written: str  # its modification time, ISO 8601

    @property
    def alpha(self) -> Moduli:
        """Linear moduli."""
        return MICRO * np.array([moduli.alpha_uN_m.median
                                 for moduli in self.document.moduli.values()])

    @property
    def beta(self) -> QuadraticModuli:
        """Quadratic moduli."""
        return NANO * np.array([moduli.beta_nN_m2.median
                                for moduli in self.document.moduli.values()])

    @property
    def density(self) -> Density:
        """Of the fabric."""
        return self.document.density

    @property
    def modulus(self) -> Moduli:
        """The secant of the torque at the stated curvature: by default the stiffness in a drape, as
        the estimate states it."""
        curvature = self.settings.curvature_1_m
        stated = [moduli.drape_stiffness_uN_m for moduli in self.document.moduli.values()]
        if curvature == DRAPE_CURVATURE and all(stated):
            return MICRO * np.array([value.median for value in stated if value])
        return secant(curvature, self.alpha, self.beta)

    @property
    def one_modulus(self) -> float:
        """For tools that bend alike in all directions, N·m: a mean of :attr:`modulus` along warp,
        weft and both biases, near the soft ones because cloth folds about them.
        Its power is that which discs of 30 fabrics of the prior need."""
        return float(np.mean(self.modulus[[WARP, BIAS, WEFT, BIAS]] ** _POWER) ** (1 / _POWER))

    @property
    def buckling(self) -> Buckling:
        """For tools whose hinges soften at an angle, in a mesh of equal sides: the law has the
        torque of the fabric at half the stated curvature and at one and a half of it. Cloth that
        stiffens does not buckle: their share is at most 1.
        """
        curvature = self.settings.curvature_1_m
        height = np.sqrt(3) / 2 * 1e-3 * self.settings.edge_mm
        ratio = float(max(0.0, 1 - curvature * height / np.pi))
        flat, bent = (secant(part * curvature, self.alpha, self.beta) for part in (0.5, 1.5))
        buckles = (bent < flat) & (ratio > 0)
        return Buckling(np.where(buckles, flat, self.modulus), np.where(buckles, bent / flat, 1.0),
                        ratio * bool(buckles.any()))

    @property
    def known(self) -> dict[str, float]:
        """What is known of the fabric beside bending and weight, of :data:`BESIDE`: stretch and
        shear in N/m as measured, thickness in mm and the coefficient of friction of the fabric on
        itself as stated. Beside the measured stretch of one yarn stands the :attr:`usual` one of
        the other, for a tool's default may be a hundredth of it."""
        found = self.usual | self._measured()
        for one in self.document.stated:
            if one.thickness_mm:
                found.setdefault("thickness_mm", one.thickness_mm)
            if one.friction_deg and one.friction_deg.fabric:
                found.setdefault("friction", float(np.tan(np.radians(one.friction_deg.fabric))))
        return found

    def _measured(self, *, usual: bool = False) -> dict[str, float]:
        return {key: value.median for record in self.document.records for key, direction in zip(
            BESIDE, ("warp", "weft", "bias"), strict=False)
            if (value := record.along(direction, usual=usual))}

    @property
    def usual(self) -> dict[str, float]:
        """Stretch, N/m, that was not measured where that of the other yarns was."""
        yarns = {"stretch_warp", "stretch_weft"}
        unmeasured = yarns - {*self._measured()}
        return {key: value for key, value in self._measured(usual=True).items()
                if len(unmeasured) == 1 and key in unmeasured}

    @property
    def stretch(self) -> tuple[float, float] | None:
        """Of warp and weft, N/m; None unless one was measured."""
        warp, weft = (self.known.get(key) for key in ("stretch_warp", "stretch_weft"))
        return (warp, weft) if warp and weft else None

    @property
    def shear(self) -> float | None:
        """N/m; None unless it was measured."""
        return self.known.get("shear")

    @property
    def not_known(self) -> list[str]:
        """What tools ask for beside bending and weight and the estimate does not state."""
        known = self.known
        return [name for key, name in BESIDE.items() if key not in known]

    @property
    def captured(self) -> dict[str, Any]:
        """Tester, sides of the specimen and diameter of the plate, m, of the first capture over a
        plate, or else of the common disc; and the captured drape coefficient, % or None."""
        document = self.document
        shown = [part.capture for part in document.captures or []] or [document.capture]
        over_plates = [(rig, one.drape_coefficient_percent) for one in shown
                       for name in one.rig.split(", ") if name
                       and (rig := Rig.from_name(name)).has_plate]
        rig, percent = over_plates[0] if over_plates else (DISC_RIG, None)
        return {"tester": rig.name, "plate": rig.plate_diameter, "captured_percent": percent,
                "specimen": list(rig.sides)[:1 if rig.specimen == "disc" else 2]}

    @property
    def name(self) -> str:
        """The fabric's, for display."""
        capture = self.document.capture
        sources = capture.sources or [capture.source or ""]
        if name := self.settings.name or capture.labels.fabric:
            return name
        if not all(source and source.isprintable() for source in sources):
            return "fabric"
        return result_name([Path(source) for source in sources])[-MAX_LABEL_LENGTH:]

    @property
    def _fold_mm(self) -> float:
        return float(1e3 * np.cbrt(GAMMA * mean_modulus(self.modulus) / (self.density * GRAVITY)))

    @property
    def _cells(self) -> int:
        """Number of the mesh's edges along a fold."""
        return round(self._fold_mm / self.settings.edge_mm)

    @property
    def coarse(self) -> Finding | None:
        """That the mesh's edges are too long to show folds, if they are."""
        return Finding("edges_coarse", {
            "value": self.settings.edge_mm, "fold": self._fold_mm,
            "limit": self._fold_mm / MIN_CELLS}) if self._cells < MIN_CELLS else None

    @property
    def ratio(self) -> float:
        """Modulus of hinges on the mesh over that of the equivalent plate."""
        if coarse := self.coarse:
            raise InputError(coarse.text)
        return hinge_ratio(self.settings.mesh, self._cells)

    @property
    def about(self) -> dict[str, Any]:
        """Metadata in JSON's types."""
        content, curvature = self.document.content(), self.settings.curvature_1_m
        capture = content["capture"]
        document = self.document
        found = [*document.warnings, *(document.advice or []), *document.mostly_usual,
                 *filter(None, [self.coarse])]
        if document.names != DIRECTIONS:
            found.append(Finding("warp_unmarked"))
        outside = np.any(-self.beta * curvature > SOFTENING_LIMIT * self.alpha)
        if outside and curvature > DRAPE_CURVATURE:  # up to there drapes show what it stands for
            found.append(Finding("curvature_outside_law", {"value": curvature}))
        return {
            "made_by": "drapenet",
            "name": self.name,
            "estimate_sha256": self.identity,
            "source": capture.get("source") or capture.get("sources"),
            "density_g_m2": capture["density_g_m2"],
            "directions": content["convention"],
            "rig": capture["rig"],
            "drape_coefficient_percent": self.captured["captured_percent"],
            "moduli": content["moduli"],
            "modulus_at_curvature_1_m": curvature,
            "modulus_over_alpha": (self.modulus / self.alpha).round(3).tolist(),
            "not_known": self.not_known, "assumed": texts([*document.assumed, *(
                Finding("stretch_usual", {"what": BESIDE[key], "value": value})
                for key, value in self.usual.items())]),
            "warnings": texts(found),
        }

    @property
    def about_edges(self) -> dict[str, Any]:
        """:attr:`about`, with the edges that :attr:`buckling` is valid for."""
        return self.about | {"edge_mm": round(self.settings.edge_mm, 6)}

    @property
    def about_hinges(self) -> dict[str, Any]:
        """:attr:`about`, with the mesh that the moduli are valid for."""
        return self.about_edges | {"mesh": self.settings.mesh,
                                   "hinge_over_plate_modulus": round(self.ratio, 4)}


def hinge_ratio(mesh: str, cells: int) -> float:
    """Modulus of hinges over that of the equivalent plate, constant beyond :data:`MAX_CELLS`.
    """
    file = Path(__file__).parents[1] / "weights" / "hinges.json"
    ratios = json.loads(file.read_text(encoding="utf-8"))
    return ratios[mesh][min(cells, MAX_CELLS) - MIN_CELLS]


def read_material(path: str | Path, **settings: object) -> Material:
    """Read an ``estimate.json``, or that in a folder, with settings of :class:`ExportSettings`."""
    path = Path(path) / ESTIMATE if Path(path).is_dir() else Path(path)
    checked, document = ExportSettings.of(settings, ""), read_document(path)
    written = datetime.fromtimestamp(path.stat().st_mtime, timezone.utc)
    return Material(document, checked, hashlib.sha256(path.read_bytes()).hexdigest(),
                    f"{written:%Y-%m-%dT%H:%M:%SZ}")
