"""The protocol, version 1: captures with known moduli, what an estimator is asked, and its score.

A change of anything here that changes a score is a new version, with a folder of its own.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from common.arguments import numbers
from common.documents import reading
from common.errors import InputError, one_line
from common.tables import number, read_table
from data.captures.capture import Capture
from data.captures.reader import read_capture
from sim.many import drape_many
from sim.material import MICRO, NANO, Fabric
from sim.measures import drape_coefficient

CASES = Path(__file__).parent / "v1"
TRUTH = "truth.csv"
COLUMNS = ("case", *(f"alpha_{name}_uN_m" for name in ("warp", "bias", "weft")),
           *(f"beta_{name}_nN_m2" for name in ("warp", "bias", "weft")),
           "drape_coefficient_percent")
UNITS = np.array([MICRO] * 3 + [NANO] * 3)
MOST_ALPHA = 0.1  # N·m, five times that of the stiffest fabrics
LEVELS = (68, 90)  # %, of central intervals
EDGE = 6e-3  # m, of the meshes on which estimates are draped

Moduli = Annotated[np.ndarray, "(..., 6) alpha of warp, bias, weft, N·m, then beta, N·m²"]
Estimator = Callable[[Capture], Moduli]
"""From a capture to (S, 6) samples of the moduli at its density; (1, 6) without an uncertainty."""


@dataclass(frozen=True)
class Case:
    """A capture of a simulated specimen.

    Attributes:
        truth: (6,) moduli at the capture's density.
        coefficient: drape coefficient of the drape that was captured, %.
    """

    name: str
    capture: Capture
    truth: Moduli
    coefficient: float

    @property
    def kind(self) -> str:
        """What was captured: outline or depth."""
        return self.name.partition("_")[0]


def read_cases(folder: Path = CASES) -> list[Case]:
    """The cases of a folder; InputError if one of its files is missing or faulty."""
    header, rows = read_table(folder / TRUTH, "truth")
    if tuple(header) != COLUMNS:
        raise InputError(f"{folder / TRUTH}: its first line must be {','.join(COLUMNS)}")
    with reading(folder / TRUTH, "restore it with git checkout"):
        values = np.array([[number(cell) for cell in row[1:]] for _, row in rows])
    return [Case(row[0], read_capture(folder / row[0]), value[:6] * UNITS, value[6])
            for (_, row), value in zip(rows, values, strict=True)]


def estimates(estimator: Estimator, cases: Sequence[Case]) -> list[Moduli]:
    """Samples (S, 6) of each case; InputError for other shapes, values that are not finite, and
    linear moduli that are not positive."""
    found = []
    for case in cases:
        samples = numbers(f"the estimate of {case.name}", estimator(case.capture),
                          "finite samples (S, 6): alpha of warp, bias, weft in N·m, beta in N·m²",
                          (None, 6))
        if not len(samples) or samples[:, :3].min() <= 0:
            raise InputError(f"the estimate of {case.name} has no samples, or one whose alpha is "
                             f"{samples[:, :3].min(initial=0):.3g} N·m; give positive ones")
        if np.median(samples[:, :3]) > MOST_ALPHA:
            raise InputError(f"the estimate of {case.name} has an alpha of "
                             f"{np.median(samples[:, :3]):.3g} N·m, more than {MOST_ALPHA:g}; give "
                             "N·m and N·m², not µN·m and nN·m²")
        found.append(samples)
    return found


def score(cases: Sequence[Case], samples: Sequence[Moduli], *, workers: int = 1) -> dict[str, Any]:
    """Scores by kind of capture, of samples (S, 6) of each case; docs: ``benchmarks/README.md``."""
    middle = np.array([np.median(part, axis=0) for part in samples])
    coefficient = draped(middle, cases, workers=workers)
    truth = np.array([case.truth for case in cases])
    same = np.sign(middle) == np.sign(truth)
    with np.errstate(divide="ignore"):
        error = np.abs(np.log(np.abs(middle / truth)))
    inside = {level: np.array([
        (low <= true) & (true <= high) for true, part in zip(truth, samples, strict=True)
        for low, high in [np.percentile(part, [50 - level / 2, 50 + level / 2], axis=0)]])
        for level in LEVELS}
    uncertain = any(len(part) > 1 for part in samples)
    missed = coefficient - [case.coefficient for case in cases]
    report = {}
    for kind in dict.fromkeys(case.kind for case in cases):
        rows = np.array([case.kind == kind for case in cases])
        beta = error[rows, 3:][same[rows, 3:]]
        drapes = missed[rows][np.isfinite(missed[rows])]
        report[kind] = {
            "captures": int(rows.sum()),
            "log_alpha_rms": float(np.sqrt(np.square(error[rows, :3]).mean())),
            "log_alpha_median": float(np.median(error[rows, :3])),
            "log_beta_median": float(np.median(beta)) if len(beta) else None,
            "beta_of_wrong_sign": float(1 - same[rows, 3:].mean()),
            **{f"{name}_inside_{level}": float(part[rows, columns].mean()) if uncertain else None
               for name, columns in (("alpha", slice(3)), ("beta", slice(3, 6)))
               for level, part in inside.items()},
            "drape_coefficient_rms": float(np.sqrt(np.square(drapes).mean())) if len(drapes) else
            None,
            "drapes_failed": int(rows.sum() - len(drapes))}
    return report


def draped(moduli: Moduli, cases: Sequence[Case], *, workers: int) -> np.ndarray:
    """Drape coefficients (N,), %, of fabrics of ``moduli`` (N, 6) on the testers of the cases; NaN
    of those that cannot be draped."""
    plans = {}
    for k, (row, case) in enumerate(zip(moduli, cases, strict=True)):
        try:
            fabric = Fabric(row[:3], row[3:], density=case.capture.density)
        except InputError as error:
            print(f"{case.name} is not draped: {one_line(error)}")
            continue
        plans[k] = {"fabric": fabric, "rig": case.capture.rig, "edge": EDGE}
    found = np.full(len(cases), np.nan)
    for k, cloth in zip(plans, drape_many(list(plans.values()), workers=workers), strict=True):
        if cloth.converged:
            found[k] = 100 * drape_coefficient(cloth.positions, cloth.faces, cloth.rig)
    return found
