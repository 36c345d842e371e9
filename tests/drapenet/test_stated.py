"""What a user states of tester and fabric for the network: rim, membrane stiffness, kind of cloth.
"""

from dataclasses import replace

import numpy as np
import pytest
from checkpoints import save_untrained
from cloths import write_dataset

import drapenet.fabric.combine
from common.errors import InputError
from data.dataset.folder import finished_manifest
from data.fabrics.nuisances import KINDS
from data.readings.known import Known
from data.render.cameras import QUARTERS, nominal_camera
from data.render.rays import DepthRenderer
from data.render.setups import Setups
from data.rigs import described_tester, read_tester
from drapenet.config import EstimateOptions
from drapenet.evidence.combine import posterior
from drapenet.fabric.combine import stated_of
from drapenet.fabric.estimate import estimate_fabric
from drapenet.fabric.next_measurements import another_disc
from drapenet.fabric.sources import Source
from drapenet.measured.tension.record import TensionRecord
from drapenet.network.captures import CaptureSet, Condition
from drapenet.network.checkpoint import read_header
from drapenet.network.dataset import make_maps
from drapenet.network.inputs import ASPECTS, FACTS, Stated
from drapenet.network.predict import batch_of, network_of, predict
from drapenet.network.trained import OfGraphs
from drapenet.network.weights import save_graphs
from drapenet.report.pages import in_words
from drapenet.views.located import LocatedViews
from drapenet.views.observation import Observation
from drapenet.views.sizes import measured_sizes
from sim.draping import drape
from sim.material import MICRO, Fabric
from sim.rig import DISC_RIG

ROUNDED = replace(DISC_RIG, rim=3e-3)
NUMBERS = {"specimen": "disc", "size_mm": 254, "plate_mm": 127}


@pytest.fixture(scope="module")
def header(untrained_checkpoint):
    return read_header(untrained_checkpoint)


def seen(rig=DISC_RIG) -> list[list[Observation]]:
    """A set of one capture."""
    return [[Observation(rig, 1, True, coefficient=0.5)]]


def test_a_tester_has_a_rim_where_one_is_stated():
    rig = read_tester(NUMBERS | {"rim_radius_mm": 3})
    assert rig.rim == 3e-3 and rig == read_tester("disc254_support127_rim3")
    assert described_tester(rig) == NUMBERS | {"rim_radius_mm": 3}
    assert read_tester(NUMBERS).rim == 0 and described_tester(DISC_RIG) == DISC_RIG.name
    assert in_words(rig.name).endswith("on a plate of 127 mm with a rim rounded by 3 mm")
    for wrong in (NUMBERS | {"rim_radius_mm": 11}, "disc300_support180_rim11"):
        with pytest.raises(InputError, match=r"has a rim of 11 mm; give 0 to 10 mm"):
            read_tester(wrong)
    other = another_disc([Observation(ROUNDED, 1, True, coefficient=0.7)])
    assert other.name == "disc360_support180_rim3"
    assert another_disc([Observation(other, 1, True, coefficient=0.7)]) is None


def test_a_plate_is_measured_to_the_end_of_its_rim():
    """At 10 mm its flat top alone would be refused."""
    rig = read_tester(NUMBERS | {"rim_radius_mm": 10})
    cloth, camera = drape(Fabric([40 * MICRO] * 3, [0.0] * 3), rig=rig, edge=8e-3, seed=1), (
        nominal_camera(rig))
    views = DepthRenderer(cloth.positions, cloth.faces).views(camera, 0.3)
    sizes = measured_sizes(LocatedViews.exact(views, camera, rig, np.array(QUARTERS)))
    assert sizes.plate == pytest.approx(0.127, rel=0.07)


@pytest.mark.parametrize(("rig", "stated"), [
    (ROUNDED, Stated()), (DISC_RIG, Stated(membrane=300.0)), (DISC_RIG, Stated(kind=1))])
def test_networks_read_what_is_stated(header, rig, stated):
    plain, told = (predict(network_of(header), header, sets, [one])[0].cloth.theta
                   for sets, one in ((seen(), Stated()), (seen(rig), stated)))
    assert not np.array_equal(plain, told)


def test_graphs_read_what_is_stated(tmp_path):
    header = read_header(save_untrained(tmp_path / "stated.safetensors"))
    batch, _ = batch_of(seen(ROUNDED), [Stated(300.0, 2)])
    expected = network_of(header).posterior(batch).means
    save_graphs(header)
    np.testing.assert_allclose(OfGraphs(header).posterior(batch).means, expected, atol=1e-4)


