"""Drapes of exported materials in Blender, compared with those of this simulator.

The script that :mod:`drapenet.export.formats` writes for Blender, with one modulus, drapes a disc
of each fabric of the prior from several random unevennesses, in a process of a Python that has
Blender as a module (``make blender``); the same fabrics are draped here from as many starts, by
their laws and with the one modulus of the file. Compared are drape coefficients and numbers of
folds, counted alike on the same outline: drapes here differ by the modulus, and those in Blender
from them by Blender. The fabrics are those of the experiment ``secants``.
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
from experiments.drapes import prior_fabric
from experiments.physics.exports import known_material
from experiments.result import Config, Result, rms, run_cases
from sim.draping import drape
from sim.material import MICRO, Fabric
from sim.measures import drape_coefficient, fold_count
from sim.rig import DISC_RIG

_COLUMNS = 5  # of the figure
DRAPES = ("law", "one_modulus", "blender")
"""Here by the law, here with the one modulus of the file, in Blender."""
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


def draped(
    *, number: int, drape_seed: int, seed: int, curvature_1_m: float, python: str, edge_mm: float
) -> dict[str, Any]:
    """Coefficients, folds and hems of the :data:`DRAPES` of a fabric of the prior."""
    fabric = prior_fabric(number, seed)
    material = known_material(fabric, curvature_1_m=curvature_1_m)
    with tempfile.TemporaryDirectory() as folder:
        script, = export(material, "blender", Path(folder) / "fabric.py")
        result = Path(folder) / "drape.npz"
        subprocess.run([python, "-c", CALL, script, result, str(drape_seed)], check=False,
                       capture_output=True)
        if not result.exists():
            raise InputError(f"python={python} made no drape in Blender; run 'make blender', or "
                             "name a Python whose packages include bpy")
        with np.load(result) as content:
            theirs = {name: content[name] for name in content.files}
    ours = [drape(one, rig=DISC_RIG, edge=1e-3 * edge_mm, seed=drape_seed)
            for one in (fabric, Fabric([material.one_modulus] * 3, density=fabric.density))]
    rims = [one.positions[np.hypot(*one.rest.T) > DISC_RIG.reach - 1e-6, :2] for one in ours]
    return {
        "version": str(theirs["version"]), "converged": all(one.converged for one in ours),
        "alpha_uN_m": (fabric.alpha / MICRO).tolist(),
        "stiffness_in_a_drape_uN_m": (material.modulus / MICRO).tolist(),
        "one_modulus_uN_m": material.one_modulus / MICRO,
        "coefficient": [*(100 * drape_coefficient(one.positions, one.faces, DISC_RIG)
                          for one in ours), float(theirs["coefficient"])],
        "folds": [*(fold_count(one.positions, one.rest, DISC_RIG) for one in ours),
                  fold_count(theirs["drape"], theirs["flat"], DISC_RIG)],
        "hems": [rim.round(4).tolist() for rim in (*rims, theirs["hem"])]}


def run(config: Config) -> Result:
    """Drape all fabrics in both programs."""
    common = {key: config[key] for key in ("seed", "curvature_1_m", "edge_mm")}
    common["python"] = str(Path(config["python"]).absolute())
    numbers, drapes = range(config["fabrics"]), range(config["drapes"])
    found = run_cases(draped, {f"{number}, {k}": common | {"number": number, "drape_seed": k}
                               for number in numbers for k in drapes}, config)
    fabrics = []
    for number in numbers:
        own = [found[f"{number}, {k}"] for k in drapes]
        fabrics.append(
            {key: own[0][key] for key in ("alpha_uN_m", "stiffness_in_a_drape_uN_m",
                                          "one_modulus_uN_m")}
            | {key: dict(zip(DRAPES, np.mean([one[key] for one in own], axis=0).tolist(),
                             strict=True)) for key in ("coefficient", "folds")}
            | {"minima": all(one["converged"] for one in own)})
    report = {"blender": found["0, 0"]["version"], "points": {
        f"{one} less {other}": _points([fabric["coefficient"][one] - fabric["coefficient"][other]
                                        for fabric in fabrics])
        for one, other in (("one_modulus", "law"), ("blender", "one_modulus"),
                           ("blender", "law"))}, "fabrics": fabrics}
    return Result(report, draw([(one["coefficient"], found[f"{number}, 0"]["hems"])
                                for number, one in enumerate(fabrics)]))


def _points(differences: list[float]) -> dict[str, float]:
    return {"mean": float(np.mean(differences)), "rms": rms(differences),
            "largest": float(np.abs(differences).max()),
            "within_3": int((np.abs(differences) <= 3).sum())}


def draw(fabrics: list[tuple[dict[str, float], list]]) -> Figure:
    """Draw hems from above, of this simulator by the law (black) and with one modulus (grey), and
    of Blender (blue), below the drape coefficients by the law and in Blender."""
    rows = -(-len(fabrics) // _COLUMNS)
    figure = Figure(figsize=(2.2 * _COLUMNS, 2.4 * rows), layout="constrained")
    for k, (coefficients, hems) in enumerate(fabrics):
        axis = figure.add_subplot(rows, _COLUMNS, k + 1)
        for hem, colour in zip(hems, ("k", "0.7", "C0"), strict=True):
            points = np.array(hem)
            around = points[np.argsort(np.arctan2(points[:, 1], points[:, 0]))]
            axis.plot(*(1e3 * np.vstack([around, around[:1]])).T, colour, lw=1)
        axis.add_patch(Circle((0, 0), 90, fill=False, lw=0.5, color="grey"))
        axis.set(aspect="equal", xlim=(-155, 155), ylim=(-155, 155))
        axis.set_title("{law:.0f} %, Blender {blender:.0f} %".format(**coefficients), fontsize=9)
        axis.axis("off")
    return figure
