"""Drapes made together, against each other and against single drapes."""

import numpy as np
import pytest
import torch
from sparse_batches import SparseSolver

from common.errors import InputError
from sim.batched import drape as batched
from sim.batched.drape import drape_batch
from sim.batched.equilibrium import analyse_grid, find_equilibria
from sim.batched.potential import BatchedPotential
from sim.batched.solvers import FrontalSolver
from sim.drape import drape, start_positions
from sim.energies.midedge import MidEdgeBending
from sim.equilibrium import build_potential, cloth_terms, find_equilibrium
from sim.laws import Laws
from sim.material import MICRO, Fabric
from sim.membranes import Corotational
from sim.newton import NewtonOptions, Status
from sim.scene import DISC_RIG, HUNG_SQUARE, Rig, Scene, State
from sim.self_contact import self_intersections
from sim.specimens import make_specimen

pytestmark = pytest.mark.usefixtures("one_thread")

N = 16
TIGHT = NewtonOptions(residual=1e-7, step=1e-6, max_iterations=300)
STIFF = Fabric(alpha=np.array([120.0, 90.0, 60.0]) * MICRO)
SOFTENING = Fabric(alpha=np.array([50.0, 60.0, 40.0]) * MICRO, beta=np.array([-1e-7, 0, -6e-8]))
SOFT = Fabric(alpha=np.full(3, 8 * MICRO), beta=np.full(3, -2e-8))
ABSURD = Fabric(alpha=np.full(3, 1e300))  # its energy overflows


def apart(a, b):
    return np.abs(a.positions - b.positions).max()


@pytest.fixture(scope="module")
def batch():
    fabrics = [STIFF, SOFTENING, ABSURD, SOFT]
    offsets = [(0.0, 0.0), (4e-3, -2e-3), (0.0, 0.0), (0.0, 3e-3)]
    starts = ["sine", "fold", "sine", "sine"]
    results = drape_batch(fabrics, resolution=N, offsets=offsets, starts=starts, seeds=[3, 4, 5, 6],
                          options=TIGHT, together=True)
    return list(zip(fabrics, offsets, starts, [3, 4, 5, 6], results, strict=True))


def test_alone_or_with_any_neighbours_the_same(batch):
    fabric, offset, start, seed, with_failing = batch[1]
    settings = {"resolution": N, "options": TIGHT, "together": True}
    alone, = drape_batch([fabric], offsets=[offset], starts=start, seeds=[seed], **settings)
    with_easy = drape_batch([STIFF, fabric], offsets=[(0.0, 0.0), offset], starts=["sine", start],
                            seeds=[0, seed], **settings)[1]
    assert batch[2][-1].status is Status.NOT_FINITE and "not a finite" in batch[2][-1].message
    for result in (alone, with_easy):
        assert result.converged and result.iterations == with_failing.iterations
        assert apart(result, with_failing) < 1e-9


def test_as_single_drapes(batch):
    # Rough factors of single precision may lead to other folds; these are exact.
    options = NewtonOptions(TIGHT.residual, TIGHT.step, TIGHT.max_iterations, "superlu")
    for fabric, offset, start, seed, result in batch:
        single = drape(fabric, resolution=N, offset=offset, start=start, seed=seed, options=options)
        assert result.status is single.status
        assert result.message.split(";")[0] == single.message.split(";")[0]
        assert np.array_equal(result.faces, single.faces)
        assert np.array_equal(result.held, single.held)
        if fabric is not ABSURD:
            assert result.converged and result.positive_definite
            # Second derivatives of self-contact jump: there rounding may cost a step.
            touches = "self-contact" in single.message
            assert abs(result.iterations - single.iterations) <= (2 if touches else 0)
            assert apart(result, single) < 1e-7
            assert np.abs(result.rotations - single.rotations).max() < 1e-5


