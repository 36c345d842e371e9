"""Rigs: what they hold, what their cloth may touch, and drapes with known properties."""

import numpy as np
import pytest

from common.errors import InputError
from sim.cantilever import elastica
from sim.drape import drape
from sim.energies.contact import Cylinder, Ramp
from sim.equilibrium import find_equilibrium
from sim.material import Fabric
from sim.measures import deepest_entry, drape_coefficient, fold_count
from sim.rings import draped_disc
from sim.scene import DISC_RIG, HUNG_SQUARE, RIGS, Rig, State
from sim.specimens import MESHES, make_specimen, strip_over_ramp


def isotropic(alpha: float) -> Fabric:
    """Linear fabric of alpha µN·m at 300 g/m²."""
    return Fabric(np.full(3, alpha * 1e-6))


@pytest.mark.parametrize("mesh", MESHES)
@pytest.mark.parametrize("name", RIGS)
def test_every_rig_has_every_mesh(name, mesh):
    rig = Rig.from_name(name)
    offset = (2e-3, -3e-3) if rig.has_plate else (0.0, 0.0)
    specimen = make_specimen(rig, mesh=mesh, resolution=21, offset=offset, seed=5)
    area = specimen.mesh.areas
    assert area.min() > 0 and area.sum() == pytest.approx(rig.specimen_area, rel=3e-3)
    assert (specimen.diagonals is None) == (mesh == "unstructured" or rig.specimen == "disc")
    held = specimen.mesh.rest[specimen.held]
    if rig.has_plate:
        rest, faces = specimen.mesh.rest, specimen.mesh.faces
        covered = specimen.mesh.areas[specimen.held[faces].all(axis=1)].sum()
        assert covered == pytest.approx(np.pi * rig.plate_radius**2, rel=1.2e-2)
        assert np.linalg.norm(held, axis=1).max() < rig.plate_radius * 1.01
        assert np.linalg.norm(rest[~specimen.held], axis=1).min() > rig.plate_radius * 1.01
        assert np.allclose((specimen.mesh.rest.max(0) + specimen.mesh.rest.min(0)) / 2, offset,
                           atol=1e-3)
    else:
        assert sorted(map(tuple, rig.place(held).round(12))) == [(-0.25, 0, 0), (0.25, 0, 0)]


@pytest.mark.parametrize("perturbed", [False, True])
@pytest.mark.parametrize("resolution", [16, 31, 51])
def test_rings_are_well_shaped_and_follow_the_rim(resolution, perturbed):
    mesh, held = draped_disc(diameter=0.3, plate_radius=0.09, resolution=resolution,
                             offset=(3e-3, -4e-3), perturbed=perturbed, seed=1)
    vertices, faces, edges = len(mesh.rest), len(mesh.faces), len(mesh.edges)
    assert vertices - edges + faces == 1
    corners = mesh.rest[mesh.faces]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    quality = 4 * np.sqrt(3) * mesh.areas / (sides**2).sum(axis=1)  # 1 when equilateral
    assert quality.min() > 0.45
    radius = np.linalg.norm(mesh.rest, axis=1)
    assert np.array_equal(held, radius < 0.09 + 1e-9)
    rim = np.isclose(radius, 0.09, rtol=1e-9)
    angles = np.sort(np.arctan2(*mesh.rest[rim].T))
    polygon = 0.5 * 0.09**2 * np.sin(np.diff(np.append(angles, angles[0] + 2 * np.pi))).sum()
    assert mesh.areas[held[mesh.faces].all(axis=1)].sum() == pytest.approx(polygon, rel=1e-9)
    border = np.unique(mesh.edges[mesh.edge_faces[:, 1] < 0])
    assert np.allclose(np.linalg.norm(mesh.rest[border] - [3e-3, -4e-3], axis=1), 0.15, rtol=1e-9)


@pytest.mark.parametrize("mesh", MESHES)
def test_disc_hangs_the_lower_the_softer_it_is(mesh):
    """The limits of the drape coefficient: 100 % for a rigid disc; and it rises with stiffness."""
    coefficients = []
    for alpha in (4, 20, 100, 1e5):
        result = drape(isotropic(alpha), rig=DISC_RIG, resolution=21, seed=1, mesh=mesh)
        assert result.converged, result.message
        coefficients.append(drape_coefficient(result.positions, result.faces, DISC_RIG))
    assert coefficients[0] < 0.35
    assert np.all(np.diff(coefficients) > 0.05)
    assert coefficients[-1] == pytest.approx(1.0, abs=6e-3)


