"""The estimate of a fabric from all its sources: captures first, then strips and known values."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache

import numpy as np

from common.errors import InputError
from common.normal import Linear, Normal
from common.types import Density
from data.captures.description import NEED_WARP
from data.captures.reported import Reported
from data.readings.known import Known
from drapenet.evidence.combine import combine, consistent, updated
from drapenet.evidence.source import Source, of_capture, of_refined, of_strips, of_values
from drapenet.evidence.state import cloth_of_state, fabric_prior, state_of
from drapenet.network.checkpoint import Header, load_model
from drapenet.network.predict import Draws, predict
from drapenet.result.estimate import Estimate, make_estimate
from drapenet.views.observation import Observation
from sim.material import DIRECTIONS, STIFF_SOFT

network_of = lru_cache(maxsize=2)(load_model)


@dataclass(frozen=True)
class CaptureEvidence:
    """A capture as the network reads it.

    Attributes:
        label: names it in sentences.
        known: what its laboratory states of the fabric.
        refined: posterior of all but hysteresis after a refinement by simulation, which takes the
            network's place.
    """

    label: str
    seen: Observation
    known: Reported | None = None
    refined: Normal | None = None

    @property
    def observations(self) -> list[Observation]:
        """The capture, and the drape coefficient that is stated beside its pictures."""
        seen, known = self.seen, self.known
        if known is None or known.drape_coefficient_percent is None or (
                np.isfinite(seen.coefficient)):
            return [seen]
        return [seen, Observation.of_numbers(seen.rig, seen.face, seen.known, known)]


@dataclass(frozen=True)
class StripsMeasured:
    """Strips of a fabric of a density, or no strips and values alone.

    Attributes:
        measured: by direction evidence of log alpha, beta/alpha and natural curvature, and alpha,
            N·m, by the strips alone.
    """

    density: Density
    measured: dict[str, tuple[Linear, float]]
    known: Known | None = None


def fabric_estimate(
    captures: Sequence[CaptureEvidence], strips: Sequence[StripsMeasured], density: Density,
    header: Header,
) -> Estimate:
    """The estimate of a fabric from everything that is known of it; its warnings name the sources
    that contradict others and are left out.

    Where the direction of the warp is not stated for all captures, it is taken as unknown for all;
    strips and values along the yarns need it.
    """
    known = all(capture.seen.known for capture in captures)
    captures = [replace(capture, seen=replace(capture.seen, known=known)) for capture in captures]
    draws, lines = (_captured(captures, header) if captures else
                    (Draws(fabric_prior(header), True, 0.0), []))
    sources = [of_strips(direction, measured, alpha, each.density) for each in strips
               for direction, (measured, alpha) in each.measured.items()]
    # Every capture of a folder repeats what is known of the fabric.
    values_stated = [*(capture.known for capture in captures), *(each.known for each in strips)]
    stated = {str(each): each for each in values_stated if each}
    values = {source.label: source for each in stated.values()
              for source in of_values(each, density)}
    name = ("the capture" if len(captures) == 1 else "the captures") if captures else ""
    return joined(draws, [*sources, *values.values()], density, header, name=name, lines=lines)


def joined(
    draws: Draws, sources: Sequence[Source], density: Density, header: Header, *, name: str,
    lines: Sequence[str] = (),
) -> Estimate:
    """The estimate from samples and further ``sources``; ``name``: of what the samples come from,
    whose directions are known if the sources are along the yarns (:func:`require_directions`)."""
    if sources:
        combined = combine(state_of(draws.cloth), sources, name)
        draws = replace(draws, cloth=cloth_of_state(combined.states))
        lines = [*lines, *combined.contradictions]
    estimate = make_estimate(draws, density=density, header=header)
    return replace(estimate, contradictions=tuple(lines))


def require_directions(marked: bool, strips: bool, stated: Sequence[Known]) -> None:
    """InputError if strips or values along the yarns meet captures without the warp's direction."""
    if marked:
        return
    if strips:
        raise InputError(f"strips along the yarns {NEED_WARP}")
    if any(each.along_yarns for each in stated):
        raise InputError(f"known values along the yarns {NEED_WARP}")


def _captured(captures: Sequence[CaptureEvidence], header: Header) -> tuple[Draws, list[str]]:
    """The posterior of captures of one fabric, and a line for each that contradicts the others."""
    known = captures[0].seen.known
    if len(captures) == 1 and not captures[0].refined:
        return predict(network_of(header), header, [captures[0].observations])[0], []
    names = DIRECTIONS if known else STIFF_SOFT
    prior = Normal.of(state_of(fabric_prior(header)))
    refined = {k: of_refined(capture.label, capture.refined, prior, names)
               for k, capture in enumerate(captures) if capture.refined and known}

    @cache
    def together(*numbers: int) -> Draws:
        """The posterior of some captures."""
        read = [part for k in numbers if k not in refined for part in captures[k].observations]
        draws = (predict(network_of(header), header, [read])[0] if read else
                 Draws(fabric_prior(header), True, 0.0))
        better = [refined[k] for k in numbers if k in refined]
        states = updated(state_of(draws.cloth), better)
        return replace(draws, cloth=cloth_of_state(states))

    alone = [together(k) for k in range(len(captures))]
    sources = [of_capture(capture.label, state_of(alone[k].cloth), prior, names)
               for k, capture in enumerate(captures)]
    number = {id(source): k for k, source in enumerate(sources)}
    left, lines = consistent(sources, lambda part: Normal.of(state_of(together(
        *(number[id(source)] for source in part)).cloth)))
    if len(captures) == 2 and lines:
        # Nothing says which of them is of another fabric: the samples are of both.
        first, second = (state_of(alone[k].cloth)[::2] for k in (0, 1))
        lines = [line.replace("left out: check", "the estimate holds for either: check")
                 for line in lines]
        return replace(alone[0], cloth=cloth_of_state(np.concatenate([first, second]))), lines
    return together(*(number[id(source)] for source in left)), lines
