"""Objectives against a scan whose points belong to no known points of the cloth.

Nearest points stand in for the unknown correspondence (Chamfer distance, as in DiffAvatar, Li et
al. 2024), both ways, and the hem is matched to the hem: without it cloth may slide along its own
surface. Distances are taken across the scanned surface or across the scanned hem only, so that
they are linear in the vertices as long as the pairs stay (point-to-plane).

These objectives see the scan on the axes of the simulation; :class:`Placed` frees turn and shift.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from common.errors import InputError
from drapenet.refine.objective import Linearised, Objective, huber
from sim.mesh import edges_of, vertex_normals

NEIGHBOURS = 20  # that a raw point's normal is taken from
_GAP = math.radians(130)  # without a neighbour: where a raw cloud ends
_HEM_NEIGHBOURS = 6


@dataclass(frozen=True)
class Cloud:
    """A scanned surface.

    Attributes:
        points: (N, 3) m; normals: (N, 3) of either sign.
        hem: (M, 3) m, points of the specimen's border; none if unknown.
    """

    points: np.ndarray
    normals: np.ndarray
    hem: np.ndarray

    @staticmethod
    def of_mesh(positions: np.ndarray, faces: np.ndarray) -> "Cloud":
        """Vertices, middles of edges and of faces of a scanned mesh, (V, 3) m and (F, 3).

        The hem is the mesh's border, so a scan with holes must be given as points.
        """
        vertices = vertex_normals(positions, faces)
        edges, count = edges_of(faces)
        points = [positions, positions[edges].mean(axis=1), positions[faces].mean(axis=1)]
        normals = [vertices, vertices[edges].sum(axis=1), vertices[faces].sum(axis=1)]
        border = edges[count == 1]
        hem = np.concatenate([positions[np.unique(border)], positions[border].mean(axis=1)])
        return Cloud(np.concatenate(points), _unit(np.concatenate(normals)), hem)

    @staticmethod
    def of_points(points: np.ndarray) -> "Cloud":
        """A raw cloud (N, 3), m: normals and hem from each point's neighbours.

        Raises:
            InputError: too few points.
        """
        if len(points) < 10 * NEIGHBOURS:
            raise InputError(f"{len(points)} points are too few for a surface")
        _, near = cKDTree(points).query(points, NEIGHBOURS + 1)
        offsets = points[near[:, 1:]] - points[:, None]
        centred = offsets - offsets.mean(axis=1, keepdims=True)
        _, frames = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))
        flat = np.einsum("nki,nij->nkj", offsets, frames[:, :, 1:])
        angles = np.sort(np.arctan2(flat[..., 1], flat[..., 0]), axis=1)
        gaps = np.diff(angles, axis=1, append=angles[:, :1] + 2 * np.pi)
        return Cloud(points, frames[:, :, 0], points[gaps.max(axis=1) > _GAP])


class Chamfer:
    """Distances from vertices to the scanned surface and back.

    Value: Huber's function of the distances in units of ``sigma``; half its mean over the points
    of either side times ``independent``.

    Args:
        faces: (F, 3) of the simulated mesh.
        cloud: scanned.
        free: (V,) bool, vertices that count: not those on the plate.
        sigma: m. limit: in units of ``sigma``.
        independent: how many distances are independent.
        samples: scanned points that count, at most, chosen evenly.
    """

    nuisances = ()
    start = scale = np.zeros(0)

    def __init__(
        self, faces: np.ndarray, cloud: Cloud, *, free: np.ndarray, sigma: float = 1e-3,
        limit: float = 3.0, independent: float = 100.0, samples: int = 3000,
    ) -> None:
        self._faces, self._cloud, self._free = faces, cloud, np.flatnonzero(free)
        self._tree = cKDTree(cloud.points)
        every = max(1, -(-len(cloud.points) // samples))
        self._samples = np.arange(0, len(cloud.points), every)
        self._sigma, self._limit, self._independent = sigma, limit, independent

    def residuals(self, positions: np.ndarray, nuisance: np.ndarray) -> np.ndarray:
        """Residuals (N,)."""
        return self.linearised(positions, nuisance).residuals

    def linearised(self, positions: np.ndarray, nuisance: np.ndarray) -> Linearised:
        """The same with derivatives."""
        cloud = self._cloud
        nearest = self._tree.query(positions[self._free])[1]
        centres = np.concatenate([positions, positions[self._faces].mean(axis=1)])
        back = cKDTree(centres).query(cloud.points[self._samples])[1]
        scanned = np.concatenate([nearest, self._samples])
        simulated = np.concatenate([self._free, back])
        normals = cloud.normals[scanned]
        sizes = np.repeat([len(self._free), len(self._samples)], [len(nearest), len(back)])
        factor = np.sqrt(self._independent / (2 * sizes))
        plain = (normals * (centres[simulated] - cloud.points[scanned])).sum(1) / self._sigma
        bent, slope = huber(plain, self._limit)

        def along(moves: np.ndarray) -> np.ndarray:
            at = np.concatenate([moves, moves[:, self._faces].mean(axis=2)], axis=1)[:, simulated]
            return (factor * slope * (normals * at).sum(-1) / self._sigma).T

        return Linearised(factor * bent, along, np.zeros((len(bent), 0)), self._independent)


class Hem:
    """Distances between the simulated and the scanned hem, across the scanned one, both ways.

    Args:
        faces: (F, 3) of the simulated mesh. cloud: scanned, with its hem.
        sigma, limit, independent: as for :class:`Chamfer`.

    Raises:
        InputError: a scan whose hem is unknown.
    """

    nuisances = ()
    start = scale = np.zeros(0)

    def __init__(
        self, faces: np.ndarray, cloud: Cloud, *, sigma: float = 1e-3, limit: float = 3.0,
        independent: float = 30.0,
    ) -> None:
        if len(cloud.hem) <= _HEM_NEIGHBOURS:
            raise InputError("the scan has no hem to compare")
        self._border = border_edges(faces)
        self._hem, self._tree = cloud.hem, cKDTree(cloud.hem)
        offsets = cloud.hem[self._tree.query(cloud.hem, _HEM_NEIGHBOURS)[1]]
        offsets = offsets - offsets.mean(axis=1, keepdims=True)
        frames = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))[1]
        self._across = frames[:, :, :2]  # (M, 3, 2), both directions across the hem
        self._sigma, self._limit, self._independent = sigma, limit, independent

    def residuals(self, positions: np.ndarray, nuisance: np.ndarray) -> np.ndarray:
        """Residuals (N,)."""
        return self.linearised(positions, nuisance).residuals

    def linearised(self, positions: np.ndarray, nuisance: np.ndarray) -> Linearised:
        """The same with derivatives."""
        middles = positions[self._border].mean(axis=1)
        nearest = self._tree.query(middles)[1]
        back = cKDTree(middles).query(self._hem)[1]
        scanned = np.concatenate([nearest, np.arange(len(self._hem))])
        simulated = np.concatenate([np.arange(len(middles)), back])
        across = self._across[scanned]
        sizes = np.repeat([len(nearest), len(back)], [len(nearest), len(back)])
        factor = np.repeat(np.sqrt(self._independent / (2 * sizes)), 2)
        gap = middles[simulated] - self._hem[scanned]
        plain = np.einsum("nij,ni->nj", across, gap).ravel() / self._sigma
        bent, slope = huber(plain, self._limit)

        def along(moves: np.ndarray) -> np.ndarray:
            at = moves[:, self._border].mean(axis=2)[:, simulated]
            straight = np.einsum("nij,pni->pnj", across, at).reshape(len(moves), -1)
            return (factor * slope * straight / self._sigma).T

        return Linearised(factor * bent, along, np.zeros((len(bent), 0)), self._independent)


class Outline:
    """The drape's outline seen from above: its distance from the axis, azimuth by azimuth.

    Args:
        faces: (F, 3) of the simulated mesh.
        target: (A,) m, outermost distance of the captured hem at A equal azimuths from the x axis
            towards y, see :func:`outline`.
        sigma, limit, independent: as for :class:`Chamfer`.
    """

    nuisances = ()
    start = scale = np.zeros(0)

    def __init__(
        self, faces: np.ndarray, target: np.ndarray, *, sigma: float = 1e-3, limit: float = 5.0,
        independent: float = 30.0,
    ) -> None:
        self._border, self._target = border_edges(faces), target
        self._sigma, self._limit, self._independent = sigma, limit, independent
        self._factor = math.sqrt(independent / len(target))

    def residuals(self, positions: np.ndarray, nuisance: np.ndarray) -> np.ndarray:
        """Residuals (A,)."""
        return self.linearised(positions, nuisance).residuals

    def linearised(self, positions: np.ndarray, nuisance: np.ndarray) -> Linearised:
        """The same with derivatives."""
        radius, edge, share = outline(positions, self._border, len(self._target))
        plain = np.where(edge >= 0, radius - self._target, 0.0) / self._sigma
        bent, slope = huber(plain, self._limit)
        ends = self._border[edge]
        span = positions[ends[:, 1], :2] - positions[ends[:, 0], :2]
        normal = np.column_stack([span[:, 1], -span[:, 0]])
        rays = _rays(len(self._target))
        towards = np.where(edge >= 0, (normal * rays).sum(1), np.inf)

        def along(moves: np.ndarray) -> np.ndarray:
            first, second = moves[:, ends[:, 0], :2], moves[:, ends[:, 1], :2]
            at = (1 - share)[:, None] * first + share[:, None] * second
            return (self._factor * slope * (normal * at).sum(-1) / towards / self._sigma).T

        return Linearised(self._factor * bent, along, np.zeros((len(bent), 0)), self._independent)


class Placed:
    """An objective whose scan may be turned about the vertical and shifted, all unknown.

    Adds the nuisances ``turn`` (rad), ``shift_x`` and ``shift_y`` (m), by which the simulated drape
    is moved onto the scan, turned first.

    Args:
        objective: without nuisances, on the scan's axes.
        turn, shift: first values.
    """

    nuisances = ("turn", "shift_x", "shift_y")

    def __init__(
        self, objective: Objective, *, turn: float = 0.0, shift: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        self._objective = objective
        self.start = np.array([turn, *shift])
        self.scale = np.array([0.05, 2e-3, 2e-3])

    def residuals(self, positions: np.ndarray, nuisance: np.ndarray) -> np.ndarray:
        """Residuals (N,)."""
        return self._objective.residuals(_move(positions, nuisance), np.zeros(0))

    def linearised(self, positions: np.ndarray, nuisance: np.ndarray) -> Linearised:
        """The same with derivatives."""
        inner = self._objective.linearised(_move(positions, nuisance), np.zeros(0))
        turned = positions @ rotation(nuisance[0]).T
        own = np.zeros((3, *positions.shape))
        own[0, :, 0], own[0, :, 1] = -turned[:, 1], turned[:, 0]
        own[1, :, 0] = own[2, :, 1] = 1.0
        return Linearised(inner.residuals,
                          lambda moves: inner.along(moves @ rotation(nuisance[0]).T),
                          inner.along(own))


def outline(
    positions: np.ndarray, border: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Outermost distance of a hem from the axis, (count,) m, at equal azimuths.

    Args:
        positions: (V, 3) m. border: (E, 2) vertices of its edges. count: azimuths.

    Returns:
        Distances, the edges (count,) that are met there, -1 for none (the distance is then 0), and
        how far along them (count,), from 0 to 1.
    """
    first, second = positions[border[:, 0], :2], positions[border[:, 1], :2]
    span = second - first
    rays = _rays(count)
    along_ray = span[:, 0] * rays[:, 1, None] - span[:, 1] * rays[:, 0, None]  # (A, E)
    offset = first[:, 0] * rays[:, 1, None] - first[:, 1] * rays[:, 0, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = -offset / along_ray
    share = np.where((share >= 0) & (share <= 1), share, np.nan)
    distance = (rays @ first.T) + share * (rays @ span.T)
    distance = np.where(distance > 0, distance, -np.inf)
    edge = np.nanargmax(np.where(np.isnan(distance), -np.inf, distance), axis=1)
    rows = np.arange(count)
    met = np.isfinite(distance[rows, edge])
    return (np.where(met, distance[rows, edge], 0.0), np.where(met, edge, -1),
            np.where(met, share[rows, edge], 0.0))


def border_edges(faces: np.ndarray) -> np.ndarray:
    """(E, 2) edges of a mesh's border."""
    edges, count = edges_of(faces)
    return edges[count == 1]


def _rays(count: int) -> np.ndarray:
    azimuth = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.column_stack([np.cos(azimuth), np.sin(azimuth)])


def rotation(turn: float) -> np.ndarray:
    """(3, 3), by ``turn``, rad, about the vertical."""
    c, s = math.cos(turn), math.sin(turn)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _move(positions: np.ndarray, nuisance: np.ndarray) -> np.ndarray:
    return positions @ rotation(nuisance[0]).T + np.array([nuisance[1], nuisance[2], 0.0])



def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-30)
