"""Simulation of a dataset's drape by its index: plan, equilibrium, measures, record."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from data.dataset.config import BORROWED, DatasetConfig
from data.dataset.plan import DrapePlan, choose_lender, plan_drape
from data.dataset.shards import (
    LENGTH_UNIT,
    MOVED_BY,
    fields,
    to_counts,
    to_moves,
)
from data.fabrics.fabrics import fabric_from_theta
from sim.mesh.specimen import DEFAULT_EDGES, default_edge

Solver = Callable[..., Any]
"""A function such as :func:`sim.draping.drape`."""
Record = Mapping[str, np.ndarray]
"""One drape of a shard by field, see :func:`data.dataset.shards.write_shard`."""

COARSER = (1.0, 4 / 3, 5 / 3, 2.0)
"""Edge lengths of a dataset's meshes relative to the finest: stiff cloth needs no finer ones."""
NUMERICAL_ERRORS = (ArithmeticError, np.linalg.LinAlgError)
"""Exceptions of a single simulation: the drape is recorded as failed, the others continue."""


def make_record(
    index: int, config: DatasetConfig, *, earlier: Sequence[Record] = (),
    solver: Solver | None = None,
) -> dict[str, np.ndarray]:
    """Simulate drape ``index``; return its record: arrays by field, such as positions (V, 3).

    A drape that fails, also by an arithmetic exception, is recorded with the reason; one whose
    measures cannot be computed is marked as failed, with its mesh. ``earlier``: records of the
    drapes before it in the same shard, candidates for a borrowed start.
    """
    plan = plan_drape(index, config=config.sampling, prior=config.prior)
    lender = find_lender(plan, config, earlier)
    record = _planned(plan, lender)
    try:
        result = _drape(plan, config, solver or load_solver(), lender, record)
        record |= _outcome(str(getattr(result.status, "value", result.status)), result.message)
        record |= {"residual": result.outcome.residual, "iterations": result.iterations}
        try:
            record |= _mesh(result)
        except OverflowError as error:
            return record | (_outcome("out_of_range", str(error)) if result.converged else {})
        if not result.converged:
            return record
        from sim.measures import drape_coefficient, fold_count  # late, like the solver

        rig = plan.nuisances.rig(plan.rig)
        return record | _moves(result) | {
            "drape_coefficient": drape_coefficient(result.positions, result.faces, rig),
            "folds": fold_count(result.positions, result.rest, rig)}
    except NUMERICAL_ERRORS as error:
        return record | _outcome("exception", f"{type(error).__name__}: {error}")


def find_lender(plan: DrapePlan, config: DatasetConfig, earlier: Sequence[Record]) -> Record | None:
    """Choose the initial state of a borrowed start among converged drapes of other fabrics (Feng et
    al. 2022, section 5.2.1), if there are any.
    """
    candidates = {int(record["index"]): record for record in earlier
                  if record["status"] == b"converged" and record["fabric"] != plan.fabric}
    if plan.start != BORROWED or not candidates:
        return None
    return candidates[choose_lender(plan.index, seed=config.sampling.seed,
                                    candidates=sorted(candidates))]


def load_solver() -> Solver:
    """The simulator; imported late, because the main process needs no compiled kernels. Its drapes
    keep their factors for derivatives."""
    from sim.draping import drape

    return partial(drape, keep=True)


def _drape(
    plan: DrapePlan, config: DatasetConfig, solver: Solver, lender: Record | None, record: dict
) -> Any:
    """The solver's result; density and edge are added to the record."""
    words = drape_words(plan, config)
    if lender is not None:
        # Rounded as stored, so that the drape can be repeated from the shard alone.
        del words["start"]
        words["borrowed"] = lender["rest"] * LENGTH_UNIT, lender["positions"] * LENGTH_UNIT
    record |= {"density": words["fabric"].density, "edge": words["edge"]}
    return solver(**words)


def drape_words(plan: DrapePlan, config: DatasetConfig) -> dict:
    """Arguments of :func:`sim.draping.drape` by name for a planned drape that borrows nothing."""
    fabric, rig = fabric_from_theta(plan.theta), plan.nuisances.rig(plan.rig)
    edges = (DEFAULT_EDGES if config.edge is None else
             [factor * config.edge for factor in COARSER])
    offset = tuple(plan.offset)
    return {"fabric": fabric, "rig": rig, "edge": default_edge(fabric, rig, edges, offset),
            "seed": plan.seed, "offset": offset, "laws": plan.nuisances.laws,
            "start": plan.fallback}


def _planned(plan: DrapePlan, lender: Record | None) -> dict:
    """The record of a drape before its simulation."""
    return {name: np.zeros(field.shape, field.dtype) for name, field in fields(0, 0).items()} | {
        "rest": np.zeros((0, 2), np.int16),
        "index": plan.index,
        "fabric": plan.fabric,
        "theta": plan.theta,
        "rejected": plan.rejected,
        "shift": plan.shift,
        "specimen": plan.rig.specimen.encode(),
        "sides": plan.rig.sides,
        "plate_diameter": plan.rig.plate_diameter,
        "rim": plan.rig.rim,
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


def _mesh(result: Any) -> dict:
    return {"positions": to_counts(result.positions), "rest": to_counts(result.rest),
            "vertices": len(result.rest)}


def _moves(result: object) -> dict:
    """Derivatives of a drape, while it is not yet rounded: a stored one is an equilibrium only
    after many Newton steps. Empty near a fold, and for a shape that is not the simulator's."""
    from sim.draping import Drape
    from sim.sensitivity import sensitivities

    if not isinstance(result, Drape):
        return {}
    found = sensitivities(result, parameters=MOVED_BY)
    return to_moves(found.positions) if found.ok else {}
