"""What a network should see of a capture, and which network should see it (002, Fig. 20, Table 2).
"""

from typing import Any

from matplotlib.figure import Figure

from studies.learned import Training, train_all
from studies.study import Report, Study, error_cell, error_picture

SEEN: dict[str, tuple[str, str, str]] = {
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
"""Name, what it sees, and the settings of :class:`Training`."""
BASE = "map, width 16"


def run(config: dict[str, Any]) -> Report:
    """All networks, for equal steps and for equal processor time."""
    def trainings(**length: float) -> dict[str, Training]:
        return {name: Training(sees=sees, network=network, **length)
                for name, (_, sees, network) in SEEN.items()}

    steps = trainings(steps=config["steps"])
    del steps["VGG-16"]  # half an hour and more
    clock = trainings(cpu_seconds=config["cpu_seconds"])
    return {"steps": train_all(steps, config), "clock": train_all(clock, config)}


def answer(report: Report) -> str:
    """In sentences."""
    by_steps, by_clock = ({name: one["unseen"]["fabrics"]["log_alpha"]["rmse"]
                           for name, one in report[way].items()} for way in ("steps", "clock"))
    views = {name: by_clock[name] for name, (_, sees, _) in SEEN.items() if sees == "views"}
    best = min(views, key=views.__getitem__)
    small = min((name for name in by_clock if name.startswith("map")), key=by_clock.__getitem__)
    return ("After the same processor time the error of log α is "
            f"{by_clock[small]:.2f} from the map of all views with the best width "
            f"({small.removeprefix('map, width ')}; {BASE.removeprefix('map, ')}: "
            f"{by_clock[BASE]:.2f}), {by_clock['outline']:.2f} from the boundary curve, "
            f"{by_clock['numbers']:.2f} from drape coefficient and folds, and {views[best]:.2f} "
            f"from four stacked views with the best backbone ({best}). After equal steps widths 8, "
            f"16 and 32 on the map have {by_steps['map, width 8']:.2f}, {by_steps[BASE]:.2f} and "
            f"{by_steps['map, width 32']:.2f}, ResNet-18 on views {by_steps['ResNet-18']:.2f}. In "
            "so little time most backbones on views learn nothing (error 1.0, that of the mean).")


def rows(report: Report) -> tuple[list[str], list[list[object]]]:
    """Networks, by what they see."""
    found = []
    for name, (shown, _, _) in SEEN.items():
        by_steps, by_clock = report["steps"].get(name), report["clock"][name]
        seconds = by_clock["cpu_seconds"] / by_clock["steps"]
        found.append([shown, name.removeprefix("map, ") if shown != name else "",
                      f"{by_clock['parameters'] / 1e6:.2f}", f"{seconds:.2f}",
                      error_cell(by_steps, "log_alpha"), error_cell(by_steps, "beta_over_alpha"),
                      by_clock["steps"], error_cell(by_clock, "log_alpha"),
                      error_cell(by_clock, "beta_over_alpha")])
    return (["input", "network", "parameters, millions", "CPU s a step", "log α, equal steps",
             "β/α", "steps in equal time", "log α, equal time", "β/α"], found)


def draw(report: Report) -> Figure:
    """Errors by network, both ways."""
    return error_picture({"equal steps": report["steps"], "equal processor time": report["clock"]})


STUDY = Study(
    "inputs", "Inputs and backbones", "002, Figure 20 and Table 2",
    "What should a network see of a capture, and which network should see it?", run, answer, rows,
    draw,
    "Table 2: ResNet-18 0.127, EfficientNet-B0 0.142, VGG-16 0.122, AlexNet 0.224, trained for 12 "
    "to 101 hours on 2.3 million images; Figure 20: the boundary curve is worse than depth images. "
    "Not comparable in figures: these networks learn for minutes from some 1 700 captures. The "
    "order of inputs is comparable; that of the backbones is one of cost, not of final quality.",
    "Short trainings on few fabrics, one seed each, all with the same learning rate and a "
    "posterior of two Gaussians. The boundary curve is that of the fused map, better than a single "
    "picture shows. VGG-16 is trained for equal time only: equal steps would take half an hour.")
