"""Cloth lowered over a plate, many drapes in step: see :mod:`sim.lowering`."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from sim.batched.newton import Outcome, minimise
from sim.batched.potential import BatchedPotential
from sim.lowering import GAP, MAX_STEPS, RING_STIFFNESS, SETTLING, STEP, on_ring
from sim.rig import GRAVITY, Rig
from sim.scene import Scene
from sim.solver.dynamics import STEP_OPTIONS
from sim.solver.newton import Status


def lowered(
    potential: BatchedPotential, scenes: Sequence[Scene], rigs: Sequence[Rig], seeds: Sequence[int],
    *, slots: int | None = None
) -> Outcome:
    """The states and the number of steps of lowered cloths, as by :func:`sim.lowering.lowered` with
    time steps as long as the relaxation time, of as many at once as there are ``slots`` (None:
    all). A drape leaves when it has settled, or at a step that is not finite."""
    flat, speeds, times = zip(*(on_ring(scene, rig, seed=seed) for scene, rig, seed in zip(
        scenes, rigs, seeds, strict=True)), strict=True)
    x = columns(flat).to(potential.free.device)
    speed, step = (torch.from_numpy(np.array(values)).to(x) for values in (speeds, times))
    before, n, step, still = x.clone(), potential.normals(x), STEP * step, torch.zeros_like(step)
    count, free = torch.zeros_like(step), torch.from_numpy(~scenes[0].held).to(x)[:, None]
    weights = potential.tensors["weights"]
    potential = potential.having(
        inertia=weights / GRAVITY / step**2, ring=RING_STIFFNESS * weights * free,
        aim=x.clone(), height=-GAP - speed * step)
    tensors = potential.tensors

    def again(drapes: np.ndarray, after: Outcome) -> np.ndarray:
        """The next time step of drapes (K,): which of them take one."""
        k, x = torch.from_numpy(drapes).to(free.device), after.x
        touched = ((tensors["height"][k] > x[2]) & (free > 0)).any(0)
        still[k] = torch.where(touched, 0.0, still[k] + 1)
        count[k] += 1
        if "origin" in tensors:
            slid = potential.take(k).slid(x, after.n).tensors["origin"]
            tensors["origin"] = tensors["origin"].index_copy(-1, k, slid)
        # They go on as fast as in the step from ``before``.
        tensors["aim"][..., k], before[..., k] = 2 * x - before[..., k], x
        tensors["height"][k] = -GAP - (speed * step * (count + 1))[k]
        over = ((still[k] >= SETTLING / STEP) | (count[k] >= MAX_STEPS)).cpu().numpy()
        return ~over & [result.status is not Status.NOT_FINITE for result in after.results]

    end = minimise(potential, x, n, STEP_OPTIONS, slots=slots, resume=again)
    end.results = [replace(result, iterations=int(steps))
                   for result, steps in zip(end.results, count.tolist(), strict=True)]
    end.origin = tensors.get("origin")
    return end


def columns(points: Sequence[np.ndarray]) -> Tensor:
    """Points (V, 3) of each drape as (3, V, B)."""
    return torch.from_numpy(np.stack(points, axis=-1).transpose(1, 0, 2).copy())
