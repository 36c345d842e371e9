"""Registration of scans of drapes to a mesh of the specimen, by pulling simulated cloth onto them.

A scan of unmarked cloth does not determine tangential positions on the surface, but the small
strain of cloth does, from the plate's rim outwards. Non-rigid ICP (Amberg et al. 2007), which
Larionov et al. use (section 3.2), stretches the mesh instead: its hem is up to 25 mm off.
"""

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from common.documents import read_bytes
from common.errors import InputError
from common.types import Density, Faces, Metres, Points, Radians
from data.captures.capture import Capture
from data.captures.description import Specimen
from data.captures.scans import MAX_SCAN_SIZE, check_rim, read_scan
from data.render.cameras import nominal_camera
from data.render.rays import QUARTERS, DepthRenderer
from drapenet.refine.springs import Surface, captured_shape, pulled
from drapenet.refine.surface import CapturedShape, Cloud, distances
from sim.cloth import Laws
from sim.material import MICRO, REFERENCE_DENSITY, Fabric
from sim.rig import DISC_RIG, Rig

# As soft as the softest fabrics of the prior, so that folds are preserved.
SOFT = Fabric(alpha=np.full(3, 2 * MICRO), beta=np.zeros(3), density=REFERENCE_DENSITY)
LAST_PULL = 30.0
"""Force of the last pull at 1 mm over the cloth's weight. Simulated scans with noise of 0.3 mm are
matched to 0.09 to 0.17 mm (``python -m experiments refine_scans``)."""
MAX_STRAIN = 0.05  # root mean square of edges; beyond, vertices have slid along the cloth
RAW = (".ply", ".obj")
MAX_CLOUD_BYTES = 256 << 20  # bytes
EDGE = 3e-3  # m, at the rim of the mesh that a scan is registered to
_PLATE_TOLERANCE = 0.02  # m, maximum distance of a raw scan's plate from the plane z = 0
_MAX_DISTANCE = 5e-3  # m, mean distance of the specimen from the scan
_FOREIGN_DISTANCE = 15e-3  # m, from the specimen, beyond which a scanned point is not cloth
_MAX_FOREIGN_SHARE = 0.1  # of such points


@dataclass(frozen=True)
class ScanRegistration:
    """A mesh of the specimen on a scan."""

    shape: CapturedShape
    distance: Metres  # mean of hanging vertices from the scanned surface; 0 for its own vertices


def read_shape(path: Path, rig: Rig, *, edge: Metres = EDGE) -> ScanRegistration:
    """The captured shape of a scan: npz with vertices, rest and faces, or a raw PLY or OBJ.

    Raw scans, and scans whose vertices have slid along the cloth, are registered to a mesh with
    edges of ``edge`` at the rim.
    """
    if path.suffix.lower() in RAW:
        cloud = read_cloud(path, rig)
        check_rim(cloud.points, path, rig)
        registration = register(cloud, rig, edge=edge)
        laid = Cloud.of_mesh(registration.shape.positions, registration.shape.faces)
        away = cKDTree(laid.points).query(cloud.points)[0]
        if (foreign := float((away > _FOREIGN_DISTANCE).mean())) > _MAX_FOREIGN_SHARE:
            raise InputError(f"{path}: {foreign:.0%} of its points do not lie on a specimen of "
                             f"{rig.name}; cut away all that is not cloth, such as the table")
    else:
        scan = read_scan(path, rig)
        surface = Cloud.of_mesh(scan.positions, scan.faces)
        check_rim(surface.points, path, rig)
        shape = CapturedShape(scan.positions, scan.rest, scan.faces, rig)
        if shape.strain < MAX_STRAIN:
            return ScanRegistration(shape, 0.0)
        registration = register(surface, rig, edge=edge, turn=flat_turn(shape))
    if registration.distance > _MAX_DISTANCE:
        raise InputError(f"{path}: the specimen of {rig.name} lies "
                         f"{1e3 * registration.distance:.0f} mm from this surface on average and "
                         "does not fit it; give all of the cloth and nothing else, in metres")
    return registration


def read_scan_capture(path: Path, specimen: Specimen) -> tuple[Capture, CapturedShape]:
    """A scan of a drape on the disc rig, and its views as a capture."""
    shape = read_shape(path, DISC_RIG).shape
    return scan_capture(path, shape, specimen.density, specimen.warp_direction), shape


