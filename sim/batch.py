"""Many drapes: each on its own, by as many worker processes as there are cores."""

import os
from collections.abc import Sequence

import numpy as np

from common.errors import InputError
from common.workers import worker_pool
from sim.drape import DrapeResult, check_arguments, drape
from sim.laws import Laws
from sim.material import Fabric
from sim.mesh.specimens import default_edge
from sim.newton import NewtonOptions
from sim.scene import Rig


def drape_batch(
    fabrics: Sequence[Fabric], *, rig: Rig | None = None,
    edge: float | Sequence[float] | None = None, starts: str | Sequence[str] = "sine",
    seeds: Sequence[int] | None = None, offsets: Sequence[tuple[float, float]] | None = None,
    laws: Laws | None = None, options: NewtonOptions | None = None, workers: int | None = None
) -> list[DrapeResult]:
    """Drape every fabric on ``rig``, as :func:`sim.drape.drape` does.

    Args:
        fabrics: any number.
        rig: of all; None for the square on its cylinder.
        edge: m, at the plate's rim, of all meshes or one each; None chooses each as
            :func:`sim.mesh.specimens.default_edge`.
        starts: initial shape, of all or one each; see :data:`sim.initial.STARTS`.
        seeds: of the initial shape and topology, one each; None for 0, 1, 2, ...
        offsets: (2,) m each, the specimens' centres from the plate's axis; None for none.
        laws: of bending, membrane and energies of your own.
        options: of the final minimisations.
        workers: processes, one drape and one core each; they take a second to start, and stay for
            a minute. None for one a core. With 1 this process does it itself.

    Returns:
        The drapes in the order of ``fabrics``; a numerical failure is in a drape's ``status``.
        InputError for parameters that make no sense, or a worker process ended from outside.
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
        """Only to be compared: fine meshes take long, and so do soft fabrics."""
        softest = fabrics[k].at_density(1.0).alpha.min()
        return (each["edge"][k] or default_edge(fabrics[k], rig)) ** -2 / softest**0.5

    longest = sorted(range(count), key=expected_work, reverse=True)
    with worker_pool(workers) as pool:
        made = {k: pool.submit(drape, **tasks[k]) for k in longest}
        return [made[k].result() for k in range(count)]
