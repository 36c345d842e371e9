"""Drape coefficients and nodes of real fabrics of known bending against simulated ones.

A fabric has the loading curve B kappa + HB of its KES readings. Where 2HB was not measured, HB is
assumed in proportion to B. Fabrics with measured stretch and shear are draped with the default
membrane and with theirs. Nothing is fitted.
"""

from typing import Any

import numpy as np
from scipy.stats import spearmanr

from common.types import Density, Moduli
from experiments.report import Report, read_rows, rms, table
from experiments.study import CaseKeys, Sample, Study, samples_of
from sim.cloth import Laws
from sim.draping import drape
from sim.energies.bending_variants import Hysteresis
from sim.energies.membrane import Membrane, OrthotropicStVK
from sim.material import KES_CURVATURE, MICRO, REFERENCE_DENSITY, Fabric
from sim.measures import drape_coefficient, fold_count
from sim.rig import Rig

FABRICS = "experiments/physics/laboratory.csv"  # KES bending and drape of real fabrics
_POISSON = 0.3
"""Poisson's ratio of the measured membranes, which KES does not give."""


class Keys(CaseKeys):
    fabrics: str = FABRICS
    testers: tuple[str, ...] = (  # where the paper's tester is not known to us; else the second
        "disc254_support127", "disc300_support180")
    hb_over_b: float = 21.5  # 1/m, of fabrics without measured hysteresis: median of the others
    bias: float = 0.88  # modulus along the bias over the mean of the yarns': published median
    seeds: int = 6  # lowered drapes of each fabric


def bending(row: dict[str, str], *, hb_over_b: float, bias: float) -> tuple[list, list]:
    """B (3), µN·m, and 2HB (3), mN·m/m, along warp, bias and weft."""
    if mean := row["bending_mean_uNm"]:
        b = [float(mean)] * 3
    else:
        warp, weft = float(row["bending_warp_uNm"]), float(row["bending_weft_uNm"])
        b = [warp, bias * (warp + weft) / 2, weft]
    measured = row["two_HB_mNm_per_m"]
    two_hb = [float(measured)] * 3 if measured else [2e-3 * hb_over_b * one for one in b]
    return b, two_hb


def measured_membrane(row: dict[str, str]) -> dict[str, float] | None:
    """Stretch along warp and weft and shear, N/m, of cloth of 300 g/m²; None if not measured."""
    if not row["shear_g_s2"]:
        return None
    scale = 1e3 * REFERENCE_DENSITY / float(row["weight_g_m2"]) / 1e3
    return {"warp": scale * float(row["stretch_warp_g_s2"]),
            "weft": scale * float(row["stretch_weft_g_s2"]),
            "shear": scale * float(row["shear_g_s2"])}


def kes_fabric(
    b: Moduli, two_hb: np.ndarray, density: Density = REFERENCE_DENSITY
) -> tuple[Fabric, Hysteresis]:
    """The fabric and bending law of readings of KES-FB2, B and 2HB (3,), N·m per metre of width.
    Its loading torque is B kappa + HB."""
    b, friction = np.asarray(b, float), np.asarray(two_hb, float) / 2
    share = friction / (KES_CURVATURE * b + friction)
    return Fabric(b, density=density), Hysteresis(tuple(share.tolist()), added=True)


def drape_case(
    *, weight: float, b: list[float], two_hb: list[float], tester: str,
    membrane: dict[str, float] | None, seeds: int
) -> Sample:
    """Drape coefficients, %, and nodes of lowered drapes on the default mesh."""
    fabric, law = kes_fabric(MICRO * np.array(b), 1e-3 * np.array(two_hb), 1e-3 * weight)
    plane: Membrane = Laws().membrane
    if membrane:
        plane = OrthotropicStVK(poisson=_POISSON, **membrane)
    rig, coefficients, nodes, failed = Rig.from_name(tester), [], [], 0
    for seed in range(seeds):
        shape = drape(fabric, rig=rig, seed=seed, laws=Laws(bending=law, membrane=plane))
        if not shape.converged:
            failed += 1
            continue
        coefficients.append(100 * drape_coefficient(shape.positions, shape.faces, rig))
        nodes.append(fold_count(shape.positions, shape.rest, rig))
    return {"coefficients": coefficients, "nodes": nodes, "failed": failed}


def run(keys: Keys) -> Report:
    """Drape all fabrics and compare with the laboratories."""
    rows = {row["id"]: row for row in read_rows(keys.fabrics)}
    cases = {}
    for name, row in rows.items():
        b, two_hb = bending(row, hb_over_b=keys.hb_over_b, bias=keys.bias)
        known = measured_membrane(row)
        for tester in keys.testers if known is None else keys.testers[-1:]:
            for membrane in (None, known) if known else (None,):
                label = f"{name}_{tester}" + "_membrane" * bool(membrane)
                cases[label] = {"weight": float(row["weight_g_m2"]), "b": b, "two_hb": two_hb,
                                "tester": tester, "membrane": membrane}
    results = samples_of(drape_case, keys, cases)
    found = [_compared(rows[label.split("_")[0]], cases[label], result) | {"case": label}
             for label, result in results.items()]
    return {"fabrics": found, "summary": {tester: _summary(found, tester, keys.testers[-1])
                                          for tester in keys.testers}}


def _compared(row: dict[str, str], case: dict, result: dict) -> dict[str, Any]:
    nodes = row["nodes_real"]
    return {"fabric": row["id"], "composition": row["composition"], "tester": case["tester"],
            "membrane": "measured" if case["membrane"] else "default",
            "hysteresis": "measured" if row["two_HB_mNm_per_m"] else "assumed",
            "measured": float(row["dc_real_percent"]),
            "coefficient": float(np.mean(result["coefficients"])),
            "spread": float(np.std(result["coefficients"])),
            "nodes_measured": float(nodes) if nodes else None,
            "nodes": float(np.mean(result["nodes"])), "failed": result["failed"]}


def _summary(found: list[dict], tester: str, known: str) -> dict[str, float]:
    """Differences with ``tester`` for the fabrics whose tester is unknown; those of the others,
    with the default membrane, are with ``known``."""
    chosen = [one for one in found if one["membrane"] == "default" and one["tester"] == (
        tester if one["hysteresis"] == "measured" else known)]
    own = [one for one in chosen if one["hysteresis"] == "measured"]

    def off(rows: list[dict]) -> float:
        return rms([row["coefficient"] - row["measured"] for row in rows])

    return {"fabrics": len(chosen), "with_hysteresis": len(own), "rms_hysteresis": off(own),
            "rms": off(chosen),
            "rank": float(spearmanr([one["measured"] for one in chosen],
                                    [one["coefficient"] for one in chosen]).statistic),
            "nodes": rms([one["nodes"] - one["nodes_measured"] for one in own])}


def block(report: Report) -> str:
    """Drape coefficients of laboratory fabrics, measured and simulated with the default
    membrane."""
    testers = list(dict.fromkeys(one["tester"] for one in report["fabrics"]))
    rows: dict[str, list[str]] = {}
    for one in report["fabrics"]:
        if one["membrane"] == "default":
            row = rows.setdefault(one["fabric"], [
                one["fabric"], f"{one['measured']:.0f}", *["–"] * len(testers)])
            row[2 + testers.index(one["tester"])] = f"{one['coefficient']:.0f}"
    return table(["drape coefficient, %", "measured",
                  *(name.replace("_", " ") for name in testers)], rows.values())


STUDY = Study(Keys, run, block)
