"""The globalised Newton method of :mod:`sim.solver.newton` for a batch of cloths, each with its own
convexity, line search and ending; those that have ended leave the batch. Saddle points end it."""

from dataclasses import dataclass

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


class _Track:
    """What the method remembers of drapes, arrays (B,): see the attributes in that module."""

    def __init__(self, count: int, level: int) -> None:
        self.level = np.full(count, level)  # index of the convexity
        self.shift, self.wait = np.zeros((2, count), dtype=int)
        self.patience = np.ones(count, dtype=int)
        self.residual, self.step = np.full((2, count), np.inf)
        self.definite = np.zeros(count, dtype=bool)

    def keep(self, chosen: np.ndarray) -> None:
        """Forget all but the ``chosen`` drapes (B,)."""
        for name, value in vars(self).items():
            setattr(self, name, value[chosen])


def minimise(
    potential: BatchedPotential, x: Tensor, n: Tensor, options: NewtonOptions | None = None, *,
    least: int = 0
) -> Outcome:
    """Find local minima near the states; as :func:`sim.solver.newton.minimise`, no failure raises
    an exception or affects another drape. When only ``least`` are left, they are given up."""
    run = Minimisation(potential, x, n, options or NewtonOptions())
    while run.iterate(least):
        pass
    return Outcome(run.end_x, run.end_n, run.results)


