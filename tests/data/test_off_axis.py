"""Outlines from beside the axis, as from the axis: by the bundled network, and its training."""

import subprocess
import sys

import numpy as np
import pytest
from safetensors.torch import load_file

from common.errors import InputError
from data.captures.off_axis import BUNDLED, seen_from_axis
from data.dataset.folder import MANIFEST
from data.dataset.off_axis import AZIMUTHS, OffAxisNetwork, main, silhouette
from sim.draping import drape
from sim.material import Fabric
from sim.mesh import Mesh
from sim.rig import DISC_RIG, Rig

HEIGHT = 0.7
AZIMUTH = np.arange(720) * (np.pi / 360)
AROUND = np.column_stack([np.cos(AZIMUTH), np.sin(AZIMUTH)])


@pytest.fixture(scope="module")
def shape():
    fabric = Fabric(alpha=[20e-6, 15e-6, 12e-6], beta=[-20e-9] * 3, density=0.15)
    return drape(fabric, rig=DISC_RIG, edge=9e-3)


def rms_mm(one: np.ndarray, other: np.ndarray) -> float:
    return 1e3 * float(np.sqrt(np.square(one - other).mean()))


def corrected(radius: np.ndarray, beside: np.ndarray, rig: Rig = DISC_RIG) -> np.ndarray:
    found = seen_from_axis(radius[:, None] * AROUND, beside, HEIGHT, rig)
    assert found.shape == (720, 2)
    return np.linalg.norm(found, axis=1)


def test_most_of_what_a_camera_beside_the_axis_changes_is_taken_back(shape):
    edges = Mesh(shape.rest, shape.faces).edges
    exact = silhouette(shape.positions, edges, np.zeros(2), HEIGHT, azimuths=720)
    for distance, turn in ((0.06, 0.3), (0.12, 2.0), (0.2, 4.5)):
        beside = distance * np.array([np.cos(turn), np.sin(turn)])
        seen = silhouette(shape.positions, edges, beside, HEIGHT, azimuths=720)
        assert rms_mm(seen, exact) > 1.5
        # By the distance of each part of the hem alone, a quarter to a third would remain.
        assert rms_mm(corrected(seen, beside), exact) < 0.2 * rms_mm(seen, exact)


@pytest.mark.parametrize("rig", [DISC_RIG, Rig((0.2, 0.25), 0.1, "rectangle")],
                         ids=lambda rig: rig.specimen)
def test_on_the_axis_the_outermost_points_stay(rig):
    radius = 0.12 + 0.01 * np.cos(7 * AZIMUTH + 1) + 0.002 * np.cos(31 * AZIMUTH)
    np.testing.assert_allclose(corrected(radius, np.zeros(2), rig), radius, atol=1e-6)


def test_a_camera_around_a_disc_finds_the_same_outline():
    radius, beside = 0.12 + 0.01 * np.cos(7 * AZIMUTH + np.cos(AZIMUTH)), np.array([0.1, 0.05])
    turned = beside @ [[0, 1], [-1, 0]]
    np.testing.assert_allclose(corrected(np.roll(radius, 180), turned),
                               np.roll(corrected(radius, beside), 180), atol=1e-6)


def test_torch_is_not_imported_before_it_is_needed():
    code = "import data.captures.off_axis, sys; assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_network_is_trained_alike_twice_and_stored_small(cloth_dataset, tmp_path, capsys):
    files = [tmp_path / name for name in ("first.safetensors", "second.safetensors")]
    for file in files:
        main([f"data={cloth_dataset}", f"out={file}", "steps=3", "cameras=2"])
    assert files[0].read_bytes() == files[1].read_bytes()
    assert len(files[0].read_bytes()) == len(BUNDLED.read_bytes()) < 60_000
    OffAxisNetwork().load_state_dict(load_file(files[0]))
    assert "place/height" in capsys.readouterr().out


def test_silhouettes_are_those_of_points_on_the_plane_of_the_plate():
    corners = np.array([[0.1, 0.1], [-0.1, 0.1], [-0.1, -0.1], [0.1, -0.1]])
    square = np.column_stack([corners, np.full(4, -0.1)])
    edges = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    seen = silhouette(square, edges, np.array([0.35, 0.0]), HEIGHT)
    # A point 0.1 m below the plate is moved by an eighth of the camera's place.
    assert seen[[0, AZIMUTHS // 2]] == pytest.approx([0.0875 + 0.04375, 0.0875 - 0.04375])


def test_without_drapes_one_line_names_the_command(cloth_dataset, tmp_path):
    out = f"out={tmp_path / 'net.safetensors'}"
    with pytest.raises(InputError, match=r"dataset\.json is missing.*data\.dataset\.generate"):
        main([f"data={tmp_path}", out])
    (tmp_path / MANIFEST).write_bytes((cloth_dataset / MANIFEST).read_bytes())
    with pytest.raises(InputError, match="no drapes to train on"):
        main([f"data={tmp_path}", out])
