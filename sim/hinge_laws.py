"""The hinge bending laws by name: which energy, and which modulus each hinge gets.

A modulus depends on the direction in which cloth bends, that of greatest curvature, in material
axes, phi from warp. It is kept as the double-angle vector s (cos 2 phi, sin 2 phi), because angles
do not average: adding such vectors adds the tensors of rank one that they stand for. The length s,
from 0 to 1, is how far the cloth bends in one direction at all: 1 on a cylinder, 0 where it is flat
or where its two principal curvatures have the same size.
"""

from dataclasses import dataclass, field

import numpy as np

from common.errors import InputError
from sim.energies.base import Energy
from sim.energies.hinges import (
    DihedralBending,
    HingeStencils,
    QuadraticBending,
    find_hinges,
    hinge_angles,
)
from sim.material import BIAS, WARP, WEFT, Fabric
from sim.mesh import Mesh

FORMS = ("hinge", "hinge_linear", "quadratic")
DIRECTIONS = ("mean", "edge", "curvature")
SMOOTHING_ROUNDS = 2
"""Rounds of averaging over neighbours that the vertices' shape operators get. Without them the
lagged iteration of :mod:`sim.lagged` ends in a cycle."""


@dataclass(frozen=True)
class HingeLaw:
    """A hinge law: the form of its energy and how the fabric's direction enters.

    Attributes:
        form: ``hinge`` (torque alpha kappa + beta kappa²), ``hinge_linear`` (beta left out) or
            ``quadratic`` (gamma = alpha/3, beta left out).
        direction: ``mean``: every hinge has the mean modulus over all directions; ``edge``: the
            modulus across its rest edge (Wang et al. 2011); ``curvature``: the modulus along
            ``axes``.
        axes: (N, 2) directions of bending of the hinges of
            :func:`sim.energies.hinges.find_hinges`; for ``curvature`` only.
            :func:`sim.equilibrium.find_equilibrium` finds them.

    Raises:
        InputError: unknown form or direction.
    """

    form: str = "hinge"
    direction: str = "mean"
    axes: np.ndarray | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        if self.form not in FORMS:
            raise InputError(f"unknown hinge law '{self.form}'; choose from {', '.join(FORMS)}")
        if self.direction not in DIRECTIONS:
            raise InputError(
                f"unknown direction '{self.direction}'; choose from {', '.join(DIRECTIONS)}"
            )

    @property
    def lagged(self) -> bool:
        """Whether the directions of bending must come from a previous solution."""
        return self.direction == "curvature"

    def __call__(self, mesh: Mesh, active: np.ndarray, *, fabric: Fabric) -> Energy:
        """The energy of the hinges beside the triangles ``active`` (F,) bool of ``mesh``.

        Raises:
            InputError: the law follows the curvature and has no ``axes`` for these hinges.
        """
        hinges = find_hinges(mesh, active)
        if self.direction == "edge":
            axes = edge_directions(hinges)
        elif self.direction == "mean":
            axes = np.zeros((len(hinges.edge), 2))
        elif self.axes is None or len(self.axes) != len(hinges.edge):
            raise InputError(
                f"the law '{self.form}_curvature' needs the cloth's directions of bending; "
                "find equilibria with sim.equilibrium.find_equilibrium"
            )
        else:
            axes = self.axes
        alpha = modulus_of_bending(fabric.alpha, axes)
        if self.form == "quadratic":
            return QuadraticBending(hinges, gamma=alpha / 3)
        beta = modulus_of_bending(fabric.beta, axes) * (self.form == "hinge")
        return DihedralBending(hinges, alpha=alpha, beta=beta, stiffness=fabric.alpha.min())


HINGE_LAWS = {
    form if direction == "mean" else f"{form}_{direction}": HingeLaw(form, direction)
    for form in FORMS
    for direction in DIRECTIONS
}
"""hinge, hinge_edge, hinge_curvature, hinge_linear, ..., quadratic_curvature."""


