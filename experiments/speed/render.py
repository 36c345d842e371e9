"""Views per second of the rasteriser and of ray casting, and the differences between them.

Four views each of drapes of fabrics from the bundled prior, on one core. The renderers are timed in
turn, several times, and the shortest times are reported, because other processes may interfere.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_erosion

from common.errors import InputError
from common.types import Faces, Points, Views
from data.fabrics.fabrics import fabric_from_theta
from data.fabrics.prior import load_prior, sample_admissible
from data.render.cameras import QUARTERS, VIEWS, Camera
from data.render.raster import rasterise
from data.render.rays import DepthRenderer
from data.render.setups import Setups
from experiments.result import Config, Result, rms
from sim.draping import drape
from sim.rig import SQUARE_RIG

SIZES = ((240, 180), (120, 90))  # pixels; that of captures, and half of it
SEED = 4


@dataclass(frozen=True)
class Shot:
    """A drape, its camera, and the direction of the warp in the first view, rad."""

    positions: Points
    faces: Faces
    camera: Camera
    orientation: float

    def resized(self, width: int, height: int) -> "Shot":
        """The same at another picture size."""
        return Shot(self.positions, self.faces, self.camera.resized(width, height),
                    self.orientation)

    def raster(self) -> Views:
        """Four views by the rasteriser."""
        return rasterise(self.positions, self.faces, self.camera,
                         self.orientation + np.array(QUARTERS))

    def rays(self, renderer: DepthRenderer | None = None) -> Views:
        """Four views by ray casting; without a ``renderer`` the search tree is built first."""
        renderer = renderer or DepthRenderer(self.positions, self.faces)
        return renderer.views(self.camera, self.orientation)


def make_shots(count: int, edge: float) -> list[Shot]:
    """Drapes of ``count`` fabrics from the prior, with edges of ``edge``, m, at the rim."""
    rng, prior, setups = np.random.default_rng(SEED), load_prior("gaussian"), Setups.load()
    shots = []
    for _ in range(count):
        shape = drape(fabric_from_theta(sample_admissible(prior, rng)[0]), edge=edge)
        shots.append(Shot(shape.positions, shape.faces, setups.camera(rng, SQUARE_RIG),
                          rng.uniform(0, 2 * np.pi)))
    return shots


def agreement(shots: list[Shot]) -> dict[str, float]:
    """Differences between rasteriser and ray casting; depths, mm, except at silhouettes."""
    views, rays = (np.stack(renderings) for renderings in
                   zip(*((shot.raster(), shot.rays()) for shot in shots), strict=True))
    inside = binary_erosion((views > 0) & (rays > 0), np.ones((1, 1, 3, 3), dtype=bool))
    error = 1e3 * np.abs(views - rays.astype(float))[inside]
    return {"cloth_pixels": int((rays > 0).sum()), "interior_pixels": int(inside.sum()),
            "silhouette_pixels_that_differ": int(((views > 0) != (rays > 0)).sum()),
            "rms_mm": rms(error), "largest_mm": float(error.max())}


def shortest_times(work: dict[str, Callable], repeats: int) -> dict[str, float]:
    """Shortest time of each function, s, called in turn after a warm-up call."""
    seconds = {name: [] for name in work}
    for turn in range(repeats + 1):
        for name, function in work.items():
            began = time.perf_counter()
            function()
            if turn:
                seconds[name].append(time.perf_counter() - began)
    return {name: min(values) for name, values in seconds.items()}


def view_rates(shots: list[Shot], repeats: int) -> dict[str, float]:
    """Views per second of each renderer."""
    renderers = [DepthRenderer(shot.positions, shot.faces) for shot in shots]
    seconds = shortest_times({
        "rays": lambda: [shot.rays(renderer)
                         for shot, renderer in zip(shots, renderers, strict=True)],
        "rays, with building the tree": lambda: [shot.rays() for shot in shots],
        "rasteriser": lambda: [shot.raster() for shot in shots],
    }, repeats)
    return {name: len(shots) * VIEWS / value for name, value in seconds.items()}


def run(config: Config) -> Result:
    """Time both renderers."""
    for key in ("drapes", "timed", "repeats"):
        if config[key] < 1:
            raise InputError(f"{key}={config[key]} must be at least 1")
    shots = make_shots(config["drapes"], 1e-3 * config["edge_mm"])
    rates = {f"{w}x{h}": view_rates([shot.resized(w, h) for shot in shots[: config["timed"]]],
                                    config["repeats"]) for w, h in SIZES}
    differences = agreement(shots)
    return Result({"agreement": {"rasteriser": differences}, "views_per_second": rates})
