"""Sound sources of each kind, and what spoils them: what the tables of tests/refused name."""

import base64
import json
import os
import shutil
import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import photographs
import strip_photographs
import trimesh
import yaml
from checkpoints import describe_again, description, save_untrained
from cloths import describe, lopsided_views, waves
from estimates import document_of, estimate_of
from PIL import Image, ImageOps
from safetensors.numpy import load, save, save_file

import apps.capture
import apps.drape
import data.dataset.generate
import data.dataset.inspect
import data.fabrics.prior.__main__
import drapenet.export.__main__
import examples.make_capture
import examples.make_strips
import experiments.__main__
import infer
import train
from common.configs import read_option
from common.errors import of
from common.files import replace_json
from data.captures.arrays import checked_capture
from data.captures.capture import Capture, DepthCapture
from data.captures.description import whole_turns
from data.captures.raw_scans import read_raw_scan
from data.captures.reader import read_capture
from data.captures.writer import write_capture
from data.dataset.folder import MANIFEST, read_manifest
from data.dataset.shards import SCHEMA_VERSION
from data.fabrics.fabrics import TABLE_COLUMNS, read_fabric_table
from data.fabrics.prior import TablePrior, load_prior, save_prior
from data.render.cameras import nominal_camera
from data.render.setups import Setups
from drapenet.fabric.entries import entries_of
from drapenet.measured.strips.folder import read_strips
from drapenet.measured.tension.folder import read_tension
from drapenet.network.checkpoint import read_header
from drapenet.result.files import ESTIMATE
from sim.material import MICRO
from sim.rig import DISC_RIG, SQUARE_RIG
from sim.scene import make_specimen

READER, COMMAND, SERVICE = "reader", "command", "service"
TWILL = Path(__file__).parents[1] / "examples" / "captures" / "twill"
BIAS_STRIP = {"direction": "bias", "width_mm": 50, "gauge_mm": 100, "load_g": 25,
              "extension_mm": 4.1}
LENGTHS = {"density_g_m2": 210, "strips": [{"direction": "warp", "bending_length_mm": 21.5},
                                           {"direction": "weft", "bending_length_mm": 18}]}


@dataclass(frozen=True)
class Start:
    """A sound source: its ``write`` fills a folder, its ``read`` is what Python calls.

    Attributes:
        command: with its ``words``, in which {} is the folder.
        description: the file that ``set`` changes.
        fields: of the service's form.
        doors: those that its rows take, unless they name others.
    """

    write: Callable[[Path], object] = Path.exists
    read: Callable[[Path], object] = read_capture
    command: Callable[[list[str]], None] = infer.main
    words: tuple[str, ...] = ("capture={}",)
    description: str = "capture.yaml"
    fields: Mapping[str, str] = field(default_factory=dict)
    doors: tuple[str, ...] = (READER, COMMAND, SERVICE)


def _views(folder: Path) -> None:
    """In the 16-bit format."""
    write_capture(folder, views=lopsided_views(), intrinsics=nominal_camera().intrinsics,
                  density=0.15, rig=SQUARE_RIG, warp_direction=0.3)


def _published(folder: Path) -> None:
    """In the 8-bit format."""
    for k, view in enumerate(lopsided_views()):
        Image.fromarray(np.rint(view * 255).astype(np.uint8)).save(folder / f"{k}.png")
    (folder / "density.txt").write_text("data0 300")


def _photograph(folder: Path) -> None:
    photographs.write(folder, photographs.drawn(), warp_direction_deg=70, outline={
        "plate_px": photographs.plate(), "camera_height_mm": 1200})


def _outline(folder: Path) -> None:
    text = "".join(f"{x:.4f},{y:.4f}\n" for x, y in 1e3 * photographs.CURVE[::4])
    photographs.write(folder, text, "outline.csv", outline={"unit": "mm"})


def _over_mat(folder: Path) -> None:
    photographs.write_over_mat(folder, photographs.over_mat())


def _strip(folder: Path) -> None:
    """A photograph of one."""
    scene = strip_photographs.LONG
    strip_photographs.write(folder, {"strip.png": strip_photographs.photograph(scene)},
                            [strip_photographs.entry(scene)])


