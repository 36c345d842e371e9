"""Posteriors of the network: mixtures, expected captures, samples of a fabric; its optimiser."""

from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal

import drapenet.network.optimizer
from common.errors import InputError
from common.findings import texts
from data.fabrics.fabrics import from_theta
from drapenet.network.checkpoint import Header, read_header
from drapenet.network.expected import (
    LEVEL,
    SHAPE,
    Likeness,
    likeness,
    log_density_of_all,
    shape_of,
)
from drapenet.network.inputs import Batch, Facts
from drapenet.network.mixture import Mixture, factor_of, outputs_of
from drapenet.network.model import Expected, make_network
from drapenet.network.optimizer import Optimizer, _Muon
from drapenet.network.posterior import LEVELS, covered, ranks
from drapenet.network.predict import DRAWS, network_of, predict
from drapenet.network.targets import CURL, TARGETS
from drapenet.network.trained import Trained
from drapenet.result.advice import advice_of, joint_advice
from drapenet.result.files import read_observation, write_observation
from drapenet.views.directions import AZIMUTH, AZIMUTHS, ELEVATIONS
from drapenet.views.observation import Observation
from drapenet.views.outline import DrapeOutline, outline_of_map
from drapenet.views.pictures import DepthPictures
from drapenet.views.radial_map import RadialMap
from sim.material import is_admissible
from sim.rig import DISC_RIG, LARGE_DISC_RIG, SQUARE_RIG, Rig

UNIT = np.array([0.25, 1.0, 1.0, 3.0, 3.0])
AROUND = 2 * np.pi * (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS
RADIUS = 0.12 + 0.006 * np.cos(2 * AROUND) + 0.004 * np.sin(5 * AROUND)


@pytest.fixture
def mixture() -> Mixture:
    generator = torch.Generator().manual_seed(3)
    outputs = torch.randn(2, outputs_of(components=3, targets=4), generator=generator)
    return Mixture.of_outputs(outputs.double(), components=3, targets=4)


def test_the_likelihood_is_that_of_the_gaussians(mixture):
    at = torch.full((2, 4), 0.3, dtype=torch.float64)
    found = mixture.log_likelihood(at)
    for n in range(2):
        shares = mixture.logits[n].softmax(dim=0).numpy()
        densities = []
        for mean, factor in zip(mixture.means[n], mixture.factors[n], strict=True):
            covariance = np.linalg.inv((factor @ factor.T).numpy())
            densities.append(multivariate_normal(mean.numpy(), covariance).pdf(at[n].numpy()))
        assert found[n].item() == pytest.approx(np.log(shares @ densities), abs=1e-9)


def test_samples_have_the_density_s_moments_and_their_intervals_hold(mixture):
    draws = mixture.posterior.sample(40_000, np.random.default_rng(0))
    for n in range(2):
        shares = mixture.logits[n].softmax(dim=0).numpy()
        means = mixture.means[n].numpy()
        mean = shares @ means
        inverse = [np.linalg.inv((f @ f.T).numpy()) for f in mixture.factors[n]]
        covariance = sum(share * (c + np.outer(m - mean, m - mean))
                         for share, c, m in zip(shares, inverse, means, strict=True))
        deviation = np.sqrt(np.diag(covariance))
        assert draws[:, n].mean(axis=0) == pytest.approx(mean, abs=0.03 * deviation.max())
        assert np.cov(draws[:, n].T) / np.outer(deviation, deviation) == pytest.approx(
            covariance / np.outer(deviation, deviation), abs=0.05)
    truth = mixture.posterior.sample(500, np.random.default_rng(1))[:, 0]
    places = ranks(draws[:4000, :1], truth)
    assert covered(places).mean(axis=(1, 2)) == pytest.approx(LEVELS, abs=0.04)
    assert covered(0.5 + (places - 0.5) / 2)[1].mean() > 0.95  # intervals twice too wide


def test_the_factor_of_residuals_is_that_of_their_precision():
    rng = np.random.default_rng(0)
    mixing = np.array([[1.0, 0.0], [0.6, 0.3]])
    residuals = torch.from_numpy(rng.standard_normal((4000, 2)) @ mixing.T).float()
    covariance = torch.linalg.inv(factor_of(residuals) @ factor_of(residuals).T)
    assert covariance.numpy() == pytest.approx(mixing @ mixing.T, rel=0.05)
    few = factor_of(residuals[:1])  # one residual has variances, but no correlation
    variances = torch.linalg.inv(few @ few.T).diagonal()
    assert variances.numpy() == pytest.approx(residuals[0].square().numpy(), rel=1e-4)


def test_a_regressions_likelihood_in_training_is_its_square_error():
    means = torch.tensor([[0.5, -1.0]])
    targets = torch.tensor([[0.0, 1.0]])
    found = Mixture.around(means, torch.eye(2)).log_likelihood(targets)
    assert found.item() == pytest.approx(-(0.25 + 4) / 2 - np.log(2 * np.pi))
    both = Mixture.joined([Mixture.around(means, torch.eye(2))] * 2)
    assert both.mean.tolist() == [[0.5, -1.0]] * 2


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
                  coefficient=0.4 * two, nodes=nothing, rim=nothing, membrane=nothing,
                  kind=-two, group=np.arange(2))
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
        targets = torch.randn(256, TARGETS)
        facts = torch.randn(256, 2)
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
    given = samples[:, 0], facts[:1].expand(400, 2), face[:1].expand(400)
    shape[:, ~known] = torch.nan
    each = expected.log_density(shape[:, None], *given).logsumexp(dim=1).detach()
    found = log_density_of_all(shape.numpy(), known.numpy(),
                               *(part.detach().numpy() for part in expected(*given)))
    np.testing.assert_allclose(found, each.numpy(), rtol=0, atol=2e-3)


