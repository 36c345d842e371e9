"""Exports: the command, its neutral files, and each tool's file turned back by that tool's rules;
of a drape alone, and of a fabric of which all is known."""

import ast
import json
import runpy
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
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
SI = {"g·mm²/s²": 1e-9, "g/s²": 1e-3, "g/mm²": 1e3, "g/m²": 1e-3, "mm": 1e-3, "dyn·cm": 1e-5 * 1e-2}
"""Units that files state, in SI units, of those that are not."""
FLAT, BENT = (ALPHA + part * CURVATURE * BETA for part in (0.5, 1.5))
TRUTH = {f"{name}_{axis}": value for name, row in (
    ("drape", IN_A_DRAPE), ("flat", FLAT), ("share", BENT / FLAT)) for axis, value in zip(
        DIRECTIONS, row, strict=True)} | {
    "alpha": ALPHA,
    "beta": BETA,
    "mean": MEAN_IN_A_DRAPE,
    "weight": DENSITY,
    "warp": 900.0,
    "weft": 400.0,
    "both": [900.0, 400.0],
    "aniso": [400.0, 900.0, 35.0],
    "stretch": 650.0,
    "shear": 35.0,
    "thickness": 0.42e-3,
    "half": 0.21e-3,
    "friction": 0.31,
}
"""Of the fabric of which all is known, in SI units."""
FIELDS = yaml.safe_load(Path(__file__).with_name("fields.yaml").read_text("utf-8"))
"""Fields that are a quantity, in their unit."""


def ppf(v: dict[str, float], names: str) -> dict[str, float]:
    """For each kg mu = E/(2 (1 + nu)) is the stretch, lambda = E nu/((1 + nu)(1 - 2 nu)) the shear;
    what is stated for a yarn is added to ``bend``."""
    young, nu, density, bend, *more = (v[name] for name in names.split())
    return {"stretch": density * young / (2 * (1 + nu)),
            "shear": density * young * nu / ((1 + nu) * (1 - 2 * nu))} | {
        f"drape_{yarn}": 1.28e-5 * density * (bend + added) / RATIO
        for yarn, added in zip(("warp", "weft"), more, strict=True)}


RATIO = hinge_ratio("unstructured", 10)  # edges of 5 mm
RULES = {
    "usd": lambda v: {"weight": v["physics:density"] * v["physics:thicknesses"]},
    "newton": lambda v: {f"drape_{axis}": 3 * ke / RATIO for axis, ke in zip(
        ("weft", "warp", "bias"), v["edge_aniso_ke"], strict=True)},
    # Newton: 2 alpha/(h + h) an edge; PhysX: hinges of 3 k t³ l/(h + h), of a plate of 1.5 k t³.
    "isaaclab": lambda v: {
        "mean": [v["newton.edge_ke"] * 5e-3 * 0.75**0.5 / RATIO,
                 1.5 * v["physx.surface_bend_stiffness"] * v["physx.surface_thickness"]**3 / RATIO],
        "weight": v["physx.density"] * v["physx.surface_thickness"],
        "stretch": v["physx.youngs_modulus"] * v["physx.surface_thickness"]},
    # 3.12: mu t³/8; 4.0: E t³/12. Strips of triangles of equal sides have 8/9 of a plate's modulus.
    "mujoco": lambda v: {"weight": v["mass"] / v["area"], "mean": [
        8 / 9 * v["elasticity.thickness"]**3 * each for each in (
            v["elasticity.young"] / 2 / 8, v["young in 4.0"] / 12)]},
    "blender": lambda v: {
        "weight": v["mass_over_area"] / 1000, "mean": v["bending_times_area"] * 18 / 1000,
        "friction": v["self_friction"] / 100, "shear": 3**0.5 / 4 * v["tension_over_edge"]},
    "ppf": lambda v: ppf(v, "young-mod poiss-rat density bend bend-warp bend-weft"),
    "ppf_addon": lambda v: ppf(v, "shell_young_modulus shell_poisson_ratio shell_density bend "
                                  "bend_warp bend_weft"),
    "hood": lambda v: {"mean": v["bending_coeff_override"] / 4 / RATIO}}
"""Quantities by the tool's rules from other fields."""


