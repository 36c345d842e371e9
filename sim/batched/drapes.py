"""Drapes of many fabrics on one mesh at once: the steps of :mod:`sim.drape` on an accelerator."""

import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from common.workers import worker_pool
from sim.batched.lowering import columns, lowered
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
    follow,
)
from sim.energies.bending_variants import Hysteresis
from sim.energies.membrane import Corotational, OrthotropicStVK
from sim.energies.self_contact import self_intersections
from sim.equilibrium import Equilibrium
from sim.lowering import LOWERING_MESHES
from sim.material import Fabric, bending_length
from sim.mesh import Mesh
from sim.mesh.specimen import GRADING, default_edge, longest_edge
from sim.rig import Rig
from sim.scene import Scene
from sim.solver.newton import NewtonOptions, Status
from sim.solver.state import State
from sim.start import LOWERED, interpolate_positions

BATCH = 2_900_000
"""Most unknowns of drapes at once, which have fewer than 65 536 fronts on a level, a limit of some
libraries: 580 drapes of a mesh of 5 000."""
_STRAGGLERS = (0.1, 0.02)
"""Shares of drapes whose minimisation, on a coarser and the final mesh, is ended when the others
have converged: a few take as long as many. Then they are continued on the final mesh, or on the
CPU."""
_MAX_ITERATIONS = 150  # on the final mesh, after which a drape is continued on the CPU
_UNFINISHED = (Status.MAX_ITERATIONS, Status.SADDLE)


def drape_batch(
    plans: Sequence[Mapping[str, Any]], device: str | torch.device = "cuda", *, workers: int = 1,
    pool: Executor | None = None
) -> list[Drape]:
    """The drapes of ``plans``, arguments of :func:`sim.drape.drape` by name, in their order, as
    :func:`sim.many.drape_many` gives them up to rounding, which may choose other folds.

    Meanwhile ``workers`` processes on the CPU, or those of a ``pool``, simulate those that are not
    covered (:func:`covers`), and continue those that intersect themselves or are not finished. A
    script calls this below ``if __name__ == "__main__":``.
    """
    groups: dict[tuple, list[tuple[int, _Run]]] = {}
    drapes: list[Drape | None] = [None] * len(plans)
    with nullcontext(pool) if pool else worker_pool(workers) as pool:
        calls = {index: pool.submit(drape, **plan)
                 for index, plan in enumerate(plans) if not covers(plan)}
        for index in sorted(set(range(len(plans))) - set(calls)):
            run = _run(**plans[index])
            # The triangles and levels of their meshes, stopping criteria, and kinds of laws
            key = (id(run.scene(run.edge).mesh.faces), run.edge, run.options, *_coarse_edges(run),
                   type(run.laws.bending), type(run.laws.membrane))
            groups.setdefault(key, []).append((index, run))
        for group in groups.values():
            size = _batch(group[0][1].scene(group[0][1].edge).mesh)
            for first in range(0, len(group), size):
                indices, runs = zip(*group[first : first + size], strict=True)
                for index, run, made in zip(indices, runs, _draped(runs, device), strict=True):
                    drapes[index] = made
                    if made.status in _UNFINISHED or (made.converged and len(
                            self_intersections(made.positions, made.faces))):
                        calls[index] = pool.submit(_continued, made, run.options)
        for index, call in calls.items():
            drapes[index] = call.result()
    return drapes


