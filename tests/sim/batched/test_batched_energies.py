"""The batched energies against those of single cloths, and against automatic derivatives."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from torch.autograd import forward_ad

from common.errors import InputError
from sim.batched.energies import batch_energies, midedge
from sim.batched.energies.contact import BatchedContact
from sim.batched.energies.edge_frames import BatchedEdgeFrames
from sim.drape import drape
from sim.energies.contact import Cylinder, ObstacleContact, Ramp
from sim.energies.fold_limit import LIMIT_START
from sim.equilibrium import cloth_terms
from sim.initial import initial_positions
from sim.laws import Laws
from sim.material import MICRO, Fabric
from sim.scene import Rig, Scene, State
from sim.specimens import make_specimen

NAMES = ["membrane", "mid-edge", "fold limit", "gravity", "contact of vertices",
         "contact of edges"]
STIFF = Fabric(alpha=np.array([120.0, 90.0, 60.0]) * MICRO)
SOFTENING = Fabric(alpha=[98.8e-6, 23.5e-6, 21.2e-6], beta=[-247e-9, -58.8e-9, -53e-9])
STIFFENING = Fabric(alpha=[20e-6, 30e-6, 10e-6], beta=[40e-9, 10e-9, 5e-9])
UNEVEN = Fabric(alpha=np.array([12.0, 9.0, 4.0]) * MICRO, beta=np.array([-3e-7, -2e-8, 0.0]))
FLAT, CONVERGED, CRUMPLED, TOUCHING = range(4)
SAMPLES = ["flat", "converged", "crumpled", "touching"]


@dataclass(frozen=True)
class Batch:
    """Cloths of different fabrics, triangulations and states: alone, and together.

    Attributes:
        single: energies by cloth, then in the order of NAMES; together: the same at once.
        states: the unknowns of each cloth; q: as one tensor, shorter rows filled with zeros.
        free: which of q no rig holds.
    """

    single: list[list]
    together: list
    states: list[np.ndarray]
    q: torch.Tensor
    free: torch.Tensor

    def pair(self, name: str) -> tuple[list, object]:
        k = NAMES.index(name)
        return [energies[k] for energies in self.single], self.together[k]


@pytest.fixture(scope="module")
def batch() -> Batch:
    rig, rng = Rig(), np.random.default_rng(5)
    settings = [
        (STIFF, {"resolution": 13, "mesh": "structured"}),
        (SOFTENING, {"resolution": 14, "seed": 1, "offset": (4e-3, -2e-3)}),
        (UNEVEN, {"resolution": 13, "seed": 2}),
        (STIFFENING, {"resolution": 12, "seed": 3}),
    ]
    single, states, free = [], [], []
    for sample, (fabric, setting) in enumerate(settings):
        specimen = make_specimen(rig, **{"mesh": "perturbed", "jitter": 0.15, **setting})
        mesh, held = specimen.mesh, specimen.held
        rotations = np.zeros(len(mesh.edges))
        if sample == FLAT:
            positions = rig.place(mesh.rest)
        elif sample == CONVERGED:
            result = drape(fabric, start="fold", **setting)
            assert result.converged
            positions, rotations = result.positions, result.rotations
        else:
            positions = initial_positions(mesh.rest, rig=rig, start="fold", rng=rng)
            noise = 9e-3 if sample == CRUMPLED else 1e-3
            positions += rng.normal(0.0, noise, positions.shape) * ~held[:, None]
            rotations = rng.normal(0.0, 0.3, len(mesh.edges))
        if sample == TOUCHING:  # squeezed into the cylinder from above and from the side
            positions[:, 2] -= 2e-3
            radius = np.linalg.norm(positions[:, :2], axis=1, keepdims=True)
            hanging = positions[:, 2:] < -0.02
            positions[:, :2] *= rig.plate_radius * np.where(hanging, 0.99, 0.6) / radius
        state = State(positions, rotations)
        scene = Scene(mesh=mesh, held=held, obstacles=rig.obstacles)
        terms = cloth_terms(scene, fabric, state)
        single.append([energy for stage in terms.stages for energy in stage])
        states.append(np.concatenate([positions.ravel(), rotations]))
        free.append(np.concatenate([np.repeat(~held, 3), np.ones(len(rotations), dtype=bool)]))
    q = torch.zeros(len(states), max(map(len, states)), dtype=torch.float64)
    for row, state in zip(q, states, strict=True):
        row[: len(state)] = torch.from_numpy(state)
    mask = torch.zeros(q.shape, dtype=torch.bool)
    for row, own in zip(mask, free, strict=True):
        row[: len(own)] = torch.from_numpy(own)
    return Batch(single, batch_energies(single), states, q, mask)


def close(found: torch.Tensor, expected: np.ndarray, size: float) -> bool:
    return bool(np.abs(found.numpy() - expected).max(initial=0.0) <= 1e-12 * size)


def test_the_states_ask_everything_of_the_energies(batch):
    """What the comparisons below would be worth little without."""
    angles = [np.abs(e.angles(q)).max() for e, q in zip(batch.pair("fold limit")[0], batch.states,
                                                        strict=True)]
    assert angles[CRUMPLED] > LIMIT_START + 0.1 and angles[FLAT] == 0.0
    counts = {name: [len(e.dofs) for e in batch.pair(name)[0]] for name in NAMES}
    assert all(len(set(n)) > 1 for n in counts.values())  # some are filled up
    (vertices, _), (middles, _) = (batch.pair(name) for name in NAMES[-2:])
    for energy in (vertices[TOUCHING], middles[TOUCHING]):
        force = energy.gradient(batch.states[TOUCHING])[:, :3]
        sideways = np.abs(force[:, 2]) < np.hypot(force[:, 0], force[:, 1])
        assert (force[:, 2] < 0).any() and sideways.any()
    assert middles[CONVERGED].value(batch.states[CONVERGED]) > 0


@pytest.mark.parametrize("name", NAMES)
def test_as_the_energies_of_single_cloths(batch, name):
    single, together = batch.pair(name)
    value, gradient = together.value(batch.q), together.gradient(batch.q)
    hessians = {c: together.hessian(batch.q, c) for c in (0.0, 1.0)}
    for k, (energy, q) in enumerate(zip(single, batch.states, strict=True)):
        count = len(energy.dofs)
        assert np.array_equal(together.dofs[k, :count], energy.dofs)
        assert (together.dofs[k, count:] == -1).all() and not gradient[k, count:].any()
        expected = energy.gradient(q)
        # Flat cloth has no forces but those of rounded coordinates.
        force = 1.0 if k == FLAT else np.abs(expected).max()
        assert close(gradient[k, :count], expected, force)
        assert close(value[k], energy.value(q), 1e-3 if k == FLAT else abs(energy.value(q)))
        for convexity, hessian in hessians.items():
            # In the frames of the edges, where there are any.
            expected = getattr(energy, "framed_hessian", energy.hessian)(q, convexity)
            if hessian is None:
                assert expected is None or not expected.any()
                continue
            assert not hessian[k, count:].any()
            if expected is None:
                assert not hessian[k].any()
            else:
                assert close(hessian[k, :count], expected, np.abs(expected).max())


def test_no_hessian_where_no_hinge_is_bent(batch):
    _, together = batch.pair("fold limit")
    some = torch.tensor([FLAT])
    assert together.hessian(batch.q, 0.0) is not None
    assert together.take(some).hessian(batch.q[some], 0.0) is None


@pytest.mark.parametrize("name", NAMES)
def test_derivatives_are_those_of_the_value(batch, name):
    """By forward differentiation of value and gradient, without the energies of single cloths."""
    _, together = batch.pair(name)
    # Where a triangle is unstretched its stretches are equal, which automatic rules cannot do.
    some = torch.tensor([CONVERGED, CRUMPLED, TOUCHING])
    energy, q = together.take(some), batch.q[some]
    direction = torch.from_numpy(np.random.default_rng(4).standard_normal(q.shape))
    if name == "mid-edge":
        direction *= batch.free[some]  # blocks in frames know nothing of what is held
    with forward_ad.dual_level():
        dual = forward_ad.make_dual(q, direction)
        slope = forward_ad.unpack_dual(energy.value(dual)).tangent
        bend = forward_ad.unpack_dual(energy.gradient(dual)).tangent
    dofs = energy.dofs
    local = torch.where(dofs >= 0, direction.gather(1, dofs.clamp(min=0).flatten(1))
                        .view(dofs.shape), 0.0)
    parts = energy.gradient(q) * local
    assert ((parts.sum((1, 2)) - slope).abs() <= 1e-12 * parts.abs().sum((1, 2))).all()
    hessian = energy.hessian(q, 0.0)
    if name == "gravity":
        assert hessian is None and bend is None
        return
    if name == "mid-edge":  # blocks are those of the frames, where only their sum is known
        frames = BatchedEdgeFrames.stack(
            [batch.pair(name)[0][k].frames for k in some.tolist()])
        found, expected = framed_product(energy, frames, q, direction, hessian, bend)
        difference = (found - expected).abs() * batch.free[some]
        assert (difference.amax(1) < 1e-11 * expected.abs().amax(1)).all()
        return
    turned = (hessian @ local[..., None])[..., 0]
    assert turned.any()
    size = bend.abs().amax((1, 2), keepdim=True)
    assert ((turned - bend).abs() <= 1e-11 * size).all()


def framed_product(energy, frames, q, direction, hessian, bend) -> tuple[torch.Tensor, ...]:
    """(B, Q) product of the blocks' sum, in frames, and a direction; the same from ``bend``, the
    change of the elements' gradients."""
    nowhere = q.shape[1]

    def summed(dofs, parts):
        place = torch.where(dofs >= 0, dofs, nowhere).flatten(1)
        return torch.zeros(len(q), nowhere + 1).double().scatter_add(1, place, parts.flatten(1))

    def taken(values, dofs):
        place = torch.where(dofs >= 0, dofs, nowhere).flatten(1)
        return torch.nn.functional.pad(values, (0, 1)).gather(1, place).view(dofs.shape)

    # dxi = dzeta - L dx; forces by x and zeta from those by x and xi
    levers, corners, rotations = frames.levers(q), frames.entries, frames.rotations
    turn = (levers * taken(direction, corners)).sum(1)
    inside = direction - summed(rotations, turn)[:, :-1]
    local = taken(inside, energy.coupled)
    force = summed(energy.coupled, (hessian @ local[..., None])[..., 0])[:, :-1]
    force = force - summed(corners, levers * taken(force, rotations)[:, None])[:, :-1]
    return force, summed(energy.dofs, bend)[:, :-1]


