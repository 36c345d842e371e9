"""Rigs: a specimen's size and shape, and what holds it, in SI units."""

import math
import re
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from common.arguments import number, numbers
from common.errors import InputError
from common.types import Metres, Points, Radians, RestPoints

GRAVITY = 9.81  # m/s²
RIM = 0.01
"""Radius of the rounded rim of a sharp plate over that of the plate: 0.5 mm for 100 mm of diameter.
At an exact edge the nearest surface would jump from top to side; the penetration of cloth is
smaller than it."""
MAX_RIM = 0.2  # of a rim's radius over the plate's diameter
_LARGEST = 5.0  # m
_NAME = re.compile(r"(?P<specimen>square|rectangle|disc)(?P<sides>[\d.]+(x[\d.]+)?)_"
                   r"(?P<holder>cylinder|support|corners)(?P<held>[\d.]+)"
                   r"(_rim(?P<rim>[\d.]+))?(_cut(?P<cut>-?[\d.]+))?")


@dataclass(frozen=True)
class Cylinder:
    """The solid below the plate: z < 0 within ``radius`` of the axis, unbounded downwards. Its rim
    is rounded, at least in proportion (:data:`RIM`), so that drapes of any size are similar."""

    radius: Metres
    rounding: Metres = 0.0

    @property
    def rim(self) -> Metres:
        """Radius of the rounded rim."""
        return max(self.rounding, RIM * self.radius)

    def _nearest(self, points: Points) -> np.ndarray:
        from sim.nearest import nearest  # compiled; most who state a rig do not need it

        return nearest(points, self.radius, self.rim)

    def depths(self, points: Points) -> np.ndarray:
        """Depths (N,), m, below the nearest surface; concave, negative outside."""
        return self._nearest(points)[0]

    def normals(self, points: Points) -> np.ndarray:
        """Outward normals (N, 3) of the nearest surface: the negative gradient of the depth."""
        _, distance, across, along, _ = self._nearest(points)
        return np.column_stack([across[:, None] * points[:, :2] / distance[:, None], along])

    def depth_hessians(self, points: Points) -> np.ndarray:
        """Second derivatives (N, 3, 3) of the depth, 1/m; negative semi-definite."""
        _, distance, across, along, bent = self._nearest(points)
        x, y = (points[:, :2] / distance[:, None]).T
        around = np.column_stack([-y, x, np.zeros(len(points))])
        over = np.column_stack([-along * x, -along * y, across])
        return -((across / distance)[:, None, None] * around[:, :, None] * around[:, None, :]
                 + bent[:, None, None] * over[:, :, None] * over[:, None, :])


