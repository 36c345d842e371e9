"""The script for Blender, with stand-ins for the parts of ``bpy`` that it uses; in Blender itself
where it is installed for Python 3.11: pip install 'bpy>=5,<6' in ``.venv-blender``."""

import math
import runpy
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from estimates import document_of, estimate_of
from scipy.spatial import Delaunay

from common.files import replace_json
from drapenet.export.formats import export
from drapenet.export.material import read_material
from sim.material import DRAPE_CURVATURE, secant
from sim.rig import Rig

ALPHA, DENSITY = np.array([52e-6, 31e-6, 22e-6]), 0.21
BETA = -2e-3 * ALPHA
BLENDER = Path(__file__).parents[2] / ".venv-blender" / "bin" / "python"
STATED = {"mass", "bending_model", "bending_stiffness", "tension_stiffness",
          "compression_stiffness", "shear_stiffness", "quality"}
GARMENT = """
import runpy, sys
import bpy
for kind, where in (("grid", 0.0), ("cube", 3.0)):
    add = getattr(bpy.ops.mesh, f"primitive_{kind}_add")
    add(location=(where, 0, 0), **({"x_subdivisions": 50, "y_subdivisions": 50, "size": 0.5}
                                   if kind == "grid" else {}))
garment = bpy.data.objects["Grid"]
garment.vertex_groups.new(name="waist").add([0, 50], 1.0, "REPLACE")
cloth = garment.modifiers.new("Cloth", "CLOTH")
cloth.settings.vertex_group_mass, cloth.settings.air_damping = "waist", 3.0
bpy.ops.object.select_all(action="DESELECT")
garment.select_set(True)
here = {thing.name for thing in bpy.data.objects}
runpy.run_path(sys.argv[1], run_name="__main__")
assert {thing.name for thing in bpy.data.objects} == here, list(bpy.data.objects)
kept = cloth.settings.vertex_group_mass, cloth.settings.air_damping
assert kept == ("waist", 3.0), kept
assert [each.type for each in garment.modifiers] == ["TRIANGULATE", "CLOTH"]
for frame in range(1, 41):
    bpy.context.scene.frame_set(frame)
shown = garment.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
heights = [vertex.co.z for vertex in shown.vertices]
assert abs(heights[0]) < 1e-3 and min(heights) < -0.1, (heights[0], min(heights))
print("as it should")
"""


class Point(np.ndarray):
    """Of a mesh, (3,), m."""

    @property
    def length(self) -> float:
        return float(np.linalg.norm(self))


class Modifiers(list):
    """Of an object, in their order."""

    def new(self, name: str, kind: str) -> SimpleNamespace:
        settings = SimpleNamespace(
            vertex_group_mass="", quality=5, mass=0.3, air_damping=1.0, tension_damping=5.0,
            use_pressure=False, bending_model="LINEAR", bending_stiffness=0.5,
            tension_stiffness=15.0, compression_stiffness=15.0, shear_stiffness=5.0)
        self.append(SimpleNamespace(name=name, type=kind, settings=settings,
                                    collision_settings=SimpleNamespace(
                                        self_friction=5.0, use_self_collision=False)))
        return self[-1]

    def move(self, start: int, end: int) -> None:
        self.insert(end, self.pop(start))


def thing(name: str, points: np.ndarray, faces: np.ndarray) -> SimpleNamespace:
    """A mesh object of flat faces (F, 3 or 4) that have equal areas."""
    pairs = {tuple(sorted(pair)) for face in faces for pair in zip(
        face, np.roll(face, 1), strict=True)}
    area = math.prod(np.ptp(points[:, :2], axis=0)) / len(faces)
    return SimpleNamespace(
        name=name, type="MESH", modifiers=Modifiers(), data=SimpleNamespace(
            vertices=[SimpleNamespace(co=np.array(point).view(Point)) for point in points],
            edges=[SimpleNamespace(vertices=pair) for pair in pairs],
            polygons=[SimpleNamespace(vertices=face, area=area) for face in faces]),
        matrix_world=SimpleNamespace(to_3x3=lambda: SimpleNamespace(determinant=lambda: 1.0)))


def quads(count: int = 20, side: float = 0.2) -> SimpleNamespace:
    """A square garment of squares."""
    x, y = np.meshgrid(*[np.linspace(0, side, count + 1)] * 2)
    first = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).ravel()
    return thing("skirt", np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()]),
                 first[:, None] + [0, 1, count + 2, count + 1])


