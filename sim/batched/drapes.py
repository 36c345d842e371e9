"""Drapes of many fabrics on one mesh at once: the steps of :mod:`sim.draping` on an accelerator."""

import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from common.arguments import whole_number
from common.workers import worker_pool
from sim.batched.lowered import columns, lowered
from sim.batched.newton import Outcome, minimise
from sim.batched.potential import BatchedPotential
from sim.cloth import Cloth, Laws
from sim.draping import COARSE_MEMBRANE, COARSE_OPTIONS, Drape, Run, drape, follow
from sim.energies.bending_variants import Hysteresis
from sim.energies.membrane import Corotational, OrthotropicStVK
from sim.energies.self_contact import self_intersections
from sim.equilibrium import Equilibrium
from sim.lowering import LOWERING_MESHES, LoweringMesh, nearest_triangles
from sim.mesh import Mesh
from sim.rig import Rig
from sim.scene import Scene
from sim.solver.newton import NUMERICAL_ERRORS, Status
from sim.solver.state import State
from sim.start import LOWERED, interpolate_positions

SLOTS = 256
"""Most drapes at once, the batch that was measured (docs/validation/gpu_drapes.json): with more
of them a step takes longer, with fewer hardly less, as it takes 12 ms or more for its launches."""
UNKNOWNS = 2_900_000
"""Most unknowns of drapes at once, which have fewer than 65 536 fronts on a level, a limit of some
libraries: 580 drapes of a mesh of 5 000."""
MAX_ITERATIONS = 100
"""Of a minimisation: then a drape is continued on the next mesh, from the final one on the CPU."""
_UNFINISHED = (Status.MAX_ITERATIONS, Status.SADDLE)
_OTHERS = {"start", "borrowed", "keep"}  # arguments of a drape that have no effect here


