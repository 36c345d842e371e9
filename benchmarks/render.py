"""Speed of rasteriser and ray casting: ``python -m benchmarks.render [key=value ...]``.

How many views a second does each renderer make of drapes of the shipped prior, four views each?
Timings are taken in turn, several times, and the shortest reported, for other programs may disturb.
That both see the same is asserted by ``tests/data/test_rasterise.py``.

Keys (``key=value``):

    drapes      number of different drapes, simulated first, in some 5 s each
    edge_mm     edges at the rim of a drape's mesh
    batch       views made at once
    threads     of each renderer
    repeats     timings of each
    device      cpu, or cuda: time the rasteriser on a GPU, too
    gpu_batch   views made at once there
    out         the report, JSON
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from benchmarks.common import REPORTS, parse_settings, table, write_report
from common.cli import run_command
from common.errors import InputError
from data.cameras import Camera, CameraRig
from data.fabrics import fabric_from_theta
from data.prior import load_prior, sample_admissible
from data.rasterise import camera_points, camera_tensors, rasterise_tensors, render_batch
from data.render import VIEWS, DepthRenderer
from sim.drape import drape

DEFAULTS = {
    "drapes": 8,
    "edge_mm": 4.0,
    "batch": 64,
    "threads": 2,
    "repeats": 15,
    "device": "cpu",
    "gpu_batch": 2048,
    "out": str(REPORTS / "render.json"),
}
SIZES = ((240, 180), (120, 90))  # the captures', and half of it
SEED = 4


@dataclass(frozen=True)
class Drapes:
    """Drapes of one mesh, with a camera and four angles each.

    Attributes:
        positions: (N, V, 3) m; faces: (F, 3); angles: (N, 4) rad; cameras: of each drape.
    """

    positions: torch.Tensor
    faces: torch.Tensor
    angles: torch.Tensor
    cameras: list[Camera]

    def first(self, count: int) -> "Drapes":
        """``count`` drapes, from the start again when there are fewer."""
        index = torch.arange(count) % len(self.positions)
        return Drapes(self.positions[index], self.faces, self.angles[index],
                      [self.cameras[k] for k in index.tolist()])

    def settings(self, width: int, height: int, device: str = "cpu") -> dict:
        """Arguments of :func:`data.rasterise.render_batch` at another picture size."""
        cameras = [camera.resized(width, height) for camera in self.cameras]
        intrinsics, poses = camera_tensors(cameras, device=device)
        return {"positions": self.positions.to(device), "faces": self.faces.to(device),
                "angles": self.angles.to(device), "intrinsics": intrinsics,
                "world_to_camera": poses, "height": height, "width": width}


def make_drapes(count: int, edge: float) -> Drapes:
    """Drapes of ``count`` fabrics of the prior, edges at the rim of ``edge``, m."""
    rng, prior, rig = np.random.default_rng(SEED), load_prior("gaussian"), CameraRig.load()
    results = [drape(fabric_from_theta(sample_admissible(prior, rng)[0]), edge=edge)
               for _ in range(count)]
    angles = rng.uniform(0, 2 * np.pi, (count, 1)) + np.arange(VIEWS) * (np.pi / 2)
    return Drapes(torch.from_numpy(np.stack([result.positions for result in results])),
                  torch.from_numpy(results[0].faces), torch.from_numpy(angles),
                  [rig.sample(rng) for _ in results])


def cast(drapes: Drapes, width: int, height: int, threads: int) -> Iterator[Callable]:
    """One function a drape that casts the rays of its four views; the search tree is built."""
    for k, camera in enumerate(drapes.cameras):
        renderer = DepthRenderer(drapes.positions[k].numpy(), drapes.faces.numpy(),
                                 threads=threads)
        camera, angles = camera.resized(width, height), drapes.angles[k].tolist()
        yield lambda r=renderer, c=camera, angles=angles: [r.view(c, angle) for angle in angles]


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Limit PyTorch's threads, which are the rasteriser's too."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def shortest(work: dict[str, Callable], repeats: int) -> dict[str, float]:
    """Least seconds of each function, called in turn after one call that does not count."""
    seconds = {name: [] for name in work}
    for turn in range(repeats + 1):
        for name, function in work.items():
            began = time.perf_counter()
            function()
            if turn:
                seconds[name].append(time.perf_counter() - began)
    return {name: min(values) for name, values in seconds.items()}


def speed(drapes: Drapes, width: int, height: int, config: dict) -> dict[str, float]:
    """Views a second of each renderer."""
    part = drapes.first(config["batch"] // VIEWS)
    settings = part.settings(width, height)
    intrinsics = settings["intrinsics"].float()[:, None].expand(-1, VIEWS, -1)
    faces = settings["faces"].expand(len(part.positions), -1, -1)
    casts = list(cast(part, width, height, config["threads"]))

    def tensors() -> None:
        points = camera_points(settings["positions"].float(), settings["angles"],
                               settings["world_to_camera"])
        rasterise_tensors(points, faces, intrinsics, height=height, width=width)

    work = {
        "rays": lambda: [views() for views in casts],
        "rays, with building the tree":
            lambda: [views() for views in cast(part, width, height, config["threads"])],
        "rasteriser": lambda: render_batch(**settings),
        "rasteriser, PyTorch only": tensors,
    }
    with torch_threads(config["threads"]):
        rates = {name: len(part.positions) * VIEWS / value
                 for name, value in shortest(work, config["repeats"]).items()}
    if config["device"] == "cuda":
        many = drapes.first(config["gpu_batch"] // VIEWS).settings(width, height, "cuda")

        def on_gpu() -> None:
            render_batch(**many)
            torch.cuda.synchronize()

        seconds = shortest({"gpu": on_gpu}, config["repeats"])["gpu"]
        rates[f"rasteriser, GPU, {config['gpu_batch']} at once"] = config["gpu_batch"] / seconds
    return rates


def main(argv: list[str]) -> None:
    """Run, print the table, and write the report."""
    config = parse_settings(DEFAULTS, argv)
    for key, least in (("drapes", 1), ("batch", VIEWS), ("threads", 1), ("repeats", 1),
                       ("gpu_batch", VIEWS)):
        if config[key] < least:
            raise InputError(f"{key}={config[key]} must be at least {least}")
    if config["device"] not in ("cpu", "cuda"):
        raise InputError(f"device={config['device']}: choose cpu or cuda")
    if config["device"] == "cuda" and not torch.cuda.is_available():
        raise InputError("device=cuda: PyTorch finds no GPU here; time the CPU with device=cpu")
    drapes = make_drapes(config["drapes"], 1e-3 * config["edge_mm"])
    rates = {f"{w}x{h}": speed(drapes, w, h, config) for w, h in SIZES}
    first = next(iter(rates.values()))
    print(f"views a second, batch of {config['batch']}, {config['threads']} threads")
    print(table(["picture", *first], [[name, *(round(v) for v in row.values())]
                                      for name, row in rates.items()]))
    write_report(Path(config["out"]), {
        "settings": {key: value for key, value in config.items() if key != "out"},
        "views_per_second": rates,
    })


if __name__ == "__main__":
    run_command(main, usage=__doc__)
