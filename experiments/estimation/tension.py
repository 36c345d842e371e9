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
from experiments.result import Config, Result, run_cases
from sim.material import BIAS, DIRECTIONS, REFERENCE_DENSITY, WARP, WEFT
from sim.tension import POISSON

SEED = 59
GAUGES, WIDTHS = (80.0, 100.0, 150.0), (30.0, 50.0, 60.0)  # mm
GROUNDS = ("white", "grey", "blue")
ABOVE = (0.0, 0.0, 10.0)  # mm
STRAINS = {BIAS: (0.01, 0.12), WARP: (0.005, 0.04), WEFT: (0.005, 0.04)}
NARROWING = {BIAS: 0.7, WARP: 0.3, WEFT: 0.3}  # of the width, over the extension
PLACES = {WARP: 0, WEFT: 1, BIAS: 2}  # in the posterior
LEVELS = {"68%": 0.994, "90%": 1.645}  # deviations
FAULTY = 3  # one pair of so many is read with faults, too
EXCHANGED, GAUGE = "pictures exchanged", "gauge 30 % too large"


def read_folder(folder: Path, strip: dict, above: float = 0.0) -> TensionSet:
    """Read ``folder`` with one strip."""
    (folder / FILE).write_text(yaml.safe_dump({
        "density_g_m2": 1e3 * REFERENCE_DENSITY, "above_mat_mm": above, "tension": [strip]}))
    return read_tension(folder)


def pair_case(*, number: int) -> dict:
    """Errors of one pair of photographs."""
    rng = np.random.default_rng([SEED, number])
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
    told = strip.kind | {"direction": DIRECTIONS[direction], "above_mm": above,
                         "true_mm": 1e3 * true, "gauge_mm": gauge, "width_mm": width}
    pictures = {"without": "without.jpg", "with": "with.jpg"}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, share in zip(pictures.values(), (0.0, strain), strict=True):
            replace_file(folder / file, strip.photograph(
                strip.pose(rng, lens), rng, stretch=1 + share,
                narrow=1 - NARROWING[direction] * share, place=tuple(rng.normal(0, 6e-3, 2)),
                turn=number // 2 % 2 * np.pi / 2 + rng.normal(0, 0.05),
                height=max(1e-3 * above + rng.normal(0, ABOVE_ERROR[0]), 0.0)))
        faults = {} if number % FAULTY else {
            EXCHANGED: stated | {"without": "with.jpg", "with": "without.jpg"},
            GAUGE: stated | pictures | {"gauge_mm": 1.3 * gauge}}
        told["faults"] = {fault: _refusal(folder, wrong, above) for fault, wrong in faults.items()}
        try:
            exact = read_folder(folder, stated | {"gauge_mm": 1e3 * strip.gauge(),
                                                  "extension_mm": 1e3 * true}).evidence
            read = read_folder(folder, stated | pictures, above)
            found = read.evidence
        except InputError as error:
            return told | {"failed": str(error).rpartition("/")[2]}
    photographs, place = read.photographs[0], PLACES[direction]
    return told | {
        "failed": "", "warnings": [one.code for one in read.warnings],
        "extension_mm": 1e3 * photographs.extension, "error_mm": 1e3 * photographs.error,
        "off_mm": 1e3 * (photographs.extension - true),
        "turned_deg": float(np.degrees(photographs.turned)),
        "by_reading": float(found.posterior.mean[place] - exact.posterior.mean[place]),
        "below_truth": float((found.samples[:, place] < np.log((warp, weft, shear)[place])).mean())}


def _refusal(folder: Path, strip: dict, above: float) -> str:
    """What a strip is refused with; '' if it is read."""
    try:
        read_folder(folder, strip, above)
    except InputError as error:
        return str(error).rpartition("/")[2]
    return ""


def run(config: Config) -> Result:
    """Read all pairs."""
    cases = run_cases(pair_case, {f"pair_{k:03}": {"number": k} for k in range(config["pairs"])},
                      config)
    read = {name: case for name, case in cases.items() if not case["failed"]}
    groups = {"all": list(read.values())} | {
        name: [case for case in read.values() if wanted(case)] for name, wanted in {
            "bias": lambda case: case["direction"] == "bias",
            "along the yarns": lambda case: case["direction"] != "bias",
            "on the mat": lambda case: not case["above_mm"],
            "10 mm above it": lambda case: case["above_mm"]}.items()}
    answers = {fault: [case["faults"][fault] for case in read.values() if case["faults"]]
               for fault in (EXCHANGED, GAUGE)}
    return Result({
        "pairs": len(cases), "read": len(read),
        "refused": {name: case["failed"] for name, case in cases.items() if case["failed"]},
        "warned": sum(bool(case["warnings"]) for case in read.values()),
        "summary": {name: summarise(some) for name, some in groups.items() if some},
        "faults": {fault: {"pairs": len(some), "found": sum(map(bool, some))}
                   for fault, some in answers.items()},
        "cases": cases})


def summarise(cases: list[dict]) -> dict:
    """Errors of extensions, mm, and of stiffnesses, percent, and coverage in percent."""
    off, error = (np.array([case[key] for case in cases]) for key in ("off_mm", "error_mm"))
    reading = 100 * np.abs([case["by_reading"] for case in cases])
    fabric = norm.ppf(np.clip([case["below_truth"] for case in cases], 1e-4, 1 - 1e-4))

    def inside(values: np.ndarray) -> dict[str, float]:
        return {level: float(100 * (np.abs(values) < limit).mean())
                for level, limit in LEVELS.items()}

    return {"pairs": len(cases), "extension_mm": {
                "median": float(np.median(np.abs(off))),
                "quantile_90": float(np.quantile(np.abs(off), 0.9)),
                "largest": float(np.abs(off).max()), "coverage": inside(off / error)},
            "stiffness": {"median": float(np.median(reading)),
                          "quantile_90": float(np.quantile(reading, 0.9)),
                          "coverage": inside(fabric)}}
