"""Estimates of real fabrics from outlines of their drapes, one picture each, by the network alone.

Nothing is known of these fabrics' moduli. Estimates of the same fabric must agree: of two captures
of a sample, of two samples, and of the two faces, whose difference the natural curvature must
explain. The drape simulated with a sample's estimate is held against the other samples of its
fabric and face.
"""

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from common.documents import read_arrays
from common.types import Outline
from data.dataset.off_axis import silhouette
from data.fabrics.fabrics import fabric_from_theta, from_theta
from data.fabrics.nuisances import Nuisances
from experiments.report import Report
from experiments.study import CaseKeys, Study, samples_of
from sim.draping import drape
from sim.material import DRAPE_CURVATURE, LINEAR, secant
from sim.outlines import coefficient_of_area, folds_around
from sim.rig import DISC_RIG

POINTS = 360  # azimuths of an outline
PARALLEL = 1e6  # m, height of a camera
SIGMA = 2.0  # of the smoothing before folds are counted, azimuths


class Keys(CaseKeys):
    outlines: str = "../shared/outlines.npz"  # fabric, sample, face_up (N,), outline (N, K, 2) m
    checkpoint: str = ""  # of the network; empty: the bundled one
    edge_mm: float = 4.0  # edges of the meshes at the plate's rim


def run(keys: Keys) -> Report:
    """Estimate all outlines and simulate a drape of each sample and face."""
    from drapenet.network.checkpoint import read_header
    from drapenet.network.predict import Draws, network_of, predict
    from drapenet.views.observation import Observation
    from drapenet.views.outline import outline_of_curve

    arrays = read_arrays(Path(keys.outlines), ("fabric", "sample", "face_up", "outline"),
                         expected="an npz file of outlines")
    fabric, sample, up = (arrays[name] for name in ("fabric", "sample", "face_up"))
    header = read_header(keys.checkpoint)
    network = network_of(header)
    seen = [Observation(DISC_RIG, 1 if face else -1, False, outline=outline_of_curve(curve))
            for face, curve in zip(up, arrays["outline"].astype(float), strict=True)]
    real = features(np.array([radii_of(curve) for curve in arrays["outline"].astype(float)]))

    def estimated(sets: Sequence[Sequence[int]]) -> list[Draws]:
        return [draws for block in range(0, len(sets), 64) for draws in predict(
            network, header, [[seen[k] for k in group] for group in sets[block : block + 64]])]

    alone = [(int(f), int(s), bool(u), [k]) for k, (f, s, u) in
             enumerate(zip(fabric, sample, up, strict=True))]
    both = [(int(f), int(s), True, [a, b]) for f, s in dict.fromkeys(
        zip(fabric.tolist(), sample.tolist(), strict=True))
        for a, b in zip(np.flatnonzero((fabric == f) & (sample == s) & up),
                        np.flatnonzero((fabric == f) & (sample == s) & ~up), strict=False)]
    report: dict[str, Any] = {}
    for name, rows in (("alone", alone), ("both faces", both)):
        draws = estimated([members for *_, members in rows])
        log_alpha = np.array([part.cloth.theta[:, LINEAR].mean() for part in draws])
        middle = np.array([np.column_stack(
            [part.cloth.theta, part.cloth.curl, np.log(part.cloth.membrane),
             part.cloth.hysteresis]).mean(axis=0) for part in draws])
        drape_stiffness = np.array([np.log(secant(
            DRAPE_CURVATURE, *from_theta(part.cloth.theta))).mean(axis=0) for part in draws])
        report[name] = _agreement(rows, log_alpha, drape_stiffness) | _drapes(
            rows, middle, real, keys)
    return report


def features(radii: np.ndarray) -> np.ndarray:
    """(N, 2) drape coefficient and folds of outlines (N, POINTS), m."""
    return np.column_stack([coefficient_of_area(np.pi * (radii**2).mean(axis=1), DISC_RIG),
                            [len(folds_around(radius, SIGMA)) for radius in radii]])


