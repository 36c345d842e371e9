"""Captures of an outline from above: the curve to 0.3 mm, and each fault in one line."""

import io
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from PIL import Image
from scipy.spatial import cKDTree

from common.errors import InputError
from data.captures import preview
from data.captures.board import PAPER, board_picture
from data.captures.capture import Capture, read_capture
from drapenet.network.checkpoint import header_for
from sim.rig import DISC_RIG

OUTLINES = Path(__file__).resolve().parents[3] / "shared" / "outlines.npz"
ANGLE = np.linspace(0, 2 * np.pi, 1440, endpoint=False)
RADIUS = 0.118 + 0.012 * np.cos(7 * ANGLE + 1) + 0.005 * np.cos(ANGLE) + 0.003 * np.sin(4 * ANGLE)
AROUND = np.column_stack([np.cos(ANGLE), np.sin(ANGLE)])
CURVE = RADIUS[:, None] * AROUND
CENTROID = RADIUS**3 @ AROUND / (1.5 * (RADIUS**2).sum())
FIELD = 0.4  # m, side of a picture
BASE = {"density_g_m2": 150, "tester": "disc300_support180"}


def drawn(*, pixel: float = 4e-4, cloth: float = 50, ground: float = 210, curve=CURVE,
          at=(0.012, -0.007)) -> np.ndarray:
    """A picture in which the plate's centre is ``at`` (2,) m from the middle."""
    size, fine = round(FIELD / pixel), 4
    picture = np.full((fine * size, fine * size), ground, np.float32)
    corners = fine * ((curve + at) * [1, -1] + FIELD / 2) / pixel - 0.5
    cv2.fillPoly(picture, [np.rint(corners * 16).astype(np.int32)], cloth, shift=4)
    return cv2.resize(picture, (size, size), interpolation=cv2.INTER_AREA)


def plate_px(pixel: float = 4e-4, at=(0.012, -0.007)) -> dict:
    x, y = (np.array(at) * [1, -1] + FIELD / 2) / pixel - 0.5
    return {"x": float(x), "y": float(y), "diameter": float(DISC_RIG.plate_diameter / pixel)}


def uneven(picture: np.ndarray) -> np.ndarray:
    rows, columns = np.indices(picture.shape) / picture.shape[0] - 0.5
    return picture * (1 + 0.3 * rows + 0.2 * columns)


def noisy(picture: np.ndarray) -> np.ndarray:
    blurred = cv2.GaussianBlur(picture, (0, 0), 1.5)
    return blurred + np.random.default_rng(0).normal(0, 8, picture.shape)


def on_paper(picture: np.ndarray) -> np.ndarray:
    """The same in the middle of a dark table, larger by 100 pixels on three sides."""
    return cv2.copyMakeBorder(picture, 100, 100, 0, 100, cv2.BORDER_CONSTANT, value=30)


def write(folder: Path, content: np.ndarray | str, *, name: str = "outline.png",
          **changes) -> Path:
    """A capture of a picture, or of a text, with keys of capture.yaml."""
    folder.mkdir(exist_ok=True)
    if isinstance(content, str):
        (folder / name).write_text(content, encoding="utf-8")
    else:
        kind = content if content.dtype == np.uint16 else np.clip(content, 0, 255).astype(np.uint8)
        Image.fromarray(kind).save(folder / name)
    (folder / "capture.yaml").write_text(yaml.safe_dump(BASE | changes))
    return folder


def error_mm(capture: Capture, curve: np.ndarray = CURVE) -> float:
    found = capture.outline.curve
    steps = np.linspace(0, 1, 20, endpoint=False)[:, None, None]
    dense = (found + steps * (np.roll(found, -1, axis=0) - found)).reshape(-1, 2)
    return 1e3 * cKDTree(dense).query(curve)[0].max()


PLATE = {"plate_px": plate_px(), "camera_height_mm": 1200}


@pytest.mark.parametrize("picture, name, source", [
    (drawn(), "outline.png", PLATE),
    (noisy(uneven(drawn())), "outline.jpg", PLATE),
    (uneven(drawn(cloth=200, ground=20)), "outline.tif", PLATE),
    (16 * drawn().astype(np.uint16), "outline.tiff", PLATE),
    (np.stack([drawn(cloth=c) for c in (90, 20, 40)], axis=2), "outline.jpeg", PLATE),
    (cv2.GaussianBlur(drawn(pixel=1e-3), (0, 0), 0.7), "outline.png", {"plate_px": plate_px(1e-3)}),
    (drawn(pixel=2e-4), "outline.png", {"plate_px": plate_px(2e-4)}),  # reduced
    (on_paper(drawn()), "outline.png", {"plate_px": {
        **plate_px(), "y": plate_px()["y"] + 100}}),
], ids=["plain", "noise", "light cloth", "16 bits", "colour", "coarse", "large", "paper"])
def test_the_curve_of_a_photograph_is_exact_to_a_fraction_of_a_millimetre(
        tmp_path, picture, name, source):
    capture = read_capture(write(tmp_path / "capture", picture, name=name, outline=source))
    outline = capture.outline
    assert error_mm(capture) < 0.3 and outline.centred
    assert outline.folds == 7
    area = np.pi * (RADIUS**2).mean()
    plate, specimen = np.pi * 0.09**2, np.pi * 0.15**2
    assert outline.drape_coefficient == pytest.approx((area - plate) / (specimen - plate), abs=4e-3)
    assert ("camera_height_mm" not in source) == any(
        w.startswith("camera_height_mm is missing") for w in capture.warnings)
    assert len(capture.views) == 0 and capture.intrinsics is None


