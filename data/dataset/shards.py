"""HDF5 shards: the file format of simulated drapes (``docs/data_format.md``).

A shard holds a fixed block of drapes, one row each in every array of :func:`fields`. A file's
bytes depend only on its content; its first 512 bytes hold the checksum of the rest.
"""

import hashlib
import io
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import h5py
import numpy as np

from common.documents import read_bytes
from common.errors import InputError, one_line
from common.files import replace_file
from common.types import Faces, Metres, Points, RestPoints
from data.dataset.levels import Levels
from data.fabrics.nuisances import NAMES, Nuisances
from sim.mesh.specimen import TOPOLOGIES, mesh_specimen
from sim.rig import Rig

SCHEMA_VERSION = 10  # of manifests and shards
SEAL_SIZE = 512  # bytes, of the header with the checksum: HDF5's smallest user block
LENGTH_UNIT = 1e-5  # m per count of stored coordinates
COMPRESSION = 9  # gzip level
MAX_SHARD_BYTES = 4 << 30


@dataclass(frozen=True)
class Field:
    """An array of a shard: type and shape of a drape's row, unit and meaning."""

    dtype: str
    shape: tuple[int, ...]
    unit: str
    meaning: str


MOVES, MOVE_UNITS = "moves", "move_units"
MOVED_BY = ("log_alpha", "ratio", "membrane")
"""Groups of parameters by which positions are differentiated, see :mod:`sim.sensitivity.forward`:
theta and the logarithm of the membrane stiffness, seven in all."""
_PARAMETERS = 7
MOVE_COUNTS = 63  # of the largest derivative by a parameter
MOVED_SHARE = 0.35
"""Share of the vertices, at least, whose derivatives are stored; those of the others are predicted,
with an error of a tenth (root mean square)."""
PADDED = ("positions", MOVES)  # in a file, with zeros


def fields(vertices: int, moved: int) -> dict[str, Field]:
    """The arrays of a shard with one row per drape, for the ``vertices`` of its largest mesh, of
    which ``moved`` have derivatives."""
    return {
        "index": Field("i8", (), "", "index of the drape in the dataset"),
        "fabric": Field("i8", (), "", "fabric in the dataset; its drapes share theta"),
        "theta": Field("f8", (6,), "log N·m, m", "moduli at 300 g/m², see data.fabrics.fabrics"),
        "rejected": Field("i4", (), "", "samples rejected before this fabric: no plate has such"),
        "shift": Field("f8", (), "1", "added to the log α of the prior's sample; 0: as drawn"),
        "specimen": Field("S9", (), "", "square, rectangle or disc"),
        "sides": Field("f8", (2,), "m", "nominal, along warp and weft; disc: its diameter"),
        "plate_diameter": Field("f8", (), "m", "nominal diameter of the plate"),
        "rim": Field("f8", (), "m", "radius of the plate's rim"),
        "face": Field("i1", (), "", "1: the fabric's marked face is up; -1: down"),
        "nuisances": Field("f8", (len(NAMES),), "SI", f"in this order: {', '.join(NAMES)}"),
        "density": Field("f8", (), "kg/m²", "mass per area in the simulation"),
        "start": Field("S8", (), "", "initial state: lowered, sine, fold, ring or borrowed"),
        "planned": Field("S8", (), "", "start as planned; the first fabric cannot borrow"),
        "lender": Field("i8", (), "", "index of the borrowed drape; -1: another start"),
        "seed": Field("i8", (), "", "seed of the mesh and the initial state"),
        "offset": Field("f8", (2,), "m", "specimen's centre from the plate's axis: warp, weft"),
        "status": Field("S24", (), "", "outcome: the solver's, exception or out_of_range"),
        "message": Field("S160", (), "", "a sentence about it"),
        "residual": Field("f8", (), "a vertex's weight", "final force residual"),
        "iterations": Field("i4", (), "", "Newton iterations on all meshes"),
        "drape_coefficient": Field("f8", (), "1", "of the drape; NaN unless converged"),
        "folds": Field("i4", (), "", "number of folds; -1 unless converged"),
        "edge": Field("f8", (), "m", "edge length of the mesh at the plate's rim"),
        "vertices": Field("i4", (), "", "of this drape's mesh, up to V; 0: it has none"),
        "check": Field("u4", (), "", "CRC-32 of rest points and positions, int16"),
        "positions": Field("i2", (vertices, 3), "1e-5 m", "vertices, coded by data.dataset.levels"),
        MOVES: Field("i1", (moved, _PARAMETERS, 3), "",
                     "derivatives of positions by theta and the logarithm of the membrane, coded"),
        MOVE_UNITS: Field("f8", (_PARAMETERS,), "m per unit of the parameter",
                          "unit of moves by each parameter; 0: not differentiable"),
    }


