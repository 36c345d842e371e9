"""Descriptors of drapes that are invariant to the phase of the folds.

Drapes of one fabric have many fold configurations with large displacements between them. Larionov
et al. (Eq. 9) use the amplitudes of the Fourier transform of the vertices, which are invariant to a
shift of the folds. :class:`GridSpectrum` is their descriptor, on a square grid of material points.
Around a plate the folds are radial and a shift is a rotation; therefore :class:`RingSpectrum`
transforms along circles around the plate. An additional fold moves the amplitude to the next
harmonic; powers are therefore smoothed over harmonics.

Descriptors are in metres, so that the norm of their difference is comparable to a root mean square
displacement.
"""

from typing import Protocol

import numpy as np
from scipy import sparse
from scipy.spatial import Delaunay

from common.errors import InputError
from common.workers import one_blas_thread
from drapenet.refine.objective import Linearised
from sim.rig import Rig

_MIN_POWER = 1e-9  # m², added to powers for a smooth square root; (0.03 mm)²


class Descriptor(Protocol):
    """Descriptor (D,), m, of vertices at positions (V, 3), m, and its derivatives."""

    def describe(self, positions: np.ndarray) -> np.ndarray: ...

    def derivatives(self, positions: np.ndarray, moves: np.ndarray) -> np.ndarray:
        """(D, P) derivatives along moves (P, V, 3) of the vertices."""


class RingSpectrum:
    """Amplitudes of distance from the axis and of height along material circles.

    Invariant to a rotation of drape and specimen about the axis, and to reflection.

    Args:
        rest: (V, 2) m, origin on the plate's axis.
        rig: with a plate.
        rings: number of circles, evenly spaced from the rim to the nearest border of the specimen.
        points: per circle. harmonics: number of harmonics, without the mean.
        blur: standard deviation, in harmonics, of the smoothing of powers; 0 for none.

    Raises:
        InputError: a rig without plate.
    """

    def __init__(
        self, rest: np.ndarray, rig: Rig, *, rings: int = 6, points: int = 144,
        harmonics: int = 24, blur: float = 1.0,
    ) -> None:
        if not rig.has_plate:
            raise InputError(f"rig={rig.name} has no plate, so folds cannot be counted; choose "
                             "another rig")
        middle = (rest.min(axis=0) + rest.max(axis=0)) / 2
        outer = rig.specimen_size / 2 - np.abs(middle).max()
        angle = np.linspace(0, 2 * np.pi, points, endpoint=False)
        radius = np.linspace(rig.plate_radius, 0.995 * outer, rings + 1)[1:]
        circles = radius[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        self._interpolate = interpolation(rest, circles.reshape(-1, 2))
        self._shape = rings, points
        self._count = harmonics + 1
        self._blur = _blur(self._count, blur)
        self._weight = np.sqrt(np.r_[1.0, np.full(harmonics, 2.0)] / rings)

    def describe(self, positions: np.ndarray) -> np.ndarray:
        """(D,) of positions (V, 3)."""
        points = self._interpolate @ positions
        signals = np.stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]])
        return self._amplitudes(self._transform(signals))[0].ravel()

    def derivatives(self, positions: np.ndarray, moves: np.ndarray) -> np.ndarray:
        """(D, P) derivatives along moves (P, V, 3)."""
        points = self._interpolate @ positions
        radius = np.hypot(points[:, 0], points[:, 1])
        outward = points[:, :2] / radius[:, None]
        signals = self._transform(np.stack([radius, points[:, 2]]))
        _, powers = self._amplitudes(signals)
        columns = []
        for move in moves:
            by = self._interpolate @ move
            change = self._transform(np.stack([(outward * by[:, :2]).sum(1), by[:, 2]]))
            power = 2 * (signals.conj() * change).real @ self._blur.T
            columns.append((0.5 * power / np.sqrt(powers) * self._weight).ravel())
        return np.stack(columns, axis=1)

    def _transform(self, signals: np.ndarray) -> np.ndarray:
        """Coefficients (2, rings, harmonics + 1) of signals (2, rings * points)."""
        rings, points = self._shape
        return np.fft.rfft(signals.reshape(2, rings, points))[..., : self._count] / points

    def _amplitudes(self, coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        powers = np.abs(coefficients) ** 2 @ self._blur.T + _MIN_POWER
        return np.sqrt(powers) * self._weight, powers


class GridSpectrum:
    """Amplitudes of the displacements' two-dimensional Fourier transform (Larionov et al., Eq. 9).

    Args:
        rest: (V, 2) m. rig: of the specimen; the grid of a disc is its inscribed square.
        points: along a side of the grid.
    """

    def __init__(self, rest: np.ndarray, rig: Rig, *, points: int = 48) -> None:
        middle = (rest.min(axis=0) + rest.max(axis=0)) / 2
        half = 0.499 * rig.specimen_size / (np.sqrt(2) if rig.specimen == "disc" else 1.0)
        axis = np.linspace(-half, half, points)
        grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2) + middle
        self._interpolate = interpolation(rest, grid)
        self._flat = np.column_stack([grid, np.zeros(len(grid))])
        self._points = points

    def describe(self, positions: np.ndarray) -> np.ndarray:
        """(D,) of positions (V, 3)."""
        coefficients = self._transform(self._interpolate @ positions - self._flat)
        return np.sqrt(np.abs(coefficients) ** 2 + _MIN_POWER).ravel()

    def derivatives(self, positions: np.ndarray, moves: np.ndarray) -> np.ndarray:
        """(D, P) derivatives along moves (P, V, 3)."""
        here = self._transform(self._interpolate @ positions - self._flat)
        size = np.sqrt(np.abs(here) ** 2 + _MIN_POWER)
        columns = [((here.conj() * self._transform(self._interpolate @ move)).real / size).ravel()
                   for move in moves]
        return np.stack(columns, axis=1)

    def _transform(self, values: np.ndarray) -> np.ndarray:
        n = self._points
        return np.fft.fft2(values.reshape(n, n, 3), axes=(0, 1)) / n**2


