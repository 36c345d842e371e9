"""Camera conventions, the rig's jitter, and its agreement with the published captures."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from common.configs import read_option
from common.errors import InputError
from data.captures.capture import read_capture
from data.render.cameras import JITTER_LIMIT_SIGMAS, Camera, CameraRig, Intrinsics, Pose
from data.render.setups import Setups
from sim.rig import DISC_RIG, SQUARE_RIG, Rig

CAPTURES = Path(__file__).resolve().parents[3] / "shared" / "captures"


def position(camera: Camera) -> np.ndarray:
    """Optical centre in the world, (3,) m."""
    return np.linalg.inv(camera.world_to_camera)[:3, 3]


@pytest.fixture(scope="module")
def rig() -> CameraRig:
    return CameraRig.load()


def test_nominal_camera_sees_the_plate_where_the_rig_says(rig):
    camera = rig.nominal()
    (pixel,), (depth,) = camera.project(np.zeros((1, 3)))
    across = rig.pose.above
    assert np.linalg.norm(position(camera)) == pytest.approx(rig.pose.distance, abs=1e-12)
    assert depth == pytest.approx(np.sqrt(rig.pose.distance**2 - across**2), abs=1e-12)
    assert pixel == pytest.approx([119.5, 89.5 - 305.0 * across / depth], abs=1e-9)


def test_camera_stands_in_front_above_and_looks_down(rig):
    camera = rig.nominal()
    assert abs(position(camera)[0]) < 1e-12
    assert position(camera)[1] < -0.3 and position(camera)[2] > 0.2
    axis = camera.world_to_camera[2, :3]
    assert np.degrees(np.arcsin(-axis[2])) == pytest.approx(38.0)
    rotation = camera.world_to_camera[:3, :3]
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_right_is_right_up_is_up_and_away_is_deeper(rig):
    points = 0.05 * np.vstack([np.zeros(3), np.eye(3)])
    pixels, depth = rig.nominal().project(points)
    right, away, up = pixels[1:] - pixels[0]
    assert right == pytest.approx([right[0], 0.0], abs=1e-9) and right[0] > 25
    assert abs(away[0]) < 1e-9 and away[1] < -10 and depth[2] > depth[0] + 0.03
    assert abs(up[0]) < 1e-9 and up[1] < -15


def test_positive_roll_turns_the_content_clockwise(rig):
    pose = replace(rig.pose, roll=np.radians(5.0), above=0.0)
    camera = replace(rig.nominal(), world_to_camera=pose.world_to_camera())
    (foot, tip), _ = camera.project(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.05]]))
    lean = np.degrees(np.arctan2(tip[0] - foot[0], foot[1] - tip[1]))
    assert lean == pytest.approx(5.0, abs=1e-6)


def test_offsets_move_the_plate_across_the_picture():
    pose = Pose(distance=0.5, pitch=0.6, above=0.04, aside=-0.03, roll=0.05)
    centre = pose.world_to_camera() @ [0, 0, 0, 1]
    assert centre[:2] == pytest.approx([-0.03, -0.04])
    assert np.linalg.norm(centre[:3]) == pytest.approx(0.5)


def test_pixel_centres_lie_on_whole_numbers(rig):
    camera = rig.sample(np.random.default_rng(3))
    depth = np.full((camera.height, camera.width), 0.5)
    local = camera.back_project(depth)
    assert (local[..., 2] == 0.5).all()
    row, column = 17, 203
    rotation, shift = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
    world = (local[row, column] - shift) @ rotation
    (pixel,), (z,) = camera.project(world[None])
    assert pixel == pytest.approx([column, row], abs=1e-9) and z == pytest.approx(0.5)


def test_resized_keeps_the_corners_of_the_picture(rig):
    camera = rig.sample(np.random.default_rng(4))
    small = camera.resized(120, 90)
    point = np.array([[0.03, -0.02, -0.06]])
    (large_px,), _ = camera.project(point)
    (small_px,), _ = small.project(point)
    assert (small_px + 0.5) * 2 == pytest.approx(large_px + 0.5, abs=1e-9)
    assert (small.width, small.height) == (120, 90)


def test_samples_vary_within_the_limit_and_repeat_with_the_seed(rig):
    rng = np.random.default_rng(0)
    cameras = [rig.sample(rng) for _ in range(2000)]
    again = rig.sample(np.random.default_rng(0))
    assert again.fx == cameras[0].fx
    assert (again.world_to_camera == cameras[0].world_to_camera).all()
    distance = np.array([np.linalg.norm(position(c)) for c in cameras])
    focal = np.array([c.fx for c in cameras])
    aside = np.array([c.world_to_camera[0, 3] for c in cameras])
    for values, nominal, sigma in (
        (distance, rig.pose.distance, rig.jitter["distance"]),
        (focal, rig.intrinsics.fx, rig.intrinsics.fx * rig.jitter["focal"]),
        (aside, rig.pose.aside, rig.jitter["aside"]),
    ):
        deviate = (values - nominal) / sigma
        assert np.abs(deviate).max() <= JITTER_LIMIT_SIGMAS + 1e-9
        # A normal cut off at two standard deviations keeps 0.880 of its own.
        assert deviate.std() == pytest.approx(0.880, abs=0.03)
        assert abs(deviate.mean()) < 0.06


def test_every_set_up_keeps_the_specimen_in_the_picture_sideways(rig):
    # The hem of a stiff drape reaches about 110 mm from the axis, 60 mm below the plate.
    angle = np.linspace(0, 2 * np.pi, 60)
    ring = np.stack([0.11 * np.cos(angle), 0.11 * np.sin(angle), np.full(60, -0.06)], axis=1)
    rng = np.random.default_rng(1)
    for _ in range(200):
        pixels, _ = rig.sample(rng).project(ring)
        assert pixels[:, 0].min() > 0 and pixels[:, 0].max() < 239 and pixels[:, 1].min() > 0


@pytest.mark.parametrize("name", ["disc200_support100", "disc400_support200",
                                  "square400_cylinder60"])
def test_pictures_of_specimens_of_all_sizes_look_alike(name):
    tester = Rig.from_name(name)
    measured = DISC_RIG if tester.specimen == "disc" else SQUARE_RIG
    ring = np.array([[np.cos(a), np.sin(a), -0.1] for a in np.linspace(0, 6, 9)])
    pixels, expected = (
        CameraRig.load(rig).sample(np.random.default_rng(3)).project(rig.reach * ring)[0]
        for rig in (tester, measured))
    assert np.allclose(pixels, expected, atol=1e-6)
    pixels, expected = (Setups.load().camera(np.random.default_rng(3), CameraRig.load(rig))
                        for rig in (tester, measured))
    assert pixels.fx * tester.reach == pytest.approx(expected.fx * measured.reach)


def test_unusable_intrinsics_are_input_errors():
    with pytest.raises(InputError, match="incomplete"):
        CameraRig.from_config({"camera": {"fx": 1.0}, "jitter": {}})
    with pytest.raises(InputError, match="positive focal"):
        Intrinsics(fx=-300, fy=300, cx=119.5, cy=89.5, width=240, height=180)
    with pytest.raises(InputError, match="inner part of the 120x90"):
        Intrinsics(fx=300, fy=300, cx=119.5, cy=89.5, width=120, height=90)


@pytest.mark.parametrize(("group", "key", "value"), [
    ("camera", "fx", "wide"), ("camera", "width", 240.5), ("camera", "pitch_deg", float("nan")),
    ("camera", "distance_mm", -527), ("jitter", "roll_deg", -1),
])
def test_rigs_that_make_no_sense(group, key, value):
    content = read_option("camera", "square300_cylinder100")
    content[group][key] = value
    with pytest.raises(InputError):
        CameraRig.from_config(content)


def flat_top(view: np.ndarray, intrinsics: Intrinsics) -> tuple[np.ndarray, np.ndarray, float]:
    """Upward normal, centroid (camera axes, m) and area (m2) of the plate's flat top."""
    points = intrinsics.back_project(view)
    top = np.argmax((view > 0).any(axis=1))
    middle = np.flatnonzero(view[top + 5]).mean()
    v, u = np.mgrid[: intrinsics.height, : intrinsics.width]
    on_plate = (np.abs(v - top - 13) < 9) & (np.abs(u - middle) < 22) & (view > 0)
    near = (view > 0) & (v < top + 40) & (np.abs(u - middle) < 45)
    for _ in range(10):
        normal = np.linalg.lstsq(points[on_plate], np.ones(on_plate.sum()), rcond=None)[0]
        height = (1 - points @ normal) / np.linalg.norm(normal)
        on_plate &= np.abs(height) < 0.003
    normal = -normal / np.linalg.norm(normal)
    flat = near & (np.abs(height) < 0.0025)
    # A pixel covers depth^2/(fx fy) across the optical axis, and more of the slanted plate.
    rays = intrinsics.directions()[flat]
    area = view[flat] ** 2 / (intrinsics.fx * intrinsics.fy) / -(rays @ normal)
    centroid = (points[flat] * area[:, None]).sum(axis=0) / area.sum()
    return normal, centroid, float(area.sum())


