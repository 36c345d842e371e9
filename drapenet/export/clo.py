"""Physical properties of CLO and Marvelous Designer, and their file ``.jfab``.

CLO states no units; those of Unreal's importer of CLO's fabrics are taken.
"""

from typing import Any

import numpy as np

from data.readings.cloth import CLO, MAX_CLO
from drapenet.export.material import Material, as_json, left_to_tool

TENSION, MAX_TENSION = 1e3, 1e7  # g/s² per N/m, and g/s²
DEFAULTS: dict[str, Any] = {
    "fBuLR": 0.8, "fBvLR": 0.8, "fBhLR": 0.8, "fBucklingStiffnessU": 0.8,
    "fBucklingStiffnessV": 0.8, "fBucklingStiffnessH": 0.8, "fSuK": 1e5, "fSvK": 1e5, "fHK": 1e4,
    "fThickness": 0.5, "fFriction": 0.03, "fIDS": 1e-4, "listNonlinearSuK": [],
    "listNonlinearSvK": [], "listNonlinearHK": []}
"""What CLO has by default."""
AXES = ("Warp", "Bias", "Weft")
JFAB = {"bendingWarp": "fBvK", "bendingBias": "fBhK", "bendingWeft": "fBuK",
        "bucklingRatioWarp": "fBvLR", "bucklingRatioBias": "fBhLR", "bucklingRatioWeft": "fBuLR",
        "bucklingStiffnessWarp": "fBucklingStiffnessV",
        "bucklingStiffnessBias": "fBucklingStiffnessH",
        "bucklingStiffnessWeft": "fBucklingStiffnessU", "stretchWarp": "fSvK",
        "stretchWeft": "fSuK", "shear": "fHK", "thickness": "fThickness", "friction": "fFriction",
        "density": "fDensity"}
"""Keys of ``mapPhysical``, by the names of CLO's schema of USD: U is the weft."""
UNITS = {**dict.fromkeys((f"bending{axis}" for axis in AXES), "g·mm²/s²"),
         **dict.fromkeys(("stretchWarp", "stretchWeft", "shear"), "g/s²"),
         "thickness": "mm", "density": "g/mm²"}
"""Units, by the same names, of those that have one."""


def clo_values(material: Material) -> dict[str, float]:
    """What is known of a fabric, by the names of CLO's schema of USD and in CLO's units."""
    buckling, known = material.buckling, material.known
    bending = np.minimum(buckling.modulus * CLO, MAX_CLO).tolist()
    values = {f"bending{axis}": value for axis, value in zip(AXES, bending, strict=True)}
    values |= {f"bucklingRatio{axis}": buckling.ratio for axis in AXES}
    values |= {f"bucklingStiffness{axis}": share for axis, share in zip(
        AXES, buckling.share.tolist(), strict=True)}
    values |= {name: min(known[key] * TENSION, MAX_TENSION) for name, key in (
        ("stretchWarp", "stretch_warp"), ("stretchWeft", "stretch_weft"), ("shear", "shear"))
        if key in known}
    values |= {"thickness": known["thickness_mm"]} if "thickness_mm" in known else {}
    values |= {"friction": min(known["friction"], 1.0)} if "friction" in known else {}
    return values | {"density": 1e-3 * material.density}


def jfab(material: Material, name: str) -> dict[str, bytes]:
    """The file of a fabric."""
    values, label = clo_values(material), material.name
    known = {JFAB[key]: value for key, value in values.items()}
    # A key that is missing would be reset to CLO's default, and the name cleared.
    physical = {"enFabricType": 0, **DEFAULTS, **known, "qsPhysicalPropertyName": label,
                "qsPhysicalPropertyNameUTF8": label}
    return {name: as_json({"qsFabricName": label, "qsFabricNameUTF8": label,
                           "uiFabricVersion": 100, "uiVersion": 100, "mapPhysical": physical,
                           "drapenet": material.about_edges | left_to_tool(DEFAULTS, known) | {
                               "units": {JFAB[key]: UNITS[key] for key in values
                                         if key in UNITS}}})}
