"""``python infer.py scan=FILE refine=scan``: a scan in, moduli and their fidelity out."""

import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from tqdm import tqdm

from common.errors import InputError
from data.prior.files import load_prior
from data.scans import LARGEST_SCAN, read_scan
from drapenet.output import require_output, write_estimate, write_report
from drapenet.refine.captured import CapturedShape, Cloth, Settled
from drapenet.refine.fidelity import fidelity
from drapenet.refine.register import SLID, edge_strain, laid_again, register
from drapenet.refine.scan import Cloud
from drapenet.refine.shape_search import Found, scan_objective, search_cloth
from drapenet.table import moduli_table
from sim.material import DIRECTIONS
from sim.scene import Rig

SCHEMA, SCHEMA_VERSION = "drapenet-scan-estimate", 3
RAW = (".ply", ".obj")
_START = "disc300_support180"
LEAST_HELD = 0.5
EDGE = 3e-3  # m, at the rim of the mesh that a scan is registered to
_FLAT = 0.02  # m, how far a raw scan's plate may lie from the plane z = 0
_APART = 5e-3  # m, mean distance from which on the specimen does not lie on the scan
_ELSEWHERE = 15e-3  # m from the specimen laid on it, a scanned point shows something else ...
_FOREIGN = 0.1  # ... and more than this share of them does not go


def refine_scan(
    path: Path, *, rig: str = _START, held: float = 1.0, solves: int = 25,
    edge: float = EDGE,
) -> tuple[dict[str, Any], CapturedShape, Found]:
    """The content of ``estimate.json``, the captured shape and what the search has found.

    Args:
        path: npz with vertices (V, 3) m, rest (V, 2) m and faces (F, 3), or a raw PLY or OBJ in
            metres, z up, the plate's centre the origin.
        rig: name of the rig.
        held: see :class:`.captured.CapturedShape`.
        solves: simulations at most.
        edge: m, at the rim of the mesh that a scan is registered to.

    Raises:
        InputError: no such scan, a share out of range, or none of the simulations ended.
    """
    if not LEAST_HELD <= held <= 1.0:
        raise InputError(f"held={held:g}: give a share of the support's radius, {LEAST_HELD} to 1")
    prior = load_prior("gaussian")
    start = Cloth(prior.mean.copy())
    shape, registration = read_shape(path, Rig.from_name(rig), held=held, edge=edge)
    with tqdm(total=solves, desc="refining", unit="drape") as bar:
        def report(count: int, least: float) -> None:
            bar.set_postfix_str(f"misfit {least:.4g}", refresh=False)
            bar.update(count - bar.n)

        found = search_cloth(shape, scan_objective(shape), start, prior=prior, solves=solves,
                             report=report)
    failures = found.effort.failures
    if found.estimate is None:
        if not failures:
            raise KeyboardInterrupt
        raise InputError(f"no cloth settles at the shape of {path} ({failures[-1]})")
    content = {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "scan": {"file": str(path), "rig": rig, "held_share": held, "registration": registration},
        "convention": "axes of the scan's rest points; which of the two yarns is the warp, the "
                      "shape does not say; where both are alike the axes may lie 45° off, "
                      "warp and bias exchanged",
        **_cloth_content(found.estimate.cloth),
        "prior_moduli_at_300_g_m2": moduli_table(DIRECTIONS, start.fabric),
        "simulations": found.effort.solves,
        "failed_simulations": failures,
        "fidelity": _fidelity_of(shape, found.released),
        "nearest_drape": None if found.nearest is None else {
            **_cloth_content(found.nearest.cloth),
            "fidelity": _fidelity_of(shape, found.nearest),
        },
    }
    return content, shape, found


