"""Verify a dataset of drapes and report its statistics.

    python -m data.dataset.inspect data=FOLDER [out=REPORT]  # or outputs/inspect/NAME_OF_DATASET

Checks that the shards of the dataset in FOLDER are those listed in its dataset.json, then reports
outcomes, parameters compared with the prior, and drapes. Writes report.json, distributions.png and
contact_sheet.png to REPORT (docs/data_format.md). Does not change FOLDER.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import yaml
from matplotlib.figure import Figure
from pydantic import Field

from common.command import command
from common.errors import InputError
from common.files import replace_file, replace_json, require_folder
from common.types import DepthImage, Theta
from data.captures.preview import png
from data.dataset.folder import MANIFEST, finished_manifest, over_shards
from data.dataset.shards import SHARDS, Shard
from data.fabrics.fabrics import THETA_NAMES
from data.fabrics.nuisances import ISOTROPIC, KINDS, NAMES
from data.fabrics.prior import prior_from_content
from data.fabrics.prior.even import draw_fabrics
from data.render.cameras import nominal_camera
from data.render.rays import DepthRenderer
from sim.energies.self_contact import self_intersections
from sim.material import BIAS, LINEAR, MICRO, WARP, WEFT
from sim.measures import maximum_stretch

COLUMNS = ("index", "fabric", "theta", "rejected", "start", "status", "message", "iterations",
           "drape_coefficient", "folds", "nuisances", "specimen", "sides", "plate_diameter", "rim")
QUANTILES = (0.0, 0.01, 0.1, 0.5, 0.9, 0.99, 1.0)
RANGE = (0.01, 0.99)  # quantiles of the prior; fabrics beyond them are counted as outside
PRIOR_SAMPLES = 2000
ACROSS = 8  # drapes in a row of the contact sheet
WIDTH, CAPTION = 1.75, 0.25  # inches, width of a drape and height of its caption
MARK = "#b5403a"  # caption of a failed drape
LINE = 100  # characters, of the report as text


@dataclass
class InspectConfig:
    """``configs/inspect.yaml``."""

    data: str
    out: str
    intersections: Annotated[int, Field(ge=0)]
    sheet: Annotated[int, Field(ge=1)]


@command("inspect", InspectConfig)
def main(config: InspectConfig) -> None:
    """Verify the dataset; print and write the report."""
    if not config.data:
        raise InputError("data= is missing; give the folder of a dataset: data=FOLDER")
    root = Path(config.data)
    out = Path(config.out or Path("outputs/inspect") / root.resolve().name)
    require_folder(out)
    manifest = check_dataset(root)
    drapes = read_drapes(root, manifest, intersections=config.intersections)
    content = report(manifest, drapes, prior_samples(manifest))
    print(as_text(content))
    replace_json(out / "report.json", content)
    replace_file(out / "distributions.png", distributions(drapes))
    if shots := take_shots(root, drapes, count=config.sheet):
        replace_file(out / "contact_sheet.png", contact_sheet(shots))
    print(f"written to {out}: report.json, distributions.png"
          + (", contact_sheet.png" if shots else ""))


def check_dataset(root: Path) -> dict:
    """Verify that the shards in ``root`` are those of its manifest, which is returned."""
    manifest = finished_manifest(root)
    digests, names = manifest["shards"], {path.name for path in root.glob(SHARDS)}
    if missing := sorted(digests.keys() - names):
        raise InputError(f"{root} lacks {_listed(missing)}; generate the missing shards with "
                         f"python -m data.dataset.generate out={root} and the dataset's settings")
    if extra := sorted(names - digests.keys()):
        raise InputError(f"{root} holds shards that {MANIFEST} does not list: {_listed(extra)}; "
                         "move them elsewhere")
    changed, indices = [], []
    outcomes: Counter[str] = Counter()
    for name, digest in over_shards(digests.items(), "checking"):
        shard = Shard(root / name)
        if shard.digest != digest or shard.attributes.get("identity") != manifest["identity"]:
            changed.append(name)
        indices.extend(shard.column("index").tolist())
        outcomes.update(shard.column("status").tolist())
    if changed:
        raise InputError(f"{root}: {_listed(changed)} differ from {MANIFEST}; remove these files "
                         "and generate them again")
    if indices != list(range(manifest["drapes"])) or dict(outcomes) != manifest.get("outcomes"):
        raise InputError(f"{root / MANIFEST}: drapes and outcomes differ from those in the shards; "
                         "generate the dataset again, in another folder")
    return manifest


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def read_drapes(root: Path, manifest: dict, *, intersections: int) -> dict[str, np.ndarray]:
    """:data:`COLUMNS` (N, ...) of a dataset's drapes, in order, with the name of the ``shard`` and
    the ``row`` of each; ``stretch``, the largest strain, to 0.1 %, NaN unless converged; and
    ``crossings``, the edges that intersect a face, of ``intersections`` drapes, else -1."""
    parts: dict[str, list] = {name: [] for name in (*COLUMNS, "shard", "row", "stretch",
                                                    "crossings")}
    checked = spread(np.arange(manifest["outcomes"].get("converged", 0)), intersections)
    converged = 0
    for name in over_shards(manifest["shards"], "measuring"):
        shard = Shard(root / name)
        columns = {column: shard.column(column) for column in COLUMNS} | {
            "shard": np.full(len(shard), name), "row": np.arange(len(shard)),
            "stretch": np.full(len(shard), np.nan), "crossings": np.full(len(shard), -1)}
        for row in np.flatnonzero(columns["status"] == "converged"):
            positions, rest, faces = shard.mesh(row)
            # Triangles held by the plate are not stretched and need not be excluded.
            columns["stretch"][row] = maximum_stretch(positions, rest, faces,
                                                      np.zeros(len(rest), bool))
            if converged in checked:
                columns["crossings"][row] = len(self_intersections(positions, faces))
            converged += 1
        for column, values in columns.items():
            parts[column].append(values)
    return {name: np.concatenate(arrays) for name, arrays in parts.items()}


def spread(items: np.ndarray, count: int) -> np.ndarray:
    """At most ``count`` of ``items`` (N, ...), evenly spread, with the first and the last."""
    return items[np.linspace(0, len(items) - 1, min(count, len(items))).round().astype(int)]


def prior_samples(manifest: dict) -> tuple[Theta, float]:
    """:data:`PRIOR_SAMPLES` fabrics of the dataset's prior, moved as its own are, and the share of
    rejected samples."""
    config, drawn = manifest["config"], manifest["config"]["sampling"]
    return draw_fabrics(prior_from_content(config["prior"], origin="the dataset's prior"),
                        PRIOR_SAMPLES, even_share=drawn["even_share"],
                        anisotropy=drawn["anisotropy"], varied=drawn["anisotropy_varied"])


def report(manifest: dict, drapes: dict[str, np.ndarray], prior: tuple[Theta, float]) -> dict:
    """Statistics of drapes (N, ...) in JSON types; ``prior``: from :func:`prior_samples`."""
    converged = drapes["status"] == "converged"
    kept = {name: column[converged] for name, column in drapes.items()}
    trained = kept["theta"][np.unique(kept["fabric"], return_index=True)[1]]
    rejected = drapes["rejected"][np.unique(drapes["fabric"], return_index=True)[1]]
    crossing = kept["index"][kept["crossings"] > 0]
    return {
        "dataset": {name: manifest[name] for name in ("identity", "hash")},
        "drapes": len(converged),
        "converged": int(converged.sum()),
        "fabrics": len(rejected),
        "fabrics_with_a_drape": len(trained),
        "rejection_rate": {"dataset": float(rejected.sum() / (rejected.sum() + len(rejected))),
                           "prior": prior[1]},
        "starts": {str(start): _of_start(start, drapes, kept)
                   for start in np.unique(drapes["start"])},
        "failures": _failures({name: column[~converged] for name, column in drapes.items()}),
        "parameters": _parameters(trained, prior[0]),
        **{name: _quantiles(kept[name]) for name in ("drape_coefficient", "stretch", "iterations")},
        "folds": {str(number): count for number, count
                  in sorted(Counter(kept["folds"].tolist()).items())},
        "self_intersections": {"looked_at": int((kept["crossings"] >= 0).sum()),
                               "intersecting": len(crossing), "drapes": crossing.tolist()},
    }


def _quantiles(values: np.ndarray) -> dict[str, float] | None:
    """:data:`QUANTILES` by name; None if there are no values."""
    if not len(values):
        return None
    return {f"{share:g}": float(np.quantile(values, share)) for share in QUANTILES}


def _of_start(start: str, drapes: dict[str, np.ndarray], kept: dict[str, np.ndarray]) -> dict:
    """Of an initial state: drapes, how many converged, and their mean number of folds."""
    folds = kept["folds"][kept["start"] == start]
    return {"drapes": int((drapes["start"] == start).sum()), "converged": len(folds),
            "mean_folds": float(folds.mean()) if len(folds) else None}


def _failures(failed: dict[str, np.ndarray]) -> list[dict]:
    """Failures by status, the most frequent first: count, and index and message of the first."""
    result = []
    for status, first, count in zip(*np.unique(failed["status"], return_index=True,
                                               return_counts=True), strict=True):
        result.append({"status": str(status), "drapes": int(count),
                       "first": int(failed["index"][first]),
                       "message": str(failed["message"][first])})
    return sorted(result, key=itemgetter("drapes"), reverse=True)


def _parameters(fabrics: Theta, prior: Theta) -> dict[str, dict]:
    """By parameter: quantiles of dataset and prior, share of fabrics outside the prior's range."""
    low, high = np.quantile(prior, RANGE, axis=0)
    outside = (fabrics < low) | (fabrics > high)
    result = {}
    for k, name in enumerate(THETA_NAMES):
        # In the units of documents, at 300 g/m².
        is_alpha = name.startswith("log_")
        dataset, expected = (np.exp(theta[:, k]) / MICRO if is_alpha else 1e3 * theta[:, k]
                             for theta in (fabrics, prior))
        result[name.removeprefix("log_")] = {
            "unit": "µN·m" if is_alpha else "mm",
            "dataset": _quantiles(dataset), "prior": _quantiles(expected),
            "outside": float(outside[:, k].mean()) if len(fabrics) else None}
    return result


