"""Which measurement next: how much narrower the intervals of an estimate would become.

All distributions are taken as normal, and a measurement as evidence that is linear in the state of
the cloth, as where sources are combined (:mod:`drapenet.evidence.combine`): the covariance after it
does not depend on what it will find. Evidence of a further drape is what leads from the network's
posterior of the captures to that of these and an expected one: the same drape again, with either
face up, or a simulated drape of the estimate on another tester.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from common.normal import Linear, Normal
from drapenet.evidence.state import heavier, seen_along, state_of
from drapenet.fabric.infer import prior_draws
from drapenet.network.checkpoint import Header
from drapenet.network.predict import network_of, predict
from drapenet.result.document import NextMeasurement
from drapenet.result.estimate import Estimate
from drapenet.views.observation import Observation
from drapenet.views.outline import DrapeOutline, silhouettes
from sim.material import DIRECTIONS, FIRST, SECOND, gravity_length
from sim.rig import GRAVITY, Rig

MINUTES = {"specimen": 10, "face": 3, "tester": 10, "strips": 20}
"""Of work, assumed: a specimen to be cut, laid down and photographed; a specimen turned over; four
strips to be cut, clamped and photographed."""
STRIP_LENGTHS = (1.5, 2.5)
"""Of the two strips of a direction, the second with the reverse up, in gravity lengths
(:func:`sim.material.gravity_length`)."""
LEAST_STRIP = 0.02  # m
_POINTS = 81  # of a strip's curve
_EDGE = 12e-3
"""m, of the mesh of a simulated drape at the rim; edges of 5 mm change the gains by 1.4 points at
most and take four times as long."""
_WORTH = 1.0  # %, of either interval; what gains less is not named
_LEAST = 0.1  # of the information of a capture; less is noise of samples
_FULL = 0.5  # drape coefficient above which a larger disc says more, and below which a smaller one
_DISCS = tuple(Rig.from_name(f"disc{size}_support180") for size in (240, 300, 360))


def next_measurements(
    estimate: Estimate, seen: Sequence[Observation], header: Header
) -> list[NextMeasurement]:
    """Further measurements of a fabric, those that say most of alpha first.

    Args:
        seen: what the network reads of its captures.
    """
    found = []
    cloth = Normal.of(state_of(estimate.cloth))
    marked = all(part.known for part in seen)
    if seen:
        seen = [replace(part, known=marked) for part in seen]
        before = _network(seen, header)
        last = seen[-1]
        found = [("specimen", "another specimen", [last]),
                 ("face", "the other face", [replace(last, face=-last.face)])]
    else:
        before = Normal.of(state_of(prior_draws(header).cloth))
    if (rig := another_disc(seen)) and (drape := expected_drape(estimate, rig, marked)):
        found.append(("tester", f"a disc of {rig.millimetres} mm on a plate of "
                                f"{1e3 * rig.plate_diameter:g} mm", [drape]))
    evidence = {(kind, name): drapes_evidence(before, _network([*seen, *further], header))
                for kind, name, further in found}
    if estimate.names == DIRECTIONS:
        evidence["strips", "two hanging strips along warp and weft each"] = strips_evidence(
            cloth.mean, estimate.density)
    records = []
    for (kind, name), linear in evidence.items():
        alpha, beta = (round(100 * float(part.mean()), 1) for part in reductions(cloth, linear))
        if max(alpha, beta) >= _WORTH:
            records.append(NextMeasurement(
                measurement=name, minutes=MINUTES[kind], alpha_narrower_percent=alpha,
                beta_narrower_percent=beta))
    return sorted(records, key=lambda record: -record.alpha_narrower_percent)


def reductions(cloth: Normal, evidence: Linear) -> tuple[np.ndarray, np.ndarray]:
    """By what shares (3,) evidence lowers the standard deviations of log alpha, and of beta, of a
    cloth's state."""
    moved = np.zeros((6, len(cloth.mean)))  # of log alpha, and of beta over alpha's mean
    moved[:, :6] = np.eye(6)
    moved[3:, :3] = np.diag(cloth.mean[3:6])
    before, after = (np.sqrt(np.diag(moved @ each.covariance @ moved.T))
                     for each in (cloth, cloth.updated(evidence)))
    return (1 - after[:3] / before[:3]).clip(0.0), (1 - after[3:] / before[3:]).clip(0.0)


def drapes_evidence(before: Normal, after: Normal) -> Linear:
    """Evidence of a state's moduli that leads from one posterior of the network to another."""
    part = range(6)
    found = Linear.between(before.only(part), after.only(part), least=_LEAST)
    return found.of_part(np.eye(6, len(before.mean)))


def strips_evidence(state: np.ndarray, density: float) -> Linear:
    """Evidence of a state that photographs of hanging strips along warp and weft give of cloth of
    this ``state`` (10,), kg/m²."""
    from drapenet.measured.strips.photograph import expected_strip  # with the simulator of strips
    from drapenet.measured.strips.posterior import expected_evidence
    from sim.cantilever import heavy_elastica

    found = []
    for k in (FIRST, SECOND):
        seen = seen_along(DIRECTIONS[k])
        own = seen @ state + heavier(density)
        alpha, strips = float(np.exp(own[0])), []
        for sign, share in zip((1, -1), STRIP_LENGTHS, strict=True):
            length = max(share * gravity_length(alpha, density), LEAST_STRIP)
            strips.append(expected_strip(heavy_elastica(
                alpha, own[1] * alpha, weight=density * GRAVITY, length=length,
                curl=sign * own[2], points=_POINTS), length, sign=sign))
        found.append(expected_evidence(strips, weight=density * GRAVITY, state=own).of_part(seen))
    return Linear.stacked(found)


def another_disc(seen: Sequence[Observation]) -> Rig | None:
    """The disc that says more than those ``seen``, if any: without a drape the usual one, of a flat
    drape a larger, of a limp one a smaller."""
    if not seen:
        return _DISCS[1]
    last = seen[-1]
    share = last.outline.coefficient(last.rig) if last.outline else last.coefficient
    rig = replace(_DISCS[-1] if share > _FULL else _DISCS[0], rim=last.rig.rim)
    return None if rig.name in {part.rig.name for part in seen} else rig


def expected_drape(estimate: Estimate, rig: Rig, marked: bool) -> Observation | None:
    """The outline of a simulated drape of an estimate; None if it does not converge."""
    from sim.draping import drape
    from sim.start import LOWERED

    found = drape(estimate.fabric, rig=rig, edge=_EDGE, start=LOWERED,
                  laws=estimate.nuisances.laws)
    if not found.converged:
        return None
    return Observation(rig, 1, marked, outline=DrapeOutline(
        silhouettes(found.positions, found.mesh.edges, np.array([np.inf]), zero=0.0)[0]))


def _network(seen: Sequence[Observation], header: Header) -> Normal:
    """The network's posterior of captures; one call for each, so that the samples' noise is that of
    the others and cancels."""
    draws, = predict(network_of(header), header, [seen])
    return Normal.of(state_of(draws.cloth))