def to_counts(coordinates: np.ndarray) -> np.ndarray:
    """Convert coordinates, m, to int16 counts of :data:`LENGTH_UNIT`, of the same shape;
    OverflowError if one is not finite or too large for the type.
    """
    counts = np.rint(np.asarray(coordinates, dtype=np.float64) / LENGTH_UNIT)
    limits = np.iinfo(np.int16)
    if not ((counts >= limits.min) & (counts <= limits.max)).all():  # also for NaN
        raise OverflowError(f"coordinates outside {limits.min * LENGTH_UNIT:g} to "
                            f"{limits.max * LENGTH_UNIT:g} m")
    return counts.astype(np.int16)


def to_moves(derivatives: np.ndarray) -> dict[str, np.ndarray]:
    """The fields "moves" and "move_units" of derivatives (P, V, 3) of positions; they are rounded
    to 1/63 of the largest of each parameter."""
    units = np.abs(derivatives).max(axis=(1, 2)) / MOVE_COUNTS
    counts = np.rint(derivatives / np.maximum(units, 1e-300)[:, None, None])
    return {MOVES: counts.astype(np.int8).transpose(1, 0, 2), MOVE_UNITS: units}


SHARDS = "shard_*.h5"


def shard_name(shard: int) -> str:
    """File name of a shard."""
    return f"shard_{shard:05d}.h5"


def write_shard(
    path: Path, records: Sequence[Mapping[str, np.ndarray]], *,
    attributes: Mapping[str, str | int | float],
) -> None:
    """Write ``records`` to ``path`` in one step; several processes may write the same file.

    A record maps each name of :func:`fields` but "check" to its row, with positions and moves of
    all vertices as counts, and "rest" to the counts (V, 2) of the flat specimen.
    """
    # In memory first, because HDF5 crashes if the disk is full.
    memory = io.BytesIO()
    with h5py.File(memory, "w", libver=("earliest", "v110"), userblock_size=SEAL_SIZE) as file:
        for name, value in attributes.items():
            # Fixed-length text: variable-length text goes through a heap with unused bytes.
            file.attrs[name] = np.bytes_(value.encode()) if isinstance(value, str) else value
        rows = [_coded(record) for record in records]
        sizes = (max(len(row[name]) for row in rows) for name in PADDED)
        for name, field in fields(*sizes).items():
            _write_field(file, name, field, [row[name] for row in rows])
    content = memory.getbuffer()[SEAL_SIZE:]
    replace_file(path, _seal(hashlib.sha256(content).hexdigest()) + content)


