"""Bending by KES of real fabrics, estimated from their drape coefficient and nodes alone.

The mean of KES B over warp and weft, with its 90 % interval, is compared with the measured mean.
"""

from typing import Any

import numpy as np

from data.readings import QUANTITIES
from data.readings.kes import GF_CM
from data.readings.known import Reported
from data.readings.laboratory import laboratory_rows
from drapenet.network.checkpoint import read_header
from drapenet.network.predict import network_of, predict
from drapenet.result.estimate import make_estimate
from drapenet.views.observation import Observation
from experiments.report import Report
from experiments.study import PlainKeys, Study
from sim.material import FIRST, MICRO, SECOND
from sim.rig import Rig

TESTERS = {"petrak": "disc300_support180", "matsudaira": "disc254_support127"}  # by source


class Keys(PlainKeys):
    checkpoint: str = ""  # of the network; empty: the bundled one


def run(keys: Keys) -> Report:
    """Estimate all fabrics."""
    header = read_header(keys.checkpoint)
    rows = laboratory_rows()
    sets = []
    for row in rows:
        stated = Reported(drape_coefficient_percent=float(row["dc_real_percent"]),
                       nodes=int(row["nodes_real"]) if row["nodes_real"] else None)
        rig = Rig.from_name(TESTERS[row["source"]])
        sets.append([Observation.of_numbers(rig, 1, True, stated)])
    found = []
    for row, draws in zip(rows, predict(network_of(header), header, sets), strict=True):
        estimate = make_estimate(draws, density=1e-3 * float(row["weight_g_m2"]), header=header)
        samples = GF_CM * QUANTITIES["kes_b_gf_cm2_per_cm"].of(estimate.cloth,
                                                                   estimate.density)
        found.append(_compared(row, samples[:, [FIRST, SECOND]].mean(axis=1)))
    widths = [one["high"] / one["low"] for one in found]
    return {"fabrics": found, "inside": sum(one["inside"] for one in found), "of": len(found),
            "ratio": float(np.median(widths))}


def _compared(row: dict[str, str], samples: np.ndarray) -> dict[str, Any]:
    """The measured mean of B, µN·m, and the posterior's, of samples (S,), N·m; samples whose
    moduli do not determine B are NaN."""
    mean, *yarns = (row[f"bending_{one}_uNm"] for one in ("mean", "warp", "weft"))
    measured = float(mean) if mean else sum(map(float, yarns)) / 2
    low, middle, high = np.nanquantile(samples, [0.05, 0.5, 0.95]) / MICRO
    return {"fabric": row["id"], "measured": measured, "median": middle, "low": low, "high": high,
            "inside": bool(low <= measured <= high),
            "undetermined": float(np.isnan(samples).mean())}


STUDY = Study(Keys, run)
