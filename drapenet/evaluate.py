"""How good is a checkpoint on fabrics and drapes that nobody has seen?

    python -m drapenet.evaluate [checkpoint=FILE] [drapes=N] [out=DIR]

Draws new fabrics from the prior, drapes and renders them (``outputs/evaluate/dataset``, which is
completed if it exists), adds the sensor's noise, estimates every capture as ``infer.py`` does, and
writes ``evaluation.json``. Errors are in units of the training set's standard deviation, beside
those of always predicting the training set's mean.
"""

import json
from pathlib import Path
from typing import NoReturn

import torch
import yaml
from tqdm import tqdm

from data.configs import CONFIG_DIR, compose_config
from data.dataset import DrapeDataset
from data.generate import generate_dataset
from data.options import Options, config_from_options
from data.sensor import SensorNoise
from drapenet.checkpoint import BUNDLED, Header, load_model, read_header, replace_file
from drapenet.metrics import regression_metrics
from drapenet.predict import average_orders
from drapenet.targets import direction_vectors, to_stiff_soft
from sim.cli import parse_overrides, run_command
from sim.errors import InputError


def evaluate(header: Header, drapes: DrapeDataset) -> dict:
    """Errors of a checkpoint on all converged drapes of a dataset, and of the mean's.

    Raises:
        InputError: the dataset is of another rig, or the one that the checkpoint was trained on.
    """
    rig = drapes.manifest["config"]["rig"]["name"]
    if rig != header.rig:
        raise InputError(f"{drapes.root} is of the rig '{rig}', the checkpoint of '{header.rig}'")
    if same_fabrics(header, drapes):
        raise InputError(f"{drapes.root} has the training set's seed and prior, so its fabrics are "
                         "not unseen; choose another seed")
    model, form, scale = load_model(header), header.form, header.scale
    outputs, targets, axes = [], [], []
    for item in tqdm(drapes, desc="estimating", unit="capture"):
        moduli, direction = average_orders(model, item["views"], form=form)
        outputs.append(torch.cat([moduli.mean(dim=0), direction.mean(dim=0)]))
        theta = torch.from_numpy(item["theta"])
        targets.append(scale.encode(to_stiff_soft(theta)))
        axes.append(direction_vectors(theta, torch.tensor(float(item["orientation"]))))
    columns = [torch.stack(column) for column in (outputs, targets, axes)]
    return {
        "checkpoint": header.identity,
        "dataset": {
            "sha256": drapes.hash,
            "fabrics": len(set(drapes.fabric.tolist())),
            "drapes": drapes.drapes,
            "not_converged": drapes.left_out.total(),
        },
        "network": regression_metrics(*columns),
        "training_mean": regression_metrics(torch.zeros_like(columns[0]), *columns[1:]),
    }


def same_fabrics(header: Header, drapes: DrapeDataset) -> bool:
    """Whether the checkpoint was trained on fabrics that the dataset holds, too."""
    ours, theirs = drapes.manifest["config"], header.content["dataset"]["generation"]
    return all(a == b for a, b in ((ours["sampling"]["seed"], theirs["sampling"]["seed"]),
                                   (ours["prior"], theirs["prior"])))


def main(argv: list[str]) -> None:
    """The command line: words ``key=value`` over ``configs/evaluate.yaml``."""
    defaults = yaml.safe_load((CONFIG_DIR / "evaluate.yaml").read_text(encoding="utf-8"))
    config = parse_overrides(defaults, argv)
    header = read_header(config["checkpoint"] or BUNDLED)
    out = Path(config["out"])
    words = [f"{key}={config[key]}" for key in ("drapes", "seed", "resolution")]
    words += ["dataset.starts_per_fabric=1", f"dataset.orientations={config['orientations']}"]
    options = compose_config("generate", words, schema=Options)
    generate_dataset(config_from_options(options), out / "dataset", workers=config["workers"])
    drapes = DrapeDataset(out / "dataset", noise=SensorNoise.load(config["sensor"]),
                          orientations_per_epoch=config["orientations"], seed=config["seed"])
    result = evaluate(header, drapes)
    replace_file(out / "evaluation.json", (json.dumps(result, indent=1) + "\n").encode())
    print(format_result(result))
    print(f"written to {out / 'evaluation.json'}")


def format_result(result: dict) -> str:
    """The main figures as lines for a terminal."""
    data, network, mean = result["dataset"], result["network"], result["training_mean"]
    lines = [f"{network['samples']} captures of {data['drapes']} drapes of {data['fabrics']} "
             f"unseen fabrics ({data['not_converged']} drapes left out: not converged)",
             f"{'standardised RMSE':28}{'network':>9}{'mean':>7}"]
    for key, name in (("rmse_log_alpha", "log alpha, all directions"),
                      ("rmse_beta_over_alpha", "beta/alpha, all directions")):
        lines.append(f"{name:28}{network[key]:9.3f}{mean[key]:7.3f}")
    lines += [f"{name:28}{value:9.3f}{mean['rmse'][name]:7.3f}"
              for name, value in network["rmse"].items()]
    if network["axis_error_deg"] is not None:
        error = network["axis_error_deg"]
        lines.append(f"{'stiff axis, median error':28}{error:8.1f}° (45° by chance)")
    return "\n".join(lines)


def entry() -> NoReturn:
    """Console script."""
    run_command(main)


if __name__ == "__main__":
    entry()
