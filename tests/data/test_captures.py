"""Captures: both formats read as written, and every bad one is refused in one clear line."""

import math
import os
import runpy
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml
from PIL import Image
from scipy import ndimage
from words import last

from common.errors import InputError
from data.captures.capture import Capture, read_capture, write_capture
from data.render.cameras import nominal_camera
from data.render.rays import DepthRenderer
from data.rigs import TESTERS
from drapenet.views.located import LocatedViews
from drapenet.views.radial_map import drape_coefficient, radial_map
from sim.rig import SQUARE_RIG, Rig

ROOT = Path(__file__).resolve().parents[2]
CAPTURES = Path(__file__).resolve().parents[3] / "shared" / "captures"
CAMERA = nominal_camera()


def cone(count: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """A plate with a lopsided skirt: positions and faces."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
    hem = ring * (0.08 + 0.02 * np.cos(angle))[:, None] - [0, 0, 0.09]
    positions = np.vstack([np.zeros((1, 3)), 0.05 * ring, hem])
    here, after = np.arange(count), np.roll(np.arange(count), -1)
    top = np.stack([np.zeros(count, int), 1 + here, 1 + after], axis=1)
    first = np.stack([1 + here, 1 + count + here, 1 + count + after], axis=1)
    second = np.stack([1 + here, 1 + count + after, 1 + after], axis=1)
    return positions, np.vstack([top, first, second])


@pytest.fixture(scope="module")
def renderer() -> DepthRenderer:
    return DepthRenderer(*cone())


@pytest.fixture(scope="module")
def views(renderer) -> np.ndarray:
    return renderer.views(CAMERA, 0.3)


@pytest.fixture
def folder(tmp_path, views) -> Path:
    """A good capture in the 16-bit format."""
    path = tmp_path / "capture"
    write_capture(path, views=views, intrinsics=CAMERA.intrinsics, density=0.15, rig=SQUARE_RIG,
                  warp_direction=0.3)
    return path


@pytest.fixture
def published(tmp_path, views) -> Path:
    """A good capture in the 8-bit format."""
    path = tmp_path / "published"
    path.mkdir()
    for k, view in enumerate(views):
        Image.fromarray(np.rint(view * 255).astype(np.uint8)).save(path / f"{k}.png")
    (path / "density.txt").write_text("data0 300")
    return path


def edit(folder: Path, **changes: object) -> None:
    """Change keys of capture.yaml; None removes one."""
    file = folder / "capture.yaml"
    content = {**yaml.safe_load(file.read_text()), **changes}
    file.write_text(yaml.safe_dump({k: v for k, v in content.items() if v is not None}))


def test_what_is_written_is_read(folder, views):
    capture = read_capture(folder)
    assert capture.views.shape == (4, 180, 240) and capture.views.dtype == np.float32
    assert np.abs(capture.views - views).max() < 0.51e-3
    assert ((capture.views > 0) == (views > 0)).all()
    assert capture.intrinsics == CAMERA.intrinsics and capture.rig == SQUARE_RIG
    assert capture.density == pytest.approx(0.15)
    assert capture.warp_direction == pytest.approx(0.3)
    assert capture.path == folder and capture.warnings == ()


def test_depth_unit_and_direction_are_converted(tmp_path, views):
    path = tmp_path / "fine"
    write_capture(
        path, views=views, intrinsics=CAMERA.intrinsics, density=0.2, rig=SQUARE_RIG,
        depth_unit=1e-4, warp_direction=math.radians(200),
    )  # fmt: skip
    capture = read_capture(path)
    assert np.abs(capture.views - views).max() < 0.051e-3
    assert capture.warp_direction == pytest.approx(math.radians(20), abs=1e-6)
    content = yaml.safe_load((path / "capture.yaml").read_text())
    assert content["density_g_m2"] == 200 and content["warp_direction_deg"] == pytest.approx(200)
    edit(path, warp_direction_deg=None)
    assert read_capture(path).warp_direction is None


def test_writing_refuses_and_leaves_nothing_behind(tmp_path, views):
    common = {"intrinsics": CAMERA.intrinsics, "density": 0.15, "rig": SQUARE_RIG}
    with pytest.raises(InputError, match="9 views given; a capture has 1 to 8"):
        write_capture(tmp_path / "many", views=np.repeat(views, 3, axis=0)[:9], **common)
    with pytest.raises(InputError, match="16 bits"):
        write_capture(tmp_path / "far", views=views, depth_unit=1e-6, **common)
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="exists already"):
        write_capture(tmp_path / "taken", views=views, **common)
    assert [p.name for p in tmp_path.rglob("*")] == ["taken", "notes.txt"]
    with pytest.raises(InputError, match="cannot write the capture"):
        write_capture(tmp_path / "taken" / "notes.txt" / "below", views=views, **common)


@pytest.mark.parametrize("name", ["disc254_support127", "square250_cylinder60", *TESTERS])
def test_a_tester_is_a_name_or_numbers_and_a_face_is_kept(tmp_path, views, name):
    write_capture(tmp_path / "a", views=views, intrinsics=CAMERA.intrinsics, density=0.2,
                  rig=Rig.from_name(name), face="down")
    content = yaml.safe_load((tmp_path / "a" / "capture.yaml").read_text())
    assert isinstance(content["tester"], str) == (name in TESTERS)
    for value in (content["tester"], name):
        edit(tmp_path / "a", tester=value)
        capture = read_capture(tmp_path / "a")
        assert capture.rig == Rig.from_name(name) and capture.face == "down"
    with pytest.raises(InputError, match="tester=disc500_support180 has a specimen of 500 mm"):
        write_capture(tmp_path / "b", views=views, intrinsics=CAMERA.intrinsics, density=0.2,
                      rig=Rig.from_name("disc500_support180"))


def test_published_format_is_recognised(published, views):
    capture = read_capture(published)
    assert np.abs(capture.views - views).max() < 0.51 / 255
    assert capture.density == pytest.approx(0.3) and capture.warp_direction is None
    assert capture.rig == SQUARE_RIG and capture.face == "up"
    assert capture.intrinsics == CAMERA.intrinsics and "8-bit" in capture.warnings[0]


def test_published_background_is_zero_or_bright_and_large_pictures_are_decimated(published, views):
    for k, view in enumerate(views):
        counts = np.rint(view * 255).astype(np.uint8)
        counts[counts == 0] = 251 + k
        large = np.repeat(np.repeat(counts, 2, axis=0), 2, axis=1)
        large[1::2] = large[:, 1::2] = 77  # the rows and columns that are left out
        Image.fromarray(large).save(published / f"{k}.png")
    capture = read_capture(published)
    assert capture.views.shape == views.shape
    assert ((capture.views > 0) == (views > 0)).all()


def test_cloth_at_the_border_is_a_warning(folder):
    picture = np.array(Image.open(folder / "view_2.png"))
    picture[picture[:, 120].nonzero()[0][-1] :, 120] = 520
    Image.fromarray(picture).save(folder / "view_2.png")
    assert read_capture(folder).warnings == ("view 2: the cloth touches the picture's border",)


def test_what_lies_apart_from_the_cloth_does_not_count(folder):
    file = folder / "view_2.png"
    clean = np.array(Image.open(file))
    spoiled = clean.copy()
    far = np.argwhere(ndimage.distance_transform_edt(clean == 0) > 8)
    for row, column in (far[0], far[-1]):
        spoiled[row, column] = 540
    touching = np.argwhere((clean == 0) & ndimage.binary_dilation(clean > 0, iterations=2)
                           & ~ndimage.binary_dilation(clean > 0))
    spoiled[tuple(touching[0])] = 540  # noise at the edge
    Image.fromarray(spoiled).save(file)
    capture = read_capture(folder)
    assert not any("apart" in w for w in capture.warnings)  # any sensor has two such pixels
    expected = np.where(spoiled == clean, clean, 0) * 1e-3
    expected[tuple(touching[0])] = 0.540
    assert np.allclose(capture.views[2], expected)
    spoiled[tuple(far[::97].T)] = 540
    Image.fromarray(spoiled).save(file)
    assert any("pixels left out that lie apart from the cloth" in w
               for w in read_capture(folder).warnings)


def test_a_view_with_half_of_the_cloth_is_reported(folder):
    file = folder / "view_2.png"
    clean = np.array(Image.open(file))
    half = np.median(np.nonzero(clean)[0])
    Image.fromarray(np.where(np.arange(len(clean))[:, None] < half, clean, 0)).save(file)
    assert any("view 2 shows" in w and "of the median" in w for w in read_capture(folder).warnings)


def test_depths_unlike_all_around_them_are_left_out(folder):
    file = folder / "view_2.png"
    clean = np.array(Image.open(file))
    spoiled = clean.copy()
    inside = np.argwhere(ndimage.binary_erosion(clean > 0, iterations=3))
    spoiled[tuple(inside[0])] = 60000  # a hot pixel
    Image.fromarray(spoiled).save(file)
    capture = read_capture(folder)
    assert not capture.warnings
    assert (capture.views[2] > 0).sum() == (clean > 0).sum() - 1
    spoiled[tuple(inside[:: len(inside) // 60].T)] = 1  # speckle
    Image.fromarray(spoiled).save(file)
    capture = read_capture(folder)
    assert capture.views.max() < 1.0 and capture.views[capture.views > 0].min() > 0.2
    assert any("differs from their neighbours'" in w for w in capture.warnings)


def test_saturated_counts_are_no_depth(folder):
    before = read_capture(folder).views
    for file in folder.glob("view_*.png"):
        counts = np.array(Image.open(file))
        Image.fromarray(np.where(counts == 0, 65535, counts).astype(np.uint16)).save(file)
    np.testing.assert_array_equal(read_capture(folder).views, before)


def test_a_large_piece_beside_the_cloth_stays_and_is_told(folder):
    file = folder / "view_1.png"
    spoiled = np.array(Image.open(file))
    assert not spoiled[:20, :30].any()
    spoiled[1:19, 1:29] = 700
    Image.fromarray(spoiled).save(file)
    capture = read_capture(folder)
    assert (capture.views[1][1:19, 1:29] > 0).all()
    assert any("504 pixels lie apart" in warning for warning in capture.warnings)



def remove(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).unlink()


def copy(source: str, target: str) -> Callable[[Path], None]:
    return lambda folder: (folder / target).write_bytes((folder / source).read_bytes())


def picture(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        counts = change(np.array(Image.open(folder / name)))
        Image.fromarray(np.ascontiguousarray(counts)).save(folder / name)

    return apply


def pictures(change: Callable[[np.ndarray], np.ndarray], names: str) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        for k in range(4):
            picture(names.format(k), change)(folder)

    return apply


def truncate(name: str, share: float) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        data = (folder / name).read_bytes()
        (folder / name).write_bytes(data[: int(share * len(data))])

    return apply


def write(name: str, data: bytes) -> Callable[[Path], None]:
    return lambda folder: (folder / name).write_bytes(data)


def only(name: str, make: Callable[[Path], object]) -> Callable[[Path], None]:
    """The views replaced by one file."""
    def apply(folder: Path) -> None:
        for file in folder.glob("view_*.png"):
            file.unlink()
        make(folder / name)

    return apply


def linked(name: str, target: str) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        (folder / name).unlink()
        (folder / name).symlink_to(target)

    return apply


def chunk(change: Callable[[bytes, int, int], bytes]) -> Callable[[Path], None]:
    """Change a picture, given the start and the end of the chunk of its pixels."""
    def apply(folder: Path) -> None:
        file = folder / "view_1.png"
        data = file.read_bytes()
        start = data.index(b"IDAT") - 4
        end = start + 12 + int.from_bytes(data[start : start + 4], "big")
        file.write_bytes(change(data, start, end))

    return apply


def npy(header: bytes) -> Callable[[Path], object]:
    start = b"\x93NUMPY\x01\x00" + (len(header) + 1).to_bytes(2, "little")
    return lambda file: file.write_bytes(start + header + b"\n" + bytes(60 * 80 * 8))


def ply(count: int) -> Callable[[Path], object]:
    return lambda file: file.write_text(
        f"ply\nformat ascii 1.0\nelement vertex {count}\nproperty float x\nproperty float y\n"
        "property float z\nend_header\n0 0 1\n")


def pickled(file: Path) -> None:
    np.save(file, np.array([{"a": 1}], dtype=object), allow_pickle=True)


def setting(**changes: object) -> Callable[[Path], None]:
    return lambda folder: edit(folder, **changes)


DISC = {"specimen": "disc", "size_mm": 300, "plate_mm": 180}
GOOD = {"fx": 305.0, "fy": 305.0, "cx": 119.5, "cy": 89.5}

BAD_METRIC = {
    "missing view": (remove("view_2.png"), "view_2.png is missing"),
    "view 10": (copy("view_0.png", "view_10.png"), "view_4.png is missing"),
    "a picture twice": (
        copy("view_1.png", "view_3.png"), "view_1.png and view_3.png are the same picture"),
    "a picture written twice": (
        pictures(lambda a: np.where(np.indices(a.shape)[1] % 80 < 40, 500, 0).astype(a.dtype),
                 "view_{}.png"), "view_0.png and view_1.png are the same picture"),
    "blank pictures": (pictures(lambda a: a * 0, "view_{}.png"), "view 0 shows no cloth"),
    "views of two sizes": (picture("view_1.png", lambda a: a[:, ::2]), "view_1.png has 120x180"),
    "too small": (pictures(lambda a: a[::4, ::4], "view_{}.png"), "60x45 pixels; views have from"),
    "intrinsics of another size": (
        pictures(lambda a: a[::2, ::2], "view_{}.png"), "inner part of the 120x90 picture"),
    "all background": (picture("view_3.png", lambda a: a * 0), "view 3 shows no cloth"),
    "a few pixels": (
        picture("view_3.png", lambda a: a * (np.arange(240) == 120)), "view 3 shows only "),
    "no background": (
        picture("view_1.png", lambda a: np.where(a > 0, a, 900).astype(a.dtype)),
        "view 1 shows the whole scene (has no background) but view 0 is cut out"),
    "three views without turns": (remove("view_3.png"), "turns_deg is missing"),
    "turns in radians": (setting(turns_deg=[0, 1.571, 3.142, 4.712]), "give degrees"),
    "depth in other units": (setting(depth_unit_m=1.0), "the cloth is 100 m from the camera"),
    "truncated picture": (truncate("view_1.png", 0.6), "view_1.png cannot be read"),
    "truncated header": (truncate("view_1.png", 0.005), "view_1.png cannot be read"),
    "empty picture": (write("view_0.png", b""), "view_0.png cannot be read"),
    "text called png": (write("view_0.png", b"not a picture\n"), "view_0.png cannot be read"),
    "a wrong checksum": (chunk(lambda data, start, end: data[: end - 1] + b"?" + data[end:]),
                         "view_1.png cannot be read"),
    "no pixels": (chunk(lambda data, start, end: data[:start] + data[end:]),
                  "view_1.png cannot be read"),
    "a pipe": (only("view_0.png", os.mkfifo), "not a regular file"),
    "a device": (linked("view_1.png", "/dev/zero"), "not a regular file"),
    "8-bit": (picture("view_0.png", lambda a: (a // 4).astype(np.uint8)), "must be 16-bit grey"),
    "colour": (
        picture("view_0.png", lambda a: np.stack([a // 4] * 3, axis=-1).astype(np.uint8)),
        "must be 16-bit grey"),
    "another background": (
        lambda folder: Image.fromarray(np.full((90, 240), 800, np.uint16)).save(
            folder / "background.png"), "background.png has 240x90 pixels, the views have 240x180"),
    "two formats": (
        lambda folder: np.save(folder / "view_0.npy", np.ones((180, 240))),
        "holds view_0.png and view_0.npy"),
    "a frame of a view missing": (
        only("view_0_1.png", lambda file: file.write_bytes(b"")), "view_0_0.png is missing"),
    "an array of objects": (only("view_0.npy", pickled), "view_0.npy cannot be read"),
    "an array of huge size": (only("view_0.npy", npy(
        b"{'descr': '<f4', 'fortran_order': False, 'shape': (1000000, 1000000), }")), "cannot be"),
    "a torn header": (only("view_0.npy", npy(b"{'descr': '<f8', 'shape': (60, 80")), "cannot be"),
    "a nested header": (only("view_0.npy", npy(b"((((((((")), "view_0.npy cannot be read"),
    "whole numbers": (
        only("view_0.npy", lambda file: np.save(file, np.ones((180, 240), int))), "floating-point"),
    "millimetres": (only("view_0.npy", lambda file: np.save(file, np.full((180, 240), 540.0))),
                    "median depth is 540, which cannot be metres"),
    "a pipe for an array": (only("view_0.npy", os.mkfifo), "not a regular file"),
    "points without size_px": (only("view_0.ply", ply(1)), "point clouds need size_px"),
    "no EXR": (only("view_0.exr", lambda file: file.write_text("no picture")), "cannot be read"),
    "no recording": (only("take.bag", lambda file: file.write_text("none")), "cannot be read"),
    "a video": (only("take.mkv", lambda file: file.write_text("")), "the folder holds 'take.mkv'"),
    "NaN density": (setting(density_g_m2=float("nan")), "finite number"),
    "negative density": (setting(density_g_m2=-150), "density_g_m2=-150"),
    "density in kg": (setting(density_g_m2=0.15), "density_g_m2=0.15"),
    "heavy density": (setting(density_g_m2=1000.1), "density_g_m2=1000.1"),
    "density in words": (setting(density_g_m2="light"), "density_g_m2='light'"),
    "density true": (setting(density_g_m2=True), "=True"),
    "no density": (setting(density_g_m2=None), "density_g_m2 is missing"),
    "no intrinsics": (setting(intrinsics=None), "intrinsics is missing; give fx, fy, cx and cy"),
    "half the intrinsics": (
        setting(intrinsics={"fx": 305.0}), "intrinsics.fy is missing; intrinsics.cx"),
    "NaN focal length": (setting(intrinsics=GOOD | {"fx": float("inf")}), "intrinsics.fx=inf"),
    "negative focal length": (
        setting(intrinsics=GOOD | {"fy": -305.0}), "intrinsics.fy=-305.0"),
    "negative unit": (setting(depth_unit_m=-0.001), "depth_unit_m=-0.001"),
    "direction in words": (setting(warp_direction_deg="left"), "warp_direction_deg='left'"),
    "former key": (setting(rig="disc300_support180"), "unknown key 'rig'"),
    "unknown tester": (setting(tester="disc300"), "tester='disc300' is not a tester; give squ"),
    "list for a tester": (setting(tester=["disc300"]), "tester=['disc300'] is not a tester"),
    "tester without plate": (
        setting(tester="square300_corners200"), "has a plate of 0 mm; give 60 to 200 mm"),
    "tester without size": (
        setting(tester={"specimen": "disc", "plate_mm": 180}), "size_mm is missing"),
    "misspelt size": (setting(tester={**DISC, "size": 1}), "(unknown key 'size'"),
    "oval": (setting(tester={**DISC, "specimen": "oval"}), "(specimen='oval'"),
    "size in words": (setting(tester={**DISC, "size_mm": "wide"}), "(size_mm='wide'"),
    "size in m": (setting(tester={**DISC, "size_mm": 0.3}), "a plate of 180 mm under a specim"),
    "large specimen": (setting(tester={**DISC, "size_mm": 401}), "a specimen of 401 mm; give 200"),
    "small specimen": (setting(tester="disc199_support100"), "a specimen of 199 mm; give 200"),
    "small plate": (setting(tester={**DISC, "plate_mm": 59.5}), "has a plate of 59.5 mm; give 60"),
    "large plate": (setting(tester={**DISC, "plate_mm": 201}), "has a plate of 201 mm; give 60"),
    "short overhang": (
        setting(tester={**DISC, "size_mm": 218}), "has an overhang of 19 mm; give 20 mm or more"),
    "cut at an angle": (setting(tester="square300_cylinder100_cut45"), "cut at an angle"),
    "no tester": (setting(tester=None), "states no tester; give tester: square300"),
    "another face": (setting(face="left"), "face='left'"),
    "lines in a key": (write("capture.yaml", b'"a\\nb": 1\n'), "unknown key 'a\\nb'"),
    "endless density": (setting(density_g_m2=10**400), "density_g_m2=1000"),
    "misspelt key": (setting(density=150), "unknown key 'density'"),
    "broken YAML": (write("capture.yaml", b"density_g_m2: [1\n"), "is not valid YAML"),
    "YAML of a list": (write("capture.yaml", b"- 150\n"), "must hold 'key: value' lines"),
    "binary YAML": (write("capture.yaml", b"\xff\xfe\x00"), "is not UTF-8 text"),
    "an object in YAML": (
        write("capture.yaml", b"!!python/object/apply:os.getcwd []\n"), "is not valid YAML"),
    "no description": (remove("capture.yaml"), "neither capture.yaml nor density.txt"),
}  # fmt: skip

BAD_POINTS = {
    "many points": (ply(999999999), "too many"),
    "no PLY": (lambda file: file.write_text("solid\n"), "view_0.ply cannot be read"),
    "half a PLY": (lambda file: file.write_text("ply\nelement vertex 5\n"), "cannot be read"),
    "points behind": (lambda file: trimesh.PointCloud(-np.eye(3)).export(file),
                      "no point in front"),
    "points aside": (lambda file: trimesh.PointCloud([[9.0, 0.0, 0.5]]).export(file),
                     "fall outside the picture"),
}

BAD_PUBLISHED = {
    "missing view": (remove("0.png"), "0.png is missing"),
    "a picture twice": (copy("2.png", "0.png"), "0.png and 2.png are the same picture"),
    "wrong size": (pictures(lambda a: a[:160], "{}.png"), "240x160 pixels; the 8-bit format has"),
    "all background": (picture("2.png", lambda a: a * 0 + 255), "view 2 shows no cloth"),
    "truncated picture": (truncate("3.png", 0.7), "3.png cannot be read"),
    "16-bit": (picture("1.png", lambda a: a.astype(np.uint16) * 4), "must be 8-bit grey"),
    "NaN density": (write("density.txt", b"data0 nan"), "finite number"),
    "negative density": (write("density.txt", b"data0 -300"), "-300.0"),
    "density in words": (write("density.txt", b"data0 thick"), "'thick'"),
    "no density": (write("density.txt", b"\n"), "must hold one line"),
    "many densities": (write("density.txt", b"data0 300\ndata1 200\n"), "must hold one line"),
}


def assert_refused(path: Path, message: str) -> None:
    before = sorted(path.rglob("*"))
    with pytest.raises(InputError) as raised:
        read_capture(path)
    text = str(raised.value)
    assert message in text
    assert "\n" not in text and path.name in text and len(text) < 600
    assert sorted(path.rglob("*")) == before


@pytest.mark.parametrize("fault", BAD_METRIC)
def test_bad_capture_is_refused_in_one_line(folder, fault):
    spoil, message = BAD_METRIC[fault]
    spoil(folder)
    assert_refused(folder, message)


@pytest.mark.parametrize("fault", BAD_POINTS)
def test_bad_points_are_refused_in_one_line(folder, fault):
    make, message = BAD_POINTS[fault]
    edit(folder, size_px=[240, 180])
    only("view_0.ply", make)(folder)
    assert_refused(folder, message)


@pytest.mark.parametrize("fault", BAD_PUBLISHED)
def test_bad_published_capture_is_refused_in_one_line(published, fault):
    spoil, message = BAD_PUBLISHED[fault]
    spoil(published)
    assert_refused(published, message)


def test_a_folder_that_is_none(tmp_path, folder):
    with pytest.raises(InputError, match="nowhere: the folder does not exist"):
        read_capture(tmp_path / "nowhere")
    with pytest.raises(InputError, match="is not a folder"):
        read_capture(folder / "view_0.png")
    (tmp_path / "empty").mkdir()
    assert_refused(tmp_path / "empty", "neither capture.yaml nor density.txt")


@pytest.mark.skipif(not CAPTURES.is_dir(), reason="the published captures are not here")
@pytest.mark.parametrize("name", ["mesh0", "mesh1"])
def test_the_published_captures_are_read(name):
    capture = read_capture(CAPTURES / name)
    assert isinstance(capture, Capture) and capture.views.shape == (4, 180, 240)
    assert capture.density == pytest.approx(0.3)
    cloth = capture.views[capture.views > 0]
    assert 0.45 < cloth.min() and cloth.max() < 0.66


@pytest.mark.parametrize(("word", "complaint"), [
    ("density=5000", "density_g_m2=5000.0.*; weigh"),
    ("out=/proc/capture", "cannot write to the folder /proc/capture"),
    ("out=", "out= is empty; give the name of a folder"),
])
def test_mistakes_of_the_example_are_told_before_the_drape(tmp_path, word, complaint, monkeypatch):
    main = runpy.run_path(str(ROOT / "examples" / "make_capture.py"))["main"]
    monkeypatch.setitem(main.__globals__, "drape", None)
    with pytest.raises(InputError, match=complaint):
        main(last(f"out={tmp_path}", word))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("seed", [7, 8])
def test_the_example_makes_whole_scenes_of_the_same_drape(tmp_path, seed):
    main = runpy.run_path(str(ROOT / "examples" / "make_capture.py"))["main"]
    coefficients = []
    for raw in ("false", "true"):  # the second replaces the first
        main([f"out={tmp_path / 'c'}", f"raw={raw}", "edge_mm=12", f"seed={seed}"])
        capture = read_capture(tmp_path / "c")
        found = radial_map(LocatedViews.of(capture))
        coefficients.append(drape_coefficient(found, Rig()))
    assert (tmp_path / "c" / "background.png").is_file()
    assert capture.cut and len(capture.views) == 4
    assert coefficients[1] == pytest.approx(coefficients[0], abs=0.02)
