"""Combine: the estimate of a fabric from samples by the network and all other sources: captures
first, then strips and known values."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from common.findings import Finding
from common.types import Density
from data.fabrics.nuisances import KINDS
from data.readings.cantilever import QUANTITIES as CANTILEVER
from data.readings.known import Known
from drapenet.evidence.combine import posterior
from drapenet.evidence.source import Source, of_values, value_key
from drapenet.evidence.state import cloth_of_state, state_of
from drapenet.measured.base import Record
from drapenet.network.checkpoint import Header
from drapenet.network.inputs import Stated
from drapenet.network.predict import Draws
from drapenet.result.estimate import Estimate, make_estimate
from sim.material import DIRECTIONS, REFERENCE_DENSITY

_MEMBRANE = "membrane_n_per_m", 0


def combine(
    draws: Draws, sources: Sequence[Source], density: Density, header: Header, *, name: str,
    contradictions: Sequence[Finding] = (),
) -> Estimate:
    """The estimate from samples and further ``sources``, those along the yarns only if the samples
    know the direction of the warp (:func:`drapenet.fabric.estimate.estimate_fabric`), and without a
    membrane stiffness that the network was told.

    Args:
        name: of what the samples come from; '': the prior.
        contradictions: among what the samples come from.
    """
    sources = [one for one in sources if not (draws.told and one.key == value_key(*_MEMBRANE))]
    if sources:
        found = posterior(state_of(draws.cloth), sources, name)
        draws = replace(draws, cloth=cloth_of_state(found.states))
        contradictions = [*contradictions, *found.contradictions]
    estimate = make_estimate(draws, density=density, header=header)
    counted = {one.key for one in sources} - {one.source for one in contradictions}
    twice = {direction: tests for k, direction in enumerate(DIRECTIONS) if len(tests := [
        each.in_words for each in CANTILEVER if value_key(each.name, k) in counted]) > 1}
    return replace(estimate, contradictions=tuple(contradictions), warnings=(
        *estimate.warnings, *(Finding("value_repeated", {
            "values": " and ".join(tests), "direction": name}) for name, tests in twice.items())))


def one_capture(reported: bool) -> str:
    """Names a capture that samples come from; ``reported``: a drape coefficient alone."""
    return "the drape coefficient" if reported else "the capture"


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


def stated_of(
    stated: Sequence[Known | None], density: Density, records: Sequence[Record] = ()
) -> Stated:
    """What is stated of a fabric of a density, for the network: the membrane stiffness, or else
    that of strips under weights, and the kind, if all agree on it."""
    every = [known for known in (*stated, *(record.known for record in records)) if known]
    membranes = [value * REFERENCE_DENSITY / density for known in every
                 if (value := known.values().get(_MEMBRANE))]
    membranes = membranes or [record.membrane for record in records if record.membrane]
    kinds = {KINDS.index(known.cloth) for known in every if known.cloth}
    return Stated(float(np.exp(np.mean(np.log(membranes)))) if membranes else np.nan,
                  kinds.pop() if len(kinds) == 1 else -1)
