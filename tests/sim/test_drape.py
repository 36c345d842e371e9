"""Drapes, of one fabric and of many, and what they start from."""

import pickle
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
from cloths import isotropic

from apps.drape import read_borrowed, write_drape
from common.errors import InputError
from sim.cloth import Cloth, Corotational, Laws
from sim.draping import drape, follow
from sim.energies.external import Gravity
from sim.equilibrium import find_equilibrium
from sim.many import drape_many
from sim.material import Fabric
from sim.measures import fold_angles, fold_outline, maximum_stretch
from sim.rig import DISC_RIG, GRAVITY, HUNG_SQUARE, Rig
from sim.scene import CONTACT_PRESSURE, Scene, make_specimen
from sim.solver.newton import NewtonOptions, Status
from sim.start import borrowed_positions, initial_positions, interpolate_positions

MODULE = import_module("sim.draping")  # the attribute of `sim` is the function
EXTREME = Fabric([98.8e-6, 23.5e-6, 21.2e-6], -2.5e-3 * np.array([98.8e-6, 23.5e-6, 21.2e-6]))
ALPHAS = (60e-6, 20e-6, 40e-6)


@pytest.fixture(scope="module")
def plain():
    return drape(isotropic(20), edge=0.012, start="sine", seed=5)


KINDS = {"stiff": isotropic(100), "median": isotropic(20, 2.0), "soft": isotropic(5),
         "extreme": EXTREME}


@pytest.mark.parametrize(("kind", "start", "edge"), [
    *((kind, "lowered", 0.008) for kind in KINDS), ("extreme", "sine", 0.008),
    ("median", "fold", 0.008), ("soft", "ring", 0.008),
    *(pytest.param(kind, "lowered", edge, marks=pytest.mark.slow)
      for kind in KINDS for edge in (0.004, 0.002))])
def test_fabrics_of_all_kinds_reach_a_proven_minimum(kind, start, edge):
    result = drape(KINDS[kind], edge=edge, start=start, seed=3)
    assert result.converged, result.message
    assert result.outcome.residual < 1e-3 and result.outcome.positive_definite
    assert np.array_equal(result.positions[result.held],
                          np.column_stack([result.rest[result.held], np.zeros(result.held.sum())]))


def test_shape_depends_on_moduli_over_density_only():
    heavy, light = (drape(isotropic(60, 1.0).at_density(density), edge=0.012, seed=1, start="sine")
                    for density in (0.3, 0.075))
    assert np.allclose(heavy.positions, light.positions, rtol=0, atol=1e-6)


def test_another_seed_has_another_drape(plain):
    other = drape(plain.fabric, edge=plain.edge, start="sine", seed=6)
    there = interpolate_positions(other.rest, other.positions, plain.rest)
    assert np.abs(plain.positions - there).max() > 1e-3


def test_cloth_hangs_less_along_its_stiffer_direction():
    """Fails if warp and weft are swapped anywhere between the moduli and the mesh."""
    for warp, weft in ((400, 30), (30, 400)):
        fabric = Fabric(np.array([warp, 120, weft]) * 1e-6)
        result = drape(fabric, edge=0.012, start="sine", seed=2)
        assert result.converged
        height = {}
        for name, axis in (("warp", 0), ("weft", 1)):
            along, across = np.abs(result.rest[:, axis]), np.abs(result.rest[:, 1 - axis])
            height[name] = result.positions[(along > 0.149) & (across < 0.03), 2].mean()
        assert (height["warp"] > height["weft"] + 0.01) == (warp > weft)


def test_in_plane_stiffness_matters_much_less_than_bending_stiffness():
    """Section 4.1, Figures 5 to 7: the effect of doubling either."""
    base = drape(isotropic(100), edge=0.009, seed=1)
    taut = follow(base, base.fabric, laws=Laws(membrane=Corotational(400.0)))
    stiff = follow(base, isotropic(200))
    by_stretch, by_bending = (
        np.linalg.norm(other.positions - base.positions, axis=1).mean() for other in (taut, stiff)
    )
    assert by_stretch < 0.35 * by_bending
    assert maximum_stretch(base.positions, base.rest, base.faces, base.held) < 0.05


