"""Exports: the command, its neutral files, and each tool's file turned back by that tool's rules;
of a drape alone, and of a fabric of which all is known."""

import json
import runpy
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from estimates import DOUBT, document_of, estimate_of
from vectors import angle_between

from common.errors import InputError
from common.files import replace_json
from data.readings.known import Known
from drapenet.export.__main__ import main
from drapenet.export.cards import DEFAULT
from drapenet.export.formats import ALIASES, TARGETS, export
from drapenet.export.material import MAX_CELLS, MIN_CELLS, hinge_ratio, read_material
from drapenet.measured.tension.law import compliance
from sim.energies.hinges import HingeBending
from sim.material import DIRECTIONS, MICRO, NANO, STIFF_SOFT, Fabric, torque
from sim.mesh import strip
from sim.tension import POISSON

ALPHA = np.array([52.0, 31.0, 22.0]) * MICRO
BETA = np.array([-158.0, -101.0, -69.0]) * NANO
DENSITY = 0.21
CURVATURE = 60.0  # 1/m, of the default modulus: the stiffness in a drape
IN_A_DRAPE = ALPHA + CURVATURE * BETA
MEAN_IN_A_DRAPE = ((IN_A_DRAPE**-3.0 @ [1, 2, 1]) / 4) ** (-1 / 3)
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


@pytest.fixture
def estimate(tmp_path) -> Path:
    return write(tmp_path / "estimate.json")


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


def exported(estimate: Path, target: str, **options: object) -> Path:
    return export(read_material(estimate, **options), target,
                  estimate.parent / TARGETS[target].file)[0]


def parsed(estimate: Path, target: str, **options: object) -> dict:
    return json.loads(exported(estimate, target, **options).read_text())


def shell(file: Path) -> dict[str, object]:
    """The parameters of a shell in a file for ppf-contact-solver."""
    return {key: json.loads(value) for key, value in (
        line.split(" = ") for line in file.read_text().splitlines() if not line.startswith("#"))}


def test_the_default_modulus_is_the_stiffness_in_a_drape_of_the_report(estimate):
    content = json.loads(estimate.read_text())
    stated = [moduli["drape_stiffness_uN_m"]["median"] for moduli in content["moduli"].values()]
    assert read_material(estimate).modulus / MICRO == pytest.approx(stated, rel=1e-12)
    for moduli in content["moduli"].values():
        del moduli["drape_stiffness_uN_m"]
    replace_json(estimate, content)  # as written before the estimate stated it
    assert read_material(estimate).modulus == pytest.approx(IN_A_DRAPE)


def test_one_measured_yarn_is_written_where_a_tool_has_a_field_for_it(known):
    content = json.loads(known.read_text())
    content["tension"]["measured"] = ["warp"]
    replace_json(known, content)
    physical = parsed(known, "jfab")
    assert physical["mapPhysical"]["fSvK"] == 900e3
    assert {"fSuK", "fHK"} < set(physical["drapenet"]["tool_defaults"])
    assert physical["drapenet"]["not_known"] == ["stretch along the weft", "shear"]
    data = parsed(known, "json")
    assert data["stretch_N_m"] == [900.0, None] and data["shear_N_m"] is None
    assert "young-mod" not in shell(exported(known, "ppf"))


def test_neutral_files_return_what_was_estimated(estimate):
    data = parsed(estimate, "json")
    assert data["alpha_N_m"] == pytest.approx(ALPHA) and data["beta_N_m2"] == pytest.approx(BETA)
    rows = [line.split(",") for line in exported(estimate, "csv").read_text().splitlines()]
    assert [row[0] for row in rows[1:]] == ["warp", "bias", "weft"]
    assert [float(row[1]) * MICRO for row in rows[1:]] == pytest.approx(ALPHA)
    curve = np.loadtxt(exported(estimate, "torque"), delimiter=",", skiprows=1)
    assert curve[20, 1:] * 1e-3 == pytest.approx(torque(curve[20, 0], ALPHA, BETA), rel=1e-4)
    write(estimate, STIFF_SOFT)  # the warp is not marked, so that no file may call yarns warp
    for target in ("json", "csv", "torque"):
        text = exported(estimate, target).read_text().partition('"drapenet"')[0]
        assert "stiff" in text and "soft" in text and "warp" not in text