def test_limp_disc_has_more_folds_than_a_stiff_one():
    soft, stiff = (
        drape(isotropic(alpha), rig=DISC_RIG, resolution=31, seed=2) for alpha in (5, 50)
    )
    folds = [fold_count(r.positions, r.rest, DISC_RIG) for r in (soft, stiff)]
    assert folds[0] > folds[1] + 1 and 3 <= folds[1] <= 7


@pytest.mark.parametrize("mesh", ["structured", "unstructured"])
def test_stiff_disc_sags_like_a_plate_at_least_to_second_order(mesh):
    """Axisymmetric plate under its weight, clamped at the rim, free at the border."""
    alpha, a, b = 0.3, 0.15, 0.09
    load = 0.3 * 9.81 / alpha
    # w = c0 + c1 r² + c2 ln r + c3 r² ln r + load r⁴/64 with Poisson's ratio 0: w = w' = 0 at b;
    # at a neither moment, w'' = 0, nor shear, (w'' + w'/r)' = 0.
    log_a, log_b = np.log(a), np.log(b)
    conditions = [[1, b**2, log_b, b**2 * log_b],
                  [0, 2 * b, 1 / b, 2 * b * log_b + b],
                  [0, 2, -1 / a**2, 2 * log_a + 3],
                  [0, 0, 0, 4 / a]]
    right = -load * np.array([b**4 / 64, b**3 / 16, 3 * a**2 / 16, a / 2])
    c = np.linalg.solve(conditions, right)
    expected = c @ [1, a**2, log_a, a**2 * log_a] + load * a**4 / 64
    errors, resolutions = [], (16, 21, 31, 46)
    for n in resolutions:
        result = drape(Fabric(np.full(3, alpha)), rig=DISC_RIG, resolution=n, mesh=mesh)
        border = np.isclose(np.linalg.norm(result.rest, axis=1), a)
        errors.append(-result.positions[border, 2].mean() / expected - 1)
    rate = -np.polyfit(np.log(np.array(resolutions) - 1), np.log(np.abs(errors)), 1)[0]
    assert rate > 1.9  # more where the corrected clamp leaves little of the second order
    assert abs(errors[-1]) < 0.005


