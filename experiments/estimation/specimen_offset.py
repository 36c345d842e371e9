"""Coefficients of the specimen's offset from the plate's axis (drapenet/views/checks.py).

    python -m experiments.estimation.specimen_offset data=DATASET [out=FILE]

A ridge regression on captures of a dataset's drapes on all testers.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from sklearn.linear_model import Ridge
from sklearn.model_selection import GroupKFold, cross_val_predict
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from common.command import command
from common.errors import InputError
from common.files import replace_file, require_file
from data.captures.view_checks import CLOTH_SHARE
from data.dataset.folder import finished_manifest
from data.dataset.shards import Shard
from data.render.setups import Setups
from drapenet.config import FromOne, FromZero
from drapenet.views.checks import offset_features
from drapenet.views.located import LocatedViews
from drapenet.views.radial_map import radial_map

RIDGE = 0.1  # of standardised features


@dataclass
class SpecimenOffsetConfig:
    """``configs/specimen_offset.yaml``."""

    data: str
    out: str
    captures: FromOne
    seed: FromZero


def fit(features: np.ndarray, values: np.ndarray, groups: np.ndarray) -> dict:
    """Coefficients of a regression without constant of values (N,) on features (N, F), and the
    deviation, cross-validated over groups (N,)."""
    model = make_pipeline(StandardScaler(with_mean=False), Ridge(RIDGE, fit_intercept=False))
    unseen = cross_val_predict(model, features, values, groups=groups, cv=GroupKFold(5))
    model.fit(features, values)
    # A regression draws values towards zero; offsets to be warned about are the largest.
    unbiased = (values @ values) / (values @ unseen)
    return {"coefficients": (unbiased * model[1].coef_ / model[0].scale_).tolist(),
            "deviation": float(np.std(unbiased * unseen - values))}


def drapes(root: Path) -> Iterator[tuple[Shard, int]]:
    """Converged drapes of a dataset; the last shards first, as networks are trained on the first.
    """
    for name in reversed(list(finished_manifest(root)["shards"])):
        shard = Shard(root / name)
        for row in np.flatnonzero(shard.column("status") == "converged"):
            yield shard, row


@command("specimen_offset", SpecimenOffsetConfig)
def main(config: SpecimenOffsetConfig) -> None:
    """Fit the coefficients and write them."""
    if not config.data:
        raise InputError("data= is missing; give the folder of a dataset: data=DIR")
    require_file(Path(config.out))
    setups, rows = Setups.load(), []
    for number, (shard, row) in enumerate(drapes(Path(config.data))):
        if number >= config.captures:
            break
        positions, _, faces = shard.mesh(row)
        rig = shard.rig(row)
        fabric, drift = int(shard.column("fabric")[row]), shard.column("offset")[row] @ [1, 1j]
        capture = setups.capture(positions, faces, np.random.default_rng([config.seed, number]),
                                 rig=rig)
        share = (capture.views > 0).mean(axis=(1, 2)).min()
        if len(capture.views) == 1 or share < CLOTH_SHARE[0]:  # refused when it is read
            continue
        drape = radial_map(LocatedViews.cut_out(capture.views, capture.intrinsics, rig,
                                                capture.turns))
        turn = np.exp(1j * (capture.orientation - drape.zero))
        rows.append((offset_features(drape, rig), drift * turn / rig.specimen_size, fabric))
    features, values, groups = (np.array(part) for part in zip(*rows, strict=True))
    # The offset rotates with the map, so the coefficients of complex features are real.
    found = fit(np.concatenate([features.real, features.imag]),
                np.concatenate([values.real, values.imag]), np.tile(groups, 2))
    replace_file(Path(config.out), (json.dumps(found, indent=1) + "\n").encode())
    print(f"offset known to {1e3 * 0.3 * found['deviation']:.2f} mm of a specimen of 300 mm, along "
          "warp and weft each")


if __name__ == "__main__":
    main()
