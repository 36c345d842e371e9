"""Cases of :mod:`experiments.physics.meshes`: their list, and the simulation of each."""

import time
from pathlib import Path

import numpy as np

from experiments.comparison import equilibrium_near
from experiments.result import load_arrays
from sim.cloth import Laws
from sim.drape import drape
from sim.energies.membrane import Corotational
from sim.material import MICRO, Fabric
from sim.measures import drape_coefficient, fold_angles, fold_outline
from sim.mesh import Mesh
from sim.mesh.specimen import TOPOLOGIES, Specimen, make_specimen
from sim.rig import Rig
from sim.solver.newton import Status

# Moduli warp, bias, weft in µN·m at 300 g/m²; beta/alpha of a typical fabric, mm.
FABRICS = {
    "soft": (5.0, 5.0, 5.0),
    "median": (20.0, 20.0, 20.0),
    "stiff": (100.0, 100.0, 100.0),
    "warp-stiff": (40.0, 18.0, 10.0),
    "weft-stiff": (8.0, 16.0, 40.0),
    "bias-soft": (50.0, 14.0, 40.0),
}
BETA_OVER_ALPHA_MM = -2.5
MESHES = ("graded", "other", "uniform")
"""Two graded triangulations, and a mesh with about as many triangles of uniform size."""
DEFAULT_LAW = "midedge"


def common_start(alpha: list[float], edge_mm: float, membrane: float, seed: int) -> dict:
    """Drape a fabric of moduli ``alpha`` (3,), µN·m, as the common start of its cases."""
    laws = Laws(membrane=Corotational(stiffness=membrane))
    result = drape(_fabric(alpha), edge=1e-3 * edge_mm, seed=seed, laws=laws, start="sine")
    return _results(result.mesh, result.positions, result.status, result.seconds)


def drape_near(
    alpha: list[float], law: str, mesh: str, edge_mm: float, membrane: float, seed: int, begin: str
) -> dict:
    """Find the equilibrium on a mesh, started from the drape in the npz file ``begin``."""
    began = time.perf_counter()
    near = load_arrays(Path(begin).parent, Path(begin).stem)
    specimen = specimen_on(mesh, 1e-3 * edge_mm, seed)
    found = equilibrium_near(near["rest"], near["positions"], specimen, Rig(), _fabric(alpha),
                             Laws(bending=law, membrane=Corotational(stiffness=membrane)))
    return _results(specimen.mesh, found.state.positions, found.status,
                    time.perf_counter() - began)


def specimen_on(kind: str, edge: float, seed: int) -> Specimen:
    """Specimen on a mesh of :data:`MESHES`, with edges of ``edge``, m, at the rim."""
    rig = Rig()
    if kind != "uniform":
        return make_specimen(rig, edge=edge, topology=(seed + (kind == "other")) % TOPOLOGIES)
    graded = make_specimen(rig, edge=edge, topology=seed % TOPOLOGIES)
    moving = ~graded.held[graded.mesh.faces].all(axis=1)
    alike = np.sqrt(4 / np.sqrt(3) * graded.mesh.areas[moving].mean())
    return make_specimen(rig, edge=float(alike), topology=seed % TOPOLOGIES, grading=1.0)


def _fabric(alpha: list[float]) -> Fabric:
    moduli = np.array(alpha) * MICRO
    return Fabric(moduli, BETA_OVER_ALPHA_MM * 1e-3 * moduli)


def _results(mesh: Mesh, positions: np.ndarray, status: Status, seconds: float) -> dict:
    """Stored results of a drape."""
    return {
        "status": status.value,
        "triangles": len(mesh.faces),
        "folds": len(fold_angles(fold_outline(positions, mesh.rest, Rig()))),
        "drape_coefficient": drape_coefficient(positions, mesh.faces, Rig()),
        "seconds": round(seconds, 2),
        "arrays": {"rest": mesh.rest, "positions": positions, "faces": mesh.faces},
    }


def plan(fabric: str, config: dict) -> tuple[dict[str, dict], dict[str, dict], dict[str, dict]]:
    """Cases of one fabric by name, in three groups that depend on the previous ones.

    The common start, the drapes started from it, and the return from the uniform mesh.
    """
    common = {"alpha": list(FABRICS[fabric]), "seed": config["seed"],
              "membrane": config["membrane"]}
    folder, edge = Path(config["cases"]), config["edge_mm"]
    start = f"{fabric}_start_{config['start_mm']:g}"
    wanted = {(law, mesh, edge) for law in laws_for(fabric, config) for mesh in MESHES}
    wanted |= {(DEFAULT_LAW, mesh, mm) for mesh in MESHES for mm in config["refinement_mm"]}
    drapes = {
        case_name(fabric, law, mesh, mm): {
            **common, "law": law, "mesh": mesh, "edge_mm": mm, "begin": str(folder / start)
        }
        for law, mesh, mm in sorted(wanted)
    }
    far = case_name(fabric, DEFAULT_LAW, "uniform", edge)
    back = {
        case_name(fabric, DEFAULT_LAW, "return", edge): {
            **common, "law": DEFAULT_LAW, "mesh": "graded", "edge_mm": edge,
            "begin": str(folder / far),
        }
    }
    # On another triangulation, because on that of the cases the start is already the equilibrium.
    own = {**common, "seed": config["seed"] + 2, "edge_mm": config["start_mm"]}
    return {start: own}, drapes, back


def laws_for(name: str, config: dict) -> list[str]:
    """Laws to compare; for isotropic fabrics without those that differ only by direction."""
    laws = list(dict.fromkeys([DEFAULT_LAW, *config["laws"]]))
    isotropic = len(set(FABRICS[name])) == 1
    return [law for law in laws if not (isotropic and law.endswith("_edge"))]


def case_name(fabric: str, law: str, mesh: str, edge_mm: float) -> str:
    """Name of the files of a case."""
    return f"{fabric}_{law}_{mesh}_{edge_mm:g}"
