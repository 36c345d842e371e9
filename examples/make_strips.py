"""Make practice photographs of cantilever strips of a fabric with known moduli.

    python examples/make_strips.py out=outputs/strips
    python infer.py strips=outputs/strips out=outputs/strips_estimate

Simulates two strips of each direction, of 1.5 and 2.5 bending lengths (alpha/rho g)^(1/3), the
second with its other face up, photographs them with a camera that is a little inclined, and writes
``strips.yaml``. The true moduli are in ``truth.json``.
"""

import json
from dataclasses import dataclass, replace

import cv2
import numpy as np
import yaml

from common.command import command
from common.errors import InputError
from common.files import folder_named, replace_file, require_folder
from data.captures.description import checked_density
from data.render.strips import StripScene, posed
from drapenet.measured.strips.description import FILE
from sim.cantilever.strip import simulate_strips
from sim.cloth import Laws
from sim.energies.bending_variants import Hysteresis
from sim.material import DIRECTIONS, MICRO, NANO, Fabric, gravity_length

STRIPS = ((1.5, "up"), (2.5, "down"))  # bending lengths, and face
DISTANCES = (300.0, 5000.0)  # mm


@dataclass
class MakeStripsConfig:
    """``configs/make_strips.yaml``."""

    out: str
    alpha: list[float]
    beta: list[float]
    curl: list[float]
    density: float
    thickness_mm: float
    distance_mm: float
    seed: int


@command("make_strips", MakeStripsConfig)
def main(config: MakeStripsConfig) -> None:
    """Simulate and photograph the strips; write their description and the true moduli."""
    out = folder_named(config.out)
    require_folder(out)
    low, high = DISTANCES
    if not low <= config.distance_mm <= high:
        raise InputError(f"distance_mm={config.distance_mm:g} must lie between {low:g} and "
                         f"{high:g} mm")
    if not 0.05 <= config.thickness_mm <= 3:
        raise InputError(f"thickness_mm={config.thickness_mm:g} must lie between 0.05 and 3 mm")
    fabric = Fabric(np.array(config.alpha) * MICRO, np.array(config.beta) * NANO,
                    checked_density(config.density))
    if len(config.curl) != 2:
        raise InputError(f"curl={config.curl} needs two curvatures, 1/m: along warp and weft")
    rng = np.random.default_rng(config.seed)
    entries = []
    for bending_lengths, face in STRIPS:
        lengths = {direction: [round(bending_lengths * gravity_length(alpha, fabric.density), 4)]
                   for direction, alpha in zip(DIRECTIONS, fabric.alpha, strict=True)}
        warp, weft = (curl if face == "up" else -curl for curl in config.curl)
        laws = Laws(Hysteresis(curvature=(warp, weft, 0.0)))
        for direction, (curve,) in simulate_strips(fabric, lengths, laws=laws).items():
            scene = posed(StripScene(curve, thickness=1e-3 * config.thickness_mm), rng)
            scene = replace(scene, distance=1e-3 * config.distance_mm)
            name = f"{direction}_{face}.png"
            replace_file(out / name, cv2.imencode(".png", scene.photograph(rng))[1].tobytes())
            entries.append({"file": name, "direction": direction, "face": face,
                            "free_length_mm": round(1e3 * lengths[direction][0], 1),
                            "scale": {"mm_per_px": round(1e3 * scene.field / scene.size[0], 5)}})
    replace_file(out / FILE, yaml.safe_dump({
        "density_g_m2": config.density, "thickness_mm": config.thickness_mm, "hangs": "right",
        "camera_distance_mm": config.distance_mm, "strips": entries}, sort_keys=False).encode())
    truth = {name: {"alpha_uN_m": alpha, "beta_nN_m2": beta} for name, alpha, beta in
             zip(DIRECTIONS, config.alpha, config.beta, strict=True)}
    replace_file(out / "truth.json", (json.dumps({"moduli": truth}, indent=1) + "\n").encode())
    print(f"strips: {out}")


if __name__ == "__main__":
    main()
