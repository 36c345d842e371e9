"""Samples of a posterior from samples of a prior and any number of sources.

The prior's samples are moved by the affine map that takes the normal distribution of their mean and
covariance to its product with the sources' likelihoods, each linearised by regression over the
posterior's samples; what the regression leaves is added to the errors (iterated posterior
linearisation, García-Fernández et al. 2015). No source, however accurate or wrong, leaves fewer
samples.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from common.errors import InputError
from common.findings import Finding
from common.normal import Linear, Normal
from drapenet.evidence.source import CAPTURES, STRIPS, VALUES, Source
from drapenet.evidence.state import possible

LEVEL = 0.01  # probability that sources of one fabric are said to contradict each other
MIN_SAMPLES = 400  # that a plate can have; fewer make quantiles uncertain
_ROUNDS = 4  # of linearisation
_TESTED = 1000  # samples of the others' posterior, over which a tested source is linearised
_NAMES = {CAPTURES: "captures", STRIPS: "strips", VALUES: "known values"}


@dataclass(frozen=True)
class Combined:
    """A posterior: states (S, 10), and a finding for each source that is left out of it."""

    states: np.ndarray
    contradictions: tuple[Finding, ...] = ()


def posterior(prior: np.ndarray, sources: Sequence[Source], prior_name: str = "") -> Combined:
    """The posterior of prior states (S, 10) and ``sources``, without those that contradict it.

    A source of a kind is tested against all sources of more trusted kinds, among them what the
    prior's samples come from, then against the others of its own kind.

    Args:
        prior_name: of what the prior's samples come from; '': fabrics in general.
    """
    kept: list[Source] = []
    contradictions: list[Finding] = []
    for kind in sorted({source.kind for source in sources}):
        own = [source for source in sources if source.kind == kind]
        rivals = [prior_name, *dict.fromkeys(_NAMES[source.kind] for source in kept)]
        rival = " and ".join(filter(None, rivals))
        states = updated(prior, kept)
        base = Normal.of(states)
        # Whatever contradicts the more trusted sources goes first, all at once. An unusual fabric
        # is no contradiction.
        wrong = [source for source in own
                 if rival and probability(source, base) < LEVEL / len(own)]
        contradictions += [source.contradiction(rival, base.samples(_TESTED)) for source in wrong]
        sound = [source for source in own if source not in wrong]
        linear = {id(source): _evidence(source, states) or _nothing(states) for source in sound}

        def others(left: Sequence[Source], base: Normal = base,
                   linear: Mapping[int, Linear] = linear) -> Normal:
            found = [linear[id(source)] for source in left]
            return base.updated(Linear.stacked(found)) if found else base

        sound, differing = consistent(sound, others, trusted=bool(rival))
        contradictions += differing
        for source in [source for source in own if source not in sound]:
            sound, doubted = _without_exchanged(source, sound, others)
            contradictions += doubted
        kept += sound
    states, missed = _fitting(prior, kept, prior_name)
    return Combined(states, (*contradictions, *missed))


def _fitting(
    prior: np.ndarray, kept: list[Source], prior_name: str
) -> tuple[np.ndarray, list[Finding]]:
    """States of the posterior of the sources that its cloth fits, and a finding for each of the
    rest. Where sources are far from linear, tests of each against the others miss it."""
    contradictions: list[Finding] = []
    states = updated(prior, kept)
    while doubtful := [source for source in kept if source.kind != CAPTURES
                       and (prior_name or len(kept) > 1)]:
        base = Normal.of(states)
        if min(probability(source, base) for source in doubtful) >= LEVEL / len(doubtful):
            break
        # Not what fits least: the cloth may have been drawn from several towards a wrong source.
        rests = [_without(kept, [one]) for one in doubtful]
        k = int(np.argmin([_misfit(prior, rest) for rest in rests]))
        kept = rests[k]
        states = updated(prior, kept)
        rivals = filter(None, [prior_name, *dict.fromkeys(_NAMES[each.kind] for each in kept)])
        contradictions.append(doubtful[k].contradiction(
            " and ".join(rivals), Normal.of(states).samples(_TESTED)))
    return states, contradictions


def _misfit(prior: np.ndarray, sources: Sequence[Source]) -> float:
    """Sum of the squares by which the mean of the posterior of ``sources`` is off them and off the
    prior, in standard deviations; infinite if no cloth can give what they measured."""
    try:
        middle = updated(prior, sources).mean(axis=0)
    except InputError:
        return np.inf
    usual = Normal.of(prior)
    gap = middle - usual.mean
    off = [gap @ np.linalg.solve(usual.covariance, gap),
           *(np.square(source.residuals(middle[None])).sum() for source in sources)]
    return float(sum(off)) if np.isfinite(off).all() else np.inf


def consistent(
    sources: Sequence[Source], others: Callable[[Sequence[Source]], Normal], *,
    trusted: bool = True,
) -> tuple[list[Source], list[Finding]]:
    """The sources that agree with each other, and a finding for each of the rest.

    The least probable source is removed, and the test repeated with the remaining ones; where that
    is not enough, all values of a test without which the rest agree: they share unit and specimen.

    Args:
        others: the posterior of some sources.
        trusted: whether anything but the sources themselves says which of two tests is wrong.

    InputError if nothing does.
    """
    left: list[Source] = list(sources)
    contradictions: list[Finding] = []
    while worst := _least_probable(left, others):
        gone, wrong = [worst], []
        if tests := {one.test: [each for each in left if each.test == one.test]
                     for one in left if one.test}:
            wrong = [part for part in tests.values() if len(part) < len(left)
                     and not _least_probable(_without(left, part), others)]
        if len(wrong) > 1 and not trusted:
            raise InputError(_undecided((wrong[0], wrong[-1]), others))
        if wrong and _least_probable(_without(left, gone), others):
            gone = next((part for part in wrong if worst in part), wrong[-1])
        left = _without(left, gone)
        rival = left[0].label if len(left) == 1 else f"the other {len(left)} {_NAMES[worst.kind]}"
        cloth = others(left).samples(_TESTED)
        contradictions += [one.contradiction(rival, cloth) for one in gone]
    return left, contradictions


def _without(sources: Sequence[Source], gone: Sequence[Source]) -> list[Source]:
    return [source for source in sources if not any(source is one for one in gone)]


def _least_probable(
    left: Sequence[Source], others: Callable[[Sequence[Source]], Normal]
) -> Source | None:
    """The source that the others contradict most; None if all agree."""
    if len(left) < 2:
        return None
    limit = LEVEL / (len(left) if len(left) > 2 else 1)  # Bonferroni
    found = [probability(source, others(_without(left, [source]))) for source in left]
    k = len(left) - 1 - int(np.argmin(found[::-1]))  # of equals the last
    return left[k] if found[k] < limit else None


def _undecided(tests: Sequence[list[Source]],
               others: Callable[[Sequence[Source]], Normal]) -> str:
    """That of two tests either may be wrong, by the values that may be slips, or any if none is."""
    said: dict[bool, list[str]] = {True: [], False: []}
    for right, doubted in (tests, tests[::-1]):
        cloth = others(right)
        worst = min(doubted, key=lambda source: probability(source, cloth))
        found = worst.contradiction("", cloth.samples(_TESTED))
        expected = found.values.get("expected", np.nan)
        slip = found.values.get("slip", "")
        said[bool(slip)].append(
            f"by {right[0].test} {worst.label} would be {expected:.3g}{slip}")
    return (f"{tests[0][0].test} and {tests[1][0].test} contradict each other, and nothing else "
            f"says which is right: {' or '.join(said[True] or said[False][:1])}; check units, "
            "fabric and density_g_m2, and leave the wrong test out")


def _without_exchanged(
    wrong: Source, sound: list[Source], others: Callable[[Sequence[Source]], Normal]
) -> tuple[list[Source], list[Finding]]:
    """The ``sound`` sources without the value along the other yarns than a ``wrong`` one if the two
    were exchanged, as their exchange shows, which is sound and more probable; and a finding for it.
    """
    swapped, key = wrong.exchanged or (wrong, "")
    for other in sound:
        if other.key != key or not other.exchanged:
            continue
        rest = _without(sound, [other])
        cloth = others(rest)
        stated = [probability(one, cloth) for one in (wrong, other)]
        better = [probability(one, cloth) for one in (swapped, other.exchanged[0])]
        if min(better) >= LEVEL and np.prod(better) > np.prod(stated):
            found = other.contradiction(wrong.label, cloth.samples(_TESTED))
            return rest, [replace(found, code="value_exchanged")]
    return sound, []


def probability(source: Source, cloth: Normal) -> float:
    """Probability of a source as far from a cloth, whose state other sources give, as this one, or
    farther; 0 if the cloth cannot give what it measured."""
    linearised = _linearised(source, cloth.samples(_TESTED))
    if linearised is None:
        return 0.0
    rows, offset, left = linearised
    total = np.eye(len(rows)) + left + rows @ cloth.covariance @ rows.T
    gap = offset + rows @ cloth.mean
    return float(chdtrc(len(rows), gap @ np.linalg.solve(total, gap)))


def updated(prior: np.ndarray, sources: Sequence[Source]) -> np.ndarray:
    """States of the posterior of prior states (S, 10) and all ``sources``, possible plates only.

    InputError if no plate is possible.
    """
    if not sources:
        return prior
    before, states = Normal.of(prior), prior
    factor = np.linalg.cholesky(before.covariance)
    found = [_nothing(states)] * len(sources)
    for _ in range(_ROUNDS):
        # Of a source that nearly none of these states can give, what earlier states said of it.
        found = [_evidence(source, states) or last
                 for source, last in zip(sources, found, strict=True)]
        after = before.updated(Linear.stacked(found))
        scale = np.linalg.cholesky(after.covariance) @ np.linalg.inv(factor)
        states = after.mean + (prior - before.mean) @ scale.T
    kept = possible(states)
    if kept.sum() < min(MIN_SAMPLES, len(prior) // 4):
        raise InputError("hardly any plate has moduli that agree with everything measured: check "
                         "directions, lengths, units and the density")
    return states[kept]


def _nothing(states: np.ndarray) -> Linear:
    return Linear(np.zeros((0, states.shape[1])), np.zeros(0))


def _evidence(source: Source, states: np.ndarray) -> Linear | None:
    """A source linearised over states (S, 10); None where it cannot be."""
    linearised = _linearised(source, states)
    if linearised is None:
        return None
    rows, offset, left = linearised
    root = np.linalg.cholesky(np.eye(len(rows)) + left)
    return Linear(np.linalg.solve(root, rows), np.linalg.solve(root, -offset))


def _linearised(
    source: Source, states: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Rows (m, 10) and offset (m,) of the residuals' regression on states (S, 10), and the
    covariance (m, m) that it leaves; None if too few of the states can give what was measured."""
    residuals = source.residuals(states)
    usable = np.isfinite(residuals).all(axis=1)
    if usable.sum() < len(states) / 20 or usable.sum() < 3 * states.shape[1]:
        return None
    seen, given = states[usable], residuals[usable]
    middle, offset = seen.mean(axis=0), given.mean(axis=0)
    around, apart = seen - middle, given - offset
    slopes = np.linalg.solve(Normal.of(seen).covariance, around.T @ apart / (len(seen) - 1))
    left = np.cov((apart - around @ slopes).T)
    return slopes.T, offset - slopes.T @ middle, np.atleast_2d(left)

