"""What the network errs by on cloth: ``python -m benchmarks.network_errors [key=value ...]``.

The network has learned from drapes on meshes; cloth has none. Fabrics of the prior are draped on
the default mesh, and again on a fine one, from that shape, so that the folds are the same. Both are
photographed from the same place with the same noise and estimated. Reported are the errors on both,
what the mesh adds to them, and how errors of different moduli go together. ``infer.py`` takes the
mean error on fine drapes off, and ``refine=depth`` weighs the network's word by what is left
(:func:`drapenet.estimate.belief`).

Keys (``key=value``):

    checkpoint   NAME.safetensors with NAME.json beside it; empty: the bundled one
    calibrate    true: write the figures into the checkpoint's JSON, where they are used
    fabrics      drawn from the prior
    fine_mm      edges at the rim of the fine drape
    sensor       noise of the views, a file of configs/sensor
    seed         of everything
    workers      processes, one thread each
    cases        folder of finished fabrics; an interrupted run goes on from there
    out          the report, JSON
"""

import json
import math
from pathlib import Path

import numpy as np

from benchmarks.common import ESTIMATOR, REPORTS, parse_settings, run_cases, table, write_report
from benchmarks.photographs import photographed, place
from common.cli import run_command
from common.errors import InputError
from common.files import replace_file
from data.fabrics import fabric_from_theta
from data.prior import load_prior, sample_admissible
from drapenet.convention import TARGET_NAMES
from drapenet.network_errors import NetworkErrors
from sim.drape import DrapeResult, drape

LEAST = 20
"""Fabrics for a covariance of six errors."""
DEFAULTS = {
    "checkpoint": "",
    "calibrate": False,
    "fabrics": 96,
    "fine_mm": 1.25,
    "sensor": "smooth",
    "seed": 79,
    "workers": 2,
    "cases": "outputs/validation/network_errors",
    "out": str(REPORTS / "network_errors.json"),
}


def estimates(number: int, checkpoint: str, fine_mm: float, sensor: str, seed: int) -> dict:
    """What the network says of one fabric's drape on both meshes."""
    from drapenet.checkpoint import BUNDLED, load_model, read_header
    from drapenet.predict import predict

    rng = np.random.default_rng([seed, number])
    theta, _ = sample_admissible(load_prior("gaussian"), rng)
    fabric = fabric_from_theta(theta)
    own = drape(fabric, seed=number)
    fine = drape(fabric, edge=1e-3 * fine_mm, borrowed=(own.rest, own.positions), seed=number)
    camera, turn = place(rng)
    header = read_header(checkpoint or BUNDLED)
    model = load_model(header)

    def say(shape: DrapeResult) -> list[float]:
        views = photographed(shape, camera, turn, sensor=sensor, seed=number)
        return predict(model, views, form=header.form, scale=header.scale).targets.tolist()

    converged = own.converged and fine.converged
    return {"theta": theta.tolist(), "edge_mm": 1e3 * own.edge, "converged": converged,
            **({"own": say(own), "fine": say(fine)} if converged else {})}


def main(argv: list[str]) -> None:
    """Measure, print the table, write the report and, if wanted, into the checkpoint's JSON."""
    import torch

    from drapenet.checkpoint import BUNDLED, read_header
    from drapenet.targets import to_stiff_soft

    config = parse_settings(DEFAULTS, argv)
    header = read_header(config["checkpoint"] or BUNDLED)
    settings = {key: config[key] for key in ("checkpoint", "fine_mm", "sensor", "seed")}
    # Other weights of the same name are another network.
    label = header.identity["sha256"][:16]
    found = run_cases(estimates, {
        f"fabric_{k}_{label}": {"number": k, **settings} for k in range(config["fabrics"])},
        folder=Path(config["cases"]), workers=config["workers"], sources=ESTIMATOR)
    good = [c for c in found.values() if c["converged"]]
    if len(good) < LEAST:
        raise InputError(f"{len(good)} of {len(found)} fabrics are draped on both meshes; at least "
                         f"{LEAST} are needed: give more fabrics=")
    own, fine = (np.array([c[key] for c in good]) for key in ("own", "fine"))
    truth = np.array([to_stiff_soft(torch.tensor(c["theta"])).tolist() for c in good])
    change, errors = fine - own, NetworkErrors.fit(fine, truth)
    summary = {
        "more on the fine mesh": change.mean(axis=0).tolist(),
        "its standard error": (change.std(axis=0, ddof=1) / math.sqrt(len(good))).tolist(),
        "error on its own mesh": np.sqrt(((own - truth) ** 2).mean(axis=0)).tolist(),
        "error on the fine mesh": np.sqrt(((fine - truth) ** 2).mean(axis=0)).tolist(),
        "of that the mean": errors.mean.tolist(),
        "the mean's change with the level": errors.slope.tolist(),
        "around the mean": errors.deviation.tolist(),
    }
    correlation = errors.covariance / np.outer(errors.deviation, errors.deviation)
    print(table(["", *TARGET_NAMES], [[key, *values] for key, values in summary.items()]))
    print(table(["correlation of errors", *TARGET_NAMES],
                [[name, *row] for name, row in zip(TARGET_NAMES, correlation, strict=True)]))
    write_report(Path(config["out"]), {"settings": settings, "summary": summary,
                                        "correlation": correlation.tolist(), "cases": found})
    if config["calibrate"]:
        description = header.path.with_suffix(".json")
        content = {**header.content,
                   "errors": {**errors.as_dict(), "fine_mm": config["fine_mm"]}}
        replace_file(description, (json.dumps(content, indent=1) + "\n").encode())
        print(f"written into {description}")


if __name__ == "__main__":
    run_command(main, usage=__doc__)
