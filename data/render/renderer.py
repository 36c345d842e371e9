"""Depth pictures of a drape by ray casting, usually four, a quarter turn of the table apart.

The table turns counter-clockwise seen from above and the camera is static: in view k the specimen's
warp axis points along (cos a, sin a) in the world, a = orientation + turn of view k (Feng et al.
2022, section 3.1). Only the cloth is rendered, as in captures; the cylinder is not.
"""

import math
from collections.abc import Sequence
from types import ModuleType

import numpy as np

from common.ctrl_c import deferred
from common.errors import InputError, one_line
from data.render.cameras import Camera

VIEWS = 4
QUARTERS = tuple(k * math.pi / 2 for k in range(VIEWS))
"""Turns of the table in four views, rad."""
OPEN3D_REMEDY = "apt-get install libusb-1.0-0 libgl1 libegl1 libgomp1 libx11-6"


def import_open3d() -> ModuleType:
    """Import open3d; InputError with the remedy if its system libraries are missing."""
    # Imported late: it takes a second, and needs system libraries that inference from cut-out
    # pictures does not.
    try:
        with deferred():  # an interrupted import reports a failed initialization
            import open3d
    except (ImportError, OSError) as error:
        raise InputError(
            f"open3d cannot be imported ({one_line(error)}); "
            f"install its libraries with: {OPEN3D_REMEDY}"
        ) from None
    return open3d


class DepthRenderer:
    """Ray caster of one drape, which can be rendered from many sides.

    Args:
        positions: (V, 3) vertices in metres, world axes at orientation 0.
        faces: (F, 3) triangles; both sides are visible.
        threads: ray-casting threads; use one inside worker processes.
    """

    def __init__(self, positions: np.ndarray, faces: np.ndarray, *, threads: int = 1) -> None:
        positions = np.ascontiguousarray(positions, dtype=np.float32)
        faces = np.ascontiguousarray(faces, dtype=np.uint32)
        if positions.ndim != 2 or positions.shape[1] != 3 or not np.isfinite(positions).all():
            raise InputError("positions to render must be finite, of shape (V, 3), in metres")
        if faces.ndim != 2 or faces.shape[1] != 3 or (faces >= len(positions)).any():
            raise InputError("faces to render must be of shape (F, 3) and name existing vertices")
        open3d = import_open3d()
        self._tensor = open3d.core.Tensor
        self._threads = threads
        self._scene = open3d.t.geometry.RaycastingScene(nthreads=threads)
        self._scene.add_triangles(self._tensor(positions), self._tensor(faces))

    def view(self, camera: Camera, angle: float = 0.0) -> np.ndarray:
        """One picture with the specimen turned by ``angle`` (radians, counter-clockwise).

        Returns:
            (height, width) float32 z-depth in metres, background 0.
        """
        # The camera rotates instead of the mesh, so that the ray tree is built only once.
        c, s = math.cos(angle), math.sin(angle)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        specimen_to_camera = camera.world_to_camera[:3, :3] @ turn
        rays = np.empty((camera.height, camera.width, 6), dtype=np.float32)
        rays[..., :3] = -specimen_to_camera.T @ camera.world_to_camera[:3, 3]
        # Directions have z = 1 along the optical axis, so the ray parameter is the z-depth.
        rays[..., 3:] = camera.directions() @ specimen_to_camera
        hit = self._scene.cast_rays(self._tensor(rays), nthreads=self._threads)["t_hit"].numpy()
        return np.where(np.isfinite(hit), hit, np.float32(0.0))

    def views(
        self, camera: Camera, orientation: float = 0.0, turns: Sequence[float] = QUARTERS
    ) -> np.ndarray:
        """The pictures of a capture, (K, height, width) float32 m, background 0.

        ``orientation``, rad: direction of the warp in the first view, 0 to the right, pi/2 away
        from the camera. ``turns`` (K,), rad: turn of the table in each.
        """
        return np.stack([self.view(camera, orientation + turn) for turn in turns])