def _described(name: str, content: object) -> Callable[[Path], None]:
    """A folder of a description alone."""
    def write(folder: Path) -> None:
        (folder / name).write_text(yaml.safe_dump(content))

    return write


def _scan(folder: Path) -> None:
    """A raw scan of a disc."""
    mesh = make_specimen(DISC_RIG, edge=12e-3).mesh
    trimesh.Trimesh(waves(mesh.rest, folds=5), mesh.faces, process=False).export(
        folder / "scan.ply")


def _checkpoint(folder: Path) -> None:
    save_untrained(folder / "net.safetensors", width=4)


def _estimate(folder: Path) -> None:
    document = document_of(estimate_of(MICRO * np.array([52, 31, 22]), np.zeros(3)))
    replace_json(folder / ESTIMATE, document.content())


def _setups(folder: Path) -> Setups:
    with of(folder):
        return Setups.from_config(yaml.safe_load((folder / "setup.yaml").read_text()))


def _manifest(folder: Path) -> None:
    """That of a finished dataset."""
    sampling = {"testers": ["disc300_support180"], "random_testers": 0.0}
    replace_json(folder / MANIFEST, {
        "schema_version": SCHEMA_VERSION,
        "drapes": 3,
        "identity": "abc",
        "complete": True,
        "hash": "def",
        "shards": {"a.h5": "1"},
        "config": {"sampling": sampling, "prior": {}}})


def _prior(name: str) -> Start:
    """A bundled one."""
    return Start(lambda folder: save_prior(load_prior(name), folder / "p.json"),
                 lambda folder: load_prior(folder / "p.json"), description="p.json",
                 doors=(READER,))


def _fabrics(folder: Path) -> None:
    """A table of fabrics."""
    rows = ["0.30, 2000, 1000, 1500, -20, -10, 15", "0.15, 9000, 4000, 6000, -900, -400, -600"]
    (folder / "fabrics.csv").write_text("\n".join([", ".join(TABLE_COLUMNS), *rows, ""]))


def capture_of_arrays(**changes: object) -> Capture:
    """Views on a turntable, with the ``changes``, as they are checked."""
    sound = DepthCapture(lopsided_views(), nominal_camera().intrinsics, whole_turns(4),
                         density=0.15, rig=SQUARE_RIG, warp_direction=0.3)
    return checked_capture(replace(sound, **changes))