def test_hung_square_sags_between_its_corners_and_mirrors_itself():
    n = 21
    result = drape(isotropic(100), rig=HUNG_SQUARE, resolution=n, mesh="structured", seed=3)
    assert result.converged, result.message
    grid = result.positions.reshape(n, n, 3)
    assert np.allclose(grid[::-1] * [-1, 1, 1], grid, atol=2e-3)
    top = grid[:, -1]
    assert np.argmin(top[:, 2]) == n // 2
    # A weightless, inextensible half edge of 300 mm over 250 mm could reach 166 mm off the chord
    # with a kink in the middle; a catenary of that length 145 mm.
    sag = np.hypot(*top[n // 2, 1:])
    assert 0.13 < sag < 0.17
    assert result.positions[:, 2].min() > -0.65 and np.abs(result.positions[:, 1]).max() > 0.02


@pytest.mark.parametrize(("gamma", "touches"), [(7.5, False), (8.5, True), (30.0, True)])
def test_strip_touches_the_ramp_when_its_bending_length_is_half_its_overhang(gamma, touches):
    """The principle of the fixed-angle tester: at 41.5 degrees, Γ = 8."""
    length = 0.15
    scene = strip_over_ramp(length=length, width=0.02, edge=0.005)
    rest = scene.mesh.rest
    state, result = find_equilibrium(
        scene, isotropic(0.3 * 9.81 * length**3 / gamma * 1e6),
        State.at(scene.mesh, np.column_stack([rest, np.zeros(len(rest))])),
    )
    assert result.status.value == "converged"
    end = state.positions[np.isclose(rest[:, 0], length)].mean(axis=0)
    angle = np.degrees(np.arctan2(-end[2], end[0]))
    depth = scene.obstacles[0].depths(state.positions[~scene.held]).max()
    free = elastica(gamma)[-1]
    if touches:
        assert angle == pytest.approx(41.5, abs=0.05) and 0 < depth < 1e-4
        assert np.degrees(np.arctan2(free[1], free[0])) > 42
    else:
        assert depth < 0
        assert angle == pytest.approx(np.degrees(np.arctan2(free[1], free[0])), abs=0.15)


@pytest.mark.parametrize("obstacle", [Cylinder(0.05), Ramp(np.radians(41.5))])
def test_depths_are_concave_distances_and_normals_their_slopes(obstacle):
    rng = np.random.default_rng(0)
    p, q = rng.uniform(-0.1, 0.1, (2, 500, 3))
    at_p, at_q, between = (obstacle.depths(x) for x in (p, q, 0.5 * (p + q)))
    assert (between >= 0.5 * (at_p + at_q) - 1e-15).all()
    assert (np.abs(at_p - at_q) <= np.linalg.norm(p - q, axis=1) + 1e-15).all()
    normal, radius = obstacle.normals(p)
    step = 1e-7
    slope = np.stack([(obstacle.depths(p + step * e) - obstacle.depths(p - step * e)) / (2 * step)
                      for e in np.eye(3)], axis=1)
    assert np.allclose(slope, -normal, atol=1e-5) and (radius > 0).all()


def test_entry_is_found_between_the_vertices():
    half, height = 0.2, -0.05
    chord = [[0.05 * np.cos(a), 0.05 * np.sin(a), height] for a in (-half, half)]
    cases = {
        # All three corners lie on the cylinder's side; the chord's middle is deepest.
        0.05 * (1 - np.cos(half)): [*chord, [0.05, 0.0, height]],
        # A large triangle cuts through the axis at 20 mm below the top.
        0.02: [[-1, -1, -0.02], [1, -1, -0.02], [0, 1.5, -0.02]],
        # And one that stays outside.
        0.0: [[0.06, -1, -1], [0.06, 1, -1], [0.06, 0, 1]],
    }
    for depth, triangle in cases.items():
        entry = deepest_entry(np.array(triangle, float), np.array([[0, 1, 2]]), Rig())
        assert entry == pytest.approx(depth, abs=1e-6)


def test_entry_is_that_of_the_deepest_of_many_samples():
    rng = np.random.default_rng(3)
    positions = rng.uniform(-0.08, 0.08, (60, 3)) - [0, 0, 0.03]
    faces = rng.permutation(60).reshape(20, 3)
    shares = rng.dirichlet(np.ones(3), 40_000)
    samples = np.einsum("sk,fkd->sfd", shares, positions[faces])
    sampled = Cylinder(0.05).depths(samples.reshape(-1, 3)).max()
    entry = deepest_entry(positions, faces, Rig())
    assert sampled - 1e-6 <= entry < sampled + 1e-3


@pytest.mark.parametrize(
    "rig", [pytest.param(Rig(), marks=pytest.mark.slow), DISC_RIG], ids=lambda rig: rig.name
)
def test_soft_cloth_stays_out_of_the_cylinder_between_its_vertices_too(rig):
    result = drape(isotropic(4), rig=rig, resolution=51, seed=2)
    assert result.converged
    entry = deepest_entry(result.positions, result.faces, rig)
    assert 0 < entry < 2e-4


@pytest.mark.parametrize(
    ("rig", "arguments", "word"),
    [(Rig(), {"mesh": "woven"}, "woven"), (Rig(), {"resolution": 5}, "resolution=5"),
     (HUNG_SQUARE, {"offset": (1e-3, 0.0)}, "no plate"),
     (DISC_RIG, {"offset": (0.05, 0.0)}, "narrow"),
     (DISC_RIG, {"diagonals": "equal"}, "diagonals"), (HUNG_SQUARE, {"start": "fold"}, "fold"),
     (Rig(), {"diagonals": "equal", "mesh": "unstructured"}, "diagonals"),
     (Rig(), {"start": "frob", "borrowed": (np.zeros((9, 2)), np.zeros((9, 3)))}, "frob")],
)
def test_what_a_rig_cannot_do_is_refused(rig, arguments, word):
    with pytest.raises(InputError, match=word):
        drape(isotropic(20), rig=rig, **{"resolution": 21, **arguments})


@pytest.mark.parametrize(
    ("arguments", "word"),
    [({"specimen": "circle"}, "square or disc"), ({"plate_diameter": 0.3}, "smaller"),
     ({"plate_diameter": -0.1}, "smaller"), ({"plate_diameter": 0.0}, "corners_apart=None"),
     ({"plate_diameter": 0.0, "corners_apart": 0.3}, "below 0.3 m"),
     ({"plate_diameter": 0.0, "specimen": "disc"}, "no corners")],
)
def test_rigs_that_hold_nothing_are_refused(arguments, word):
    with pytest.raises(InputError, match=word):
        Rig("mine", **arguments)


def test_a_coarse_mesh_that_an_offset_leaves_no_room_for_is_left_out():
    """35 mm of 60 mm overhang: 16 vertices across are too few, 31 are not."""
    with pytest.raises(InputError, match="narrow for 16"):
        drape(isotropic(60), rig=DISC_RIG, resolution=16, offset=(0.035, 0.0))
    assert drape(isotropic(60), rig=DISC_RIG, resolution=31, offset=(0.035, 0.0)).converged
