"""Targets of the network: the fabric in units of its weight and of a specimen's size.

A drape depends on alpha/(rho g L³), beta/(alpha L), the natural curvature times L, and the membrane
stiffness over rho g L only, with L the specimen's size, so that testers of all sizes are one family
(:mod:`sim.rig`, ``docs/physics.md``). L is that of the set's captures, their geometric mean. Of a
rectangle it is that of its sides, beside which the drape depends on their ratio.

Where the direction of the warp is not stated, the targets are those with the stiffer yarns first.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from data.fabrics.fabrics import ClothProperties
from drapenet.views.directions import AZIMUTHS
from drapenet.views.pictures import PICTURES
from sim.material import FIRST, REFERENCE_DENSITY, SECOND, SWAPPED
from sim.rig import GRAVITY

SYMMETRIES = 8  # over which estimates are averaged
QUARTER = AZIMUTHS // 4
MODULI = 6  # the first targets, in the order of theta
TARGETS = 10  # moduli, curl along warp and weft, log membrane, hysteresis
CURL, MEMBRANE, HYSTERESIS = slice(6, 8), 8, 9
_SWAPPED = np.array([*SWAPPED, 7, 6, MEMBRANE, HYSTERESIS])

TargetArray = Annotated[np.ndarray, "(..., TARGETS)"]
SpecimenSizes = Annotated[np.ndarray, "(...,) m, sizes of the specimens"]


def targets_of(cloth: ClothProperties, size: SpecimenSizes) -> TargetArray:
    """Targets in units of specimens of ``size``."""
    weight = np.log(REFERENCE_DENSITY * GRAVITY)
    return np.concatenate([
        cloth.theta[..., :3] - weight - 3 * np.log(size)[..., None],
        cloth.theta[..., 3:] / size[..., None],
        cloth.curl * size[..., None],
        (np.log(cloth.membrane) - weight - np.log(size))[..., None],
        cloth.hysteresis[..., None]], axis=-1)


def cloth_of(targets: TargetArray, size: SpecimenSizes) -> ClothProperties:
    """The inverse of :func:`targets_of`."""
    weight = np.log(REFERENCE_DENSITY * GRAVITY)
    theta = np.concatenate([
        targets[..., :3] + weight + 3 * np.log(size)[..., None],
        targets[..., 3:MODULI] * size[..., None]], axis=-1)
    return ClothProperties(theta, targets[..., CURL] / size[..., None],
                           np.exp(targets[..., MEMBRANE] + weight + np.log(size)),
                           targets[..., HYSTERESIS])


def stiffer_first(targets: TargetArray) -> TargetArray:
    """The targets with warp and weft exchanged where the weft is stiffer."""
    soft = targets[..., FIRST] < targets[..., SECOND]
    return exchanged(targets, soft)


def exchanged(targets: TargetArray, where: np.ndarray) -> TargetArray:
    """The targets with warp and weft exchanged ``where`` (...,)."""
    return np.where(where[..., None], targets[..., _SWAPPED], targets)


@dataclass(frozen=True)
class Symmetry:
    """Rotations and reflections of N captures that give equally likely captures.

    A quarter turn gives the capture of the fabric with warp and weft exchanged.
    """

    cells: np.ndarray  # (N,) azimuth cells of the rotation
    mirror: np.ndarray  # (N,) whether a capture is first reflected at azimuth 0

    @classmethod
    def draw(
        cls, *, known: np.ndarray, disc: np.ndarray, exchanged: np.ndarray | bool = False,
        rng: np.random.Generator,
    ) -> "Symmetry":
        """Random: half turns where the warp is ``known`` (N,), and a quarter more where it is
        ``exchanged`` (N,) with the weft; else whole cells of a ``disc`` (N,) and quarter turns of a
        rectangle, whose aspect is then the inverse."""
        step = np.where(known, 2 * QUARTER, np.where(disc, 1, QUARTER))
        cells = step * rng.integers(AZIMUTHS // step) + QUARTER * (known & exchanged)
        return cls(cells, rng.integers(2, size=len(known)) > 0)

    @classmethod
    def number(cls, k: int, captures: int) -> "Symmetry":
        """One of :data:`SYMMETRIES`, of each of N ``captures``."""
        return cls(np.full(captures, QUARTER * (k % 4)), np.full(captures, k >= 4))

    @property
    def exchanged(self) -> np.ndarray:
        """(N,) whether azimuth 0 lies along the weft if it was along the warp, or the reverse."""
        return self.cells // QUARTER % 2 > 0

    def of_rows(self, rows: np.ndarray) -> np.ndarray:
        """Apply to maps or outlines (N, AZIMUTHS, ...)."""
        azimuth = (np.arange(AZIMUTHS) - self.cells[:, None]) % AZIMUTHS
        azimuth = np.where(self.mirror[:, None], AZIMUTHS - 1 - azimuth, azimuth)
        return rows[np.arange(len(rows))[:, None], azimuth]

    def of_pictures(self, pictures: np.ndarray) -> np.ndarray:
        """Apply, in quarter turns, to pictures (N, PICTURES, SIDE, SIDE) of
        :class:`drapenet.views.pictures.DepthPictures`, or to none, (N, 0, ...)."""
        if not pictures.shape[1]:
            return pictures
        order = np.arange(PICTURES) + self.cells[:, None] // QUARTER
        # Seen in a mirror, azimuth 0 is k quarter turns away where it was 2 - k.
        order = np.where(self.mirror[:, None], 2 - order, order) % PICTURES
        turned = pictures[np.arange(len(pictures))[:, None], order]
        return np.where(self.mirror[:, None, None, None], turned[..., ::-1], turned)

    def of_angles(self, angle: np.ndarray) -> np.ndarray:
        """Apply to angles (N,), rad, of azimuth 0 in the first picture."""
        return np.where(self.mirror, -angle, angle)


@dataclass(frozen=True)
class TargetScale:
    """Standardisation of the targets, by a mean and a deviation of each."""

    mean: TargetArray
    std: TargetArray

    @staticmethod
    def fit(targets: TargetArray) -> "TargetScale":
        """Scale of a training set's targets, equal for warp and weft."""
        mean = targets.mean(axis=0)
        std = np.maximum(targets.std(axis=0), 1e-12)
        return TargetScale((mean + mean[_SWAPPED]) / 2, (std + std[_SWAPPED]) / 2)

    def encode(self, targets: TargetArray) -> TargetArray:
        return (targets - self.mean) / self.std

    def decode(self, standardised: TargetArray) -> TargetArray:
        return standardised * self.std + self.mean
