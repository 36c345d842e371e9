"""Reading, checking and writing of captures: folders with depth pictures of one specimen.

    description -> frames -> intrinsics -> turns -> cut-out -> checks

Two formats are recognised by their files:

- ``capture.yaml`` with one to eight views in files of depth (:mod:`data.captures.frames`), or with
  an outline seen from above (:mod:`data.captures.photograph`);
- ``density.txt`` with ``0.png`` to ``3.png``: the sets published with Feng et al. 2022, 8-bit grey,
  count/255 = metres, background 0 or above 250, of the square, with its camera's intrinsics.
"""

import hashlib
import math
import os
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import yaml
from PIL import Image

from common.documents import misnamed, read_text, read_yaml, rename_remedy
from common.errors import InputError, one_line
from common.files import path_named
from common.types import Density, DepthImage, Metres, Radians, Turns, Views
from data.captures.board import board_intrinsics, board_turns, shows_board
from data.captures.cutout import CutOut, cut_out
from data.captures.description import (
    INTRINSICS_KEYS,
    MIN_EQUAL_TURNS,
    OUTLINE_TABLES,
    PARALLEL,
    UNLABELLED,
    Description,
    Labels,
    OutlineSource,
    checked_density,
    whole_turns,
)
from data.captures.frames import join_views, numbered, read_frames, read_picture, views_in
from data.captures.reported import Reported
from data.captures.view_checks import checked_views, require_sizes
from data.pictures.reading import SUFFIXES
from data.render.cameras import Intrinsics, nominal_camera
from data.rigs import MISSING_TESTER, described_tester
from sim.rig import SQUARE_RIG, Rig

if TYPE_CHECKING:
    from data.captures.photograph import PhotographedOutline

OUTLINE_SUFFIXES = (*SUFFIXES, *OUTLINE_TABLES)
DESCRIPTION = "capture.yaml"
CAPTURE_FILES = (DESCRIPTION, "density.txt")
"""Files that identify a capture folder: one for each format."""
MAX_DENSITY_DIFFERENCE = 0.1  # between specimens of one fabric, relative to the smallest
MAX_SPACING = 3.5e-3  # m, between points on the cloth
PUBLISHED_SIZES = {(240, 180): 1, (480, 360): 2}  # size: keep every n-th pixel
PUBLISHED_BACKGROUND = 250  # counts above are background
MAX_FOCAL = 238.0  # pixels, 2.1 mm a pixel at 0.5 m; finer pictures are subsampled to no less


@dataclass(frozen=True)
class Capture:
    """Views of one specimen on a turntable, or its outline from above and no view.

    Attributes:
        turns: nominal, since the first view.
        warp_direction: in the first view, in [0, pi), 0 to the right in the picture, pi/2 away from
            the camera (up in a picture from above); None when it is not marked.
        cut: None if the frames showed only cloth.
        face: "up" if the face of the fabric that the laboratory has marked is on top, else "down".
    """

    views: Views
    intrinsics: Intrinsics | None
    turns: Turns
    density: Density
    warp_direction: Radians | None
    rig: Rig
    path: Path = Path("capture")
    warnings: tuple[str, ...] = ()
    cut: CutOut | None = None
    face: str = "up"
    outline: "PhotographedOutline | None" = None
    known: Reported | None = None
    labels: Labels = UNLABELLED

    @property
    def sign(self) -> int:
        """1 if the marked face is up, else -1."""
        return 1 if self.face == "up" else -1

    @property
    def numbers(self) -> bool:
        """Whether a drape coefficient stands in place of views and outline."""
        return self.outline is None and not len(self.views)

    @property
    def digest(self) -> str:
        """SHA-256 of the views, or of the outline."""
        content = self.views if self.outline is None else self.outline.curve
        if self.numbers:
            return hashlib.sha256(str(self.known).encode()).hexdigest()
        return hashlib.sha256(content.tobytes()).hexdigest()


def read_capture(path: str | Path) -> Capture:
    """Read a capture folder of either format; InputError for anything that makes it unusable."""
    path = Path(path)
    try:
        if not path.exists():
            raise InputError("the folder does not exist; check the path")
        if not path.is_dir():
            raise InputError("this is not a folder; give the folder with capture.yaml")
        if (path / "capture.yaml").exists():
            return _read_metric(path)
        if (path / "density.txt").exists():
            return _read_published(path)
        if other := misnamed(os.listdir(path), DESCRIPTION):
            raise InputError(f"{path / other}: {rename_remedy(DESCRIPTION)}")
        raise InputError("the folder has neither capture.yaml nor density.txt; write capture.yaml "
                         "with density_g_m2, tester, and intrinsics or outline")
    except OSError as error:
        raise InputError(f"capture {path} cannot be read ({one_line(error)}); check its "
                         "permissions") from None
    except InputError as error:
        place = "" if str(path) in str(error) else f"{path}: "
        raise InputError(f"{place}{error}") from None


def _read_metric(path: Path) -> Capture:
    file = path / "capture.yaml"
    description = Description.of(read_yaml(file), file)
    if outline := find_outline(path):
        return _read_outline(path, outline, description)
    if description.outline:
        others = sorted(set(found.name for found in path.iterdir()) - {file.name})
        raise InputError(f"{file} has the key outline, but there is no outline.jpg, .heic, .png, "
                         f".tif, .csv or .txt (the folder holds "
                         f"{', '.join(others)[:80] or 'no other'}); name the photograph so, or "
                         "leave the key out")
    if description.reported and not views_in(path):
        return Capture(np.zeros((0, 0, 0), np.float32), None, np.zeros(0), description.density,
                       description.warp_direction, _tester(path, description), path,
                       description.questions, face=description.face, known=description.known,
                       labels=description.labels)
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
    rig = _tester(path, description)
    cut = cut_out(depth, intrinsics, rig, background)
    views, warnings = checked_views(cut.views if cut else depth, intrinsics)
    notes = (*description.questions, *(cut.warnings if cut else ()), *warnings, *_sparse(
        frames.spacing, float(np.median(views[views > 0])) / (step * intrinsics.fx)))
    return Capture(views, intrinsics, turns, description.density, description.warp_direction,
                   rig, path, notes, cut, description.face, known=description.known,
                   labels=description.labels)


