"""Virtual pure-bending tester, as KES-FB2: a strip bent to cylinders of given curvatures."""

from collections.abc import Sequence

import numpy as np

from sim.energies.hysteresis import HystereticBending
from sim.laws import Law
from sim.material import Fabric
from sim.mesh import Mesh, strip

_LENGTH, _EDGE = 0.01, 5e-4  # m, of the bent square and of its cells
_STEP = 1e-3  # 1/m, of the differences of the energy


def pure_bending(
    fabric: Fabric, law: Law, curvatures: Sequence[float], *, angle: float = 0.0
) -> np.ndarray:
    """Torques per width (K,), N, of cloth bent to ``curvatures`` (K,), 1/m, one after the other.

    The torque is the derivative of the energy by the curvature, without stresses. Hysteresis
    follows every curvature in turn, so that they should be close to each other.

    Args:
        angle: from the warp to the direction that is bent, rad.
    """
    flat, _ = strip(length=_LENGTH, width=_LENGTH, edge=_EDGE, clamp=0.0)
    along, across = flat.rest.T
    cos, sin = np.cos(angle), np.sin(angle)
    mesh = Mesh(np.column_stack([cos * along - sin * across, sin * along + cos * across]),
                flat.faces)
    energy = law(mesh, np.ones(len(mesh.faces), dtype=bool), fabric=fabric)

    def bent(curvature: float) -> np.ndarray:
        """The cylinder's positions and edge normals."""
        turn = curvature * along
        middle = turn[mesh.edges].mean(axis=1)
        reach, drop = along * np.sinc(turn / np.pi), along * np.sinc(turn / 2 / np.pi) * np.sin(
            turn / 2)
        positions = np.column_stack([reach, across, -drop])
        normals = np.column_stack([np.sin(middle), np.zeros(len(middle)), np.cos(middle)])
        return np.concatenate([positions.ravel(), normals.ravel()])

    torques = []
    for curvature in curvatures:
        ends = [energy.value(bent(curvature + sign * _STEP)) for sign in (1, -1)]
        torques.append((ends[0] - ends[1]) / (2 * _STEP * mesh.areas.sum()))
        if isinstance(energy, HystereticBending):
            energy.origin = energy.origin_at(bent(curvature))
    return np.array(torques)
