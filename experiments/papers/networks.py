"""Networks trained on the same drapes: the paper's and others by input (002, Figure 20)."""

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from common.command import compose_config
from data.dataset.folder import finished_manifest
from drapenet.config import EvaluateConfig, TrainConfig
from drapenet.network.checkpoint import Header, read_header
from drapenet.network.evaluate import CELLS, SINGLES, judged
from drapenet.network.weights import load_model
from experiments.page import Section
from experiments.result import Config, Report, Result
from train import train

NAMES = {"views": "four stacked views, ResNet-18, regression (the paper's)",
         "depth": "map of all views, posterior", "outline": "outline alone, posterior",
         "bundled": "the bundled network"}


def run(config: Config) -> Result:
    """Train and evaluate all networks."""
    found: Report = {}
    drapes = finished_manifest(Path(config["data"]))["drapes"]
    for name, words in config["networks"].items():
        folder = Path(config["cases"]) / name
        checkpoint = train(compose_config("train", [
            f"data={config['data']}", f"maps={Path(config['cases']) / 'maps'}", f"out={folder}",
            f"workers={config['workers']}", "graphs=false", *config["common"], *words],
            schema=TrainConfig))
        found[name] = _evaluated(read_header(str(checkpoint)), config)
    found["bundled"] = _evaluated(read_header(), config)
    return Result({"drapes": drapes, "networks": found})


def _evaluated(header: Header, config: Config) -> dict[str, Any]:
    """Error and coverage of the first of the kinds of captures that a network reads."""
    settings = compose_config("evaluate", [
        f"testers=[{config['tester']}]", f"fabrics_per_tester={config['fabrics']}",
        f"seed={config['seed']}", f"workers={config['workers']}", "even_fabrics=0",
        f"out={Path(config['cases']) / 'evaluate'}"], schema=EvaluateConfig)
    kind = next(kind for kind in SINGLES if CELLS[kind].kind in header.config.inputs)
    (_, estimates), = judged(header, config["tester"], {kind: CELLS[kind]}, settings)
    return {"captures": kind,
            "parameters": sum(part.numel() for part in load_model(header).parameters()),
            **estimates.summary(header.spread)}


def summarise(report: Report) -> str:
    """Summary in sentences."""
    error = {name: one["log_alpha"]["rmse"] for name, one in report["networks"].items()}
    return (f"Of the same {report['drapes']} drapes, the paper's network learns log α to "
            f"{error['views']:.2f} of its spread over fabrics and a network of maps to "
            f"{error['depth']:.2f}, from an outline alone to {error['outline']:.2f}. The bundled "
            f"network, of ten times the drapes, has {error['bundled']:.2f} with four views.")


def rows(report: Report) -> tuple[list[str], list[list[object]]]:
    """Table of errors and coverage by network."""
    return (["network", "parameters", "α off by: median, nine of ten", "log α (95 %)", "β/α",
             "inside 50, 68, 90 %"],
            [[NAMES[name], f"{one['parameters'] / 1e6:.1f} million",
              f"{one['alpha']['median']:.0%}, {one['alpha']['ninth_decile']:.0%}",
              "{:.2f} ({:.2f} to {:.2f})".format(one["log_alpha"]["rmse"],
                                                 *one["log_alpha"]["interval_95"]),
              f"{one['beta_over_alpha']['rmse']:.2f}",
              ", ".join(f"{100 * share['mean']:.0f}" for share in one["inside"].values())]
             for name, one in report["networks"].items()])


def draw(report: Report) -> Figure:
    """Bars of the errors."""
    figure = Figure(figsize=(7, 3.2), layout="constrained")
    axes = figure.subplots()
    for name, one in reversed(report["networks"].items()):
        error, (low, high) = one["log_alpha"]["rmse"], one["log_alpha"]["interval_95"]
        axes.barh(NAMES[name], error, xerr=[[error - low], [high - error]],
                  color="#b5403a" if name == "views" else "#2f6da8", height=0.6)
    axes.set_xlabel("error of log α [spread over fabrics]")
    return figure


SECTION = Section(
    "Networks", "002, section 6, Figure 20, Table 2",
    "How do the paper's network and networks of other inputs compare on the same drapes?",
    summarise, rows, draw,
    "its ResNet-18, trained for 12.7 hours on 48 000 drapes, has an error of 0.127; not "
    "comparable, because its fabrics, captures and unit are others.",
    "The drapes, of discs of 300 mm with all nuisances, evenly distributed from limp to stiff, one "
    "of each fabric, are a twentieth of the paper's. All networks begin with random weights. "
    "Errors are of 32 fabrics of the prior, four drapes each, as of `make evaluate`.")
