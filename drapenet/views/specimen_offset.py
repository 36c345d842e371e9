"""Scale and offset of the specimen, estimated from a capture's map.

The ratio of the drape's apparent size to the possible one, and the offset of the specimen from the
plate's axis, are regressed on a map's distances in bands of elevations: the scale on their means
and standard deviations around the axis, the offset on their first harmonics. The coefficients in
``drapenet/weights/placement.json`` are fitted by ``experiments/estimation/specimen_offset.py``.
"""

import json
import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from drapenet.views.directions import AZIMUTHS
from drapenet.views.radial_map import RadialMap
from sim.rig import Rig

FILE = Path(__file__).parents[1] / "weights" / "placement.json"
_BAND = 4  # rows of a map


@cache
def coefficients() -> dict[str, Any]:
    """The coefficients by name of the rig."""
    return json.loads(FILE.read_text(encoding="utf-8"))


def specimen_placement(drape: RadialMap, rig: Rig) -> tuple[float, float]:
    """Logarithm of the apparent over the possible size of the drape, and offset, m, of the
    specimen's centre from the plate's axis; NaN for a rig without coefficients.
    """
    if rig.name not in coefficients():
        return math.nan, math.nan
    scale, offset = (coefficients()[rig.name][name] for name in ("log_scale", "offset"))
    return (float(scale_features(drape) @ scale["coefficients"] + scale["constant"]),
            float(np.abs(offset_features(drape) @ offset["coefficients"])))


def _bands(values: np.ndarray) -> np.ndarray:
    """(AZIMUTHS, B) means over bands of rows."""
    return values.reshape(AZIMUTHS, -1, _BAND).mean(axis=2)


def scale_features(drape: RadialMap) -> np.ndarray:
    """(2 B,) mean and standard deviation of the distances, m, around the axis."""
    bands = _bands(drape.distance)
    return np.concatenate([bands.mean(axis=0), bands.std(axis=0)])


def offset_features(drape: RadialMap) -> np.ndarray:
    """(2 B,) complex first harmonics of the distances, m, and of the visibility."""
    around = np.exp(2j * np.pi * (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS)
    return np.concatenate([around @ _bands(values) / AZIMUTHS
                           for values in (drape.distance, (drape.weight > 0).astype(float))])
