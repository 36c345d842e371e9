"""Simulation of many drapes in parallel worker processes, one drape per process."""

import os
from collections.abc import Sequence

import numpy as np

from common.errors import InputError
from common.workers import worker_pool
from sim.drape import DrapeResult, check_arguments, drape
from sim.laws import Laws
from sim.material import Fabric
from sim.mesh.specimens import default_edge
from sim.scene import Rig
from sim.solver.newton import NewtonOptions


def drape_batch(
    fabrics: Sequence[Fabric], *, rig: Rig | None = None,
    edge: float | Sequence[float] | None = None, starts: str | Sequence[str] = "sine",
    seeds: Sequence[int] | None = None, offsets: Sequence[tuple[float, float]] | None = None,
    laws: Laws | None = None, options: NewtonOptions | None = None, workers: int | None = None
) -> list[DrapeResult]:
    """Drape every fabric on ``rig``, as :func:`sim.drape.drape` does.

    Args:
        fabrics: N fabrics, any number.
        rig: rig of all drapes; None for the square on its cylinder.
        edge: edge length at the plate's rim, m, one value or N; None chooses each by
            :func:`sim.mesh.specimens.default_edge`.
        starts: initial shape, one name or N; see :data:`sim.start.STARTS`.
        seeds: N seeds of the initial shape and the triangulation; None for 0, 1, 2, ...
        offsets: N offsets (2,), m, of the specimen's centre from the plate's axis; None for zero.
        laws: bending law, membrane and user-defined energies.
        options: stopping criteria of the final minimisations.
        workers: number of processes; each runs one drape at a time on one core, takes a second to
            start and is kept for a minute. None for one per core; 1 runs in this process.

    Returns:
        The drapes in the order of ``fabrics``; numerical failures are given by their ``status``.
        InputError for invalid parameters, or a worker process that was killed.
    """
    rig, laws, count = rig or Rig(), laws or Laws(), len(fabrics)
    workers = (os.cpu_count() or 1) if workers is None else workers
    if workers < 1:
        raise InputError(f"workers={workers}: at least one process is needed")
    each = {"edge": [edge] * count if np.ndim(edge) == 0 else edge,
            "start": [starts] * count if isinstance(starts, str) else starts,
            "seed": range(count) if seeds is None else seeds,
            "offset": [(0.0, 0.0)] * count if offsets is None else offsets}
    for name, values in each.items():
        if len(values) != count:
            raise InputError(f"{name} has {len(values)} entries for {count} fabrics")
    for start, seed, offset in zip(each["start"], each["seed"], each["offset"], strict=True):
        check_arguments(rig, laws, start, seed, offset)
    shared = {"rig": rig, "laws": laws, "options": options}
    tasks = [{"fabric": fabric, **dict(zip(each, values, strict=True)), **shared}
             for fabric, *values in zip(fabrics, *each.values(), strict=True)]
    workers = min(workers, count)
    if workers <= 1:
        return [drape(**task) for task in tasks]

    def expected_work(k: int) -> float:
        """Relative cost of a drape: it grows with fine meshes and soft fabrics."""
        softest = fabrics[k].at_density(1.0).alpha.min()
        return (each["edge"][k] or default_edge(fabrics[k], rig)) ** -2 / softest**0.5

    longest = sorted(range(count), key=expected_work, reverse=True)
    with worker_pool(workers) as pool:
        made = {k: pool.submit(drape, **tasks[k]) for k in longest}
        return [made[k].result() for k in range(count)]
