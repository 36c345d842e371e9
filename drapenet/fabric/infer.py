"""Infer: samples of the posterior of a fabric by the network, from one capture or several."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from common.errors import InputError
from common.findings import Finding
from common.normal import Normal
from data.captures.description import NEED_WARP
from data.readings.known import Reported
from drapenet.evidence.combine import consistent, updated
from drapenet.evidence.source import of_capture, of_refined
from drapenet.evidence.state import cloth_of_state, fabric_prior, state_of
from drapenet.fabric.combine import stated_of
from drapenet.measured.base import Observed, Record
from drapenet.network.checkpoint import Header
from drapenet.network.inputs import Stated
from drapenet.network.predict import Draws, network_of, predict
from drapenet.views.observation import Observation
from sim.material import DIRECTIONS, STIFF_SOFT


@dataclass(frozen=True)
class CaptureEvidence:
    """A capture as the network reads it.

    Attributes:
        label: names it in sentences.
        stated: what its laboratory states of the fabric.
        refined: posterior of all but hysteresis after a refinement by simulation, which takes the
            network's place.
    """

    label: str
    seen: Observation
    stated: Reported | None = None
    refined: Normal | None = None

    @property
    def observations(self) -> list[Observation]:
        """The capture, and the drape coefficient that is stated beside its pictures."""
        seen, stated = self.seen, self.stated
        if stated is None or stated.drape_coefficient_percent is None or (
                np.isfinite(seen.coefficient)):
            return [seen]
        return [seen, Observation.of_numbers(seen.rig, seen.face, seen.known, stated)]


def evidence_of(observed: Observed) -> CaptureEvidence:
    """A capture as it was observed, with what its laboratory states."""
    capture = observed.capture
    return CaptureEvidence(str(capture.path), observed.seen, capture.known)


def infer(observed: Observed, header: Header, records: Sequence[Record] = ()) -> Draws:
    """Samples from one capture, of which ``records`` state more, and how it compares with drapes of
    them; InputError for a tester or a kind of capture that the network of ``header`` has not
    learned."""
    capture = observed.capture
    try:
        header.require_learned(capture.rig)
        if capture.warp_direction is None and capture.known and capture.known.along_yarns:
            raise InputError(f"known values along the yarns {NEED_WARP}")
        draws, = predict(network_of(header), header, [evidence_of(observed).observations],
                         [stated_of([capture.known], capture.density, records)], compared=True)
    except InputError as error:
        raise InputError(f"{capture.path}: {error}") from None
    return draws


def prior_draws(header: Header) -> Draws:
    """Samples of a fabric of which nothing is captured."""
    return Draws(fabric_prior(header), True, 0.0)


def infer_jointly(
    captures: Sequence[CaptureEvidence], header: Header, stated: Stated
) -> tuple[Draws, list[Finding]]:
    """Samples from captures of one fabric, of which something may be ``stated``, and a finding for
    each that contradicts the others.

    Where the direction of the warp is not stated for all captures, it is taken as unknown for all.
    """
    if not captures:
        return prior_draws(header), []
    marked = all(capture.seen.known for capture in captures)
    captures = [replace(capture, seen=replace(capture.seen, known=marked)) for capture in captures]
    if len(captures) == 1 and not captures[0].refined:
        return predict(network_of(header), header, [captures[0].observations], [stated])[0], []
    names = DIRECTIONS if marked else STIFF_SOFT
    prior = Normal.of(state_of(fabric_prior(header)))
    refined = {k: of_refined(capture.label, capture.refined, prior, names)
               for k, capture in enumerate(captures) if capture.refined and marked}

    @cache
    def together(*numbers: int) -> Draws:
        """The posterior of some captures."""
        read = [part for k in numbers if k not in refined for part in captures[k].observations]
        draws = (predict(network_of(header), header, [read], [stated])[0] if read else
                 prior_draws(header))
        better = [refined[k] for k in numbers if k in refined]
        states = updated(state_of(draws.cloth), better)
        return replace(draws, cloth=cloth_of_state(states))

    alone = [together(k) for k in range(len(captures))]
    sources = [of_capture(capture.label, state_of(alone[k].cloth), prior, names)
               for k, capture in enumerate(captures)]
    number = {id(source): k for k, source in enumerate(sources)}
    left, contradictions = consistent(sources, lambda part: Normal.of(state_of(together(
        *(number[id(source)] for source in part)).cloth)))
    if len(captures) == 2 and contradictions:
        # Nothing says which of them is of another fabric: the samples are of both.
        first, second = (state_of(alone[k].cloth)[::2] for k in (0, 1))
        return (replace(alone[0], cloth=cloth_of_state(np.concatenate([first, second]))),
                [replace(found, code="captures_differ") for found in contradictions])
    return together(*(number[id(source)] for source in left)), contradictions