def radii_of(curve: Outline) -> np.ndarray:
    """Radii (POINTS,), m, of an outline at equally spaced azimuths."""
    azimuth = np.arctan2(curve[:, 1], curve[:, 0])
    order = azimuth.argsort()
    return np.interp(2 * np.pi * np.arange(POINTS) / POINTS, azimuth[order],
                     np.linalg.norm(curve, axis=1)[order], period=2 * np.pi)


def _agreement(
    rows: Sequence[tuple[int, int, bool, list[int]]], log_alpha: np.ndarray,
    drape_stiffness: np.ndarray,
) -> dict[str, Any]:
    """Median ratios of alpha, and how often the other sample whose stiffness in a drape along the
    three directions (N, 3), a logarithm, is nearest, is of the same fabric."""
    pairs: dict[str, list[float]] = {"captures": [], "samples": [], "faces": []}
    for a, b in combinations(range(len(rows)), 2):
        if rows[a][0] != rows[b][0]:
            continue
        same_sample = rows[a][1] == rows[b][1]
        same_face = rows[a][2] == rows[b][2]
        kind = {(True, True): "captures", (False, True): "samples",
                (True, False): "faces"}.get((same_sample, same_face))
        if kind:
            pairs[kind].append(abs(log_alpha[a] - log_alpha[b]))
    nearest = 0
    for k, row in enumerate(rows):
        apart = np.square(drape_stiffness - drape_stiffness[k]).sum(axis=1)
        apart[[other[:2] == row[:2] for other in rows]] = np.inf
        nearest += rows[int(apart.argmin())][0] == row[0]
    return {name: float(np.exp(np.median(values))) for name, values in pairs.items() if values} | {
        "nearest": nearest, "of": len(rows)}


def _drapes(
    rows: Sequence[tuple[int, int, bool, list[int]]], middle: np.ndarray, real: np.ndarray,
    keys: Keys,
) -> dict[str, Any]:
    """Drape coefficient and folds of a drape of the mean estimate of each sample and face, against
    the other samples of the fabric and face, and of the sample against them."""
    groups: dict[tuple[int, int, bool], list[int]] = {}
    for k, row in enumerate(rows):
        groups.setdefault(row[:3], []).append(k)
    cases = {f"{len(rows)}_{f}_{s}_{'up' if u else 'down'}": {
        "values": middle[members].mean(axis=0).tolist(), "face": 1 if u else -1}
        for (f, s, u), members in groups.items()}
    results = samples_of(simulated, keys, cases)
    measured = {key: real[[k for member in members for k in rows[member][3][:1]]].mean(axis=0)
                for key, members in groups.items()}
    errors: dict[str, list[np.ndarray]] = {"simulated": [], "samples": []}
    for key, found in zip(groups, results.values(), strict=True):
        for other, value in measured.items():
            if other[0] == key[0] and other[2] == key[2] and other[1] != key[1] and found:
                errors["simulated"].append(np.abs(found - value))
                errors["samples"].append(np.abs(measured[key] - value))
    return {f"{name}_{what}": float(np.mean([error[k] for error in values]))
            for name, values in errors.items() for k, what in enumerate(("coefficient", "folds"))}


def simulated(*, values: list[float], face: int, edge_mm: float) -> list[float]:
    """Drape coefficient and folds of a lowered drape of theta, curl, log membrane, hysteresis;
    nothing if it fails."""
    laws = Nuisances(membrane=float(np.exp(values[8])), hysteresis=max(values[9], 0.0),
                     curl_warp=face * values[6], curl_weft=face * values[7]).laws
    shape = drape(fabric_from_theta(np.array(values[:6])), rig=DISC_RIG, edge=1e-3 * edge_mm,
                  laws=laws)
    if not shape.converged:
        return []
    radius = silhouette(shape.positions, shape.mesh.edges, np.zeros(2), PARALLEL, azimuths=POINTS)
    return features(radius[None])[0].tolist()


STUDY = Study(Keys, run)
