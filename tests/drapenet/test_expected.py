"""What a network expects of a capture: shapes of known curves, and a check that can fail."""

import numpy as np
import pytest
import torch

from common.findings import texts
from drapenet.network.expected import (
    LEVEL,
    SHAPE,
    Likeness,
    likeness,
    log_density_of_all,
    shape_of,
)
from drapenet.network.inputs import Batch, Facts
from drapenet.network.model import Expected, _log_density
from drapenet.network.targets import CURL, TARGETS
from drapenet.result.advice import advice_of, joint_advice
from drapenet.views.directions import AZIMUTH, ELEVATIONS
from sim.rig import Rig

UNIT = np.array([0.25, 1.0, 1.0, 3.0, 3.0])


def test_the_shape_of_a_wavy_outline_is_its_waves():
    radius = 0.75 + 0.06 * np.cos(7 * AZIMUTH - 1) + 0.01 * np.cos(AZIMUTH)
    radius[5:12] = np.nan  # not seen
    shape, = shape_of(radius[None], np.array([0.4]), np.array([np.nan])) * UNIT
    assert shape[0] == pytest.approx(0.4) and np.isnan(shape[4])
    assert np.exp(shape[1]) == pytest.approx(0.06, rel=0.05)
    assert np.exp(shape[2]) == pytest.approx(np.hypot(0.01, 0.01), rel=0.2)
    assert shape[3] == pytest.approx(7, abs=0.1)
    radius[20:90] = np.nan
    assert np.isnan(shape_of(radius[None], np.array([0.4]), np.array([6.0]))[0, 1:4]).all()


def test_of_a_single_view_the_coefficient_alone_is_compared():
    nothing, two = np.full(2, np.nan), np.ones(2)
    facts = Facts(size=0.3 * two, plate=0.6 * two, disc=two > 0, aspect=two, face=two,
                  known=two > 0, views=np.array([1, 4]), perspective=0 * two,
                  coefficient=0.4 * two, nodes=nothing, group=np.arange(2))
    maps = np.zeros((2, len(AZIMUTH), ELEVATIONS))
    outline = np.tile(0.75 + 0.06 * np.cos(7 * AZIMUTH), (2, 1))
    batch = Batch.of(maps, maps, outline, 0 * outline, facts, np.zeros((2, 0, 1, 1)), 0 * two)
    assert np.isfinite(batch.shape).tolist() == [[True, *[False] * 4], [*[True] * 4, False]]


@pytest.fixture(scope="module")
def expected() -> Expected:
    """It has learned that the coefficient follows the first target with a deviation of 0.3, and
    that the other numbers depend on the curl that is up."""
    torch.manual_seed(0)
    found = Expected(facts=2)
    optimizer = torch.optim.Adam(found.parameters(), 5e-3)
    for _ in range(400):
        targets, facts = torch.randn(256, TARGETS), torch.randn(256, 2)
        face = torch.sign(torch.randn(256))
        shape = 0.3 * torch.randn(256, SHAPE) + (face * targets[:, CURL.start])[:, None]
        shape[:, 0] = targets[:, 0] + 0.3 * torch.randn(256)
        shape[torch.rand(256, SHAPE) < 0.2] = torch.nan
        loss = -found.log_density(shape, targets, facts, face).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return found


def drawn(count: int, seed: int) -> tuple[torch.Tensor, ...]:
    """Shapes, posterior samples about their cloths, facts and faces of captures."""
    generator = torch.Generator().manual_seed(seed)
    targets = torch.randn(count, TARGETS, generator=generator)
    face = torch.sign(torch.randn(count, generator=generator))
    shape = 0.3 * torch.randn(count, SHAPE, generator=generator) + (
        face * targets[:, CURL.start])[:, None]
    shape[:, 0] = targets[:, 0] + 0.3 * torch.randn(count, generator=generator)
    samples = targets + 0.1 * torch.randn(400, count, TARGETS, generator=generator)
    return shape, samples, torch.zeros(count, 2), face


@torch.inference_mode()
def compared(expected: Expected, shape: torch.Tensor, *given: torch.Tensor) -> list[Likeness]:
    """Of samples (S, N, TARGETS), facts and faces of captures."""
    samples, facts, face = given
    parts = expected(samples, facts.expand(len(samples), *facts.shape),
                     face.expand(len(samples), *face.shape))
    return likeness(shape.numpy(), *(part.numpy() for part in parts))


def test_captures_like_their_estimate_are_seldom_named(expected):
    found = compared(expected, *drawn(200, 1))
    shares = np.array([one.probability for one in found])
    assert (shares < LEVEL).mean() <= 0.03 and 0.35 < shares.mean() < 0.65
    assert all(one.warning(0.3, "the tester") is None for one in found if one.probability >= LEVEL)


def test_a_capture_that_no_cloth_of_its_estimate_gives_is_named_with_the_number(expected):
    shape, samples, facts, face = drawn(20, 2)
    shape[:, 0] += 3.0  # 75 points of drape coefficient
    shape[:, 4] = torch.nan
    for one in compared(expected, shape, samples, facts, face):
        assert one.probability < LEVEL
        assert one.warning(0.3, "the tester").code == "unlike_coefficient"
    turned = compared(expected, *drawn(20, 2)[:3], -drawn(20, 2)[3])  # the other face up
    assert np.median([one.probability for one in turned]) < 0.1


@pytest.mark.parametrize(("name", "coefficient", "advice"), [
    ("disc300_support180", 0.86, "drape a disc of 360 mm"), ("disc360_support180", 0.9, "strips"),
    ("square300_cylinder100", 0.1, "disc of 240 mm"), ("disc300_support180", 0.5, ""),
    ("disc240_support180", 0.1, ""), ("disc300_support180", np.nan, "")])
def test_a_specimen_that_says_little_is_named_with_a_better_one(name, coefficient, advice):
    lines = texts(advice_of(Rig.from_name(name), coefficient))
    assert (advice in lines[0]) if advice else not lines


def test_the_advice_of_a_fabric_is_that_of_specimens_that_all_say_little():
    flat, largest, enough = (advice_of(Rig.from_name(name), coefficient) for name, coefficient in (
        ("disc300_support180", 0.9), ("disc360_support180", 0.9), ("disc300_support180", 0.6)))
    assert joint_advice([flat, flat]) == flat and joint_advice([]) == []
    assert joint_advice([flat, enough]) == joint_advice([flat, None]) == []
    assert joint_advice([flat, largest]) == largest


def test_densities_by_matrix_products_are_those_of_each_cloth(expected):
    shape, samples, facts, face = drawn(30, 3)
    known = torch.tensor([True, True, False, True, False])
    parts = [part.detach() for part in expected(
        samples[:, 0], facts[:1].expand(400, 2), face[:1].expand(400))]
    shape[:, ~known] = torch.nan
    each = _log_density(shape[:, None], *parts).logsumexp(dim=1)
    found = log_density_of_all(shape.numpy(), known.numpy(), *(part.numpy() for part in parts))
    np.testing.assert_allclose(found, each.numpy(), rtol=0, atol=2e-3)
