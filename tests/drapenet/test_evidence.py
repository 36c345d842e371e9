"""Sources of evidence: what they move, what contradicts, that nothing narrows by error, and what
further ones are expected to add."""

import numpy as np
import pytest

from common.errors import InputError
from common.findings import texts
from common.normal import Linear, Normal
from data.readings import QUANTITIES
from data.readings.cantilever import bending_length
from data.readings.known import ByDirection, Known
from data.readings.quantity import SPECIMEN_SCATTER
from drapenet.config import EstimateOptions
from drapenet.evidence.combine import consistent, posterior, updated
from drapenet.evidence.source import of_capture, of_refined, of_strips, of_values
from drapenet.evidence.state import cloth_of_state, fabric_prior, prior_along, state_of
from drapenet.fabric.combine import combine
from drapenet.fabric.estimate import estimate_fabric
from drapenet.fabric.infer import prior_draws
from drapenet.fabric.next_measurements import another_disc, drapes_evidence, reductions
from drapenet.fabric.sources import sources_of
from drapenet.measured.strips.photograph import expected_strip
from drapenet.measured.strips.posterior import direction_evidence, expected_evidence
from drapenet.network.checkpoint import read_header
from drapenet.views.observation import Observation
from sim.cantilever import heavy_elastica
from sim.material import DIRECTIONS, MICRO
from sim.rig import GRAVITY, Rig

DENSITY = 0.3
SPREAD = 0.3  # standard deviation of log alpha and of log membrane
MEMBRANE, NAME = 8, "the captures"


@pytest.fixture(scope="module")
def header():
    return read_header()


def states(count: int = 10_000) -> np.ndarray:
    """Normal posterior of captures: alpha 60 µN·m; warp and weft are correlated, and curl with the
    warp."""
    white = np.random.default_rng(0).standard_normal((count, 10))
    log_alpha = np.log(60 * MICRO) + SPREAD * np.column_stack([
        white[:, 0], 0.6 * white[:, 0] + 0.8 * white[:, 1], 0.8 * white[:, 0] + 0.6 * white[:, 2]])
    return np.column_stack([
        log_alpha, 1e-4 * white[:, 3:6], 3 * (0.5 * white[:, 0] + white[:, 6]), 3 * white[:, 7],
        np.log(600) + SPREAD * white[:, 8], 0.2 + 0.02 * white[:, 9]])


def strips(direction: str, alpha: float, deviation: float):
    """Strips that determine alpha, N·m, alone."""
    return of_strips(direction, Linear(np.array([[1.0, 0, 0]]) / deviation,
                                       np.array([np.log(alpha) / deviation])), alpha, DENSITY)


def test_a_strip_moves_what_is_correlated_with_its_direction():
    before, gap = states(), np.log(80 / 60)
    after = updated(before, [strips("warp", 80 * MICRO, SPREAD)])
    moved = after.mean(axis=0) - before.mean(axis=0)
    # Both have the same deviation: halfway, and narrower by the root of 2.
    assert moved[:3] == pytest.approx([gap / 2, 0.6 * gap / 2, 0.8 * gap / 2], abs=0.004)
    assert after[:, 0].std() == pytest.approx(SPREAD / np.sqrt(2), rel=0.02)
    assert moved[6] == pytest.approx(1.5 * gap / 2 / SPREAD, abs=0.05)


def test_a_value_of_a_tester_is_a_normal_logarithm():
    known = Known(membrane_n_per_m=900.0, error_percent={"membrane_n_per_m": 100 * SPREAD})
    after = updated(states(), of_values(known, DENSITY))
    assert after[:, MEMBRANE].mean() == pytest.approx(np.log(np.sqrt(600 * 900)), abs=0.01)
    assert after[:, MEMBRANE].std() == pytest.approx(SPREAD / np.sqrt(2), rel=0.03)
    assert after[:, :3].mean(axis=0) == pytest.approx(states()[:, :3].mean(axis=0), abs=0.01)