def test_without_the_plate_the_centroid_is_the_centre(tmp_path):
    capture = read_capture(write(tmp_path / "capture", drawn(), outline={
        "mm_per_px": 0.4, "camera_height_mm": "parallel"}))
    assert not capture.outline.centred and capture.outline.height == np.inf
    assert len(capture.warnings) == 1 and "centroid" in capture.warnings[0]
    assert np.linalg.norm(CENTROID) > 4e-3 and error_mm(capture, CURVE - CENTROID) < 0.3


@pytest.mark.parametrize("tilt", [0.05, 0.35])
def test_a_board_gives_the_scale_of_an_inclined_picture(tmp_path, tilt):
    pixel = 5e-4
    sheet = np.array(Image.open(io.BytesIO(board_picture())))
    page = cv2.resize(sheet, (round(PAPER[0] / pixel), round(PAPER[1] / pixel)),
                      interpolation=cv2.INTER_AREA)
    scene = cv2.copyMakeBorder(drawn(pixel=pixel), 0, 0, 0, 460, cv2.BORDER_REPLICATE)
    scene[80 : 80 + page.shape[0], 820 : 820 + page.shape[1]] = page[:, : scene.shape[1]]
    height, width = scene.shape
    focal = 1.3 * width  # of a camera above the middle
    to_middle = np.array([[1, 0, -width / 2], [0, 1, -height / 2], [0, 0, 1]])
    tilted = np.array([[1, 0, 0], [0, np.cos(tilt), 0], [0, np.sin(tilt), focal]])
    lens = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    picture = cv2.warpPerspective(scene, lens @ tilted @ to_middle, (width, height),
                                  borderMode=cv2.BORDER_REPLICATE)
    capture = read_capture(write(tmp_path / "capture", picture, outline={}))
    assert any("off the vertical" in w for w in capture.warnings) == (tilt > 0.2)
    assert error_mm(capture, CURVE - CENTROID) < 0.5
    assert capture.outline.pixel == pytest.approx(pixel, rel=0.1)


def rows(first: np.ndarray, second: np.ndarray, form: str = "{:.4f},{:.4f}\n") -> str:
    return "".join(form.format(a, b) for a, b in zip(first[::4], second[::4], strict=True))


X, Y = 1e3 * CURVE.T
DEGREES = np.degrees(ANGLE)


@pytest.mark.parametrize("text, unit", [
    (rows(X, Y), "mm"),
    ("x_mm;y_mm\n" + rows(X, Y, "{:.4f};{:.4f}\n").replace(".", ","), None),
    ("# no\tY (mm)\tX (mm)\n" + rows(Y, X, "1\t{:.4f}\t{:.4f}\n"), None),
    (rows(X / 1e3, Y / 1e3, "{:.7f} {:.7f}\n"), "m"),
    (rows(X[::-1], Y[::-1]) + rows(X[-1:], Y[-1:]), "mm"),  # clockwise, closed
    ("angle_deg, radius_mm\n" + rows(DEGREES, 1e3 * RADIUS), "mm"),
    (rows(DEGREES, 1e3 * RADIUS, "{:.4f} {:.4f}\n").replace(".", ","), "mm"),
], ids=["plain", "comma", "columns", "metres", "clockwise", "polar", "polar comma"])
def test_numbers_of_a_drapemeter_are_read(tmp_path, text, unit):
    source = {"camera_height_mm": "parallel"} | ({"unit": unit} if unit else {})
    capture = read_capture(write(tmp_path / "capture", text, name="outline.csv", outline=source))
    assert error_mm(capture) < 0.05 and not capture.warnings and capture.outline.folds == 7


def test_real_outlines_pass_the_checks(tmp_path):
    if not OUTLINES.exists():
        pytest.skip(f"{OUTLINES} is absent")
    for curve in np.load(OUTLINES)["outline"][::31]:
        text = "".join(f"{x:.6f},{y:.6f}\n" for x, y in curve)
        capture = read_capture(write(tmp_path / "capture", text, name="outline.csv",
                                     outline={"unit": "m"}))
        assert len(capture.warnings) == 1 and 3 <= capture.outline.folds <= 14


def moved(shift: int) -> np.ndarray:
    return np.roll(drawn(), shift, axis=1)


def beside(radius: float) -> np.ndarray:
    """A second disc in the corner of the picture."""
    other = drawn(curve=radius * AROUND, at=(-0.16, 0.16))
    return np.minimum(drawn(), other)