def read_shape(
    path: Path, rig: Rig, *, held: float = 1.0, edge: float = EDGE
) -> tuple[CapturedShape, dict[str, Any] | None]:
    """The captured shape of a scan, and what ``estimate.json`` says of its registration.

    Raw scans are registered; so are those whose own vertices slid along the cloth. Arguments and
    errors as for :func:`refine_scan`; a surface that the specimen cannot be laid on is one.
    """
    if path.suffix.lower() in RAW:
        cloud = read_cloud(path, rig)
        found, strain = register(cloud, rig, edge=edge, held=held), None
        laid = Cloud.of_mesh(found.shape.positions, found.shape.faces)
        away = cKDTree(laid.points).query(cloud.points)[0]
        if (foreign := float((away > _ELSEWHERE).mean())) > _FOREIGN:
            raise InputError(f"{path}: {foreign:.0%} of its points do not lie on a specimen of "
                             f"{rig.name}; cut away all that is not cloth, such as the table")
    else:
        scan = read_scan(path, rig)
        own = CapturedShape(scan.positions, scan.rest, scan.faces, rig, held)
        strain = edge_strain(own)
        if strain < SLID:
            return own, None
        found = laid_again(own, edge=edge)
    apart = float(found.distance[found.shape.hanging].mean())
    if apart > _APART:
        raise InputError(f"{path}: a specimen of {rig.name} cannot be laid on this surface, it "
                         f"stays {1e3 * apart:.0f} mm away on average; give all of the cloth and "
                         "nothing else, in metres")
    return found.shape, {
        "reason": "raw" if strain is None else "vertices slid along the cloth",
        "edge_strain_before": strain,
        "edge_strain": edge_strain(found.shape),
        "mean_distance_mm": 1e3 * apart,
    }


def _cloth_content(cloth: Cloth) -> dict[str, Any]:
    return {
        "moduli_at_300_g_m2": moduli_table(DIRECTIONS, cloth.fabric),
        "membrane_N_m": cloth.membrane,
        "warp_direction_deg": math.degrees(cloth.warp) % 180,
    }


def _fidelity_of(shape: CapturedShape, settled: Settled | None) -> dict[str, Any] | None:
    return None if settled is None else fidelity(shape, settled.drape).as_dict()


def infer_scan(config: dict[str, Any]) -> None:
    """Refine what ``configs/infer.yaml`` names, write estimate and report, print a table.

    Raises:
        InputError: keys that do not go together, or see :func:`refine_scan`.
    """
    if config["capture"]:
        raise InputError("give capture=DIR or scan=FILE, not both")
    if config["refine"] not in ("none", "scan"):
        raise InputError(f"refine={config['refine']} does not go with scan=FILE; use refine=scan")
    path = Path(config["scan"])
    out = Path(config["out"] or Path("outputs/infer") / path.stem)
    require_output(out)
    content, shape, found = refine_scan(path, held=config["held"])
    write_estimate(out, content, format_scan(content))
    write_report(out, draw(shape, found, content))


def format_scan(content: dict[str, Any]) -> str:
    """The estimate as a few lines."""
    lines = [f"{'at 300 g/m²':12}{'alpha µN·m':>12}{'beta nN·m²':>12}{'prior alpha':>13}"]
    for name, row in content["moduli_at_300_g_m2"].items():
        before = content["prior_moduli_at_300_g_m2"][name]["alpha_uN_m"]
        lines.append(f"{name:12}{row['alpha_uN_m']:12.3g}{row['beta_nN_m2']:12.3g}{before:13.3g}")
    if registration := content["scan"]["registration"]:
        lines.append(f"registered ({registration['reason']}): "
                     f"{registration['mean_distance_mm']:.2f} mm from the scan on average")
    lines.append(f"membrane {content['membrane_N_m']:.3g} N/m, warp at "
                 f"{content['warp_direction_deg']:.0f}°, {content['simulations']} simulations")
    nearest = content["nearest_drape"]
    alphas = ", ".join(f"{row['alpha_uN_m']:.3g}"
                       for row in nearest["moduli_at_300_g_m2"].values()) if nearest else ""
    for name, f in (("let go at the captured shape", content["fidelity"]),
                    (f"nearest drape found (alpha {alphas} µN·m)",
                     nearest and nearest["fidelity"])):
        if f:
            lines += [
                f"{name}: rests {f['displacement_mm']:.1f} mm away on average, "
                f"{f['surface_mm']:.1f} mm from the surface",
                f"    mean curvature {f['curvature']:.0%} different; drape coefficient "
                f"{f['coefficient']:.1f} %, captured {f['captured_coefficient']:.1f} %",
            ]
    return "\n".join(lines)


