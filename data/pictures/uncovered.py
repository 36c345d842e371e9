"""The hem of a drape from where the code of the mat behind it is visible, whatever its colour.

Each place is ground, as printed, in the light of a window beside it, or cloth, of the colours near
it or of any; beyond the hem that the network cuts, what hides the code may be a thing. A closed
Markov chain over azimuths weighs them to the border of the cloth and its error. All is done in the
plane of the plate, at equal steps of azimuth and of the logarithm of the radius.

    places of the code (:mod:`data.pictures.shifts`)
    -> print as the camera blurs it (:func:`_levels`) -> how well windows of it fit (:func:`_fit`)
    -> evidence (:func:`_evidence`) -> border (:func:`_border`)
    -> again, with ground and cloth as they were found
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from scipy.ndimage import label, maximum_filter1d, median_filter

from common.types import Metres
from data.pictures.cut import Cut, Printed
from data.pictures.mat import FINE, code_page, mat_pixels
from data.pictures.planes import mapped, on_grid
from data.pictures.reading import Photograph
from data.pictures.shifts import DARKER, FLOOR, MATCH, blurred, sampled_light, shifts_of
from sim.outlines import closed, farthest

STEPS = 1440  # azimuths
_WRAP = 60  # more at both ends
_INSIDE, _OUTSIDE = 0.9, 1.1  # of the radii of plate and reach, looked at
_WIDE, _NARROW = 8.0, 4.5  # pixels, deviations of windows of light
_INNER = 5.5  # the same of ground alone
_TURNS = 2  # times of all
_NEAR = (8.0, 4.5, 2.5)  # pixels, windows of the cloth's colours
_WAYS = [(0.0, 0.0), *((1.6 * np.cos(t), 1.6 * np.sin(t)) for t in np.arange(8) * np.pi / 4)]
"""Windows, of their deviations, beside a place: edges of shadows stay sharp."""
_BLURS = (0.2e-3, 0.7e-3, 1.4e-3)  # m, of which a camera's is a sum
_NOMINAL = np.kron(DARKER, [1, 0, 0]).astype(np.float32)
"""How much darker than paper grey and black are, of each of these blurs."""
_HELD = 1e-4  # of a place's weight, by which these are
_PLACES = 20_000  # of ground, at most, to tell the levels
_ROUNDS = 5  # of weighing them
_DARK = 4e-3  # light of ink, at least
_GLARE = 0.985  # overexposed light
_BLIND = 0.2  # of a window, overexposed
_BESIDE = 3.0  # deviations of the cut, beyond it
_TELLING = 0.3  # mean of evidence there, below which the network's hem stands
_APART_FROM_CUT = 2e-3  # m, of stretches that may not be cloth
_ENDS = 21  # azimuths around them
_ODDER = 1.5  # times of the network's, of their error by shape
_ODD_AT_ALL = 3e-3  # m, the same
_FITS = 0.8  # correlation of sure windows
_NEARLY = 0.06  # less, of those as good
_EVEN = 1 / 1.2  # density of any light
_ODD = 0.03  # its share on ground
_OWN = 0.6  # share of the cloth's colours
_THROUGH = 0.25  # of the print's contrast: less is seen through cloth or a reflection
_UNEVEN = (0.04, 0.06)  # relative, of light on ground and of colours of cloth
_TEMPER = 0.25  # of a pixel's evidence, for neighbours err alike
_HIDDEN = 0.1  # weight of what hides the code apart from cloth
_SURELY = 2.0  # errors of the cut
_GAP_SEEN = 8.0  # of evidence, in a gap between them
_ALIKE = 7  # azimuths in which it is alike
_BEYOND, _NEVER = 1.05, 20.0  # of the flat specimen's reach, beyond which no hem is
_BELIEVED = 0.1  # of deviations from its hem, that count at an azimuth
_MOST = 2.0  # of what counts
_FAINT = 1e-3  # m, added to its error
_APART = 2.0  # in these errors, cloth beyond it is doubtful
_RIM = 0.995  # of the plate's radius
_ON_PLATE = 1.5  # more speaks for cloth within it
_SLOPE = 0.8e-3 / 0.12  # deviation of steps along half a degree, over the radius
_BEND = 1e-3  # deviation of second differences along half a degree, over the radius
_ARM = 9e-3  # m, beyond what folds stand out
_CAUTION = 1.3  # factor of the chain's deviations
_LEAST = 1.5e-4  # m


class Grid(NamedTuple):
    """Places (A, R, 2), m, of the plate's plane, and radii (R,)."""

    places: np.ndarray
    radii: np.ndarray

    @classmethod
    def about(cls, plate: Metres, reach: Metres) -> "Grid":
        """From within the plate's rim to beyond the flat specimen."""
        step = 2 * np.pi / STEPS
        count = int(np.log(_OUTSIDE * reach / (_INSIDE * plate)) / step) + 1
        radii = _INSIDE * plate * np.exp(step * np.arange(count))
        turn = np.arange(-_WRAP, STEPS + _WRAP) * step
        way = np.column_stack([np.cos(turn), np.sin(turn)])
        return cls(way[:, None] * radii[:, None], radii)