def test_refinement_changes_a_stiff_drape_by_little():
    """On graded meshes, less than half of what a grid of 26 vertices a side was away."""
    coarse, fine = (drape(isotropic(150), edge=edge, seed=1, start="sine")
                    for edge in (0.008, 0.004))
    there = interpolate_positions(fine.rest, fine.positions, coarse.rest)
    assert np.linalg.norm(there - coarse.positions, axis=1).mean() < 1e-3


def test_only_the_coarser_meshes_are_soft():
    """The forces on a drape balance in a scene and under laws made again, in full stiffness."""
    result = drape(isotropic(20, 2), edge=0.005, seed=1, start="sine")
    assert result.coarse == (Status.CONVERGED,)
    residuals = []
    for contact in (CONTACT_PRESSURE, 0.5 * CONTACT_PRESSURE):
        scene = replace(result.scene, contact_pressure=contact)
        potential = Cloth(scene, result.fabric, laws=result.laws).potential
        residuals.append(potential.residual(potential.gradient(result.state.q)))
    assert residuals[0] < 1e-3
    assert residuals[1] > 0.1  # the cylinder carries some of the cloth


def test_how_coarser_meshes_ended_is_kept(monkeypatch):
    monkeypatch.setattr(MODULE, "COARSE_OPTIONS", NewtonOptions(max_iterations=1))
    result = drape(isotropic(60), edge=0.005, start="sine")
    assert result.converged and result.coarse == (Status.MAX_ITERATIONS,)


def test_cloth_without_weight_stays_flat():
    """Scales of force come from the cloth's weight under standard gravity, not from the scene's."""
    specimen = make_specimen(Rig(), edge=0.012)
    scene = Scene(mesh=specimen.mesh, held=specimen.held, gravity=0.0)
    rng = np.random.default_rng(0)
    bumps = rng.normal(0, 2e-3, len(specimen.held)) * ~specimen.held
    found = find_equilibrium(scene, isotropic(50),
                             scene.state(np.column_stack([specimen.mesh.rest, bumps])))
    assert found.converged, found.message
    assert np.abs(found.state.positions[:, 2]).max() < 1e-5


def test_results_travel_without_their_factor(plain):
    result = follow(plain, plain.fabric, keep=True)
    assert result.outcome.factor is not None
    there = pickle.loads(pickle.dumps(result))
    assert there.outcome.factor is None and there.status is result.status
    assert np.array_equal(there.state.q, result.state.q)


def test_offset_hangs_further_down_where_there_is_more_cloth():
    result = drape(isotropic(60), edge=0.012, start="sine", offset=(0.02, 0.0))
    ends = [result.positions[np.isclose(result.rest[:, 0], x), 2].mean() for x in (0.17, -0.13)]
    assert ends[0] < ends[1] - 0.01


def test_a_failed_minimisation_is_a_status():
    result = drape(isotropic(100), edge=0.016, options=NewtonOptions(max_iterations=1))
    assert not result.converged
    assert result.status.value == "max_iterations" and "1 iterations" in result.message


def test_user_defined_laws_are_called_for_every_mesh():
    made = []

    def heavier(mesh, active, *, fabric):
        made.append(len(mesh.rest))
        return Gravity(mesh, density=fabric.density, gravity=GRAVITY)

    twice = drape(isotropic(60), edge=0.008, laws=Laws(others=(heavier,)))
    assert twice.converged
    assert len(made) == 3 and made[0] == made[1] < made[2]  # lowered, settled, final mesh
    light = follow(twice, isotropic(30), laws=Laws(membrane=Corotational(100.0)))
    assert np.allclose(twice.positions, light.positions, rtol=0, atol=2e-4)  # contact is harder


def test_a_drape_prints_as_one_line(plain):
    fabric = "Fabric(alpha [20, 20, 20] µN·m, beta [0, 0, 0] nN·m², 300 g/m²)"
    size = f"{len(plain.positions)} vertices"
    assert repr(plain) == f"Drape(converged, square300_cylinder100, {size}, {fabric})"
    assert repr(plain.at(plain.positions)).startswith("Drape(a shape, not an equilibrium, ")


class Raising(Gravity):
    """An energy whose value cannot be computed."""

    def value(self, q: np.ndarray) -> float:
        raise FloatingPointError("no value")


def raising(mesh, active, *, fabric):
    return Raising(mesh, density=fabric.density, gravity=9.81)