STRIPS = {"words": ("strips={}",), "description": "strips.yaml", "read": read_strips}
STARTS = {
    "views": Start(_views),
    "published": Start(_published, description="density.txt"),
    "photograph": Start(_photograph),
    "outline": Start(_outline),
    "mat": Start(_over_mat),
    "strip": Start(_strip, **STRIPS),
    "lengths": Start(_described("strips.yaml", LENGTHS), **STRIPS),
    "tension": Start(
        _described("tension.yaml", {"density_g_m2": 210, "tension": [BIAS_STRIP]}),
        read_tension, words=("tension={}",), description="tension.yaml"),
    "scan": Start(_scan, lambda folder: read_raw_scan(folder / "scan.ply", DISC_RIG),
                  words=("scan={}/scan.ply", "density_g_m2=150"), fields={"density_g_m2": "150"}),
    "checkpoint": Start(_checkpoint, lambda folder: read_header(folder / "net.safetensors"),
                        words=("checkpoint={}/net.safetensors", f"capture={TWILL}"),
                        description="net.safetensors", doors=(READER, COMMAND)),
    "description": Start(doors=(READER,)),
    "nothing": Start(doors=(READER, COMMAND)),
    "command": Start(words=(), doors=(COMMAND,)),
    "drape": Start(command=apps.drape.main, words=(), doors=(COMMAND,)),
    "prior": Start(command=data.fabrics.prior.__main__.main, words=(), doors=(COMMAND,)),
    "dataset": Start(command=data.dataset.generate.main, words=(), doors=(COMMAND,)),
    "inspection": Start(command=data.dataset.inspect.main, words=(), doors=(COMMAND,)),
    "training": Start(command=train.main, words=("data=/none",), doors=(COMMAND,)),
    "export": Start(_estimate, command=drapenet.export.__main__.main, description=ESTIMATE,
                    words=("estimate={}/estimate.json",), doors=(COMMAND,)),
    "study": Start(command=experiments.__main__.main, words=(), doors=(COMMAND,)),
    "check": Start(command=apps.capture.main, words=(), doors=(COMMAND,)),
    "practice capture": Start(command=examples.make_capture.main, words=(), doors=(COMMAND,)),
    "practice strips": Start(command=examples.make_strips.main, words=(), doors=(COMMAND,)),
    "fabrics": Start(_fabrics, lambda folder: read_fabric_table(folder / "fabrics.csv"),
                     doors=(READER,)),
    "setup": Start(_described("setup.yaml", read_option("setup", "real")), _setups,
                   description="setup.yaml", doors=(READER,)),
    "manifest": Start(_manifest, read_manifest, description=MANIFEST, doors=(READER,)),
    "gaussian": _prior("gaussian"),
    "vae": _prior("vae"),
    "table of a prior": Start(
        lambda folder: save_prior(TablePrior(np.zeros((9, 6))), folder / "p.json"),
        lambda folder: load_prior(folder / "p.json"), description="p.json", doors=(READER,)),
    "list": Start(read=lambda folder: entries_of(folder / "list.csv"), doors=(READER,)),
    "form": Start(fields={"density_g_m2": "210"}, doors=(SERVICE,)),
    "form of a photograph": Start(doors=(SERVICE,), fields={
        "density_g_m2": "150", "tester": "disc300_support180", "camera_height_mm": "1200",
        **{f"plate_{key}": str(value) for key, value in photographs.plate().items()}}),
    "form of tension": Start(doors=(SERVICE,), fields={
        "density_g_m2": "210", **{f"tension.0.{key}": str(value)
                                  for key, value in BIAS_STRIP.items()}}),
}
STARTS |= {f"{name} in a form": replace(STARTS[name], doors=(SERVICE,)) for name in (
    "views", "published", "lengths", "strip", "tension")}
STARTS |= {f"{name} and words": replace(STARTS[name], doors=(COMMAND,)) for name in (
    "views", "tension", "scan")}


@cache
def _sound(name: str, folder: Path) -> Path:
    """A sound source, written once."""
    (folder / name).mkdir()
    STARTS[name].write(folder / name)
    return folder / name


def spoiled(row: Mapping[str, Any], folder: Path, cache: Path) -> Path:
    """The source that a row starts with, changed, in a ``folder``; sound ones are in ``cache``."""
    start, place = STARTS[row["of"]], folder / row["of"]
    shutil.copytree(_sound(row["of"], cache), place)
    for name, value in row.get("set", {}).items():
        _set(place / start.description, name, value)
    for name in _listed(row.get("remove", [])):
        for file in [*place.glob(name)]:
            file.unlink()
    for target, source in row.get("copy", {}).items():
        shutil.copy(place / source, place / target)
    for target, source in row.get("rename", {}).items():
        (place / source).rename(place / target)
    for name, text in row.get("write", {}).items():
        (place / name).parent.mkdir(exist_ok=True)
        (place / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    if "make" in row:
        name, *arguments = _listed(row["make"])
        CHANGES[name](place, *arguments)
    return place


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _set(file: Path, place: str, value: object) -> None:
    """Change a value of a description, at a dotted place; None removes it."""
    checkpoint = file.suffix == ".safetensors"
    content = inner = description(file) if checkpoint else yaml.safe_load(file.read_text())
    *path, last = [int(key) if key.isdigit() else key for key in place.split(".")]
    for key in path:
        inner = inner[key]
    if value is None:
        inner.pop(last, None)
    else:
        inner[last] = value
    if checkpoint:
        describe_again(file, json.dumps(content))
    else:
        file.write_text(json.dumps(content) if file.suffix == ".json" else yaml.safe_dump(content))


def large_png(width: int, height: int) -> bytes:
    """A PNG whose header states a size, with next to nothing in it."""
    def chunk(kind: bytes, data: bytes) -> bytes:
        checked = kind + data
        return struct.pack(">I", len(data)) + checked + struct.pack(">I", zlib.crc32(checked))

    header = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b""))
            + chunk(b"IEND", b""))


