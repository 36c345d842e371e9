import numpy as np
import pytest
import torch
from scipy import sparse
from scipy.spatial import Delaunay
from sparse_batches import SparseSolver
from torch._subclasses.fake_tensor import FakeTensorMode

from common.errors import InputError
from sim.linear import SparsePattern
from sim.linear.fronts import plan_fronts
from sim.linear.multifrontal import FrontalSolver
from sim.linear.nested_dissection import EliminationTree, dissect

pytestmark = pytest.mark.usefixtures("one_thread")

SAMPLES = 5
CPU = torch.device("cpu")


def grid_graph(n):
    """Upper triangle of an n x n grid's graph, each vertex with its four neighbours."""
    index = np.arange(n * n).reshape(n, n)
    edges = [np.stack([index[:-1], index[1:]], -1), np.stack([index[:, :-1], index[:, 1:]], -1)]
    return SparsePattern([np.concatenate([e.reshape(-1, 2) for e in edges])], n * n)


def place(n):
    return np.stack(np.meshgrid(np.arange(n), np.arange(n), indexing="ij"), -1).reshape(-1, 2)


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


def cloth(vertices, seed=0):
    """Stencils (F, 12) and places (n, 2) of a cloth held in the middle, points more dense there.

    Unknowns are three coordinates of each free vertex and one rotation of each edge that has one.
    """
    rng = np.random.default_rng(seed)
    angle, radius = rng.uniform(0, 2 * np.pi, vertices), rng.uniform(0, 1, vertices) ** 0.7
    points = 0.15 * radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    faces = Delaunay(points).simplices
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=2)
    edges, number = np.unique(sides.reshape(-1, 2), axis=0, return_inverse=True)
    free = radius > 0.3
    used = np.concatenate([np.repeat(free, 3), free[edges].any(axis=1)])
    row = np.where(used, np.cumsum(used) - 1, -1)
    corners = (3 * faces[:, :, None] + np.arange(3)).reshape(-1, 9)
    stencil = row[np.hstack([corners, 3 * vertices + number.reshape(-1, 3)])]
    everywhere = np.concatenate([np.repeat(points, 3, axis=0), points[edges].mean(axis=1)])
    return stencil, everywhere[used]


@pytest.fixture(scope="module")
def system():
    """Pattern, places and CSR data of a batch: blocks as of cloth, a few stiff directions each."""
    stencil, places = cloth(300)
    pattern = SparsePattern([stencil], len(places))
    rng = np.random.default_rng(1)
    data = []
    for _ in range(SAMPLES):
        rows = rng.standard_normal((len(stencil), 9, 12)) * np.repeat([10.0, 0.1], [3, 6])[:, None]
        data.append(pattern.assemble([rows.transpose(0, 2, 1) @ rows]))
        data[-1][pattern.diagonal] += 1e-3
    return pattern, places, np.stack(data)


@pytest.fixture(scope="module")
def solver(system):
    pattern, places, _ = system
    return FrontalSolver(pattern, places)


def right_hand_sides(pattern, seed=0):
    return torch.from_numpy(np.random.default_rng(seed).standard_normal((SAMPLES, pattern.size)))


def lowest_eigenvalue(pattern, row):
    matrix = pattern.symmetric(row)
    return sparse.linalg.eigsh(matrix, k=1, sigma=0.0, return_eigenvectors=False)[0]


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
    tree = dissect(pattern, rng.random((120, 2)), leaf=leaf)
    assert np.array_equal(np.sort(np.concatenate(tree.pivots)), np.arange(120))
    owner = np.empty(120, dtype=int)
    for node, pivots in enumerate(tree.pivots):
        owner[pivots] = node
    above = [ancestors(tree, node) for node in range(len(tree.pivots))]
    assert [len(nodes) - 1 for nodes in above] == tree.depth.tolist()
    rows = np.repeat(np.arange(120), np.diff(pattern.indptr))
    for a, b in zip(owner[rows], owner[pattern.indices], strict=True):
        assert b in above[a] or a in above[b]


