"""Every bad capture is refused in one clear line."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from cloths import describe
from PIL import Image

from common.errors import InputError
from data.captures.reader import read_capture


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
    return lambda folder: describe(folder, **changes)


DISC = {"specimen": "disc", "size_mm": 300, "plate_mm": 180}
SIDES = {"specimen": "rectangle", "size_mm": [170, 250], "plate_mm": 90}
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
    "a number for a name": (setting(fabric=12), "in quotes if they are a number"),
    "a date in another order": (setting(date="26.11.2026"), "give YYYY-MM-DD"),
    "depth in other units": (setting(depth_unit_m=1.0), "the cloth is 100 m from the camera"),
    "truncated picture": (truncate("view_1.png", 0.6), "view_1.png cannot be read"),
    "text called png": (write("view_0.png", b"not a picture\n"), "view_0.png cannot be read"),
    "a wrong checksum": (chunk(lambda data, start, end: data[: end - 1] + b"?" + data[end:]),
                         "view_1.png cannot be read"),
    "no pixels": (chunk(lambda data, start, end: data[:start] + data[end:]),
                  "view_1.png cannot be read"),
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
    "whole numbers": (
        only("view_0.npy", lambda file: np.save(file, np.ones((180, 240), int))), "floating-point"),
    "millimetres": (only("view_0.npy", lambda file: np.save(file, np.full((180, 240), 540.0))),
                    "median depth is 540, which cannot be metres"),
    "points without size_px": (only("view_0.ply", ply(1)), "point clouds need size_px"),
    "a recording of another kind": (
        only("take.mkv", lambda file: file.write_text("")), "'take.mkv' is a recording of Azure"),
    **{f"views in {end}": (only(f"view_0{end}", lambda file: file.write_text("")),
                           f"'view_0{end}' is {what}") for end, what in (
        (".raw", "bare pixels without their size; save"), (".pcd", "a point cloud of PCL; save"),
        (".npz", "an archive of arrays"), (".JPEG", "an 8-bit picture"), (".tiff", "TIFF; save"))},
    "another file": (only("depth.txt", lambda file: file.write_text("")),
                     "view_0.png is missing (the folder holds 'depth.txt')"),
    "a decimal comma": (write("capture.yaml", b"density_g_m2: 210,5\n"),
                        "density_g_m2=210,5 has a decimal comma; write a point"),
    "decimal commas in braces": (
        write("capture.yaml", b"density_g_m2: 210\nintrinsics: {fx: 305,0, fy: 305,0}\n"),
        "a decimal comma before 0; write a point, such as 305.0"),
    "keys of an SDK": (
        setting(intrinsics={**GOOD, "ppx": 119.5, "ppy": 89.5, "model": "none", "width": 240}),
        "unknown keys 'intrinsics.model', 'intrinsics.ppx', 'intrinsics.ppy', 'intrinsics.width'; "
        "give fx, fy, cx and cy in pixels"),
    "NaN density": (setting(density_g_m2=float("nan")), "finite number"),
    "weight and density": (setting(weight_g=20.0), "both state the density; give one of them"),
    "weight of no specimen": (setting(weight_g=20.0, density_g_m2=None, tester=None),
                              "weight_g is of the whole specimen; state tester"),
    "weight of an unknown specimen": (setting(weight_g=20.0, density_g_m2=None, tester="disc"),
                                      "tester='disc' is not a tester; give"),
    "weight in words": (setting(weight_g="20 g", density_g_m2=None), "weight_g='20 g'"),
    "weight of a kilogram": (setting(weight_g=1000.0, density_g_m2=None), "density_g_m2=11111"),
    "density in kg": (setting(density_g_m2=0.15), "density_g_m2=0.15"),
    "heavy density": (setting(density_g_m2=1000.1), "density_g_m2=1000.1"),
    "density in words": (setting(density_g_m2="light"), "density_g_m2='light'"),
    "no density": (setting(density_g_m2=None), "density_g_m2 is missing"),
    "no intrinsics": (setting(intrinsics=None), "intrinsics is missing; give fx, fy, cx and cy"),
    "half the intrinsics": (
        setting(intrinsics={"fx": 305.0}), "intrinsics.fy is missing; intrinsics.cx"),
    "NaN focal length": (setting(intrinsics=GOOD | {"fx": float("inf")}), "intrinsics.fx=inf"),
    "negative focal length": (
        setting(intrinsics=GOOD | {"fy": -305.0}), "intrinsics.fy=-305.0"),
    "negative unit": (setting(depth_unit_m=-0.001), "depth_unit_m=-0.001"),
    "direction in words": (setting(warp_direction_deg="left"), "warp_direction_deg='left'"),
    "former key": (setting(rig="disc300_support180"), "unknown key 'rig'; the keys are "),
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
    "small rectangle": (
        setting(tester="rectangle130x250_cylinder90"), "a specimen of 130x250 mm; give 140 to 400"),
    "rectangle with one side": (
        setting(tester={**SIDES, "size_mm": 250}), "(size_mm=250: Input should be a valid list; "
        "give both sides of a rectangle, along warp and weft, such as [170, 250])"),
    "square with two sides": (setting(tester={**SIDES, "specimen": "square"}), "size_mm=[170"),
    "rectangle with a short overhang": (
        setting(tester={**SIDES, "plate_mm": 150}), "has an overhang of 10 mm; give 20 mm or more"),
    "small plate": (setting(tester={**DISC, "plate_mm": 59.5}), "has a plate of 59.5 mm; give 60"),
    "large plate": (setting(tester={**DISC, "plate_mm": 201}), "has a plate of 201 mm; give 60"),
    "short overhang": (
        setting(tester={**DISC, "size_mm": 218}), "has an overhang of 19 mm; give 20 mm or more"),
    "cut at an angle": (setting(tester="square300_cylinder100_cut45"), "cut at an angle"),
    "no tester": (setting(tester=None), "states no tester; give tester: square300"),
    "another face": (setting(face="left"), "face='left'"),
    "lines in a key": (write("capture.yaml", b'"a\\nb": 1\n'), "unknown key 'a\\nb'"),
    "endless density": (setting(density_g_m2=10**400), "density_g_m2=1000"),
    "misspelt key": (setting(density=150), "size_px, outline, known"),
    "broken YAML": (write("capture.yaml", b"density_g_m2: [1\n"), "is not valid YAML"),
    "YAML of a list": (write("capture.yaml", b"- 150\n"), "must hold 'key: value' lines"),
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
    "wrong size": (pictures(lambda a: a[:160], "{}.png"), "240x160 pixels; the 8-bit format has"),
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
    describe(folder, size_px=[240, 180])
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
