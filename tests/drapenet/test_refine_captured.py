"""Refinement of captured shapes: derivatives, recovery, fidelity, registration, the command."""

import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CloughTocher2DInterpolator
from scipy.spatial import cKDTree

from benchmarks.simulated_scans import simulated_scan
from common.errors import InputError
from data.fabrics import fabric_from_theta, to_theta
from data.prior import load_prior
from drapenet.refine import shape_search
from drapenet.refine.attraction import plane_springs
from drapenet.refine.captured import (
    NAMES,
    SCALE,
    CapturedProblem,
    CapturedShape,
    Cloth,
    cloth_moves,
    turned_rest,
)
from drapenet.refine.fidelity import fidelity
from drapenet.refine.friction import drapes_with_friction
from drapenet.refine.register import edge_strain, register
from drapenet.refine.registered import RobustPositions
from drapenet.refine.scan import Cloud, border_edges
from drapenet.refine.scan_report import format_scan, read_cloud, read_shape
from drapenet.refine.shape_search import scan_objective, search_cloth
from sim.drape import DrapeResult, drape
from sim.mesh import vertex_normals
from sim.newton import NewtonOptions
from sim.scene import DISC_RIG
from sim.sensitivity import follow

TIGHT = NewtonOptions(residual=1e-8, step=1e-8, max_iterations=300)
THETA = to_theta(np.array([90e-6, 60e-6, 55e-6]), np.array([-150e-9, -80e-9, -90e-9]))
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def captured() -> CapturedShape:
    """A simulated drape of THETA, its rest points turned by 0.3 rad against the warp."""
    result = drape(fabric_from_theta(THETA), rig=DISC_RIG, edge=7e-3)
    assert result.converged
    return CapturedShape(result.positions, turned_rest(result.rest, -0.3), result.faces, DISC_RIG)


def vertex_objective(shape: CapturedShape) -> RobustPositions:
    return RobustPositions(shape.positions, vertices=~shape.held, sigma=1e-3, limit=2.0)


def test_the_shape_of_a_drape_is_its_own_equilibrium(captured: CapturedShape) -> None:
    settled = captured.settle(fabric_from_theta(THETA), warp=0.3)
    assert settled.converged
    found = fidelity(captured, settled)
    assert found.largest_mm < 0.02
    assert found.curvature < 0.01
    assert found.coefficient == pytest.approx(found.captured_coefficient, abs=0.1)
    np.testing.assert_array_equal(settled.positions[captured.held],
                                  captured.positions[captured.held])


def test_a_support_that_holds_less_lets_the_cloth_lift_and_turn(captured: CapturedShape) -> None:
    """Freed inside the rim, cloth that was clamped there gives way: it lifts behind the rim and
    hangs lower in front of it."""
    loose = replace(captured, held_share=0.8)
    np.testing.assert_array_equal(loose.hanging, captured.hanging)
    assert loose.held.sum() < captured.held.sum() == (~captured.hanging).sum()
    settled = loose.settle(fabric_from_theta(THETA), warp=0.3)
    assert settled.converged
    height = 1e3 * settled.positions[:, 2]
    assert 0.05 < height[captured.held].max() < 3.0
    assert np.abs(height[loose.held]).max() == 0.0
    assert height[captured.hanging].mean() < 1e3 * captured.positions[captured.hanging, 2].mean()


def test_friction_keeps_a_cloth_that_is_too_soft_by_the_captured_shape(
    captured: CapturedShape
) -> None:
    soft = Cloth(THETA - np.array([0.4, 0.4, 0.4, 0.0, 0.0, 0.0]), warp=0.3)
    drapes = drapes_with_friction(captured, soft, [0.0, 3e-4, 3e-3])
    assert all(d.converged for d in drapes)
    held, free, little, much = (fidelity(captured, d).displacement_mm for d in drapes)
    assert held < much < little < free
    # More than the cloth's own torque, some 60 µN·m at 20 1/m.
    assert much - held < 0.1 * (free - held)