def test_a_file_of_one_tool_does_not_replace_that_of_another(estimate, tmp_path):
    out = tmp_path / "exp"
    for program in ("clo", "unreal"):
        main([f"estimate={estimate}", f"to={program}", f"out={out}"])
    assert {file.name for file in out.iterdir()} == {"fabric.jfab", "fabric.usda"}
    before = (out / "fabric.jfab").read_bytes()
    with pytest.raises(InputError, match=r"the file for to=usd ends in \.usda; give such a name"):
        main([f"estimate={estimate}", "to=unreal", f"out={out / 'fabric.jfab'}"])
    assert (out / "fabric.jfab").read_bytes() == before
    main([f"estimate={estimate}", "to=unreal", f"out={out / 'silk.usda'}"])
    assert (out / "silk.usda").exists()


def test_all_targets_of_one_estimate_have_the_same_bytes_again(estimate):
    folders = [estimate.parent / name for name in ("first", "second")]
    for folder in folders:
        main([f"estimate={estimate}", "to=all", f"out={folder}"])
    names = sorted(file.name for file in folders[0].iterdir())
    assert len(names) == len(TARGETS) + 1
    for name in names:
        assert (folders[0] / name).read_bytes() == (folders[1] / name).read_bytes()


def test_the_docs_hold_every_tool():
    text = (Path(__file__).parents[2] / "docs" / "exports.md").read_text(encoding="utf-8")
    for name, t in TARGETS.items():
        row, = (line for line in text.splitlines() if line.startswith(f"| `{name}` | {t.tool} | "))
        assert row.endswith(f" | {t.lost} |") and row.count("|") == 7
    assert "\n## Not offered\n" in text and set(ALIASES.values()) <= set(TARGETS)


def test_the_name_of_the_fabric_is_in_the_files(estimate):
    for name, wanted in (("", "twill"), ("Blé 7/8", "Blé 7/8")):
        jfab = parsed(estimate, "jfab", name=name)
        assert jfab["qsFabricName"].endswith(wanted) and jfab["drapenet"]["name"].endswith(wanted)
        main_file = parsed(estimate, "u3m", name=name)["material"]
        assert main_file["name"].endswith(wanted)
        written = datetime.fromisoformat(main_file["created"].replace("Z", "+00:00")).timestamp()
        assert written == pytest.approx(estimate.stat().st_mtime, abs=1)
        usda = exported(estimate, "usd", name=name).read_text()
        assert f'{wanted}"' in usda and "/Fabric" not in usda
        assert exported(estimate, "csv", name=name).read_text().splitlines()[1].endswith(wanted)
    formula = exported(estimate, "csv", name="=1+1").read_text()
    assert formula.splitlines()[1].endswith(",'=1+1")


def test_programs_stand_for_their_format_and_folders_for_their_estimate(estimate, capsys):
    main(["to=list"])
    assert "unreal (usd)" in capsys.readouterr().out
    main([f"estimate={estimate.parent}", "to=CLO,unreal,jfab", "curvature_1_m=120"])
    printed = capsys.readouterr().out
    assert [Path(line).name for line in printed.splitlines()[:2]] == ["fabric.jfab", "fabric.usda"]
    assert "warning: curvature_1_m=120 is outside the law" in printed
    write(estimate, STIFF_SOFT)
    main([f"estimate={estimate}", "to=json"])
    assert "does not mark the warp" in capsys.readouterr().out


@pytest.mark.parametrize(("mesh", "low", "high"), [
    ("unstructured", 1.0, 1.1), ("alternating", 1.18, 1.24), ("equal", 1.15, 1.25),
    ("random", 1.08, 1.2)])
def test_ratios_of_meshes_are_those_of_the_docs(estimate, mesh, low, high):
    assert low < read_material(estimate, mesh=mesh).ratio < high
    assert all(0.9 < hinge_ratio(mesh, n) < 1.3 for n in range(MIN_CELLS, MAX_CELLS + 1))
    assert hinge_ratio(mesh, 10 * MAX_CELLS) == hinge_ratio(mesh, MAX_CELLS)


