"""Cloth, plate and turns found in whole scenes.

Drapes of the prior stand in synthetic scenes (:mod:`data.scenes`): table, column, wall,
clutter of three densities. Every pose of the camera is seen by three sensors. The table turns by up
to 5 degrees more or less than a quarter. Targets: :data:`ASKED`. The shift of log alpha is that
between raw frames and a perfect cut-out, in its standard deviations; a perfect cut-out has the true
mask and none of the pixels in which a time-of-flight sensor mixes cloth with background, "true
mask" has those.

A sensor's own errors move and tilt the plate that it shows. So the centre is judged across the line
of sight, and along it after the sensor's mean error of depth; the tilt beside that of the plane
through the pixels that truly show the plate.
"""

from pathlib import Path

import numpy as np

from benchmarks.common import ESTIMATOR, Config, Result, run_cases, table
from benchmarks.known import known_drape
from common.errors import InputError
from data.captures import Capture
from data.cutout import CutOut, cut_out
from data.render import QUARTERS
from data.scenes import CLUTTER, RawScene, raw_scene
from drapenet.canonical import drape_map
from drapenet.checkpoint import bundled, read_header
from drapenet.convention import LINEAR
from drapenet.registration import locate_camera
from sim.material import REFERENCE_DENSITY
from sim.scene import Rig

SENSORS = ("smooth", "paper", "tof")
BLENDED = 8e-3  # m
WRONG = 5.0  # degrees, largest error of the table
ASKED = {"iou": (0.985, 0.96), "across_mm": 1.5, "tilt_deg": 0.3, "turn_deg": 0.7, "shift": 1 / 3}


def case(*, number: int, sensor: str, clutter: str, rig: str, edge_mm: float, seed: int,
         estimated: bool) -> dict:
    """Figures of one capture; ``failed`` with the message where it is not cut out."""
    tester = Rig.from_name(rig)
    _, shape = known_drape(number, rig=rig, nuisances="none", edge_mm=edge_mm, seed=seed)
    rng = np.random.default_rng([seed, number, SENSORS.index(sensor)])
    turns = np.array(QUARTERS) + np.radians(rng.uniform(-WRONG, WRONG, len(QUARTERS)))
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
             "iou_background": overlap(empty.masks, scene.cloth), "doubts": list(cut.doubts),
             "column_mm": 1e3 * scene.column,
             "column_found_mm": 1e3 * cut.column if cut.column else None,
             **plate_errors(cut, scene, tester)}
    perfect = np.where(scene.cloth & ~blended(scene, sensor), scene.frames, np.float32(0.0))
    for name, views in (("turn_deg", cut.views), ("turn_perfect_deg", perfect)):
        camera = locate_camera(views, intrinsics, tester)
        measured = drape_map(views, camera, tester, turns=np.array(QUARTERS)).turns
        found[name] = float(np.degrees(np.abs(measured - turns)).max())
    if estimated:
        found["shift"] = shifts(cut.views, perfect, scene, rig)
        masked = np.where(scene.cloth, scene.frames, np.float32(0.0))
        found["shift_true_mask"] = shifts(masked, perfect, scene, rig)
    return found


def blended(scene: RawScene, sensor: str) -> np.ndarray:
    """(K, H, W) bool, pixels of the cloth's edge whose depth lies between cloth and background."""
    error = scene.frames - scene.clean
    seen = scene.cloth & (scene.frames > 0)
    return seen & (np.abs(error - np.median(error[seen])) > BLENDED) & (sensor == "tof")


def overlap(masks: np.ndarray, truth: np.ndarray) -> list[float]:
    """Intersection over union of masks (K, H, W) with the truth, frame by frame."""
    both, either = (part.sum(axis=(1, 2)) for part in (masks & truth, masks | truth))
    return (both / either).tolist()


