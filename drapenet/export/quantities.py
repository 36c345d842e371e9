"""What files for other tools say of a fabric, by name, in SI units."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from data.readings.cloth import BROWZWEAR, CLO
from drapenet.export.blender import blender_settings
from drapenet.export.material import Material
from sim.energies.hinges import ARCSIM
from sim.energies.membrane import OrthotropicStVK
from sim.material import BIAS, DIRECTIONS, WARP, WEFT, torque
from sim.tension import POISSON

UNITS = {
    "g·mm²/s²": CLO,
    "dyn·cm": BROWZWEAR,
    "kg·cm²/s²/rad²": 1e4,
    "g/s²": 1e3,
    "g/m²": 1e3,
    "g/mm²": 1e-3,
    "mm": 1e3,
}
"""Numbers in units that are no SI units, over those in SI units; any other unit is one."""
SLIDER = ((0.0, 10.0, 28.0, 48.0, 65.0, 83.0, 100.0), (0.0, 1e2, 1e3, 3e3, 2e4, 2e5, 2e6))
"""CLO's scale of 0 to 100 and its bending stiffness, linear between these."""
ASSUMED_MM = 1.0
"""Thickness where none is known: a weight is density times thickness, and tools that read no
thickness take the default of AOUSD's proposal, which is this."""
PPF = 1.28e-5  # m²/s²: BEND_SCALE of ppf-contact-solver's energy.cu
STYLE3D = 3.0  # Newton's quadratic hinges: plate of modulus 3 ke
PHYSX = 1.5  # modulus over stiffness and thickness cubed (``PxgFEMCloth.cpp``)
HOOD_THICKNESS = 4.7e-4  # m, of HOOD's and ContourCraft's stretching energies
FLEX = 8.0  # mu t³ over the modulus in MuJoCo 3.12, mu being young/2 without Poisson's ratio
FLEX_EDGE, FLEX_COLUMNS, FLEX_ROWS = 0.01, 11, 13
"""m, of the triangles of equal sides of MuJoCo's patch, and their vertices."""
FLEX_AREA = (FLEX_COLUMNS - 1) * (FLEX_ROWS - 1) * FLEX_EDGE**2 * 0.75**0.5
EQUAL_SIDES = 9 / 8
"""Of strips, over that of hinges on triangles of equal sides: they are a plate whose Poisson's
ratio is -1/3. Such a strip hangs as the elastica in MuJoCo 3.12 and 4.0."""
ARCSIM_CURVATURES = np.array([0.0, 10.0, 20.0, 30.0, 40.0])
"""1/m, of ARCSim's table: theta l/(A0 + A1) is twice the number that its columns count in steps of
5/m (``dde.cpp``, ``bending_stiffness``); it is constant beyond the last column."""
ARCSIM_STRETCHING = 6
"""Samples of ARCSim's table of stretching: without strain, and of five directions with it."""


def quantities(material: Material) -> dict[str, Any]:
    """Numbers, lists of them and texts; what is not known is missing or None. Curves along warp,
    bias and weft are lists; ``flat``, ``share`` and ``bent`` those of a hinge that buckles.
    """
    known, buckling, density = material.known, material.buckling, material.density
    thickness = 1e-3 * known.get("thickness_mm", ASSUMED_MM)
    curves = {"": material.modulus, "flat": buckling.modulus, "share": buckling.share,
              "bent": buckling.modulus * buckling.share,
              "slider": np.interp(UNITS["g·mm²/s²"] * buckling.modulus, *SLIDER[::-1])}
    found = {f"{name}_{direction}".lstrip("_"): value for name, curve in curves.items()
             for direction, value in zip(DIRECTIONS, curve.tolist(), strict=True)}
    found |= {key: value for key, value in known.items() if key != "thickness_mm"}
    found |= {
        "directions": list(material.document.names),
        "alpha": material.alpha.tolist(),
        "beta": material.beta.tolist(),
        "mean": material.one_modulus,
        "density": density,
        "buckling_ratio": buckling.ratio,
        "edge": 1e-3 * material.settings.edge_mm,
        "stretch": [known.get(f"stretch_{yarns}") for yarns in ("warp", "weft")],
        "assumed": thickness,
        "assumed_radius": thickness / 2,
        "volume_density": density / thickness,
        "patch_mass": FLEX_AREA * density,
        "flex_young": 2 * FLEX * EQUAL_SIDES * material.one_modulus / thickness**3}
    if "thickness_mm" in known:  # the offsets of two layers are added
        found |= {"thickness": thickness, "radius": thickness / 2}
    if material.stretch:
        found["stretch_mean"] = sum(material.stretch) / 2
    if material.stretch and "thickness_mm" in known:
        found["young"] = found["stretch_mean"] / thickness
    if "shear" in known:
        found["hood_mu"] = known["shear"] / HOOD_THICKNESS
    if material.stretch and "shear" in known:
        found |= _in_plane(*material.stretch, known["shear"], density)
    return found | blender_settings(material) | material.captured