def test_derivatives_match_tight_simulations(captured: CapturedShape) -> None:
    cloth = Cloth(THETA - np.array([0.2, 0.1, 0.2, 0, 0, 0]), 150.0, 0.2, (1.5, -1.0, 0.5))
    settled = captured.settle(cloth.fabric, warp=cloth.warp, laws=cloth.laws, options=TIGHT)
    assert settled.converged
    moves = cloth_moves(settled, cloth, np.ones(len(NAMES), dtype=bool))
    values = np.concatenate([cloth.theta, [np.log(cloth.membrane), cloth.warp], cloth.curvature])
    for k in (1, 5, 6, 7, 8, 10):
        ends = []
        for side in (1, -1):
            other = values + side * 1e-4 * SCALE * np.eye(len(NAMES))[k]
            there = Cloth(other[:6], float(np.exp(other[6])), other[7], tuple(other[8:]))
            turned = settled.mesh.with_rest(turned_rest(captured.rest, there.warp))
            start = replace(settled, mesh=turned)
            ends.append(follow(start, there.fabric, laws=there.laws, options=TIGHT).positions)
        expected = (ends[0] - ends[1]) / (2e-4 * SCALE[k])
        gap = np.linalg.norm(moves[k] - expected) / np.linalg.norm(expected)
        assert gap < 1e-4, NAMES[k]


def test_robust_positions_have_exact_derivatives(captured: CapturedShape) -> None:
    objective = vertex_objective(captured)
    rng = np.random.default_rng(0)
    positions = captured.positions + rng.normal(0, 2e-3, captured.positions.shape)
    moves = rng.normal(0, 1.0, (3, *positions.shape))
    h = 1e-7
    expected = np.stack([(objective.residuals(positions + h * m, np.zeros(0))
                          - objective.residuals(positions - h * m, np.zeros(0))) / (2 * h)
                         for m in moves], axis=1)
    found = objective.linearised(positions, np.zeros(0)).along(moves)
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


def test_search_recovers_the_moduli_and_the_direction(captured: CapturedShape) -> None:
    start = Cloth(THETA + np.array([0.25, -0.1, 0.2, 4e-4, -4e-4, 3e-4]), 200.0, 0.15)
    found = search_cloth(captured, vertex_objective(captured), start, solves=20)
    assert found.effort.solves <= 20
    assert fidelity(captured, found.nearest.drape).displacement_mm < 0.1
    for settled in (found.estimate, found.released, found.nearest):
        np.testing.assert_allclose(settled.cloth.theta[:3], THETA[:3], atol=0.05)
        assert settled.cloth.warp == pytest.approx(0.3, abs=0.05)


def test_isotropic_linear_cloth_is_among_those_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = np.r_[np.full(3, math.log(40e-6)), np.zeros(3)]
    drawn = drape(fabric_from_theta(plain), rig=DISC_RIG, edge=7e-3)
    shape = CapturedShape(drawn.positions, drawn.rest, drawn.faces, DISC_RIG)
    monkeypatch.setattr(shape_search, "HELD", 1)
    monkeypatch.setattr(shape_search, "RELEASE", ())
    monkeypatch.setattr(shape_search, "FREED", 1)
    start = Cloth(plain + np.array([0.9, 0.7, 0.5, -3e-3, -3e-3, -3e-3]))
    gaps = []
    for solves in (3, 7):  # held, let go at once and by steps; and plain cloth, followed
        found = search_cloth(shape, vertex_objective(shape), start, solves=solves)
        gaps.append(fidelity(shape, found.nearest.drape).displacement_mm)
    assert gaps[1] < 0.2 * gaps[0]


