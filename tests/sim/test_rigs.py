"""Rigs: what they hold and what their cloth may touch; drapes with known properties, measures of
drapes, and other cloth: skirts and pulled strips."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from cloths import isotropic
from scipy.signal import find_peaks

from common.errors import InputError
from drapenet.measured.tension.law import compliance, extension, load, reach, softness
from sim.cantilever import elastica
from sim.cloth import Laws
from sim.draping import FINE_OPTIONS, drape
from sim.energies.bending_variants import Hysteresis
from sim.energies.membrane import OrthotropicStVK
from sim.equilibrium import find_equilibrium
from sim.material import BIAS, MICRO, WARP, WEFT, Fabric
from sim.measures import (
    drape_coefficient,
    fold_angles,
    fold_count,
    fold_outline,
    max_penetration,
    maximum_stretch,
    projected_area,
)
from sim.mesh import strip
from sim.mesh.specimen import coarse_to_fine, default_edge
from sim.outlines import _peaks
from sim.rig import DISC_RIG, GRAVITY, HUNG_SQUARE, RIGS, Cylinder, Rig
from sim.scene import Scene, make_specimen
from sim.skirt import SKIRT, skirt
from sim.solver.newton import NewtonOptions
from sim.solver.potential import forces
from sim.start import initial_positions, interpolate_positions
from sim.tension import pull


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


CHORD = [[0.05 * np.cos(a), 0.05 * np.sin(a), -0.05] for a in (-0.2, 0.2)]


@pytest.mark.parametrize(("triangle", "depth"), [
    # All three corners lie on the cylinder's side; the chord's middle is deepest.
    ([*CHORD, [0.05, 0.0, -0.05]], 0.05 * (1 - np.cos(0.2))),
    # A large triangle cuts through the axis at 20 mm below the top.
    ([[-1, -1, -0.02], [1, -1, -0.02], [0, 1.5, -0.02]], 0.02),
    ([[0.06, -1, -1], [0.06, 1, -1], [0.06, 0, 1]], 0.0)])  # it stays outside
def test_entry_is_found_between_the_vertices(triangle, depth):
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


@pytest.mark.parametrize("name", [
    "rectangle170x250_cylinder90", "rectangle250x170_cylinder90", "rectangle400x140.5_cylinder60",
    "rectangle170x250_cylinder90_cut-5", "square300_cylinder100", "disc254_support127"])
def test_names_state_sizes(name):
    assert Rig.from_name(name).name == name


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


RIG = Rig()
WARP_N, WEFT_N, SHEAR_N = 700.0, 350.0, 40.0  # N/m
FABRIC = Fabric(np.array([30e-6, 20e-6, 14e-6]), np.array([-66e-9, -40e-9, -21e-9]))
EXACT = NewtonOptions(residual=1e-9, step=1e-8)


@pytest.fixture(scope="module")
def specimen():
    specimen = make_specimen(RIG, edge=0.006, grading=1)
    return specimen.mesh, specimen.held


def straight_skirt(rest: np.ndarray, folds: int, depth: float) -> np.ndarray:
    """The overhang turned straight down, with sinusoidal folds."""
    radius, angle = np.hypot(*rest.T), np.arctan2(rest[:, 1], rest[:, 0])
    drop = np.maximum(radius - 0.05, 0)
    wave = depth * drop / 0.1 * np.cos(folds * angle + 1)
    reach = np.minimum(radius, 0.05) + wave
    return np.column_stack([reach * np.cos(angle), reach * np.sin(angle), -drop])


def test_flat_specimen_covers_itself(specimen):
    mesh, _ = specimen
    flat = np.column_stack([mesh.rest, np.zeros(len(mesh.rest))])
    assert projected_area(flat, mesh.faces) == pytest.approx(0.09, rel=3e-3)
    assert drape_coefficient(flat, mesh.faces, RIG) == pytest.approx(1.0, abs=4e-3)
    hanging = straight_skirt(mesh.rest, folds=1, depth=0.0)  # straight down, over the plate only
    assert drape_coefficient(hanging, mesh.faces, RIG) == pytest.approx(0.0, abs=4e-3)


@pytest.mark.parametrize("folds", [3, 4, 7, 11])
def test_folds_are_counted_but_no_ripples_below_three_millimetres(specimen, folds):
    mesh, _ = specimen
    for depth, count in ((0.008, folds), (0.001, 0)):
        assert fold_count(straight_skirt(mesh.rest, folds, depth), mesh.rest, RIG) == count


@pytest.mark.parametrize(("scale", "rig"), [(1e3, RIG), (1.0, Rig(0.4))])
def test_folds_of_other_specimens_are_not_counted(specimen, scale, rig):
    rest = specimen[0].rest
    with pytest.raises(InputError, match=r"rest extend over .* give metres"):
        fold_count(straight_skirt(rest, 4, 0.008), scale * rest, rig)


def test_outline_tells_where_the_folds_are(specimen):
    mesh, _ = specimen
    outline = fold_outline(straight_skirt(mesh.rest, 5, 0.008), mesh.rest, RIG)
    # The material circle lies 0.135 - 0.05 m below the rim.
    wave = 0.05 + 0.008 * 0.085 / 0.1 * np.cos(5 * np.linspace(0, 2 * np.pi, 720, False) + 1)
    assert np.abs(np.linalg.norm(outline, axis=1) - wave).max() < 4e-4
    peaks = (2 * np.pi * np.arange(1, 6) - 1) / 5
    np.testing.assert_allclose(fold_angles(outline), peaks, atol=np.radians(2))


def test_stretch_is_that_of_the_most_stretched_direction(specimen):
    mesh, held = specimen
    positions = np.column_stack([1.03 * mesh.rest[:, 0], 0.98 * mesh.rest[:, 1],
                                 np.zeros(len(mesh.rest))])
    stretch = maximum_stretch(positions, mesh.rest, mesh.faces, held)
    assert stretch == pytest.approx(0.03, rel=1e-9)


def test_peaks_are_those_of_scipy():
    rng = np.random.default_rng(0)
    for _ in range(50):
        values = np.cumsum(rng.normal(size=200))
        np.testing.assert_array_equal(_peaks(values, 1.5), find_peaks(values, prominence=1.5)[0])


def test_the_ring_carries_the_weight_of_a_skirt():
    fabric = Fabric(np.full(3, 100 * MICRO))
    worn = skirt(fabric, edge=25e-3, seed=1)
    scene = worn.cloth.scene
    mesh, held = scene.mesh, scene.held
    assert scene.obstacles == ()
    # A polygon with the circle's area.
    assert np.allclose(np.linalg.norm(mesh.rest[held], axis=1), SKIRT.plate_radius, rtol=5e-3)
    found = find_equilibrium(scene, fabric, worn.state, options=FINE_OPTIONS)
    cloth, size = found.cloth, found.cloth.potential.unknowns
    elastic = forces([cloth.membrane, cloth.bending], found.state.q, size)
    vertical = elastic[2 : 3 * len(held) : 3]
    assert abs(vertical.sum()) < 1e-6 * abs(vertical[held].sum())
    # Of the annulus, without the share of the vertices in the ring.
    area = np.pi * (SKIRT.reach**2 - SKIRT.plate_radius**2) - mesh.vertex_areas[held].sum()
    assert vertical[held].sum() == pytest.approx(fabric.density * GRAVITY * area, rel=0.02)
    assert -1.01 * SKIRT.overhang < found.state.positions[:, 2].min() < -0.6 * SKIRT.overhang


@pytest.mark.parametrize(("direction", "angle"), [(WARP, 0.0), (WEFT, np.pi / 2)])
def test_cloth_that_need_not_narrow_follows_the_law_everywhere(direction, angle):
    cloth = OrthotropicStVK(warp=WARP_N, weft=WEFT_N, poisson=0.0, shear=SHEAR_N)
    found = pull(cloth, angle=angle, length=0.2, width=0.05, extension=0.05, cells=4)
    law = compliance(direction, (WARP_N, WEFT_N, SHEAR_N), 0.0)
    assert found.load == pytest.approx(load(0.05, law), rel=1e-6)
    assert found.extension() == pytest.approx(0.05) == found.extension(0.06)
    assert extension(found.load, law) == pytest.approx(0.05, rel=1e-6)


@pytest.mark.parametrize(("length", "margin", "cells"), [
    (0.1, 0.0, 48), (0.15, 0.0, 48),  # FAST-3, and longer
    (0.2, 0.05, 24)])  # marks a width from the clamps
@pytest.mark.parametrize("shear", [10.0, 40.0, 150.0])
def test_simulated_bias_strips_stretch_as_the_table_says(shear, length, margin, cells):
    width, stretch, n = 0.05, 600.0, 0.3
    cloth = OrthotropicStVK(warp=stretch, weft=stretch, poisson=n, shear=shear)
    found = pull(cloth, angle=np.pi / 4, length=length, width=width, extension=0.02, cells=cells)
    law, gauge = (stretch, stretch, shear), (length - 2 * margin) / width
    far = extension(found.load, compliance(BIAS, law, n))
    told = far * reach(BIAS, law, n, gauge=gauge, margin=margin / width)
    assert found.extension(margin) == pytest.approx(told, abs=0.04 * far / gauge)
    if margin == 0.0 and shear == 10.0:  # without the clamps it would be wrong
        assert found.extension() < 0.88 * far


def test_a_strip_with_yarns_that_differ_and_a_large_extension_is_told_to_two_per_cent():
    n = 0.3
    cloth = OrthotropicStVK(warp=WARP_N, weft=WEFT_N, poisson=n * np.sqrt(WARP_N / WEFT_N),
                            shear=SHEAR_N)
    found = pull(cloth, angle=np.pi / 4, length=0.2, width=0.05, extension=0.1, cells=24)
    law = (WARP_N, WEFT_N, SHEAR_N)
    far = extension(found.load, compliance(BIAS, law, n))
    assert found.extension() == pytest.approx(far * reach(BIAS, law, n, gauge=4.0, margin=0.0),
                                              rel=0.02)
    assert found.extension(0.06) == pytest.approx(far, rel=0.02)
    assert 0.1 < softness(*law, n) < 0.2


def similar(fabric: Fabric, rig: Rig, laws: Laws, factor: float) -> tuple[Fabric, Rig, Laws]:
    """Fabric, rig and laws of the drape that is ``factor`` times as large at equal density.

    A drape in units of the specimen's size L depends on alpha/(rho g L³), beta/(alpha L), the
    plate's diameter over L, the in-plane stiffness over rho g L, the natural curvature times L and
    the hysteresis at equal curvature times L.
    """
    bending = replace(laws.bending, at=laws.bending.at / factor,
                      curvature=tuple(value / factor for value in laws.bending.curvature),
                      origin=laws.bending.origin / factor)
    larger = replace(rig, sides=tuple(factor * side for side in rig.sides),
                     plate_diameter=factor * rig.plate_diameter)
    return (Fabric(factor**3 * fabric.alpha, factor**4 * fabric.beta, fabric.density), larger,
            replace(laws, bending=bending, membrane=laws.membrane.scaled(factor)))


@pytest.mark.parametrize(("rig", "factor"), [(Rig(), 0.5), (DISC_RIG, 1.3)])
def test_a_drape_of_another_size_is_the_scaled_drape(rig, factor):
    specimen = make_specimen(rig, edge=12e-3, topology=1)
    mesh, held, rest = specimen.mesh, specimen.held, specimen.mesh.rest
    rng = np.random.default_rng(0)
    scene = Scene(mesh, held, rig.obstacles)
    origin = rng.normal(0, 8, (scene.active.sum(), 3))
    laws = Laws(Hysteresis(0.2, curvature=(4.0, -3.0, 0.0), origin=origin),
                OrthotropicStVK(warp=400.0, weft=300.0, poisson=0.2, shear=60.0))
    start = initial_positions(rest, rig=rig, start="sine", rng=rng)
    start[held] = rig.place(rest[held])
    here = find_equilibrium(scene, FABRIC, scene.state(start), laws=laws, options=EXACT)
    fabric, larger, scaled = similar(FABRIC, rig, laws, factor)
    there = Scene(mesh.with_rest(factor * rest), held, larger.obstacles)
    near = here.state.positions + rng.normal(0, 1e-4, start.shape) * ~held[:, None]
    found = find_equilibrium(there, fabric, there.state(factor * near), laws=scaled,
                             options=EXACT)
    assert here.converged and found.converged
    gap = found.state.positions - factor * here.state.positions
    assert np.abs(gap).max() < 1e-6 * larger.specimen_size
    plain = replace(laws, bending=Hysteresis(0.2, origin=origin))
    uncurved = find_equilibrium(scene, FABRIC, here.state, laws=plain, options=EXACT)
    assert np.abs(uncurved.state.positions - here.state.positions).max() > 1e-3
