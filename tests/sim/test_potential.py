"""Potentials, lowering, and the reference drape."""

import numpy as np
import pytest
from scipy.special import j0

from sim.cloth import Cloth, Laws
from sim.draping import drape
from sim.energies.bending_variants import Hysteresis
from sim.energies.external import Gravity
from sim.energies.fold_barrier import LIMIT_START, is_bent, keeps_distance
from sim.energies.membrane import Corotational
from sim.energies.midedge import MidEdgeBending
from sim.material import Fabric
from sim.measures import fold_count
from sim.mesh import Mesh, strip
from sim.rig import DISC_RIG, GRAVITY, Rig
from sim.scene import Scene, make_specimen
from sim.solver.dynamics import Inertia, Motion
from sim.solver.newton import Status
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
