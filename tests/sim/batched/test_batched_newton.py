"""The minimisation of many functions at once, against the one of single functions."""

import numpy as np
import pytest
import torch
from sparse_batches import SparseSolver

from sim.batched.newton import minimise_batch
from sim.batched.solvers import FrontalSolver
from sim.linear import SparsePattern
from sim.linear.multifrontal import analyse
from sim.newton import NewtonOptions, Status, minimise

N = 12
CHAIN = SparsePattern([np.stack([np.arange(N - 1), np.arange(1, N)], axis=1)], N)
TIGHT = NewtonOptions(residual=1e-11, step=1e-9, max_iterations=300)


class Chains:
    """Rosenbrock's function along a chain, steep (B,), over 2: a double well where flat (B,).

    E = sum_i (1 - w) [steep (y_i+1 - y_i²)² + (1 - y_i)²] + w [(y_i² - 1)²/4 + y_N²...], and not a
    number beyond |y| = ``wall``; steps of more than ``reach`` are not allowed.
    """

    def __init__(self, steep, well, wall=None, reach=None):
        self.steep, self.well = (torch.as_tensor(v, dtype=torch.float64) for v in (steep, well))
        self.wall = torch.full_like(self.steep, torch.inf) if wall is None else wall
        self.reach = torch.full_like(self.steep, torch.inf) if reach is None else reach
        self.regularisation = torch.ones(len(self.steep), N, dtype=torch.float64)

    def take(self, index):
        return Chains(*(v[index] for v in (self.steep, self.well, self.wall, self.reach)))

    def value(self, y):
        a, b = y[:, :-1], y[:, 1:]
        chain = (self.steep[:, None] * (b - a**2) ** 2 + (1 - a) ** 2).sum(1)
        well = ((y**2 - 1) ** 2 / 4).sum(1)
        total = (1 - self.well) * chain + self.well * well
        return torch.where((y.abs() > self.wall[:, None]).any(1), torch.nan, total)

    def gradient(self, y):
        a, b = y[:, :-1], y[:, 1:]
        chain = torch.zeros_like(y)
        chain[:, :-1] += -4 * self.steep[:, None] * (b - a**2) * a - 2 * (1 - a)
        chain[:, 1:] += 2 * self.steep[:, None] * (b - a**2)
        return (1 - self.well[:, None]) * chain + self.well[:, None] * (y**3 - y)

    def blocks(self, y):
        """(B, N-1, 2, 2) and the diagonal's rest (B, N)."""
        a, b = y[:, :-1], y[:, 1:]
        steep, share = self.steep[:, None], (1 - self.well)[:, None]
        block = torch.stack([
            torch.stack([-4 * steep * (b - 3 * a**2) + 2, -4 * steep * a], -1),
            torch.stack([-4 * steep * a, (2 * steep).expand_as(a)], -1),
        ], -2)
        return share[..., None, None] * block, self.well[:, None] * (3 * y**2 - 1)

    def hessians(self, y):
        return ChainHessians(self, y)

    def allows(self, old, new):
        return ((new - old).abs() <= self.reach[:, None]).all(1)

    def residual(self, gradient):
        return gradient.abs().amax(1)

    step_length = residual


class ChainHessians:
    def __init__(self, chains, y):
        self.chains, self.y = chains, y

    def systems(self, index, convexity, shift):
        yield np.arange(len(index)), CHAIN, self.data(index, convexity, shift)

    def into_frames(self, index, gradient):
        return gradient

    def out_of_frames(self, index, move):
        return move

    def data(self, index, convexity, shift):
        part = self.chains.take(torch.from_numpy(index))
        block, rest = part.blocks(self.y[torch.from_numpy(index)])
        value, vector = torch.linalg.eigh(block)
        keep = 1.0 - torch.from_numpy(convexity)[:, None]
        value = torch.where(value > 0, value, keep[..., None] * value)
        block = (vector * value[..., None, :]) @ vector.mT
        rest = torch.where(rest > 0, rest, keep * rest)
        rows = []
        for k in range(len(index)):
            data = CHAIN.assemble([block[k].numpy()])
            data[CHAIN.diagonal] += rest[k].numpy() + shift[k]
            rows.append(torch.from_numpy(data))
        return torch.stack(rows)


class Single:
    """One of the chains as the single minimisation sees it."""

    size, regularisation = N, np.ones(N)

    def __init__(self, chains, k):
        self.chains = chains.take(torch.tensor([k]))

    def __getattr__(self, name):
        function = getattr(self.chains, name)
        return lambda *a: function(*(torch.from_numpy(v)[None] for v in a))[0].numpy()[()]

    def hessian(self, y, convexity):
        hessians = self.chains.hessians(torch.from_numpy(y)[None])
        return CHAIN, hessians.data(np.array([0]), np.array([convexity]), np.zeros(1))[0].numpy()

    def into_frames(self, y, gradient):
        return gradient

    def out_of_frames(self, y, move):
        return move


