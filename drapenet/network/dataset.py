"""Maps of synthetic captures of a dataset's drapes, for training and evaluation.

For small changes of its moduli and its membrane stiffness, a stored drape moves linearly. A capture
of the moved drape shows a neighbouring fabric with the same folds, at a fiftieth of a simulation.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from common.cases import run_cases
from common.errors import InputError
from common.provenance import digest
from common.types import Faces, Points, Radians, Theta
from data.captures.view_checks import CLOTH_SHARE
from data.dataset.folder import MANIFEST
from data.dataset.shards import Shard
from data.fabrics.nuisances import Nuisances
from data.render.setups import Setups
from drapenet.views.directions import AZIMUTHS, ELEVATIONS
from drapenet.views.located import LocatedViews
from drapenet.views.observation import map_along
from drapenet.views.outline import PERSPECTIVES, contour, outline_of_map, silhouettes
from drapenet.views.pictures import PICTURES, SIDE, DepthPictures
from drapenet.views.radial_map import compressed
from sim.mesh import Mesh
from sim.rig import Rig

VERSION = 2
"""Of the maps of a shard: raise it when the same drapes and settings give others."""
_COLUMNS = ("index", "fabric", "theta", "nuisances", "face", "folds", "edge", "seed", "offset",
            "status")
DIRECTION_ERROR = math.radians(2.0)  # of the warp as stated, standard deviation
NEIGHBOUR_CORRELATION = 0.99
"""Of a neighbour's parameters with the fabric's: about a seventh of a standard deviation apart,
which moves lowered drapes by 1 to 3 mm (root mean square); the linear prediction has an error of a
tenth."""
MAX_MOVE = 0.04  # of a neighbour's drape, over the specimen's size
_PARAMETERS = 7  # theta and the logarithm of the membrane stiffness
_MEMBRANE = np.log(10.0) / (2 * 1.96)  # standard deviation of the logarithm, as configs/nuisances


@dataclass(frozen=True)
class Maps:
    """N synthetic captures of drapes: the outlines of all, depth views of D of them, and the truth.

    Azimuth 0 is the direction of the warp as an operator states it.
    """

    distance: np.ndarray  # (D, AZIMUTHS, ELEVATIONS), :func:`drapenet.views.radial_map.compressed`
    weight: np.ndarray
    hem: np.ndarray  # (D, AZIMUTHS) half sizes, outline of the captured cloth, NaN where not seen
    pictures: np.ndarray  # (D, PICTURES or 0, SIDE, SIDE), and, (D,), their angles, as in
    angle: np.ndarray  # :class:`drapenet.views.pictures.DepthPictures`
    depth: np.ndarray  # (N,) row of the depth capture in the fields above, -1 without
    silhouettes: np.ndarray  # (N, P, AZIMUTHS) half sizes, from each of PERSPECTIVES, exact
    theta: Theta
    curl: np.ndarray  # (N, 2) 1/m, of this specimen with the marked face up
    membrane: np.ndarray  # (N,) N/m
    hysteresis: np.ndarray  # (N,)
    kind: np.ndarray  # (N,) number of the kind of cloth
    size: np.ndarray  # (N,) m, as of the fields below
    plate: np.ndarray  # diameter over the size
    rim: np.ndarray  # radius of the plate's, m
    disc: np.ndarray
    aspect: np.ndarray  # side along the weft over that along the warp
    face: np.ndarray
    views: np.ndarray  # their number
    folds: np.ndarray
    fabric: np.ndarray  # number of the fabric in the dataset
    index: np.ndarray  # of the drape in the dataset
    moved: np.ndarray  # whether it shows a neighbour of the fabric

    def __len__(self) -> int:
        return len(self.index)

    def chosen(self, rows: np.ndarray) -> "Maps":
        """The captures of ``rows`` (M,), indices, or (N,), a mask; depth views, which may fill the
        memory, are not copied."""
        return replace(self, **{name: column[rows] for name, column in vars(self).items()
                                if name not in _OF_DEPTH})

    def depth_views(self, rows: np.ndarray, used: np.ndarray) -> dict[str, np.ndarray]:
        """Fields of depth captures, with a row for each of ``rows`` (M,): what shows nothing where
        ``used`` (M,), a mask, is not set."""
        found = {}
        for name, nothing in _OF_DEPTH.items():
            column = getattr(self, name)
            found[name] = np.full((len(rows), *column.shape[1:]), nothing.flat[0], column.dtype)
            found[name][used] = column[self.depth[rows[used]]]
        return found

    @classmethod
    def read(cls, files: Iterable[Path]) -> "Maps":
        """The rows of all files."""
        parts = []
        for file in files:
            with np.load(file, allow_pickle=False) as arrays:
                parts.append(cls(*(arrays[column.name] for column in fields(cls))))
        return cls.joined(parts)

    @classmethod
    def joined(cls, parts: Iterable["Maps"]) -> "Maps":
        """The rows of all ``parts``; a single one is not copied, as it may fill the memory."""
        parts = list(parts)
        if len(parts) == 1:
            return parts[0]
        before = np.cumsum([0, *(len(part.distance) for part in parts)])
        parts = [replace(part, depth=np.where(part.depth < 0, -1, part.depth + rows))
                 for part, rows in zip(parts, before[:-1], strict=True)]
        return cls(*(np.concatenate(columns) for columns in
                     zip(*(vars(part).values() for part in parts), strict=True)))


_OF_DEPTH: dict[str, np.ndarray] = {
    "distance": np.zeros((AZIMUTHS, ELEVATIONS), np.float16),
    "weight": np.zeros((AZIMUTHS, ELEVATIONS), np.uint8),
    "hem": np.full(AZIMUTHS, np.nan, np.float16),
    "pictures": np.full((PICTURES, SIDE, SIDE), np.nan, np.float16), "angle": np.zeros(())}
"""Fields of depth captures, as of a capture that shows nothing."""


def make_maps(
    root: str | Path, manifest: dict, out: Path, *, setups: Setups, captures: int, seed: int,
    neighbours: bool = False, outlines: int = 0, pictures: bool = False, tester: Rig | None = None,
    workers: int = 1,
) -> Maps:
    """Maps of ``captures`` captures of each converged drape of the dataset ``root``, cached in
    ``out``, where an interrupted run is resumed; they are made again where a shard, a setting or
    the :data:`VERSION` has changed.

    Args:
        neighbours: all captures of a drape but the first show neighbours of its fabric, the same
            for all drapes of a fabric.
        outlines: further neighbours of each fabric, of which there are outlines only.
        pictures: whether the maps have the depth views as pictures, eight times as many bytes.
        tester: of whose drapes alone, with any rim, there are maps.
    """
    options = {"setups": setups, "captures": captures, "seed": seed, "neighbours": neighbours,
               "outlines": outlines, "pictures": pictures, **({"tester": tester} if tester else {})}
    folder = out / f"maps_{digest(options)[:12]}"
    # By content: shards grow when a dataset is extended, and are made again.
    cases = {sha256[:16]: {"path": Path(root) / name, "sha256": sha256, "options": options}
             for name, sha256 in manifest["shards"].items()}
    made = run_cases(_shard_case, cases, folder=folder, workers=workers, unit="shard",
                     version=VERSION)
    if not any(case["rows"] for case in made.values()):
        raise InputError(f"{root} has no drapes" + (f" on {tester.name}" if tester else ""))
    return Maps.read(folder / f"{name}.npz" for name, case in made.items() if case["rows"])


def _shard_case(*, path: Path, sha256: str, options: dict[str, Any]) -> dict[str, Any]:
    """Number of rows, and the maps as arrays, of the shard ``path``; InputError if its digest is
    another one."""
    shard = Shard(path)
    if shard.digest != sha256:
        raise InputError(f"{path} differs from {MANIFEST}; remove it and generate it again")
    maps = maps_of_shard(shard, **options)
    return {"rows": len(maps), "arrays": vars(maps)}


def maps_of_shard(
    shard: Shard, *, setups: Setups, captures: int, seed: int, neighbours: bool, outlines: int,
    pictures: bool = False, tester: Rig | None = None,
) -> Maps:
    """Maps of one shard; arguments as for :func:`make_maps`."""
    table = {name: shard.column(name) for name in _COLUMNS}
    converged = np.flatnonzero(table["status"] == "converged")
    rows: list[dict[str, Any]] = []
    depths: list[dict[str, Any]] = []
    for row in converged:
        drape = {name: column[row] for name, column in table.items()}
        rig = shard.rig(row)
        if tester and replace(rig, rim=0.0) != tester:
            continue
        positions, rest, faces = shard.mesh(row)
        mesh = Mesh(rest, faces)
        derivatives = shard.moves(row) if neighbours else None
        for number in range(captures + outlines if derivatives is not None else
                            1 if neighbours else captures):
            step, moved = np.zeros(_PARAMETERS), positions
            if derivatives is not None and number:
                rng = np.random.default_rng([seed, int(drape["fabric"]), number])
                step = neighbour(drape["theta"], table["theta"][converged], rng)
                move = np.tensordot(step, derivatives, 1)
                if np.linalg.norm(move, axis=1).max() > MAX_MOVE * rig.specimen_size:
                    continue  # near an instability, where the prediction is not linear
                moved = positions + move
            rng = np.random.default_rng([seed, int(drape["index"]), number])
            wrong = DIRECTION_ERROR * rng.standard_normal()
            depth, views = None, 0
            if number < captures:
                depth, views, wrong = _depth(moved, faces, rig, setups, rng, wrong)
            rows.append(_truth(drape, rig, step) | {
                "silhouettes": _silhouettes(moved, mesh, rig, wrong), "views": views,
                "depth": len(depths) if depth else -1})
            depths += [depth] if depth else []
    seen = {name: np.stack([nothing, *(depth[name] for depth in depths)])[1:]
            for name, nothing in _OF_DEPTH.items()}
    if not pictures:
        seen["pictures"] = seen["pictures"][:, :0]
    return Maps(**seen, **{field.name: np.array([row[field.name] for row in rows])
                           for field in fields(Maps) if field.name not in seen})


def _depth(
    positions: Points, faces: Faces, rig: Rig, setups: Setups, rng: np.random.Generator,
    wrong: Radians,
) -> tuple[dict[str, Any] | None, int, Radians]:
    """A synthetic depth capture, fields of :class:`Maps`, its number of views, and the error of its
    azimuth 0: that of the stated warp of a disc, ``wrong``, and of the measured side of a
    rectangle; None and no views if it would be refused when it is read."""
    capture = setups.capture(positions, faces, rng, rig=rig)
    if (capture.views > 0).mean(axis=(1, 2)).min() < CLOTH_SHARE[0]:
        return None, 0, wrong  # a flat drape seen along its surface
    located = LocatedViews.cut_out(capture.views, capture.intrinsics, rig, capture.turns)
    drape = map_along(capture.orientation + wrong, located)
    hem = outline_of_map(drape, rig).radius / (rig.specimen_size / 2)
    distance, weight = compressed(drape.distance / rig.specimen_size, drape.weight)
    seen = DepthPictures.of(located, drape.zero)
    return {"distance": distance, "weight": weight, "hem": hem.astype(np.float16),
            "pictures": seen.depth, "angle": seen.angle,
            }, len(capture.views), drape.zero - capture.orientation


def _silhouettes(positions: Points, mesh: Mesh, rig: Rig, wrong: Radians) -> np.ndarray:
    """Outlines of a drape, a row of that field of :class:`Maps`."""
    with np.errstate(divide="ignore"):
        heights = rig.specimen_size / np.array(PERSPECTIVES)
    edges = contour(positions, mesh, heights.min())
    radii = silhouettes(positions, edges, heights, zero=wrong)
    return (radii / (rig.specimen_size / 2)).astype(np.float32)


def _truth(drape: dict[str, np.ndarray], rig: Rig, step: np.ndarray) -> dict[str, Any]:
    """Fabric and specimen of a ``drape``, a row of a shard, moved by ``step``."""
    nuisances = Nuisances(*drape["nuisances"])
    return {"theta": drape["theta"] + step[:-1],
            "curl": drape["face"] * np.array([nuisances.curl_warp, nuisances.curl_weft]),
            "membrane": nuisances.membrane * np.exp(step[-1]), "hysteresis": nuisances.hysteresis,
            "kind": int(nuisances.kind), "moved": step.any(), "size": rig.specimen_size,
            "plate": rig.plate_diameter / rig.specimen_size, "rim": rig.rim,
            "disc": rig.specimen == "disc", "aspect": rig.aspect,
            **{name: drape[name] for name in ("face", "folds", "fabric", "index")}}


def neighbour(theta: Theta, fabrics: Theta, rng: np.random.Generator) -> np.ndarray:
    """(7,) random change of theta and of the logarithm of the membrane stiffness, such that the
    changed fabrics have the mean and the covariance of ``fabrics``.
    """
    far = np.sqrt(1 - NEIGHBOUR_CORRELATION**2)
    middle = fabrics.mean(axis=0)
    target = fabrics[rng.integers(len(fabrics))]
    return np.append((NEIGHBOUR_CORRELATION - 1) * (theta - middle) + far * (target - middle),
                     far * _MEMBRANE * rng.standard_normal())
