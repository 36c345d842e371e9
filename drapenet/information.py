"""What four depth views of a drape can tell of its fabric: the Cramér-Rao bound.

A depth is measured with the standard deviation s, and one pixel in m independently of the others.
With the derivatives J of the depths by the parameters, Fisher's information is JᵀJ/(s² m), and no
unbiased estimate has a smaller covariance than its inverse. What is unknown beside the moduli
(how the specimen is turned, where it lies on the plate, where the camera stands) has columns of
its own in J. Silhouettes are left out: their pixels are few.

The bound is that of the drape's own fold configuration and of a law that is true.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from data.cameras import Camera
from data.fabrics import THETA_NAMES
from data.render import render_views
from drapenet.refine.depth import POSE, DepthViews, DepthWeights
from sim.drape import DrapeResult
from sim.sensitivity import Tangent
from sim.sensitivity.forward import tangent_sensitivities
from sim.sensitivity.rest_shape import moves_with_offset

SPECIMEN = ("turn", "offset_warp", "offset_weft")
"""How the specimen lies: rad about the vertical, and m of its centre from the plate's axis."""
CAMERA = tuple(name for name in POSE if name != "turn")
"""How the camera stands: rad and m."""


@dataclass(frozen=True)
class Information:
    """What a capture tells of theta (:mod:`data.fabrics`) and of what else is unknown.

    Attributes:
        names: (P,) parameters: theta, :data:`SPECIMEN`, :data:`CAMERA`.
        fisher: (P, P) information; NaN where the drape has no derivatives.
        pixels: how many see cloth and were used.
        ok, message: whether there are derivatives, and why not.
    """

    names: tuple[str, ...]
    fisher: np.ndarray
    pixels: int
    ok: bool
    message: str

    def covariance(self, unknown: Sequence[str] = SPECIMEN) -> np.ndarray:
        """(6, 6) least covariance of theta with the parameters ``unknown`` free, others known."""
        chosen = [self.names.index(name) for name in (*THETA_NAMES, *unknown)]
        part = self.fisher[np.ix_(chosen, chosen)]
        if not np.isfinite(part).all():
            return np.full((6, 6), np.nan)
        scale = 1 / np.sqrt(np.diag(part))
        return (scale[:, None] * np.linalg.inv(scale[:, None] * part * scale) * scale)[:6, :6]


def bounds(covariance: np.ndarray) -> np.ndarray:
    """(6,) standard deviations of log alpha and beta/alpha (m), other moduli unknown."""
    return np.sqrt(np.diag(covariance))


def bounds_alone(covariance: np.ndarray) -> np.ndarray:
    """(6,) the same if the other five moduli were known."""
    return 1 / np.sqrt(np.diag(np.linalg.inv(covariance)))


def combinations(covariance: np.ndarray, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Independent combinations of the moduli, best known first.

    Args:
        covariance: (6, 6) of theta.
        scale: (6,) spread of theta over fabrics, the unit in which its entries are compared.

    Returns:
        Standard deviations (6,) in that unit, and combinations (6, 6), a row of weights each.
    """
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.sqrt(np.maximum(values, 0.0)), vectors.T


def depth_information(
    result: DrapeResult,
    camera: Camera,
    *,
    orientation: float = 0.0,
    noise: float = 1e-3,
    pixels_per_measurement: float = 100.0,
) -> Information:
    """Information in the four views of a drape.

    Args:
        camera: that sees the specimen, turned by ``orientation`` (rad) in the first view.
        noise: m, standard deviation of a depth.
        pixels_per_measurement: m above.
    """
    names = (*THETA_NAMES, *SPECIMEN, *CAMERA)
    tangent = Tangent.of(result)
    if not tangent.ok:
        none = np.full((len(names), len(names)), np.nan)
        return Information(names, none, 0, False, tangent.message)
    moves = np.concatenate([
        tangent_sensitivities(tangent, result.fabric, ("log_alpha", "ratio")).positions,
        moves_with_offset(tangent, result.rig),
    ])
    positions = tangent.positions
    views = render_views(positions, result.faces, camera, orientation)
    objective = DepthViews(
        views,
        camera,
        result.faces,
        turn=orientation,
        table=False,
        weights=DepthWeights(sigma=noise, limit=1.0, border_sigma=np.inf, stride=1,
                             patch=pixels_per_measurement**0.5),
    )
    found = objective.linearised(positions, objective.start)
    columns = dict(zip((*names[:6], *SPECIMEN[1:]), found.along(moves).T, strict=True))
    columns |= dict(zip(objective.nuisances, found.by_nuisance.T, strict=True))
    jacobian = np.stack([columns[name] for name in names], axis=1)
    used = np.any(jacobian != 0, axis=1)
    # The residuals are scaled to the number of independent measurements.
    return Information(names, jacobian.T @ jacobian, int(used.sum()), True, "")