def depth(known: bool = True) -> Observation:
    distance = 0.66 * RADIUS[:, None] * np.linspace(0.9, 1.1, ELEVATIONS)
    drape = RadialMap(distance, np.ones_like(distance), 0.3, 4)
    return Observation(SQUARE_RIG, 1, known, drape, outline_of_map(drape, SQUARE_RIG))


def outline(known: bool = True, face: int = 1) -> Observation:
    return Observation(DISC_RIG, face, known, outline=DrapeOutline(RADIUS, 1.0))


@pytest.fixture(scope="module")
def network(untrained_checkpoint: Path) -> tuple[Trained, Header]:
    header = read_header(untrained_checkpoint)
    return network_of(header), header


def theta(network: tuple[Trained, Header], *captures: Observation) -> np.ndarray:
    return predict(*network, [captures])[0].cloth.theta


def turned(capture: Observation, cells: int) -> Observation:
    rolled = replace(capture.outline, radius=np.roll(capture.outline.radius, cells))
    drape = capture.map and replace(capture.map, distance=np.roll(capture.map.distance, cells, 0))
    return replace(capture, map=drape, outline=rolled)


@pytest.mark.parametrize("capture", [depth(), outline()])
def test_samples_are_possible_fabrics(network, capture: Observation) -> None:
    draws, = predict(*network, [[capture]])
    assert is_admissible(*from_theta(draws.cloth.theta)).all()
    assert len(draws.cloth.theta) == len(draws.cloth.curl) == round(
        DRAWS * (1 - draws.impossible))


