"""Strips under weights: stiffnesses of simulated strips, friction, errors, refusals."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from data.readings.quantity import STANDARD_GRAVITY
from drapenet.measured.tension.folder import TensionSet, read_tension
from drapenet.measured.tension.law import compliance, extension, reach
from drapenet.measured.tension.posterior import (
    FRICTION,
    KES_SHEAR,
    MeasuredExtension,
    TensionEvidence,
    prior,
    tension_evidence,
)
from sim.energies.membrane import OrthotropicStVK
from sim.material import BIAS, DIRECTIONS, REFERENCE_DENSITY, WARP, WEFT
from sim.tension import pull

TRUE = (2500.0, 900.0, 35.0)  # N/m: warp, weft, shear
POISSON = 0.3


def read(folder: Path, *strips: dict, **stated) -> TensionSet:
    """A folder with these strips."""
    (folder / "tension.yaml").write_text(yaml.safe_dump(
        {"density_g_m2": 210, "tension": list(strips)} | stated))
    return read_tension(folder)


def told(folder: Path, *strips: dict, **stated) -> TensionEvidence:
    return read(folder, *strips, **stated).evidence


def medians(found: TensionEvidence) -> np.ndarray:
    return np.exp(found.posterior.mean)


def deviations(found: TensionEvidence) -> np.ndarray:
    return np.sqrt(np.diag(found.posterior.covariance))


def strip_of(direction: str, load_g: float, *, friction: float = 0.0, gauge: float = 100.0,
             factor: float = 1.0, **stated) -> dict:
    """A strip of cloth of the stiffnesses :data:`TRUE` times a factor."""
    k, cloth = DIRECTIONS.index(direction), tuple(factor * np.array(TRUE))
    load = 1e-3 * load_g * STANDARD_GRAVITY / 0.05 - friction
    share = extension(load, compliance(k, cloth, POISSON))
    return {"direction": direction, "width_mm": 50.0, "gauge_mm": gauge, "load_g": load_g,
            "extension_mm": float(gauge * share)} | stated


def test_strips_simulated_between_clamps_give_the_stiffnesses(tmp_path):
    cloth = OrthotropicStVK(warp=TRUE[0], weft=TRUE[1], shear=TRUE[2],
                            poisson=POISSON * np.sqrt(TRUE[0] / TRUE[1]))
    strips = []
    for k, (direction, share) in enumerate(zip(DIRECTIONS, (0.04, 0.05, 0.08), strict=True)):
        found = pull(cloth, angle=k * np.pi / 4, length=0.1, width=0.05, extension=share, cells=48)
        strips.append({"direction": direction, "width_mm": 50, "gauge_mm": 100, "clamped_mm": 100,
                       "load_g": float(1e3 * found.load * 0.05 / STANDARD_GRAVITY),
                       "extension_mm": 100 * share})
    clamped = told(tmp_path, *strips, extension_error_mm=0.05)
    assert medians(clamped) == pytest.approx(TRUE, rel=0.08)
    assert not clamped.findings
    # As FAST-3 does it, without the clamps' part.
    simple = 1e-3 * strips[1]["load_g"] * STANDARD_GRAVITY / 0.05 / (4 * 0.05)
    assert simple > 1.3 * TRUE[2]


def test_two_loads_find_the_initial_friction_and_narrow_the_interval(tmp_path):
    one = told(tmp_path, strip_of("bias", 25, friction=1.0))
    two = told(tmp_path, strip_of("bias", 25, friction=1.0), strip_of("bias", 100, friction=1.0))
    assert two.friction[BIAS] == pytest.approx(1.0, abs=0.4)
    assert medians(two)[2] == pytest.approx(TRUE[2], rel=0.15)
    assert medians(one)[2] > 1.2 * TRUE[2]  # a secant
    assert deviations(two)[2] < 0.75 * deviations(one)[2]
    assert not two.findings


def test_intervals_contain_what_they_say(tmp_path):
    rng, inside = np.random.default_rng(1), 0
    for _ in range(60):
        strips = []
        for direction, loads in (("bias", (25, 50)), ("warp", (500,)), ("weft", (500,))):
            factor, friction = np.exp(0.073 * rng.standard_normal()), rng.standard_normal()
            for load in loads:
                strip = strip_of(direction, load, friction=friction, factor=factor)
                strip["extension_mm"] += 0.3 * rng.standard_normal()
                strip["load_g"] *= 1 + 0.01 * rng.standard_normal()
                strips.append(strip)
        found = told(tmp_path, *strips)
        off = (np.log(TRUE) - found.posterior.mean) / deviations(found)
        inside += np.count_nonzero(np.abs(off) < 0.994)
    assert 0.55 < inside / 180 < 0.82  # 68 %


def test_shear_of_a_bias_strip_alone_is_as_sure_as_its_interval_says():
    """Cloth of the prior: the strip is long by its shear or by its yarns."""
    rng, below = np.random.default_rng(3), []
    usual = prior(REFERENCE_DENSITY)
    for _ in range(60):
        cloth = tuple(np.exp(rng.multivariate_normal(usual.mean, usual.covariance)))
        strain = rng.uniform(0.01, 0.12)
        strip = MeasuredExtension(BIAS, 1.0, 0.01, 0.05, 0.1, np.inf, 0.1 * strain, 1e-4)
        needed = strip.needed(cloth, POISSON)
        borne = max(FRICTION * rng.standard_normal() + needed, needed / 2)
        found = tension_evidence([replace(strip, load=borne)], REFERENCE_DENSITY)
        below.append((found.samples[:, 2] < np.log(cloth[2])).mean())
    off = np.abs(2 * np.array(below) - 1)
    assert (off < 0.9).mean() > 0.83 and 0.52 < (off < 0.68).mean() < 0.84


def test_what_is_not_measured_is_that_of_usual_fabrics(tmp_path):
    bias = told(tmp_path, strip_of("bias", 50))
    assert bias.measured == (BIAS,) and deviations(bias)[0] > 1.0
    both = told(tmp_path, strip_of("bias", 50), strip_of("warp", 500))
    assert deviations(both)[0] < 0.25 < deviations(both)[1] < deviations(bias)[1]


def test_kes_shear_joins_the_strips_and_is_a_reading(tmp_path):
    alone = told(tmp_path, kes_g_gf_per_cm_deg=0.8)
    assert medians(alone)[2] == pytest.approx(0.8 * KES_SHEAR, rel=0.02)
    found = alone.readings()
    assert np.median(found["kes_g_gf_per_cm_deg"]) == pytest.approx(0.8, rel=0.02)
    cloth, n = tuple(medians(alone)), alone.poisson
    eb5 = 100 * extension(4.903, compliance(BIAS, cloth, n)) * reach(BIAS, cloth, n, gauge=2,
                                                                   margin=0)
    assert np.median(found["fast_eb5_percent"]) == pytest.approx(eb5, rel=0.1)


def test_values_of_fast_are_read_as_they_are_given(tmp_path):
    stated = {"fast_eb5_percent": 3.4, "fast_e100_warp_percent": 2.0, "fast_e100_weft_percent": 5.0}
    found = told(tmp_path, **stated)
    assert found.measured == (WARP, BIAS, WEFT) and not found.findings
    for key, value in found.readings().items():
        if key in stated:
            assert np.median(value) == pytest.approx(stated[key], rel=0.1)
    strip = {"direction": "bias", "width_mm": 50, "gauge_mm": 100, "clamped_mm": 100,
             "load_g": 25, "extension_mm": 3.4}
    alone = told(tmp_path, fast_eb5_percent=3.4)
    assert medians(alone) == pytest.approx(medians(told(
        tmp_path, strip, extension_error_mm=0.1)), rel=1e-6)


def test_the_weight_for_ten_per_cent_stretches_by_ten_per_cent(tmp_path):
    strips = read(tmp_path, strip_of("bias", 25), strip_of("warp", 500))
    for direction, load in strips.loads().items():
        assert strip_of(direction, load)["extension_mm"] == pytest.approx(10, rel=0.12)


def test_half_a_clip_counts_and_half_is_its_error(tmp_path):
    without, clipped = (told(tmp_path, strip_of("bias", 50), clip_g=clip) for clip in (0.0, 20.0))
    assert medians(clipped)[2] > 1.15 * medians(without)[2]
    assert deviations(clipped)[2] > deviations(without)[2]


@pytest.mark.parametrize(("strips", "code"), [
    ([strip_of("bias", 25), strip_of("bias", 50) | {"load_g": 500.0}], "tension_differs"),
    ([strip_of("warp", 500, gauge=200.0), strip_of("warp", 1000, gauge=200.0) |
      {"extension_mm": 23.0}], "tension_differs"),  # slipped
    ([strip_of("bias", 25) | {"load_g": 1000.0}], "tension_unusual"),
    ([strip_of("warp", 1000) | {"load_g": 10.0}], "tension_soft"),
])
def test_strips_that_contradict_each_other_or_all_fabrics_are_named(tmp_path, strips, code):
    found = told(tmp_path, *strips).findings
    assert [one.code for one in found] == [code]
    assert strips[0]["direction"] in found[0].text or "shear" in found[0].text
    found = told(tmp_path, *strips, known={"cloth": "knit"}).findings
    assert bool(found) == (code != "tension_soft")
