"""Strips of exported materials in Newton's Style3D, compared with the heavy elastica.

Strips along warp, bias and weft are simulated with the material that :mod:`drapenet.export.formats`
writes for a fabric with one modulus and for one with three. The result is the apparent modulus from
drop over reach, relative to that of the fabric. VBD is not tested: it needs more than 4 000 steps
per second for a strip to come to rest, which takes minutes per second. Needs the extra ``newton``.
"""

import runpy
import tempfile
from pathlib import Path

import numpy as np

from data.fabrics.fabrics import ClothProperties, to_theta
from drapenet.export.formats import export
from drapenet.export.material import GAMMA, MESHES, ExportSettings, Material
from drapenet.result.document import EstimateDocument
from drapenet.result.estimate import Estimate
from experiments.physics import style3d
from experiments.physics.hinges import free_end
from experiments.result import Config, Result, table
from sim.cantilever.elastica import aspect_ratio, gamma_of_aspect_ratio
from sim.material import DIRECTIONS, MICRO, REFERENCE_DENSITY, Fabric
from sim.mesh import Mesh, strip
from sim.rig import GRAVITY
from sim.solver.state import State

FABRICS = {"one modulus": (40.0, 40.0, 40.0), "three moduli": (60.0, 40.0, 20.0)}  # µN·m
DENSITY = 200.0  # g/m²
STEP = 1 / 120  # s
MEMBRANE = 400.0  # N/m

ITERATIONS = 400  # of the linear solver; fewer damp the motion


def known_material(fabric: Fabric, **settings: object) -> Material:
    """The material of a fabric whose moduli are known without error."""
    per_weight = REFERENCE_DENSITY / fabric.density
    theta = to_theta(fabric.alpha * per_weight, fabric.beta * per_weight)
    samples = theta + 1e-9 * np.vstack([np.zeros(6), np.eye(6), -np.eye(6)])
    unknown = np.zeros(len(samples))
    cloth = ClothProperties(samples, np.zeros((len(samples), 2)), unknown + MEMBRANE, unknown)
    estimate = Estimate(cloth, DIRECTIONS, fabric.density, np.ones(6))
    document = EstimateDocument.from_estimate(
        estimate, capture={"source": "experiments.exports", "rig": "",
                           "density_g_m2": 1e3 * fabric.density},
        checkpoint={"file": "", "sha256": "", "dataset_sha256": ""})
    return Material(document, ExportSettings(**settings), "", "")


def hang(
    material: dict, mesh: Mesh, held: np.ndarray, *, angle: float, seconds: float
) -> tuple[np.ndarray, float]:
    """Simulate a strip along +x; final positions (V, 3), m, and largest speed, m/s.

    ``material`` is that of the exported module; ``angle``, rad, is from the strip to the warp.
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
            file = Path(temporary) / "fabric.py"
            material = known_material(
                Fabric(MICRO * np.array(alphas), density=1e-3 * DENSITY),
                edge_mm=config["edge_mm"], mesh=config["mesh"])
            export(material, "newton", file)
            module = runpy.run_path(str(file))
        diagonals, jitter = MESHES[config["mesh"]]
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
