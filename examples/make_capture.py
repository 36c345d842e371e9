"""Make a synthetic capture of a fabric with known moduli, such as ``captures/twill``.

    python examples/make_capture.py out=examples/captures/twill
    python examples/make_capture.py raw=true out=outputs/raw  # uncropped scenes
    python examples/make_capture.py photograph_mm=1200 out=outputs/photograph  # from above

Simulates the drape on a finer mesh than in training, renders it with a camera of a random
set-up, adds sensor noise, and writes four views with ``capture.yaml``. With
``raw=true`` the views also show tester, table and wall, ``background.png`` shows the scene without
cloth, and the warp direction is random. ``photograph_mm`` gives one photograph instead, of dark
cloth on a light ground, from this height above the plate. ``truth.json`` contains the moduli.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import yaml

from common.command import command
from common.errors import InputError
from common.files import folder_named, replace_file, require_folder
from common.types import Metres, Radians
from data.captures.capture import write_capture
from data.captures.description import CAMERA_HEIGHTS, checked_density, whole_turns
from data.render.rays import VIEWS, DepthRenderer
from data.render.scenes import raw_scene
from data.render.sensors import StructuredLight, load_sensor
from data.render.setups import Setups
from data.rigs import named_tester
from sim.drape import Drape, drape
from sim.material import DIRECTIONS, MICRO, NANO, Fabric
from sim.measures import shadow_radius
from sim.rig import Rig

PIXEL = 4e-4  # m, of a photograph at the plate
FILES = {"capture.yaml", "truth.json", "background.png", "outline.png",
         *(f"view_{k}.png" for k in range(VIEWS))}


@dataclass
class MakeCaptureConfig:
    """``configs/make_capture.yaml``."""

    out: str
    alpha: list[float]
    beta: list[float]
    density: float
    tester: str
    warp_direction: float
    edge_mm: float
    sensor: str
    seed: int
    raw: bool
    photograph_mm: float | None


@command("make_capture", MakeCaptureConfig)
def main(config: MakeCaptureConfig) -> None:
    """Simulate and render the drape; write the capture and the true moduli."""
    out = folder_named(config.out)
    old = list(out.iterdir()) if out.is_dir() else []
    if out.is_file() or not {file.name for file in old} <= FILES:
        raise InputError(f"{out} contains other files than a capture made by this program; choose "
                         "another out=")
    low, high = CAMERA_HEIGHTS
    photograph = config.photograph_mm is not None
    if photograph and (config.raw or not low <= config.photograph_mm <= high):
        raise InputError(f"photograph_mm={config.photograph_mm:g}: give {low:g} to {high:g} mm, "
                         "without raw=true")
    require_folder(out)
    density, tester = checked_density(config.density), named_tester(config.tester)
    noise = load_sensor(config.sensor)
    if isinstance(noise, StructuredLight):
        # 8-bit quantisation belongs to the published format, not to 16-bit captures.
        noise = noise.model_copy(update={"eight_bit_probability": 0.0})
    fabric = Fabric(alpha=np.array(config.alpha) * MICRO, beta=np.array(config.beta) * NANO,
                    density=density)
    result = drape(fabric, rig=tester, edge=1e-3 * config.edge_mm, seed=config.seed)
    if not result.converged:
        raise InputError(f"the drape did not converge ({result.message}); try another seed")

    rng = np.random.default_rng(config.seed)
    direction, background = math.radians(config.warp_direction), None
    if config.raw:
        scene = raw_scene(result.positions, result.faces, rng, rig=tester,
                          turns=whole_turns(VIEWS), sensor=config.sensor)
        views, background, direction = scene.frames, scene.background, scene.orientation
        camera = scene.camera
    elif not photograph:
        camera = Setups.load().camera(rng, tester)
        views = DepthRenderer(result.positions, result.faces).views(camera, direction)
        views = noise(views, camera, config.seed)
    for file in old:
        file.unlink()
    if photograph:
        write_photograph(out, result, tester, direction, 1e-3 * config.photograph_mm, rng,
                         density=config.density)
    else:
        write_capture(out, views=views, intrinsics=camera.intrinsics, density=density,
                      rig=tester, warp_direction=direction, background=background)
    truth = {
        "density_g_m2": config.density,
        "moduli": {name: {"alpha_uN_m": alpha, "beta_nN_m2": beta} for name, alpha, beta in
                   zip(DIRECTIONS, config.alpha, config.beta, strict=True)},
    }
    replace_file(out / "truth.json", (json.dumps(truth, indent=1) + "\n").encode())
    print(f"capture: {out}")


def write_photograph(
    out: Path, drape: Drape, rig: Rig, direction: Radians, height: Metres,
    rng: np.random.Generator, *, density: float,
) -> None:
    """Write a photograph of a drape from above, with noise, and its ``capture.yaml``; ``density``
    in g/m²."""
    radius = shadow_radius(drape.positions, drape.mesh, height=height, points=1440)
    angle = np.linspace(0, 2 * np.pi, len(radius), endpoint=False) + direction
    half = int(1.15 * radius.max() / PIXEL)
    curve = radius[:, None] * np.column_stack([np.cos(angle), -np.sin(angle)]) / PIXEL + half
    picture = np.full((2 * half + 1, 2 * half + 1), 205, np.uint8)
    cv2.fillPoly(picture, [np.rint(16 * curve).astype(np.int32)], 70, cv2.LINE_AA, shift=4)
    noisy = cv2.GaussianBlur(picture, (0, 0), 1.2) + rng.normal(0, 4, picture.shape)
    grey = noisy.clip(0, 255).astype(np.uint8)
    replace_file(out / "outline.png", cv2.imencode(".png", grey)[1].tobytes())
    plate = {"x": half, "y": half, "diameter": round(rig.plate_diameter / PIXEL, 3)}
    replace_file(out / "capture.yaml", yaml.safe_dump({
        "density_g_m2": density, "tester": rig.name,
        "warp_direction_deg": round(math.degrees(direction), 3),
        "outline": {"plate_px": plate, "camera_height_mm": 1e3 * height}},
        sort_keys=False).encode())


if __name__ == "__main__":
    main()
