"""In-plane laws: analytic tension and shear, directions, parameters."""

import numpy as np
import pytest
from test_energies import ORTHOTROPIC, crumpled_strip

from common.errors import InputError
from sim.cloth import Laws
from sim.draping import drape
from sim.energies.membrane import Corotational, OrthotropicStVK
from sim.material import Fabric
from sim.mesh import strip

MEMBRANES = (Corotational(), ORTHOTROPIC)


def stretched(membrane, warp: float, weft: float, shear: float = 0.0):
    """Energy per rest area (J/m²) of cloth stretched and sheared evenly."""
    mesh, _ = strip(length=0.03, width=0.02, edge=0.01, clamp=0.01, diagonals="random", seed=1)
    everywhere = np.ones(len(mesh.faces), dtype=bool)
    energy = membrane.energy(mesh, everywhere)
    F = np.array([[warp, shear], [0.0, weft], [0.0, 0.0]])
    return energy.value((mesh.rest @ F.T).ravel()) / mesh.areas.sum()


def pull(membrane, warp: float, weft: float, axis: int) -> float:
    """Force per rest width (N/m) along warp (0) or weft (1) at these stretches."""
    h = 1e-6
    step = (h, 0.0) if axis == 0 else (0.0, h)
    ahead = stretched(membrane, warp + step[0], weft + step[1])
    return (ahead - stretched(membrane, warp - step[0], weft - step[1])) / (2 * h)


def test_uniaxial_tension_has_the_youngs_modulus_and_poisson_ratio_of_each_direction():
    """Larionov et al., Eq. 6: with free sides S_uu = E_warp E_uu and E_vv = -n E_uu."""
    for axis, modulus, ratio in ((0, 400.0, 0.6), (1, 90.0, 0.6 * 90 / 400)):
        green = 0.03
        along, across = np.sqrt(1 + 2 * green), np.sqrt(1 - 2 * ratio * green)
        stretches = (along, across) if axis == 0 else (across, along)
        assert pull(ORTHOTROPIC, *stretches, 1 - axis) == pytest.approx(0.0, abs=1e-7)
        # Force per rest width is the first Piola-Kirchhoff stress, stretch times S.
        assert pull(ORTHOTROPIC, *stretches, axis) == pytest.approx(
            along * modulus * green, rel=1e-7
        )


def test_simple_shear_has_the_shear_modulus():
    gamma = 0.01
    normal = gamma**2 / 2  # E_vv of simple shear
    weft = 90 / (1 - 0.36 * 90 / 400)
    expected = 0.5 * 30 * gamma**2 + 0.5 * weft * normal**2
    assert stretched(ORTHOTROPIC, 1.0, 1.0, gamma) == pytest.approx(expected, rel=1e-10)


def test_small_strains_do_not_tell_isotropic_stvk_from_corotational():
    laws = Corotational(200.0, 0.3), OrthotropicStVK()
    for stretches in ((1.001, 1.0), (0.9995, 1.001), (1.0, 1.001)):
        one, other = (stretched(law, *stretches) for law in laws)
        assert one == pytest.approx(other, rel=3e-3)


def test_warp_and_weft_are_not_swapped_in_a_drape():
    """Cloth whose warp is soft in plane is strained along warp, on the rest axis of the mesh."""
    fabric = Fabric(np.full(3, 100e-6))
    for warp, weft in ((30.0, 400.0), (400.0, 30.0)):
        membrane = OrthotropicStVK(warp, weft, 0.0, 50.0)
        result = drape(fabric, edge=8e-3, seed=1, start="sine",
                       laws=Laws(membrane=membrane))
        assert result.converged, result.message
        ends = result.mesh.edges
        edges = result.rest[ends[:, 1]] - result.rest[ends[:, 0]]
        now = result.positions[ends[:, 1]] - result.positions[ends[:, 0]]
        lengths = np.linalg.norm(edges, axis=1)
        strain = np.linalg.norm(now, axis=1) / lengths - 1
        along_warp, along_weft = (
            np.sqrt((strain[np.abs(edges[:, axis]) > 0.95 * lengths] ** 2).mean())
            for axis in (0, 1)
        )
        assert (along_warp > 3 * along_weft) == (warp < weft)
        assert (along_weft > 3 * along_warp) == (weft < warp)


def test_stiffness_scales():
    mesh, active, q = crumpled_strip()
    for membrane in MEMBRANES:
        once, thrice = membrane.energy(mesh, active), membrane.scaled(3.0).energy(mesh, active)
        assert thrice.value(q) == pytest.approx(3 * once.value(q), rel=1e-9)


@pytest.mark.parametrize(("make", "word"), [
    (lambda: Corotational(-1.0), "stiffness"),
    (lambda: Corotational(200.0, 1.0), "poisson"),
    (lambda: OrthotropicStVK(shear=0.0), "shear"),
    (lambda: OrthotropicStVK(warp=100.0, weft=400.0, poisson=0.5), "poisson"),
])
def test_impossible_parameters_are_refused(make, word):
    with pytest.raises(InputError, match=word):
        make()
