"""Rectangles: their sides in views and maps, their aspect in the network, and who may read them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from cloths import write_dataset

from common.errors import InputError
from data.captures.capture import warnings_of
from data.dataset.folder import finished_manifest
from data.render.cameras import QUARTERS, nominal_camera
from data.render.rays import DepthRenderer
from data.render.setups import Setups
from drapenet.config import ModelConfig
from drapenet.network.captures import CaptureSet, Condition
from drapenet.network.checkpoint import read_header
from drapenet.network.dataset import make_maps
from drapenet.network.inputs import FACTS
from drapenet.network.model import make_network
from drapenet.network.predict import batch_of, network_of, predict
from drapenet.network.targets import Symmetry
from drapenet.network.weights import Loaded
from drapenet.views.checks import REFUSED_SIZE_ERROR, size_checks
from drapenet.views.directions import AZIMUTH, AZIMUTHS
from drapenet.views.located import LocatedViews
from drapenet.views.observation import Observation, map_along
from drapenet.views.outline import DrapeOutline
from drapenet.views.radial_map import radial_map
from drapenet.views.sizes import measured_sizes
from sim.draping import Drape, drape
from sim.material import MICRO, Fabric
from sim.rig import Rig

RIG = Rig((0.17, 0.25), 0.09)
ACROSS = Rig((0.25, 0.17), 0.09)


@pytest.fixture(scope="module")
def draped() -> Drape:
    return drape(Fabric([40 * MICRO] * 3, [0.0] * 3), rig=RIG, edge=5e-3, seed=1)


def located(draped: Drape, orientation: float, rig: Rig = RIG) -> LocatedViews:
    camera = nominal_camera(RIG)
    views = DepthRenderer(draped.positions, draped.faces).views(camera, orientation)
    return LocatedViews.exact(views, camera, rig, np.array(QUARTERS))


def off(angle: float, period: float) -> float:
    """Degrees from the nearest multiple of a period."""
    return abs(np.degrees((angle + period / 2) % period - period / 2))


@pytest.mark.parametrize("orientation", [0.3, 1.9, 4.0])
def test_views_show_which_side_of_a_rectangle_is_which(draped, orientation):
    found = radial_map(located(draped, orientation))
    assert 0 <= found.zero < np.pi and off(found.zero - orientation, np.pi) < 5
    exchanged = radial_map(located(draped, orientation, ACROSS))
    assert off(exchanged.zero - orientation - np.pi / 2, np.pi) < 5
    warp = orientation + 0.2  # as stated, inaccurately
    along = map_along(warp, located(draped, orientation))
    assert off(along.zero - orientation, 2 * np.pi) < 5
    turns = round((along.zero - found.zero) / np.pi)
    assert np.array_equal(along.distance, np.roll(found.distance, -turns * AZIMUTHS // 2, axis=0))


@pytest.mark.parametrize("orientation", [0.3, 1.9, 4.0])
def test_a_stated_warp_decides_which_side_is_the_first(draped, orientation):
    """Stated across, the specimen lies with its sides exchanged: the views do not decide then."""
    views = located(draped, orientation)
    across = orientation + np.pi / 2
    assert off(map_along(across, views).zero - across, 2 * np.pi) < 46
    nearly = Rig((0.2, 0.21), 0.09)
    for warp in (orientation, across, orientation + np.pi):
        found = map_along(warp, located(draped, orientation, nearly)).zero
        assert off(found - warp, 2 * np.pi) < 46


def test_sizes_of_a_rectangle_are_those_of_its_sides(draped):
    sizes = measured_sizes(located(draped, 0.3))
    assert sizes.specimen == pytest.approx(RIG.specimen_size, rel=0.07)
    assert sizes.plate == pytest.approx(RIG.plate_diameter, rel=0.07)
    assert not warnings_of(size_checks(sizes, REFUSED_SIZE_ERROR))
    stated = Rig((0.34, 0.5), 0.09)
    warning, = warnings_of(size_checks(replace(sizes, rig=stated), REFUSED_SIZE_ERROR))
    first, second = (0.5 * sizes.specimen / RIG.specimen_size * side for side in (340, 500))
    assert warning.values["measured"] == f"{first:.0f}x{second:.0f}"
    assert warning.values["stated"] == "340x500"


def test_a_flat_rectangle_is_as_large_as_its_outline():
    outline = DrapeOutline(RIG.border(AZIMUTH))
    assert outline.coefficient(RIG) == pytest.approx(1.0, abs=0.01)
    half = DrapeOutline(np.full(AZIMUTHS, RIG.plate_radius), height=0.5)
    hanging = half.corrected(RIG).radius  # of a hem at the plate's rim, seen from half a metre
    lowest = 0.88 * (RIG.border(AZIMUTH) - RIG.plate_radius)
    assert np.all(hanging > RIG.plate_radius) and np.all(
        hanging < RIG.plate_radius * (1 + lowest / 0.5) + 1e-9)
    assert hanging.argmax() in np.argsort(RIG.border(AZIMUTH))[-8:]


def seen(rig: Rig, radius: np.ndarray, known: bool) -> Observation:
    return Observation(rig, 1, known, outline=DrapeOutline(radius, 1.0))


RADIUS = 0.075 + 0.006 * np.cos(2 * AZIMUTH + 0.3) + 0.004 * np.sin(5 * AZIMUTH)


@pytest.fixture(scope="module")
def reader(untrained_checkpoint: Path) -> tuple:
    """A network that reads rectangles, not trained, and its description."""
    header = read_header(untrained_checkpoint)
    model = header.model.model_copy(update={"rectangles": True})
    torch.manual_seed(1)
    return Loaded(make_network(**model.model_dump())), header.model_copy(update={"model": model})


def test_a_rectangle_read_across_is_the_one_of_exchanged_sides(reader):
    """Without a stated warp, azimuth 0 may lie along either side."""
    def theta(rig: Rig, radius: np.ndarray) -> np.ndarray:
        return predict(*reader, [[seen(rig, radius, False)]])[0].cloth.theta

    one = theta(RIG, RADIUS)
    other = theta(ACROSS, np.roll(RADIUS, AZIMUTHS // 4))
    gap = (other.mean(axis=0) - one.mean(axis=0)) / one.std(axis=0)
    assert gap == pytest.approx(np.zeros(6), abs=0.1)
    wrong = theta(ACROSS, RADIUS)
    assert np.abs((wrong.mean(axis=0) - one.mean(axis=0)) / one.std(axis=0)).max() > 1e-3


def test_the_aspect_is_read_by_networks_that_know_rectangles_alone(reader, untrained_checkpoint):
    network, header = reader
    plain = network_of(read_header(untrained_checkpoint))
    batches = [batch_of([[seen(rig, RADIUS, True)]])[0] for rig in (RIG, ACROSS)]
    along, across = (network.posterior(batch).means for batch in batches)
    assert not np.allclose(along, across)
    assert np.array_equal(*(plain.posterior(batch).means for batch in batches))
    header.require_learned(RIG)


@pytest.mark.parametrize("name", ["rectangle170x250_cylinder90", "square150_cylinder90"])
def test_a_network_without_rectangles_refuses_them(untrained_checkpoint, name):
    header = read_header(untrained_checkpoint)
    with pytest.raises(InputError, match=rf"tester {name}: .* 200 mm and more, no rectangles;"):
        header.require_learned(Rig.from_name(name))
    for known in ("square200_cylinder90", "disc200_support100", "square300_cylinder100"):
        header.require_learned(Rig.from_name(known))
    read_header().require_learned(Rig())  # the bundled one


def test_training_on_rectangles_turns_their_input_on(tmp_path):
    networks = []
    for name, share in (("square300_cylinder100", 0.0), (RIG.name, 0.5)):
        folder = write_dataset(tmp_path / name, drapes=16, edge=0.025, testers=(name,),
                               rectangles=share, drift=0.001)
        maps = make_maps(folder, finished_manifest(folder), tmp_path, setups=Setups.load("real"),
                         captures=1, seed=1)
        captures = CaptureSet(maps)
        networks.append(captures.network(ModelConfig(
            backbone=None, output="posterior", width=4, components=1, dropout=0.0)))
    assert [network["rectangles"] for network in networks] == [False, True]
    stated = np.isclose(maps.aspect, 25 / 17)
    assert 2 <= stated.sum() <= 14 and (maps.aspect[~stated] != 1).all()
    assert maps.size[stated] == pytest.approx(RIG.specimen_size)
    batch, facts = captures.batch(np.arange(16), rng=np.random.default_rng(0), symmetric=False,
                                  condition=Condition((0.0, 1.0, 0.0), (1.0,), known=1.0))
    assert np.array_equal(np.sort(facts.aspect), np.sort(maps.aspect))
    turned = batch.turned(Symmetry.number(1, 16))
    assert np.array_equal(turned.facts[:, FACTS], -batch.facts[:, FACTS])
    assert np.array_equal(turned.facts[:, FACTS + 1], batch.facts[:, FACTS + 1])