def test_separators_of_a_grid_are_its_lines():
    tree = dissect(grid_graph(15), place(15), leaf=30)
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
    tree = dissect(ring, places[kept], leaf=30)
    assert len(tree.pivots[-1]) == 8


def test_a_separator_has_all_unknowns_of_a_vertex_or_none():
    """They have one place and the same neighbours."""
    stencil, places = cloth(200)
    tree = dissect(SparsePattern([stencil], len(places)), places, leaf=20)
    owner = np.empty(len(places), dtype=int)
    for node, pivots in enumerate(tree.pivots):
        owner[pivots] = node
    _, place_of = np.unique(places, axis=0, return_inverse=True)
    assert np.bincount(place_of.ravel()).max() == 3
    for k in range(place_of.max() + 1):
        assert len(np.unique(owner[place_of.ravel() == k])) == 1


def test_fronts_hold_exactly_the_fill():
    """With one unknown a node and the elimination tree of a sparse Cholesky factor."""
    rng = np.random.default_rng(5)
    pattern = random_pattern(rng, 60, 40)
    matrix = pattern.symmetric(random_matrices(rng, pattern, 1)[0]).toarray()
    filled = np.linalg.cholesky(matrix) != 0.0
    below = np.tril(filled, -1)
    # Several roots are children of the last unknown.
    parent = np.where(below.any(axis=0), below.argmax(axis=0), np.append(np.full(59, 59), -1))
    depth = np.zeros(60, dtype=int)
    for node in reversed(range(59)):
        depth[node] = depth[parent[node]] + 1
    deepest_first = np.argsort(-depth, kind="stable")
    number = np.append(np.argsort(deepest_first), -1)
    tree = EliminationTree(tuple(deepest_first[:, None]), number[parent[deepest_first]],
                           depth[deepest_first])
    fronts = plan_fronts(pattern, tree, group_cost=0.0, device=CPU)
    assert filled.sum() > len(pattern.indices)
    assert fronts.sizes[:, 0].tolist() == [1] * 60
    assert np.array_equal(fronts.sizes.sum(axis=1), filled.sum(axis=0)[deepest_first])


@pytest.mark.parametrize(("leaf", "group_cost"), [(1, 0.0), (10, 1e3), (10, 1e9), (1000, 0.0)])
def test_solves_like_dense_cholesky(monkeypatch, leaf, group_cost):
    """Whatever the sizes of the fronts; the unknowns are in no order, and many do not couple."""
    monkeypatch.setattr("sim.linear.multifrontal._LEAF", leaf)
    monkeypatch.setattr("sim.linear.multifrontal._GROUP_COST", group_cost)
    rng = np.random.default_rng(3)
    pattern = random_pattern(rng, 150, 130)
    data = random_matrices(rng, pattern, 4)
    solver = FrontalSolver(pattern, rng.random((150, 2)))
    assert solver.factorise(torch.from_numpy(data)).all()
    rhs = torch.from_numpy(rng.standard_normal((4, 150)))
    found = solver.solve(rhs)
    for k in range(4):
        lower = torch.linalg.cholesky(torch.from_numpy(pattern.symmetric(data[k]).toarray()))
        expected = torch.cholesky_solve(rhs[k, :, None], lower)[:, 0]
        assert (found[k] - expected).abs().max() <= 150e-13 * expected.abs().max()


def test_permuted_unknowns_have_permuted_solutions(system, solver):
    """Another numbering leads to other fronts or at least another order within them."""
    pattern, places, data = system
    stencil, _ = cloth(300)
    number = np.random.default_rng(2).permutation(pattern.size)  # new number of each unknown
    other = SparsePattern([np.where(stencil >= 0, number[stencil], -1)], pattern.size)
    rows = np.repeat(np.arange(pattern.size), np.diff(pattern.indptr))
    slots = other.slots(number[np.stack([rows, pattern.indices], axis=1)])
    permuted = np.zeros_like(data)
    permuted[:, slots[:, 1]] = data
    moved = FrontalSolver(other, places[np.argsort(number)])
    rhs = right_hand_sides(pattern)
    assert moved.factorise(torch.from_numpy(permuted)).all()
    assert solver.factorise(torch.from_numpy(data)).all()
    expected = solver.solve(rhs)
    found = moved.solve(rhs[:, np.argsort(number)])[:, number]
    assert (found - expected).abs().max() <= 1e-10 * expected.abs().max()


