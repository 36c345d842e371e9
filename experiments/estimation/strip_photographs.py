"""Curves and moduli from simulated photographs of cantilever strips, and faulty photographs.

Directions of fabrics from the prior have two strips each, of 1.5 and 2.5 bending lengths, at least
20 mm: elasticas with a natural curvature, photographed from a random pose. The strips' alphas
differ from the fabric's by 5 to 10 %, as those of specimens do. In half of the directions the
longer strip hangs with the other face up; in the others one face is measured. Clamp, scale, free
length and the camera's distance have the errors that the reader assumes. The moduli of a
direction's fabric are estimated from its strips together. Faults are those of :data:`FAULTS`; one
is found if the photograph is refused, or has a warning.
"""

import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from common.errors import InputError
from common.findings import texts
from common.normal import Normal
from data.render.strips import StripScene, posed
from drapenet.evidence.state import fabric_prior, prior_along
from drapenet.measured.strips.description import FILE
from drapenet.measured.strips.folder import StripSet, read_strips
from drapenet.measured.strips.photograph import CLAMP_ERROR, LENGTH_ERROR, ROLL_ERROR, SCALE_ERROR
from drapenet.measured.strips.posterior import SLOPE_ERROR
from experiments.drapes import header, prior_theta
from experiments.report import Report, errors, listed, table
from experiments.study import CaseKeys, Sample, Study, grouped, samples_of
from sim.cantilever import heavy_elastica
from sim.cantilever.moduli import distance_across
from sim.material import DIRECTIONS, REFERENCE_DENSITY, gravity_length
from sim.rig import GRAVITY

SEED = 47
LENGTHS, LEAST_LENGTH = (1.5, 2.5), 0.02  # bending lengths, and m
WEIGHT = REFERENCE_DENSITY * GRAVITY
SCALES = ("mm_per_px", "ruler_px", "free_length")  # of the directions in turn
CURL = 5.0  # 1/m, scale of the Laplace distribution of natural curvatures
FACES = ("one face", "both faces")
SCATTER = (0.05, 0.10)  # standard deviations of the specimens' log alpha, uniform over fabrics
MIN_RATIO = 1e-3  # m; errors of beta are relative to the larger of |beta| and this times alpha
DISTANCE_ERROR = 0.02  # relative, of the stated distance of the camera
LEVELS = (0.68, 0.9)


class Keys(CaseKeys):
    directions: int = 240  # of fabrics, with two photographs each
    repeats: int = 2  # photographs with each fault
    seed: int = SEED  # of all random numbers


