"""The globalised Newton method of :mod:`sim.solver.newton` for a batch of cloths, each with its own
convexity, line search and ending. Saddle points end it.

Steps are taken in lock by the drapes in a number of slots; one that has ended leaves its slot to
the next that waits.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from sim.batched.laws import keeps_distance
from sim.batched.potential import BatchedPotential, Value
from sim.solver.newton import (
    ARMIJO,
    MAX_PATIENCE,
    MIN_STEP_FACTOR,
    ROUNDING,
    SHIFTS,
    STILL_STEEP,
    NewtonOptions,
    NewtonResult,
    Status,
)

_TRIALS = 4  # step lengths tried at once, each half of the one before, if
_FEW = 32  # drapes at most still search: so few cost no more


@dataclass
class Outcome:
    """States of a batch after a minimisation, and the result (B,) of each, without its state; the
    ``origin`` (3, T, B) of the hysteresis, if there is any."""

    x: Tensor
    n: Tensor
    results: list[NewtonResult]
    origin: Tensor | None = None


Resume = Callable[[np.ndarray, Outcome], np.ndarray]
"""Of the numbers (K,) of drapes that have ended, and how they have: whether each goes on from there
as if it began, in a potential that the function may have changed for it."""


_TRACK = np.dtype([("level", int), ("shift", int), ("wait", int), ("patience", int),
                   ("iterations", int), ("residual", float), ("step", float), ("definite", bool)])
"""What the method remembers of a drape: see that module; the level is the convexity's index."""


def minimise(
    potential: BatchedPotential, x: Tensor, n: Tensor, options: NewtonOptions | None = None, *,
    slots: int | None = None, resume: Resume | None = None
) -> Outcome:
    """Find local minima near the states, as :func:`sim.solver.newton.minimise`, of as many at once
    as there are ``slots`` (None: all). No failure raises an exception or affects another drape."""
    run = Minimisation(potential, x, n, options or NewtonOptions(), slots=slots, resume=resume)
    while run.iterate():
        pass
    return Outcome(run.x, run.n, run.results)