def _sparse(spacing: float, pixel: Metres) -> tuple[str, ...]:
    """A warning of points ``spacing`` pixels apart on the cloth; InputError if that is too far."""
    apart = (f"depth is sparser than its pictures, a point every {spacing:.1f} pixels, "
             f"{1e3 * spacing * pixel:.1f} mm (at most {1e3 * MAX_SPACING:g} mm): record without "
             "decimation, without thinning of the cloud, not aligned to a larger picture")
    if spacing > 1 and spacing * pixel > MAX_SPACING:
        raise InputError(apart)
    return (apart,) * (spacing > 1)


def _tester(path: Path, description: Description) -> Rig:
    if description.tester is None:
        raise InputError(f"{path / 'capture.yaml'} states no tester; {MISSING_TESTER}")
    return description.tester


def find_outline(folder: Path) -> Path | None:
    """The file ``outline.*`` in the folder of a capture."""
    files = sorted(file for file in folder.glob("outline.*")
                   if file.suffix.lower() in OUTLINE_SUFFIXES)
    if len(files) > 1:
        raise InputError(f"{folder} holds {files[0].name} and {files[1].name}; keep one of them")
    return files[0] if files else None


def _read_outline(path: Path, file: Path, description: Description) -> Capture:
    if view := next(iter(views_in(path).values()), None):
        raise InputError(f"{path} holds {file.name} and {view}; give depth views and outlines in "
                         "different folders")
    for key in ("depth_unit_m", "intrinsics", "turns_deg", "size_px"):
        if getattr(description, key) is not None:
            raise InputError(f"{path / 'capture.yaml'}: {key} is of depth views, but the folder "
                             f"holds {file.name}; leave it out")
    rig = _tester(path, description)
    from data.captures.photograph import read_outline  # half a second, which views need not spend

    source, warp = description.outline or OutlineSource(), description.warp_direction
    if warp is None and description.marked:
        warp = 0.0
    outline = read_outline(file, source, rig, warp)
    return Capture(np.zeros((0, 0, 0), np.float32), None, np.zeros(0), description.density, warp,
                   rig, path,
                   (*description.questions, *outline.warnings), face=description.face,
                   outline=outline, known=description.known, labels=description.labels)


def _read_published(path: Path) -> Capture:
    file = path / "density.txt"
    lines = [line.split() for line in read_text(file).splitlines() if line.strip()]
    if len(lines) != 1 or len(lines[0]) > 2:
        raise InputError(f"{file} must hold one line such as 'data0 300' (g/m2)")
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
    coarse = "8-bit depth: steps of 3.9 mm; 16-bit pictures in millimetres carry more"
    return Capture(views, camera, whole_turns(len(views)), density, None, SQUARE_RIG, path,
                   (coarse, *warnings))


def captures_in(path: Path) -> list[Path]:
    """Capture folders in ``path``, sorted: itself, or those in a folder of captures or samples.

    Those whose description is misnamed are among them, so that none is left out in silence.
    """
    path = path_named(Path(), str(path))
    if not path.is_dir() or any((path / name).exists() for name in CAPTURE_FILES):
        return [path]
    for below in ("*", "*/*", "*/*/*"):
        folders = sorted({file.parent for file in path.glob(f"{below}/*")
                          if file.name in CAPTURE_FILES or misnamed([file.name], DESCRIPTION)})
        if folders and below.count("/") == 2:
            raise InputError(f"{path} looks like FABRIC/SAMPLE/CAPTURE ({folders[0]}): give "
                             f"captures={path} for an estimate of each fabric")
        if folders:
            return folders
    return [path]


def require_one_fabric(densities: Sequence[Density], digests: Iterable[tuple[str, str]]) -> None:
    """InputError for captures that cannot be combined; ``digests``: name and
    :attr:`Capture.digest` of each.
    """
    names: dict[str, str] = {}
    for name, digest in digests:
        if digest in names:
            raise InputError(f"{names[digest]} and {name} have the same views, which are not "
                             "independent; give each capture once")
        names[digest] = name
    low, high = min(densities), max(densities)
    if high > (1 + MAX_DENSITY_DIFFERENCE) * low:
        raise InputError(f"captures and strips of one fabric state densities from {1e3 * low:g} to "
                         f"{1e3 * high:g} g/m², more than {MAX_DENSITY_DIFFERENCE:.0%} apart; "
                         "correct density_g_m2, or give different fabrics apart")


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
    what :func:`read_capture` would refuse, and for depth that does not fit 16 bits.
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


def write_outline(capture: Capture, path: str | Path) -> None:
    """Write a capture of an outline, as numbers, to a new or empty folder, in one step."""
    outline = capture.outline
    assert outline, "a capture of an outline"
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
            (folder / "capture.yaml").write_text(text, encoding="utf-8")
            os.replace(folder, path)
    except OSError as error:
        reason = error.strerror or one_line(error)
        raise InputError(f"cannot write the capture {path}: {reason}") from None