class DescriptorObjective:
    """Objective: difference between the descriptors of a drape and of a captured one.

    Args:
        descriptor: of the simulated mesh.
        target: (D,) m, descriptor of the captured drape.
        sigma: m, norm of the difference between descriptors of drapes of one fabric.
    """

    nuisances = ()
    start = scale = deviation = np.zeros(0)

    def __init__(self, descriptor: Descriptor, target: np.ndarray, *, sigma: float = 2e-3) -> None:
        self._descriptor, self._target, self._sigma = descriptor, target, sigma

    def residuals(self, positions: np.ndarray, nuisance: np.ndarray) -> np.ndarray:
        """Residuals (D,)."""
        return (self._descriptor.describe(positions) - self._target) / self._sigma

    def linearised(self, positions: np.ndarray, nuisance: np.ndarray) -> Linearised:
        """Residuals with derivatives."""
        residuals = self.residuals(positions, nuisance)

        def derivatives(moves: np.ndarray) -> np.ndarray:
            return self._descriptor.derivatives(positions, moves) / self._sigma

        return Linearised(residuals, derivatives, np.zeros((len(residuals), 0)), len(residuals))


@one_blas_thread
def interpolation(rest: np.ndarray, points: np.ndarray) -> sparse.csr_matrix:
    """(N, V) matrix from values at rest points (V, 2) to linear interpolants at points (N, 2).

    Points beyond the border have the values of the border point on the line to the centre.
    """
    triangulation = Delaunay(rest)
    middle = (rest.min(axis=0) + rest.max(axis=0)) / 2
    inside = points.copy()
    for _ in range(200):
        simplex = triangulation.find_simplex(inside, tol=1e-9)
        lost = simplex < 0
        if not lost.any():
            break
        inside[lost] = middle + (inside[lost] - middle) * 0.999
    transform = triangulation.transform[simplex]
    two = np.einsum("nij,nj->ni", transform[:, :2], inside - transform[:, 2])
    shares = np.column_stack([two, 1 - two.sum(axis=1)])
    rows = np.repeat(np.arange(len(points)), 3)
    return sparse.csr_matrix(
        (shares.ravel(), (rows, triangulation.simplices[simplex].ravel())),
        shape=(len(points), len(rest)))


def _blur(count: int, width: float) -> np.ndarray:
    """(count, count) matrix that smooths powers over harmonics, except the mean, harmonic 0."""
    if width <= 0:
        return np.eye(count)
    step = np.arange(count)[:, None] - np.arange(count)
    matrix = np.exp(-0.5 * (step / width) ** 2)
    matrix[0, 1:] = matrix[1:, 0] = 0.0
    return matrix / matrix.sum(axis=0)  # preserves the total power
