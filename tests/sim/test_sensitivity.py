"""Derivatives of equilibria: against beam theory, finite differences and each other."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from sim.cantilever.elastica import elastica
from sim.cloth import Cloth, Laws
from sim.draping import FINE_OPTIONS, Drape, drape, follow
from sim.energies.base import Energy
from sim.energies.bending_variants import Hysteresis
from sim.energies.midedge import MidEdgeBending
from sim.equilibrium import find_equilibrium
from sim.material import REFERENCE_DENSITY, Fabric
from sim.mesh import strip
from sim.rig import GRAVITY
from sim.scene import Scene
from sim.sensitivity import PARAMETERS, Tangent, sensitivities
from sim.sensitivity.adjoint import adjoint_gradients, equilibria
from sim.sensitivity.forward import tangent_sensitivities
from sim.sensitivity.rest_shape import moves_with_rest
from sim.solver.newton import NewtonOptions, Status

TIGHT = NewtonOptions(residual=1e-9, step=1e-7)
MODULI = ("log_alpha", "ratio")
FABRIC = Fabric([60e-6, 25e-6, 30e-6], [-150e-9, -50e-9, -80e-9], density=0.15)
LENGTH = 0.06


@pytest.fixture(scope="module")
def draped() -> Drape:
    """A drape of cloth that is anisotropic, softens and has another density."""
    result = drape(FABRIC, edge=0.012, options=TIGHT)
    assert result.converged
    return result


@pytest.fixture(scope="module")
def weights(draped) -> torch.Tensor:
    """Random ones of its positions."""
    return torch.from_numpy(np.random.default_rng(0).standard_normal(draped.positions.shape))


def gap(found: np.ndarray, ends: list[np.ndarray], step: float) -> float:
    """Relative error of a derivative against the difference of positions ``step`` apart."""
    difference = (ends[0] - ends[1]) / step
    return float(np.linalg.norm(found - difference) / np.linalg.norm(difference))


def hanging_strip(gamma: float) -> Tangent:
    """A cantilever of isotropic cloth with rho g L³/alpha = gamma."""
    mesh, held = strip(length=LENGTH, width=0.012, edge=0.003, clamp=0.003)
    alpha = REFERENCE_DENSITY * GRAVITY * LENGTH**3 / gamma
    scene = Scene(mesh=mesh, held=held)
    flat = np.column_stack([mesh.rest, np.zeros(len(mesh.rest))])
    fabric = Fabric(np.full(3, alpha))
    found = find_equilibrium(scene, fabric, scene.state(flat), options=TIGHT)
    assert found.converged
    return Tangent(found.cloth, found.state.q, found.outcome.factor)


def by_stiffness(tangent: Tangent) -> np.ndarray:
    """(V, 3) derivative by the logarithm of all bending moduli together."""
    moves = tangent_sensitivities(tangent, tangent.cloth.fabric, ("log_alpha",))
    assert moves.ok
    return moves.positions.sum(axis=0)


def test_small_deflections_are_inversely_proportional_to_the_stiffness():
    tangent = hanging_strip(gamma=1e-3)
    drop = -tangent.positions[:, 2]
    tip = tangent.cloth.scene.mesh.rest[:, 0] > LENGTH - 1e-6
    assert drop[tip] == pytest.approx(LENGTH * 1e-3 / 8, rel=0.01)  # rho g L⁴/(8 alpha)
    assert by_stiffness(tangent)[:, 2] == pytest.approx(drop, abs=1e-5 * drop.max())
    heavier = tangent_sensitivities(tangent, tangent.cloth.fabric, ("density",)).positions[0]
    assert heavier[:, 2] * REFERENCE_DENSITY == pytest.approx(-drop, abs=1e-5 * drop.max())


@pytest.mark.parametrize("gamma", [3.0, 30.0])
def test_a_cantilever_changes_as_the_elastica_does(gamma):
    """The tip's reach and drop: d/d log alpha = -d/d log gamma of the boundary-value problem."""
    tangent = hanging_strip(gamma)
    tip = tangent.cloth.scene.mesh.rest[:, 0] > LENGTH - 1e-6
    step = 1e-3
    below, above = (LENGTH * elastica(gamma * np.exp(s))[-1] for s in (-step, step))
    expected = (below - above) / (2 * step)
    found = by_stiffness(tangent)[tip][:, [0, 2]].mean(axis=0) * [1, -1]
    assert found == pytest.approx(expected, rel=0.01)