def _batch(mesh: Mesh) -> int:
    """Largest number of drapes at once on a mesh."""
    return max(1, BATCH // (3 * len(mesh.rest) + len(mesh.edges)))


def _continued(made: Drape, options: NewtonOptions) -> Drape:
    """The drape near an unfinished one, with self-contact where it is needed."""
    near = follow(made, made.fabric, options=options)
    return replace(near, coarse=made.coarse, outcome=near.after(made).outcome,
                   seconds=made.seconds + near.seconds)


def covers(plan: Mapping[str, Any]) -> bool:
    """Whether a plan is simulated in a batch: lowered cloth, mid-edge bending and its variants,
    a corotational or orthotropic membrane."""
    laws, start = plan.get("laws") or Laws(), plan.get("start") or LOWERED
    bent = laws.bending == "midedge" or (
        isinstance(laws.bending, Hysteresis) and laws.bending.origin is None)
    known = bent and type(laws.membrane) in (Corotational, OrthotropicStVK) and not laws.others
    begun = start == LOWERED and plan.get("borrowed") is None and plan.get("seed", 0) >= 0
    return known and begun and (plan.get("rig") or Rig()).has_plate


def _run(
    fabric: Fabric, rig: Rig | None = None, edge: float | None = None, seed: int = 0,
    offset: tuple[float, float] = (0.0, 0.0), laws: Laws | None = None,
    options: NewtonOptions | None = None, **_: object
) -> _Run:
    rig = rig or Rig()
    edge = default_edge(fabric, rig, offset=offset) if edge is None else edge
    return _Run(fabric, rig, laws or Laws(), edge, seed, tuple(offset),
                options or FINE_OPTIONS)


def _coarse_edges(run: _Run) -> list[float]:
    longest = longest_edge(run.rig, run.offset)
    return [min(max(edge, run.edge), longest) for edge, _ in LOWERING_MESHES]


def _draped(runs: Sequence[_Run], device: str | torch.device) -> list[Drape]:
    """The drapes of a group. Limp cloth, and cloth without an equilibrium, is lowered on a finer
    mesh, as in :meth:`sim.drape._Run.lowered`."""
    drapes: list[Drape | None] = [None] * len(runs)
    folds = [bending_length(run.fabric.alpha.min(), run.fabric.density) for run in runs]
    for (edge, grading), coarse in zip(LOWERING_MESHES, _coarse_edges(runs[0]), strict=True):
        limp = grading != GRADING
        chosen = [k for k, (run, made) in enumerate(zip(runs, drapes, strict=True))
                  if not (made and (made.converged or made.status in _UNFINISHED))
                  and (limp or edge <= _EDGES_OF_LIMP * folds[k])]
        if chosen:
            settled = _settled([runs[k] for k in chosen], coarse, grading, device)
            for k, made in zip(chosen, settled, strict=True):
                drapes[k] = made
    return drapes


def _settled(
    runs: list[_Run], coarse: float, grading: float, device: str | torch.device
) -> list[Drape]:
    """The drapes of cloth lowered on a mesh of the edge length ``coarse``, then on finer ones."""
    began, limp = time.perf_counter(), grading != GRADING
    by_run = []
    for run in runs:
        finer = run.scenes(_MIDDLE * coarse)
        if limp:
            finer.insert(-1, run.scene(run.edge, soft=True))
        by_run.append([run.scene(coarse, grading, soft=True), *finer])
    outcomes, before = [], None
    for scenes in zip(*by_run, strict=True):
        last, scene = scenes[0] is by_run[0][-1], scenes[0]
        cloths = [Cloth(one, run.fabric, laws=run.laws if last else run.laws.softened(
            COARSE_MEMBRANE)) for run, one in zip(runs, scenes, strict=True)]
        potential = BatchedPotential(cloths, device)
        if before is None:
            outcomes.append(lowered(potential, scenes, [run.rig for run in runs],
                                    [run.seed for run in runs]))
            x = outcomes[-1].x
        else:
            x = _prolonged(before, scene.mesh, not limp).to(x) @ x
            x[:, scene.held] = columns([run.rig.place(one.mesh.rest[one.held])
                                        for run, one in zip(runs, scenes, strict=True)]).to(x)
        if outcomes[0].origin is not None:
            near, weight = _nearest(by_run[0][0], scene)
            potential = potential.having(
                origin=(outcomes[0].origin[:, near] * weight.to(x)).sum(2))
        options = runs[0].options if last else COARSE_OPTIONS
        options = replace(options, max_iterations=min(options.max_iterations, _MAX_ITERATIONS))
        outcomes.append(minimise(potential, x, potential.normals(x), options,
                                 least=int(_STRAGGLERS[last] * len(runs))))
        outcomes[-1].origin = potential.own.get("origin")
        x, before = outcomes[-1].x, scene.mesh
    found = [_found(k, run, scenes[-1], outcomes)
             for k, (run, scenes) in enumerate(zip(runs, by_run, strict=True))]
    seconds = (time.perf_counter() - began) / len(runs)
    return [_made(one, False, fabric=run.fabric, rig=run.rig, edge=run.edge, seconds=seconds,
                  coarse=tuple(outcome.results[k].status for outcome in outcomes[1:-1]))
            for k, (run, one) in enumerate(zip(runs, found, strict=True))]


def _found(k: int, run: _Run, scene: Scene, outcomes: list[Outcome]) -> Equilibrium:
    """What was found for drape ``k``."""
    last, laws = outcomes[-1], run.laws
    now = State(*(part[..., k].T.cpu().numpy().copy() for part in (last.x, last.n)))
    steps = sum(outcome.results[k].iterations for outcome in outcomes)
    if last.origin is not None and last.origin[..., k].any():
        origin = last.origin[..., k].T.cpu().numpy().copy()
        laws = replace(laws, bending=replace(laws.bending, origin=origin))
    return Equilibrium(cloth=Cloth(scene, run.fabric, laws=laws), state=now,
                       outcome=replace(last.results[k], q=now.q, iterations=steps))


@lru_cache(maxsize=64)
def _prolonged(coarse: Mesh, fine: Mesh, smooth: bool) -> Tensor:
    """Matrix (V, U) of :func:`sim.start.interpolate_positions`, linear in the positions up to the
    1e-6 to which it finds slopes."""
    identity = np.eye(len(coarse.rest))
    return torch.from_numpy(interpolate_positions(coarse.rest, identity, fine.rest, smooth=smooth))


def _nearest(coarse: Scene, fine: Scene) -> tuple[np.ndarray, Tensor]:
    """The three triangles (T, 3) of ``coarse`` nearest to each of ``fine``, and their weights
    (T, 3, 1), as in :func:`sim.lowering.with_origins`."""
    centres, places = (one.mesh.rest[one.mesh.faces[one.active]].mean(axis=1)
                       for one in (coarse, fine))
    distance, near = cKDTree(centres).query(places, k=3)
    weight = 1 / (distance + 1e-6)
    return near, torch.from_numpy(weight / weight.sum(axis=1, keepdims=True))[..., None]
