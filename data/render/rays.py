"""Ray casting of meshes by Open3D: depth pictures of single drapes, triangles behind pixels.

The table turns counter-clockwise seen from above and the camera is static: in view k the specimen's
warp axis points along (cos a, sin a) in the world, a = orientation + turn of view k (Feng et al.
2022, section 3.1). Only the cloth is rendered.
"""

import math
from dataclasses import dataclass
from types import ModuleType

import numpy as np

from common.errors import InputError, lacks_memory, one_line
from common.types import DepthImage, Faces, Points, Radians, Turns, Views
from data.render.cameras import QUARTERS, Camera

OPEN3D_REMEDY = "apt-get install libusb-1.0-0 libgl1 libegl1 libgomp1 libx11-6"


def import_open3d() -> ModuleType:
    """Import open3d, late, because it takes a second; InputError if system libraries are missing.
    """
    try:
        import open3d
    except (ImportError, OSError) as error:
        if lacks_memory(error):
            raise
        raise InputError(f"open3d cannot be imported ({one_line(error)}); install drapenet[train], "
                         f"and its libraries with: {OPEN3D_REMEDY}") from None
    return open3d


@dataclass(frozen=True)
class Hits:
    """Nearest intersections of rays, in arrays of the rays' shape."""

    distance: np.ndarray  # in lengths of the ray's direction, infinite for none
    mesh: np.ndarray  # index, -1 for none
    face: np.ndarray  # index in the mesh, -1 for none
    uv: np.ndarray  # (..., 2) weights of the triangle's second and third corner


class RayScene:
    """Meshes, each with two-sided triangles, at which rays are cast in single precision."""

    def __init__(self, *meshes: tuple[Points, Faces]) -> None:
        open3d = import_open3d()
        self._tensor = open3d.core.Tensor
        self._scene = open3d.t.geometry.RaycastingScene(nthreads=1)
        for positions, faces in meshes:
            self._scene.add_triangles(
                self._tensor(np.ascontiguousarray(positions, np.float32)),
                self._tensor(np.ascontiguousarray(faces, np.uint32)))

    def cast(self, starts: np.ndarray, directions: np.ndarray) -> Hits:
        """Cast rays from starts (..., 3) or (3,), m, along directions (..., 3)."""
        rays = np.empty((*directions.shape[:-1], 6), dtype=np.float32)
        rays[..., :3], rays[..., 3:] = starts, directions
        hits = self._scene.cast_rays(self._tensor(rays), nthreads=1)
        distance = hits["t_hit"].numpy()
        mesh, face = (np.where(np.isfinite(distance), hits[name].numpy().astype(np.int64), -1)
                      for name in ("geometry_ids", "primitive_ids"))
        return Hits(distance, mesh, face, hits["primitive_uvs"].numpy())


class DepthRenderer:
    """One drape, at orientation 0, which can be rendered from many sides."""

    def __init__(self, positions: Points, faces: Faces) -> None:
        self._scene = RayScene((positions, faces))

    def view(self, camera: Camera, angle: Radians = 0.0) -> DepthImage:
        """One picture with the specimen turned by ``angle``, counter-clockwise."""
        # The camera rotates instead of the mesh, so that the ray tree is built only once.
        c, s = math.cos(angle), math.sin(angle)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        rotation = camera.world_to_camera[:3, :3] @ turn
        # Directions have z = 1 along the optical axis, so the distance is the z-depth.
        depth = self._scene.cast(-rotation.T @ camera.world_to_camera[:3, 3],
                                 camera.directions() @ rotation).distance
        return np.where(np.isfinite(depth), depth, np.float32(0.0))

    def views(
        self, camera: Camera, orientation: Radians = 0.0, turns: Turns = QUARTERS
    ) -> Views:
        """The pictures of a capture; ``orientation``: direction of the warp in the first view."""
        return np.stack([self.view(camera, orientation + turn) for turn in turns])