@pytest.mark.parametrize(("name", "error"), [("bending_length_mm", 0.15),
                                             ("flexural_rigidity_uN_m", 0.15),
                                             ("kes_b_gf_cm2_per_cm", 0.10)])
def test_values_equal_importance_weights(name, error):
    """Of a linear law a bending length goes with the cube root of alpha (Peirce): its error of 5 %
    is one of 15 % of alpha."""
    before, true = states(), np.log(70 * MICRO)
    exact = before[:1].copy()
    exact[0, :6] = [true] * 3 + [0.0] * 3
    value = float(QUANTITIES[name].of(cloth_of_state(exact), DENSITY)[0, 2])
    known = Known(**{name: ByDirection(weft=value)})
    after = updated(before, of_values(known, DENSITY))
    gap = of_values(known, DENSITY)[0].residuals(before)[:, 0]
    weights = np.exp(-0.5 * np.nan_to_num(gap, nan=np.inf) ** 2)
    mean = weights @ before[:, 2] / weights.sum()
    assert after[:, 2].mean() == pytest.approx(mean, abs=0.01)
    share = SPREAD**2 / (SPREAD**2 + error**2)
    assert after[:, 2].mean() == pytest.approx(
        np.log(60 * MICRO) + share * (true - np.log(60 * MICRO)), abs=0.02)


@pytest.mark.parametrize("share", [0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.2, 1.5])
def test_a_kes_reading_of_softening_cloth_counts_or_is_named(share):
    """At 1.5 cm⁻¹ half of these cloths are beyond their law."""
    before = states()
    before[:, 3:6] = -3.2e-3 + 8 * before[:, 3:6]

    def reading(states: np.ndarray) -> float:
        return float(np.median(QUANTITIES["kes_b_gf_cm2_per_cm"].of(
            cloth_of_state(states), DENSITY)[:, 0]))

    value = share * reading(before)
    known = Known(kes_b_gf_cm2_per_cm=ByDirection(warp=value))
    found = posterior(before, of_values(known, DENSITY), NAME)
    if not found.contradictions:
        assert abs(np.log(reading(found.states) / value)) < 0.6 * abs(np.log(share))


def lengths(warp: float, weft: float) -> Known:
    """Bending lengths of linear cloth with these alphas, µN·m."""
    warp, weft = (1e3 * float(bending_length(np.array(a * MICRO), np.array(0.0), DENSITY))
                  for a in (warp, weft))
    return Known(bending_length_mm=ByDirection(warp=warp, weft=weft))


WRONG = {
    "KES B in another unit": Known(kes_b_gf_cm2_per_cm=ByDirection(warp=6.0, weft=6.0)),
    "KES B ten times": Known(kes_b_gf_cm2_per_cm=ByDirection(bias=6.2)),
    "KES B a tenth": Known(kes_b_gf_cm2_per_cm=ByDirection(weft=0.06)),
    "2HB in another unit": Known(kes_2hb_gf_cm_per_cm=ByDirection(warp=18.0)),
    "a fifth of the bending length": Known(bending_length_mm=ByDirection(warp=5.4)),
    "overhang as bending length": Known(bending_length_mm=ByDirection(warp=55.0)),
    "of another fabric, softer": lengths(12, 12),
    "of another fabric, stiffer": lengths(300, 300),
    "rigidity in mg cm": Known(flexural_rigidity_uN_m=ByDirection(warp=600.0)),
    "rigidity a third": Known(flexural_rigidity_uN_m=ByDirection(weft=15.0)),
    "membrane of the yarn": Known(membrane_n_per_m=9000.0),
    "membrane a fiftieth": Known(membrane_n_per_m=12.0),
    "hysteresis in per cent": Known(hysteresis_share=0.9),
    "supplier's B in another unit": Known(bending_stiffness_uN_m=19000.0),
    "supplier's B of another cloth": Known(bending_stiffness_uN_m=8.0),
    "two right, one wrong": Known(membrane_n_per_m=610.0, hysteresis_share=0.2,
                                  kes_b_gf_cm2_per_cm=ByDirection(warp=0.06)),
}
STRIPS = {
    "of another fabric": [strips("warp", 200 * MICRO, 0.05)],
    "of warp and weft, exchanged": [strips("warp", 180 * MICRO, 0.05),
                                    strips("weft", 20 * MICRO, 0.05)],
    "bias too soft": [strips("bias", 15 * MICRO, 0.05), strips("warp", 62 * MICRO, 0.05)],
    "density in other units": [strips(name, 2 * MICRO, 0.05) for name in DIRECTIONS],
}


