"""Extensions of strips under weights from simulated pairs of photographs over the mat.

Fabrics are those of the prior of stretch and shear; each has one strip, half of them along the
bias, whose stiffness differs from the fabric's, and which bears a friction, as the estimate
assumes.
Strips lie or hang on mats of three grounds (:mod:`data.render.pulled`), at another place and seen
from another place in each of the two pictures. The stiffness by the photographs is compared with
that by the true extension, and with the fabric's. Every third pair is
read twice more with a fault: its pictures exchanged, and the nominal gauge 30 % too large; a fault
is found if the pair is refused.
"""

import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import yaml
from scipy.stats import norm

from common.errors import InputError
from common.files import replace_file
from data.readings.quantity import SPECIMEN_SCATTER, STANDARD_GRAVITY
from data.render.pulled import MarkedStrip
from drapenet.measured.tension.description import FILE
from drapenet.measured.tension.folder import TensionSet, read_tension
from drapenet.measured.tension.law import compliance, load
from drapenet.measured.tension.photograph import ABOVE_ERROR
from drapenet.measured.tension.posterior import FRICTION, prior
from experiments.report import Report, errors, listed, table
from experiments.study import CaseKeys, Sample, Study, grouped, samples_of
from sim.material import BIAS, DIRECTIONS, REFERENCE_DENSITY, WARP, WEFT
from sim.tension import POISSON

GAUGES, WIDTHS = (80.0, 100.0, 150.0), (30.0, 50.0, 60.0)  # mm
GROUNDS = ("white", "grey", "blue")
ABOVE = (0.0, 0.0, 10.0)  # mm
STRAINS = {BIAS: (0.01, 0.12), WARP: (0.005, 0.04), WEFT: (0.005, 0.04)}
NARROWING = {BIAS: 0.7, WARP: 0.3, WEFT: 0.3}  # of the width, over the extension
PLACES = {WARP: 0, WEFT: 1, BIAS: 2}  # in the posterior
LEVELS = {"68%": 0.994, "90%": 1.645}  # deviations
FAULTY = 3  # one pair of so many is read with faults, too
FAULTS = {"pictures exchanged": {"without": "with.jpg", "with": "without.jpg"},
          "gauge 30 % too large": {"gauge_mm": 1.3}}
"""What is stated wrongly; a number is a factor."""
GROUPS = {"bias": lambda pair: pair["direction"] == "bias",
          "along the yarns": lambda pair: pair["direction"] != "bias",
          "on the mat": lambda pair: not pair["above_mm"],
          "10 mm above it": lambda pair: pair["above_mm"]}


class Keys(CaseKeys):
    pairs: int = 200  # strips, with two photographs each
    seed: int = 59  # of all random numbers


def read_folder(folder: Path, strip: Mapping[str, object], above: float = 0.0) -> TensionSet:
    """Read ``folder`` with one strip."""
    (folder / FILE).write_text(yaml.safe_dump({
        "density_g_m2": 1e3 * REFERENCE_DENSITY, "above_mat_mm": above, "tension": [dict(strip)]}))
    return read_tension(folder)


