"""Scans: reading, registration, the search for their cloth, fidelity, the command."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.interpolate import CloughTocher2DInterpolator

from common.errors import InputError
from data.fabrics.fabrics import THETA_NAMES, fabric_from_theta, to_theta
from drapenet.refine.positions import fidelity
from drapenet.refine.search import CapturedScan, search
from drapenet.refine.unknowns import Unknowns
from drapenet.surface.registration import flat_turn, read_shape, register, scan_capture
from drapenet.surface.shape import CapturedShape, Cloud
from drapenet.surface.springs import plane_springs
from infer import main
from sim.draping import Drape, drape, follow
from sim.mesh import vertex_normals
from sim.rig import DISC_RIG
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
    turned = flat_turn(captured)
    assert turned == pytest.approx(-0.3, abs=1e-3)
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
    hanging = ~captured.held
    free = hanging.sum()
    push = springs.gradient(q + 1e-3 * normals.ravel())
    weight = 0.3 * 9.81 * scene.mesh.vertex_areas[hanging]
    np.testing.assert_allclose(np.linalg.norm(push, axis=1), 0.05 * weight, rtol=1e-3)
    assert len(push) == free
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
    x, radius = scanned.rest[:, 0], np.linalg.norm(scanned.rest, axis=1)
    trimesh.PointCloud(scanned.positions[(x < 0) | (radius < 0.1)]).export(tmp_path / "part.ply")
    with pytest.raises(InputError, match="mm from this surface on average and does not fit"):
        read_shape(tmp_path / "part.ply", DISC_RIG, edge=8e-3)
    trimesh.PointCloud(scanned.positions).export(tmp_path / "points.ply")
    found = read_shape(tmp_path / "points.ply", DISC_RIG, edge=8e-3)
    assert found.distance < 1e-3 and found.shape.strain < 0.01
    table = np.random.default_rng(0).uniform(-0.25, 0.25, (len(scanned.positions) // 3, 3))
    table[:, 2] = scanned.positions[:, 2].min() - 0.03
    trimesh.PointCloud(np.concatenate([scanned.positions, table])).export(tmp_path / "table.ply")
    found = read_shape(tmp_path / "table.ply", DISC_RIG, edge=8e-3)
    assert found.distance < 1e-3 and found.warnings[0].code == "scan_table"
    trimesh.Trimesh(1.2 * scanned.positions, scanned.faces).export(tmp_path / "large.ply")
    with pytest.raises(InputError, match="of its points do not lie on a specimen of disc300"):
        read_shape(tmp_path / "large.ply", DISC_RIG, edge=8e-3)


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
