"""What a network reads: sets of captures as arrays, and what is known of them.

Single precision; N captures in M sets.
"""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from data.fabrics.nuisances import KINDS
from drapenet.network.expected import shape_of
from drapenet.network.targets import Symmetry
from drapenet.views.radial_map import WEIGHT_UNIT

_SIZE = 0.3  # m, unit of the specimens' size
_MAX_COEFFICIENT = 1.05
_ERROR = 0.005  # half sizes, of outlines
_RIM, _MEMBRANE = 0.005, 1e3  # units of rims over the specimen's size, and of N/m of _SIZE
FACTS, ASPECTS, STATED = 19, 2, 4 + len(KINDS)
"""Numbers of scalar inputs: of every network, and, after them, of one that reads rectangles, and of
one that reads what is stated of rim and fabric."""
_WARP = 5  # column: 1 if azimuth 0 is along the warp, -1 along the weft, 0 not known
_ODD = (_WARP, FACTS)  # columns that a quarter turn gives the opposite sign: that, and the aspect's
DISC, KNOWN = 3, 4  # columns
TESTER = 6  # the first columns, which state specimen, tester and warp, and nothing of the drape
_ABOUT = 10
"""The first columns: those, number of views and perspective."""
CIRCUMSTANCES = _ABOUT + ASPECTS + 1
"""What says nothing of the drape: those, the aspects and the mean error of the outline."""


def columns_of(first: int, rectangles: bool) -> list[int]:
    """Columns that a network reads: the ``first`` ones, and of the further ones its own."""
    return [*range(first), *range(FACTS, FACTS + ASPECTS * rectangles),
            *range(FACTS + ASPECTS, FACTS + ASPECTS + STATED)]


MapArray = Annotated[np.ndarray, "(N, AZIMUTHS, ELEVATIONS) float32"]


@dataclass(frozen=True)
class Stated:
    """What is stated of a fabric, for networks that read it."""

    membrane: float = np.nan  # N/m at 300 g/m², geometric mean of warp and weft; NaN: not stated
    kind: int = -1  # number among data.fabrics.nuisances.KINDS; -1: not stated


@dataclass(frozen=True)
class Facts:
    """What is known of N captures beside their pictures, (N,) each; NaN if it is not.

    ``known``: whether the captures of its set have azimuth 0 along the warp (or, after a quarter
    turn, see :meth:`Batch.turned`, along the weft).
    """

    size: np.ndarray  # of the specimens, m
    plate: np.ndarray  # its diameter over the specimen's size
    disc: np.ndarray
    aspect: np.ndarray  # side across azimuth 0 over the side along it; 1 of squares and discs
    face: np.ndarray  # 1, or -1 if turned over
    known: np.ndarray
    views: np.ndarray  # their number in a depth capture, 0 without
    perspective: np.ndarray  # size over the camera's height, of an outline; 0: parallel light
    coefficient: np.ndarray  # drape coefficient, from 0 to 1, of the outline or as reported
    nodes: np.ndarray  # number of folds, as reported
    rim: np.ndarray  # radius of the plate's, m
    membrane: np.ndarray  # as of :class:`Stated`
    kind: np.ndarray
    group: np.ndarray  # number of the set, from 0

    @property
    def sizes(self) -> np.ndarray:
        """(M,) m, geometric means over the sets."""
        count = np.bincount(self.group)
        return np.exp(np.bincount(self.group, np.log(self.size)) / count)

    @property
    def share(self) -> np.ndarray:
        """(N,) drape coefficients as a network reads them: a few depth maps of nearly flat cloth
        have a hem far out."""
        return self.coefficient.clip(0.0, _MAX_COEFFICIENT)

    def columns(self) -> np.ndarray:
        """(N, :data:`FACTS` + :data:`ASPECTS` + :data:`STATED`) scalar inputs of the network."""
        size = self.sizes[self.group]
        columns = [np.log(size / _SIZE), np.log(self.size / size), 2 * self.plate - 1, self.disc,
                   self.known, self.known, self.views / 4 - 1, self.views > 0]
        for part, unit in ((self.perspective, 0.4), (self.share, 0.5), (self.nodes, 8.0)):
            finite = np.isfinite(part)
            columns += [finite, np.where(finite, part, unit) / unit - 1]
        # What a regression on the drape coefficient needs.
        share = columns[-3]
        columns += [share**2, share**3, share * columns[2], share * self.disc, columns[2] ** 2]
        aspect = np.log(self.aspect)
        columns += [aspect, aspect**2]
        # Membranes in units of weight and size, as the targets: drapes depend on them alone.
        for part in (np.log1p(self.rim / self.size / _RIM),
                     np.log(self.membrane / _MEMBRANE) - columns[0]):
            columns += [np.isfinite(part), np.nan_to_num(part)]
        columns += [self.kind == k for k in range(len(KINDS))]
        return np.column_stack(columns).astype(np.float32)


