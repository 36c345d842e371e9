"""Plausibility checks of captures.

The checks use that cloth does not stretch, the plate is flat, and all views show the same cloth.
Few correct simulated captures exceed the limits (``python -m experiments faults``).
"""

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_erosion, binary_fill_holes, label

from common.errors import InputError
from common.findings import Finding
from common.types import Metres, Turns
from data.captures.capture import Check, warnings_of
from data.captures.description import MAX_COEFFICIENT
from data.captures.plate import INNER_SHARE
from data.render.cameras import Camera
from data.render.setups import Setups
from drapenet.views.directions import AZIMUTH, AZIMUTHS
from drapenet.views.located import LocatedViews
from drapenet.views.outline import outline_of_map
from drapenet.views.radial_map import RadialMap
from drapenet.views.sizes import Sizes, measured_sizes
from drapenet.views.turns import disagreement, register
from sim.rig import Rig

SPECIMEN_OFFSET = Path(__file__).parents[1] / "weights" / "specimen_offset.json"
"""Coefficients of a regression on simulated captures."""
_BAND = 4  # rows of a map
_PLATE_TOLERANCE = 10e-3  # m, distance of cloth on the plate from its plane
_CUT_TOLERANCE = 1.5e-3  # m, range of depths of a border cut by a threshold
MAX_SIZE_ERROR = 0.105  # of the logarithm of a measured over a stated size
REFUSED_SIZE_ERROR = 0.16  # of the same
MAX_OFFSET = 14e-3  # m: 3.5 standard deviations of the training specimens
MAX_BULGE = 0.35e-3  # m
MAX_OFF_PLATE = 0.1  # of the points over the plate's middle; images rotated by 90° have 0.2
MAX_DISAGREEMENT = 3.5e-3  # m
MAX_HOLES_SHARE = 0.05
MAX_HOLE_PIXELS = 150  # pixels
MAX_CUT_SHARE = 0.25
MAX_PIXEL = 2.6e-3  # m; training captures have up to 2.1 mm
MAX_TURN_ERROR = np.radians(7.5)  # rad: 3 standard deviations of the training captures
TILT, SHIFT = np.radians(2.0), 0.020  # rad and m, errors of the estimated pose
MIN_IMPROVEMENT = 1.35  # factor by which another reading must reduce the disagreement of the views
MAX_SWAPPED_VIEWS = 4  # maximum number of views for which all pairs are tried swapped

Reading = tuple[str, dict[str, int]]
"""Another reading of the views: code and values of its finding."""


@dataclass(frozen=True)
class Quality:
    """Quality measures of a capture; NaN if too little is visible."""

    sizes: Sizes  # of specimen and plate
    offset: Metres  # of the specimen's centre from the plate's axis
    bulge: Metres  # height of the middle of the cloth on the plate over its edge
    off_plate: float  # share of the points over the plate's middle that are off its plane
    disagreement: Metres  # between views of the same cloth
    misread: Finding | None  # explanation of a disagreement with its remedy
    holes: float  # share of the cloth's pixels that have no depth
    hole: int  # pixels of the largest
    cut: float  # share of a view's border that has the same depth, maximum over views
    pixel: Metres  # size on the plate
    coefficient: float  # of the drape, from 0 to 1


def view_warnings(located: LocatedViews, drape: RadialMap, setups: Setups) -> list[Finding]:
    """A finding for each possible fault of a capture; InputError if its views show no plate."""
    quality = measure(located, drape)
    require_plate(quality)
    return warnings_of(view_checks(located, quality, setups))


def view_checks(located: LocatedViews, quality: Quality, setups: Setups) -> list[Check]:
    """Checks of a capture: pose of the camera, which the ``setups`` trained on limit, turns of the
    table, quality of the views."""
    return [*pose_checks(located.camera, setups), *turn_checks(located), *quality_checks(quality)]


def pose_checks(camera: Camera, setups: Setups) -> Iterator[Check]:
    """Checks of the place of ``camera`` against the ``setups`` trained on."""
    up = camera.world_to_camera[:3, 2]
    centre = camera.world_to_camera[:3, 3]
    pitch = np.arcsin(np.clip(-up[2], -1.0, 1.0))
    distance = float(np.linalg.norm(centre))
    low, high = setups.pitch
    near, far = setups.distance
    yield Check("camera looks down by", f"{np.degrees(pitch):.0f}°", Finding("camera_pitch", {
        "value": math.degrees(pitch), "low": math.degrees(low), "high": math.degrees(high)})
        if not low - TILT < pitch < high + TILT else None)
    yield Check("distance of the plate", f"{1e3 * distance:.0f} mm", Finding("camera_distance", {
        "value": 1e3 * distance, "low": 1e3 * near, "high": 1e3 * far})
        if not near - SHIFT < distance < far + SHIFT else None)


