"""Drapes of any size are one family."""

from dataclasses import replace

import numpy as np
import pytest

from sim.cloth import Laws
from sim.energies.bending_variants import Hysteresis
from sim.energies.membrane import OrthotropicStVK
from sim.equilibrium import find_equilibrium
from sim.material import Fabric
from sim.rig import DISC_RIG, Rig
from sim.scene import Scene, make_specimen
from sim.solver.newton import NewtonOptions
from sim.start import initial_positions

FABRIC = Fabric(np.array([30e-6, 20e-6, 14e-6]), np.array([-66e-9, -40e-9, -21e-9]))
EXACT = NewtonOptions(residual=1e-9, step=1e-8)


def similar(fabric: Fabric, rig: Rig, laws: Laws, factor: float) -> tuple[Fabric, Rig, Laws]:
    """Fabric, rig and laws of the drape that is ``factor`` times as large at equal density.

    A drape in units of the specimen's size L depends on alpha/(rho g L³), beta/(alpha L), the
    plate's diameter over L, the in-plane stiffness over rho g L, the natural curvature times L and
    the hysteresis at equal curvature times L.
    """
    bending = laws.bending
    if isinstance(bending, Hysteresis):
        curvature = tuple(value / factor for value in bending.curvature)
        origin = None if bending.origin is None else bending.origin / factor
        bending = replace(bending, curvature=curvature, origin=origin, at=bending.at / factor)
    larger = replace(rig, sides=tuple(factor * side for side in rig.sides),
                     plate_diameter=factor * rig.plate_diameter)
    return (Fabric(factor**3 * fabric.alpha, factor**4 * fabric.beta, fabric.density), larger,
            replace(laws, bending=bending, membrane=laws.membrane.scaled(factor)))


@pytest.mark.parametrize(("rig", "factor"), [(Rig(), 0.5), (DISC_RIG, 1.3)])
def test_a_drape_of_another_size_is_the_scaled_drape(rig, factor):
    specimen = make_specimen(rig, edge=12e-3, topology=1)
    mesh, held, rest = specimen.mesh, specimen.held, specimen.mesh.rest
    rng = np.random.default_rng(0)
    scene = Scene(mesh, held, rig.obstacles)
    origin = rng.normal(0, 8, (scene.active.sum(), 3))
    laws = Laws(Hysteresis(0.2, curvature=(4.0, -3.0, 0.0), origin=origin),
                OrthotropicStVK(warp=400.0, weft=300.0, poisson=0.2, shear=60.0))
    start = initial_positions(rest, rig=rig, start="sine", rng=rng)
    start[held] = rig.place(rest[held])
    here = find_equilibrium(scene, FABRIC, scene.state(start), laws=laws, options=EXACT)
    fabric, larger, scaled = similar(FABRIC, rig, laws, factor)
    there = Scene(mesh.with_rest(factor * rest), held, larger.obstacles)
    near = here.state.positions + rng.normal(0, 1e-4, start.shape) * ~held[:, None]
    found = find_equilibrium(there, fabric, there.state(factor * near), laws=scaled,
                             options=EXACT)
    assert here.converged and found.converged
    gap = found.state.positions - factor * here.state.positions
    assert np.abs(gap).max() < 1e-6 * larger.specimen_size
    plain = replace(laws, bending=Hysteresis(0.2, origin=origin))
    uncurved = find_equilibrium(scene, FABRIC, here.state, laws=plain, options=EXACT)
    assert np.abs(uncurved.state.positions - here.state.positions).max() > 1e-3
