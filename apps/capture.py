"""Check a capture while the specimen hangs, and cut out the cloth.

    python -m apps.capture frames=FOLDER out=DIR
    python -m apps.capture frames=ROOT out=DIR                all captures in the folders of ROOT
    python -m apps.capture mat=a3 out=mat.pdf [paper=a4] [ground=grey]
    python -m apps.capture board=board.png

FOLDER has capture.yaml and frames of the full scene, or of the cloth alone (docs/use.md), or its
outline from above, which is written as numbers, with a picture of curve and plate; or strips.yaml
and photographs of strips, whose curves are written as CSV, with a picture of each. Writes
the capture as 16-bit PNG with background 0 to DIR, and DIR/capture.png: each frame with the outline
of the cloth, the plate's rim and its axes; the hems of all frames from above, one colour per
frame, rotated back by turns_deg; and all checks that an estimate makes of a capture, with what is
measured, green or red. The exit code is 0 if all are green.

Of the captures of a ROOT, each is written to a folder of its own below DIR, beside DIR/checks.csv,
a line for each, and DIR/checks.png, their pictures; a capture that is refused does not stop it.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from common.cases import progress_bar
from common.command import command
from common.errors import InputError
from common.files import folder_named, replace_file, require_folder
from common.findings import texts
from data.captures.board import SQUARE, board_picture
from data.captures.capture import Capture, Check, DepthCapture, OutlineCapture, warnings_of
from data.captures.cutout import CutOut
from data.captures.plate import plate_of_cloth
from data.captures.preview import show
from data.captures.writer import write_capture, write_outline
from data.pictures.mat import BAR, CLEAR, MATS, mat_pages
from drapenet.fabric.entries import entries_of
from drapenet.measured.captures import Captured, observe
from drapenet.measured.read import is_measured, read_measured
from drapenet.network.checkpoint import read_header
from drapenet.result.tables import csv_table
from drapenet.views.checks import measure, require_plate, view_checks

DEPTH_UNIT = 1e-4  # m per count, finer than those of input files
PICTURE = "capture.png"
TILE = 360, 260, 20  # pixels of a picture in a contact sheet, and of its name


@dataclass
class CaptureConfig:
    """``configs/capture.yaml``."""

    frames: str
    out: str
    board: str
    mat: str
    paper: str
    ground: str


@command("capture", CaptureConfig)
def main(config: CaptureConfig) -> None:
    """Write the capture and its picture, and print its checks; or write a mat or a board."""
    if config.mat:
        file = Path(config.out or f"mat_{config.mat}.pdf")
        if file.suffix.lower() not in ("", ".pdf"):
            raise InputError(f"out={file}: a mat is a PDF; give a name that ends in .pdf")
        replace_file(file, mat_pages(config.mat, config.paper or config.mat, config.ground))
        clear = MATS[config.mat].clear if config.mat in MATS else None
        print(f"mat: {file}; print it at 100 %, join its pages if there are several, measure its "
              f"scale of {1e3 * BAR:g} mm, and state what you measure as mat_bar_mm." * bool(clear)
              + (f" Markers begin {1e3 * CLEAR:g} mm beyond hems that are seen {1e3 * clear:.0f} mm"
                 " from its middle" + "; for discs of 300 mm take mat=a2" * (config.mat == "a3")
                 if clear else f"sheet: {file}; print it at 100 %, and lay it on the foot, circles "
                 "and lines over those of the mat"))
        return
    if config.board:
        replace_file(Path(config.board), board_picture())
        print(f"board: {config.board}; print it on A4 at 100 %: squares of {1e3 * SQUARE:g} mm")
        return
    if not config.frames:
        raise InputError("frames= is missing; give the folder of the frames: frames=FOLDER")
    source, out = Path(config.frames), folder_named(config.out)
    require_folder(out)
    if source.is_dir() and not is_measured(os.listdir(source)):
        check_all(source, out)
        return
    measured, faults = check(source, out)
    print("\n".join([*measured, *(f"warning: {fault}" for fault in faults), f"capture: {out}",
                     *[f"picture: {out / PICTURE}"] * (out / PICTURE).exists()]))
    if faults:
        raise InputError(f"{len(faults)} of {len(measured) + len(faults)} checks of {source} "
                         f"failed; docs/rig.md lists causes, {out / PICTURE} shows what was read")


def check(source: Path, out: Path) -> tuple[list[str], list[str]]:
    """What is measured of the capture, or the strips, of a folder, which is written to ``out`` with
    its picture; and its faults."""
    found = read_measured(source)
    if not isinstance(found, Captured):
        for name, content in ({PICTURE: found.shown()} | found.tables()).items():
            if content:
                replace_file(out / name, content)
        return [f"note: {line}" for line in texts(found.warnings)], []
    checks = check_capture(found.capture, out)
    return ([f"{one.name}: {one.value}" for one in checks if not one.warning],
            texts(warnings_of(checks)))


def check_all(root: Path, out: Path) -> None:
    """Check the captures of a tree of folders; print and write what is found; InputError at the end
    if one has a fault."""
    entries, rows = entries_of(root), []
    for entry in progress_bar(entries, desc="checking", unit="capture"):
        folder = out / entry.place
        require_folder(folder)
        try:
            measured, faults = check(entry.path, folder)
            state = "doubtful" if faults else "sound"
        except InputError as error:
            measured, faults, state = [], [str(error)], "refused"
        rows.append({"capture": str(entry.place), "state": state, "faults": "; ".join(faults),
                     "measured": "; ".join(measured)})
        print(f"{entry.place}: {state}" + "".join(f"\n  {fault}" for fault in faults), flush=True)
    replace_file(out / "checks.csv", csv_table(rows).encode())
    replace_file(out / "checks.png", contact_sheet({
        row["capture"]: out / row["capture"] / PICTURE for row in rows}))
    print(f"table: {out / 'checks.csv'}\npictures: {out / 'checks.png'}")
    if bad := sum(row["state"] != "sound" for row in rows):
        raise InputError(f"{bad} of {len(rows)} captures have faults; docs/rig.md lists causes")


def contact_sheet(pictures: Mapping[str, Path]) -> bytes:
    """PNG of pictures by name, those that do not exist left empty."""
    wide, high, text = TILE
    columns = min(5, len(pictures))
    sheet = np.full((-(-len(pictures) // columns) * high, columns * wide, 3), 255, np.uint8)
    for k, (name, file) in enumerate(pictures.items()):
        tile = sheet[k // columns * high :, k % columns * wide :][: high, : wide]
        cv2.putText(tile, name[-45:], (4, text - 5), cv2.FONT_HERSHEY_SIMPLEX, 0.4, 0)
        if file.exists():
            picture = np.array(Image.open(file).convert("RGB"))
            share = min((wide - 4) / picture.shape[1], (high - text) / picture.shape[0])
            small = cv2.resize(picture, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
            tile[text : text + len(small), 2 : 2 + small.shape[1]] = small
    return cv2.imencode(".png", sheet[..., ::-1])[1].tobytes()


def check_capture(capture: Capture, out: Path) -> list[Check]:
    """The checks of a capture, which is written to ``out`` with its picture."""
    checks = [Check("capture", "", found) for found in capture.warnings]
    if isinstance(capture, OutlineCapture):
        checks += outline_checks(capture)
        write_outline(capture, out)
        replace_file(out / PICTURE, show(capture, checks))
    elif isinstance(capture, DepthCapture):
        views, observed = capture.views, observe(capture)
        quality = measure(observed.views, observed.seen.map)
        checks += view_checks(observed.views, quality, read_header("").setups)
        write_capture(
            out, views=views, intrinsics=capture.intrinsics, density=capture.density,
            warp_direction=capture.warp_direction, turns=capture.turns, rig=capture.rig,
            face=capture.face, depth_unit=DEPTH_UNIT, labels=capture.labels)
        cut = capture.cut or CutOut(views, views > 0, views, plate_of_cloth(
            views, capture.intrinsics, capture.rig))
        replace_file(out / PICTURE, show(replace(capture, cut=cut), checks))
        require_plate(quality)  # last, as the picture shows what is wrong
    else:
        raise InputError(f"{capture.path} states a drape coefficient and holds no picture; nothing "
                         "can be checked")
    return checks


def outline_checks(capture: OutlineCapture) -> list[Check]:
    """What is measured of an outline from above; reading it has refused what is impossible."""
    seen = observe(capture).seen.outline  # refuses a square whose warp is not marked
    outline, rig = capture.outline, capture.rig
    known = f"; {100 * outline.drape_coefficient:.1f} % as the camera sees it"
    return [
        Check("drape coefficient", f"{100 * seen.corrected(rig).coefficient(rig):.1f} %"
              + known * bool(np.isfinite(seen.height))),
        Check("nodes", f"{outline.folds}"),
        Check("hem", f"{1e3 * outline.radii.min():.0f} to {1e3 * outline.radii.max():.0f} mm from "
              f"the centre{'' if outline.centred else ' of the outline'} (plate: "
              f"{1e3 * rig.plate_radius:g}, flat specimen: {1e3 * rig.reach:.4g})")]


if __name__ == "__main__":
    main()
