"""Outlines of real Cusick drapes, seen from above, against simulated ones.

For each real fabric and face, the isotropic fabric is found whose lowered drapes have the same mean
drape coefficient, without natural curvature, and with that which the two faces have. Such cloth,
exactly centred, has regular outlines. The same is therefore done with *specimens* of isotropic
fabrics, off-centre and with the nuisances of datasets, and with those of *fabrics* of the prior, as
it is and as networks have *learned* them, scaled to a mean alpha. Compared are the number of folds,
the standard deviation of the outline's radius, and its spectrum. How the pictures were taken is not
documented: both parallel light and a camera above the plate are tried.
"""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import least_squares

from common.cases import load_arrays
from common.documents import read_arrays
from common.errors import InputError
from common.types import Metres, Outline
from data.dataset.plan import draw_nuisances, plan_drape
from data.fabrics.fabrics import fabric_from_theta
from experiments.drapes import LEARNED, specimen_config
from experiments.report import Report, rms, table
from experiments.study import CaseKeys, Sample, Study, folder_of, samples_of
from sim.cloth import Laws
from sim.draping import Drape, drape
from sim.energies.bending_variants import Hysteresis
from sim.material import MICRO, Fabric
from sim.measures import shadow_radius
from sim.outlines import coefficient_of_area, folds_around
from sim.rig import DISC_RIG

BANDS = ((0.4, 0.6), (0.6, 0.8), (0.8, 1.0))
"""Drape coefficients from and to which folds are compared apart: their mean hides that limp cloth
may have too many and stiff cloth too few."""
MIN_COEFFICIENT = BANDS[0][0]  # of the drapes whose folds are compared in the summary
MAX_MISFIT = 1e-3  # of the drape coefficient, beyond which no fabric of the grid has it
READINGS = ("parallel", "camera")
SPECIMENS = "specimens"
AS_LEARNED = (*LEARNED, "dataset.starts_per_fabric=1", "dataset.testers_per_fabric=1",
              "dataset.both_faces=false")
OUTLINES = "../shared/outlines.npz"
"""Real Cusick drapes: fabric, sample, face_up (N,), outline (N, K, 2) m."""
POINTS = 360  # azimuths of an outline
SIGMA = 2.0  # of the smoothing before folds are counted, azimuths
HARMONICS = np.arange(2, 17)
VARIED: dict[str, tuple[str, ...]] = {SPECIMENS: (), "fabrics": (), "learned": AS_LEARNED}
"""Starts of specimens with nuisances, and how their fabrics are drawn."""
_FACES = {True: "up", False: "down"}


class Keys(CaseKeys):
    outlines: str = OUTLINES
    alphas: tuple[float, ...] = (  # µN·m at 300 g/m², isotropic
        3.0, 5.0, 8.0, 12.0, 18.0, 27.0, 40.0, 60.0, 90.0, 130.0)
    curls: tuple[float, ...] = (  # natural curvature along both yarns, 1/m
        -24.0, -12.0, -6.0, 0.0, 6.0, 12.0, 24.0)
    ratio_mm: float = -2.5  # beta/alpha: the median of the published fabrics
    hysteresis: float = 0.17  # share of the torque: HB/B of 20 1/m
    edge_mm: float = 4.0  # edges of the mesh at the plate's rim
    seeds: int = 4  # lowered drapes of each fabric and natural curvature
    specimens: int = 24  # specimens of datasets with each mean alpha
    camera_mm: float = 700.0  # height of the camera in the second reading of the pictures


def drape_case(
    *, alpha: float, curl: float, ratio_mm: float, hysteresis: float, edge_mm: float, seeds: int,
    start: str, camera_mm: float
) -> Sample:
    """Outlines (seeds, POINTS), m, of drapes of a fabric in both readings of the pictures;
    ``start`` in :data:`VARIED`: lowered, of specimens with nuisances."""
    edge, alphas = 1e-3 * edge_mm, np.full(3, alpha * MICRO)
    fabric = Fabric(alphas, 1e-3 * ratio_mm * alphas)
    if start in VARIED:
        known = fabric if start == SPECIMENS else None
        shapes = [specimen(alpha, known, seed, edge, words=VARIED[start]) for seed in range(seeds)]
    else:
        laws = Laws(bending=Hysteresis(hysteresis, curvature=(curl, curl, 0.0)))
        shapes = [drape(fabric, rig=DISC_RIG, edge=edge, start=start, seed=seed, laws=laws)
                  for seed in range(seeds)]
    done = [shape for shape in shapes if shape.converged]
    radii = {name: [shadow_radius(shape.positions, shape.mesh, height=height, points=POINTS)
                    for shape in done]
             for name, height in zip(READINGS, (np.inf, 1e-3 * camera_mm), strict=True)}
    return {"failed": len(shapes) - len(done),
            "arrays": {name: np.reshape(each, (-1, POINTS)) for name, each in radii.items()}}