def pair(rng: np.random.Generator, *, number: int) -> Sample:
    """Errors of one pair of photographs."""
    direction = (BIAS, WARP, BIAS, WEFT)[number % 4]
    fabric = prior(REFERENCE_DENSITY)
    warp, weft, shear = np.exp(rng.multivariate_normal(fabric.mean, fabric.covariance))
    gauge, width = float(rng.choice(GAUGES)), float(rng.choice(WIDTHS))
    above, ground = ABOVE[number // 4 % 3], GROUNDS[number % 3]
    strip = MarkedStrip.random(rng, gauge=1e-3 * gauge, width=1e-3 * width, ground=ground)
    strain = float(rng.uniform(*STRAINS[direction]))
    needed = float(load(strain, compliance(direction, (warp, weft, shear), POISSON)))
    borne = max(FRICTION * rng.standard_normal() + needed * np.exp(
        SPECIMEN_SCATTER * rng.standard_normal()), needed / 2)
    lens = rng.uniform(24, 30), float(np.clip(rng.normal(0, 0.012), -0.03, 0.03))
    stated = {"direction": DIRECTIONS[direction], "width_mm": width, "gauge_mm": gauge,
              "load_g": float(1e5 * borne * 1e-3 * width / STANDARD_GRAVITY) / 100}
    true = strip.gauge(1 + strain) - strip.gauge()
    pictures = {"without": "without.jpg", "with": "with.jpg"}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, share in zip(pictures.values(), (0.0, strain), strict=True):
            replace_file(folder / file, strip.photograph(
                strip.pose(rng, lens), rng, stretch=1 + share,
                narrow=1 - NARROWING[direction] * share, place=tuple(rng.normal(0, 6e-3, 2)),
                turn=number // 2 % 2 * np.pi / 2 + rng.normal(0, 0.05),
                height=max(1e-3 * above + rng.normal(0, ABOVE_ERROR[0]), 0.0)))
        exact = read_folder(folder, stated | {"gauge_mm": 1e3 * strip.gauge(),
                                              "extension_mm": 1e3 * true}).evidence
        read = read_folder(folder, stated | pictures, above)
        faults = {} if number % FAULTY else {
            fault: _refusal(folder, stated | pictures, wrong, above)
            for fault, wrong in FAULTS.items()}
    photographs, place, found = read.photographs[0], PLACES[direction], read.evidence
    return strip.kind | {
        "direction": DIRECTIONS[direction], "above_mm": above, "true_mm": 1e3 * true,
        "gauge_mm": gauge, "width_mm": width, "faults": faults,
        "warnings": [one.code for one in read.warnings],
        "extension_mm": 1e3 * photographs.extension, "error_mm": 1e3 * photographs.error,
        "off_mm": 1e3 * (photographs.extension - true),
        "turned_deg": float(np.degrees(photographs.turned)),
        "by_reading": float(found.posterior.mean[place] - exact.posterior.mean[place]),
        "below_truth": float((found.samples[:, place] < np.log((warp, weft, shear)[place])).mean())}


def _refusal(folder: Path, strip: dict, wrong: Mapping[str, object], above: float) -> str:
    """What a strip with a fault is refused with; '' if it is read."""
    wrong = {key: value * strip[key] if isinstance(value, float) else value
             for key, value in wrong.items()}
    try:
        read_folder(folder, strip | wrong, above)
    except InputError as error:
        return str(error).rpartition("/")[2]
    return ""


def run(keys: Keys) -> Report:
    """Read all pairs."""
    refused: dict[str, str] = {}
    pairs = samples_of(pair, keys, keys.pairs, refused=refused, kind="pair")
    answers = {fault: [one["faults"][fault] for one in pairs.values() if one["faults"]]
               for fault in FAULTS}
    return {
        "pairs": keys.pairs, "read": len(pairs),
        "refused": {name: answer.rpartition("/")[2] for name, answer in refused.items()},
        "warned": sum(bool(one["warnings"]) for one in pairs.values()),
        "summary": grouped(pairs, summarise, GROUPS),
        "faults": {fault: {"pairs": len(some), "found": sum(map(bool, some))}
                   for fault, some in answers.items()},
        "cases": pairs}


def summarise(pairs: list[Sample]) -> Report:
    """Errors of extensions, mm, and of stiffnesses, percent, and coverage in percent."""
    off, error = (np.array([one[key] for one in pairs]) for key in ("off_mm", "error_mm"))
    reading = 100 * np.array([one["by_reading"] for one in pairs])
    fabric = norm.ppf(np.clip([one["below_truth"] for one in pairs], 1e-4, 1 - 1e-4))

    def inside(values: np.ndarray) -> dict[str, float]:
        return {level: float(100 * (np.abs(values) < limit).mean())
                for level, limit in LEVELS.items()}

    return {"pairs": len(pairs),
            "extension_mm": errors(off) | {"coverage": inside(off / error)},
            "stiffness": errors(reading) | {"coverage": inside(fabric)}}


def block(report: Report) -> str:
    """Errors of extensions by photographs, and of the stiffnesses by them."""
    return table(
        ["strips", "pairs", "extension, mm: median, 9 of 10, largest", "inside 68, 90 %",
         "stiffness off that by the true extension, %", "fabric inside 68, 90 %"],
        [[name, f"{found['pairs']}",
          listed(found["extension_mm"], ("median", "quantile_90", "largest"), ".2f"),
          listed(found["extension_mm"]["coverage"], LEVELS, ".0f"),
          listed(found["stiffness"], ("median", "quantile_90"), ".1f"),
          listed(found["stiffness"]["coverage"], LEVELS, ".0f")]
         for name, found in report["summary"].items()])


STUDY = Study(Keys, run, block)
