"""The check of an energy's derivatives finds errors, and accepts the simulator's own energies."""

from functools import partial

import numpy as np
import pytest
from test_energies import crumpled_strip

from common.errors import InputError
from sim.cloth import Laws
from sim.draping import drape
from sim.energies.base import Energy, check
from sim.material import Fabric
from sim.solver.newton import NewtonOptions

MESH, ACTIVE, BENT = crumpled_strip(amplitude=1e-4, turn=0.1)
FABRIC = Fabric([60e-6, 30e-6, 40e-6], [-90e-9, -40e-9, -60e-9])


class Quartic(Energy):
    """k z⁴ of every vertex, J, with factors on its derivatives."""

    def __init__(self, mesh, active, *, fabric, slope=1.0, bend=1.0, convexity=1.0):
        self.dofs = 3 * np.arange(len(mesh.rest))[:, None] + 2
        self.slope, self.bend, self.convexity = slope, bend, convexity

    def value(self, q):
        return 1e3 * float((q[self.dofs] ** 4).sum())

    def gradient(self, q):
        return self.slope * 4e3 * q[self.dofs] ** 3

    def hessian(self, q, convex=False):
        return (self.convexity if convex else self.bend) * 12e3 * q[self.dofs][:, :, None] ** 2


class Aimless(Quartic):
    def __init__(self, mesh, active, *, fabric):
        pass


def test_right_derivatives_pass():
    check(Quartic(MESH, ACTIVE, fabric=FABRIC), BENT, MESH.edges)


@pytest.mark.parametrize(("factors", "complaint"), [
    ({"slope": -1.0}, "Quartic.gradient is not the derivative of the value"),
    ({"slope": 1.001}, "Quartic.gradient is not"), ({"bend": -1.0}, "Quartic.hessian is not"),
    ({"convexity": -1.0}, "negative eigenvalue"),
])
def test_wrong_derivatives_are_named(factors, complaint):
    with pytest.raises(InputError, match=complaint):
        check(Quartic(MESH, ACTIVE, fabric=FABRIC, **factors), BENT, MESH.edges)


def test_a_gradient_of_another_shape_is_named():
    class Short(Quartic):
        def gradient(self, q):
            return super().gradient(q)[:-1]

    with pytest.raises(InputError, match=r"Short.gradient has the shape \(\d+, 1\)"):
        check(Short(MESH, ACTIVE, fabric=FABRIC), BENT, MESH.edges)


def test_an_energy_without_dofs_is_named_by_a_drape_and_by_the_check():
    for failing in (lambda: drape(FABRIC, edge=0.02, laws=Laws(others=(Aimless,))),
                    lambda: check(Aimless(MESH, ACTIVE, fabric=FABRIC), BENT, MESH.edges)):
        with pytest.raises(InputError, match=r"Aimless\.dofs must be an array"):
            failing()


def test_a_drape_that_fails_by_a_wrong_derivative_points_to_the_check():
    law = partial(Quartic, slope=-1.0)
    result = drape(FABRIC, edge=0.02, laws=Laws(others=(law,)),
                   options=NewtonOptions(max_iterations=10))
    assert not result.converged and "sim.energies.base" in result.message
