"""Batched rasteriser against ray casting: ``python -m benchmarks.render [key=value ...]``.

Fifty drapes of the shipped prior, four views each: do both renderers see the same silhouettes and
depths, and how many views a second does each make? Then the same for the sensor noise. Timings are
taken in turn, several times, and the shortest reported, for other programs may disturb.

Keys (``key=value``):

    data        folder of the drapes; simulated on the first run, in about two minutes
    drapes      number of drapes
    edge_mm     edges at the rim of a drape's mesh
    batch       views made at once
    threads     of each renderer
    repeats     timings of each
    gpu_batch   views made at once on a GPU, where there is one
    workers     processes that simulate
    out         the report, JSON; the picture lies beside it
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
import torch
from scipy.ndimage import binary_dilation, binary_erosion
from torch.nn.utils.rnn import pad_sequence

from benchmarks.common import REPORTS, parse_settings, table, write_figure, write_report
from common.cli import run_command
from common.errors import InputError
from data.cameras import Camera
from data.configs import compose_config
from data.dataset import DrapeDataset
from data.generate import generate_dataset
from data.options import Options, config_from_options
from data.rasterise import camera_points, camera_tensors, rasterise, rasterise_tensors, render_batch
from data.render import VIEWS, DepthRenderer
from data.sensor import load_sensor
from data.sensor_noise import SensorNoise
from data.shards import Shard

matplotlib.use("Agg")
import matplotlib.pyplot as plt

DEFAULTS = {
    "data": "outputs/bench_render",
    "drapes": 50,
    "edge_mm": 4.0,
    "batch": 64,
    "threads": 2,
    "repeats": 15,
    "gpu_batch": 2048,
    "workers": 1,
    "out": str(REPORTS / "render.json"),
}
SIZES = ((240, 180), (120, 90))  # the captures', and that of the network's input by default
SENSORS = ("smooth", "paper", "tof")
EIGHT_NEIGHBOURS = np.ones((1, 3, 3), dtype=bool)


@dataclass(frozen=True)
class Drapes:
    """Drapes with a camera and four angles each.

    Attributes:
        positions: (N, V, 3) m; faces: (N, F, 3), those of smaller meshes without area at the end;
            angles: (N, 4) rad; cameras: of each drape.
    """

    positions: torch.Tensor
    faces: torch.Tensor
    angles: torch.Tensor
    cameras: list[Camera]

    def first(self, count: int) -> "Drapes":
        """``count`` drapes, from the start again when there are fewer."""
        index = torch.arange(count) % len(self.positions)
        return Drapes(self.positions[index], self.faces[index], self.angles[index],
                      [self.cameras[k] for k in index.tolist()])

    def settings(self, width: int, height: int, device: str = "cpu") -> dict:
        """Arguments of :func:`data.rasterise.render_batch` at another picture size."""
        cameras = [camera.resized(width, height) for camera in self.cameras]
        intrinsics, poses = camera_tensors(cameras, device=device)
        return {"positions": self.positions.to(device), "faces": self.faces.to(device),
                "angles": self.angles.to(device), "intrinsics": intrinsics,
                "world_to_camera": poses, "height": height, "width": width}


def load_drapes(config: dict) -> Drapes:
    """The drapes in ``data``, simulated where they are missing."""
    words = [f"drapes={config['drapes']}", f"edge_mm={config['edge_mm']}", "seed=4",
             "prior=gaussian", "dataset=one_start", "dataset.orientations=1"]
    options = compose_config("generate", words, schema=Options)
    generation = config_from_options(options)
    root = Path(config["data"])
    generate_dataset(generation, root, workers=config["workers"])
    meshes, cameras = [], []
    for name in DrapeDataset(root).manifest["shards"]:
        with Shard(root / name) as shard:
            for row in np.flatnonzero(shard.column("rendered")):
                positions, _, faces = shard.mesh(row)
                angles = shard.column("orientations")[row, 0] + shard.column("turns")[row, 0]
                meshes.append((positions, faces, angles + np.arange(VIEWS) * np.pi / 2))
                size = generation.cameras.intrinsics
                cameras.append(Camera(*shard.column("intrinsics")[row, 0], size.width, size.height,
                                      world_to_camera=shard.column("world_to_camera")[row, 0]))
    padded = (pad_sequence([torch.from_numpy(mesh) for mesh in part], batch_first=True)
              for part in zip(*meshes, strict=True))
    return Drapes(*padded, cameras)


def cast(drapes: Drapes, width: int, height: int, threads: int) -> Iterator[Callable]:
    """One function a drape that casts the rays of its four views; the search tree is built."""
    for k, camera in enumerate(drapes.cameras):
        renderer = DepthRenderer(drapes.positions[k].numpy(), drapes.faces[k].numpy(),
                                 threads=threads)
        camera, angles = camera.resized(width, height), drapes.angles[k].tolist()
        yield lambda r=renderer, c=camera, angles=angles: [r.view(c, angle) for angle in angles]


def agreement(views: np.ndarray, rays: np.ndarray) -> dict:
    """How pictures (N, H, W) agree with those of the ray caster."""
    cloth, seen = views > 0, rays > 0
    # A pixel of one silhouette may lie one pixel outside of the other, not farther.
    beyond = (cloth & ~binary_dilation(seen, EIGHT_NEIGHBOURS)
              | seen & ~binary_dilation(cloth, EIGHT_NEIGHBOURS))
    inside = binary_erosion(cloth & seen, EIGHT_NEIGHBOURS)
    error = np.abs(views - rays.astype(float))[inside] * 1e3
    return {
        "cloth_pixels": int(seen.sum()),
        "silhouette_pixels_that_differ": int((cloth != seen).sum()),
        "of_them_beyond_one_pixel": int(beyond.sum()),
        "interior_pixels": int(inside.sum()),
        "rms_mm": float(np.sqrt(np.square(error).mean())),
        "largest_mm": float(error.max()),
    }


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
    casts = list(cast(part, width, height, config["threads"]))

    def tensors() -> None:
        points = camera_points(settings["positions"].float(), settings["angles"],
                               settings["world_to_camera"])
        rasterise_tensors(points, settings["faces"], intrinsics, height=height, width=width)

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
    if torch.cuda.is_available():
        many = drapes.first(config["gpu_batch"] // VIEWS).settings(width, height, "cuda")

        def on_gpu() -> None:
            render_batch(**many)
            torch.cuda.synchronize()

        seconds = shortest({"gpu": on_gpu}, config["repeats"])["gpu"]
        rates[f"rasteriser, GPU, {config['gpu_batch']} at once"] = config["gpu_batch"] / seconds
    return rates


def noise_speed(views: torch.Tensor, intrinsics: torch.Tensor, config: dict) -> dict[str, float]:
    """Views a second of each noise model, capture by capture as a dataset's workers call it."""
    generator = torch.Generator().manual_seed(0)

    def apply(noise: SensorNoise) -> Callable:
        return lambda: [noise(*capture, generator)
                        for capture in zip(views, intrinsics, strict=True)]

    with torch_threads(1):
        seconds = shortest({name: apply(load_sensor(name)) for name in SENSORS},
                          config["repeats"])
    return {name: views.shape[:2].numel() / value for name, value in seconds.items()}