def test_moduli_against_finite_differences_of_converged_drapes(draped):
    exact = sensitivities(draped, parameters=MODULI)
    alpha, ratio = np.log(FABRIC.alpha), FABRIC.beta / FABRIC.alpha
    for k, name in enumerate(exact.names):
        ends = []
        step = 1e-5 if k < 3 else 1e-7
        for sign in (1, -1):
            theta = np.concatenate([alpha, ratio])
            theta[k] += sign * step
            moduli = np.exp(theta[:3])
            fabric = Fabric(moduli, theta[3:] * moduli, FABRIC.density)
            end = follow(draped, fabric, options=TIGHT)
            assert end.converged
            ends.append(end.positions)
        assert gap(exact.positions[k], ends, 2 * step) < 1e-5, name


def test_a_common_factor_of_moduli_stiffness_and_density_changes_nothing(draped):
    moves = sensitivities(draped, parameters=PARAMETERS)
    one = dict(zip(moves.names, moves.positions, strict=True))
    directions = ("warp", "bias", "weft")
    by_alpha = sum(one[f"log_alpha_{d}"] for d in directions)
    by_moduli = sum(FABRIC.alpha[k] * one[f"alpha_{d}"] + FABRIC.beta[k] * one[f"beta_{d}"]
                    for k, d in enumerate(directions))
    by_density = FABRIC.density * one["density"]
    assert np.allclose(by_moduli, by_alpha, atol=1e-12)
    size = np.abs(by_density).max()
    assert size > 1e-3  # m: there is something to cancel
    assert np.abs(by_alpha + one["membrane"] + by_density).max() < 1e-7 * size


def test_equilibria_against_finite_differences(draped, weights):
    """Through PyTorch: a batch of two, all four inputs, one direction through each."""
    starts = [draped, draped]
    inputs = {
        "alpha": torch.tensor(np.stack([FABRIC.alpha, 1.02 * FABRIC.alpha])),
        "beta": torch.tensor(np.stack([FABRIC.beta, FABRIC.beta])),
        "density": torch.tensor([0.15, 0.15], dtype=torch.float64),
        "membrane": torch.tensor([100.0, 100.0], dtype=torch.float64),
    }
    steps = {"alpha": 3e-9, "beta": 3e-11, "density": 1e-5, "membrane": 1e-2}

    def weighed(**changed: torch.Tensor) -> torch.Tensor:
        found = equilibria(starts, options=TIGHT, **(inputs | changed))
        assert found.ok == [True, True]
        return sum(((k + 1) * weights * x).sum() for k, x in enumerate(found.positions))

    for value in inputs.values():
        value.requires_grad_()
    weighed().backward()
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for name, value in inputs.items():
            direction = torch.randn(value.shape, dtype=torch.float64, generator=generator)
            move = steps[name] * direction
            difference = (weighed(**{name: value + move}) - weighed(**{name: value - move})) / 2
            assert float((value.grad * move).sum()) == pytest.approx(float(difference), rel=1e-4)


def test_a_failure_affects_its_own_sample_only(draped):
    far = draped.at(draped.positions * [1, 1, 0.9])  # too far for four steps
    alpha = torch.tensor(np.stack([FABRIC.alpha, FABRIC.alpha]), requires_grad=True)
    beta = torch.tensor(np.stack([FABRIC.beta, FABRIC.beta]), requires_grad=True)
    found = equilibria([far, draped], alpha=alpha, beta=beta, density=0.15, membrane=100.0,
                       options=replace(FINE_OPTIONS, max_iterations=4))
    assert found.ok == [False, True]
    assert [r.status for r in found.results] == [Status.MAX_ITERATIONS, Status.CONVERGED]
    assert "no equilibrium" in found.messages[0]
    sum(positions.sum() for positions in found.positions).backward()
    for gradient in (alpha.grad, beta.grad):
        assert gradient[0].isnan().all() and gradient[1].isfinite().all()
    moves = sensitivities(found.results[0])
    assert not moves.ok and np.isnan(moves.positions).all() and moves.message


