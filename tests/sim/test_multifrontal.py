import numpy as np
import pytest
import torch
from scipy import sparse
from sim.specimens import make_specimen

from common.errors import InputError
from sim.drape import drape
from sim.equilibrium import build_potential
from sim.grid_unknowns import GridUnknowns
from sim.initial import initial_positions
from sim.linear import SparsePattern, make_solver
from sim.linear.multifrontal import BatchedCholesky, analyse
from sim.linear.nested_dissection import EliminationTree, dissect
from sim.material import Fabric
from sim.scene import Rig, Scene, State

pytestmark = pytest.mark.usefixtures("one_thread")

ISOTROPIC = Fabric(density=0.3, alpha=np.full(3, 1e-4), beta=np.full(3, -1e-7))
RIG = Rig()
N = 21


def grid_graph(n):
    """Upper triangle of an n x n grid's graph, each vertex with its four neighbours."""
    index = np.arange(n * n).reshape(n, n)
    edges = [np.stack([index[:-1], index[1:]], -1), np.stack([index[:, :-1], index[:, 1:]], -1)]
    return SparsePattern([np.concatenate([e.reshape(-1, 2) for e in edges])], n * n)


def random_pattern(rng, size, elements):
    return SparsePattern([rng.integers(0, size, (elements, 3))], size)


def random_matrices(rng, pattern, samples):
    """(samples, nnz) data of diagonally dominant, so positive definite, matrices."""
    data = rng.standard_normal((samples, len(pattern.indices)))
    data[:, pattern.diagonal] = 0.0
    for row in data:
        total = np.abs(pattern.symmetric(row)).sum(axis=1)
        row[pattern.diagonal] = np.asarray(total).ravel() + 0.1
    return data


def place(n):
    return np.stack(np.meshgrid(np.arange(n), np.arange(n), indexing="ij"), -1).reshape(-1, 2)


def ancestors(tree, node):
    found = {node}
    while tree.parent[node] >= 0:
        node = tree.parent[node]
        found.add(node)
    return found


@pytest.mark.parametrize("leaf", [1, 7, 30])
def test_only_ancestors_and_descendants_couple(leaf):
    rng = np.random.default_rng(leaf)
    pattern = random_pattern(rng, 120, 90)
    tree = dissect(pattern.indptr, pattern.indices, rng.random((120, 2)), leaf=leaf)
    assert np.array_equal(np.sort(np.concatenate(tree.pivots)), np.arange(120))
    owner = np.empty(120, dtype=int)
    for node, pivots in enumerate(tree.pivots):
        owner[pivots] = node
    above = [ancestors(tree, node) for node in range(len(tree.pivots))]
    rows = np.repeat(np.arange(120), np.diff(pattern.indptr))
    for a, b in zip(owner[rows], owner[pattern.indices], strict=True):
        assert b in above[a] or a in above[b]


def test_separators_of_a_grid_are_its_lines():
    pattern = grid_graph(15)
    tree = dissect(pattern.indptr, pattern.indices, place(15), leaf=20)
    assert len(tree.pivots[-1]) == 15  # the shortest cut of a square grid
    children = np.flatnonzero(tree.parent == len(tree.pivots) - 1)
    assert sorted(len(tree.pivots[k]) for k in children) == [7, 7]


def test_a_hole_shortens_the_separator():
    places = place(16)
    kept = np.abs(places - 7.5).max(axis=1) > 4  # leaves a ring four wide
    number = np.cumsum(kept) - 1
    pattern = grid_graph(16)
    rows = np.repeat(np.arange(256), np.diff(pattern.indptr))
    pairs = np.stack([rows, pattern.indices], 1)
    ring = SparsePattern([number[pairs[kept[pairs].all(axis=1)]]], int(kept.sum()))
    tree = dissect(ring.indptr, ring.indices, places[kept], leaf=30)
    assert len(tree.pivots[-1]) == 8


