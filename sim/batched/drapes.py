"""Drapes of many fabrics on one mesh at once: the steps of :mod:`sim.drape` on an accelerator."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from sim.batched.newton import Outcome, minimise
from sim.batched.potential import BatchedPotential
from sim.cloth import Cloth, Laws
from sim.drape import (
    _EDGES_OF_LIMP,
    _MIDDLE,
    COARSE_MEMBRANE,
    COARSE_OPTIONS,
    FINE_OPTIONS,
    Drape,
    _made,
    _Run,
    drape,
)
from sim.energies.membrane import Corotational
from sim.energies.self_contact import self_intersections
from sim.equilibrium import Equilibrium, find_equilibrium
from sim.lowering import (
    _GAP,
    _MAX_STEPS,
    _PRESSURE,
    _WAVINESS,
    LOWERING_MESHES,
    SETTLING,
    SPEEDS,
    STEP,
)
from sim.mesh import Mesh
from sim.mesh.specimen import GRADING, bending_length, default_edge, longest_edge
from sim.rig import GRAVITY, Rig
from sim.scene import Scene
from sim.solver.dynamics import STEP_OPTIONS
from sim.solver.newton import Status
from sim.solver.state import State
from sim.start import LOWERED, interpolate_positions, waves

BATCH = 256
"""Largest number of drapes at once; about 12 GB for meshes of 4 000 unknowns."""


def drape_batch(
    plans: Sequence[Mapping[str, Any]], device: str | torch.device = "cuda"
) -> list[Drape]:
    """The drapes of ``plans``, arguments of :func:`sim.drape.drape` by name, in their order, as
    :func:`sim.batch.drape_batch` gives them up to rounding, which may choose other folds. Those
    that are not covered (:func:`covers`) are simulated one by one on the CPU."""
    drapes: list[Drape | None] = [None] * len(plans)
    groups: dict[tuple, list[tuple[int, _Run]]] = {}
    for index, plan in enumerate(plans):
        if covers(plan):
            run = _run(plan)
            groups.setdefault(_meshes(run), []).append((index, run))
        else:
            drapes[index] = drape(**plan)
    for group in groups.values():
        for first in range(0, len(group), BATCH):
            indices, runs = zip(*group[first : first + BATCH], strict=True)
            for index, made in zip(indices, _draped(runs, device), strict=True):
                drapes[index] = made
    return drapes


def covers(plan: Mapping[str, Any]) -> bool:
    """Whether a plan is simulated in a batch: lowered cloth with the default kinds of laws."""
    laws, start = plan.get("laws") or Laws(), plan.get("start") or LOWERED
    default = laws.bending == "midedge" and type(laws.membrane) is Corotational and not laws.others
    alone = plan.get("borrowed") is None and not plan.get("keep")
    return default and alone and start == LOWERED and (plan.get("rig") or Rig()).has_plate


def _run(plan: Mapping[str, Any]) -> _Run:
    fabric, rig, edge = plan["fabric"], plan.get("rig") or Rig(), plan.get("edge")
    return _Run(fabric, rig, plan.get("laws") or Laws(),
                default_edge(fabric, rig) if edge is None else edge, plan.get("seed", 0),
                plan.get("offset", (0.0, 0.0)), plan.get("options") or FINE_OPTIONS)


def _meshes(run: _Run) -> tuple:
    """What drapes of one batch share: triangles and levels of their meshes, stopping criteria."""
    return id(run.scene(run.edge).mesh.faces), run.edge, run.options, *_coarse_edges(run)


def _coarse_edges(run: _Run) -> list[float]:
    longest = longest_edge(run.rig, run.offset)
    return [min(max(edge, run.edge), longest) for edge, _ in LOWERING_MESHES]


def _draped(runs: Sequence[_Run], device: str | torch.device) -> list[Drape]:
    """The drapes of a group. Limp cloth, and cloth without an equilibrium, is lowered on a finer
    mesh, as in :meth:`sim.drape._Run.lowered`."""
    drapes: list[Drape | None] = [None] * len(runs)
    for (edge, grading), coarse in zip(LOWERING_MESHES, _coarse_edges(runs[0]), strict=True):
        limp = grading != GRADING
        chosen = [k for k, (run, made) in enumerate(zip(runs, drapes, strict=True))
                  if not (made and made.converged)
                  and (limp or edge <= _EDGES_OF_LIMP * bending_length(run.fabric))]
        if chosen:
            settled = _settled([runs[k] for k in chosen], coarse, grading, device)
            for k, made in zip(chosen, settled, strict=True):
                drapes[k] = made
    return drapes


def _settled(
    runs: list[_Run], coarse: float, grading: float, device: str | torch.device
) -> list[Drape]:
    """The drapes of cloth lowered on a mesh of the edge length ``coarse``."""
    began, limp = time.perf_counter(), grading != GRADING
    by_run = []
    for run in runs:
        finer = run.scenes(_MIDDLE * coarse)
        if limp:
            finer.insert(-1, run.scene(run.edge, soft=True))
        by_run.append([run.scene(coarse, grading, soft=True), *finer])
    levels = list(zip(*by_run, strict=True))
    x, before, outcomes = None, None, []
    for level, scenes in enumerate(levels):
        last = level == len(levels) - 1
        cloths = [Cloth(scene, run.fabric, laws=run.laws if last else run.laws.softened(
            COARSE_MEMBRANE)) for run, scene in zip(runs, scenes, strict=True)]
        potential, mesh = BatchedPotential(cloths, device), scenes[0].mesh
        if level == 0:
            outcome = _lowered(potential, scenes, runs)
            outcomes.append(outcome)
            x = outcome.x
        else:
            x = _prolonged(before, mesh, not limp).to(x) @ x
            held = np.flatnonzero(scenes[0].held)
            x[:, held] = _columns([run.rig.place(scene.mesh.rest[held])
                                   for run, scene in zip(runs, scenes, strict=True)]).to(x)
        n, before = potential.normals(x), mesh
        outcomes.append(minimise(potential, x, n, runs[0].options if last else COARSE_OPTIONS))
        x = outcomes[-1].x
    found = [_found(k, run, scenes[-1], outcomes) for k, (run, scenes) in
             enumerate(zip(runs, by_run, strict=True))]
    seconds = (time.perf_counter() - began) / len(runs)
    return [_made(one, False, fabric=run.fabric, rig=run.rig, edge=run.edge, seconds=seconds,
                  coarse=tuple(outcome.results[k].status for outcome in outcomes[1:-1]))
            for k, (run, one) in enumerate(zip(runs, found, strict=True))]


def _found(k: int, run: _Run, scene: Scene, outcomes: list[Outcome]) -> Equilibrium:
    """The equilibrium of drape ``k``; one that intersects itself is untangled on the CPU."""
    last = outcomes[-1]
    now = State(*(part[..., k].T.cpu().numpy().copy() for part in (last.x, last.n)))
    steps = sum(outcome.results[k].iterations for outcome in outcomes)
    outcome = replace(last.results[k], q=now.q, iterations=steps)
    one = Equilibrium(cloth=Cloth(scene, run.fabric, laws=run.laws), state=now, outcome=outcome)
    if one.converged and len(self_intersections(one.positions, scene.mesh.faces)):
        return find_equilibrium(scene, run.fabric, now, laws=run.laws, options=run.options,
                                self_contact=True).after(one)
    return one


def _lowered(
    potential: BatchedPotential, scenes: Sequence[Scene], runs: Sequence[_Run]
) -> Outcome:
    """Cloth lowered as by :func:`sim.lowering.lowered`, with time steps as long as the relaxation
    time; each drape leaves when it has settled, or at a step that is not finite."""
    speeds, times, flat = [], [], []
    for run, scene in zip(runs, scenes, strict=True):
        rng, rest = np.random.default_rng([run.seed, 1]), scene.mesh.rest
        overhang = (run.rig.specimen_size - run.rig.plate_diameter) / 2
        times.append(np.sqrt(overhang / GRAVITY))
        speeds.append(np.exp(rng.uniform(*np.log(SPEEDS))) * overhang / times[-1])
        height = waves(rest, run.rig, rng, amplitude=_WAVINESS) * ~scene.held[:, None]
        flat.append(np.column_stack([rest, np.zeros(len(rest))]) + height)
    x = _columns(flat).to(potential.free.device)
    n = potential.normals(x)
    speed, unit = (torch.from_numpy(np.array(values)).to(x) for values in (speeds, times))
    free = torch.from_numpy(~scenes[0].held).to(x)[:, None]
    weights, step = potential.own["weights"], STEP * unit
    potential = potential.take(torch.arange(len(runs), device=x.device))
    potential.own |= {
        "inertia": weights / GRAVITY / step**2, "ring": _PRESSURE / 1e-6 * weights * free,
        "step": step, "speed": speed, "velocity": torch.zeros_like(x),
        "still": torch.zeros_like(step)}
    end, results, live = Outcome(x.clone(), n.clone(), []), [None] * len(runs), np.arange(len(runs))
    for count in range(_MAX_STEPS):
        own = potential.own
        own["height"] = -_GAP - own["speed"] * own["step"] * (count + 1)
        own["aim"] = x + own["step"] * own["velocity"]
        after = minimise(potential, x, n, STEP_OPTIONS)
        own["velocity"] = (after.x - x) / own["step"]
        x, n = after.x, after.n
        touched = ((own["height"] > x[2]) & (own["ring"] > 0)).any(0)
        own["still"] = torch.where(touched, 0.0, own["still"] + own["step"])
        lost = np.array([result.status is Status.NOT_FINITE for result in after.results])
        over = (own["still"] >= SETTLING / STEP * own["step"]).cpu().numpy() | lost
        over |= count == _MAX_STEPS - 1
        for k in np.flatnonzero(over):
            results[live[k]] = replace(after.results[k], iterations=count + 1)
        gone, stay, where = (torch.from_numpy(np.flatnonzero(one) if one.dtype == bool else one)
                             .to(x.device) for one in (over, ~over, live[over]))
        end.x[..., where], end.n[..., where] = x[..., gone], n[..., gone]
        if over.all():
            break
        if over.any():
            x, n, potential, live = x[..., stay], n[..., stay], potential.take(stay), live[~over]
    return Outcome(end.x, end.n, results)


def _columns(points: Sequence[np.ndarray]) -> Tensor:
    """Points (V, 3) of each drape as (3, V, B)."""
    return torch.from_numpy(np.stack(points, axis=-1).transpose(1, 0, 2).copy())


@lru_cache(maxsize=64)
def _prolonged(coarse: Mesh, fine: Mesh, smooth: bool) -> Tensor:
    """Matrix (V, U) of :func:`sim.start.interpolate_positions`, linear in the positions up to the
    1e-6 to which it finds slopes."""
    identity = np.eye(len(coarse.rest))
    return torch.from_numpy(interpolate_positions(coarse.rest, identity, fine.rest, smooth=smooth))