def specimen(
    alpha: float, fabric: Fabric | None, seed: int, edge: Metres, *, words: Sequence[str]
) -> Drape:
    """A lowered drape, off-centre and with the nuisances of datasets, of a specimen of ``fabric``;
    None: of one of the prior, drawn with the overrides ``words`` of a dataset's config and scaled
    to the geometric mean ``alpha``, µN·m."""
    config = specimen_config(*words, seed=0, nuisances="real", rig=DISC_RIG)
    plan = plan_drape(seed, config=config.sampling, prior=config.prior)
    theta = plan.theta.copy()
    theta[:3] += np.log(alpha * MICRO) - theta[:3].mean()
    nuisances = draw_nuisances(config.sampling, plan.fabric, seed, theta)
    return drape(fabric or fabric_from_theta(theta), rig=nuisances.rig(DISC_RIG), edge=edge,
                 seed=seed, offset=tuple(plan.offset), laws=nuisances.laws)


def features(radii: np.ndarray) -> np.ndarray:
    """(N, 3 + H) drape coefficient, folds, standard deviation (mm), and amplitudes (mm) of
    :data:`HARMONICS`, of outlines (N, POINTS) m."""
    coefficient = coefficient_of_area(np.pi * (radii**2).mean(axis=1), DISC_RIG)
    folds = [len(folds_around(radius, SIGMA)) for radius in radii]
    amplitudes = 2 * np.abs(np.fft.rfft(radii, axis=1))[:, HARMONICS] / POINTS
    return np.column_stack([coefficient, folds, 1e3 * radii.std(axis=1), 1e3 * amplitudes])


def radii_of(curve: Outline) -> np.ndarray:
    """Radii (POINTS,), m, of an outline at equally spaced azimuths."""
    azimuth = np.arctan2(curve[:, 1], curve[:, 0])
    order = azimuth.argsort()
    return np.interp(2 * np.pi * np.arange(POINTS) / POINTS, azimuth[order],
                     np.linalg.norm(curve, axis=1)[order], period=2 * np.pi)


