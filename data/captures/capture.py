"""Reading, checking and writing of captures: folders with depth pictures of one specimen.

Two formats are recognised by their files:

- ``capture.yaml`` with ``view_0.png`` and so on, one to eight, usually four: 16-bit grey, depth in
  units of ``depth_unit_m`` (default millimetres), 0 for missing depth, any size with matching
  intrinsics; or other files of depth (:mod:`data.captures.frames`).
- ``density.txt`` with ``0.png`` to ``3.png``: the sets published with Feng et al. 2022, 8-bit grey,
  count/255 = metres, background 0 or above 250, 240x180 or 480x360 pixels (every second one is
  used), of the square on its cylinder, with the intrinsics of its camera.

In frames of the full scene, in the first format, the cloth is cut out
(:mod:`data.captures.cutout`); other frames show only cloth. All content is validated; a fault
raises an InputError of one line that names the file.
"""

import hashlib
import math
import os
import tempfile
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import yaml
from PIL import Image
from pydantic import Field
from scipy import ndimage

from common.documents import Schema, read_text, read_yaml, shown
from common.errors import InputError, one_line
from data.captures.board import board_intrinsics, board_turns, shows_board
from data.captures.cutout import CutOut, cut_out, is_raw
from data.captures.frames import read_frames
from data.captures.pictures import (
    MAX_PICTURE,
    MAX_VIEWS,
    join_views,
    neighbours,
    numbered,
    read_picture,
)
from data.captures.plate import plate_diameter
from data.render.cameras import Intrinsics, nominal_camera
from data.testers import Tester, described_tester, named_tester, tester_choices
from sim.rig import SQUARE_RIG, Rig

CAPTURE_FILES = ("capture.yaml", "density.txt")
"""Files that identify a capture folder: one for each format."""
DENSITY_RANGE = (10.0, 1000.0)  # g/m2
MAX_DENSITY_DIFFERENCE = 0.1  # between specimens of one fabric, relative to the smallest
DISTANCE_RANGE = (0.2, 2.0)  # m, of the cloth; otherwise the depth unit is wrong
CLOTH_SHARE = (0.005, 0.9)  # of a picture's pixels
MIN_AREA = 0.6  # of the median of the views' cloth
MAX_SPECK_SHARE = 0.01  # of the cloth's pixels; smaller separate pieces are removed
OUTLIER_STEP = 0.025  # m, depth difference from the neighbours
MAX_OUTLIER_SHARE = 0.003  # of the cloth's pixels, usual for sensors; more cause a warning
MIN_SPECK_GAP = 3.0  # pixels from the cloth; nearer specks are harmless noise at its edge
PUBLISHED_SIZES = {(240, 180): 1, (480, 360): 2}  # size: keep every n-th pixel
PUBLISHED_BACKGROUND = 250  # counts above are background
MIN_EQUAL_TURNS = 4  # views, from which on equally spaced turns are the default
MIN_TURN = 6.3  # degrees; the largest turn given in radians is 6.28
MAX_WIDTH = 400  # pixels; larger pictures are subsampled
INTRINSICS_KEYS = ("fx", "fy", "cx", "cy")


class _Density(Schema):
    density_g_m2: float = Field(
        ge=DENSITY_RANGE[0], le=DENSITY_RANGE[1],
        description="weigh the specimen, give its g/m² and check the unit")


_Focal = Annotated[float, Field(ge=10, le=1e5)]


class _Pixels(Schema):
    fx: _Focal
    fy: _Focal
    cx: float
    cy: float


class Description(_Density):
    """``capture.yaml``: density, g/m²; depth unit, m; intrinsics, px; turns and direction, °; size
    of the picture to which points are projected, px; tester; face of the fabric that is on top.
    """

    depth_unit_m: float | None = Field(None, gt=0, description="0.001 for millimetres")
    intrinsics: _Pixels | None = Field(
        None, description="give fx, fy, cx and cy in pixels, such as {fx: 305.0, fy: 305.0, "
                          "cx: 119.5, cy: 89.5}")
    turns_deg: list[float] | None = Field(
        None, description="one angle for each view, such as [0, 90, 180, 270]")
    warp_direction_deg: float | None = None
    tester: Tester | None = None
    face: Literal["up", "down"] = "up"
    size_px: list[Annotated[int, Field(ge=1, le=max(MAX_PICTURE))]] | None = Field(
        None, min_length=2, max_length=2, description="width and height, such as [640, 480]")