def as_text(content: Any) -> str:
    """A :func:`report` as text, its numbers to three digits."""
    return yaml.safe_dump(_rounded(content), sort_keys=False, allow_unicode=True, width=LINE,
                          default_flow_style=None)


def _rounded(content: Any) -> Any:
    if isinstance(content, dict):
        return {name: _rounded(part) for name, part in content.items()}
    return float(f"{content:.3g}") if isinstance(content, float) else content


def distributions(drapes: dict[str, np.ndarray]) -> bytes:
    """PNG of what was drawn for the drapes (N, ...), and of their coefficients by tester."""
    theta, sides, plate = drapes["theta"], drapes["sides"], drapes["plate_diameter"]
    drawn = dict(zip(NAMES, drapes["nuisances"].T, strict=True))
    kinds = drawn["kind"].astype(int)
    log_alpha, mean = theta[:, LINEAR], theta[:, LINEAR].mean(axis=1)
    yarns = (log_alpha[:, WARP] + log_alpha[:, WEFT]) / 2
    shear = drawn["shear"] * drawn["membrane"] / ISOTROPIC
    curl = np.hypot(drawn["curl_warp"], drawn["curl_weft"])
    panels = {"mean α, µN·m": np.exp(mean) / MICRO,
              "log of bias over mean of yarns": log_alpha[:, BIAS] - yarns,
              "log of warp over weft": log_alpha[:, WARP] - log_alpha[:, WEFT],
              "in-plane stiffness, N/m": drawn["membrane"], "shear, N/m": shear,
              "natural curvature, 1/m": curl, "uneven curvature, 1/m": drawn["uneven"],
              "radius of the rim, mm": 1e3 * drapes["rim"]}
    figure = Figure(figsize=(11, 8), dpi=100, layout="constrained")
    *axes, by_tester = figure.subplots(3, 3).ravel()
    for panel, (label, values) in zip(axes, panels.items(), strict=True):
        edges = (np.geomspace if values.min() > 0 and values.max() > 30 * values.min()
                 else np.linspace)(values.min(), max(values.max(), values.min() + 1e-9), 41)
        panel.hist([values[kinds == k] for k in range(len(KINDS))], edges, stacked=True,
                   label=KINDS)
        panel.set(xlabel=label, xscale="log" if edges[1] - edges[0] < edges[-1] - edges[-2] - 1e-9
                  else "linear")
    axes[0].legend(fontsize=8)
    for specimen in np.unique(drapes["specimen"]):
        mine = (drapes["specimen"] == specimen) & (drapes["status"] == "converged")
        by_tester.plot(sides[mine].min(axis=1) / plate[mine], drapes["drape_coefficient"][mine],
                       ".", ms=3, label=specimen)
    by_tester.set(xlabel="specimen over plate", ylabel="drape coefficient")
    by_tester.legend(fontsize=8)
    return png(figure)