def maker(kind):
    """Of the solver of a pattern."""
    if kind == "sparse":
        return lambda pattern: SparseSolver(pattern, threads=2)
    return lambda pattern: FrontalSolver(analyse(pattern, np.arange(N)[:, None], leaf=3))


def mixed():
    """Easy and hard chains, a wall in the way, short steps, a saddle, one that is not finite."""
    inf = torch.inf
    chains = Chains(
        steep=[1.0, 100.0, 30.0, 10.0, 1.0, 5.0],
        well=[0.0, 0.0, 0.0, 0.0, 1.0, 0.0],
        wall=torch.tensor([inf, inf, 2.5, inf, inf, 0.1]).double(),
        reach=torch.tensor([inf, inf, inf, 0.05, inf, inf]).double(),
    )
    start = 2.0 * torch.from_numpy(np.random.default_rng(3).random((6, N))) - 1.0
    start[4] = 0.0  # a maximum
    return chains, start


@pytest.mark.parametrize("kind", ["frontal", "sparse"])
def test_every_sample_as_if_alone(kind):
    chains, start = mixed()
    together = minimise_batch(chains, start, TIGHT, make_solver=maker(kind))
    statuses = [result.status for result in together]
    assert statuses == [*[Status.CONVERGED] * 5, Status.NOT_FINITE]
    for k, result in enumerate(together):
        index = torch.tensor([k])
        alone, = minimise_batch(chains.take(index), start[index], TIGHT, make_solver=maker(kind))
        assert (alone.status, alone.iterations) == (result.status, result.iterations)
        assert alone.factorisations == result.factorisations
        assert np.allclose(alone.y, result.y, atol=1e-11)


def test_every_sample_as_the_single_minimisation():
    chains, start = mixed()
    together = minimise_batch(chains, start, TIGHT, make_solver=maker("sparse"))
    for k, result in enumerate(together):
        single = minimise(Single(chains, k), start[k].numpy(), TIGHT)
        assert single.status is result.status and single.message == result.message
        # Rough factors of single precision change single steps, never the road taken.
        assert abs(single.iterations - result.iterations) <= 2
        if result.status is Status.CONVERGED:
            assert result.positive_definite and np.allclose(single.y, result.y, atol=1e-9)


def test_iterations_are_limited_for_each_sample():
    chains, start = mixed()
    free = minimise_batch(chains, start, TIGHT, make_solver=maker("frontal"))
    limit = int(np.median([result.iterations for result in free]))
    options = NewtonOptions(TIGHT.residual, TIGHT.step, limit)
    for before, result in zip(free, minimise_batch(chains, start, options,
                                                   make_solver=maker("frontal")), strict=True):
        if before.iterations < limit or before.status is not Status.CONVERGED:
            assert result.status is before.status and np.array_equal(result.y, before.y)
        elif before.iterations > limit:
            assert result.status is Status.MAX_ITERATIONS and result.iterations == limit
            assert str(limit) in result.message


def test_converges_quadratically():
    """With one more iteration, the distance to the minimum is about squared."""
    chains = Chains([100.0], [0.0])
    start = torch.full((1, N), 0.9, dtype=torch.float64)
    error = []
    for steps in range(1, 30):
        options = NewtonOptions(1e-14, 1e-14, steps)
        result, = minimise_batch(chains, start, options, make_solver=maker("frontal"))
        error.append(np.abs(result.y - 1.0).max())
    small = [k for k, e in enumerate(error) if 1e-7 < e < 1e-2]
    assert small and all(error[k + 1] < 300 * error[k] ** 2 for k in small)


def test_a_saddle_without_a_way_out_is_one():
    """-y² with steps forbidden: stationary, not a minimum, and it says so."""
    chains = Chains([1.0, 1.0], [1.0, 0.0], reach=torch.tensor([0.0, torch.inf]).double())
    start = torch.zeros(2, N, dtype=torch.float64)
    stuck, easy = minimise_batch(chains, start, TIGHT, make_solver=maker("frontal"))
    assert stuck.status is Status.SADDLE and not stuck.positive_definite
    assert np.array_equal(stuck.y, np.zeros(N))
    assert easy.status is Status.CONVERGED


def test_times_are_shared_out():
    chains, start = mixed()
    results = minimise_batch(chains, start, TIGHT, make_solver=maker("frontal"))
    for result in results[:5]:
        parts = sum(result.seconds[name] for name in ("assemble", "factorise", "search"))
        assert 0 < parts <= result.seconds["total"]
