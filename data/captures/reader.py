"""Reading and checking of captures: folders with depth pictures, or an outline, of one specimen.

    description -> frames -> intrinsics -> turns -> cut-out -> checks

Two formats are recognised by their files:

- ``capture.yaml`` with one to eight views in files of depth (:mod:`data.captures.frames`), with an
  outline seen from above (:mod:`data.captures.photograph`), or with a drape coefficient alone;
- ``density.txt`` with ``0.png`` to ``3.png``: the sets published with Feng et al. 2022, 8-bit grey,
  count/255 = metres, background 0 or above 250, of the square, with its camera's intrinsics.
"""

import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from common.documents import misnamed, read_text, read_yaml, rename_remedy
from common.errors import InputError, of, one_line, shown
from common.findings import Finding
from common.types import Metres
from data.captures.board import board_intrinsics, board_turns, shows_board
from data.captures.capture import Capture, DepthCapture, OutlineCapture, ReportedCapture
from data.captures.cutout import cut_out
from data.captures.description import (
    INTRINSICS_KEYS,
    OUTLINE_TABLES,
    Description,
    OutlineSource,
    checked_density,
    whole_turns,
)
from data.captures.frames import join_views, numbered, read_frames, read_picture, views_in
from data.captures.view_checks import checked_views
from data.pictures.reading import SUFFIXES
from data.render.cameras import Intrinsics, nominal_camera
from data.rigs import MISSING_TESTER
from sim.rig import SQUARE_RIG

OUTLINE_SUFFIXES = (*SUFFIXES, *OUTLINE_TABLES)
DESCRIPTION = "capture.yaml"
CAPTURE_FILES = (DESCRIPTION, "density.txt")
"""Files that identify a capture folder: one for each format."""
MAX_PICTURES = 6  # of one drape over the mat
MAX_SPACING = 3.5e-3  # m, between points on the cloth
PUBLISHED_SIZES = {(240, 180): 1, (480, 360): 2}  # size: keep every n-th pixel
PUBLISHED_BACKGROUND = 250  # counts above are background
MAX_FOCAL = 238.0  # pixels, 2.1 mm a pixel at 0.5 m; finer pictures are subsampled to no less


def read_capture(path: str | Path) -> Capture:
    """Read a capture folder of either format; InputError for anything that makes it unusable."""
    path = Path(path)
    try:
        with of(path):
            return _read(path)
    except OSError as error:
        raise InputError(f"capture {path} cannot be read ({one_line(error)}); check its "
                         "permissions") from None


def _read(path: Path) -> Capture:
    if not path.exists():
        raise InputError("the folder does not exist; check the path")
    if not path.is_dir():
        raise InputError("this is not a folder; give the folder with capture.yaml")
    if (path / DESCRIPTION).exists():
        return _read_metric(path)
    if (path / "density.txt").exists():
        return _read_published(path)
    if other := misnamed(os.listdir(path), DESCRIPTION):
        raise InputError(rename_remedy(DESCRIPTION), source=path / other)
    raise InputError("the folder has neither capture.yaml nor density.txt; write capture.yaml "
                     "with density_g_m2, tester, and intrinsics or outline")


def _read_metric(path: Path) -> Capture:
    file = path / "capture.yaml"
    description = Description.of(read_yaml(file), file)
    if outlines := outline_files(path):
        return _read_outline(path, outlines[0], description)
    if description.outline:
        others = sorted(set(found.name for found in path.iterdir()) - {file.name})
        raise InputError(f"has the key outline, but there is no outline.jpg, .heic, .png, "
                         f".tif, .csv or .txt (the folder holds "
                         f"{', '.join(others)[:80] or 'no other'}); name the photograph so, or "
                         "leave the key out", source=file, joint=" ")
    if description.reported and not views_in(path):
        return ReportedCapture(**_stated(path, description), warnings=description.questions)
    frames = read_frames(path, description)
    depth, background = frames.depth, frames.background
    count, height, width = depth.shape
    board = frames.color if frames.color is not None and shows_board(frames.color) else None
    intrinsics = frames.intrinsics
    if intrinsics is None:
        intrinsics = (board_intrinsics(board) if board is not None else
                      description.stated_camera(width, height))
    if board is not None and description.turns_deg is None:
        turns = board_turns(board, intrinsics)
    else:
        turns = description.turns(count)
    step = max(int(intrinsics.fx / MAX_FOCAL), 1)
    if step > 1:
        first = step // 2  # pixels in the middle of those that they stand for
        depth = depth[:, first::step, first::step]
        background = None if background is None else background[first::step, first::step]
        numbers = {key: (getattr(intrinsics, key) - first * key.startswith("c")) / step
                   for key in INTRINSICS_KEYS}
        intrinsics = Intrinsics(**numbers, width=depth.shape[2], height=depth.shape[1])
    stated = _stated(path, description)
    cut = cut_out(depth, intrinsics, stated["rig"], background)
    views, warnings = checked_views(cut.views if cut else depth, intrinsics)
    warnings = (*description.questions, *(cut.warnings if cut else ()), *warnings, *_sparse(
        frames.spacing, float(np.median(views[views > 0])) / (step * intrinsics.fx)))
    return DepthCapture(views, intrinsics, turns, cut, **stated, warnings=warnings)


