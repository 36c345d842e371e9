"""Error of estimates as a function of the number of views (002, Figure 19)."""

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from common.errors import InputError
from data.render.setups import Setups
from drapenet.network.posterior import inside, ranks
from experiments.drapes import (
    capture_drape,
    drape_specimen,
    infer,
    plan_specimen,
    posterior_bound,
    spread,
)
from experiments.report import Report, rms, table
from experiments.study import CaseKeys, Sample, Study, samples_of
from sim.material import LINEAR, RATIO

VIEWS = (1, 2, 3, 4, 6, 8)
_MAX_REFUSED = 5
"""Captures of a drape that may be refused; others take their place, and are counted."""


class Keys(CaseKeys):
    fabrics: int = 60  # drawn from the prior, with all nuisances of specimens
    captures: int = 2  # per fabric and number of views
    edge_mm: float = 3.0  # mesh edge length at the rim
    seed: int = 606
    workers: int = 2


def fabric(*, number: int, captures: int, edge_mm: float, seed: int) -> Sample:
    """Errors, posterior standard deviations and ranks (captures, 6) each, by number of views."""
    plan = plan_specimen(number, seed=seed, nuisances="real")
    shape = drape_specimen(plan, edge=1e-3 * edge_mm)
    result = {}
    for count in VIEWS:
        setups = replace(Setups.load("real"),
                         views=tuple(float(k == count) for k in range(1, 9)))
        found: list[np.ndarray] = []
        refused = 0
        while len(found) < captures and refused < _MAX_REFUSED:  # the same cameras for each number
            rng = np.random.default_rng([seed, number, len(found) + refused])
            try:
                found.append(infer(capture_drape(shape, setups, rng)).estimate.samples)
            except InputError:
                refused += 1
        result[str(count)] = {
            "refused": refused,
            "error": [((one.mean(axis=0) - plan.theta) / spread()).tolist() for one in found],
            "deviation": [(one.std(axis=0) / spread()).tolist() for one in found],
            "rank": [ranks(one[:, None], plan.theta[None])[0].tolist() for one in found]}
    return result


def run(keys: Keys) -> Report:
    """Run all fabrics."""
    return report_of(samples_of(fabric, keys, keys.fabrics, kind="fabric"))


def report_of(found: dict[str, Sample]) -> Report:
    """Errors, deviations and coverage by number of views."""
    report: Report = {"views": {}}
    rng = np.random.default_rng(0)
    for count in map(str, VIEWS):
        # A fabric has fewer captures than others, or none, if too many of its are refused.
        read = [one[count] for one in found.values() if one[count]["error"]]
        error, deviation, rank = (np.concatenate([one[key] for one in read])
                                  for key in ("error", "deviation", "rank"))
        resampled = [rms(np.concatenate([read[k]["error"] for k in rows])[:, LINEAR])
                     for rows in rng.integers(len(read), size=(400, len(read)))]
        report["views"][count] = {
            "captures": len(error),
            "log_alpha": rms(error[..., LINEAR]),
            "interval_95": np.quantile(resampled, [0.025, 0.975]).tolist(),
            "beta_over_alpha": rms(error[..., RATIO]),
            "deviation": rms(deviation[..., LINEAR]),
            "inside": inside(rank)}
    report["refused_captures"] = {count: sum(one[count]["refused"] for one in found.values())
                         for count in map(str, VIEWS)}
    return report | {"bound": posterior_bound()}


def block(report: Report) -> str:
    """Summary and table."""
    four, eight = (report["views"][count]["log_alpha"] for count in ("4", "8"))
    text = (f"The error of log α of eight views is {100 * (1 - eight / four):.0f} % less than of "
            "four. In the same unit, the posterior bound of four views with a good sensor is "
            f"{report['bound']:.3f} ([validation](validation.md#what-a-drape-determines)).")
    head = ["views", "log α (95 %)", "β/α", "posterior deviation of log α",
            "truth inside 50, 68, 90 %"]
    rows = [[count, "{:.3f} ({:.3f} to {:.3f})".format(one["log_alpha"], *one["interval_95"]),
             f"{one['beta_over_alpha']:.2f}", f"{one['deviation']:.3f}",
             ", ".join(f"{100 * share:.0f}" for share in one["inside"].values())]
            for count, one in report["views"].items()]
    return f"{text}\n\n{table(head, rows)}"


def draw(report: Report) -> Figure:
    """Plot error and posterior standard deviation over views."""
    figure = Figure(figsize=(6, 3.4), layout="constrained")
    axes = figure.subplots()
    count = [int(key) for key in report["views"]]
    values = list(report["views"].values())
    low, high = np.transpose([one["interval_95"] for one in values])
    axes.fill_between(count, low, high, color="#2f6da8", alpha=0.15, lw=0)
    axes.plot(count, [one["log_alpha"] for one in values], "o-", color="#2f6da8", label="error")
    axes.plot(count, [one["deviation"] for one in values], "s--", color="#b5403a",
              label="posterior's standard deviation")
    axes.set(xlabel="views", ylabel="log α [spread over fabrics]", ylim=(0, None))
    axes.legend(frameon=False)
    return figure


STUDY = Study(Keys, run, block, draw)
