"""Verify a dataset of drapes and report its statistics.

    python -m data.dataset.inspect data=FOLDER [out=REPORT]  # or outputs/inspect/NAME_OF_DATASET

Checks that the shards of the dataset in FOLDER are those listed in its dataset.json, then reports
outcomes, parameters compared with the prior, and drapes. Writes report.json and contact_sheet.png
to REPORT (docs/data_format.md). Does not change FOLDER.
"""

import io
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from matplotlib.figure import Figure
from pydantic import Field

from common.command import command
from common.errors import InputError
from common.files import replace_file, replace_json, require_folder
from common.types import DepthImage, Theta
from data.dataset.folder import MANIFEST, finished_manifest, over_shards
from data.dataset.shards import SHARDS, Shard
from data.fabrics.fabrics import THETA_NAMES
from data.fabrics.prior import prior_from_content
from data.fabrics.prior.even import draw_fabrics
from data.render.cameras import nominal_camera
from data.render.rays import DepthRenderer
from sim.energies.self_contact import self_intersections
from sim.material import MICRO
from sim.measures import maximum_stretch

COLUMNS = ("index", "fabric", "theta", "rejected", "start", "status", "message", "iterations",
           "drape_coefficient", "folds")
QUANTILES = (0.0, 0.01, 0.1, 0.5, 0.9, 0.99, 1.0)
RANGE = (0.01, 0.99)  # quantiles of the prior; fabrics beyond them are counted as outside
PRIOR_SAMPLES = 2000
PARAMETERS = tuple(name.removeprefix("log_") for name in THETA_NAMES)
UNITS = ("µN·m",) * 3 + ("mm",) * 3
"""Names and units of :func:`in_display_units`; at 300 g/m²."""
ACROSS = 8  # drapes in a row of the contact sheet
WIDTH, CAPTION = 1.75, 0.25  # inches, width of a drape and height of its caption
MARK = "#b5403a"  # caption of a failed drape
LABEL = 22  # characters, width of a table's first column


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
    prior = prior_samples(manifest)
    shots = take_shots(root, drapes, count=config.sheet)
    content = report(manifest, drapes, prior)
    print("\n".join(describe(content)))
    replace_json(out / "report.json", content)
    if shots:
        replace_file(out / "contact_sheet.png", contact_sheet(shots))
    print(f"\nwritten to {out}: report.json" + (", contact_sheet.png" if shots else ""))


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


@dataclass(frozen=True)
class Drapes:
    """All drapes of a dataset, one row each, in order."""

    columns: dict[str, np.ndarray]  # of COLUMNS
    places: list[tuple[str, int]]  # shard and row
    stretch: np.ndarray  # (N,) largest strain, of 0.1 % uncertainty; NaN unless converged
    crossings: np.ndarray  # (N,) edges that intersect a face; -1 if not checked

    @property
    def converged(self) -> np.ndarray:
        """(N,) bool."""
        return self.columns["status"] == "converged"


def read_drapes(root: Path, manifest: dict, *, intersections: int) -> Drapes:
    """Read and measure a dataset's drapes, of which ``intersections`` for self-intersections."""
    parts: dict[str, list[np.ndarray]] = {name: [] for name in COLUMNS}
    places: list[tuple[str, int]] = []
    converged = 0
    checked = set(spread(np.arange(manifest["outcomes"].get("converged", 0)), intersections))
    stretch, crossings = np.full(manifest["drapes"], np.nan), np.full(manifest["drapes"], -1)
    for name in over_shards(manifest["shards"], "measuring"):
        shard = Shard(root / name)
        for column, arrays in parts.items():
            arrays.append(shard.column(column))
        for row in np.flatnonzero(parts["status"][-1] == "converged"):
            drape = len(places) + row
            positions, rest, faces = shard.mesh(row)
            # Triangles held by the plate are not stretched and need not be excluded.
            stretch[drape] = maximum_stretch(positions, rest, faces, np.zeros(len(rest), bool))
            if converged in checked:
                crossings[drape] = len(self_intersections(positions, faces))
            converged += 1
        places += [(name, row) for row in range(len(shard))]
    columns = {name: np.concatenate(arrays) for name, arrays in parts.items()}
    return Drapes(columns, places, stretch, crossings)


def spread(items: np.ndarray, count: int) -> np.ndarray:
    """At most ``count`` of ``items`` (N, ...), evenly spread, with the first and the last."""
    chosen = np.linspace(0, len(items) - 1, min(count, len(items))).round().astype(int)
    return items[chosen]


def prior_samples(manifest: dict) -> tuple[Theta, float]:
    """:data:`PRIOR_SAMPLES` fabrics of the dataset's prior, moved as its own are, and the share of
    rejected samples."""
    config = manifest["config"]
    return draw_fabrics(prior_from_content(config["prior"], origin="the dataset's prior"),
                        PRIOR_SAMPLES, **{key: config["sampling"][key]
                                          for key in ("even_share", "anisotropy")})


