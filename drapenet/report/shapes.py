"""``drape.glb``: the captured surface and the simulated drape in one scene.

Metres, y up, origin at the plate's centre; x to the right in the first view, z towards the camera.
Nodes: ``captured``, ``simulated``, ``support``.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import trimesh
from trimesh.visual.material import PBRMaterial

from common.types import DepthImage, Faces, Metres, Points
from drapenet.report.drape import Resimulation, turned
from drapenet.views.located import LocatedViews
from sim.mesh import vertex_normals
from sim.rig import Rig

MAX_POINTS = 16_000  # of the captured surface, all views together
MAX_JUMP = 6e-3  # m, range of depths within a triangle
_COLUMN = 0.13  # m, height of the support that is drawn
_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # of rows: z up to y up
_CLOTH = (217, 118, 42)
_COLOURS = {"captured": (168, 172, 178), "support": (120, 116, 110)}


def drape_glb(rig: Rig, located: LocatedViews | None, drape: Resimulation | None) -> bytes:
    """The scene as binary glTF; without the node ``captured`` for a photograph, and without
    ``simulated`` if no simulated drape converged."""
    scene = trimesh.Scene()
    if located is not None:
        add_surface(scene, "captured", *captured_surface(located))
    if drape is not None:
        add_surface(scene, "simulated", drape.positions, drape.drape.faces)
    radius = 0.985 * rig.sharp.plate_radius
    column = trimesh.creation.cylinder(radius=radius, height=_COLUMN, sections=64)
    add_surface(scene, "support", column.vertices - [0, 0, _COLUMN / 2 + 1e-3], column.faces,
                flat=True)
    return scene.export(file_type="glb", include_normals=True)


def captured_surface(located: LocatedViews) -> tuple[Points, Faces]:
    """Surfaces of all views in the orientation of the first, not merged where they overlap."""
    views, camera = located.views, located.camera
    step = max(1, int(np.ceil(np.sqrt((views > 0).sum() / MAX_POINTS))))
    small = views[:, ::step, ::step]
    rotation, shift = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
    points, faces, before = [], [], 0
    for view, full, turn in zip(small, views, located.turns, strict=True):
        world = (camera.back_project(full)[::step, ::step] - shift) @ rotation
        cloth = view > 0
        number = np.full(view.shape, -1)
        number[cloth] = before + np.arange(cloth.sum())
        faces.append(_between(number, view))
        points.append(turned(world[cloth] - [*located.centre, 0.0], -turn))
        before += cloth.sum()
    return np.concatenate(points), np.concatenate(faces)


def _between(number: np.ndarray, depth: DepthImage) -> Faces:
    """Triangles between neighbouring pixels: ``number`` (H, W) of each, -1 for none."""
    corners = [np.s_[:-1, :-1], np.s_[1:, :-1], np.s_[1:, 1:], np.s_[:-1, 1:]]
    faces = []
    for trio in ((0, 1, 2), (0, 2, 3)):
        numbers = np.stack([number[corners[k]] for k in trio], axis=-1)
        depths = np.stack([depth[corners[k]] for k in trio], axis=-1)
        faces.append(numbers[(numbers >= 0).all(axis=-1) & (np.ptp(depths, axis=-1) < MAX_JUMP)])
    return np.concatenate(faces)


def add_surface(
    scene: trimesh.Scene, name: str, points: Points, faces: Faces, *, flat: bool = False,
    at: tuple[Metres, Metres] = (0.0, 0.0), extras: Mapping[str, Any] | None = None,
) -> None:
    """Add a surface, z up, as the node ``name``, whose origin is ``at`` x and y; ``flat``: without
    smooth normals. ``extras`` of the node are of JSON's types."""
    mesh = trimesh.Trimesh(points @ _UP, faces, process=False)
    if flat:
        mesh.unmerge_vertices()
    else:
        mesh.vertex_normals = vertex_normals(mesh.vertices, mesh.faces)  # type: ignore[method-assign]
    mesh.visual = trimesh.visual.TextureVisuals(material=PBRMaterial(
        name=name, baseColorFactor=(*_COLOURS.get(name, _CLOTH), 255), metallicFactor=0.0,
        roughnessFactor=0.9, doubleSided=True))
    scene.add_geometry(
        mesh, node_name=name, geom_name=name, metadata=dict(extras or {}),
        transform=trimesh.transformations.translation_matrix(np.array([*at, 0.0]) @ _UP))
