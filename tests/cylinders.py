"""Strips that bend as cylinders, like infinitely wide ones: by constraints, and what theory says.

A strip cut at an angle to the yarns twists when it bends, and one with a Poisson effect curves
across. Constrained to a cylinder it has the torque of the law in its direction. Strips are grids
whose columns of ``across`` + 1 vertices are numbered consecutively.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from common.errors import InputError
from sim.cloth import Laws
from sim.energies import bending_law
from sim.energies.base import Energy
from sim.material import Fabric
from sim.mesh import Mesh

_SMALL = 0.01  # reduced curvature below the softening limit of every term of the law
TIE_STIFFNESS = 100.0
"""Stiffness of the ties in units of alpha/edge²; the rulings are level within 1e-4."""


def guided(laws: Laws, across: int) -> Laws:
    """Add the constraint to a cylinder to ``laws``, for a strip with ``across`` mesh cells."""
    ties = (partial(TiedRows, across=across), partial(LevelSides, across=across))
    return replace(laws, others=(*laws.others, *ties))


class TiedRows(Energy):
    """Penalty on differences in x and z between neighbours across a strip."""

    def __init__(self, mesh: Mesh, active: np.ndarray, *, fabric: Fabric, across: int) -> None:
        grid = np.arange(len(mesh.rest)).reshape(-1, across + 1)
        edge = float(np.linalg.norm(mesh.rest[across + 1] - mesh.rest[0]))
        neighbours = np.stack([grid[:, :-1], grid[:, 1:]], axis=-1).reshape(-1, 2)
        self.dofs = np.concatenate([3 * neighbours, 3 * neighbours + 2])
        self._stiffness = TIE_STIFFNESS * float(fabric.alpha.max()) / edge**2  # N/m of each tie

    def value(self, q: np.ndarray) -> float:
        return 0.5 * self._stiffness * float((self._differences(q) ** 2).sum())

    def gradient(self, q: np.ndarray) -> np.ndarray:
        return self._stiffness * self._differences(q)[:, None] * [1.0, -1.0]

    def hessian(self, q: np.ndarray, convex: bool = False) -> np.ndarray:
        block = self._stiffness * np.array([[1.0, -1.0], [-1.0, 1.0]])
        return np.broadcast_to(block, (len(self.dofs), 2, 2))

    def _differences(self, q: np.ndarray) -> np.ndarray:
        return q[self.dofs[:, 0]] - q[self.dofs[:, 1]]


class LevelSides(Energy):
    """Penalty on the component across the strip, y, of the normals at its sides.

    The Hessian omits the terms proportional to this component.
    """

    def __init__(self, mesh: Mesh, active: np.ndarray, *, fabric: Fabric, across: int) -> None:
        row = mesh.edges % (across + 1)
        sides = np.flatnonzero((mesh.edge_faces[:, 1] < 0) & (row[:, 0] == row[:, 1]))
        ends = (3 * mesh.edges[sides][:, :, None] + np.arange(3)).reshape(-1, 6)
        coordinates = 3 * len(mesh.rest)
        self.dofs = np.concatenate([ends, coordinates + sides[:, None]], axis=1)
        self._normals = coordinates + 3 * sides[:, None] + np.arange(3)
        self._stiffness = TIE_STIFFNESS * float(fabric.alpha.max())  # N·m per side edge

    def value(self, q: np.ndarray) -> float:
        return 0.5 * self._stiffness * float((q[self._normals[:, 1]] ** 2).sum())

    def gradient(self, q: np.ndarray) -> np.ndarray:
        return self._stiffness * q[self._normals[:, 1]][:, None] * self._rows(q)

    def hessian(self, q: np.ndarray, convex: bool = False) -> np.ndarray:
        rows = self._rows(q)
        return self._stiffness * rows[:, :, None] * rows[:, None, :]

    def _rows(self, q: np.ndarray) -> np.ndarray:
        """Derivatives (N, 7) of the normals' components by both end points and the rotation."""
        normal, edge = q[self._normals], q[self.dofs[:, 3:6]] - q[self.dofs[:, :3]]
        length = np.linalg.norm(edge, axis=1, keepdims=True)
        along = edge / length
        tilt = along[:, 1:2] * normal / length
        turn = along[:, 2] * normal[:, 0] - along[:, 0] * normal[:, 2]
        return np.concatenate([tilt, -tilt, turn[:, None]], axis=1)


def tabulated_law(curvature: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Linear pieces (4, K - 1) through curvatures (K,) from 0, 1/m, and torques (K,), N."""
    rise = np.diff(torque)
    if not (rise > 0).all():
        raise InputError("the torque must increase with the curvature")
    return np.stack([curvature[:-1], torque[:-1], rise / np.diff(curvature), np.zeros_like(rise)])


def cylinder_torque(fabric: Fabric, angle: float, curvature: np.ndarray) -> np.ndarray:
    """Torque (K,), N, per width of cylinders of ``curvature`` (K,), 1/m, at ``angle``, rad.

    The derivative of the plate's energy (:mod:`sim.energies.bending_law`) with respect to kappa.
    """
    law = bending_law.constants(fabric)
    cos, sin = np.cos(angle), np.sin(angle)
    direction = np.array([cos**2, sin**2, cos * sin])
    bent = curvature[:, None] * direction
    return bending_law.respond(bent, np.zeros_like(bent), law, bending_law.PLAIN)[1] @ direction


def cylinder_moduli(fabric: Fabric, angle: float) -> tuple[float, float]:
    """k(phi): alpha, N·m, and beta, N·m², of a cylinder bent along ``angle`` (rad from warp).

    Its torque is alpha kappa + beta kappa² up to the softening limit in warp, bias and weft, and
    in other directions as long as no term of the law has reached its limit.
    """
    kappa = _SMALL / max(np.abs(fabric.beta / fabric.alpha).max(), 1e-6)
    once, twice = cylinder_torque(fabric, angle, np.array([kappa, 2 * kappa]))
    return float((4 * once - twice) / (2 * kappa)), float((twice - 2 * once) / (2 * kappa**2))


def free_modulus(fabric: Fabric, angle: float, skew: float = 0.0) -> float:
    """Linear modulus, N·m, of a narrow free strip along ``angle``, rad, for small deflections.

    1/(m D^-1 m) with the plate's stiffness D (3, 3) for (Sxx, Syy, Sxy) and the components m of a
    unit moment along the strip: the other two moments are zero.
    """
    stiffness = bending_law.form(bending_law.constants(fabric, skew))
    cos, sin = np.cos(angle), np.sin(angle)
    moments = np.array([cos**2, sin**2, 2 * cos * sin])
    return float(1 / (moments @ np.linalg.solve(stiffness, moments)))