class Minimisation:
    """A running minimisation. Its arrays hold the drapes that have not ended, ``live`` (B,)."""

    def __init__(
        self, potential: BatchedPotential, x: Tensor, n: Tensor, options: NewtonOptions
    ) -> None:
        self.potential, self.x, self.n, self.options = potential, x, n, options
        self.end_x, self.end_n = x.clone(), n.clone()
        self.live, self.iterations = np.arange(potential.count), 0
        self.blends = np.array(options.convexities)
        self.last = len(self.blends) - 1
        self.track = _Track(potential.count, self.last)
        unfinished = NewtonResult(np.empty(0), Status.MAX_ITERATIONS, "")
        self.results = [unfinished] * potential.count
        self.value = potential.evaluate(x, n)

    def iterate(self, least: int) -> bool:
        """One iteration of all; False if none is left."""
        track, options = self.track, self.options
        track.residual, energy = _host(torch.stack([
            self._largest(self.value.gradient, "force_scale"), self.value.energy]))
        finite = np.isfinite(track.residual) & np.isfinite(energy)
        over = self.iterations >= options.max_iterations or len(finite) <= least
        if not self._leave({Status.NOT_FINITE: ~finite, Status.MAX_ITERATIONS: finite & over}):
            return False
        small = track.residual < options.residual
        steps, found = self._directions(small)
        slopes = (self.value.gradient * steps).sum(0)
        length, slope = _host(torch.stack([self._largest(steps, "length_scale"), slopes]))
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
        left = self._leave({Status.CONVERGED: converged, Status.SADDLE: small & ~found,
                            Status.SINGULAR: ~small & ~found, Status.LINE_SEARCH: lost})
        self.iterations += 1
        return left

    def _leave(self, ended: dict[Status, np.ndarray]) -> bool:
        """Note the drapes (B,) that have ended by status, and drop them; whether any is left."""
        track, kept = self.track, ~np.any(list(ended.values()), axis=0)
        for status, which in ended.items():
            for k in np.flatnonzero(which):
                result = self.results[self.live[k]] = NewtonResult(
                    np.empty(0), status, "", self.iterations, float(track.residual[k]),
                    float(track.step[k]), bool(track.definite[k]))
                result.end(status)
        if not kept.all():
            gone, stay, where = map(self._index, (~kept, kept, self.live[~kept]))
            self.end_x[..., where], self.end_n[..., where] = self.x[..., gone], self.n[..., gone]
            self.x, self.n = self.x[..., stay], self.n[..., stay]
            self.value, self.potential = self.value.take(stay), self.potential.take(stay)
            self.live = self.live[kept]
            track.keep(kept)
        return len(self.live) > 0

    def _directions(self, small: np.ndarray) -> tuple[Tensor, np.ndarray]:
        """Newton steps (n, B) with the least convexity that has a factor, that of the exact Hessian
        where the residual is ``small``; whether each was found (B,)."""
        track, last = self.track, self.last
        steps, found = torch.zeros_like(self.value.gradient), np.zeros(len(small), dtype=bool)
        patient = (track.wait > 0) | (track.shift > 0)
        lowest = np.where(small, 0, np.where(patient, track.level, np.maximum(track.level - 1, 0)))
        track.wait = np.where(small, track.wait, np.maximum(track.wait - 1, 0))
        trial, pending = lowest.copy(), np.arange(len(small))
        while len(pending):
            shift = np.where(trial == last, np.array(SHIFTS)[track.shift], 0.0)[pending]
            subset, x, n, gradient = self._part(pending, self.x, self.n, self.value.gradient)
            blend, shift = (torch.from_numpy(values).to(x) for values in (
                self.blends[trial[pending]], shift))
            definite = _host(subset.solver.factorise(subset.hessian(x, n, blend, shift)))
            good, bad = pending[definite], pending[~definite]
            steps[:, self._index(good)] = subset.solver.solve(-gradient)[:, self._index(definite)]
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
        value = self.value
        start = self.x, self.n, value.energy, value.angles, value.gradient, steps, slopes
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
        self, chosen: np.ndarray, sizes: np.ndarray, start: tuple[Tensor, ...], *, equal: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Move ``chosen`` drapes (C,) by the first of the ``sizes`` (C, K) of their steps at which
        that is allowed and the energy falls, also below the one that was reached; its index, or -1,
        and whether the energy still falls steeply. With ``equal``, of energies that differ by
        rounding errors only, the smaller gradient is taken."""
        many = np.repeat(chosen, sizes.shape[1])
        subset, x, n, energy, angles, gradient, step, slope, now = self._part(
            many, *start, self.value.energy)
        size = torch.from_numpy(sizes.ravel()).to(x)
        x, n = subset.moved(x, n, size * step)
        new = subset.evaluate(x, n)
        limit, rounding = energy + ARMIJO * size * slope, ROUNDING * subset.energy_scale
        falls = new.energy <= limit if equal else new.energy < torch.minimum(now, limit)
        steep = falls & ((new.gradient * step).sum(0) < STILL_STEEP * slope)
        if equal:
            scale = subset.tensors["force_scale"]
            smaller = (new.gradient / scale).abs().amax(0) < (gradient / scale).abs().amax(0)
            falls |= ((size * slope).abs() < rounding) & (new.energy < energy + rounding) & smaller
        good, steep = _host(torch.stack([
            falls & keeps_distance(angles, new.angles, subset.tensors["pole"]), steep]))
        good = good.reshape(sizes.shape)
        index = np.where(good.any(axis=1), good.argmax(axis=1), -1)
        flat = np.arange(len(chosen)) * sizes.shape[1] + index
        self._accept(chosen[index >= 0], x, n, new, flat[index >= 0])
        return index, steep[flat] & (index >= 0)

    def _accept(
        self, chosen: np.ndarray, x: Tensor, n: Tensor, value: Value, columns: np.ndarray
    ) -> None:
        """Replace the states of ``chosen`` drapes by ``columns``; copies, as searches keep the
        earlier ones."""
        if len(chosen):
            index, columns = self._index(chosen), self._index(columns)
            self.x, self.n = (old.index_copy(-1, index, new[..., columns])
                              for old, new in ((self.x, x), (self.n, n)))
            self.value = self.value.replaced(index, value.take(columns))

    def _part(self, chosen: np.ndarray, *arrays: Tensor) -> tuple:
        """Potential and arrays of the ``chosen`` drapes."""
        if np.array_equal(chosen, np.arange(self.potential.count)):
            return self.potential, *arrays
        index = self._index(chosen)
        return self.potential.take(index), *(array[..., index] for array in arrays)

    def _index(self, chosen: np.ndarray) -> Tensor:
        chosen = np.flatnonzero(chosen) if chosen.dtype == bool else chosen
        return torch.from_numpy(chosen).to(self.x.device)

    def _largest(self, values: Tensor, scale: str) -> Tensor:
        """Largest entries (B,) of values (n, B) in units of a scale."""
        return (values / self.potential.tensors[scale]).abs().amax(0)


def _host(values: Tensor) -> np.ndarray:
    return values.cpu().numpy()
