"""Combine: the estimate of a fabric from samples by the network and all other sources: captures
first, then strips and known values."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from common.normal import Linear
from common.types import Density
from data.readings.known import Known
from drapenet.estimator.infer import CaptureEvidence, infer_jointly
from drapenet.evidence.combine import combine as combined
from drapenet.evidence.source import Source, of_strips, of_values
from drapenet.evidence.state import cloth_of_state, state_of
from drapenet.network.checkpoint import Header
from drapenet.network.predict import Draws
from drapenet.result.estimate import Estimate, make_estimate


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


def combine(
    draws: Draws, sources: Sequence[Source], density: Density, header: Header, *, name: str,
    lines: Sequence[str] = (),
) -> Estimate:
    """The estimate from samples and further ``sources``; ``name``: of what the samples come from,
    whose directions are known if the sources are along the yarns
    (:func:`drapenet.estimator.read.require_directions`)."""
    if sources:
        found = combined(state_of(draws.cloth), sources, name)
        draws = replace(draws, cloth=cloth_of_state(found.states))
        lines = [*lines, *found.contradictions]
    estimate = make_estimate(draws, density=density, header=header)
    return replace(estimate, contradictions=tuple(lines))


def combine_all(
    captures: Sequence[CaptureEvidence], strips: Sequence[StripsMeasured], density: Density,
    header: Header,
) -> Estimate:
    """The estimate of a fabric from everything that is known of it; its contradictions name the
    sources that are left out. Strips and values along the yarns need the direction of the warp.
    """
    draws, lines = infer_jointly(captures, header)
    sources = [of_strips(direction, measured, alpha, part.density) for part in strips
               for direction, (measured, alpha) in part.measured.items()]
    # Every capture of a folder repeats what is known of the fabric.
    values_stated = [*(capture.stated for capture in captures), *(part.known for part in strips)]
    stated = {str(known): known for known in values_stated if known}
    values = {source.label: source for known in stated.values()
              for source in of_values(known, density)}
    name = ("the capture" if len(captures) == 1 else "the captures") if captures else ""
    return combine(draws, [*sources, *values.values()], density, header, name=name, lines=lines)