def hinge_quantities(material: Material) -> dict[str, Any]:
    """Those that hold for hinges on the stated mesh alone; InputError if it is too coarse."""
    ratio, thickness = material.ratio, 1e-3 * material.known.get("thickness_mm", ASSUMED_MM)
    modulus, mean = material.modulus * ratio, material.one_modulus * ratio
    kappa = np.maximum(ARCSIM_CURVATURES, 1e-9)
    secants = torque(kappa, material.alpha[:, None], material.beta[:, None]) / kappa * ratio
    bend = modulus[[WARP, WEFT]] / (PPF * material.density)
    # Rows of ARCSim are indexed by the edge's direction in material axes; cloth bends across it.
    return {
        "hinged": modulus.tolist(),
        "style3d": (modulus[[WEFT, WARP, BIAS]] / STYLE3D).tolist(),
        "arcsim_bending": (secants / ARCSIM)[[WEFT, BIAS, WARP]].tolist(),
        "hood_bending": mean / ARCSIM,
        "ppf_bend": float(bend.min()),
        "ppf_warp": float(bend[0] - bend.min()),
        "ppf_weft": float(bend[1] - bend.min()),
        "edge_ke": 2 * mean / (3**0.5 * 1e-3 * material.settings.edge_mm),
        "physx_bending": mean / (PHYSX * thickness**3),
    }


def _in_plane(warp: float, weft: float, shear: float, density: float) -> dict[str, Any]:
    """Of membranes of two stretches and a shear, N/m."""
    law = OrthotropicStVK(warp=warp, weft=weft, poisson=POISSON * (warp / weft) ** 0.5,
                          shear=shear).matrix
    # ARCSim doubles samples to k; its stress is k0 E_uu + k1 E_vv, k1 E_uu + k2 E_vv and k3 E_uv in
    # the Green strain (``dde.cpp``, ``physics.cpp``).
    sample = [law[0, 0] / 2, law[0, 1] / 2, law[1, 1] / 2, law[2, 2]]
    # ppf: Baraff and Witkin's energy for each kg, mu/2 of the yarns' extensions squared, lambda/2
    # of the sine of the shear angle squared (``baraffwitkin.hpp``).
    mu, lam = (warp + weft) / 2 / density, shear / density
    poisson = lam / (2 * (mu + lam))
    return {
        "tri_aniso": [weft, warp, shear],
        "arcsim_stretching": [sample] * ARCSIM_STRETCHING,
        "ppf_model": "baraff-witkin",
        "ppf_addon_model": "BARAFF_WITKIN",
        "ppf_normalized": True,
        "ppf_young": 2 * (1 + poisson) * mu,
        "ppf_poisson": poisson,
    }


def filled(fields: Iterable[Mapping[str, Any]], values: Mapping[str, Any]) -> dict[str, Any]:
    """Values of the fields that have one, in their units and limits."""
    return {row["field"]: _in_unit(values[row["value"]], row) for row in fields
            if values.get(row.get("value", "")) is not None}


def _in_unit(value: Any, row: Mapping[str, Any]) -> Any:
    if (unit := row.get("unit")) in UNITS:
        value = float(f"{UNITS[unit] * value:.12g}")
    if "most" in row:
        value = min(max(value, row.get("least", value)), row["most"])
    return value