@pytest.mark.parametrize("calls", [2, 9])
def test_an_interrupted_search_returns_the_best_so_far(
    captured: CapturedShape, calls: int
) -> None:
    least = []

    def interrupt(count: int, value: float) -> None:
        least.append(value)
        if len(least) == calls:
            raise KeyboardInterrupt

    start = Cloth(THETA + np.array([0.25, -0.1, 0.2, 4e-4, -4e-4, 3e-4]), 200.0, 0.15)
    found = search_cloth(captured, vertex_objective(captured), start, solves=20, report=interrupt)
    assert len(least) == calls
    assert found.estimate.value <= least[0]
    assert (found.nearest is None) == (calls == 2)


def test_held_cloth_is_free_along_the_surface(captured: CapturedShape) -> None:
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


def test_a_soft_membrane_costs_in_the_value_and_in_the_derivatives(captured: CapturedShape) -> None:
    cloth = Cloth(THETA, 100.0, 0.3)
    values, slopes = [], []
    for spread in (math.inf, 0.3):
        problem = CapturedProblem(captured, vertex_objective(captured), cloth, spread=spread)
        values.append(problem.value(problem.start))
        residuals, jacobian = problem.linearised(problem.start)
        slopes.append(jacobian.T @ residuals)
        assert values[-1] == pytest.approx(0.5 * residuals @ residuals)
    off = math.log(100 / 200) / 0.3
    assert values[1] - values[0] == pytest.approx(0.5 * off**2)
    expected = np.zeros(8)
    expected[6] = off / 0.3
    np.testing.assert_allclose(slopes[1] - slopes[0], expected, atol=1e-9)


def test_a_failed_simulation_is_infinite_and_kept_as_a_message(captured: CapturedShape) -> None:
    problem = CapturedProblem(captured, vertex_objective(captured), Cloth(THETA))
    impossible = problem.start.copy()
    impossible[1] -= 5.0  # no plate is as soft along the bias only
    assert problem.value(impossible) == np.inf
    assert problem.effort.solves == 0
    assert problem.linearised(problem.start) is None
    first = problem.value(problem.start)
    assert first == problem.value(problem.start)
    assert problem.effort.solves == 1


@pytest.fixture(scope="module")
def scanned() -> DrapeResult:
    """A drape on a mesh of its own."""
    fabric = fabric_from_theta(THETA)
    return drape(fabric, rig=DISC_RIG, edge=4e-3, start="sine", seed=3)


def test_a_raw_scan_is_registered_without_stretching_the_cloth(scanned: DrapeResult) -> None:
    noise = np.random.default_rng(4).normal(0, 3e-4, scanned.positions.shape)
    cloud = Cloud.of_mesh(scanned.positions + noise, scanned.faces[:, ::-1])
    found = register(cloud, DISC_RIG, edge=6e-3, held=0.95)
    shape = found.shape
    assert shape.held_share == 0.95
    assert 1e3 * found.distance[shape.hanging].mean() < 0.5
    assert edge_strain(shape) < 0.01
    hem = shape.positions[border_edges(shape.faces)].mean(axis=1)
    assert 1e3 * cKDTree(cloud.hem).query(hem)[0].max() < 6.0  # the scan's edges are 9 mm long
    # Vertices lie where the same point of the specimen was draped.
    inside = shape.rest * (1 - 1e-3)
    truth = CloughTocher2DInterpolator(scanned.rest, scanned.positions)(inside)
    gap = 1e3 * np.linalg.norm(shape.positions - truth, axis=1)
    assert np.nanmean(gap[shape.hanging]) < 1.0
    assert shape.settle(fabric_from_theta(THETA)).converged