# --- Changes, which rows name ------------------------------------------------------------------


def truncated(folder: Path, name: str, share: float) -> None:
    """A file cut short."""
    data = (folder / name).read_bytes()
    (folder / name).write_bytes(data[: int(share * len(data))])


def gone(folder: Path) -> None:
    """No folder."""
    shutil.rmtree(folder)


def a_file(folder: Path) -> None:
    """A file in place of the folder."""
    shutil.rmtree(folder)
    folder.touch()


def filled(folder: Path, name: str, text: str, count: int, head: str = "") -> None:
    """A file of a text, repeated."""
    (folder / name).write_text(head + text * count)


def replaced(folder: Path, name: str, old: str, new: str) -> None:
    """A file with other words."""
    file = folder / name
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new, 1))


def again(folder: Path, name: str, text: str) -> None:
    """A file with more lines."""
    with (folder / name).open("a") as file:
        file.write(text)


def undescribed(folder: Path, *text: str) -> None:
    """A checkpoint with no description, or a text for one."""
    file = folder / "net.safetensors"
    if text:
        describe_again(file, text[0])
    else:
        save_file(load(file.read_bytes()), file)


def folder_in_the_way(folder: Path) -> None:
    """A folder where the command writes a file."""
    (folder.parent / "out" / "report.png").mkdir(parents=True)


def mesh(folder: Path, how: str) -> None:
    """A scan that no cloth can be, or whose numbers are faulty."""
    file = folder / "scan.ply"
    cloth = trimesh.load(file, process=False)
    vertices, faces = np.array(cloth.vertices), np.array(cloth.faces)
    if how == "flat":
        vertices[:, 2] = 0
    elif how == "large":
        vertices *= 5
    elif how == "not a number":
        vertices[3, 1] = np.nan
    else:
        faces[:, 2] += 10**6
    trimesh.Trimesh(vertices, faces, process=False).export(file)


def many(folder: Path, count: int) -> None:
    """Empty pictures."""
    for k in range(count):
        (folder / f"view_{k}.png").touch()


def png_of_size(folder: Path, name: str, width: int, height: int) -> None:
    """A PNG of :func:`large_png`."""
    (folder / name).write_bytes(large_png(width, height))


def repeated(folder: Path, name: str, key: str, load: float | None = None) -> None:
    """The first strip of a description once more."""
    content = yaml.safe_load((folder / name).read_text())
    content[key].append(content[key][0] | ({"load_g": load} if load else {}))
    (folder / name).write_text(json.dumps(content))  # without an alias


def endless_density(folder: Path) -> None:
    """A number of 400 digits."""
    describe(folder, density_g_m2=10**400)


def _picture(file: Path, change: Callable[[np.ndarray], np.ndarray]) -> None:
    counts = change(np.array(Image.open(file)))
    Image.fromarray(np.ascontiguousarray(counts)).save(file)


def blank(folder: Path, names: str) -> None:
    """Pictures of nothing."""
    for file in folder.glob(names):
        _picture(file, lambda counts: counts * 0)


def striped(folder: Path) -> None:
    """Every view the same stripes."""
    for file in folder.glob("view_*"):
        _picture(file, lambda counts: np.where(np.indices(counts.shape)[1] % 80 < 40, 500, 0
                                               ).astype(np.uint16))


def thinned(folder: Path, names: str, rows: int, columns: int) -> None:
    """Every n-th row and column of pictures."""
    for file in folder.glob(names):
        _picture(file, lambda counts: counts[::rows, ::columns])


def cut(folder: Path, names: str, rows: int) -> None:
    """The first rows of pictures."""
    for file in folder.glob(names):
        _picture(file, lambda counts: counts[:rows])


def one_column(folder: Path, name: str) -> None:
    """Cloth in one column of a picture."""
    _picture(folder / name, lambda counts: counts * (np.arange(counts.shape[1]) == 120))


def whole(folder: Path, name: str) -> None:
    """A view with a background."""
    _picture(folder / name, lambda counts: np.where(counts > 0, counts, 900).astype(np.uint16))