def test_free_motions_are_reported():
    """A flag turns about its pole."""
    mesh, _ = strip(length=LENGTH, width=0.012, edge=0.006, clamp=0.006)
    x, y = mesh.rest.T
    flag = np.column_stack([y, np.zeros(len(x)), -x])
    fabric = Fabric(np.full(3, 50e-6))
    scene = Scene(mesh=mesh, held=y == 0.0)
    tangent = Tangent(Cloth(scene, fabric), scene.state(flag).q)
    assert not tangent.ok and ("singular" in tangent.message or "definite" in tangent.message)
    moves = tangent_sensitivities(tangent, fabric, MODULI)
    assert not moves.ok and moves.message == tangent.message and np.isnan(moves.positions).all()
    assert all(np.isnan(pull).all()
               for pull in adjoint_gradients(tangent, fabric, flag, membrane=200.0))


def test_a_column_beyond_its_buckling_load_is_no_minimum():
    mesh, held = strip(length=LENGTH, width=0.012, edge=0.003, clamp=0.003)
    x, y = mesh.rest.T
    scene = Scene(mesh=mesh, held=held)
    upright = scene.state(np.column_stack([np.zeros(len(x)), y, x]))
    critical = REFERENCE_DENSITY * GRAVITY * LENGTH**3 / 7.837  # Greenhill's column
    stands, falls, nearly = (
        Tangent(Cloth(scene, Fabric(np.full(3, share * critical))), upright.q)
        for share in (1.3, 0.7, 1.03))
    assert stands.ok
    assert not falls.ok and "not positive definite" in falls.message
    # Towards the fold, where the column begins to lean, the softest motion loses its stiffness.
    assert 0 < nearly.softest < 0.3 * stands.softest


def test_shapes_that_are_not_equilibria_have_no_derivatives(draped, weights):
    lifted = draped.at(draped.positions + 1e-3 * weights.numpy())
    assert not sensitivities(lifted).ok
    assert not Tangent(lifted.cloth, lifted.state.q).ok


def test_following_finds_the_equilibrium_of_the_new_moduli(draped):
    moves = sensitivities(draped)
    fabric = Fabric(FABRIC.alpha * [1.1, 0.95, 1.05], FABRIC.beta, FABRIC.density)
    start = moves.prediction(draped, fabric, laws=draped.laws)
    plain, led = (follow(draped, fabric, options=TIGHT, start=s) for s in (None, start))
    assert plain.converged and led.converged and led.fabric is fabric
    assert led.positions == pytest.approx(plain.positions, abs=1e-9)
    assert np.abs(led.positions - draped.positions).max() > 1e-4
    # A step of the prediction's length has an error of the square of the change.
    close = Fabric(FABRIC.alpha * 1.001, FABRIC.beta * 1.001, FABRIC.density)
    predicted = draped.positions + 1e-3 * moves.positions[:3].sum(axis=0)
    exact = follow(draped, close, options=TIGHT).positions
    error, size = (np.abs(exact - x).max() for x in (predicted, draped.positions))
    assert error < 0.02 * size


def averaged(mesh, active, *, fabric):
    """The plate of an isotropic fabric with the mean moduli."""
    return MidEdgeBending(mesh, active, fabric=Fabric(np.full(3, fabric.alpha.mean()),
                                                      np.full(3, fabric.beta.mean())))


@pytest.mark.parametrize("bending", [Hysteresis(curvature=(20.0, 0.0, 0.0)), averaged])
def test_what_a_law_makes_of_the_moduli_itself_counts(bending):
    """As the torque of a natural curvature, or moduli that are means of the fabric's."""
    laws = Laws(bending=bending)
    fabric = Fabric([80e-6, 40e-6, 50e-6], [-80e-9, -40e-9, -50e-9])
    result = drape(fabric, edge=0.016, start="sine", laws=laws, options=TIGHT)
    moves = sensitivities(result, parameters=("log_alpha",))
    # Of the warp, beta/alpha kept. The drape of the hysteretic law has several minima; in the
    # softest the error of a difference over 1e-3 is 0.4 %, over 1e-4 a hundredth of that.
    factors = np.array([np.exp(1e-4), 1.0, 1.0])
    ends = [follow(result, Fabric(fabric.alpha * f, fabric.beta * f), laws=laws,
                   options=TIGHT).positions for f in (factors, 1 / factors)]
    assert gap(moves.positions[0], ends, 2e-4) < 1e-3


