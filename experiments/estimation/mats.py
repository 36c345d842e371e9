"""Photographs by phones of drapes over the printed mats: outline, camera height and estimate.

Fabrics drawn evenly from limp to stiff, with all nuisances, are photographed on plates 90 to 200 mm
above the mat from 0.4 to 1.5 m, up to 20 degrees beside the axis, with random textures or, where
``shared/photographs`` is present, real ones; in six of seven scenes something makes the hem hard to
see. The picture nearest to the axis is read alone, and all of a drape together; the outline is
compared with the true one from the camera's place and from the axis, and log alpha with the
estimate from the true outline and with the truth.
"""

import tempfile
from pathlib import Path

import cv2
import numpy as np

from common.command import compose_config
from common.errors import InputError
from common.findings import texts
from common.types import Outline
from data.captures.capture import OutlineCapture
from data.captures.photograph import PhotographedOutline
from data.dataset.config import Options, config_from_options
from data.dataset.plan import plan_drape
from data.dataset.reading import Taken, true_radii
from data.fabrics.fabrics import fabric_from_theta
from data.pictures.mat import CODE
from data.pictures.planes import mapped
from data.pictures.reading import decoded
from data.render import textures
from data.render.hard import HARD
from data.render.phone import PhonePicture
from drapenet.fabric.stages import by_network
from drapenet.network.checkpoint import read_header
from experiments.report import Report, percents, rms, table
from experiments.study import CaseKeys, Sample, Study, samples_of
from sim.draping import Drape
from sim.draping import drape as draped
from sim.material import LINEAR, REFERENCE_DENSITY
from sim.rig import Rig

NEAR = 0.1  # the same of pictures near the axis
TARGETS = {
    CODE: {"reading_mm": (0.5, 1.0), "alone": (0.025, 0.08), "together": (0.025, 0.08),
           "silent": 0},
    "plain": {"silent": 0.01, "warned_though_right": 0.15},
}
WRONG, UNLIKELY = 0.15, 2.0  # of alpha, and in deviations
KINDS = ("sound", *HARD)
TEXTURES = Path(__file__).resolve().parents[3] / "shared" / "photographs"
_PATCH, _PIXEL = 90, 3.9e-4  # pixels on each side of the middle, and their size, m


class Keys(CaseKeys):
    testers: tuple[str, ...] = (
        "disc300_support180", "disc240_support180", "disc360_support180", "square300_cylinder100")
    grounds: tuple[str, ...] = (CODE, "white", CODE, "grey")  # of the mats, in turn
    drapes: int = 56  # in turn on each tester, each of another fabric
    pictures: int = 3  # of each drape, from up to 20 degrees beside the axis
    edge_mm: float = 6.0  # edges of the mesh at the plate's rim
    seed: int = 17  # of all random numbers