@pytest.mark.parametrize("sources", [*(of_values(known, DENSITY) for known in WRONG.values()),
                                     *STRIPS.values()], ids=[*WRONG, *STRIPS])
def test_what_contradicts_the_captures_is_named_and_left_out(sources):
    before = states()
    found = posterior(before, sources, NAME)
    assert found.contradictions and all(NAME in line and "left out" in line and "\n" not in line
                                        for line in texts(found.contradictions))
    left_out = {contradiction.source for contradiction in found.contradictions}
    kept = [source for source in sources if source.key not in left_out]
    assert (found.states == updated(before, kept)).all()
    assert len(found.states) > 0.9 * len(before)
    if not kept:
        assert (found.states == before).all(), "nothing is narrower"


def test_right_values_are_used_and_repeats_rarely_contradict():
    rng = np.random.default_rng(1)
    alarms = 0
    before = states(1000)
    for _ in range(100):
        true = before[rng.integers(len(before))]
        exact = cloth_of_state(true[None])
        known = Known(**{name: (ByDirection(**dict(zip(DIRECTIONS, values.tolist(), strict=True)))
                                if len(values) > 1 else float(values[0]))
                         for name, quantity in QUANTITIES.items()
                         if name in ("bending_length_mm", "membrane_n_per_m", "hysteresis_share")
                         for values in [quantity.of(exact, DENSITY)[0] * np.exp(
                             quantity.error * rng.standard_normal(quantity.directions))]})
        alarms += bool(posterior(before, of_values(known, DENSITY), NAME).contradictions)
    assert alarms <= 6  # 1 to 2 expected of 100


def test_values_that_contradict_each_other_and_not_the_captures():
    wide = np.array(states(4000))
    wide[:, :3] += 3 * (wide[:, :3] - wide[:, :3].mean(axis=0))
    known = Known(bending_length_mm=lengths(60, 60).bending_length_mm,
                  flexural_rigidity_uN_m=ByDirection(warp=62.0, weft=220.0))
    contradiction, = posterior(wide, of_values(known, DENSITY), NAME).contradictions
    assert contradiction.source == "known.flexural_rigidity_uN_m.2"
    assert contradiction.values["value"] == 220 > contradiction.values["expected"]


def readings(alpha: float, *names: str, **factors: float) -> Known:
    """What tests, some in other units, state of usual cloth with alpha, µN·m, along its warp."""
    exact = states()[:1].copy()
    exact[0, :6] = [*np.log(np.array([1, 0.8, 0.6]) * alpha * MICRO), *[-2.2e-3] * 3]
    values = {name: factors.get(name, 1) * QUANTITIES[name].of(cloth_of_state(exact), DENSITY)[0]
              for name in names}
    return Known(**{name: ByDirection(warp=each[0], weft=each[2]) for name, each in values.items()})


LENGTH, RIGIDITY, KES_B = "bending_length_mm", "flexural_rigidity_uN_m", "kes_b_gf_cm2_per_cm"


def test_a_test_in_a_wrong_unit_is_left_out_as_a_whole(header):
    """Value by value, the warp's of one test and the weft's of another would be left."""
    prior = state_of(fabric_prior(header))
    for wrong in (LENGTH, RIGIDITY, KES_B):
        known = readings(60, LENGTH, RIGIDITY, KES_B, **{wrong: 2 if wrong == LENGTH else 0.1})
        found = posterior(prior, of_values(known, DENSITY))
        assert {one.source for one in found.contradictions} == {
            f"known.{wrong}.0", f"known.{wrong}.2"}
        slip = "twice: the overhang" if wrong == LENGTH else "0.1 times that: another unit"
        assert all(slip in line for line in texts(found.contradictions))
        warp, weft = np.exp(found.states[:, [0, 2]].mean(axis=0)) / MICRO
        assert warp > 1.3 * weft