def _coded(record: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The row of a record."""
    rest, positions, moves = (np.asarray(record[name], dtype) for name, dtype in (
        ("rest", np.int16), ("positions", np.int16), (MOVES, np.int8)))
    levels = Levels(rest)
    return {**record, "check": _check(rest, positions), "positions": levels.coded(positions),
            MOVES: levels.coded(moves, levels.size(MOVED_SHARE)) if len(moves) else moves}


def _check(rest: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Checksum () of a mesh, counts (V, 2) and (V, 3) of type int16."""
    first, second = (array.astype("<i2").tobytes() for array in (rest, positions))
    return np.array(zlib.crc32(second, zlib.crc32(first)), np.uint32)


def _write_field(file: h5py.File, name: str, field: Field, rows: Sequence[np.ndarray]) -> None:
    """Write one array; shorter rows are padded with zeros."""
    options = {}
    if field.shape and np.prod(field.shape) > 64:
        options = {"chunks": (len(rows), *field.shape), "compression": "gzip", "shuffle": True,
                   "compression_opts": COMPRESSION}
    data = file.create_dataset(name, (len(rows), *field.shape), field.dtype, **options)
    for i, row in enumerate(rows):
        row = np.asarray(row).astype(field.dtype)
        data[(i, slice(len(row))) if name in PADDED else i] = row
    if field.unit:
        data.attrs["unit"] = np.bytes_(field.unit.encode())


def _seal(digest: str) -> bytes:
    """Header of a shard whose remaining bytes have the SHA-256 ``digest``, as readable text."""
    text = f"drapes, schema {SCHEMA_VERSION}, SHA-256 of all after byte {SEAL_SIZE}:\n{digest}\n"
    return text.encode().ljust(SEAL_SIZE, b"\0")


def _require_layout(file: h5py.File) -> None:
    """ValueError unless all arrays have the types and shapes of :func:`fields`."""
    rows, vertices = file["positions"].shape[:2]
    for name, field in fields(vertices, file[MOVES].shape[1]).items():
        if (file[name].dtype, file[name].shape) != (np.dtype(field.dtype), (rows, *field.shape)):
            raise ValueError(f"{name} does not have the type or shape of docs/data_format.md")


@lru_cache(maxsize=8)  # a drape's mesh and its derivatives are asked for one after the other
def _specimen(
    rig: Rig, edge: Metres, topology: int, offset: tuple[float, float]
) -> tuple[np.ndarray, Faces, Levels]:
    """Rest points (V, 2), counts, triangles and levels of a flat specimen."""
    mesh, _ = mesh_specimen(rig, edge=edge, topology=topology, offset=offset)
    rest = to_counts(mesh.rest)
    return rest, mesh.faces, Levels(rest)


class Shard:
    """A shard in memory, verified by its checksum; ``digest``: SHA-256 of the file, hexadecimal."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        data = read_bytes(self.path, MAX_SHARD_BYTES, "shard")
        if data[:SEAL_SIZE] != _seal(hashlib.sha256(memoryview(data)[SEAL_SIZE:]).hexdigest()):
            raise InputError(f"{self.path} is damaged or not a shard of schema version "
                             f"{SCHEMA_VERSION}; generate it again")
        self.digest = hashlib.sha256(data).hexdigest()
        try:
            with h5py.File(io.BytesIO(data), "r") as file:
                _require_layout(file)
                self.attributes = {name: value.decode() if isinstance(value, bytes) else value
                                   for name, value in file.attrs.items()}
                self._arrays = {name: rows[:] for name, rows in file.items()}
        except (RuntimeError, OSError, KeyError, ValueError) as error:
            raise InputError(f"{self.path} is damaged ({one_line(error)}); generate it again"
                             ) from None

    def __len__(self) -> int:
        return len(self._arrays["index"])

    def column(self, name: str) -> np.ndarray:
        """All rows (N, ...) of a field, as stored; text as str."""
        rows = self._arrays[name]
        return np.char.decode(rows, "utf-8", "replace") if rows.dtype.kind == "S" else rows

    def _flat(self, row: int | np.integer) -> tuple[np.ndarray, Faces, Levels]:
        """:func:`_specimen` of a drape."""
        arrays = self._arrays
        if not arrays["vertices"][row]:
            return np.zeros((0, 2), np.int16), np.zeros((0, 3), np.int64), Levels(np.zeros((0, 2)))
        rig = Nuisances(*arrays["nuisances"][row].tolist()).rig(self.rig(row))
        return _specimen(rig, float(arrays["edge"][row]), int(arrays["seed"][row] % TOPOLOGIES),
                         tuple(arrays["offset"][row].tolist()))

    def mesh(self, row: int | np.integer) -> tuple[Points, RestPoints, Faces]:
        """Positions, rest points and faces of a drape; InputError if this code makes another mesh
        of its specimen than the code that made the shard."""
        rest, faces, levels = self._flat(row)
        if len(rest) == self._arrays["vertices"][row]:
            positions = levels.decoded(self._arrays["positions"][row, : len(rest)])
            if _check(rest, positions) == self._arrays["check"][row]:
                return positions * LENGTH_UNIT, rest * LENGTH_UNIT, faces
        raise InputError(f"{self.path}: drape {self._arrays['index'][row]} is on a mesh that this "
                         "version does not make; generate the shard again")

    def moves(self, row: int | np.integer) -> np.ndarray | None:
        """Derivatives (P, V, 3) of a drape's positions by the parameters :data:`MOVED_BY`, m per
        unit of each; None if it has none."""
        units = self._arrays[MOVE_UNITS][row]
        if not units.any():
            return None
        levels = self._flat(row)[2]
        counts = levels.decoded(self._arrays[MOVES][row, : levels.size(MOVED_SHARE)])
        return (counts * units[:, None]).transpose(1, 0, 2)

    def rig(self, row: int | np.integer) -> Rig:
        """Nominal tester of a drape, with its rim."""
        return Rig(tuple(self._arrays["sides"][row].tolist()),
                   float(self._arrays["plate_diameter"][row]), str(self.column("specimen")[row]),
                   rim=float(self._arrays["rim"][row]))
