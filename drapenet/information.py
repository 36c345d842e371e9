"""How well depth views of a drape determine its fabric at best: the Cramér-Rao bound.

A depth is measured with the standard deviation s, and one pixel in m independently of the others.
With the derivatives J of the depths by the parameters, Fisher's information is JᵀJ/(s² m), and no
unbiased estimate has a smaller covariance than its inverse. What is unknown beside the moduli
(nuisances of the specimen, how it is turned and where it lies on the plate, where the camera
stands) has columns of its own in J. What is known of a parameter before the drape, with the
covariance C, adds C⁻¹ to the information. The inverse of the sum is the posterior bound: in linear
approximation, the covariance of the best estimate that uses this knowledge. Silhouettes are
left out: their pixels are few.

The bound is that of the drape's own fold configuration and of a law that is true.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from data.cameras import Camera
from data.fabrics import THETA_NAMES
from data.nuisances import NAMES, NuisanceConfig, Nuisances
from data.render import render_views
from drapenet.refine.depth import FOCAL, POSE, TABLE, DepthViews, DepthWeights
from sim.drape import DrapeResult
from sim.sensitivity import Tangent
from sim.sensitivity.forward import tangent_sensitivities
from sim.sensitivity.parameters import forces
from sim.sensitivity.rest_shape import moves_with_offset, moves_with_plate, moves_with_size

SPECIMEN = ("turn", "offset_warp", "offset_weft")
"""How the specimen lies: rad about the vertical, and m of its centre from the plate's axis."""
CAMERA = tuple(name for name in POSE if name != "turn")
"""How the camera stands: rad and m."""
SETUP = (*TABLE, FOCAL)
"""What the table turned beyond quarter turns, rad, and the logarithm of the focal length."""
LOGARITHMIC = ("membrane", "shear")
"""Those of :data:`data.nuisances.NAMES` whose columns are by their logarithm."""
_STEPS = {"membrane": 1e-3, "shear": 1e-3, "friction": 1e-5, "curl_warp": 0.1, "curl_weft": 0.1}


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
        return self._theta_block(np.zeros((6, 6)), dict.fromkeys(unknown, np.inf))

    def posterior(self, prior: np.ndarray, unknown: Mapping[str, float]) -> np.ndarray:
        """(6, 6) the same for an estimate that knows how fabrics and nuisances spread.

        Args:
            prior: (6, 6) covariance of theta over fabrics.
            unknown: standard deviations, above 0, of the parameters that are not known, in the
                units of :attr:`names`; infinity where nothing is known of one.
        """
        return self._theta_block(np.linalg.inv(prior), unknown)

    def _theta_block(self, precision: np.ndarray, unknown: Mapping[str, float]) -> np.ndarray:
        chosen = [self.names.index(name) for name in (*THETA_NAMES, *unknown)]
        total = self.fisher[np.ix_(chosen, chosen)]
        if not np.isfinite(total).all():
            return np.full((6, 6), np.nan)
        total[:6, :6] += precision
        total[6:, 6:] += np.diag([deviation**-2.0 for deviation in unknown.values()])
        scale = 1 / np.sqrt(np.diag(total))
        return (scale[:, None] * np.linalg.inv(scale[:, None] * total * scale) * scale)[:6, :6]


def bounds(covariance: np.ndarray) -> np.ndarray:
    """(6,) standard deviations of log alpha and beta/alpha (m) of a covariance (6, 6)."""
    return np.sqrt(np.diag(covariance))


def deviations(spread: NuisanceConfig) -> dict[str, float]:
    """Standard deviations of the nuisances, by :data:`data.nuisances.NAMES`.

    Of the logarithms of membrane and shear. Uniform distributions count with theirs.
    """
    (softest, stiffest), (least, most) = spread.membrane, spread.shear
    return {
        "membrane": np.log(stiffest / softest) / (2 * 1.96),  # between percentiles 2.5 and 97.5
        "shear": np.log(most / least) / np.sqrt(12),
        "friction": spread.friction / np.sqrt(12),
        "curl_warp": spread.curl,
        "curl_weft": spread.curl,
        "size": spread.size,
        "plate": spread.plate,
        "cut": spread.cut,
    }


def law_moves(tangent: Tangent, nuisances: Nuisances) -> dict[str, np.ndarray]:
    """(V, 3) how a drape moves with each nuisance of its cloth's energies, by name.

    Per unit of log membrane and log shear, N of friction, 1/m of curl. Forces are linear in the
    parameters themselves, so that differences at one state are derivatives, for any step.
    """
    cloth, size = tangent.cloth, tangent.cloth.potential.unknowns
    mesh, active = cloth.scene.mesh, cloth.scene.active

    def forces_with(name: str, value: float) -> np.ndarray:
        laws = replace(nuisances, **{name: value}).laws
        energies = [laws.membrane.energy(mesh, active),
                    laws.bending_law(mesh, active, fabric=cloth.fabric)]
        return forces(energies, tangent.q, size)

    moves = {}
    for name, step in _STEPS.items():
        value = getattr(nuisances, name)
        # A shear of exactly 1 is another law. Friction below 0 is none.
        low, high = ((value * (1 - step), value * (1 + step)) if name in LOGARITHMIC
                     else (value, value + step))
        push = (forces_with(name, high) - forces_with(name, low)) / (high - low)
        push *= value if name in LOGARITHMIC else 1.0
        moves[name] = -tangent.response(push)[: tangent.coordinates].reshape(-1, 3)
    return moves


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
    views = render_views(tangent.positions, result.faces, camera, orientation)
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
