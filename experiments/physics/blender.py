"""Drapes of exported materials in Blender, compared with those of this simulator.

The script that :mod:`drapenet.export.formats` writes for Blender drapes a disc of each fabric from
several random unevennesses, in a process of a Python that has Blender as a module (``make
blender``); the same fabrics are draped here from as many starts. Compared are drape coefficients
and numbers of folds, both counted on the same outline.
"""

import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from common.errors import InputError
from drapenet.export.formats import export
from experiments.physics.exports import DENSITY, known_material
from experiments.result import Config, Result, run_cases
from sim.draping import drape
from sim.material import MICRO, Fabric
from sim.measures import drape_coefficient, fold_count
from sim.rig import DISC_RIG

SOURCES = ("drapenet.export", "sim")
CALL = """
import runpy, sys
import bpy
import numpy as np
script = runpy.run_path(sys.argv[1])
bpy.ops.wm.read_factory_settings(use_empty=True)
flat, drape = script["drape_test"](int(sys.argv[3]))
np.savez(sys.argv[2], flat=flat, drape=drape, hem=script["rim"](flat, drape),
         coefficient=script["drape_coefficient"](script["rim"](flat, drape)),
         version=bpy.app.version_string)
"""


def draped(*, alpha: float, seed: int, python: str, edge_mm: float) -> dict[str, Any]:
    """Coefficients, folds and hems of both drapes of a fabric of one modulus ``alpha``, µN·m."""
    with tempfile.TemporaryDirectory() as folder:
        script, = export(known_material((alpha,) * 3), "blender", Path(folder) / "fabric.py")
        result = Path(folder) / "drape.npz"
        subprocess.run([python, "-c", CALL, script, result, str(seed)], check=False,
                       capture_output=True)
        if not result.exists():
            raise InputError(f"python={python} made no drape in Blender; run 'make blender', or "
                             "name a Python whose packages include bpy")
        with np.load(result) as content:
            theirs = {name: content[name] for name in content.files}
    fabric = Fabric([alpha * MICRO] * 3, density=1e-3 * DENSITY)
    ours = drape(fabric, rig=DISC_RIG, edge=1e-3 * edge_mm, seed=seed)
    rim = np.hypot(*ours.rest.T) > DISC_RIG.reach - 1e-6
    return {
        "version": str(theirs["version"]), "converged": ours.converged,
        "coefficient": [100 * drape_coefficient(ours.positions, ours.faces, DISC_RIG),
                        float(theirs["coefficient"])],
        "folds": [fold_count(ours.positions, ours.rest, DISC_RIG),
                  fold_count(theirs["drape"], theirs["flat"], DISC_RIG)],
        "hems": [ours.positions[rim, :2].round(4).tolist(), theirs["hem"].round(4).tolist()]}


def run(config: Config) -> Result:
    """Drape all fabrics in both programs."""
    common = {"python": str(Path(config["python"]).absolute()), "edge_mm": config["edge_mm"]}
    cases = {f"{alpha:g}, {seed}": common | {"alpha": float(alpha), "seed": seed}
             for alpha in config["alphas"] for seed in range(config["drapes"])}
    found = run_cases(draped, cases, config, sources=SOURCES)
    report = {}
    for alpha in config["alphas"]:
        drapes = [found[f"{alpha:g}, {seed}"] for seed in range(config["drapes"])]
        columns = {name: np.mean([one[name] for one in drapes], axis=0).tolist()
                   for name in ("coefficient", "folds")}
        report[f"{alpha:g}"] = columns | {"minima": all(one["converged"] for one in drapes)}
    first = {alpha: found[f"{alpha:g}, 0"]["hems"] for alpha in config["alphas"]}
    return Result({"blender": next(iter(found.values()))["version"], "density_g_m2": DENSITY,
                   "drapes": config["drapes"], "alpha_uN_m": report}, draw(first))


def draw(hems: dict[float, list]) -> Figure:
    """Draw hems from above, of this simulator (black) and of Blender (blue)."""
    figure = Figure(figsize=(2.2 * len(hems), 2.4), layout="constrained")
    for axis, (alpha, pair) in zip(figure.subplots(1, len(hems)), hems.items(), strict=True):
        for hem, colour in zip(pair, ("k", "C0"), strict=True):
            points = np.array(hem)
            around = points[np.argsort(np.arctan2(points[:, 1], points[:, 0]))]
            axis.plot(*(1e3 * np.vstack([around, around[:1]])).T, colour, lw=1)
        axis.add_patch(Circle((0, 0), 90, fill=False, lw=0.5, color="grey"))
        axis.set(aspect="equal", xlim=(-155, 155), ylim=(-155, 155))
        axis.set_title(f"α {alpha:g} µN·m", fontsize=9)
        axis.axis("off")
    return figure
