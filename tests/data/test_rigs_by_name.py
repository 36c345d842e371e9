"""Testers of several sizes: draped, rendered, written and read back."""

from pathlib import Path

import numpy as np
import pytest
from cloths import describe

from data.captures.description import whole_turns
from data.captures.reader import read_capture
from data.captures.writer import write_capture
from data.render.cameras import VIEWS, nominal_camera
from data.render.rays import DepthRenderer
from data.render.scenes import raw_scene
from data.rigs import PLATES
from sim.draping import Drape, drape
from sim.material import MICRO, Fabric
from sim.rig import Rig

NAMES = ("square300_cylinder100", "disc360_support120", "rectangle170x250_cylinder90")


@pytest.fixture(scope="module", params=NAMES)
def shape(request) -> Drape:
    """A drape of a rather stiff fabric."""
    return drape(Fabric(alpha=[60 * MICRO] * 3, beta=[0.0] * 3), rig=Rig.from_name(request.param),
                 edge=6e-3, seed=1)


def test_a_tester_of_any_size_drapes_renders_and_reads_back(tmp_path, shape):
    rig = shape.rig
    views = DepthRenderer(shape.positions, shape.faces).views(nominal_camera(rig), 0.3)
    folder = tmp_path / "capture"
    write_capture(folder, views=views, intrinsics=nominal_camera(rig).intrinsics, density=0.3,
                  rig=rig)
    sides = [round(1e3 * side) for side in rig.sides]
    describe(folder, tester={"specimen": rig.specimen,
                          "size_mm": sides if rig.specimen == "rectangle" else sides[0],
                          "plate_mm": round(1e3 * rig.plate_diameter)})
    capture = read_capture(folder)
    assert shape.converged and capture.rig == rig and capture.warnings == ()
    cloth = capture.views > 0
    assert np.abs(capture.views - views)[cloth].max() < 0.51e-3
    assert cloth.sum() > 0.999 * (views > 0).sum()  # few pixels are taken for outliers


def test_cloth_on_a_tester_of_any_size_is_cut_out_of_its_scene(tmp_path, shape):
    scene = raw_scene(shape.positions, shape.faces, np.random.default_rng(1), rig=shape.rig,
                      turns=whole_turns(VIEWS), sensor="smooth")
    write_capture(tmp_path / "capture", views=scene.frames, intrinsics=scene.camera.intrinsics,
                  density=0.3, rig=shape.rig)
    assert read_capture(tmp_path / "capture").cut is not None


def test_the_manual_states_heights_and_weights_of_specimens_on_a_tin():
    text = (Path(__file__).parents[2] / "docs" / "use.md").read_text("utf-8")
    text = " ".join(text.partition("#### With a tin")[2].partition("####")[0].split())
    disc, square = (Rig.from_name(name) for name in ("disc254_support127", "square250_cylinder127"))
    for rig, height in ((disc, 75), (square, 125)):
        assert f"{1e3 * rig.overhang:.0f} mm" in text and f"needs {height} mm" in text
        assert 10 <= height - 1e3 * rig.overhang < 13
    weight = 150 * disc.specimen_area
    assert f"weighs {weight:.1f} g at 150 g/m²" in text and f"one of {100 / weight:.0f} %" in text
    low, high = PLATES
    assert f"outer diameter, {low:g} to {high:g} mm" in text
