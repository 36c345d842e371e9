"""Many drapes at once: fabrics in, drapes out, each as :func:`sim.drape.drape` would make it.

On a GPU drapes on one topology are minimised together: each follows the algorithm of a single
drape in a thread of its own (:mod:`sim.batch.rendezvous`), while energies, derivatives and factors
of all of them are calculated in one batch (:mod:`sim.batch.device`). On a CPU that is slower than
the sparse solver of single drapes, which works in cache and partly in single precision: there, by
default, each drape is made on its own, by as many worker processes as there are cores
(``benchmarks/batched.py`` measures both).
"""

import os
import re
from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch

from common.errors import InputError
from common.workers import worker_pool
from sim import reference
from sim.batch.device import DeviceCloths
from sim.batch.rendezvous import Rendezvous, together
from sim.cloth import Cloth
from sim.drape import DrapeResult, check_seed, check_setting, drape
from sim.initial import check_start
from sim.laws import Laws
from sim.linear import CholeskySolver, make_solver
from sim.material import Fabric
from sim.mesh.specimens import TOPOLOGIES, default_edge
from sim.newton import NewtonOptions, NewtonResult, minimise
from sim.scene import Rig, Scene
from sim.self_contact import contact_near
from sim.state import State

AT_A_TIME = 64
"""Default of ``at_a_time`` (:func:`drape_batch`)."""
_SOLVE, _EVALUATE, _FACTORISE, _GATHER = 3, 2, 1, 0  # what is answered first


