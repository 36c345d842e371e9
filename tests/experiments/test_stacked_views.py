"""Stacked views under rotation and reflection of specimens, and downsampling."""

from itertools import product

import numpy as np
import torch
from cloths import skirt

from data.render.cameras import nominal_camera
from data.render.rays import DepthRenderer
from drapenet.network.targets import Symmetry
from experiments.papers import stacked_views
from sim.material import Fabric
from sim.mesh.specimen import make_specimen
from sim.rig import Rig


def test_symmetries_of_views_are_those_of_the_specimen():
    specimen = make_specimen(Rig(), edge=0.015).mesh
    cloth = skirt(Fabric(np.full(3, 20e-6)), rig=Rig(), edge=0.015, start="", seed=0,
                  offset=(0.0, 0.0), laws=None)
    camera = nominal_camera()
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])

    def views(positions: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(DepthRenderer(positions, specimen.faces).views(camera, 0.3))

    for quarters, mirror in product(range(4), (False, True)):
        symmetry = Symmetry(torch.tensor([32 * quarters]), torch.tensor([mirror]))
        found, = stacked_views.apply_symmetry(views(cloth.positions)[None], symmetry)
        spun = np.linalg.matrix_power(turn, quarters)
        first = np.array([[np.cos(0.3), -np.sin(0.3), 0], [np.sin(0.3), np.cos(0.3), 0], [0, 0, 1]])
        shown = cloth.positions @ first.T * ([-1, 1, 1] if mirror else 1) @ spun.T @ first
        assert torch.isclose(found, views(shown), atol=1e-3).float().mean() > 0.99


def test_downsampled_views_are_means_over_cloth_pixels():
    views = np.zeros((1, 6, 6), np.float32)
    views[0, :3, :3], views[0, 0, 0] = 0.65, 0.0
    views[0, 3, 3:] = 0.6
    downsampled = stacked_views.downsample(views)
    np.testing.assert_allclose(downsampled, [[[1.0, 2.0], [2.0, 2.0]]], atol=1e-3)
