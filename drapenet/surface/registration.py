"""Registration of scans of drapes to a mesh of the specimen, by pulling simulated cloth onto them.

A scan of unmarked cloth does not determine tangential positions on the surface, but the small
strain of cloth does, from the plate's rim outwards.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from common.errors import InputError
from common.findings import Finding
from common.types import Density, Metres, Radians
from data.captures.capture import DepthCapture
from data.captures.description import Specimen
from data.captures.raw_scans import KINDS, RAW, read_raw_scan
from data.captures.scans import check_rim, read_scan
from data.render.cameras import QUARTERS, nominal_camera
from data.render.raster import rasterise
from drapenet.surface.shape import CapturedShape, Cloud, distances
from drapenet.surface.springs import Surface, captured_shape, pulled
from sim.cloth import Laws
from sim.material import MICRO, REFERENCE_DENSITY, Fabric
from sim.rig import DISC_RIG, Rig

# As soft as the softest fabrics of the prior, so that folds are preserved.
SOFT = Fabric(alpha=np.full(3, 2 * MICRO), beta=np.zeros(3), density=REFERENCE_DENSITY)
LAST_PULL = 30.0
"""Force of the last pull at 1 mm over the cloth's weight. Simulated scans with noise of 0.3 mm are
matched to 0.09 to 0.17 mm (docs/validation.md, Refinement)."""
MAX_STRAIN = 0.05  # root mean square of edges; beyond, vertices have slid along the cloth
EDGE = 3e-3  # m, at the rim of the mesh that a scan is registered to
_MAX_DISTANCE = 5e-3  # m, mean distance of the specimen from the scan
_FOREIGN_DISTANCE = 15e-3  # m, from the specimen, beyond which a scanned point is not cloth
_MAX_FOREIGN_SHARE = 0.1  # of such points


@dataclass(frozen=True)
class ScanRegistration:
    """A mesh of the specimen on a scan."""

    shape: CapturedShape
    distance: Metres  # mean of hanging vertices from the scanned surface; 0 for its own vertices
    warnings: tuple[Finding, ...] = ()  # what was changed of a raw scan


def read_shape(path: Path, rig: Rig, *, edge: Metres = EDGE) -> ScanRegistration:
    """The captured shape of a scan: npz with vertices, rest and faces, or a raw one
    (:data:`~data.captures.raw_scans.RAW`).

    Raw scans, and scans whose vertices have slid along the cloth, are registered to a mesh with
    edges of ``edge`` at the rim.
    """
    if path.suffix.lower() in RAW:
        raw = read_raw_scan(path, rig)
        cloud = (Cloud.of_mesh(raw.points, raw.faces) if len(raw.faces)
                 else Cloud.of_points(raw.points))
        check_rim(cloud.points, path, rig)
        registration = replace(register(cloud, rig, edge=edge), warnings=raw.warnings)
        laid = Cloud.of_mesh(registration.shape.positions, registration.shape.faces)
        away = cKDTree(laid.points).query(cloud.points)[0]
        if (foreign := float((away > _FOREIGN_DISTANCE).mean())) > _MAX_FOREIGN_SHARE:
            raise InputError(f"{path}: {foreign:.0%} of its points do not lie on a specimen of "
                             f"{rig.name}; cut away all that is not cloth, such as the table, or "
                             "drape a specimen of that size")
    elif path.suffix.lower() != ".npz":
        raise InputError(f"{path} is not a scan of a kind that is read; export it as {KINDS}, or "
                         "give an .npz with vertices, rest and faces")
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
                         "does not fit it; give all of the cloth and nothing else")
    return registration


@dataclass(frozen=True, kw_only=True)
class ScannedCapture(DepthCapture):
    """The scan of a drape, as four rendered views of its surface."""

    shape: CapturedShape  # a mesh of the specimen on it


def read_scan_capture(path: Path, specimen: Specimen) -> ScannedCapture:
    """A scan of a drape on the disc rig as a capture."""
    scan = read_shape(path, DISC_RIG)
    capture = scan_capture(path, scan.shape, specimen.density, specimen.warp_direction)
    return replace(capture, warnings=specimen.questions + scan.warnings)


def scan_capture(
    path: Path, shape: CapturedShape, density: Density, warp: Radians | None
) -> ScannedCapture:
    """A scan as a capture of four views without noise, from the rig's nominal camera."""
    camera = nominal_camera(shape.rig)
    views = rasterise(shape.positions, shape.faces, camera, QUARTERS)
    return ScannedCapture(views, camera.intrinsics, np.array(QUARTERS),
                          density=density, warp_direction=warp, rig=shape.rig, path=path,
                          shape=shape)


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
    laid = captured_shape(SOFT, surface, edge=edge)
    drape = pulled(laid.scene, SOFT, laid.state, surface, laws=Laws(), pulls=[LAST_PULL])
    shape = CapturedShape(drape.state.positions @ back.T, laid.rest, laid.faces, rig)
    return ScanRegistration(shape, float(distances(cloud, shape.positions)[shape.hanging].mean()))
