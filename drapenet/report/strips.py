"""Picture of strips in a report: hanging ones as they were read, those under weights."""

from typing import TYPE_CHECKING

from data.captures.preview import png

if TYPE_CHECKING:
    from drapenet.measured.strips.folder import StripSet
    from drapenet.measured.tension.folder import TensionSet


def draw_strips(source: "StripSet | TensionSet") -> bytes:
    """PNG of strips; empty if there is nothing to see: bending lengths, or values of testers."""
    if source.kind == "tension":
        from drapenet.measured.tension.preview import tension_figure

        return png(tension_figure(source, source.evidence)) if source.strips else b""
    from drapenet.measured.strips.preview import strips_figure

    return png(strips_figure(source)) if source.photographs else b""
