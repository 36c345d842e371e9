"""A source of evidence: what it measured, and how far it lies from a cloth of a given state."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from common.findings import Finding
from common.normal import Linear, Normal
from common.types import Density
from data.readings import QUANTITIES
from data.readings.known import Known
from data.readings.quantity import SPECIMEN_SCATTER
from drapenet.evidence.state import (
    STATE,
    cloth_of_state,
    heavier,
    seen_along,
)
from sim.material import DIRECTIONS, LINEAR, MICRO, REFERENCE_DENSITY

CAPTURES, STRIPS, VALUES = range(3)
"""Kinds of sources, the most trusted first: a source that contradicts those of a more trusted kind
is left out."""


@dataclass(frozen=True)
class Source:
    """Evidence of a cloth's state.

    Attributes:
        label: subject of a sentence, such as "the strips along the warp".
        key: of the source among those of a fabric.
        kind: of :data:`CAPTURES`, :data:`STRIPS`, :data:`VALUES`.
        residuals: (S, m) of states (S, 10): what was measured less what a cloth of this state
            gives, in standard deviations, independent; NaN of a state that cannot give it.
        against: what was measured beside what states (S, 10) of other sources say: code and values.
        exchanged: the same with the value that is stated along the other yarns, if one is, and the
            key of the source of that one.
        test: what measured a stated value; '': no value.
    """

    label: str
    key: str
    kind: int
    residuals: Callable[[np.ndarray], np.ndarray]
    against: "Against"
    exchanged: "tuple[Source, str] | None" = None
    test: str = ""

    def contradiction(self, rival: str, states: np.ndarray) -> Finding:
        """That it contradicts the ``rival``, of whose states (S, 10) are."""
        code, values = self.against(states)
        return Finding(code, {"label": self.label, "rival": rival} | values, self.key)


Against = Callable[[np.ndarray], tuple[str, dict[str, Any]]]


def linear(label: str, key: str, kind: int, evidence: Linear, against: Against) -> Source:
    """A source whose evidence is linear in the state."""
    return Source(label, key, kind, lambda states: states @ evidence.rows.T - evidence.values,
                  against)


def of_strips(direction: str, measured: Linear, alpha: float, density: Density) -> Source:
    """Strips along a direction, which measured log alpha at a density, beta/alpha and curvature;
    ``alpha``, N·m: what they say alone."""
    seen, k = seen_along(direction), DIRECTIONS.index(direction)

    def against(states: np.ndarray) -> tuple[str, dict[str, Any]]:
        others = np.exp(states[:, k].mean()) * density / REFERENCE_DENSITY
        return "strips_contradict", {"value": alpha / MICRO, "expected": others / MICRO}

    return linear(f"the strips along the {direction}", f"strips.{direction}", STRIPS,
                  measured.moved(-heavier(density)).of_part(seen), against)


def of_values(known: Known | None, density: Density) -> list[Source]:
    """Each value that a laboratory states."""
    stated, found = known.values() if known else {}, []
    for (name, k), value in stated.items():
        assert known
        error = known.error(name)
        source = _of_value(name, k, value, error, density)
        other = name, 2 - k  # of the other yarns; of the bias none
        if other in stated and other[1] != k:
            source = replace(source, exchanged=(
                _of_value(name, k, stated[other], error, density), value_key(*other)))
        found.append(source)
    return found


def _of_value(name: str, k: int, value: float, error: float, density: Density) -> Source:
    quantity = QUANTITIES[name]

    def predicted(states: np.ndarray) -> np.ndarray:
        return quantity.of(cloth_of_state(states), density)[:, k]

    def residuals(states: np.ndarray) -> np.ndarray:
        with np.errstate(invalid="ignore", divide="ignore"):
            gap = np.log(predicted(states)) - np.log(value)
        return np.where(np.isfinite(gap), gap / error, np.nan)[:, None]

    def against(states: np.ndarray) -> tuple[str, dict[str, Any]]:
        values = predicted(states)
        if not np.isfinite(values).any():
            return "value_cannot_be_measured", {"value": value}
        expected = float(np.nanmedian(values))
        slip = quantity.slip(value / expected)
        return "value_slipped" if slip else "value_contradicts", {
            "value": value, "expected": expected, **({"slip": slip} if slip else {})}

    return Source(f"the known {quantity.stated(k, value)}", value_key(name, k), VALUES, residuals,
                  against, test=quantity.in_words)


def value_key(name: str, k: int) -> str:
    """Key of a stated value of this quantity along the direction of this number."""
    return f"known.{name}.{k}"


def of_refined(label: str, refined: Normal, prior: Normal, names: Sequence[str]) -> Source:
    """A refined capture: its posterior of all but hysteresis, without the prior's part."""
    part = range(len(refined.mean))
    evidence = Linear.between(prior.only(part), refined)
    seen = np.eye(len(part), len(STATE))
    return linear(label, label, CAPTURES, evidence.of_part(seen),
                  _alpha_against(refined.mean, names))


def of_capture(label: str, alone: np.ndarray, prior: Normal, names: Sequence[str]) -> Source:
    """What a capture's posterior states (S, 10) say of log alpha of the fabric, from which its
    specimen differs; to be tested against others, not to be combined."""
    posterior, part = Normal.of(alone[:, LINEAR]), range(3)
    evidence = Linear.between(prior.only(part), posterior, least=0.1).scattered(
        SPECIMEN_SCATTER**2 * np.eye(3))
    return linear(label, label, CAPTURES, evidence.of_part(np.eye(3, len(STATE))),
                  _alpha_against(posterior.mean, names))


def _alpha_against(mean: np.ndarray, names: Sequence[str]) -> Against:
    """The alpha, at 300 g/m², that differs most from that of others."""
    def against(states: np.ndarray) -> tuple[str, dict[str, Any]]:
        others = states[:, LINEAR].mean(axis=0)
        worst = int(np.abs(mean[LINEAR] - others).argmax())
        alpha, expected = np.exp([mean[worst], others[worst]]) / MICRO
        return "capture_contradicts", {"direction": names[worst], "value": float(alpha),
                                       "expected": float(expected)}

    return against
