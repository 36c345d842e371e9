"""What each measurement of a fabric adds to one drape.

Unseen fabrics are draped on two testers as for the evaluation. The estimate from one drape's depth
views is compared with those from it and the other face, four drapes, a drape on the second tester,
a strip along warp and weft each, photographed with either face up, and KES B of both.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from common.command import compose_config
from common.errors import InputError
from common.normal import Linear, Normal
from data.dataset.generate import generate_dataset
from data.fabrics.fabrics import ClothProperties
from data.readings import QUANTITIES
from data.readings.known import ByDirection, Known
from drapenet.config import EvaluateConfig
from drapenet.evidence.source import of_strips, of_values
from drapenet.evidence.state import fabric_prior, prior_along, state_of
from drapenet.fabric.combine import combine
from drapenet.fabric.next_measurements import drapes_evidence, reductions, strips_evidence
from drapenet.measured.strips.posterior import StripEvidence
from drapenet.network.captures import CaptureSet, Condition
from drapenet.network.checkpoint import Header, read_header
from drapenet.network.dataset import Maps, make_maps
from drapenet.network.evaluate import DEPTH, make_config, require_unseen
from drapenet.network.posterior import inside, ranks
from drapenet.network.predict import Draws, network_of, sample_targets
from drapenet.network.targets import cloth_of
from drapenet.result.estimate import Estimate, make_estimate
from experiments.estimation.strip_photographs import (
    LEAST_LENGTH,
    LENGTHS,
    draw_scene,
    entry_of,
    read_pictures,
)
from experiments.result import Config, Result, read_report, rms
from sim.material import DIRECTIONS, FIRST, LINEAR, RATIO, REFERENCE_DENSITY, SECOND, gravity_length

DRAPES = 4  # of each fabric, at most in a set
ONE = "one drape"
STRIPS = "one drape, a strip along warp and weft"
YARNS = [FIRST, SECOND]
_RESAMPLES = 400  # of the bootstrap over fabrics
_BOUNDS = {ONE: "depth, 4 views", "two drapes": "depth, sets of 2",
           "four drapes": "depth, sets of 4"}


def run(config: Config) -> Result:
    """Estimate all fabrics from all combinations."""
    header = read_header(config["checkpoint"])
    first, second = (_maps(header, tester, config) for tester in config["testers"])
    # A set has each drape once, by its number, which both testers' drapes begin at 0.
    second = replace(second, index=second.index + 1 + first.index.max())
    errors: dict[str, list[np.ndarray]] = {}
    places: dict[str, list[np.ndarray]] = {}
    widths: dict[str, list[np.ndarray]] = {}
    predicted: dict[str, list[np.ndarray]] = {}
    kept: dict[str, list[int]] = {}  # numbers of the fabrics
    for fabric in np.intersect1d(first.fabric, second.fabric):
        drapes, others = (np.flatnonzero(maps.fabric == fabric) for maps in (first, second))
        if len(drapes) < DRAPES or not len(others):
            continue  # a drape did not converge
        one = first.chosen(drapes[:1])
        turned = drapes[first.face[drapes] != first.face[drapes[0]]]
        sets = {ONE: one, "two drapes": first.chosen(drapes[:2]),
                "four drapes": first.chosen(drapes),
                "one drape of each face": first.chosen(np.r_[drapes[:1], turned[:1]]),
                "one drape on two testers": Maps.joined([one, second.chosen(others[:1])])}
        estimates = {name: _estimate(header, maps) for name, maps in sets.items()}
        alone, rng = estimates[ONE], np.random.default_rng([config["seed"], fabric])
        truth = ClothProperties(one.theta[0], first.curl[drapes].mean(axis=0), one.membrane[0],
                                one.hysteresis[0])
        added = {"one drape, KES B of warp and weft": of_values(_sheet(truth, rng),
                                                                REFERENCE_DENSITY)}
        if strips := _strips(truth, header, rng):
            added[STRIPS] = [of_strips(direction, found.measured, found.alpha, REFERENCE_DENSITY)
                             for direction, found in strips.items()]
        draws = Draws(alone.cloth, True, 0.0)
        estimates |= {name: combine(draws, sources, REFERENCE_DENSITY, header, name="the drape")
                      for name, sources in added.items()}
        for name, shares in _predicted(header, one, alone).items():
            predicted.setdefault(name, []).append(shares)
        for name, estimate in estimates.items():
            widths.setdefault(name, []).append(_widths(estimate))
            kept.setdefault(name, []).append(len(predicted[STRIPS]) - 1)
            gap = (estimate.samples.mean(axis=0) - truth.theta) / header.spread
            errors.setdefault(name, []).append(gap)
            places.setdefault(name, []).append(ranks(estimate.samples[:, None], truth.theta[None]))
    bounds = read_report("bounds")["cells"][config["testers"][0]]
    rows = {name: _summary(np.array(gaps), np.concatenate(places[name]))
            | {"bound": bounds.get(_BOUNDS.get(name, ""))} for name, gaps in errors.items()}
    for name, shares in predicted.items():
        same = kept.get(name, [])
        if same:
            rows[name]["narrower"] = _narrower(
                np.array(shares)[same], np.array([widths[ONE][k] for k in same]),
                np.array(widths[name]), np.array([errors[ONE][k] for k in same]),
                np.array(errors[name]))
    for name, row in rows.items():
        print(f"{name}: log alpha {row['log_alpha']:.3f}, of warp and weft "
              f"{row['log_alpha_yarns']:.3f}; beta/alpha {row['beta_over_alpha']:.2f}, "
              f"{row['beta_over_alpha_yarns']:.2f}; inside {row['inside']}, n {row['fabrics']}")
    return Result({"rows": rows})


def _maps(header: Header, tester: str, config: Config) -> Maps:
    """One capture of each drape of new fabrics on a tester."""
    options = compose_config("evaluate", [
        f"testers=[{tester}]", f"fabrics_per_tester={config['fabrics']}",
        f"drapes_per_fabric={DRAPES}", f"seed={config['seed']}"], schema=EvaluateConfig)
    base, folder = make_config(header, tester, options), Path(config["work"]) / tester
    require_unseen(header, base.as_dict())
    manifest = generate_dataset(base, folder, workers=config["workers"])
    return make_maps(folder, manifest, folder, setups=header.setups, captures=1,
                     seed=config["seed"], workers=config["workers"],
                     pictures=header.model.backbone is not None)


def _estimate(header: Header, maps: Maps) -> Estimate:
    """The network's estimate from one depth capture of each drape of one fabric."""
    captures = CaptureSet(maps, scale=header.scale)
    sizes = tuple(float(k + 1 == len(maps)) for k in range(DRAPES))
    batch, facts = captures.batch(np.array([0]), Condition(DEPTH, sizes, known=1.0),
                                  np.random.default_rng(0), symmetric=False)
    samples = sample_targets(network_of(header), header, batch, facts.known)[:, 0]
    cloth = cloth_of(samples, np.full(len(samples), facts.sizes[0]))
    # The batch marks a face at random.
    cloth = replace(cloth, curl=cloth.curl * facts.face[0] * maps.face[0])
    draws = Draws.possible(cloth, known=True)
    return make_estimate(draws, density=REFERENCE_DENSITY, header=header)


