"""Cholesky factors of a batch of sparse symmetric matrices of one pattern, front by front.

The unknowns are ordered once, by nested dissection (George 1973): the elements, sorted by azimuth
or by radius, are bisected again and again, where the unknowns that both halves share, the
separator, are fewest. Each node of that binary tree is a front: its separator, eliminated there,
and the boundary, the unknowns of earlier separators that its elements touch (the multifrontal
method of Duff and Reid 1983). Fronts of one level are padded to one size, so that a level of all
matrices is one batched dense operation each. Triangular factors are inverted.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from sim.solver.linear import SparsePattern

LEAF = 64
"""Unknowns of a matrix for each leaf of the tree; with fewer, more is moved between fronts."""
BLOCK = 32
"""Largest matrix that a library factors and inverts; larger ones are split, as products are faster
than factors and substitutions."""
_CUTS = np.linspace(0.47, 0.53, 9)
"""Shares of the elements in the first half: nearly equal, as fronts of a level have one size."""


@dataclass
class Level:
    """The F fronts of one level: their unknowns, P pivots and the boundary of Q, (F, P) and (F, Q),
    padded by the number of unknowns; which entries of the matrix, and of the first and second
    children's Schur complements, are added at which places. A front is stored as its panel
    (P + Q, P), then, if there are children, the block (Q, Q) of its boundary: lower triangles."""

    pivots: Tensor
    boundary: Tensor
    entries: Tensor
    places: Tensor
    ones: Tensor  # places of the padding's diagonal
    joins: list[tuple[Tensor, Tensor]]


class BatchedSolver:
    """Solver for matrices of ``pattern``, assembled from ``stencils``, (N, K) unknowns each (-1:
    absent), with the ``places`` (n, 2) of the unknowns, m, around the plate's axis."""

    def __init__(
        self, pattern: SparsePattern, stencils: list[np.ndarray], places: np.ndarray,
        device: str | torch.device = "cpu"
    ) -> None:
        tree = _dissected(stencils, places, max(1, round(np.log2(pattern.size / LEAF))))
        self.levels = _levels(pattern, tree, device)
        self._panels: list[tuple[Tensor, Tensor]] = []

    def factorise(self, data: Tensor) -> Tensor:
        """Factor matrices of CSR data (nnz, B); whether each (B,) is positive definite. The factors
        of those that are not are meaningless."""
        self._panels, below = [], data.new_zeros(0)
        data, batch = data.T.contiguous(), data.shape[1]
        definite = torch.ones(batch, dtype=torch.bool, device=data.device)
        for level in reversed(self.levels):
            (fronts, p), q = level.pivots.shape, level.boundary.shape[1]
            size = (p + q) * p + (q * q if level.joins else 0)
            flat = data.new_zeros(batch, fronts * size)
            flat.index_copy_(1, level.places, data[:, level.entries])
            flat.index_fill_(1, level.ones, 1.0)
            for entries, places in level.joins:
                flat.index_add_(1, places, below[:, entries], alpha=-1.0)
            front = flat.view(batch * fronts, size)
            panel = front[:, : (p + q) * p].unflatten(1, (p + q, p))
            inverse, sound = _inverse_factors(panel[:, :p])
            definite &= sound.view(batch, fronts).all(1)
            strip = torch.bmm(panel[:, p:], inverse.mT)
            self._panels.append((inverse, strip))
            if q and level.joins:  # what is subtracted from the parents: that of the children, too
                below = torch.baddbmm(front[:, (p + q) * p :].unflatten(1, (q, q)), strip,
                                      strip.mT, beta=-1.0).view(batch, -1)
            elif q:
                below = torch.bmm(strip, strip.mT).view(batch, -1)
        return definite

    def solve(self, rhs: Tensor) -> Tensor:
        """Solutions (n, B) for right-hand sides (n, B) with the last factors."""
        rest = torch.cat([rhs, rhs.new_zeros(1, rhs.shape[1])]).T.contiguous()
        batch, pieces = len(rest), []
        for level, (inverse, strip) in zip(reversed(self.levels), self._panels, strict=True):
            piece = inverse @ rest[:, level.pivots].view(len(inverse), -1, 1)
            pieces.append(piece)
            rest.index_add_(1, level.boundary.ravel(), (strip @ piece).view(batch, -1), alpha=-1.0)
        solution = torch.zeros_like(rest)
        for level in self.levels:
            piece, (inverse, strip) = pieces.pop(), self._panels[len(pieces)]
            known = solution[:, level.boundary].view(len(inverse), -1, 1)
            piece = inverse.mT @ (piece - strip.mT @ known)
            solution[:, level.pivots.ravel()] = piece.view(batch, -1)
        return solution.T[:-1].contiguous()


def _inverse_factors(matrices: Tensor) -> tuple[Tensor, Tensor]:
    """Inverses (M, p, p) of the Cholesky factors of matrices, given by their lower triangles, and
    whether each (M,) is positive definite; in two halves where they are large."""
    p = matrices.shape[1]
    if p <= BLOCK:
        factor, info = torch.linalg.cholesky_ex(matrices)
        identity = torch.eye(p, dtype=factor.dtype, device=factor.device).expand_as(factor)
        return (torch.linalg.solve_triangular(factor, identity, upper=False),
                (info == 0) & (factor.diagonal(dim1=1, dim2=2) > 0).all(1))
    half, inverse = p // 2, matrices.new_zeros(matrices.shape)
    first, sound = _inverse_factors(matrices[:, :half, :half])
    strip = torch.bmm(matrices[:, half:, :half], first.mT)
    second, more = _inverse_factors(torch.baddbmm(matrices[:, half:, half:], strip, strip.mT,
                                                 alpha=-1.0))
    inverse[:, :half, :half], inverse[:, half:, half:] = first, second
    inverse[:, half:, :half] = -torch.bmm(second, torch.bmm(strip, first))
    return inverse, sound & more