def in_display_units(theta: Theta) -> np.ndarray:
    """Alpha in µN·m and beta/alpha in mm (..., 6)."""
    return np.concatenate([np.exp(theta[..., :3]) / MICRO, theta[..., 3:] * 1e3], axis=-1)


def draped_fabrics(drapes: Drapes) -> Theta:
    """The fabrics with a converged drape, which are used in training."""
    kept = drapes.converged
    _, first = np.unique(drapes.columns["fabric"][kept], return_index=True)
    return drapes.columns["theta"][kept][first]


def report(manifest: dict, drapes: Drapes, prior: tuple[Theta, float]) -> dict:
    """Statistics of the dataset in JSON types; ``prior``: from :func:`prior_samples`."""
    columns, converged = drapes.columns, drapes.converged
    rejected = columns["rejected"][np.unique(columns["fabric"], return_index=True)[1]]
    crossing = np.flatnonzero(drapes.crossings > 0)
    return {
        "dataset": {name: manifest[name] for name in ("identity", "hash")},
        "drapes": len(converged),
        "converged": int(converged.sum()),
        "fabrics": len(rejected),
        "fabrics_with_a_drape": len(draped_fabrics(drapes)),
        "rejection_rate": {"dataset": float(rejected.sum() / (rejected.sum() + len(rejected))),
                           "prior": prior[1]},
        "starts": _starts(columns, converged),
        "failures": _failures(columns, converged),
        "parameters": _parameters(drapes, prior[0]),
        "drape_coefficient": _quantiles(columns["drape_coefficient"][converged]),
        "folds": {str(n): int(count) for n, count
                  in zip(*np.unique(columns["folds"][converged], return_counts=True), strict=True)},
        "stretch": _quantiles(drapes.stretch[converged]),
        "iterations": _quantiles(columns["iterations"][converged]),
        "self_intersections": {
            "looked_at": int((drapes.crossings >= 0).sum()),
            "intersecting": len(crossing),
            "drapes": columns["index"][crossing].tolist(),
        },
    }


def _quantiles(values: np.ndarray) -> dict[str, float] | None:
    """:data:`QUANTILES` by name; None if there are no values."""
    if not len(values):
        return None
    return {f"{share:g}": float(np.quantile(values, share)) for share in QUANTILES}


def _starts(columns: dict[str, np.ndarray], converged: np.ndarray) -> dict[str, dict]:
    result = {}
    for start, count in zip(*np.unique(columns["start"], return_counts=True), strict=True):
        folds = columns["folds"][converged & (columns["start"] == start)]
        result[str(start)] = {"drapes": int(count), "converged": len(folds),
                              "mean_folds": float(folds.mean()) if len(folds) else None}
    return result


def _failures(columns: dict[str, np.ndarray], converged: np.ndarray) -> list[dict]:
    """Failures by status, the most frequent first: count, and index and message of the first."""
    reasons = Counter(columns["status"][~converged].tolist())
    result = []
    for status in sorted(reasons, key=lambda status: (-reasons[status], status)):
        first = int(np.flatnonzero(columns["status"] == status)[0])
        result.append({"status": status, "drapes": reasons[status],
                       "first": int(columns["index"][first]),
                       "message": str(columns["message"][first])})
    return result


def _parameters(drapes: Drapes, prior: Theta) -> dict[str, dict]:
    """By parameter: quantiles of dataset and prior, share of fabrics outside the prior's range."""
    fabrics = draped_fabrics(drapes)
    low, high = np.quantile(prior, RANGE, axis=0)
    result = {}
    for k, (name, unit) in enumerate(zip(PARAMETERS, UNITS, strict=True)):
        outside = (fabrics[:, k] < low[k]) | (fabrics[:, k] > high[k])
        result[name] = {
            "unit": unit,
            "dataset": _quantiles(in_display_units(fabrics)[:, k]),
            "prior": _quantiles(in_display_units(prior)[:, k]),
            "outside": float(outside.mean()) if len(fabrics) else None,
        }
    return result


