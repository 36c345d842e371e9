"""A small dataset whose pictures show theta plainly, so that learning is fast to test."""

from pathlib import Path

import numpy as np

from data.shards import (
    DEPTH_UNIT,
    SCHEMA_VERSION,
    Layout,
    fields,
    json_digest,
    verified_digest,
    write_manifest,
    write_shard,
)

HEIGHT, WIDTH, ORIENTATIONS = 60, 80, 2


def blob_views(theta: np.ndarray, psi: float, turns: np.ndarray | None = None) -> np.ndarray:
    """Views (4, H, W) m of an ellipse: stiffer is larger, elongated along the stiff axis.

    ``turns`` (4,) is what the table has turned beyond a quarter turn a view, rad.

    Not a drape, but with a drape's symmetries: another first view or the mirror image of the
    views is what the correspondingly turned or mirrored specimen gives.
    """
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    x, y = (x - (WIDTH - 1) / 2) / 20, (y - (HEIGHT - 1) / 2) / 20
    size = 1 + 0.25 * (theta[1] + 10.4)
    views = []
    for k in range(4):
        # Seen from the side, a table shows what lies across the line of sight.
        angle = psi + k * np.pi / 2 + (0.0 if turns is None else turns[k])
        across = np.tanh(theta[0] - theta[2]) * np.cos(2 * angle)
        tilt = np.tanh(theta[0] - theta[2]) * np.sin(2 * angle)
        radius = (x * (1 - 0.3 * across)) ** 2 + y**2
        depth = 0.5 + 0.03 * radius + 0.05 * tilt * x
        views.append(np.where(radius < size**2, depth, 0.0))
    return np.stack(views)


def write_dataset(root: Path, *, drapes: int = 64, seed: int = 0, turn: float = 0.0) -> Path:
    """A dataset of blobs, one fabric each, in two shards; ``turn``: the table's deviation, rad."""
    rng = np.random.default_rng(seed)
    layout = Layout(orientations=ORIENTATIONS, height=HEIGHT, width=WIDTH)
    root.mkdir(parents=True)
    rows = []
    for index in range(drapes):
        row = {name: np.zeros(f.shape, f.dtype) for name, f in fields(layout, 0).items()}
        theta = np.concatenate([rng.normal(-10.4, 0.9, 3), rng.normal(-0.003, 0.002, 3)])
        psi = rng.uniform(0, 2 * np.pi, ORIENTATIONS)
        turns = np.zeros((ORIENTATIONS, 4))
        if turn:
            turns[:, 1:] = rng.normal(0.0, turn, (ORIENTATIONS, 3))
        views = np.stack([blob_views(theta, *shown) for shown in zip(psi, turns, strict=True)])
        row |= {"index": index, "fabric": index, "theta": theta, "status": b"converged",
                "start": b"sine", "rendered": 1, "faces": np.zeros((0, 3)), "orientations": psi,
                "turns": turns, "views": np.rint(views / DEPTH_UNIT)}
        rows.append(row)
    half = drapes // 2
    names = []
    for shard, block in enumerate((rows[:half], rows[half:])):
        names.append(f"shard_{shard:05d}.h5")
        write_shard(root / names[-1], block, layout=layout,
                    attributes={"schema_version": SCHEMA_VERSION})
    config = {"sampling": {"orientations": ORIENTATIONS, "seed": seed}, "prior": "blobs",
              "rig": {"name": "square300_cylinder100"}}
    write_manifest(root, {
        "schema_version": SCHEMA_VERSION, "complete": True, "drapes": drapes,
        "hash": f"{seed:064x}", "shards": {name: verified_digest(root / name) for name in names},
        "config": config, "identity": json_digest(config),
    })
    return root
