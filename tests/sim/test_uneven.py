"""Cloth that is not alike everywhere, and plates with rounded rims."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist, squareform

from common.errors import InputError
from sim.cloth import Laws
from sim.draping import drape
from sim.energies.bending_variants import Hysteresis
from sim.energies.membrane import OrthotropicStVK
from sim.energies.uneven import CREASE_WIDTH, HEM_WIDTH, TWIST, Crease, HemWeight, Uneven
from sim.equilibrium import find_equilibrium
from sim.material import Fabric
from sim.measures import drape_coefficient
from sim.mesh import strip
from sim.mesh.specimen import mesh_specimen
from sim.rig import DISC_RIG, GRAVITY, Rig
from sim.scene import Scene, make_specimen
from sim.solver.newton import NewtonOptions

FABRIC = Fabric([25e-6, 20e-6, 18e-6])


@pytest.fixture(scope="module")
def disc():
    """A mesh of a disc and its free triangles."""
    scene = make_specimen(DISC_RIG, edge=4e-3)
    return scene.mesh, scene.active


def test_random_curvature_has_its_deviation_and_its_correlation_length(disc):
    mesh, active = disc
    fields = np.array([Uneven(10.0, 0.03, seed).curvature_at(mesh, active) for seed in range(300)])
    assert fields.std(axis=(0, 1)) == pytest.approx(10.0 * np.array([1, 1, TWIST]), rel=0.05)
    assert np.abs(fields.mean(axis=(0, 1))).max() < 0.5
    distance = squareform(pdist(mesh.rest[mesh.faces[active]].mean(axis=1)))
    for share in (0.5, 1.0, 2.0):
        pairs = np.argwhere(np.abs(distance - share * 0.03) < 3e-4)[:400]
        products = (fields[:, pairs[:, 0], 0] * fields[:, pairs[:, 1], 0]).mean() / 100
        assert products == pytest.approx(np.exp(-share**2 / 2), abs=0.08)


def test_a_crease_turns_a_weightless_strip_by_its_curvature_times_its_width():
    mesh, held = strip(length=0.06, width=0.012, edge=0.004, clamp=0.006)
    scene = Scene(mesh=mesh, held=held, gravity=0.0)
    law = Hysteresis(uneven=Uneven(creases=(Crease(40.0, 0.0, 0.025),)))
    flat = scene.state(np.column_stack([mesh.rest, np.zeros(len(mesh.rest))]))
    found = find_equilibrium(scene, Fabric(np.full(3, 30e-6)), flat, laws=Laws(law),
                             options=NewtonOptions(residual=1e-4, step=1e-6))
    assert found.converged
    by_end = np.argsort(mesh.rest[:, 0])
    near, tip = (found.positions[np.isclose(mesh.rest[:, 0], x, atol=2e-3)].mean(axis=0)
                 for x in (0.045, mesh.rest[by_end[-1], 0]))
    slope = np.arctan2(-(tip - near)[2], (tip - near)[0])
    assert slope == pytest.approx(40.0 * CREASE_WIDTH, rel=0.03)


@pytest.mark.parametrize("edge", [3e-3, 5e-3])
def test_bands_are_averaged_over_triangles(edge):
    """Their areas do not depend on the mesh, which is coarser than they are."""
    scene = make_specimen(DISC_RIG, edge=edge)
    mesh, active = scene.mesh, scene.active
    areas, width = mesh.areas[active], 5e-3
    added = (Uneven(hem_layers=width).layers_at(mesh, active) - 1) @ areas
    assert added == pytest.approx(2 * np.pi * (0.15 - width / 2) * width, rel=0.04)
    weight = HemWeight(width)(mesh, active, fabric=FABRIC).weights.sum()
    assert weight == pytest.approx(FABRIC.density * GRAVITY * added, rel=1e-9)
    curl = Uneven(hem_curl=50.0).curvature_at(mesh, active)
    both = curl[:, :2].sum(axis=1) @ areas  # across and along the hem
    assert both == pytest.approx(50.0 * 2 * np.pi * (0.15 - HEM_WIDTH / 2) * HEM_WIDTH, rel=0.04)


def coefficients(edge: float, rim: float, **laws: object) -> np.ndarray:
    """Drape coefficients of four drapes of 300 mm on a plate of 180 mm."""
    rig = Rig((0.3, 0.3), 0.18, "disc", rim=rim)
    law = Laws(Hysteresis(0.15, **laws), OrthotropicStVK(warp=1500, weft=1200, shear=100))
    shapes = [drape(FABRIC, rig=rig, edge=edge, seed=seed, laws=law) for seed in range(4)]
    assert all(shape.converged for shape in shapes)
    return np.array([drape_coefficient(shape.positions, shape.faces, rig) for shape in shapes])


@pytest.mark.slow
def test_a_mesh_need_not_resolve_a_rounded_rim():
    """Edges of 4 mm on a rim of 4 mm, against edges of 2 mm."""
    coarse, fine = (coefficients(edge, 4e-3) for edge in (4e-3, 2e-3))
    assert coarse.mean() == pytest.approx(fine.mean(), abs=0.01)
    assert coefficients(4e-3, 0.0).mean() - coarse.mean() > 0.03


@pytest.mark.slow
def test_a_mesh_need_not_resolve_uneven_cloth():
    uneven = Uneven(14.0, 0.012, 5)
    coarse, fine = (coefficients(edge, 0.0, uneven=uneven) for edge in (4e-3, 2e-3))
    assert coarse.mean() == pytest.approx(fine.mean(), abs=0.01)


def test_a_rounded_plate_holds_the_cloth_on_its_flat_top():
    rig = Rig((0.3, 0.3), 0.18, "disc", rim=5e-3)
    assert Rig.from_name(rig.name) == rig and rig.name == "disc300_support180_rim5"
    mesh, held = mesh_specimen(rig, edge=5e-3)
    assert np.linalg.norm(mesh.rest[held], axis=1).max() == pytest.approx(0.085, rel=2e-3)
    obstacle, = rig.obstacles
    assert obstacle.radius == 0.09 and obstacle.rim == 5e-3
    # At 45° over the rim, 1 mm deep.
    point = np.array([[0.085 + 4e-3 / np.sqrt(2), 0.0, -5e-3 + 4e-3 / np.sqrt(2)]])
    assert obstacle.depths(point) == pytest.approx([1e-3])
    with pytest.raises(InputError, match="a rim rounded by 40 mm on a plate of 180 mm"):
        Rig((0.3, 0.3), 0.18, "disc", rim=0.04)
