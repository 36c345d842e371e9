"""Many drapes at once: fabrics in, drapes out, each as :func:`sim.drape.drape` would make it.

On a GPU the drapes of one resolution are minimised together (:mod:`sim.batched.newton`). On a CPU
that is slower than the sparse solver of single drapes, which works in cache and partly in single
precision: there, by default, each drape is made on its own, by as many worker processes as there
are cores (``benchmarks/batched.py`` measures both). Threads would often wait for each other: about
half of a drape's time goes into kernels and array operations that hold Python's lock.
"""

import os
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from common.errors import InputError
from common.workers import worker_pool
from sim.batched.equilibrium import analyse_grid, find_equilibria
from sim.drape import (
    COARSE_MEMBRANE,
    COARSE_OPTIONS,
    FINE_OPTIONS,
    DrapeResult,
    check_seed,
    check_setting,
    coarse_to_fine,
    default_resolution,
    drape,
    drape_result,
    scene_on,
    start_positions,
)
from sim.initial import check_start
from sim.laws import Laws
from sim.material import REFERENCE_DENSITY, Fabric
from sim.mesh import check_resolution
from sim.newton import NewtonOptions, NewtonResult, Status
from sim.scene import Rig, Scene, State
from sim.self_contact import find_free_equilibrium, self_intersections
from sim.specimens import make_specimen, rim_radius

MESHES = ("structured", "perturbed")
"""Triangulations of a grid, which drapes that are made together must have."""
AT_A_TIME = 64
"""Default of ``at_a_time`` (:func:`drape_batch`)."""
_JITTER = 0.15  # as by default in sim.drape.drape


@dataclass(frozen=True)
class _Request:
    """One drape to be made; attributes as the arguments of :func:`sim.drape.drape`."""

    fabric: Fabric
    resolution: int
    start: str
    seed: int
    offset: tuple[float, float]


def drape_batch(
    fabrics: Sequence[Fabric],
    *,
    rig: Rig | None = None,
    resolution: int | Sequence[int] | None = None,
    starts: str | Sequence[str] = "sine",
    seeds: Sequence[int] | None = None,
    offsets: Sequence[tuple[float, float]] | None = None,
    mesh: str = "perturbed",
    laws: Laws | None = None,
    options: NewtonOptions | None = None,
    device: torch.device | str = "cpu",
    together: bool | None = None,
    at_a_time: int = AT_A_TIME,
    workers: int | None = None,
) -> list[DrapeResult]:
    """Drape every fabric on ``rig``.

    A drape does not depend on which others are made with it, but for rounding.

    Args:
        fabrics: any number.
        rig: of all; None for the square on its cylinder.
        resolution: vertices a side, of all or one each; None chooses each as
            :func:`sim.drape.default_resolution`. Drapes of one resolution form a batch.
        starts: initial shape, of all or one each; see :data:`sim.initial.STARTS`.
        seeds: of the initial shape and triangulation, one each; None for 0, 1, 2, ...
        offsets: (2,) m each, the specimens' centres from the plate's axis; None for none.
        mesh: kind of triangulation, "perturbed" or "structured".
        laws: of bending, membrane and energies of your own; made together, drapes know only those
            with a twin in :mod:`sim.batched.energies`.
        options: of the final minimisations.
        device: where the drapes are minimised, "cpu" or "cuda".
        together: whether drapes of one resolution share their minimisation; None: not on a CPU.
        at_a_time: so many at most, which limits the memory.
        workers: processes that make drapes each on its own, or free those made together that
            intersect themselves; they take a second to start, and stay for a minute. None for one
            a core. With 1, as for a single drape, this process does it itself.
            Otherwise a script that defines laws of its own must keep what it runs under ``if
            __name__ == "__main__"``, for the processes import it.

    Returns:
        The drapes in the order of ``fabrics``; a numerical failure is in a drape's ``status``.
        Of what is done together, ``seconds`` and ``time_spent`` are even shares of wall time.

    Raises:
        InputError: parameters that make no sense; a worker process that was ended from outside.
    """
    rig, laws = rig or Rig(), laws or Laws()
    check_setting(rig, laws)
    requests = _requests(fabrics, rig, resolution, starts, seeds, offsets)
    if mesh not in MESHES:
        raise InputError(f"unknown mesh '{mesh}' for a batch; choose from {', '.join(MESHES)}")
    if at_a_time < 1:
        raise InputError(f"at_a_time={at_a_time}: at least one drape is needed")
    workers = (os.cpu_count() or 1) if workers is None else workers
    if workers < 1:
        raise InputError(f"workers={workers}: at least one process is needed")
    device = _device(device)
    together = device.type != "cpu" if together is None else together
    if not together:
        return _one_by_one(requests, rig, mesh, laws, options, workers)
    if rig.specimen != "square":
        raise InputError(f"the specimen of {rig.name} is no grid; give together=False")
    results: list[DrapeResult | None] = [None] * len(requests)
    for n in sorted({request.resolution for request in requests}):
        group = [k for k, request in enumerate(requests) if request.resolution == n]
        for first in range(0, len(group), at_a_time):
            part = group[first : first + at_a_time]
            made = _together([requests[k] for k in part], rig, mesh, laws, options, device,
                             workers)
            for k, result in zip(part, made, strict=True):
                results[k] = result
    return results


