"""Observe: what the network reads of a capture, by its kind, and checks of what is seen."""

from dataclasses import dataclass
from functools import singledispatch

from common.errors import InputError
from common.findings import Finding
from data.captures.capture import Capture, DepthCapture, OutlineCapture, ReportedCapture
from data.render.setups import Setups
from drapenet.views.checks import view_warnings
from drapenet.views.located import LocatedViews
from drapenet.views.observation import Observation


@dataclass(frozen=True)
class Observed:
    """A capture as it is observed.

    Attributes:
        seen: the network's input.
        views: of a depth capture.
    """

    capture: Capture
    seen: Observation
    views: LocatedViews | None = None

    def warnings(self, setups: Setups) -> list[Finding]:
        """Faults of depth views, posed as the ``setups`` that were trained on or not; InputError if
        they show no drape."""
        if not (self.views and self.seen.map):
            return []
        return view_warnings(self.views, self.seen.map, setups)


@singledispatch
def observe(capture: Capture) -> Observed:
    """Observe a capture; InputError if it does not show what its kind needs."""
    raise InputError(f"{capture.path}: captures of the kind {type(capture).__name__} cannot be "
                     "observed; register one in drapenet/fabric/observe.py")


@observe.register
def _(capture: DepthCapture) -> Observed:
    views = LocatedViews.of(capture)
    return Observed(capture, Observation.of_views(views, capture.sign, capture.warp_direction),
                    views)


@observe.register
def _(capture: OutlineCapture) -> Observed:
    return Observed(capture, Observation.of_outline(capture))


@observe.register
def _(capture: ReportedCapture) -> Observed:
    marked = capture.warp_direction is not None
    return Observed(capture, Observation.of_numbers(capture.rig, capture.sign, marked,
                                                    capture.known))
