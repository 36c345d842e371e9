"""Writing of captures: a new folder, in one step, that :mod:`data.captures.reader` reads."""

import math
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import yaml
from PIL import Image

from common.errors import InputError, one_line
from common.types import Density, DepthImage, Metres, Radians, Turns, Views
from data.captures.capture import OutlineCapture
from data.captures.description import (
    INTRINSICS_KEYS,
    MIN_EQUAL_TURNS,
    PARALLEL,
    UNLABELLED,
    Description,
    Labels,
    whole_turns,
)
from data.captures.reader import DESCRIPTION
from data.captures.view_checks import require_sizes
from data.render.cameras import Intrinsics
from data.rigs import described_tester
from sim.rig import Rig


def write_capture(
    path: str | Path,
    *,
    views: Views,
    intrinsics: Intrinsics,
    density: Density,
    rig: Rig,
    warp_direction: Radians | None = None,
    turns: Turns | None = None,
    face: str = "up",
    depth_unit: Metres = 1e-3,
    background: DepthImage | None = None,
    labels: Labels = UNLABELLED,
) -> None:
    """Write a capture in the 16-bit format to a new or empty folder, in one step.

    ``turns`` are equally spaced if None; ``background`` is the scene without cloth. InputError for
    what the reader would refuse, and for depth that does not fit 16 bits.
    """
    path = Path(path)
    require_sizes(views, intrinsics)
    pictures = {f"view_{k}": view for k, view in enumerate(views)}
    if background is not None:
        pictures["background"] = background
    counts = np.rint(np.stack(list(pictures.values())) / depth_unit)
    if not (np.isfinite(counts).all() and counts.min() >= 0 and counts.max() <= 65535):
        raise InputError(f"depth from {depth_unit * counts.min():.4g} to "
                         f"{depth_unit * counts.max():.4g} m does not fit 16 bits at "
                         f"{depth_unit:g} m per count; choose a larger depth_unit")
    keys: dict[str, object] = {
        "depth_unit_m": depth_unit,
        "intrinsics": {key: float(getattr(intrinsics, key)) for key in INTRINSICS_KEYS}}
    if turns is None and 1 < len(views) < MIN_EQUAL_TURNS:
        turns = whole_turns(len(views))
    if turns is not None:
        keys["turns_deg"] = np.degrees(turns).round(6).tolist()

    def save(folder: Path) -> None:
        for name, picture in zip(pictures, counts.astype(np.uint16), strict=True):
            Image.fromarray(picture).save(folder / f"{name}.png")

    stated = described(density, rig, face, warp_direction, labels)
    Description.of(stated | keys, path)
    _write_folder(path, stated | keys, save)


def write_outline(capture: OutlineCapture, path: str | Path) -> None:
    """Write a capture of an outline, as numbers, to a new or empty folder, in one step."""
    outline = capture.outline
    source: dict[str, object] = {"unit": "mm", "centred": outline.centred}
    if not math.isnan(outline.height):
        source["camera_height_mm"] = PARALLEL if math.isinf(outline.height) else round(
            1e3 * outline.height, 6)
    description = described(capture.density, capture.rig, capture.face, capture.warp_direction,
                             capture.labels)
    _write_folder(Path(path), description | {"outline": source}, lambda folder: np.savetxt(
        folder / "outline.csv", 1e3 * outline.curve, fmt="%.3f", delimiter=",", header="x_mm,y_mm",
        comments=""))


def described(
    density: Density, rig: Rig, face: str, warp_direction: Radians | None, labels: Labels
) -> dict[str, object]:
    """The keys of capture.yaml that captures of all kinds have."""
    if warp_direction is not None and not abs(warp_direction) <= 2 * np.pi:
        raise InputError(f"warp_direction={warp_direction:g} is more than a turn; give radians")
    marked: dict[str, object] = {} if warp_direction is None else {
        "warp_direction_deg": round(math.degrees(warp_direction), 6)}
    return labels.stated() | {"density_g_m2": round(density * 1e3, 6),
                              "tester": described_tester(rig), "face": face} | marked


def _write_folder(path: Path, description: dict, save: Callable[[Path], None]) -> None:
    """Write capture.yaml and what ``save`` writes to a new or empty folder, in one step."""
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise InputError(f"'{path}' exists already; remove it or choose another folder")
    text = yaml.safe_dump(description, sort_keys=False)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as temporary:
            folder = Path(temporary) / path.name
            folder.mkdir()
            save(folder)
            (folder / DESCRIPTION).write_text(text, encoding="utf-8")
            os.replace(folder, path)
    except OSError as error:
        reason = error.strerror or one_line(error)
        raise InputError(f"cannot write the capture {path}: {reason}") from None
