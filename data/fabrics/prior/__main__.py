"""Fit a prior to a table of measured fabrics.

    python -m data.fabrics.prior fit fabrics=FILE [out=FILE] [model=NAME]

The table is a CSV file in the published format: density [kg.m-2], linear moduli [SI*1e9], nonlinear
moduli [SI*1e12], each warp, weft, diag. Repeated rows are one fabric. To draw a dataset's fabrics
from the prior: python -m data.dataset.generate prior.file=outputs/prior.json; ``fit --help`` lists
the keys.
"""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common.command import command, commands
from common.errors import InputError
from common.files import require_file
from data.fabrics.fabrics import read_fabric_table
from data.fabrics.prior import MODELS, save_prior
from data.fabrics.prior.even import draw_fabrics

SAMPLES = 1000  # for the printed quantiles


@dataclass
class FitConfig:
    """``configs/prior_fit.yaml``."""

    fabrics: str
    out: str
    model: str


@command("prior_fit", FitConfig)
def fit(config: FitConfig) -> None:
    """Fit and write a prior; print quantiles of the table and of samples."""
    if not config.fabrics:
        raise InputError("fabrics= is missing; give a table of fabrics: fit fabrics=FILE")
    if config.model not in MODELS:
        raise InputError(f"model={config.model} is unknown; choose from {', '.join(MODELS)}")
    require_file(Path(config.out))
    table = read_fabric_table(config.fabrics)
    start = time.perf_counter()
    prior = MODELS[config.model](table.theta)
    seconds = time.perf_counter() - start
    # Sampled before saving: a prior without admissible samples must not replace a valid file.
    theta, rejected = draw_fabrics(prior, SAMPLES)
    save_prior(prior, config.out)
    print(f"{len(table)} distinct fabrics in {int(table.multiplicity.sum())} rows, "
          f"{config.model} fitted in {seconds:.0f} s")
    print(f"{'median and 90 % range':28}{'table':>26}{'samples':>26}")
    for k, direction in enumerate(("warp", "bias", "weft")):
        print(f"alpha {direction}, µN·m         " + "".join(
            _range(np.exp(values[:, k]) * 1e6) for values in (table.theta, theta)))
    for k, direction in enumerate(("warp", "bias", "weft")):
        print(f"beta/alpha {direction}, mm      " + "".join(
            _range(values[:, 3 + k] * 1e3) for values in (table.theta, theta)))
    print(f"{rejected:.1%} of the samples are no possible fabric and are drawn again")
    print(f"written to {config.out}; use it: python -m data.dataset.generate "
          f"prior.file={config.out}")


def _range(values: np.ndarray) -> str:
    low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
    return f"{middle:10.3g} ({low:.3g} to {high:.3g})".rjust(26)


main = commands({"fit": fit}, usage=__doc__)

if __name__ == "__main__":
    main()