def drape_batch(
    fabrics: Sequence[Fabric],
    *,
    rig: Rig | None = None,
    edge: float | Sequence[float] | None = None,
    starts: str | Sequence[str] = "sine",
    seeds: Sequence[int] | None = None,
    offsets: Sequence[tuple[float, float]] | None = None,
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
        edge: m, at the plate's rim, of all meshes or one each; None chooses each as
            :func:`sim.mesh.specimens.default_edge`.
        starts: initial shape, of all or one each; see :data:`sim.initial.STARTS`.
        seeds: of the initial shape and topology, one each; None for 0, 1, 2, ...
        offsets: (2,) m each, the specimens' centres from the plate's axis; None for none.
        laws: of bending, membrane and energies of your own; made together, drapes know only those
            that :func:`sim.reference.covers`.
        options: of the final minimisations.
        device: where the drapes are minimised, "cpu" or "cuda".
        together: whether drapes on one topology share their minimisation; None: not on a CPU.
        at_a_time: so many at most, which limits the memory.
        workers: processes that make drapes each on its own, or finish those made together that
            touch themselves; they take a second to start, and stay for a minute. None for one a
            core. With 1, as for a single drape, this process does it itself.

    Returns:
        The drapes in the order of ``fabrics``; a numerical failure is in a drape's ``status``. Of
        drapes made together, ``time_spent`` is what each took on the host, ``seconds`` the wall
        time of all.

    Raises:
        InputError: parameters that make no sense; a worker process that was ended from outside.
    """
    rig, laws = rig or Rig(), laws or Laws()
    check_setting(rig, laws)
    requests = _requests(fabrics, rig, edge, starts, seeds, offsets)
    if at_a_time < 1:
        raise InputError(f"at_a_time={at_a_time}: at least one drape is needed")
    workers = (os.cpu_count() or 1) if workers is None else workers
    if workers < 1:
        raise InputError(f"workers={workers}: at least one process is needed")
    device = _device(device)
    shared = {"rig": rig, "laws": laws, "options": options}
    if not (device.type != "cpu" if together is None else together):
        return _one_by_one(requests, shared, workers)
    results: dict[int, DrapeResult] = {}
    # Processes start with their first task, which most batches do not have.
    with worker_pool(workers) if workers > 1 else nullcontext() as pool:
        for key in sorted({request.key for request in requests}):
            group = [k for k, request in enumerate(requests) if request.key == key]
            for first in range(0, len(group), at_a_time):
                part = group[first : first + at_a_time]
                made = _together([requests[k] for k in part], shared, device, pool)
                results.update(zip(part, made, strict=True))
    return [results[k] for k in range(len(requests))]


@dataclass(frozen=True, eq=False)
class _Request:
    """One drape to be made; attributes as the arguments of :func:`sim.drape.drape`."""

    fabric: Fabric
    edge: float
    start: str
    seed: int
    offset: tuple[float, float]

    @property
    def key(self) -> tuple[float, int]:
        """Equal for drapes on meshes of one size and topology."""
        return self.edge, self.seed % TOPOLOGIES


def _requests(
    fabrics: Sequence[Fabric],
    rig: Rig,
    edge: float | Sequence[float] | None,
    starts: str | Sequence[str],
    seeds: Sequence[int] | None,
    offsets: Sequence[tuple[float, float]] | None,
) -> list[_Request]:
    count = len(fabrics)
    if edge is None:
        edge = [default_edge(fabric, rig) for fabric in fabrics]
    given = {
        "edge": [edge] * count if np.ndim(edge) == 0 else edge,
        "starts": [starts] * count if isinstance(starts, str) else starts,
        "seeds": range(count) if seeds is None else seeds,
        "offsets": [(0.0, 0.0)] * count if offsets is None else offsets,
    }
    for name, values in given.items():
        if len(values) != count:
            raise InputError(f"{name} has {len(values)} entries for {count} fabrics")
    for start, seed in zip(given["starts"], given["seeds"], strict=True):
        check_start(start)
        check_seed(seed)
    if not np.isfinite(np.asarray(given["offsets"], dtype=float)).all():
        raise InputError("offsets must be finite numbers, in metres")
    return [
        _Request(fabric, float(length), start, int(seed), (float(offset[0]), float(offset[1])))
        for fabric, length, start, seed, offset in zip(fabrics, *given.values(), strict=True)
    ]


def _device(name: torch.device | str) -> torch.device:
    """The device, which must be there."""
    if not re.fullmatch(r"cpu|cuda(:\d+)?", str(name)):
        raise InputError(f"device '{name}' knows no batches of drapes; choose cpu or cuda")
    device = torch.device(name)
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        raise InputError(f"device '{name}': PyTorch finds no GPU of this number here")
    return device


def _one_by_one(requests: list[_Request], shared: dict, workers: int) -> list[DrapeResult]:
    """Each drape on its own, ``workers`` at a time, the longest first."""
    workers = min(workers, len(requests))
    if workers <= 1:
        return [drape(**vars(request), **shared) for request in requests]

    def expected_work(k: int) -> float:
        """Only to be compared: fine meshes take long, and so do soft fabrics."""
        softest = requests[k].fabric.at_density(1.0).alpha.min()
        return requests[k].edge**-2 / softest**0.5

    longest = sorted(range(len(requests)), key=expected_work, reverse=True)
    with worker_pool(workers) as pool:
        made = {k: pool.submit(drape, **vars(requests[k]), **shared) for k in longest}
        return [made[k].result() for k in range(len(requests))]


def _together(
    requests: list[_Request], shared: dict, device: torch.device, pool: Executor | None
) -> list[DrapeResult]:
    """Drapes on one topology, each mesh's minimisations in one batch."""
    def run(request: _Request, rendezvous: Rendezvous, number: int) -> DrapeResult:
        minimiser = partial(_minimise_there, rendezvous, number, device, pool)
        return drape(**vars(request), **shared, minimiser=minimiser)

    return together([partial(run, request) for request in requests])


def _minimise_there(
    rendezvous: Rendezvous,
    number: int,
    device: torch.device,
    pool: Executor | None,
    cloth: Cloth,
    q: np.ndarray,
    options: NewtonOptions | None,
) -> NewtonResult:
    """:func:`sim.newton.minimise`, with the calculations of the run ``number`` on the device."""
    if cloth.extra:
        # Cloth that touches itself couples vertices far apart, each in its own way.
        with rendezvous.apart():
            if pool is None:
                return minimise(cloth.potential, q, options)
            task = (cloth.scene, cloth.fabric, cloth.laws, q, options)
            return pool.submit(_minimise_touching, *task).result()
    if not reference.covers(cloth):
        raise InputError("these laws cannot be evaluated in a batch; make such drapes one by one "
                         "(together=False)")
    mesh = cloth.scene.mesh
    key = mesh.faces.tobytes(), cloth.scene.held.tobytes()

    def gathered(cloths: Sequence[Cloth]) -> list[tuple[DeviceCloths, int]]:
        there = DeviceCloths(cloths, device)
        return [(there, k) for k in range(len(cloths))]

    there, place = rendezvous.ask(number, ("gather", key), _GATHER, gathered, cloth)
    objective = _Remote(rendezvous, number, there, place, cloth)
    result = minimise(objective, q, options, make_solver=lambda *_: objective)
    return replace(result, factor=None)


def _minimise_touching(
    scene: Scene, fabric: Fabric, laws: Laws, q: np.ndarray, options: NewtonOptions | None
) -> NewtonResult:
    """A minimum near the state ``q`` of cloth with its contact with itself there, which is made
    anew because it does not travel between processes."""
    positions = State.of(q, len(scene.mesh.rest)).positions
    contact = contact_near(scene, positions, density=fabric.density)
    cloth = Cloth(scene, fabric, laws=laws, extra=[contact])
    return replace(minimise(cloth.potential, q, options), factor=None)


class _Remote:
    """Objective and solver (:mod:`sim.newton`) of one cloth, whose numbers come from a device.

    What is rare, Hessians convex beyond the membrane, is calculated here.
    """

    name = "batch"

    def __init__(
        self, rendezvous: Rendezvous, number: int, there: DeviceCloths, place: int, cloth: Cloth
    ) -> None:
        self._rendezvous, self._number = rendezvous, number
        self._there, self._place = there, place
        self._here = potential = cloth.potential
        self._local: CholeskySolver | None = None
        self._is_local = False
        self.size, self.pattern = potential.size, there.pattern
        self.energy_scale = potential.energy_scale
        self.moved, self.allows = potential.moved, potential.allows
        self.residual, self.step_length = potential.residual, potential.step_length

    def value(self, q: np.ndarray) -> float:
        return self._ask("value", _EVALUATE, self._there.values, q)

    def gradient(self, q: np.ndarray) -> np.ndarray:
        return self._ask("gradient", _EVALUATE, self._there.gradients, q)

    def hessian(
        self, q: np.ndarray, convexity: float, shift: float
    ) -> tuple[np.ndarray, float, float]:
        return q, convexity, shift

    def factorise(self, data: tuple[np.ndarray, float, float], *, rough: bool = False) -> bool:
        q, convexity, shift = data
        share = 2 * convexity  # the membrane is the first of two stages
        self._is_local = share > 1 or shift > 0
        if not self._is_local:
            return self._ask("factorise", _FACTORISE, self._there.factorise, q, share)
        self._local = self._local or make_solver(self._here.pattern)
        return self._local.factorise(self._here.hessian(q, convexity, shift), rough=rough)

    def solve(self, rhs: np.ndarray, *, rough: bool = False) -> np.ndarray:
        if self._is_local:
            return self._local.solve(rhs, rough=rough)
        return self._ask("solve", _SOLVE, self._there.solve, rhs)

    def _ask(self, kind: str, priority: int, answer: object, *argument: object) -> object:
        return self._rendezvous.ask(self._number, (kind, id(self._there)), priority, answer,
                                    (self._place, *argument))
