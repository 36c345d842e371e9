"""Drapes made together are those made one by one; a failure spoils its own drape only."""

import os
import signal
import threading
from collections.abc import Sequence

import numpy as np
import pytest
import torch
from torch._subclasses.fake_tensor import FakeTensorMode

from common.errors import InputError
from sim import reference
from sim.batch import drape_batch
from sim.batch.device import DeviceCloths
from sim.batch.rendezvous import together
from sim.cloth import Cloth
from sim.drape import drape
from sim.energies.gravity import Gravity
from sim.laws import Laws
from sim.material import Fabric
from sim.membranes import Corotational
from sim.mesh.specimens import TOPOLOGIES, coarse_to_fine, make_specimen
from sim.newton import NewtonOptions, Status
from sim.scene import DISC_RIG, GRAVITY, Rig, Scene

FABRICS = [Fabric(np.array(a) * 1e-6, -1.5e-3 * np.array(a) * 1e-6)
           for a in ([60, 40, 30], [150, 150, 150], [120, 90, 100])]
SAME = [0, TOPOLOGIES, 2 * TOPOLOGIES]  # seeds of one topology and different starts
EDGE = 0.014
TIGHT = NewtonOptions(residual=1e-7, step=1e-6, max_iterations=300)
TOUCHING = Fabric(np.full(3, 4e-6))  # with seed 0 it meets itself, whatever its start's last bits
ABSURD = Fabric(np.full(3, 1e300))  # its energy overflows


@pytest.mark.parametrize("rig", [Rig(), DISC_RIG], ids=lambda rig: rig.name)
def test_drapes_made_together_are_those_made_alone(rig):
    """The batch changes steps by rounding only, by which one drape takes 43 to 48 of them."""
    settings = {"rig": rig, "edge": EDGE, "offsets": [(0, 0), (4e-3, 2e-3), (0, -3e-3)],
                "seeds": SAME, "starts": ["fold", "fold", "sine"], "options": TIGHT}
    made = drape_batch(FABRICS, **settings, together=True)
    alone = drape_batch(FABRICS, **settings, workers=1)
    for one, other in zip(made, alone, strict=True):
        assert one.converged and one.positive_definite
        assert np.abs(one.positions - other.positions).max() < 1e-8
        assert np.abs(one.state.normals - other.state.normals).max() < 1e-6
        assert one.residual < TIGHT.residual
    together, apart = (sum(result.iterations for result in results) for results in (made, alone))
    assert abs(together - apart) <= 0.1 * apart


def test_a_failure_spoils_no_other():
    soft = Fabric(np.full(3, 0.4e-6))
    options = NewtonOptions(TIGHT.residual, TIGHT.step, max_iterations=45)
    settings = {"edge": 0.02, "options": options}
    good, late, failed = drape_batch([FABRICS[1], soft, ABSURD], seeds=SAME, together=True,
                                     **settings)
    alone, = drape_batch([FABRICS[1]], seeds=SAME[:1], together=True, **settings)
    single = drape(FABRICS[1], seed=SAME[0], **settings)
    # A batch may round its products by its size, and rounding decides upon the last step.
    assert good.converged and abs(good.iterations - alone.iterations) <= 1
    for other in (alone, single):
        assert np.abs(good.positions - other.positions).max() < 1e-9
    assert late.status is Status.MAX_ITERATIONS and "45 iterations" in late.message
    assert failed.status is Status.NOT_FINITE and "not a finite" in failed.message


def test_cloth_that_meets_itself_is_finished_by_itself():
    made = drape_batch([FABRICS[1], TOUCHING], edge=0.016, seeds=[TOPOLOGIES, 0], options=TIGHT,
                       together=True, workers=2)
    alone = drape(TOUCHING, edge=0.016, seed=0, options=TIGHT)
    assert [result.touches for result in made] == [False, True]
    assert all(result.converged and result.self_intersections == 0 for result in made)
    assert "self-contact" in made[1].message and made[1].positive_definite
    assert np.abs(made[1].positions - alone.positions).max() < 1e-7


def test_sizes_and_topologies_form_batches_of_their_own():
    made = drape_batch([FABRICS[1]] * 3, edge=[0.02, 0.016, 0.02], seeds=[0, 1, 8],
                       together=True, at_a_time=1)
    assert [result.edge for result in made] == [0.02, 0.016, 0.02]
    assert np.array_equal(made[0].faces, made[2].faces)
    assert all(result.converged for result in made)


