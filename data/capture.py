"""Turn depth frames into a cut-out capture.

    python -m data.capture frames=FOLDER out=DIR
    python -m data.capture board=board.png

FOLDER has capture.yaml and frames of the whole scene, or of the cloth alone
(docs/use.md). Writes the capture in the usual format (16-bit PNG, background 0) to DIR, and
DIR/capture.png: each frame with the cloth outlined, the plate's rim, and its axes; last, the cloth
of all frames from above, one colour a frame, turned back by turns_deg. Look at it: where the hems
of two colours lie apart, the table was not turned as stated, or the cloth has moved.
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
_VIEWS = ((180, 120, 30), (60, 140, 230), (90, 160, 60), (170, 80, 170))
_WIDE = 1.02  # of the specimen, the half width of the picture from above
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
        raise InputError("frames= needs the folder of the frames")
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
    """PNG of the frames, two in a row, and of the cloth from above; ``turns`` (K,), rad."""
    seen = cut.frames[cut.masks]
    near, far = (seen.min(), seen.max() + 0.3) if len(seen) else (0.0, 1.0)
    scale = max(1, round(_SMALLEST / intrinsics.width))
    tiles = [_tile(frame, mask, cut, intrinsics, rig, near, far, scale)
             for frame, mask in zip(cut.frames, cut.masks, strict=True)]
    if cut.plate is not None:
        tiles.append(_from_above(cut, intrinsics, rig, turns, tiles[0].shape))
    if len(tiles) % 2:
        tiles.append(np.zeros_like(tiles[0]))
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
    """Tile of ``shape`` with the cloth of all views as in the first one, its right to the right."""
    tile = np.full(shape, 255, np.uint8)
    scale = shape[0] / (2 * _WIDE * rig.reach)
    middle = np.array([shape[1], shape[0]]) / 2

    def pixels(points: np.ndarray) -> np.ndarray:
        return np.rint(points[:, :2] * [scale, -scale] + middle).astype(int)

    for k, (view, turn) in enumerate(zip(cut.views, turns, strict=True)):
        points = cut.plate.local(intrinsics.back_project(view)[view > 0])
        cos, sin = np.cos(turn), np.sin(turn)
        x, y = points[:, 0] * cos + points[:, 1] * sin, points[:, 1] * cos - points[:, 0] * sin
        for column, row in pixels(np.column_stack([x, y])):
            cv2.circle(tile, (int(column), int(row)), 1, _VIEWS[k % len(_VIEWS)], -1)
    angle = np.linspace(0, 2 * np.pi, 90)
    rim = rig.plate_radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    cv2.polylines(tile, [pixels(rim).astype(np.int32)], True, (0, 0, 0), 1, cv2.LINE_AA)
    return tile


if __name__ == "__main__":
    main()
