"""Maps of synthetic captures of a dataset's drapes, for training and evaluation.

For small changes of its moduli and its membrane stiffness, a stored drape moves linearly. A capture
of the moved drape shows a neighbouring fabric with the same folds, at a fifth of a simulation.
"""

import io
from collections.abc import Iterable
from concurrent.futures import as_completed
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from common.files import remove_partial, replace_file
from common.types import Points, Theta
from common.workers import worker_pool
from data.dataset.folder import json_digest, only_tester
from data.dataset.shards import Shard
from data.fabrics.fabrics import fabric_from_theta
from data.fabrics.nuisances import NAMES, Nuisances
from data.render.setups import Setups
from drapenet.network.model import compressed
from drapenet.views.located import LocatedViews
from drapenet.views.radial_map import radial_map
from sim.drape import FINE_OPTIONS
from sim.equilibrium import find_equilibrium
from sim.mesh.specimen import TOPOLOGIES
from sim.rig import Rig
from sim.scene import make_specimen
from sim.sensitivity import Tangent
from sim.sensitivity.forward import tangent_sensitivities

_COLUMNS = ("index", "fabric", "theta", "nuisances", "edge", "seed", "offset", "status")
NEIGHBOUR_CORRELATION = 0.97
"""Of a neighbour's parameters with the fabric's: about a quarter of a standard deviation apart,
which moves a drape by 1 mm; the linear prediction has an error of a quarter."""
_PARAMETERS = 7  # theta and the logarithm of the membrane stiffness
_MEMBRANE = np.log(10.0) / (2 * 1.96)  # standard deviation of the logarithm, as configs/nuisances
_EQUILIBRIUM_TOLERANCE = 5e-4  # m, maximum move of a stored drape to its equilibrium


@dataclass(frozen=True)
class Maps:
    """Maps of N captures and their truth, (N, ...) each."""

    distance: np.ndarray  # :func:`drapenet.network.model.compressed`
    weight: np.ndarray
    theta: Theta
    warp: np.ndarray  # rad, true azimuth in the map
    nuisances: np.ndarray  # of :data:`data.fabrics.nuisances.NAMES`
    views: np.ndarray  # their number
    fabric: np.ndarray  # number of the fabric in the dataset
    index: np.ndarray  # of the drape in the dataset
    moved: np.ndarray  # whether it shows a neighbour of the fabric

    def __len__(self) -> int:
        return len(self.index)

    def nuisance(self, name: str) -> np.ndarray:
        """(N,) values of a nuisance."""
        return self.nuisances[:, NAMES.index(name)]

    def chosen(self, rows: np.ndarray) -> "Maps":
        """The maps of ``rows``, indices or a mask."""
        return Maps(*(column[rows] for column in vars(self).values()))

    @classmethod
    def read(cls, files: Iterable[Path]) -> "Maps":
        """The rows of all files."""
        parts = []
        for file in files:
            with np.load(file, allow_pickle=False) as arrays:
                parts.append([arrays[column.name] for column in fields(cls)])
        return cls(*map(np.concatenate, zip(*parts, strict=True)))


def make_maps(
    root: str | Path, manifest: dict, out: Path, *, setups: Setups, captures: int, seed: int,
    neighbours: bool = False, workers: int = 1, shards: int | None = None,
) -> Maps:
    """Maps of ``captures`` captures of each converged drape of the dataset ``root``, cached in
    ``out``, where an interrupted run is resumed.

    Args:
        neighbours: all captures of a drape but the first show a neighbour of its fabric.
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
    return Maps.read(files.values())


def _write_maps(shard: Path, path: Path, **options: Any) -> None:
    content = io.BytesIO()
    np.savez(content, **vars(maps_of_shard(shard, **options)))
    remove_partial(path.parent, path.name)
    replace_file(path, content.getvalue())


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
        derivatives = (drape_derivatives(drape, positions, drapes.origin(row), rig)
                       if neighbours else None)
        for number in range(captures):
            rng = np.random.default_rng([seed, int(drape["index"]), number])
            step, moved = np.zeros(_PARAMETERS), positions
            if derivatives is not None and number:
                step = neighbour(drape["theta"], table["theta"][converged], rng)
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
    repeated = np.repeat(converged, captures)
    return Maps(*compressed(maps), **{name: np.array(values) for name, values in rows.items()},
                **{name: table[name][repeated] for name in ("fabric", "index")})


def drape_derivatives(
    row: dict[str, np.ndarray], positions: Points, origin: np.ndarray, rig: Rig
) -> np.ndarray | None:
    """(7, V, 3) derivatives of the stored drape of a ``row`` by theta and the logarithm of the
    membrane stiffness, or None; ``origin``: (F, 3) 1/m, curvatures without friction.
    """
    nuisances = Nuisances(*row["nuisances"])
    rig, fabric = nuisances.rig(rig), fabric_from_theta(row["theta"])
    scene = make_specimen(rig, edge=float(row["edge"]), topology=int(row["seed"]) % TOPOLOGIES,
                          offset=tuple(row["offset"]))
    positions = positions.copy()
    positions[scene.held] = rig.place(scene.mesh.rest[scene.held])
    laws = nuisances.laws
    if nuisances.hysteresis:
        laws = replace(laws, bending=replace(laws.bending, origin=origin[scene.active]))
    equilibrium = find_equilibrium(
        scene, fabric, scene.state(positions), laws=laws, options=FINE_OPTIONS, self_contact=True)
    if np.abs(equilibrium.state.positions - positions).max() > _EQUILIBRIUM_TOLERANCE:
        return None
    tangent = Tangent(equilibrium.cloth, equilibrium.state.q, equilibrium.outcome.factor)
    derivatives = tangent_sensitivities(tangent, fabric, ("log_alpha", "ratio", "membrane"))
    return derivatives.positions if derivatives.ok else None


def neighbour(theta: Theta, fabrics: Theta, rng: np.random.Generator) -> np.ndarray:
    """(7,) random change of theta and of the logarithm of the membrane stiffness, such that the
    changed fabrics have the mean and the covariance of ``fabrics``.
    """
    far = np.sqrt(1 - NEIGHBOUR_CORRELATION**2)
    middle = fabrics.mean(axis=0)
    target = fabrics[rng.integers(len(fabrics))]
    return np.append((NEIGHBOUR_CORRELATION - 1) * (theta - middle) + far * (target - middle),
                     far * _MEMBRANE * rng.standard_normal())