def test_what_is_stated_in_training_is_of_the_set(tmp_path):
    folder = write_dataset(tmp_path / "set", drapes=32, edge=0.025, starts_per_fabric=4,
                           testers_per_fabric=2, testers=(DISC_RIG.name,), rounded_rims=0.5)
    maps = make_maps(folder, finished_manifest(folder), tmp_path, setups=Setups.load("real"),
                     captures=1, seed=1)
    captures = CaptureSet(maps)
    cloths = np.tile(np.arange(8), 40)
    shares = replace(Condition.of_inputs(["outline"]), sizes=(0.0, 1.0))
    batch, facts = captures.batch(cloths, shares, np.random.default_rng(0))
    by_set = facts.group.argsort(kind="stable").reshape(-1, 2)
    for stated, share in ((np.isfinite(facts.rim), shares.rim), (facts.kind >= 0, shares.kind),
                          (np.isfinite(facts.membrane), shares.membrane)):
        first, second = stated[by_set].T
        assert np.array_equal(first, second) and first.mean() == pytest.approx(share, abs=0.1)
    for part in (facts.membrane, facts.kind):
        assert np.array_equal(*part[by_set].T, equal_nan=True)
    true = captures.cloth.membrane[cloths[facts.group]]
    assert np.nanstd(np.log(facts.membrane / true)) == pytest.approx(0.15, abs=0.05)
    assert 0 <= np.nanmin(facts.rim) < 1e-3 and 2e-3 < np.nanmax(facts.rim) < 9e-3
    known = facts.kind >= 0
    assert np.array_equal(facts.kind[known], captures.kind[cloths[facts.group]][known])
    columns = batch.facts[:, FACTS + ASPECTS :]
    for column, told in ((0, np.isfinite(facts.rim)), (2, np.isfinite(facts.membrane))):
        assert np.array_equal(columns[:, column] > 0, told)
        assert not columns[~told, column + 1].any()
    assert np.array_equal(columns[:, 4:].argmax(axis=1)[known], facts.kind[known])
    assert np.array_equal(columns[:, 4:].sum(axis=1) > 0, known)
    assert np.abs(columns).max() < 5


def test_a_membrane_that_the_network_reads_is_no_further_evidence(header, tmp_path, monkeypatch):
    (tmp_path / "capture.yaml").write_text(
        "density_g_m2: 150\ntester: {specimen: disc, size_mm: 300, plate_mm: 180, rim_radius_mm: 2}"
        "\nknown: {drape_coefficient_percent: 50, membrane_n_per_m: 600, hysteresis_share: 0.2, "
        "cloth: knit}\n")
    used = []

    def noted(prior, sources, name):
        used.append([source.key for source in sources])
        return posterior(prior, sources, name)

    monkeypatch.setattr(drapenet.fabric.combine, "posterior", noted)
    found = estimate_fabric([Source(place=tmp_path)], header, EstimateOptions(drapes=0))
    assert used == [["known.hysteresis_share.0"]]
    assert "kind of cloth: knit" in found.document.known_values
    assert found.document.capture.rig == "disc300_support180_rim2"


def test_strips_under_weights_state_the_membrane_unless_it_is_known():
    def quantity(median: float) -> dict:
        return {"median": median, "interval_68": [0, 1e4], "interval_90": [0, 1e4]}

    content = {"source": "", "density_g_m2": 150, "strips": 2, "measured": ["warp", "weft"],
               "shear_n_per_m": quantity(50), "friction_n_per_m": {}, "readings": {},
               "stretch_n_per_m": {"warp": quantity(900), "weft": quantity(400)},
               "weight_for_10_percent_g": {}, "along_yarns": True, "findings": []}
    strips = TensionRecord.model_validate(content)
    assert stated_of([None], 0.15, [strips]).membrane == pytest.approx(1200)
    known = Known(membrane_n_per_m=200, cloth=KINDS[1])
    assert stated_of([known], 0.15, [strips]) == Stated(pytest.approx(400), 1)
    assert stated_of([known, Known(cloth=KINDS[0])], 0.15).kind == -1
    half = TensionRecord.model_validate(content | {"measured": ["warp"]})
    assert np.isnan(stated_of([], 0.15, [half]).membrane)