@pytest.mark.parametrize(("capture", "cells"), [
    (depth(), AZIMUTHS // 2), (outline(), AZIMUTHS // 2),
    (depth(known=False), AZIMUTHS // 4), (outline(known=False), 3 * AZIMUTHS // 4)])
def test_symmetries_do_not_change_the_answer(
    network, capture: Observation, cells: int
) -> None:
    first = theta(network, capture)
    second = theta(network, turned(capture, cells))
    # Other samples of the same answers.
    assert (second.mean(axis=0) - first.mean(axis=0)) / first.std(axis=0) == pytest.approx(
        np.zeros(6), abs=0.1)


def test_the_order_of_captures_does_not_matter(network) -> None:
    captures = depth(), outline(), Observation(LARGE_DISC_RIG, -1, True, coefficient=0.5, nodes=6)
    np.testing.assert_allclose(theta(network, *captures[::-1]), theta(network, *captures),
                               rtol=1e-3, atol=1e-8)
    assert np.abs(theta(network, *captures).mean(axis=0)
                  - theta(network, captures[0]).mean(axis=0)).max() > 1e-6


def test_sets_of_one_call_do_not_mix(network) -> None:
    together = predict(*network, [[depth(), outline()], [outline()]])
    np.testing.assert_allclose(together[1].cloth.theta.mean(axis=0),
                               theta(network, outline()).mean(axis=0), rtol=0.05)


def test_an_unknown_warp_of_one_capture_is_unknown_for_all(network) -> None:
    draws, = predict(*network, [[depth(), outline(known=False)]])
    assert not draws.known


def test_the_height_of_the_camera_matters(network) -> None:
    near = replace(outline(), outline=DrapeOutline(RADIUS, 0.5))
    unknown = replace(outline(), outline=DrapeOutline(RADIUS, np.nan))
    answers = [theta(network, capture).mean(axis=0) for capture in (outline(), near, unknown)]
    assert all(np.abs(answers[a] - answers[b]).max() > 1e-6 for a, b in ((0, 1), (0, 2), (1, 2)))


def bits(value: object) -> object:
    """Types and bytes of the values in a dataclass or array."""
    if is_dataclass(value):
        return [type(value), *(bits(getattr(value, field.name)) for field in fields(value))]
    array = np.asarray(value)
    return array.dtype, array.shape, array.tobytes()


PICTURES = np.where(np.arange(4 * 128 * 128).reshape(4, 128, 128) % 7, 0.1, np.nan)
OF_OTHER_SIZES = Rig((0.25412345678, 0.17 / 3), 0.01, "rectangle", cut=0.1)


@pytest.mark.parametrize("capture", [
    replace(depth(), pictures=DepthPictures(PICTURES.astype(np.float16), 0.1)),
    replace(outline(face=-1), rig=OF_OTHER_SIZES),
    replace(outline(), outline=DrapeOutline(RADIUS / 3, np.nan, RADIUS / 70)),
    Observation(LARGE_DISC_RIG, -1, False, coefficient=1 / 3, nodes=6)],
    ids=["depth", "outline", "photograph", "numbers"])
def test_what_the_network_has_read_is_kept_beside_the_estimate_to_the_last_bit(tmp_path, capture):
    write_observation(tmp_path, capture)
    assert bits(read_observation(tmp_path)) == bits(capture)
    (tmp_path / "observation.npz").write_bytes((tmp_path / "observation.npz").read_bytes()[:-99])
    with pytest.raises(InputError, match=r"observation\.npz cannot be read"):
        read_observation(tmp_path)


@pytest.mark.parametrize("backbone", [None, "resnet18"])
def test_every_direction_of_a_hidden_weight_moves_as_far(backbone):
    """By 0.2 times the root of the larger side, within the error of five Newton-Schulz steps; the
    other weights, biases and norms by the rate; and without a gradient nothing moves."""
    torch.manual_seed(0)
    network = make_network(backbone=backbone, width=8, components=2, dropout=0.0, distance=0.5,
                           spread=0.1, expected=True)
    optimizer = Optimizer(network, weight_decay=0.0)
    before = {name: part.detach().clone() for name, part in network.named_parameters()}
    for part in network.parameters():
        part.grad = torch.randn_like(part)
    still = network.curl.bias
    still.grad = None
    optimizer.step(1e-3)
    hidden = {id(part) for part in network.hidden_weights()}
    assert len(hidden) > 15
    for name, part in network.named_parameters():
        moved = (before[name] - part.detach()) / 1e-3
        if part is still:
            assert not moved.any()
        elif id(part) in hidden:
            moved = moved.flatten(1) / (0.2 * max(moved.flatten(1).shape) ** 0.5)
            moved = moved if len(moved) < moved.shape[1] else moved.T
            squares = torch.linalg.eigvalsh(moved @ moved.T)  # of the singular values
            assert squares.min() > 0.3**2 and squares.max() < 1.4**2, name
        else:
            assert moved.abs().sub(1).abs().max() < 0.01, name
        assert part.grad is None


@pytest.mark.parametrize("shape", [(12, 40), (40, 12)])
def test_steps_in_single_precision_are_torchs_without_its_rounding(shape, monkeypatch):
    monkeypatch.setattr(drapenet.network.optimizer, "multiplies_bfloat16", lambda device: False)
    torch.manual_seed(0)
    start = torch.randn(shape)
    one, other = (torch.nn.Parameter(start.clone()) for _ in range(2))
    optimizers = [kind([part], lr=0.02, weight_decay=0.1, adjust_lr_fn="match_rms_adamw")
                  for kind, part in ((_Muon, one), (torch.optim.Muon, other))]
    for _ in range(3):
        one.grad = torch.randn(shape)
        other.grad = one.grad.clone()
        for optimizer in optimizers:
            optimizer.step()
    assert 0 < (one - other).norm() < 0.03 * (one - start).norm()
    momenta = (optimizer.state_dict()["state"][0]["momentum_buffer"] for optimizer in optimizers)
    torch.testing.assert_close(*momenta)