def picture(views: torch.Tensor, rays: np.ndarray, intrinsics: torch.Tensor, out: Path) -> None:
    """Both renderers, their difference, and the noise on one view, beside each other."""
    panels = {"ray casting": rays[0], "rasteriser": views[0].numpy()}
    for name in SENSORS:
        noise = load_sensor(name)
        panels[f"sensor={name}"] = noise(views, intrinsics, torch.Generator().manual_seed(2))[0]
    cloth = rays[0] > 0
    rows, columns = np.flatnonzero(cloth.any(1)), np.flatnonzero(cloth.any(0))
    window = (slice(rows[0] - 4, rows[-1] + 5), slice(columns[0] - 4, columns[-1] + 5))
    figure, axes = plt.subplots(2, len(panels), figsize=(3.1 * len(panels), 5.2),
                                layout="constrained")
    low, high = rays[0][cloth].min() * 1e3, rays[0][cloth].max() * 1e3
    for k, (title, panel) in enumerate(panels.items()):
        depth, truth = np.asarray(panel)[window].astype(float), rays[0][window].astype(float)
        shown = axes[0, k].imshow(np.where(depth > 0, depth * 1e3, np.nan), vmin=low, vmax=high)
        both = (depth > 0) & (truth > 0)
        change = np.where(both, (depth - truth) * 1e3, np.nan)
        # A capture's offset would hide the rest.
        error = axes[1, k].imshow(change - np.nanmedian(change), cmap="coolwarm", vmin=-5, vmax=5)
        axes[0, k].set_title(title)
    for axis in axes.flat:
        axis.set_xticks([])
        axis.set_yticks([])
    axes[0, 0].set_ylabel("depth")
    axes[1, 0].set_ylabel("minus ray casting\nand the median of that")
    figure.colorbar(shown, ax=axes[0], label="mm")
    figure.colorbar(error, ax=axes[1], label="mm")
    write_figure(out, figure)
    plt.close(figure)