class Fit(NamedTuple):
    """How well the code fits a picture at places (A, R): the best correlation of a window beside
    each, the misfit of its light in variances, this light, and the variance."""

    match: np.ndarray
    misfit: np.ndarray
    bright: np.ndarray
    spread: np.ndarray

    def or_better(self, other: "Fit") -> "Fit":
        """At each place the better one."""
        better = other.misfit < self.misfit
        return Fit(np.maximum(self.match, other.match), *(
            np.where(better, *pair) for pair in zip(other[1:], self[1:], strict=True)))


def uncover(
    cut: Cut, photograph: Photograph, to_pixels: np.ndarray, printed: Printed, *, plate: Metres,
    reach: Metres, unlike: Callable[[np.ndarray], np.ndarray]
) -> tuple[Cut, np.ndarray]:
    """The hem of a ``cut`` in a photograph over a mat with the code, read again; and at which
    azimuths (AZIMUTHS,) the code beside it is overexposed.

    Args:
        to_pixels: homography (3, 3) from the plate's plane.
        plate, reach: radii of the plate and of the flat specimen.
        unlike: errors by their shape of radii (AZIMUTHS,), m.
    """
    grid = Grid.about(plate, reach)
    to_plate = np.linalg.inv(to_pixels)
    line = mapped(cut.hem, to_plate)
    pixel = float(np.linalg.norm(np.diff(mapped(np.array([[0, 0], [1, 0.0]]), to_plate), axis=0)))
    turn = np.arange(STEPS) * (2 * np.pi / STEPS)
    error = np.interp(turn, np.arctan2(*line.T[::-1]), pixel * cut.error, period=2 * np.pi)
    by_cut = farthest(closed(line), STEPS)
    unsure = np.hypot(error, _FAINT)
    off = (grid.radii - by_cut[:, None]) / unsure[:, None]
    evidence, doubt, glare = _told(photograph, grid, to_pixels, printed, off, plate, reach)
    told, error = _border(evidence, doubt, grid.radii)
    radii, odd = told, _odd(told, by_cut, unlike)[:, None]
    if odd.any():
        radii, error = _border(np.where(odd, 0, evidence), np.where(odd, np.square(off) / 2, doubt),
                               grid.radii)
    torn = np.maximum(radii - by_cut - _APART * np.hypot(unsure, error), 0) + np.abs(radii - told)
    radii, error = _smoothed(radii, error), np.hypot(_CAUTION * error, _LEAST) + torn / 2
    hem = mapped(radii[:, None] * np.column_stack([np.cos(turn), np.sin(turn)]), to_pixels)
    return replace(cut, hem=hem, error=error / pixel), glare[::2]