def problem(fabrics, n, **settings):
    """Arguments of find_equilibria for sine starts, and the terms."""
    rig = Rig()
    specimens = [make_specimen(rig, resolution=n, seed=k, **settings) for k in range(len(fabrics))]
    scenes = [Scene(mesh=s.mesh, held=s.held, obstacles=rig.obstacles) for s in specimens]
    starts = [
        State.at(s.mesh, start_positions(s, rig, coarse=None, start="sine", seed=k))
        for k, s in enumerate(specimens)
    ]
    free = np.any([~s.held for s in specimens], axis=0).reshape(n, n)
    terms = [cloth_terms(*sample) for sample in zip(scenes, fabrics, starts, strict=True)]
    return scenes, fabrics, starts, analyse_grid(free), terms


def potential_of(fabrics):
    """Scenes, starts, terms, shared unknowns, the batch's potential and its rows at the starts."""
    scenes, _, starts, analysed, terms = problem(fabrics, 12)
    potential = BatchedPotential(terms, [scene.mesh for scene in scenes], analysed.unknowns)
    y = potential.start([sample.template for sample in terms])
    return scenes, starts, terms, analysed.unknowns, potential, y


def only(systems):
    """The one group of systems there is, its data as an array."""
    (which, pattern, data), = systems
    return which, pattern, data.numpy()


def test_potential_is_that_of_the_samples():
    """Value, gradient, Hessian at every convexity, scales and limits, on shared unknowns."""
    fabrics = [STIFF, SOFTENING, SOFT]
    scenes, starts, terms, unknowns, potential, y = potential_of(fabrics)
    y += 1e-3 * torch.from_numpy(np.random.default_rng(0).standard_normal(y.shape))
    index, shift = np.array([2, 0, 2, 1]), np.array([0.0, 0.5, 2.0, 0.0])
    levels = np.array([0.1, 0.0, 1.0, 0.5])
    hessians = potential.hessians(y)
    which, pattern, data = only(hessians.systems(index, levels, shift))
    assert pattern is unknowns.pattern and np.array_equal(which, np.arange(4))
    _, _, again = only(hessians.systems(np.array([1, 2]), np.array([0.5, 0.1]), np.zeros(2)))
    assert np.array_equal(again, data[[3, 0]])
    everyone = np.arange(3)
    inside = hessians.into_frames(everyone, potential.gradient(y))
    outside = hessians.out_of_frames(everyone, y)
    some = np.array([0, 2])
    assert np.array_equal(hessians.into_frames(some, potential.gradient(y)[some]), inside[some])
    assert np.array_equal(hessians.out_of_frames(some, y[some]), outside[some])
    part = potential.take(torch.tensor([1]))
    for k, (scene, fabric, start) in enumerate(zip(scenes, fabrics, starts, strict=True)):
        single = build_potential(scene, fabric, start)
        rows = unknowns.rows(scene.mesh, terms[k].free)
        own = y[k].numpy()[rows[rows >= 0]]
        full = potential.full(y)[k].numpy()
        assert np.array_equal(full, single.full(own))
        assert np.isclose(potential.value(y)[k], single.value(own), rtol=1e-12)
        gradient, expected = potential.gradient(y)[k].numpy(), single.gradient(own)
        assert np.allclose(gradient[rows[rows >= 0]], expected, atol=1e-12 * abs(expected).max())
        absent = np.ones(unknowns.size, dtype=bool)
        absent[rows[rows >= 0]] = False
        assert absent.any() and not gradient[absent].any()
        residual = potential.residual(potential.gradient(y))[k]
        assert np.isclose(residual, single.residual(expected), rtol=1e-9)
        assert np.isclose(potential.step_length(y)[k], single.step_length(own), rtol=1e-12)
        if k == 1:
            assert np.isclose(part.value(y[[1]])[0], single.value(own), rtol=1e-12)
        for found, framed in ((inside[k], single.into_frames(own, expected)),
                              (outside[k], single.out_of_frames(own, own))):
            found = found.numpy()[rows[rows >= 0]]
            assert np.allclose(found, framed, atol=1e-12 * abs(framed).max())
        for where in np.flatnonzero(index == k):
            pattern, matrix = single.hessian(own, levels[where])
            matrix[pattern.diagonal] += shift[where] * single.regularisation
            expected = unknowns.embed(pattern, matrix, rows[rows >= 0])
            assert np.allclose(data[where], expected, atol=1e-11 * abs(expected).max())


