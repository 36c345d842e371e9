"""Captures made of arrays, checked like those that are read."""

from contextlib import suppress
from dataclasses import replace

import numpy as np

from common.documents import shown
from common.errors import InputError, one_line
from common.types import Views
from data.captures.capture import Capture, described
from data.captures.depth import measured
from data.captures.description import Description
from data.captures.view_checks import checked_views, require_sizes
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
    density = _number("density", capture.density, "kg/m²")
    if density > MAX_DENSITY:
        raise InputError(f"density={density:g} is more than {MAX_DENSITY:g} kg/m², as of g/m²; "
                         "give kg/m²: 0.21 for 210 g/m²")
    warp = capture.warp_direction
    warp = None if warp is None else _number("warp_direction", warp, "rad, or None")
    stated = described(density, rig, capture.face, warp, capture.labels)
    if capture.outline or (capture.known and not np.size(capture.views)):
        Description.of(stated, capture.path)
        return replace(capture, rig=rig, density=density, warp_direction=warp)
    views = _metres(capture.views)
    camera = require_sizes(views, capture.intrinsics)
    turns = _numbers("turns", capture.turns)
    if (largest := np.abs(turns).max(initial=0)) > MAX_TURN:
        raise InputError(f"turns reach {largest:g}, more than a full turn of 6.283 rad; give "
                         "radians: np.radians([0, 90, 180, 270])")
    turns = Description.of(stated | {"turns_deg": np.degrees(turns).tolist()},
                           capture.path).turns(len(views))
    views, warnings = checked_views(views, camera)
    return replace(capture, views=views, turns=turns, rig=rig, density=density, warp_direction=warp,
                   warnings=tuple(dict.fromkeys((*capture.warnings, *warnings))))


def _numbers(name: str, values: object) -> np.ndarray:
    """An argument of numbers (N,); InputError for others, and for masked ones."""
    with suppress(TypeError, ValueError):
        found = np.asarray(values, dtype=float)
        if found.ndim == 1 and np.isfinite(found).all() and not np.ma.is_masked(values):
            return found
    raise InputError(f"{name}={shown(values)}: give a list of finite numbers")


def _number(name: str, value: object, unit: str) -> float:
    """An argument of one number; InputError for others."""
    with suppress(InputError):
        if not isinstance(value, (str, bool)):
            return float(_numbers(name, [value])[0])
    raise InputError(f"{name}={shown(value)}: give a finite number, {unit}")


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