@pytest.mark.skipif(not CAPTURES.is_dir(), reason="the published captures are not here")
@pytest.mark.parametrize("name", ["mesh0", "mesh1"])
def test_published_captures_lie_within_the_jitter(rig, name):
    capture = read_capture(CAPTURES / name)
    limit = JITTER_LIMIT_SIGMAS
    for view in capture.views:
        normal, centre, area = flat_top(view, rig.intrinsics)
        pitch, roll = np.arcsin(-normal[2]), np.arctan2(normal[0], -normal[1])
        assert abs(pitch - rig.pose.pitch) < limit * rig.jitter["pitch"]
        assert abs(roll - rig.pose.roll) < limit * rig.jitter["roll"]
        assert abs(np.linalg.norm(centre) - rig.pose.distance) < limit * rig.jitter["distance"]
        assert abs(centre[0] - rig.pose.aside) < limit * rig.jitter["aside"]
        assert abs(-centre[1] - rig.pose.above) < limit * rig.jitter["above"]
        # A disc of 100 mm has 0.00785 m2; the cloth just outside still looks flat.
        assert 0.0075 < area < 0.0110


def test_camera_knows_its_intrinsics(rig):
    camera = rig.nominal()
    assert isinstance(camera, Camera) and camera.intrinsics == rig.intrinsics
