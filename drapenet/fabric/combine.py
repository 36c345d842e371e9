"""Combine: the estimate of a fabric from samples by the network and all other sources: captures
first, then strips and known values."""

from collections.abc import Sequence
from dataclasses import replace

from common.findings import Finding
from common.types import Density
from data.readings.known import Known
from drapenet.evidence.combine import posterior
from drapenet.evidence.source import Source, of_values
from drapenet.evidence.state import cloth_of_state, state_of
from drapenet.measured.base import Record
from drapenet.network.checkpoint import Header
from drapenet.network.predict import Draws
from drapenet.result.estimate import Estimate, make_estimate


def combine(
    draws: Draws, sources: Sequence[Source], density: Density, header: Header, *, name: str,
    contradictions: Sequence[Finding] = (),
) -> Estimate:
    """The estimate from samples and further ``sources``, those along the yarns only if the samples
    know the direction of the warp (:func:`drapenet.fabric.estimate.estimate_fabric`).

    Args:
        name: of what the samples come from; '': the prior.
        contradictions: among what the samples come from.
    """
    if sources:
        found = posterior(state_of(draws.cloth), sources, name)
        draws = replace(draws, cloth=cloth_of_state(found.states))
        contradictions = [*contradictions, *found.contradictions]
    estimate = make_estimate(draws, density=density, header=header)
    return replace(estimate, contradictions=tuple(contradictions))


def evidence_of(
    records: Sequence[Record], stated: Sequence[Known | None], density: Density
) -> list[Source]:
    """What records, and values that are stated of captures, say of a fabric of a density."""
    # Every capture of a folder repeats what is known of the fabric.
    different = {str(known): known for known in (*stated, *(record.known for record in records))
                 if known}
    values = {source.label: source for known in different.values()
              for source in of_values(known, density)}
    return [*(source for record in records for source in record.sources()), *values.values()]
