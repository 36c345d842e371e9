"""Files in USD, with the attributes of CLO and of the proposal."""

import json

import numpy as np
import pytest
from exported import ALPHA, BETA, CURVATURE, DENSITY, IN_A_DRAPE, SI, exported

from drapenet.export.material import read_material


def test_usd_opens_with_clo_s_and_the_proposal_s_attributes(estimate):
    usd = pytest.importorskip("pxr.Usd")
    stage = usd.Stage.Open(str(exported(estimate, "usd")))
    prim = stage.GetDefaultPrim()
    applied = prim.GetPrimTypeInfo().GetAppliedAPISchemas()  # known to this USD or not
    assert applied == ["PhysicsMaterialAPI", "PhysicsSurfaceDeformableMaterialAPI",
                       "CloFabricAPI"]
    flat, bent = (ALPHA + part * CURVATURE * BETA for part in (0.5, 1.5))
    for key, axis in (("Warp", 0), ("Weft", 2), ("BiasLeft", 1), ("BiasRight", 1)):
        bending, share, ratio = (prim.GetAttribute(f"primvars:clo:{name}{key}").Get()[0]
                                 for name in ("bending", "bucklingStiffness", "bucklingRatio"))
        # Unreal's importer: 1e-5 from g·mm²/s² to kg·cm²/s², buckling a share of bending.
        assert bending * 1e-5 * 1e-4 == pytest.approx(flat[axis], rel=1e-6)
        assert bending * share * 1e-5 * 1e-4 == pytest.approx(bent[axis], rel=1e-6)
        assert ratio == pytest.approx(read_material(estimate).buckling.ratio, rel=1e-6)
    mean = prim.GetAttribute("physics:surfaceBendStiffness").Get()
    warp, bias, weft = IN_A_DRAPE
    assert mean == pytest.approx(((warp**-3 + 2 * bias**-3 + weft**-3) / 4) ** (-1 / 3), rel=1e-6)
    assert not prim.HasAttribute("primvars:clo:stretchWarp")
    in_si = {key: SI[attribute.GetDocumentation()] * np.ravel(attribute.Get())[0] for key in (
        "physics:surfaceBendStiffness", "primvars:clo:bendingWarp", "primvars:clo:density")
        for attribute in [prim.GetAttribute(key)]}
    assert list(in_si.values()) == pytest.approx([mean, flat[0], DENSITY], rel=1e-6)
    about = json.loads(prim.GetCustomDataByKey("drapenet"))
    left = set(about["tool_defaults"])
    assert {"primvars:clo:stretchWarp", "primvars:clo:thickness", "primvars:clo:internalDamping",
            "physics:surfaceShearStiffness"} < left
    assert not any(prim.HasAttribute(name) and prim.GetAttribute(name).HasAuthoredValue()
                   for name in left)
    assert about["moduli"] == json.loads(estimate.read_text())["moduli"]
    assert about["edge_mm"] == 5


def test_usd_has_all_that_is_known(known):
    usd = pytest.importorskip("pxr.Usd")
    stage = usd.Stage.Open(str(exported(known, "usd")))  # prims end with it
    prim = stage.GetDefaultPrim()
    clo = {key: prim.GetAttribute(f"primvars:clo:{key}") for key in (
        "stretchWarp", "stretchWeft", "shearLeft", "shearRight", "thickness")}
    assert [SI[each.GetDocumentation()] * each.Get()[0] for each in clo.values()] == pytest.approx(
        [900.0, 400.0, 35.0, 35.0, 0.42e-3])
    assert prim.GetAttribute("primvars:clo:friction").Get()[0] == pytest.approx(0.31)
    surface = [prim.GetAttribute(f"physics:surface{key}Stiffness") for key in ("Stretch", "Shear")]
    assert [each.Get() for each in surface] == pytest.approx([650.0, 35.0])
    assert {each.GetDocumentation() for each in surface} == {"N/m"}
    assert prim.GetAttribute("physics:surfaceThickness").Get() == pytest.approx(0.42e-3)
    physics = pytest.importorskip("pxr.UsdPhysics").MaterialAPI(prim)  # as usd-core registers it
    assert physics.GetStaticFrictionAttr().Get() == pytest.approx(0.31)
    assert physics.GetDensityAttr().Get() == pytest.approx(DENSITY / 0.42e-3)
    assert not physics.GetDynamicFrictionAttr().HasAuthoredValue()
    assert set(json.loads(prim.GetCustomDataByKey("drapenet"))["tool_defaults"]) == {
        "physics:dynamicFriction", "primvars:clo:internalDamping", "primvars:clo:shrinkage"}


@pytest.mark.parametrize(("fixture", "assumed"), [("estimate", 1.0), ("known", None)])
def test_density_times_thickness_is_the_weight(fixture, assumed, request):
    usd = pytest.importorskip("pxr.Usd")
    stage = usd.Stage.Open(str(exported(request.getfixturevalue(fixture), "usd")))
    prim = stage.GetDefaultPrim()
    density, thickness = (prim.GetAttribute(f"physics:{key}").Get()
                          for key in ("density", "surfaceThickness"))
    assert density * thickness == pytest.approx(DENSITY, rel=1e-6)
    about = json.loads(prim.GetCustomDataByKey("drapenet"))
    assert about.get("thickness_assumed_mm") == assumed
    assert ("thickness" in about["not_known"]) == (assumed is not None)


@pytest.mark.parametrize(("name", "label"), [
    ('2/1 "Köper", blau \\ 7', "_2_1__K_per___blau___7"), ("é", "_"), ("Twill", "Twill")])
def test_usd_opens_with_any_name(estimate, name, label):
    usd = pytest.importorskip("pxr.Usd")
    stage = usd.Stage.Open(str(exported(estimate, "usd", name=name)))  # prims end with it
    prim = stage.GetDefaultPrim()
    assert (prim.GetName(), prim.GetDisplayName()) == (label, name)
