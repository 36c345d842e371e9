"""Potentials, lowering, and batches of drapes: energies, steps and minima of the compiled simulator
one by one. The two state the physics independently, so that each is held against the other."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch
from scipy.special import j0

from sim.batched import drapes
from sim.batched.drapes import covers, drape_batch
from sim.batched.laws import raise_eigenvalues
from sim.batched.lowered import columns, lowered
from sim.batched.newton import Minimisation, minimise
from sim.batched.potential import BatchedPotential
from sim.cloth import Cloth, Laws
from sim.draping import Run, drape
from sim.energies.bending_variants import Hysteresis
from sim.energies.external import Gravity
from sim.energies.fold_barrier import LIMIT_START, is_bent, keeps_distance
from sim.energies.membrane import Corotational, OrthotropicStVK
from sim.energies.midedge import MidEdgeBending
from sim.energies.uneven import Uneven
from sim.material import Fabric
from sim.measures import fold_count
from sim.mesh import Mesh, strip
from sim.rig import DISC_RIG, GRAVITY, Rig
from sim.scene import Scene, make_specimen
from sim.solver.dynamics import Inertia, Motion
from sim.solver.linear import SuperLUSolver
from sim.solver.newton import NewtonOptions, Status
from sim.solver.newton import minimise as minimise_alone
from sim.solver.potential import forces
from sim.solver.state import State, moved

RIG = Rig()
SOFT = Fabric(np.full(3, 20e-6))


def crumpled_cloth(size=2e-3, turn=0.1, edge=0.012, **laws):
    """A cloth, a crumpled state of it, and random numbers."""
    specimen = make_specimen(RIG, edge=edge)
    mesh, held = specimen.mesh, specimen.held
    rng = np.random.default_rng(0)
    positions = np.column_stack([mesh.rest, np.zeros(len(mesh.rest))])
    positions += rng.normal(0, size, positions.shape) * ~held[:, None]
    scene = Scene(mesh=mesh, held=held, obstacles=RIG.obstacles)
    cloth = Cloth(scene, Fabric(np.full(3, 2e-5)), laws=Laws(**laws))
    potential = cloth.potential
    step = np.zeros(potential.unknowns)
    step[3 * len(mesh.rest):] = rng.normal(0, turn, len(mesh.edges))
    q = potential.moved(scene.state(positions).q, potential.free_unknowns(step))
    return cloth, q, rng


@pytest.fixture(scope="module")
def crumpled():
    return crumpled_cloth()


def random_step(potential, rng):
    return rng.standard_normal(potential.size) / np.sqrt(potential.regularisation)


def test_an_exchanged_energy_takes_its_place_in_a_copy_alone():
    cloth, q, rng = crumpled_cloth(bending=Hysteresis(0.3))
    before, bent = cloth.potential.evaluate(q), cloth.bending
    slid = bent.with_origin(bent.origin_at(q))
    other = cloth.potential.exchanged({bent: slid})
    assert other.pattern is cloth.potential.pattern
    assert other.value(q) - before[0] == pytest.approx(slid.value(q) - bent.value(q), rel=1e-9)
    step = random_step(other, rng)
    full = other.all_unknowns(step)
    change = full @ (forces([slid], q, len(full)) - forces([bent], q, len(full)))
    assert (other.gradient(q) - before[1]) @ step == pytest.approx(change, rel=1e-9)
    assert change != 0.0 and not bent.origin.any()
    again = cloth.potential.evaluate(q)
    assert again[0] == before[0] and (again[1] == before[1]).all()


@pytest.mark.parametrize("case", ["usual", "folded"])
def test_derivatives_are_those_of_steps(case):
    """Away from equilibrium, too: second derivatives along a step, of a state that is no vector."""
    shape = {"size": 9e-3, "turn": 0.0} if case == "folded" else {}
    cloth, q, rng = crumpled_cloth(**shape)
    potential = cloth.potential
    assert is_bent(cloth.bending.angles(q), cloth.bending.pole).any() == (case == "folded")
    step = random_step(potential, rng)
    h = 1e-5 / potential.step_length(step)
    ahead, behind = (potential.moved(q, sign * h * step) for sign in (1, -1))
    slope = potential.gradient(q) @ step
    assert slope == pytest.approx(
        (potential.value(ahead) - potential.value(behind)) / (2 * h), rel=1e-5)
    h *= 30
    ahead, behind = (potential.moved(q, sign * h * step) for sign in (1, -1))
    bend = (potential.value(ahead) - 2 * potential.value(q) + potential.value(behind)) / h**2
    matrix = potential.pattern.symmetric(potential.model(q).hessian())
    assert step @ matrix @ step == pytest.approx(bend, rel=1e-4)


def test_a_rigid_motion_carries_normals_along():
    """Parallel transport: turning cloth in small steps turns its normals with it."""
    cloth, q, _ = crumpled_cloth()
    mesh = cloth.scene.mesh
    vertices, axis = len(mesh.rest), np.array([0.36, 0.48, 0.8])
    start = State.of(q, vertices)
    bending = MidEdgeBending(mesh, np.ones(len(mesh.faces), bool), fabric=cloth.fabric)

    def turned(x, angle):
        return (np.cos(angle) * x + np.sin(angle) * np.cross(axis, x)
                + (1 - np.cos(angle)) * (x @ axis)[:, None] * axis)

    for k in range(1, 101):
        move = turned(start.positions, 0.01 * k) - q[: 3 * vertices].reshape(-1, 3)
        step = np.concatenate([move.ravel(), np.zeros(len(mesh.edges))])
        q = moved(q, mesh.edges, step)
    # A rotation about an edge itself turns the triangles, not the transported normal: what is left
    # of the motion is that turn, at most its angle of one radian.
    ends = start.positions[mesh.edges]
    along = np.diff(ends, axis=1)[:, 0]
    share = np.abs(along @ axis) / np.linalg.norm(along, axis=1)
    missed = np.linalg.norm(State.of(q, vertices).normals - turned(start.normals, 1.0), axis=1)
    assert missed[share < 0.01].max() < 0.02 and missed.max() > 0.5
    still = State(turned(start.positions, 1.0), turned(start.normals, 1.0)).q
    assert bending.value(still) == pytest.approx(bending.value(start.q), rel=1e-10)


def test_no_step_passes_the_limit_of_folds(crumpled):
    cloth, q, _ = crumpled
    mesh, bending = cloth.scene.mesh, cloth.bending
    free = np.flatnonzero(~cloth.scene.held_edges & (mesh.edge_faces[:, 1] >= 0))[0]
    first = np.argwhere(mesh.face_edges[cloth.scene.active] == free)[0]
    sign = np.sign(bending.angles(q)[tuple(first)]) or 1.0
    step = np.zeros(cloth.potential.unknowns)
    results = []
    for angle in np.linspace(0, np.pi / 2, 40):
        step[3 * len(mesh.rest) + free] = angle * sign
        new = moved(q, mesh.edges, step)
        reached = np.abs(bending.angles(new)).max() / (np.pi / 2)
        results.append((reached, bending.allows(q, new)))
    assert all(allowed for reached, allowed in results if reached < LIMIT_START)
    assert not any(allowed for reached, allowed in results if reached > 0.97)


def test_steps_are_judged_by_every_angle_between_triangle_and_normal(crumpled):
    """Angles that end far from their poles are passed over without a look at where they began."""
    cloth, q, rng = crumpled
    bending, allowed = cloth.bending, []
    for size in np.geomspace(0.1, 30.0, 60):
        step = random_step(cloth.potential, rng)
        new = cloth.potential.moved(q, size * step / cloth.potential.step_length(step))
        kept = [keeps_distance(*angles) for angles in zip(
            bending.angles(q).flat, bending.angles(new).flat, bending.pole.flat, strict=True)]
        allowed.append(bending.allows(q, new))
        assert allowed[-1] == all(kept)
    assert any(allowed) and not all(allowed)


def test_triangles_without_a_common_edge_do_not_couple_their_corners(crumpled):
    """Else factors would be larger than they need to be."""
    cloth, _, _ = crumpled
    mesh, potential = cloth.scene.mesh, cloth.potential
    row = potential.all_unknowns(np.arange(1, potential.size + 1)).astype(int)[
        : 3 * len(mesh.rest) : 3] - 1
    matrix = potential.pattern.symmetric(np.ones(len(potential.pattern.indices)))
    coupled = np.argwhere(matrix[row[row >= 0]][:, row[row >= 0]].toarray())
    near = np.zeros((len(mesh.rest),) * 2, dtype=bool)
    for beside in mesh.edge_faces:
        corners = np.unique(mesh.faces[beside[beside >= 0]])
        near[np.ix_(corners, corners)] = True
    free = np.flatnonzero(row >= 0)
    assert near[free[coupled[:, 0]], free[coupled[:, 1]]].all() and len(coupled) > 1000


def test_hessian_does_not_depend_on_what_was_asked_before(crumpled):
    cloth, q, _ = crumpled
    fresh = {c: cloth.potential.model(q).hessian(c) for c in (0.0, 0.3, 0.5, 0.8, 1.0)}
    model = cloth.potential.model(q)
    for convexity in (0.8, 1.0, 0.3, 0.0, 0.5):
        assert np.array_equal(model.hessian(convexity), fresh[convexity])


def test_the_membrane_becomes_convex_before_the_rest():
    cloth, q, _ = crumpled_cloth(edge=0.03)
    potential = cloth.potential
    exact, half, full = (potential.model(q).hessian(c) for c in (0.0, 0.5, 1.0))
    membrane = Cloth(cloth.scene, cloth.fabric).membrane
    rows = potential.all_unknowns(np.arange(1, potential.size + 1)).astype(int) - 1
    change = np.zeros((potential.size + 1,) * 2)  # held unknowns have the last row
    at = rows[membrane.dofs]
    np.add.at(change, (at[:, :, None], at[:, None, :]),
              membrane.hessian(q, True) - membrane.hessian(q))
    dense = [potential.pattern.symmetric(data).toarray() for data in (exact, half, full)]
    assert np.allclose(dense[1] - dense[0], change[:-1, :-1], rtol=1e-9, atol=1e-9)
    assert np.allclose(potential.model(q).hessian(0.25), (exact + half) / 2, rtol=1e-12, atol=1e-12)
    assert np.allclose(potential.model(q).hessian(0.75), (half + full) / 2, rtol=1e-12, atol=1e-12)
    scale = 1 / np.sqrt(potential.regularisation)
    least = [np.linalg.eigvalsh(m * scale * scale[:, None])[0] for m in dense]
    assert least[0] < least[1] < 0 or least[0] < 0 <= least[1]
    assert least[2] > -1e-9


@pytest.mark.parametrize("rig", [Rig(0.2, 0.06, "disc"), Rig(0.4, 0.2, "square")],
                         ids=lambda rig: rig.name)
def test_small_and_large_specimens_are_lowered(rig):
    result = drape(SOFT, rig=rig, edge=10e-3, start="lowered", seed=1)
    assert result.converged, result.message
    assert result.positions[:, 2].min() < -0.2 * (rig.specimen_size - rig.plate_diameter)


@pytest.mark.slow
def test_lowered_discs_have_more_folds_than_discs_from_rings():
    """Their numbers scatter by 0.6 and 1.5."""
    folds = {}
    for start, count in (("lowered", 3), ("ring", 12)):
        drapes = [drape(SOFT, rig=DISC_RIG, edge=6e-3, start=start, seed=seed)
                  for seed in range(count)]
        assert all(one.converged for one in drapes)
        folds[start] = np.mean([fold_count(one.positions, one.rest, DISC_RIG) for one in drapes])
    assert folds["lowered"] > folds["ring"] + 0.5


def test_a_time_step_that_fails_is_a_status():
    class Broken(Gravity):
        """A weight without a value."""

        def value(self, q: np.ndarray) -> float:
            return np.nan

    def law(mesh, active, *, fabric):
        return Broken(mesh, density=fabric.density, gravity=GRAVITY)

    result = drape(SOFT, edge=0.012, laws=Laws(others=(law,)))
    assert result.status is Status.NOT_FINITE and set(result.coarse) == {Status.NOT_FINITE}


LIMP = Fabric(np.full(3, 0.5e-6))
LENGTH = 0.3  # m


def moving(scene: Scene, fabric: Fabric, laws: Laws | None = None) -> tuple[Cloth, Inertia]:
    """The cloth of ``scene`` with its inertia, and that inertia."""
    inertia = Inertia(scene.mesh, density=fabric.density)
    return Cloth(scene, fabric, laws=laws or Laws(), extra=[inertia]), inertia


def test_cloth_without_support_falls_with_the_known_error_of_the_step():
    """Velocities are exact; positions are g t h/2 too low in steps of h, whatever the viscosity."""
    mesh, _ = strip(length=0.06, width=0.03, edge=0.01, clamp=0.0)
    scene = Scene(mesh, np.zeros(len(mesh.rest), dtype=bool))
    cloth, inertia = moving(scene, LIMP)
    motion = Motion.at_rest(scene.state(np.column_stack([mesh.rest, np.zeros(len(mesh.rest))])))
    for _ in range(10):
        motion, _ = motion.advanced(cloth.potential, inertia, 0.02, relaxation=0.05)
    assert motion.time == pytest.approx(0.2)
    fall = GRAVITY * (0.2**2 / 2 + 0.2 * 0.02 / 2)
    assert np.allclose(motion.state.positions[:, 2], -fall, atol=1e-6)
    assert np.allclose(motion.velocities, [0, 0, -GRAVITY * 0.2], atol=1e-5)


@pytest.mark.parametrize("relaxation", [0.01, 0.05])
def test_a_hanging_strip_swings_and_is_damped_as_stated(relaxation):
    """Lowest frequency of a heavy chain: half the first zero of J0, times sqrt(g/L). Amplitudes
    fall by exp(-tau w²/2 t), the viscosity of the stiffness that gravity gives. ``relaxation`` is
    tau in periods."""
    mesh, held = strip(length=LENGTH, width=0.01, edge=0.01, clamp=0.0)
    scene = Scene(mesh, held)
    cloth, inertia = moving(scene, LIMP, Laws(membrane=Corotational(5e3)))
    down, across = mesh.rest.T
    mode = j0(2.4048 * np.sqrt(1 - down / LENGTH))
    motion = Motion.at_rest(scene.state(np.column_stack([2e-3 * mode, across, -down])))
    frequency = 2.4048 / 2 * np.sqrt(GRAVITY / LENGTH)
    period, swing = 2 * np.pi / frequency, []
    for _ in range(220):
        motion, _ = motion.advanced(cloth.potential, inertia, 0.005 * period,
                                    relaxation=relaxation * period)
        swing.append(inertia.masses * mode @ motion.state.positions[:, 0])
    swing = np.array(swing)
    before = np.flatnonzero(np.diff(np.sign(swing)) != 0)
    crossings = before + np.abs(swing[before] / np.diff(swing)[before])
    assert np.diff(crossings) == pytest.approx(100, rel=0.03)
    first, second = np.abs(swing[50:150]).max(), np.abs(swing[150:]).max()
    rate = np.log(first / second) / (period / 2)
    assert rate == pytest.approx(relaxation * period * frequency**2 / 2, rel=0.1)


def test_the_energy_of_falling_cloth_only_decreases():
    specimen = make_specimen(Rig(), edge=0.016)
    mesh: Mesh = specimen.mesh
    scene = Scene(mesh, specimen.held, Rig().obstacles)
    cloth, inertia = moving(scene, Fabric(np.full(3, 30e-6)))
    bumps = np.random.default_rng(0).normal(0, 1e-4, len(mesh.rest)) * ~specimen.held
    motion = Motion.at_rest(scene.state(np.column_stack([mesh.rest, bumps])))
    energies = []
    for _ in range(30):
        q = motion.state.q
        kinetic = 0.5 * inertia.masses @ (motion.velocities**2).sum(axis=1)
        energies.append(kinetic + cloth.potential.value(q) - inertia.value(q))
        motion, _ = motion.advanced(cloth.potential, inertia, 0.01, relaxation=0.02)
    assert motion.state.positions[:, 2].min() < -0.05
    assert (np.diff(energies) < 0).all()


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
def batched(request):
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
                                   uneven=Uneven(10.0, 0.02, 3, hem_layers=5e-3), skew=0.4,
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


def test_energies_and_gradients_are_those_of_one_cloth(batched):
    cloths, states, batch, now = batched
    value = batch.evaluate(*now)
    bending = cloths[2].bending
    assert "origin" in batch.tensors or is_bent(bending.angles(states[2]), bending.pole).any()
    for k, (cloth, q) in enumerate(zip(cloths, states, strict=True)):
        assert "origin" not in batch.tensors or cloth.obstacles[0].value(q) > 0
        energy, gradient = cloth.potential.evaluate(q)
        assert float(value.energy[k]) == pytest.approx(energy, rel=1e-12)
        assert np.abs(value.gradient[:, k].numpy() - gradient).max() < 1e-12 * np.abs(
            gradient).max()


def test_each_has_the_hessian_of_its_convexity(batched):
    cloths, states, batch, now = batched
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


def test_solutions_are_those_of_a_sparse_solver_and_indefinite_matrices_are_named(batched):
    cloths, states, batch, _ = batched
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


@pytest.mark.parametrize("batched", ["real"], indirect=True)
def test_origins_slide_as_those_of_one_cloth(batched):
    cloths, states, batch, now = batched
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
    laws = Laws(Hysteresis(0.15, curvature=(4.0, -3.0, 0.0), uneven=Uneven(8.0, 0.02), skew=0.3),
                OrthotropicStVK(warp=900.0, weft=500.0, shear=100.0))
    plans = [PLAN | {"rig": Rig((0.3 + size,) * 2, 0.18, "disc", rim=2e-3), "laws": laws,
                     "seed": 3} for size in (1e-3, -1e-3)]
    for made, plan in zip(drape_batch(plans, device="cpu"), plans, strict=True):
        one = drape(**plan)
        assert made.converged and made.rig == plan["rig"] and one.converged
        assert np.abs(made.positions - one.positions).max() < 1e-6
        origin, expected = (drape.laws.bending.origin for drape in (made, one))
        assert np.abs(origin - expected).max() < 1e-4 * np.abs(expected).max()
