"""Hanging strips compared with the heavy elastica.

Clamped strips on four triangulations: deviation of drop over reach (H/W) from the boundary-value
solution.
"""


import numpy as np

from common.errors import InputError
from experiments.report import Report
from experiments.study import CaseKeys, Study, samples_of
from sim.cantilever import aspect_ratio, elastica, fabric_of_gamma
from sim.cantilever.strip import TIGHT
from sim.equilibrium import find_equilibrium
from sim.mesh import Mesh, strip
from sim.scene import Scene
from sim.solver.newton import Status
from sim.solver.state import State
from sim.start import interpolate_positions

LENGTH, WIDTH = 0.09, 0.027  # m
MAX_DEVIATION = 0.005  # relative deviation of H/W
CELLS = (20, 40, 80, 160)  # along the free length
CLAMP = 2 * LENGTH / CELLS[0]  # m, equal on all meshes
TABLE_CELLS = ((40.0, 40), (200.0, 80), (np.inf, 160))
"""Upper limits of gamma, and cells along the strip in the table up to that limit."""

MESHES = {
    "alternating": {"diagonals": "alternating"},
    "equal": {"diagonals": "equal"},
    "random": {"diagonals": "random", "seed": 1},
    "jittered": {"diagonals": "random", "jitter": 0.2, "seed": 2},
}


class Keys(CaseKeys):
    gammas: tuple[float, ...] = (  # rho g L³/alpha of the strips
        0.1, 0.231, 0.5337, 1.233, 2.848, 6.579, 15.2, 35.11, 81.11, 187.4, 432.9, 1000.0)
    meshes: tuple[str, ...] = tuple(MESHES)  # triangulations


def free_end(mesh: Mesh, state: State) -> np.ndarray:
    """Mean (reach, drop) (2,), m, of the free end of a strip along +x."""
    x = mesh.rest[:, 0]
    end = state.positions[x > (1 - 1e-9) * x.max()].mean(axis=0)
    return np.array([end[0], -end[2]])


def cells_for(gamma: float) -> int:
    """Number of cells along the strip in the table of deviations."""
    return next(cells for limit, cells in TABLE_CELLS if gamma <= limit)


def hang_series(mesh: str, gammas: list[float], cells: list[int]) -> Report:
    """Deviations of H/W from the elastica for all ``gammas`` on successively finer meshes.

    A strip starts from its shape on the next coarser mesh, on the coarsest mesh from the shape of
    the next smaller gamma. ``cells`` gives the finest mesh of each gamma.
    """
    rows, coarse = [], None
    for level in CELLS:
        grid, held = strip(length=LENGTH, width=WIDTH, edge=LENGTH / level, clamp=CLAMP,
                           **MESHES[mesh])
        flat = np.column_stack([grid.rest, np.zeros(len(grid.rest))])
        scene = Scene(mesh=grid, held=held)
        state, shapes = scene.state(flat), {}
        for gamma, finest in zip(gammas, cells, strict=True):
            if level > finest:
                continue
            if coarse:
                positions = interpolate_positions(coarse[0], coarse[1][gamma], grid.rest)
                positions[held] = flat[held]
                state = scene.state(positions)  # normals of the clamp follow from the positions
            found = find_equilibrium(scene, fabric_of_gamma(gamma, LENGTH), state,
                                     options=TIGHT)
            state = found.state
            shapes[gamma] = state.positions
            ratio = aspect_ratio(free_end(grid, state)) if found.converged else None
            expected = aspect_ratio(elastica(gamma)[-1])
            rows.append({"gamma": gamma, "cells": level, "status": found.status.value,
                         "aspect_ratio": ratio,
                         "deviation": ratio / expected - 1 if found.converged else None})
        coarse = grid.rest, shapes
    return {"rows": rows}


def run(keys: Keys) -> Report:
    """Simulate all strips."""
    if unknown := set(keys.meshes) - set(MESHES):
        raise InputError(f"unknown mesh '{unknown.pop()}'; choose from {', '.join(MESHES)}")
    gammas = sorted(keys.gammas)
    cells = [cells_for(gamma) for gamma in gammas]
    hung = samples_of(hang_series, keys, {
        mesh: {"mesh": mesh, "gammas": gammas, "cells": cells} for mesh in keys.meshes})
    deviations = {mesh: [_at(one["rows"], gamma) for gamma in gammas]
                  for mesh, one in hung.items()}
    largest = _largest(deviations)
    return {"length_m": LENGTH, "width_m": WIDTH, "cells_along": cells,
            "passed": largest is not None and largest <= MAX_DEVIATION,
            "largest_deviation": largest, "deviations": deviations, "strips": hung}


def _at(rows: list[dict], gamma: float) -> float | None:
    """Deviation on the mesh used in the table for ``gamma``, None if it did not converge."""
    row = next(r for r in rows if r["gamma"] == gamma and r["cells"] == cells_for(gamma))
    return row["deviation"] if row["status"] == Status.CONVERGED.value else None


def _largest(by_mesh: dict[str, list]) -> float | None:
    """Largest absolute deviation, None without strips or if one did not converge."""
    values = [value for line in by_mesh.values() for value in line]
    return max(map(abs, values)) if values and None not in values else None


STUDY = Study(Keys, run)
