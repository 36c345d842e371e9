"""Scale and offset of the specimen, estimated from a capture's map.

The ratio of the drape's apparent size to the possible one, and the offset of the specimen from the
plate's axis, are regressed on a map's distances in bands of elevations: the scale on their means
and standard deviations around the axis, the offset on their first harmonics. The coefficients of
the ridge regressions, in ``drapenet/weights/placement.json``, are fitted to captures of a dataset's
drapes, for the scale with depths multiplied by up to e^±0.15:

    python -m drapenet.views.specimen_offset data=DATASET [rig=NAME] [out=FILE]

writes that table with the coefficients of one rig replaced; it takes effect in the place of the
file above.
"""

import json
import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from common.command import command
from common.errors import InputError
from common.files import replace_file, require_file
from drapenet.config import FromOne, FromZero
from drapenet.views.directions import AZIMUTHS
from drapenet.views.located import LocatedViews
from drapenet.views.radial_map import RadialMap, radial_map
from sim.rig import Rig

FILE = Path(__file__).parents[1] / "weights" / "placement.json"
_BAND = 4  # rows of a map
_REACH = 0.15  # of the logarithm of the scale
_RIDGE = 0.1  # of standardised features


@dataclass
class PlacementConfig:
    """``configs/placement.yaml``."""

    data: str
    rig: str
    out: str
    captures: FromOne
    seed: FromZero


@cache
def _table() -> dict[str, Any]:
    """The coefficients by name of the rig."""
    return json.loads(FILE.read_text(encoding="utf-8"))


def specimen_placement(drape: RadialMap, rig: Rig) -> tuple[float, float]:
    """Logarithm of the apparent over the possible size of the drape in ``drape``, and offset, m, of
    the specimen's centre from the plate's axis; NaN for a rig without coefficients.
    """
    if rig.name not in _table():
        return math.nan, math.nan
    scale, offset = (_table()[rig.name][name] for name in ("log_scale", "offset"))
    return (float(_scale_features(drape) @ scale["coefficients"] + scale["constant"]),
            float(np.abs(_offset_features(drape) @ offset["coefficients"])))


def _bands(values: np.ndarray) -> np.ndarray:
    """(AZIMUTHS, B) means over bands of rows."""
    return values.reshape(AZIMUTHS, -1, _BAND).mean(axis=2)


def _scale_features(drape: RadialMap) -> np.ndarray:
    """(2 B,) mean and standard deviation of the distances, m, around the axis."""
    bands = _bands(drape.distance)
    return np.concatenate([bands.mean(axis=0), bands.std(axis=0)])


def _offset_features(drape: RadialMap) -> np.ndarray:
    """(2 B,) complex first harmonics of the distances, m, and of the visibility."""
    around = np.exp(2j * np.pi * (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS)
    return np.concatenate([around @ _bands(values) / AZIMUTHS
                           for values in (drape.distance, (drape.weight > 0).astype(float))])


def fit(features: np.ndarray, values: np.ndarray, groups: np.ndarray, *, constant: bool) -> dict:
    """Coefficients of a ridge regression of values (N,) on features (N, F).

    The deviation is cross-validated over groups (N,).
    """
    from sklearn.linear_model import Ridge
    from sklearn.model_selection import GroupKFold, cross_val_predict
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    model = make_pipeline(StandardScaler(with_mean=constant),
                          Ridge(_RIDGE, fit_intercept=constant))
    unseen = cross_val_predict(model, features, values, groups=groups, cv=GroupKFold(5))
    model.fit(features, values)
    coefficients = model[1].coef_ / model[0].scale_
    middle = model[1].intercept_ - coefficients @ model[0].mean_ if constant else 0.0
    return {"coefficients": coefficients.tolist(), "constant": float(middle),
            "deviation": float(np.std(unseen - values))}


@command("placement", PlacementConfig)
def main(config: PlacementConfig) -> None:
    """Fit the coefficients of one rig and write the table of all rigs with them."""
    from data.dataset.folder import finished_manifest
    from data.dataset.shards import Shard
    from data.render.setups import Setups

    if not config.data:
        raise InputError("data= is missing; give the folder of a dataset: data=DIR")
    require_file(Path(config.out))
    rig, setups = Rig.from_name(config.rig), Setups.load()
    manifest, root = finished_manifest(config.data), Path(config.data)
    scales: list[tuple[np.ndarray, float, int]] = []
    offsets: list[tuple[np.ndarray, complex, int]] = []
    for name in reversed(list(manifest["shards"])):  # networks are trained on the first
        drapes = Shard(root / name)
        fabric, drift = drapes.column("fabric"), drapes.column("offset") @ [1, 1j]
        for row in np.flatnonzero(drapes.column("status") == "converged"):
            positions, _, faces = drapes.mesh(row)
            rng = np.random.default_rng([config.seed, len(scales)])
            seen = setups.capture(positions, faces, rng, rig=rig)
            for scale in (0.0, *rng.uniform(-_REACH, _REACH, 2)):
                views = seen.views * np.float32(math.exp(scale))
                drape = radial_map(LocatedViews.cut_out(views, seen.intrinsics, rig, seen.turns))
                scales.append((_scale_features(drape), scale, int(fabric[row])))
                if scale == 0.0 and len(seen.views) > 1:
                    turned = np.exp(1j * (seen.orientation - drape.zero))
                    offsets.append((_offset_features(drape), drift[row] * turned,
                                    int(fabric[row])))
            if len(scales) >= 3 * config.captures:
                break
        if len(scales) >= 3 * config.captures:
            break
    features, values, groups = (np.array(part) for part in zip(*scales, strict=True))
    own = {"log_scale": fit(features, values, groups, constant=True)}
    features, values, groups = (np.array(part) for part in zip(*offsets, strict=True))
    # The offset rotates with the map, so the coefficients of complex features are real.
    own["offset"] = fit(np.concatenate([features.real, features.imag]),
                        np.concatenate([values.real, values.imag]), np.tile(groups, 2),
                        constant=False)
    table = _table() | {rig.name: own}
    replace_file(Path(config.out), (json.dumps(table, indent=1) + "\n").encode())
    print(f"{rig.name}: log scale known to {own['log_scale']['deviation']:.3f}, offset to "
          f"{1e3 * own['offset']['deviation']:.2f} mm along warp and weft each")


if __name__ == "__main__":
    main()