def drape(rng: np.random.Generator, *, number: int, testers: list[str], grounds: list[str],
          edge_mm: float, pictures: int, seed: int) -> Sample:
    """Errors of the pictures of one drape, of the nearest to the axis alone and of all together."""
    tester = Rig.from_name(testers[number // len(grounds) % len(testers)])
    kind = KINDS[number % len(KINDS)]
    ground = grounds[number % len(grounds)]
    options = compose_config("generate", [
        "nuisances=real", "dataset.even_share=0.8", f"dataset.testers=[{tester.name}]",
        f"seed={seed}"], schema=Options)
    config = config_from_options(options)
    plan = plan_drape(number, config=config.sampling, prior=config.prior)
    shape = draped(fabric_from_theta(plan.theta), rig=plan.nuisances.rig(plan.rig),
                   edge=1e-3 * edge_mm, start=plan.start, seed=plan.seed,
                   offset=tuple(plan.offset), laws=plan.nuisances.laws)
    if not shape.converged:
        raise InputError(f"a drape of fabric {plan.fabric} did not converge ({shape.message}); "
                         "choose another seed=")
    taken = Taken.of(shape.positions, shape.mesh, tester, rng, pictures=pictures,
                     clutter=ground != CODE or kind == "littered", surface=real_texture(rng),
                     ground=ground, hard=(kind,) if kind in HARD else ())
    first = taken.pictures[0]
    found = {**first.kind, "plate_mm": 1e3 * taken.plate_height, "mat": taken.mat, "hard": kind,
             "ground": ground if ground == CODE else "plain", "height_m": taken.place(first)[2],
             "lean": taken.lean(first)}
    truth = np.log(fabric_from_theta(plan.theta).alpha)
    for name, chosen in (("alone", taken.pictures[:1]), ("together", taken.pictures)):
        with tempfile.TemporaryDirectory() as folder:
            found[name] = errors(taken, chosen, Path(folder), shape, truth)
    return found


def errors(taken: Taken, chosen: list[PhonePicture], folder: Path, shape: Drape,
           truth: np.ndarray) -> dict:
    """Errors of a capture of ``chosen`` pictures; ``refused`` has the sentence if it is not read.
    """
    try:
        outline = taken.read(chosen, folder)
    except InputError as error:
        return {"refused": str(error).split("outline.jpg: ")[-1]}
    shown = taken.reference(outline)
    place, warp = taken.place(shown), shown.warp
    assert outline.hem is not None and outline.to_pixels is not None
    assert outline.error is not None
    seen = mapped(outline.hem, np.linalg.inv(outline.to_pixels))
    true_axis, true_seen = (true_radii(shape.positions, shape.mesh.edges, warp, beside, place[2])
                            for beside in (np.zeros(2), place[:2]))
    perfect = PhotographedOutline(curve_of(true_axis), place[2], True, outline.rig)
    alpha, sure = _log_alpha(outline, warp)
    best, _ = _log_alpha(perfect, warp)
    off = outline.radii - true_axis
    return {
        "refused": "", "warnings": texts(outline.warnings),
        "codes": [one.code for one in outline.warnings],
        "reading_mm": 1e3 * rms(
            PhotographedOutline(seen, np.inf, True, outline.rig).radii - true_seen),
        "outline_mm": 1e3 * rms(off), "height_error": outline.height / place[2] - 1,
        "inside": [float((np.abs(off) < times * outline.error).mean()) for times in (1, 2)],
        "alpha_error": (alpha - best).tolist(), "truth_error": (alpha - truth).tolist(),
        "deviation": sure.tolist()}


def real_texture(rng: np.random.Generator) -> textures.Texture | None:
    """The middle of a photograph of real cloth; None for half of the draws, or if there is none."""
    files = sorted(TEXTURES.glob("*.jpg"))
    if not files or rng.random() < 0.5:
        return None
    picture = cv2.imread(str(files[rng.integers(len(files))]))[..., ::-1]
    row, column = (side // 2 for side in picture.shape[:2])
    patch = picture[row - _PATCH : row + _PATCH, column - _PATCH : column + _PATCH]
    return textures.of_picture(decoded(patch / 255.0), _PIXEL)


def curve_of(radius: np.ndarray) -> Outline:
    """The curve of radii (N,) at equal steps of azimuth."""
    angle = np.arange(len(radius)) * (2 * np.pi / len(radius))
    return radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def _log_alpha(outline: PhotographedOutline, warp: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean and deviation (3,) of log alpha that the network estimates."""
    capture = OutlineCapture(outline, density=REFERENCE_DENSITY, rig=outline.rig,
                             warp_direction=warp % np.pi)
    samples = by_network(capture, read_header()).estimate.samples[:, LINEAR]
    return samples.mean(axis=0), samples.std(axis=0)


def run(keys: Keys) -> Report:
    """Evaluate all drapes."""
    drapes = samples_of(drape, keys, keys.drapes)
    groups: dict = {}
    for ground in (CODE, "plain"):
        over = [one for one in drapes.values() if one["ground"] == ground]
        groups |= {
            f"one near the axis ({ground})": [one["alone"] for one in over if one["lean"] < NEAR],
            f"one ({ground})": [one["alone"] for one in over],
            f"{keys.pictures} together ({ground})": [one["together"] for one in over]}
        groups |= {f"{kind} ({ground})": [one["alone"] for one in over if one["hard"] == kind]
                   for kind in KINDS}
    return {"targets": TARGETS, "cases": drapes,
            "summary": {name: summarise(some) for name, some in groups.items() if some}}


def summarise(results: list[Sample]) -> Report:
    """Counts, and median and ninth decile of each error; relative errors of alpha of all three
    directions together; the share of true alpha within 68 % intervals."""
    read = [one for one in results if not one["refused"]]
    found: dict = {"captures": len(results), "refused": len(results) - len(read)}
    if not read:
        return found
    for name in ("reading_mm", "outline_mm", "height_error"):
        found[name] = _deciles(np.abs([one[name] for one in read]))
    for name in ("alpha_error", "truth_error"):
        found[name] = _deciles(np.abs(np.expm1([one[name] for one in read])).ravel())
    off, truth, sure = (np.array([one[name] for one in read]) for name in (
        "alpha_error", "truth_error", "deviation"))
    far = np.abs(np.expm1(off)) > WRONG
    wrong = (far & (np.abs(off) > UNLIKELY * sure)).any(axis=1)
    silent = np.array([not one["warnings"] for one in read])
    right = ~far.any(axis=1)
    return found | {
        "inside": np.mean([one["inside"] for one in read], axis=0).tolist(),
        "inside_68": float((np.abs(truth) < sure).mean()), "wrong": int(wrong.sum()),
        "wrong_in_silence": int((wrong & silent).sum()), "right": int(right.sum()),
        "warned_though_right": int((right & ~silent).sum())}


def _deciles(values: np.ndarray) -> list[float]:
    return [float(np.quantile(values, q)) for q in (0.5, 0.9)]


def block(report: Report) -> str:
    """Errors of photographs over the mat, alone and together."""
    return table(
        ["pictures", "captures", "refused", "outline as seen, mm: median, 9 of 10",
         "from the axis", "of it within one, two stated deviations, %",
         "α off the true outline's, %", "wrong, no warning", "right, with a warning",
         "off the truth, %", "inside 68 %, %"],
        [[name, f"{found['captures']}", f"{found['refused']}",
          *("{:.1f}, {:.1f}".format(*found[key]) for key in ("reading_mm", "outline_mm")),
          percents(found["inside"]), percents(found["alpha_error"]),
          f"{found['wrong_in_silence']} of {found['wrong']}",
          f"{found['warned_though_right']} of {found['right']}",
          percents(found["truth_error"]), percents([found["inside_68"]])]
         for name, found in report["summary"].items() if name.split(" (")[0] not in KINDS])


STUDY = Study(Keys, run, block)