def plate_errors(cut: CutOut, scene: RawScene, rig: Rig) -> dict:
    """mm and degrees between the plate found and the true one."""
    pose, points = scene.camera.world_to_camera, scene.camera.back_project(scene.frames)
    centre, up = pose[:3, 3], pose[:3, 2]
    sight = centre / np.linalg.norm(centre)
    error = cut.plate.centre - centre
    along = float(error @ sight)
    # Pixels that truly show the flat plate, wherever the sensor's noise puts them.
    true = (scene.camera.back_project(scene.clean) - centre) @ pose[:3, :3]
    top = scene.cloth & (scene.clean > 0) & (scene.frames > 0) & (
        np.hypot(true[..., 0], true[..., 1]) < 0.75 * rig.plate_radius) & (true[..., 2] > -2e-3)
    bias = float(np.median((scene.frames - scene.clean)[top]) / sight[2])
    shown = points[top][np.abs((scene.frames - scene.clean)[top] - bias) < 0.01]
    own = np.linalg.eigh(np.cov(shown.T))[1][:, 0]
    return {"across_mm": 1e3 * float(np.linalg.norm(error - along * sight)),
            "along_mm": 1e3 * (along - bias), "bias_mm": 1e3 * bias,
            "tilt_deg": angle(cut.plate.normal, up), "tilt_sensor_deg": angle(own, up),
            "tilt_from_shown_deg": angle(cut.plate.normal, own)}


def angle(one: np.ndarray, other: np.ndarray) -> float:
    """Degrees between two directions (3,), whichever way they point."""
    return float(np.degrees(np.arccos(min(1.0, abs(float(one @ other))))))


def shifts(views: np.ndarray, perfect: np.ndarray, scene: RawScene, rig: str) -> list[float]:
    """(3,) by how many standard deviations log alpha differs between two cut-outs."""
    from drapenet.inference import infer_capture

    header, samples = read_header(bundled(rig)), []
    for one in (views, perfect):
        capture = Capture(one, scene.camera.intrinsics, np.array(QUARTERS), REFERENCE_DENSITY,
                          None, rig, Path(), ())
        samples.append(infer_capture(capture, header).estimate.samples[:, LINEAR])
    found, ideal = samples
    return (np.abs(found.mean(axis=0) - ideal.mean(axis=0)) / ideal.std(axis=0)).tolist()


def run(config: Config) -> Result:
    """Cut out all captures, and print the table."""
    settings = {key: config[key] for key in ("rig", "edge_mm", "seed")}
    densities = list(CLUTTER)
    cases = {f"{sensor}_{k}": {
        "number": k, "sensor": sensor, "clutter": densities[(k + shift) % len(densities)],
        "estimated": k < config["estimated"], **settings}
        for shift, sensor in enumerate(SENSORS) for k in range(config["poses"])}
    results = run_cases(case, cases, folder=Path(config["cases"]) / config["rig"],
                        workers=config["workers"], sources=ESTIMATOR)
    groups = {"all": list(results)} | {
        name: [key for key in results if cases[key][kind] == name]
        for kind, names in (("sensor", SENSORS), ("clutter", densities)) for name in names}
    summary = {name: judged([results[key] for key in keys]) for name, keys in groups.items()
               if keys}
    print(table(["", "captures", "failed", "IoU median", "worst", "with background: worst",
                 "across, mm", "worst", "tilt, °", "worst", "from shown: worst", "turn, °", "worst",
                 "log alpha, sd",
                 "true mask"],
                [[name, one["captures"], one["failed"], *one["iou"], one["iou_background"][1],
                  *one["across_mm"], *one["tilt_deg"], one["tilt_from_shown_deg"][1],
                  *one["turn_deg"], one["shift"][0], one["shift_true_mask"][0]]
                 for name, one in summary.items()]))
    return Result({"asked": ASKED, "summary": summary, "cases": results})


def judged(results: list[dict]) -> dict:
    """Median and worst of each figure over captures; 'n/a' where there is none."""
    done = [one for one in results if not one["failed"]]
    found = {"captures": len(results), "failed": len(results) - len(done)}
    for name in ("iou", "iou_background", "across_mm", "along_mm", "tilt_deg", "tilt_sensor_deg",
                 "tilt_from_shown_deg", "turn_deg", "turn_perfect_deg", "shift", "shift_true_mask"):
        values = np.abs(np.concatenate([np.atleast_1d(one[name]) for one in done if name in one]
                                       or [np.zeros(0)]))
        worst = np.min if name.startswith("iou") else np.max
        found[name] = [float(np.median(values)), float(worst(values))] if len(values) else [
            "n/a", "n/a"]
    return found