def main(argv: list[str]) -> None:
    """Run, print the tables, and write the report."""
    config = parse_settings(DEFAULTS, argv)
    for key, least in (("drapes", 1), ("batch", VIEWS), ("threads", 1), ("repeats", 1),
                       ("gpu_batch", VIEWS)):
        if config[key] < least:
            raise InputError(f"{key}={config[key]} must be at least {least}")
    drapes = load_drapes(config)
    report = {"settings": {k: v for k, v in config.items() if k not in ("out", "data", "workers")}}
    size = SIZES[0]
    settings = drapes.settings(*size)
    rays = np.concatenate([views() for views in cast(drapes, *size, 1)])
    points = camera_points(settings["positions"].float(), settings["angles"],
                           settings["world_to_camera"])
    same = {name: function(points, settings["faces"],
                           settings["intrinsics"].float()[:, None].expand(-1, VIEWS, -1),
                           height=size[1], width=size[0])
            for name, function in (("rasteriser", rasterise),
                                   ("rasteriser, PyTorch only", rasterise_tensors))}
    if torch.cuda.is_available():
        same["rasteriser, GPU"] = render_batch(**drapes.settings(*size, "cuda")).cpu()
    report["drapes"] = len(drapes.positions)
    report["agreement"] = {name: agreement(views.flatten(0, 1).numpy(), rays)
                           for name, views in same.items()}
    first = next(iter(report["agreement"].values()))
    print(f"{report['drapes']} drapes, {VIEWS} views each of {size[0]}x{size[1]}, against rays")
    print(table(["", *first], [[name, *row.values()]
                               for name, row in report["agreement"].items()]))

    report["views_per_second"] = {f"{w}x{h}": speed(drapes, w, h, config) for w, h in SIZES}
    first = next(iter(report["views_per_second"].values()))
    print(f"\nviews a second, batch of {config['batch']}, {config['threads']} threads")
    print(table(["picture", *first], [[name, *(round(v) for v in row.values())]
                                      for name, row in report["views_per_second"].items()]))

    captures = config["batch"] // VIEWS
    views = same["rasteriser"][:captures]
    intrinsics = settings["intrinsics"][:captures]
    report["noisy_views_per_second"] = noise_speed(views, intrinsics, config)
    print(f"\nsensor noise, views of {size[0]}x{size[1]} a second, one thread: " + ", ".join(
        f"{name} {rate:.0f}" for name, rate in report["noisy_views_per_second"].items()))
    out = Path(config["out"])
    picture(views[0], rays[:VIEWS], intrinsics[0], out.with_suffix(".png"))
    write_report(out, report)


if __name__ == "__main__":
    run_command(main, usage=__doc__)
