"""How good is a checkpoint on fabrics and drapes that nobody has seen?

    python -m drapenet.evaluate [checkpoint=FILE] [drapes=N] [data=DIR] [out=DIR]

Draws new fabrics from the prior, drapes and renders them (``outputs/evaluate/dataset``, which is
completed if it exists), or takes the dataset ``data``, rendered now if it has no views. Adds the
sensor's noise, asks the network about every capture, and writes ``evaluation.json``. Errors are
those of its mean over the view orders, without and with its mean error on cloth subtracted as
``infer.py`` does, in units of the training set's standard deviation, beside those of always
predicting the training set's mean.
"""

import common.interrupt  # noqa: F401

# isort: split
from pathlib import Path
from typing import NoReturn

from common.ctrl_c import deferred

with deferred():
    import numpy as np
    import torch
from tqdm import tqdm

from common.cli import parse_overrides, run_command
from common.errors import InputError
from common.files import folder_named, replace_json, require_folder
from data.configs import compose_config, read_config
from data.fresh import open_views
from data.generate import generate_dataset
from data.options import Options, config_from_options
from data.sensor import load_sensor
from data.splits import SplitDataset, finished_manifest
from drapenet.checkpoint import BUNDLED, Header, load_model, read_header
from drapenet.metrics import regression_metrics
from drapenet.predict import average_orders
from drapenet.targets import direction_vectors, to_stiff_soft


def evaluate(header: Header, drapes: SplitDataset) -> dict:
    """Errors of a checkpoint on all converged drapes of a dataset, and of the mean's.

    Raises:
        InputError: the dataset is of another rig, or the one that the checkpoint was trained on.
    """
    require_unseen(header, drapes.manifest["config"])
    model, form, scale = load_model(header), header.form, header.scale
    outputs, targets, axes = [], [], []
    for item in tqdm(drapes, desc="estimating", unit="capture"):
        moduli, direction = average_orders(model, item["views"], form=form)
        outputs.append(torch.cat([moduli.mean(dim=0), direction.mean(dim=0)]))
        theta = torch.from_numpy(item["theta"])
        targets.append(scale.encode(to_stiff_soft(theta)))
        axes.append(direction_vectors(theta, torch.tensor(float(item["orientation"]))))
    columns = [torch.stack(column) for column in (outputs, targets, axes)]
    said = scale.decode(columns[0][:, :6])
    mean_errors = np.array([header.errors.mean_at(one) for one in said.double().numpy()])
    corrected = torch.cat([scale.encode(said - torch.from_numpy(mean_errors).to(said)),
                           columns[0][:, 6:]], dim=1)
    return {
        "checkpoint": header.identity,
        "dataset": {
            "sha256": drapes.hash,
            "fabrics": len(set(drapes.fabric.tolist())),
            "drapes": drapes.drapes,
            "not_converged": drapes.left_out.total(),
        },
        "network": regression_metrics(*columns),
        "network_less_mean_error": regression_metrics(corrected, *columns[1:]),
        "training_mean": regression_metrics(torch.zeros_like(columns[0]), *columns[1:]),
    }


def require_unseen(header: Header, generation: dict) -> None:
    """Check that a dataset's configuration gives drapes of the rig, but not of the fabrics, that
    a checkpoint was trained on.

    Args:
        generation: :meth:`data.records.DatasetConfig.as_dict`.

    Raises:
        InputError: it does not.
    """
    rig = generation["rig"]["name"]
    if rig != header.rig:
        raise InputError(f"the drapes are of the rig '{rig}', the checkpoint of '{header.rig}'")
    # A fabric depends on the prior, the seed and its index only.
    for training in (dataset["generation"] for dataset in header.datasets):
        if (generation["prior"] == training["prior"]
                and generation["sampling"]["seed"] == training["sampling"]["seed"]):
            raise InputError("a training set has the same seed and prior, so that its fabrics "
                             "are not unseen; choose another seed")


def main(argv: list[str]) -> None:
    """The command line: words ``key=value`` over ``configs/evaluate.yaml``."""
    config = parse_overrides(read_config("evaluate"), argv)
    if config["orientations"] < 1:
        raise InputError(f"orientations={config['orientations']} must be at least 1")
    out, data = folder_named(config["out"]), config["data"]
    require_folder(out)
    header = read_header(config["checkpoint"] or BUNDLED)
    noise = load_sensor(config["sensor"])  # before minutes of simulation
    if data:
        require_unseen(header, finished_manifest(data)["config"])
    else:
        data = out / "dataset"
        make_dataset(header, data, config)
    drapes = open_views(data, noise=noise,
                        orientations_per_epoch=config["orientations"], seed=config["seed"])
    result = evaluate(header, drapes)
    replace_json(out / "evaluation.json", result)
    print(format_result(result))
    print(f"written to {out / 'evaluation.json'}")


def make_dataset(header: Header, root: Path, config: dict) -> None:
    """Make or complete the dataset that the command line asks for; InputError if a fabric of it may
    have been seen.
    """
    words = [f"{key}={config[key]}" for key in ("drapes", "seed", "edge_mm", "prior")]
    words += ["dataset.starts_per_fabric=1",
              f"dataset.orientations={config['orientations']}"]
    options = compose_config("generate", words, schema=Options)
    generation = config_from_options(options)
    require_unseen(header, generation.as_dict())  # now, because making the drapes takes minutes
    generate_dataset(generation, root, workers=config["workers"])


def format_result(result: dict) -> str:
    """The main figures as lines for a terminal."""
    data, network, mean = result["dataset"], result["network"], result["training_mean"]
    corrected = result["network_less_mean_error"]
    lines = [f"{network['samples']} captures of {data['drapes']} drapes of {data['fabrics']} "
             f"unseen fabrics ({data['not_converged']} drapes left out: not converged)",
             f"{'standardised RMSE':28}{'network':>9}{'mean':>7}{'ratio':>7}"]
    for key, name in (("rmse_log_alpha", "log alpha, all directions"),
                      ("rmse_beta_over_alpha", "beta/alpha, all directions")):
        lines.append(_line(name, network[key], mean[key]))
    lines.append(_line("log alpha less mean error", corrected["rmse_log_alpha"],
                       mean["rmse_log_alpha"]))
    lines += [_line(name, value, mean["rmse"][name]) for name, value in network["rmse"].items()]
    if network["axis_error_deg"] is not None:
        error = network["axis_error_deg"]
        lines.append(f"{'stiff axis, median error':28}{error:8.1f}° (45° by chance)")
    return "\n".join(lines)


def _line(name: str, network: float, mean: float) -> str:
    return f"{name:28}{network:9.3f}{mean:7.3f}{network / mean:7.3f}"


def entry() -> NoReturn:
    """Console script."""
    run_command(main, usage=__doc__)


if __name__ == "__main__":
    entry()
