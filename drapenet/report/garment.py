"""A garment of an estimate with its uncertainty: skirts of samples of the posterior.

A skirt of the fabric in the middle is simulated first; those of the samples are the equilibria
nearest to it. All have its folds, so that they differ by the moduli alone; the same fabric in the
folds of another start differs far more (docs/studies.md). As in other tools,
natural curvature and hysteresis are left out (``docs/exports.md``).
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from common.arguments import require, whole_number
from common.errors import InputError
from common.files import replace_file
from data.captures.preview import png
from data.render.shade import shade
from drapenet.report.shapes import add_surface
from drapenet.result.estimate import Estimate
from drapenet.result.files import GARMENTS
from sim.equilibrium import Equilibrium
from sim.many import many
from sim.material import DRAPE_CURVATURE, MICRO, NANO, Fabric, is_admissible, secant
from sim.skirt import hem, settled, skirt

EDGE = 10e-3  # m, of the mesh at the waist, that of the experiment
SAMPLES = 12
_STARTS = 3  # tried until the skirt in the middle converges
_COLUMNS = 4  # of the pictures of skirts, and of the skirts in the file of shapes
_APART = 1.0  # m, between these
_RAISED = np.array([0.0, 0.0, 0.09])  # m: the middle of a skirt to that of its picture
_SIZE = (300, 250)  # px, of the picture of a skirt

Run = Callable[[Callable[..., Equilibrium], Sequence[Mapping[str, Any]]], Iterable[Equilibrium]]
"""Simulates: outcomes of a function for arguments by name, in their order."""


@dataclass(frozen=True)
class Garments:
    """Skirts of samples of an estimate, from the limpest to the stiffest.

    Attributes:
        names: of the directions.
        rows: (N,) numbers of the samples in the estimate.
        fabrics: of the samples, at the estimate's density.
        skirts: of the samples, those that failed with their status and message.
        middle: the skirt of the fabric in the middle of all samples.
    """

    names: tuple[str, str, str]
    rows: tuple[int, ...]
    fabrics: tuple[Fabric, ...]
    skirts: tuple[Equilibrium, ...]
    middle: Equilibrium

    @property
    def failures(self) -> dict[int, str]:
        """Why a skirt is missing, by the number of its sample."""
        return {row: each.message for row, each in zip(self.rows, self.skirts, strict=True)
                if not each.converged}

    @cached_property
    def picture(self) -> bytes:
        """PNG: hems from above, one over the other, and each skirt from the side."""
        figure = Figure(figsize=(13, 6.2), layout="constrained")
        above, beside = figure.subfigures(1, 2, squeeze=False, width_ratios=(1, 1.35))[0]
        stiffness = [_stiffness(fabric) / MICRO for fabric in self.fabrics]
        colours = ScalarMappable(Normalize(min(stiffness), max(stiffness)), "viridis")
        axes = above.subplots()
        for value, each in zip(stiffness, self.skirts, strict=True):
            if each.converged:
                axes.plot(*_above(each), color=colours.to_rgba(np.array(value)), lw=1)
        axes.plot(*_above(self.middle), color="black", lw=1, ls="--", label="middle")
        axes.set(title="hems from above, all from one start", aspect="equal")
        axes.set_axis_off()
        axes.legend(loc="lower left", frameon=False)
        above.colorbar(colours, ax=axes, orientation="horizontal", shrink=0.7,
                       label=f"stiffness in a drape, {self.names[0]} [µN·m]")
        panels = beside.subplots(-(-len(self.skirts) // _COLUMNS), _COLUMNS, squeeze=False).ravel()
        for panel in panels:
            panel.set_axis_off()
        for panel, row, value, each in zip(panels, self.rows, stiffness, self.skirts, strict=False):
            panel.set_title(f"sample {row}:\n{value:.3g} µN·m", fontsize=13)
            if each.converged:
                panel.imshow(shade(each.positions + _RAISED, each.cloth.scene.mesh.faces,
                                   plate_radius=0.0, size=_SIZE, field=0.6))
            else:
                panel.text(0.5, 0.5, "not simulated", ha="center", transform=panel.transAxes)
        return png(figure)

    @cached_property
    def shapes(self) -> bytes:
        """Binary glTF, metres, y up, with a node ``sample_ROW`` for each skirt, side by side: the
        origin of each is the middle of its waist. The moduli are in the ``extras`` of the nodes."""
        scene = trimesh.Scene()
        for k, (row, fabric, each) in enumerate(zip(self.rows, self.fabrics, self.skirts,
                                                    strict=True)):
            if each.converged:
                line, place = divmod(k, _COLUMNS)
                add_surface(scene, f"sample_{row}", each.positions, each.cloth.scene.mesh.faces,
                            at=(_APART * place, -_APART * line),
                            extras={"sample": row, **self._moduli(fabric)})
        return scene.export(file_type="glb", include_normals=True)

    def _moduli(self, fabric: Fabric) -> dict[str, Any]:
        values = {"alpha_uN_m": fabric.alpha / MICRO, "beta_nN_m2": fabric.beta / NANO,
                  "drape_stiffness_uN_m": _secants(fabric) / MICRO}
        return {"density_g_m2": float(f"{1e3 * fabric.density:.4g}"), **{
            quantity: {name: float(f"{value:.4g}")
                       for name, value in zip(self.names, found, strict=True)}
            for quantity, found in values.items()}}

    def write(self, folder: str | Path) -> None:
        """Write ``garment.png`` and ``garment.glb`` to a folder."""
        for name, data in zip(GARMENTS, (self.picture, self.shapes), strict=True):
            replace_file(Path(folder) / name, data)


def preview(
    estimate: Estimate, *, samples: int = SAMPLES, seed: int = 0, workers: int = 1,
    run: Run | None = None,
) -> Garments:
    """Skirts of ``samples`` of an estimate, chosen at random by the ``seed`` among those that are
    moduli of a stable plate; some 40 CPU-seconds. A script calls this below
    ``if __name__ == "__main__":``.

    Args:
        workers: processes of one thread; the skirts are the same with any number.
        run: how skirts are simulated; None: in ``workers`` processes, with a bar of progress.

    Raises:
        InputError: if too few samples are admissible, or the skirt in the middle does not converge.
    """
    require(estimate=(estimate, Estimate))
    count, seed = whole_number("samples", samples, 1), whole_number("seed", seed, 0)
    run = run or partial(many, workers=workers, unit="skirt")
    alpha, beta = estimate.moduli()
    possible = np.flatnonzero(is_admissible(alpha, beta))
    if len(possible) < count:
        raise InputError(f"{len(possible)} of the {len(alpha)} samples of the estimate are moduli "
                         f"that cloth can have, and {count} are needed; estimate the fabric again, "
                         "or give fewer samples=")
    chosen = np.random.default_rng(seed).choice(possible, count, replace=False)
    fabrics = {int(row): Fabric(alpha[row], beta[row], estimate.density) for row in chosen}
    rows = sorted(fabrics, key=lambda row: (_stiffness(fabrics[row]), row))
    for start in range(seed, seed + _STARTS):
        [middle] = run(skirt, [{"fabric": estimate.fabric, "edge": EDGE, "seed": start}])
        if middle.converged:
            break
    else:
        raise InputError(f"no skirt of the fabric converged ({middle.message}); give another seed=")
    skirts = run(settled, [{"scene": middle.cloth.scene, "positions": middle.positions,
                            "fabric": fabrics[row]} for row in rows])
    return Garments(estimate.names, tuple(rows), tuple(fabrics[row] for row in rows),
                    tuple(skirts), middle)


def _secants(fabric: Fabric) -> np.ndarray:
    """(3,) N·m, stiffness in a drape."""
    return secant(DRAPE_CURVATURE, fabric.alpha, fabric.beta)


def _stiffness(fabric: Fabric) -> float:
    """N·m, along the first direction."""
    return float(_secants(fabric)[0])


def _above(found: Equilibrium) -> np.ndarray:
    """(2, H + 1) m, the closed hem from above."""
    around = hem(found.cloth.scene)
    return found.positions[[*around, around[0]], :2].T
