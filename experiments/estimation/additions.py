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
from data.dataset.generate import generate_dataset
from data.fabrics.properties import ClothProperties
from data.readings import QUANTITIES
from data.readings.known import ByDirection, Known
from data.strips.posterior import StripEvidence
from drapenet.config import EvaluateConfig
from drapenet.estimator.combine import combine
from drapenet.evidence.source import of_strips, of_values
from drapenet.evidence.state import fabric_prior, prior_along
from drapenet.network.captures import CaptureSet, Condition
from drapenet.network.checkpoint import Header, read_header
from drapenet.network.dataset import Maps, make_maps
from drapenet.network.evaluate import DEPTH, make_config, require_unseen
from drapenet.network.load import network_of
from drapenet.network.posterior import inside, ranks
from drapenet.network.predict import Draws, sample_targets
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
        for name, estimate in estimates.items():
            gap = (estimate.samples.mean(axis=0) - truth.theta) / header.spread
            errors.setdefault(name, []).append(gap)
            places.setdefault(name, []).append(ranks(estimate.samples[:, None], truth.theta[None]))
    bounds = read_report("bounds")["cells"][config["testers"][0]]
    rows = {name: _summary(np.array(gaps), np.concatenate(places[name]))
            | {"bound": bounds.get(_BOUNDS.get(name, ""))} for name, gaps in errors.items()}
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
