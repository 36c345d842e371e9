"""Turn depth frames into a cut-out capture.

    python -m data.capture frames=FOLDER out=DIR
    python -m data.capture board=board.png

FOLDER has capture.yaml and frames of the whole scene, or of the cloth alone
(docs/use.md). Writes the capture in the usual format (16-bit PNG, background 0) to DIR, and
DIR/capture.png: each frame with the cloth outlined, the plate's rim, and its axes; last, the hems
of all frames from above, one colour a frame, turned back by turns_deg. Look at it: where two
colours lie apart, or all on one side, the table was not turned as stated, or the cloth has moved.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from common.command import command
from common.errors import InputError
from common.files import folder_named, replace_file, require_folder
from data.board import SQUARE, board_picture
from data.cameras import Camera, Intrinsics
from data.captures import read_capture, write_capture
from data.cutout import CutOut, cut_out
from sim.scene import Rig

DEPTH_UNIT = 1e-4  # m per count, finer than any file's
PICTURE = "capture.png"
_AXIS = 0.04  # m, length of the axes drawn
_SMALLEST = 480  # pixels, width of a frame in the picture
_RIM, _OUTLINE = (0, 200, 255), (60, 220, 60)  # blue, green, red
_VIEWS = ((178, 114, 0), (0, 94, 213), (115, 158, 0), (167, 121, 204), (233, 180, 86),
          (0, 159, 230), (60, 60, 60), (20, 20, 160))  # Okabe and Ito's, and two dark ones
_WIDE = 1.02  # of the specimen, the half width of the picture from above
_SECTORS = 180  # of the hem from above, each with its outermost point
_SEEN = np.radians(75.0)  # to either side of the camera, where a view shows the hem
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_AXES = (60, 60, 255), (60, 200, 60), (255, 120, 60)


@dataclass
class CaptureConfig:
    """``configs/capture.yaml``."""

    frames: str
    out: str
    board: str


@command("capture", CaptureConfig, swept_out=".")
def main(config: CaptureConfig) -> None:
    """Cut out, and write the capture and its picture; or write a board."""
    if config.board:
        replace_file(Path(config.board), board_picture())
        print(f"board: {config.board}; print it on A4 at 100 %: squares of "
              f"{1e3 * SQUARE:g} mm")
        return
    if not config.frames:
        raise InputError("frames= is missing; give the folder of the frames: frames=FOLDER")
    out = folder_named(config.out)
    require_folder(out)
    capture = read_capture(config.frames)
    cut = capture.cut or cut_out(capture.views, capture.intrinsics, Rig.from_name(capture.rig))
    write_capture(out, views=capture.views, intrinsics=capture.intrinsics, density=capture.density,
                  warp_direction=capture.warp_direction, turns=capture.turns, rig=capture.rig,
                  depth_unit=DEPTH_UNIT)
    replace_file(out / PICTURE, picture(cut, capture.intrinsics, Rig.from_name(capture.rig),
                                        turns=capture.turns))
    for line in (*capture.warnings, *(() if capture.cut else ("the frames were cut out already",))):
        print(f"note: {line}")
    print(f"capture: {out}\npicture: {out / PICTURE}")


def picture(cut: CutOut, intrinsics: Intrinsics, rig: Rig, *, turns: np.ndarray) -> bytes:
    """PNG of the frames, two in a row, and of the hems from above; ``turns`` (K,), rad."""
    seen = cut.frames[cut.masks]
    near, far = (seen.min(), seen.max() + 0.3) if len(seen) else (0.0, 1.0)
    scale = max(1, round(_SMALLEST / intrinsics.width))
    tiles = [_tile(frame, mask, cut, intrinsics, rig, near, far, scale)
             for frame, mask in zip(cut.frames, cut.masks, strict=True)]
    if cut.plate is not None:
        tiles.append(_from_above(cut, intrinsics, rig, turns, tiles[0].shape))
    if len(tiles) % 2:
        tiles.append(np.full_like(tiles[0], 255))
    rows = [np.hstack(tiles[k : k + 2]) for k in range(0, len(tiles), 2)]
    return cv2.imencode(".png", np.vstack(rows))[1].tobytes()


def _tile(
    frame: np.ndarray, mask: np.ndarray, cut: CutOut, intrinsics: Intrinsics, rig: Rig,
    near: float, far: float, scale: int,
) -> np.ndarray:
    """(H scale, W scale, 3) uint8 of one frame."""
    grey = np.where(frame > 0, 255 - 200 * np.clip((frame - near) / (far - near), 0, 1), 0)
    size = (intrinsics.width * scale, intrinsics.height * scale)
    tile = cv2.resize(np.repeat(grey[..., None], 3, axis=2).astype(np.uint8), size,
                      interpolation=cv2.INTER_NEAREST)
    large = cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    outlines, _ = cv2.findContours(large, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(tile, outlines, -1, _OUTLINE, 1)
    if cut.plate is None:
        return tile
    angle = np.linspace(0, 2 * np.pi, 90)
    rim = rig.plate_radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    drawn = [(rim, _RIM), *((np.stack([np.zeros(3), _AXIS * axis]), colour)
                            for axis, colour in zip(np.eye(3), _AXES, strict=True))]
    camera = Camera(**vars(intrinsics), world_to_camera=cut.plate.pose)
    for points, colour in drawn:
        pixels = (camera.project(points)[0] + 0.5) * scale
        cv2.polylines(tile, [np.rint(pixels).astype(np.int32)], False, colour, 1, cv2.LINE_AA)
    return tile


def _from_above(
    cut: CutOut, intrinsics: Intrinsics, rig: Rig, turns: np.ndarray, shape: tuple[int, ...]
) -> np.ndarray:
    """Tile of ``shape`` with the hems of all views as in the first one, its right to the right."""
    tile = np.full(shape, 255, np.uint8)
    scale = shape[0] / (2 * _WIDE * rig.reach)
    legend = 0.3 * shape[1]
    middle = np.array([(shape[1] + legend) / 2, shape[0] / 2])
    size = shape[0] / 720  # of letters and lines

    def pixels(points: np.ndarray) -> np.ndarray:
        return np.rint(points * [scale, -scale] + middle).astype(np.int32)

    angle = np.linspace(0, 2 * np.pi, 90)
    rim = rig.plate_radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    cv2.polylines(tile, [pixels(rim)], True, (120, 120, 120), 1, cv2.LINE_AA)

    def write(text: str, row: float, colour: tuple[int, ...]) -> None:
        cv2.putText(tile, text, (round(16 * size), round(row * size)), _FONT, 0.8 * size, colour,
                    max(1, round(1.6 * size)), cv2.LINE_AA)

    write("hems from above", 34, (0, 0, 0))
    camera = np.linalg.inv(cut.plate.pose)[:2, 3]
    for k, (view, turn) in enumerate(zip(cut.views, turns, strict=True)):
        colour = _VIEWS[k % len(_VIEWS)]
        points = cut.plate.local(intrinsics.back_project(view)[view > 0])[:, :2]
        back = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        for line in _hem(points, np.arctan2(camera[1], camera[0])):
            cv2.polylines(tile, [pixels(line @ back.T)], False, colour, max(2, round(2 * size)),
                          cv2.LINE_AA)
        # Hershey's letters have no degree sign.
        write(f"view {k}: {np.degrees(turn):.4g} deg", 34 * (k + 2), colour)
    write("plate's rim", 34 * (len(turns) + 2), (120, 120, 120))
    return tile


def _hem(points: np.ndarray, towards: float) -> list[np.ndarray]:
    """Lines (N, 2) along the outermost of ``points`` (P, 2) in each sector around the plate's axis,
    m; of the sectors that face a camera in the direction ``towards``, rad.
    """
    distance = np.linalg.norm(points, axis=1)
    away = (np.arctan2(points[:, 1], points[:, 0]) - towards + np.pi) % (2 * np.pi) - np.pi
    sector = np.floor(away / (2 * np.pi / _SECTORS)).astype(int)
    order = np.lexsort((-distance, sector))
    found, first = np.unique(sector[order], return_index=True)
    outermost = order[first][np.abs((found + 0.5) * (2 * np.pi / _SECTORS)) < _SEEN]
    gaps = np.flatnonzero(np.diff(sector[outermost]) > 1) + 1
    return [points[part] for part in np.split(outermost, gaps) if len(part) > 1]


if __name__ == "__main__":
    main()
