"""Cloth lowered over a plate, many drapes in step: see :mod:`sim.lowering`."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from sim import lowering as single
from sim.batched.newton import Outcome, minimise
from sim.batched.potential import BatchedPotential
from sim.rig import GRAVITY, Rig
from sim.scene import Scene
from sim.solver.dynamics import STEP_OPTIONS
from sim.solver.newton import Status
from sim.start import waves


def lowered(
    potential: BatchedPotential, scenes: Sequence[Scene], rigs: Sequence[Rig], seeds: Sequence[int]
) -> Outcome:
    """The states and the number of steps of lowered cloths, as by :func:`sim.lowering.lowered` with
    time steps as long as the relaxation time. A drape leaves when it has settled, or at a step that
    is not finite; speeds differ, and so do the numbers of steps."""
    speeds, times, flat = [], [], []
    for scene, rig, seed in zip(scenes, rigs, seeds, strict=True):
        rng, rest = np.random.default_rng([seed, 1]), scene.mesh.rest
        overhang = (rig.specimen_size - rig.plate_diameter) / 2
        times.append(np.sqrt(overhang / GRAVITY))
        speeds.append(np.exp(rng.uniform(*np.log(single.SPEEDS))) * overhang / times[-1])
        height = waves(rest, rig, rng, amplitude=single._WAVINESS) * ~scene.held[:, None]
        flat.append(np.column_stack([rest, np.zeros(len(rest))]) + height)
    x = columns(flat).to(potential.free.device)
    speed, step = (torch.from_numpy(np.array(values)).to(x) for values in (speeds, times))
    n, step, live = potential.normals(x), single.STEP * step, np.arange(len(seeds))
    free = torch.from_numpy(~scenes[0].held).to(x)[:, None]
    weights = potential.own["weights"]
    potential = potential.having(
        inertia=weights / GRAVITY / step**2, ring=single._PRESSURE / 1e-6 * weights * free,
        speed=speed, step=step, still=0 * step, velocity=torch.zeros_like(x))
    origin = potential.own.get("origin")
    end = Outcome(x.clone(), n.clone(), [None] * len(live),
                  None if origin is None else origin.clone())
    for count in range(1, single._MAX_STEPS + 1):
        own = potential.own
        step, height = own["step"], -single._GAP - own["speed"] * own["step"] * count
        potential = potential.having(aim=x + step * own["velocity"], height=height)
        after = minimise(potential, x, n, STEP_OPTIONS)
        velocity = (after.x - x) / step
        x, n = after.x, after.n
        touched = ((height > x[2]) & (free > 0)).any(0)
        still = torch.where(touched, 0.0, own["still"] + 1)
        potential = potential.slid(x, n).having(velocity=velocity, still=still)
        over = (still >= single.SETTLING / single.STEP).cpu().numpy()
        over |= [result.status is Status.NOT_FINITE for result in after.results]
        over |= count == single._MAX_STEPS
        for k in np.flatnonzero(over):
            end.results[live[k]] = replace(after.results[k], iterations=count)
        gone, stay, where = (torch.from_numpy(one).to(x.device) for one in (
            np.flatnonzero(over), np.flatnonzero(~over), live[over]))
        end.x[..., where], end.n[..., where] = x[..., gone], n[..., gone]
        if end.origin is not None:
            end.origin[..., where] = potential.own["origin"][..., gone]
        if over.all():
            break
        if over.any():
            x, n, potential, live = x[..., stay], n[..., stay], potential.take(stay), live[~over]
    return end


def columns(points: Sequence[np.ndarray]) -> Tensor:
    """Points (V, 3) of each drape as (3, V, B)."""
    return torch.from_numpy(np.stack(points, axis=-1).transpose(1, 0, 2).copy())
