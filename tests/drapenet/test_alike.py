"""Fabrics that cannot be told apart: the probability, its calibration, the order, the command."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from estimates import document_of, estimate_of
from scipy.stats import norm

import drapenet
import drapenet.alike
from common.errors import InputError
from drapenet.alike import ALIKE, Candidate, candidate, like, typical
from drapenet.library import main
from drapenet.network.checkpoint import BUNDLED
from drapenet.result.files import write_estimate
from sim.material import DIRECTIONS, MICRO, STIFF_SOFT

CAPTURES = Path(__file__).parents[2] / "examples" / "captures"
MIDDLE = np.log([52e-6, 31e-6, 22e-6])
WEIGHT = 2 * norm.cdf(np.log(1.1) / (0.03 * 2**0.5)) - 1  # that equal densities are alike


def cloth(name: str, middle: np.ndarray, deviation: float, **changes: object) -> Candidate:
    """A fabric with 4000 normal samples of the logarithms of its stiffness."""
    noise = np.random.default_rng([*name.encode()]).standard_normal((4000, 3))
    one = Candidate(name, "", 0.2, DIRECTIONS, middle + deviation * noise)
    return replace(one, **changes)


def test_the_probability_is_that_of_normal_errors():
    apart = np.array([0.1, -0.2, 0.0])
    one = cloth("a", MIDDLE, 0.15)
    found, = like(one, [cloth("b", MIDDLE + apart, 0.2)])
    for off, value in ((apart, found.probability), (0 * apart, found.highest)):
        inside = np.diff(norm.cdf([-ALIKE - off, ALIKE - off], scale=0.25), axis=0).prod()
        odds = inside / (1 - inside) * 0.94 / 0.06
        assert value == pytest.approx(WEIGHT * odds / (1 + odds), abs=0.03)
    assert [*found.apart.values()] == pytest.approx([*apart, 0], abs=0.02)
    # Pairs of two that are vague overlap, too.
    vague, = like(one, [cloth("c", MIDDLE, 1.0)])
    assert vague.verdict == "not known" and vague.highest < 0.3


def test_of_pairs_as_likely_alike_as_not_the_share_is_the_probability(monkeypatch):
    spread, error, rng = 0.5, 0.2, np.random.default_rng(0)
    truth = spread * rng.standard_normal((60_000, 2, 3))
    alike = (np.abs(truth[:, 0] - truth[:, 1]) <= ALIKE).all(axis=1)
    monkeypatch.setattr(drapenet.alike, "UNLIKE", (0, 0, alike.mean()))
    kept = np.concatenate([np.flatnonzero(part)[:600] for part in (alike, ~alike)])
    shrunk = spread**2 / (spread**2 + error**2)
    middles = shrunk * (truth[kept] + error * rng.standard_normal((1200, 2, 3)))
    left = error * shrunk**0.5
    found = np.array([like(cloth("a", a, left), [cloth("b", b, left)])[0].probability
                      for a, b in middles]) / WEIGHT
    for low, high in ((0, 0.3), (0.3, 0.6), (0.6, 1)):
        here = (low <= found) & (found < high)
        assert here.sum() > 100
        assert alike[kept][here].mean() == pytest.approx(found[here].mean(), abs=0.06)


def test_weight_shear_and_an_unmarked_warp_count():
    one = cloth("a", MIDDLE, 0.02, measured={"shear": (3.0, 0.05)})
    changed = {"same": {"measured": {"shear": (3.05, 0.05)}}, "unmarked": {"names": STIFF_SOFT},
               "heavy": {"density": 0.25}, "loose": {"measured": {"shear": (2.0, 0.05)}}}
    found = {each.fabric.name: each for each in like(one, [
        cloth("turned", MIDDLE[::-1], 0.02), cloth("stiff", MIDDLE + np.log(3), 0.02),
        *(cloth(name, MIDDLE, 0.02, **changes) for name, changes in changed.items())])}
    assert {*list(found)[:2]} == {"same", "unmarked"}
    assert {found[name].verdict for name in ("same", "unmarked")} == {"100 %"}
    assert {found[name].verdict for name in [*found][2:]} == {"below 5 %"}
    assert found["heavy"].content()["weight_difference_percent"] == pytest.approx(25)


def test_published_fabrics_are_compared_by_kes_b():
    # Without beta it is alpha.
    alpha = np.array([2.14, 2.1, 2.0]) * MICRO
    for names in (DIRECTIONS, STIFF_SOFT):
        one = estimate_of(alpha, np.zeros(3), density=0.179, names=names)
        first, second, *others = like(candidate(one), typical())
        assert first.fabric.name.startswith("75% wool") and first.probability > 0.9
        assert second.probability < 0.05 and len(others) == 8
        assert first.fabric.source.startswith("Petrak")


@pytest.mark.skipif(not BUNDLED.exists(), reason="no network is bundled")
def test_two_captures_of_a_fabric_are_found_by_the_command(tmp_path, capsys):
    views, photograph = (drapenet.estimate(CAPTURES / name)
                         for name in ("twill", "twill_photograph"))
    times = np.log([3.0, 3.0, 3.0, 1.0, 1.0, 1.0])
    stiffer = replace(views, cloth=replace(views.cloth, theta=views.samples + times))
    for name, one in (("views", views), ("photograph", photograph), ("stiffer", stiffer)):
        (tmp_path / name).mkdir()
        write_estimate(tmp_path / name, one, document_of(one))
    (tmp_path / "damaged").mkdir()
    (tmp_path / "damaged" / "estimate.json").write_text("{}")
    main([f"like={tmp_path}/views", f"out={tmp_path}/table.csv"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[2].startswith("80 %") and lines[2].endswith("/photograph")
    assert "warning: left out: " in lines[-2] and "damaged" in lines[-2]
    with (tmp_path / "table.csv").open(encoding="utf-8-sig") as file:
        rows = {Path(row["place"]).name: row for row in csv.DictReader(file)}
    assert len(rows) == 3 and float(rows["stiffer"]["probability"]) < 0.05
    assert float(rows["stiffer"]["warp_difference_percent"]) == pytest.approx(200, rel=1e-3)
    with pytest.raises(InputError, match="there is no such folder"):
        main([f"like={tmp_path}/views", "among=/none"])
