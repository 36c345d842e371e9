"""The drapes of :mod:`benchmarks.meshes`: which there are, and how each is made."""

import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from sim.specimens import make_specimen

from benchmarks.common import load_arrays
from common.errors import InputError
from sim.comparison import Draped
from sim.drape import drape
from sim.initial import borrowed_positions
from sim.lagged import find_settled_equilibrium
from sim.laws import Corotational, Laws
from sim.material import MICRO, Fabric
from sim.measures import drape_coefficient, fold_angles, fold_outline
from sim.newton import NewtonOptions
from sim.scene import Rig, Scene, State

# Moduli warp, bias, weft in µN·m at 300 g/m²; beta/alpha of a typical fabric, mm.
FABRICS = {
    "soft": (5.0, 5.0, 5.0),
    "median": (20.0, 20.0, 20.0),
    "stiff": (100.0, 100.0, 100.0),
    "warp-stiff": (40.0, 18.0, 10.0),
    "weft-stiff": (8.0, 16.0, 40.0),
    "bias-soft": (50.0, 14.0, 40.0),
}
SOFTENING = -2.5
MESHES = ("structured", "perturbed", "unstructured")
DEFAULT_LAW = "midedge"


def common_start(alpha: list[float], resolution: int, membrane: float, seed: int) -> dict:
    """Drape a fabric of moduli ``alpha`` (3,), µN·m, in the usual way."""
    laws = Laws(membrane=Corotational(stiffness=membrane))
    result = drape(_fabric(alpha), resolution=resolution, seed=seed, laws=laws)
    return _figures(result, result.status, result.seconds)


def one_drape(
    alpha: list[float], law: str, mesh: str, resolution: int, membrane: float, seed: int, begin: str
) -> dict:
    """The equilibrium on a mesh next to the drape in the npz file ``begin``."""
    began = time.perf_counter()
    rig = Rig()
    specimen = make_specimen(rig, mesh=mesh, resolution=resolution, seed=seed)
    cloth, held = specimen.mesh, specimen.held
    near = load_arrays(Path(begin).parent, Path(begin).stem)
    positions = borrowed_positions(
        cloth.rest, rig=rig, borrowed=(near["rest"], near["positions"])
    )
    positions[held] = rig.place(cloth.rest[held])
    state, result, settling = find_settled_equilibrium(
        Scene(mesh=cloth, held=held, obstacles=rig.obstacles),
        _fabric(alpha),
        State.at(cloth, positions),
        laws=Laws(bending=law, membrane=Corotational(stiffness=membrane)),
        options=NewtonOptions(residual=1e-4, step=1e-4, max_iterations=400),
    )
    shape = SimpleNamespace(rest=cloth.rest, positions=state.positions, faces=cloth.faces)
    return {"rounds": settling.rounds,
            **_figures(shape, result.status, time.perf_counter() - began)}


def _fabric(alpha: list[float]) -> Fabric:
    moduli = np.array(alpha) * MICRO
    return Fabric(moduli, SOFTENING * 1e-3 * moduli)


def _figures(shape: Draped, status: str, seconds: float) -> dict:
    """What is kept of a drape."""
    outline = fold_outline(shape.positions, shape.rest, Rig())
    return {
        "status": str(getattr(status, "value", status)),
        "vertices": len(shape.rest),
        "folds": len(fold_angles(outline)),
        "drape_coefficient": drape_coefficient(shape.positions, shape.faces, Rig()),
        "seconds": round(seconds, 2),
        "arrays": {"rest": shape.rest, "positions": shape.positions, "faces": shape.faces},
    }


def chosen_fabrics(config: dict) -> list[str]:
    """Names of the fabrics to drape."""
    names = list(FABRICS) if config["fabrics"] == "all" else config["fabrics"].split(",")
    if unknown := set(names) - set(FABRICS):
        raise InputError(f"unknown fabric '{min(unknown)}'; choose from {', '.join(FABRICS)}")
    return names


def plan(fabric: str, config: dict) -> tuple[dict[str, dict], dict[str, dict], dict[str, dict]]:
    """Cases of one fabric by name, in the order in which they need each other.

    The common start, the drapes next to it, and the return from the unstructured mesh.
    """
    common = {"alpha": list(FABRICS[fabric]), "seed": config["seed"],
              "membrane": config["membrane"]}
    folder, n = Path(config["cases"]), config["resolution"]
    start = f"{fabric}_start_{config['start']}"
    wanted = {(law, mesh, n) for law in laws_for(fabric, config) for mesh in MESHES}
    wanted |= {(DEFAULT_LAW, mesh, m) for mesh in MESHES for m in config["refinement"]}
    drapes = {
        case_name(fabric, law, mesh, m): {
            **common, "law": law, "mesh": mesh, "resolution": m, "begin": str(folder / start)
        }
        for law, mesh, m in sorted(wanted)
    }
    far = case_name(fabric, DEFAULT_LAW, "unstructured", n)
    back = {
        case_name(fabric, DEFAULT_LAW, "return", n): {
            **common, "law": DEFAULT_LAW, "mesh": "perturbed", "resolution": n,
            "begin": str(folder / far),
        }
    }
    # A mesh of its own: on the start's mesh the start would simply stay.
    own = {**common, "seed": config["seed"] + 1, "resolution": config["start"]}
    return {start: own}, drapes, back


def laws_for(name: str, config: dict) -> list[str]:
    """Laws to compare for a fabric: without those that an isotropic fabric does not tell apart."""
    laws = list(dict.fromkeys([DEFAULT_LAW, *config["laws"].split(",")]))
    isotropic = len(set(FABRICS[name])) == 1
    return [law for law in laws if not (isotropic and law.endswith(("_edge", "_curvature")))]


def case_name(fabric: str, law: str, mesh: str, resolution: int) -> str:
    """Name of a drape's files."""
    return f"{fabric}_{law}_{mesh}_{resolution}"
