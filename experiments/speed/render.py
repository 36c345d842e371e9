"""Views per second of the rasteriser and of ray casting, and the differences between them.

Four views of each of several drapes of fabrics from the bundled prior. The renderers are timed in
turn, several times, and the shortest times are reported, because other processes may interfere.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import binary_erosion

from common.errors import InputError
from data.fabrics.fabrics import fabric_from_theta
from data.fabrics.prior import load_prior, sample_admissible
from data.render.cameras import Camera, CameraRig
from data.render.rasterise import camera_points, camera_tensors, rasterise_tensors, render_batch
from data.render.renderer import VIEWS, DepthRenderer
from experiments.common import Config, Result, table
from sim.drape import drape

SIZES = ((240, 180), (120, 90))  # pixels; that of captures, and half of it
SEED = 4


@dataclass(frozen=True)
class Drapes:
    """Drapes on one mesh, with a camera and four angles each.

    Attributes:
        positions: (N, V, 3) m; faces: (F, 3); angles: (N, 4) rad; cameras: one per drape.
    """

    positions: torch.Tensor
    faces: torch.Tensor
    angles: torch.Tensor
    cameras: list[Camera]

    def first(self, count: int) -> "Drapes":
        """``count`` drapes, repeated if there are fewer."""
        index = torch.arange(count) % len(self.positions)
        return Drapes(self.positions[index], self.faces, self.angles[index],
                      [self.cameras[k] for k in index.tolist()])

    def settings(self, width: int, height: int, device: str = "cpu") -> dict:
        """Arguments of :func:`data.render.rasterise.render_batch` at an image size in pixels."""
        cameras = [camera.resized(width, height) for camera in self.cameras]
        intrinsics, poses = camera_tensors(cameras, device=device)
        return {"positions": self.positions.to(device), "faces": self.faces.to(device),
                "angles": self.angles.to(device), "intrinsics": intrinsics,
                "world_to_camera": poses, "height": height, "width": width}


def make_drapes(count: int, edge: float) -> Drapes:
    """Drapes of ``count`` fabrics from the prior, with edges of ``edge``, m, at the rim."""
    rng, prior, rig = np.random.default_rng(SEED), load_prior("gaussian"), CameraRig.load()
    results = [drape(fabric_from_theta(sample_admissible(prior, rng)[0]), edge=edge)
               for _ in range(count)]
    angles = rng.uniform(0, 2 * np.pi, (count, 1)) + np.arange(VIEWS) * (np.pi / 2)
    return Drapes(torch.from_numpy(np.stack([result.positions for result in results])),
                  torch.from_numpy(results[0].faces), torch.from_numpy(angles),
                  [rig.sample(rng) for _ in results])


def ray_casters(drapes: Drapes, width: int, height: int, threads: int) -> Iterator[Callable]:
    """One function per drape that casts the rays of its four views; builds the search tree."""
    for k, camera in enumerate(drapes.cameras):
        renderer = DepthRenderer(drapes.positions[k].numpy(), drapes.faces.numpy(),
                                 threads=threads)
        camera, angles = camera.resized(width, height), drapes.angles[k].tolist()
        yield lambda r=renderer, c=camera, angles=angles: [r.view(c, angle) for angle in angles]


def agreement(drapes: Drapes, threads: int) -> dict[str, float]:
    """Differences between rasteriser and ray casting; depths, mm, except at silhouettes."""
    width, height = SIZES[0]
    views = render_batch(**drapes.settings(width, height)).numpy()
    rays = np.array([see() for see in ray_casters(drapes, width, height, threads)])
    cloth, seen = views > 0, rays > 0
    inside = binary_erosion(cloth & seen, np.ones((1, 1, 3, 3), dtype=bool))
    error = 1e3 * np.abs(views - rays.astype(float))[inside]
    return {"cloth_pixels": int(seen.sum()), "interior_pixels": int(inside.sum()),
            "silhouette_pixels_that_differ": int((cloth != seen).sum()),
            "rms_mm": float(np.sqrt(np.square(error).mean())), "largest_mm": float(error.max())}


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Limit the threads of PyTorch, which the rasteriser uses."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


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


def view_rates(drapes: Drapes, width: int, height: int, config: dict) -> dict[str, float]:
    """Views per second of each renderer at an image size in pixels."""
    part = drapes.first(config["batch"] // VIEWS)
    settings = part.settings(width, height)
    intrinsics = settings["intrinsics"].float()[:, None].expand(-1, VIEWS, -1)
    faces = settings["faces"].expand(len(part.positions), -1, -1)
    casts = list(ray_casters(part, width, height, config["threads"]))

    def tensors() -> None:
        points = camera_points(settings["positions"].float(), settings["angles"],
                               settings["world_to_camera"])
        rasterise_tensors(points, faces, intrinsics, height=height, width=width)

    work = {
        "rays": lambda: [views() for views in casts],
        "rays, with building the tree":
            lambda: [views() for views in ray_casters(part, width, height, config["threads"])],
        "rasteriser": lambda: render_batch(**settings),
        "rasteriser, PyTorch only": tensors,
    }
    with torch_threads(config["threads"]):
        rates = {name: len(part.positions) * VIEWS / value
                 for name, value in shortest_times(work, config["repeats"]).items()}
    if config["device"] == "cuda":
        many = drapes.first(config["gpu_batch"] // VIEWS).settings(width, height, "cuda")

        def on_gpu() -> None:
            render_batch(**many)
            torch.cuda.synchronize()

        seconds = shortest_times({"gpu": on_gpu}, config["repeats"])["gpu"]
        rates[f"rasteriser, GPU, {config['gpu_batch']} at once"] = config["gpu_batch"] / seconds
    return rates


def run(config: Config) -> Result:
    """Time both renderers; print the table."""
    for key, least in (("drapes", 1), ("batch", VIEWS), ("threads", 1), ("repeats", 1),
                       ("gpu_batch", VIEWS)):
        if config[key] < least:
            raise InputError(f"{key}={config[key]} must be at least {least}")
    if config["device"] not in ("cpu", "cuda"):
        raise InputError(f"device={config['device']}: choose cpu or cuda")
    if config["device"] == "cuda" and not torch.cuda.is_available():
        raise InputError("device=cuda: PyTorch finds no GPU here; time the CPU with device=cpu")
    drapes = make_drapes(config["drapes"], 1e-3 * config["edge_mm"])
    rates = {f"{w}x{h}": view_rates(drapes, w, h, config) for w, h in SIZES}
    found = agreement(drapes, config["threads"])
    print(f"{found['silhouette_pixels_that_differ']} of {found['cloth_pixels']} pixels differ, "
          f"depth within {found['largest_mm']:.2g} mm")
    first = next(iter(rates.values()))
    print(f"views per second, batch of {config['batch']}, {config['threads']} threads")
    print(table(["image", *first], [[name, *(round(v) for v in row.values())]
                                    for name, row in rates.items()]))
    return Result({"agreement": {"rasteriser": found}, "views_per_second": rates})
