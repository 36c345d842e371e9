"""Every reader of files from outside: a sound input, how it is damaged, and the reading."""

import csv
import hashlib
import json
import os
import random
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import fake_drapes
import numpy as np
import torch
import trimesh
import yaml
from checkpoints import save_untrained
from corruption import (
    damaged_bytes,
    damaged_json,
    damaged_npy,
    damaged_png,
    damaged_safetensors,
    damaged_text,
    damaged_value,
    damaged_zip,
)
from estimates import document_of, estimate_of
from PIL import Image
from test_scans import RIG as SCAN_RIG
from test_scans import scan_arrays

import drapenet
from apps.drape_file import read_borrowed
from apps.strip_curves import read_curve
from common.configs import read_config, read_option
from common.documents import read_bytes, read_json
from common.errors import InputError
from common.provenance import digest
from data.captures.capture import read_capture
from data.captures.raw_scans import read_raw_scan
from data.captures.rosbag import read_recording
from data.captures.scans import read_scan
from data.dataset import inspect
from data.dataset.config import DatasetConfig, SamplingConfig
from data.dataset.folder import DatasetFolder
from data.dataset.simulate import make_record
from data.fabrics.fabrics import TABLE_COLUMNS, read_fabric_table
from data.fabrics.prior import load_prior
from data.render.setups import Setups
from drapenet.batch.captures import entries_of
from drapenet.config import ServeConfig
from drapenet.export.formats import TARGETS
from drapenet.export.material import read_material
from drapenet.network.checkpoint import load_model, read_header
from drapenet.network.model import Network, make_network
from drapenet.network.optimizer import Optimizer
from drapenet.network.training import load_state, save_state
from drapenet.result.files import write_estimate
from drapenet.service.limits import RequestError
from drapenet.service.uploads import checked_upload
from sim.material import MICRO
from sim.rig import Rig

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "captures" / "twill"
Damage = Callable[[bytes, random.Random], bytes]


@dataclass(frozen=True)
class Reader:
    """A reader.

    Attributes:
        make: writes a sound input to a new folder.
        damage: by file of the folder.
        read: reads the folder.
        after: mends digests, so that the damage is not found by them alone.
    """

    make: Callable[[Path], None]
    damage: dict[str, Damage]
    read: Callable[[Path], object]
    after: Callable[[Path], None] = lambda folder: None


def spoil(reader: Reader, folder: Path, rng: random.Random) -> str:
    """Damage one file of a sound input in ``folder``, or what the file is; its name."""
    name = rng.choice(sorted(reader.damage))
    file = folder / name
    way = rng.random()
    if way < 0.97:
        file.write_bytes(reader.damage[name](file.read_bytes(), rng))
        reader.after(folder)
    else:
        others = [other for other in folder.iterdir() if other != file]
        file.unlink()
        _STRANGE[rng.randrange(len(_STRANGE))](file, rng.choice(others) if others else folder)
    return name


def _sparse(file: Path, other: Path) -> None:
    with file.open("wb") as stream:
        stream.truncate(1 << 40)


_STRANGE = (
    lambda file, other: None, lambda file, other: file.mkdir(), lambda file, other: os.mkfifo(file),
    lambda file, other: file.symlink_to("/dev/zero"), lambda file, other: file.symlink_to(file),
    lambda file, other: file.symlink_to(other), lambda file, other: file.touch(), _sparse)


def _small(view: np.ndarray, step: int) -> np.ndarray:
    return np.ascontiguousarray(view[::step, ::step])


def _views() -> list[np.ndarray]:
    return [_small(np.array(Image.open(EXAMPLE / f"view_{k}.png")), 3) for k in range(4)]


def _describe(folder: Path, **more: object) -> None:
    content = yaml.safe_load((EXAMPLE / "capture.yaml").read_text())
    content["intrinsics"] = {key: value / 3 for key, value in content["intrinsics"].items()}
    (folder / "capture.yaml").write_text(yaml.safe_dump(content | more))


def _capture(folder: Path) -> None:
    for k, view in enumerate(_views()):
        Image.fromarray(view).save(folder / f"view_{k}.png")
    _describe(folder, turns_deg=[0, 90, 180, 270])


