"""Initial shapes of a drape. Which one decides the folds the cloth falls into (section 5.2.1)."""

import numpy as np
from scipy.interpolate import CloughTocher2DInterpolator

from sim.errors import InputError
from sim.scene import Rig

STARTS = ("sine", "fold")


def initial_positions(
    rest: np.ndarray, *, rig: Rig, start: str, rng: np.random.Generator
) -> np.ndarray:
    """Positions (V, 3), m, of rest points (V, 2); flat on the plate, see :data:`STARTS`.

    Raises:
        InputError: unknown start.
    """
    if start == "sine":
        flat = np.column_stack([rest, np.zeros(len(rest))])
        return flat + _waves(rest, rig, rng, amplitude=5e-3)
    if start == "fold":
        return _fold(rest, rig, rng) + _waves(rest, rig, rng, amplitude=1e-3)
    raise InputError(f"unknown start '{start}'; choose from {', '.join(STARTS)}")


def _waves(
    rest: np.ndarray, rig: Rig, rng: np.random.Generator, *, amplitude: float, count: int = 8
) -> np.ndarray:
    """Vertical displacements (V, 3): random plane sine waves, fading out towards the rim."""
    angle = rng.uniform(0, 2 * np.pi, count)
    wavelength = rng.uniform(0.06, 0.3, count)
    phase = rng.uniform(0, 2 * np.pi, count)
    direction = np.stack([np.cos(angle), np.sin(angle)])
    waves = np.sin(2 * np.pi * (rest @ direction) / wavelength + phase).sum(1) / np.sqrt(count)
    outside = np.maximum(np.linalg.norm(rest, axis=1) - rig.plate_radius, 0.0)
    fade = 1.0 - np.exp(-outside / (0.2 * rig.specimen_size / 2))
    height = amplitude * fade * waves
    return np.column_stack([np.zeros_like(rest), height])


def _fold(rest: np.ndarray, rig: Rig, rng: np.random.Generator) -> np.ndarray:
    """The specimen bent down on both sides of the plate, along a random direction.

    Isometric: beyond the plate, the cloth follows a circular arc of up to a quarter turn and
    hangs straight from there, so that it starts without stretch and without self-intersection.
    """
    angle = rng.uniform(0, np.pi)
    bend = 0.02 * rng.uniform(0.7, 1.5)  # m, radius of the arc
    turn = rng.uniform(0.5, 0.95) * np.pi / 2
    across = np.array([np.cos(angle), np.sin(angle)])
    along = np.array([-across[1], across[0]])
    s, t = rest @ across, rest @ along
    arc = np.maximum(np.abs(s) - rig.plate_radius, 0.0)
    theta = np.minimum(arc / bend, turn)
    straight = np.maximum(arc - bend * turn, 0.0)
    reach = np.minimum(np.abs(s), rig.plate_radius) + bend * np.sin(theta)
    reach += straight * np.cos(turn)
    drop = bend * (1 - np.cos(theta)) + straight * np.sin(turn)
    plane = (np.sign(s) * reach)[:, None] * across + t[:, None] * along
    return np.column_stack([plane, -drop])


def interpolate_positions(
    coarse_rest: np.ndarray, coarse_positions: np.ndarray, rest: np.ndarray
) -> np.ndarray:
    """Positions (V, 3) at rest points (V, 2) of a smooth surface through coarser vertices.

    ``coarse_rest`` (W, 2) and ``coarse_positions`` (W, 3) cover the same specimen.
    """
    surface = CloughTocher2DInterpolator(coarse_rest, coarse_positions)
    centre = (coarse_rest.min(0) + coarse_rest.max(0)) / 2
    inward = centre + (rest - centre) * (1 - 1e-9)  # keeps the border inside the hull
    return surface(inward)