def _predicted(header: Header, one: Maps, alone: Estimate) -> dict[str, np.ndarray]:
    """Shares (2, 3) by which further measurements are expected to narrow log alpha and beta."""
    def further(*faces: int) -> Linear:
        """Of drapes like the one at hand, with faces as it has them, or the other."""
        parts = [one, *(replace(one, index=one.index + 10**6 * (k + 1), face=one.face * face)
                        for k, face in enumerate(faces))]
        joint = _estimate(header, Maps.joined(parts))
        return drapes_evidence(cloth, Normal.of(state_of(joint.cloth)))

    cloth = Normal.of(state_of(alone.cloth))
    expected = {"two drapes": further(1), "four drapes": further(1, 1, 1),
                "one drape of each face": further(-1),
                STRIPS: strips_evidence(cloth.mean, REFERENCE_DENSITY)}
    return {name: np.stack(reductions(cloth, found)) for name, found in expected.items()}


def _widths(estimate: Estimate) -> np.ndarray:
    """(2, 3) standard deviations of log alpha and of beta."""
    alpha, beta = estimate.moduli()
    return np.stack([np.log(alpha).std(axis=0), beta.std(axis=0)])


def _narrower(
    predicted: np.ndarray, before: np.ndarray, after: np.ndarray, errors: np.ndarray,
    later: np.ndarray,
) -> dict[str, dict[str, float]]:
    """By what share the intervals of F fabrics, of widths (F, 2, 3), and the root mean square of
    the errors (F, 6) became smaller, beside the ``predicted`` share (F, 2, 3); of the measured ones
    with the standard error over the fabrics."""
    rng, found = np.random.default_rng(0), {}
    draws = rng.integers(len(predicted), size=(_RESAMPLES, len(predicted)))
    for k, (key, part) in enumerate((("log_alpha", LINEAR), ("beta", RATIO))):
        shares = 1 - after[:, k] / before[:, k]
        squares = [np.square(each[:, part]).mean(axis=1) for each in (errors, later)]
        gains = 1 - np.sqrt(squares[1][draws].sum(axis=1) / squares[0][draws].sum(axis=1))
        found[key] = {
            "predicted": float(predicted[:, k].mean()), "intervals": float(shares.mean()),
            "intervals_error": float(shares.mean(axis=1).std() / np.sqrt(len(shares))),
            "errors": float(1 - np.sqrt(squares[1].sum() / squares[0].sum())),
            "errors_error": float(gains.std())}
    return found


