"""Testers of several sizes: draped, rendered, written, read back, and their plates measured."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from common.errors import InputError
from data.captures.capture import read_capture, write_capture
from data.captures.description import whole_turns
from data.captures.plate import plate_diameter
from data.render.cameras import nominal_camera
from data.render.rays import VIEWS, DepthRenderer
from data.render.scenes import raw_scene
from sim.drape import Drape, drape
from sim.material import MICRO, Fabric
from sim.rig import Rig

NAMES = ("disc240_support180", "square300_cylinder100", "disc360_support120")
PLATE_ERROR, ERROR_IN_SCENE = 6e-3, 8e-3  # m, in views without noise and in scenes with it


@pytest.fixture(scope="module", params=NAMES)
def shape(request) -> Drape:
    """A drape of a rather stiff fabric."""
    return drape(Fabric(alpha=[60 * MICRO] * 3, beta=[0.0] * 3), rig=Rig.from_name(request.param),
                 edge=6e-3, seed=1)


def state_tester(folder: Path, tester: object) -> None:
    """Write ``tester`` to the description of a capture; None: remove it."""
    file = folder / "capture.yaml"
    content = yaml.safe_load(file.read_text()) | {"tester": tester}
    file.write_text(yaml.safe_dump({k: v for k, v in content.items() if v is not None}))


def test_a_tester_of_any_size_drapes_renders_and_reads_back(tmp_path, shape):
    rig = shape.rig
    views = DepthRenderer(shape.positions, shape.faces).views(nominal_camera(rig), 0.3)
    folder = tmp_path / "capture"
    write_capture(folder, views=views, intrinsics=nominal_camera(rig).intrinsics, density=0.3,
                  rig=rig)
    state_tester(folder, {"specimen": rig.specimen, "size_mm": round(1e3 * rig.specimen_size),
                          "plate_mm": round(1e3 * rig.plate_diameter)})
    capture = read_capture(folder)
    assert shape.converged and capture.rig == rig and capture.warnings == ()
    cloth = capture.views > 0
    assert np.abs(capture.views - views)[cloth].max() < 0.51e-3
    assert cloth.sum() > 0.999 * (views > 0).sum()  # few pixels are taken for outliers
    assert plate_diameter(capture.views, capture.intrinsics) == pytest.approx(
        rig.plate_diameter, abs=PLATE_ERROR)


def test_a_missing_tester_is_refused_with_the_plate_of_the_scene(tmp_path, shape):
    plate = shape.rig.plate_diameter
    scene = raw_scene(shape.positions, shape.faces, np.random.default_rng(1), rig=shape.rig,
                      turns=whole_turns(VIEWS), sensor="smooth")
    folder = tmp_path / "capture"
    write_capture(folder, views=scene.frames, intrinsics=scene.camera.intrinsics, density=0.3,
                  rig=shape.rig)
    assert read_capture(folder).cut is not None
    state_tester(folder, None)
    with pytest.raises(InputError, match="states no tester; the pictures show a plate") as error:
        read_capture(folder)
    words = str(error.value).partition("about ")[2].split()
    assert float(words[0]) == pytest.approx(1e3 * plate, abs=1e3 * ERROR_IN_SCENE)
    assert (shape.rig.name in words) == (shape.rig.name != "disc360_support120")


def test_pictures_without_a_plate_leave_the_choices(tmp_path):
    views = np.zeros((1, 180, 240))
    views[:, 40:140, 60:180] = 0.5
    write_capture(tmp_path / "c", views=views, intrinsics=nominal_camera().intrinsics, density=0.2,
                  rig=Rig())
    state_tester(tmp_path / "c", None)
    with pytest.raises(InputError, match="states no tester; give tester: square300_cylinder100, d"):
        read_capture(tmp_path / "c")
