"""Refinement on surfaces: scans, their registration, and cloth pulled onto captured folds."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from cloths import revolved, varied_camera, waves
from scipy.interpolate import CloughTocher2DInterpolator

from common.errors import InputError
from common.findings import texts
from data.captures.capture import warnings_of
from data.captures.plate import plate_of_cloth
from data.fabrics.fabrics import THETA_NAMES, fabric_from_theta, to_theta
from data.render.cameras import QUARTERS, nominal_camera
from data.render.rays import DepthRenderer
from data.render.setups import Setups
from drapenet.refine.depth import DepthViews
from drapenet.refine.positions import RobustPositions, fidelity
from drapenet.refine.search import CapturedScan, search
from drapenet.refine.unknowns import Unknowns
from drapenet.report.drape import radius_profile, silhouette_overlap
from drapenet.surface.registration import flat_turn, read_shape, register, scan_capture
from drapenet.surface.shape import CapturedShape, Cloud, distances
from drapenet.surface.springs import (
    MAX_HINGE_ANGLE,
    Surface,
    captured_shape,
    plane_springs,
    uncrumpled,
)
from drapenet.views.checks import pose_checks
from drapenet.views.located import LocatedViews
from drapenet.views.outline import count_folds
from infer import main
from sim.draping import Drape, drape, follow
from sim.energies.hinges import Hinges, hinge_angles
from sim.material import MICRO, Fabric
from sim.mesh import vertex_normals
from sim.rig import DISC_RIG, Rig
from sim.scene import Scene, make_specimen
from sim.solver.newton import NewtonOptions

SETTLING = NewtonOptions(residual=1e-3, step=1e-3, max_iterations=300)
THETA = to_theta(np.array([90e-6, 60e-6, 55e-6]), np.array([-150e-9, -80e-9, -90e-9]))


@pytest.fixture(scope="module")
def captured() -> CapturedShape:
    """A simulated drape of THETA, its rest points turned by 0.3 rad against the warp."""
    result = drape(fabric_from_theta(THETA), rig=DISC_RIG, edge=7e-3)
    assert result.converged
    turned = Unknowns.of(THETA, warp=-0.3).rest(result.rest, DISC_RIG)
    return CapturedShape(result.positions, turned, result.faces, DISC_RIG)


def settle(shape: CapturedShape, theta: np.ndarray, warp: float = 0.0) -> Drape:
    """The drape that cloth of theta (6,) falls into when it is let go at ``shape``."""
    near = shape.as_drape(fabric_from_theta(theta))
    rest = Unknowns.of(theta, warp=warp).rest(near.rest, DISC_RIG)
    return follow(near.on(near.mesh.with_rest(rest)), near.fabric, options=SETTLING)


def test_the_shape_of_a_drape_is_its_own_equilibrium(captured):
    settled = settle(captured, THETA, 0.3)
    assert settled.converged
    found = fidelity(captured, settled)
    assert found.surface_mm <= found.displacement_mm < 0.01
    assert found.coefficient == pytest.approx(found.captured_coefficient, abs=0.1)
    np.testing.assert_array_equal(settled.positions[captured.held],
                                  captured.positions[captured.held])


def test_a_search_recovers_the_moduli_and_the_direction(captured):
    away = THETA + np.array([0.25, -0.1, 0.2, 4e-4, -4e-4, 3e-4])
    found = search(CapturedScan(captured), [Unknowns.of(away, warp=0.15)],
                   free=(*THETA_NAMES, "warp"))
    assert fidelity(captured, found.released).displacement_mm < 0.2
    np.testing.assert_allclose(found.best.unknowns.theta[:3], THETA[:3], atol=0.05)
    assert found.best.unknowns["warp"] == pytest.approx(0.3, abs=0.05)
    assert found.improved


def test_a_scan_is_seen_as_a_capture(captured):
    assert flat_turn(captured) == pytest.approx(-0.3, abs=1e-3)
    seen = scan_capture(Path("scan.npz"), captured, 0.2, 0.4)
    assert seen.views.shape[0] == 4 and seen.density == 0.2 and seen.rig == DISC_RIG
    assert seen.warp_direction == 0.4
    assert (seen.views > 0).mean() > 0.05


def test_held_cloth_is_free_along_the_surface(captured):
    scene = captured.as_drape(fabric_from_theta(THETA)).scene
    springs = plane_springs(scene, captured.positions, pull=0.05)
    q = captured.positions.ravel()
    assert springs.value(q) == 0.0
    normals = vertex_normals(captured.positions, captured.faces)
    push = springs.gradient(q + 1e-3 * normals.ravel())
    weight = 0.3 * 9.81 * scene.mesh.vertex_areas[~captured.held]
    np.testing.assert_allclose(np.linalg.norm(push, axis=1), 0.05 * weight, rtol=1e-3)
    along = np.cross(normals, [0.0, 0.0, 1e-3])
    assert springs.value(q + along.ravel()) < 1e-20


@pytest.fixture(scope="module")
def scanned() -> Drape:
    """A drape on another mesh."""
    fabric = fabric_from_theta(THETA)
    return drape(fabric, rig=DISC_RIG, edge=4e-3, start="sine", seed=3)


def test_a_raw_scan_is_registered_without_stretching_the_cloth(scanned):
    noise = np.random.default_rng(4).normal(0, 3e-4, scanned.positions.shape)
    cloud = Cloud.of_mesh(scanned.positions + noise, scanned.faces[:, ::-1])
    found = register(cloud, DISC_RIG, edge=6e-3)
    shape = found.shape
    assert 1e3 * found.distance < 0.5
    assert shape.strain < 0.01
    # Vertices lie where the same point of the specimen was draped.
    inside = shape.rest * (1 - 1e-3)
    truth = CloughTocher2DInterpolator(scanned.rest, scanned.positions)(inside)
    gap = 1e3 * np.linalg.norm(shape.positions - truth, axis=1)
    assert np.nanmean(gap[shape.hanging]) < 1.0
    assert settle(shape, THETA).converged


def test_a_scan_whose_vertices_slid_is_laid_again(tmp_path, scanned):
    c, s = math.cos(0.7), math.sin(0.7)
    turned = scanned.rest @ np.array([[c, -s], [s, c]])  # first rest axis at 0.7 rad on the plate
    file = tmp_path / "scan.npz"
    np.savez(file, vertices=scanned.positions, rest=turned, faces=scanned.faces)
    found = read_shape(file, DISC_RIG, edge=6e-3)
    own = found.shape
    assert found.distance == 0.0
    np.testing.assert_array_equal(own.positions, scanned.positions)

    wave = 1.5e-3 * np.sin(100 * turned[:, ::-1]) * own.hanging[:, None]
    slid = np.minimum(np.linalg.norm(turned + wave, axis=1), 0.15)
    angle = np.arctan2(*(turned + wave).T[::-1])
    np.savez(file, vertices=scanned.positions, faces=scanned.faces,
             rest=np.column_stack([slid * np.cos(angle), slid * np.sin(angle)]))
    found = read_shape(file, DISC_RIG, edge=6e-3)
    shape = found.shape
    assert found.distance > 0.0 and shape.strain < 0.01
    plate = ~shape.hanging
    np.testing.assert_allclose(shape.rest[plate] @ [[c, s], [-s, c]], shape.positions[plate, :2],
                               atol=1e-4)


def test_a_surface_that_no_specimen_can_be_laid_on_is_refused(tmp_path, scanned):
    x = scanned.rest[:, 0]
    radius = np.linalg.norm(scanned.rest, axis=1)
    table = np.random.default_rng(0).uniform(-0.25, 0.25, (len(scanned.positions) // 3, 3))
    table[:, 2] = scanned.positions[:, 2].min() - 0.03
    for name, points in (("part", scanned.positions[(x < 0) | (radius < 0.1)]),
                         ("points", scanned.positions),
                         ("table", np.concatenate([scanned.positions, table]))):
        trimesh.PointCloud(points).export(tmp_path / f"{name}.ply")
    trimesh.Trimesh(1.2 * scanned.positions, scanned.faces).export(tmp_path / "large.ply")
    for name, message in (("part", "mm from this surface on average and does not fit"),
                          ("large", "of its points do not lie on a specimen of disc300")):
        with pytest.raises(InputError, match=message):
            read_shape(tmp_path / f"{name}.ply", DISC_RIG, edge=8e-3)
    for name, warnings in (("points", []), ("table", ["scan_table"])):
        found = read_shape(tmp_path / f"{name}.ply", DISC_RIG, edge=8e-3)
        assert found.distance < 1e-3 and found.shape.strain < 0.01
        assert [warning.code for warning in found.warnings] == warnings


@pytest.mark.slow
def test_the_command_refines_a_scan(tmp_path, captured, untrained_checkpoint):
    scan = tmp_path / "scan.npz"
    np.savez(scan, vertices=captured.positions, rest=captured.rest, faces=captured.faces)
    main([f"scan={scan}", "refine=simulation", "density_g_m2=300", "warp_direction_deg=0",
          f"out={tmp_path / 'out'}", f"checkpoint={untrained_checkpoint}"])
    content = json.loads((tmp_path / "out" / "estimate.json").read_text())
    assert content["refined"]["fidelity"]["displacement_mm"] < 1.0
    alpha = [content["moduli_at_300_g_m2"][name]["alpha_uN_m"] for name in ("warp", "weft")]
    for found, truth in zip(alpha, (90.0, 55.0), strict=True):
        low, high = found["interval_90"]
        assert low < truth < high
    assert (tmp_path / "out" / "report.png").stat().st_size > 10_000


def test_derivatives_match_central_differences(disc):
    target = waves(disc.mesh.rest)
    objective = RobustPositions(target, vertices=~disc.held, sigma=1e-3, limit=2.0)
    rng = np.random.default_rng(0)
    positions = waves(disc.mesh.rest, depth=0.018) + rng.normal(0, 1e-3, target.shape)
    found = objective.linearised(positions, np.zeros(0))
    np.testing.assert_array_equal(found.residuals, objective.residuals(positions, np.zeros(0)))
    moves = rng.normal(0, 1.0, (2, *positions.shape))
    h = 1e-8
    expected = np.stack([(objective.residuals(positions + h * m, np.zeros(0))
                          - objective.residuals(positions - h * m, np.zeros(0))) / (2 * h)
                         for m in moves], axis=1)
    assert np.abs(found.along(moves) - expected).max() < 1e-4 * np.abs(expected).max()


def test_raw_points_get_the_normals_of_the_surface():
    rng = np.random.default_rng(1)
    rest = rng.uniform(-0.15, 0.15, (12000, 2))
    cloud = Cloud.of_points(np.column_stack([rest, np.zeros(len(rest))]))
    assert np.abs(cloud.normals[:, 2]).min() > 1 - 1e-9
    above = np.array([[0.0, 0.0, 2e-3], [0.25, 0.0, 0.0]])  # over the surface, and beyond its hem
    assert distances(cloud, above) == pytest.approx([2e-3, 0.1], abs=2e-3)
    with pytest.raises(InputError, match="too few"):
        Cloud.of_points(np.zeros((20, 3)))


def bent(scene: Scene, positions: np.ndarray) -> np.ndarray:
    hinges = Hinges(scene.mesh, scene.active)
    return np.abs(hinge_angles(positions.ravel(), hinges.dofs)) > MAX_HINGE_ANGLE


def test_crumpled_cloth_is_smoothed_and_other_cloth_stays():
    scene = make_specimen(Rig(), edge=8e-3)
    rest = scene.mesh.rest
    crumpled = np.column_stack([rest, np.zeros(len(rest))])
    far = np.linalg.norm(rest, axis=1) > 0.09
    crumpled[far, 2] = np.random.default_rng(0).uniform(-0.02, 0.02, far.sum())
    assert bent(scene, crumpled).sum() > 50
    smooth = uncrumpled(scene, crumpled)
    assert not bent(scene, smooth).any()
    np.testing.assert_array_equal(smooth[scene.held], crumpled[scene.held])
    wavy = np.column_stack([rest, 0.01 * np.sin(40 * rest[:, 0])])
    assert not bent(scene, wavy).any()
    np.testing.assert_array_equal(uncrumpled(scene, wavy), wavy)


def test_soft_cloth_takes_the_captured_folds():
    fabric = Fabric(np.full(3, 5 * MICRO), np.full(3, -2e-3 * 5 * MICRO))
    truth = drape(fabric, edge=4e-3, seed=3)
    camera, turn = nominal_camera(), 0.4
    views = DepthRenderer(truth.positions, truth.faces).views(camera, turn)
    located = LocatedViews.exact(views, camera, Rig(), QUARTERS)
    objective = DepthViews(located, make_specimen(Rig(), edge=4e-3).mesh.faces, turn=turn)
    surface = Surface(*objective.points(objective.start), Rig())
    shape = captured_shape(fabric, surface, edge=4e-3)
    seen = objective.render(shape.positions, objective.start)
    apart = np.abs(seen - views)[(seen > 0) & (views > 0)]
    assert np.median(apart) < 0.5e-3 and np.quantile(apart, 0.9) < 3e-3
    assert shape.self_intersections < 5


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


@pytest.mark.parametrize(("folds", "orientation"), [
    (4, 0.2), (7, 0.2), (11, 0.2), (1, 1.0), (1, 2.5), (1, 4.0)])
def test_folds_are_counted_where_they_are(folds, orientation):
    camera = nominal_camera()
    views = DepthRenderer(*skirt(folds)).views(camera, orientation)
    located = camera if folds == 1 else camera.posed(plate_of_cloth(views, camera, Rig()).pose)
    profile = radius_profile(views, located, QUARTERS)
    # 40 mm down, 40 % of the skirt: 50 mm + 0.4 (20 ± 20) mm, the valleys partly hidden.
    assert np.nanmax(profile) == pytest.approx(0.066, abs=0.0025)
    if folds > 1:
        assert count_folds(profile) == folds
    else:  # a bulge, at azimuth 0 of the specimen
        azimuth = (np.nanargmax(profile) + 0.5) / len(profile) * 2 * np.pi
        assert np.cos(azimuth - orientation) > 0.9


def test_a_smooth_circle_has_no_fold_and_an_unseen_drape_neither():
    assert count_folds(np.full(180, np.nan)) is None
    wave = np.cos(5 * np.linspace(0, 2 * np.pi, 180, endpoint=False))
    for depth, folds in ((0.0, 0), (0.004, 5), (0.0005, 0)):  # the last within a depth step
        assert count_folds(0.06 + depth * wave) == folds


def test_overlap_of_silhouettes():
    first, second = np.zeros((4, 10, 10)), np.zeros((4, 10, 10))
    first[:, :, :6], second[:, :, 3:9] = 0.5, 0.7
    assert silhouette_overlap(first, second) == pytest.approx(3 / 9)
    assert silhouette_overlap(first, first) == 1