def drape_batch(
    plans: Sequence[Mapping[str, Any]], device: str | torch.device = "cuda", *, workers: int = 1,
    pool: Executor | None = None, slots: int = SLOTS
) -> list[Drape]:
    """The drapes of ``plans``, arguments of :func:`sim.draping.drape` by name, in their order, as
    :func:`sim.many.drape_many` gives them up to rounding, which may choose other folds.

    As many drapes of one triangulation as there are ``slots`` take their steps at once; those that
    end a lowering or minimisation make room for the next.

    Meanwhile ``workers`` processes on the CPU, or those of a ``pool``, simulate those that are not
    covered (:func:`covers`), and continue those that intersect themselves or are not finished. A
    script calls this below ``if __name__ == "__main__":``.
    """
    slots = whole_number("slots", slots, 1)
    groups: dict[tuple, list[tuple[int, Run]]] = {}
    drapes: dict[int, Drape] = {}
    with nullcontext(pool) if pool else worker_pool(workers) as executor:
        calls = {index: executor.submit(drape, **plan)
                 for index, plan in enumerate(plans) if not covers(plan)}
        for index in sorted(set(range(len(plans))) - set(calls)):
            run = Run.of(**{name: plans[index][name] for name in plans[index].keys() - _OTHERS})
            # The triangles and levels of their meshes, stopping criteria, and kinds of laws
            key = (id(run.scene(run.edge).mesh.faces), run.edge, run.options,
                   *map(run.lowering_edge, LOWERING_MESHES), type(run.laws.bending),
                   type(run.laws.membrane))
            groups.setdefault(key, []).append((index, run))
        for group in groups.values():
            # Limp cloth takes the most steps: begun last, it would keep the other slots waiting.
            group.sort(key=lambda one: float(np.mean(one[1].fabric.alpha)) / one[1].fabric.density)
            indices, runs = zip(*group, strict=True)
            mesh = runs[0].scene(runs[0].edge).mesh
            most = max(1, min(slots, UNKNOWNS // (3 * len(mesh.rest) + len(mesh.edges))))
            for index, run, made in zip(indices, runs, _draped(runs, device, most), strict=True):
                drapes[index] = made
                if made.status in _UNFINISHED or (made.converged and len(
                        self_intersections(made.positions, made.faces))):
                    calls[index] = executor.submit(_continued, made, run)
        drapes |= {index: call.result() for index, call in calls.items()}
    return [drapes[index] for index in range(len(plans))]


def _continued(made: Drape, run: Run) -> Drape:
    """The drape near an unfinished one, with self-contact where it is needed."""
    try:
        near = follow(made, made.fabric, options=run.options)
    except NUMERICAL_ERRORS as error:
        return run.made(run.failed(error), made.coarse, made.seconds)
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


def _draped(runs: Sequence[Run], device: str | torch.device, slots: int) -> list[Drape]:
    """The drapes of a group, as by :meth:`sim.draping.Run.lowered`."""
    drapes: dict[int, Drape] = {}
    for mesh in LOWERING_MESHES:
        chosen = [k for k, run in enumerate(runs) if run.is_lowered_on(mesh) and not (
            k in drapes and (drapes[k].converged or drapes[k].status in _UNFINISHED))]
        if chosen:
            settled = _settled([runs[k] for k in chosen], mesh, device, slots)
            drapes.update(zip(chosen, settled, strict=True))
    return [drapes[k] for k in range(len(runs))]


def _settled(
    runs: list[Run], mesh: LoweringMesh, device: str | torch.device, slots: int
) -> list[Drape]:
    """The drapes of cloth lowered on ``mesh``, then on finer ones."""
    began = time.perf_counter()
    by_run = [run.lowering_scenes(mesh) for run in runs]
    outcomes: list[Outcome] = []
    before: Scene | None = None
    for scenes in zip(*by_run, strict=True):
        last, scene = scenes[0] is by_run[0][-1], scenes[0]
        cloths = [Cloth(of, run.fabric, laws=run.laws if last else run.laws.softened(
            COARSE_MEMBRANE)) for run, of in zip(runs, scenes, strict=True)]
        potential = BatchedPotential(cloths, device)
        if before is None:
            outcomes.append(lowered(potential, scenes, [run.rig for run in runs],
                                    [run.seed for run in runs], slots=slots))
            x = outcomes[-1].x
        else:
            x = prolonged(before.mesh, scene.mesh, not mesh.limp).to(x) @ x
            x[:, scene.held] = columns([run.rig.place(of.mesh.rest[of.held])
                                        for run, of in zip(runs, scenes, strict=True)]).to(x)
        if outcomes[0].origin is not None:
            near, weight = nearest_triangles(by_run[0][0], scene)
            potential = potential.having(origin=(
                outcomes[0].origin[:, near] * torch.from_numpy(weight[..., None]).to(x)).sum(2))
        options = runs[0].options if last else COARSE_OPTIONS
        options = replace(options, max_iterations=min(options.max_iterations, MAX_ITERATIONS))
        outcomes.append(minimise(potential, x, potential.normals(x), options, slots=slots))
        outcomes[-1].origin = potential.tensors.get("origin")
        x, before = outcomes[-1].x, scene
    seconds = (time.perf_counter() - began) / len(runs)
    return [run.made(equilibrium_of(k, run, scenes[-1], outcomes), [
        outcome.results[k].status for outcome in outcomes[1:-1]], seconds)
            for k, (run, scenes) in enumerate(zip(runs, by_run, strict=True))]


def equilibrium_of(k: int, run: Run, scene: Scene, outcomes: list[Outcome]) -> Equilibrium:
    """The last state of drape ``k``, as an equilibrium."""
    last, laws = outcomes[-1], run.laws
    positions, normals = (array[..., k].T.cpu().numpy().copy() for array in (last.x, last.n))
    steps = sum(outcome.results[k].iterations for outcome in outcomes)
    if last.origin is not None and last.origin[..., k].any():
        laws = laws.with_origin(last.origin[..., k].T.cpu().numpy().copy())
    state = State(positions, normals)
    return Equilibrium(cloth=Cloth(scene, run.fabric, laws=laws), state=state,
                       outcome=replace(last.results[k], q=state.q, iterations=steps))


@lru_cache(maxsize=64)
def prolonged(coarse: Mesh, fine: Mesh, smooth: bool) -> Tensor:
    """Matrix (V, U) of :func:`sim.start.interpolate_positions`, linear in the positions up to the
    1e-6 to which it finds slopes."""
    identity = np.eye(len(coarse.rest))
    return torch.from_numpy(interpolate_positions(coarse.rest, identity, fine.rest, smooth=smooth))
