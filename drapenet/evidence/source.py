"""A source of evidence: what it measured, and how far it lies from a cloth of a given state."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

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
        kind: of :data:`CAPTURES`, :data:`STRIPS`, :data:`VALUES`.
        residuals: (S, m) of states (S, 10): what was measured less what a cloth of this state
            gives, in standard deviations, independent; NaN of a state that cannot give it.
        against: clause on what was measured beside what states (S, 10) of other sources say.
    """

    label: str
    kind: int
    residuals: Callable[[np.ndarray], np.ndarray]
    against: Callable[[np.ndarray], str]


def linear(label: str, kind: int, evidence: Linear, against: Callable[[np.ndarray], str]
           ) -> Source:
    """A source whose evidence is linear in the state; ``against`` is a function of states (S, 10).
    """
    return Source(label, kind, lambda states: states @ evidence.rows.T - evidence.values, against)


def of_strips(direction: str, measured: Linear, alpha: float, density: Density) -> Source:
    """Strips along a direction, which measured log alpha at a density, beta/alpha and curvature;
    ``alpha``, N·m: what they say alone."""
    seen, k = seen_along(direction), DIRECTIONS.index(direction)

    def against(states: np.ndarray) -> str:
        others = np.exp(states[:, k].mean()) * density / REFERENCE_DENSITY
        return f"alpha is {alpha / MICRO:.3g} against {others / MICRO:.3g} µN·m"

    return linear(f"the strips along the {direction}", STRIPS,
                  measured.moved(-heavier(density)).of_part(seen), against)


def of_values(known: Known | None, density: Density) -> list[Source]:
    """Each value that a laboratory states."""
    return [_of_value(name, k, value, known.error(name), density)
            for (name, k), value in known.values().items()] if known else []


def _of_value(name: str, k: int, value: float, error: float, density: Density) -> Source:
    quantity = QUANTITIES[name]

    def predicted(states: np.ndarray) -> np.ndarray:
        return quantity.of(cloth_of_state(states), density)[:, k]

    def residuals(states: np.ndarray) -> np.ndarray:
        with np.errstate(invalid="ignore", divide="ignore"):
            gap = np.log(predicted(states)) - np.log(value)
        return np.where(np.isfinite(gap), gap / error, np.nan)[:, None]

    def against(states: np.ndarray) -> str:
        values = predicted(states)
        return (f"they say {np.nanmedian(values):.3g}" if np.isfinite(values).any() else
                "their cloth lies outside the range in which it can be measured")

    return Source(f"the known {quantity.stated(k, value)}", VALUES, residuals, against)


def of_refined(label: str, refined: Normal, prior: Normal, names: Sequence[str]) -> Source:
    """A refined capture: its posterior of all but hysteresis, without the prior's part."""
    part = range(len(refined.mean))
    evidence = Linear.between(prior.only(part), refined)
    seen = np.eye(len(part), len(STATE))
    return linear(label, CAPTURES, evidence.of_part(seen), _alpha_against(refined.mean, names))


def of_capture(label: str, alone: np.ndarray, prior: Normal, names: Sequence[str]) -> Source:
    """What a capture's posterior states (S, 10) say of log alpha of the fabric, from which its
    specimen differs; to be tested against others, not to be combined."""
    posterior, part = Normal.of(alone[:, LINEAR]), range(3)
    evidence = Linear.between(prior.only(part), posterior, least=0.1).scattered(
        SPECIMEN_SCATTER**2 * np.eye(3))
    return linear(label, CAPTURES, evidence.of_part(np.eye(3, len(STATE))),
                  _alpha_against(posterior.mean, names))


def _alpha_against(mean: np.ndarray, names: Sequence[str]) -> Callable[[np.ndarray], str]:
    """Text of the alpha, at 300 g/m², that differs most from that of others."""
    def against(states: np.ndarray) -> str:
        others = states[:, LINEAR].mean(axis=0)
        worst = int(np.abs(mean[LINEAR] - others).argmax())
        alpha, expected = np.exp([mean[worst], others[worst]]) / MICRO
        return (f"alpha {names[worst]} at 300 g/m² is {alpha:.3g} against {expected:.3g} µN·m")

    return against