def test_of_two_tests_alone_none_is_trusted_more(header):
    prior = state_of(fabric_prior(header))
    for wrong, said in (({RIGIDITY: 0.1}, "another unit"),
                        ({LENGTH: 2.0}, "bending length.*overhang_mm")):
        known = readings(60, LENGTH, RIGIDITY, **wrong)
        with pytest.raises(InputError, match=f"contradict each other, .*{said}"):
            posterior(prior, of_values(known, DENSITY))
        found = posterior(states(), of_values(known, DENSITY), NAME)
        assert {one.source.split(".")[1] for one in found.contradictions} == set(wrong)


def test_a_wrong_value_beside_strips_is_named_though_it_is_far_from_linear(header, tmp_path):
    """A cloth between all of them would have none: it curls, and KES B and 2HB are others, too.
    Fabrics as anisotropic as published ones can be: each value by itself fits the others."""
    stated = header.prior
    woven = stated.nuisances["cloth"]["woven"] | {"membrane": [200.0, 2000.0]}
    wide = stated.model_copy(update={"anisotropy": [1.0, 1.0], "nuisances": {
        **stated.nuisances, "cloth": {"woven": woven}}})
    header = header.model_copy(update={"prior": wide})
    (tmp_path / "strips.yaml").write_text(
        "density_g_m2: 210\nstrips:\n- {direction: warp, bending_length_mm: 28.4}\n"
        "- {direction: weft, bending_length_mm: 20.8, face: down}\n"
        "known: {kes_b_gf_cm2_per_cm: {warp: 0.24, weft: 0.10}, kes_2hb_gf_cm_per_cm: {warp: 0.9}}")
    sources = sources_of([], strips=tmp_path)
    estimate = estimate_fabric(sources, header, EstimateOptions(drapes=0)).estimate
    assert [one.source for one in estimate.contradictions] == ["known.kes_2hb_gf_cm_per_cm.0"]
    length = np.median(estimate.reading("bending_length_mm"), axis=0)
    assert length[[0, 2]] == pytest.approx([28.4, 20.8], rel=0.03)


def test_of_values_exchanged_between_warp_and_weft_both_are_left_out():
    before = states()
    before[:, 0] = np.log(90 * MICRO) + (before[:, 0] - np.log(60 * MICRO)) / 3
    before[:, 2] += np.log(45 / 60)  # known less well, so that a wrong value pulls it
    exchanged = posterior(before, of_values(lengths(45, 90), DENSITY), NAME)
    assert [found.code for found in exchanged.contradictions] == [
        "value_contradicts", "value_exchanged"]
    np.testing.assert_array_equal(exchanged.states, before)
    assert "weft" in exchanged.contradictions[1].text.partition(" is left out, too")[0]
    for warp, weft, wrong in ((90, 45, []), (45, 45, ["value_contradicts"])):
        found = posterior(before, of_values(lengths(warp, weft), DENSITY), NAME)
        assert [one.code for one in found.contradictions] == wrong
        assert found.states[:, 2].std() < 0.8 * before[:, 2].std()  # the weft is used


def test_an_unusual_fabric_is_no_contradiction():
    before = states()
    found = posterior(before, [strips("warp", 600 * MICRO, 0.05)])
    assert not found.contradictions and found.states[:, 0].mean() > np.log(400 * MICRO)


def test_no_number_of_sources_leaves_few_samples():
    before = states(4000)
    known = Known(membrane_n_per_m=700.0, error_percent={"membrane_n_per_m": 0.1})
    after = updated(before, [*of_values(known, DENSITY), strips("warp", 75 * MICRO, 1e-3)])
    assert len(after) == len(before) and len(np.unique(after[:, 2])) == len(before)
    impossible = [strips(name, alpha * MICRO, 1e-3)
                  for name, alpha in zip(DIRECTIONS, (400, 30, 2), strict=True)]
    with pytest.raises(InputError, match="hardly any plate"):
        updated(before, impossible)


