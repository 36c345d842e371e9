"""Random surfaces of cloth, tables and things for synthetic photographs.

A texture maps places (N, 2), m, to albedo (N, 3), 0 to 1.
"""

from collections.abc import Callable

import cv2
import numpy as np

Texture = Callable[[np.ndarray], np.ndarray]

PATTERNS = ("plain", "stripes", "bands", "checks", "dots", "weave", "mottled", "print", "patches")
_LEAST, _MOST = 0.015, 0.93  # albedo
_SIDE = 256  # of a tile of noise
_BLACK, _WHITE = 0.15, 0.35  # quantiles of draws that are black, and black or white
_ROWS = 32_000  # of a picture that OpenCV samples


def cloth(rng: np.random.Generator) -> tuple[str, Texture]:
    """A pattern of :data:`PATTERNS`, and cloth with it, of colours, yarns and shades of its own."""
    pattern = str(rng.choice(PATTERNS))
    colours = [colour(rng)]
    for _ in range(3):
        near = colours[0] * np.exp(rng.normal(0, 0.3, 3))
        colours.append(near if rng.random() < 0.3 else colour(rng))
    period = float(np.exp(rng.uniform(np.log(4e-3), np.log(0.06))))
    shares = _shares(pattern, period, rng)
    yarn = _noise(rng, extent=rng.uniform(0.06, 0.25), fall=rng.uniform(0, 1.2))
    depth = rng.choice([0.0, 0.05, 0.15, 0.4]) * rng.uniform(0.3, 1.0)

    def texture(places: np.ndarray) -> np.ndarray:
        albedo = colours[0] * np.ones((len(places), 1))
        for share, other in zip(shares(places), colours[1:], strict=False):
            albedo = albedo + share[:, None] * (other - albedo)
        return np.clip(albedo * np.exp(depth * yarn(places))[:, None], _LEAST, _MOST)

    return pattern, texture