def test_a_narrow_overhang_leaves_out_coarse_meshes_in_a_batch_too():
    offsets = [(0.078, 0.0), (0.0, 0.0)]
    made = drape_batch(FABRICS[:2], edge=0.006, offsets=offsets, seeds=SAME[:2], together=False,
                       workers=1)
    assert [len(r.coarse) for r in made] == [0, len(coarse_to_fine(0.006)) - 1]
    assert all(result.converged for result in made)


def batch_of(
    device: str, sizes: Sequence[float] = (1e-3, 1e-3, 1e-3)
) -> tuple[list[Cloth], DeviceCloths, list[np.ndarray]]:
    """Three cloths, and states crumpled by so many metres."""
    specimen = make_specimen(Rig(), edge=0.016)
    scene = Scene(mesh=specimen.mesh, held=specimen.held, obstacles=Rig().obstacles)
    cloths = [Cloth(scene, fabric) for fabric in FABRICS]
    rng = np.random.default_rng(0)
    rest = specimen.mesh.rest
    radius = np.linalg.norm(rest, axis=1, keepdims=True)
    inwards = rest * np.minimum(1, 0.0499 / np.maximum(radius, 1e-9))
    states = [scene.state(np.column_stack([
        inwards, -np.maximum(radius[:, 0] - 0.05, 0) + rng.normal(0, size, len(rest))
        * ~specimen.held])).q for size in sizes]
    return cloths, DeviceCloths(cloths, torch.device(device)), states


def test_hessians_of_a_batch_are_those_of_the_kernels():
    cloths, there, states = batch_of("cpu", sizes=(1e-3, 1e-3, 9e-3))
    folded = [c.bending.is_folded(q) for c, q in zip(cloths, states, strict=True)]
    assert folded == [False, False, True]
    asked = [(k, states[k], share) for k, share in ((2, 0.0), (0, 0.2), (1, 1.0))]
    data = torch.cat([there._hessians(asked[:2]), there._hessians(asked[2:])]).numpy()
    for row, (k, q, share) in zip(data, asked, strict=True):
        assert cloths[k].obstacles[1].hessian(q).any()  # middles of edges touch the cylinder
        expected = cloths[k].potential.hessian(q, share / 2)
        assert np.abs(row - expected).max() < 1e-12 * np.abs(expected).max()


def test_solutions_go_to_those_who_asked():
    cloths, there, _ = batch_of("cpu")
    scene = cloths[0].scene
    rest = scene.mesh.rest
    bulged = np.column_stack([rest, -0.5 * (rest**2).sum(axis=1)])
    states = [scene.state(bulged).q] * 3
    asked = [(k, states[k], 1.0) for k in (2, 0, 1)]
    verdicts = there.factorise(asked)
    rhs = np.random.default_rng(1).standard_normal(there.pattern.size)
    assert verdicts == [True] * 3
    some = [0, 2]  # one of them needs no solution
    found = there.solve([(number, rhs) for number in some])
    for number, x in zip(some, found, strict=True):
        matrix = there.pattern.symmetric(cloths[number].potential.hessian(states[number], 0.5))
        assert np.linalg.norm(matrix @ x - rhs) < 1e-6 * np.linalg.norm(rhs)


def test_everything_stays_on_the_device(monkeypatch):
    """By tensors that have a device and no numbers, so that no GPU is needed.

    PyTorch differentiates none of these without a GPU: that is left out.
    """
    def without_numbers(energies, at):
        assert energies(at).shape == at.shape[:2]
        return at, at[..., None] * at[..., None, :]

    monkeypatch.setattr("sim.batch.hessians.derivatives", without_numbers)
    monkeypatch.setattr("sim.batch.device.derivatives", without_numbers)
    cloths, _, states = batch_of("cpu")
    with FakeTensorMode(allow_non_fake_inputs=True):
        there = DeviceCloths(cloths, torch.device("cuda"))
        some, x, n = there._at([(0, states[0]), (2, states[2])])
        move, turn = torch.zeros_like(x), x.new_zeros(n.shape[:2])
        turned = reference.moved(some.topology, x, n, move, turn)
        data = there._hessians([(0, states[0], 0.0), (2, states[2], 1.0)])
        found = [reference.energy(some, x, turned), data, there._solver.factorise(data),
                 there._solver.solve(data.new_zeros(2, there.pattern.size))]
    assert [tensor.device for tensor in found] == 4 * [torch.device("cuda", 0)]
    assert [len(tensor) for tensor in found] == 4 * [2]


# The rendezvous