def describe(content: dict) -> list[str]:
    """Format the result of :func:`report` as lines of text."""
    n, rate = content["drapes"], content["rejection_rate"]
    lines = [
        f"{n} drapes of {content['fabrics']} fabrics, {content['converged']} converged "
        f"({content['converged'] / n:.1%}); {content['fabrics_with_a_drape']} fabrics have one",
        f"content {content['dataset']['hash'][:16]}, settings "
        f"{content['dataset']['identity'][:16]}; shards agree with dataset.json",
        f"impossible fabrics rejected: {rate['dataset']:.2%}, by the prior itself "
        f"{rate['prior']:.2%}",
        "",
        f"{'initial state':<{LABEL}}{'drapes':>8}{'converged':>11}{'mean folds':>12}",
        *(f"{name:<{LABEL}}{row['drapes']:>8}{row['converged']:>11}{_number(row['mean_folds']):>12}"
          for name, row in content["starts"].items()),
        "",
    ]
    if content["failures"]:
        lines += [f"{'failure':<{LABEL}}{'drapes':>8}  first", *(
            f"{row['status']:<{LABEL}}{row['drapes']:>8}  {row['first']}: {row['message']}"
            for row in content["failures"]), ""]
    low, high = RANGE
    lines.append(f"{'at 300 g/m²':<{LABEL}}{'1 %':>8}{'10 %':>9}{'median':>9}{'90 %':>9}{'99 %':>9}"
                 f"   outside the prior's {low:.0%} to {high:.0%} ({1 - high + low:.0%} expected)")
    for name, row in content["parameters"].items():
        outside = "" if row["outside"] is None else f"   {row['outside']:.1%}"
        lines += [_range(_label(name, row["unit"]), row["dataset"]) + outside,
                  _range("  prior", row["prior"])]
    lines += [
        "",
        _range("drape coefficient", content["drape_coefficient"]),
        _range("largest strain", content["stretch"]),
        _range("iterations", content["iterations"]),
        "folds: " + ", ".join(f"{count} with {folds}" for folds, count in content["folds"].items()),
        _self_intersections(content["self_intersections"], content["converged"]),
    ]
    return lines


def _label(parameter: str, unit: str) -> str:
    return f"{parameter.replace('_over_', '/').replace('_', ' ')} [{unit}]"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _range(label: str, quantiles: dict[str, float] | None) -> str:
    values = [_number((quantiles or {}).get(f"{share:g}")) for share in QUANTILES[1:-1]]
    return f"{label:<{LABEL}}{values[0]:>8}" + "".join(f"{value:>9}" for value in values[1:])


def _self_intersections(figures: dict, converged: int) -> str:
    of = "all" if figures["looked_at"] == converged else f"{figures['looked_at']} of"
    line = f"self-intersections: {figures['intersecting']} of {of} {converged} converged drapes"
    if figures["drapes"]:
        line += f" (first: {', '.join(map(str, figures['drapes'][:8]))})"
    return line


@dataclass(frozen=True)
class Shot:
    """A drape on the contact sheet, with the text above it."""

    caption: str
    failed: bool
    view: DepthImage


def take_shots(root: Path, drapes: Drapes, *, count: int) -> list[Shot]:
    """Render ``count`` converged drapes, by drape coefficient, and up to a row of failed ones."""
    converged = np.flatnonzero(drapes.converged)
    by_coefficient = converged[np.argsort(drapes.columns["drape_coefficient"][converged],
                                          kind="stable")]
    failed = np.flatnonzero(~drapes.converged)
    shots = [_shoot(root, drapes, int(drape)) for drape
             in [*spread(by_coefficient, count), *spread(failed, ACROSS)]]
    return [shot for shot in shots if shot is not None]


def _shoot(root: Path, drapes: Drapes, drape: int) -> Shot | None:
    """Render a drape; None for a failed one without coordinates."""
    name, row = drapes.places[drape]
    shard = Shard(root / name)
    positions, rest, faces = shard.mesh(row)
    if not rest.any():
        return None
    columns = {key: values[drape] for key, values in drapes.columns.items()}
    failed = columns["status"] != "converged"
    caption = columns["status"] if failed else (
        f"{100 * columns['drape_coefficient']:.0f} %, {columns['folds']} folds")
    return Shot(f"{columns['index']}: {caption}", failed,
                DepthRenderer(positions, faces).view(nominal_camera(shard.rig(row))))


def contact_sheet(shots: list[Shot]) -> bytes:
    """PNG of all shots, cropped to the cloth of all of them; nearer is brighter."""
    views = np.stack([shot.view for shot in shots])
    rows, columns = np.nonzero((views > 0).any(axis=0))
    if len(rows):
        views = views[:, rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    views = np.where(views > 0, views, np.nan)
    low, high = np.nanquantile(views, (0.01, 0.99)) if len(rows) else (0, 1)
    height, width = views.shape[1:]
    across = min(ACROSS, len(shots))
    down = -(-len(shots) // across)
    figure = Figure(figsize=(across * WIDTH, down * (WIDTH * height / width + CAPTION)), dpi=110,
                    layout="constrained")
    panels = figure.subplots(down, across, squeeze=False).ravel()
    for axes in panels:
        axes.set_axis_off()
    for axes, shot, view in zip(panels, shots, views, strict=False):
        axes.imshow(view, cmap="viridis_r", vmin=low, vmax=high, interpolation="nearest")
        axes.set_title(shot.caption, fontsize=7, color=MARK if shot.failed else "black")
    picture = io.BytesIO()
    figure.savefig(picture, format="png", metadata={"Software": None})
    return picture.getvalue()


if __name__ == "__main__":
    main()