def in_bits(folder: Path, name: str, bits: int) -> None:
    """A grey picture of 8 or 16 bits from one of the other."""
    kind, factor = (np.uint8, 0.25) if bits == 8 else (np.uint16, 4)
    _picture(folder / name, lambda counts: (counts * factor).astype(kind))


def coloured(folder: Path, name: str) -> None:
    """A picture of three channels."""
    _picture(folder / name, lambda counts: np.stack([counts // 4] * 3, axis=-1).astype(np.uint8))


def polar(folder: Path) -> None:
    """An outline in angles and radii."""
    rows = "".join(f"{degrees};{110 + degrees % 20}\n" for degrees in range(0, 360, 5))
    (folder / "outline.csv").write_text(f"angle;radius_mm\n{rows}")


def grey_picture(folder: Path, name: str) -> None:
    """A photograph of nothing."""
    Image.new("RGB", (800, 600), (200, 190, 180)).save(folder / name)


def pipe(folder: Path, name: str) -> None:
    """A named pipe, to which nobody writes."""
    os.mkfifo(folder / name)


def mirrored(folder: Path, name: str) -> None:
    """A photograph, mirrored."""
    with Image.open(folder / name) as picture:
        ImageOps.mirror(picture).save(folder / name, exif=picture.getexif())


def small_background(folder: Path) -> None:
    """A picture of the empty scene of another size."""
    Image.fromarray(np.full((90, 240), 800, np.uint16)).save(folder / "background.png")


def damaged_pixels(folder: Path, how: str) -> None:
    """The chunk of a PNG's pixels with a wrong checksum, or left out."""
    file = folder / "view_1.png"
    data = file.read_bytes()
    start = data.index(b"IDAT") - 4
    end = start + 12 + int.from_bytes(data[start : start + 4], "big")
    file.write_bytes(data[: end - 1] + b"?" + data[end:] if how == "checksum" else
                     data[:start] + data[end:])


def array(folder: Path, kind: str) -> None:
    """The views replaced by an array."""
    blank_name, size = "view_0.npy", (180, 240)
    made = {"objects": np.array([{"a": 1}], dtype=object), "whole numbers": np.ones(size, int),
            "millimetres": np.full(size, 540.0)}
    for file in folder.glob("view_*.png"):
        file.unlink()
    np.save(folder / blank_name, made[kind], allow_pickle=True)


def array_header(folder: Path, header: str) -> None:
    """The views replaced by an array with this header."""
    start = b"\x93NUMPY\x01\x00" + (len(header) + 1).to_bytes(2, "little")
    for file in folder.glob("view_*.png"):
        file.unlink()
    (folder / "view_0.npy").write_bytes(start + header.encode() + b"\n" + bytes(60 * 80 * 8))


def points(folder: Path, *content: Any) -> None:
    """The views replaced by a cloud of points: a text, or places, m."""
    for file in folder.glob("view_*.png"):
        file.unlink()
    describe(folder, size_px=[240, 180])
    if isinstance(content[0], str):
        (folder / "view_0.ply").write_text(content[0])
    else:
        trimesh.PointCloud(np.array(content, float)).export(folder / "view_0.ply")


def weights(folder: Path, name: str, how: str) -> None:
    """A weight of an autoencoder left out, in another form, or one more."""
    file = folder / "p.json"
    content = json.loads(file.read_text())
    found = load(base64.b64decode(content["weights"]))
    value = found.pop(name, np.ones(2, np.float32))
    if how != "left out":
        found[name] = {"not a number": value * np.float32(np.nan), "as double": value.astype(float),
                       "square": np.ones((3, 3), np.float32), "more": value}[how]
    file.write_text(json.dumps(content | {"weights": base64.b64encode(save(found)).decode()}))


CHANGES = {change.__name__: change for change in (
    truncated, gone, a_file, filled, undescribed, repeated, replaced,
    again, folder_in_the_way, mesh, many, png_of_size, endless_density, blank, striped, thinned,
    cut, one_column, whole, in_bits, coloured, small_background, damaged_pixels, array,
    array_header, points, polar, grey_picture, pipe, mirrored,
    weights)}
