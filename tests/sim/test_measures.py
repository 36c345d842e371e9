"""Measures of drapes, similar drapes, and other cloth: skirts and pulled strips."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import find_peaks

from common.errors import InputError
from drapenet.measured.tension.law import compliance, extension, load, reach, softness
from sim.cloth import Laws
from sim.draping import FINE_OPTIONS
from sim.energies.bending_variants import Hysteresis
from sim.energies.membrane import OrthotropicStVK
from sim.equilibrium import find_equilibrium
from sim.material import BIAS, MICRO, WARP, WEFT, Fabric
from sim.measures import (
    drape_coefficient,
    fold_angles,
    fold_count,
    fold_outline,
    maximum_stretch,
    projected_area,
)
from sim.outlines import _peaks
from sim.rig import DISC_RIG, GRAVITY, Rig
from sim.scene import Scene, make_specimen
from sim.skirt import SKIRT, skirt
from sim.solver.newton import NewtonOptions
from sim.solver.potential import forces
from sim.start import initial_positions
from sim.tension import pull

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


def test_cloth_hanging_straight_down_covers_the_plate_only(specimen):
    mesh, _ = specimen
    hanging = straight_skirt(mesh.rest, folds=1, depth=0.0)
    assert drape_coefficient(hanging, mesh.faces, RIG) == pytest.approx(0.0, abs=4e-3)


@pytest.mark.parametrize("folds", [3, 4, 7, 11])
def test_folds_are_counted(specimen, folds):
    mesh, _ = specimen
    assert fold_count(straight_skirt(mesh.rest, folds, 0.008), mesh.rest, RIG) == folds


def test_ripples_below_three_millimetres_are_no_folds(specimen):
    mesh, _ = specimen
    assert fold_count(straight_skirt(mesh.rest, 6, 0.001), mesh.rest, RIG) == 0


@pytest.mark.parametrize(("arguments", "word"), [
    ({"scale": 1e3}, "positions extend over .* give metres"), ({"scale": 1e-3}, "give metres"),
    ({"scale": np.nan}, r"positions of the shape .*give finite positions"),
    ({"rig": "disc"}, "class Rig"), ({"faces": np.array([[0, 1, 10**6]])}, "faces of the shape"),
    ({"faces": np.zeros((3, 9), int)}, r"faces of the shape \(3, 9\)")])
def test_coefficients_of_other_units_and_arrays_are_refused(specimen, any_shapes, arguments, word):
    given = {"scale": 1.0, "faces": specimen[0].faces, "rig": RIG} | arguments
    positions = given.pop("scale") * straight_skirt(specimen[0].rest, 4, 0.008)
    with pytest.raises(InputError, match=word):
        drape_coefficient(positions, **given)


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
    (0.1, 0.0, 48),     # FAST-3
    (0.15, 0.0, 48),
    (0.2, 0.05, 24)])   # marks a width from the clamps
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
    bending = laws.bending
    if isinstance(bending, Hysteresis):
        curvature = tuple(value / factor for value in bending.curvature)
        origin = None if bending.origin is None else bending.origin / factor
        bending = replace(bending, curvature=curvature, origin=origin, at=bending.at / factor)
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