@pytest.mark.parametrize("name", ["membrane", "mid-edge", "fold limit", "contact of edges"])
def test_the_convex_hessian_is_convex(batch, name):
    _, together = batch.pair(name)
    exact, convex = (torch.linalg.eigvalsh(together.hessian(batch.q, c))[CRUMPLED:]
                     for c in (0.0, 1.0))
    size = convex.amax()
    assert exact.amin() < -1e-6 * size < -1e-12 * size < convex.amin()


def test_eigenvalues_in_several_portions(batch, monkeypatch):
    """Many tangents lie below the floor; each is raised to it once."""
    _, together = batch.pair("mid-edge")
    whole = together.hessian(batch.q, 1.0)
    sizes, eigh = [], torch.linalg.eigh

    def counted(matrices: torch.Tensor):
        sizes.append(len(matrices))
        return eigh(matrices)

    monkeypatch.setattr(torch.linalg, "eigh", counted)
    monkeypatch.setattr(midedge, "_MOST", 7)
    assert torch.allclose(together.hessian(batch.q, 1.0), whole, rtol=1e-13, atol=0.0)
    assert len(sizes) > 2 and max(sizes) == 7


@pytest.mark.parametrize("name", NAMES)
def test_some_of_the_samples(batch, name):
    _, together = batch.pair(name)
    index = torch.tensor([CRUMPLED, FLAT])
    part, q = together.take(index), batch.q[index]
    assert torch.equal(part.dofs, together.dofs[index])
    assert part.value(q).allclose(together.value(batch.q)[index], rtol=1e-14, atol=0.0)
    assert part.gradient(q).allclose(together.gradient(batch.q)[index], rtol=1e-12, atol=1e-18)
    assert torch.equal(part.allows(q, 1.1 * q), together.allows(batch.q, 1.1 * batch.q)[index])
    for convexity in (0.0, 1.0):
        whole, own = together.hessian(batch.q, convexity), part.hessian(q, convexity)
        assert (whole is None) == (own is None)
        assert whole is None or own.allclose(whole[index], rtol=1e-12, atol=1e-18)


