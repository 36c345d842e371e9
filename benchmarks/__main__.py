"""Score estimators of bending moduli on the captures of benchmarks/v1.

    python -m benchmarks                            # this release, and the drape coefficient alone
    python -m benchmarks estimator=MODULE:FUNCTION  # yours, from this folder or PYTHONPATH

FUNCTION takes a capture and returns samples (S, 6) of its moduli (README.md).
"""

import common.interrupt  # noqa: F401

# isort: split
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from benchmarks.protocol import Estimator, estimates, read_cases, score
from common.command import command
from common.configs import Workers
from common.errors import InputError, one_line
from common.files import replace_json, require_file
from common.provenance import machine
from drapenet.network.checkpoint import read_header
from experiments.report import markdown

ESTIMATORS = ("benchmarks.estimators:release", "benchmarks.estimators:coefficient_alone")
COLUMNS = {
    "log_alpha_rms": "ln α, rms",
    "log_alpha_median": "median",
    "log_beta_median": "ln β, median",
    "beta_of_wrong_sign": "β of wrong sign",
    "alpha_inside_68": "α inside 68 %",
    "alpha_inside_90": "90 %",
    "beta_inside_68": "β inside 68 %",
    "beta_inside_90": "90 %",
    "drape_coefficient_rms": "drape coefficient, rms",
    "drapes_failed": "drapes failed",
}


@dataclass
class BenchmarkConfig:
    """``configs/benchmarks.yaml``."""

    estimator: str
    out: str
    workers: Workers


@command("benchmarks", BenchmarkConfig)
def main(config: BenchmarkConfig) -> None:
    """Score the estimators, print the table and write the scores."""
    names = [config.estimator] if config.estimator else list(ESTIMATORS)
    out = Path(config.out)
    require_file(out)
    estimators, cases = [estimator_named(name) for name in names], read_cases()
    samples = {name: estimates(estimator, cases)
               for name, estimator in zip(names, estimators, strict=True)}
    samples["truth"] = [case.truth[None] for case in cases]  # of drapes without nuisances
    scores = {name: score(cases, part, workers=config.workers) for name, part in samples.items()}
    replace_json(out, {"machine": machine(), "weights_sha256": read_header().sha256,
                       "scores": scores})
    print(f"{table_of(scores)}\nscores: {out}")


def estimator_named(name: str) -> Estimator:
    """The function of a MODULE:FUNCTION; InputError if it cannot be imported."""
    module, _, function = name.partition(":")
    if not (module and function):
        raise InputError(f"estimator={name}: write MODULE:FUNCTION, such as {ESTIMATORS[1]}")
    try:
        found = getattr(import_module(module), function)
    except (ImportError, AttributeError) as error:
        raise InputError(f"estimator={name} cannot be imported ({one_line(error)}); put its "
                         "file into this folder, or its folder into PYTHONPATH") from None
    if not callable(found):
        raise InputError(f"estimator={name} is no function")
    return found


def table_of(scores: dict[str, dict[str, Any]]) -> str:
    """Markdown table of the scores by estimator and kind of capture."""
    rows = [[name.rpartition(":")[2], kind, str(found["captures"]),
             *("–" if found[key] is None else f"{found[key]:.3g}" for key in COLUMNS)]
            for name, kinds in scores.items() for kind, found in kinds.items()]
    return markdown(["estimator", "kind", "captures", *COLUMNS.values()], rows)


if __name__ == "__main__":
    main()
