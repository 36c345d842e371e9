"""Square plates under a small uniform load, compared with series solutions.

Isotropic plates have no Poisson effect, as in the default law.
"""

import numpy as np

from common.errors import InputError
from sim.cloth import Laws
from sim.energies.membrane import Corotational
from sim.equilibrium import find_equilibrium
from sim.material import REFERENCE_DENSITY, Fabric, plate_constants
from sim.mesh import Mesh, choose_diagonals, grid_faces, grid_points
from sim.rig import GRAVITY
from sim.scene import Scene
from sim.solver.newton import NewtonOptions

SIDE = 0.1  # m
SMALL_GRAVITY = 1e-3 * GRAVITY
SOFT_MEMBRANE = 1.0
"""N/m, for the small gravity: the membrane bears no load, and its rounding errors are small."""

CLAMPED = 0.00126532  # centre deflection of a clamped isotropic square plate, times q a⁴/D
PLATES = {
    "supported, isotropic": ((30e-6, 30e-6, 30e-6), False),
    "supported, orthotropic": ((30e-6, 20e-6, 15e-6), False),
    "clamped, isotropic": ((30e-6, 30e-6, 30e-6), True),
}
"""alpha in warp, bias and weft, N·m, and whether the sides are clamped (else simply supported)."""


def plate(*, kind: str, cells: int) -> dict:
    """Relative error of the deflection at the centre of a plate of ``cells`` by ``cells``.

    Raises:
        InputError: the plate does not converge.
    """
    alpha, clamped = PLATES[kind]
    fabric = Fabric(np.array(alpha))
    ring = 1 if clamped else 0
    shape = (cells + 1 + 2 * ring,) * 2
    step = SIDE / cells
    points = grid_points(shape, (SIDE + 2 * ring * step,) * 2, 0.0, np.random.default_rng(0))
    points -= ring * step
    # With an even number of cells the diagonals cut the corners, so that only triangles of the
    # clamped ring have all vertices held.
    faces = grid_faces(choose_diagonals(shape, "alternating", np.random.default_rng(0)))
    mesh = Mesh(rest=points.reshape(-1, 2), faces=faces)
    inside = ((mesh.rest > 0.5 * step) & (mesh.rest < SIDE - 0.5 * step)).all(axis=1)
    flat = np.column_stack([mesh.rest, np.zeros(len(mesh.rest))])
    scene = Scene(mesh=mesh, held=~inside, gravity=SMALL_GRAVITY)
    found = find_equilibrium(
        scene, fabric, scene.state(flat),
        laws=Laws(membrane=Corotational(SOFT_MEMBRANE)),
        options=NewtonOptions(residual=1e-6, step=1e-6),
    )
    if not found.converged:
        raise InputError(f"the plate '{kind}' does not converge: {found.message}")
    middle = np.argmin(np.linalg.norm(mesh.rest - SIDE / 2, axis=1))
    load = REFERENCE_DENSITY * SMALL_GRAVITY
    exact = load * SIDE**4 * (CLAMPED / fabric.alpha[0] if clamped else navier(fabric))
    deflection = -float(found.state.positions[middle, 2])
    return {"kind": kind, "cells": cells, "error": float(deflection / exact - 1)}


def navier(fabric: Fabric) -> float:
    """Deflection at the centre of a simply supported square plate, divided by q a⁴, 1/(N·m)."""
    a11, a22, a12, a66 = plate_constants(fabric.alpha)
    m = np.arange(1, 400, 2)[:, None]
    n = m.T
    sign = np.where((m + n) // 2 % 2 == 1, 1.0, -1.0)
    form = a11 * m**4 + 2 * (a12 + 2 * a66) * m**2 * n**2 + a22 * n**4
    return float((16 * sign / (np.pi**6 * m * n * form)).sum())
