"""Rigs: what they hold, what their cloth may touch, and drapes with known properties."""

from dataclasses import dataclass

import numpy as np
import pytest
from cloths import isotropic

from common.errors import InputError
from sim.cantilever import elastica
from sim.draping import drape
from sim.equilibrium import find_equilibrium
from sim.material import Fabric
from sim.measures import drape_coefficient, fold_count, max_penetration
from sim.mesh import strip
from sim.mesh.specimen import coarse_to_fine, default_edge
from sim.rig import DISC_RIG, HUNG_SQUARE, RIGS, Cylinder, Rig
from sim.scene import Scene, make_specimen
from sim.start import interpolate_positions


@dataclass(frozen=True)
class Ramp:
    """A platform z = 0 that ends at x = 0 in a plane ``angle`` (rad) below the horizontal.

    The stand of a bending-length tester with a fixed angle.
    """

    angle: float
    radius: float = 0.05  # m, length to which contact is in proportion

    def depths(self, points: np.ndarray) -> np.ndarray:
        x, _, z = points.T
        return np.minimum(-z, -(x * np.sin(self.angle) + z * np.cos(self.angle)))

    def normals(self, points: np.ndarray) -> np.ndarray:
        x, _, z = points.T
        sloping = -(x * np.sin(self.angle) + z * np.cos(self.angle)) < -z
        slope = np.array([np.sin(self.angle), 0.0, np.cos(self.angle)])
        return np.where(sloping[:, None], slope, np.array([0.0, 0.0, 1.0]))

    def depth_hessians(self, points: np.ndarray) -> np.ndarray:
        return np.zeros((len(points), 3, 3))


@pytest.mark.parametrize("name", RIGS)
def test_every_rig_has_a_mesh(name):
    rig = Rig.from_name(name)
    offset = (2e-3, -3e-3) if rig.has_plate else (0.0, 0.0)
    edge = default_edge(isotropic(20), rig)
    specimen = make_specimen(rig, edge=edge, offset=offset, topology=5)
    area = specimen.mesh.areas
    assert area.min() > 0 and area.sum() == pytest.approx(rig.specimen_area, rel=3e-3)
    assert 1000 < len(area) < 20_000
    rest, held = specimen.mesh.rest, specimen.held
    if rig.has_plate:
        assert np.allclose((rest.max(0) + rest.min(0)) / 2, offset, atol=1e-3)
        assert np.array_equal(held, np.linalg.norm(rest, axis=1) < rig.plate_radius * 1.001)
    else:
        corners = rig.place(rest[held])
        assert sorted(map(tuple, corners.round(12))) == [(-0.25, 0, 0), (0.25, 0, 0)]


def test_disc_hangs_the_lower_and_has_the_more_folds_the_softer_it_is():
    """The limits of the drape coefficient: 100 % for a rigid disc; and it rises with stiffness."""
    coefficients, folds = [], []
    for alpha in (4, 20, 100, 1e5):
        result = drape(isotropic(alpha), rig=DISC_RIG, edge=0.008, seed=1)
        assert result.converged, result.message
        coefficients.append(drape_coefficient(result.positions, result.faces, DISC_RIG))
        folds.append(fold_count(result.positions, result.rest, DISC_RIG))
    assert coefficients[0] < 0.35
    assert np.all(np.diff(coefficients) > 0.05)
    assert coefficients[-1] == pytest.approx(1.0, abs=6e-3)
    assert folds[0] > folds[2] + 1 and 3 <= folds[2] <= 7 and folds[3] == 0


def test_stiff_disc_sags_like_a_plate_nearly_to_second_order():
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
    errors, edges = [], np.array([8e-3, 5e-3, 3.5e-3, 2.5e-3])
    for edge in edges:
        scene = make_specimen(DISC_RIG, edge=edge, grading=1)
        rest = scene.mesh.rest
        found = find_equilibrium(scene, Fabric(np.full(3, alpha)),
                                 scene.state(DISC_RIG.place(rest)))
        border = np.isclose(np.linalg.norm(rest, axis=1), a)
        errors.append(-found.state.positions[border, 2].mean() / expected - 1)
    rate = np.polyfit(np.log(edges), np.log(np.abs(errors)), 1)[0]
    assert rate > 1.6  # second order, less the remainder of the clamp's correction
    assert abs(errors[1]) < 0.004