def test_a_scan_whose_vertices_slid_is_laid_again(tmp_path: Path, scanned: DrapeResult) -> None:
    c, s = math.cos(0.7), math.sin(0.7)
    turned = scanned.rest @ np.array([[c, -s], [s, c]])  # first rest axis at 0.7 rad on the plate
    file = tmp_path / "scan.npz"
    np.savez(file, vertices=scanned.positions, rest=turned, faces=scanned.faces)
    own, registration = read_shape(file, DISC_RIG, edge=6e-3)
    assert registration is None
    np.testing.assert_array_equal(own.positions, scanned.positions)

    wave = 1.5e-3 * np.sin(100 * turned[:, ::-1]) * own.hanging[:, None]
    slid = np.minimum(np.linalg.norm(turned + wave, axis=1), 0.15)
    angle = np.arctan2(*(turned + wave).T[::-1])
    np.savez(file, vertices=scanned.positions, faces=scanned.faces,
             rest=np.column_stack([slid * np.cos(angle), slid * np.sin(angle)]))
    shape, registration = read_shape(file, DISC_RIG, edge=6e-3)
    assert registration["edge_strain_before"] > 0.05 > 5 * registration["edge_strain"]
    plate = ~shape.hanging
    np.testing.assert_allclose(shape.rest[plate] @ [[c, s], [-s, c]], shape.positions[plate, :2],
                               atol=1e-4)