@pytest.mark.parametrize(("group_cost", "entry_cost"), [(0.0, 0.0), (1e3, 3.0), (1e9, 0.0)])
def test_solves_like_dense_cholesky(group_cost, entry_cost):
    rng = np.random.default_rng(3)
    pattern = random_pattern(rng, 150, 130)
    data = random_matrices(rng, pattern, 4)
    analysis = analyse(pattern, rng.random((150, 2)), leaf=10, group_cost=group_cost,
                       entry_cost=entry_cost)
    solver = BatchedCholesky(analysis)
    assert solver.factorise(torch.from_numpy(data)).all()
    rhs = rng.standard_normal((4, 150, 3))
    found = solver.solve(torch.from_numpy(rhs)).numpy()
    for k in range(4):
        dense = torch.from_numpy(pattern.symmetric(data[k]).toarray())
        lower = torch.linalg.cholesky(dense)
        expected = torch.cholesky_solve(torch.from_numpy(rhs[k]), lower).numpy()
        assert np.abs(found[k] - expected).max() <= 1e-13 * np.abs(expected).max() * 150
    single = solver.solve(torch.from_numpy(rhs[..., 1])).numpy()
    assert np.allclose(single, found[..., 1], rtol=0, atol=1e-13)


def test_fronts_hold_exactly_the_fill():
    """With one unknown a node and the elimination tree of a sparse Cholesky factor."""
    rng = np.random.default_rng(5)
    pattern = random_pattern(rng, 60, 40)
    matrix = pattern.symmetric(random_matrices(rng, pattern, 1)[0]).toarray()
    filled = np.linalg.cholesky(matrix) != 0.0
    below = np.tril(filled, -1)
    parent = np.where(below.any(axis=0), below.argmax(axis=0), -1)
    tree = EliminationTree(tuple(np.arange(60)[:, None]), parent)
    fronts = analyse(pattern, tree, entry_cost=0.0).fronts
    assert filled.sum() > len(pattern.indices)
    assert fronts.factor_entries <= filled.sum()  # nodes joined at no cost share their fill
    assert fronts.largest >= filled.sum(axis=0).max()


def states(samples):
    """Mesh, potential and unknowns of drapes under way; every second one at equilibrium.

    They lie differently on the plate, so that other vertices are held.
    """
    for seed in range(samples):
        offset = (0.003 * seed, -0.002 * seed)
        if seed % 2:
            result = drape(ISOTROPIC, resolution=N, seed=seed, offset=offset)
            assert result.converged
        specimen = make_specimen(RIG, resolution=N, seed=seed, offset=offset)
        scene = Scene(mesh=specimen.mesh, held=specimen.held, obstacles=RIG.obstacles)
        if seed % 2:
            state = State(result.positions, result.rotations)
        else:
            rng = np.random.default_rng(seed)
            positions = initial_positions(specimen.mesh.rest, rig=RIG, start="fold", rng=rng)
            positions[specimen.held] = RIG.place(specimen.mesh.rest[specimen.held])
            state = State.at(specimen.mesh, positions)
        q = state.unknowns
        yield specimen, build_potential(scene, ISOTROPIC, state), q


@pytest.fixture(scope="module")
def drapes():
    """Shared unknowns and, of each sample: own matrix's pattern and data, rows, shared data."""
    samples = list(states(4))
    free = np.any([~specimen.held for specimen, _, _ in samples], axis=0)
    unknowns = GridUnknowns((N, N), free.reshape(N, N))
    cases = []
    for specimen, potential, q in samples:
        chosen = potential.free_part(np.arange(len(q)))
        mask = np.zeros(len(q), dtype=bool)
        mask[chosen] = True
        rows = unknowns.rows(specimen.mesh, mask)[chosen]
        pattern, data = potential.hessian(q[chosen], 1.0)
        cases.append((pattern, data, rows, unknowns.embed(pattern, data, rows)))
    return unknowns, cases


@pytest.fixture(scope="module")
def solver(drapes):
    unknowns, _ = drapes
    return BatchedCholesky(analyse(unknowns.pattern, unknowns.places))


def batch(drapes):
    return torch.from_numpy(np.stack([shared for *_, shared in drapes[1]]))


