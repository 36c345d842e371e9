"""Simulation of a dataset's drape by its index: plan, equilibrium, measures, record."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from common.errors import InputError
from common.provenance import release
from data.dataset.plan import BORROWED, DrapePlan, SamplingConfig, choose_lender, plan_drape
from data.dataset.shards import FACES, LENGTH_UNIT, ORIGIN, ORIGIN_UNIT, fields, to_counts
from data.fabrics.fabrics import fabric_from_theta
from data.fabrics.prior import Prior, prior_content
from sim.mesh.specimen import EDGE_RANGE, default_edge
from sim.rig import Rig

Solver = Callable[..., object]
"""A function such as :func:`sim.drape.drape`."""
Record = Mapping[str, np.ndarray]
"""One drape of a shard by field, see :func:`data.dataset.shards.write_shard`."""

NUMERICAL_ERRORS = (ArithmeticError, np.linalg.LinAlgError)
"""Exceptions of a single simulation: the drape is recorded as failed, the others continue."""


@dataclass(frozen=True)
class DatasetConfig:
    """All settings that determine a dataset's bytes.

    Attributes:
        drapes: number of drapes.
        sampling: fabrics, testers, specimens, starts, seed.
        prior: distribution of the fabrics.
        edge: edge length of the meshes at the plate's rim, m; 0: chosen for each fabric, see
            :func:`sim.mesh.specimen.default_edge`.
        drapes_per_shard: drapes per file.
    """

    drapes: int
    sampling: SamplingConfig
    prior: Prior
    edge: float = 0.0
    drapes_per_shard: int = 64

    def __post_init__(self) -> None:
        for name in ("drapes", "drapes_per_shard"):
            if getattr(self, name) < 1:
                raise InputError(f"{name}={getattr(self, name)} must be at least 1")
        if self.edge and not EDGE_RANGE[0] <= self.edge <= EDGE_RANGE[1]:
            raise InputError(f"edge_mm={1e3 * self.edge:g}: give 0, for a mesh that suits each "
                             f"fabric, or {1e3 * EDGE_RANGE[0]:g} to {1e3 * EDGE_RANGE[1]:g} mm")

    def as_dict(self) -> dict:
        """Settings that determine each drape and its record, in JSON types; without their number.
        """
        settings = {
            "sampling": asdict(self.sampling),
            "prior": prior_content(self.prior),
            "solver": {"edge_mm": round(1e3 * self.edge, 6)},
            "storage": {"drapes_per_shard": self.drapes_per_shard},
            "code_version": release(),
        }
        return json.loads(json.dumps(settings))  # tuples are lists in JSON

    def rows(self, shard: int) -> range:
        """Indices of the drapes in a shard."""
        first = shard * self.drapes_per_shard
        return range(first, min(first + self.drapes_per_shard, self.drapes))

    @property
    def shards(self) -> int:
        """Number of shards."""
        return -(-self.drapes // self.drapes_per_shard)


def find_lender(plan: DrapePlan, config: DatasetConfig, earlier: Sequence[Record]) -> Record | None:
    """Choose the record among ``earlier`` whose drape is the plan's initial state; None if the plan
    has another start or there is no candidate.

    Candidates are converged drapes of other fabrics (Feng et al. 2022, section 5.2.1).
    """
    if plan.start != BORROWED:
        return None
    candidates = {int(record["index"]): record for record in earlier
            if record["status"] == b"converged" and record["fabric"] != plan.fabric}
    if not candidates:
        return None
    return candidates[choose_lender(plan.index, seed=config.sampling.seed,
                                    candidates=sorted(candidates))]


def simulate(
    plan: DrapePlan, config: DatasetConfig, solver: Solver, lender: Record | None = None
) -> tuple[dict, object]:
    """Drape the plan's fabric; return the record without measures, and the solver's result.

    For a drape that fails, also by an arithmetic exception, the record states the reason and the
    result is None.
    """
    start: dict = {"start": plan.fallback}
    if lender is not None:
        # Rounded as stored, so that the drape can be repeated from the shard alone.
        start = {"borrowed": (lender["rest"] * LENGTH_UNIT, lender["positions"] * LENGTH_UNIT)}
    fabric = fabric_from_theta(plan.theta)
    edge = config.edge or default_edge(fabric, plan.rig)
    record = _planned(plan, lender) | {"density": fabric.density, "edge": edge}
    try:
        result = solver(
            fabric,
            rig=plan.nuisances.rig(plan.rig),
            edge=edge,
            seed=plan.seed,
            offset=tuple(plan.offset),
            laws=plan.nuisances.laws,
            **start,
        )
    except NUMERICAL_ERRORS as error:
        return record | _numerical_failure(error), None
    record |= _outcome(str(getattr(result.status, "value", result.status)), result.message)
    record |= {"residual": result.residual, "iterations": result.iterations}
    try:
        record |= {
            "positions": to_counts(result.positions),
            "rest": to_counts(result.rest),
            "vertices": len(result.rest),
            FACES: result.faces,
            ORIGIN: _origins(result),
        }
    except OverflowError as error:
        if result.converged:
            record |= _outcome("out_of_range", str(error))
        return record, None
    return record, result if result.converged else None


def _origins(result: object) -> np.ndarray:
    """Curvatures without friction (F, 3) in counts of :data:`ORIGIN_UNIT`, of all triangles."""
    origins = np.zeros(result.faces.shape)
    origin = getattr(result.laws.bending, "origin", None)
    if origin is not None:
        origins[result.scene.active] = origin
    limit = np.iinfo(np.int16).max
    return np.clip(np.rint(origins / ORIGIN_UNIT), -limit, limit).astype(np.int16)


def _planned(plan: DrapePlan, lender: Record | None) -> dict:
    """The record of a drape before its simulation."""
    return {name: np.zeros(field.shape, field.dtype) for name, field in fields(0, 0).items()} | {
        FACES: np.zeros((0, 3), np.int32),
        ORIGIN: np.zeros((0, 3), np.int16),
        "index": plan.index,
        "fabric": plan.fabric,
        "theta": plan.theta,
        "rejected": plan.rejected,
        "weight": plan.weight,
        "specimen": plan.rig.specimen.encode(),
        "specimen_size": plan.rig.specimen_size,
        "plate_diameter": plan.rig.plate_diameter,
        "face": plan.face,
        "nuisances": plan.nuisances.vector,
        "start": (plan.fallback if lender is None else BORROWED).encode(),
        "planned": plan.start.encode(),
        "lender": -1 if lender is None else lender["index"],
        "seed": plan.seed,
        "offset": plan.offset,
        "residual": np.nan,
        "drape_coefficient": np.nan,
        "folds": -1,
    }


def _outcome(status: str, message: str) -> dict:
    return {"status": status.encode("ascii", "replace")[:24],
            "message": message.encode("ascii", "replace")[:160]}


def _numerical_failure(error: Exception) -> dict:
    return _outcome("exception", f"{type(error).__name__}: {error}")


def load_solver() -> Solver:
    """The simulator; imported late, because the main process and --help need no compiled kernels.
    """
    from sim.drape import drape

    return drape


def make_record(
    index: int,
    config: DatasetConfig,
    *,
    earlier: Sequence[Record] = (),
    solver: Solver | None = None,
) -> dict[str, np.ndarray]:
    """Simulate drape ``index``; return its record: arrays by field, such as positions (V, 3).

    A drape whose measures cannot be computed is marked as failed, with its mesh.

    Args:
        earlier: records of the drapes before it in the same shard, candidates for a borrowed start.
    """
    plan = plan_drape(index, config=config.sampling, prior=config.prior)
    lender = find_lender(plan, config, earlier)
    record, result = simulate(plan, config, solver or load_solver(), lender)
    if result is None:
        return record
    try:
        return record | _measures(result, plan.nuisances.rig(plan.rig))
    except NUMERICAL_ERRORS as error:
        return record | _numerical_failure(error)


def _measures(result: object, rig: Rig) -> dict:
    """Drape coefficient and number of folds."""
    # Imported here like the solver, see load_solver.
    from sim.measures import drape_coefficient, fold_count

    return {"drape_coefficient": drape_coefficient(result.positions, result.faces, rig),
            "folds": fold_count(result.positions, result.rest, rig)}
