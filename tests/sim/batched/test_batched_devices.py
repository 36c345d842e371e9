"""That everything stays on a GPU, on machines without one: tensors that have a device and no data.

PyTorch's fake tensors refuse operations between devices as real ones do. Nothing can be asked of
them that depends on data, so that the minimisation itself is left out.
"""

import numpy as np
import pytest
import torch
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.fx.experimental.symbolic_shapes import ShapeEnv

from sim.batched import potential as batched
from sim.batched.energies.fold_limit import BatchedFoldLimit
from sim.batched.equilibrium import Analysed
from sim.batched.hessians import CachedHessians
from sim.batched.potential import BatchedPotential
from sim.batched.solvers import FrontalSolver
from sim.drape import start_positions
from sim.equilibrium import cloth_terms
from sim.grid_unknowns import GridUnknowns
from sim.material import Fabric
from sim.scene import Rig, Scene, State
from sim.specimens import make_specimen

N = 12
GPU = torch.device("cuda", 0)


@pytest.fixture
def cloths():
    """Terms and meshes of two samples, and which vertices of their grid are free in either."""
    rig, terms, meshes, free = Rig(), [], [], np.zeros((N, N), dtype=bool)
    for seed, alpha in enumerate((20e-6, 60e-6)):
        specimen = make_specimen(rig, resolution=N, seed=seed)
        scene = Scene(mesh=specimen.mesh, held=specimen.held, obstacles=rig.obstacles)
        start = start_positions(specimen, rig, coarse=None, start="sine", seed=seed)
        terms.append(cloth_terms(scene, Fabric(np.full(3, alpha), np.full(3, -2e-3 * alpha)),
                                 State.at(specimen.mesh, start)))
        meshes.append(specimen.mesh)
        free |= ~specimen.held.reshape(N, N)
    return terms, meshes, free


@pytest.fixture
def fake(monkeypatch):
    """Tensors without data; what asks for data is left out."""
    monkeypatch.setattr(batched, "_require_places", lambda found: None)
    monkeypatch.setattr(BatchedFoldLimit, "hessian", lambda self, q, convexity: None)
    monkeypatch.setattr(CachedHessians, "__init__", _without_data)
    shapes = ShapeEnv(allow_scalar_outputs=True, allow_dynamic_output_shape_ops=True)
    with FakeTensorMode(allow_non_fake_inputs=True, shape_env=shapes):
        yield


def _without_data(self, potential, q):
    self._potential, self._q, self._data, self._known = potential, q, {}, {}
    self._wide = np.array([False, True])


@pytest.mark.usefixtures("fake")
def test_potential_and_solver_stay_on_the_gpu(cloths):
    terms, meshes, free = cloths
    # Not by analyse_grid, which would keep these for whoever has a GPU.
    analysed = Analysed(GridUnknowns((N, N), free), torch.device("cuda"))
    potential = BatchedPotential(terms, meshes, analysed.unknowns, analysed.device)
    y = potential.start([sample.template for sample in terms])
    gradient = potential.gradient(y)
    part = potential.take(torch.tensor([1], device=GPU))
    found = [y, gradient, potential.value(y), potential.allows(y, y), part.value(y[:1]),
             potential.residual(gradient), potential.step_length(y)]
    hessians = potential.hessians(y)
    both, exact = np.array([0, 1]), np.zeros(2)
    patterns = []
    for which, pattern, data in hessians.systems(both, exact, np.array([0.0, 0.5])):
        patterns.append(pattern)
        inside = hessians.into_frames(both[which], gradient[which])
        definite, move = FrontalSolver(analysed.analysis(pattern)).solve(data, inside)
        found += [data, definite, hessians.out_of_frames(both[which], move)]
    assert patterns == [analysed.unknowns.pattern, analysed.unknowns.wide_pattern]
    assert [tensor.device for tensor in found] == len(found) * [GPU]
