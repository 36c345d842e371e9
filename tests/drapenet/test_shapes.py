"""The captured surface and the simulated drape in one file, in one place."""

import io

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from data.render.cameras import nominal_camera
from data.render.rays import DepthRenderer
from drapenet.report.drape import Resimulation, turned
from drapenet.report.shapes import drape_glb
from drapenet.views.located import LocatedViews
from sim.draping import drape
from sim.material import MICRO, Fabric
from sim.rig import Rig

RIG = Rig.from_name("square300_cylinder100")


def test_captured_surface_lies_on_the_drape_that_was_captured():
    fabric = Fabric(alpha=np.array([60, 40, 20]) * MICRO, beta=np.zeros(3))
    result = drape(fabric, edge=6e-3, seed=3)
    camera = nominal_camera(RIG)
    turns = np.radians([0.0, 70.0, 180.0, 250.0])
    renderer = DepthRenderer(result.positions, result.faces)
    views = renderer.views(camera, 0.4, turns)
    located = LocatedViews.registered(views, camera, RIG, turns)
    shown = Resimulation.beside(located, views, result, turned(result.positions, 0.4),
                                ("converged",))
    scene = trimesh.load(io.BytesIO(drape_glb(RIG, located, shown)), file_type="glb")
    simulated, captured = (scene.geometry[name] for name in ("simulated", "captured"))
    # glTF's y is up: right, up, towards the camera.
    lies = turned(result.positions, 0.4)[:, [0, 2, 1]] * [1, 1, -1]
    assert np.allclose(simulated.vertices, lies, atol=1e-6)
    dense = trimesh.Trimesh(lies, result.faces, process=False)
    points, _ = trimesh.sample.sample_surface(dense, 200_000, seed=1)
    apart, _ = cKDTree(points).query(captured.vertices)
    # The plate is located to 1 or 2 mm; turned the wrong way, points lie centimetres off.
    assert np.quantile(apart, 0.95) < 4e-3 and np.median(apart) < 1.5e-3
    hanging = lies[lies[:, 1] < -0.01]  # and the views go all around
    nearest, _ = cKDTree(captured.vertices).query(hanging)
    assert np.quantile(nearest, 0.8) < 8e-3
