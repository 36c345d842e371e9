"""The mesh of a rig's specimen: which kind of triangulation, which vertices are held."""

from dataclasses import dataclass

import numpy as np

from common.errors import InputError
from sim.energies.contact import Ramp
from sim.mesh import (
    Mesh,
    check_resolution,
    choose_diagonals,
    draped_square,
    grid_faces,
    grid_points,
    strip,
)
from sim.rings import draped_disc
from sim.scene import Rig, Scene
from sim.unstructured import unstructured_disc, unstructured_square

MESHES = ("structured", "perturbed", "unstructured")


@dataclass(frozen=True)
class Specimen:
    """A rig's specimen, meshed.

    Attributes:
        mesh: origin of ``rest`` on the plate's axis, without a plate at the specimen's centre.
        held: (V,) bool, vertices that the rig holds.
        diagonals: (n-1, n-1) bool so that ``mesh.faces == sim.mesh.grid_faces(diagonals)``; None
            for meshes that are no grids.
    """

    mesh: Mesh
    held: np.ndarray
    diagonals: np.ndarray | None = None


def make_specimen(
    rig: Rig,
    *,
    mesh: str = "perturbed",
    resolution: int,
    offset: tuple[float, float] = (0.0, 0.0),
    jitter: float = 0.15,
    diagonals: str | None = None,
    seed: int = 0,
) -> Specimen:
    """Mesh the specimen of ``rig``.

    Args:
        mesh: "structured": a regular grid, for discs regular rings; "perturbed": the same with
            its vertices moved at random; "unstructured": see :mod:`sim.unstructured`.
        resolution: vertices a side or, of a disc, across, within
            :data:`sim.mesh.RESOLUTIONS`. An unstructured mesh has edges as long as a grid's
            spacing.
        offset: specimen's centre from the plate's axis, m.
        jitter: of a perturbed mesh, in spacings.
        diagonals: of a grid, see :data:`sim.mesh.DIAGONALS`; None for random ones in a
            perturbed mesh and alternating ones in a structured one.
        seed: of all that is random.

    Raises:
        InputError: arguments that make no mesh.
    """
    if mesh not in MESHES:
        raise InputError(f"unknown mesh '{mesh}'; choose from {', '.join(MESHES)}")
    check_resolution(resolution)
    if not rig.has_plate and np.any(offset):
        raise InputError(f"rig {rig.name} has no plate for an offset to refer to")
    if diagonals is not None and (rig.specimen == "disc" or mesh == "unstructured"):
        kind = "an unstructured mesh" if mesh == "unstructured" else "the mesh of a disc"
        raise InputError(f"diagonals={diagonals}: {kind} has none to choose")
    perturbed = mesh == "perturbed"
    edge = rig.specimen_size / (resolution - 1)
    if mesh == "unstructured":
        return _unstructured(rig, resolution=resolution, offset=offset, seed=seed)
    if rig.specimen == "disc":
        return Specimen(
            *draped_disc(
                diameter=rig.specimen_size,
                plate_radius=rim_radius(rig, edge),
                resolution=resolution,
                offset=offset,
                perturbed=perturbed,
                jitter=jitter,
                seed=seed,
            )
        )
    chosen = diagonals or ("random" if perturbed else "alternating")
    jitter = jitter if perturbed else 0.0
    if not rig.has_plate:
        return _hung(rig.specimen_size, resolution, chosen, jitter, seed)
    return Specimen(
        *draped_square(
            size=rig.specimen_size,
            plate_radius=rim_radius(rig, edge),
            resolution=resolution,
            offset=offset,
            diagonals=chosen,
            jitter=jitter,
            seed=seed,
        )
    )


def rim_radius(rig: Rig, edge: float) -> float:
    """Radius on which a mesh of the spacing ``edge`` has the rim's vertices, m.

    A little outside the plate's, so that the polygon through them has the plate's area: with
    corners on the rim it would hold too little cloth and lie inside the cylinder.
    """
    chord = edge / rig.plate_radius
    return rig.plate_radius * (1 + chord**2 / 12)


def _unstructured(
    rig: Rig, *, resolution: int, offset: tuple[float, float], seed: int
) -> Specimen:
    edge = rig.specimen_size / (resolution - 1)
    if not rig.has_plate:
        mesh, _ = unstructured_square(size=rig.specimen_size, edge=edge, seed=seed)
        return Specimen(mesh, _upper_corners(mesh, rig.specimen_size))
    if rig.specimen_size / 2 - np.hypot(*offset) < rig.plate_radius + 1.5 * edge:
        raise InputError(f"the specimen's overhang is too narrow for {resolution} vertices a side; "
                         "reduce the offset or refine")
    settings = {"edge": edge, "plate_radius": rim_radius(rig, edge), "offset": offset, "seed": seed}
    if rig.specimen == "disc":
        return Specimen(*unstructured_disc(diameter=rig.specimen_size, **settings))
    return Specimen(*unstructured_square(size=rig.specimen_size, **settings))


def _hung(size: float, resolution: int, diagonals: str, jitter: float, seed: int) -> Specimen:
    """A plain grid held by the two corners at the largest y."""
    rng = np.random.default_rng(seed)
    shape = (resolution, resolution)
    points = grid_points(shape, (size, size), jitter, rng) - size / 2
    cells = choose_diagonals(shape, diagonals, rng)
    mesh = Mesh(rest=points.reshape(-1, 2), faces=grid_faces(cells))
    return Specimen(mesh, _upper_corners(mesh, size), cells)


def _upper_corners(mesh: Mesh, size: float) -> np.ndarray:
    upper = np.array([1.0, 1.0]) * size / 2
    return np.linalg.norm(np.abs(mesh.rest) * [1, 0] + mesh.rest * [0, 1] - upper, axis=1) < 1e-9


def strip_over_ramp(
    *, length: float, width: float, edge: float, angle: float = np.radians(41.5),
    diagonals: str = "alternating",
) -> Scene:
    """A strip that juts out from a platform over a plane which slopes down from its end.

    The stand of a fixed-angle bending-length tester: the strip is moved forward until its end
    touches the plane. The strip is held where it lies on the platform; along the rest it may
    touch the plane.

    Args:
        length: of the part that juts out, m.
        width, edge: of the strip and of the mesh, m.
        angle: of the plane below the horizontal, rad; 41.5 degrees is where a strip's bending
            length is half its overhang.
        diagonals: see :func:`sim.mesh.strip`.
    """
    mesh, held = strip(length=length, width=width, edge=edge, clamp=2 * edge, diagonals=diagonals)
    return Scene(mesh=mesh, held=held, obstacles=(Ramp(angle),))