@pytest.fixture
def scene(monkeypatch) -> SimpleNamespace:
    """The context of a Blender without a window in which nothing is saved or selected."""
    context = SimpleNamespace(selected_objects=[])
    for name, content in (
            ("bpy", {"context": context, "app": SimpleNamespace(background=True),
                     "data": SimpleNamespace(filepath="")}),  # no ops: what empties a scene fails
            ("mathutils", {}), ("mathutils.geometry", {"delaunay_2d_cdt": lambda points, *_: (
                [np.array(point) for point in points], [], Delaunay(points).simplices.tolist(),
                [])})):
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    return context


def script(folder: Path, tension: dict | None = None, **about: object) -> Path:
    """The exported script of an estimate whose capture has these changes."""
    document = document_of(estimate_of(ALPHA, BETA, density=DENSITY, deviation=0.01))
    content = document.content() | ({"tension": tension} if tension else {})
    replace_json(folder / "estimate.json", content | {"capture": content["capture"] | about})
    return export(read_material(folder), "blender", folder / "fabric_blender.py")[0]


@pytest.mark.parametrize("dressed", [False, True])
def test_a_garment_of_quads_keeps_its_pins_and_what_is_not_stated(
        scene, tmp_path, capsys, dressed):
    garment = quads()
    scene.selected_objects.append(garment)
    if dressed:
        for kind in ("CLOTH", "SUBSURF", "TRIANGULATE"):
            garment.modifiers.new(kind, kind)
        garment.modifiers[0].settings.__dict__.update(
            vertex_group_mass="waist", air_damping=3.0, use_pressure=True, quality=40)
    else:
        garment.modifiers.new("bevel", "BEVEL")
    first = Modifiers().new("", "CLOTH").settings
    before = vars(garment.modifiers[0].settings if dressed else first).copy()
    runpy.run_path(str(script(tmp_path)), run_name="__main__")
    kinds = [each.type for each in garment.modifiers]
    assert kinds == (["TRIANGULATE", "CLOTH", "SUBSURF"] if dressed else
                     ["BEVEL", "TRIANGULATE", "CLOTH"])
    after = vars(garment.modifiers[kinds.index("CLOTH")].settings)
    assert {key for key in after if after[key] != before[key]} == (
        STATED - {"quality"} if dressed else STATED)
    vertex = 0.2**2 / 21**2  # m²
    warp, bias, weft = secant(DRAPE_CURVATURE, ALPHA, BETA)
    assert after["mass"] == pytest.approx(1000 * DENSITY * vertex)
    assert after["bending_stiffness"] == pytest.approx(
        1000 * ((warp**-3 + 2 * bias**-3 + weft**-3) / 4) ** (-1 / 3) / 18 / vertex, rel=0.05)
    assert after["quality"] == (40 if dressed else 15)
    printed = capsys.readouterr().out
    assert printed.startswith("skirt: cloth of ") and all(name in printed for name in STATED)
    assert "skirt: self-collision is off" in printed
    runpy.run_path(str(tmp_path / "fabric_blender.py"), run_name="__main__")
    assert kinds == [each.type for each in garment.modifiers] and vars(
        garment.modifiers[kinds.index("CLOTH")].settings) == after


def test_cloth_of_known_shear_and_friction_has_springs_of_that_shear(scene, tmp_path, capsys):
    """Springs of k on triangles of equal sides are a sheet of the shear stiffness sqrt(3)/4 k, and
    Blender's k is the tension over the mean edge; its friction is in hundredths."""
    garment = quads()
    scene.selected_objects.append(garment)
    shear = {"median": 335.0, "interval_68": [330.0, 340.0], "interval_90": [328.0, 344.0]}
    runpy.run_path(str(script(tmp_path, tension={
        "source": "strips", "density_g_m2": 210, "strips": 1, "measured": ["bias"],
        "shear_n_per_m": shear, "stretch_n_per_m": {"warp": shear, "weft": shear},
        "friction_n_per_m": {}, "weight_for_10_percent_g": {}, "readings": {}, "findings": [],
        "along_yarns": False, "known": {"friction_deg": {"fabric": 30}}})), run_name="__main__")
    cloth = garment.modifiers[-1]
    edge = np.mean([np.ptp([garment.data.vertices[k].co for k in pair], axis=0).max()
                    for pair in (line.vertices for line in garment.data.edges)])
    for name in ("tension", "compression", "shear"):
        assert getattr(cloth.settings, f"{name}_stiffness") / edge * math.sqrt(3) / 4 == (
            pytest.approx(335, rel=1e-6))
    assert cloth.collision_settings.self_friction == pytest.approx(100 * math.tan(math.pi / 6))
    printed = capsys.readouterr().out
    assert "self_friction 57.7" in printed
    assert "not known: stretch along the warp, stretch along the weft, thickness" in printed


