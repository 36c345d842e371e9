"""Cramér-Rao bound of a fabric's moduli estimated from depth views or an outline of its drape.

A depth, or a radius of an outline, has the standard deviation s, and one pixel in m is an
independent measurement. With the Jacobian J of depths or radii with respect to the parameters, the
Fisher information is JᵀJ/(s² m), and no unbiased estimate has a smaller covariance than its
inverse. Other unknowns than the moduli (nuisances of the specimen, its rotation and offset on the
plate, the camera pose) have separate columns in J. A prior with the covariance C adds C⁻¹ to the
information. The inverse of the sum is the posterior bound: in linear approximation, the covariance
of the best estimate that uses the prior. Silhouettes in depth views are omitted, because they have
few pixels.

The bound assumes that the fold configuration of the drape and the bending law are known.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from common.types import Metres, Radians
from data.fabrics.fabrics import THETA_NAMES
from data.fabrics.nuisances import NAMES, Nuisances
from data.render.cameras import QUARTERS, Camera
from data.render.rays import DepthRenderer
from drapenet.refine.depth import FOCAL, POSE, DepthViews, DepthWeights, table_names
from drapenet.refine.unknowns import LAW_NAMES, law_moves
from drapenet.views.directions import AZIMUTH, AZIMUTHS
from drapenet.views.located import LocatedViews
from drapenet.views.outline import contour, silhouettes
from sim.draping import Drape
from sim.rig import Rig
from sim.sensitivity import Tangent
from sim.sensitivity.forward import tangent_sensitivities
from sim.sensitivity.rest_shape import (
    difference_step,
    forces_in,
    moves_with_offset,
    moves_with_rest,
    share_of_border,
)

SPECIMEN = ("turn", "offset_warp", "offset_weft")
"""Placement of the specimen: rotation about the vertical, rad, and offset from the axis, m."""
CAMERA = tuple(name for name in POSE if name != "turn")
"""Camera pose: rad and m."""
SETUP = (*table_names(len(QUARTERS)), FOCAL)
"""Errors of the turns of the table, rad, and logarithm of the focal length."""
PICTURE = ("picture_x", "picture_y", "picture_scale")
"""Errors of an outline's centre, m, and of its scale."""
_RADIUS_STEP = 2e-4  # m, largest move of a vertex for the difference of two outlines


@dataclass(frozen=True)
class Information:
    """Fisher information (P, P) of a capture about theta and other unknowns, in SI units or
    logarithms; NaN if the drape has no derivatives."""

    names: tuple[str, ...]
    fisher: np.ndarray
    pixels: int
    ok: bool
    message: str

    @classmethod
    def missing(cls, names: tuple[str, ...], message: str) -> "Information":
        """That of a drape without derivatives."""
        return cls(names, np.full((len(names), len(names)), np.nan), 0, False, message)

    def covariance(self, unknown: Iterable[str] = SPECIMEN) -> np.ndarray:
        """Smallest covariance (6, 6) of theta; ``unknown`` parameters are free, others known."""
        return joint_covariance([self], np.zeros((6, 6)), separate=dict.fromkeys(unknown, np.inf))

    def posterior(self, prior: np.ndarray, unknown: Mapping[str, float]) -> np.ndarray:
        """Smallest covariance (6, 6) of theta for an estimate that uses priors.

        Args:
            prior: (6, 6) covariance of theta over fabrics.
            unknown: prior standard deviations of the unknown parameters; infinity for none.
        """
        return joint_covariance([self], np.linalg.inv(prior), separate=unknown)