@dataclass(frozen=True)
class Rig:
    """A specimen and its holder: a round plate under its middle (paper, section 3.1), whose top
    face's centre is the origin, z pointing up; or two neighbouring corners of a rectangle, held at
    z = 0, at the same distance from the origin (section 7.4.2).

    ``sides`` are those along warp and weft, before the ``cut`` turns them; one number stands for
    both, and is a disc's diameter. A square is a rectangle of equal sides."""

    sides: tuple[Metres, Metres] = (0.300, 0.300)
    plate_diameter: Metres = 0.100  # 0 without a plate
    specimen: str = "square"  # or "rectangle", if the sides differ; or "disc"
    corners_apart: Metres | None = None  # the two corners that hold a specimen without plate
    cut: Radians = 0.0  # from the warp to the first side of a rectangle, counter-clockwise
    rim: Metres = 0.0  # radius of the plate's rounded rim, within which its top is flat

    def __post_init__(self) -> None:
        given = self.sides if np.ndim(self.sides) else [self.sides] * 2
        sides = tuple(numbers("sides", given, "one number or two, along warp and weft, m",
                              (2,)).tolist())
        object.__setattr__(self, "sides", sides)
        for name, unit in (("plate_diameter", "m"), ("cut", "rad"), ("rim", "m"),
                           *[("corners_apart", "m")] * (self.corners_apart is not None)):
            object.__setattr__(self, name, number(name, getattr(self, name), unit))
        if self.specimen not in ("square", "rectangle", "disc"):
            raise InputError(f"specimen={self.specimen!r}: choose square, rectangle or disc")
        if self.specimen != "disc":
            kind = "square" if sides[0] == sides[1] else "rectangle"
            object.__setattr__(self, "specimen", kind)
        elif sides[0] != sides[1]:
            raise InputError(f"sides of {sides[0]:g} and {sides[1]:g} m: a disc has one diameter")
        self._check_sizes()

    def _check_sizes(self) -> None:
        sides = self.sides
        if not abs(self.cut) <= np.pi / 4 or (self.cut and not self.has_plate):
            raise InputError(f"a cut of {np.degrees(self.cut):g}° from the warp: give at most 45°, "
                             "and 0 without a plate")
        if not max(sides) <= _LARGEST:
            raise InputError(f"a specimen of {self.millimetres} mm: sizes are in metres, at most "
                             f"{_LARGEST:g}")
        if not 0 <= self.plate_diameter < np.min(sides):
            raise InputError(f"a plate of {1e3 * self.plate_diameter:g} mm under a specimen of "
                             f"{self.millimetres} mm: it must be smaller")
        if not 0 <= self.rim <= MAX_RIM * self.plate_diameter:
            raise InputError(f"a rim rounded by {1e3 * self.rim:g} mm on a plate of "
                             f"{1e3 * self.plate_diameter:g} mm: give 0 to "
                             f"{1e3 * MAX_RIM * self.plate_diameter:g} mm")
        if self.has_plate:
            if self.corners_apart is not None:
                raise InputError(f"corners_apart={self.corners_apart:g} beside a plate: give "
                                 "plate_diameter=0 too, or leave it out")
            return
        if self.specimen == "disc":
            raise InputError("a disc has no corners to hang by; give it a plate")
        if not (self.corners_apart and 0 < self.corners_apart < sides[0]):
            raise InputError(f"corners_apart={self.corners_apart}: without a plate give a distance "
                             f"above 0 and below {sides[0]:g} m, the specimen's first side")

    @property
    def name(self) -> str:
        """Identifier in datasets and checkpoints: specimen and holder, sizes in mm."""
        holder, size = ("support" if self.specimen == "disc" else "cylinder"), self.plate_diameter
        if self.corners_apart:
            holder, size = "corners", self.corners_apart
        cut = f"_cut{np.degrees(self.cut):g}" if self.cut else ""
        rim = f"_rim{1e3 * self.rim:g}" if self.rim else ""
        return f"{self.specimen}{self.millimetres}_{holder}{1e3 * size:g}{rim}{cut}"

    @property
    def millimetres(self) -> str:
        """The specimen's size in mm: ``300``, or ``170x250`` with sides along warp and weft."""
        sides = self.sides if self.specimen == "rectangle" else self.sides[:1]
        return "x".join(f"{1e3 * side:g}" for side in sides)

    @property
    def specimen_size(self) -> Metres:
        """Size of the specimen as one number: side of the square of its area, or diameter."""
        return math.sqrt(self.sides[0] * self.sides[1])

    @property
    def plate_radius(self) -> Metres:
        """Radius of the plate."""
        return self.plate_diameter / 2

    @property
    def sharp(self) -> "Rig":
        """The rig whose plate is the flat top of this one, on which the cloth is held."""
        return replace(self, plate_diameter=self.plate_diameter - 2 * self.rim,
                       rim=0.0) if self.rim else self

    @property
    def reach(self) -> Metres:
        """Distance of the flat specimen's farthest point from its centre."""
        return self.sides[0] / 2 if self.specimen == "disc" else math.hypot(*self.sides) / 2

    @property
    def overhang(self) -> Metres:
        """Largest distance of a centred specimen's border beyond the plate's rim."""
        return self.reach - self.plate_radius

    @property
    def least_overhang(self) -> Metres:
        """The smallest such distance."""
        return (min(self.sides) - self.plate_diameter) / 2

    @property
    def has_plate(self) -> bool:
        """Whether the specimen is draped over a plate, so that it has a drape coefficient."""
        return self.plate_diameter > 0

    @property
    def specimen_area(self) -> float:
        """Area of the flat specimen, m²."""
        product = self.sides[0] * self.sides[1]
        return np.pi / 4 * product if self.specimen == "disc" else product

    @property
    def obstacles(self) -> tuple[Cylinder, ...]:
        """Obstacles in contact with the cloth."""
        return (Cylinder(self.plate_radius, self.rim),) if self.has_plate else ()

    @property
    def aspect(self) -> float:
        """Second side over the first."""
        return self.sides[1] / self.sides[0]

    @property
    def symmetry(self) -> Radians:
        """Smallest turn that brings the flat specimen onto itself; 0: any turn does."""
        return {"disc": 0.0, "square": np.pi / 2, "rectangle": np.pi}[self.specimen]

    @property
    def directions(self) -> np.ndarray:
        """(2, 2) unit vectors along the sides of a rectangle, in warp/weft axes, as columns."""
        cos, sin = np.cos(self.cut), np.sin(self.cut)
        return np.array([[cos, -sin], [sin, cos]])

    def to_border(self, rest: RestPoints, centre: np.ndarray | tuple[float, float]) -> np.ndarray:
        """Distances (V,), m, to the border of the flat specimen around ``centre``; negative
        outside."""
        offset = np.abs((rest - np.asarray(centre)) @ self.directions)
        if self.specimen == "disc":
            return self.sides[0] / 2 - np.linalg.norm(offset, axis=1)
        return (np.array(self.sides) / 2 - offset).min(axis=1)

    def border(self, azimuth: np.ndarray) -> np.ndarray:
        """Distances (...,), m, of the flat specimen's border from its centre at azimuths (...,),
        rad, from the direction of its first side."""
        first, second = self.sides
        if self.specimen == "disc":
            return np.full(np.shape(azimuth), first / 2)
        along, across = np.abs(np.cos(azimuth)), np.abs(np.sin(azimuth))
        return first / 2 / np.maximum(along, first / second * across)

    def to_plate(self, rest: RestPoints) -> np.ndarray:
        """Distances (V,), m, in the flat specimen to the flat top of the plate; 0 on it."""
        return np.maximum(np.linalg.norm(rest, axis=1) - self.plate_radius + self.rim, 0.0)

    def place(self, rest: RestPoints) -> Points:
        """Positions of the held points of the specimen."""
        if self.has_plate:
            return np.column_stack([rest, np.zeros(len(rest))])
        across = rest[:, 0] * self.corners_apart / self.sides[0]
        return np.column_stack([across, np.zeros((len(rest), 2))])

    @staticmethod
    def from_name(name: str) -> "Rig":
        """The rig with this :attr:`name`; InputError if ``name`` is not of this form."""
        words = _NAME.fullmatch(str(name))
        with suppress(ValueError):  # numbers such as 1.2.3, sizes that no rig can have
            # People say support and cylinder of either.
            if words and (rig := _rig_of(words)).name in (
                    name, name.replace("cylinder", "support"), name.replace("support", "cylinder")):
                return rig
        raise InputError(f"unknown rig '{name}'; known rigs: {', '.join(RIGS)}, and others of "
                         "this form with sizes in mm")


def _rig_of(words: re.Match) -> Rig:
    sides = [float(side) / 1e3 for side in words["sides"].split("x")]
    held, hung = float(words["held"]) / 1e3, words["holder"] == "corners"
    return Rig((sides[0], sides[-1]), 0.0 if hung else held, words["specimen"],
               held if hung else None, math.radians(float(words["cut"] or 0)),
               float(words["rim"] or 0) / 1e3)


SQUARE_RIG = Rig()
"""The tester of Feng et al. 2022, section 3.1."""

DISC_RIG = Rig((0.300, 0.300), 0.180, specimen="disc")
"""The drape tester of textile laboratories: ISO 9073-9, BS 5058."""

SMALL_DISC_RIG, LARGE_DISC_RIG = (replace(DISC_RIG, sides=(size, size)) for size in (0.240, 0.360))
"""The same tester with its specimens for limp and for stiff cloth."""

HUNG_SQUARE = Rig((0.600, 0.600), 0.0, corners_apart=0.500)
"""The hanging test of section 7.4.2."""

RIGS = {rig.name: rig for rig in
        (SQUARE_RIG, SMALL_DISC_RIG, DISC_RIG, LARGE_DISC_RIG, HUNG_SQUARE)}
"""Rigs with a common name, by name."""