def test_any_places_give_the_right_solution():
    """Places decide the time alone: all unknowns in one point, or parts that do not couple."""
    rng = np.random.default_rng(8)
    pattern = SparsePattern([rng.integers(0, 100, (90, 3)), rng.integers(100, 200, (90, 3))], 200)
    data = torch.from_numpy(random_matrices(rng, pattern, 2))
    rhs = torch.from_numpy(rng.standard_normal((2, 200)))
    apart = np.stack([np.arange(200) >= 100, rng.random(200)], axis=1)
    for places in (np.zeros((200, 2)), apart):
        solver = FrontalSolver(pattern, places)
        assert solver.factorise(data).all()
        found = solver.solve(rhs).numpy()
        for row, x, b in zip(data.numpy(), found, rhs.numpy(), strict=True):
            assert np.abs(pattern.symmetric(row) @ x - b).max() <= 1e-12


def test_like_the_sparse_solver(system, solver):
    pattern, _, data = system
    rhs = right_hand_sides(pattern)
    other = SparseSolver(pattern)
    assert solver.factorise(torch.from_numpy(data)).all()
    assert other.factorise(torch.from_numpy(data)).all()
    found, expected = solver.solve(rhs), other.solve(rhs)
    assert (found - expected).abs().max() <= 1e-9 * expected.abs().max()
    for row, x, b in zip(data, found.numpy(), rhs.numpy(), strict=True):
        assert np.linalg.norm(pattern.symmetric(row) @ x - b) <= 1e-10 * np.linalg.norm(b)


def test_a_device_may_be_named_as_no_tensor_names_it():
    """As "cuda", whose tensors say "cuda:0"; on any machine, "cpu:0", whose say "cpu"."""
    pattern = grid_graph(4)
    solver = FrontalSolver(pattern, place(4), device="cpu:0")
    values = torch.zeros(1, len(pattern.indices), dtype=torch.float64, device="cpu:0")
    values[:, pattern.diagonal] = 4.0
    assert solver.factorise(values).all()
    assert (solver.solve(torch.ones(1, 16).double()) == 0.25).all()


@pytest.mark.parametrize("fault", ["indefinite", "nan", "infinite", "infinite diagonal", "huge"])
def test_a_bad_matrix_spoils_its_own_sample_only(system, solver, fault):
    pattern, _, data = system
    values, rhs = torch.from_numpy(data.copy()), right_hand_sides(pattern)
    assert solver.factorise(values).all()
    before = solver.solve(rhs)
    if fault == "indefinite":
        values[2, pattern.diagonal] -= 1.01 * lowest_eigenvalue(pattern, data[2])
    else:
        entry = pattern.diagonal[7] + (fault != "infinite diagonal")
        values[2, entry] = {"nan": np.nan, "huge": 1e300}.get(fault, np.inf)
    others = [0, 1, 3, 4]
    assert solver.factorise(values).tolist() == [k in others for k in range(SAMPLES)]
    after = solver.solve(rhs)
    assert after[2].isnan().all()
    assert torch.equal(after[others], before[others])
    values[2] = torch.from_numpy(data[2])
    assert solver.factorise(values).all()  # nothing is left behind in the kept memory
    assert torch.equal(solver.solve(rhs), before)