def joint_covariance(
    captures: Sequence[Information], precision: np.ndarray, *, separate: Mapping[str, float],
    shared: Mapping[str, float] | None = None,
) -> np.ndarray:
    """Smallest covariance (6 + S, 6 + S) of theta and of S parameters shared by all captures.

    NaN if a drape has no derivatives.

    Args:
        precision: (6, 6) of the prior of theta.
        separate, shared: prior standard deviations of the parameters that differ between captures,
            and of those that do not; infinity for none.
    """
    shared = shared or {}
    total = np.zeros((6 + len(shared),) * 2)
    total[:6, :6] = precision
    total[6:, 6:] = np.diag([deviation**-2.0 for deviation in shared.values()])
    for one in captures:
        kept, marginal = ([one.names.index(name) for name in names]
                          for names in ((*THETA_NAMES, *shared), separate))
        if not np.isfinite(one.fisher).all():
            return np.full(total.shape, np.nan)
        cross = one.fisher[np.ix_(kept, marginal)]
        block = one.fisher[np.ix_(marginal, marginal)] + np.diag(
            [d**-2.0 for d in separate.values()])
        total += one.fisher[np.ix_(kept, kept)] - cross @ _inverse(block) @ cross.T
    return _inverse(total)


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a symmetric positive definite matrix whose rows have different units."""
    scale = 1 / np.sqrt(np.diag(matrix))
    return scale[:, None] * np.linalg.inv(scale[:, None] * matrix * scale) * scale


def bounds(covariance: np.ndarray) -> np.ndarray:
    """Standard deviations (6,) of log alpha and beta/alpha (m) from a covariance (6, 6)."""
    return np.sqrt(np.diag(covariance))


def depth_information(
    result: Drape,
    camera: Camera,
    *,
    nuisances: Nuisances | None = None,
    orientation: Radians = 0.0,
    noise: Metres = 1e-3,
    pixels_per_measurement: float = 100.0,
) -> Information:
    """Fisher information of four views of a drape, rotated by ``orientation`` in the first, whose
    depths have the standard deviation ``noise``."""
    names = (*THETA_NAMES, *SPECIMEN, *CAMERA, *SETUP, *NAMES)
    tangent = Tangent.of(result)
    if not tangent.ok:
        return Information.missing(names, tangent.message)
    moves = drape_moves(tangent, result, nuisances)
    views = DepthRenderer(tangent.positions, result.faces).views(camera, orientation)
    objective = DepthViews(
        LocatedViews.exact(views, camera, result.rig, QUARTERS),
        result.faces,
        turn=orientation,
        weights=DepthWeights(sigma=noise, limit=1.0, border_sigma=np.inf, stride=1,
                             patch=pixels_per_measurement**0.5),
    )
    found = objective.linearised(tangent.positions, objective.start)
    columns = dict(zip(moves, found.along(np.stack(list(moves.values()))).T, strict=True))
    columns |= zip(objective.nuisances, found.by_nuisance.T, strict=True)
    jacobian = np.stack([columns[name] for name in names], axis=1)
    used = np.any(jacobian != 0, axis=1)
    # DepthViews scales the residuals to the number of independent measurements.
    return Information(names, jacobian.T @ jacobian, int(used.sum()), True, "")


OUTLINE = (*THETA_NAMES, *SPECIMEN, *PICTURE, *NAMES)
"""Unknowns of an outline."""


def outline_information(
    result: Drape, *, nuisances: Nuisances, noise: Metres, cells_per_measurement: float
) -> Information:
    """Fisher information of the outline of a drape under parallel light, whose radii have the
    standard deviation ``noise``; one azimuth in so many is an independent measurement."""
    tangent = Tangent.of(result)
    if not tangent.ok:
        return Information.missing(OUTLINE, tangent.message)
    _, jacobian = _outline_moves(tangent, result, nuisances)
    scale = noise * cells_per_measurement**0.5
    return Information(OUTLINE, jacobian.T @ jacobian / scale**2, AZIMUTHS, True, "")


def _outline_moves(
    tangent: Tangent, result: Drape, nuisances: Nuisances
) -> tuple[np.ndarray, np.ndarray]:
    """Radii (A,) of a drape's outline under parallel light, m, and their derivatives (A, P) by
    :data:`OUTLINE`."""
    here = tangent.positions
    edges = contour(here, result.mesh, np.inf)
    moves = drape_moves(tangent, result, nuisances)
    moves["turn"] = np.column_stack([-here[:, 1], here[:, 0], np.zeros(len(here))])
    columns = {}
    for name, move in moves.items():
        step = _RADIUS_STEP / np.linalg.norm(move, axis=1).max()
        ahead, behind = (silhouettes(here + s * move, edges, np.array([np.inf]), zero=0.0)[0]
                         for s in (step, -step))
        columns[name] = (ahead - behind) / (2 * step)
    radius = silhouettes(here, edges, np.array([np.inf]), zero=0.0)[0]
    columns |= zip(PICTURE, (np.cos(AZIMUTH), np.sin(AZIMUTH), radius), strict=True)
    return radius, np.stack([columns[name] for name in OUTLINE], axis=1)


def drape_moves(
    tangent: Tangent, result: Drape, nuisances: Nuisances | None
) -> dict[str, np.ndarray]:
    """(V, 3) derivatives of a drape by theta, the specimen's offset and the nuisances."""
    by_moduli = tangent_sensitivities(tangent, result.fabric, ("log_alpha", "ratio")).positions
    moves = dict(zip(THETA_NAMES, by_moduli, strict=True))
    moves |= zip(SPECIMEN[1:], moves_with_offset(tangent, result.rig), strict=True)
    moves |= zip(("size", "cut"), moves_with_size(tangent, result.rig), strict=True)
    moves |= law_moves(tangent, nuisances or Nuisances(), (*LAW_NAMES, "hysteresis"))
    moves["plate"] = moves_with_plate(tangent, result.rig)
    return moves