def inside(rest: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Distances (N,), m, of places (N, 2) from the cut edge of a flat specimen (V, 2)."""
    half = np.abs(rest).max(axis=0)
    if float(np.hypot(*rest.T).max()) < 1.05 * half.max():
        return lambda places: half.max() - np.hypot(*places.T)
    return lambda places: (half - np.abs(places)).min(axis=1)


def bordered(surface: Texture, rest: np.ndarray, wide: float, edge: np.ndarray) -> Texture:
    """Cloth whose border, ``wide`` m of a flat specimen (V, 2), has another colour (3,)."""
    far = inside(rest)
    return lambda places: np.where((far(places) < wide)[:, None], edge, surface(places))


def _shares(pattern: str, period: float, rng: np.random.Generator
            ) -> Callable[[np.ndarray], list[np.ndarray]]:
    """How much (N,) of each further colour a pattern has at places (N, 2)."""
    turn = rng.uniform(0, np.pi) if rng.random() < 0.3 else 0.0
    axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) / period
    widths = rng.uniform(0.08, 0.6, 3)
    fields = [_noise(rng, extent=period * rng.uniform(4, 20), fall=rng.uniform(1.2, 2.5))
              for _ in range(3)]
    limits = rng.uniform(-0.3, 1.5, 3)
    edges, bands = np.sort(rng.random(6)), rng.random((3, 7)) < 0.4
    across = rng.random() < 0.4

    def shares(places: np.ndarray) -> list[np.ndarray]:
        x, y = (places @ axes).T
        if pattern == "stripes":
            return [x % 1 < widths[0], (x + 0.5) % 1 < 0.3 * widths[1]]
        if pattern == "bands":  # broad and uneven, of a tartan if they cross
            ways = [bands[:, np.searchsorted(edges, 0.1 * way % 1)] for way in (x, y)]
            return list(0.5 * (ways[0] + 1.0 * ways[1]) if across else ways[0])
        if pattern == "checks":
            return [0.5 * (x % 1 < widths[0]) + 0.5 * (y % 1 < widths[0]),
                    (x % 2 < 0.1) | (y % 2 < 0.1)]
        if pattern == "dots":
            return [np.hypot(x % 1 - 0.5, y % 1 - 0.5) < 0.7 * widths[0]]
        if pattern == "weave":
            return [0.2 + 0.2 * np.sign(np.sin(40 * x) * np.sin(40 * y))]
        if pattern == "mottled":
            return [1 / (1 + np.exp(-2 * field(places))) for field in fields[:2]]
        if pattern == "print":
            return [field(places) > limit for field, limit in zip(fields, limits, strict=True)]
        if pattern == "patches":  # diamonds and figures, far apart
            return [np.abs(x % 4 - 2) + widths[1] * np.abs((y + np.floor(x / 4)) % 3 - 1.5)
                    < widths[0]]
        return []

    return lambda places: [np.asarray(share, float) for share in shares(places)]


def table(rng: np.random.Generator) -> Texture:
    """A table: plain, of wood, of stone, tiled, or with a cloth or lines on it."""
    kind = rng.choice(["plain", "wood", "stone", "tiles", "cloth"], p=[0.25, 0.25, 0.2, 0.15, 0.15])
    if kind == "cloth":
        return cloth(rng)[1]
    tone = colour(rng)
    stretch = np.array([1.0, 1.0 / rng.uniform(4, 20)]) if kind == "wood" else np.ones(2)
    coarse = _noise(rng, extent=rng.uniform(0.2, 1.5), fall=rng.uniform(1.0, 2.2))
    fine = _noise(rng, extent=rng.uniform(0.1, 0.4), fall=rng.uniform(0, 1))
    depth = rng.uniform(0.05, 0.4) if kind in ("wood", "stone") else rng.uniform(0, 0.06)
    tint, joint = np.exp(rng.normal(0, 0.3, 3)), rng.uniform(0.01, 0.15)

    def texture(places: np.ndarray) -> np.ndarray:
        shade = depth * coarse(places * stretch) + 0.3 * depth * fine(places * stretch)
        albedo = tone * np.exp(shade[:, None] * tint)
        if kind == "tiles":
            lines = (np.abs(places / joint % 1 - 0.5) > 0.48).any(axis=1)
            albedo[lines] = tone * tint
        return np.clip(albedo, _LEAST, _MOST)

    return texture


def plain(albedo: np.ndarray | float, rng: np.random.Generator, depth: float = 0.1) -> Texture:
    """One colour, a little uneven."""
    uneven = _noise(rng, extent=0.3, fall=1.5)
    return lambda places: np.clip(
        albedo * np.exp(depth * uneven(places))[:, None] * np.ones(3), _LEAST, _MOST)


def of_picture(albedo: np.ndarray, pixel: float) -> Texture:
    """The surface of a picture (H, W, 3), of a size of a ``pixel``, m, mirrored at its borders."""
    height, width = albedo.shape[:2]

    def texture(places: np.ndarray) -> np.ndarray:
        columns, rows = (np.abs((along / pixel + side) % (2 * side) - side).astype(int).clip(
            0, side - 1) for along, side in zip(places.T, (width, height), strict=True))
        return np.clip(albedo[rows, columns], _LEAST, _MOST)

    return texture


def colour(rng: np.random.Generator) -> np.ndarray:
    """Albedo (3,): every seventh is black, every fifth white, the rest of any lightness."""
    draw = rng.random()
    if draw < _BLACK:
        light = rng.uniform(_LEAST, 0.05)
    else:
        light = rng.uniform(0.6, 0.9) if draw < _WHITE else np.exp(rng.uniform(-3.2, -0.2))
    tints = 0.05 if draw < _WHITE and rng.random() < 0.7 else rng.choice([0.0, 0.1, 0.35, 0.7])
    return np.clip(light * np.exp(rng.normal(0, tints, 3)), _LEAST, _MOST)


def _noise(rng: np.random.Generator, *, extent: float, fall: float
           ) -> Callable[[np.ndarray], np.ndarray]:
    """Noise of deviation 1 at places (N, 2), that repeats after an ``extent``, m, and whose
    amplitudes fall with the wave number to the power ``fall``."""
    waves = np.hypot(np.fft.fftfreq(_SIDE)[:, None], np.fft.rfftfreq(_SIDE)) * _SIDE
    waves[0, 0] = np.inf
    tile = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((_SIDE, _SIDE))) * waves**-fall)
    tile = (tile / tile.std()).astype(np.float32)

    def noise(places: np.ndarray) -> np.ndarray:
        columns, rows = (places.T * (_SIDE / extent)).astype(np.float32) % _SIDE
        if not len(rows):
            return np.zeros(0, np.float32)
        rest = np.zeros(-len(rows) % _ROWS, np.float32)  # OpenCV's pictures are not as wide as long
        across, down = (np.append(one, rest).reshape(-1, _ROWS) for one in (columns, rows))
        found = cv2.remap(tile, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        return found.ravel()[: len(rows)]

    return noise
