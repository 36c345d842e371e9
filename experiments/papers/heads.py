"""Comparison of network outputs: classes, regression or posterior (002, Fig. 18, Eq. 10)."""


from matplotlib.figure import Figure

from experiments.page import Section
from experiments.papers.trainings import Training, error_cell, error_figure, train_all
from experiments.result import Config, Report, Result


def run(config: Config) -> Result:
    """Train networks that differ in the output only."""
    names = ["posterior", "regression", *(f"classes {count}" for count in config["classes"])]
    return Result({"heads": train_all({name: Training(steps=config["steps"], output=name)
                                for name in names}, config)})


def _label(name: str) -> str:
    return {"posterior": "posterior (mean)", "regression": "regression, Eq. 10"}.get(
        name, name.replace("classes ", "classification, ") + " classes per modulus")


def summarise(report: Report) -> str:
    """Summary in sentences."""
    found = {name: one["unseen"]["fabrics"]["log_alpha"]["rmse"]
             for name, one in report["heads"].items()}
    classes = {name: value for name, value in found.items() if name.startswith("classes")}
    best = min(classes, key=classes.__getitem__)
    inside = report["heads"]["posterior"]["unseen"]["fabrics"]["inside"]["68%"]
    return (f"The error of log α is {found['posterior']:.2f} for the mean of a posterior, "
            f"{found['regression']:.2f} for a regression, and {classes[best]:.2f} for the best "
            f"classification ({best.split()[1]} classes). The posterior also states its "
            f"uncertainty: {inside:.0%} of the moduli lie inside its intervals of 68 %.")


def rows(report: Report) -> tuple[list[str], list[list[object]]]:
    """Table of errors by output."""
    return (["output", "log α (95 %)", "β/α (95 %)"],
            [[_label(name), error_cell(one, "log_alpha", interval=True),
              error_cell(one, "beta_over_alpha", interval=True)]
             for name, one in report["heads"].items()])


def draw(report: Report) -> Figure:
    """Plot errors by output."""
    return error_figure({"": {_label(name): one for name, one in report["heads"].items()}})


SECTION = Section(
    "Network output", "002, Figure 18 and Eq. 10",
    "Which output is most accurate: classes, a regression or a posterior?",
    summarise, rows, draw,
    "finds regression better than classification with 8 to 64 classes (Figure 18); figures are "
    "not comparable.",
    "Trainings are short, with one seed each. Classes divide five standard deviations of a "
    "modulus evenly, and the estimate is the centre of the most probable class. Intervals are over "
    "unseen fabrics.")