def plan(alpha: float, **options: object) -> dict:
    start = "lowered" if alpha == ALPHAS[0] else "sine"
    return {"fabric": Fabric(np.full(3, alpha)), "rig": DISC_RIG, "edge": 12e-3,
            "start": start} | options


def test_drapes_are_in_order_and_alike_on_one_core_and_one_that_fails_is_a_status():
    plans = [*map(plan, ALPHAS), plan(30e-6, laws=Laws(others=(raising,)))]
    two = drape_many(plans, workers=2)
    assert [one.fabric.alpha[0] for one in two] == [*ALPHAS, 30e-6]
    assert [one.status for one in two] == [Status.CONVERGED] * 3 + [Status.EXCEPTION]
    assert two[3].message == "FloatingPointError: no value"
    assert not two[3].positions[:, 2].any()
    assert drape_many(iter(())) == []
    for one, other in zip(drape_many(plans), two, strict=True):
        assert one.positions.tobytes() == other.positions.tobytes()


def on_disc(alpha: float, lender=None, **options):
    """A drape of a disc, which has many fold configurations to choose from."""
    settings = {"edge": 0.008, "seed": 1} | options
    if lender is not None:
        settings["borrowed"] = lender.rest, lender.positions
    result = drape(isotropic(alpha), rig=DISC_RIG, **settings)
    assert result.converged, result.message
    return result


@pytest.fixture(scope="module")
def lender():
    """Has ten folds."""
    return on_disc(15)


def mean_distance(first, second) -> float:
    """Between two drapes at the rest points of the first, m."""
    other = interpolate_positions(second.rest, second.positions, first.rest)
    return np.linalg.norm(first.positions - other, axis=1).mean()


def folds(result) -> np.ndarray:
    """Directions of the folds, rad."""
    return fold_angles(fold_outline(result.positions, result.rest, result.rig))


def test_the_same_fabric_stays_where_its_drape_was(lender):
    again = on_disc(15, lender)
    assert np.abs(again.positions - lender.positions).max() < 1e-6
    assert again.iterations < 0.5 * lender.iterations


def test_folds_survive_in_another_fabric_on_another_mesh(lender):
    others, lent = [], []
    for seed in (8, 9):
        borrowed = on_disc(17, lender, seed=seed)
        assert len(folds(borrowed)) == len(folds(lender))
        apart = np.exp(1j * folds(borrowed)[:, None]) / np.exp(1j * folds(lender))
        assert np.degrees(np.abs(np.angle(apart)).min(axis=1)).max() < 9
        lent.append(mean_distance(borrowed, lender))
        others.append(mean_distance(on_disc(17, seed=seed, start="ring"), lender))
    assert max(others) > 2 * max(lent)  # other starts may find the same folds, not all do


def test_borrowed_drape_drifts_with_the_specimen(lender):
    offset = (4e-3, -2e-3)
    moved = on_disc(15, lender, offset=offset)
    assert np.allclose((moved.rest.max(0) + moved.rest.min(0)) / 2, offset, atol=2e-4)
    assert len(folds(moved)) == len(folds(lender))
    assert mean_distance(moved, lender) < 5e-3


@pytest.mark.parametrize("rig", [Rig(), DISC_RIG], ids=lambda rig: rig.name)
def test_drift_matches_plate_with_plate_and_border_with_border(rig):
    lent = make_specimen(rig, edge=0.008, topology=1).mesh
    mesh = make_specimen(rig, edge=0.006, offset=(5e-3, 3e-3), topology=2).mesh
    flat = np.column_stack([lent.rest, np.zeros(len(lent.rest))])
    found = borrowed_positions(mesh.rest, rig=rig, borrowed=(lent.rest, flat))[:, :2]
    radius = np.linalg.norm(mesh.rest, axis=1)
    assert np.allclose(found[radius < rig.plate_radius], mesh.rest[radius < rig.plate_radius],
                       atol=1e-9)
    border = np.unique(mesh.edges[mesh.edge_faces[:, 1] < 0])
    shifted = mesh.rest[border] - [5e-3, 3e-3]
    # The centre of a disc is found from its corners, good to their distance from the circle.
    assert np.allclose(found[border], shifted, atol=1e-4 if rig.specimen == "disc" else 1e-9)
    stretched = np.linalg.norm(np.diff(found[mesh.edges], axis=1), axis=-1) / np.linalg.norm(
        np.diff(mesh.rest[mesh.edges], axis=1), axis=-1)
    assert abs(stretched - 1).max() < 0.15


