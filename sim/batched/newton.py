"""The minimisation of :mod:`sim.newton` for many samples at once.

Every sample takes its own decisions: how convex its Hessian must be, how far its step goes, when it
has arrived. Together they share the calls that evaluate, factorise and solve. No sample's numbers
meet another's, so that neighbours, failing ones too, change its result by rounding at most.

Numbers of a whole sample, (B, n) and longer, stay on the objective's device. One number a sample
comes back to the host, where the decisions are taken.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import torch

from sim.batched.line_search import LineSearch
from sim.batched.objective import (
    BatchedObjective,
    BatchedSolver,
    Hessians,
    on_device,
    on_host,
    part_of,
)
from sim.linear import SparsePattern
from sim.newton import (
    CONVEXITY,
    NUDGE,
    NUDGE_GROWTH,
    NUDGE_HALVINGS,
    NUDGES,
    SHIFTS,
    NewtonOptions,
    NewtonResult,
    Status,
    ending,
)

_FULL = len(CONVEXITY) - 1
_LAST = len(SHIFTS) - 1


def minimise_batch(
    objective: BatchedObjective,
    start: torch.Tensor,
    options: NewtonOptions | None = None,
    *,
    make_solver: Callable[[SparsePattern], BatchedSolver],
) -> list[NewtonResult]:
    """Find a local minimum of each function near ``start`` (B, n), as :func:`sim.newton.minimise`.

    Samples that have ended leave the batch. Never raises for a numerical failure.

    Args:
        objective: the functions.
        start: float64 on the objective's device.
        options: of every sample; the linear solver they name is not used.
        make_solver: makes the solver of the Newton systems of one pattern.

    Returns:
        A result a sample, its ``y`` on the host; ``seconds`` is wall time, of which everything
        done together is shared out evenly.
    """
    run = _Run(objective, start, options or NewtonOptions(), make_solver)
    with np.errstate(all="ignore"), torch.no_grad():
        run.iterate()
    return run.results


class _Run:
    """State of the minimisations that still run, B of them."""

    def __init__(
        self,
        objective: BatchedObjective,
        start: torch.Tensor,
        options: NewtonOptions,
        make_solver: Callable[[SparsePattern], BatchedSolver],
    ) -> None:
        count = len(start)
        self.objective, self.options, self.make_solver = objective, options, make_solver
        self.solvers: dict[SparsePattern, BatchedSolver] = {}
        self.y = start.clone()
        self.gradient = self.y  # known when the iteration begins
        self.sample = np.arange(count)  # which of those that were given
        self.value, self.residual, self.step = np.full((3, count), np.inf)
        self.level = np.full(count, _FULL)  # of convexity
        self.shift, self.iterations, self.nudges, self.factorisations = (
            np.zeros(count, dtype=np.int64) for _ in range(4)
        )
        self.rest, self.definite = np.zeros((2, count), dtype=bool)
        self.ended: list[Status | None] = [None] * count
        self.rngs = [np.random.default_rng(0) for _ in range(count)]
        activities = ("analyse", "assemble", "factorise", "search", "total")
        self.seconds = {name: np.zeros(count) for name in activities}  # of all that were given
        self.results = [
            NewtonResult(y=np.empty(0), status=Status.MAX_ITERATIONS, message="")
            for _ in range(count)
        ]

    def iterate(self) -> None:
        with self._timed("total"):
            self.value = on_host(self.objective.value(self.y))
            self.gradient = self.objective.gradient(self.y)
        while len(self.sample):
            with self._timed("total"):
                self._round()
            self._let_go()

    def _round(self) -> None:
        """One iteration of every sample."""
        self.residual = on_host(self.objective.residual(self.gradient))
        finite = np.isfinite(self.value) & np.isfinite(self.residual)
        self._end(self.iterations >= self.options.max_iterations, Status.MAX_ITERATIONS)
        self._end(~finite, Status.NOT_FINITE)
        going = self._going()
        if not len(going):
            return
        near = self.residual < self.options.residual
        step, definite = self._directions(going, near)
        length = np.full(len(self.sample), np.nan)
        length[going] = on_host(self._part(going).step_length(step[self._at(going)]))

        # Only the exact Hessian can tell a minimum from a saddle.
        proven, stationary = _both(going, near & definite), _both(going, near & ~definite)
        self.definite[_both(going, near)] = definite[_both(going, near)]
        self.step[proven] = length[proven]
        self.level[proven], self.rest[proven] = 0, False
        self._end(proven[length[proven] < self.options.step], Status.CONVERGED)
        self._end(stationary[self.nudges[stationary] >= NUDGES], Status.SADDLE)
        self._end(_both(going, ~near & ~definite), Status.SINGULAR)
        self._nudge(_both(self._going(), near & ~definite))
        self._search(_both(self._going(), definite), step, length)

    # Directions

    def _directions(
        self, going: np.ndarray, near: np.ndarray
    ) -> tuple[torch.Tensor, np.ndarray]:
        """Newton steps (B, n) with the least convexity that works; (B,) bool where one does.

        Near a minimum the exact Hessian alone is tried.
        """
        step = torch.zeros_like(self.y)
        definite = np.zeros(len(self.sample), dtype=bool)
        lowest = np.where(self.rest, self.level, np.maximum(self.level - 1, 0))
        trial = np.where(near, 0, np.where(self.shift > 0, _FULL, lowest))
        self.rest[_both(going, ~near)] = False
        hessians = self.objective.hessians(self.y)
        pending = going
        while len(pending):
            shift = np.where(trial[pending] == _FULL, self.shift[pending], 0)
            found, part = self._solve(
                hessians, pending, trial[pending], shift, -self.gradient[self._at(pending)]
            )
            step[self._at(pending[found])] = part[self._at(found.nonzero()[0])]
            definite[pending[found]] = True
            failed = pending[~found]
            failed = failed[~near[failed]]
            full = trial[failed] == _FULL
            pending = failed[~full | (self.shift[failed] < _LAST)]
            self.shift[failed[full & (self.shift[failed] < _LAST)]] += 1
            trial[failed[~full]] += 1
        found = _both(going, definite & ~near)
        # Having tried in vain to need less, try again only after another step.
        tried = (trial == self.level) & (lowest < self.level) & (trial < _FULL)
        self.rest[found] = tried[found]
        self.level[found] = trial[found]
        return step, definite

    def _solve(
        self,
        hessians: Hessians,
        index: np.ndarray,
        level: np.ndarray,
        shift: np.ndarray,
        rhs: torch.Tensor,
    ) -> tuple[np.ndarray, torch.Tensor]:
        """Whether the Hessians of the samples ``index`` (b,) are definite, and solutions (b, n)."""
        self.factorisations[index] += 1
        found, solution = np.zeros(len(index), dtype=bool), torch.empty_like(rhs)
        with self._timed("assemble"):
            systems = list(
                hessians.systems(index, np.take(CONVEXITY, level), np.take(SHIFTS, shift))
            )
        for which, pattern, data in systems:
            if pattern not in self.solvers:
                with self._timed("analyse"):
                    self.solvers[pattern] = self.make_solver(pattern)
            with self._timed("factorise"):
                some, at = index[which], self._at(which)
                force = hessians.into_frames(some, rhs[at])
                definite, move = self.solvers[pattern].solve(data, force)
                found[which] = on_host(definite)
                solution[at] = hessians.out_of_frames(some, move)
        return found, solution

    def _nudge(self, index: np.ndarray) -> None:
        """Small moves out of saddles: random, smoothed by the convex Hessian."""
        if not len(index):
            return
        noise = np.stack([self.rngs[k].standard_normal(self.y.shape[1]) for k in index])
        level, shift = np.full(len(index), _FULL), np.ones(len(index), dtype=np.int64)
        found, move = self._solve(
            self.objective.hessians(self.y), index, level, shift, on_device(noise, self.y)
        )
        objective, y = self._part(index), self.y[self._at(index)]
        size = on_device(NUDGE * NUDGE_GROWTH ** self.nudges[index], self.y)
        move = move * (size / objective.step_length(move))[:, None]
        move[self._at(np.flatnonzero(~found))] = 0.0
        for _ in range(NUDGE_HALVINGS):
            barred = on_host(~objective.allows(y, y + move))
            if not barred.any():
                break
            move[self._at(np.flatnonzero(barred))] /= 2
        else:
            move[self._at(np.flatnonzero(barred))] = 0.0
        self.y[self._at(index)] = y + move
        self.value[index] = on_host(objective.value(self.y[self._at(index)]))
        self._take_gradient(index)
        self.level[index] = _FULL
        self.nudges[index] += 1
        self.iterations[index] += 1

    # Line search

    def _search(self, index: np.ndarray, step: torch.Tensor, length: np.ndarray) -> None:
        """Go along the steps (B, n), of the ``length`` (B,) in the objective's units."""
        if not len(index):
            return
        with self._timed("search"):
            at = self._at(index)
            line = LineSearch(self._part(index), self.y[at], step[at], self.value[index],
                              self.gradient[at], self.residual[index])
            line.run()
            moved = line.length > 0
            found, failed = index[moved], index[~moved]
            self.y[at], self.value[index] = line.best, line.lowest
            self._take_gradient(found)
        self.shift[found] = 0
        self.step[found] = line.length[moved] * length[found]
        # A nearly singular model points far out of its range: make it stiffer, and do not ask for
        # less at the same place. A minimum's own model there is none stiffer.
        full = self.level[failed] == _FULL
        stationary = self.residual[failed] < self.options.residual
        self._end(failed[stationary | (full & (self.shift[failed] == _LAST))], Status.LINE_SEARCH)
        self.shift[failed[full & (self.shift[failed] < _LAST)]] += 1
        self.level[failed], self.rest[failed] = _FULL, True
        self.iterations[[k for k in index if self.ended[k] is None]] += 1

    def _take_gradient(self, index: np.ndarray) -> None:
        """Gradients of the samples ``index`` (b,) where they are."""
        if len(index):
            at = self._at(index)
            self.gradient[at] = self._part(index).gradient(self.y[at])

    # Who runs

    def _going(self) -> np.ndarray:
        """Samples that have not ended."""
        return np.array([k for k, status in enumerate(self.ended) if status is None], dtype=int)

    def _end(self, which: np.ndarray, status: Status) -> None:
        """Samples, as a mask (B,) or by number, that end if they have not yet."""
        for k in np.flatnonzero(which) if which.dtype == bool else which:
            self.ended[k] = self.ended[k] or status

    def _let_go(self) -> None:
        """Write the results of samples that have ended, and go on without them."""
        going = self._going()
        if len(going) == len(self.sample):
            return
        for k, status in enumerate(self.ended):
            if status is None:
                continue
            result = self.results[self.sample[k]]
            result.y, result.status = self.y[k].cpu().numpy(), status
            for name in ("residual", "step"):
                setattr(result, name, float(getattr(self, name)[k]))
            for name in ("iterations", "factorisations"):
                setattr(result, name, int(getattr(self, name)[k]))
            result.positive_definite = bool(self.definite[k])
            result.message = ending(status, result.residual, result.iterations)
            result.seconds = {a: float(s[self.sample[k]]) for a, s in self.seconds.items()}
        self.objective = self._part(going)
        at = self._at(going)
        self.y, self.gradient = self.y[at], self.gradient[at]
        for name in ("sample", "value", "residual", "step", "level", "shift", "iterations",
                     "nudges", "factorisations", "rest", "definite"):
            setattr(self, name, getattr(self, name)[going])
        self.rngs = [self.rngs[k] for k in going]
        self.ended = [None] * len(going)

    def _part(self, index: np.ndarray) -> BatchedObjective:
        return part_of(self.objective, index, self.y)

    def _at(self, index: np.ndarray) -> torch.Tensor:
        return on_device(index, self.y)

    @contextmanager
    def _timed(self, activity: str) -> Iterator[None]:
        """Share the time of a ``with`` block out among the samples that run."""
        began = time.perf_counter()
        yield
        if self.y.is_cuda:
            torch.cuda.synchronize(self.y.device)
        share = (time.perf_counter() - began) / max(len(self.sample), 1)
        self.seconds[activity][self.sample] += share


def _both(index: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Those of ``index`` (b,) for which ``mask`` (B,) holds."""
    return index[mask[index]]
