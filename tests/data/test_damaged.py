"""A damaged file of any kind is read as something sound or refused in one line, within a memory."""

import hashlib
import io
import json
import os
import re
import resource
import shutil
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from copy import deepcopy
from datetime import timedelta
from pathlib import Path
from typing import Any

import fake_drapes
import numpy as np
import photographs
import pytest
import torch
import trimesh
import yaml
from cloths import describe, lopsided_views
from estimates import DOUBT, document_of, estimate_of
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from services import settings_for
from spoiled import STARTS
from test_generate import small_config
from test_scans import RIG, scan_arrays

import drapenet
from apps.drape import read_borrowed
from common.configs import read_option
from common.documents import read_bytes, read_json
from common.errors import MAX_LENGTH, InputError
from common.provenance import digest
from data.captures.raw_scans import read_raw_scan
from data.captures.reader import read_capture
from data.captures.rosbag import read_recording
from data.captures.scans import read_scan
from data.dataset import inspect
from data.dataset.folder import DatasetFolder
from data.dataset.simulate import make_record
from data.fabrics.prior import load_prior
from data.render.setups import Setups
from drapenet.export.formats import TARGETS
from drapenet.export.material import read_material
from drapenet.fabric.entries import entries_of
from drapenet.network.checkpoint import read_header
from drapenet.network.model import make_network
from drapenet.network.optimizer import Optimizer
from drapenet.network.predict import network_of
from drapenet.network.training import load_state, save_state
from drapenet.result.files import write_estimate
from drapenet.service.limits import RequestError
from drapenet.service.uploads import checked_upload
from sim.rig import DISC_RIG, Rig

ROOT = Path(__file__).parents[2]
TWILL = ROOT / "examples" / "captures" / "twill"
PRIORS = ("gaussian", "vae")
ROOM = 1 << 30  # bytes, of memory for reading a file of a few kilobytes

VALUES = (0, -1, 1, 2**31, 2**63, 10**400, 1e-300, 1e308, -1e308, 0.5, None, True, "", "x" * 3000,
          "a\nb", "\0", "\udcff", "nan", "1e3", [], {}, [[]], [None], {"": 0}, [1] * 50,
          float("nan"), float("inf"))
WORDS = (b"", b"nan", b"inf", b"-1", b"0", b"1e400", b"9" * 400, b"0x10", b"-", b"\xc2\xb5", b"\0",
         b'"', b"[", b"{", b"*a", b"&a", b"<<: ", b"!!python/object:os.system", b"!!binary", b"? ",
         b"#", b"\t", b",", b"=", b"\n", b"\xff" * 8, b"\x7f\xff\xff\xff", b"\0" * 256)
HEADERS = (b"(1000000000000,)", b"(0, 0)", b"(2147483648, 2147483648)", b"(-1, 3)", b"()",
           b"(3, 1)", b"'|O'", b"'<f2'", b"'>f8'", b"'<c16'", b"'<M8[s]'", b"'|V9'", b"'<i8'")
NAMES = ("x", "../x.npy", "/etc/x.npy", "a" * 300, "tRNS", "acTL", "eXIf", "zTXt")
Draw = Callable[[st.SearchStrategy], Any]


def edited(draw: Draw, data: bytes) -> bytes:
    """A span, or a word, replaced by others, repeated or, with all that follows, cut off."""
    start = draw(st.integers(0, len(data)))
    end = start + draw(st.sampled_from((0, 1, 4, 16, 256, len(data))))
    if draw(st.booleans()) and (word := re.compile(rb"[-+.\w]+").search(data, start)):
        start, end = word.span()
    repeated = draw(st.sampled_from((2, 300))) * data[start : min(end, start + 40)]
    new = draw(st.sampled_from((*WORDS, repeated)) | st.binary(max_size=16))
    return data[:start] + new + data[end:]


def places(value: Any) -> Iterator[tuple]:
    """The keys that lead to each value of a tree."""
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, inner in items:
        yield (key,)
        if isinstance(inner, dict | list):
            yield from ((key, *rest) for rest in places(inner))


def changed(draw: Draw, content: Any) -> Any:
    """A tree of mappings and lists with another value, or none, in a place."""
    content = inner = deepcopy(content)
    if not isinstance(content, dict | list) or not content:
        return draw(st.sampled_from(VALUES))
    *path, key = draw(st.sampled_from([*places(content)]))
    for step in path:
        inner = inner[step]
    old = inner[key]
    if isinstance(old, str) and old.startswith("{"):  # a document in a document
        inner[key] = json.dumps(changed(draw, json.loads(old)))
    elif isinstance(old, float | int) and draw(st.booleans()):
        inner[key] = float(old) * draw(st.sampled_from((-1, 10, 1000, 1e-3, 1e9, 1e-9)))
    elif draw(st.integers(0, 6)):
        inner[key] = draw(st.sampled_from(VALUES))
    else:
        del inner[key]
    return content


