"""Captures of an outline from above: the curve to 0.3 mm, and each fault in one line."""

import io
import re
from contextlib import nullcontext
from pathlib import Path

import cv2
import numpy as np
import pytest
from photographs import (
    ANGLE,
    AROUND,
    CENTROID,
    CURVE,
    PLACE,
    RADIUS,
    distances_mm,
    drawn,
    error_mm,
    noisy,
    plate,
    uneven,
    write,
)
from PIL import Image

from apps.capture import main
from common.errors import InputError
from common.findings import texts
from data.captures.board import PAPER, board_picture
from data.captures.capture import OutlineCapture
from data.captures.photograph import require_height
from data.captures.reader import read_capture
from data.pictures.reading import decoded, encoded
from drapenet.measured.read import sources_in
from sim.rig import DISC_RIG, Rig

OUTLINES = Path(__file__).resolve().parents[3] / "shared" / "outlines.npz"


def on_paper() -> np.ndarray:
    """A dark table around three sides of the ground."""
    return cv2.copyMakeBorder(drawn(), 100, 100, 0, 100, cv2.BORDER_CONSTANT, value=30)


SCALE = {"mm_per_px": 0.4}
PLATE = {"plate_px": plate(), "camera_height_mm": 1200}


@pytest.mark.parametrize("picture, name, source", [
    (drawn, "outline.png", PLATE),
    (lambda: noisy(uneven(drawn())), "outline.jpg", PLATE),
    (lambda: uneven(drawn(cloth=200, ground=20)), "outline.tif", PLATE),
    (lambda: drawn().astype(np.uint16) * 16, "outline.tiff", PLATE),
    (lambda: np.stack([drawn(cloth=c) for c in (90, 20, 40)], axis=2), "outline.jpeg", PLATE),
    (lambda: drawn(pixel=1e-3), "outline.png", {"plate_px": plate(1e-3)}),
    (lambda: drawn(pixel=2e-4), "outline.png", {"plate_px": plate(2e-4)}),  # reduced
    (on_paper, "outline.png", {"plate_px": plate(down=100)}),
], ids=["plain", "noise", "light cloth", "16 bits", "colour", "coarse", "large", "paper"])
def test_the_curve_of_a_photograph_is_exact_to_0_3_mm(tmp_path, picture, name, source):
    capture = read_capture(write(tmp_path / "capture", picture(), name, outline=source))
    outline = capture.outline
    # 0.33 mm at a millimetre a pixel.
    assert error_mm(capture) < (0.3 if outline.pixel < 9e-4 else 0.35)
    assert outline.centred and outline.folds == 7
    expected = ((RADIUS**2).mean() - 0.09**2) / (0.15**2 - 0.09**2)
    assert outline.drape_coefficient == pytest.approx(expected, abs=4e-3)
    assert ("camera_height_mm" not in source) == (
        "camera_height_missing" in [found.code for found in capture.warnings])
    assert isinstance(capture, OutlineCapture)


def test_without_the_plate_the_centroid_is_the_centre(tmp_path):
    capture = read_capture(write(tmp_path / "capture", drawn(), outline={
        "mm_per_px": 0.4, "camera_height_mm": "parallel"}))
    assert not capture.outline.centred and capture.outline.height == np.inf
    assert [found.code for found in capture.warnings] == ["centre_unknown_in_picture"]
    assert np.linalg.norm(CENTROID) > 4e-3 and error_mm(capture, CURVE - CENTROID) < 0.3


