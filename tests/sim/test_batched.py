"""Batches of drapes: the energies, steps and minima of the compiled simulator, one by one; the two
state the physics independently, so that each is held against the other."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch

from sim.batched import drapes
from sim.batched.drapes import covers, drape_batch
from sim.batched.laws import raise_eigenvalues
from sim.batched.lowered import columns, lowered
from sim.batched.newton import Minimisation, minimise
from sim.batched.potential import BatchedPotential
from sim.cloth import Cloth, Laws
from sim.draping import Run, drape
from sim.energies.bending_variants import Hysteresis
from sim.energies.fold_barrier import is_bent
from sim.energies.membrane import OrthotropicStVK
from sim.material import Fabric
from sim.rig import DISC_RIG, Rig
from sim.scene import make_specimen
from sim.solver.linear import SuperLUSolver
from sim.solver.newton import NewtonOptions, Status
from sim.solver.newton import minimise as minimise_alone
from sim.solver.state import State

FABRICS = (
    Fabric(np.array([5e-5, 2e-5, 1e-5]), np.array([-5e-8, -4e-8, -1e-8])),  # limp bias
    Fabric(np.array([5e-6, 4e-6, 1e-5]), np.array([-5e-9, -1e-8, 1e-9])),
    Fabric(np.array([5e-5, 1e-4, 6e-5]), np.array([-5e-8, -4e-8, -1e-8])),  # stiff bias
)
EXACT = NewtonOptions(residual=1e-7, step=1e-5, max_iterations=60)


PLAN = {"fabric": FABRICS[2], "rig": DISC_RIG, "edge": 20e-3}


@pytest.fixture(scope="module")
def exact():
    """A drape by the compiled simulator."""
    return drape(**PLAN)


@pytest.fixture(scope="module", params=["plain", "real"])
def crumpled(request):
    """Cloths, a state of each (nearly flat, creased, folded) and their batch; real specimens differ
    in size and offset, have hysteresis, curl and orthotropic membranes."""
    rng, cloths, states = np.random.default_rng(0), [], []
    for fabric, size in zip(FABRICS, (1e-4, 2e-3, 4e-3), strict=True):
        scene, laws = make_specimen(DISC_RIG, edge=12e-3), Laws()
        if request.param == "real":
            sides, plate = rng.normal((0.3, 0.18), 5e-4)
            scene = make_specimen(Rig((sides, sides), plate, "disc"), edge=12e-3,
                                  offset=rng.normal(0, 2e-3, 2))
            origin = rng.normal(0, 3.0, (scene.active.sum(), 3))
            laws = Laws(Hysteresis(rng.uniform(0.1, 0.3), curvature=tuple(rng.normal(0, 4, 3)),
                                   origin=origin),
                        OrthotropicStVK(warp=rng.uniform(200, 900), shear=rng.uniform(20, 80)))
        mesh, free = scene.mesh, ~scene.held
        cloth = Cloth(scene, fabric, laws=laws)
        x = np.column_stack([mesh.rest * np.where(free, 0.95, 1.0)[:, None], -1e-3 * free])
        if request.param == "real":  # pressed to the support's side
            radius, plate = np.linalg.norm(mesh.rest, axis=1), scene.obstacles[0].radius
            x[free, :2] = mesh.rest[free] * ((plate - 1e-4) / radius[free])[:, None]
            x[free, 2] = plate - radius[free]
        turns = np.zeros(cloth.potential.unknowns)
        turns[x.size:] = rng.normal(0, 0.1, len(mesh.edges))
        turns = cloth.potential.free_unknowns(turns)
        start = scene.state(x + rng.normal(0, size, x.shape) * free[:, None])
        states.append((start, turns, cloth.potential.moved(start.q, turns)))
        cloths.append(cloth)
    x = columns([start.positions for start, _, _ in states])
    batch = BatchedPotential(cloths)
    if request.param == "real":
        batch = batch.having(origin=columns([cloth.bending.origin for cloth in cloths]))
    n = batch.normals(x)
    assert torch.allclose(n, columns([start.normals for start, _, _ in states]), atol=1e-12)
    moved = batch.moved(x, n, torch.from_numpy(np.stack([turns for _, turns, _ in states], 1)))
    return cloths, [q for _, _, q in states], batch, moved


def test_energies_and_gradients_are_those_of_one_cloth(crumpled):
    cloths, states, batch, now = crumpled
    value = batch.evaluate(*now)
    bending = cloths[2].bending
    assert "origin" in batch.tensors or is_bent(bending.angles(states[2]), bending.pole).any()
    for k, (cloth, q) in enumerate(zip(cloths, states, strict=True)):
        assert "origin" not in batch.tensors or cloth.obstacles[0].value(q) > 0
        energy, gradient = cloth.potential.evaluate(q)
        assert float(value.energy[k]) == pytest.approx(energy, rel=1e-12)
        assert np.abs(value.gradient[:, k].numpy() - gradient).max() < 1e-12 * np.abs(
            gradient).max()


def test_each_has_the_hessian_of_its_convexity(crumpled):
    cloths, states, batch, now = crumpled
    for blends in ((0.0, 0.1, 1.0), (1.0, 0.0, 0.5), (0.5, 1.0, 0.0)):
        data = batch.hessian(*now, *(torch.tensor(one, dtype=torch.float64)
                                     for one in (blends, (0.0, 0.1, 1e3))))
        for k, (cloth, q) in enumerate(zip(cloths, states, strict=True)):
            expected = cloth.potential.model(q).hessian(blends[k], (0.0, 0.1, 1e3)[k])
            assert np.abs(data[:, k].numpy() - expected).max() < 1e-10 * np.abs(expected).max()


def test_only_low_eigenvalues_are_raised():
    rng = np.random.default_rng(3)
    draws = rng.standard_normal((3, 3, 2, 50))
    matrix = draws + draws.swapaxes(0, 1)
    matrix[..., 0, 0], matrix[..., 0, 1] = np.diag([1.0, -2.0, 1.0]), np.zeros((3, 3))
    floor, share = rng.uniform(0, 1, (2, 50))
    value, vector = np.linalg.eigh(np.moveaxis(matrix, (0, 1), (2, 3)))
    lift = share[:, None] * np.maximum(floor[:, None] - value, 0.0)
    expected = matrix + np.einsum("...ik,...k,...jk->ij...", vector, lift, vector)
    found = torch.from_numpy(matrix.copy())
    raise_eigenvalues(found, torch.from_numpy(floor), torch.from_numpy(share))
    assert np.abs(found.numpy() - expected).max() < 1e-13


def test_solutions_are_those_of_a_sparse_solver_and_indefinite_matrices_are_named(crumpled):
    cloths, states, batch, _ = crumpled
    rng, potential = np.random.default_rng(1), cloths[1].potential
    convex, exact = (potential.model(states[1]).hessian(blend) for blend in (1.0, 0.0))
    broken = np.where(np.arange(len(convex)) == 7, np.nan, convex)
    stiff = cloths[2].potential.model(states[2]).hessian(1.0)
    data = torch.from_numpy(np.stack([convex, exact, broken, stiff], axis=1))
    rhs = rng.standard_normal((potential.size, 4))
    assert batch.solver.factorise(data).tolist() == [True, False, False, True]
    solved = batch.solver.solve(torch.from_numpy(rhs)).numpy()
    for k, matrix in ((0, convex), (3, stiff)):
        one = SuperLUSolver(potential.pattern)
        assert one.factorise(matrix)
        expected = one.solve(rhs[:, k])
        assert np.abs(solved[:, k] - expected).max() < 1e-8 * np.abs(expected).max()


@pytest.mark.parametrize("slots", [None, 1])
def test_drapes_converge_to_the_minima_of_one_and_a_failure_stays_alone(exact, slots):
    scene, rng = exact.scene, np.random.default_rng(0)
    starts = [np.full_like(exact.positions, np.nan), exact.positions + rng.normal(
        0, 1e-4, exact.positions.shape) * ~scene.held[:, None]]
    x = columns(starts)
    batch = BatchedPotential([Cloth(scene, fabric) for fabric in (FABRICS[0], FABRICS[2])])
    found = minimise(batch, x, batch.normals(x), EXACT, slots=slots)
    assert [result.status for result in found.results] == [Status.NOT_FINITE, Status.CONVERGED]
    assert found.results[1].positive_definite and found.results[0].iterations == 0
    near = minimise_alone(exact.cloth.potential, exact.state.q, EXACT)
    assert near.status is Status.CONVERGED
    positions = State.of(near.q, len(exact.positions)).positions
    assert np.abs(found.x[..., 1].numpy().T - positions).max() < 1e-6


def test_a_slot_is_filled_at_once_and_drapes_depend_neither_on_it_nor_on_a_failure(monkeypatch):
    count, run = 6, Run.of(FABRICS[2], rig=DISC_RIG, edge=20e-3)
    scenes, calls, iterate = [run.scene(run.edge)] * count, [], Minimisation.iterate
    potential = BatchedPotential([Cloth(scene, FABRICS[2]) for scene in scenes])
    alone, broken = potential.tensors["form"], potential.tensors["form"].clone()
    broken[..., 1] = torch.nan
    monkeypatch.setattr(Minimisation, "iterate", lambda run: calls.append(0) or iterate(run))
    every, paired = (lowered(potential.having(form=form), scenes, [DISC_RIG] * count, range(count),
                             slots=slots) for form, slots in ((alone, None), (broken, 2)))
    steps = np.array([result.iterations for result in paired.results])
    assert [result.status for result in paired.results].count(Status.NOT_FINITE) == 1
    assert paired.results[1].status is Status.NOT_FINITE
    others = np.arange(count) != 1
    assert steps[others].tolist() == [every.results[k].iterations for k in np.flatnonzero(others)]
    assert np.abs((paired.x - every.x)[..., others].numpy()).max() < 1e-9
    # No slot is empty while a drape waits: the bound of list scheduling (Graham 1966).
    in_lock = len(calls) - max(result.iterations for result in every.results) - 2
    assert steps.sum() / 2 <= in_lock <= (steps.sum() + steps.max()) / 2


@pytest.mark.parametrize("crumpled", ["real"], indirect=True)
def test_origins_slide_as_those_of_one_cloth(crumpled):
    cloths, states, batch, now = crumpled
    part = batch.take(torch.arange(3)).slid(*now)
    for k, (cloth, q) in enumerate(zip(cloths, states, strict=True)):
        origin = cloth.bending.origin_at(q)
        assert np.abs(part.tensors["origin"][..., k].numpy().T - origin).max() < 1e-9 * np.abs(
            origin).max()
        assert not np.allclose(origin, cloth.bending.origin)


def test_a_batch_is_complete_and_in_order(exact):
    plans = [PLAN | {"fabric": FABRICS[0]}, PLAN | {"start": "sine"}, PLAN]
    assert [covers(plan) for plan in plans] == [True, False, True]
    made = drape_batch(plans, device="cpu", slots=1)
    assert [one.fabric for one in made] == [plan["fabric"] for plan in plans]
    assert all(one.converged for one in made)
    assert np.abs(made[2].positions - exact.positions).max() < 1e-6


def test_what_is_not_finished_is_continued(monkeypatch, exact):
    monkeypatch.setattr(drapes, "MAX_ITERATIONS", 1)
    made = drape_batch([PLAN], device="cpu")[0]
    assert made.converged and made.coarse == (Status.MAX_ITERATIONS,)
    assert made.outcome.positive_definite
    assert np.abs(made.positions - exact.positions).max() < 1e-6


def test_an_error_of_one_that_is_continued_stays_its_own(monkeypatch):
    def fails(*_, **__):
        raise FloatingPointError("overflow")

    monkeypatch.setattr(drapes, "MAX_ITERATIONS", 1)
    monkeypatch.setattr(drapes, "follow", fails)
    with ThreadPoolExecutor(1) as pool:
        made = drape_batch([PLAN], device="cpu", pool=pool)[0]
    assert made.status is Status.EXCEPTION and "FloatingPointError: overflow" in made.message
    assert made.fabric == PLAN["fabric"]


def test_real_specimens_are_those_of_one():
    """Of different sizes, with hysteresis, curl and an orthotropic membrane."""
    laws = Laws(Hysteresis(0.15, curvature=(4.0, -3.0, 0.0)),
                OrthotropicStVK(warp=700.0, weft=700.0, shear=100.0))
    plans = [PLAN | {"rig": Rig((0.3 + size,) * 2, 0.18, "disc"), "laws": laws, "seed": 3}
             for size in (1e-3, -1e-3)]
    for made, plan in zip(drape_batch(plans, device="cpu"), plans, strict=True):
        one = drape(**plan)
        assert made.converged and made.rig == plan["rig"] and one.converged
        assert np.abs(made.positions - one.positions).max() < 1e-6
        origin, expected = (drape.laws.bending.origin for drape in (made, one))
        assert np.abs(origin - expected).max() < 1e-4 * np.abs(expected).max()
