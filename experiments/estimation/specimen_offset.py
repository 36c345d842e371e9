"""Coefficients of the specimen's offset from the plate's axis (drapenet/views/checks.py).

A ridge regression on captures of a dataset's drapes on all testers; the report is the table
``drapenet/weights/specimen_offset.json``.
"""

from itertools import islice
from pathlib import Path

import numpy as np
from sklearn.linear_model import Ridge
from sklearn.model_selection import GroupKFold, cross_val_predict
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from common.errors import InputError
from data.captures.view_checks import CLOTH_SHARE
from data.render.setups import Setups
from drapenet.views.checks import offset_features
from drapenet.views.located import LocatedViews
from drapenet.views.radial_map import radial_map
from experiments.drapes import converged_drapes
from experiments.report import Report
from experiments.study import PlainKeys, Study

RIDGE = 0.1  # of standardised features


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


class Keys(PlainKeys):
    data: str = ""  # folder of a finished dataset
    captures: int = 300  # used for the regressions
    seed: int = 1  # of the captures
    out: str = "outputs/specimen_offset.json"  # the coefficients


def run(keys: Keys) -> Report:
    """Fit the coefficients."""
    if not keys.data:
        raise InputError("data= is missing; give the folder of a dataset: data=DIR")
    setups, rows = Setups.load(), []
    found = islice(converged_drapes(Path(keys.data)), keys.captures)
    for number, (shard, row) in enumerate(found):
        positions, _, faces = shard.mesh(row)
        rig = shard.rig(row)
        fabric, drift = int(shard.column("fabric")[row]), shard.column("offset")[row] @ [1, 1j]
        capture = setups.capture(positions, faces, np.random.default_rng([keys.seed, number]),
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
    return fit(np.concatenate([features.real, features.imag]),
               np.concatenate([values.real, values.imag]), np.tile(groups, 2))


STUDY = Study(Keys, run)