def test_arcsim_s_table_gives_the_torque_by_arcsim_s_rules(estimate):
    """Linear interpolation over the curvature's half in steps of 5/m, rows by the edge's angle."""
    ratio = read_material(estimate, mesh="alternating").ratio
    data = parsed(estimate, "arcsim", mesh="alternating")
    for row, direction in ((0, 2), (1, 1), (2, 0)):  # an edge along the warp bends the weft
        for kappa in (0.5, 17.0, 39.0, -17.0):  # below 0 the first interval is extrapolated
            at = min(kappa / 2 / 5, 4)
            low = min(max(int(at), 0), 3)
            table = data["bending"][row]
            ke = (1 - at + low) * table[low] + (at - low) * table[low + 1]
            beta = BETA[direction] * np.sign(kappa)
            assert ke * abs(kappa) / 4 / ratio == pytest.approx(
                torque(np.array(abs(kappa)), ALPHA[direction], beta), rel=1e-6)
    assert "at negative angles" in TARGETS["arcsim"].lost
    assert "stretching" not in data and "stretching" in data["drapenet"]["tool_defaults"]


def test_arcsim_s_samples_give_the_law_of_strips_by_arcsim_s_rules(known):
    """k twice the sample at all strains; stresses k0 E_uu + k1 E_vv, k1 E_uu + k2 E_vv, k3 E_uv."""
    data = parsed(known, "arcsim")
    assert len(data["stretching"]) == 6 and all(
        row == data["stretching"][0] for row in data["stretching"])
    k = 2 * np.array(data["stretching"][0])
    tangent = np.array([[k[0], k[1], 0], [k[1], k[2], 0], [0, 0, k[3] / 2]])  # over 2 E_uv
    pulled = {0: [1, 0, 0], 1: [0.5, 0.5, 0.5], 2: [0, 1, 0]}  # stresses of 1 N/m along each
    for direction, stress in pulled.items():
        strain = np.linalg.solve(tangent, stress) @ stress
        assert strain == pytest.approx(compliance(direction, (900.0, 400.0, 35.0), POISSON))
    assert data["drapenet"]["tool_defaults"] == ["damping", "friction", "repulsion_thickness"]


@pytest.mark.parametrize(("options", "curvature"), [({}, CURVATURE), ({"curvature_1_m": 30.0}, 30)])
def test_browzwear_gets_dyne_centimetres_and_a_main_file_that_names_them(
        estimate, options, curvature):
    file = exported(estimate, "u3m", **options)
    physics = json.loads(file.read_text())["material"]["physics"]
    assert physics["weight"] == 210
    fab = json.loads((file.parent / physics["devices"]["fab"]).read_text())
    assert set(fab) == {"schema", "raw_data", "custom"} and fab["raw_data"] is None
    bend = fab["custom"]["browzwear"]["bend"]
    assert [float(bend[key]) * 1e-5 * 1e-2 for key in ("length", "width")] == pytest.approx(
        (ALPHA + curvature * BETA)[[0, 2]])
    assert "thickness" not in fab["custom"]["browzwear"]


def test_browzwear_gets_all_that_is_known(known):
    assert parsed(known, "u3m")["material"]["physics"]["thickness"] == 0.42  # mm
    custom = json.loads((known.parent / "fabric.fab.json").read_text())["custom"]
    found = custom["browzwear"]
    assert (float(found["thickness"]), float(found["friction"])) == (0.42, 0.31)
    assert {key: float(value) for key, value in found["stretch"].items()} == {
        "length": 900.0, "width": 400.0} and float(found["shear"]) == 35.0
    assert custom["drapenet"]["tool_defaults"] == [
        "hysteresis", "shear_linearity", "shrink", "stretch_linearity"]


def typed(content: dict) -> dict[str, dict[str, str | None]]:
    """What to type, by tool and field."""
    return {card["tool"]: {field["field"]: field["value"] for field in card["fields"]}
            for card in content["cards"]}