def document(draw: Draw, data: bytes) -> bytes:
    """A changed JSON or YAML document."""
    if data.lstrip()[:1] in (b"{", b"["):
        return json.dumps(changed(draw, json.loads(data))).encode("utf-8", "surrogatepass")
    return yaml.safe_dump(changed(draw, yaml.safe_load(data))).encode("utf-8", "surrogatepass")


def array(draw: Draw, data: bytes) -> bytes:
    """A NumPy file with another header, or other values."""
    if draw(st.booleans()):
        return re.sub(rb"(?<='shape': )[^)]*\)|(?<='descr': )'[^']*'",
                      draw(st.sampled_from(HEADERS)), data, count=draw(st.integers(1, 2)))
    values = np.load(io.BytesIO(data)).astype(float)
    at = draw(st.integers(0, max(values.size - 1, 0)))
    values.flat[at : at + draw(st.sampled_from((1, 50)))] = draw(st.sampled_from(
        (0, -1, 1e30, np.nan, np.inf)))
    stream = io.BytesIO()
    np.save(stream, values[: draw(st.sampled_from((len(values), len(values) // 2)))])
    return stream.getvalue()


def members(draw: Draw, files: list[tuple[str, bytes]]) -> list[tuple[str, bytes]]:
    """Members of a container, one of them damaged, renamed, repeated, filled with zeros or gone."""
    k = draw(st.integers(0, len(files) - 1))
    name, data = files[k]
    new = draw(st.sampled_from(["damaged"] * 6 + ["renamed", "repeated", "zeros", "gone"]))
    others = {
        "damaged": lambda: [(name, damaged(draw, name, data))],
        "renamed": lambda: [(draw(st.sampled_from(NAMES)), data)],
        "repeated": lambda: 2 * [(name, data)],
        "zeros": lambda: [(name, data[:128] + bytes(16 << 20))], "gone": list}
    return files[:k] + others[new]() + files[k + 1 :]


def archive(draw: Draw, data: bytes) -> bytes:
    """A zip file with a damaged member."""
    with zipfile.ZipFile(io.BytesIO(data)) as read:
        files = members(draw, [(name, read.read(name)) for name in read.namelist()])
    stream = io.BytesIO()
    kind = draw(st.sampled_from((zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED)))
    with warnings.catch_warnings(), zipfile.ZipFile(stream, "w", kind) as written:
        warnings.simplefilter("ignore", UserWarning)  # a name twice is meant
        for name, content in files:
            written.writestr(name, content)
    return stream.getvalue()


def picture(draw: Draw, data: bytes) -> bytes:
    """A PNG with a damaged chunk, its pixels unpacked, with right checksums."""
    chunks, at = [], 8
    while at < len(data):
        end = at + 8 + int.from_bytes(data[at : at + 4], "big")
        kind, part = data[at + 4 : at + 8].decode(), data[at + 8 : end]
        chunks.append((kind, zlib.decompress(part) if kind == "IDAT" else part))
        at = end + 4
    new = data[:8]
    for kind, part in members(draw, chunks):
        body = kind[:4].encode() + (zlib.compress(part, 1) if kind == "IDAT" else part)
        new += struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    return new


def tensors(draw: Draw, data: bytes) -> bytes:
    """A safetensors file with a damaged header."""
    end = 8 + int.from_bytes(data[:8], "little")
    header = document(draw, data[8:end])
    return struct.pack("<Q", len(header)) + header + data[end:]


DAMAGE = {".json": document, ".yaml": document, ".npy": array, ".npz": archive, ".zip": archive,
          ".pt": archive, ".png": picture, ".safetensors": tensors}


def damaged(draw: Draw, name: str, data: bytes) -> bytes:
    """The bytes of a file, damaged as its kind can be, or anywhere."""
    special = DAMAGE.get(Path(name).suffix)
    return special(draw, data) if special and draw(st.integers(0, 3)) else edited(draw, data)


def _views(write: Callable[[Path, np.ndarray], object], suffix: str, **more: object
           ) -> Callable[[Path], None]:
    """Two views of a third of the size, metres, each written to a file."""
    def make(folder: Path) -> None:
        STARTS["views"].write(folder)
        camera = yaml.safe_load((folder / "capture.yaml").read_text())["intrinsics"]
        describe(folder, turns_deg=[0, 90], **more,
                 intrinsics={key: value / 3 for key, value in camera.items()})
        for file in folder.glob("view_*.png"):
            file.unlink()
        for k, view in enumerate(lopsided_views()[:2, ::3, ::3]):
            write(folder / f"view_{k}{suffix}", np.ascontiguousarray(view))

    return make


def _exr(file: Path, view: np.ndarray) -> None:
    import OpenEXR

    OpenEXR.File({"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION},
                 {"Z": view}).write(str(file))


def _ply(file: Path, view: np.ndarray) -> None:
    rows, columns = np.nonzero(view)
    depth = view[rows, columns]
    trimesh.PointCloud(np.column_stack([(columns - 39.5) * depth / 101.7,
                                        (rows - 29.5) * depth / 101.7, depth])).export(
        file, encoding="ascii" if file.stem.endswith("1") else "binary")


def _raw_scan(folder: Path) -> None:
    STARTS["scan"].write(folder)
    trimesh.load(folder / "scan.ply").export(folder / "scan.obj")


def _photograph(folder: Path) -> None:
    photographs.write(folder, photographs.drawn(pixel=1e-3), outline={
        "plate_px": photographs.plate(1e-3), "camera_height_mm": 1200})


def _drape(folder: Path) -> None:
    rest = np.random.default_rng(0).uniform(-0.1, 0.1, (40, 2))
    np.savez_compressed(folder / "drape.npz", rest=rest,
                        positions=np.column_stack([rest, -np.ones(40)]))


def _training() -> dict:
    torch.manual_seed(0)
    model = make_network(width=2, components=1, dropout=0.0, distance=0.5, spread=0.1)
    return {"model": model, "optimizer": Optimizer(model, weight_decay=0.1)}


RUN = {"settings": {"seed": 0}, "datasets": ["0" * 64]}


def _state(folder: Path) -> None:
    parts = _training()
    sum(part.square().sum() for part in parts["model"].parameters()).backward()
    parts["optimizer"].step(0.1)
    record = {"run": RUN, "epochs_done": 2, "best_loss": 0.5}
    save_state(folder / "state.pt", record=record, **parts)


def _read_checkpoint(folder: Path) -> None:
    header = read_header(folder / "net.safetensors")
    _ = header.setups, header.scale, header.identity
    network_of(header)


def _estimate(folder: Path) -> None:
    alpha = np.array([52e-6, 31e-6, 22e-6])
    estimate = estimate_of(alpha, -3e-3 * alpha, deviation=0.1)
    write_estimate(folder, estimate, document_of(estimate, warnings=[DOUBT]))


def _read_estimate(folder: Path) -> None:
    drapenet.load(folder)
    material = read_material(folder / "estimate.json", curvature_1_m=50.0)
    for target in TARGETS.values():
        target.write(material, target.file)


def _dataset(folder: Path) -> None:
    config = small_config(8)
    made = DatasetFolder(folder, config)
    made.claim()
    for shard in range(config.shards):
        made.write(shard, [make_record(index, config, solver=fake_drapes.cone)
                           for index in config.rows(shard)])
    made.finish()


def _read_dataset(folder: Path) -> None:
    with suppress(Exception):  # digests fit the damage, if it can be hidden
        assert all(file.stat().st_size < 1 << 30 and file.is_file() for file in folder.iterdir())
        manifest = json.loads((folder / "dataset.json").read_text())
        shards = {name: hashlib.sha256((folder / name).read_bytes()).hexdigest()
                  for name in manifest["shards"]}
        (folder / "dataset.json").write_text(json.dumps(manifest | {
            "identity": digest(manifest["config"]), "shards": shards,
            "hash": digest(shards)}))
    manifest = inspect.check_dataset(folder)
    inspect.report(manifest, inspect.read_drapes(folder, manifest, intersections=1),
                   inspect.prior_samples(manifest))
    DatasetFolder(folder, small_config(8)).finish()


def _upload(folder: Path) -> None:
    (folder / "inside").mkdir()
    STARTS["views"].write(folder / "inside")
    shutil.make_archive(str(folder / "capture"), "zip", folder / "inside")
    shutil.rmtree(folder / "inside")


def _read_upload(folder: Path) -> None:
    limits = settings_for(folder / "results", "megabytes=4")
    content = read_bytes(folder / "capture.zip", 1 << 22, "zip")
    try:
        upload = checked_upload([("capture.zip", content)],
                                {"density_g_m2": "123,5", "name": "twill"}, limits)
    except RequestError as error:
        raise InputError(error.detail) from None
    (folder / "written").mkdir()
    for name, content in upload.files.items():
        (folder / "written" / name).write_bytes(content)
    read_capture(folder / "written")


def _read_priors(folder: Path) -> None:
    for name in PRIORS:
        load_prior(folder / f"{name}.json").sample(20, np.random.default_rng(0))


def _copy(*files: Path) -> Callable[[Path], None]:
    return lambda folder: [shutil.copy(file, folder) for file in files] and None


# Of each kind of input: writes a sound one to a folder, and reads it.
READERS: dict[str, tuple[Callable[[Path], object], Callable[[Path], object]]] = {
    **{name: (STARTS[name].write, STARTS[name].read) for name in (
        "views", "published", "outline", "lengths", "tension", "fabrics")},
    "checkpoint": (STARTS["checkpoint"].write, _read_checkpoint),
    "photograph": (_photograph, read_capture),
    "arrays": (_views(np.save, ".npy"), read_capture),
    "EXR": (_views(_exr, ".exr"), read_capture),
    "points": (_views(_ply, ".ply", size_px=[80, 60]), read_capture),
    "recording": (_copy(ROOT / "tests/data/recordings/turntable.db3"),
                  lambda folder: read_recording([folder / "turntable.db3"])),
    "scan": (lambda folder: np.savez(folder / "scan.npz", **scan_arrays()),
             lambda folder: read_scan(folder / "scan.npz", RIG)),
    "raw scan": (_raw_scan, lambda folder: [
        read_raw_scan(folder / f"scan.{kind}", DISC_RIG) for kind in ("ply", "obj")]),
    "drape": (_drape, lambda folder: read_borrowed(folder / "drape.npz")),
    "list of captures": (
        lambda folder: (folder / "list.csv").write_text("fabric,sample,capture\n" + "".join(
            f"f{k % 3},{k},c{k}\n" for k in range(9))),
        lambda folder: entries_of(folder / "list.csv")),
    "prior": (_copy(*(ROOT / f"data/weights/{name}.json" for name in PRIORS)), _read_priors),
    "state of a training": (_state, lambda folder: load_state(
        folder / "state.pt", run=RUN, **_training())),
    "estimate": (_estimate, _read_estimate),
    "dataset": (_dataset, _read_dataset),
    "set-ups": (
        lambda folder: (folder / "setup.json").write_text(json.dumps(read_option("setup", "real"))),
        lambda folder: Setups.from_config(read_json(folder / "setup.json")).camera(
            np.random.default_rng(0), Rig())),
    "upload": (_upload, _read_upload),
}


@contextmanager
def little_memory() -> Iterator[None]:
    """Bounds what is allocated."""
    limits = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + ROOM, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)


@pytest.fixture(scope="module", params=READERS)
def kind(request, tmp_path_factory) -> tuple[str, Path]:
    """A kind of input, and a folder of a sound one."""
    sound = tmp_path_factory.mktemp("sound")
    READERS[request.param][0](sound)
    return request.param, sound


@pytest.mark.parametrize("examples", [6, pytest.param(500, marks=pytest.mark.slow)])
@pytest.mark.filterwarnings("ignore")
def test_a_damaged_file_is_sound_or_refused_in_one_line(
        kind, examples, tmp_path, any_shapes, monkeypatch):
    (name, sound), folder = kind, tmp_path / "case"
    read = READERS[name][1]
    monkeypatch.setattr(inspect, "PRIOR_SAMPLES", 50)
    names = sorted(file.name for file in sound.iterdir())
    shutil.copytree(sound, folder)
    read(folder)

    @settings(max_examples=examples, derandomize=examples < 100, deadline=timedelta(seconds=60),
              database=None, suppress_health_check=list(HealthCheck))
    @given(st.data())
    def check(data: st.DataObject) -> None:
        file = data.draw(st.sampled_from(names))
        content = damaged(data.draw, file, (sound / file).read_bytes())
        shutil.rmtree(folder)
        shutil.copytree(sound, folder)
        (folder / file).write_bytes(content)
        try:
            with little_memory():
                read(folder)
        except InputError as refusal:
            assert str(refusal).isprintable() and 10 < len(str(refusal)) <= MAX_LENGTH + 3
        assert not list(folder.rglob("*.part"))

    check()


@pytest.mark.parametrize("irregular", ["pipe", "device", "sparse"])
def test_only_regular_files_of_bounded_size_are_read(kind, irregular, tmp_path):
    (name, sound), folder = kind, tmp_path / "case"
    for file in sorted(sound.iterdir()):
        shutil.copytree(sound, folder)
        (folder / file.name).unlink()
        if irregular == "pipe":
            os.mkfifo(folder / file.name)
        elif irregular == "device":
            (folder / file.name).symlink_to("/dev/zero")
        else:
            with (folder / file.name).open("wb") as stream:
                stream.truncate(1 << 43)
        with pytest.raises(InputError, match="has 8796093022208 bytes; " if irregular == "sparse"
                           else "not a regular file"):
            READERS[name][1](folder)
        shutil.rmtree(folder)
