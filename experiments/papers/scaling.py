"""Effect of the numbers of fabrics, drapes and training steps on the error (002, section 5.2)."""


from matplotlib.figure import Figure

from experiments.drapes import posterior_bound
from experiments.page import Section
from experiments.papers.trainings import Training, error_cell, limits, log_alpha, train_all
from experiments.result import Config, Report, Result

_PER_FABRIC = (1, 2, 4)  # drapes


def run(config: Config) -> Result:
    """Train with different numbers of fabrics, of drapes per fabric, and of steps."""
    steps = config["steps"]
    groups = {
        "fabrics": {str(n): Training(fabrics=n, steps=steps) for n in config["fabrics"]},
        "drapes": {str(n): Training("starts", starts=n, steps=steps) for n in _PER_FABRIC},
        "steps": {str(n): Training(steps=n) for n in config["times"]}}
    found = train_all({f"{group} {size}": one for group, members in groups.items()
                       for size, one in members.items()}, config)
    return Result({group: {size: found[f"{group} {size}"] for size in members}
            for group, members in groups.items()})


def summarise(report: Report) -> str:
    """Summary in sentences."""
    def change(group: str) -> tuple[int, float, int, float]:
        found = {int(size): error for size, error in log_alpha(report[group]).items()}
        low, high = min(found), max(found)
        return low, found[low], high, found[high]

    low, few, high, many = change("fabrics")
    one, single, four, several = change("drapes")
    short, early, long, late = change("steps")
    per_fabric = report["drapes"][str(one)]["captures"] // 2
    return (f"From {low} to {high} fabrics the error of log α falls from {few:.2f} to {many:.2f}; "
            f"from {one} to {four} drapes of each of {per_fabric} fabrics from {single:.2f} to "
            f"{several:.2f}; from {short} to {long} steps on all fabrics from {early:.2f} to "
            f"{late:.2f}. The bundled network (3 051 fabrics, 4 500 steps of five times as many "
            f"captures) has 0.17, the posterior bound is {posterior_bound():.2f}.")


def rows(report: Report) -> tuple[list[str], list[list[object]]]:
    """Table of errors of all trainings."""
    names = {"fabrics": "{} fabrics, one drape each", "drapes": "{} drapes per fabric",
             "steps": "{} steps on all fabrics"}
    return (["training data", "captures", "steps", "log α (95 %)", "β/α (95 %)"],
            [[names[group].format(size), one["captures"], one["steps"],
              error_cell(one, "log_alpha", interval=True),
              error_cell(one, "beta_over_alpha", interval=True)]
             for group in names for size, one in report[group].items()])


def draw(report: Report) -> Figure:
    """Plot errors of log alpha over each quantity."""
    figure = Figure(figsize=(9, 3.2), layout="constrained")
    labels = {"fabrics": "fabrics, one drape of each", "drapes": "drapes of each fabric",
              "steps": "steps"}
    for axes, (group, label) in zip(figure.subplots(1, 3, sharey=True), labels.items(),
                                    strict=True):
        middle, bars = limits([one["unseen"]["fabrics"]["log_alpha"]
                               for one in report[group].values()])
        axes.errorbar([int(size) for size in report[group]], middle, bars, fmt="o-")
        axes.axhline(posterior_bound(), color="0.5", ls=":")
        axes.set(xscale="log", xlabel=label, ylim=(0, None))
        axes.set_xticks([int(size) for size in report[group]], list(report[group]))
        axes.minorticks_off()
    figure.axes[0].set_ylabel("error of log α")
    figure.axes[0].annotate("posterior bound", (0.04, posterior_bound()), (0, 3), fontsize=8,
                            xycoords=("axes fraction", "data"), textcoords="offset points")
    return figure


SECTION = Section(
    "Amount of training data", "002, section 5.2",
    "How much do more fabrics, more drapes per fabric, and longer training reduce the error?",
    summarise, rows, draw,
    "uses 6 000 fabrics, eight drapes of each and twelve captures of each drape, and reports no "
    "learning curve.",
    "Sets are small and trained with one seed; intervals are over unseen fabrics, not over "
    "trainings. 16 000 and 48 000 fabrics were not tried.")