def moves_with_size(tangent: Tangent, rig: Rig) -> np.ndarray:
    """(2, V, 3) how a drape moves with the specimen's sides, m per m, and its cut, m per rad; the
    mesh moves as for :func:`sim.sensitivity.rest_shape.moves_with_offset`."""
    share, from_centre = share_of_border(tangent, rig)
    turned = np.column_stack([-from_centre[:, 1], from_centre[:, 0]])
    larger = (from_centre @ rig.directions / rig.sides) @ rig.directions.T
    return moves_with_rest(tangent, share[:, None] * np.stack([larger, turned]))


def moves_with_plate(tangent: Tangent, rig: Rig) -> np.ndarray:
    """(V, 3) how a drape moves with the diameter of the plate of ``rig``, m per m. The vertices on
    the plate move with it, and the others less and less towards the border."""
    scene = tangent.cloth.scene
    move = (1 - share_of_border(tangent, rig)[0])[:, None] * scene.mesh.rest / rig.plate_diameter
    step = difference_step(tangent, move)
    ahead, behind = (
        forces_in(replace(scene, mesh=scene.mesh.with_rest(scene.mesh.rest + s * move),
                          obstacles=replace(rig, plate_diameter=rig.plate_diameter + s).obstacles),
                  tangent)
        for s in (step, -step))
    carried = np.zeros(tangent.cloth.potential.unknowns)
    carried[: tangent.coordinates].reshape(-1, 3)[scene.held, :2] = move[scene.held]
    push = (ahead - behind) / (2 * step) + hessian_product(tangent, carried)
    return (carried - tangent.response(push))[: tangent.coordinates].reshape(-1, 3)


def hessian_product(tangent: Tangent, move: np.ndarray) -> np.ndarray:
    """Change (U,) of the energy's gradient when the unknowns move by ``move`` (U,)."""
    total = np.zeros(len(move) + 1)  # last entry: dofs of -1
    for energy in tangent.cloth.potential.energies:
        blocks = energy.hessian(tangent.q)
        if blocks is not None:
            local = np.where(energy.dofs >= 0, move[energy.dofs], 0.0)
            np.add.at(total, energy.dofs, np.einsum("nij,nj->ni", blocks, local))
    return total[:-1]