def test_cards_say_what_to_type_and_what_is_not_known(estimate):
    content = parsed(estimate, "fields")
    words = typed(content)
    assert set(words) == {"CLO", "Marvelous Designer", "VStitcher", "Blender", "Houdini", "Unreal"}
    assert words["CLO"]["Bending-Weft"] == "19900" and words["CLO"]["Density"] == "0.00021"
    # 47 300 lies between 65 (20 000) and 83 (200 000) of CLO's scale.
    assert words["CLO"]["Bending-Warp as 0 to 100"] == "67.7"
    assert words["CLO"]["Buckling Stiffness-Warp"] == "0.799"
    assert words["VStitcher"]["Bend Length"] == "425" and words["VStitcher"]["Mass"] == "210"
    assert words["Unreal"]["Bending Stiffness Bias"] == "0.28"
    assert words["Unreal"]["Buckling Stiffness Bias"] == "0.219"
    assert words["Unreal"]["Stretch Stiffness Warp"] is words["CLO"]["Thickness"] is None
    notes = {field["field"]: field.get("note") for card in content["cards"]
             for field in card["fields"] if card["tool"] == "CLO"}
    assert notes["Thickness"] == DEFAULT and notes["Bending-Weft"] is None
    assert words["Blender"]["Vertex Mass"] == "0.0116"  # a thousand times 55.4 mm²
    assert words["Houdini"]["Bend Stiffness"] is None
    assert all(card["unknown"] and card["source"] and card["where"] for card in content["cards"])
    page = exported(estimate, "cards").read_text()
    assert "<th scope=\"row\">Bending-Weft</th><td class=\"number\">19900 g·mm²/s²</td>" in page
    assert "not known" in page and "warp stands for" not in page
    ratios = 1 + CURVATURE * BETA / ALPHA
    assert content["drapenet"]["modulus_over_alpha"] == pytest.approx(ratios, abs=1e-3)
    assert ", ".join(f"{ratio:.0%}" for ratio in ratios) in page


def test_cards_have_all_that_is_known(known):
    words = typed(parsed(known, "fields"))
    assert (words["CLO"]["Stretch-Weft"], words["CLO"]["Shear"]) == ("400000", "35000")
    assert words["Unreal"]["Stretch Stiffness Bias"] == "35"
    assert words["VStitcher"]["Thickness"] == "0.42" and words["Houdini"]["Friction"] == "0.31"
    assert (words["VStitcher"]["Stretch Length"], words["VStitcher"]["Shear"]) == ("900", "35")
    # Springs of k on triangles of equal sides have the shear stiffness sqrt(3)/4 k; tension is k
    # times the edge, 8 mm.
    tension = float(words["Blender"]["Stiffness: Tension, Compression, Shear"])
    assert tension / 0.008 * np.sqrt(3) / 4 == pytest.approx(35, rel=0.01)
    assert words["Blender"]["Collisions, Self Collisions: Friction"] == "31"


def clo(estimate: Path) -> tuple[dict, dict, dict]:
    """What a file for CLO says of itself, its values, and those with a unit in SI units."""
    content = parsed(estimate, "jfab")
    about, physical = content["drapenet"], content["mapPhysical"]
    return about, physical, {key: SI[unit] * physical[key] for key, unit in about["units"].items()}


def test_clo_gets_the_weft_along_u(estimate):
    about, physical, in_si = clo(estimate)
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
    about, physical, in_si = clo(known)
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
    assert parsed(estimate, "jfab", edge_mm=20.0)["drapenet"]["edge_mm"] == 20


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


