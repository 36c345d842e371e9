"""Simulated drapes with the drape coefficients of scanned real drapes.

For each scan of a real fabric on the disc rig (300 mm disc, 180 mm support), the isotropic linear
modulus whose drape has the same drape coefficient is found on a logarithmic grid, then by bisection
between the two grid points that enclose it. Densities are unknown: moduli are those at 300 g/m².
"""

from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.common import Config, Result, load_arrays, run_cases, table
from benchmarks.comparison import best_turn
from common.errors import InputError
from data.picture import shade
from data.scans import Scan, read_scans
from sim.drape import drape
from sim.material import MICRO, Fabric
from sim.measures import drape_coefficient, fold_angles, fold_count, fold_outline
from sim.scene import DISC_RIG, Rig

MAX_DIFFERENCE = 2.0  # points of drape coefficient between a scan and its drape
TOLERANCE = 0.3  # points, tolerance of the bisection
_STEM_RADIUS = 0.3  # radius of the stem below the support in figures, relative to the support's


def one_drape(alpha: float, edge_mm: float, start: str, seed: int) -> dict:
    """Drape a disc of the modulus ``alpha``, µN·m."""
    rig = DISC_RIG
    result = drape(Fabric(np.full(3, alpha * MICRO)), rig=rig, edge=1e-3 * edge_mm, start=start,
                   seed=seed)
    return {
        "alpha_uN_m": alpha,
        "status": result.status.value,
        "message": result.message,
        "coefficient": 100 * drape_coefficient(result.positions, result.faces, rig),
        "folds": fold_count(result.positions, result.rest, rig),
        "seconds": round(result.seconds, 2),
        "arrays": {"rest": result.rest, "positions": result.positions, "faces": result.faces},
    }


class Search:
    """Drapes of isotropic moduli, simulated on request and stored in a folder."""

    def __init__(self, config: dict) -> None:
        self._settings = {key: config[key] for key in ("edge_mm", "start", "seed")}
        self.folder = Path(config["cases"])
        self._workers = config["workers"]
        self.drapes: dict[float, dict] = {}

    def drape_all(self, alphas: list[float]) -> None:
        """Simulate the moduli (µN·m) that are not in :attr:`drapes`."""
        missing = sorted({a for a in alphas if a not in self.drapes})
        cases = {self.name(a): {"alpha": a, **self._settings} for a in missing}
        found = run_cases(one_drape, cases, folder=self.folder, workers=self._workers)
        self.drapes.update(zip(missing, found.values(), strict=True))

    def name(self, alpha: float) -> str:
        """Name of the files of a drape."""
        settings = "_".join(str(value) for value in self._settings.values())
        return f"alpha_{alpha:.5g}_{settings}"

    def converged(self) -> dict[float, dict]:
        """Converged drapes by modulus, in ascending order."""
        return {a: d for a, d in sorted(self.drapes.items()) if d["status"] == "converged"}

    def nearest(self, coefficient: float) -> dict:
        """Drape with the coefficient nearest to ``coefficient``, percent."""
        drapes = self.converged()
        if not drapes:
            raise InputError("no drape of the grid converged; change edge_mm or grid")
        return min(drapes.values(), key=lambda d: abs(d["coefficient"] - coefficient))

    def next_modulus(self, coefficient: float) -> float | None:
        """Next modulus, the geometric mean of two moduli that enclose ``coefficient``, or None.

        The coefficient is not monotonic, because the number of folds changes with the modulus. Of
        several enclosing pairs, that with the smallest difference of coefficients is bisected.
        """
        drapes = list(self.converged().items())
        pairs = [
            (abs(high["coefficient"] - low["coefficient"]), np.sqrt(a * b))
            for (a, low), (b, high) in pairwise(drapes)
            if (low["coefficient"] - coefficient) * (high["coefficient"] - coefficient) <= 0
        ]
        tries = [alpha for _, alpha in sorted(pairs) if rounded(alpha) not in self.drapes]
        return rounded(tries[0]) if tries else None


def rounded(alpha: float) -> float:
    """``alpha`` rounded to the digits in the names of cases."""
    return float(f"{alpha:.5g}")


