"""Files for CLO and Unreal: stiffness when flat, and buckled."""

import json

import numpy as np
import pytest
from estimates import document_of, estimate_of
from exported import ALPHA, BETA, CURVATURE, DENSITY, SI, exported

from common.files import replace_json
from drapenet.export.material import read_material


def test_clo_gets_the_weft_along_u(estimate):
    content = json.loads(exported(estimate, "jfab").read_text())
    about, physical = content["drapenet"], content["mapPhysical"]
    in_si = {key: SI[unit] * physical[key] for key, unit in about["units"].items()}
    flat = [in_si[key] for key in ("fBvK", "fBhK", "fBuK")]
    assert flat == pytest.approx(ALPHA + CURVATURE / 2 * BETA)
    bent = [physical[f"fBucklingStiffness{axis}"] * modulus
            for axis, modulus in zip("VHU", flat, strict=True)]
    assert bent == pytest.approx(ALPHA + 1.5 * CURVATURE * BETA)
    assert in_si["fDensity"] == pytest.approx(DENSITY)
    assert set(about["tool_defaults"]) == {
        "fSuK", "fSvK", "fHK", "fThickness", "fFriction", "fIDS", "listNonlinearSuK",
        "listNonlinearSvK", "listNonlinearHK"}
    assert about["not_known"] == ["stretch along the warp", "stretch along the weft", "shear",
                                  "thickness", "friction"]


def test_clo_gets_all_that_is_known(known):
    content = json.loads(exported(known, "jfab").read_text())
    about, physical = content["drapenet"], content["mapPhysical"]
    in_si = {key: SI[unit] * physical[key] for key, unit in about["units"].items()}
    assert [in_si[key] for key in ("fSvK", "fSuK", "fHK", "fThickness")] == pytest.approx(
        [900.0, 400.0, 35.0, 0.42e-3])
    assert physical["fFriction"] == 0.31 and about["not_known"] == []
    assert set(about["tool_defaults"]) == {"fIDS", "listNonlinearSuK", "listNonlinearSvK",
                                          "listNonlinearHK"}


def test_hinges_buckle_at_the_curvature_on_a_mesh_of_these_edges(estimate):
    """Unreal: buckled when pi - |angle| < ratio (pi - |rest angle|), of angles of curved cloth."""
    for edge_mm in (5.0, 20.0):
        ratio = read_material(estimate, edge_mm=edge_mm).buckling.ratio
        height = 1e-3 * edge_mm * np.sqrt(0.75)
        for curvature, buckled in ((0.99 * CURVATURE, False), (1.01 * CURVATURE, True)):
            assert (np.pi - curvature * height < ratio * np.pi) == buckled
    assert json.loads(exported(estimate, "jfab", edge_mm=20.0).read_text())["drapenet"][
        "edge_mm"] == 20


@pytest.mark.parametrize(("beta", "settings"), [
    (-BETA, {}), (BETA, {"curvature_1_m": 0.0}), (BETA, {"edge_mm": 100.0})])
def test_cloth_that_does_not_soften_does_not_buckle(tmp_path, beta, settings):
    """Nor that whose hinges would have to fold onto themselves first."""
    path = tmp_path / "estimate.json"
    estimate = estimate_of(ALPHA, beta, density=DENSITY, deviation=0.01)
    replace_json(path, document_of(estimate).content())
    material = read_material(path, **settings)
    assert material.buckling.ratio == 0 and material.buckling.share.tolist() == [1, 1, 1]
    assert material.buckling.modulus == pytest.approx(material.modulus)
    assert material.modulus == pytest.approx(
        ALPHA + settings.get("curvature_1_m", CURVATURE) * beta)
