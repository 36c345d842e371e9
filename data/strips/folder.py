"""A folder of strips of one fabric, and the posterior of its moduli by direction."""

from dataclasses import dataclass
from pathlib import Path

from common.errors import InputError
from common.types import DeflectionCurve, Density, Radians
from data.strips.description import StripsDescription, read_description
from data.strips.photograph import PhotographedStrip, read_strip
from sim.cantilever.posterior import BendingLength, StripPosterior, direction_posterior
from sim.material import DIRECTIONS
from sim.rig import GRAVITY

BENDING_LENGTH_ERROR = 0.02  # relative standard deviation of one read at 41.5°


@dataclass(frozen=True)
class StripSet:
    """The strips of one fabric.

    Attributes:
        lengths: direction and value of each bending length that was typed in.
        slope: of all clamps below the horizontal.
    """

    density: Density
    photographs: tuple[PhotographedStrip, ...]
    lengths: tuple[tuple[str, BendingLength], ...]
    slope: Radians

    @property
    def curves(self) -> dict[str, list[DeflectionCurve]]:
        """The photographed curves of each direction that has some."""
        return {direction: curves for direction in DIRECTIONS if (curves := [
            strip.measured.curve for strip in self.photographs if strip.direction == direction])}

    @property
    def warnings(self) -> tuple[str, ...]:
        """Those of all photographs, and directions of which only one face was measured."""
        lines = [line for strip in self.photographs for line in strip.warnings]
        for direction in DIRECTIONS:
            faces = [strip.measured.sign for strip in self.photographs
                     if strip.direction == direction]
            faces += [length.sign for name, length in self.lengths if name == direction]
            if len(set(faces)) == 1:
                lines.append(f"{direction}: only one face was measured, and its natural curvature "
                             "is taken as 0; one of 5 1/m, which is usual, changes alpha by "
                             "20 to 60 %, or twofold: hang one of the strips with the other face "
                             "up")
        return tuple(lines)

    def posteriors(self) -> dict[str, StripPosterior]:
        """Posterior of log alpha (N·m) and beta/alpha (m) of each direction that was measured, at
        the density of the fabric; InputError if the strips of one do not fit each other."""
        found = {}
        for direction in DIRECTIONS:
            strips = [strip.measured for strip in self.photographs if strip.direction == direction]
            lengths = [length for name, length in self.lengths if name == direction]
            if not (strips or lengths):
                continue
            try:
                found[direction] = direction_posterior(
                    strips, lengths, weight=self.density * GRAVITY, slope=self.slope)
            except InputError as error:
                raise InputError(f"{direction}: {error}") from None
        return found


def read_strips(folder: str | Path, *, slope: Radians = 0.0) -> StripSet:
    """Read ``strips.yaml`` and the photographs it names; InputError for the first fault."""
    folder = Path(folder)
    description = read_description(folder)
    photographs = tuple(read_strip(folder, entry, description, slope=slope)
                        for entry in description.strips if entry.file)
    return StripSet(description.density, photographs, _lengths(description), slope)


def _lengths(description: StripsDescription) -> tuple[tuple[str, BendingLength], ...]:
    return tuple(
        (entry.direction, BendingLength(1e-3 * entry.bending_length_mm,
                                        1e-3 * entry.bending_length_mm * BENDING_LENGTH_ERROR,
                                        entry.sign))
        for entry in description.strips if entry.bending_length_mm)
