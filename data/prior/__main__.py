"""Fit a prior to a table of measured fabrics.

    python -m data.prior fit fabrics=FILE [out=FILE] [model=NAME]

fabrics   the table, a CSV file in the published format: density [kg.m-2], linear moduli [SI*1e9],
          nonlinear moduli [SI*1e12], each warp, weft, diag. Rows that repeat are one fabric.
out       where to write the prior, default outputs/prior.json. To draw a dataset's fabrics from
          it: python -m data.generate prior.file=outputs/prior.json
model     vae1 to vae4, gmm3 to gmm7 or gaussian, default vae4
"""

import time
from functools import partial
from pathlib import Path

import numpy as np

from common.cli import parse_overrides, run_command
from common.errors import InputError
from common.files import require_file
from data.fabrics import read_fabric_table
from data.prior import MODELS, sample_admissible, save_prior

SAMPLES = 1000  # of which the printed description is made


def main(argv: list[str]) -> None:
    """The command line: ``fit fabrics=FILE [out=FILE] [model=NAME]``."""
    if not argv or argv[0] != "fit":
        raise InputError("the command is: fit fabrics=FILE; see --help")
    options = parse_overrides(
        {"fabrics": "", "out": "outputs/prior.json", "model": "vae4"}, argv[1:])
    if not options["fabrics"]:
        raise InputError("a table of fabrics is needed: fit fabrics=FILE")
    if options["model"] not in MODELS:
        raise InputError(f"model={options['model']} is unknown; choose from {', '.join(MODELS)}")
    require_file(Path(options["out"]))
    table = read_fabric_table(options["fabrics"])
    start = time.perf_counter()
    prior = MODELS[options["model"]](table.theta)
    seconds = time.perf_counter() - start
    # One that cannot be sampled must not take the place of a good one.
    rng = np.random.default_rng(0)
    draws = [sample_admissible(prior, rng) for _ in range(SAMPLES)]
    save_prior(prior, options["out"])
    print(f"{len(table)} distinct fabrics in {int(table.multiplicity.sum())} rows, "
          f"{options['model']} fitted in {seconds:.0f} s")
    theta = np.array([draw for draw, _ in draws])
    rejected = sum(count for _, count in draws)
    print(f"{'median and 90 % range':28}{'table':>26}{'samples':>26}")
    for k, direction in enumerate(("warp", "bias", "weft")):
        print(f"alpha {direction}, µN·m         " + "".join(
            _range(np.exp(values[:, k]) * 1e6) for values in (table.theta, theta)))
    for k, direction in enumerate(("warp", "bias", "weft")):
        print(f"beta/alpha {direction}, mm      " + "".join(
            _range(values[:, 3 + k] * 1e3) for values in (table.theta, theta)))
    print(f"{rejected / (SAMPLES + rejected):.1%} of the samples are no possible fabric and are "
          "drawn again")
    print(f"written to {options['out']}; use it: python -m data.generate "
          f"prior.file={options['out']}")


def _range(values: np.ndarray) -> str:
    low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
    return f"{middle:10.3g} ({low:.3g} to {high:.3g})".rjust(26)


entry = partial(run_command, main, usage=__doc__)  # console script

if __name__ == "__main__":
    entry()
