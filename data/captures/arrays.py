"""Captures made of arrays, checked like those that are read."""

from dataclasses import replace

import numpy as np

from common.arguments import number, numbers
from common.errors import InputError, one_line, shown
from common.types import Views
from data.captures.capture import Capture, DepthCapture
from data.captures.depth import measured
from data.captures.description import Description
from data.captures.view_checks import checked_views, require_sizes
from data.captures.writer import described
from data.rigs import TESTERS, named_tester
from sim.rig import Rig

MAX_DENSITY = 1.0  # kg/m²: larger numbers are g/m²
MAX_TURN = 6.3  # rad: larger numbers are degrees
MAX_ARRAY_DEPTH = 20.0  # m: larger numbers are millimetres


def checked_capture(capture: Capture) -> Capture:
    """A capture made of arrays, checked like one that is read; InputError for a fault.

    ``rig`` may be the name of a tester. Depth that is masked, not finite or not positive is
    background.
    """
    rig = named_tester(capture.rig) if isinstance(capture.rig, str) else capture.rig
    if not isinstance(rig, Rig):
        raise InputError(f"rig={shown(rig)} is not a tester; give Rig.from_name(NAME) or a name "
                         f"such as {TESTERS[0]}")
    density = number("density", capture.density, "kg/m²")
    if density > MAX_DENSITY:
        raise InputError(f"density={density:g} is more than {MAX_DENSITY:g} kg/m², as of g/m²; "
                         "give kg/m²: 0.21 for 210 g/m²")
    warp = capture.warp_direction
    warp = None if warp is None else number("warp_direction", warp, "rad, or None")
    stated = described(density, rig, capture.face, warp, capture.labels)
    if not isinstance(capture, DepthCapture):
        Description.of(stated, capture.path)
        return replace(capture, rig=rig, density=density, warp_direction=warp)
    views = _metres(capture.views)
    camera = require_sizes(views, capture.intrinsics)
    turns = numbers("turns", capture.turns, "a list of finite numbers", (None,))
    if (largest := np.abs(turns).max(initial=0)) > MAX_TURN:
        raise InputError(f"turns reach {largest:g}, more than a full turn of 6.283 rad; give "
                         "radians: np.radians([0, 90, 180, 270])")
    turns = Description.of(stated | {"turns_deg": np.degrees(turns).tolist()},
                           capture.path).turns(len(views))
    views, warnings = checked_views(views, camera)
    new = tuple(found for found in warnings if found not in capture.warnings)
    return replace(capture, views=views, turns=turns, rig=rig, density=density, warp_direction=warp,
                   warnings=capture.warnings + new)


def _metres(views: object) -> Views:
    """Depth of an argument, m, 0 for what is no measurement; InputError for other arrays."""
    try:
        found: np.ndarray = np.ma.filled(np.ma.asarray(views), 0)
    except (TypeError, ValueError) as error:
        raise InputError(f"views are no array ({one_line(error)}); give views of one size"
                         ) from None
    if found.dtype.kind != "f":
        raise InputError(f"views are of the type {found.dtype}; give metres as floating-point "
                         "numbers, of millimetres 1e-3 * views")
    found = measured(found)
    middle = float(np.median(found[found > 0])) if found.any() else 0.0
    if middle > MAX_ARRAY_DEPTH:
        raise InputError(f"views have a median depth of {middle:.4g}, which cannot be metres (at "
                         f"most {MAX_ARRAY_DEPTH:g}); of millimetres give 1e-3 * views")
    return found
