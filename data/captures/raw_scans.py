"""Scans as scanners write them: meshes or clouds of points, in any unit and orientation."""

import io
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from common.documents import read_bytes, reading
from common.errors import InputError, of
from common.findings import Finding
from common.types import Faces, Points
from data.captures.scan_place import cut_away, plate_filled, plate_of_scan
from data.captures.scans import MAX_SCAN_SIZE
from sim.rig import Rig

RAW = (".ply", ".obj", ".stl", ".glb")  # suffixes
KINDS = f"{', '.join(RAW[:-1])} or {RAW[-1]}"
MAX_BYTES = 256 << 20
MIN_POINTS = 200
_HEAD = 1 << 16  # bytes of a file that show how it is written
_UNREAD = {rb"KHR_draco|EXT_meshopt": "is compressed; export it without compression",
           rb"^[ \t]*(v\w*[ \t]+)?-?\d+,\d+[ \t]+-?\d+,\d": "has decimal commas; write points"}


@dataclass(frozen=True)
class RawScan:
    """A scanned surface in metres, z up, the centre of the plate's top its origin; ``faces`` may be
    none, ``warnings`` state what was measured and changed."""

    points: Points
    faces: Faces
    warnings: tuple[Finding, ...] = ()


def read_raw_scan(path: Path, rig: Rig) -> RawScan:
    """Read a file of a kind of :data:`RAW`: unit, vertical, tilt and centre are measured from the
    flat plate, what is not cloth is cut away, and the plate's plane fills gaps on it.
    """
    with reading(path, f"export the scan again as {KINDS}"):
        points, faces = _read(path)
    with of(path):
        return _placed(points, faces, rig)


def _placed(points: Points, faces: Faces, rig: Rig) -> RawScan:
    points, changes = plate_of_scan(points, faces, rig).placed(points)
    cloth, others = cut_away(points, faces, rig)
    if others:
        if cloth.sum() < MIN_POINTS:
            raise InputError(f"{cloth.sum()} points of it are cloth, at least {MIN_POINTS} are "
                             "needed; scan more densely")
        faces = np.cumsum(cloth)[faces[cloth[faces].all(axis=1)]] - 1
        points = points[cloth]
    points, faces, filled = plate_filled(points, faces, rig)
    return RawScan(points, faces, (*changes, *others, *filled))


def _read(path: Path) -> tuple[Points, Faces]:
    """Points and faces, merged; InputError for impossible ones, any error for a damaged file."""
    import trimesh

    data = read_bytes(path, MAX_BYTES, "scan")
    for mark, fault in _UNREAD.items():
        if re.search(mark, data[:_HEAD], re.MULTILINE):
            raise InputError(fault, source=path, joint=" ")
    if path.suffix.lower() == ".obj":
        data = _counted_from_first(data)
    # From memory: files that a scan refers to, such as materials, must not be read.
    mesh: Any = trimesh.load(io.BytesIO(data), file_type=path.suffix[1:].lower(), process=False,
                        skip_materials=True)
    if isinstance(mesh, trimesh.Scene):  # a mesh for each material
        mesh = trimesh.util.concatenate(mesh.dump())
    points = np.asarray(mesh.vertices, dtype=np.float64)
    if points.shape[1:] != (3,):
        raise ValueError("points have another number of coordinates than three")
    faces = np.asarray(getattr(mesh, "faces", np.zeros((0, 3))), dtype=np.int64)
    if bad := int((~np.isfinite(points)).any(axis=1).sum()):
        raise InputError(f"{bad} of {len(points)} points are not finite numbers; "
                         "remove them", source=path)
    if len(faces):
        if not 0 <= faces.min() <= faces.max() < len(points):
            raise InputError("a face refers to a missing vertex; export the scan again",
                             source=path)
        mesh.merge_vertices()  # STL has the corners of each triangle apart
        points, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces)
    if not MIN_POINTS <= len(points) <= MAX_SCAN_SIZE:
        raise InputError(f"has {len(points)} points; a scan has {MIN_POINTS} to "
                         f"{MAX_SCAN_SIZE}", source=path, joint=" ")
    return points, faces


def _counted_from_first(text: bytes) -> bytes:
    """An OBJ whose faces count vertices from the first on: trimesh takes negative ones, which count
    back from the face, for places from the end of the file."""
    count = 0

    def line(found: re.Match[bytes]) -> bytes:
        nonlocal count
        count += found[1] == b"v"
        return found[0] if found[1] == b"v" else re.sub(
            rb"(?<=[ \t])-(\d+)\S*", lambda back: b"%d" % (count + 1 - int(back[1])), found[0])

    back = re.search(rb"^f[ \t].*-", text, re.MULTILINE)
    return re.sub(rb"^([vf])[ \t].*", line, text, flags=re.MULTILINE) if back else text