def test_who_feels_the_limit_of_folds_has_another_pattern():
    """Two of three samples, one of them crumpled: its matrix is that of the single potential."""
    fabrics = [STIFF, SOFTENING, SOFT]
    scenes, starts, terms, unknowns, potential, y = potential_of(fabrics)
    y[1] += 0.03 * torch.from_numpy(np.random.default_rng(0).standard_normal(y[1].shape))
    hessians = potential.hessians(y)
    systems = list(hessians.systems(np.array([0, 1]), np.array([0.0, 0.1]), np.zeros(2)))
    assert [which.tolist() for which, _, _ in systems] == [[0], [1]]
    assert [pattern for _, pattern, _ in systems] == [unknowns.pattern, unknowns.wide_pattern]
    rows = unknowns.rows(scenes[1].mesh, terms[1].free)
    single = build_potential(scenes[1], fabrics[1], starts[1])
    own = y[1].numpy()[rows[rows >= 0]]
    pattern, expected = single.hessian(own, 0.1)
    whole = systems[1][1].symmetric(systems[1][2][0].numpy())[rows[rows >= 0]][:, rows[rows >= 0]]
    difference = whole - pattern.symmetric(expected)
    assert abs(difference).max() < 1e-11 * abs(expected).max()


def test_both_linear_solvers_find_the_same():
    scenes, fabrics, starts, analysed, _ = problem([STIFF, SOFTENING], 12)
    makers = (None, lambda pattern: SparseSolver(pattern, threads=2))
    first, second = (
        find_equilibria(scenes, fabrics, starts, analysed, options=TIGHT, make_solver=maker)
        for maker in makers
    )
    for a, b in zip(first[0], second[0], strict=True):
        assert np.abs(a.positions - b.positions).max() < 1e-9
    assert [r.iterations for r in first[1]] == [r.iterations for r in second[1]]


def test_crumpled_and_smooth_cloth_together_go_the_way_of_single_ones():
    """Some steps from where one of two feels the limit of folds: in two patterns at once."""
    scenes, fabrics, starts, analysed, _ = problem([STIFF, SOFTENING], 12)
    crumpled = starts[1].positions.copy()
    noise = np.random.default_rng(0).normal(0.0, 0.012, crumpled.shape)
    crumpled[~scenes[1].held] += noise[~scenes[1].held]
    starts = [starts[0], State.at(scenes[1].mesh, crumpled)]
    options = NewtonOptions(max_iterations=4, linear_solver="superlu")
    patterns = []

    def make(pattern):
        patterns.append(pattern)
        return FrontalSolver(analysed.analysis(pattern))

    states, results = find_equilibria(scenes, fabrics, starts, analysed, options=options,
                                      make_solver=make)
    assert patterns == [analysed.unknowns.pattern, analysed.unknowns.wide_pattern]
    for scene, fabric, start, state, result in zip(scenes, fabrics, starts, states, results,
                                                   strict=True):
        expected, single = find_equilibrium(scene, fabric, start, options=options)
        assert result.iterations == single.iterations == 4
        assert result.factorisations == single.factorisations
        assert np.abs(state.positions - expected.positions).max() < 1e-8
        assert np.abs(state.rotations - expected.rotations).max() < 1e-5


def test_coarse_to_fine_and_resolutions_of_their_own():
    """Two resolutions in one call, one of them by way of a coarser mesh."""
    fabrics = [STIFF, SOFTENING]
    results = drape_batch(fabrics, resolution=[16, 31], options=TIGHT, together=True)
    assert [result.resolution for result in results] == [16, 31]
    for seed, (fabric, result) in enumerate(zip(fabrics, results, strict=True)):
        single = drape(fabric, resolution=result.resolution, seed=seed, options=TIGHT)
        assert result.converged and single.converged
        assert apart(result, single) < 1e-7
        assert 0 < result.time_spent["factorise"] < result.time_spent["total"] < result.seconds