def test_interpolation_is_exact_for_planes_beyond_a_disc_s_polygon_too():
    coarse, fine = (make_specimen(DISC_RIG, edge=e).mesh.rest for e in (0.016, 0.004))
    plane = np.array([[1.0, 0.2, -0.3], [0.1, 0.9, 0.4]])
    assert np.allclose(interpolate_positions(coarse, coarse @ plane, fine), fine @ plane,
                       atol=1e-9)


def test_hung_start_is_isometric_between_the_corners():
    """The arc has the square's width, so that it starts nearly without stretch."""
    mesh = make_specimen(HUNG_SQUARE, edge=0.015).mesh
    rng = np.random.default_rng(0)
    start = initial_positions(mesh.rest, rig=HUNG_SQUARE, start="sine", rng=rng)
    bottom = np.isclose(mesh.rest[:, 1], -0.3)
    steps = np.diff(mesh.rest[mesh.edges], axis=1)[:, 0]
    lengths = np.linalg.norm(np.diff(start[mesh.edges], axis=1)[:, 0], axis=1)
    assert np.allclose(start[bottom, 2], -0.6)
    assert np.median(lengths / np.linalg.norm(steps, axis=1)) == pytest.approx(1.0, abs=0.02)
    assert np.ptp(start[:, 0]) == pytest.approx(0.5, abs=1e-3)


def test_file_gives_the_drape_back(tmp_path, lender):
    write_drape(tmp_path / "drape.npz", lender)
    rest, positions = read_borrowed(tmp_path / "drape.npz")
    assert np.array_equal(rest, lender.rest) and np.array_equal(positions, lender.positions)
    with np.load(tmp_path / "drape.npz", allow_pickle=False) as archive:
        assert np.array_equal(archive["faces"], lender.faces)
        assert np.array_equal(archive["held"], lender.held)


@pytest.mark.parametrize("changes", [
    {"rest": np.array([{}], dtype=object)}, {"rest": 1.0, "positions": 2.0}, {"positions": None},
    {"rest": np.zeros((3, 2))}, {"positions": np.full((9, 3), np.nan), "rest": np.zeros((9, 2))}],
    ids=["pickle", "scalars", "no positions", "another number", "holes"])
def test_bad_files_are_refused_in_one_line(tmp_path, lender, changes):
    arrays = {"rest": lender.rest, "positions": lender.positions} | changes
    np.savez(tmp_path / "other.npz", **{k: v for k, v in arrays.items() if v is not None})
    with pytest.raises(InputError) as caught:
        read_borrowed(tmp_path / "other.npz")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("rig", "word"), [(HUNG_SQUARE, "3600"), (Rig(), "900")])
def test_drapes_of_other_specimens_are_not_borrowed(lender, rig, word):
    with pytest.raises(InputError, match=word):
        drape(isotropic(20), rig=rig, borrowed=(lender.rest, lender.positions))


def test_a_ring_start_has_waves_all_around_and_leads_to_more_than_one_number_of_folds():
    """Folds as deep on all sides; of one fabric, the number depends on the start's."""
    found = set()
    for seed in range(3):
        rng = np.random.default_rng([seed, 1])
        rest = make_specimen(DISC_RIG, edge=0.008, topology=0, offset=(0.0, 0.0)).mesh.rest
        start = initial_positions(rest, rig=DISC_RIG, start="ring", rng=rng)
        radius = np.linalg.norm(rest, axis=1)
        assert np.abs(start[radius <= DISC_RIG.plate_radius, 2]).max() < 1e-12
        hem = start[radius > 0.149]
        angle = np.arctan2(hem[:, 1], hem[:, 0])
        spectrum = [abs((hem[:, 2] * np.exp(-1j * k * angle)).mean()) for k in range(1, 20)]
        assert 4 <= 1 + int(np.argmax(spectrum)) <= 14
        found.add(len(folds(on_disc(15, edge=0.01, seed=seed, start="ring"))))
    assert len(found) > 1 and min(found) >= 4