@pytest.mark.parametrize("tilt", [0.05, 0.35])
def test_a_board_gives_the_scale_of_an_inclined_picture(tmp_path, tilt):
    pixel = 5e-4
    sheet = np.array(Image.open(io.BytesIO(board_picture())))
    page = cv2.resize(sheet, [round(side / pixel) for side in PAPER], interpolation=cv2.INTER_AREA)
    scene = cv2.copyMakeBorder(drawn(pixel=pixel), 0, 0, 0, 460, cv2.BORDER_REPLICATE)
    scene[80 : 80 + page.shape[0], 820 : 820 + page.shape[1]] = page
    height, width = scene.shape
    focal = 1.3 * width
    middle = np.array([[1, 0, -width / 2], [0, 1, -height / 2], [0, 0, 1]])
    tilted = np.array([[1, 0, 0], [0, np.cos(tilt), 0], [0, np.sin(tilt), focal]])
    picture = cv2.warpPerspective(
        scene, np.linalg.inv(middle) @ np.diag([focal, focal, 1]) @ tilted @ middle,
        (width, height), borderMode=cv2.BORDER_REPLICATE)
    capture = read_capture(write(tmp_path / "capture", picture, outline={}))
    assert ("plate_tilted" in [found.code for found in capture.warnings]) == (tilt > 0.2)
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
    capture = read_capture(write(tmp_path / "capture", text, "outline.csv", outline=source))
    assert error_mm(capture) < 0.05 and not capture.warnings and capture.outline.folds == 7


R_ROWS = "".join(f'"{k}",{x:.4f},{y:.4f}\n' for k, (x, y) in enumerate(1e3 * CURVE[::4], 1))
CORNER = [200.0, 200.0]  # mm, of a picture's corner from the plate's centre
DOWN = rows(X + CORNER[0], CORNER[1] - Y, "{:.4f}\t{:.4f}\n")
CLOCKWISE = "angle;radius_mm\n" + rows(360 - DEGREES, 1e3 * RADIUS, "{:.4f};{:.4f}\n")
SKEW = {"warp_direction_deg": 25}