def turn_checks(located: LocatedViews) -> Iterator[Check]:
    """Checks of the table's turns against the stated ones, of all views but the first."""
    pairs = zip(located.turns, located.stated_turns, strict=True)
    for k, (turn, stated) in enumerate(pairs):
        if k:
            yield Check(f"table in view {k}", f"{np.degrees(turn):.0f}°", Finding("table_turned", {
                "view": k, "value": math.degrees(turn), "stated": math.degrees(stated)})
                if abs(turn - stated) >= MAX_TURN_ERROR else None)


def measure(located: LocatedViews, drape: RadialMap) -> Quality:
    """Measure the quality of a capture with the map ``drape``."""
    views = located.views
    camera = located.camera
    rig = located.rig
    gap = disagreement(located.clouds, located.turns, located.centre, rig)
    missing = [binary_fill_holes(view) & ~view for view in views > 0]
    offset = specimen_offset(drape, rig) if len(views) > 1 else np.nan
    bulge, off_plate = _flatness(np.concatenate(located.clouds) - [*located.centre, 0.0], rig)
    return Quality(
        sizes=measured_sizes(located), offset=offset, bulge=bulge, off_plate=off_plate,
        disagreement=gap, misread=_misread(located, gap),
        holes=float(np.sum(missing) / max(np.sum(missing) + (views > 0).sum(), 1)),
        hole=max(int(np.bincount(label(part)[0].ravel())[1:].max(initial=0)) for part in missing),
        cut=max(_cut(view) for view in views),
        pixel=float(np.linalg.norm(camera.world_to_camera[:3, 3]) / camera.fx),
        coefficient=outline_of_map(drape, rig).coefficient(rig))


def _misread(located: LocatedViews, gap: float) -> Finding | None:
    """The reading of the views that reduces their disagreement by far the most."""
    if not np.isfinite(gap):
        return None
    clouds = located.clouds
    camera = located.camera
    rig = located.rig
    gaps = [(disagreement(clouds, *register(clouds, turns, rig), rig), reading)
            for reading, turns in _turn_readings(located.stated_turns)]
    along = located.views / np.linalg.norm(camera.directions(), axis=2)
    clouds = [camera.cloth_points(view) for view in along]
    gaps.append((disagreement(clouds, *register(clouds, located.stated_turns, rig), rig),
                 ("depth_along_rays", {})))
    least, (code, values) = min(gaps, key=lambda found: np.nan_to_num(found[0], nan=np.inf))
    return Finding(code, {"value": 1e3 * gap, "factor": MIN_IMPROVEMENT} | values
                   ) if gap > MIN_IMPROVEMENT * least else None


def _turn_readings(stated: Turns) -> list[tuple[Reading, Turns]]:
    """Other turns of the table, each different, with their explanations."""
    readings: list[tuple[Reading, Turns]] = [(("turned_backwards", {}), -stated)]
    count = len(stated)
    for later in range(1, count):
        stayed = stated.copy()
        stayed[later] = stated[later - 1]
        readings.append((("table_did_not_turn", {"view": later}), stayed))
        for earlier in range(later):
            if count <= MAX_SWAPPED_VIEWS or later == earlier + 1:
                swapped = stated.copy()
                swapped[[earlier, later]] = stated[[later, earlier]]
                readings.append((("views_swapped", {"earlier": earlier, "later": later}),
                                 swapped - swapped[0]))
    distinct: list[tuple[Reading, Turns]] = []
    for reading, turns in readings:  # four quarter turns backwards: views 1, 3 swapped
        if not any(np.allclose(np.exp(1j * turns), np.exp(1j * former))
                   for _, former in distinct):
            distinct.append((reading, turns))
    return distinct


def quality_checks(q: Quality) -> Iterator[Check]:
    """Checks of the quality of views."""
    yield from size_checks(q.sizes, MAX_SIZE_ERROR)
    yield Check("specimen's centre off the axis", _shown(1e3 * q.offset, "mm"), _beyond(
        "specimen_off_axis", 1e3 * q.offset, 1e3 * MAX_OFFSET))
    yield Check("bulge of the plate", _shown(1e3 * q.bulge, "mm", 1), _beyond(
        "plate_curved", 1e3 * q.bulge, 1e3 * MAX_BULGE))
    yield Check("difference of views", _shown(1e3 * q.disagreement, "mm", 1), q.misread or _beyond(
        "views_differ", 1e3 * q.disagreement, 1e3 * MAX_DISAGREEMENT))
    yield Check("cloth without depth", f"{q.holes:.1%}, {q.hole} px in one hole", Finding(
        "depth_holes", {"value": q.holes, "limit": MAX_HOLES_SHARE, "pixels": q.hole,
                        "limit_pixels": MAX_HOLE_PIXELS})
        if q.holes > MAX_HOLES_SHARE or q.hole > MAX_HOLE_PIXELS else None)
    yield Check("border of one depth", _shown(100 * q.cut, "%"), _beyond(
        "border_cut", q.cut, MAX_CUT_SHARE))
    yield Check("pixel on the plate", _shown(1e3 * q.pixel, "mm", 1), _beyond(
        "pixel_on_plate_large", 1e3 * q.pixel, 1e3 * MAX_PIXEL))
    yield coefficient_check(q.coefficient, 1.0)