def write(path: Path, names: tuple[str, ...] = DIRECTIONS) -> Path:
    estimate = estimate_of(ALPHA, BETA, density=DENSITY, names=names, deviation=0.01)
    replace_json(path, document_of(estimate, warnings=[DOUBT]).content())
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
    content["tension"] = {
        "source": "strips", "density_g_m2": 1e3 * DENSITY, "strips": 3, "findings": [],
        "measured": ["warp", "weft", "bias"], "shear_n_per_m": quantity(35.0), "readings": {},
        "stretch_n_per_m": {"warp": quantity(900.0), "weft": quantity(400.0)},
        "along_yarns": True, "friction_n_per_m": {}, "weight_for_10_percent_g": {},
        "known": stated.model_dump(exclude_none=True)}
    replace_json(estimate, content)
    return estimate


def exported(estimate: Path, target: str, **options: object) -> Path:
    return export(read_material(estimate, **options), target,
                  estimate.parent / TARGETS[target].file)[0]


def parsed(estimate: Path, target: str, **options: object) -> dict:
    return json.loads(exported(estimate, target, **options).read_text())


def flat(values: dict, prefix: str = "") -> dict[str, Any]:
    """Values by their path with dots."""
    return {path: leaf for key, value in values.items() for path, leaf in (flat(
        value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}).items()}


def fields_of(file: Path, target: str) -> dict[str, Any]:
    """The fields that a file has, by the rules of its container."""
    text = file.read_text(encoding="utf-8")
    if target == "usd":
        stage = pytest.importorskip("pxr.Usd").Stage.Open(str(file))
        return {each.GetName().removeprefix("primvars:"): np.ravel(each.Get())[0]
                for prim in stage.Traverse() for each in prim.GetAuthoredAttributes()}
    if target == "u3m":
        custom = json.loads(file.with_suffix(".fab.json").read_text())["custom"]["browzwear"]
        return {key: float(value) for key, value in flat(custom).items()
                if key not in ("name", "version")}
    if target == "mujoco":
        return flex(file)
    if file.suffix == ".py":
        return flat(next(ast.literal_eval(node.value) for node in ast.parse(text).body
                         if isinstance(node, ast.Assign) and node.targets[0].id == "MATERIAL"))
    if file.suffix == ".yaml":
        return yaml.safe_load(text)
    if file.suffix == ".toml":
        content = pytest.importorskip("tomllib").loads(text)
        return content.get("twill", content)
    return {key.removeprefix("mapPhysical."): value
            for key, value in flat(json.loads(text)).items()}


def flex(file: Path) -> dict[str, Any]:
    """Attributes of MuJoCo's patch, and its area; its triangles have equal sides."""
    cloth, newer = (ElementTree.parse(each).find(".//flexcomp") for each in (
        file, file.with_name("mujoco_4.xml")))
    points, faces = (np.array(cloth.get(key).split(), float).reshape(-1, 3)
                     for key in ("point", "element"))
    sides = points[faces.astype(int)] - points[np.roll(faces.astype(int), 1, axis=1)]
    assert np.linalg.norm(sides, axis=2) == pytest.approx(0.01, rel=1e-4)
    found = {"mass": cloth.get("mass"), "radius": cloth.get("radius")} | {
        f"{name}.{key}": value for name in ("elasticity", "contact")
        for key, value in cloth.find(name).items() if key in ("young", "thickness", "friction")}
    return {key: float(value.split()[0]) for key, value in found.items()} | {
        "area": np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum() / 2,
        "young in 4.0": float(newer.find("elasticity").get("young"))}


@pytest.mark.parametrize("target", FIELDS)
def test_every_field_is_read_back_by_its_tool_s_rules(known, target):
    found = fields_of(exported(known, target), target)
    units = {row["field"].removeprefix("primvars:"): SI.get(row.get("unit"), 1.0)
             for row in TARGETS[target].fields if "value" in row}
    assert set(units) <= set(found)
    in_si = {key: value * units[key] if units.get(key, 1.0) != 1 else value
             for key, value in found.items()}
    stated = FIELDS[target].items()
    read = [(name, in_si[key]) for key, name in stated]
    read += RULES.get(target, lambda _: {})(in_si).items()
    for name, value in read:
        assert value == pytest.approx(np.broadcast_to(TRUTH[name], np.shape(value)), rel=1e-6), name