def test_newton_s_edges_store_the_energy_of_hinges(estimate):
    """1/2 ke l theta² of every edge against the hinge law, on a bent strip."""
    ratio = read_material(estimate).ratio
    module = runpy.run_path(str(exported(estimate, "newton")))
    assert np.array(module["MATERIAL"]["edge_aniso_ke"]) * 3 / ratio == pytest.approx(
        IN_A_DRAPE[[2, 0, 1]])
    assert module["MATERIAL"]["tri_aniso_ke"] is None
    mesh, _ = strip(length=0.03, width=0.01, edge=2e-3, clamp=0.0, diagonals="random", jitter=0.2)
    inner = np.flatnonzero(mesh.edge_faces.min(axis=1) >= 0)
    pairs = mesh.edge_faces[inner]
    apexes = mesh.faces[pairs].sum(axis=2) - mesh.edges[inner].sum(axis=1, keepdims=True)
    builder = SimpleNamespace(
        particle_q=np.column_stack([mesh.rest, np.zeros(len(mesh.rest))]),
        edge_indices=np.column_stack([apexes, mesh.edges[inner]]),
        edge_bending_properties=[(0.0, 0.0)] * len(inner))
    module["set_bending"](builder)
    bend = 8.0  # 1/m
    x, y = mesh.rest.T
    bent = np.column_stack([np.sin(bend * x) / bend, y, (1 - np.cos(bend * x)) / bend])
    normal = np.cross(*(bent[mesh.faces[:, k]] - bent[mesh.faces[:, 0]] for k in (1, 2)))
    theta = angle_between(normal[pairs[:, 0]], normal[pairs[:, 1]])
    lengths = np.linalg.norm(np.diff(mesh.rest[mesh.edges[inner]], axis=1)[:, 0], axis=1)
    stiffness = np.array(builder.edge_bending_properties)[:, 0]
    law = HingeBending(mesh, np.ones(len(mesh.faces), bool), directed=True,
                       fabric=Fabric(IN_A_DRAPE * ratio))
    unknowns = np.concatenate([bent.ravel(), np.zeros(len(mesh.edges))])
    assert 0.5 * (stiffness * lengths * theta**2).sum() == pytest.approx(
        law.value(unknowns), rel=1e-5)


def test_newton_gets_all_that_is_known(known):
    found = runpy.run_path(str(exported(known, "newton")))["MATERIAL"]
    assert found["tri_aniso_ke"] == [400.0, 900.0, 35.0]  # weft, warp, shear
    assert 2 * found["particle_radius"] == pytest.approx(0.42e-3)
    assert found["soft_contact_mu"] == 0.31
    assert found["about"]["tool_defaults"] == ["edge_kd", "tri_ka", "tri_kd", "tri_ke"]


def test_ppf_s_triangles_stretch_and_shear_by_its_rules(known):
    """mu = E/(2 (1 + nu)) of the extension and lambda = E nu/((1 + nu)(1 - 2 nu)) of the shear, for
    each kg, in a stretch energy mu/2 e² and a shear energy lambda/2 gamma²."""
    data = shell(exported(known, "ppf"))
    young, poisson = data["young-mod"], data["poiss-rat"]
    mu = young / (2 * (1 + poisson))
    lam = young * poisson / ((1 + poisson) * (1 - 2 * poisson))
    assert data["model"] == "baraff-witkin" and 0 < poisson < 0.5
    assert [mu * data["density"], lam * data["density"]] == pytest.approx([650.0, 35.0])
    assert data["friction"] == 0.31 and 2 * data["contact-offset"] == pytest.approx(0.42e-3)


def test_ppf_s_hinges_across_the_yarns_have_their_moduli_and_the_rest_its_defaults(estimate):
    options = {"mesh": "equal", "edge_mm": 4.0}
    file, ratio = exported(estimate, "ppf", **options), read_material(estimate, **options).ratio
    data = shell(file)
    for sine, direction in ((1.0, 0), (0.0, 2)):  # of an edge's angle to the warp, squared
        bend = data["bend"] + data["bend-warp"] * sine + data["bend-weft"] * (1 - sine)
        assert 1.28e-5 * bend * data["density"] == pytest.approx(IN_A_DRAPE[direction] * ratio)
    assert "hinge_over_plate_modulus" in file.read_text()
    unknown = {"young-mod", "poiss-rat", "friction", "contact-offset"}
    about = json.loads("".join(line[2:] for line in file.read_text().splitlines()[:-5]))
    assert not unknown & set(data) and unknown < set(about["tool_defaults"])


def prim_of(estimate: Path, **options: object) -> SimpleNamespace:
    """The material of a file in USD, its stage (prims end with it) and what it says of itself."""
    usd = pytest.importorskip("pxr.Usd")
    stage = usd.Stage.Open(str(exported(estimate, "usd", **options)))
    prim = stage.GetDefaultPrim()
    return SimpleNamespace(stage=stage, prim=prim, attribute=prim.GetAttribute,
                           about=json.loads(prim.GetCustomDataByKey("drapenet")))