def modulus_along(moduli: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Moduli in directions ``angle`` (rad from warp, any shape) of (warp, bias, weft) (3,).

    Feng et al. 2022, Eq. 7 and 8: between two neighbouring sample directions the moduli follow
    cos², sin²; warp and weft are axes of symmetry. With c = cos 2 phi this is

        k = k_bias + max(c, 0) (k_warp - k_bias) + max(-c, 0) (k_weft - k_bias),

    a mean of the three with non-negative weights, so that it never changes sign.
    """
    warp, bias, weft = moduli[WARP], moduli[BIAS], moduli[WEFT]
    c = np.cos(2 * np.asarray(angle, float))
    return bias + np.maximum(c, 0) * (warp - bias) + np.maximum(-c, 0) * (weft - bias)


def mean_modulus(moduli: np.ndarray) -> float:
    """Mean of :func:`modulus_along` over all directions: (1 - 2/pi) bias + (warp + weft)/pi."""
    return float((1 - 2 / np.pi) * moduli[BIAS] + (moduli[WARP] + moduli[WEFT]) / np.pi)


def modulus_of_bending(moduli: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(N,) moduli for bending in ``directions`` (N, 2) of (warp, bias, weft) (3,).

    (1 - s) mean + s k(phi): :func:`modulus_along` as far as there is one direction. Section 4.4
    takes k(phi) alone, which jumps where the two principal curvatures change places; the iteration
    of :mod:`sim.lagged` then ends in a cycle for strongly anisotropic fabrics.
    """
    share = np.linalg.norm(directions, axis=1)
    angle = np.arctan2(directions[:, 1], directions[:, 0]) / 2
    return (1 - share) * mean_modulus(moduli) + share * modulus_along(moduli, angle)


def edge_directions(hinges: HingeStencils) -> np.ndarray:
    """(N, 2) directions across the hinges' rest edges."""
    nx, ny = hinges.normals.T
    return np.stack([nx * nx - ny * ny, 2 * nx * ny], axis=1)


def shape_operators(mesh: Mesh, active: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """(V, 3) curvatures (Sxx, Syy, Sxy), 1/m, of vertices at positions (V, 3), m.

    S = 1/A sum 1/2 theta e n n^T over the hinges at a vertex, with the dihedral angle theta, the
    rest edge's length e and normal n, and A the vertex's share of the rest area. Hinges that are
    beside no ``active`` (F,) triangle count as flat.
    """
    hinges = find_hinges(mesh, active)
    bend = 0.5 * hinge_angles(positions.ravel(), hinges.dofs) * hinges.lengths
    nx, ny = hinges.normals.T
    per_hinge = bend[:, None] * np.stack([nx * nx, ny * ny, nx * ny], axis=1)
    total = np.zeros((len(mesh.rest), 3))
    for end in range(2):
        np.add.at(total, hinges.corners[:, end], per_hinge)
    return total / mesh.vertex_areas[:, None]


def smoothed(mesh: Mesh, values: np.ndarray, rounds: int = SMOOTHING_ROUNDS) -> np.ndarray:
    """Values (V, K) averaged with those of the neighbours, ``rounds`` times."""
    for _ in range(rounds):
        total, count = values.copy(), np.ones(len(values))
        for a, b in (mesh.edges.T, mesh.edges.T[::-1]):
            np.add.at(total, a, values[b])
            np.add.at(count, a, 1)
        values = total / count[:, None]
    return values


def hinge_directions(mesh: Mesh, active: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Directions (N, 2) in which the hinges of :func:`find_hinges` bend.

    The mean of those at the edge's two ends (section 4.4), from smoothed shape operators S. A
    vertex contributes the deviator of S², whose first axis is the direction of greater |curvature|
    and whose size is the difference of the squared principal curvatures; the sum is divided by
    that of |S|², so that flat vertices, whose direction is noise, have no say.
    Arguments as for :func:`shape_operators`.
    """
    sxx, syy, sxy = smoothed(mesh, shape_operators(mesh, active, positions)).T
    # dev(S²) = tr(S) dev(S), and (Sxx - Syy, 2 Sxy) is the double-angle vector of S
    vectors = np.stack([sxx - syy, 2 * sxy], axis=1) * (sxx + syy)[:, None]
    sizes = sxx**2 + syy**2 + 2 * sxy**2
    ends = find_hinges(mesh, active).corners[:, :2]
    total, size = vectors[ends].sum(axis=1), sizes[ends].sum(axis=1)[:, None]
    return np.divide(total, size, out=np.zeros_like(total), where=size > 0)