@dataclass(frozen=True)
class Capture:
    """Views of one specimen on a turntable.

    Attributes:
        views: (K, H, W) float32 z-depth in metres, background 0.
        intrinsics: of these pictures.
        turns: (K,) nominal turns of the table since the first view, rad.
        density: kg/m2.
        warp_direction: angle of the warp direction in the first view, in [0, pi) radians, 0 to
            the right in the picture, pi/2 away from the camera; None when it is not marked.
        rig: the tester.
        path: its folder.
        warnings: one line each, for the report.
        cut: result of cutting out the cloth; None if the frames showed only cloth.
        face: "up" if the face of the fabric that the laboratory has marked is on top, else "down".
    """

    views: np.ndarray
    intrinsics: Intrinsics
    turns: np.ndarray
    density: float
    warp_direction: float | None
    rig: Rig
    path: Path
    warnings: tuple[str, ...]
    cut: CutOut | None = None
    face: str = "up"

    @property
    def digest(self) -> str:
        """SHA-256 of the views."""
        return hashlib.sha256(self.views.tobytes()).hexdigest()


def read_capture(path: str | Path) -> Capture:
    """Read and check a capture folder of either format.

    Raises:
        InputError: anything that makes the capture unusable.
    """
    path = Path(path)
    try:
        return _read(path)
    except OSError as error:
        raise InputError(f"capture '{path}' cannot be read ({one_line(error)}); check its "
                         "permissions") from None


def _read(path: Path) -> Capture:
    if not path.exists():
        raise InputError(f"capture folder '{path}' does not exist; check the path")
    if not path.is_dir():
        raise InputError(f"capture '{path}' is not a folder; give the folder with the views")
    if (path / "capture.yaml").exists():
        return _read_metric(path)
    if (path / "density.txt").exists():
        return _read_published(path)
    if (path / "capture.yml").exists():
        raise InputError(f"{path / 'capture.yml'}: rename it to capture.yaml")
    raise InputError(
        f"capture folder '{path}' has neither capture.yaml nor density.txt; "
        "write capture.yaml with density_g_m2, tester and intrinsics"
    )


def captures_in(path: Path) -> list[Path]:
    """Capture folders in ``path``, sorted: itself, or those in a folder of captures or of samples.

    Raises:
        InputError: ``path`` is a folder of fabrics.
    """
    if not path.is_dir() or any((path / name).exists() for name in CAPTURE_FILES):
        return [path]
    for below in ("*", "*/*", "*/*/*"):
        found = sorted({file.parent for name in CAPTURE_FILES
                        for file in path.glob(f"{below}/{name}")})
        if found and below.count("/") == 2:
            raise InputError(f"{path} looks like FABRIC/SAMPLE/CAPTURE ({found[0]}): give "
                             f"captures={path} for an estimate of each fabric")
        if found:
            return found
    return [path]


def require_one_fabric(
    rigs: Iterable[Rig | str], marked: Iterable[bool], densities: Sequence[float],
    digests: Iterable[tuple[str, str]],
) -> None:
    """InputError for captures that cannot be combined in the estimate of one fabric.

    Args:
        rigs: of the captures, or their names.
        marked: whether each states the warp direction.
        densities: kg/m².
        digests: name and :attr:`Capture.digest` of each.
    """
    names: dict[str, str] = {}
    for name, digest in digests:
        if digest in names:
            raise InputError(f"{names[digest]} and {name} have the same views, which are not "
                             "independent; give each capture once")
        names[digest] = name
    for right, values in (("have the same tester", set(rigs)),
                          ("state warp_direction_deg, or none of them", set(marked))):
        if len(values) > 1:
            raise InputError(f"captures of one fabric must all {right}; estimate those that differ "
                             "as another fabric")
    low, high = min(densities), max(densities)
    if high > (1 + MAX_DENSITY_DIFFERENCE) * low:
        raise InputError(f"captures of one fabric state densities from {1e3 * low:g} to "
                         f"{1e3 * high:g} g/m², more than {MAX_DENSITY_DIFFERENCE:.0%} apart; "
                         "correct density_g_m2, or give different fabrics apart")


