"""Estimates that tests export, and what they read from the files."""

import json
from pathlib import Path

import numpy as np
from estimates import DOUBT, document_of, estimate_of

from common.files import replace_json
from drapenet.export.formats import TARGETS, export
from drapenet.export.material import read_material
from sim.material import DIRECTIONS, MICRO, NANO

ALPHA = np.array([52.0, 31.0, 22.0]) * MICRO
BETA = np.array([-158.0, -101.0, -69.0]) * NANO
DENSITY = 0.21
CURVATURE = 60.0  # 1/m, of the default modulus: the stiffness in a drape
IN_A_DRAPE = ALPHA + CURVATURE * BETA
SI = {"g·mm²/s²": 1e-3 * 1e-6, "g/s²": 1e-3, "g/mm²": 1e-3 / 1e-6, "N·m": 1.0, "N/m": 1.0,
      "mm": 1e-3, "m": 1.0, "kg/m³": 1.0, "1": 1.0}
"""Units that files state, in SI units."""


def write(path: Path, names: tuple[str, ...] = DIRECTIONS, **changes: object) -> Path:
    estimate = estimate_of(ALPHA, BETA, density=DENSITY, names=names, deviation=0.01)
    replace_json(path, document_of(estimate, warnings=[DOUBT]).content() | changes)
    return path


def quantity(value: float) -> dict[str, object]:
    return {"median": value, "interval_68": [0.9 * value, 1.1 * value],
            "interval_90": [0.8 * value, 1.2 * value]}


def exported(estimate: Path, target: str, **options: object) -> Path:
    return export(read_material(estimate, **options), target,
                  estimate.parent / TARGETS[target].file)[0]


def shell(file: Path) -> dict[str, object]:
    """The parameters of a shell in a file for ppf-contact-solver."""
    return {key: json.loads(value) for key, value in (
        line.split(" = ") for line in file.read_text().splitlines() if not line.startswith("#"))}
