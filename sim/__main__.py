"""Drape one fabric: ``python -m sim alpha=20,20,20 beta=0,0,0 out=outputs/a``.

Keys (``key=value``):

    alpha        linear moduli warp,bias,weft in µN·m
    beta         quadratic moduli warp,bias,weft in nN·m², usually negative
    density      g/m²; the shape depends on moduli/density only
    rig          square300_cylinder100: 300 mm square on a cylinder of 100 mm
    start        initial shape: sine or fold
    seed         of the initial shape and of the triangulation
    resolution   vertices a side
    offset       specimen's centre off the plate's axis along warp,weft in mm
    out          folder for drape.ply (mesh, metres), drape.png and drape.json
"""

import json
import sys
from pathlib import Path

import numpy as np

from sim.cli import parse_overrides, run_command
from sim.drape import DrapeResult, drape
from sim.errors import InputError
from sim.files import replace_file
from sim.material import DIRECTIONS, MICRO, NANO, Fabric
from sim.measures import drape_coefficient, fold_count, maximum_stretch
from sim.scene import Rig

DEFAULTS = {
    "alpha": [20.0, 20.0, 20.0],
    "beta": [0.0, 0.0, 0.0],
    "density": 300.0,
    "rig": "square300_cylinder100",
    "start": "sine",
    "seed": 0,
    "resolution": 51,
    "offset": [0.0, 0.0],
    "out": "outputs/drape",
}


def main(argv: list[str]) -> None:
    """Simulate, print what came out, and write the three files."""
    if {"-h", "--help", "help"} & set(argv):
        print(__doc__)
        return
    config = parse_overrides(DEFAULTS, argv)
    if len(config["offset"]) != 2:
        raise InputError("offset needs two values in mm: along warp, along weft")
    fabric = Fabric(
        alpha=np.array(config["alpha"]) * MICRO,
        beta=np.array(config["beta"]) * NANO,
        density=config["density"] * 1e-3,
    )
    result = drape(
        fabric,
        rig=Rig.from_name(config["rig"]),
        resolution=config["resolution"],
        start=config["start"],
        seed=config["seed"],
        offset=tuple(1e-3 * v for v in config["offset"]),
    )
    summary = summarise(result, config)
    folder = Path(config["out"])
    write(folder, result, summary)
    print(f"{summary['status']}: {summary['message']}")
    print(f"residual            {summary['residual']:.1e} of a vertex's weight")
    print(f"minimum             {'yes' if summary['positive_definite'] else 'not proven'}")
    print(f"drape coefficient   {100 * summary['drape_coefficient']:.1f} %")
    print(f"folds               {summary['fold_count']}")
    print(f"largest stretch     {100 * summary['maximum_stretch']:.2f} %")
    print(f"{summary['iterations']} Newton steps, {summary['seconds']:.1f} s; see {folder}/")


def summarise(result: DrapeResult, config: dict) -> dict:
    """What drape.json says: parameters in people's units, outcome, measures."""
    return {
        "parameters": {
            "alpha_uN_m": dict(zip(DIRECTIONS, config["alpha"], strict=True)),
            "beta_nN_m2": dict(zip(DIRECTIONS, config["beta"], strict=True)),
            "density_g_m2": config["density"],
            **{key: config[key] for key in ("rig", "start", "seed", "resolution")},
            "offset_mm": config["offset"],
        },
        "status": result.status.value,
        "message": result.message,
        "residual": result.residual,
        "last_step_mm": result.step,
        "positive_definite": result.positive_definite,
        "iterations": result.iterations,
        "seconds": round(result.seconds, 3),
        "drape_coefficient": drape_coefficient(result.positions, result.faces, result.rig),
        "fold_count": fold_count(result.positions, result.rest, result.rig),
        "maximum_stretch": maximum_stretch(
            result.positions, result.rest, result.faces, result.held
        ),
    }


def write(folder: Path, result: DrapeResult, summary: dict) -> None:
    """Write drape.ply, drape.png and drape.json, each whole or not at all."""
    # Pictures and mesh formats are the command line's business, not the simulator's.
    import cv2
    import trimesh

    from data.picture import shade

    mesh = trimesh.Trimesh(result.positions, result.faces, process=False)
    radius = result.rig.plate_radius
    views = [shade(result.positions, result.faces, plate_radius=radius, elevation=angle)
             for angle in (25.0, 90.0)]
    _, picture = cv2.imencode(".png", np.hstack(views)[..., ::-1])
    replace_file(folder / "drape.ply", mesh.export(file_type="ply"))
    replace_file(folder / "drape.png", picture.tobytes())
    replace_file(folder / "drape.json", (json.dumps(summary, indent=2) + "\n").encode())


def entry() -> None:
    """Console script."""
    run_command(main)


if __name__ == "__main__":
    sys.exit(entry())
