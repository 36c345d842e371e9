"""Statistics of a dataset."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data.dataset.progress import over_shards
from data.dataset.shards import COORDINATES, FACES, Shard
from data.fabrics.fabrics import THETA_NAMES
from data.fabrics.prior import prior_from_content, sample_admissible
from sim.energies.self_contact import self_intersections
from sim.material import MICRO
from sim.measures import maximum_stretch

COLUMNS = ("index", "fabric", "theta", "rejected", "start", "status", "message", "iterations",
           "drape_coefficient", "folds")
QUANTILES = (0.0, 0.01, 0.1, 0.5, 0.9, 0.99, 1.0)
RANGE = (0.01, 0.99)  # quantiles of the prior; fabrics beyond them are counted as outside
PRIOR_SAMPLES = 2000


@dataclass(frozen=True)
class Drapes:
    """All drapes of a dataset, one row each, in order.

    Attributes:
        columns: arrays of :data:`COLUMNS`, as returned by :meth:`data.dataset.shards.Shard.column`.
        places: shard and row of each drape.
        stretch: (N,) largest strain of a triangle, NaN unless converged. Vertices are rounded to
            5 µm, which causes an uncertainty of about 0.1 %.
        crossings: (N,) number of edges that intersect a face; -1 if not checked.
        bytes: size on disk of each array of the shards, and ``other`` for the rest of the files.
    """

    columns: dict[str, np.ndarray]
    places: list[tuple[str, int]]
    stretch: np.ndarray
    crossings: np.ndarray
    bytes: dict[str, int]

    @property
    def converged(self) -> np.ndarray:
        """(N,) bool."""
        return self.columns["status"] == "converged"


def read_drapes(root: Path, manifest: dict, *, intersections: int) -> Drapes:
    """Read and measure a dataset's drapes; count the self-intersections of ``intersections`` of
    them, evenly spread over the converged ones."""
    parts: dict[str, list[np.ndarray]] = {name: [] for name in COLUMNS}
    places, used, seen = [], Counter(), 0
    looked_at = set(spread(np.arange(manifest["outcomes"].get("converged", 0)), intersections))
    stretch, crossings = np.full(manifest["drapes"], np.nan), np.full(manifest["drapes"], -1)
    for name in over_shards(manifest["shards"], "measuring"):
        shard = Shard(root / name)
        for column, arrays in parts.items():
            arrays.append(shard.column(column))
        for row in np.flatnonzero(parts["status"][-1] == "converged"):
            drape = len(places) + row
            positions, rest, faces = shard.mesh(row)
            # Triangles held by the plate are not stretched and need not be excluded.
            stretch[drape] = maximum_stretch(positions, rest, faces,
                                             np.zeros(len(rest), dtype=bool))
            if seen in looked_at:
                crossings[drape] = len(self_intersections(positions, faces))
            seen += 1
        places += [(name, row) for row in range(len(shard))]
        used.update(shard.storage)
        used["other"] += (root / name).stat().st_size - sum(shard.storage.values())
    columns = {name: np.concatenate(arrays) for name, arrays in parts.items()}
    return Drapes(columns, places, stretch, crossings, dict(used))


def spread(items: np.ndarray, count: int) -> np.ndarray:
    """At most ``count`` of ``items`` (N, ...), evenly spread, with the first and the last."""
    chosen = np.linspace(0, len(items) - 1, min(count, len(items))).round().astype(int)
    return items[chosen]


def prior_samples(manifest: dict) -> tuple[np.ndarray, float]:
    """Draw theta (n, 6), n = :data:`PRIOR_SAMPLES`, from the dataset's prior; return also the share
    of rejected samples."""
    prior = prior_from_content(manifest["config"]["prior"], origin="the dataset's prior")
    rng = np.random.default_rng(0)
    theta, rejected = zip(*(sample_admissible(prior, rng) for _ in range(PRIOR_SAMPLES)),
                          strict=True)
    return np.array(theta), sum(rejected) / (sum(rejected) + PRIOR_SAMPLES)


def in_display_units(theta: np.ndarray) -> np.ndarray:
    """Convert theta (..., 6) to alpha in µN·m and beta/alpha in mm."""
    return np.concatenate([np.exp(theta[..., :3]) / MICRO, theta[..., 3:] * 1e3], axis=-1)


PARAMETERS = tuple(name.removeprefix("log_") for name in THETA_NAMES)
UNITS = ("µN·m",) * 3 + ("mm",) * 3
"""Names and units of :func:`in_display_units`; at 300 g/m²."""


def draped_fabrics(drapes: Drapes) -> np.ndarray:
    """theta (F, 6) of the fabrics with a converged drape, which are used in training."""
    kept = drapes.converged
    _, first = np.unique(drapes.columns["fabric"][kept], return_index=True)
    return drapes.columns["theta"][kept][first]


def report(manifest: dict, drapes: Drapes, prior: tuple[np.ndarray, float]) -> dict:
    """Statistics of the dataset in JSON types, independent of folder and machine.

    ``prior``: fabrics (n, 6) and the rejected share, from :func:`prior_samples`.
    """
    columns, converged = drapes.columns, drapes.converged
    rejected = columns["rejected"][np.unique(columns["fabric"], return_index=True)[1]]
    looked_at = drapes.crossings >= 0
    crossing = np.flatnonzero(drapes.crossings > 0)
    return {
        "dataset": {name: manifest[name] for name in ("identity", "hash")},
        "drapes": len(converged),
        "converged": int(converged.sum()),
        "fabrics": len(rejected),
        "fabrics_with_a_drape": len(draped_fabrics(drapes)),
        "rejection_rate": {
            "dataset": float(rejected.sum() / (rejected.sum() + len(rejected))),
            "prior": prior[1],
        },
        "starts": _starts(columns, converged),
        "failures": _failures(columns, converged),
        "parameters": _parameters(drapes, prior[0]),
        "drape_coefficient": _quantiles(columns["drape_coefficient"][converged]),
        "folds": {str(n): count for n, count
                  in sorted(Counter(columns["folds"][converged].tolist()).items())},
        "stretch": _quantiles(drapes.stretch[converged]),
        "iterations": _quantiles(columns["iterations"][converged]),
        "self_intersections": {
            "looked_at": int(looked_at.sum()),
            "intersecting": len(crossing),
            "drapes": columns["index"][crossing].tolist(),
        },
        "disk": _disk(drapes),
    }


def _quantiles(values: np.ndarray) -> dict[str, float] | None:
    """:data:`QUANTILES` by name; None of nothing."""
    if not len(values):
        return None
    return {f"{q:g}": float(v) for q, v in zip(QUANTILES, np.quantile(values, QUANTILES),
                                               strict=True)}


def _starts(columns: dict[str, np.ndarray], converged: np.ndarray) -> dict[str, dict]:
    """By initial state: number of drapes, number of converged ones, their mean number of folds."""
    result = {}
    for start in np.unique(columns["start"]).tolist():
        these = columns["start"] == start
        folds = columns["folds"][these & converged]
        result[start] = {
            "drapes": int(these.sum()),
            "converged": len(folds),
            "mean_folds": float(folds.mean()) if len(folds) else None,
        }
    return result


def _failures(columns: dict[str, np.ndarray], converged: np.ndarray) -> list[dict]:
    """Failures by status, the most frequent first: count, and index and message of the first."""
    reasons = Counter(columns["status"][~converged].tolist())
    result = []
    for status, count in sorted(reasons.items(), key=lambda item: (-item[1], item[0])):
        first = int(np.flatnonzero(columns["status"] == status)[0])
        result.append({
            "status": status,
            "drapes": count,
            "first": int(columns["index"][first]),
            "message": str(columns["message"][first]),
        })
    return result


def _parameters(drapes: Drapes, prior: np.ndarray) -> dict[str, dict]:
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


def _disk(drapes: Drapes) -> dict[str, int]:
    """Bytes of the shards by part."""
    used = dict(drapes.bytes)
    parts = {"meshes": sum(used.pop(name) for name in (*COORDINATES, FACES)),
             "file structure": used.pop("other")}
    return {**parts, "records": sum(used.values()), "all": sum(drapes.bytes.values())}
