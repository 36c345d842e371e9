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
from experiments.report import Report, table
from experiments.study import CaseKeys, Study, folder_of
from train import train

NAMES = {"views": "four stacked views, ResNet-18, regression (the paper's)",
         "depth": "map of all views, posterior", "outline": "outline alone, posterior",
         "bundled": "the bundled network"}
WORDS = {"views": ["model=views", "optim.batch_size=16", "epochs=12"],
         "depth": ["inputs=[depth]", "epochs=14"], "outline": ["inputs=[outline]", "epochs=14"]}
"""Words of train.py for each network."""


class Keys(CaseKeys):
    data: str = "outputs/discs"  # drapes to train on (docs/training.md)
    tester: str = "disc300_support180"  # of the drapes to evaluate with, 32 unseen fabrics
    common: tuple[str, ...] = ("captures=2", "outlines=0")  # words of train.py for all networks
    fabrics: int = 32
    seed: int = 20231  # of the fabrics to evaluate with
    workers: int = 2


def run(keys: Keys) -> Report:
    """Train and evaluate all networks."""
    found: Report = {}
    drapes = finished_manifest(Path(keys.data))["drapes"]
    for name, words in WORDS.items():
        folder = folder_of(keys) / name
        checkpoint = train(compose_config("train", [
            f"data={keys.data}", f"maps={folder_of(keys) / 'maps'}", f"out={folder}",
            f"workers={keys.workers}", "graphs=false", *keys.common, *words], schema=TrainConfig))
        found[name] = _evaluated(read_header(str(checkpoint)), keys)
    found["bundled"] = _evaluated(read_header(), keys)
    return {"drapes": drapes, "networks": found}


def _evaluated(header: Header, keys: Keys) -> dict[str, Any]:
    """Error and coverage of the first of the kinds of captures that a network reads."""
    settings = compose_config("evaluate", [
        f"testers=[{keys.tester}]", f"fabrics_per_tester={keys.fabrics}", f"seed={keys.seed}",
        f"workers={keys.workers}", "even_fabrics=0", f"out={folder_of(keys) / 'evaluate'}"],
        schema=EvaluateConfig)
    kind = next(kind for kind in SINGLES if CELLS[kind].kind in header.config.inputs)
    (_, estimates), = judged(header, keys.tester, {kind: CELLS[kind]}, settings)
    return {"captures": kind,
            "parameters": sum(part.numel() for part in load_model(header).parameters()),
            **estimates.summary(header.spread)}


def block(report: Report) -> str:
    """Summary and table."""
    text = (f"All but the last are trained on the same {report['drapes']} drapes, the last on ten "
            "times as many.")
    head = ["network", "parameters", "α off by: median, nine of ten", "log α (95 %)", "β/α",
            "inside 50, 68, 90 %"]
    rows = [[NAMES[name], f"{one['parameters'] / 1e6:.1f} million",
             f"{one['alpha']['median']:.0%}, {one['alpha']['ninth_decile']:.0%}",
             "{:.2f} ({:.2f} to {:.2f})".format(one["log_alpha"]["rmse"],
                                                *one["log_alpha"]["interval_95"]),
             f"{one['beta_over_alpha']['rmse']:.2f}",
             ", ".join(f"{100 * share['mean']:.0f}" for share in one["inside"].values())]
            for name, one in report["networks"].items()]
    return f"{text}\n\n{table(head, rows)}"


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


STUDY = Study(Keys, run, block, draw)
