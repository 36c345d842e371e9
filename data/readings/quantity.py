"""What a laboratory may state of a fabric: a quantity, its error and its value of a given cloth."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from common.types import Density
from data.fabrics.fabrics import from_theta
from data.fabrics.properties import ClothProperties
from sim.material import REFERENCE_DENSITY

STANDARD_GRAVITY = 9.80665  # m/s², of gram-force
SPECIMEN_SCATTER = 0.07
"""Standard deviation of log alpha between specimens of a fabric: of most 0.05 to 0.10.

Assumed, as no repeats of measured alpha are at hand. A trial network estimated a bending stiffness
from outlines of real drapes: its median ratio between samples of one fabric and face is 1.10 (nine
fabrics) and 1.13 (thirteen), as of normal logarithms with standard deviations of 0.10 and 0.13,
which include errors of the network.
"""


@dataclass(frozen=True)
class Quantity:
    """A positive quantity whose logarithm has a normal error.

    Attributes:
        name: key of ``known``, which ends in the unit.
        directions: 3 if it is stated along warp, bias and weft each, 1 of the whole fabric.
        error: relative standard deviation, between specimens and operators, of a value without a
            stated one.
        predict: gives it of S fabrics, (S, directions), in the unit of the name, at their moduli of
            300 g/m² and the density of the fabric; NaN of a fabric that cannot have it.
        title: its name and unit for people, by default its key.
    """

    name: str
    directions: int
    error: float
    predict: Callable[[ClothProperties, Density], np.ndarray]
    title: str = ""

    @property
    def in_words(self) -> str:
        """Names it for people."""
        return self.title or self.name


def moduli_at(cloth: ClothProperties, density: Density) -> tuple[np.ndarray, np.ndarray]:
    """alpha (S, 3) N·m and beta (S, 3) N·m² at a density."""
    alpha, beta = from_theta(cloth.theta)
    scale = density / REFERENCE_DENSITY
    return alpha * scale, beta * scale
