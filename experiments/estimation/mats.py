"""Photographs by phones of drapes over the printed mat: outline, camera height and estimate.

Fabrics drawn evenly from limp to stiff are draped and photographed (:mod:`data.render.phone`) from
0.4 to 1.5 m above the plate, up to 250 mm beside its axis, up to 15 degrees off the vertical, with
two focal lengths' worth of phones, lenses that distort, soft and hard shadows, patterns and JPEG;
each picture is read as a user's. The outline is compared with the true one as seen from the
camera's true place (reading) and from the axis (what is estimated from); log alpha with that of the
true outline from the axis.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from common.errors import InputError
from common.findings import texts
from common.types import Metres, Outline
from data.captures.capture import OutlineCapture
from data.captures.photograph import AZIMUTHS, PhotographedOutline
from data.captures.reader import read_capture
from data.dataset.off_axis import silhouette
from data.pictures.planes import mapped
from data.render.phone import mat_around, phone_picture
from drapenet.estimator.stages import by_network
from experiments.drapes import drape_as_planned, header, plan_specimen
from experiments.result import ESTIMATOR, Config, Result, run_cases
from sim.drape import Drape
from sim.material import LINEAR, REFERENCE_DENSITY
from sim.rig import Rig

MARGIN = (0.02, 0.12)  # m, of the lowest cloth above the mat
TARGETS = {"outline_mm": (0.5, 1.0), "alpha": (0.03, 0.08), "silent": 1 / 200}
WRONG = 0.15  # of alpha


def case(*, number: int, rig: str, edge_mm: float, seed: int) -> dict:
    """Errors of one photograph; ``refused`` has the sentence if it is not read."""
    tester = Rig.from_name(rig)
    plan = plan_specimen(number, "dataset.even_share=0.8", rig=tester, seed=seed)
    shape = drape_as_planned(plan, edge=1e-3 * edge_mm)
    rng = np.random.default_rng([seed, number])
    plate_height = float(-shape.positions[:, 2].min() + rng.uniform(*MARGIN))
    mat = mat_around(tester.reach)
    picture = phone_picture(shape.positions, shape.mesh.rest, shape.faces, rng, mat=mat,
                            plate_radius=tester.plate_radius, plate_height=plate_height)
    place = picture.pose.place - [0, 0, plate_height]
    known = {**picture.kind, "height_m": place[2], "beside_m": float(np.hypot(*place[:2])),
             "tilt_deg": float(np.degrees(picture.pose.tilt))}
    with tempfile.TemporaryDirectory() as folder:
        picture.write(Path(folder), density=REFERENCE_DENSITY, tester=rig, mat=mat,
                      plate_height=plate_height)
        try:
            read = read_capture(Path(folder))
        except InputError as error:
            return known | {"refused": str(error).split("outline.jpg: ")[-1]}
    assert read.outline and read.outline.hem is not None and read.outline.to_pixels is not None
    seen = mapped(read.outline.hem, np.linalg.inv(read.outline.to_pixels))
    true_seen = true_radii(shape, picture.warp, place[:2], place[2])
    true_axis = true_radii(shape, picture.warp, np.zeros(2), place[2])
    perfect = PhotographedOutline(curve_of(true_axis), place[2], True, tester)
    alpha, sure = _log_alpha(read.outline, tester, picture.warp)
    best, _ = _log_alpha(perfect, tester, picture.warp)
    return known | {
        "refused": "", "warnings": texts(read.warnings),
        "reading_mm": _rms(replace(read.outline, curve=seen).radii - true_seen), "outline_mm": _rms(
            read.outline.radii - true_axis),
        "height_error": read.outline.height / place[2] - 1,
        "coefficient": perfect.drape_coefficient,
        "coefficient_error": read.outline.drape_coefficient - perfect.drape_coefficient,
        "alpha_error": (alpha - best).tolist(), "alpha_deviation": sure.tolist()}


def true_radii(shape: Drape, warp: float, beside: np.ndarray, height: Metres) -> np.ndarray:
    """Radii (720,), m, in the plane of the plate, of what a camera sees from a ``height`` above it
    and a place (2,) ``beside`` its axis, with the warp turned."""
    cos, sin = np.cos(warp), np.sin(warp)
    points = shape.positions @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1.0]])
    return silhouette(points, shape.mesh.edges, beside, height, azimuths=AZIMUTHS)


def curve_of(radius: np.ndarray) -> Outline:
    """The curve of radii (N,) at equal steps of azimuth."""
    angle = np.arange(len(radius)) * (2 * np.pi / len(radius))
    return radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def _rms(error: np.ndarray) -> float:
    """Root mean square, mm."""
    return 1e3 * float(np.sqrt(np.square(error).mean()))


def _log_alpha(
    outline: PhotographedOutline, rig: Rig, warp: float
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and deviation (3,) of log alpha that the network estimates."""
    capture = OutlineCapture(outline, density=REFERENCE_DENSITY, rig=rig,
                             warp_direction=warp % np.pi)
    samples = by_network(capture, header()).estimate.samples[:, LINEAR]
    return samples.mean(axis=0), samples.std(axis=0)


def run(config: Config) -> Result:
    """Evaluate all photographs."""
    cases = {f"{k}": {
        "number": k, "rig": config["testers"][k % len(config["testers"])],
        "edge_mm": config["edge_mm"], "seed": config["seed"]}
        for k in range(config["photographs"])}
    results = run_cases(case, cases, config, sources=ESTIMATOR)
    groups = {"all": list(results)} | {
        tester: [k for k in results if cases[k]["rig"] == tester] for tester in config["testers"]}
    groups |= {f"beside {low:g} to {high:g} of the height": [
        k for k, one in results.items() if low <= one["beside_m"] / one["height_m"] < high]
        for low, high in ((0, 0.1), (0.1, 0.2), (0.2, 0.4), (0.4, 1.0))}
    return Result({"targets": TARGETS, "cases": results, "summary": {
        name: summarise([results[key] for key in keys]) for name, keys in groups.items() if keys}})


def summarise(results: list[dict]) -> dict:
    """Counts, and median and ninth decile of each error; relative errors of alpha of all three
    directions together."""
    read = [one for one in results if not one["refused"]]
    found: dict = {"photographs": len(results), "refused": len(results) - len(read)}
    if not read:
        return found
    for name in ("reading_mm", "outline_mm", "height_error", "coefficient_error"):
        found[name] = _deciles(np.abs([one[name] for one in read]))
    worst = np.array([np.abs(np.expm1(one["alpha_error"])).max() for one in read])
    found["alpha"] = _deciles(np.abs(np.expm1([one["alpha_error"] for one in read])).ravel())
    silent = [not one["warnings"] for one in read]
    return found | {"warned": int(len(read) - sum(silent)),
                    "wrong": int((worst > WRONG).sum()),
                    "wrong_in_silence": int(((worst > WRONG) & silent).sum())}


def _deciles(values: np.ndarray) -> list[float]:
    return [float(np.quantile(values, q)) for q in (0.5, 0.9)]
