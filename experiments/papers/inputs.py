"""Comparison of network inputs, backbones and outputs (002, Figures 18 and 20, Table 2, Eq. 10)."""

from matplotlib.figure import Figure

from experiments.page import Section
from experiments.papers.trainings import Training, error_cell, error_figure, log_alpha, train_all
from experiments.result import Config, Report, Result, table

INPUTS: dict[str, tuple[str, str, str]] = {
    "map, width 16": ("canonical map", "map", "16"),
    "map, width 8": ("canonical map", "map", "8"),
    "map, width 32": ("canonical map", "map", "32"),
    "outline": ("boundary curve, radius and height", "outline", "16"),
    "numbers": ("drape coefficient and number of folds", "numbers", ""),
    "ResNet-18": ("four depth views", "views", "resnet18"),
    "ResNet-34": ("four depth views", "views", "resnet34"),
    "AlexNet": ("four depth views", "views", "alexnet"),
    "EfficientNet-B0": ("four depth views", "views", "efficientnet_b0"),
    "VGG-16": ("four depth views", "views", "vgg16"),
}
"""By name: label of the input, and the fields ``input`` and ``network`` of :class:`Training`."""


def run(config: Config) -> Result:
    """Train all networks for equal steps and for equal processor time, and with other outputs."""
    def trainings(**length: float) -> dict[str, Training]:
        return {name: Training(input=kind, network=network, **length)
                for name, (_, kind, network) in INPUTS.items()}

    steps = trainings(steps=config["steps"])
    del steps["VGG-16"]  # takes more than half an hour
    outputs = ["posterior", "regression", *(f"classes {count}" for count in config["classes"])]
    groups = {"steps": steps, "clock": trainings(cpu_seconds=config["cpu_seconds"]),
              "heads": {name: Training(steps=config["steps"], output=name) for name in outputs}}
    return Result({group: train_all(members, config) for group, members in groups.items()})


def summarise(report: Report) -> str:
    """Summary in sentences."""
    by_clock, heads = log_alpha(report["clock"]), log_alpha(report["heads"])
    views = {name: by_clock[name] for name, (_, kind, _) in INPUTS.items() if kind == "views"}
    best = min(views, key=views.__getitem__)
    small = min((name for name in by_clock if name.startswith("map")), key=by_clock.__getitem__)
    classes = min((name for name in heads if name.startswith("classes")), key=heads.__getitem__)
    inside = report["heads"]["posterior"]["unseen"]["fabrics"]["inside"]["68%"]
    return ("After the same processor time the error of log α is "
            f"{by_clock[small]:.2f} from the map of all views ({small.removeprefix('map, ')}), "
            f"{by_clock['outline']:.2f} from the boundary curve, {by_clock['numbers']:.2f} from "
            f"drape coefficient and folds, and {views[best]:.2f} from four stacked views with the "
            f"best backbone ({best}). In this time most backbones learn nothing from views (error "
            f"1.0, that of the mean). With the map as input, the error is {heads['posterior']:.2f} "
            f"for the mean of a posterior, {heads['regression']:.2f} for a regression, and "
            f"{heads[classes]:.2f} for the best classification ({classes.split()[1]} classes). The "
            f"posterior also states its uncertainty: {inside:.0%} of the moduli lie inside its "
            "intervals of 68 %.")


def rows(report: Report) -> tuple[list[str], list[list[object]]]:
    """Table of errors by input and network."""
    lines = []
    for name, (label, _, _) in INPUTS.items():
        by_steps, by_clock = report["steps"].get(name), report["clock"][name]
        seconds = by_clock["cpu_seconds"] / by_clock["steps"]
        lines.append([label, name.removeprefix("map, ") if label != name else "",
                      f"{by_clock['parameters'] / 1e6:.2f}", f"{seconds:.2f}",
                      error_cell(by_steps, "log_alpha"), error_cell(by_steps, "beta_over_alpha"),
                      by_clock["steps"], error_cell(by_clock, "log_alpha"),
                      error_cell(by_clock, "beta_over_alpha")])
    return (["input", "network", "parameters, millions", "CPU s per step", "log α, equal steps",
             "β/α", "steps in equal time", "log α, equal time", "β/α"], lines)


def _labelled(heads: Report) -> Report:
    names = {"posterior": "posterior (mean)", "regression": "regression, Eq. 10"}
    return {names.get(name, name.replace("classes ", "classification, ") + " classes per modulus"):
            training for name, training in heads.items()}


def outputs(report: Report) -> str:
    """Table of errors by output."""
    return table(["output, from the map", "log α (95 %)", "β/α (95 %)"],
                 [[name, error_cell(training, "log_alpha", interval=True),
                   error_cell(training, "beta_over_alpha", interval=True)]
                  for name, training in _labelled(report["heads"]).items()])


def draw(report: Report) -> Figure:
    """Plot errors by network, for equal steps and equal time, and by output."""
    return error_figure({"equal steps": report["steps"], "equal processor time": report["clock"],
                         "outputs, equal steps": _labelled(report["heads"])})


SECTION = Section(
    "Inputs, backbones and outputs", "002, Figures 18 and 20, Table 2 and Eq. 10",
    "Which input, which network and which output estimate the moduli best?",
    summarise, rows, draw,
    "finds ResNet-18 0.127, EfficientNet-B0 0.142, VGG-16 0.122, AlexNet 0.224 (Table 2), trained "
    "for 12 to 101 hours on 2.3 million images; the boundary curve is worse than depth (Figure "
    "20), regression better than classification with 8 to 64 classes (Figure 18). Only the order "
    "of inputs is comparable: these networks are trained for minutes on about 1 700 captures, so "
    "that backbones are ranked by cost, not by final accuracy.",
    "Each network has one seed, few fabrics, the same learning rate and a posterior of two "
    "Gaussians. The boundary curve is that of the merged map, better than that of one picture. "
    "VGG-16 was not trained for equal steps, which would take half an hour. Classes divide five "
    "standard deviations of a modulus evenly, and the estimate is the centre of the most probable "
    "class. Intervals are over unseen fabrics.",
    second_table=outputs)
