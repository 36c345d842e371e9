"""Share of faulty captures that are corrected, refused or reported with a warning.

Drapes of a dataset are captured in four views (``configs/setup/real.yaml``), and faulted as users
may. Captures without faults should have no warning.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import ndimage
from tqdm import tqdm

from common.errors import InputError
from common.findings import texts
from data.captures.capture import DepthCapture
from data.captures.view_checks import checked_views
from data.dataset.folder import finished_manifest
from data.dataset.shards import Shard
from data.fabrics.fabrics import fabric_from_theta
from data.render.setups import Setups, SyntheticCapture
from drapenet.views.checks import view_warnings
from drapenet.views.located import LocatedViews
from drapenet.views.radial_map import radial_map
from experiments.report import Report
from experiments.study import PlainKeys, Study
from sim.draping import drape
from sim.material import REFERENCE_DENSITY
from sim.rig import Rig

MAX_DIFFERING_PIXELS = 10  # pixels per view that may still differ in a corrected capture
EDGE = 6e-3  # m, mesh edges of drapes that are simulated with a fault

Rng = np.random.Generator


def _scale_focal(capture: SyntheticCapture, fx: float, fy: float) -> SyntheticCapture:
    given = capture.intrinsics
    return replace(capture, intrinsics=replace(given, fx=fx * given.fx, fy=fy * given.fy))


def _per_view(change: Callable[[np.ndarray, Rng], np.ndarray]) -> Callable:
    def apply(capture: SyntheticCapture, rng: Rng) -> SyntheticCapture:
        return replace(capture, views=np.stack([change(view.copy(), rng)
                                                for view in capture.views]))
    return apply


def _speckle(view: np.ndarray, rng: Rng) -> np.ndarray:
    inside = np.argwhere(ndimage.binary_erosion(view > 0, iterations=2))
    view[tuple(inside[rng.choice(len(inside), 40)].T)] = 1e-3
    return view


def _missing(view: np.ndarray, rng: Rng) -> np.ndarray:
    view[rng.random(view.shape) < 0.15] = 0
    return view


def _hot(view: np.ndarray, rng: Rng) -> np.ndarray:
    view[tuple(rng.integers(view.shape))] = 65.535
    return view


def _threshold(view: np.ndarray, rng: Rng) -> np.ndarray:
    view[view > np.quantile(view[view > 0], 0.85)] = 0
    return view


def _flying(view: np.ndarray, rng: Rng) -> np.ndarray:
    cloth = view > 0
    edge = ndimage.binary_dilation(cloth) & ~cloth & (rng.random(view.shape) < 0.3)
    view[edge] = rng.uniform(0.5, 1.5, edge.sum())
    return view


def _saturated(view: np.ndarray, rng: Rng) -> np.ndarray:
    rows, columns = np.nonzero(view > 0)
    middle = rng.integers(len(rows))
    near = np.hypot(*np.indices(view.shape) - [[[rows[middle]]], [[columns[middle]]]]) < 14
    view[near] = 0
    return view


def _rays(capture: SyntheticCapture, rng: Rng) -> SyntheticCapture:
    c = capture.intrinsics
    rows, columns = np.indices(capture.views.shape[1:])
    length = np.sqrt(1 + ((columns - c.cx) / c.fx) ** 2 + ((rows - c.cy) / c.fy) ** 2)
    return replace(capture, views=(capture.views * length).astype(np.float32))


def _not_turned(capture: SyntheticCapture, rng: Rng) -> SyntheticCapture:
    views = capture.views.copy()
    views[1] = np.where(views[0] > 0, views[0] + rng.normal(0, 1e-3, views[0].shape), 0)
    return replace(capture, views=views)


def _coarse(capture: SyntheticCapture, rng: Rng) -> SyntheticCapture:
    given, step = capture.intrinsics, 2
    views = capture.views[:, ::step, ::step]
    return replace(capture, views=views, intrinsics=replace(
        given, **{name: getattr(given, name) / step for name in ("fx", "fy", "cx", "cy")},
        width=views.shape[2], height=views.shape[1]))


def _shift_rows(capture: SyntheticCapture, rows: int) -> SyntheticCapture:
    views = np.roll(capture.views, rows, axis=1)
    given = capture.intrinsics
    views[:, :rows] = 0
    return replace(capture, views=views, intrinsics=replace(given, cy=given.cy + rows))


FAULTS: dict[str, Callable[[SyntheticCapture, Rng], SyntheticCapture]] = {
    "speckle inside the cloth": _per_view(_speckle),
    "15 % of pixels missing": _per_view(_missing),
    "fx 15 % too long": lambda c, rng: _scale_focal(c, 1.15, 1.0),
    "fx 20 % too short": lambda c, rng: _scale_focal(c, 0.8, 1.0),
    "fx and fy 15 % too long": lambda c, rng: _scale_focal(c, 1.15, 1.15),
    "depth 10 % too large": _per_view(lambda view, rng: 1.1 * view),
    "depth 10 % too small": _per_view(lambda view, rng: 0.9 * view),
    "table not turned once": _not_turned,
    "cut by a threshold of the depth": _per_view(_threshold),
    "length of the ray for depth": _rays,
    "a hot pixel": _per_view(_hot),
    "flying pixels around the cloth": _per_view(_flying),
    "a saturated patch": _per_view(_saturated),
    "two views swapped": lambda c, rng: replace(c, views=c.views[[0, 2, 1, 3]]),
    "turned the other way": lambda c, rng: replace(c, views=c.views[[0, 3, 2, 1]]),
    "mirrored pictures": _per_view(lambda view, rng: view[:, ::-1]),
    "pictures upside down": _per_view(lambda view, rng: view[::-1]),
    "hem outside the picture": lambda c, rng: _shift_rows(c, 35),
    "every second pixel only": _coarse,
    "depth in centimetres": _per_view(lambda view, rng: 10 * view),
}
"""Faults by name, as functions that apply them to a capture of four views."""
SIMULATED = {
    "specimen of 270 mm": {"rig": replace(Rig(), sides=(0.27, 0.27))},
    "specimen 20 mm off the centre": {"offset": (0.02, 0.0)},
}
"""Faults of the specimen by name, as arguments of :func:`sim.draping.drape`."""
MOVED_CLOTH = "cloth moved between the views"


def check_capture(capture: SyntheticCapture) -> DepthCapture:
    """Check the capture as ``infer.py`` does when it reads one."""
    views, warnings = checked_views(capture.views, capture.intrinsics)
    return DepthCapture(views, capture.intrinsics, capture.turns, density=REFERENCE_DENSITY,
                        rig=Rig(), warnings=warnings)


def find_warnings(
    capture: SyntheticCapture, rig: Rig, setups: Setups, *, sound: SyntheticCapture | None = None
) -> list[str]:
    """Warnings of ``infer.py`` before estimation, or its error message if it refuses the capture.

    Args:
        sound: the capture without the fault. If the checked captures differ in at most a few
            pixels, the result is "corrected".
    """
    try:
        checked = check_capture(capture)
    except InputError as error:
        return [str(error)]
    if sound is not None and checked.views.shape == sound.views.shape:
        differing = (np.abs(checked.views - check_capture(sound).views) > 1e-6).sum()
        if differing < MAX_DIFFERING_PIXELS * len(checked.views):
            return ["corrected"]
    located = LocatedViews.cut_out(checked.views, checked.intrinsics, rig, checked.turns)
    try:
        return texts([*checked.warnings, *view_warnings(located, radial_map(located), setups)])
    except InputError as error:
        return [str(error)]


def converged_drapes(root: Path, rig: Rig) -> Iterator[tuple[Shard, int]]:
    """Converged drapes on a ``rig``, with any rim, by shard and row."""
    for name in finished_manifest(root)["shards"]:
        shard = Shard(root / name)
        for row in np.flatnonzero(shard.column("status") == "converged"):
            if replace(shard.rig(row), rim=0.0) == rig:
                yield shard, row
    raise InputError(f"{root} has too few drapes on {rig.name}; give a larger dataset")


class Keys(PlainKeys):
    data: str = "outputs/dataset"  # with drapes on the square rig (make dataset)
    sound: int = 300  # captures without faults
    spoiled: int = 20  # captures with each fault
    seed: int = 31  # of all random numbers


def run(keys: Keys) -> Report:
    """Check captures without and with faults."""
    rig = Rig()
    setups = replace(Setups.load(), views=(0.0, 0.0, 0.0, 1.0))
    source = converged_drapes(Path(keys.data), rig)

    def capture(positions: np.ndarray, faces: np.ndarray, rng: Rng) -> SyntheticCapture:
        return setups.capture(positions, faces, rng, rig=rig)

    messages: dict[str, list[list[str]]] = {}
    for number in tqdm(range(keys.sound), desc="sound", mininterval=5):
        rng = np.random.default_rng([keys.seed, number])
        shard, row = next(source)
        positions, _, faces = shard.mesh(row)
        seen = capture(positions, faces, rng)
        messages.setdefault("sound", []).append(find_warnings(seen, rig, setups))
    for number in tqdm(range(keys.spoiled), desc="spoiled"):
        rng = np.random.default_rng([keys.seed, 1, number])
        shard, row = next(source)
        theta, (positions, _, faces) = shard.column("theta")[row], shard.mesh(row)
        seen = capture(positions, faces, rng)
        for name, apply in FAULTS.items():
            messages.setdefault(name, []).append(
                find_warnings(apply(seen, rng), rig, setups, sound=seen))
        shapes = {name: drape(fabric_from_theta(theta), edge=EDGE, seed=number, **{
            "rig": rig, **options}) for name, options in SIMULATED.items()}
        for name, shape in shapes.items():
            if shape.converged:
                messages.setdefault(name, []).append(find_warnings(
                    capture(shape.positions, shape.faces, rng), rig, setups))
        other = drape(fabric_from_theta(theta), rig=rig, edge=EDGE, seed=number + 1, start="fold")
        again = capture(other.positions, other.faces, np.random.default_rng(
            [keys.seed, 1, number]))
        views = np.concatenate([seen.views[:2], again.views[2:]])
        messages.setdefault(MOVED_CLOTH, []).append(
            find_warnings(replace(seen, views=views), rig, setups))
    shares = {name: float(np.mean([bool(one) for one in lines]))
              for name, lines in messages.items()}
    reasons = Counter(line.split(":")[-1 if line.startswith("view ") else 0][:50]
                      for lines in messages["sound"] for line in lines)
    return {"found": shares, "warnings_of_sound": dict(reasons.most_common(20))}


STUDY = Study(Keys, run)