@pytest.mark.parametrize("text", [
    '"","x_mm","y_mm"\n' + R_ROWS, '"x_mm","y_mm"\n' + R_ROWS,
    '"x_mm","y_mm"\n' + rows(X, Y), "sep=;\nx;y\nmm;mm\n" + rows(X, Y, "{:.4f};{:.4f}\n"),
    "x_mm;y_mm;\n" + rows(X, Y, "{:.4f};{:.4f};\n") + ";;\n;;\n",
    "Drape 7; light box\n;X [mm];Y [mm]\n" + rows(X, Y, "p;{:.4f};{:.4f}\n"),
    "# written by hand\n# x_mm y_mm\n" + rows(X, Y, "{:.4f} {:.4f}\n"),
    "radius_mm,angle\n" + rows(1e3 * RADIUS, DEGREES),
    "sep=\t\nx_mm\ty_mm\n" + rows(X, Y, "{:.4f}\t{:.4f}\n").replace(".", ","),
    "x_mm;y_mm\n" + rows(X, Y, "{:.4f};{:.4f}\n").replace("-", "\u2212"),
    "x_mm y_mm\n" + rows(X, Y, "{:.4f} {:.4f}\n").translate({45: "\u2212", 46: ","}),
    "angle;radius_mm;area_px\n" + rows(DEGREES, 1e3 * RADIUS, "{:.4f}\u00b0;{:.4f};7\n"),
], ids=["R", "R without corner", "quoted", "Excel and units", "empty", "title", "comments",
        "radius first", "tab", "minus sign", "minus sign, spaces", "degree sign"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_tables_of_other_programs_are_read(tmp_path, text, encoding):
    folder = write(tmp_path / "capture", "", "outline.csv", **SKEW,
                   outline={"camera_height_mm": "parallel"})
    (folder / "outline.csv").write_bytes(text.encode(encoding))
    assert error_mm(read_capture(folder)) < 0.05


def test_columns_without_names_are_recognised_by_their_values(tmp_path):
    def read(text: str, **source: object):
        return read_capture(write(tmp_path / "capture", text, "outline.txt", outline={
            "unit": "mm", "camera_height_mm": "parallel"} | source))

    turned = np.roll(np.column_stack([DEGREES, 1e3 * RADIUS]), 400, axis=0).T
    assert error_mm(read(rows(*turned))) < 0.05
    assert error_mm(read(DOWN, centred=False, y_axis="down"), CURVE - CENTROID) < 0.05
    overlapping = DEGREES.copy()
    overlapping[::40], overlapping[8::40] = DEGREES[8::40], DEGREES[::40]
    with pytest.raises(InputError, match="may be x and y, or angle and radius; name them"):
        read(rows(overlapping, 1e3 * RADIUS))


@pytest.mark.parametrize(("text", "source", "question", "answer"), [
    (DOWN, {}, "state outline: {centred: false, y_axis: down}, or y_axis: up",
     {"centred": False, "y_axis": "down"}),
    (DOWN, {"centred": False}, "state outline: {y_axis: down}, or y_axis: up", {"y_axis": "down"}),
    (rows(X - 300, Y), {}, "lies outside of the outline; state outline: {centred: false}",
     {"centred": False}),
    (CLOCKWISE, {}, "{angles: clockwise}, or counter-clockwise", {"angles": "clockwise"}),
], ids=["corner", "corner, stated", "beside", "clockwise"])
def test_a_doubtful_sense_or_origin_is_asked_for(tmp_path, text, source, question, answer):
    def read(**more: object):
        return read_capture(write(tmp_path / "capture", text, "outline.csv", **SKEW,
                                  outline={"unit": "mm", "camera_height_mm": "parallel"} | more))

    with pytest.raises(InputError, match=re.escape(question)):
        read(**source)
    capture = read(**source, **answer)
    assert error_mm(capture, CURVE if capture.outline.centred else CURVE - CENTROID) < 0.05


@pytest.mark.parametrize("direction", [None, 0, 89.5, 180])
def test_a_mirrored_outline_is_no_question_where_it_is_that_of_the_same_fabric(
    tmp_path, direction
):
    marked = {} if direction is None else {"warp_direction_deg": direction}
    for text in (DOWN, CLOCKWISE):
        read_capture(write(tmp_path / "capture", text, "outline.csv", **marked, outline={
            "unit": "mm", "centred": False, "camera_height_mm": "parallel"}))


def test_real_outlines_pass_the_checks(tmp_path):
    if not OUTLINES.exists():
        pytest.skip(f"{OUTLINES} is absent")
    for curve in np.load(OUTLINES)["outline"][::31]:
        text = rows(*np.repeat(curve, 4, axis=0).T, "{:.6f},{:.6f}\n")
        capture = read_capture(write(tmp_path / "capture", text, "outline.csv",
                                     outline={"unit": "m"}))
        assert len(capture.warnings) == 1 and 3 <= capture.outline.folds <= 14


def test_what_lies_beside_the_drape_is_not_cloth(tmp_path):
    beside = np.minimum(drawn(), drawn(0.03 * AROUND, at=(-0.16, 0.16)))
    capture = read_capture(write(tmp_path / "capture", beside, outline=PLATE))
    assert error_mm(capture) < 0.3 and not capture.warnings


def shadowed(cloth=(60, 90, 160), hard=True, left=0.6, aside=0.02) -> np.ndarray:
    """Coloured cloth on a grey ground with its shadow beside it."""
    share = drawn(ground=0, cloth=255) / 255.0
    shadow = drawn(at=(PLACE[0] + aside, PLACE[1] - aside), ground=0, cloth=255) / 255.0
    shadow = shadow if hard else cv2.GaussianBlur(shadow, (0, 0), 20)
    light = 0.6 * (1 - (1 - left) * shadow)[..., None] * np.ones(3)
    light += decoded(share)[..., None] * (decoded(np.array(cloth) / 255) - light)
    return np.rint(255 * encoded(light.astype(np.float32)))


@pytest.mark.parametrize("picture", [
    shadowed, lambda: shadowed(hard=False), lambda: shadowed(cloth=(25, 25, 25))],
    ids=["hard shadow", "soft shadow", "black cloth"])
def test_shadows_are_ground_and_patterns_are_cloth(tmp_path, picture):
    capture = read_capture(write(tmp_path / "capture", picture(), outline=PLATE))
    # Where the border of a shadow meets the hem, a corner of it is not decided.
    assert np.sqrt(np.square(distances_mm(capture)).mean()) < 0.6
    expected = ((RADIUS**2).mean() - 0.09**2) / (0.15**2 - 0.09**2)
    assert capture.outline.drape_coefficient == pytest.approx(expected, abs=0.01)


def test_a_hem_in_a_shadow_of_the_cloths_own_grey_is_doubtful(tmp_path):
    capture = read_capture(write(tmp_path / "capture", shadowed(
        (154, 154, 154), hard=False, left=0.54, aside=0.04), outline=PLATE))
    assert "hem_doubtful" in [found.code for found in capture.warnings]
    assert capture.outline.error.max() > 3e-3 and distances_mm(capture).max() > 3


def test_transparent_pixels_are_ground(tmp_path):
    picture = np.dstack([shadowed()] * 1 + [np.where(drawn(ground=0, cloth=255) > 127, 255, 0)])
    folder = write(tmp_path / "capture", picture, outline=PLATE)
    assert error_mm(read_capture(folder)) < 0.5


@pytest.mark.parametrize("name, options", [
    ("outline.heic", {"format": "HEIF", "quality": 90}), ("outline.jpg", {"format": "HEIF"}),
    ("outline.jpg", {"format": "WEBP", "quality": 90}), ("outline.avif", {"format": "AVIF"}),
    ("outline.jpg", {"format": "JPEG", "exif": 6}), ("outline.tif", {"format": "TIFF", "exif": 8})])
def test_files_of_phones_are_read_upright(tmp_path, name, options):
    folder = write(tmp_path / "capture", drawn(), "unrelated.png", outline=PLATE)
    picture = Image.fromarray(drawn())
    if turn := options.pop("exif", None):
        picture = picture.transpose({6: Image.Transpose.ROTATE_90, 8: Image.Transpose.ROTATE_270}[
            turn])
        exif = picture.getexif()
        exif[274] = turn
        options["exif"] = exif
    if options["format"] == "HEIF":
        picture = picture.convert("RGB")
    picture.save(folder / name, **options)
    assert error_mm(read_capture(folder)) < 0.4


@pytest.mark.parametrize(("size", "count"), [((16320, 12240), "199 million"),
                                             ((12000, 9000), "12000x9000")])
def test_a_photograph_of_too_many_pixels_has_a_line_and_no_warning_of_pillow(
        tmp_path, size, count, recwarn):
    folder = write(tmp_path / "capture", drawn(), "unrelated.png", outline=PLATE)
    Image.new("L", size, 128).save(folder / "outline.jpg", quality=20)
    with pytest.raises(InputError, match=f"{count}.* pixels; photographs have 100 to 10000"):
        read_capture(folder)
    assert not recwarn


@pytest.mark.parametrize(("heads", "factor"), [
    ("x_cm;y_cm", 1e-2), ("X (inch);Y (inch)", 0.0254), ("x in;y in", 0.0254),
    ("x in mm;y in mm", 1e-3),
    ("x [\u00b5m];y [\u00b5m]", 1e-6), ("x;y\nin;in", 0.0254)])
def test_lengths_are_in_the_unit_of_the_header(tmp_path, heads, factor):
    numbers = "\n".join(f"{x:.9f};{y:.9f}" for x, y in CURVE[::4] / factor)
    folder = write(tmp_path / "capture", f"{heads}\n{numbers}\n", "outline.csv",
                   outline={"camera_height_mm": "parallel"})
    assert error_mm(read_capture(folder)) < 0.1


@pytest.mark.parametrize(("options", "said"), [
    ({"dpi": (63.5, 63.5)}, []),
    ({"dpi": (300, 300)}, ["scale_contradicts"]),
    ({"format": "JPEG", "dpi": (300, 300), "exif": 37386}, []),
    ({"dpi": (204, 196)}, "its pixels are not square"),
    ({"save_all": True, "append_images": [Image.new("L", (900, 900))]}, "several pictures"),
    ({"tiffinfo": {50706: b"\1\4\0\0"}}, "several pictures"),  # DNG
    ({"format": "PNG", "dpi": (204, 196)}, "its pixels are not square")])
def test_a_scan_has_one_picture_of_square_pixels_at_the_stated_scale(tmp_path, options, said):
    folder = write(tmp_path / "capture", drawn(), "unrelated.png", outline=SCALE)
    exif = Image.Exif()
    if "exif" in options:
        exif.get_ifd(0x8769)[options["exif"]] = 27.0
    Image.fromarray(drawn()).save(folder / "outline.tif", **{"format": "TIFF"} | options | {
        "exif": exif})
    if isinstance(said, str):
        with pytest.raises(InputError, match=said):
            read_capture(folder)
    else:
        assert [found.code for found in read_capture(folder).warnings][:-2] == said


def test_a_picture_of_the_plate_gives_scale_and_centre(tmp_path):
    folder = write(tmp_path / "capture", drawn(), outline={"camera_height_mm": 1200})
    Image.fromarray(drawn(0.09 * AROUND, cloth=120)).save(folder / "plate.png")
    capture = read_capture(folder)
    assert error_mm(capture) < 0.4 and capture.outline.centred and not capture.warnings
    write(folder, drawn(), outline=PLATE | {"plate_px": plate() | {"diameter": 500}})
    with pytest.raises(InputError, match=r"shows a plate of 45\d pixels.* has 500"):
        read_capture(folder)
    Image.fromarray(drawn()).save(folder / "plate.png")
    with pytest.raises(InputError, match=r"plate\.png: no plate was found"):
        read_capture(folder)
    Image.fromarray(drawn()[:900]).save(folder / "plate.png")
    with pytest.raises(InputError, match=r"plate\.png has another size"):
        read_capture(folder)


def test_cloth_nearly_as_light_as_its_ground_states_a_large_error(tmp_path):
    write(tmp_path / "capture", np.where(np.arange(1000) < 560, drawn(cloth=207), drawn()),
          outline=PLATE)
    capture = read_capture(tmp_path / "capture")
    assert "hem_doubtful" in [found.code for found in capture.warnings]
    assert error_mm(capture) < 2e3 * np.quantile(capture.outline.error, 0.9)


MM = {"unit": "mm"}
FAULTS = {
    "blank": (lambda: drawn(cloth=210), PLATE, "differs from its ground on 0% of the plate"),
    "small": (lambda: drawn(0.1 * CURVE), PLATE, "differs from its ground on .* of the plate"),
    "cut off": (lambda: np.roll(drawn(), 250, axis=1), SCALE, "beyond the border of the picture"),
    "hole": (lambda: drawn(0.0902 * AROUND), PLATE, "not that of the plate or of a hole"),
    "board": (lambda: np.array(Image.open(io.BytesIO(board_picture()))), {}, "board fills"),
    "gon": (lambda: rows(DEGREES / 0.9, 1e3 * RADIUS), MM, "span 398.9°, more than a turn"),
    "radians": (lambda: rows(ANGLE, 1e3 * RADIUS), MM, "span 6.266°, at least 270°"),
    "gap": (lambda: rows(X[:1300], Y[:1300]), MM, "a gap of 36° of azimuth"),
    "order": (lambda: rows(*np.random.default_rng(1).permutation(1e3 * CURVE).T), MM,
              "turns back over .* at most 50%|does not go once around"),
}


@pytest.mark.parametrize("content, source, fault", FAULTS.values(), ids=FAULTS)
def test_each_fault_has_a_line(tmp_path, content, source, fault):
    content = content()
    name = "outline.txt" if isinstance(content, str) else "outline.png"
    folder = write(tmp_path / "capture", content, name, outline=source)
    with pytest.raises(InputError, match=fault) as caught:
        read_capture(folder)
    assert str(folder) in str(caught.value)


@pytest.mark.parametrize(("scale", "said"), [(0.999, []), (1.005, ["outline_too_large"]),
                                             (1.02, ["outline_too_large"])])
def test_a_stiff_disc_with_a_scale_slightly_wrong_is_read_with_a_warning(tmp_path, scale, said):
    """One of 300 mm that does not hang down."""
    outline = plate() | {"diameter": plate()["diameter"] / scale}
    capture = read_capture(write(tmp_path / "capture", drawn(0.150 * AROUND),
                                 outline={"plate_px": outline, "camera_height_mm": 1200}))
    assert [found.code for found in capture.warnings] == said
    assert capture.outline.drape_coefficient == pytest.approx(
        (scale**2 - 0.36) / 0.64, abs=2e-3)


def test_more_than_the_flat_disc_is_no_drape(tmp_path):
    """Within the limit of its reach, over a plate nearly as large."""
    x, y = 102.75 * AROUND.T
    folder = write(tmp_path / "capture", rows(x, y), "outline.txt", outline=MM, tester={
        "specimen": "disc", "size_mm": 200, "plate_mm": 160})
    with pytest.raises(InputError, match=r"drape coefficient is 115\.5"):
        read_capture(folder)


@pytest.mark.parametrize(("beyond", "named"), [(0.0, False), (12e-3, True)])
def test_a_hem_that_reaches_farther_than_the_specimen_is_named(tmp_path, beyond, named):
    """By a hard shadow beside one fold, so that the outline fits into the specimen's circle."""
    reach = DISC_RIG.reach
    radius = 0.125 + 0.006 * np.cos(7 * ANGLE)
    shadow = np.abs((ANGLE + np.pi) % (2 * np.pi) - np.pi) < 0.2
    radius[shadow] = reach + beyond
    table = "angle_deg, radius_mm\n" + rows(DEGREES, 1e3 * radius)
    capture = read_capture(write(tmp_path / "capture", table, "outline.csv",
                                 outline={"camera_height_mm": "parallel"}))
    assert ("hem_beyond_specimen" in [found.code for found in capture.warnings]) == named


@pytest.mark.parametrize(("nearest", "said"), [
    (0.095, None), (0.0885, r"within 88\.5 mm .* rim of 90 mm, which hides it: check the scale "
                            r"first \(unit\), then the tester")])
def test_a_hem_inside_the_plates_rim_is_a_warning(tmp_path, nearest, said):
    radius = nearest + 0.012 * (1 - np.cos(7 * ANGLE))
    capture = read_capture(write(
        tmp_path / "capture", "angle_deg, radius_mm\n" + rows(DEGREES, 1e3 * radius), "outline.csv",
        outline={"camera_height_mm": "parallel"}))
    lines = texts(capture.warnings)
    assert not lines if said is None else re.search(said, " ".join(lines))


def test_a_hem_is_not_wider_than_the_specimens_short_side_in_every_direction(tmp_path):
    """By a wrong scale, though it fits into the circle of the corners."""
    table = "angle_deg, radius_mm\n" + rows(DEGREES, 92 + 2 * np.cos(5 * ANGLE))
    folder = write(tmp_path / "capture", table, "outline.csv", warp_direction_deg=0,
                   tester={"specimen": "rectangle", "size_mm": [170, 250], "plate_mm": 100},
                   outline={"camera_height_mm": "parallel"})
    assert [found.code for found in read_capture(folder).warnings] == ["hem_wide"]


@pytest.mark.parametrize(("height", "named"), [(1200, False), (1000, True), ("parallel", False)])
def test_scale_and_height_contradict_the_focal_length_of_the_file(tmp_path, height, named):
    """The file's 104 mm of full frame put a camera at 1.2 m that sees 0.4 mm in a pixel."""
    whole = drawn()[125:875]  # 4:3
    folder = write(tmp_path / "capture", whole, outline={
        "plate_px": plate(down=-125), "camera_height_mm": height})
    (folder / "outline.png").unlink()
    exif = Image.Exif()
    exif.get_ifd(0x8769)[41989] = 104
    Image.fromarray(whole).save(folder / "outline.jpg", quality=95, exif=exif)
    lines = texts(read_capture(folder).warnings)
    assert len(lines) == named
    assert all(re.search(r"was 120\d mm above the plate, but camera_height_mm is 1000, more than "
                         r"15% off: check the scale first \(plate_px", line) for line in lines)


def test_cloth_that_swings_back_under_its_folds_is_a_warning(tmp_path):
    angle = ANGLE + 0.25 * np.sin(7 * ANGLE)
    x, y = 1e3 * RADIUS * np.stack([np.cos(angle), np.sin(angle)])
    capture = read_capture(write(tmp_path / "capture", "x_mm,y_mm\n" + rows(x, y), "outline.csv",
                                 outline={"camera_height_mm": "parallel"}))
    assert capture.warnings[0].code == "outline_turns_back"


def test_the_preview_is_a_picture_and_a_capture_of_numbers(tmp_path, capsys):
    folder = write(tmp_path / "capture", drawn(), warp_direction_deg=30,
                   outline=SCALE | {"camera_height_mm": 900})
    capture = read_capture(folder)
    with pytest.raises(InputError, match="1 of 4 checks"):
        main([f"frames={folder}", f"out={tmp_path / 'out'}"])
    assert "warning: the plate's centre is not known" in capsys.readouterr().out
    again = read_capture(tmp_path / "out")
    assert np.abs(again.outline.curve - capture.outline.curve).max() < 2e-6
    assert (again.outline.centred, again.outline.height) == (False, 0.9)
    assert again.warp_direction == pytest.approx(capture.warp_direction)
    assert again.digest != capture.digest == read_capture(folder).digest
    with Image.open(tmp_path / "out" / "capture.png") as picture:
        assert picture.size == (960, 960)


@pytest.mark.parametrize("name", [
    "capture.yml", "capture.yaml.txt", "Capture.YAML", "capture.yml.txt"])
def test_a_capture_with_a_misnamed_description_is_not_left_out_in_silence(tmp_path, name):
    for k, file in enumerate(("capture.yaml", name)):
        (tmp_path / str(k)).mkdir()
        (tmp_path / str(k) / file).touch()
    assert sources_in(tmp_path, "capture") == [tmp_path / "0", tmp_path / "1"]


@pytest.mark.parametrize(("nearest", "height", "refused"), [
    (58, 139, 0), (58, 95, 0), (58, 60, 1), (100, 55, 1), (100, 90, 0), (148, 20, 0)])
def test_cloth_that_would_hang_through_the_mat_is_refused(nearest, height, refused):
    """100.5 mm of cloth beyond the rim of 49.5 mm that reach 8.5 mm outwards hang 92 mm down; the
    mean of those that reach from 50 to 91 mm hangs 71 mm or more."""
    turn = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    radius = 1e-3 * (nearest + 20 * (1 - np.cos(5 * turn)))
    curve = radius[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    said = (pytest.raises(InputError, match=f"hangs more than {height + 5} mm .*=.*{height}; check")
            if refused else nullcontext())
    with said:
        require_height(curve, Rig((0.3, 0.3), 0.099, "disc"), 1e-3 * height, np.inf)
