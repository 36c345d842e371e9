"""Drapes of neighbouring fabrics by linear extrapolation, at a fifth of the cost of a simulation.

For small changes of its moduli and its membrane stiffness, a stored drape moves linearly. A capture
of the moved drape shows another fabric with the same folds, so that one simulation yields training
captures of several fabrics.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from data.fabrics.fabrics import fabric_from_theta
from data.fabrics.nuisances import Nuisances
from sim.drape import FINE_OPTIONS, scene_on
from sim.equilibrium import find_equilibrium
from sim.material import REFERENCE_DENSITY
from sim.mesh.specimen import TOPOLOGIES, make_specimen
from sim.rig import Rig
from sim.sensitivity import Tangent
from sim.sensitivity.forward import tangent_sensitivities

NEIGHBOUR_CORRELATION = 0.97
"""Correlation of a neighbour's parameters with the fabric's: a distance of about a quarter of a
standard deviation, which moves a drape by 1 mm; the linear prediction has an error of a quarter."""
PARAMETERS = 7  # theta and the logarithm of the membrane stiffness
_MEMBRANE = np.log(10.0) / (2 * 1.96)  # standard deviation of the logarithm, as configs/nuisances
_EQUILIBRIUM_TOLERANCE = 5e-4  # m, maximum move of a stored drape to its equilibrium


def moves(
    row: Mapping[str, np.ndarray], positions: np.ndarray, origin: np.ndarray, rig: Rig
) -> np.ndarray | None:
    """(7, V, 3) derivatives of a stored drape's positions, m, by theta and the logarithm of the
    membrane stiffness; None if they do not exist.

    Args:
        row: theta, nuisances, edge, seed and offset of the drape, as stored in a shard.
        positions: (V, 3) m.
        origin: (F, 3) 1/m, curvatures without friction.
        rig: the dataset's.
    """
    nuisances = Nuisances(*row["nuisances"])
    rig, fabric = nuisances.rig(rig), fabric_from_theta(row["theta"])
    specimen = make_specimen(rig, edge=float(row["edge"]), topology=int(row["seed"]) % TOPOLOGIES,
                             offset=tuple(row["offset"]))
    positions = positions.copy()
    positions[specimen.held] = rig.place(specimen.mesh.rest[specimen.held])
    scene = scene_on(specimen, rig)
    laws = nuisances.laws
    if nuisances.hysteresis:
        laws = replace(laws, bending=replace(laws.bending, origin=origin[scene.active]))
    found = find_equilibrium(scene, fabric.at_density(REFERENCE_DENSITY), scene.state(positions),
                             laws=laws, options=FINE_OPTIONS, self_contact=True)
    if np.abs(found.state.positions - positions).max() > _EQUILIBRIUM_TOLERANCE:
        return None
    derivatives = tangent_sensitivities(Tangent(found), fabric, ("log_alpha", "ratio", "membrane"))
    return derivatives.positions if derivatives.ok else None


def change(theta: np.ndarray, fabrics: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(7,) random change of theta and of the logarithm of the membrane stiffness.

    The changed fabrics have the mean and the covariance of ``fabrics``.

    Args:
        theta: (6,) of the drape's fabric.
        fabrics: (N, 6) theta of fabrics of the same distribution.
    """
    far = np.sqrt(1 - NEIGHBOUR_CORRELATION**2)
    middle = fabrics.mean(axis=0)
    other = fabrics[rng.integers(len(fabrics))]
    return np.append((NEIGHBOUR_CORRELATION - 1) * (theta - middle) + far * (other - middle),
                     far * _MEMBRANE * rng.standard_normal())