def test_samples_differ_in_couplings_and_held_vertices(drapes):
    """Otherwise the tests below show little."""
    _, cases = drapes
    assert len({frozenset(rows.tolist()) for _, _, rows, _ in cases}) > 1
    zeros = {frozenset(np.flatnonzero(shared == 0).tolist()) for *_, shared in cases}
    assert len(zeros) == len(cases)


def test_shared_pattern_holds_the_same_matrix(drapes):
    unknowns, cases = drapes
    for pattern, data, rows, shared in cases:
        matrix = unknowns.pattern.symmetric(shared)
        assert abs(matrix[rows][:, rows] - pattern.symmetric(data)).max() == 0.0
        absent = np.setdiff1d(np.arange(unknowns.size), rows)
        assert (matrix[absent] != sparse.eye_array(unknowns.size, format="csr")[absent]).nnz == 0


def test_shared_rows_keep_places(drapes):
    """A sample's vertices and edges come to lie where they are in the grid."""
    unknowns, _ = drapes
    specimen = make_specimen(RIG, resolution=N, seed=7, diagonals="equal")
    mesh = specimen.mesh
    grid = place(N).astype(float)
    middles = grid[mesh.edges].mean(axis=1)
    rows = unknowns.rows(mesh, np.zeros(3 * len(grid) + len(mesh.edges), dtype=bool))
    assert (rows == -1).all()
    free = np.concatenate([np.zeros(3 * len(grid), dtype=bool), ~specimen.held[mesh.edges].any(1)])
    rows = unknowns.rows(mesh, free)
    assert len(np.unique(rows[free])) == free.sum()
    np.testing.assert_array_equal(unknowns.places[rows[free]], middles[free[3 * len(grid) :]])


def test_residual_on_drape_hessians(drapes, solver):
    unknowns, cases = drapes
    assert solver.factorise(batch(drapes)).all()
    rhs = np.random.default_rng(0).standard_normal((len(cases), unknowns.size))
    found = solver.solve(torch.from_numpy(rhs)).numpy()
    for (pattern, data, rows, shared), b, x in zip(cases, rhs, found, strict=True):
        matrix = unknowns.pattern.symmetric(shared)
        assert np.linalg.norm(matrix @ x - b) <= 1e-11 * np.linalg.norm(b)
        other = make_solver(pattern)
        assert other.factorise(data)
        np.testing.assert_allclose(x[rows], other.solve(b[rows]), atol=1e-9 * np.abs(x).max())


def test_a_device_may_be_named_as_no_tensor_names_it():
    """As "cuda", whose tensors say "cuda:0"; on any machine, "cpu:0", whose say "cpu"."""
    unknowns = GridUnknowns((4, 4), np.ones((4, 4), dtype=bool))
    solver = BatchedCholesky(analyse(unknowns.pattern, unknowns.places, device="cpu:0"))
    values = torch.zeros(1, len(unknowns.pattern.indices), dtype=torch.float64, device="cpu:0")
    values[:, unknowns.pattern.diagonal] = 4.0
    assert solver.factorise(values).all()
    assert torch.equal(solver.solve(torch.ones(1, unknowns.size).double()),
                       torch.full((1, unknowns.size), 0.25).double())


@pytest.mark.parametrize("fault", ["indefinite", "nan", "infinite"])
def test_a_bad_matrix_spoils_its_own_sample_only(drapes, solver, fault):
    unknowns, cases = drapes
    values = batch(drapes)
    rhs = torch.from_numpy(np.random.default_rng(1).standard_normal((len(cases), unknowns.size)))
    assert solver.factorise(values).all()
    before = solver.solve(rhs)
    diagonal = torch.from_numpy(unknowns.pattern.diagonal.astype(np.int64))
    if fault == "indefinite":
        matrix = unknowns.pattern.symmetric(cases[2][3])
        lowest = sparse.linalg.eigsh(matrix, k=1, sigma=0.0, return_eigenvectors=False)[0]
        values[2, diagonal] -= 1.01 * lowest
    else:
        values[2, 5] = {"nan": np.nan, "infinite": np.inf}[fault]
    assert solver.factorise(values).tolist() == [True, True, False, True]
    after = solver.solve(rhs)
    for k in (0, 1, 3):
        assert torch.equal(after[k], before[k])


