"""Figures that describe a drape."""

import numba
import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

from sim.energies.membrane import CorotationalMembrane
from sim.mesh import Mesh
from sim.scene import Rig

_PIXEL = 5e-4  # m, of the top view that is measured
_LEAST_FOLD = 3e-3  # m, depth of the shallowest fold that is counted


def drape_coefficient(positions: np.ndarray, faces: np.ndarray, rig: Rig) -> float:
    """Share of the overhanging cloth that is seen from above (BS 5058, ISO 9073-9).

    (projected area - plate area) / (specimen area - plate area), of positions (V, 3) m and
    faces (F, 3): 1 for a rigid specimen, 0 for one that hangs straight down. Good to 0.3 %.
    """
    plate = np.pi * rig.plate_radius**2
    return (projected_area(positions, faces) - plate) / (rig.specimen_size**2 - plate)


def projected_area(positions: np.ndarray, faces: np.ndarray) -> float:
    """Area of the shadow straight below, m², of positions (V, 3) m and faces (F, 3)."""
    corner = positions[:, :2].min(0) - _PIXEL
    pixels = (positions[:, :2] - corner) / _PIXEL
    shape = np.ceil(pixels.max(0)).astype(int) + 2
    return _covered(pixels[faces], shape[0], shape[1]) * _PIXEL**2


def fold_count(positions: np.ndarray, rest: np.ndarray, rig: Rig) -> int:
    """Number of folds: how often the cloth's distance from the axis peaks around the specimen.

    Followed along the material circle at 90 % of the specimen's inradius, around its centre,
    peaks of less than 3 mm left out. positions (V, 3) and rest (V, 2) in m.
    """
    angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    circle = 0.45 * rig.specimen_size * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    centre = (rest.min(axis=0) + rest.max(axis=0)) / 2
    around = LinearNDInterpolator(rest, positions[:, :2])(centre + circle)
    radius = gaussian_filter1d(np.linalg.norm(around, axis=1), 6.0, mode="wrap")
    radius = np.roll(radius, -int(radius.argmin()))  # no peak at the seam
    peaks, _ = find_peaks(np.append(radius, radius[0]), prominence=_LEAST_FOLD)
    return len(peaks)


def maximum_stretch(
    positions: np.ndarray, rest: np.ndarray, faces: np.ndarray, held: np.ndarray
) -> float:
    """Largest strain in any triangle that is not held, 0.01 for 1 %.

    positions (V, 3) m, rest (V, 2) m, faces (F, 3), held (V,) bool.
    """
    mesh = Mesh(rest=rest, faces=faces)
    membrane = CorotationalMembrane(mesh, ~held[faces].all(axis=1))
    return float(membrane.stretches(positions.ravel()).max() - 1.0)


@numba.njit(cache=True)
def _covered(triangles, width, height):
    """Number of unit pixels whose centre lies in a triangle (N, 3, 2) of either orientation."""
    seen = np.zeros((width, height), dtype=np.bool_)
    for t in range(len(triangles)):
        (ax, ay), (bx, by), (cx, cy) = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        twice = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if twice == 0.0:
            continue
        for i in range(int(min(ax, bx, cx)), int(max(ax, bx, cx)) + 1):
            for j in range(int(min(ay, by, cy)), int(max(ay, by, cy)) + 1):
                x, y = i + 0.5, j + 0.5
                u = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / twice
                v = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / twice
                if u >= 0.0 and v >= 0.0 and u + v <= 1.0:
                    seen[i, j] = True
    return seen.sum()