def test_refined_captures_count_the_prior_once(header):
    prior = Normal.of(state_of(fabric_prior(header)))
    seen = Linear(np.diag([5.0] * 3 + [300] * 3 + [0.3] * 2 + [2]), np.zeros(9))
    part = prior.only(range(9))
    seen = Linear(seen.rows, seen.rows @ (part.mean + np.array([0.4, 0.3, 0.5, 0, 0, 0, 2, 0,
                                                                0.1])))
    source = of_refined("a", part.updated(seen), prior, DIRECTIONS)
    before = prior.samples(4000)
    expected = part.updated(Linear.stacked([seen] * 2))
    twice = Normal.of(updated(before, [source] * 2))
    deviation = np.sqrt(np.diag(expected.covariance))
    assert np.abs((twice.mean[:9] - expected.mean) / deviation).max() < 0.3
    assert np.diag(twice.covariance)[:9] == pytest.approx(np.diag(expected.covariance), rel=0.3)


def test_the_prior_is_that_of_what_the_network_has_learned_last(header):
    """Earlier trainings, whose fabrics are not unseen, do not count."""
    newest = header.dataset.generation[-1]
    assert header.prior.fabrics == newest["prior"]
    for name in ("even_share", "anisotropy"):
        assert getattr(header.prior, name) == newest["sampling"][name]
    states = state_of(fabric_prior(header))
    bias = states[:, 1] - states[:, [0, 2]].mean(axis=1)  # log alpha against the yarns'
    assert bias.std() == pytest.approx(0.28, abs=0.02)
    low, high = np.exp(np.quantile(states[:, 8], [0.025, 0.975]))
    assert (low, high) == pytest.approx((41, 11700), rel=0.1)  # knits to films


def test_strips_alone_leave_the_other_directions_to_the_prior(header):
    density = 0.21
    prior = prior_along(fabric_prior(header), density)["weft"]
    measured = Linear(np.array([[1 / 0.02, 0, 0]]), np.array([np.log(40 * MICRO) / 0.02]))
    found = combine(prior_draws(header), [of_strips("weft", measured, 40 * MICRO, density)],
                    density, header, name="")
    assert np.median(found.moduli()[0][:, 2]) == pytest.approx(40 * MICRO, rel=0.01)
    assert prior.mean[0] != pytest.approx(np.log(40 * MICRO), abs=0.1)
    share = found.constraint
    assert share["alpha weft"] < 0.05 < 0.2 < share["alpha warp"] < 1


ERROR = 0.15
PRIOR = Normal(np.zeros(10), np.diag([0.9] * 3 + [1.0] * 7) ** 2)


class Captures:
    """Normal posteriors of captures of one fabric, each with an observed value of log alpha."""

    def __init__(self, seen: np.ndarray) -> None:
        self.seen = seen
        self.draws = np.random.default_rng(0).normal(size=(400, 10))

    def of(self, numbers: list[int]) -> np.ndarray:
        variance = 1 / (1 / 0.9**2 + len(numbers) / ERROR**2)
        mean = variance * self.seen[numbers].sum(axis=0) / ERROR**2
        samples = self.draws.copy()
        samples[:, :3] = mean + np.sqrt(variance) * self.draws[:, :3]
        return samples

    def lines(self, labels: str) -> list[str]:
        sources = [of_capture(label, self.of([k]), PRIOR, DIRECTIONS)
                   for k, label in enumerate(labels)]
        return texts(consistent(sources, lambda left: Normal.of(self.of(
            [labels.index(source.label) for source in left])))[1])


def test_captures_of_another_fabric_are_named_and_no_other():
    same, other = np.zeros(3), np.full(3, 1.2)
    line, = Captures(np.array([same, same, other])).lines("ABC")
    assert line.startswith("C contradicts the other 2 captures: alpha ")
    line, = Captures(np.array([same, other])).lines("AB")
    assert "contradicts" in line
    assert {text[0] for text in Captures(np.array([same, other, same, other, same])).lines(
        "ABCDE")} == {"B", "D"}