def test_a_surface_that_no_specimen_can_be_laid_on_is_refused(
    tmp_path: Path, scanned: DrapeResult
) -> None:
    import trimesh

    near = scanned.rest[:, 0] < 0.03  # one side is missing
    trimesh.PointCloud(scanned.positions[near]).export(tmp_path / "part.ply")
    with pytest.raises(InputError, match="cannot be laid on this surface"):
        read_shape(tmp_path / "part.ply", DISC_RIG, edge=6e-3)
    trimesh.PointCloud(scanned.positions).export(tmp_path / "points.ply")
    shape, registration = read_shape(tmp_path / "points.ply", DISC_RIG, edge=6e-3)
    assert registration["mean_distance_mm"] < 1.0
    assert edge_strain(shape) < 0.01
    table = np.random.default_rng(0).uniform(-0.25, 0.25, (len(scanned.positions) // 3, 3))
    table[:, 2] = scanned.positions[:, 2].min() - 0.03
    trimesh.PointCloud(np.concatenate([scanned.positions, table])).export(tmp_path / "table.ply")
    with pytest.raises(InputError, match=r"25% of its points .* cut away all that is not cloth"):
        read_shape(tmp_path / "table.ply", DISC_RIG, edge=6e-3)


def test_raw_scans_are_checked(tmp_path: Path, captured: CapturedShape) -> None:
    import trimesh

    good = tmp_path / "good.ply"
    trimesh.Trimesh(captured.positions, captured.faces, process=False).export(good)
    assert len(read_cloud(good, DISC_RIG).hem) > 50
    points = tmp_path / "points.ply"
    trimesh.PointCloud(captured.positions).export(points)
    assert len(read_cloud(points, DISC_RIG).points) == len(captured.positions)
    damaged = tmp_path / "damaged.obj"
    damaged.write_text("v 0.1 0.2 0\n" * 300 + "v 0.1 0.2\n" + "f 1 2 3\n")
    with pytest.raises(InputError, match="export it again"):
        read_cloud(damaged, DISC_RIG)
    millimetres = tmp_path / "mm.ply"
    trimesh.Trimesh(1e3 * captured.positions, captured.faces, process=False).export(millimetres)
    with pytest.raises(InputError, match="metres"):
        read_cloud(millimetres, DISC_RIG)
    lying = tmp_path / "lying.obj"
    trimesh.Trimesh(captured.positions - [0, 0, 0.1], captured.faces, process=False).export(lying)
    with pytest.raises(InputError, match="plane z = 0"):
        read_cloud(lying, DISC_RIG)
    standing = tmp_path / "standing.ply"
    trimesh.Trimesh(captured.positions * [1, 1, -1], captured.faces, process=False).export(standing)
    with pytest.raises(InputError, match="z must point up"):
        read_cloud(standing, DISC_RIG)
    vertices = captured.positions.copy()
    vertices[3, 1] = np.nan
    unknown = tmp_path / "nan.ply"
    trimesh.Trimesh(vertices, captured.faces, process=False).export(unknown)
    with pytest.raises(InputError, match="1 of its points are not finite"):
        read_cloud(unknown, DISC_RIG)
    far = tmp_path / "far.ply"
    faces = captured.faces + np.array([0, 0, 10**6])
    trimesh.Trimesh(captured.positions, faces, process=False).export(far)
    with pytest.raises(InputError, match="names a vertex that is not there"):
        read_cloud(far, DISC_RIG)
    for content in (b"", b"ply\nformat ascii 1.0\n", b"\x00\xff" * 50):
        bad = tmp_path / "bad.ply"
        bad.write_bytes(content)
        with pytest.raises(InputError):
            read_cloud(bad, DISC_RIG)
    with pytest.raises(InputError, match="cannot read"):
        read_cloud(tmp_path / "missing.ply", DISC_RIG)


def test_command_says_what_is_wrong(tmp_path: Path) -> None:
    from infer import main

    bad = tmp_path / "bad.npz"
    bad.write_bytes(b"nothing")
    for words, message in (
        ([f"scan={bad}"], "cannot read the scan"),
        (["scan=x.npz", "capture=y"], "not both"),
        (["scan=x.npz", "refine=depth"], "use refine=scan"),
        ([f"scan={tmp_path / 'missing.obj'}"], "cannot read the scan"),
        (["scan=x.npz", f"out={bad}"], "a file is in the way"),
        (["scan=x.npz", "held=1.2"], "held=1.2: give a share"),
        (["scan=x.npz", "edge_mm=3"], "edge_mm= has no effect with scan=FILE"),
        (["capture=x", "held=0.95"], "held= has no effect with capture=DIR"),
    ):
        with pytest.raises(InputError, match=message) as error:
            main([f"out={tmp_path / 'out'}", *words])
        assert "\n" not in str(error.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_estimate_stands_errors_of_a_scans_vertices() -> None:
    theta = to_theta(np.array([38e-6, 22e-6, 15e-6]), np.array([-100e-9, -50e-9, -35e-9]))
    scan = simulated_scan(theta, along=0.35e-3, across=0.1e-3, seed=1, fine=2.5e-3, scanned=7e-3)
    prior = load_prior("gaussian")
    found = search_cloth(scan, scan_objective(scan), Cloth(prior.mean.copy()), prior=prior)
    assert found.effort.solves == 25
    errors = found.estimate.cloth.theta[:3] - theta[:3]
    assert np.abs(errors).max() < math.log(1.25), np.exp(errors)
    assert abs(fidelity(scan, found.nearest.drape).coefficient
               - fidelity(scan, found.nearest.drape).captured_coefficient) < 2.0


@pytest.fixture(scope="module")
def refined(tmp_path_factory: pytest.TempPathFactory, captured: CapturedShape) -> tuple[Path, str]:
    """Folder and terminal of the command that refines ``captured``."""
    folder = tmp_path_factory.mktemp("scan")
    scan = folder / "scan.npz"
    np.savez(scan, vertices=captured.positions, rest=captured.rest, faces=captured.faces)
    done = subprocess.run(
        [sys.executable, "infer.py", f"scan={scan}", "refine=scan", f"out={folder / 'out'}"],
        cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return folder / "out", done.stdout


@pytest.mark.slow
def test_command_refines_a_scan(refined: tuple[Path, str]) -> None:
    out, printed = refined
    content = json.loads((out / "estimate.json").read_text())
    assert content["simulations"] <= 25
    assert format_scan(content) in printed
    assert (out / "report.png").stat().st_size > 10_000


@pytest.mark.slow
def test_command_finds_a_drape_of_the_simulator(refined: tuple[Path, str]) -> None:
    content = json.loads((refined[0] / "estimate.json").read_text())
    assert content["fidelity"]["displacement_mm"] < 0.5
    assert content["nearest_drape"]["fidelity"]["displacement_mm"] < 0.5
    assert content["warp_direction_deg"] == pytest.approx(math.degrees(0.3), abs=2.0)
