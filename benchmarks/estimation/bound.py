"""How well depth views of a drape determine its fabric at best: the Cramér-Rao bound.

A depth is measured with the standard deviation s, and one pixel in m independently of the others.
With the derivatives J of the depths by the parameters, Fisher's information is JᵀJ/(s² m), and no
unbiased estimate has a smaller covariance than its inverse. What is unknown beside the moduli
(nuisances of the specimen, how it is turned and where it lies on the plate, where the camera
stands) has separate columns in J. What is known of a parameter before the drape, with the
covariance C, adds C⁻¹ to the information. The inverse of the sum is the posterior bound: in linear
approximation, the covariance of the best estimate that uses this knowledge. Silhouettes are
left out: their pixels are few.

The bound is that of the drape's own fold configuration and of a law that is true.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from data.cameras import Camera
from data.fabrics import THETA_NAMES
from data.nuisances import NAMES, Nuisances
from data.render import QUARTERS, DepthRenderer
from drapenet.refine.cloth import law_moves
from drapenet.refine.depth import FOCAL, POSE, DepthViews, DepthWeights, table_names
from sim.drape import DrapeResult
from sim.scene import Rig
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
"""How the specimen lies: rad about the vertical, and m of its centre from the plate's axis."""
CAMERA = tuple(name for name in POSE if name != "turn")
"""How the camera stands: rad and m."""
SETUP = (*table_names(len(QUARTERS)), FOCAL)
"""What the table turned beyond quarter turns, rad, and the logarithm of the focal length."""


@dataclass(frozen=True)
class Information:
    """What a capture shows of theta (:mod:`data.fabrics`) and of what else is unknown.

    Attributes:
        names: (P,) parameters: theta, :data:`SPECIMEN`, :data:`CAMERA`, :data:`SETUP` and
            :data:`data.nuisances.NAMES`, in SI units or logarithms.
        fisher: (P, P) information; NaN where the drape has no derivatives.
        pixels: how many see cloth and were used.
        ok, message: whether there are derivatives, and why not.
    """

    names: tuple[str, ...]
    fisher: np.ndarray
    pixels: int
    ok: bool
    message: str

    def covariance(self, unknown: Iterable[str] = SPECIMEN) -> np.ndarray:
        """(6, 6) least covariance of theta with the parameters ``unknown`` free, others known."""
        return joint_covariance([self], np.zeros((6, 6)), own=dict.fromkeys(unknown, np.inf))

    def posterior(self, prior: np.ndarray, unknown: Mapping[str, float]) -> np.ndarray:
        """(6, 6) the same for an estimate that knows how fabrics and nuisances spread.

        Args:
            prior: (6, 6) covariance of theta over fabrics.
            unknown: standard deviations, above 0, of the parameters that are not known, in the
                units of :attr:`names`; infinity where nothing is known of one.
        """
        return joint_covariance([self], np.linalg.inv(prior), own=unknown)


def joint_covariance(
    captures: Sequence[Information], precision: np.ndarray, *, own: Mapping[str, float],
    shared: Mapping[str, float] | None = None,
) -> np.ndarray:
    """(6 + S, 6 + S) least covariance of theta and of what else captures of one fabric share.

    NaN where a drape has no derivatives.

    Args:
        precision: (6, 6) of theta beforehand.
        own: standard deviations of what differs from capture to capture; shared: of the S
            parameters that belong to the fabric; infinity where nothing is known of one.
    """
    shared = shared or {}
    total = np.zeros((6 + len(shared),) * 2)
    total[:6, :6] = precision
    total[6:, 6:] = np.diag([deviation**-2.0 for deviation in shared.values()])
    for one in captures:
        kept, left = ([one.names.index(name) for name in names]
                      for names in ((*THETA_NAMES, *shared), own))
        if not np.isfinite(one.fisher).all():
            return np.full(total.shape, np.nan)
        between = one.fisher[np.ix_(kept, left)]
        within = one.fisher[np.ix_(left, left)] + np.diag([d**-2.0 for d in own.values()])
        total += one.fisher[np.ix_(kept, kept)] - between @ _inverse(within) @ between.T
    return _inverse(total)


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Of a symmetric positive definite matrix whose rows have different units."""
    scale = 1 / np.sqrt(np.diag(matrix))
    return scale[:, None] * np.linalg.inv(scale[:, None] * matrix * scale) * scale


def bounds(covariance: np.ndarray) -> np.ndarray:
    """(6,) standard deviations of log alpha and beta/alpha (m) of a covariance (6, 6)."""
    return np.sqrt(np.diag(covariance))


def depth_information(
    result: DrapeResult,
    camera: Camera,
    *,
    nuisances: Nuisances | None = None,
    orientation: float = 0.0,
    noise: float = 1e-3,
    pixels_per_measurement: float = 100.0,
) -> Information:
    """Information in the four views of a drape.

    Args:
        result: on a rig with a plate.
        camera: that sees the specimen, turned by ``orientation`` (rad) in the first view.
        nuisances: whose laws and rig the drape was made with; None for none.
        noise: m, standard deviation of a depth.
        pixels_per_measurement: m above.
    """
    names = (*THETA_NAMES, *SPECIMEN, *CAMERA, *SETUP, *NAMES)
    tangent = Tangent.of(result)
    if not tangent.ok:
        none = np.full((len(names), len(names)), np.nan)
        return Information(names, none, 0, False, tangent.message)
    by_moduli = tangent_sensitivities(tangent, result.fabric, ("log_alpha", "ratio")).positions
    moves = dict(zip(THETA_NAMES, by_moduli, strict=True))
    moves |= zip(SPECIMEN[1:], moves_with_offset(tangent, result.rig), strict=True)
    moves |= zip(("size", "cut"), moves_with_size(tangent, result.rig), strict=True)
    moves |= law_moves(tangent, nuisances or Nuisances())
    moves["plate"] = moves_with_plate(tangent, result.rig)
    views = DepthRenderer(tangent.positions, result.faces).views(camera, orientation)
    objective = DepthViews(
        views,
        camera,
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
    # The residuals are scaled to the number of independent measurements.
    return Information(names, jacobian.T @ jacobian, int(used.sum()), True, "")


def moves_with_size(tangent: Tangent, rig: Rig) -> np.ndarray:
    """(2, V, 3) how a drape moves with the specimen's size, m per m, and its cut, m per rad; the
    mesh moves as for :func:`sim.sensitivity.rest_shape.moves_with_offset`."""
    share, from_centre = share_of_border(tangent, rig)
    turned = np.column_stack([-from_centre[:, 1], from_centre[:, 0]])
    return moves_with_rest(
        tangent, share[:, None] * np.stack([from_centre / rig.specimen_size, turned]))


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
    push = (ahead - behind) / (2 * step) + tangent.force_of(carried)
    return (carried - tangent.response(push))[: tangent.coordinates].reshape(-1, 3)