@pytest.mark.parametrize("target", FIELDS)
def test_what_is_not_known_is_left_to_the_tool(estimate, target):
    row, found = TARGETS[target], fields_of(exported(estimate, target), target)
    left = {each["field"] for each in row.fields if each.get("value") in (
        None, "stretch_warp", "stretch_weft", "stretch_mean", "shear", "thickness", "friction")}
    usual = {key.removeprefix("mapPhysical."): value for key, value in flat(
        row.frame if isinstance(row.frame, dict) else {}).items()}
    assert left and all(found.get(key) == usual.get(key) for key in left)


def test_the_default_modulus_is_the_stiffness_in_a_drape_of_the_report(estimate):
    content = json.loads(estimate.read_text())
    stated = [moduli["drape_stiffness_uN_m"]["median"] for moduli in content["moduli"].values()]
    assert read_material(estimate).modulus / MICRO == pytest.approx(stated, rel=1e-12)
    for moduli in content["moduli"].values():
        del moduli["drape_stiffness_uN_m"]
    replace_json(estimate, content)  # as written before the estimate stated it
    assert read_material(estimate).modulus == pytest.approx(IN_A_DRAPE)


def test_beside_one_measured_yarn_the_usual_stretch_of_the_other_is_written_and_named(known):
    content = json.loads(known.read_text())
    content["tension"]["measured"] = ["warp"]
    replace_json(known, content)
    physical = parsed(known, "jfab")
    assert physical["mapPhysical"]["fSvK"] == 900e3 and physical["mapPhysical"]["fSuK"] == 400e3
    about = physical["drapenet"]
    assert "fHK" in about["tool_defaults"] and about["not_known"] == ["shear"]
    assert about["assumed"] == ["stretch along the weft was not measured: files for other tools "
                                "have 400 N/m, as usual beside the stretch of the other yarns"]


def test_neutral_files_return_what_was_estimated(estimate):
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
    first, second = ({file.name: file.read_bytes() for file in each.iterdir()} for each in folders)
    assert first == second and len(first) == len(TARGETS) + 2


def test_the_docs_hold_every_tool():
    text = (Path(__file__).parents[2] / "docs" / "exports.md").read_text(encoding="utf-8")
    for name, t in TARGETS.items():
        row, = (line for line in text.splitlines() if line.startswith(f"| `{name}` | {t.tool} | "))
        assert row.endswith(f" | {t.lost} |") and row.count("|") == 6
    assert "\n## Not offered\n" in text and set(ALIASES.values()) <= set(TARGETS)
    assert set(FIELDS) == {name for name, target in TARGETS.items() if target.fields}


def test_the_name_of_the_fabric_is_in_the_files(estimate):
    for name, wanted in (("", "twill"), ("Blé 7/8", "Blé 7/8")):
        jfab = parsed(estimate, "jfab", name=name)
        assert jfab["qsFabricName"].endswith(wanted) and jfab["drapenet"]["name"].endswith(wanted)
        main_file = parsed(estimate, "u3m", name=name)["material"]
        assert main_file["name"].endswith(wanted)
        written = datetime.fromisoformat(main_file["created"].replace("Z", "+00:00")).timestamp()
        assert written == pytest.approx(estimate.stat().st_mtime, abs=1)
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


def typed(content: dict) -> dict[tuple[str, str], dict[str, str]]:
    """What to type, by tool and field."""
    return {(card["tool"], each["field"]): each for card in content["cards"]
            for each in card["fields"]}