PICTURE_FAULTS = {
    "blank": (drawn(cloth=205), PLATE, "cloth and ground differ by 2%"),
    "small": (drawn(curve=0.1 * CURVE), PLATE, "no drape was found"),
    "cut off": (moved(250), PLATE, "touches the border"),
    "two": (beside(0.03), PLATE, "2 pieces differ"),
    "scale": (drawn(), {"mm_per_px": 0.6}, "fills a circle of .* more than 1.03 times"),
    "unit": (drawn(), {"mm_per_px": 0.04}, "inside the plate of 90 mm radius"),
    "place": (drawn(), {"plate_px": plate_px(at=(0.1, 0))}, "comes within 3"),
    "elsewhere": (drawn(), {"plate_px": plate_px(at=(0.19, 0))}, "does not go once around"),
    "flat": (drawn(curve=0.152 * AROUND), PLATE, "drape coefficient is 104.3%"),
    "no scale": (drawn(), {}, "the scale is not known"),
    "two scales": (drawn(), PLATE | {"mm_per_px": 0.4}, "both state the scale"),
    "height": (drawn(), {"mm_per_px": 0.4, "camera_height_mm": 1.2}, "=1.2 is not a height"),
    "word": (drawn(), {"mm_per_px": 0.4, "unit": "mm"}, "outline.unit is of a text file"),
}
TEXT_FAULTS = {
    "unit": (rows(X, Y), {}, "unit of its lengths is not stated"),
    "two units": ("x_m,y_m\n" + rows(X, Y), {"unit": "mm"}, "states m, capture.yaml .* mm"),
    "columns": ("a_mm,b_mm\n" + rows(X, Y), {}, "neither x and y nor angle and radius"),
    "comma": (rows(X, Y).replace(".", ","), {"unit": "mm"}, "does not have 2 numbers"),
    "radians": (rows(ANGLE, 1e3 * RADIUS), {"unit": "mm"}, "span 6.266°, at least 270°"),
    "few": (rows(X[:80], Y[:80]), {"unit": "mm"}, "20 points"),
    "order": (rows(*np.random.default_rng(0).permutation(CURVE).T * 1e3), {"unit": "mm"},
              "turns back over|does not go once around"),
    "picture's": (rows(X, Y), {"plate_px": plate_px()}, "outline.plate_px is of a photograph"),
}


@pytest.mark.parametrize("content, source, fault", [
    *PICTURE_FAULTS.values(), *TEXT_FAULTS.values()], ids=[*PICTURE_FAULTS, *TEXT_FAULTS])
def test_each_fault_has_a_line(tmp_path, content, source, fault):
    name = "outline.txt" if isinstance(content, str) else "outline.png"
    folder = write(tmp_path / "capture", content, name=name, outline=source)
    with pytest.raises(InputError, match=fault) as caught:
        read_capture(folder)
    assert str(folder) in str(caught.value)


def test_folders_hold_views_or_one_outline(tmp_path):
    folder = write(tmp_path / "capture", drawn(), outline=PLATE)
    for name, fault in (("view_0.png", "holds outline.png and view_0.png; give depth"),
                        ("outline.csv", "holds outline.csv and outline.png; keep one")):
        (folder / name).write_text("")
        with pytest.raises(InputError, match=fault):
            read_capture(folder)
        (folder / name).unlink()
    write(folder, drawn(), outline=PLATE, turns_deg=[0])
    with pytest.raises(InputError, match="turns_deg is of depth views"):
        read_capture(folder)
    (folder / "outline.png").write_bytes((folder / "outline.png").read_bytes()[:3000])
    (folder / "capture.yaml").write_text(yaml.safe_dump(BASE | {"outline": PLATE}))
    with pytest.raises(InputError, match="save it again as PNG"):
        read_capture(folder)
    (folder / "outline.png").unlink()
    with pytest.raises(InputError, match=r"has the key outline, but there is no outline\.png"):
        read_capture(folder)


def test_cloth_that_swings_back_under_its_folds_is_a_warning(tmp_path):
    swung = RADIUS[:, None] * np.column_stack([np.cos(a := ANGLE + 0.2 * np.sin(7 * ANGLE)),
                                               np.sin(a)])
    capture = read_capture(write(tmp_path / "capture", drawn(curve=swung), outline=PLATE))
    assert len(capture.warnings) == 1 and "turns back over" in capture.warnings[0]


def test_the_preview_is_a_picture_and_a_capture_of_numbers(tmp_path, capsys):
    folder = write(tmp_path / "capture", drawn(), warp_direction_deg=30,
                   outline={"mm_per_px": 0.4, "camera_height_mm": 900})
    capture = read_capture(folder)
    preview.main([f"frames={folder}", f"out={tmp_path / 'out'}"])
    assert "note: the plate's centre is not known" in capsys.readouterr().out
    again = read_capture(tmp_path / "out")
    assert np.abs(again.outline.curve - capture.outline.curve).max() < 2e-6
    assert (again.outline.centred, again.outline.height) == (False, 0.9)
    assert again.warp_direction == pytest.approx(capture.warp_direction)
    assert again.digest != capture.digest == read_capture(folder).digest
    with Image.open(tmp_path / "out" / "capture.png") as picture:
        assert picture.size == (960, 960)
    with pytest.raises(InputError, match="not yet estimated"):
        header_for([capture])