def _beyond(code: str, value: float, limit: float) -> Finding | None:
    """A finding if a value is larger than its limit; not if it is NaN."""
    return Finding(code, {"value": value, "limit": limit}) if abs(value) > limit else None


def _shown(value: float, unit: str, places: int = 0) -> str:
    return f"{value:.{places}f} {unit}" if np.isfinite(value) else "not seen"


def size_checks(sizes: Sizes, limit: float) -> Iterator[Check]:
    """Checks of the sizes: a warning if the ratio to the stated one has a logarithm beyond a
    ``limit``."""
    low, high = np.exp(-limit), np.exp(limit)
    rig = sizes.rig
    parts = (("specimen", "specimen_size", sizes.specimen, rig.specimen_size, rig.millimetres),
             ("plate", "plate_size", sizes.plate, rig.plate_diameter,
              f"{1e3 * rig.plate_diameter:g}"))
    for name, code, size, one, stated in parts:
        ratio = size / one
        measured = "x".join(f"{ratio * float(side):.0f}" for side in stated.split("x"))
        shown = f"{measured} mm (stated: {stated})" if np.isfinite(size) else "not seen"
        yield Check(name, shown, Finding(code, {
            "value": float(ratio),
            "low": float(low),
            "high": float(high),
            "measured": measured,
            "stated": stated}) if ratio < low or ratio > high else None)


def coefficient_check(coefficient: float, limit: float) -> Check:
    """Check of a drape coefficient, from 0 to 1: a warning if it exceeds a ``limit``."""
    return Check("drape coefficient", _shown(100 * coefficient, "%"), _beyond(
        "coefficient_impossible", float(coefficient), limit))


def require_plate(quality: Quality) -> None:
    """Raise InputError if the views cannot show cloth of the stated size on the stated plate."""
    sizes = size_checks(quality.sizes, REFUSED_SIZE_ERROR) if quality.sizes.views > 1 else ()
    coefficient = coefficient_check(quality.coefficient, MAX_COEFFICIENT)
    if wrong := warnings_of([*sizes, coefficient]):
        raise InputError(wrong[0].text)
    if quality.off_plate > MAX_OFF_PLATE:
        raise InputError(
            f"{quality.off_plate:.0%} of the points over the plate's middle lie more than "
            f"{1e3 * _PLATE_TOLERANCE:g} mm off its plane (limit {MAX_OFF_PLATE:.0%}), so what was "
            "found is not a drape on a plate; check that the pictures are upright, neither turned "
            "nor mirrored, that all show the cloth, and the tester; "
            "python -m apps.capture shows what was cut out")


def _flatness(points: np.ndarray, rig: Rig) -> tuple[float, float]:
    """Bulge of the cloth on the plate, m, of a fitted paraboloid, and share of the points over the
    plate that are off its plane.
    """
    reach = INNER_SHARE * rig.plate_radius
    over = points[np.hypot(points[:, 0], points[:, 1]) < reach]
    flat = np.abs(over[:, 2]) < _PLATE_TOLERANCE
    x, y, z = over[flat].T
    if len(z) < 30:
        return np.nan, 1.0
    design = np.column_stack([np.ones(len(z)), x, y, (x**2 + y**2) / reach**2])
    return -float(np.linalg.lstsq(design, z, rcond=None)[0][3]), 1.0 - float(flat.mean())


def _cut(view: np.ndarray) -> float:
    """Maximum share of a view's border whose depths are within :data:`_CUT_TOLERANCE`."""
    cloth = binary_fill_holes(view > 0)
    border = cloth & ~binary_erosion(cloth) & (view > 0)
    depths = np.sort(view[border])
    if len(depths) < 20:
        return np.nan
    last = np.searchsorted(depths, depths + _CUT_TOLERANCE, side="right") - np.arange(len(depths))
    return float(last.max() / len(depths))


@cache
def coefficients() -> np.ndarray:
    """(6 B,) the regression's coefficients, of :func:`offset_features`."""
    return np.array(json.loads(SPECIMEN_OFFSET.read_text(encoding="utf-8"))["coefficients"])


def specimen_offset(drape: RadialMap, rig: Rig) -> Metres:
    """Offset of the specimen's centre from the plate's axis, regressed on a map."""
    return rig.specimen_size * float(np.abs(offset_features(drape, rig) @ coefficients()))


def offset_features(drape: RadialMap, rig: Rig) -> np.ndarray:
    """(6 B,) complex first harmonics of the distances, in sizes, and of the visibility, in bands of
    elevation; in turn of any tester, by its proportions, and of a disc."""
    around = np.exp(1j * AZIMUTH)
    waves = np.concatenate([
        around @ values.reshape(AZIMUTHS, -1, _BAND).mean(axis=2) / AZIMUTHS
        for values in (drape.distance / rig.specimen_size, (drape.weight > 0).astype(float))])
    return np.concatenate([waves, waves * (rig.plate_diameter / rig.specimen_size),
                           waves * (rig.specimen == "disc")])