def test_usd_opens_with_clo_s_and_the_proposal_s_attributes(estimate):
    opened = prim_of(estimate)
    prim, about = opened.prim, opened.about
    applied = prim.GetPrimTypeInfo().GetAppliedAPISchemas()  # known to this USD or not
    assert applied == ["PhysicsMaterialAPI", "PhysicsSurfaceDeformableMaterialAPI",
                       "CloFabricAPI"]
    flat, bent = (ALPHA + part * CURVATURE * BETA for part in (0.5, 1.5))
    for key, axis in (("Warp", 0), ("Weft", 2), ("BiasLeft", 1), ("BiasRight", 1)):
        bending, share, ratio = (opened.attribute(f"primvars:clo:{name}{key}").Get()[0]
                                 for name in ("bending", "bucklingStiffness", "bucklingRatio"))
        # Unreal's importer: 1e-5 from g·mm²/s² to kg·cm²/s², buckling a share of bending.
        assert bending * 1e-5 * 1e-4 == pytest.approx(flat[axis], rel=1e-6)
        assert bending * share * 1e-5 * 1e-4 == pytest.approx(bent[axis], rel=1e-6)
        assert ratio == pytest.approx(read_material(estimate).buckling.ratio, rel=1e-6)
    in_si = [SI[attribute.GetDocumentation()] * np.ravel(attribute.Get())[0] for attribute in map(
        opened.attribute, ("physics:surfaceBendStiffness", "primvars:clo:bendingWarp",
                           "primvars:clo:density"))]
    assert in_si == pytest.approx([MEAN_IN_A_DRAPE, flat[0], DENSITY], rel=1e-6)
    left = set(about["tool_defaults"])
    assert {"primvars:clo:stretchWarp", "primvars:clo:thickness", "primvars:clo:internalDamping",
            "physics:surfaceShearStiffness"} < left
    assert not any(prim.HasAttribute(name) and prim.GetAttribute(name).HasAuthoredValue()
                   for name in left)
    assert about["moduli"] == json.loads(estimate.read_text())["moduli"]
    assert about["edge_mm"] == 5


def test_usd_has_all_that_is_known(known):
    opened = prim_of(known)
    in_plane = [opened.attribute(f"primvars:clo:{key}") for key in (
        "stretchWarp", "stretchWeft", "shearLeft", "shearRight", "thickness")]
    assert [SI[each.GetDocumentation()] * each.Get()[0] for each in in_plane] == pytest.approx(
        [900.0, 400.0, 35.0, 35.0, 0.42e-3])
    assert opened.attribute("primvars:clo:friction").Get()[0] == pytest.approx(0.31)
    surface = [opened.attribute(f"physics:surface{key}Stiffness") for key in ("Stretch", "Shear")]
    assert [each.Get() for each in surface] == pytest.approx([650.0, 35.0])
    assert {each.GetDocumentation() for each in surface} == {"N/m"}
    assert opened.attribute("physics:surfaceThickness").Get() == pytest.approx(0.42e-3)
    physics = pytest.importorskip("pxr.UsdPhysics").MaterialAPI(opened.prim)  # of usd-core
    assert physics.GetStaticFrictionAttr().Get() == pytest.approx(0.31)
    assert physics.GetDensityAttr().Get() == pytest.approx(DENSITY / 0.42e-3)
    assert not physics.GetDynamicFrictionAttr().HasAuthoredValue()
    assert set(opened.about["tool_defaults"]) == {
        "physics:dynamicFriction", "primvars:clo:internalDamping", "primvars:clo:shrinkage"}


@pytest.mark.parametrize(("fixture", "assumed"), [("estimate", 1.0), ("known", None)])
def test_density_times_thickness_is_the_weight(fixture, assumed, request):
    opened = prim_of(request.getfixturevalue(fixture))
    density, thickness = (opened.attribute(f"physics:{key}").Get()
                          for key in ("density", "surfaceThickness"))
    assert density * thickness == pytest.approx(DENSITY, rel=1e-6)
    assert opened.about.get("thickness_assumed_mm") == assumed
    assert ("thickness" in opened.about["not_known"]) == (assumed is not None)


@pytest.mark.parametrize(("name", "label"), [
    ('2/1 "Köper", blau \\ 7', "_2_1__K_per___blau___7"), ("é", "_"), ("Twill", "Twill")])
def test_usd_opens_with_any_name(estimate, name, label):
    opened = prim_of(estimate, name=name)
    assert (opened.prim.GetName(), opened.prim.GetDisplayName()) == (label, name)