@pytest.mark.parametrize("bad", [torch.nan, torch.inf])
@pytest.mark.parametrize("name", NAMES)
def test_numbers_that_are_not_finite_stay_in_their_sample(batch, name, bad):
    _, together = batch.pair(name)
    q = batch.q.clone()
    q[CONVERGED] = bad
    others = [FLAT, CRUMPLED, TOUCHING]
    results = [
        [function(state) for function in (
            together.value, together.gradient, lambda x: together.allows(batch.q, x),
            lambda x: together.hessian(x, 0.0), lambda x: together.hessian(x, 1.0))]
        for state in (q, batch.q)
    ]
    for spoilt, sound in zip(*results, strict=True):
        assert (spoilt is None) == (sound is None)
        assert sound is None or torch.equal(spoilt[others], sound[others])
    if "contact" not in name:  # nothing that is not a number touches anything
        assert not torch.isfinite(results[0][0][CONVERGED])


@pytest.mark.parametrize("name", NAMES)
def test_steps_are_allowed_as_for_single_cloths(batch, name):
    """Steps of several lengths: all are allowed, none, or those of some samples."""
    single, together = batch.pair(name)
    move = torch.from_numpy(np.random.default_rng(6).standard_normal(batch.q.shape))
    verdicts = []
    for length in (1e-7, 1e-3, 1e-2, 3e-2):
        allowed = together.allows(batch.q, batch.q + length * move)
        for k, (energy, q) in enumerate(zip(single, batch.states, strict=True)):
            assert bool(allowed[k]) == energy.allows(q, q + length * move[k, : len(q)].numpy())
        verdicts.append(int(allowed.sum()))
    if name == "fold limit":
        assert verdicts[0] == len(SAMPLES) and verdicts[-1] == 0 and len(set(verdicts)) > 2
    else:
        assert verdicts == [len(SAMPLES)] * 4