def test_runs_that_wait_are_answered_together():
    calls = []

    def double(asked):
        calls.append(("double", list(asked)))
        return [2 * value for value in asked]

    def count(asked):
        calls.append(("count", len(asked)))
        return [len(asked)] * len(asked)

    def run(number, rendezvous, place):
        assert number == place
        value = rendezvous.ask(place, "double", 1, double, number)
        if number == 2:
            return value  # and leaves the others
        return value + rendezvous.ask(place, "count", 0, count, None)

    found = together([lambda r, k, n=n: run(n, r, k) for n in range(3)])
    assert found == [2, 4, 4]
    assert calls == [("double", [0, 1, 2]), ("count", 2)]


def test_nobody_waits_for_a_run_that_is_busy_by_itself():
    first = threading.Event()

    def answer(asked):
        first.set()
        return list(asked)

    def run(number, rendezvous, place):
        if number == 0:
            with rendezvous.apart():
                assert first.wait(30)  # until the other has its answer
        return rendezvous.ask(place, "kind", 0, answer, number)

    assert together([lambda r, k, n=n: run(n, r, k) for n in range(2)]) == [0, 1]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
@pytest.mark.parametrize("where", ["run", "answer"])
def test_an_error_ends_all_runs_and_reaches_the_caller(where, error):
    ended = threading.Semaphore(0)

    def answer(asked):
        if where == "answer":
            raise error("there")
        return list(asked)

    def run(rendezvous, number):
        try:
            if number == 1 and where == "run":
                raise error("here")
            while True:
                rendezvous.ask(number, "kind", 0, answer, number)
        finally:
            ended.release()

    with pytest.raises(error, match="there" if where == "answer" else "here"):
        together([run, run])
    assert all(ended.acquire(timeout=30) for _ in range(2))


# Mistakes, and worker processes


def heavier(mesh, active, *, fabric):
    return Gravity(mesh, density=fabric.density, gravity=GRAVITY)


@pytest.mark.parametrize(("arguments", "word"), [
    ({"starts": ["sine"]}, "starts has 1 entries for 3 fabrics"),
    ({"seeds": [0, 1, -2]}, "seed=-2"), ({"starts": "flat"}, "flat"),
    ({"offsets": [(0, np.nan)] * 3}, "finite"), ({"at_a_time": 0}, "at_a_time=0"),
    ({"workers": 0}, "workers=0"), ({"device": "tpu9"}, "tpu9"), ({"device": "meta"}, "meta"),
    ({"device": "cuda:x"}, "cuda:x"), ({"device": "cuda:99"}, "no GPU of this number"),
    ({"edge": 1e-6, "workers": 1}, "edge=0.001 mm"), ({"rig": "square"}, "rig='square'"),
    ({"laws": Laws(bending="hinge"), "together": True}, "together=False"),
    ({"laws": Laws(others=(heavier,)), "together": True}, "together=False"),
])
def test_mistakes_are_named(arguments, word):
    with pytest.raises(InputError, match=word):
        drape_batch(FABRICS, **({"edge": EDGE} | arguments))


def test_worker_processes_make_the_same_drapes():
    fabrics = [*FABRICS[:2], ABSURD]
    made = drape_batch(fabrics, edge=EDGE, seeds=SAME, starts=["fold"] * 3, options=TIGHT,
                       workers=2)
    for seed, fabric, result in zip(SAME, fabrics, made, strict=True):
        alone = drape(fabric, edge=EDGE, seed=seed, start="fold", options=TIGHT)
        assert np.array_equal(result.fabric.alpha, fabric.alpha)
        assert result.status is alone.status and result.message == alone.message
        if fabric is not ABSURD:
            assert np.abs(result.positions - alone.positions).max() < 1e-8


def test_laws_of_the_default_forms_may_have_other_constants():
    settings = {"edge": 0.016, "options": TIGHT, "laws": Laws(membrane=Corotational(400.0))}
    made, = drape_batch(FABRICS[1:2], together=True, **settings)
    assert made.converged
    assert np.abs(made.positions - drape(FABRICS[1], **settings).positions).max() < 1e-8
    plain = drape(FABRICS[1], edge=0.016, options=TIGHT)
    assert np.abs(made.positions - plain.positions).max() > 1e-5


def test_no_fabrics_no_drapes():
    assert drape_batch([]) == [] and drape_batch([], together=True) == []


def killed(mesh, active, *, fabric):
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_worker_that_is_killed_is_reported():
    with pytest.raises(InputError, match="ended from outside"):
        drape_batch(FABRICS, edge=EDGE, workers=2, laws=Laws(others=(killed,)))
