"""Quasi-static cloth simulation of the drape test: physics only, no images, no networks.

    from sim import MICRO, Fabric, drape, drape_coefficient
    cloth = drape(Fabric(alpha=[48 * MICRO, 30 * MICRO, 22 * MICRO]), edge=4e-3)
    print(cloth, drape_coefficient(cloth.positions, cloth.faces, cloth.rig))

A :class:`Fabric` is draped on a tester, a :class:`Rig`, with the :class:`Laws` of its bending and
stretch; :func:`drape_many` makes many drapes on all cores. :mod:`sim.energies` has what a new law
needs, :mod:`sim.sensitivity` differentiates an equilibrium, :mod:`sim.cantilever` hangs strips.
"""

from typing import TYPE_CHECKING

from common.late import late

if TYPE_CHECKING:
    from common.errors import InputError
    from sim.cloth import BENDING, Laws
    from sim.draping import Drape, drape, follow
    from sim.many import drape_many
    from sim.material import DIRECTIONS, MICRO, NANO, Fabric, gravity_length, torque
    from sim.measures import drape_coefficient, fold_count, fold_outline
    from sim.rig import DISC_RIG, SQUARE_RIG, Rig
    from sim.solver import NewtonOptions, Status

__all__ = [
    "BENDING",
    "DIRECTIONS",
    "DISC_RIG",
    "MICRO",
    "NANO",
    "SQUARE_RIG",
    "Drape",
    "Fabric",
    "InputError",
    "Laws",
    "NewtonOptions",
    "Rig",
    "Status",
    "drape",
    "drape_coefficient",
    "drape_many",
    "fold_count",
    "fold_outline",
    "follow",
    "gravity_length",
    "torque",
]

# Loaded when they are used: who needs a rig or a unit does not wait for compiled energies.
__getattr__, __dir__ = late(__name__, {
    "common.errors": ("InputError",), "sim.cloth": ("BENDING", "Laws"),
    "sim.draping": ("Drape", "drape", "follow"), "sim.many": ("drape_many",),
    "sim.material": ("DIRECTIONS", "MICRO", "NANO", "Fabric", "gravity_length", "torque"),
    "sim.measures": ("drape_coefficient", "fold_count", "fold_outline"),
    "sim.rig": ("DISC_RIG", "SQUARE_RIG", "Rig"), "sim.solver": ("NewtonOptions", "Status")})