def test_definiteness_follows_the_lowest_eigenvalue(drapes, solver):
    unknowns, cases = drapes
    values = batch(drapes)
    diagonal = torch.from_numpy(unknowns.pattern.diagonal.astype(np.int64))
    for k, share in enumerate((0.9, 1.1, 0.99, 1.01)):
        matrix = unknowns.pattern.symmetric(cases[k][3])
        lowest = sparse.linalg.eigsh(matrix, k=1, sigma=0.0, return_eigenvectors=False)[0]
        values[k, diagonal] -= share * lowest
    assert solver.factorise(values).tolist() == [True, False, True, False]


def test_alone_and_in_a_batch_alike(drapes, solver):
    """Not to the bit: a library may add up in another order for another number of matrices."""
    values = batch(drapes)
    rhs = torch.from_numpy(np.random.default_rng(2).standard_normal((4, drapes[0].size)))
    solver.factorise(values)
    together = solver.solve(rhs)
    for k in range(len(values)):
        assert solver.factorise(values[k : k + 1]).all()
        alone = solver.solve(rhs[k : k + 1])[0]
        assert (alone - together[k]).abs().max() <= 1e-11 * together[k].abs().max()


def test_repeats_to_the_bit(drapes, solver):
    values = batch(drapes)
    rhs = torch.ones(len(values), drapes[0].size, dtype=torch.float64)
    solver.factorise(values)
    first = solver.solve(rhs)
    solver.factorise(values[:1])  # leaves other numbers in the kept memory
    solver.factorise(values)
    assert torch.equal(solver.solve(rhs), first)


def test_several_right_hand_sides(drapes, solver):
    values = batch(drapes)
    solver.factorise(values)
    rhs = torch.from_numpy(np.random.default_rng(4).standard_normal((4, drapes[0].size, 5)))
    together = solver.solve(rhs)
    for k in range(5):
        one = solver.solve(rhs[..., k].contiguous())
        assert (together[..., k] - one).abs().max() <= 1e-11 * one.abs().max()


def test_mistakes_are_named(drapes, solver):
    unknowns, _ = drapes
    values = batch(drapes)
    with pytest.raises(InputError, match="do not fit the pattern"):
        solver.factorise(values[:, :-1])
    with pytest.raises(InputError, match="float64"):
        solver.factorise(values.float())
    solver.factorise(values)
    with pytest.raises(InputError, match="do not fit 4 matrices"):
        solver.solve(torch.zeros(3, unknowns.size, dtype=torch.float64))
    with pytest.raises(InputError, match="places"):
        analyse(unknowns.pattern, unknowns.places[1:])
    with pytest.raises(InputError, match="further than the pattern"):
        unknowns.pattern.slots(np.array([[0, unknowns.size - 1]]))
    other = make_specimen(RIG, resolution=N + 1).mesh
    with pytest.raises(InputError, match="no triangulation"):
        unknowns.rows(other, np.zeros(3 * (N + 1) ** 2 + len(other.edges), dtype=bool))
    with pytest.raises(InputError, match="has no row"):
        mesh = make_specimen(RIG, resolution=N).mesh
        unknowns.rows(mesh, np.ones(3 * N * N + len(mesh.edges), dtype=bool))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_a_gpu_gives_the_same_solutions(drapes, solver):
    values = batch(drapes)
    rhs = torch.from_numpy(np.random.default_rng(6).standard_normal((4, drapes[0].size)))
    assert solver.factorise(values).all()
    expected = solver.solve(rhs)
    unknowns, _ = drapes
    other = BatchedCholesky(analyse(unknowns.pattern, unknowns.places, device="cuda"))
    assert other.factorise(values.cuda()).all()
    found = other.solve(rhs.cuda()).cpu()
    assert (found - expected).abs().max() <= 1e-9 * expected.abs().max()