class Draught(Energy):
    """A force along x of 0.2 N/m² times the square of the stiffest alpha in 60 µN·m."""

    def __init__(self, mesh, active, *, fabric):
        self.dofs = 3 * np.arange(len(mesh.rest))[:, None]
        self.forces = -0.2 * (fabric.alpha.max() / 60e-6) ** 2 * mesh.vertex_areas

    def value(self, q):
        return float(self.forces @ q[self.dofs[:, 0]])

    def gradient(self, q):
        return self.forces[:, None]

    def hessian(self, q, convex=False):
        return None


def test_energies_beside_the_laws_count_in_all_derivatives(draped, weights):
    """One that depends on the moduli, through PyTorch and against differences."""
    laws = Laws(others=(Draught,))
    start = follow(draped, FABRIC, laws=laws, options=TIGHT)
    assert start.converged and np.abs(start.positions - draped.positions).max() > 1e-3

    def weighed(alpha: torch.Tensor, density: torch.Tensor) -> torch.Tensor:
        found = equilibria([start], alpha=alpha, beta=torch.tensor(FABRIC.beta)[None],
                           density=density, membrane=100.0, others=laws.others, options=TIGHT)
        assert found.ok == [True], found.messages
        return (weights * found.positions[0]).sum()

    alpha = torch.tensor(FABRIC.alpha[None], requires_grad=True)
    density = torch.tensor(FABRIC.density, dtype=torch.float64, requires_grad=True)
    weighed(alpha, density).backward()
    with torch.no_grad():
        for value, other, step in (
            (alpha.grad[0, 0], (torch.tensor([[1e-9, 0.0, 0.0]]), 0.0), 1e-9),
            (density.grad, (0.0, 1e-6), 1e-6),
        ):
            ends = [weighed(alpha + s * other[0], density + s * other[1]) for s in (1, -1)]
            assert float(value) == pytest.approx(float(ends[0] - ends[1]) / (2 * step), rel=1e-3)


def test_equilibria_have_density_inextensibility_and_laws_of_their_starts(draped):
    start = follow(draped, FABRIC, laws=Laws(others=(Draught,)), options=TIGHT)
    for near in (draped, start):
        found = equilibria([near], alpha=torch.tensor(FABRIC.alpha)[None],
                           beta=torch.tensor(FABRIC.beta)[None], options=TIGHT)
        assert found.results[0].fabric.density == FABRIC.density != REFERENCE_DENSITY
        assert np.abs(found.positions[0].numpy() - near.positions).max() < 1e-7


def test_one_fabric_may_be_that_of_all_starts_in_an_array_or_a_tensor(draped):
    arrays = equilibria([draped] * 2, alpha=FABRIC.alpha, beta=FABRIC.beta, options=TIGHT)
    tensor = equilibria([draped], alpha=torch.tensor(FABRIC.alpha), beta=torch.tensor(FABRIC.beta),
                        options=TIGHT)
    assert all(torch.equal(each, tensor.positions[0]) for each in arrays.positions)


@pytest.mark.slow
def test_cloth_that_meets_itself():
    alpha = np.array([2e-6, 2.2e-6, 1.8e-6])
    # Which meshes and starts lead to a drape that touches itself depends on rounding.
    results = (drape(Fabric(alpha, -2e-3 * alpha), edge=0.006, seed=seed, start="fold")
               for seed in range(8))
    result = next(one for one in results if one.converged and one.touches)
    moves = sensitivities(result, parameters=("log_alpha",))
    assert moves.ok
    x, y = result.rest.T
    shear = np.column_stack([0.1 * y * np.sin(20 * x + 10 * y), 0.1 * x * np.cos(30 * y)])
    by_rest = moves_with_rest(Tangent.of(result), shear[None])[0]
    ends = [follow(result.on(result.mesh.with_rest(result.rest + s * shear)), result.fabric,
                   options=TIGHT).positions for s in (1e-5, -1e-5)]
    assert gap(by_rest, ends, 2e-5) < 1e-3
    near = [follow(result, Fabric(moduli, -2e-3 * moduli), options=TIGHT)
            for moduli in (alpha * np.exp([step, 0, 0]) for step in (1e-4, -1e-4))]
    assert all(one.converged and one.touches for one in near)
    assert gap(moves.positions[0], [one.positions for one in near], 2e-4) < 1e-3
