"""What a laboratory may state of a fabric: a quantity, its error and its value of a given cloth."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from common.types import Density
from data.fabrics.fabrics import ClothProperties, from_theta
from sim.material import DIRECTIONS, REFERENCE_DENSITY

STANDARD_GRAVITY = 9.80665  # m/s², of gram-force
SPECIMEN_SCATTER = 0.07
"""Standard deviation of log alpha between specimens of a fabric: of most 0.05 to 0.10.

Assumed, as no repeats of measured alpha are at hand. A trial network estimated a bending stiffness
from outlines of real drapes: its median ratio between samples of one fabric and face is 1.10 (nine
fabrics) and 1.13 (thirteen), as of normal logarithms with standard deviations of 0.10 and 0.13,
which include errors of the network.
"""
SLIP = 0.4  # of the logarithm, by which a value is near a multiple of the right one
MAX_DENSITY_DIFFERENCE = 0.1  # between specimens of one fabric, relative to the smallest


@dataclass(frozen=True)
class Quantity:
    """A positive quantity whose logarithm has a normal error.

    Attributes:
        name: key of ``known``, which ends in the unit.
        directions: 3 if it is stated along warp, bias or weft, also of something that is never
            measured along all of them; 1 of the whole fabric.
        error: standard deviation of its logarithm, 0.05 for 5 %, between specimens and operators,
            of a value without a stated one.
        predict: gives it of S fabrics of a density, (S, directions), in the unit of the name;
            :func:`moduli_at` gives their moduli. NaN of a fabric that cannot have it.
        limits: least and largest value that may be stated; beyond them it has another unit.
        doubled: what a value of twice the right one is.
        title: its name and unit for people, by default its key.
    """

    name: str
    directions: int
    error: float
    predict: Callable[[ClothProperties, Density], np.ndarray]
    title: str = ""
    limits: tuple[float, float] = (0.0, math.inf)
    doubled: str = ""

    def __post_init__(self) -> None:
        if self.directions not in (1, 3) or not 0 < self.error <= 1:
            raise ValueError(f"{self.name}: directions={self.directions} must be 1 or 3, and "
                             f"error={self.error} a share above 0 and up to 1")

    def of(self, cloth: ClothProperties, density: Density) -> np.ndarray:
        """:attr:`predict`, checked; ValueError if its result has another shape."""
        values = self.predict(cloth, density)
        if values.shape != (shape := (len(cloth.theta), self.directions)):
            raise ValueError(f"{self.name}: predict gives an array {values.shape}, not {shape}")
        return values

    @property
    def in_words(self) -> str:
        """Names it for people."""
        return self.title or self.name

    def slip(self, ratio: float) -> str:
        """What a value so many times the right one may be, in brackets; empty if it is no slip."""
        tens = round(math.log10(ratio))
        if self.doubled and abs(math.log(ratio / 2)) < SLIP:
            return f" (twice: {self.doubled}?)"
        if tens and abs(math.log(ratio / 10.0**tens)) < SLIP:
            return f" (stated is {10.0**tens:g} times that: another unit?)"
        return ""

    def stated(self, k: int, value: float) -> str:
        """A value along the direction of this number, if it has directions, in words."""
        return f"{self.in_words}{f' {DIRECTIONS[k]}' * (self.directions > 1)} = {value:g}"


def by_name(quantities: Iterable[Quantity]) -> dict[str, Quantity]:
    """Quantities by their keys; ValueError if two have the same."""
    found: dict[str, Quantity] = {}
    for each in quantities:
        if each.name in found:
            raise ValueError(f"two quantities have the key {each.name}")
        found[each.name] = each
    return found


def moduli_at(cloth: ClothProperties, density: Density) -> tuple[np.ndarray, np.ndarray]:
    """alpha (S, 3) N·m and beta (S, 3) N·m² at a density."""
    alpha, beta = from_theta(cloth.theta)
    scale = density / REFERENCE_DENSITY
    return alpha * scale, beta * scale
