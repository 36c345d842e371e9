"""Material for exports: alpha and beta of an estimate, or one modulus per direction, and the
modulus of hinges on the meshes of other tools.
"""

import hashlib
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from common.documents import Excerpt, parse_json, read_bytes, shown
from common.errors import InputError
from drapenet.export.hinges import GAMMA, MESHES, MIN_CELLS, hinge_ratio
from drapenet.result.content import SCHEMA, SCHEMA_VERSION
from drapenet.result.output import ESTIMATE, result_name
from sim.energies.hinges import mean_modulus
from sim.material import DIRECTIONS, MICRO, NANO, SOFTENING_LIMIT, STIFF_SOFT, torque
from sim.rig import GRAVITY

MAX_ESTIMATE_BYTES = 8 << 20  # bytes
MAX_NAME_LENGTH = 80  # characters

_Interval = Annotated[list[float], Field(min_length=2, max_length=2)]


class _Quantity(Excerpt):
    median: float
    interval_68: _Interval
    interval_90: _Interval


class _Positive(_Quantity):
    median: float = Field(gt=0)


class _Direction(Excerpt):
    alpha_uN_m: _Positive  # noqa: N815 (the file's own name)
    beta_nN_m2: _Quantity  # noqa: N815


class _Capture(Excerpt):
    density_g_m2: float = Field(gt=0)


class EstimateFile(Excerpt):
    """The keys that are read of an ``estimate.json``."""

    remedy = "give the estimate.json that infer.py writes"
    convention: Literal["warp/weft", "stiff/soft"]
    capture: _Capture
    moduli: dict[str, _Direction]
    warnings: list[str]

    @model_validator(mode="after")
    def _named(self) -> "EstimateFile":
        if tuple(self.moduli) not in (DIRECTIONS, STIFF_SOFT):
            raise ValueError(f"moduli: the directions {shown(list(self.moduli))} are unknown")
        return self


@dataclass(frozen=True)
class Material:
    """An estimate with the settings of an export.

    Attributes:
        alpha: (3,) N·m, median linear moduli of the first yarns (warp), bias, second yarns (weft).
        beta: (3,) N·m², quadratic.
        density: kg/m².
        curvature: 1/m, of the secant modulus; 0: alpha.
        mesh: name of :data:`MESHES`; edge: m.
        name: of the fabric, for display.
        content: of ``estimate.json``.
        identity: SHA-256 of that file.
        written: its modification time, ISO 8601.
    """

    alpha: np.ndarray
    beta: np.ndarray
    density: float
    curvature: float
    mesh: str
    edge: float
    name: str
    content: dict[str, Any]
    identity: str
    written: str

    @property
    def modulus(self) -> np.ndarray:
        """(3,) N·m: alpha, or the secant of the torque at :attr:`curvature`."""
        if not self.curvature:
            return self.alpha
        return torque(np.array(self.curvature), self.alpha, self.beta) / self.curvature

    @property
    def ratio(self) -> float:
        """Modulus of hinges on the mesh over that of the equivalent plate."""
        natural = np.cbrt(GAMMA * mean_modulus(self.modulus) / (self.density * GRAVITY))
        cells = round(natural / self.edge)
        if cells < MIN_CELLS:
            raise InputError(f"edge_mm={1e3 * self.edge:g} is too coarse for this fabric, whose "
                             f"folds are about {1e3 * natural:.0f} mm long; at most "
                             f"{1e3 * natural / MIN_CELLS:.1f}")
        return hinge_ratio(self.mesh, cells)

    @property
    def about(self) -> dict[str, Any]:
        """Metadata for exports, with intervals and warnings, in JSON's types."""
        capture = self.content["capture"]
        first = self.content["convention"].partition("/")[0]
        notes = [] if first == DIRECTIONS[0] else [
            "warp stands for the stiffer yarns and weft for the softer: the capture does not mark "
            "the warp"]
        if np.any(-self.beta * self.curvature > SOFTENING_LIMIT * self.alpha):
            notes.append(f"curvature_1_m={self.curvature:g} is outside the law: the "
                         "torque is continued as a straight line there")
        return {
            "made_by": "drapenet", "name": self.name, "estimate_sha256": self.identity,
            "source": capture.get("source") or capture.get("sources"),
            "density_g_m2": capture["density_g_m2"], "directions": self.content["convention"],
            "moduli": self.content["moduli"], "modulus_at_curvature_1_m": self.curvature,
            "warnings": [*self.content["warnings"], *notes],
        }

    @property
    def about_hinges(self) -> dict[str, Any]:
        """:attr:`about`, with the mesh that the moduli are valid for."""
        return self.about | {"mesh": self.mesh, "edge_mm": round(1e3 * self.edge, 6),
                             "hinge_over_plate_modulus": round(self.ratio, 4)}


def read_material(
    path: Path, *, curvature: float = 0.0, mesh: str = "unstructured", edge: float = 5e-3,
    name: str = "",
) -> Material:
    """The fabric of an ``estimate.json``, or of that in a folder; arguments as the attributes of
    :class:`Material`, an empty ``name`` is that of the captures.

    Raises:
        InputError: no such file, another kind of file, or an argument out of range.
    """
    if mesh not in MESHES:
        raise InputError(f"mesh={mesh} is unknown; choose from {', '.join(MESHES)}")
    if not 1e-4 <= edge <= 0.1:
        raise InputError(f"edge_mm={1e3 * edge:g} must lie between 0.1 and 100")
    if not 0 <= curvature <= 1000:
        raise InputError(f"curvature_1_m={curvature:g} must lie between 0 and 1000")
    if len(name) > MAX_NAME_LENGTH or not name.isprintable():
        raise InputError(f"name= must be at most {MAX_NAME_LENGTH} printable characters")
    path = path / ESTIMATE if path.is_dir() else path
    data = read_bytes(path, MAX_ESTIMATE_BYTES, "file estimate.json")
    written = datetime.fromtimestamp(path.stat().st_mtime, timezone.utc)
    content = parse_json(data, path, EstimateFile.remedy)
    if not isinstance(content, dict) or [content.get(key) for key in ("schema", "schema_version")
                                         ] != [SCHEMA, SCHEMA_VERSION]:
        raise InputError(f"{path} is not an estimate of version {SCHEMA_VERSION}; estimate the "
                         "capture again")
    found = EstimateFile.of(content, path)
    alpha, beta = ([getattr(direction, key).median for direction in found.moduli.values()]
                   for key in ("alpha_uN_m", "beta_nN_m2"))
    return Material(MICRO * np.array(alpha), NANO * np.array(beta),
                    1e-3 * found.capture.density_g_m2, curvature, mesh, edge,
                    name or _captured_name(content["capture"]), content,
                    hashlib.sha256(data).hexdigest(), f"{written:%Y-%m-%dT%H:%M:%SZ}")


def _captured_name(capture: dict[str, Any]) -> str:
    sources = capture.get("sources") or [capture.get("source")]
    if not all(isinstance(source, str) and source and source.isprintable() for source in sources):
        return "fabric"
    return result_name([Path(source) for source in sources])[-MAX_NAME_LENGTH:]