def _sheet(truth: ClothProperties, rng: np.random.Generator) -> Known:
    """KES B as measured, with the error that is assumed of it."""
    exact = ClothProperties(*(np.asarray(part)[None] for part in vars(truth).values()))
    quantity = QUANTITIES["kes_b_gf_cm2_per_cm"]
    values = (quantity.of(exact, REFERENCE_DENSITY)[0]
              * np.exp(quantity.error * rng.standard_normal(3)))
    return Known(**{quantity.name: ByDirection(**{
        DIRECTIONS[k]: float(values[k]) for k in YARNS if np.isfinite(values[k])})})


def _strips(
    truth: ClothProperties, header: Header, rng: np.random.Generator
) -> dict[str, StripEvidence] | None:
    """Evidence of photographed strips along warp and weft; None if one is refused."""
    pictures, entries = {}, []
    for k in YARNS:
        alpha, ratio = float(np.exp(truth.theta[k])), float(truth.theta[3 + k])
        for face, share in zip(("up", "down"), LENGTHS, strict=True):
            length = max(share * gravity_length(alpha, REFERENCE_DENSITY), LEAST_LENGTH)
            curl = float(truth.curl[YARNS.index(k)]) * (1 if face == "up" else -1)
            scene = draw_scene(alpha, ratio, length, rng, curl=curl)
            name = f"{DIRECTIONS[k]}_{face}.png"
            pictures[name] = scene.photograph(rng)
            entries.append(entry_of(scene, name, length, "mm_per_px", rng)
                           | {"direction": DIRECTIONS[k], "face": face})
    try:
        return read_pictures(pictures, entries).evidence(
            prior_along(fabric_prior(header), REFERENCE_DENSITY))
    except InputError:
        return None


def _summary(errors: np.ndarray, places: np.ndarray) -> dict:
    """Errors over the spread, of all directions and of warp and weft, and coverage."""
    return {"log_alpha": rms(errors[:, LINEAR]), "log_alpha_yarns": rms(errors[:, YARNS]),
            "beta_over_alpha": rms(errors[:, RATIO]),
            "beta_over_alpha_yarns": rms(errors[:, [3 + k for k in YARNS]]),
            "inside": inside(places), "fabrics": len(errors)}
