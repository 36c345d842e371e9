"""Maps of synthetic captures of a dataset's drapes, for training and evaluation.

    shard of drapes -> captures (data.render.setups) -> maps (drapenet.views.radial_map) ->
    maps_NNNNN.npz

Files depend on the dataset, the set-ups and the seed only, so an interrupted run can be resumed.
"""

import io
from concurrent.futures import as_completed
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from common.files import remove_partial, replace_file
from common.types import Theta
from common.workers import worker_pool
from data.dataset.folder import json_digest, only_tester
from data.dataset.shards import Shard
from data.fabrics.nuisances import NAMES
from data.render.setups import Setups
from drapenet.network.extrapolated import PARAMETERS, change, moves
from drapenet.network.model import compressed
from drapenet.views.located import LocatedViews
from drapenet.views.radial_map import radial_map
from sim.rig import Rig

_COLUMNS = ("index", "fabric", "theta", "nuisances", "edge", "seed", "offset", "status")


@dataclass(frozen=True)
class Maps:
    """Maps of N captures and their truth.

    Attributes:
        distance, weight: (N, AZIMUTHS, ELEVATIONS), :func:`drapenet.network.model.compressed`.
        warp: (N,) rad, true azimuth of the warp in the map.
        nuisances: (N, 8) of :data:`data.fabrics.nuisances.NAMES`.
        views: (N,) number of views.
        fabric, index: (N,) of the drape in the dataset.
        moved: (N,) whether it shows a neighbour of the fabric (:mod:`.extrapolated`).
    """

    distance: np.ndarray
    weight: np.ndarray
    theta: Theta
    warp: np.ndarray
    nuisances: np.ndarray
    views: np.ndarray
    fabric: np.ndarray
    index: np.ndarray
    moved: np.ndarray

    def __len__(self) -> int:
        return len(self.index)

    def nuisance(self, name: str) -> np.ndarray:
        """(N,) values of a nuisance."""
        return self.nuisances[:, NAMES.index(name)]

    def chosen(self, rows: np.ndarray) -> "Maps":
        """The maps of ``rows``, indices or a mask."""
        return Maps(*(column[rows] for column in vars(self).values()))

    @staticmethod
    def joined(parts: "list[Maps]") -> "Maps":
        """The rows of all parts."""
        return Maps(*map(np.concatenate, zip(*(vars(part).values() for part in parts),
                                           strict=True)))


def make_maps(
    root: str | Path, manifest: dict, out: Path, *, setups: Setups, captures: int, seed: int,
    neighbours: bool = False, workers: int = 1, shards: int | None = None,
) -> Maps:
    """Maps of ``captures`` captures of each converged drape of the dataset ``root``.

    Args:
        manifest: of the complete dataset.
        out: folder of the cached files; each set of arguments has a subfolder.
        neighbours: all captures of a drape but the first show a neighbour of its fabric.
        workers: processes of one thread each; files do not depend on it.
        shards: number of shards used; None: all.
    """
    options = {"setups": setups, "captures": captures, "seed": seed, "neighbours": neighbours}
    settings = options | {"dataset": manifest["identity"], "setups": asdict(setups)}
    folder = out / f"maps_{json_digest(settings)[:12]}"
    folder.mkdir(parents=True, exist_ok=True)
    files = {Path(root) / name: folder / f"{Path(name).stem}.npz"
             for name in list(manifest["shards"])[:shards]}
    missing = [shard for shard in files if not files[shard].exists()]
    if missing:
        rig = only_tester(root, manifest)
        with worker_pool(workers) as pool:
            running = [pool.submit(_write_maps, shard, files[shard], rig=rig, **options)
                       for shard in missing]
            for done in tqdm(as_completed(running), total=len(running), unit="shard", desc="maps"):
                done.result()
    return Maps.joined([_read_maps(file) for file in files.values()])


def _write_maps(shard: Path, path: Path, **options: Any) -> None:
    content = io.BytesIO()
    np.savez(content, **vars(maps_of_shard(shard, **options)))
    remove_partial(path.parent, path.name)
    replace_file(path, content.getvalue())


def _read_maps(path: Path) -> Maps:
    with np.load(path, allow_pickle=False) as arrays:
        return Maps(*(arrays[field.name] for field in fields(Maps)))


def maps_of_shard(
    shard: Path, *, rig: Rig, setups: Setups, captures: int, seed: int, neighbours: bool
) -> Maps:
    """Maps of one shard; arguments as for :func:`make_maps`."""
    maps = []
    rows: dict[str, list] = {name: [] for name in ("theta", "nuisances", "warp", "views", "moved")}
    drapes = Shard(shard)
    table = {name: drapes.column(name) for name in _COLUMNS}
    converged = np.flatnonzero(table["status"] == "converged")
    for row in converged:
        drape = {name: column[row] for name, column in table.items()}
        positions, _, faces = drapes.mesh(row)
        derivatives = moves(drape, positions, drapes.origin(row), rig) if neighbours else None
        for number in range(captures):
            rng = np.random.default_rng([seed, int(drape["index"]), number])
            step, moved = np.zeros(PARAMETERS), positions
            if derivatives is not None and number:
                step = change(drape["theta"], table["theta"][converged], rng)
                moved = positions + np.tensordot(step, derivatives, 1)
            capture = setups.capture(moved, faces, rng, rig=rig)
            maps.append(radial_map(
                LocatedViews.cut_out(capture.views, capture.intrinsics, rig, capture.turns)))
            nuisances = drape["nuisances"].copy()
            nuisances[NAMES.index("membrane")] *= np.exp(step[-1])
            for name, value in zip(rows, (drape["theta"] + step[:-1], nuisances,
                                          capture.orientation - maps[-1].zero,
                                          len(capture.views), step.any()), strict=True):
                rows[name].append(value)
    many = np.repeat(converged, captures)
    return Maps(*compressed(maps), **{name: np.array(values) for name, values in rows.items()},
                **{name: table[name][many] for name in ("fabric", "index")})
