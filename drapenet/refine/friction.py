"""What friction within cloth would do to the fit of a captured shape.

Drapes are simulated without friction. Real cloth is held by it wherever the torque that is left
falls short of half its bending hysteresis; so a captured shape need not be an equilibrium.
"""

from collections.abc import Sequence
from dataclasses import replace

from drapenet.refine.captured import SETTLING, CapturedShape, Cloth
from drapenet.refine.shape_search import surface_springs
from sim.drape import DrapeResult
from sim.energies.bending_friction import BendingFriction
from sim.energies.midedge import MidEdgeBending
from sim.sensitivity import follow


def drapes_with_friction(
    shape: CapturedShape, cloth: Cloth, torques: Sequence[float]
) -> list[DrapeResult]:
    """``cloth`` held to a captured shape by its springs, and let go with friction.

    Args:
        torques: N·m per metre that friction holds, see :mod:`sim.energies.bending_friction`; it
            begins where the springs hold the cloth, which must have no natural curvature.

    Returns:
        The drape under the springs, then one for each of ``torques``; look at their ``status``.
    """
    start = shape.as_drape(cloth.fabric, cloth.warp)
    held = follow(start, cloth.fabric, laws=cloth.laws, extra=[surface_springs(start)],
                  options=SETTLING)
    scene = held.scene
    origin = MidEdgeBending(scene.mesh, scene.active, fabric=cloth.fabric).curvatures(held.state.q)
    return [held, *(
        follow(held, cloth.fabric, options=SETTLING,
               laws=replace(cloth.laws, bending=BendingFriction(torque, origin)))
        for torque in torques)]