class Minimisation:
    """A running minimisation of N drapes: their ``results``, and states ``x`` and ``n``, the starts
    of those ``waiting``. The other arrays hold the drapes in the B slots, ``live`` (B,)."""

    def __init__(
        self, potential: BatchedPotential, x: Tensor, n: Tensor, options: NewtonOptions, *,
        slots: int | None = None, resume: Resume | None = None
    ) -> None:
        self.whole, self.options, self.resume = potential, options, resume
        self.x, self.n, count = x.clone(), n.clone(), potential.count
        self.results = [NewtonResult(np.empty(0), Status.MAX_ITERATIONS, "")] * count
        self.blends, self.last = np.array(options.convexities), len(options.convexities) - 1
        self.live, self.waiting = np.split(np.arange(count), [slots or count])
        self.track, self.now = self._begun(self.live)
        self.potential = potential.take(self._index(self.live))

    def iterate(self) -> bool:
        """One iteration of all in slots; False if none is left."""
        options, checked = self.options, False
        while not checked:  # those that enter are checked, too
            track = self.track
            track.residual, energy = torch.stack([
                self._largest(self.now.gradient, "force_scale"), self.now.energy]).cpu().numpy()
            finite = np.isfinite(track.residual) & np.isfinite(energy)
            over = finite & (track.iterations >= options.max_iterations)
            checked = bool((finite & ~over).all())
            if not self._leave({Status.NOT_FINITE: ~finite, Status.MAX_ITERATIONS: over}):
                return False
        small = track.residual < options.residual
        steps, found = self._directions(small)
        slopes = (self.now.gradient * steps).sum(0)
        length, slope = torch.stack([self._largest(steps, "length_scale"), slopes]).cpu().numpy()
        track.definite = small & found
        track.step = np.where(track.definite, length, track.step)
        track.level[track.definite] = 0
        converged = track.definite & (length < options.step)
        factor = self._search(np.flatnonzero(found & ~converged & (slope < 0)), steps, slopes)
        improved = factor > 0
        track.step = np.where(improved, factor * length, track.step)
        track.shift[improved] = 0
        # The step of a nearly singular model leaves the range in which the model is valid.
        stuck, stiffest = found & ~converged & ~improved, track.level == self.last
        lost = stuck & (small | (stiffest & (track.shift == len(SHIFTS) - 1)))
        track.shift[stuck & stiffest & ~lost] += 1
        track.level[stuck], track.wait[stuck] = self.last, 1
        track.iterations += ~(converged | ~found | lost)
        return self._leave({Status.CONVERGED: converged, Status.SADDLE: small & ~found,
                            Status.SINGULAR: ~small & ~found, Status.LINE_SEARCH: lost})

    def _leave(self, ended: dict[Status, np.ndarray]) -> bool:
        """Note the drapes (B,) that have ended by status, and fill or drop their slots; whether any
        is left."""
        track, gone = self.track, np.flatnonzero(np.any(list(ended.values()), axis=0))
        if not len(gone):
            return True
        for status, which in ended.items():
            for k in np.flatnonzero(which):
                result = self.results[self.live[k]] = NewtonResult(
                    np.empty(0), status, "", int(track.iterations[k]), float(track.residual[k]),
                    float(track.step[k]), bool(track.definite[k]))
                result.end(status)
        left, last = self.live[gone], self.now[..., self._index(gone)]
        self.x[..., self._index(left)], self.n[..., self._index(left)] = last.x, last.n
        if self.resume:
            again = self.resume(left, Outcome(last.x, last.n, [self.results[k] for k in left]))
            self.waiting = np.concatenate([left[again], self.waiting])
        enter, self.waiting = np.split(self.waiting, [len(gone)])
        filled, dropped = np.split(gone, [len(enter)])
        if len(enter):
            track[filled], begun = self._begun(enter)
            self.now = self.now.replaced(self._index(filled), begun)
            self.live[filled] = enter
        if len(dropped):
            kept = np.delete(np.arange(len(self.live)), dropped)
            self.live, self.track = self.live[kept], track[kept]
            self.now = self.now[..., self._index(kept)]
        self.potential = self.whole.take(self._index(self.live))
        return len(self.live) > 0

    def _begun(self, drapes: np.ndarray) -> tuple[Any, Value]:
        """What is remembered of ``drapes`` (B,) that begin, and their start."""
        track, index = np.zeros(len(drapes), _TRACK).view(np.recarray), self._index(drapes)
        track.level, track.patience, track.residual, track.step = self.last, 1, np.inf, np.inf
        return track, self.whole.take(index).evaluate(self.x[..., index], self.n[..., index])

    def _directions(self, small: np.ndarray) -> tuple[Tensor, np.ndarray]:
        """Newton steps (n, B) with the least convexity that has a factor, that of the exact Hessian
        where the residual is ``small``; whether each was found (B,)."""
        track, last = self.track, self.last
        steps, found = torch.zeros_like(self.now.gradient), np.zeros(len(small), dtype=bool)
        patient = (track.wait > 0) | (track.shift > 0)
        lowest = np.where(small, 0, np.where(patient, track.level, np.maximum(track.level - 1, 0)))
        track.wait = np.where(small, track.wait, np.maximum(track.wait - 1, 0))
        trial, pending = lowest.copy(), np.arange(len(small))
        while len(pending):
            shift = np.where(trial == last, np.array(SHIFTS)[track.shift], 0.0)[pending]
            subset, now = self._part(pending, self.now)
            blend, shift = (torch.from_numpy(values).to(now.x) for values in (
                self.blends[trial[pending]], shift))
            sound = subset.solver.factorise(subset.hessian(now.x, now.n, blend, shift))
            definite = sound.cpu().numpy()
            good, bad = pending[definite], pending[~definite]
            steps[:, self._index(good)] = subset.solver.solve(-now.gradient)[:, sound]
            found[good] = True
            bad = bad[~small[bad] & ((trial[bad] < last) | (track.shift[bad] < len(SHIFTS) - 1))]
            track.shift[bad[trial[bad] == last]] += 1
            trial[bad] = np.minimum(trial[bad] + 1, last)
            pending = bad
        kept, tried = trial == track.level, lowest < track.level
        again = ~small & kept & tried
        track.wait = np.where(again, track.patience, track.wait)
        track.patience = np.where(again, np.minimum(2 * track.patience, MAX_PATIENCE),
                                  np.where(small | kept, track.patience, 1))
        track.level = np.where(small, track.level, trial)
        return steps, found

    def _search(self, pending: np.ndarray, steps: Tensor, slopes: Tensor) -> np.ndarray:
        """Line searches of ``pending`` drapes along steps with negative slopes (B,); the lengths
        (B,) by which they are moved, 0: none."""
        start = self.now, steps, slopes
        factor, length = np.zeros(len(slopes)), np.ones(len(slopes))
        steep, trials = np.zeros(len(slopes), dtype=bool), 1
        while len(pending):
            sizes = length[pending, None] / 2.0 ** np.arange(trials)
            index, more = self._try(pending, sizes, start, equal=True)
            good = index >= 0
            taken = pending[good]
            factor[taken], steep[taken] = sizes[good, index[good]], more[good]
            pending = pending[~good]
            length[pending] /= 2**trials
            pending = pending[length[pending] > MIN_STEP_FACTOR]
            trials = _TRIALS if len(pending) <= _FEW else 1
        # Where the energy falls along the step as steeply as before, the step is too short.
        pending = np.flatnonzero(steep & (factor >= 1.0)) if self.options.extend else pending
        while len(pending):
            index, more = self._try(pending, 2 * factor[pending, None], start, equal=False)
            factor[pending[index == 0]] *= 2
            pending = pending[(index == 0) & more]
        return factor

    def _try(
        self, chosen: np.ndarray, sizes: np.ndarray, start: tuple[Value, Tensor, Tensor], *,
        equal: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Move ``chosen`` drapes (C,) by the first of the ``sizes`` (C, K) of their steps at which
        that is allowed and the energy falls, also below the one that was reached; its index, or -1,
        and whether the energy still falls steeply. With ``equal``, of energies that differ by
        rounding errors only, the smaller gradient is taken."""
        many = np.repeat(chosen, sizes.shape[1])
        subset, old, step, slope, now = self._part(many, *start, self.now.energy)
        size = torch.from_numpy(sizes.ravel()).to(step)
        new = subset.evaluate(*subset.moved(old.x, old.n, size * step))
        limit, rounding = old.energy + ARMIJO * size * slope, ROUNDING * subset.energy_scale
        falls = new.energy <= limit if equal else new.energy < torch.minimum(now, limit)
        steep = falls & ((new.gradient * step).sum(0) < STILL_STEEP * slope)
        if equal:
            scale = subset.tensors["force_scale"]
            smaller = (new.gradient / scale).abs().amax(0) < (old.gradient / scale).abs().amax(0)
            near = ((size * slope).abs() < rounding) & (new.energy < old.energy + rounding)
            falls |= near & smaller
        falls &= keeps_distance(old.angles, new.angles, subset.tensors["pole"])
        good, steep = torch.stack([falls, steep]).cpu().numpy()
        good = good.reshape(sizes.shape)
        index = np.where(good.any(axis=1), good.argmax(axis=1), -1)
        flat = np.arange(len(chosen)) * sizes.shape[1] + index
        self.now = self.now.replaced(self._index(chosen[index >= 0]),
                                     new[..., self._index(flat[index >= 0])])
        return index, steep[flat] & (index >= 0)

    def _part(self, chosen: np.ndarray, *arrays: Tensor | Value) -> tuple:
        """Potential and arrays of the ``chosen`` drapes."""
        if np.array_equal(chosen, np.arange(self.potential.count)):
            return self.potential, *arrays
        index = self._index(chosen)
        return self.potential.take(index), *(array[..., index] for array in arrays)

    def _index(self, chosen: np.ndarray) -> Tensor:
        return torch.from_numpy(chosen).to(self.x.device)

    def _largest(self, values: Tensor, scale: str) -> Tensor:
        """Largest entries (B,) of values (n, B) in units of a scale."""
        return (values / self.potential.tensors[scale]).abs().amax(0)