def write_capture(
    path: str | Path,
    *,
    views: np.ndarray,
    intrinsics: Intrinsics,
    density: float,
    rig: Rig,
    warp_direction: float | None = None,
    turns: np.ndarray | None = None,
    face: str = "up",
    depth_unit: float = 1e-3,
    background: np.ndarray | None = None,
) -> None:
    """Write a capture in the 16-bit format to a new or empty folder, in one step.

    Args:
        views: (K, H, W) z-depth in metres, background 0.
        density: kg/m²; warp_direction: radians in the first view; depth_unit: metres per count.
        rig: the tester. face: of the fabric on top, "up" or "down".
        turns: (K,) nominal turns of the table, rad; None: equally spaced.
        background: (H, W) z-depth of the scene without cloth, m.

    Raises:
        InputError: wrong shape, a tester outside the limits, depth that does not fit 16 bits, a
            folder that is not empty or cannot be written.
    """
    path = Path(path)
    views = np.asarray(views)
    named_tester(rig.name)
    if views.shape[1:] != (intrinsics.height, intrinsics.width):
        raise InputError(f"views have the shape {views.shape}, but the intrinsics are for "
                         f"{intrinsics.width}x{intrinsics.height} pixels; give the intrinsics of "
                         "this picture size")
    if not 1 <= len(views) <= MAX_VIEWS:
        raise InputError(f"{len(views)} views given; a capture has 1 to {MAX_VIEWS}")
    pictures = {f"view_{k}": view for k, view in enumerate(views)}
    if background is not None:
        pictures["background"] = background
    counts = np.rint(np.stack(list(pictures.values())) / depth_unit)
    if not (np.isfinite(counts).all() and counts.min() >= 0 and counts.max() <= 65535):
        raise InputError(f"depth from {depth_unit * counts.min():.4g} to "
                         f"{depth_unit * counts.max():.4g} m does not fit 16 bits at "
                         f"{depth_unit:g} m per count; choose a larger depth_unit")
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise InputError(f"'{path}' exists already; remove it or choose another folder")
    description = {
        "density_g_m2": round(density * 1e3, 6),
        "depth_unit_m": depth_unit,
        "intrinsics": {key: float(getattr(intrinsics, key)) for key in INTRINSICS_KEYS},
        "tester": described_tester(rig),
        "face": face,
    }
    if turns is None and 1 < len(views) < MIN_EQUAL_TURNS:
        turns = whole_turns(len(views))
    if turns is not None:
        description["turns_deg"] = np.degrees(turns).round(6).tolist()
    if warp_direction is not None:
        description["warp_direction_deg"] = round(math.degrees(warp_direction), 6)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as temporary:
            folder = Path(temporary) / path.name
            folder.mkdir()
            for name, picture in zip(pictures, counts.astype(np.uint16), strict=True):
                Image.fromarray(picture).save(folder / f"{name}.png")
            text = yaml.safe_dump(description, sort_keys=False)
            (folder / "capture.yaml").write_text(text, encoding="utf-8")
            os.replace(folder, path)
    except OSError as error:
        reason = error.strerror or one_line(error)
        raise InputError(f"cannot write the capture {path}: {reason}") from None


def whole_turns(count: int) -> np.ndarray:
    """(count,) equally spaced turns of the table, rad."""
    return np.arange(count) * (2 * np.pi / count)


