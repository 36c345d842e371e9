"""A dataset of pieces of cloth that hang in folds, none of them symmetric, at little cost."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace

import numpy as np
import yaml

from common.files import replace_json
from common.provenance import digest
from data.captures.scans import Scan, read_scan
from data.captures.writer import write_capture
from data.dataset.config import DatasetConfig, SamplingConfig
from data.dataset.folder import MANIFEST
from data.dataset.shards import SCHEMA_VERSION, Shard, shard_name, write_shard
from data.dataset.simulate import make_record
from data.fabrics.prior import load_prior
from data.render.cameras import QUARTERS, Camera, camera_pose, nominal_camera
from data.render.rays import DepthRenderer
from drapenet.surface.shape import CapturedShape
from sim.cloth import Laws
from sim.draping import Drape
from sim.material import Fabric
from sim.mesh import grid_faces
from sim.mesh.specimen import TOPOLOGIES
from sim.rig import DISC_RIG, SQUARE_RIG, Rig
from sim.scene import make_specimen

SOFT = SimpleNamespace(alpha=np.full(3, 20e-6))


def isotropic(alpha: float, softening: float = 0.0) -> Fabric:
    """A fabric of alpha µN·m at 300 g/m² in all directions, with beta/alpha = -softening mm."""
    moduli = np.full(3, alpha * 1e-6)
    return Fabric(moduli, -softening * 1e-3 * moduli)


def flat_drape() -> Drape:
    """A disc on its plate before it hangs."""
    scene = make_specimen(DISC_RIG, edge=0.03)
    flat = np.column_stack([scene.mesh.rest, np.zeros(len(scene.mesh.rest))])
    return CapturedShape(flat, scene.mesh.rest, scene.mesh.faces, DISC_RIG).as_drape(isotropic(20))


def waves(
    rest: np.ndarray, *, folds: int = 8, phase: float = 0.0, depth: float = 0.02
) -> np.ndarray:
    """A drape-like surface over rest points (V, 2) on the disc rig."""
    radius, angle = np.linalg.norm(rest, axis=1), np.arctan2(rest[:, 1], rest[:, 0])
    beyond = np.maximum(radius - DISC_RIG.plate_radius, 0.0) / 0.06
    out = np.minimum(radius, DISC_RIG.plate_radius) + 0.035 * beyond
    out = out + depth * beyond**2 * np.cos(folds * (angle - phase))
    return np.column_stack([out * np.cos(angle), out * np.sin(angle), -0.045 * beyond])


def revolved(radius: np.ndarray, height: np.ndarray, around: int = 180) -> tuple:
    """Vertices and faces of rings about the axis, whose radii and heights, m, are (R,) or, where
    they vary around it, (R, around).
    """
    angle = 2 * np.pi * np.arange(around) / around
    radius, height = (np.broadcast_to(np.reshape(x, (len(x), -1)), (len(x), around))
                      for x in (radius, height))
    vertices = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=-1)
    index = around * np.arange(len(radius))[:, None] + np.append(np.arange(around), 0)
    faces = index.ravel()[grid_faces(np.ones((len(radius) - 1, around), bool))]
    return vertices.reshape(-1, 3), faces


def scan_arrays() -> dict[str, np.ndarray]:
    """A disc of rings whose overhang hangs down along a cone of 45°."""
    radius = np.linspace(0.01, 0.15, 15)
    over = np.maximum(radius - 0.09, 0)
    rest, faces = revolved(radius, 0 * radius, around=60)
    vertices, _ = revolved(radius - (1 - np.sqrt(0.5)) * over, -np.sqrt(0.5) * over, around=60)
    return {"vertices": vertices.astype(np.float32), "rest": rest[:, :2].astype(np.float32),
            "faces": faces.astype(np.int32)}


def scan_with(**changes: np.ndarray | None) -> Scan:
    """The scan of :func:`scan_arrays` with the ``changes``, as it is read."""
    arrays = {name: value for name, value in (scan_arrays() | changes).items() if value is not None}
    with TemporaryDirectory() as folder:
        np.savez(Path(folder) / "bad.npz", **arrays)
        return read_scan(Path(folder) / "bad.npz", Rig(plate_diameter=0.180))


def skirt(
    fabric=SOFT, *, rig=SQUARE_RIG, edge=0.01, start="sine", seed=0, offset=(0.0, 0.0), laws=None
):
    """In place of the solver: five folds, the deeper the softer, which lean to one side."""
    mesh = make_specimen(rig, edge=edge, topology=seed % TOPOLOGIES, offset=offset).mesh
    radius, angle = np.linalg.norm(mesh.rest, axis=1), np.arctan2(*mesh.rest.T[::-1])
    reach = np.maximum(radius - rig.plate_radius, 0)
    depth = 0.6 / (1 + fabric.alpha.mean() / 20e-6)
    spread = 0.5 * (1 + depth * np.sin(5 * angle + 1) + 0.3 * np.cos(angle - 0.4))
    out = np.minimum(radius, rig.plate_radius + spread * reach)
    positions = np.column_stack([out * np.cos(angle), out * np.sin(angle), -0.75 * reach])
    return SimpleNamespace(
        status="converged", converged=True, message="", positions=positions, rest=mesh.rest,
        faces=mesh.faces, outcome=SimpleNamespace(residual=1e-5), iterations=1,
        laws=laws or Laws(),
    )


def write_dataset(root: Path, *, drapes: int, edge: float = 0.012, **sampling: object) -> Path:
    """Drapes, of one fabric each unless ``sampling`` states others, in shards of 8."""
    config = DatasetConfig(
        drapes=drapes, prior=load_prior("gaussian"),
        sampling=SamplingConfig(**{"starts_per_fabric": 1} | sampling), edge=edge,
        drapes_per_shard=8,
    )
    root.mkdir(parents=True)
    for shard in range(config.shards):
        records = [make_record(index, config, solver=skirt) for index in config.rows(shard)]
        write_shard(root / shard_name(shard), records,
                    attributes={"schema_version": SCHEMA_VERSION})
    digests = {name: Shard(root / name).digest for name in map(shard_name, range(config.shards))}
    replace_json(root / MANIFEST, {
        "schema_version": SCHEMA_VERSION, "complete": True, "drapes": drapes,
        "hash": digest(digests), "config": config.as_dict(),
        "identity": digest(config.as_dict()), "shards": digests,
    })
    return root


def varied_camera(rng: np.random.Generator) -> Camera:
    """The nominal camera with another pose."""
    pose = {"distance": rng.normal(0.527, 0.01), "pitch": rng.normal(0.66, 0.02),
            "above": rng.normal(0.036, 0.01), "aside": rng.normal(0.0, 0.01),
            "roll": rng.normal(0.0, 0.04)}
    return replace(nominal_camera(), world_to_camera=camera_pose(**pose))


def capture_views(*, orientation: float = 0.4, turns: Sequence[float] | None = None) -> tuple:
    """Views (4, 90, 120), m, of a skirt, and the intrinsics of their camera."""
    shape, camera = skirt(edge=0.012), nominal_camera().resized(120, 90)
    renderer = DepthRenderer(shape.positions, shape.faces)
    return renderer.views(camera, orientation, QUARTERS if turns is None else turns), (
        camera.intrinsics)


def lopsided_views() -> np.ndarray:
    """Views (4, 180, 240), m, of a plate with a lopsided skirt, by the nominal camera."""
    hem = 0.08 + 0.02 * np.cos(2 * np.pi * np.arange(24) / 24)
    radius = np.array([0 * hem, np.full(24, 0.05), hem])
    cone = revolved(radius, np.array([0, 0, -0.09]), around=24)
    return DepthRenderer(*cone).views(nominal_camera(), 0.3)


def write_skirt(
    folder: Path, *, orientation: float = 0.4, turns: Sequence[float] | None = None, **more: object
) -> Path:
    """A sound capture of a skirt of 150 g/m²."""
    views, intrinsics = capture_views(orientation=orientation, turns=turns)
    write_capture(folder, views=views, intrinsics=intrinsics, density=0.15, rig=SQUARE_RIG,
                  turns=turns, **more)
    return folder


def describe(folder: Path, **changes: object) -> None:
    """Change keys of the description of a capture; None removes one."""
    file = folder / "capture.yaml"
    content = {**yaml.safe_load(file.read_text()), **changes}
    file.write_text(yaml.safe_dump({k: v for k, v in content.items() if v is not None}))