class Shot(NamedTuple):
    """A drape on the contact sheet, with the text above it."""

    caption: str
    failed: bool
    view: DepthImage


def take_shots(root: Path, drapes: dict[str, np.ndarray], *, count: int) -> list[Shot]:
    """Render ``count`` converged ones of the drapes (N, ...), by drape coefficient, and up to a row
    of failed ones with coordinates."""
    order = np.argsort(drapes["drape_coefficient"], kind="stable")
    converged = drapes["status"][order] == "converged"
    shots = []
    for drape in [*spread(order[converged], count), *spread(np.sort(order[~converged]), ACROSS)]:
        this = {name: column[drape] for name, column in drapes.items()}
        shard = Shard(root / this["shard"])
        positions, rest, faces = shard.mesh(this["row"])
        failed = this["status"] != "converged"
        if rest.any():
            caption = this["status"] if failed else (
                f"{100 * this['drape_coefficient']:.0f} %, {this['folds']} folds")
            camera = nominal_camera(shard.rig(this["row"]))
            shots.append(Shot(f"{this['index']}: {caption}", failed,
                              DepthRenderer(positions, faces).view(camera)))
    return shots


def contact_sheet(shots: list[Shot]) -> bytes:
    """PNG of all shots, cropped to the cloth of all of them; nearer is brighter."""
    views = np.stack([shot.view for shot in shots])
    rows, columns = np.nonzero((views > 0).any(axis=0))
    views = views[:, rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    views = np.where(views > 0, views, np.nan)
    low, high = np.nanquantile(views, (0.01, 0.99))
    height, width = views.shape[1:]
    across, down = min(ACROSS, len(shots)), -(-len(shots) // ACROSS)
    figure = Figure(figsize=(across * WIDTH, down * (WIDTH * height / width + CAPTION)), dpi=110,
                    layout="constrained")
    panels = figure.subplots(down, across, squeeze=False).ravel()
    for axes in panels:
        axes.set_axis_off()
    for axes, shot, view in zip(panels, shots, views, strict=False):
        axes.imshow(view, cmap="viridis_r", vmin=low, vmax=high, interpolation="nearest")
        axes.set_title(shot.caption, fontsize=7, color=MARK if shot.failed else "black")
    return png(figure)


if __name__ == "__main__":
    main()
