"""Estimates that are exported: of a drape alone, and of a fabric of which all is known."""

import json
from pathlib import Path

import numpy as np
import pytest
from exported import DENSITY, quantity, write

from common.files import replace_json
from data.readings.known import Known
from drapenet.export.material import Material, read_material


@pytest.fixture
def estimate(tmp_path) -> Path:
    return write(tmp_path / "estimate.json")


@pytest.fixture
def material(estimate) -> Material:
    return read_material(str(estimate.parent))


@pytest.fixture
def known(estimate) -> Path:
    """The estimate of a fabric of which all is known that tools ask for."""
    content = json.loads(estimate.read_text())
    stated = Known(thickness_mm=0.42, thickness_kpa=0.2, friction_deg={
        "fabric": float(np.degrees(np.arctan(0.31)))})
    usual = {"findings": [], "along_yarns": True, "friction_n_per_m": {}, "readings": {},
             "weight_for_10_percent_g": {}}
    content["tension"] = {
        "source": "strips", "density_g_m2": 1e3 * DENSITY, "strips": 3,
        "measured": ["warp", "weft", "bias"], "shear_n_per_m": quantity(35.0),
        "stretch_n_per_m": {"warp": quantity(900.0), "weft": quantity(400.0)},
        "known": stated.model_dump(exclude_none=True)} | usual
    replace_json(estimate, content)
    return estimate