def scan_capture(
    path: Path, shape: CapturedShape, density: Density, warp: Radians | None
) -> Capture:
    """A scan as a capture of four views without noise, from the rig's nominal camera."""
    camera = nominal_camera(shape.rig)
    views = DepthRenderer(shape.positions, shape.faces).views(camera, 0.0)
    return Capture(views.astype(np.float32), camera.intrinsics, np.array(QUARTERS), density, warp,
                   shape.rig, path, ())


def flat_turn(shape: CapturedShape) -> Radians:
    """Direction of the first rest axis on the plate."""
    held = shape.held
    flat, rest = (points @ [1.0, 1j] for points in (shape.positions[held, :2], shape.rest[held]))
    return float(np.angle(np.vdot(rest, flat)))


def register(cloud: Cloud, rig: Rig, *, edge: Metres, turn: Radians = 0.0) -> ScanRegistration:
    """Register a mesh of the specimen, with edges of ``edge`` at the rim, to a scan.

    ``turn``: direction of the mesh's first rest axis on the plate, unknown from a raw scan.
    """
    c, s = np.cos(turn), np.sin(turn)
    back = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])  # of rows: rig's to rest axes
    # The sign of scanned normals is unknown.
    points = np.tile(cloud.points, (2, 1)) @ back
    normals = np.concatenate([cloud.normals, -cloud.normals]) @ back
    surface = Surface(points, normals, rig)
    laid = captured_shape(SOFT, surface, rig=rig, edge=edge)
    drape = pulled(laid.scene, SOFT, laid.state, surface, laws=Laws(), pulls=[LAST_PULL])
    shape = CapturedShape(drape.state.positions @ back.T, laid.rest, laid.faces, rig)
    return ScanRegistration(shape, float(distances(cloud, shape.positions)[shape.hanging].mean()))


def read_cloud(path: Path, rig: Rig) -> Cloud:
    """Read a raw scan, PLY or OBJ in metres, z up, the plate's centre the origin."""
    points, faces = _read_mesh(path)
    if bad := int((~np.isfinite(points)).any(axis=1).sum()):
        raise InputError(f"{path}: {bad} of {len(points)} points are not finite numbers; "
                         "remove them")
    if not 200 <= len(points) <= MAX_SCAN_SIZE:
        raise InputError(f"{path} has {len(points)} points; a scan has 200 to {MAX_SCAN_SIZE}")
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(points):
        raise InputError(f"{path}: a face refers to a missing vertex; export the scan again")
    reach = np.abs(points).max()
    if not 0.5 * rig.plate_radius < reach < rig.specimen_size:
        raise InputError(f"{path}: points must be in metres, the plate's centre the origin; they "
                         f"reach {reach:.3g} from it, a specimen {rig.specimen_size / 2:g} m")
    middle = points[np.hypot(points[:, 0], points[:, 1]) < 0.8 * rig.plate_radius, 2]
    if not len(middle):
        raise InputError(f"{path}: no point lies on the plate; move its centre to the origin")
    if (off := np.abs(np.median(middle))) > _PLATE_TOLERANCE:
        raise InputError(f"{path}: cloth on the plate lies {1e3 * off:.3g} mm from the plane z = 0 "
                         f"(median), at most {1e3 * _PLATE_TOLERANCE:g} mm is allowed; move the "
                         "plate's top to z = 0, with z pointing up")
    if points[:, 2].min() > -_PLATE_TOLERANCE:
        raise InputError(f"{path}: no point lies below the support; z must point up (in metres)")
    return Cloud.of_mesh(points, faces) if len(faces) else Cloud.of_points(points)


def _read_mesh(path: Path) -> tuple[Points, Faces]:
    """Points and faces, of which there may be none, of a PLY or OBJ file."""
    import trimesh

    # From memory: files that a scan refers to, such as materials, must not be read.
    data = read_bytes(path, MAX_CLOUD_BYTES, "scan")
    try:
        mesh = trimesh.load(io.BytesIO(data), file_type=path.suffix[1:].lower(), process=False,
                            skip_materials=True, force=None)
        points = np.asarray(getattr(mesh, "vertices", np.zeros((0, 3))), dtype=np.float64)
        if points.shape[1:] != (3,):
            raise ValueError("points of another number of coordinates than three")
        faces = np.asarray(getattr(mesh, "faces", np.zeros((0, 3))), dtype=np.int64)
    except Exception as error:
        # Messages of trimesh do not help the user.
        reason = getattr(error, "strerror", None) or (
            "no PLY or OBJ mesh or cloud of points, or a damaged one; export it again")
        raise InputError(f"cannot read the scan {path}: {reason}") from None
    return points, faces