def _sparse(spacing: float, pixel: Metres) -> tuple[Finding, ...]:
    """A warning of points ``spacing`` pixels apart on the cloth; InputError if that is too far."""
    apart = Finding("depth_sparse", {"value": 1e3 * spacing * pixel, "limit": 1e3 * MAX_SPACING,
                                     "pixels": float(spacing)})
    if spacing > 1 and spacing * pixel > MAX_SPACING:
        raise InputError(apart.text)
    return (apart,) * (spacing > 1)


def _stated(path: Path, description: Description) -> dict[str, Any]:
    """What captures of all kinds have of their description."""
    if description.tester is None:
        raise InputError(f"states no tester; {MISSING_TESTER}",
                         source=path / DESCRIPTION, joint=" ")
    return {"density": description.density, "rig": description.tester, "path": path,
            "warp_direction": description.warp_direction, "face": description.face,
            "known": description.known, "labels": description.labels}


def find_outline(folder: Path) -> Path | None:
    """The first of :func:`outline_files`."""
    return next(iter(outline_files(folder)), None)


def outline_files(folder: Path) -> list[Path]:
    """The file ``outline.*`` in the folder of a capture, or its pictures of one drape,
    ``outline_1`` to ``outline_6``, of which ``outline`` may be one."""
    found: dict[int, Path] = {}
    for file in sorted(folder.iterdir()):
        called = re.fullmatch(r"outline([\W_]*(\d+)[\W_]*)?", file.stem, re.IGNORECASE)
        if not called or file.suffix.lower() not in OUTLINE_SUFFIXES:
            continue
        number = int(called[2] or 1)
        table = next((one for one in found.values() if one.suffix.lower() in OUTLINE_TABLES), None)
        if other := table or found.get(number):
            raise InputError(f"holds {other.name} and {file.name}; keep one of them",
                             source=folder, joint=" ")
        if file.stem != "outline" and (file.suffix.lower() in OUTLINE_TABLES or not re.fullmatch(
                f"outline_[1-{MAX_PICTURES}]", file.stem)):
            raise InputError(f"holds {shown(file.name)}; an outline is called outline, pictures of "
                             f"one drape outline_1 to outline_{MAX_PICTURES}: rename it, or take "
                             "it away", source=folder, joint=" ")
        found[number] = file
    return [found[number] for number in sorted(found)]


def _read_outline(path: Path, file: Path, description: Description) -> OutlineCapture:
    if view := next(iter(views_in(path).values()), None):
        raise InputError(f"holds {file.name} and {view}; give depth views and outlines in "
                         "different folders", source=path, joint=" ")
    for key in ("depth_unit_m", "intrinsics", "turns_deg", "size_px"):
        if getattr(description, key) is not None:
            raise InputError(f"{key} is of depth views, but the folder "
                             f"holds {file.name}; leave it out", source=path / DESCRIPTION)
    stated = _stated(path, description)
    from data.captures.photograph import read_outline  # half a second, which views need not spend

    if stated["warp_direction"] is None and description.marked:
        stated["warp_direction"] = 0.0
    outline = read_outline(file, description.outline or OutlineSource(), stated["rig"],
                           stated["warp_direction"])
    return OutlineCapture(outline, **stated,
                          warnings=(*description.questions, *outline.warnings))


def _read_published(path: Path) -> DepthCapture:
    file = path / "density.txt"
    lines = [line.split() for line in read_text(file).splitlines() if line.strip()]
    if len(lines) != 1 or len(lines[0]) > 2:
        raise InputError("must hold one line such as 'data0 300' (g/m2)", source=file, joint=" ")
    density = checked_density(lines[0][-1], f"{file}")
    counts = join_views({picture: read_picture(picture, modes={"L"}, kind="8-bit grey")
                         for picture in numbered(path, "{}.png")})
    height, width = counts.shape[1:]
    if (width, height) not in PUBLISHED_SIZES:
        raise InputError(f"pictures have {width}x{height} pixels; the 8-bit format has 240x180 or "
                         "480x360: export them in one of these sizes")
    keep = PUBLISHED_SIZES[width, height]
    counts = counts[:, ::keep, ::keep]
    depth = np.where(counts > PUBLISHED_BACKGROUND, 0, counts / 255).astype(np.float32)
    camera = nominal_camera(SQUARE_RIG).intrinsics
    views, warnings = checked_views(depth, camera)
    return DepthCapture(views, camera, whole_turns(len(views)), density=density, rig=SQUARE_RIG,
                        path=path, warnings=(Finding("depth_coarse"), *warnings))
