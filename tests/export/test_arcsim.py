"""Files for ArcSim, turned back by its own rules."""

import json

import numpy as np
import pytest
from exported import ALPHA, BETA, exported

from drapenet.export.formats import TARGETS, export
from drapenet.export.material import read_material
from drapenet.measured.tension.law import compliance
from sim.material import torque
from sim.tension import POISSON


def test_arcsim_s_table_gives_the_torque_by_arcsim_s_rules(estimate):
    """Linear interpolation over the curvature's half in steps of 5/m, rows by the edge's angle."""
    material = read_material(estimate, mesh="alternating")
    data = json.loads(export(material, "arcsim", estimate.parent / "a.json")[0].read_text())
    assert material.ratio == pytest.approx(1.21, abs=0.03)  # docs/exports.md
    for row, direction in ((0, 2), (1, 1), (2, 0)):  # an edge along the warp bends the weft
        for kappa in (0.5, 17.0, 39.0, -17.0):  # below 0 the first interval is extrapolated
            at = min(kappa / 2 / 5, 4)
            low = min(max(int(at), 0), 3)
            ke = (1 - at + low) * data["bending"][row][low] + (at - low) * data["bending"][row][
                low + 1]
            beta = BETA[direction] * np.sign(kappa)
            assert ke * abs(kappa) / 4 / material.ratio == pytest.approx(
                torque(np.array(abs(kappa)), ALPHA[direction], beta), rel=1e-6)
    assert "at negative angles" in TARGETS["arcsim"].lost


def test_arcsim_s_samples_give_the_law_of_strips_by_arcsim_s_rules(known):
    """k twice the sample at all strains; stresses k0 E_uu + k1 E_vv, k1 E_uu + k2 E_vv, k3 E_uv."""
    data = json.loads(exported(known, "arcsim").read_text())
    assert len(data["stretching"]) == 6 and all(
        row == data["stretching"][0] for row in data["stretching"])
    k = 2 * np.array(data["stretching"][0])
    tangent = np.array([[k[0], k[1], 0], [k[1], k[2], 0], [0, 0, k[3] / 2]])  # over 2 E_uv
    pulled = {0: [1, 0, 0], 1: [0.5, 0.5, 0.5], 2: [0, 1, 0]}  # stresses of 1 N/m along each
    for direction, stress in pulled.items():
        strain = np.linalg.solve(tangent, stress) @ stress
        assert strain == pytest.approx(compliance(direction, (900.0, 400.0, 35.0), POISSON))
    assert data["drapenet"]["tool_defaults"] == ["damping", "friction", "repulsion_thickness"]


def test_arcsim_says_that_stretching_is_missing(estimate):
    data = json.loads(exported(estimate, "arcsim").read_text())
    assert "stretching" not in data and "stretching" in data["drapenet"]["tool_defaults"]