def test_hung_square_sags_between_its_corners_and_mirrors_itself():
    result = drape(isotropic(100), rig=HUNG_SQUARE, edge=0.03, seed=3)
    assert result.converged, result.message
    rest, positions = result.rest, result.positions
    mirrored = interpolate_positions(rest * [-1, 1], positions * [-1, 1, 1], rest)
    assert np.linalg.norm(mirrored - positions, axis=1).mean() < 4e-3
    top = np.isclose(rest[:, 1], 0.3)
    lowest = np.flatnonzero(top)[np.argmin(positions[top, 2])]
    assert abs(rest[lowest, 0]) < 0.03
    # A weightless, inextensible half edge of 300 mm over 250 mm could reach 166 mm off the chord
    # with a kink in the middle; a catenary of that length 145 mm.
    sag = np.hypot(*positions[lowest, 1:])
    assert 0.13 < sag < 0.17
    assert result.positions[:, 2].min() > -0.65 and np.abs(result.positions[:, 1]).max() > 0.02


@pytest.mark.parametrize(("gamma", "touches"), [(7.5, False), (8.5, True), (30.0, True)])
def test_strip_touches_the_ramp_when_its_bending_length_is_half_its_overhang(gamma, touches):
    """The principle of the fixed-angle tester: at 41.5 degrees, Γ = 8."""
    length = 0.15
    mesh, held = strip(length=length, width=0.02, edge=0.005, clamp=0.01)
    scene = Scene(mesh=mesh, held=held, obstacles=(Ramp(np.radians(41.5)),))
    rest = scene.mesh.rest
    found = find_equilibrium(
        scene, isotropic(0.3 * 9.81 * length**3 / gamma * 1e6),
        scene.state(np.column_stack([rest, np.zeros(len(rest))])),
    )
    assert found.converged
    state = found.state
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
    normal = obstacle.normals(p)
    step = 1e-7
    slope = np.stack([(obstacle.depths(p + step * e) - obstacle.depths(p - step * e)) / (2 * step)
                      for e in np.eye(3)], axis=1)
    assert np.allclose(slope, -normal, atol=1e-5)


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
        entry = max_penetration(np.array(triangle, float), np.array([[0, 1, 2]]), Rig())
        assert entry == pytest.approx(depth, abs=1e-6)


@pytest.mark.parametrize(
    "rig", [pytest.param(Rig(), marks=pytest.mark.slow), DISC_RIG], ids=lambda rig: rig.name
)
def test_soft_cloth_stays_out_of_the_cylinder_between_its_vertices_too(rig):
    result = drape(isotropic(4), rig=rig, edge=0.006, seed=2)
    assert result.converged
    entry = max_penetration(result.positions, result.faces, rig)
    assert (0 if rig is DISC_RIG else 1e-6) <= entry < 2e-4  # the disc hangs clear of its support


@pytest.mark.parametrize(("arguments", "word"), [
    ({"specimen": "circle"}, "square, rectangle or disc"),
    ({"sides": (0.3, 0.2), "specimen": "disc"}, "0.3 and 0.2 m: a disc has one diameter"),
    ({"sides": (0.3, 0.1)}, "100 mm under a specimen of 300x100 mm"),
    ({"plate_diameter": 0.3}, "smaller"),
    ({"plate_diameter": -0.1}, "smaller"), ({"plate_diameter": 0.0}, "corners_apart=None"),
    ({"plate_diameter": 0.0, "corners_apart": 0.3}, "below 0.3 m"),
    ({"plate_diameter": 0.0, "specimen": "disc"}, "no corners"),
    ({"corners_apart": 0.2}, "beside a plate"), ({"plate_diameter": "0.1"}, "plate_diameter='0.1'"),
    ({"cut": None}, "cut=None: give a finite number, rad"), ({"sides": "square300"}, "sides="),
    ({"sides": (0.3, np.nan)}, "sides="), ({"sides": (0.3, 0.3, 0.3)}, "one number or two"),
    ({"plate_diameter": np.array([0.1, 0.1])}, "plate_diameter="),
    ({"plate_diameter": 0.0, "corners_apart": "a"}, "corners_apart='a'")])
def test_impossible_rigs_are_refused(arguments, word):
    with pytest.raises(InputError, match=word):
        Rig(**arguments)


