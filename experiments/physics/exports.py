"""Strips of exported materials in Newton's Style3D, compared with the heavy elastica.

Strips along warp, bias and weft are simulated with the material that :mod:`drapenet.export.formats`
writes for a fabric with one modulus and for one with three. The result is the apparent modulus from
drop over reach, relative to that of the fabric. VBD is not tested: it needs more than 4 000 steps
per second for a strip to come to rest, which takes minutes per second. Needs the extra ``newton``.
"""

import json
import runpy
import tempfile
from pathlib import Path

import numpy as np

from drapenet.export.formats import export
from drapenet.export.material import GAMMA, MESHES, read_material
from drapenet.result.content import SCHEMA, SCHEMA_VERSION
from experiments.physics import style3d
from experiments.result import Config, Result, table
from sim.cantilever.elastica import aspect_ratio, gamma_of_aspect_ratio
from sim.cantilever.tester import free_end
from sim.material import DIRECTIONS, MICRO
from sim.mesh import Mesh, strip
from sim.rig import GRAVITY
from sim.solver.state import State

FABRICS = {"one modulus": (40.0, 40.0, 40.0), "three moduli": (60.0, 40.0, 20.0)}  # µN·m
DENSITY = 200.0  # g/m²
STEP = 1 / 120  # s
MEMBRANE = 400.0  # N/m

ITERATIONS = 400  # of the linear solver; fewer damp the motion


def estimate_file(folder: Path, alphas: tuple[float, ...]) -> Path:
    """Write an ``estimate.json`` of the fabric with intervals of zero width."""
    def exact(value: float) -> dict:
        return {"median": value, "interval_68": [value] * 2, "interval_90": [value] * 2}

    content = {
        "schema": SCHEMA, "schema_version": SCHEMA_VERSION, "convention": "warp/weft",
        "capture": {"source": "experiments.exports", "density_g_m2": DENSITY},
        "moduli": {name: {"alpha_uN_m": exact(alpha), "beta_nN_m2": exact(0.0)}
                   for name, alpha in zip(DIRECTIONS, alphas, strict=True)},
        "warnings": []}
    path = folder / "estimate.json"
    path.write_text(json.dumps(content))
    return path


def hang(
    material: dict, mesh: Mesh, held: np.ndarray, *, angle: float, seconds: float
) -> tuple[np.ndarray, float]:
    """Simulate a strip along +x; final positions (V, 3), m, and largest speed, m/s.

    Args:
        material: ``MATERIAL`` of the exported module.
        angle: rad, from the direction of the strip to the warp.
    """
    from newton.solvers import SolverStyle3D

    model = style3d.cloth(
        mesh, held, np.column_stack([mesh.rest, np.zeros(len(mesh.rest))]), angle=angle,
        density=material["density_kg_m2"], stiffness=material["edge_aniso_ke"], young=MEMBRANE,
        shear=MEMBRANE / 4).finalize()
    solver = SolverStyle3D(model=model, config=SolverStyle3D.Config(iterations=ITERATIONS))
    solver.collision = None  # there are no obstacles
    now, then, control = model.state(), model.state(), model.control()
    for _ in range(round(seconds / STEP)):
        now.clear_forces()
        solver.step(now, then, control, None, STEP)
        now, then = then, now
    return now.particle_q.numpy(), float(np.abs(now.particle_qd.numpy()).max())


def run(config: Config) -> Result:
    """Simulate all strips; print the table."""
    style3d.require()
    import newton

    edge, rows = 1e-3 * config["edge_mm"], []
    for fabric, alphas in FABRICS.items():
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            material = read_material(estimate_file(folder, alphas), edge=edge,
                                     mesh=config["mesh"])
            export(material, "newton", folder / "fabric.py")
            module = runpy.run_path(str(folder / "fabric.py"))
        diagonals, jitter = MESHES[material.mesh]
        for name, alpha, angle in zip(DIRECTIONS, alphas, (0.0, np.pi / 4, np.pi / 2),
                                      strict=True):
            weight = 1e-3 * DENSITY * GRAVITY
            length = np.ceil(np.cbrt(GAMMA * alpha * MICRO / weight) / edge) * edge
            mesh, held = strip(length=length, width=round(length / edge / 2) * edge, edge=edge,
                               clamp=2 * edge, diagonals=diagonals, jitter=jitter)
            positions, speed = hang(module["MATERIAL"], mesh, held, angle=angle,
                                    seconds=config["seconds"])
            end = free_end(mesh, State.at(mesh, positions))
            gamma = gamma_of_aspect_ratio(aspect_ratio(end))
            expected = weight * length**3 / (alpha * MICRO)
            rows.append({"fabric": fabric, "strip": name, "alpha_uN_m": alpha,
                         "modulus_over_alpha": round(float(expected / gamma), 3),
                         "speed_mm_s": round(1e3 * speed, 2)})
    print(table(list(rows[0]), [list(row.values()) for row in rows]))
    return Result({"newton": newton.__version__, "ratio": material.ratio, "strips": rows})
