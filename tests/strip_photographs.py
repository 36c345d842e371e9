"""Photographs of one strip of known curve, and folders of them."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import yaml

from data.render.strips import StripScene
from sim.cantilever import heavy_elastica
from sim.cantilever.moduli import distance_across
from sim.rig import GRAVITY

DENSITY, ALPHA, BETA = 0.2, 30e-6, -75e-9
LENGTHS = (0.038, 0.062)  # m
CURVES = [heavy_elastica(ALPHA, BETA, weight=DENSITY * GRAVITY, length=length, points=161)
          for length in LENGTHS]
LONG = StripScene(CURVES[1], field=0.14, aim=(0.005, -0.02), size=(1200, 900))
SLOPED = replace(LONG, slope=0.4, roll=-0.05, to_the_left=True, curve=heavy_elastica(
    ALPHA, BETA, weight=DENSITY * GRAVITY, length=LENGTHS[1], points=161, slope=0.4))
SHORT = replace(LONG, curve=CURVES[0], field=0.1, aim=(0.0, -0.005))


def entry(scene: StripScene, file: str = "strip.png", **changes) -> dict:
    """What strips.yaml states of a scene."""
    arc = np.linalg.norm(np.diff(scene.curve, axis=0), axis=1).sum()
    return {"file": file, "direction": "warp", "free_length_mm": round(float(1e3 * arc), 2),
            "hangs": "left" if scene.to_the_left else "right",
            "camera_distance_mm": 1e3 * scene.distance,
            "scale": {"mm_per_px": 1e3 * scene.field / scene.size[0]}} | changes


def write(folder: Path, pictures: dict[str, np.ndarray], entries: list[dict], **keys) -> Path:
    """A folder of pictures and strips.yaml."""
    folder.mkdir(exist_ok=True)
    for name, picture in pictures.items():
        (folder / name).write_bytes(cv2.imencode(Path(name).suffix, picture)[1].tobytes())
    content = {"density_g_m2": 1e3 * DENSITY, "strips": entries} | keys
    (folder / "strips.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    return folder


def photograph(scene: StripScene) -> np.ndarray:
    """Its picture, with a fixed noise."""
    return scene.photograph(np.random.default_rng(0))


def largest_error_mm(curve: np.ndarray, scene: StripScene) -> float:
    """Largest distance of a curve's points from the scene's."""
    return 1e3 * float(np.abs(distance_across(curve[1:], scene.curve)).max())
