"""Make a synthetic capture of a fabric with known moduli, such as ``captures/twill``.

    python examples/make_capture.py out=examples/captures/twill
    python examples/make_capture.py raw=true out=outputs/raw  # uncropped scenes
    python examples/make_capture.py photograph=true out=outputs/photograph  # over the mat

Simulates the drape on a finer mesh than in training, renders it with a camera of a random
set-up, adds sensor noise, and writes four views with ``capture.yaml``. With
``raw=true`` the views also show tester, table and wall, ``background.png`` shows the scene without
cloth, and the warp direction is random. With ``photograph=true`` a phone takes one picture of the
drape over the printed mat instead. ``truth.json`` contains the moduli.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common.command import command
from common.errors import InputError
from common.files import folder_named, replace_file, require_folder
from data.captures.description import checked_density, whole_turns
from data.captures.writer import write_capture
from data.pictures.mat import CODE
from data.render.cameras import VIEWS
from data.render.phone import phone_picture
from data.render.rays import DepthRenderer
from data.render.scenes import raw_scene
from data.render.sensors import StructuredLight, load_sensor
from data.render.setups import Setups
from data.rigs import named_tester
from sim.draping import Drape, drape
from sim.material import DIRECTIONS, MICRO, NANO, Fabric

ABOVE_MAT, BESIDE = 0.04, 0.02  # m, of the lowest cloth, and of the phone from the plate's axis
FILES = {"capture.yaml", "truth.json", "background.png", "outline.jpg",
         *(f"view_{k}.png" for k in range(VIEWS))}


@dataclass
class MakeCaptureConfig:
    """``configs/make_capture.yaml``."""

    out: str
    alpha: list[float]
    beta: list[float] | None
    density: float
    tester: str
    warp_direction: float
    edge_mm: float
    sensor: str
    seed: int
    raw: bool
    photograph: bool


@command("make_capture", MakeCaptureConfig)
def main(config: MakeCaptureConfig) -> None:
    """Simulate and render the drape; write the capture and the true moduli."""
    out = folder_named(config.out)
    old = list(out.iterdir()) if out.is_dir() else []
    if out.is_file() or not {file.name for file in old} <= FILES:
        raise InputError(f"{out} contains other files than a capture made by this program; choose "
                         "another out=")
    if config.photograph and config.raw:
        raise InputError("photograph=true and raw=true: a capture is a photograph or depth views; "
                         "give one of them")
    require_folder(out)
    density, tester = checked_density(config.density), named_tester(config.tester)
    noise = load_sensor(config.sensor)
    if isinstance(noise, StructuredLight):
        # 8-bit quantisation belongs to the published format, not to 16-bit captures.
        noise = noise.model_copy(update={"eight_bit_probability": 0.0})
    betas = [-2 * alpha for alpha in config.alpha] if config.beta is None else config.beta
    fabric = Fabric(alpha=np.array(config.alpha) * MICRO, beta=np.array(betas) * NANO,
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
    elif not config.photograph:
        camera = Setups.load().camera(rng, tester)
        views = DepthRenderer(result.positions, result.faces).views(camera, direction)
        views = noise(views, camera, config.seed)
    for file in old:
        file.unlink()
    if config.photograph:
        write_photograph(out, result, rng)
    else:
        write_capture(out, views=views, intrinsics=camera.intrinsics, density=density,
                      rig=tester, warp_direction=direction, background=background)
    truth = {
        "density_g_m2": config.density,
        "moduli": {name: {"alpha_uN_m": alpha, "beta_nN_m2": beta} for name, alpha, beta in
                   zip(DIRECTIONS, config.alpha, betas, strict=True)},
    }
    replace_file(out / "truth.json", (json.dumps(truth, indent=1) + "\n").encode())
    print(f"capture: {out}")


def write_photograph(out: Path, drape: Drape, rng: np.random.Generator) -> None:
    """Write a phone's photograph of a drape over the mat, and its ``capture.yaml``."""
    mat, height = "a2", ABOVE_MAT - float(drape.positions[:, 2].min())
    picture = phone_picture(drape.positions, drape.rest, drape.faces, rng, mat=mat,
                            plate_radius=drape.rig.plate_radius, plate_height=height,
                            beside=BESIDE, ground=CODE)
    picture.write(out, density=drape.fabric.density, rig=drape.rig, mat=mat,
                  plate_height=height)


if __name__ == "__main__":
    main()