def test_definiteness_follows_the_lowest_eigenvalue(system, solver):
    pattern, _, data = system
    values = torch.from_numpy(data.copy())
    shares = (0.9, 1.1, 0.99, 1.01, 0.0)
    for row, share in zip(values, shares, strict=True):
        row[pattern.diagonal] -= share * lowest_eigenvalue(pattern, row.numpy())
    assert solver.factorise(values).tolist() == [share < 1.0 for share in shares]
    assert SparseSolver(pattern).factorise(values).tolist() == [share < 1.0 for share in shares]


def test_alone_and_in_a_batch_alike(system, solver):
    """Not to the bit: a library may add up in another order for another number of matrices."""
    pattern, _, data = system
    values, rhs = torch.from_numpy(data), right_hand_sides(pattern, 2)
    solver.factorise(values)
    together = solver.solve(rhs)
    for k in range(SAMPLES):
        assert solver.factorise(values[k : k + 1]).all()
        alone = solver.solve(rhs[k : k + 1])[0]
        assert (alone - together[k]).abs().max() <= 1e-10 * together[k].abs().max()


def test_repeats_to_the_bit(system, solver):
    pattern, _, data = system
    values, rhs = torch.from_numpy(data), right_hand_sides(pattern, 3)
    solver.factorise(values)
    first = solver.solve(rhs)
    solver.factorise(values[:1])  # leaves other numbers in the kept memory
    solver.factorise(values)
    assert torch.equal(solver.solve(rhs), first)


def test_flows_have_no_target_twice(solver):
    """So that a GPU, which adds in any order, gives one sum."""
    fronts = solver.fronts
    of_groups = [flow for group in fronts.groups for flow in (*group.updates, *group.carried)]
    assert max(len(group.updates) for group in fronts.groups) > 1
    for take, put in [*fronts.values, *of_groups]:
        assert len(take) == len(put) == len(put.unique())


def test_mistakes_are_named(system, solver):
    pattern, places, data = system
    values = torch.from_numpy(data)
    with pytest.raises(InputError, match="matrices must be"):
        solver.factorise(values[:, :-1])
    with pytest.raises(InputError, match="float64"):
        solver.factorise(values.float())
    solver.factorise(values)
    with pytest.raises(InputError, match=rf"right-hand sides must be \({SAMPLES}, {pattern.size}"):
        solver.solve(torch.zeros(3, pattern.size, dtype=torch.float64))
    with pytest.raises(InputError, match="places"):
        FrontalSolver(pattern, places[1:])
    with pytest.raises(InputError, match="places"):
        FrontalSolver(pattern, np.where(places == places[0], np.nan, places))
    with pytest.raises(InputError, match="further than the pattern"):
        pattern.slots(np.array([[0, pattern.size - 1]]))


def test_all_tensors_stay_on_a_gpu(system):
    """Without one: PyTorch's fake tensors have a device, no data, and refuse to mix devices."""
    pattern, places, data = system
    gpu = torch.device("cuda", 0)
    with FakeTensorMode(allow_non_fake_inputs=True):
        solver = FrontalSolver(pattern, places, device="cuda")
        definite = solver.factorise(torch.empty(data.shape, dtype=torch.float64, device=gpu))
        found = solver.solve(torch.empty(SAMPLES, pattern.size, dtype=torch.float64, device=gpu))
    assert (definite.device, definite.dtype, definite.shape) == (gpu, torch.bool, (SAMPLES,))
    assert (found.device, found.dtype) == (gpu, torch.float64)
    assert found.shape == (SAMPLES, pattern.size)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_a_gpu_gives_the_same_solutions(system, solver):
    pattern, places, data = system
    values, rhs = torch.from_numpy(data.copy()), right_hand_sides(pattern, 6)
    values[1, 5] = np.nan
    definite = solver.factorise(values)
    expected = solver.solve(rhs)[definite]
    other = FrontalSolver(pattern, places, device="cuda")
    assert torch.equal(other.factorise(values.cuda()).cpu(), definite)
    found = other.solve(rhs.cuda()).cpu()[definite]
    assert (found - expected).abs().max() <= 1e-9 * expected.abs().max()