def draw(shape: CapturedShape, found: Found, content: dict[str, Any]) -> bytes:
    """PNG: captured shape, nearest drape, their distance on the flat specimen; the moduli below."""
    from io import BytesIO

    from matplotlib.figure import Figure

    from data.picture import shade

    best, name = found.nearest or found.estimate, "nearest drape" if found.nearest else "held cloth"
    figure = Figure(figsize=(11, 5.6), layout="constrained")
    axes = figure.subplots(1, 3)
    for axis, positions, title in zip(axes, (shape.positions, best.drape.positions),
                                      ("captured", name), strict=False):
        axis.imshow(shade(positions, shape.faces, plate_radius=shape.rig.plate_radius))
        axis.set_title(title)
    gap = 1e3 * np.linalg.norm(best.drape.positions - shape.positions, axis=1)
    image = axes[2].tripcolor(*1e3 * shape.rest.T, shape.faces, gap, shading="gouraud",
                              cmap="magma")
    axes[2].set_aspect("equal")
    axes[2].set_title("distance on the flat specimen")
    figure.colorbar(image, ax=axes[2], label="mm")
    for axis in axes:
        axis.set_xticks([])
        axis.set_yticks([])
    figure.supxlabel(format_scan(content), x=0.01, ha="left", family="monospace", fontsize=9)
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    return buffer.getvalue()


def read_cloud(path: Path, rig: Rig) -> Cloud:
    """Read a raw scan, PLY or OBJ in metres, z up, the plate's centre the origin.

    Raises:
        InputError: no such file, no points, other units or axes.
    """
    import trimesh

    try:
        # In memory first: a scan may name other files, materials for example, which are not read.
        with path.open("rb") as file:
            loaded = trimesh.load(file, file_type=path.suffix[1:].lower(), process=False,
                                  skip_materials=True, force=None)
        points = np.asarray(getattr(loaded, "vertices", np.zeros((0, 3))), dtype=np.float64)
        if points.shape[1:] != (3,):
            raise ValueError("points of another number of coordinates than three")
        faces = np.asarray(getattr(loaded, "faces", np.zeros((0, 3))), dtype=np.int64)
    except (OSError, ValueError, TypeError, KeyError, IndexError, AttributeError, EOFError,
            UnicodeDecodeError, NotImplementedError, zipfile.BadZipFile) as error:
        # What trimesh says of a file that it cannot read is of no use to its owner.
        reason = getattr(error, "strerror", None) or (
            "no PLY or OBJ mesh or cloud of points, or a damaged one; export it again")
        raise InputError(f"cannot read the scan {path}: {reason}") from None
    if bad := int((~np.isfinite(points)).any(axis=1).sum()):
        raise InputError(f"{path}: {bad} of its points are not finite numbers; remove them")
    if not 200 <= len(points) <= LARGEST_SCAN:
        raise InputError(f"{path}: a scan has from 200 to {LARGEST_SCAN} points, this one "
                         f"{len(points)}")
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(points):
        raise InputError(f"{path}: a face names a vertex that is not there; export the scan again")
    reach = np.abs(points).max()
    if not 0.5 * rig.plate_radius < reach < rig.specimen_size:
        raise InputError(f"{path}: points must be in metres, the plate's centre the origin; they "
                         f"reach {reach:.3g} from it, a specimen {rig.specimen_size / 2:g} m")
    middle = points[np.hypot(points[:, 0], points[:, 1]) < 0.8 * rig.plate_radius]
    if not len(middle) or np.abs(np.median(middle[:, 2])) > _FLAT:
        raise InputError(f"{path}: cloth on the plate must lie in the plane z = 0, z up")
    if points[:, 2].min() > -_FLAT:
        raise InputError(f"{path}: nothing hangs below the support; z must point up")
    return Cloud.of_mesh(points, faces) if len(faces) else Cloud.of_points(points)
