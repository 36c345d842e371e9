"""What a refinement makes of the network's estimate."""

import math

import numpy as np
import pytest

from common.configs import read_option
from common.findings import texts
from data.fabrics.fabrics import ClothProperties, fabric_from_theta
from data.render.cameras import QUARTERS, nominal_camera
from data.render.rays import DepthRenderer
from drapenet.network.checkpoint import read_header
from drapenet.refine import refine
from drapenet.refine.minimise import Status
from drapenet.refine.positions import Fidelity
from drapenet.refine.problem import Effort, Trial, Uncertainty
from drapenet.refine.search import CapturedViews, SearchResult
from drapenet.refine.unknowns import NAMES, Unknowns
from drapenet.result.estimate import Estimate
from drapenet.views.located import LocatedViews
from sim.draping import Drape, drape
from sim.material import DIRECTIONS, MICRO
from sim.rig import Rig

HEADER = read_header()
THETA = np.concatenate([np.log(np.array([60, 40, 30]) * MICRO), np.full(3, -2e-3)])
SPREAD = np.array([0.9, 0.8, 0.9, 1.4e-3, 1.4e-3, 1.4e-3])


def before() -> Estimate:
    deviation = np.array([0.3, 0.2, 0.3, 3e-4, 2e-4, 3e-4])
    samples = THETA + deviation * np.random.default_rng(0).normal(size=(1000, 6))
    cloth = ClothProperties(samples, np.zeros((1000, 2)), np.full(1000, 600.0), np.full(1000, 0.2))
    return Estimate(cloth, DIRECTIONS, 0.15, SPREAD)


@pytest.fixture(scope="module")
def draped() -> Drape:
    return drape(fabric_from_theta(THETA), edge=8e-3)


def run(
    shape: Drape, monkeypatch: pytest.MonkeyPatch, *, start_value: float = 50.0
) -> tuple[refine.Refinement, dict]:
    """A refinement whose search finds ``shape`` with known uncertainties."""
    asked = {}

    def search(
        _: CapturedViews, starts: list[Unknowns], *, free: list[str], **more
    ) -> SearchResult:
        asked.update(starts=starts, free=free)
        names = (*(name for name in NAMES if name in free), "turn")
        objective = CapturedViews(located, turn=0.5, edge=8e-3, coarse=8e-3).objective(8e-3)
        nuisance = objective.start
        trial = Trial(np.zeros(len(names)), Unknowns.of(THETA + 0.1), nuisance, shape, 10.0, 10.0)
        return SearchResult(trial, objective, Effort(), start_value, Uncertainty(
            names, 0.01 * np.eye(len(names)), 1.0), shape, Status.CONVERGED, "")

    monkeypatch.setattr(refine, "search", search)
    camera = nominal_camera()
    views = DepthRenderer(shape.positions, shape.faces).views(camera, 0.5).astype(np.float32)
    located = LocatedViews.exact(views, camera, Rig(), QUARTERS)
    result = refine.refine_capture(
        before().cloth, located, HEADER, density=0.15, warp=0.5, face=-1,
        settings=read_option("refine", "simulation") | {"edge_mm": 8.0})
    return result, asked


def test_samples_are_those_of_the_network_and_as_many_of_the_search(draped, monkeypatch):
    result, asked = run(draped, monkeypatch)
    network, searched = np.split(result.draws.cloth.theta, 2)
    np.testing.assert_allclose(network.mean(axis=0), before().samples.mean(axis=0))
    np.testing.assert_allclose(network.std(axis=0),
                               refine.NARROWED * before().samples.std(axis=0))
    assert searched.mean(axis=0)[:3] == pytest.approx(THETA[:3] + 0.1, abs=0.02)
    assert searched.std(axis=0)[0] == pytest.approx(refine.NARROWED * 0.1, rel=0.1)
    assert result.searched.mean[:6] == pytest.approx(THETA + 0.1)
    mean = np.array(result.content["posterior"]["mean"])
    assert mean[:6] == pytest.approx(result.draws.cloth.theta.mean(axis=0))
    assert result.draws.known and not result.warnings
    assert result.resimulation.overlap > 0.97
    membrane = result.content["specimen"]["membrane_n_per_m"]
    assert membrane["interval_68"][1] / membrane["median"] == pytest.approx(math.exp(0.1))
    assert membrane["median"] == pytest.approx(200 * 0.15 / 0.3)  # of the fabric of 150 g/m²
    assert len(asked["starts"]) == 3
    np.testing.assert_allclose(asked["starts"][0].theta, before().theta, rtol=1e-12)


def test_a_refinement_that_gains_nothing_leaves_the_network_its_answer(draped, monkeypatch):
    result, _ = run(draped, monkeypatch, start_value=10.2)
    assert result.draws is None
    assert "refinement_no_better" in [found.code for found in result.warnings]


@pytest.mark.parametrize(("displacement", "warning"), [
    (3.0, None), (12.0, "12 mm from the scan"), (None, "does not come to rest")])
def test_cloth_released_at_a_scan_stays_there(displacement, warning):
    near = displacement and Fidelity(displacement, 1.0, 70.0, 70.0)
    warnings = texts(refine._scan_warnings(near))
    assert len(warnings) == (warning is not None) and (warning or "") in "".join(warnings)