@pytest.mark.parametrize(("rig", "tested"), [
    ("square300_cylinder100", "square300_cylinder100"),
    ("rectangle400x250_cylinder120", "rectangle400x250_cylinder120"),
    ("disc240_support180, square300_cylinder100", "disc240_support180"),
    ("square600_corners500, disc360_support180", "disc360_support180"), ("", "disc300_support180")])
@pytest.mark.parametrize("percent", [None, 41.5])
def test_the_captured_specimen_is_draped_beside_what_is_there(
        scene, tmp_path, capsys, monkeypatch, rig, tested, percent):
    made, linked = {}, []

    def new(name: str, mesh: object) -> SimpleNamespace:
        one = thing(name, np.array(made["points"]), np.array(made["faces"]))
        vars(one).update(
            vertex_groups=SimpleNamespace(new=lambda name: SimpleNamespace(
                add=lambda chosen, *_: made.update(pinned=chosen))),
            evaluated_get=lambda _: SimpleNamespace(to_mesh=lambda: one.data))  # it stays flat
        vars(one.modifiers.new("", "CLOTH")).update(
            collision_settings=SimpleNamespace(use_self_collision=False),
            point_cache=SimpleNamespace(frame_end=250))
        return one

    vars(sys.modules["bpy"].data).update(
        objects=SimpleNamespace(new=new), meshes=SimpleNamespace(new=lambda name: SimpleNamespace(
            from_pydata=lambda points, _, faces: made.update(points=points, faces=faces))))
    coarse = quads(count=2)
    vars(scene).update(
        selected_objects=[coarse], evaluated_depsgraph_get=lambda: None,
        collection=SimpleNamespace(objects=SimpleNamespace(link=linked.append)),
        scene=SimpleNamespace(frame_set=lambda frame: None, frame_end=75, use_gravity=True,
                              gravity=(0.0, 0.0, -9.81)))
    runpy.run_path(str(script(tmp_path, rig=rig, drape_coefficient_percent=percent)),
                   run_name="__main__")
    printed = capsys.readouterr().out
    captured = f"the captured cloth had {percent} %"
    expected = Rig.from_name(tested)
    assert "skirt: not made cloth, its edges are 100 mm long" in printed and not coarse.modifiers
    assert f"folds here on {expected.name}" in printed and "None" not in printed
    assert "self-collision" not in printed  # the drape test needs none
    assert (captured in printed) == (percent is not None and rig != "")
    coefficient = float(printed.partition("coefficient ")[2].partition(" %")[0])
    assert coefficient == pytest.approx(100, abs=0.3)  # of flat cloth; a hem is a polygon
    flat = np.array(made["points"])[:, :2]
    assert np.ptp(flat, axis=0) == pytest.approx(expected.sides, abs=2e-4)
    held = np.hypot(*flat[made["pinned"]].T)
    assert 0.9 < held.max() / expected.plate_radius < 1.01
    assert linked[0].modifiers[0].settings.vertex_group_mass == "plate"
    assert scene.scene.frame_end == 75


@pytest.mark.parametrize(("kinds", "reason"), [
    (["SUBSURF"], "SUBSURF before the cloth changes its mesh; apply it"),
    (["MIRROR", "CLOTH"], "MIRROR before the cloth"), (["COLLISION"], "it is an obstacle")])
def test_what_another_modifier_changes_is_named(scene, tmp_path, capsys, kinds, reason):
    garment, other = quads(), quads()
    scene.selected_objects += [garment, other]
    for kind in kinds:
        garment.modifiers.new(kind, kind)
    runpy.run_path(str(script(tmp_path)), run_name="__main__")
    printed = capsys.readouterr().out.splitlines()
    assert f"skirt: not made cloth, {reason}" in printed[0]
    assert [each.type for each in garment.modifiers] == kinds
    assert printed[2] == "skirt: self-collision is off; garments need it"


@pytest.mark.slow
@pytest.mark.skipif(not BLENDER.exists(), reason="no bpy>=5,<6 in .venv-blender")
def test_a_pinned_garment_of_quads_hangs_in_blender(tmp_path):
    done = subprocess.run([BLENDER, "-c", GARMENT, script(tmp_path)], capture_output=True,
                          text=True)
    assert "as it should" in done.stdout, done.stdout + done.stderr
