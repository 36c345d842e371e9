from dataclasses import replace

import numpy as np
import pytest
from cloths import revolved, varied_camera

from common.findings import texts
from data.captures.capture import warnings_of
from data.captures.plate import plate_of_cloth
from data.render.cameras import QUARTERS, nominal_camera
from data.render.rays import DepthRenderer
from data.render.setups import Setups
from drapenet.report.drape import radius_profile, silhouette_overlap
from drapenet.views.checks import pose_checks
from drapenet.views.outline import count_folds
from sim.rig import Rig


def skirt(folds: int) -> tuple[np.ndarray, np.ndarray]:
    """A round table-cloth with a flat top of 50 mm radius and a wavy skirt: vertices and faces."""
    s = np.linspace(0, 1, 40)[:, None]
    phi = np.linspace(0, 2 * np.pi, 240, endpoint=False)
    drop = np.maximum(s - 0.4, 0) / 0.6
    radius = np.minimum(s / 0.4, 1) * 0.05 + drop * (0.02 + 0.02 * np.cos(folds * phi))
    return revolved(radius, -0.1 * drop, around=240)


@pytest.mark.parametrize("seed", range(5))
def test_the_camera_is_found_again(seed):
    camera = varied_camera(np.random.default_rng(seed))
    views = DepthRenderer(*skirt(7)).views(camera, 0.2)
    found = plate_of_cloth(views, camera.intrinsics, Rig()).pose
    assert np.linalg.norm(found[:3, 3] - camera.world_to_camera[:3, 3]) < 3e-3
    assert np.linalg.norm(found[:3, 2] - camera.world_to_camera[:3, 2]) < 5e-3  # rad


def test_a_camera_outside_the_set_ups_gives_a_warning():
    views = DepthRenderer(*skirt(7)).views(varied_camera(np.random.default_rng(1)), 0.2)

    def warnings(pictures: np.ndarray, **changes: float) -> str:
        nominal = replace(nominal_camera().intrinsics, **changes)
        camera = nominal.posed(plate_of_cloth(pictures, nominal, Rig()).pose)
        return "; ".join(texts(warnings_of(pose_checks(camera, Setups.load()))))

    assert warnings(views) == ""
    assert "upright" in warnings(views[:, ::-1])
    assert "above the horizontal" in warnings(views, fx=100.0, fy=100.0)
    assert "mm away" in warnings(1.5 * views)
    speck = np.zeros_like(views)
    speck[:, 80:82, 100] = 0.5
    assert warnings(speck)  # no plate at all: no crash


@pytest.mark.parametrize("folds", [4, 7, 11])
def test_folds_are_counted(folds):
    camera = nominal_camera()
    views = DepthRenderer(*skirt(folds)).views(camera, 0.2)
    located = camera.posed(plate_of_cloth(views, camera, Rig()).pose)
    profile = radius_profile(views, located, QUARTERS)
    assert count_folds(profile) == folds
    # 40 mm down, 40 % of the skirt: 50 mm + 0.4 (20 ± 20) mm, the valleys partly hidden.
    assert np.nanmax(profile) == pytest.approx(0.066, abs=0.0025)


def test_the_profile_turns_with_the_specimen():
    camera = nominal_camera()
    vertices, faces = skirt(1)  # one bulge, at azimuth 0 of the specimen
    for orientation in (0.0, 1.0, 2.5, 4.0):
        views = DepthRenderer(vertices, faces).views(camera, orientation)
        profile = radius_profile(views, camera, QUARTERS)
        azimuth = (np.nanargmax(profile) + 0.5) / len(profile) * 2 * np.pi
        assert np.cos(azimuth - orientation) > 0.9


def test_a_smooth_circle_has_no_fold_and_an_unseen_drape_neither():
    assert count_folds(np.full(180, 0.06)) == 0
    assert count_folds(np.full(180, np.nan)) is None
    wave = 0.06 + 0.004 * np.cos(5 * np.linspace(0, 2 * np.pi, 180, endpoint=False))
    assert count_folds(wave) == 5
    assert count_folds(0.06 + (wave - 0.06) / 8) == 0  # ripples within a depth step


def test_overlap_of_silhouettes():
    first, second = np.zeros((4, 10, 10)), np.zeros((4, 10, 10))
    first[:, :, :6], second[:, :, 3:9] = 0.5, 0.7
    assert silhouette_overlap(first, second) == pytest.approx(3 / 9)
    assert silhouette_overlap(first, first) == 1