def direction_of(number: int, seed: int) -> tuple[float, float]:
    """alpha, N·m, and beta/alpha, m, of a direction of a fabric of the prior."""
    theta, k = prior_theta(number // len(DIRECTIONS), seed), number % len(DIRECTIONS)
    return float(np.exp(theta[k])), float(theta[len(DIRECTIONS) + k])


def priors() -> dict[str, Normal]:
    """What is known of each direction before any strip."""
    return prior_along(fabric_prior(header()), REFERENCE_DENSITY)


def draw_scene(
    alpha: float, ratio: float, length: float, rng: np.random.Generator, *, curl: float = 0.0
) -> StripScene:
    """A photograph of the strip of a ``length``, m, with moduli alpha, N·m, and beta/alpha, m, and
    a natural curvature ``curl``, 1/m."""
    level = rng.normal(0, ROLL_ERROR)  # of the clamp, which gives the horizontal
    curve = heavy_elastica(alpha, ratio * alpha, weight=WEIGHT, length=length, points=161,
                           curl=curl, slope=level + rng.normal(0, SLOPE_ERROR))
    dark = rng.random() < 0.5
    scene = StripScene(
        curve, slope=level, edge=rng.normal(0, CLAMP_ERROR),
        thickness=rng.uniform(2e-4, 8e-4), blur=rng.uniform(0.7, 1.6), noise=rng.uniform(2, 6),
        gradient=rng.uniform(0, 0.2), to_the_left=rng.random() < 0.5,
        cloth=rng.uniform(30, 120) if dark else rng.uniform(170, 230),
        ground=rng.uniform(180, 220) if dark else rng.uniform(20, 60),
        clamp=rng.uniform(30, 90) if dark else rng.uniform(120, 200))
    return posed(scene, rng)


def entry_of(scene: StripScene, name: str, length: float, scale: str,
             rng: np.random.Generator) -> dict:
    """What ``strips.yaml`` states of a photograph; the strip's length in m."""
    pixel = 1e3 * scene.field / scene.size[0] * (1 + rng.normal(0, SCALE_ERROR["mm_per_px"]))
    free = 1e3 * (length + rng.normal(0, LENGTH_ERROR))
    scales = {"mm_per_px": {"mm_per_px": pixel},
              "ruler_px": {"ruler_px": [[200, 900], [1200, 900]], "ruler_mm": 1000 * pixel},
              "free_length": {"by": "free_length"}}
    return {"file": name, "direction": "warp", "free_length_mm": float(free),
            "hangs": "left" if scene.to_the_left else "right", "scale": scales[scale],
            "camera_distance_mm": float(1e3 * scene.distance * (1 + rng.normal(0, DISTANCE_ERROR)))}


def read_pictures(pictures: dict[str, np.ndarray], entries: list[dict], **keys) -> StripSet:
    """Read pictures (H, W) by the names of their files, described by ``entries`` and other keys of
    ``strips.yaml``."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, picture in pictures.items():
            (folder / file).write_bytes(cv2.imencode(".png", picture)[1].tobytes())
        content = {"density_g_m2": 1e3 * REFERENCE_DENSITY, "strips": entries} | keys
        (folder / FILE).write_text(yaml.safe_dump(content), encoding="utf-8")
        return read_strips(folder)


def direction(rng: np.random.Generator, *, number: int, seed: int) -> Sample:
    """Errors of the curves and of the moduli of one direction: the errors are those of its strips,
    the intervals those of the fabric."""
    alpha, ratio = direction_of(number, seed)
    scale = SCALES[number // 2 % len(SCALES)]
    curl = float(rng.laplace(0, CURL))
    truth = {"alpha": alpha, "ratio": ratio, "scale": scale, "curl": curl,
             "faces": FACES[number % 2]}
    pictures, entries, scenes = {}, [], []
    apart = rng.uniform(*SCATTER) * rng.standard_normal(len(LENGTHS))
    for k, share in enumerate(LENGTHS):
        length = max(share * gravity_length(alpha, REFERENCE_DENSITY), LEAST_LENGTH)
        down = number % 2 and k
        scenes.append(draw_scene(alpha * np.exp(apart[k]), ratio, length, rng,
                                 curl=-curl if down else curl))
        pictures[f"{k}.png"] = scenes[-1].photograph(rng)
        entries.append(entry_of(scenes[-1], f"{k}.png", length, scale, rng)
                       | {"face": "down" if down else "up"})
    strips = read_pictures(pictures, entries)
    (found,) = strips.evidence(priors()).values()
    off = [distance_across(strip.measured.curve[1:], scene.curve)
           for strip, scene in zip(strips.photographs, scenes, strict=True)]
    true = np.array([alpha, ratio * alpha])  # of the fabric
    measured = alpha * np.exp(apart.mean())  # of its strips
    shown = np.array([measured, ratio * measured])
    size = np.array([measured, measured * max(abs(ratio), MIN_RATIO)])
    return truth | {
        "warnings": texts(one for strip in strips.photographs for one in strip.warnings),
        "curl_found": found.curl,
        "curve_mm": [1e3 * float(np.sqrt((each**2).mean())) for each in off],
        "curve_largest_mm": [1e3 * float(np.abs(each).max()) for each in off],
        "errors": ((np.array([found.alpha, found.beta]) - shown) / size).tolist(),
        "deviations": np.sqrt(np.diag(found.posterior.covariance)).tolist(),
        "scatter": found.scatter,
        "inside": [((spans[:, 0] < true) & (true < spans[:, 1])).tolist()
                   for spans in map(found.intervals, LEVELS)], "misfit": found.misfit}


def _bent(scene: StripScene, at: float, turn: float, *, sharp: bool) -> np.ndarray:
    """The curve with a kink, or a curl of the rest, of ``turn``, rad, from a share of it on."""
    steps = np.diff(scene.curve, axis=0)
    share = np.linspace(0, 1, len(steps))
    angle = turn * (share > at if sharp else np.clip((share - at) / (1 - at), 0, 1))
    cos, sin = np.cos(angle), np.sin(angle)
    turned = np.column_stack([cos * steps[:, 0] + sin * steps[:, 1],
                              -sin * steps[:, 0] + cos * steps[:, 1]])
    return np.vstack([[0, 0], np.cumsum(turned, axis=0)])


def _cropped(picture: np.ndarray, scene: StripScene, *, clamp: bool) -> np.ndarray:
    """The part of a picture without the clamp, or without the tip."""
    columns, rows = scene.pixels(scene.curve).T
    if not clamp:
        return np.ascontiguousarray(picture[: int(rows[-1] - 0.2 * np.ptp(rows))])
    start = columns[0] + 0.15 * (columns[-1] - columns[0])
    kept = picture[:, : int(start)] if scene.to_the_left else picture[:, int(start) :]
    return np.ascontiguousarray(kept)


def _on_pattern(picture: np.ndarray) -> np.ndarray:
    rows, columns = np.indices(picture.shape) // 60
    return np.where((rows + columns) % 2, picture, picture // 2).astype(np.uint8)


def _marked(picture: np.ndarray, scene: StripScene, places: np.ndarray, width: float,
            shade: str) -> np.ndarray:
    """A picture with something drawn over it along places (N, 2), m, of the middle plane."""
    pixels = np.rint(scene.pixels(places)).astype(np.int32)
    thick = max(1, round(width * scene.size[0] / scene.field))
    ground = float(np.median(picture[np.clip(pixels[0, 1], 0, picture.shape[0] - 1)]))
    cv2.polylines(picture, [pixels], False, ground if shade == "ground" else scene.cloth, thick,
                  cv2.LINE_AA)
    return picture


SCENES: dict[str, Callable[[StripScene], dict[str, Any]]] = {
    "no strip": lambda scene: {"curve": 0.02 * scene.curve},
    "no clamp": lambda scene: {"clamp": None},
    "low contrast": lambda scene: {"cloth": 0.93 * scene.ground},
    "out of focus": lambda scene: {"blur": 25.0},
    "rolled by 25°": lambda scene: {"roll": np.radians(25.0)},
    "kinked": lambda scene: {"curve": _bent(scene, 0.4, 1.3, sharp=True)},
    "curled up": lambda scene: {"curve": _bent(scene, 0.4, 1.6, sharp=False)},
    "against a wall": lambda scene: {"curve": _bent(scene, 0.2, -1.6, sharp=False)},
    "clamp slopes by 35°": lambda scene: {
        "slope": np.radians(35), "curve": _bent(scene, 0.0, -0.6, sharp=True)},
    "seen from afar": lambda scene: {"field": 20 * scene.field},
}
STATED: dict[str, Callable[[dict], dict[str, Any]]] = {
    "other side": lambda entry: {"hangs": "right" if entry["hangs"] == "left" else "left"},
    "scale 12 % too large": lambda entry: {
        "scale": {"mm_per_px": 1.12 * entry["scale"]["mm_per_px"]}},
    "scale in cm": lambda entry: {"scale": {"mm_per_px": 0.1 * entry["scale"]["mm_per_px"]}},
    "whole strip's length": lambda entry: {"free_length_mm": entry["free_length_mm"] + 20},
    "clamp_px elsewhere": lambda entry: {"clamp_px": [40.0, 40.0]},
}
PICTURES: dict[str, Callable[[np.ndarray, StripScene], np.ndarray]] = {
    "clamp cut off": lambda picture, scene: _cropped(picture, scene, clamp=True),
    "tip cut off": lambda picture, scene: _cropped(picture, scene, clamp=False),
    "blank": lambda picture, scene: np.full_like(picture, 120),
    "patterned ground": lambda picture, scene: _on_pattern(picture),
    "upside down": lambda picture, scene: np.ascontiguousarray(picture[::-1]),
    "on its side": lambda picture, scene: np.ascontiguousarray(np.rot90(picture)),
    "second strip": lambda picture, scene: _marked(
        picture, scene, scene.curve * [1.15, 0.4] + [0.0, -0.004], 6e-4, "cloth"),
    "ruler in the picture": lambda picture, scene: _marked(
        picture, scene, scene.curve[-1] + np.array([[0.006, 0], [0.006, -0.03]]), 3e-3, "cloth"),
    "thread": lambda picture, scene: _marked(
        picture, scene, scene.curve[80] + np.array([[0, 0], [0.0005, 0.012]]), 3e-4, "cloth"),
    "strip hidden": lambda picture, scene: _marked(
        picture, scene, scene.curve[95] + np.array([[-0.02, 0], [0.02, 0]]), 4e-3, "ground"),
}
FAULTS = (*SCENES, *STATED, *PICTURES)
"""Faults: of what is photographed, of what is stated, and of the picture."""


def fault_case(*, kind: str, number: int, seed: int = SEED) -> Sample:
    """What a photograph with a fault of :data:`FAULTS` is answered with: '' if it is estimated."""
    alpha, ratio = direction_of(7 * number, seed)
    rng = np.random.default_rng([seed, 1, number])
    length = max(LENGTHS[1] * gravity_length(alpha, REFERENCE_DENSITY), LEAST_LENGTH)
    scene = draw_scene(alpha, ratio, length, rng)
    entry = entry_of(scene, "strip.png", length, "mm_per_px", rng)
    if kind in SCENES:
        scene = replace(scene, **SCENES[kind](scene))
    elif kind in STATED:
        entry |= STATED[kind](entry)
    picture = scene.photograph(rng)
    if kind in PICTURES:
        picture = PICTURES[kind](picture, scene)
    try:
        strips = read_pictures({"strip.png": picture}, [entry])
        strips.evidence(priors())
    except InputError as error:
        return {"answer": str(error).partition("strip.png: ")[2] or str(error)}
    return {"answer": "; ".join(texts(strips.photographs[0].warnings))}


def run(keys: Keys) -> Report:
    """Estimate all directions, and read all faulty photographs."""
    refused: dict[str, str] = {}
    done = samples_of(direction, keys, keys.directions, refused=refused, kind="direction")
    answers = {name: case["answer"] for name, case in samples_of(fault_case, keys, {
        f"{kind} {k}": {"kind": kind, "number": k}
        for kind in FAULTS for k in range(keys.repeats)}).items()}
    missed = sorted(name for name, answer in answers.items() if not answer)
    return {
        "photographs": len(LENGTHS) * keys.directions,
        "refused": {name: answer.rpartition("/")[2] for name, answer in refused.items()},
        "with_warnings": sum(bool(case["warnings"]) for case in done.values()),
        "summary": grouped(done, summarise, {
            name: partial(_is_of, name) for name in (*FACES, *SCALES)}),
        "faults": {"kinds": len(FAULTS), "photographs": len(answers),
                   "share_found": 1 - len(missed) / len(answers), "missed": missed},
        "answers": answers}


def _is_of(name: str, case: Sample) -> bool:
    return name in (case["scale"], case["faces"])


def summarise(cases: list[Sample]) -> Report:
    """Errors of curves in mm and of moduli in percent, and coverage in percent."""
    summary: Report = {"directions": len(cases), "curve_mm": errors(
        np.concatenate([case["curve_mm"] for case in cases])) | {
            "largest": float(max(max(case["curve_largest_mm"]) for case in cases))}}
    inside = 100 * np.mean([case["inside"] for case in cases], axis=0)
    for k, name in enumerate(("alpha", "beta")):
        off = 100 * np.array([case["errors"][k] for case in cases])
        summary[name] = errors(off) | {
            "median_signed": float(np.median(off)),
            "coverage": {f"{level:.0%}": float(share)
                         for level, share in zip(LEVELS, inside[:, k], strict=True)}}
    summary["misfit"] = float(np.median([case["misfit"] for case in cases]))
    return summary


def block(report: Report) -> str:
    """Errors of moduli from photographs of strips, and their coverage."""
    moduli = {"α": "alpha", "β": "beta"}
    return table(
        ["strips", "curve, mm", *(f"{modulus}, %: median, 9 of 10" for modulus in moduli),
         *(f"{modulus} inside 68, 90 %" for modulus in moduli)],
        [[name, f"{found['curve_mm']['median']:.2f}",
          *(listed(found[key], ("median", "quantile_90"), ".2g") for key in moduli.values()),
          *(listed(found[key]["coverage"], ("68%", "90%"), ".0f") for key in moduli.values())]
         for name, found in report["summary"].items() if name not in FACES])


STUDY = Study(Keys, run, block)