@pytest.mark.parametrize("name", [
    "rectangle170x250_cylinder90", "rectangle250x170_cylinder90", "rectangle400x140.5_cylinder60",
    "rectangle170x250_cylinder90_cut-5", "square300_cylinder100", "disc254_support127"])
def test_names_state_sizes_and_come_back(name):
    rig = Rig.from_name(name)
    assert rig.name == name and Rig.from_name(rig.name) == rig
    for other in ("rectangle300x300_cylinder100", "rectangle170_cylinder90",
                  "square170x250_cylinder90", "disc170x250_support90", 300):
        with pytest.raises(InputError, match="unknown rig"):
            Rig.from_name(other)


def test_the_border_of_a_rectangle_is_that_of_its_sides():
    rig = Rig((0.17, 0.25), 0.09, cut=0.1)
    assert rig.specimen == "rectangle" and rig.specimen_area == pytest.approx(0.0425)
    assert rig.least_overhang == pytest.approx(0.04)
    corner = np.arctan2(0.25, 0.17)
    assert rig.border(np.array([0.0, np.pi / 2, np.pi, corner])) == pytest.approx(
        [0.085, 0.125, 0.085, rig.reach])
    azimuth = np.linspace(0, 2 * np.pi, 100)
    turned = azimuth + 0.1  # to the warp
    points = rig.border(azimuth)[:, None] * np.column_stack([np.cos(turned), np.sin(turned)])
    assert np.abs(rig.to_border(points, (0, 0))).max() < 1e-15
    assert np.array_equal(Rig((0.3, 0.3)).border(azimuth), 0.15 / np.maximum(
        np.abs(np.cos(azimuth)), np.abs(np.sin(azimuth))))


def test_a_rectangle_turned_with_its_yarns_drapes_alike():
    """Meshes and starts of the two differ, so stiff cloth, which has one equilibrium."""
    def coefficient(sides, alpha):
        rig = Rig(sides, 0.09)
        result = drape(Fabric(np.array(alpha) * 1e-6), rig=rig, edge=7e-3, start="sine")
        assert result.converged
        return drape_coefficient(result.positions, result.faces, rig)

    along, bias, across = 400.0, 200.0, 100.0
    straight = coefficient((0.17, 0.25), (along, bias, across))
    turned = coefficient((0.25, 0.17), (across, bias, along))
    assert turned == pytest.approx(straight, abs=0.01)
    assert coefficient((0.25, 0.17), (along, bias, across)) > straight + 0.05


def test_a_coarse_mesh_that_an_offset_leaves_no_room_for_is_left_out():
    """Of the square's overhang of 100 mm, 22 mm are left: two edges of 11 mm."""
    offset = (0.078, 0.0)
    with pytest.raises(InputError, match=r"22 mm .* narrow for edges of 16 mm"):
        drape(isotropic(60), edge=0.016, offset=offset)
    assert drape(isotropic(200), edge=0.01, offset=offset, start="sine").converged


def test_softer_cloth_gets_a_finer_mesh_whatever_its_density():
    chosen = [default_edge(isotropic(alpha), Rig()) for alpha in (1000, 100, 30, 15, 6, 3, 0.1)]
    assert chosen == [0.006, 0.006, 0.004, 0.003, 0.0025, 0.002, 0.002]
    assert 5 * 0.004 <= (30e-6 / (0.3 * 9.81)) ** (1 / 3) < 5 * 0.005
    assert default_edge(isotropic(30).at_density(0.1), Rig()) == 0.004
    assert default_edge(isotropic(30), HUNG_SQUARE) == pytest.approx(0.016)
    narrow = Rig((0.14, 0.14), 0.1)
    assert default_edge(isotropic(1000), narrow, offset=(0.012, 0.0)) == 0.004
    assert default_edge(isotropic(1000), narrow, offset=(0.0, 0.017)) == pytest.approx(0.0015)


def test_levels_grow_finer_by_one_factor_and_start_where_they_may():
    assert coarse_to_fine(0.002) == pytest.approx([0.0125, 0.005, 0.002])
    assert coarse_to_fine(0.0025, 0.008) == pytest.approx([0.00625, 0.0025])
    assert coarse_to_fine(0.02) == [0.02]
    for edge in (0.0, -1.0, 1e-4, np.nan):
        with pytest.raises(InputError, match=r"edge=.* between"):
            coarse_to_fine(edge)