@dataclass(frozen=True)
class Batch:
    """Inputs of a network."""

    distance: MapArray  # in sizes of the specimen
    weight: MapArray  # logarithm of 1 + weight
    outline: np.ndarray  # (N, AZIMUTHS), in half sizes of the specimen; 0 where not seen
    error: np.ndarray  # (N, AZIMUTHS), logarithm of 1 + error / _ERROR of the outline
    face: np.ndarray  # (N,) 1 or -1
    facts: np.ndarray  # (N, FACTS + ASPECTS + STATED)
    group: np.ndarray  # (N,)
    pictures: np.ndarray  # (N, PICTURES or 0, SIDE, SIDE) in sizes, NaN where there is no cloth
    angle: np.ndarray  # (N,) of azimuth 0 in the first picture, rad
    shape: np.ndarray  # (N, SHAPE), see :mod:`drapenet.network.expected`
    targets: np.ndarray | None = None  # (M, TARGETS) standardised; None in inference

    @classmethod
    def of(cls, distance: np.ndarray, weight: np.ndarray, outline: np.ndarray, error: np.ndarray,
           facts: Facts, pictures: np.ndarray, angle: np.ndarray,
           targets: np.ndarray | None = None) -> "Batch":
        """Batch of N stored maps (:func:`drapenet.views.radial_map.compressed`), (N, AZIMUTHS)
        outlines in half sizes (m/m), NaN where not seen, and their standard deviations, 0 of exact
        ones, pictures and their angles, rad."""
        # Of a single view, much of the hem is guessed, and with it all but the coefficient.
        hem = np.where((facts.views == 1)[:, None], np.nan, outline)

        def single(values: np.ndarray) -> np.ndarray:
            return np.asarray(values, np.float32)

        return cls(single(distance), np.float32(WEIGHT_UNIT) * weight,
                   single(np.nan_to_num(outline)), single(np.log1p(error / _ERROR)),
                   single(facts.face), facts.columns(), facts.group, single(pictures),
                   single(angle),
                   single(shape_of(hem, facts.share, facts.nodes)),
                   None if targets is None else single(targets))

    def turned(self, symmetry: Symmetry) -> "Batch":
        """The batch with ``symmetry`` applied to its captures, not to its targets."""
        facts = self.facts.copy()
        for column in _ODD:
            facts[symmetry.exchanged, column] *= -1
        return replace(self, facts=facts, pictures=symmetry.of_pictures(self.pictures),
                       angle=symmetry.of_angles(self.angle),
                       **{name: symmetry.of_rows(getattr(self, name))
                          for name in ("distance", "weight", "outline", "error")})

    @property
    def members(self) -> np.ndarray:
        """(M, N) float32, 1 where a capture is of a set."""
        sets = np.arange(self.group.max() + 1)
        return (sets[:, None] == self.group).astype(np.float32)

    @property
    def circumstances(self) -> np.ndarray:
        """(N, CIRCUMSTANCES)"""
        return np.hstack([self.facts[:, :_ABOUT], self.facts[:, FACTS : FACTS + ASPECTS],
                          self.error.mean(axis=1, keepdims=True)])