def _arrays(folder: Path) -> None:
    for k, view in enumerate(_views()[:2]):
        np.save(folder / f"view_{k}.npy", (view * 1e-3).astype(np.float32))
    _describe(folder, turns_deg=[0, 90])


def _exr(folder: Path) -> None:
    import OpenEXR

    for k, view in enumerate(_views()[:2]):
        channels = {"Z": (view * 1e-3).astype(np.float32)}
        OpenEXR.File({"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION},
                     channels).write(str(folder / f"view_{k}.exr"))
    _describe(folder, turns_deg=[0, 90])


def _points(folder: Path) -> None:
    for k, view in enumerate(_views()[:2]):
        rows, columns = np.nonzero(view)
        depth = view[rows, columns] * 1e-3
        points = np.column_stack([(columns - 39.5) * depth / 101.7, (rows - 29.5) * depth / 101.7,
                                  depth])
        data = trimesh.PointCloud(points).export(file_type="ply", encoding=(
            "ascii" if k else "binary"))
        (folder / f"view_{k}.ply").write_bytes(data.encode() if isinstance(data, str) else data)
    _describe(folder, turns_deg=[0, 90], size_px=[80, 60])


def _published(folder: Path) -> None:
    for k in range(4):
        view = np.array(Image.open(EXAMPLE / f"view_{k}.png"))
        Image.fromarray((view * (255 / 1000)).astype(np.uint8)).save(folder / f"{k}.png")
    (folder / "density.txt").write_text("data0 300\n")


def _scan(folder: Path) -> None:
    np.savez(folder / "scan.npz", **scan_arrays())


def _raw_scan(folder: Path) -> None:
    arrays = scan_arrays()
    mesh = trimesh.Trimesh(arrays["vertices"], arrays["faces"], process=False)
    for kind in ("ply", "obj"):
        data = mesh.export(file_type=kind)
        (folder / f"scan.{kind}").write_bytes(data.encode() if isinstance(data, str) else data)


def _read_raw_scan(folder: Path) -> None:
    for kind in ("ply", "obj"):
        read_raw_scan(folder / f"scan.{kind}", SCAN_RIG)


def _drape(folder: Path) -> None:
    rest = np.random.default_rng(0).uniform(-0.1, 0.1, (40, 2))
    np.savez_compressed(folder / "drape.npz", rest=rest,
                        positions=np.column_stack([rest, -np.ones(40)]))


def _fabrics(folder: Path) -> None:
    rows = np.random.default_rng(0).uniform(5, 90, (9, len(TABLE_COLUMNS)))
    rows[:, 0] = 0.2
    with (folder / "fabrics.csv").open("w", newline="") as file:
        csv.writer(file).writerows([TABLE_COLUMNS,
                                    *rows.tolist()])


def _curve(folder: Path) -> None:
    x = np.linspace(0, 80, 30)
    lines = [f"{a:.3f},{-a * a / 150:.3f}" for a in x]
    (folder / "curve.csv").write_text("x_mm,y_mm\n" + "\n".join(lines) + "\n")


def _list(folder: Path) -> None:
    (folder / "list.csv").write_text("fabric,sample,capture\n" + "\n".join(
        f"f{k % 3},s{k},c{k}" for k in range(9)) + "\n")


def _priors(folder: Path) -> None:
    for name in ("gaussian", "vae"):
        shutil.copy(ROOT / "data" / "weights" / f"{name}.json", folder)


def _read_priors(folder: Path) -> None:
    for name in ("gaussian", "vae"):
        prior = load_prior(folder / f"{name}.json")
        prior.sample(20, np.random.default_rng(0))


def _read_checkpoint(folder: Path) -> None:
    header = read_header(folder / "net.safetensors")
    _ = header.setups, header.scale, header.identity
    load_model(header)


def _training() -> tuple[Network, Optimizer]:
    torch.manual_seed(0)
    model = make_network(width=2, components=1, dropout=0.0, distance=0.5, spread=0.1)
    return model, Optimizer(model, weight_decay=0.1)


def _step(model: Network, optimizer: Optimizer) -> None:
    sum(part.square().sum() for part in model.parameters()).backward()
    optimizer.step(0.1)


_RUN = {"settings": {"seed": 0}, "datasets": ["0" * 64]}


def _state(folder: Path) -> None:
    model, optimizer = _training()
    _step(model, optimizer)
    save_state(folder / "state.pt", model=model, optimizer=optimizer, record={
        "run": _RUN, "epochs_done": 2, "best_loss": 0.5})


def _read_state(folder: Path) -> None:
    model, optimizer = _training()
    load_state(folder / "state.pt", run=_RUN, model=model,
               optimizer=optimizer)
    _step(model, optimizer)


def _estimate(folder: Path) -> None:
    alpha = np.array([52.0, 31.0, 22.0]) * MICRO
    estimate = estimate_of(alpha, -3e-3 * alpha, deviation=0.1)
    write_estimate(folder, estimate, document_of(estimate, warnings=["holes"]))


def _read_estimate(folder: Path) -> None:
    drapenet.load(folder)
    material = read_material(folder / "estimate.json", curvature_1_m=50.0)
    for target in TARGETS.values():
        target.write(material, target.file)


def small_config(drapes: int = 8, per_shard: int = 4) -> DatasetConfig:
    """A dataset on coarse meshes."""
    return DatasetConfig(drapes=drapes, sampling=SamplingConfig(), prior=load_prior("gaussian"),
                         edge=0.04, drapes_per_shard=per_shard)


def _dataset(folder: Path) -> None:
    config = small_config()
    made = DatasetFolder(folder, config)
    made.claim()
    for shard in range(config.shards):
        made.write(shard, [make_record(index, config, solver=fake_drapes.cone)
                           for index in config.rows(shard)])
    made.finish()


def _damaged_manifest(data: bytes, rng: random.Random) -> bytes:
    content = json.loads(data)
    if rng.random() < 0.5:
        content["config"] = damaged_value(content["config"], rng)
    else:
        content = damaged_value(content, rng)
    return json.dumps(content).encode("utf-8", "surrogatepass")


def _mend_dataset(folder: Path) -> None:
    """Digests that fit what is there; damage of shards shows by their seals."""
    try:
        manifest = json.loads((folder / "dataset.json").read_text())
        manifest["identity"] = digest(manifest["config"])
        manifest["shards"] = {name: hashlib.sha256((folder / name).read_bytes()).hexdigest()
                              for name in manifest["shards"]}
        manifest["hash"] = digest(manifest["shards"])
        (folder / "dataset.json").write_text(json.dumps(manifest))
    except Exception:  # damage that cannot be hidden
        pass


def _read_dataset(folder: Path) -> None:
    inspect.PRIOR_SAMPLES = 50
    manifest = inspect.check_dataset(folder)
    drapes = inspect.read_drapes(folder, manifest, intersections=1)
    inspect.report(manifest, drapes, inspect.prior_samples(manifest))
    DatasetFolder(folder, small_config()).finish()


def _setup(folder: Path) -> None:
    (folder / "setup.json").write_text(json.dumps(dict(read_option("setup", "real"))))


def _read_setup(folder: Path) -> None:
    setups = Setups.from_config(read_json(folder / "setup.json"))
    setups.camera(np.random.default_rng(0), Rig())


def _upload(folder: Path) -> None:
    files = {"capture.zip": cloths_zip(folder), "fields.json": json.dumps({
        "density_g_m2": "123,5", "warp_direction_deg": "20", "name": "twill", "refine": "no"}
        ).encode()}
    for name, data in files.items():
        (folder / name).write_bytes(data)


def cloths_zip(folder: Path) -> bytes:
    """A zip with a small capture."""
    inside = folder / "inside"
    inside.mkdir()
    _capture(inside)
    archive = shutil.make_archive(str(folder / "made"), "zip", inside)
    data = Path(archive).read_bytes()
    Path(archive).unlink()
    shutil.rmtree(inside)
    return data


def _damaged_member(data: bytes, rng: random.Random) -> bytes:
    return damaged_png(data, rng) if data.startswith(b"\x89PNG") else damaged_text(data, rng)


def _read_upload(folder: Path) -> None:
    config = {**read_config("serve"), "results": str(folder / "r"), "megabytes": 4.0}
    settings = ServeConfig(**{key: config[key] for key in config
                              if key in ServeConfig.__dataclass_fields__})
    data, fields = read_bytes(folder / "capture.zip", 1 << 23, "zip"), read_json(
        folder / "fields.json")
    texts = {str(key): value if isinstance(value, str) else repr(value)
             for key, value in (fields.items() if isinstance(fields, dict) else ())}
    try:
        upload = checked_upload([("capture.zip", data)], texts, settings)
    except RequestError as error:
        raise InputError(error.detail) from None
    written = folder / f"written_{os.getpid()}"
    written.mkdir()
    for name, content in upload.files.items():
        (written / name).write_bytes(content)
    read_capture(written)


def _each(names: str, count: int, damage: Damage) -> dict[str, Damage]:
    return {names.format(k): damage for k in range(count)}


def _damaged_yaml(data: bytes, rng: random.Random) -> bytes:
    if rng.random() < 0.5:
        return damaged_text(data, rng)
    return yaml.safe_dump(damaged_value(yaml.safe_load(data), rng)).encode("utf-8", "surrogatepass")


YAML: dict[str, Damage] = {"capture.yaml": _damaged_yaml}

READERS = {
    "capture, 16-bit PNG": Reader(_capture, _each("view_{}.png", 4, damaged_png) | YAML,
                                  read_capture),
    "capture, 8-bit PNG": Reader(_published, _each("{}.png", 4, damaged_png)
                                 | {"density.txt": damaged_text}, read_capture),
    "capture, NumPy": Reader(_arrays, _each("view_{}.npy", 2, damaged_npy) | YAML, read_capture),
    "capture, EXR": Reader(_exr, _each("view_{}.exr", 2, damaged_bytes), read_capture),
    "capture, points": Reader(_points, {"view_0.ply": damaged_bytes, "view_1.ply": damaged_text}
                              | YAML, read_capture),
    "recording": Reader(lambda folder: shutil.copy(
        ROOT / "tests" / "data" / "recordings" / "turntable.db3", folder),
        {"turntable.db3": damaged_bytes},
        lambda folder: read_recording([folder / "turntable.db3"])),
    "scan, npz": Reader(_scan, {"scan.npz": damaged_zip},
                        lambda folder: read_scan(folder / "scan.npz", SCAN_RIG)),
    "scan, PLY and OBJ": Reader(_raw_scan, {"scan.ply": damaged_bytes, "scan.obj": damaged_text},
                                _read_raw_scan),
    "drape": Reader(_drape, {"drape.npz": damaged_zip},
                    lambda folder: read_borrowed(folder / "drape.npz")),
    "fabric table": Reader(_fabrics, {"fabrics.csv": damaged_text},
                           lambda folder: read_fabric_table(folder / "fabrics.csv")),
    "deflection curve": Reader(_curve, {"curve.csv": damaged_text},
                               lambda folder: read_curve(folder / "curve.csv")),
    "list of captures": Reader(_list, {"list.csv": damaged_text},
                               lambda folder: entries_of(folder / "list.csv")),
    "prior": Reader(_priors, {"gaussian.json": damaged_json, "vae.json": damaged_json},
                    _read_priors),
    "checkpoint": Reader(lambda folder: save_untrained(folder / "net.safetensors", width=4),
                         {"net.safetensors": damaged_safetensors}, _read_checkpoint),
    "state of a training": Reader(_state, {"state.pt": lambda data, rng: damaged_zip(
        data, rng, damaged_bytes)}, _read_state),
    "estimate": Reader(_estimate, {"estimate.json": damaged_json, "samples.npz": lambda data, rng:
                                   damaged_zip(data, rng, damaged_bytes)}, _read_estimate),
    "dataset": Reader(_dataset, _each("shard_0000{}.h5", 2, damaged_bytes)
                      | {"dataset.json": _damaged_manifest}, _read_dataset, _mend_dataset),
    "set-ups": Reader(_setup, {"setup.json": damaged_json}, _read_setup),
    "upload": Reader(_upload, {"capture.zip": lambda data, rng: damaged_zip(
        data, rng, _damaged_member), "fields.json": damaged_json}, _read_upload),
}
