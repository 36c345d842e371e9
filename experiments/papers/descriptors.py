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

import numpy as np
from scipy import sparse
from scipy.spatial import Delaunay

from common.types import Points, RestPoints
from common.workers import one_blas_thread
from drapenet.refine.objective import Linearised
from sim.rig import Rig

_MIN_POWER = 1e-9  # m², added to powers for a smooth square root; (0.03 mm)²


RINGS, POINTS, HARMONICS = 6, 144, 24
"""Circles, evenly spaced from the rim to the nearest border of the specimen; points of a circle;
harmonics of its spectrum, without the mean."""
GRID = 48  # points along a side of the grid
SIGMA = 2e-3  # m, norm of the difference between descriptors of drapes of one fabric


class RingSpectrum:
    """Amplitudes of distance from the axis and of height along material circles.

    Invariant to a rotation of drape and specimen about the axis, and to reflection.

    Args:
        blur: standard deviation, in harmonics, of the smoothing of powers; 0 for none.
    """

    def __init__(self, rest: RestPoints, rig: Rig, *, blur: float = 1.0) -> None:
        middle = (rest.min(axis=0) + rest.max(axis=0)) / 2
        outer = rig.specimen_size / 2 - np.abs(middle).max()
        angle = np.linspace(0, 2 * np.pi, POINTS, endpoint=False)
        radius = np.linspace(rig.plate_radius, 0.995 * outer, RINGS + 1)[1:]
        circles = radius[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        self._interpolate = interpolation(rest, circles.reshape(-1, 2))
        self._blur = _blur(HARMONICS + 1, blur)
        self._weight = np.sqrt(np.r_[1.0, np.full(HARMONICS, 2.0)] / RINGS)

    def describe(self, positions: Points) -> np.ndarray:
        """The descriptor (D,) of a drape."""
        points = self._interpolate @ positions
        signals = np.stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]])
        return self._amplitudes(self._transform(signals))[0].ravel()

    def derivatives(self, positions: Points, moves: np.ndarray) -> np.ndarray:
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
        return np.fft.rfft(signals.reshape(2, RINGS, POINTS))[..., : HARMONICS + 1] / POINTS

    def _amplitudes(self, coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        powers = np.abs(coefficients) ** 2 @ self._blur.T + _MIN_POWER
        return np.sqrt(powers) * self._weight, powers


class GridSpectrum:
    """Amplitudes of the displacements' two-dimensional Fourier transform (Larionov et al., Eq. 9);
    the grid of a disc is its inscribed square."""

    def __init__(self, rest: RestPoints, rig: Rig) -> None:
        middle = (rest.min(axis=0) + rest.max(axis=0)) / 2
        half = 0.499 * rig.specimen_size / (np.sqrt(2) if rig.specimen == "disc" else 1.0)
        axis = np.linspace(-half, half, GRID)
        grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2) + middle
        self._interpolate = interpolation(rest, grid)
        self._flat = np.column_stack([grid, np.zeros(len(grid))])

    def describe(self, positions: Points) -> np.ndarray:
        """The descriptor (D,) of a drape."""
        coefficients = self._transform(self._interpolate @ positions - self._flat)
        return np.sqrt(np.abs(coefficients) ** 2 + _MIN_POWER).ravel()

    def derivatives(self, positions: Points, moves: np.ndarray) -> np.ndarray:
        """(D, P) derivatives along moves (P, V, 3)."""
        here = self._transform(self._interpolate @ positions - self._flat)
        size = np.sqrt(np.abs(here) ** 2 + _MIN_POWER)
        columns = [((here.conj() * self._transform(self._interpolate @ move)).real / size).ravel()
                   for move in moves]
        return np.stack(columns, axis=1)

    def _transform(self, values: np.ndarray) -> np.ndarray:
        return np.fft.fft2(values.reshape(GRID, GRID, 3), axes=(0, 1)) / GRID**2


class DescriptorObjective:
    """Objective: difference of a drape's descriptor from that of a captured one."""

    nuisances = ()
    start = scale = deviation = np.zeros(0)

    def __init__(self, descriptor: GridSpectrum | RingSpectrum, target: np.ndarray) -> None:
        self._descriptor, self._target = descriptor, target

    def residuals(self, positions: np.ndarray, nuisance: np.ndarray) -> np.ndarray:
        """Residuals (D,)."""
        return (self._descriptor.describe(positions) - self._target) / SIGMA

    def linearised(self, positions: np.ndarray, nuisance: np.ndarray) -> Linearised:
        """Residuals with derivatives."""
        residuals = self.residuals(positions, nuisance)

        def derivatives(moves: np.ndarray) -> np.ndarray:
            return self._descriptor.derivatives(positions, moves) / SIGMA

        return Linearised(residuals, derivatives, np.zeros((len(residuals), 0)), len(residuals))


@one_blas_thread
def interpolation(rest: RestPoints, points: RestPoints) -> sparse.csr_matrix:
    """(N, V) matrix from values at rest points to linear interpolants at ``points``.

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
