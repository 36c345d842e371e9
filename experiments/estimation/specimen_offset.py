"""Coefficients of the specimen's scale and offset (drapenet/views/checks.py).

    python -m experiments.estimation.specimen_offset data=DATASET [rig=NAME] [out=FILE]

Ridge regressions on captures of a dataset's drapes, for the scale with depths multiplied by up to
e^±0.15. Writes the table of all rigs with the coefficients of one replaced.
"""

import json
import math
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
from data.dataset.folder import finished_manifest
from data.dataset.shards import Shard
from data.render.setups import Setups
from drapenet.config import FromOne, FromZero
from drapenet.views.checks import coefficients, offset_features, scale_features
from drapenet.views.located import LocatedViews
from drapenet.views.radial_map import radial_map
from sim.rig import Rig

REACH = 0.15  # of the logarithm of the scale
RIDGE = 0.1  # of standardised features


@dataclass
class SpecimenOffsetConfig:
    """``configs/specimen_offset.yaml``."""

    data: str
    rig: str
    out: str
    captures: FromOne
    seed: FromZero


def fit(features: np.ndarray, values: np.ndarray, groups: np.ndarray, *, constant: bool) -> dict:
    """Coefficients of a regression of values (N,) on features (N, F), and the deviation,
    cross-validated over groups (N,)."""
    model = make_pipeline(StandardScaler(with_mean=constant), Ridge(RIDGE, fit_intercept=constant))
    unseen = cross_val_predict(model, features, values, groups=groups, cv=GroupKFold(5))
    model.fit(features, values)
    slopes = model[1].coef_ / model[0].scale_
    middle = model[1].intercept_ - slopes @ model[0].mean_ if constant else 0.0
    return {"coefficients": slopes.tolist(), "constant": float(middle),
            "deviation": float(np.std(unseen - values))}


def drapes(root: Path) -> Iterator[tuple[Shard, int]]:
    """Converged drapes of a dataset; the last shards first, as networks are trained on the first.
    """
    for name in reversed(list(finished_manifest(root)["shards"])):
        shard = Shard(root / name)
        for row in np.flatnonzero(shard.column("status") == "converged"):
            yield shard, row


@command("specimen_offset", SpecimenOffsetConfig)
def main(config: SpecimenOffsetConfig) -> None:
    """Fit the coefficients of one rig and write the table of all rigs with them."""
    if not config.data:
        raise InputError("data= is missing; give the folder of a dataset: data=DIR")
    require_file(Path(config.out))
    rig, setups = Rig.from_name(config.rig), Setups.load()
    scales, offsets = [], []
    for shard, row in drapes(Path(config.data)):
        if len(scales) >= 3 * config.captures:
            break
        positions, _, faces = shard.mesh(row)
        fabric, drift = int(shard.column("fabric")[row]), shard.column("offset")[row] @ [1, 1j]
        rng = np.random.default_rng([config.seed, len(scales)])
        capture = setups.capture(positions, faces, rng, rig=rig)
        for scale in (0.0, *rng.uniform(-REACH, REACH, 2)):
            drape = radial_map(LocatedViews.cut_out(
                capture.views * np.float32(math.exp(scale)), capture.intrinsics, rig,
                capture.turns))
            scales.append((scale_features(drape), scale, fabric))
            if scale == 0.0 and len(capture.views) > 1:
                turn = np.exp(1j * (capture.orientation - drape.zero))
                offsets.append((offset_features(drape), drift * turn, fabric))
    features, values, groups = (np.array(part) for part in zip(*scales, strict=True))
    of_rig = {"log_scale": fit(features, values, groups, constant=True)}
    features, values, groups = (np.array(part) for part in zip(*offsets, strict=True))
    # The offset rotates with the map, so the coefficients of complex features are real.
    of_rig["offset"] = fit(np.concatenate([features.real, features.imag]),
                           np.concatenate([values.real, values.imag]), np.tile(groups, 2),
                           constant=False)
    table = coefficients() | {rig.name: of_rig}
    replace_file(Path(config.out), (json.dumps(table, indent=1) + "\n").encode())
    print(f"{rig.name}: log scale known to {of_rig['log_scale']['deviation']:.3f}, offset to "
          f"{1e3 * of_rig['offset']['deviation']:.2f} mm along warp and weft each")


if __name__ == "__main__":
    main()