def read_outlines(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fabrics (N,), whether the marked face is up (N,), and outlines (N, POINTS), m; InputError
    unless each face has two, whose spread the comparison needs."""
    arrays = read_arrays(path, ("fabric", "face_up", "outline"),
                         expected="an npz file of outlines with fabric, face_up and outline")
    fabrics, up = arrays["fabric"], arrays["face_up"].astype(bool)
    numbers = Counter(zip(fabrics.tolist(), up.tolist(), strict=True))
    if not numbers:
        raise InputError(f"{path} has no outlines; give at least two of a fabric")
    for (fabric, face), number in numbers.items():
        if number < 2:
            raise InputError(f"{path}: fabric {fabric} has one outline with its face "
                             f"{_FACES[face]}; give at least two, or leave it out")
    radii = [radii_of(points) for points in arrays["outline"].astype(float)]
    return fabrics, up, np.array(radii)


class Simulated:
    """Mean features of simulated drapes as a function of log alpha and natural curvature."""

    def __init__(self, alphas: Sequence[float], curls: Sequence[float], means: np.ndarray) -> None:
        self._axes = np.log(alphas), np.asarray(curls, dtype=np.float64)
        self._means = RegularGridInterpolator(self._axes, means)

    def at(self, log_alpha: float, curl: float) -> np.ndarray:
        """Features (3 + H,) of a fabric of ``log_alpha``, µN·m, and natural curvature, 1/m, both
        inside the grid."""
        return self._means([log_alpha, curl])[0]

    def fitted(self, coefficients: Sequence[float], *, curled: bool) -> tuple[float, float] | None:
        """Log alpha and natural curvature, 1/m, at the drape coefficients of the face up and the
        other face; without ``curled``: at a single one, and no natural curvature. None if no fabric
        inside the grid has them."""
        alphas, curls = self._axes
        reach = min(-curls[0], curls[-1])
        low, high = [alphas[0], -1.0], [alphas[-1], 1.0]  # of log alpha and curl over its reach
        unknowns = slice(2 if curled else 1)

        def curl(x: np.ndarray) -> float:
            return reach * x[1] if curled else 0.0

        def misfit(x: np.ndarray) -> np.ndarray:
            return np.array([self.at(x[0], sign * curl(x))[0] - coefficient
                             for sign, coefficient in zip((1, -1), coefficients, strict=False)])

        start = np.array([alphas.mean(), 0.0])[unknowns]
        fit = least_squares(misfit, start, bounds=(low[unknowns], high[unknowns]), diff_step=1e-2)
        if np.abs(fit.fun).max() > MAX_MISFIT:
            return None
        return float(fit.x[0]), float(curl(fit.x))


def compare(
    fabrics: np.ndarray, up: np.ndarray, real: np.ndarray, simulated: Simulated, *, curled: bool
) -> list[dict[str, Any]]:
    """Real and simulated features of every fabric and face; ``curled``: of one fabric for both
    faces, if there are two. A fabric that is not inside the grid has None for the simulated ones.
    """
    rows = []
    for fabric in np.unique(fabrics):
        faces = {face: real[(fabrics == fabric) & (up == face)] for face in (True, False)}
        faces = {face: mine for face, mine in faces.items() if len(mine)}
        coefficients = [mine[:, 0].mean() for mine in faces.values()]
        both = curled and len(faces) == 2
        together = simulated.fitted(coefficients, curled=True) if both else None
        for (face, mine), coefficient in zip(faces.items(), coefficients, strict=True):
            fit = together if both else simulated.fitted([coefficient], curled=False)
            row = {"fabric": int(fabric), "face": _FACES[face], "outlines": len(mine),
                   "real": mine.mean(axis=0).tolist(), "spread": mine.std(axis=0, ddof=1).tolist()}
            rows.append(row | _found(row, simulated, fit, 1 if face else -1))
    return rows


def _found(
    row: dict[str, Any], simulated: Simulated, fit: tuple[float, float] | None, sign: int
) -> dict[str, Any]:
    """The simulated part of a row; ``sign``: -1 if the other face is up."""
    if fit is None:
        return dict.fromkeys(("alpha_uN_m", "curl_per_m", "simulated", "spectrum"))
    log_alpha, curl = fit[0], sign * fit[1]
    found = simulated.at(log_alpha, curl)
    off, spread = np.abs(found - row["real"])[3:], np.array(row["spread"])[3:]
    return {"alpha_uN_m": float(np.exp(log_alpha)), "curl_per_m": curl, "simulated": found.tolist(),
            "spectrum": float(np.median(off / spread))}


def summarise(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """:func:`means` of all fabrics and faces with a drape coefficient above the minimum, and of
    those in each of :data:`BANDS`."""
    rows = [row for row in rows if row["real"][0] > MIN_COEFFICIENT]
    bands = {f"{100 * low:.0f}-{100 * high:.0f} %": means(
        [row for row in rows if low <= row["real"][0] < high]) for low, high in BANDS}
    return means(rows) | {"bands": bands}


def means(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Means over fabrics and faces, without those outside the grid, which are named; of none: their
    number alone."""
    inside = [row for row in rows if row["simulated"] is not None]
    number = {"faces": len(inside), "outside": [f"{row['fabric']} {row['face']}" for row in rows
                                                if row["simulated"] is None]}
    if not inside:
        return number
    real, found = (np.array([row[name] for row in inside]) for name in ("real", "simulated"))
    return number | {
        "folds_real": float(real[:, 1].mean()), "folds": float(found[:, 1].mean()),
        "folds_rms": rms((found - real)[:, 1]),
        "deviation_real_mm": float(real[:, 2].mean()),
        "deviation_mm": float(found[:, 2].mean()),
        "harmonics_real_mm": {str(k): float(real[:, 1 + k].mean()) for k in (2, 4)},
        "harmonics_mm": {str(k): float(found[:, 1 + k].mean()) for k in (2, 4)},
        "spectrum": float(np.median([row["spectrum"] for row in inside])),
        "coefficient_off": float(np.abs((found - real)[:, 0]).mean())}


def run(keys: Keys) -> Report:
    """Simulate the grid of fabrics, fit and compare."""
    fabrics, up, radii = read_outlines(Path(keys.outlines))
    real, curls = features(radii), {"lowered": keys.curls}
    cases = {f"{start}_{alpha:g}_{curl:g}": {
        "alpha": alpha, "curl": curl, "start": start,
        "seeds": keys.specimens if start in VARIED else keys.seeds}
        for start in ("lowered", "ring", *VARIED) for alpha in keys.alphas
        for curl in curls.get(start, [0.0])}
    results, folder = samples_of(drape_case, keys, cases), folder_of(keys)
    if empty := [name for name in cases if results[name]["failed"] == cases[name]["seeds"]]:
        raise InputError(f"no drape converged of {', '.join(empty)} (start, alpha, natural "
                         "curvature); choose other alphas= or curls=")
    means = {(name, reading): features(load_arrays(folder, name)[reading]).mean(axis=0)
             for name in cases for reading in READINGS}
    report: Report = {"failed": sum(result["failed"] for result in results.values())}
    for reading in READINGS:
        lowered = Simulated(keys.alphas, keys.curls, np.array(
            [[means[f"lowered_{a:g}_{c:g}", reading] for c in keys.curls] for a in keys.alphas]))
        others = {start: Simulated(keys.alphas, [-1e3, 1e3], np.array(
            [[means[f"{start}_{a:g}_0", reading]] * 2 for a in keys.alphas]))
            for start in ("ring", *VARIED)}
        report[reading] = {"flat": compare(fabrics, up, real, lowered, curled=False),
                           "curled": compare(fabrics, up, real, lowered, curled=True),
                           **{start: compare(fabrics, up, real, by, curled=False)
                              for start, by in others.items()}}
    report["summary"] = {
        reading: {name: summarise(rows) for name, rows in report[reading].items()}
        for reading in READINGS}
    straight = min(keys.curls, key=abs)
    drapes = {alpha: load_arrays(folder, f"lowered_{alpha:g}_{straight:g}")["parallel"]
              for alpha in keys.alphas}
    return report | {"figure": _figure(fabrics, up, radii, report["parallel"]["flat"], drapes)}


def _figure(
    fabrics: np.ndarray, up: np.ndarray, radii: np.ndarray, rows: list[dict[str, Any]],
    drapes: dict[float, np.ndarray],
) -> Figure | None:
    """Outlines side by side: two real ones of each fabric inside the grid, (N, POINTS) m, and up to
    two of the simulated ``drapes`` by alpha, (M, POINTS) m, of the nearest; None without a fabric.

    Its marked face is up, unless only the other one is inside the grid; ``rows`` are those of
    :func:`compare`, which have that face first.
    """
    shown = {row["fabric"]: row for row in reversed(rows) if row["simulated"] is not None}
    if not shown:
        return None
    figure = Figure(figsize=(1.5 * len(shown), 6.4), layout="constrained")
    panels = figure.subplots(4, len(shown), squeeze=False)
    for column, fabric in zip(panels.T, sorted(shown), strict=True):
        row = shown[fabric]
        near = min(drapes, key=lambda alpha: abs(np.log(alpha / row["alpha_uN_m"])))
        real = radii[(fabrics == fabric) & (up == (row["face"] == "up"))]
        outlines = [*real[[0, len(real) // 2]], *drapes[near][:2]]
        for k, axes in enumerate(column):
            if k < len(outlines):
                draw_outline(axes, outlines[k], *((f"fabric {fabric}", "black") if k < 2 else
                                                  (f"{near:g} µN·m", "tab:blue")))
            else:  # only one drape has converged
                axes.set_axis_off()
    return figure


def draw_outline(axes: Axes, radius: np.ndarray, name: str, color: str) -> None:
    """An outline (POINTS,), m, its drape coefficient, its folds and the plate."""
    azimuths = 2 * np.pi * np.arange(POINTS) / POINTS
    coefficient, folds = features(radius[None])[0, :2]
    axes.fill(radius * np.cos(azimuths), radius * np.sin(azimuths), color=color)
    axes.add_patch(Circle((0, 0), DISC_RIG.plate_radius, fill=False, color="white", lw=0.8))
    reach = (-DISC_RIG.reach, DISC_RIG.reach)
    axes.set(xlim=reach, ylim=reach, xticks=[], yticks=[], aspect="equal")
    axes.set_title(f"{name}\n{100 * coefficient:.0f} %, {folds:.0f} folds", fontsize=7)


def block(report: Report) -> str:
    """Folds, radii and spectra of real and simulated outlines at equal drape coefficient, read as
    seen under parallel light."""
    starts = {"flat": "lowered", "curled": "lowered, natural curvature from both faces",
              "specimens": "lowered, nuisances of specimens",
              "fabrics": "lowered, fabrics of the prior with nuisances",
              "learned": "lowered, fabrics that the network learns from", "ring": "ring"}
    summary = report["summary"]["parallel"]
    flat = summary["flat"]
    bands = [band for band, found in flat["bands"].items() if found["faces"]]

    def row(label: str, found: Report, kind: str = "") -> list[str]:
        apart = [found["folds_rms"], found["spectrum"]] if not kind else []
        folds, deviation = found[f"folds{kind}"], found[f"deviation{kind}_mm"]
        return [label, f"{folds:.2f}", f"{deviation:.1f}",
                *([f"{one:.2f}" for one in apart] or ["–", "–"]),
                *("{:.1f}; {:.1f}, {:.1f}".format(
                    found["bands"][band][f"folds{kind}"],
                    *(found["bands"][band][f"harmonics{kind}_mm"][k] for k in ("2", "4")))
                  for band in bands)]

    return table(["outlines", "folds", "deviation of the radius, mm", "rms difference of folds",
                  "of spectra, deviations",
                  *(f"coefficient {band}: folds; harmonics 2, 4, mm" for band in bands)],
                 [row("real", flat, "_real"),
                  *(row(label, summary[name]) for name, label in starts.items())])


STUDY = Study(Keys, run, block)
