"""Lines that a pen has drawn across a strip, in a picture of its band."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d, uniform_filter1d

from common.types import Metres

STEP = 1e-4  # m, of a band along the strip
COLUMNS = 48  # of a band, across the strip
ACROSS = 0.4  # of the strip's width, on both sides of its middle, in which marks are measured
_PENS = (0.6e-3, 1.2e-3, 2.4e-3)  # m, thicknesses of lines that are looked for
_WAVE = 0.6e-3  # m, by which a line may differ from a straight one, on both sides
_SLOPES = np.linspace(-0.1, 0.1, 11)  # of a line
_SEEN = 0.33  # quantile over the columns, so that two thirds of a line must be seen
_LEAST = 0.12  # of log light, by which a line differs from the cloth on both of its sides
_CLEAR = 0.2  # of the strongest line's strength, at least, of marks
_APART, _MOST = 4e-3, 20  # m, between two lines; number of lines that are looked at
_ALIKE = 0.5  # of log light, by which marks of one pen differ in each colour, or in contrast
_WINDOWS = (1.2e-3, 0.7e-3)  # m, on both sides of a line, in two rounds
_WEAK = 0.3  # of a line's usual contrast, below which a column is left out


@dataclass(frozen=True)
class Line:
    """A line across a band."""

    place: Metres  # along the strip, in its middle
    slope: float  # of the line to the strip's normal
    thickness: Metres  # of the pen, about
    colour: np.ndarray  # (3,) log light of red, green and blue
    contrast: np.ndarray  # (3,) the same over the light beside it
    strength: float  # log light by which two thirds of it differ from both sides


@dataclass(frozen=True)
class Band:
    """A strip, straightened."""

    along: np.ndarray  # (S,) m, a STEP apart
    across: np.ndarray  # (COLUMNS,) m
    logs: np.ndarray  # (S, COLUMNS, 3) logarithm of light

    def lines(self) -> list[Line]:
        """Lines that differ from the cloth on both sides, the strongest first."""
        coarse = len(self.along) // 2
        logs = self.logs[: 2 * coarse].reshape(coarse, 2, COLUMNS, 3).mean(axis=1)
        places, step = self.along[: 2 * coarse : 2] + STEP / 2, 2 * STEP
        found: list[Line] = []
        rows, columns = np.arange(coarse)[:, None], np.arange(COLUMNS)
        best = np.zeros((2, coarse))
        chosen = np.zeros((2, coarse, 2))  # slope and thickness
        for pen in _PENS:
            middle, sides = _contrasts(logs, pen, step)
            for k, differs in enumerate((sides.min(axis=0) - middle, middle - sides.max(axis=0))):
                near = maximum_filter1d(differs, 2 * round(_WAVE / step) + 1, axis=0)
                for slope in _SLOPES:
                    moved = rows + np.rint(slope * self.across / step).astype(int)
                    there = near[moved.clip(0, coarse - 1), columns]
                    seen = np.partition(there, int(_SEEN * COLUMNS), axis=1)[
                        :, int(_SEEN * COLUMNS)].max(axis=1)
                    better = seen > best[k]
                    best[k][better] = seen[better]
                    chosen[k][better] = slope, pen
        left = best.copy()
        while len(found) < _MOST and (peak := left.max()) > _LEAST:
            k, first = (int(one[0]) for one in np.nonzero(left > 0.98 * peak))
            top = np.flatnonzero(left[k] > 0.98 * peak)  # flat, by what a line may wave
            row = int(np.median(top[np.abs(top - first) * step < _APART]))
            slope, pen = chosen[k, row]
            found.append(self._line(places[row], slope, pen, float(peak)))
            # What is beside a bright line is a dark one.
            left[:, np.abs(places - places[row]) < _APART] = 0.0
        return found

    def line_at(self, place: Metres) -> Line | None:
        """The strongest line within :data:`_APART` of a place."""
        near = [line for line in self.lines() if abs(line.place - place) < _APART]
        return near[0] if near else None

    def _line(self, place: Metres, slope: float, pen: Metres, strength: float) -> Line:
        middle, sides = _contrasts(self.logs, pen, STEP)
        rows = np.rint((place + slope * self.across - self.along[0]) / STEP).astype(int)
        at = rows.clip(0, len(self.along) - 1), np.arange(COLUMNS)
        contrast = np.median(middle[at] - sides.mean(axis=0)[at], axis=0)
        colour = np.median(middle[at], axis=0)
        return Line(float(place), float(slope), float(pen), colour, contrast, strength)

    def course(self, line: Line) -> np.ndarray:
        """Places (COLUMNS,) of a line along the strip, m, to a fraction of a pixel; NaN where it is
        not seen."""
        colour = line.contrast / np.linalg.norm(line.contrast)
        values, width = self.logs @ colour, 0.5 * line.thickness / STEP
        sharp = gaussian_filter1d(values, width, axis=0) - gaussian_filter1d(
            values, 2.5 * width, axis=0)
        guess, places = line.place + line.slope * self.across, np.full(COLUMNS, np.nan)
        for window in _WINDOWS:
            places = self._peaks(sharp, guess, round(window / STEP))
            seen = np.isfinite(places)
            if seen.sum() < COLUMNS / 3:
                break
            off = places - guess
            for _ in range(3):  # without columns in which something else is the strongest
                curve = np.polyfit(self.across[seen], off[seen], 2)
                apart = np.abs(off - np.polyval(curve, self.across))
                seen = apart < max(3 * 1.48 * float(np.nanmedian(apart)), STEP)
            guess = guess + np.polyval(curve, self.across)
        return places

    def _peaks(self, sharp: np.ndarray, guess: np.ndarray, window: int) -> np.ndarray:
        rows = np.rint((guess - self.along[0]) / STEP).astype(int)
        near = rows + np.arange(-window, window + 1)[:, None]
        near = near.clip(1, len(self.along) - 2)
        columns = np.arange(COLUMNS)
        row = near[sharp[near, columns].argmax(axis=0), columns]
        low, peak, high = (sharp[row + k, columns] for k in (-1, 0, 1))
        with np.errstate(divide="ignore", invalid="ignore"):
            places = self.along[row] + STEP * (high - low) / (2 * (2 * peak - low - high))
        real = (peak > low) & (peak >= high) & (peak > _WEAK * np.median(peak))
        return np.where(real, places, np.nan)


def _contrasts(logs: np.ndarray, pen: Metres, step: Metres) -> tuple[np.ndarray, np.ndarray]:
    """Log light of (S, C, 3) over a pen's thickness, and (2, S, C, 3) beside it on both sides."""
    middle = uniform_filter1d(logs, max(round(pen / step), 1), axis=0)
    away = round((pen + 4e-4) / step)
    padded = np.pad(middle, ((away, away), (0, 0), (0, 0)), mode="edge")
    return middle, np.stack([padded[: -2 * away], padded[2 * away :]])


def pairs(lines: list[Line], low: Metres, high: Metres) -> list[tuple[Line, Line]]:
    """Pairs of ``lines`` by one pen, ``low`` to ``high`` apart, in their order along the strip;
    lines much weaker than the strongest are none."""
    clear = [line for line in lines if line.strength > _CLEAR * lines[0].strength]
    return [(one, other)
            for one, other in combinations(sorted(clear, key=lambda line: line.place), 2)
            if low <= other.place - one.place <= high and alike(one, other) > 0.1]


def alike(one: Line, other: Line) -> float:
    """How likely two lines are by one pen, 0 to 1: ink that covers has one colour on all colours of
    the cloth, ink that does not has one contrast."""
    off = np.array([one.colour - other.colour, one.contrast - other.contrast]) / _ALIKE
    return float(np.exp(-0.5 * np.square(off).sum(axis=1).min()))
