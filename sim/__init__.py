"""Quasi-static cloth simulation of the drape test: physics only, no images, no networks.

    from sim.drape import drape
    from sim.material import MICRO, Fabric
    from sim.measures import drape_coefficient
    cloth = drape(Fabric(alpha=[48 * MICRO, 30 * MICRO, 22 * MICRO]), edge=4e-3)
    print(cloth.converged, drape_coefficient(cloth.positions, cloth.faces, cloth.rig))

A fabric is a :class:`sim.material.Fabric`, a tester a :class:`sim.rig.Rig`, the laws of bending and
stretch a :class:`sim.cloth.Laws`; ``sim.drape_many`` makes many drapes on all cores
(:mod:`sim.many`), :mod:`sim.sensitivity` differentiates an equilibrium and
:mod:`sim.cantilever` hangs strips.
"""

__all__ = ["cantilever", "cloth", "drape", "many", "material", "measures", "rig", "sensitivity"]


def __getattr__(name: str) -> object:
    if name != "drape_many":
        raise AttributeError(f"module 'sim' has no attribute '{name}'")
    from sim.many import drape_many  # on use: it loads the simulator

    return drape_many
