"""Accuracy of the cloth mask, the plate and the turns found in uncropped scenes.

Drapes of fabrics from the prior are rendered in synthetic scenes (:mod:`data.render.scenes`) with
table, column, wall and clutter of three densities, with three sensors per camera pose. The turns of
the table deviate from 90 degrees by up to 5 degrees. Targets: :data:`TARGETS`.

Depth errors of the sensor shift the measured plate along the line of sight. Therefore errors of the
centre are given across it.
"""

from pathlib import Path

import numpy as np

from common.errors import InputError
from common.findings import texts
from data.captures.cutout import CutOut, cut_out
from data.render.cameras import QUARTERS
from data.render.scenes import CLUTTER, RawScene, raw_scene
from drapenet.views.located import LocatedViews
from experiments.drapes import drape_as_planned, plan_specimen
from experiments.result import Config, Result, run_cases
from sim.rig import Rig

SENSORS = ("smooth", "paper", "tof")
MAX_TURN_ERROR = 5.0  # degrees, largest deviation of a turn
TARGETS = {"iou": (0.985, 0.96), "across_mm": 1.5, "tilt_deg": 0.3, "turn_deg": 0.7}


def case(*, number: int, sensor: str, clutter: str, rig: str, edge_mm: float, seed: int) -> dict:
    """Errors of one capture; ``failed`` has the message if no cloth was found."""
    tester = Rig.from_name(rig)
    shape = drape_as_planned(plan_specimen(number, rig=tester, seed=seed), edge=1e-3 * edge_mm)
    rng = np.random.default_rng([seed, number, SENSORS.index(sensor)])
    errors = rng.uniform(-MAX_TURN_ERROR, MAX_TURN_ERROR, len(QUARTERS))
    turns = np.array(QUARTERS) + np.radians(errors)
    turns -= turns[0]
    scene = raw_scene(shape.positions, shape.faces, rng, rig=tester, turns=turns, sensor=sensor,
                      clutter=clutter)
    intrinsics = scene.camera.intrinsics
    try:
        cut = cut_out(scene.frames, intrinsics, tester)
    except InputError as error:
        return {"failed": str(error)}
    empty = cut_out(scene.frames, intrinsics, tester, scene.background)
    found = {"failed": "", "iou": overlap(cut.masks, scene.cloth),
             "iou_background": overlap(empty.masks, scene.cloth), "warnings": texts(cut.warnings),
             "column_mm": 1e3 * scene.column,
             "column_found_mm": 1e3 * cut.column if cut.column else None,
             **plate_errors(cut, scene)}
    measured = LocatedViews.cut_out(cut.views, intrinsics, tester, np.array(QUARTERS)).turns
    return found | {"turn_deg": float(np.degrees(np.abs(measured - turns)).max())}


def overlap(masks: np.ndarray, truth: np.ndarray) -> list[float]:
    """Intersection over union of masks (K, H, W) and true masks, for each frame."""
    both, either = (part.sum(axis=(1, 2)) for part in (masks & truth, masks | truth))
    return (both / either).tolist()


def plate_errors(cut: CutOut, scene: RawScene) -> dict[str, float]:
    """Errors of the plate's centre across the line of sight, mm, and of its normal, degrees."""
    pose = scene.camera.world_to_camera
    centre = pose[:3, 3]
    sight = centre / np.linalg.norm(centre)
    error = cut.plate.axis_centre - centre
    return {"across_mm": 1e3 * float(np.linalg.norm(error - (error @ sight) * sight)),
            "tilt_deg": angle(cut.plate.normal, pose[:3, 2])}


def angle(one: np.ndarray, other: np.ndarray) -> float:
    """Angle, degrees, between two unit vectors (3,), ignoring their signs."""
    return float(np.degrees(np.arccos(min(1.0, abs(one @ other)))))


def run(config: Config) -> Result:
    """Evaluate all captures."""
    settings = {key: config[key] for key in ("rig", "edge_mm", "seed")}
    densities = list(CLUTTER)
    cases = {f"{sensor}_{k}": {
        "number": k, "sensor": sensor, "clutter": densities[(k + shift) % len(densities)],
        **settings}
        for shift, sensor in enumerate(SENSORS) for k in range(config["poses"])}
    results = run_cases(case, cases, config, folder=Path(config["cases"]) / config["rig"])
    groups = {"all": list(results)} | {
        name: [key for key in results if cases[key][kind] == name]
        for kind, names in (("sensor", SENSORS), ("clutter", densities)) for name in names}
    summary = {name: summarise([results[key] for key in keys]) for name, keys in groups.items()
               if keys}
    return Result({"targets": TARGETS, "summary": summary, "cases": results})


def summarise(results: list[dict]) -> dict:
    """Median and worst case of each error over captures; 'n/a' without values."""
    done = [one for one in results if not one["failed"]]
    found = {"captures": len(results), "failed": len(results) - len(done)}
    for name in ("iou", "iou_background", "across_mm", "tilt_deg", "turn_deg"):
        values = np.abs(np.concatenate([np.atleast_1d(one[name]) for one in done if name in one]
                                       or [np.zeros(0)]))
        worst = np.min if name.startswith("iou") else np.max
        found[name] = [float(np.median(values)), float(worst(values))] if len(values) else [
            "n/a", "n/a"]
    return found