def _odd(
    radii: np.ndarray, by_cut: np.ndarray, unlike: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Where (STEPS,) cloth can rather have the network's hem than these radii: an arm or an offcut
    at the hem hides the code, too."""
    apart = np.abs(radii - by_cut) > _APART_FROM_CUT
    stretches, count = label(np.tile(apart, 2))
    here, its = (unlike(one[::2]).repeat(2) for one in (radii, by_cut))
    odd = np.zeros(STEPS, bool)
    for k in range(1, count + 1):
        part = maximum_filter1d((stretches == k).reshape(2, -1).any(axis=0), _ENDS, mode="wrap")
        odd |= part & (here[part].max() > max(_ODDER * its[part].max(), _ODD_AT_ALL))
    return odd


def _told(
    photograph: Photograph, grid: Grid, to_pixels: np.ndarray, printed: Printed, off: np.ndarray,
    plate: Metres, reach: Metres
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Evidence (STEPS, R) for ground, what the network's hem says against each radius, of which
    places are ``off`` (STEPS, R) so many deviations, and where (STEPS,) the code is overexposed."""
    light, blank = photograph.light, photograph.transparent
    blank = blank if photograph.missing is None else blank | photograph.missing
    seen = np.sqrt(sampled_light(light, grid.places, to_pixels) + FLOOR)
    on_mat = on_grid(grid.places, printed.to_mat)
    moved, sure = shifts_of(light.mean(axis=2), to_pixels, printed, 1.15 * grid.radii[-1], on_mat)
    at = mat_pixels(printed.mat, on_mat - moved, FINE)
    pages, plain = code_page(printed.mat)
    shown = cv2.remap(plain.astype(np.float32), *at, cv2.INTER_LINEAR) > 0.99
    shown &= sampled_light(blank.astype(np.float32), grid.places, to_pixels) < 0.01
    prints = np.stack([cv2.remap(blurred(page, blur / FINE), *at, cv2.INTER_LINEAR)
                       for page in pages for blur in _BLURS], axis=-1)
    glaring = seen.max(axis=2) > np.sqrt(_GLARE)
    usable = shown & ~glaring
    everywhere, ground = usable.astype(np.float32), (usable & sure).astype(np.float32)
    grey = np.square(_grey(seen))
    levels = _levels(grey, prints, ground, _NOMINAL)
    expected = np.sqrt(_printed(prints, levels))
    narrow = _fit(seen, expected, everywhere, _NARROW)
    blind = (blurred(glaring.astype(np.float32), _NARROW) > _BLIND) & (narrow.match < MATCH)
    shown &= ~blind
    beside = (off > 0) & (off < _BESIDE)
    count = np.maximum(beside.sum(axis=1), 1)
    glare = (beside & blind[_WRAP:-_WRAP]).sum(axis=1) > count / 2
    beyond = np.pad(off > _SURELY, [(_WRAP, _WRAP), (0, 0)], mode="wrap")
    cloth = None
    for turn in range(_TURNS):
        if turn:
            expected = np.sqrt(_printed(prints, _levels(grey, prints, ground, levels)))
        best = narrow.or_better(_fit(seen, expected, *((ground, _INNER) if turn else
                                                       (everywhere, _WIDE))))
        evidence = np.where(shown, _evidence(seen, best, cloth), 0)
        # What hides the code beyond a gap in which it is seen, and beyond the cut, is no cloth.
        seen_from = np.cumsum(cv2.blur(evidence, (1, _ALIKE)), axis=1)
        gap = seen_from - np.minimum.accumulate(seen_from, axis=1) > _GAP_SEEN
        apart = np.maximum.accumulate(gap, axis=1) & beyond & (evidence < 0)
        evidence = np.where(apart, _HIDDEN * evidence, evidence)
        evidence[:, grid.radii < _RIM * plate] -= _ON_PLATE
        evidence[:, grid.radii > _BEYOND * reach] = _NEVER
        told = (beside * np.abs(evidence[_WRAP:-_WRAP])).sum(axis=1) > _TELLING * count
        doubt = np.where(told[:, None], np.minimum(_BELIEVED * np.abs(off), _MOST),
                         np.square(off) / 2)
        if turn < _TURNS - 1:
            radii, _ = _border(evidence[_WRAP:-_WRAP], doubt, grid.radii)
            border = np.minimum(radii, median_filter(radii, 61, mode="wrap") + _ARM)
            border = np.pad(border, _WRAP, mode="wrap")[:, None]
            cloth = (grid.radii < border - 5e-4).astype(np.float32)
            ground = (usable & (best.match > _FITS) & (
                evidence > np.where(grid.radii > border, -3, 0.5))).astype(np.float32)
    return evidence[_WRAP:-_WRAP], doubt, glare


def _smoothed(radii: np.ndarray, error: np.ndarray) -> np.ndarray:
    """The likeliest hem (STEPS,), m, that bends like cloth."""
    unit = np.eye(STEPS // 2)
    second = np.roll(unit, 1, 1) - 2 * unit + np.roll(unit, -1, 1)
    halves, errors = (one.reshape(-1, 2).mean(axis=1) for one in (radii, error))
    weight = 1 / np.square(errors)
    found = np.linalg.solve(np.diag(weight) + second.T @ second / (_BEND * radii.mean()) ** 2,
                            weight * halves)
    return np.interp(np.arange(STEPS) / 2, np.arange(STEPS // 2) + 0.25, found, period=STEPS // 2)


def _grey(values: np.ndarray) -> np.ndarray:
    """Means over colours."""
    return cv2.transform(values, np.full((1, 3), 1 / 3))


def _printed(prints: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """Light of the ground over that of paper."""
    return np.maximum(1 - prints @ levels, _DARK)


def _levels(light: np.ndarray, prints: np.ndarray, ground: np.ndarray, levels: np.ndarray
            ) -> np.ndarray:
    """How much darker than paper the print is, of each blur, by least squares over ``ground``."""
    expected = _printed(prints, levels)
    paper = blurred(light * ground * expected, 2 * _WIDE) / np.maximum(
        blurred(expected**2 * ground, 2 * _WIDE), 1e-6)
    rows, columns = np.nonzero((ground > 0) & (paper > 0.01))
    chosen = np.random.default_rng(0).permutation(len(rows))[:_PLACES]
    rows, columns = rows[chosen], columns[chosen]
    design = prints[rows, columns].astype(float)
    goal = 1 - light[rows, columns] / paper[rows, columns]
    held = _HELD * max(len(goal), 1)
    for _ in range(_ROUNDS if len(goal) else 0):
        off = goal - design @ levels
        weighted = design / (1 + np.square(off / (1.5 * np.median(np.abs(off)) + 1e-6)))[:, None]
        levels = np.linalg.solve(weighted.T @ design + held * np.eye(len(_NOMINAL)),
                                 weighted.T @ goal + held * _NOMINAL)
    return levels.astype(np.float32)


def _fit(seen: np.ndarray, expected: np.ndarray, weight: np.ndarray, sigma: float) -> Fit:
    """Each place as ground in the light of a window beside it, told where ``weight`` is."""
    total = np.maximum(blurred(weight, sigma), 1e-4)
    times = np.dstack([weight * expected, weight * expected**2])
    mean, square = np.moveaxis(blurred(times, sigma) / total[..., None], 2, 0)
    part = weight[..., None] * seen
    light, lights, mixed = (blurred(one, sigma) / total[..., None] for one in (
        part, part * seen, part * expected[..., None]))
    gain = mixed / np.maximum(square, 1e-4)[..., None]
    left = np.maximum(lights - gain * mixed, 0)
    varied = 3 * _grey(np.maximum(lights - light**2, 0))
    contrast = np.maximum(square - mean**2, 1e-4)
    common = 3 * _grey(mixed - mean[..., None] * light)
    match = common / np.sqrt(np.maximum(3 * varied * contrast, 1e-12))
    share = common / np.maximum(3 * contrast * _grey(gain), 1e-6)
    match -= 0.5 * (total < 0.15) + (np.abs(share - 1) > _THROUGH)
    sure = (match > 0.9) & (_grey(gain) > 0.1)
    rough = np.median((left / np.maximum(gain, 1e-3) ** 2)[sure]) if sure.any() else 0.01
    spread = np.minimum(left, 2.5 * (rough * gain**2 + 2e-5)) + (_UNEVEN[0] * gain) ** 2 + 1e-6
    ways = [(round(sigma * down), round(sigma * along)) for down, along in _WAYS]
    most = max(max(map(abs, way)) for way in ways)

    def beside(values: np.ndarray) -> list[np.ndarray]:
        """Values (A, R, ...) of the windows, by way."""
        wide = cv2.copyMakeBorder(values, most, most, most, most, cv2.BORDER_REPLICATE)
        return [wide[most - down :, most - along :][: len(values), : values.shape[1]]
                for down, along in ways]

    near = beside(match)
    found = Fit(np.max(near, axis=0), *(np.full(match.shape, value, np.float32)
                                        for value in (99, 1, 1)))
    least = np.clip(found.match - _NEARLY, MATCH, _FITS)
    gray, wide = map(_grey, (gain, spread))
    for fits, light, varying, *theirs in zip(near, beside(gain), beside(1 / spread), beside(gray),
                                             beside(wide), strict=True):
        off = seen - np.minimum(light * expected[..., None], 1)
        off *= off * varying
        misfit = _grey(off)
        better = (fits > least) & (misfit < found.misfit)
        for mine, its in zip(found[1:], (misfit, *theirs), strict=True):
            np.copyto(mine, its, where=better)
    return found


def _evidence(seen: np.ndarray, fit: Fit, cloth: np.ndarray | None) -> np.ndarray:
    """Logarithm (A, R) of how much likelier than cloth each place is ground."""
    even = _EVEN / np.maximum(fit.bright, 5e-3)
    ground = _ODD * even + (1 - _ODD) * (fit.match > MATCH) * np.exp(-0.5 * fit.misfit) / np.sqrt(
        2 * np.pi * fit.spread)
    other = even
    if cloth is not None:
        own = np.zeros_like(even)
        for sigma in _NEAR:
            near = blurred(cloth, sigma)[..., None]
            mean, square = (blurred(cloth[..., None] * one, sigma) / np.maximum(near, 1e-4)
                            for one in (seen, seen**2))
            wide = np.maximum(square - mean**2, 0) + (_UNEVEN[1] * mean) ** 2 + 2e-5
            own = np.maximum(own, (near[..., 0] > 1e-2) * np.exp(-0.5 * _grey(np.square(
                seen - mean) / wide)) / np.sqrt(2 * np.pi * _grey(wide)))
        other = _OWN * own + (1 - _OWN) * even
    return np.log(ground / other).astype(np.float32)


def _border(evidence: np.ndarray, doubt: np.ndarray, radii: np.ndarray
            ) -> tuple[np.ndarray, np.ndarray]:
    """Mean and deviation (STEPS,), m, of the radii at which cloth ends, as of a closed Markov
    chain over azimuths of half a degree: of ``evidence`` (STEPS, R) and the ``doubt`` of each."""
    count, step = STEPS // 2, np.log(radii[1] / radii[0])
    cost = _TEMPER * np.cumsum(evidence.reshape(count, 2, -1).sum(axis=1), axis=1) + doubt[::2]
    like = np.exp(-np.minimum(cost - cost.min(axis=1, keepdims=True), 80)).astype(np.float32)
    index = np.arange(len(radii))
    jumps = np.exp(-0.5 * np.square((index[:, None] - index) * step / _SLOPE)).astype(np.float32)
    order = np.arange(-count // 4, count + count // 4) % count  # closed: the last visit counts

    def swept(order: np.ndarray) -> np.ndarray:
        state, found = np.full(len(radii), 1 / len(radii), np.float32), np.empty_like(like)
        for k in order:
            state = state @ jumps + 1e-30
            found[k] = state = state / state.sum()
            state = state * like[k]
            state /= state.sum() + 1e-30
        return found

    both = swept(order).astype(float) * swept(order[::-1]) * like
    both /= both.sum(axis=1, keepdims=True)
    logs = np.log(radii) + step / 2
    mean = both @ logs
    spread = np.exp(mean) * np.sqrt(np.maximum(both @ logs**2 - mean**2, 0))
    turn, middle = np.arange(STEPS) / 2, np.arange(count) + 0.25
    return (np.interp(turn, middle, np.exp(mean), period=count),
            np.interp(turn, middle, spread, period=count))
