"""The bounds of a capture, beside the errors of its estimate."""

from dataclasses import replace

import numpy as np
import pytest

from data.cameras import CameraRig
from drapenet.information import Information
from drapenet.limits import add_limits
from drapenet.resimulate import Resimulation
from sim.drape import DrapeResult, drape
from sim.material import MICRO, Fabric

NAMES = ("stiff", "bias", "soft")


@pytest.fixture(scope="module")
def draped() -> DrapeResult:
    result = drape(Fabric(np.array([60.0, 45.0, 35.0]) * MICRO), edge=8e-3, seed=1)
    assert result.converged
    return result


def shown(result: DrapeResult, turn: float) -> Resimulation:
    views = np.zeros((4, 1, 1))
    return Resimulation(views, (np.zeros(1), np.zeros(1)), (0, 0), 1.0, ("converged",), result,
                        CameraRig.load().nominal(), turn)


def content(percent: float) -> dict:
    error = {"alpha_percent": percent, "beta_over_alpha_mm": percent / 100}
    return {"moduli": dict.fromkeys(NAMES), "warnings": [],
            "typical_error": {name: dict(error) for name in NAMES}}


def test_errors_are_raised_to_the_bound_and_no_further(draped: DrapeResult) -> None:
    sure, unsure = content(1e-6), content(1e3)
    for one in (sure, unsure):
        add_limits(one, shown(draped, 0.4))
    assert sure["typical_error"] == sure["limits"]
    assert unsure["typical_error"] == content(1e3)["typical_error"]
    assert unsure["limits"] == sure["limits"]


def test_a_specimen_whose_weft_is_stiff_has_the_same_limits(draped: DrapeResult) -> None:
    # The same cloth, its two yarns named the other way round.
    turned = draped.mesh.with_rest(draped.rest @ np.array([[0.0, 1.0], [-1.0, 0.0]]))
    swapped = replace(draped, fabric=Fabric(draped.fabric.alpha[::-1].copy()), mesh=turned)
    found = []
    for result, turn in ((draped, 0.4), (swapped, 0.4)):
        one = content(1.0)
        add_limits(one, shown(result, turn))
        found.append([one["limits"][name]["alpha_percent"] for name in NAMES])
    assert found[1] == pytest.approx(found[0], rel=1e-3)


@pytest.mark.parametrize(("bound", "said"), [(0.6, "hardly tells alpha bias: at best to"),
                                             (1.0, "does not tell alpha bias")])
def test_what_is_hardly_told_is_named(
    draped: DrapeResult, monkeypatch: pytest.MonkeyPatch, bound: float, said: str
) -> None:
    """Over fabrics, log alpha along the bias spreads by 0.81."""
    information = np.full(14, 1e12)
    information[1] = bound**-2.0  # log alpha along the bias
    information[4] = 1e8  # beta/alpha along the bias, to 0.1 mm
    names = tuple(f"theta{k}" for k in range(6))

    class Blind(Information):
        def covariance(self, unknown: tuple[str, ...] = ()) -> np.ndarray:
            return np.diag(1 / information[:6])

    monkeypatch.setattr("drapenet.limits.depth_information", lambda *_, **__: Blind(
        names, np.zeros((6, 6)), 1, True, ""))
    one = content(1.0)
    add_limits(one, shown(draped, 0.0))
    assert len(one["warnings"]) == 1 and said in one["warnings"][0]
    assert one["typical_error"]["bias"]["alpha_percent"] == pytest.approx(100 * np.expm1(bound))


def test_a_drape_without_derivatives_is_reported(
    draped: DrapeResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drapenet.limits.depth_information", lambda *_, **__: Information(
        (), np.zeros((0, 0)), 0, False, "a fold"))
    one = content(1.0)
    add_limits(one, shown(draped, 0.0))
    assert "a fold" in one["warnings"][0] and "limits" not in one
