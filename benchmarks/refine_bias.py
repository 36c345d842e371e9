"""What a mesh does to a refinement: ``python -m benchmarks.refine_bias [key=value ...]``.

Four depth views of a known fabric without any noise, the camera and the turn known, the drape held
to the captured surface as in the last rounds of ``refine=depth``, and the true moduli: a perfect
simulator would leave nothing to correct. Reported is how far one Gauss-Newton step moves the
moduli from the truth: what of an error comes from the meshes alone, of the captured drape (fine)
and of the refined one. Once by the views alone, and once with a prior as certain as the network.
Beside it stands the CPU time of the captured shape, the held equilibrium and its derivatives.

Keys (``key=value``):

    fabrics      drawn from the prior
    truth_mm     edges at the rim of the captured drape
    edges_mm     the same of the refined one
    pulls        force of the springs at 1 mm over the cloth's weight
    seed         of everything
    workers      processes, one thread each
    cases        folder of finished fabrics; an interrupted run goes on from there
    out          the report, JSON
"""

import time
from pathlib import Path

import numpy as np

from benchmarks.common import (
    ESTIMATOR,
    REPORTS,
    parse_settings,
    run_cases,
    table,
    usual_size,
    write_report,
)
from benchmarks.photographs import place
from benchmarks.recovery import known_drape
from common.cli import run_command
from common.errors import InputError
from data.fabrics import fabric_from_theta
from data.render import render_views
from drapenet.refine.attraction import captured_shape
from drapenet.refine.depth import DepthViews
from drapenet.refine.held import springs_to_surface
from drapenet.refine.problem import DrapeProblem
from sim.mesh.specimens import TOPOLOGIES, make_specimen
from sim.scene import Rig
from sim.sensitivity import follow

PRIOR = np.array([0.2] * 3 + [1.3e-3] * 3)  # usual errors of the network: log alpha, m
DEFAULTS = {
    "fabrics": 12,
    "truth_mm": 1.0,
    "edges_mm": [3.5, 2.5, 1.75, 1.5],
    "pulls": [0.1],
    "seed": 78,
    "workers": 2,
    "cases": "outputs/validation/refine_bias",
    "out": str(REPORTS / "refine_bias.json"),
}


def corrections(
    number: int, truth_mm: float, edges_mm: list[float], pulls: list[float], seed: int
) -> dict:
    """The steps from the truth of one fabric, for every mesh and spring."""
    theta, shape = known_drape(seed, number, truth_mm)
    rng = np.random.default_rng([seed, number, 2])
    camera, turn = place(rng)
    views = render_views(shape.positions, shape.faces, camera, turn)
    steps = []
    for edge in edges_mm:
        # The captured drape has another of the triangulations, see known_drape.
        specimen = {"rig": Rig(), "edge": 1e-3 * edge, "topology": (number + 1) % TOPOLOGIES}
        mesh = make_specimen(**specimen).mesh
        objective = DepthViews(views, camera, mesh.faces, turn=turn, table=False, focal=False)
        points = objective.points(objective.start)
        for pull in pulls:
            began = time.process_time()
            start = captured_shape(fabric_from_theta(theta), *points, **specimen)
            springs = springs_to_surface(start, *points, pull=pull)
            held = follow(start, fabric_from_theta(theta), extra=[springs], keep=True)
            found = (step(DrapeProblem(held, theta, objective, springs=[springs]))
                     if held.converged else {})
            steps.append({"edge_mm": edge, "triangles": len(mesh.faces), "pull": pull,
                          "status": held.status.value,
                          "cpu_seconds": round(time.process_time() - began, 3)} | found)
    return {"alpha_uN_m": (1e6 * np.exp(theta[:3])).tolist(), "steps": steps}


def step(problem: DrapeProblem) -> dict:
    """The Gauss-Newton step of theta at the start of ``problem``, and what is left there."""
    problem.value(problem.start)
    linearised = problem.linearised(problem.start)
    if linearised is None:
        return {}
    residuals, jacobian = linearised[0], linearised[1][:, :6] / problem.scale[:6]
    normal, slope = jacobian.T @ jacobian, jacobian.T @ residuals
    return {
        "misfit": float(np.sqrt(residuals @ residuals / problem.measurements)),
        "views": (-np.linalg.solve(normal, slope)).tolist(),
        "with_prior": (-np.linalg.solve(normal + np.diag(PRIOR**-2.0), slope)).tolist(),
    }


def main(argv: list[str]) -> None:
    """Make the steps, print the table, write the report."""
    config = parse_settings(DEFAULTS, argv)
    settings = {key: config[key] for key in ("truth_mm", "edges_mm", "pulls", "seed")}
    if min(config["pulls"]) <= 0:
        raise InputError("pulls=... must be above 0: without springs the cloth leaves the capture")
    found = run_cases(corrections, {
        f"fabric_{k}": {"number": k, **settings} for k in range(config["fabrics"])},
        folder=Path(config["cases"]), workers=config["workers"], sources=ESTIMATOR)
    rows = []
    for edge in config["edges_mm"]:
        for pull in config["pulls"]:
            own = [s for c in found.values() for s in c["steps"]
                   if (s["edge_mm"], s["pull"]) == (edge, pull) and "views" in s]
            rows.append({"edge_mm": edge, "pull": pull, "fabrics": len(own),
                         "triangles": float(np.mean([s["triangles"] for s in own])),
                         "cpu_seconds": float(np.mean([s["cpu_seconds"] for s in own])),
                         "misfit": float(np.median([s["misfit"] for s in own]))}
                        | {key: usual_size([s[key] for s in own])
                           for key in ("views", "with_prior")})
    print(table(
        ["edges at the rim, mm", "springs", "fabrics", "triangles", "CPU-seconds", "misfit",
         "α by the views alone", "α with a prior", "β/α, mm", "β/α with a prior"],
        [[r["edge_mm"], r["pull"], r["fabrics"], round(r["triangles"]), r["cpu_seconds"],
          r["misfit"],
          *(f"{100 * np.mean(r[key][:3]):.0f} %" for key in ("views", "with_prior")),
          *(f"{1e3 * np.mean(r[key][3:]):.2f}" for key in ("views", "with_prior"))]
         for r in rows]))
    write_report(Path(config["out"]), {"settings": settings, "summary": rows, "fabrics": found})


if __name__ == "__main__":
    run_command(main, usage=__doc__)
