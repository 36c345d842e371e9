"""Errors with which photographs over the mat are read, as the estimator learns them.

    python -m data.dataset.reading data=FOLDER [out=FILE]

FOLDER is a dataset of drapes, finished or not. Each is photographed as by a user
(:mod:`data.render.phone`), half of them over the code, half with a hem that is hard to see, and
read from one picture, from another, and from both: errors of the outlines as seen from the axis,
and those stated, along the azimuth. Ten seconds a drape and core.
"""

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from common.cases import load_arrays, run_cases
from common.command import command
from common.configs import Seed
from common.errors import InputError
from common.files import replacing, require_file
from common.types import Edges, Metres, Points
from data.captures.capture import OutlineCapture
from data.captures.off_axis import AZIMUTHS
from data.captures.photograph import PhotographedOutline
from data.captures.reader import read_capture
from data.dataset.folder import require_dataset
from data.dataset.off_axis import silhouette
from data.dataset.shards import SHARDS, Shard
from data.pictures.mat import CODE
from data.render.hard import HARD
from data.render.phone import PhonePicture, mat_around, phone_pictures
from sim.material import REFERENCE_DENSITY
from sim.mesh import Mesh
from sim.rig import Rig

PLATES = (0.09, 0.2)  # m, over the mat
LEAST_MARGIN = 5e-3  # m, of the lowest cloth above it
LEAN = float(np.tan(np.radians(20.0)))  # farthest place beside the axis over height
_PICTURES, _SIZE = 2, (1344, 1008)  # pixels
_GROUNDS = {CODE: 0.5, "white": 0.3, "grey": 0.15, "blue": 0.05}  # shares of the mats
STORED = 120  # azimuths of the errors in a file
VERSION = 2
"""Of the errors of a shard: raise it when they change."""


@dataclass
class ReadingConfig:
    """``configs/reading.yaml``."""

    data: str
    cases: str
    out: str
    shards: Annotated[int, Field(ge=1)]
    drapes: Annotated[int, Field(ge=1)]
    workers: Annotated[int, Field(ge=1)]
    seed: Seed


@command("reading", ReadingConfig)
def main(config: ReadingConfig) -> None:
    """Photograph, read, and write the errors of all outlines that can be read."""
    root, out = require_dataset(config.data), Path(config.out)
    require_file(out)
    cases = {shard.stem: {"shard": shard, "drapes": config.drapes, "seed": config.seed}
             for shard in sorted(root.glob(SHARDS))[:config.shards]}
    folder = Path(config.cases)
    results = run_cases(read_again, cases, folder=folder, workers=config.workers, version=VERSION,
                        unit="shard")
    parts = [load_arrays(folder, name) for name in cases]
    off, stated = (np.concatenate([part[name] for part in parts]) for name in ("off", "stated"))
    if not len(off):
        raise InputError(f"no picture of {root} could be read")
    with replacing(out) as file:
        np.savez_compressed(file, off=off.astype(np.float16), stated=stated.astype(np.float16))
    refused = sum(one["refused"] for one in results.values())
    print(f"{len(off)} outlines, {refused} refused; {1e3 * np.sqrt(np.square(off).mean()):.1f} "
          f"thousandths of half a specimen, written to {out}")


def read_again(*, shard: Path, drapes: int, seed: int) -> dict:
    """Errors (N, STORED) of the outlines of the first drapes of a shard, and those stated, in half
    sizes; and the number of captures that are refused."""
    stored = Shard(shard)
    rows = np.flatnonzero(stored.column("status") == "converged")[:drapes]
    found: dict[str, list] = {"off": [], "stated": []}
    refused = 0
    for row in rows:
        positions, rest, faces = stored.mesh(row)
        rig, mesh = stored.rig(row), Mesh(rest, faces)
        rng = np.random.default_rng([seed, int(stored.column("index")[row])])
        ground = str(rng.choice(list(_GROUNDS), p=list(_GROUNDS.values())))
        hard = rng.permutation(list(HARD))[: rng.integers(2)].tolist()
        taken = Taken.of(positions, mesh, rig, rng, pictures=_PICTURES, size=_SIZE, ground=ground,
                         clutter=ground != CODE, hard=hard)
        for chosen in (taken.pictures[:1], taken.pictures[1:2], taken.pictures):
            with tempfile.TemporaryDirectory() as name:
                try:
                    outline = taken.read(chosen, Path(name))
                except InputError:
                    refused += 1
                    continue
            shown = taken.reference(outline)
            error = outline.radii - true_radii(positions, mesh.edges, shown.warp, np.zeros(2),
                                               taken.place(shown)[2])
            for key, values in (("off", error), ("stated", outline.error)):
                assert values is not None
                even = values.reshape(STORED, -1).mean(axis=1)
                found[key].append(even / (rig.specimen_size / 2))
    return {"refused": refused,
            "arrays": {key: np.array(one).reshape(-1, STORED) for key, one in found.items()}}


@dataclass(frozen=True)
class Taken:
    """Pictures of a drape over a mat, the nearest to the axis first."""

    pictures: list[PhonePicture]
    rig: Rig
    mat: str
    plate_height: Metres

    @classmethod
    def of(cls, positions: Points, mesh: Mesh, rig: Rig, rng: np.random.Generator, *, pictures: int,
           **scene: Any) -> "Taken":
        """Random pictures, as a user takes them; ``scene``: for
        :func:`data.render.phone.phone_pictures`."""
        height = max(float(-positions[:, 2].min()) + LEAST_MARGIN, rng.uniform(*PLATES))
        mat = mat_around(rig.reach) if rng.random() < 0.7 else "a2"
        taken = phone_pictures(positions, mesh.rest, mesh.faces, rng, count=pictures, mat=mat,
                               lean=LEAN, beside=1.0, plate_radius=rig.plate_radius,
                               plate_height=height, **scene)
        found = cls(taken, rig, mat, height)
        taken.sort(key=found.lean)
        return found

    def place(self, picture: PhonePicture) -> np.ndarray:
        """The camera's place (3,), m, from the plate's centre."""
        return picture.pose.place - np.array([0, 0, self.plate_height])

    def lean(self, picture: PhonePicture) -> float:
        """Place beside the axis over the height above the plate."""
        x, y, z = self.place(picture)
        return float(np.hypot(x, y) / z)

    def reference(self, outline: PhotographedOutline) -> PhonePicture:
        """The picture from whose height the outline is as it was read: of several the reader takes
        one, and cloth below the plate looks the larger, the lower the camera."""
        return min(self.pictures, key=lambda one: abs(self.place(one)[2] - outline.height))

    def read(self, chosen: list[PhonePicture], folder: Path) -> PhotographedOutline:
        """The outline of ``chosen`` pictures, written to a ``folder``; InputError if refused."""
        for k, picture in enumerate(chosen, 1):
            picture.write(folder, density=REFERENCE_DENSITY, rig=self.rig, mat=self.mat,
                          plate_height=self.plate_height, number=k if len(chosen) > 1 else None)
        capture = read_capture(folder)
        assert isinstance(capture, OutlineCapture)
        return capture.outline


def true_radii(positions: Points, edges: Edges, warp: float, beside: np.ndarray, height: Metres
               ) -> np.ndarray:
    """Radii (720,), m, in the plane of the plate, of what a camera sees from a ``height`` above it
    and a place (2,) ``beside`` its axis, of a drape (V, 3) with the warp turned."""
    cos, sin = np.cos(warp), np.sin(warp)
    points = positions @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1.0]])
    return silhouette(points, edges, beside, height, azimuths=AZIMUTHS)


if __name__ == "__main__":
    main()