def run(config: Config) -> Result:
    """Search the modulus of each scan; print the table."""
    rig = DISC_RIG
    scans = read_scans(Path(config["scans"]), rig)
    if not 0 < config["least"] < config["most"] or config["grid"] < 2:
        raise InputError("the grid needs 0 < least < most and at least two values")
    targets = {
        scan.name: 100 * drape_coefficient(scan.positions, scan.faces, rig) for scan in scans
    }
    search = Search(config)
    grid = np.geomspace(config["least"], config["most"], config["grid"])
    search.drape_all([rounded(alpha) for alpha in grid])
    for _ in range(config["rounds"]):
        open_targets = [
            t for t in targets.values() if abs(search.nearest(t)["coefficient"] - t) > TOLERANCE
        ]
        tries = [a for t in open_targets if (a := search.next_modulus(t)) is not None]
        if not tries:
            break
        search.drape_all(tries)

    rows = [match(scan, targets[scan.name], search, rig) for scan in scans]
    print(table(
        ["scan", "drape coefficient", "simulated", "α, µN·m", "folds", "simulated folds"],
        [[row["scan"], f"{row['coefficient']:.1f} %", f"{row['simulated_coefficient']:.1f} %",
          row["alpha_uN_m"], row["folds"], row["simulated_folds"]]
         for row in rows],
    ))
    worst = max(abs(row["difference"]) for row in rows)
    print(f"largest difference {worst:.2f} points, limit {MAX_DIFFERENCE:g}")
    return Result({
        "rig": rig.name,
        "limit_points": MAX_DIFFERENCE, "passed": bool(worst <= MAX_DIFFERENCE),
        "largest_difference": worst,
        "scans": rows, "drapes": list(search.drapes.values()),
    }, draw(scans, rows, search, rig))


def match(scan: Scan, coefficient: float, search: Search, rig: Rig) -> dict:
    """Compare a scan of that drape coefficient (percent) with the nearest drape."""
    nearest = search.nearest(coefficient)
    shape = load_arrays(search.folder, search.name(nearest["alpha_uN_m"]))
    outline = fold_outline(scan.positions, scan.rest, rig)
    simulated = fold_outline(shape["positions"], shape["rest"], rig)
    turn = best_turn(outline, simulated)
    return {
        "scan": scan.name,
        "coefficient": coefficient,
        "simulated_coefficient": nearest["coefficient"],
        "difference": nearest["coefficient"] - coefficient,
        "alpha_uN_m": nearest["alpha_uN_m"],
        "folds": len(fold_angles(outline)),
        "simulated_folds": nearest["folds"],
        "turn_degrees": float(np.degrees(turn)),
    }


def turned(points: np.ndarray, angle: float) -> np.ndarray:
    """Rotate points (N, 2) or (N, 3) about the vertical axis."""
    c, s = np.cos(angle), np.sin(angle)
    plane = points[:, :2] @ np.array([[c, s], [-s, c]])
    return np.column_stack([plane, points[:, 2:]])


def draw(scans: list[Scan], rows: list[dict], search: Search, rig: Rig) -> Figure:
    """Show every scan, its simulated drape, and their outlines from above."""
    figure = Figure(figsize=(1.9 * len(scans), 5.6), layout="constrained")
    axes = figure.subplots(3, len(scans), squeeze=False)
    for column, scan, row in zip(axes.T, scans, rows, strict=True):
        shape = load_arrays(search.folder, search.name(row["alpha_uN_m"]))
        angle = np.radians(row["turn_degrees"])
        found = turned(shape["positions"], angle)
        for axis, (positions, faces) in zip(
            column, ((scan.positions, scan.faces), (found, shape["faces"])), strict=False
        ):
            axis.imshow(shade(positions, faces, plate_radius=_STEM_RADIUS * rig.plate_radius,
                              elevation=45.0, size=(300, 270), field=0.32))
        column[0].set_title(f"{scan.name.replace('_capture_1', '')}\n{row['coefficient']:.1f} %",
                            fontsize=8)
        column[1].set_title(f"α = {row['alpha_uN_m']:.3g} µN·m\n"
                            f"{row['simulated_coefficient']:.1f} %", fontsize=8)
        outlines = (fold_outline(scan.positions, scan.rest, rig),
                    turned(fold_outline(shape["positions"], shape["rest"], rig), angle))
        for outline, label in zip(outlines, ("scan", "simulated"), strict=True):
            column[2].plot(*1e3 * np.vstack([outline, outline[:1]]).T, lw=1.0, label=label)
        column[2].set_aspect("equal")
        column[2].set_title(f"{row['folds']} and {row['simulated_folds']} folds", fontsize=8)
        for axis in column:
            axis.set_xticks([])
            axis.set_yticks([])
    axes[2, 0].legend(fontsize=6, frameon=False, loc="center")
    return figure