def test_repeats_contradict_each_other_as_rarely_as_is_stated():
    rng, alarms = np.random.default_rng(3), {2: 0, 4: 0}
    for count in alarms:
        for _ in range(200):
            fabric = 0.9 * rng.normal(size=3)
            errors = np.hypot(ERROR, SPECIMEN_SCATTER) * rng.normal(size=(count, 3))
            alarms[count] += bool(Captures(fabric + errors).lines("ABCD"[:count]))
    assert all(share <= 7 for share in alarms.values())  # 2 expected of 200


# --- What a further measurement is expected to add ------------------------------------------


WEIGHT = DENSITY * GRAVITY
DEVIATIONS = np.array([0.2, 0.2, 0.2, 2e-3, 2e-3, 2e-3, 3.0, 3.0, 0.3, 0.1])


def normal_cloth(ratio: float = -2e-3) -> Normal:
    mean = np.array([-10.0, -10.5, -11.0, ratio, ratio, ratio, 0.0, 0.0, 6.0, 0.2])
    return Normal(mean, np.diag(np.square(DEVIATIONS)))


def test_evidence_as_accurate_as_an_estimate_narrows_it_by_the_root_of_two():
    rows = np.zeros((1, 10))
    rows[0, 0] = 1 / DEVIATIONS[0]
    alpha, beta = reductions(normal_cloth(ratio=0.0), Linear(rows, np.zeros(1)))
    np.testing.assert_allclose(alpha, [1 - np.sqrt(0.5), 0, 0], atol=1e-9)
    np.testing.assert_allclose(beta, 0, atol=1e-9)  # alpha and beta/alpha 0 are independent


def test_beta_is_narrower_where_alpha_is_if_it_is_a_share_of_alpha():
    rows = np.zeros((1, 10))
    rows[0, 0] = 1e3  # alpha of the warp is known
    before, after = np.hypot(2e-3, 0.02 * 0.2), 2e-3  # of beta over alpha's mean
    _, beta = reductions(normal_cloth(ratio=-0.02), Linear(rows, np.zeros(1)))
    assert beta[0] == pytest.approx(1 - after / before, rel=1e-3) and beta[1] == 0


def test_evidence_of_drapes_leads_from_one_posterior_to_the_other():
    before = normal_cloth()
    after = Normal(before.mean, before.covariance.copy())
    after.covariance[1, 1] /= 4
    found = before.updated(drapes_evidence(before, after))
    np.testing.assert_allclose(found.covariance, after.covariance, rtol=1e-6, atol=1e-15)


def test_expected_strips_say_what_strips_of_the_same_curves_do():
    state, strips = np.array([np.log(40e-6), -2e-3, 1.0]), []
    for sign, length in ((1, 0.036), (-1, 0.06)):
        strips.append(expected_strip(heavy_elastica(
            40e-6, -2e-3 * 40e-6, weight=WEIGHT, length=length, curl=sign * state[2], points=61),
            length, sign=sign))
    prior = Normal(state, np.diag([0.5, 2e-3, 3.0]) ** 2)
    measured = direction_evidence(strips, weight=WEIGHT, prior=prior)
    expected = prior.updated(expected_evidence(strips, weight=WEIGHT, state=state))
    np.testing.assert_allclose(np.sqrt(np.diag(expected.covariance)),
                               np.sqrt(np.diag(measured.posterior.covariance)), rtol=0.05)
    assert 0.04 < np.sqrt(expected.covariance[0, 0]) < 0.07  # two specimens that differ by 7 %


@pytest.mark.parametrize(("tester", "share", "disc"), [
    ("disc300_support180", 0.9, "disc360_support180"),
    ("disc300_support180", 0.2, "disc240_support180"), ("disc360_support180", 0.9, None)])
def test_a_flat_drape_asks_for_a_larger_disc(tester, share, disc):
    found = another_disc([Observation(Rig.from_name(tester), 1, True, coefficient=share)])
    assert (found and found.name) == disc
    assert another_disc([]).name == "disc300_support180"
