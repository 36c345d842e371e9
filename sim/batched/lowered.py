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
from sim.solver.newton import NewtonResult, Status


def lowered(
    potential: BatchedPotential, scenes: Sequence[Scene], rigs: Sequence[Rig], seeds: Sequence[int]
) -> Outcome:
    """The states and the number of steps of lowered cloths, as by :func:`sim.lowering.lowered` with
    time steps as long as the relaxation time. A drape leaves when it has settled, or at a step that
    is not finite; speeds differ, and so do the numbers of steps."""
    flat, speeds, times = zip(*(on_ring(scene, rig, seed=seed) for scene, rig, seed in zip(
        scenes, rigs, seeds, strict=True)), strict=True)
    x = columns(flat).to(potential.free.device)
    speed, step = (torch.from_numpy(np.array(values)).to(x) for values in (speeds, times))
    n, step, live = potential.normals(x), STEP * step, np.arange(len(seeds))
    free = torch.from_numpy(~scenes[0].held).to(x)[:, None]
    weights = potential.tensors["weights"]
    potential = potential.having(
        inertia=weights / GRAVITY / step**2, ring=RING_STIFFNESS * weights * free,
        speed=speed, step=step, still=0 * step, velocity=torch.zeros_like(x))
    origin = potential.tensors.get("origin")
    unfinished = NewtonResult(np.empty(0), Status.MAX_ITERATIONS, "")
    end = Outcome(x.clone(), n.clone(), [unfinished] * len(live),
                  None if origin is None else origin.clone())
    for count in range(1, MAX_STEPS + 1):
        tensors = potential.tensors
        step, height = tensors["step"], -GAP - tensors["speed"] * tensors["step"] * count
        potential = potential.having(aim=x + step * tensors["velocity"], height=height)
        after = minimise(potential, x, n, STEP_OPTIONS)
        velocity = (after.x - x) / step
        x, n = after.x, after.n
        touched = ((height > x[2]) & (free > 0)).any(0)
        still = torch.where(touched, 0.0, tensors["still"] + 1)
        potential = potential.slid(x, n).having(velocity=velocity, still=still)
        over = (still >= SETTLING / STEP).cpu().numpy()
        over |= [result.status is Status.NOT_FINITE for result in after.results]
        over |= count == MAX_STEPS
        for k in np.flatnonzero(over):
            end.results[live[k]] = replace(after.results[k], iterations=count)
        gone, stay, where = (torch.from_numpy(index).to(x.device) for index in (
            np.flatnonzero(over), np.flatnonzero(~over), live[over]))
        end.x[..., where], end.n[..., where] = x[..., gone], n[..., gone]
        if end.origin is not None:
            end.origin[..., where] = potential.tensors["origin"][..., gone]
        if over.all():
            break
        if over.any():
            x, n, potential, live = x[..., stay], n[..., stay], potential.take(stay), live[~over]
    return end


def columns(points: Sequence[np.ndarray]) -> Tensor:
    """Points (V, 3) of each drape as (3, V, B)."""
    return torch.from_numpy(np.stack(points, axis=-1).transpose(1, 0, 2).copy())
