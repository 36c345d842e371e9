"""Drape one fabric.

    python -m apps.drape alpha=60,40,30 beta=-90,-60,-45 out=outputs/a

``drape.npz``, from which another drape can start, is a NumPy archive of four arrays: ``rest``
(V, 2) and ``positions`` (V, 3) in metres, float64; ``faces`` (F, 3) int64; ``held`` (V,) bool. Axes
and origin as in :class:`sim.draping.Drape`.
"""

import common.interrupt  # noqa: F401

# isort: split
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common.command import command
from common.compiled import announce
from common.configs import metres
from common.documents import read_arrays
from common.errors import InputError
from common.files import folder_named, replace_file, replace_json, require_folder
from common.types import Points, RestPoints
from sim.draping import Drape, drape
from sim.material import DIRECTIONS, MICRO, NANO, Fabric
from sim.nearest import nearest
from sim.rig import Rig
from sim.start import LOWERED


@dataclass
class DrapeConfig:
    """``configs/drape.yaml``."""

    alpha: list[float]
    beta: list[float]
    density: float
    rig: str
    start: str | None
    borrow: str
    seed: int
    edge_mm: float | None
    offset: list[float]
    out: str


@command("drape", DrapeConfig)
def main(config: DrapeConfig) -> None:
    """Simulate the drape, print a summary and write the files."""
    folder = folder_named(config.out)
    if len(config.offset) != 2:
        raise InputError(f"offset={config.offset} has {len(config.offset)} values; give two in mm, "
                         "along warp and along weft")
    fabric = Fabric(np.array(config.alpha) * MICRO, np.array(config.beta) * NANO,
                    config.density * 1e-3)
    require_folder(folder)
    announce(nearest)
    result = drape(
        fabric,
        rig=Rig.from_name(config.rig),
        edge=metres(config.edge_mm),
        start=config.start,
        borrowed=read_borrowed(Path(config.borrow)) if config.borrow else None,
        seed=config.seed,
        offset=tuple(1e-3 * v for v in config.offset),
    )
    summary = summarise(result, config)
    write(folder, result, summary)
    print(f"{summary['status']}: {summary['message']}")
    print(f"residual            {summary['residual']:.1e} of a vertex's weight")
    print(f"minimum             {'yes' if summary['positive_definite'] else 'not proven'}")
    if result.rig.has_plate:
        print(f"drape coefficient   {100 * summary['drape_coefficient']:.1f} %")
        print(f"folds               {summary['fold_count']}")
    print(f"largest stretch     {100 * summary['maximum_stretch']:.2f} %")
    print(f"{summary['iterations']} Newton steps, {summary['seconds']:.1f} s; see {folder}/")


def summarise(result: Drape, config: DrapeConfig) -> dict:
    """Contents of drape.json: parameters, status and measures; None where they need a plate."""
    from sim.measures import drape_coefficient, fold_count, max_penetration, maximum_stretch

    positions, faces, rig = result.positions, result.faces, result.rig
    return {
        "parameters": {
            "alpha_uN_m": dict(zip(DIRECTIONS, config.alpha, strict=True)),
            "beta_nN_m2": dict(zip(DIRECTIONS, config.beta, strict=True)),
            "density_g_m2": config.density,
            **{key: getattr(config, key) for key in ("rig", "borrow", "seed")},
            "start": None if config.borrow else config.start or (
                LOWERED if rig.has_plate else "sine"),
            "edge_mm": round(1e3 * result.edge, 6),
            "offset_mm": config.offset,
        },
        "status": result.status.value,
        "message": result.message,
        "coarser_meshes": [status.value for status in result.coarse],
        "residual": result.outcome.residual,
        "last_step_mm": result.outcome.step,
        "positive_definite": result.outcome.positive_definite,
        "self_intersections": result.self_intersections,
        "iterations": result.iterations,
        "seconds": round(result.seconds, 3),
        "drape_coefficient": drape_coefficient(positions, faces, rig) if rig.has_plate else None,
        "fold_count": fold_count(positions, result.rest, rig) if rig.has_plate else None,
        "deepest_entry_mm": 1e3 * max_penetration(positions, faces, rig),
        "maximum_stretch": maximum_stretch(positions, result.rest, faces, result.held),
    }


def write(folder: Path, result: Drape, summary: dict) -> None:
    """Write drape.ply, drape.png, drape.json and drape.npz, each atomically."""
    import cv2  # slow to load, as the next
    import trimesh

    from data.render.shade import shade

    mesh = trimesh.Trimesh(result.positions, result.faces, process=False)
    size, radius = max(result.rig.sides), result.rig.plate_radius
    # Images are centred at the height of the plate, to which hung cloth is raised.
    raised = np.array([0.0, 0.0, 0.0 if result.rig.has_plate else 0.4 * size])
    views = [shade(result.positions + raised, result.faces, plate_radius=radius, elevation=angle,
                   field=4 / 3 * size)
             for angle in (25.0, 90.0)]
    _, picture = cv2.imencode(".png", np.hstack(views)[..., ::-1])
    replace_file(folder / "drape.ply", mesh.export(file_type="ply"))
    replace_file(folder / "drape.png", picture.tobytes())
    replace_json(folder / "drape.json", summary)
    write_drape(folder / "drape.npz", result)


def write_drape(path: Path, result: Drape) -> None:
    """Write ``result`` to ``path`` atomically."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, rest=result.rest, positions=result.positions, faces=result.faces,
                        held=result.held)
    replace_file(path, buffer.getvalue())


def read_borrowed(path: Path) -> tuple[RestPoints, Points]:
    """Rest points and positions of the drape in a file."""
    expected = "a drape.npz with rest and positions"
    arrays = read_arrays(path, ("rest", "positions"), expected=expected)
    rest, positions = arrays["rest"], arrays["positions"]
    for name, array, columns in (("rest", rest, 2), ("positions", positions, 3)):
        if array.dtype.kind != "f" or array.shape != (len(rest) if rest.ndim else 0, columns):
            raise InputError(f"{path}: {name} must be numbers of shape (V, {columns}); they have "
                             f"the type {array.dtype} and the shape {array.shape}")
        if not np.isfinite(array).all():
            raise InputError(f"{path}: {name} holds numbers that are not finite")
    return rest, positions


if __name__ == "__main__":
    main()