def _device(name: torch.device | str) -> torch.device:
    """The device, which must be there."""
    try:
        device = torch.device(name)
    except RuntimeError:
        raise InputError(f"unknown device '{name}'; choose cpu or cuda") from None
    if device.type not in ("cpu", "cuda"):
        raise InputError(f"device '{name}' knows no batches of drapes; choose cpu or cuda")
    if device.type == "cuda" and not torch.cuda.is_available():
        raise InputError(f"device '{name}': PyTorch finds no GPU here")
    return device


def _requests(
    fabrics: Sequence[Fabric],
    rig: Rig,
    resolution: int | Sequence[int] | None,
    starts: str | Sequence[str],
    seeds: Sequence[int] | None,
    offsets: Sequence[tuple[float, float]] | None,
) -> list[_Request]:
    count = len(fabrics)
    if resolution is None:
        resolution = [default_resolution(fabric, rig) for fabric in fabrics]
    given = {
        "resolution": [resolution] * count if np.ndim(resolution) == 0 else resolution,
        "starts": [starts] * count if isinstance(starts, str) else starts,
        "seeds": range(count) if seeds is None else seeds,
        "offsets": [(0.0, 0.0)] * count if offsets is None else offsets,
    }
    for name, values in given.items():
        if len(values) != count:
            raise InputError(f"{name} has {len(values)} entries for {count} fabrics")
    for n in given["resolution"]:
        check_resolution(n)
    for start, seed in zip(given["starts"], given["seeds"], strict=True):
        check_start(start)
        check_seed(seed)
    if not np.isfinite(np.asarray(given["offsets"], dtype=float)).all():
        raise InputError("offsets must be finite numbers, in metres")
    return [
        _Request(fabric, int(n), start, int(seed), (float(offset[0]), float(offset[1])))
        for fabric, n, start, seed, offset in zip(fabrics, *given.values(), strict=True)
    ]


def _one_by_one(
    requests: list[_Request],
    rig: Rig,
    mesh: str,
    laws: Laws,
    options: NewtonOptions | None,
    workers: int,
) -> list[DrapeResult]:
    """Each drape on its own, ``workers`` at a time, the longest first."""
    shared = {"rig": rig, "mesh": mesh, "laws": laws, "options": options}
    workers = min(workers, len(requests))
    if workers <= 1:
        return [drape(**vars(request), **shared) for request in requests]
    longest = sorted(range(len(requests)), key=lambda k: -_expected_work(requests[k]))
    with worker_pool(workers) as pool:
        made = {k: pool.submit(drape, **vars(requests[k]), **shared) for k in longest}
        return [made[k].result() for k in range(len(requests))]


def _expected_work(request: _Request) -> float:
    """Only to be compared: fine meshes take long, and so do soft fabrics."""
    return request.resolution**2.5 / request.fabric.at_density(1.0).alpha.min() ** 0.5