def test_samples_need_the_same_terms(batch):
    first, second = batch.single[:2]
    with pytest.raises(InputError, match="same kinds"):
        batch_energies([first, second[:-1]])
    with pytest.raises(InputError, match="same kinds"):
        batch_energies([first, second[::-1]])
    with pytest.raises(InputError, match="same kinds"):
        batch_energies([])


def test_terms_without_a_twin_are_named():
    rig = Rig()
    specimen = make_specimen(rig, mesh="structured", resolution=9)
    mesh = specimen.mesh
    terms = cloth_terms(Scene(mesh=mesh, held=specimen.held, obstacles=rig.obstacles), STIFF,
                        State.at(mesh, rig.place(mesh.rest)), laws=Laws(bending="hinge"))
    with pytest.raises(InputError, match="cannot be evaluated in a batch"):
        batch_energies([[energy for stage in terms.stages for energy in stage]])


def test_contact_knows_cylinders_and_one_kind_of_points():
    def contact(obstacle: object, vertices: int) -> ObstacleContact:
        return ObstacleContact(np.arange(2 * vertices).reshape(2, vertices), np.ones(2),
                               obstacle=obstacle, pressure=1.0)

    with pytest.raises(InputError, match="cylinders only"):
        BatchedContact.stack([contact(Cylinder(0.09), 1), contact(Ramp(0.7), 1)])
    with pytest.raises(InputError, match="as many vertices"):
        BatchedContact.stack([contact(Cylinder(0.09), 1), contact(Cylinder(0.09), 2)])