def test_cloth_that_meets_itself_is_finished_alone(monkeypatch):
    """The batch's minimum intersects itself; what comes back does not."""
    found = []

    def spy(positions, faces):
        found.append(len(self_intersections(positions, faces)))
        return self_intersections(positions, faces)

    monkeypatch.setattr(batched, "self_intersections", spy)
    tangled = Fabric(alpha=np.full(3, 1.5 * MICRO))
    results = drape_batch([STIFF, tangled], resolution=21, seeds=[0, 2], together=True)
    assert found[0] == 0 and found[1] > 0
    assert "self-contact" in results[1].message and "self-contact" not in results[0].message
    assert results[0].converged and results[0].self_intersections == 0
    assert results[1].self_intersections == 0 or results[1].status is Status.SELF_CONTACT


def test_a_hung_square_and_a_structured_mesh():
    result, = drape_batch([STIFF], rig=HUNG_SQUARE, mesh="structured", resolution=13, options=TIGHT,
                          together=True)
    single = drape(STIFF, rig=HUNG_SQUARE, mesh="structured", resolution=13, options=TIGHT)
    assert result.converged and apart(result, single) < 1e-7


def test_one_by_one_is_the_single_drape():
    fabrics = [SOFTENING, STIFF, ABSURD]
    results = drape_batch(fabrics, resolution=N, seeds=[7, 8, 9], workers=2)
    for seed, (fabric, result) in enumerate(zip(fabrics, results, strict=True), 7):
        single = drape(fabric, resolution=N, seed=seed)
        assert np.array_equal(result.fabric.alpha, fabric.alpha)
        assert result.status is single.status and result.message == single.message
        assert np.array_equal(result.positions, single.positions)


def test_no_fabrics_no_drapes():
    assert drape_batch([]) == [] and drape_batch([], together=True) == []


@pytest.mark.parametrize("wrong, words", [
    ({"seeds": [1]}, "seeds has 1 entries for 2"),
    ({"starts": ["sine"] * 3}, "starts has 3"),
    ({"resolution": [16]}, "resolution has 1"),
    ({"resolution": [16, 402]}, "resolution=402"),
    ({"rig": DISC_RIG.name}, "Rig.from_name"),
    ({"laws": "midedge"}, "sim.laws.Laws"),
    ({"offsets": [(0, 0), (np.nan, 0)]}, "finite"),
    ({"mesh": "unstructured"}, "unknown mesh"),
    ({"rig": DISC_RIG, "together": True}, "no grid"),
    ({"at_a_time": 0}, "at least one"),
    ({"workers": 0}, "at least one"),
    ({"device": "abacus"}, "unknown device"),
    ({"device": "meta"}, "choose cpu or cuda"),
    ({"laws": Laws(bending="hinge"), "resolution": 16, "together": True}, "together=False"),
    ({"laws": Laws(others=(MidEdgeBending,)), "resolution": 16, "together": True},
     "together=False"),
    ({"starts": "crumpled"}, "unknown start"),
    ({"seeds": [0, -1]}, "negative"),
    ({"resolution": [16, 12.7]}, "whole number"),
])
def test_mistakes(wrong, words):
    with pytest.raises(InputError, match=words):
        drape_batch([STIFF, SOFT], **wrong)


@pytest.mark.parametrize("together", [True, False])
def test_drapes_of_other_laws(together):
    laws = Laws(membrane=Corotational(400.0))
    result, = drape_batch([STIFF], resolution=N, laws=laws, options=TIGHT, together=together,
                          workers=1)
    single = drape(STIFF, resolution=N, laws=laws, options=TIGHT)
    assert result.converged and apart(result, single) < 1e-7
    assert apart(single, drape(STIFF, resolution=N, options=TIGHT)) > 1e-5


def test_terms_without_a_twin_are_refused():
    scenes, fabrics, starts, analysed, _ = problem([STIFF], 12)
    with pytest.raises(InputError, match="cannot be evaluated in a batch"):
        find_equilibria(scenes, fabrics, starts, analysed, laws=Laws(bending="hinge"))