def _together(
    requests: list[_Request],
    rig: Rig,
    mesh: str,
    laws: Laws,
    options: NewtonOptions | None,
    device: torch.device,
    workers: int,
) -> list[DrapeResult]:
    """Drapes of one resolution, in one minimisation on each mesh."""
    began = time.perf_counter()
    resolution = requests[0].resolution
    fabrics = [request.fabric.at_density(REFERENCE_DENSITY) for request in requests]
    coarse: list[tuple[np.ndarray, np.ndarray] | None] = [None] * len(requests)
    iterations = np.zeros(len(requests), dtype=np.int64)
    time_spent = [Counter() for _ in requests]
    for level in coarse_to_fine(resolution):
        last = level == resolution
        specimens = [
            make_specimen(rig, mesh=mesh, resolution=level, offset=request.offset,
                          jitter=_JITTER, seed=request.seed)
            for request in requests
        ]
        starts = [
            start_positions(specimen, rig, coarse=before, start=request.start, seed=request.seed)
            for request, specimen, before in zip(requests, specimens, coarse, strict=True)
        ]
        scenes = [scene_on(specimen, rig, last=last) for specimen in specimens]
        states, results = find_equilibria(
            scenes,
            fabrics,
            [State.at(s.mesh, start) for s, start in zip(specimens, starts, strict=True)],
            analyse_grid(_free_places(rig, level, [r.offset for r in requests]), device),
            laws=laws if last else laws.softened(COARSE_MEMBRANE),
            options=(options or FINE_OPTIONS) if last else COARSE_OPTIONS,
        )
        coarse = [
            (specimen.mesh.rest, state.positions)
            for specimen, state in zip(specimens, states, strict=True)
        ]
        iterations += [result.iterations for result in results]
        for spent, result in zip(time_spent, results, strict=True):
            spent.update(result.seconds)
    share = (time.perf_counter() - began) / len(requests)
    options = options or FINE_OPTIONS
    states, freed, seconds = _freed(scenes, fabrics, states, results, laws, options, workers)
    for k, result in freed.items():
        iterations[k] += result.iterations
        time_spent[k].update(result.seconds)
    return [
        drape_result(
            request.fabric,
            rig,
            specimens[k],
            states[k],
            freed.get(k, results[k]),
            resolution=resolution,
            iterations=int(iterations[k]),
            seconds=share + seconds.get(k, 0.0),
            time_spent=dict(time_spent[k]),
        )
        for k, request in enumerate(requests)
    ]


def _freed(
    scenes: list[Scene],
    fabrics: list[Fabric],
    states: list[State],
    results: list[NewtonResult],
    laws: Laws,
    options: NewtonOptions,
    workers: int,
) -> tuple[list[State], dict[int, NewtonResult], dict[int, float]]:
    """States in which no cloth intersects itself; results and seconds of those that did.

    Cloth that meets itself couples vertices far apart, for which the batch's matrices have no
    place; the sparse solver of single drapes finishes it, in ``workers`` processes.
    """
    tangled = [
        k for k, (scene, state, result) in enumerate(zip(scenes, states, results, strict=True))
        if result.status is Status.CONVERGED
        and len(self_intersections(state.positions, scene.mesh.faces))
    ]
    tasks = [(scenes[k], fabrics[k], states[k], laws, options) for k in tangled]
    workers = min(workers, len(tasks))
    if workers <= 1:
        made = [_free(*task) for task in tasks]
    else:
        with worker_pool(workers) as pool:
            made = list(pool.map(_free, *zip(*tasks, strict=True)))
    states = list(states)
    for k, (state, _, _) in zip(tangled, made, strict=True):
        states[k] = state
    return (
        states,
        {k: result for k, (_, result, _) in zip(tangled, made, strict=True)},
        {k: seconds for k, (_, _, seconds) in zip(tangled, made, strict=True)},
    )


def _free(
    scene: Scene, fabric: Fabric, state: State, laws: Laws, options: NewtonOptions
) -> tuple[State, NewtonResult, float]:
    """One cloth as :func:`find_free_equilibrium` leaves it, and the seconds that took."""
    began = time.perf_counter()
    state, result = find_free_equilibrium(scene, fabric, state, laws=laws, options=options)
    return state, result, time.perf_counter() - began


def _free_places(
    rig: Rig, resolution: int, offsets: Sequence[tuple[float, float]]
) -> np.ndarray:
    """(n, n) bool, vertices that the rig may leave free at one of the ``offsets``.

    Judged by the places of the regular grid, so that batches of the same offsets, however
    their meshes are perturbed, share one analysis.
    """
    side = np.linspace(-rig.specimen_size / 2, rig.specimen_size / 2, resolution)
    free = np.zeros((resolution, resolution), dtype=bool)
    edge = side[1] - side[0]
    # A mesh's vertices are held within the rim after their perturbation.
    least = rim_radius(rig, edge) - (_JITTER * np.sqrt(2) + 1e-6) * edge if rig.has_plate else -1.0
    for x, y in dict.fromkeys(offsets):
        free |= np.hypot(*np.meshgrid(side + x, side + y, indexing="ij")) > least
    return free