def test_cards_say_what_to_type_and_what_is_not_known(estimate, request):
    content = parsed(estimate, "fields")
    fields = typed(content)
    assert {tool for tool, _ in fields} == {
        "CLO", "Marvelous Designer", "VStitcher", "Blender", "Houdini", "Unreal"}
    assert all(set(field) == {"field", "value", "unit", "note"} for field in fields.values())
    stated = {  # 47 300 lies between 65 (20 000) and 83 (200 000) of CLO's scale
        ("CLO", "Bending-Weft"): "19900", ("CLO", "Bending-Warp as 0 to 100"): "67.7",
        ("CLO", "Buckling Stiffness-Warp"): "0.799", ("CLO", "Density"): "0.00021",
        ("VStitcher", "Bend Length"): "425", ("VStitcher", "Mass"): "210",
        ("Unreal", "Buckling Stiffness Bias"): "0.219",
        ("Blender", "Vertex Mass"): "0.0116",  # a thousand times 55.4 mm²
        ("Houdini", "Bend Stiffness"): None, ("Unreal", "Stretch Stiffness Warp"): None}
    assert {key: fields[key]["value"] for key in stated} == stated
    assert [fields["CLO", name]["note"] for name in ("Thickness", "Bending-Weft")] == [DEFAULT, ""]
    assert all(card["unknown"] and card["source"] and card["where"] for card in content["cards"])
    page = exported(estimate, "cards").read_text()
    assert "<th scope=\"row\">Bending-Weft</th><td class=\"number\">19900 g·mm²/s²</td>" in page
    assert "not known" in page and "warp stands for" not in page
    ratios = 1 + CURVATURE * BETA / ALPHA
    assert content["drapenet"]["modulus_over_alpha"] == pytest.approx(ratios, abs=1e-3)
    assert ", ".join(f"{ratio:.0%}" for ratio in ratios) in page
    fields = typed(parsed(request.getfixturevalue("known"), "fields"))
    stated = {("CLO", "Stretch-Weft"): "400000", ("Unreal", "Stretch Stiffness Bias"): "35",
              ("VStitcher", "Thickness"): "0.42",
              ("Blender", "Stiffness: Tension, Compression, Shear"): "2",  # 35 N/m would stretch
              ("Blender", "Collisions, Self Collisions: Friction"): "31"}
    assert {key: fields[key]["value"] for key in stated} == stated


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


def test_usd_opens_with_its_schemas_and_a_square_of_the_fabric_s_weight(estimate):
    """usd-core has PhysicsMaterialAPI; the square is what Newton's importer weighs."""
    usd, shade = pytest.importorskip("pxr.Usd"), pytest.importorskip("pxr.UsdShade")
    stage = usd.Stage.Open(str(exported(estimate, "usd")))
    prim, square = stage.GetDefaultPrim(), stage.GetPrimAtPath("/twill_square")
    applied = prim.GetPrimTypeInfo().GetAppliedAPISchemas()  # known to this USD or not
    assert applied == ["PhysicsMaterialAPI", "PhysicsSurfaceDeformableMaterialAPI", "CloFabricAPI"]
    bound, _ = shade.MaterialBindingAPI(square).ComputeBoundMaterial("physics")
    assert bound.GetPrim() == prim
    thickness, = square.GetAttribute("physics:thicknesses").Get()
    assert np.ptp(square.GetAttribute("points").Get(), axis=0) == pytest.approx([0.1, 0.1, 0])
    assert thickness * prim.GetAttribute("physics:density").Get() == pytest.approx(DENSITY)
    about = json.loads(prim.GetCustomDataByKey("drapenet"))
    assert about["thickness_assumed_mm"] == 1 and about["edge_mm"] == 5


@pytest.mark.parametrize(("name", "label"), [
    ('2/1 "Köper" -- <blau> \\ 7', "_2_1__K_per______blau____7"), ("é", "_")])
def test_usd_toml_and_xml_open_with_any_name(estimate, name, label):
    stage = pytest.importorskip("pxr.Usd").Stage.Open(str(exported(estimate, "usd", name=name)))
    prim = stage.GetDefaultPrim()
    assert (prim.GetName(), prim.GetDisplayName()) == (label, name)
    model = ElementTree.parse(exported(estimate, "mujoco", name=name)).getroot()
    assert model.get("model") == name
    text = exported(estimate, "ppf_addon", name=name).read_text(encoding="utf-8")
    assert list(pytest.importorskip("tomllib").loads(text)) == [name]


def test_values_beyond_what_networks_learned_are_written_at_their_limit_and_named(known):
    file = exported(known, "hood")
    assert fields_of(file, "hood")["lame_mu_override"] == 63636 < 35.0 / 4.7e-4
    assert '"limited": [\n#   "lame_mu_override"' in file.read_text()


def test_a_joint_estimate_states_the_captured_coefficient(known):
    content = json.loads(known.read_text())
    part = {"capture": content["capture"] | {"drape_coefficient_percent": 72.4},
            "moduli": content["moduli"], "warnings": []}
    replace_json(known, content | {"captures": [part]})
    assert parsed(known, "json")["drapenet"]["drape_coefficient_percent"] == 72.4
