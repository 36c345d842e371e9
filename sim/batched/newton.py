"""The globalised Newton method of :mod:`sim.solver.newton` for a batch of cloths, each with its own
convexity, line search and ending; those that have ended leave the batch."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from sim.batched.laws import keeps_distance
from sim.batched.potential import BatchedPotential, Value
from sim.solver.newton import (
    _ENDINGS,
    ARMIJO,
    MAX_PATIENCE,
    MAX_PERTURBATIONS,
    MIN_STEP_FACTOR,
    PERTURBATION,
    PERTURBATION_GROWTH,
    PERTURBATION_HALVINGS,
    ROUNDING,
    SHIFTS,
    STILL_STEEP,
    NewtonOptions,
    NewtonResult,
    Status,
)


@dataclass
class Outcome:
    """States of a batch after a minimisation, and the result (B,) of each, without its state."""

    x: Tensor
    n: Tensor
    results: list[NewtonResult]


class _Track:
    """What the method remembers of drapes, arrays (B,): see the attributes in that module."""

    def __init__(self, count: int, level: int) -> None:
        self.level = np.full(count, level)  # index of the convexity
        self.shift, self.wait, self.perturbations = np.zeros((3, count), dtype=int)
        self.patience = np.ones(count, dtype=int)
        self.residual, self.step = np.full((2, count), np.inf)
        self.definite = np.zeros(count, dtype=bool)

    def keep(self, chosen: np.ndarray) -> None:
        """Forget all but the ``chosen`` drapes (B,)."""
        for name, value in vars(self).items():
            setattr(self, name, value[chosen])


def minimise(
    potential: BatchedPotential, x: Tensor, n: Tensor, options: NewtonOptions | None = None
) -> Outcome:
    """Find local minima near the states; as :func:`sim.solver.newton.minimise`, no failure raises
    an exception or affects another drape."""
    run = _Minimisation(potential, x.clone(), n.clone(), options or NewtonOptions())
    while run.iterate():
        pass
    return Outcome(run.end_x, run.end_n, run.results)


class _Minimisation:
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
        self.results: list[NewtonResult | None] = [None] * potential.count
        self.value = potential.evaluate(x, n)
        self.rng = [np.random.default_rng(0) for _ in self.live]

    def iterate(self) -> bool:
        """One iteration of all; False if none is left."""
        track, options = self.track, self.options
        track.residual = _host(self._largest(self.value.gradient, "force_scale"))
        if self.iterations >= options.max_iterations:
            return self._leave({Status.MAX_ITERATIONS: track.residual < np.inf,
                                Status.NOT_FINITE: ~(track.residual < np.inf)})
        finite = np.isfinite(track.residual) & _host(self.value.energy.isfinite())
        if not self._leave({Status.NOT_FINITE: ~finite}):
            return False
        small = track.residual < options.residual
        steps, found = self._directions(small)
        length = _host(self._largest(steps, "length_scale"))
        proven = small & found
        track.definite = proven
        track.step = np.where(proven, length, track.step)
        track.level[proven] = 0
        converged, saddle = proven & (length < options.step), small & ~found
        hopeless = saddle & (track.perturbations >= MAX_PERTURBATIONS)
        if (saddle & ~hopeless).any():
            self._perturb(np.flatnonzero(saddle & ~hopeless))
        factor = self._search(np.flatnonzero(found & ~converged), steps)
        improved = factor > 0
        track.step = np.where(improved, factor * length, track.step)
        track.shift[improved] = 0
        # The step of a nearly singular model leaves the range in which the model is valid.
        stuck, stiffest = found & ~converged & ~improved, track.level == self.last
        lost = stuck & (small | (stiffest & (track.shift == len(SHIFTS) - 1)))
        track.shift[stuck & stiffest & ~lost] += 1
        track.level[stuck], track.wait[stuck] = self.last, 1
        over = {Status.CONVERGED: converged, Status.SADDLE: hopeless,
                Status.SINGULAR: ~small & ~found}
        self._leave(over)
        lost = lost[~np.any(list(over.values()), axis=0)]
        self.iterations += 1
        return self._leave({Status.LINE_SEARCH: lost})

    def _leave(self, ended: dict[Status, np.ndarray]) -> bool:
        """Note the drapes (B,) that have ended by status, and drop them; whether any is left."""
        track, kept = self.track, ~np.any(list(ended.values()), axis=0)
        if kept.all():
            return len(kept) > 0
        for status, which in ended.items():
            for k in np.flatnonzero(which):
                result = NewtonResult(
                    np.empty(0), status, "", self.iterations, float(track.residual[k]),
                    float(track.step[k]), bool(track.definite[k]))
                result.message = _ENDINGS[status].format(**vars(result))
                self.results[self.live[k]] = result
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
            definite, solved = self._solved(
                pending, self.blends[trial[pending]], shift, -self.value.gradient)
            good, bad = pending[definite], pending[~definite]
            steps[:, self._index(good)] = solved[:, self._index(definite)]
            found[good] = True
            bad = bad[~small[bad] & ((trial[bad] < last) | (track.shift[bad] < len(SHIFTS) - 1))]
            track.shift[bad[trial[bad] == last]] += 1
            trial[bad] = np.minimum(trial[bad] + 1, last)
            pending = bad
        kept = ~small & (trial == track.level)
        tried = kept & (lowest < track.level)
        track.wait = np.where(tried, track.patience, track.wait)
        track.patience = np.where(tried, np.minimum(2 * track.patience, MAX_PATIENCE), np.where(
            ~small & ~kept, 1, track.patience))
        track.level = np.where(small, track.level, trial)
        return steps, found

    def _solved(
        self, chosen: np.ndarray, convexity: np.ndarray, shift: np.ndarray, rhs: Tensor
    ) -> tuple[np.ndarray, Tensor]:
        """Which of the Hessians of ``chosen`` drapes are definite, and the solutions."""
        part, x, n, rhs = self._part(chosen, self.x, self.n, rhs)
        blend, shift = (torch.from_numpy(one).to(x) for one in (convexity, shift))
        definite = part.solver.factorise(part.hessian(x, n, blend, shift))
        return _host(definite), part.solver.solve(rhs)

    def _search(self, chosen: np.ndarray, steps: Tensor) -> np.ndarray:
        """Line searches of the ``chosen`` drapes, which are moved; their lengths (B,), 0: none."""
        value = self.value
        slope = (value.gradient * steps).sum(0)
        start = self.x, self.n, value.energy, value.angles, value.gradient, steps, slope
        factor, length = np.zeros(len(slope)), np.ones(len(slope))
        pending, steep = chosen[_host(slope)[chosen] < 0], np.zeros(len(slope), dtype=bool)
        while len(pending):
            good, more = self._try(pending, length[pending], start, equal=True)
            taken = pending[good]
            factor[taken], steep[taken] = length[taken], more[good]
            pending = pending[~good]
            length[pending] /= 2
            pending = pending[length[pending] > MIN_STEP_FACTOR]
        # Where the energy falls along the step as steeply as before, the step is too short.
        pending = np.flatnonzero(steep & (factor >= 1.0)) if self.options.extend else pending
        while len(pending):
            good, more = self._try(pending, 2 * factor[pending], start, equal=False)
            factor[pending[good]] *= 2
            pending = pending[good & more]
        return factor

    def _try(
        self, chosen: np.ndarray, length: np.ndarray, start: tuple[Tensor, ...], *, equal: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Move ``chosen`` drapes by a ``length`` (B,) of their steps where that is allowed and
        their energies fall, also below those that were reached; whether it was, and whether they
        still fall steeply. With ``equal``, of equal energies the smaller gradients are taken."""
        now = self.value.energy
        part, x, n, energy, angles, gradient, step, slope, now = self._part(chosen, *start, now)
        size = torch.from_numpy(length).to(x)
        x, n = part.moved(x, n, size * step)
        new = part.evaluate(x, n)
        least, scale = energy + ARMIJO * size * slope, part.own["force_scale"]
        rounding = ROUNDING * part.energy_scale
        falls = new.energy <= least if equal else new.energy < torch.minimum(now, least)
        steep = falls & ((new.gradient * step).sum(0) < STILL_STEEP * slope)
        if equal:
            same = ((size * slope).abs() < rounding) & (new.energy < energy + rounding)
            smaller = (new.gradient / scale).abs().amax(0) < (gradient / scale).abs().amax(0)
            falls |= same & smaller
        good = falls & keeps_distance(angles, new.angles, part.own["pole"])
        good, steep = _host(good), _host(steep)
        taken = self._index(good)
        self._accept(chosen[good], x[..., taken], n[..., taken], new.take(taken))
        return good, steep

    def _accept(self, chosen: np.ndarray, x: Tensor, n: Tensor, value: Value) -> None:
        """Replace the states of ``chosen`` drapes; copies, as searches keep the earlier ones."""
        if len(chosen) == self.potential.count:
            self.x, self.n, self.value = x, n, value
        elif len(chosen):
            index = self._index(chosen)
            self.x, self.n = (old.index_copy(-1, index, new)
                              for old, new in ((self.x, x), (self.n, n)))
            self.value = self.value.replaced(index, value)

    def _perturb(self, chosen: np.ndarray) -> None:
        """Random states near saddles, as :meth:`sim.solver.newton._Minimisation._perturbed`."""
        draws = np.zeros(self.value.gradient.shape)
        for k in chosen:
            draws[:, k] = self.rng[self.live[k]].standard_normal(len(draws))
        ones = np.ones(len(chosen))
        definite, move = self._solved(chosen, ones, SHIFTS[1] * ones, torch.from_numpy(draws).to(
            self.x))
        part, x, n, angles = self._part(chosen, self.x, self.n, self.value.angles)
        size = (move / part.own["length_scale"]).abs().amax(0)
        growth = PERTURBATION_GROWTH ** self.track.perturbations[chosen].astype(float)
        move = move * PERTURBATION * torch.from_numpy(growth).to(x) / size
        pending = torch.from_numpy(definite).to(x.device)
        there = x.clone(), n.clone()
        for _ in range(PERTURBATION_HALVINGS):
            new = part.moved(x, n, move)
            good = pending & keeps_distance(
                angles, part.evaluate(*new).angles, part.own["pole"])
            there = tuple(torch.where(good, fresh, old) for old, fresh in zip(
                there, new, strict=True))
            pending, move = pending & ~good, move / 2
            if not pending.any():
                break
        self._accept(chosen, *there, part.evaluate(*there))
        self.track.perturbations[chosen] += 1
        self.track.level[chosen] = self.last

    def _part(self, chosen: np.ndarray, *arrays: Tensor) -> tuple:
        """Potential and arrays of the ``chosen`` drapes."""
        if len(chosen) == self.potential.count:
            return self.potential, *arrays
        index = self._index(chosen)
        return self.potential.take(index), *(array[..., index] for array in arrays)

    def _index(self, chosen: np.ndarray) -> Tensor:
        chosen = np.flatnonzero(chosen) if chosen.dtype == bool else chosen
        return torch.from_numpy(chosen).to(self.x.device)

    def _largest(self, values: Tensor, scale: str) -> Tensor:
        """Largest entries (B,) of values (n, B) in units of a scale."""
        return (values / self.potential.own[scale]).abs().amax(0)


def _host(values: Tensor) -> np.ndarray:
    return values.cpu().numpy()