def _dissected(
    stencils: list[np.ndarray], places: np.ndarray, depth: int
) -> list[list[tuple[np.ndarray, np.ndarray]]]:
    """Pivots and boundary of the fronts, (2^l of them) on each level l up to ``depth``."""
    size, width = len(places), max(stencil.shape[1] for stencil in stencils)
    elements = np.concatenate([
        np.pad(stencil, ((0, 0), (0, width - stencil.shape[1])), constant_values=-1)
        for stencil in stencils])
    elements = np.where(elements < 0, size, elements)
    elements = elements[(elements < size).any(axis=1)]
    weight = elements < size
    centres = np.concatenate([places, np.zeros((1, 2))])[elements].sum(1) / weight.sum(1)[:, None]
    eliminated = np.zeros(size + 1, dtype=bool)
    eliminated[size] = True
    parts, tree = [np.arange(len(elements))], []
    for level in range(depth + 1):
        fronts, halves = [], []
        for part in parts:
            touched = np.unique(elements[part])
            touched = touched[touched < size]
            boundary = touched[eliminated[touched]]
            pivots = touched[~eliminated[touched]]
            if level < depth:
                first, second, pivots = _bisected(part, elements, centres, eliminated, level == 0)
                halves += [first, second]
            fronts.append((pivots, boundary))
        for pivots, _ in fronts:
            eliminated[pivots] = True
        tree.append(fronts)
        parts = halves
    return tree


def _bisected(
    part: np.ndarray, elements: np.ndarray, centres: np.ndarray, eliminated: np.ndarray, ring: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two halves of the elements ``part`` and the separator, the smallest of several; a ``ring``
    is cut at two azimuths."""
    x, y = centres[part].T
    mean = np.arctan2(y.sum(), x.sum())
    azimuth = (np.arctan2(y, x) - mean + np.pi) % (2 * np.pi)
    cuts = []
    for key in (azimuth,) if ring else (azimuth, np.hypot(x, y)):
        order = part[np.argsort(key, kind="stable")]
        for share in _CUTS:
            # Of a ring, the first half starts at another element for each cut.
            turned = np.roll(order, round(share * len(part))) if ring else order
            cut = round((0.5 if ring else share) * len(part))
            halves = turned[:cut], turned[cut:]
            count = np.zeros(len(eliminated), dtype=np.int8)
            for half in halves:
                count[elements[half].ravel()] += 1
            # += counts an unknown once per half
            separator = np.flatnonzero((count == 2) & ~eliminated)
            cuts.append((*halves, separator))
    return min(cuts, key=lambda cut: len(cut[2]))


def _levels(pattern: SparsePattern, tree: list, device: str | torch.device) -> list[Level]:
    size, levels = pattern.size, []
    depth_of, front_of = np.zeros((2, size), dtype=int)
    for depth, fronts in enumerate(tree):
        for front, (pivots, _) in enumerate(fronts):
            depth_of[pivots], front_of[pivots] = depth, front
    rows, columns = np.repeat(np.arange(size), np.diff(pattern.indptr)), pattern.indices.astype(int)
    owner = np.where(depth_of[rows] >= depth_of[columns], rows, columns)

    def placed(array: np.ndarray) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(array, dtype=np.int64)).to(device)

    for depth, fronts in enumerate(tree):
        p, q = (max(len(front[k]) for front in fronts) for k in range(2))
        pivots, boundary = (np.full((len(fronts), width), size) for width in (p, q))
        local = np.full((len(fronts), size), -1)
        for front, (inner, outer) in enumerate(fronts):
            pivots[front, : len(inner)], boundary[front, : len(outer)] = inner, outer
            local[front, inner] = np.arange(len(inner))
            local[front, outer] = p + np.arange(len(outer))
        children = tree[depth + 1] if depth < len(tree) - 1 else []
        step = (p + q) * p + (q * q if children else 0)

        def place(front, one, other, p=p, q=q, step=step):
            low, high = np.minimum(one, other), np.maximum(one, other)
            beyond = (p + q) * p + (high - p) * q + low - p
            return front * step + np.where(low < p, high * p + low, beyond)

        width, joins = max((len(outer) for _, outer in children), default=0), []
        for first in range(2 if children else 0):
            parts = []
            for child in range(first, len(children), 2):
                outer = children[child][1]
                (one, other), target = np.tril_indices(len(outer)), local[child // 2, outer]
                parts.append((child * width**2 + one * width + other,
                              place(child // 2, target[one], target[other])))
            of_child, of_parent = (placed(np.concatenate(part))
                                   for part in zip(*parts, strict=True))
            joins.append((of_child, of_parent))
        entries = np.flatnonzero(depth_of[owner] == depth)
        front, (padded, index) = front_of[owner[entries]], np.nonzero(pivots == size)
        places = place(front, local[front, rows[entries]], local[front, columns[entries]])
        levels.append(Level(placed(pivots), placed(boundary), placed(entries), placed(places),
                            placed(place(padded, index, index)), joins))
    return levels