def _read_metric(path: Path) -> Capture:
    file = path / "capture.yaml"
    known = Description.of(read_yaml(file), file)
    found = read_frames(
        path, known.depth_unit_m,
        lambda width, height: _intrinsics(known.intrinsics, file, width, height), known.size_px)
    views, background = found.frames, found.background
    height, width = views.shape[1:]
    intrinsics = found.intrinsics
    board = found.color is not None and shows_board(found.color)
    if board and intrinsics is None and known.intrinsics is None:
        intrinsics = board_intrinsics(found.color)
    elif intrinsics is None or known.intrinsics is not None:
        intrinsics = _intrinsics(known.intrinsics, file, width, height)
    turns = (board_turns(found.color, intrinsics) if board and known.turns_deg is None
             else _turns(known.turns_deg, file, len(views)))
    step = -(-width // MAX_WIDTH)
    if step > 1:
        views = views[:, ::step, ::step]
        intrinsics = Intrinsics(**{key: getattr(intrinsics, key) / step
                                   for key in INTRINSICS_KEYS},
                                width=views.shape[2], height=views.shape[1])
    if known.tester is None:
        seen = plate_diameter(views, intrinsics)
        raise InputError(f"{file} states no tester; {tester_choices(seen)}")
    cut = _cut(path, views, intrinsics, known.tester,
               None if background is None else background[::step, ::step])
    views = cut.views if cut else views
    direction = known.warp_direction_deg
    capture = checked_capture(
        path, views, intrinsics, turns, 1e-3 * known.density_g_m2,
        None if direction is None else math.radians(direction) % math.pi, known.tester,
        cut.warnings if cut else ())
    return replace(capture, cut=cut, face=known.face)


def _cut(
    path: Path, frames: np.ndarray, intrinsics: Intrinsics, rig: Rig,
    background: np.ndarray | None,
) -> CutOut | None:
    """Cut the cloth out of frames (K, H, W), m, of full scenes; None if they show only cloth."""
    if not any(is_raw(frame, intrinsics, rig) for frame in frames):
        return None
    try:
        return cut_out(frames, intrinsics, rig, background)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _read_published(path: Path) -> Capture:
    density = checked_density(*_read_density(path / "density.txt"))
    counts = join_views({file: read_picture(file, modes={"L"}, kind="8-bit grey")
                         for file in numbered(path, "{}.png")})
    height, width = counts.shape[1:]
    if (width, height) not in PUBLISHED_SIZES:
        raise InputError(
            f"{path}: pictures have {width}x{height} pixels; the 8-bit format has 240x180 or "
            "480x360: export them in one of these sizes")
    keep = PUBLISHED_SIZES[width, height]
    counts = counts[:, ::keep, ::keep]
    views = np.where(counts > PUBLISHED_BACKGROUND, 0, counts / 255).astype(np.float32)
    warning = "8-bit depth: steps of 3.9 mm; 16-bit pictures in millimetres carry more"
    intrinsics = nominal_camera(SQUARE_RIG).intrinsics
    return checked_capture(path, views, intrinsics, whole_turns(len(views)), density, None,
                           SQUARE_RIG, (warning,))


def checked_capture(
    path: Path,
    views: np.ndarray,
    intrinsics: Intrinsics,
    turns: np.ndarray,
    density: float,
    warp_direction: float | None,
    rig: Rig,
    warnings: tuple[str, ...],
) -> Capture:
    """Build a capture: remove specks, check size and distance of the cloth, collect warnings.

    Views (K, H, W), m, turns (K,) and the warp's direction, rad, density, kg/m².
    """
    views = views.copy()
    for k, view in enumerate(views):
        warnings += _remove_isolated(view, f"view {k}")
        warnings += _remove_specks(view, f"view {k}")
        cloth = view > 0
        if not cloth.any():
            raise InputError(f"{path}: view {k} shows no cloth: all pixels are background or "
                             "specks; take the view again")
        if cloth.mean() < CLOTH_SHARE[0]:
            raise InputError(
                f"{path}: view {k} shows only {cloth.sum()} pixels of cloth, at least "
                f"{CLOTH_SHARE[0] * cloth.size:.0f} are needed; move the camera nearer")
        distance = float(np.median(view[cloth]))
        if not DISTANCE_RANGE[0] <= distance <= DISTANCE_RANGE[1]:
            raise InputError(
                f"{path}: view {k}: the cloth is {distance:.4g} m from the camera; it must be "
                f"{DISTANCE_RANGE[0]:g} to {DISTANCE_RANGE[1]:g} m away: check depth_unit_m "
                "(0.001 for millimetres)")
        if cloth.mean() > CLOTH_SHARE[1]:
            raise InputError(
                f"{path}: view {k} has no background; set every pixel that is not cloth to 0"
            )
        border = np.concatenate([cloth[0], cloth[-1], cloth[:, 0], cloth[:, -1]])
        if border.any():
            warnings += (f"view {k}: the cloth touches the picture's border",)
    areas = (views > 0).sum(axis=(1, 2))
    if areas.min() < MIN_AREA * np.median(areas):
        warnings += (f"view {areas.argmin()} shows {areas.min()} pixels of cloth, less than "
                     f"{MIN_AREA:.0%} of the median of the views, {np.median(areas):.0f}: take "
                     "it again if the cloth was missing or hidden",)
    return Capture(views, intrinsics, turns, density, warp_direction, rig, path, warnings)


def _remove_isolated(view: np.ndarray, name: str) -> tuple[str, ...]:
    """Set isolated outliers of a view (H, W) to background, in place; return warnings.

    A pixel is isolated if fewer than two neighbours have a similar depth. Depth also jumps at
    folds, but there a pixel has neighbours on the same fold.
    """
    cloth = view > 0
    adjacent = neighbours(view)
    near = ((np.abs(adjacent - view) < OUTLIER_STEP) & (adjacent > 0)).sum(axis=0)
    isolated = cloth & (near < 2) & (ndimage.median_filter(cloth.astype(np.uint8), 3) > 0)
    view[isolated] = 0
    if isolated.sum() <= MAX_OUTLIER_SHARE * cloth.sum():
        return ()
    return (f"{name}: {isolated.sum()} pixels left out whose depth differs from their neighbours'; "
            "check the sensor's settings",)


def _remove_specks(view: np.ndarray, name: str) -> tuple[str, ...]:
    """Set small pieces of a view (H, W) apart from its cloth to background, in place; warnings.

    The network's input is the bounding window of the foreground: a single distant pixel, as from a
    time-of-flight sensor, moves it and halves the moduli. Larger pieces are kept with a warning, as
    they may be cloth.
    """
    pieces, count = ndimage.label(view > 0, structure=np.ones((3, 3)))
    if count < 2:
        return ()
    sizes = np.bincount(pieces.ravel())[1:]
    cloth = 1 + int(sizes.argmax())
    gap = ndimage.minimum(ndimage.distance_transform_edt(pieces != cloth), pieces,
                          index=np.arange(1, count + 1))
    apart = gap > MIN_SPECK_GAP
    specks = apart & (sizes < MAX_SPECK_SHARE * sizes.max())
    warnings = ()
    view[np.isin(pieces, 1 + np.flatnonzero(specks))] = 0
    if (removed := int(sizes[specks].sum())) > MAX_OUTLIER_SHARE * sizes.sum():
        warnings += (f"{name}: {removed} pixels left out that lie apart from the cloth",)
    if large := int(sizes[apart & ~specks].sum()):
        warnings += (f"{name}: {large} pixels lie apart from the cloth; set to 0 what is not "
                     "cloth",)
    return warnings


def _read_density(file: Path) -> tuple[str, str]:
    """The number in ``density.txt`` (one line, 'name value') and the file's name for messages."""
    lines = [line.split() for line in read_text(file).splitlines() if line.strip()]
    if len(lines) != 1 or len(lines[0]) > 2:
        raise InputError(f"{file} must hold one line such as 'data0 300' (g/m2)")
    return lines[0][-1], f"{file}"


def checked_density(value: object, what: str = "") -> float:
    """Density in kg/m2 from g/m2; InputError, which names the file ``what``, if out of range."""
    with suppress(TypeError, ValueError):
        value = float(value) if isinstance(value, str) else value
    return 1e-3 * _Density.of({} if value is None else {"density_g_m2": value}, what).density_g_m2


def _turns(degrees: list[float] | None, file: Path, count: int) -> np.ndarray:
    example = [round(360 * k / max(count, 4)) for k in range(count)]
    if degrees is None:
        if 1 < count < MIN_EQUAL_TURNS:
            raise InputError(f"{file}: turns_deg is missing, and {count} views need not be equally "
                             f"spaced; state the table's angles, such as turns_deg: {example}")
        return whole_turns(count)
    if len(degrees) != count:
        raise InputError(f"{file}: turns_deg={shown(degrees)}: give one angle for each of the "
                         f"{count} views, such as {example}")
    if 0 < (largest := max(map(abs, degrees))) <= MIN_TURN:
        raise InputError(f"{file}: turns_deg={shown(degrees)} reach only {largest:.3g}° (a full "
                         "turn in radians is 6.28); give degrees, of views from several sides")
    return np.radians(degrees) - np.radians(degrees[0])


def _intrinsics(pixels: _Pixels | None, file: Path, width: int, height: int) -> Intrinsics:
    if pixels is None:
        raise InputError(f"{file}: intrinsics is missing; "
                         f"{Description.model_fields['intrinsics'].description}")
    try:
        return Intrinsics(**pixels.model_dump(), width=width, height=height)
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
