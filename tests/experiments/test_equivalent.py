"""Equivalent hinge moduli: a strip given one hangs as the physical strip does."""

import numpy as np
import pytest

from common.errors import InputError
from experiments.physics.elastica import free_end
from experiments.physics.hinges import equivalent_ratio
from sim.cantilever import aspect_ratio, elastica, fabric_of_gamma
from sim.cantilever.strip import TIGHT
from sim.cloth import Laws
from sim.equilibrium import find_equilibrium
from sim.material import Fabric
from sim.mesh import strip
from sim.scene import Scene
from sim.solver.state import State

EDGE = 7.5e-3


def coarse_strip(diagonals: str = "alternating"):
    return strip(length=0.09, width=0.03, edge=EDGE, clamp=2 * EDGE, diagonals=diagonals)


def test_a_strip_with_the_equivalent_modulus_hangs_as_the_elastica():
    mesh, held = coarse_strip()
    equivalent = equivalent_ratio(mesh, held, gamma=10)
    assert equivalent > 1.1  # plain hinges are far too soft on this mesh
    physical = fabric_of_gamma(10, 0.09)
    flat = State.at(mesh, np.column_stack([mesh.rest, np.zeros(len(mesh.rest))]))
    laws = Laws(bending="hinge_linear")
    off = {}
    for ratio in (1.0, equivalent):
        fabric = Fabric(ratio * physical.alpha, density=physical.density)
        found_here = find_equilibrium(Scene(mesh=mesh, held=held), fabric, flat, laws=laws,
                                      options=TIGHT)
        hung = aspect_ratio(free_end(mesh, found_here.state))
        off[ratio] = hung / aspect_ratio(elastica(10)[-1]) - 1
    assert off[1.0] > 0.1
    assert abs(off[equivalent]) < 1e-4


def test_the_modulus_depends_on_the_triangulation_but_not_for_the_default_law():
    ratios = {d: equivalent_ratio(*coarse_strip(d), gamma=1)
              for d in ("alternating", "random")}
    assert ratios["alternating"] - ratios["random"] > 0.05
    for diagonals in ("alternating", "random"):
        default = equivalent_ratio(*coarse_strip(diagonals), gamma=1,
                                   laws=Laws(bending="midedge"))
        assert default == pytest.approx(1.0, abs=0.015)


def test_failure_and_nonsense_are_refused():
    mesh, held = strip(length=0.09, width=0.03, edge=0.015, clamp=0.03)
    folded = strip(length=0.09, width=0.03, edge=0.01, clamp=0.03, diagonals="equal")
    for where, settings, complaint in (
            ((mesh, held), {"gamma": 1, "tolerance": 0.0}, "no match"),
            (folded, {"gamma": 2000}, "."), ((mesh, held), {"gamma": -1}, "gamma"),
            ((type(mesh)(mesh.rest - [1.0, 0.0], mesh.faces), held), {}, "free length")):
        with pytest.raises(InputError, match=complaint):
            equivalent_ratio(*where, **settings)
