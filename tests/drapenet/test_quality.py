"""Spoiled captures say what is wrong with them; sound ones say nothing."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from common.errors import InputError
from common.findings import sentences, texts
from data.captures.check import warnings_of
from data.render.setups import Setups, SyntheticCapture
from drapenet.views.checks import (
    SPECIMEN_OFFSET,
    Quality,
    measure,
    quality_checks,
    require_plate,
    specimen_offset,
)
from drapenet.views.located import LocatedViews
from drapenet.views.radial_map import radial_map
from experiments.__main__ import main
from experiments.estimation.specimen_offset import fit
from sim.draping import drape
from sim.material import Fabric
from sim.rig import Rig

RIG = Rig()
FABRIC = Fabric([48e-6, 30e-6, 22e-6], [-96e-9, -60e-9, -44e-9])
CLEAN = replace(Setups.load(), views=(0.0, 0.0, 0.0, 1.0), sensors={"smooth": 1.0}, border=0,
                holes=0, hem_share=0.0)


@pytest.fixture(scope="module")
def sound() -> SyntheticCapture:
    # Lowered squares of this fabric are too symmetric to show that the table was reversed.
    shape = drape(FABRIC, edge=6e-3, seed=4, start="sine")
    assert shape.converged
    return CLEAN.capture(shape.positions, shape.faces, np.random.default_rng(6),
                         rig=RIG)


def quality(capture: SyntheticCapture, rig: Rig = RIG) -> Quality:
    located = LocatedViews.cut_out(capture.views, capture.intrinsics, rig, capture.turns)
    return measure(located, radial_map(located))


def warnings(capture: SyntheticCapture) -> str:
    return "; ".join(texts(warnings_of(quality_checks(quality(capture)))))


def test_coefficients_of_the_placement_are_written_to_out_alone(
    cloth_dataset, tmp_path, monkeypatch, sound
):
    before, out = SPECIMEN_OFFSET.read_bytes(), tmp_path / "specimen_offset.json"
    main(["specimen_offset", f"data={cloth_dataset}", "captures=6", f"out={out}"])
    fitted, bundled = json.loads(out.read_text()), json.loads(before)
    assert SPECIMEN_OFFSET.read_bytes() == before
    assert fitted.keys() >= bundled.keys()
    assert fitted["coefficients"] != bundled["coefficients"]
    found = radial_map(LocatedViews.cut_out(sound.views, sound.intrinsics, RIG, sound.turns))
    placement = specimen_offset(found, RIG)
    monkeypatch.setattr("drapenet.views.checks.SPECIMEN_OFFSET", out)  # is read once
    assert specimen_offset(found, RIG) == placement


def test_a_sound_capture_gives_no_warning(sound):
    assert warnings(sound) == ""


def _rays(views: np.ndarray, capture: SyntheticCapture) -> np.ndarray:
    rows, columns = np.indices(views.shape[1:])
    given = capture.intrinsics
    return views * np.sqrt(1 + ((columns - given.cx) / given.fx) ** 2
                           + ((rows - given.cy) / given.fy) ** 2)


def _holed(views: np.ndarray, capture: SyntheticCapture) -> np.ndarray:
    row, column = np.argwhere(ndimage.binary_erosion(views[0] > 0, iterations=20))[0]
    views[0, row - 8 : row + 9, column - 8 : column + 9] = 0
    return views


def _stayed(views: np.ndarray, capture: SyntheticCapture) -> np.ndarray:
    noise = np.random.default_rng(0).normal(0, 1e-3, views[0].shape)
    views[1] = np.where(views[0] > 0, views[0] + noise, 0)
    return views


def _cut(views: np.ndarray, capture: SyntheticCapture) -> np.ndarray:
    return np.where(views > np.quantile(views[views > 0], 0.8), 0, views)


@pytest.mark.parametrize(("spoil", "said"), [
    (_rays, "length of the ray"),
    (_holed, "in one hole"),
    (_stayed, "did not turn before view 1"),
    (_cut, "a threshold of the depth has cut"),
    (lambda views, _: views[[0, 2, 1, 3]], "views 1 and 2 are swapped"),
    (lambda views, _: views[[0, 3, 2, 1]], "turned the other way"),
    (lambda views, _: 1.15 * views, "check depth unit and scale"),
])
def test_a_fault_is_named(sound, spoil, said):
    views = spoil(sound.views.copy(), sound)
    assert said in warnings(replace(sound, views=views.astype(np.float32)))


def test_more_than_the_flat_specimen_is_no_drape(sound):
    seen = quality(sound)
    assert 0.1 < seen.coefficient < 0.9
    require_plate(slight := replace(seen, coefficient=1.05))
    found, = warnings_of(quality_checks(slight))
    assert found.text.startswith("the drape coefficient is 105%, only 0 to 100 % is possible")
    with pytest.raises(InputError, match="coefficient is 127%"):
        require_plate(replace(seen, coefficient=1.27))


@pytest.mark.parametrize("spoil", [
    lambda views: views[:, ::-1], lambda views: views[:, ::-1, ::-1], lambda views: 1.3 * views])
def test_what_cannot_be_a_drape_on_the_plate_is_refused(sound, spoil):
    require_plate(quality(sound))
    views = np.ascontiguousarray(spoil(sound.views), np.float32)
    with pytest.raises(InputError, match="upright"):
        require_plate(quality(replace(sound, views=views)))


@pytest.mark.parametrize(("stated", "said"), [
    (Rig(0.25), "the specimen measures .* times the stated 250 mm"),
    (Rig(0.38), "the specimen measures .* times the stated 380 mm"),
    (Rig(plate_diameter=0.14), "the plate measures .* times the stated 140 mm"),
    (Rig(plate_diameter=0.08), "the plate measures .* times the stated 80 mm"),
])
def test_a_tester_of_another_size_is_refused(sound, stated, said):
    with pytest.raises(InputError, match=said):
        require_plate(quality(sound, stated))


def test_a_specimen_off_the_axis_is_measured():
    shape = drape(FABRIC, edge=6e-3, seed=4, offset=(0.016, -0.012))
    seen = CLEAN.capture(shape.positions, shape.faces, np.random.default_rng(6),
                         rig=RIG)
    measured = quality(seen)
    assert measured.offset == pytest.approx(0.02, abs=4e-3)
    assert "specimen_off_axis" in [found.code for found in warnings_of(quality_checks(measured))]


def test_an_offset_is_regressed_on_features():
    rng = np.random.default_rng(1)
    features, groups = rng.normal(0.1, 0.01, (400, 6)), np.repeat(np.arange(100), 4)
    true = rng.normal(0, 5, 6)
    offsets = features @ true + rng.normal(0, 1e-3, 400)
    found = fit(features, offsets, groups)
    assert np.abs(features @ found["coefficients"] - offsets).max() < 5e-3
    assert found["deviation"] == pytest.approx(1e-3, rel=0.2)


WARNINGS = (
    "the cloth touches the picture's border", "pixels left out", "8-bit depth", "less than",
    "no table is seen below the plate", "the column is nearly as wide as the plate",
    "background.png shows", "background.png does not fit the frames",
    "camera_height_mm is missing", "the plate's centre is not known",
    "the outline turns back over", "a pixel covers", "off the vertical",
    "above the horizontal", "mm away", "the table was turned by", "the specimen measures",
    "the specimen's centre lies", "the plate looks curved", "views differ", "have no depth",
    "border has one and the same depth", "a pixel spans", "the drape coefficient is",
    "of its silhouette in common", "has a drape coefficient of",
    "outside the fabrics of the training set", "of the posterior samples", "contradict",
    "state different densities", ": they say", "no drape of the estimate converged",
    "the estimate is not refined", "the network's estimate is not refined",
    "there is no report", "the report shows no simulated drape")
"""Words of each warning."""


@pytest.mark.parametrize("words", WARNINGS)
def test_the_docs_have_the_cause_of_every_warning(words):
    lines = (Path(__file__).parents[2] / "docs" / "rig.md").read_text("utf-8").splitlines()
    assert any(words in sentence for sentence in sentences().values())
    assert any(line.startswith("| ") and line.count("|") == 3 and words in line for line in lines)
