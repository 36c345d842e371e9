"""Formats of other tools; quantities, units, relations, sources, losses: ``docs/exports.md``.

A tool with one modulus per direction gets the secant of the torque at a curvature, by default the
stiffness in a drape; one whose hinges buckle gets two. What is not known keeps the tool's default.
"""

import json
import pprint
import re
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from common.errors import InputError
from common.files import replace_file
from drapenet.export.blender import at_8_mm, blender_settings, captured_specimen
from drapenet.export.cards import SLIDER, cards
from drapenet.export.material import Material
from drapenet.report.pages import render
from drapenet.result.tables import csv_number, csv_table, interval_columns
from sim.energies.hinges import ARCSIM, mean_modulus
from sim.material import BIAS, DIRECTIONS, WARP, WEFT, torque

CLO = 1e9  # CLO_BENDING per N·m
CLO_STRETCH = 1e3  # CLO_TENSION per N/m
CLO_BENDING, CLO_TENSION, CLO_DENSITY = "g·mm²/s²", "g/s²", "g/mm²"
"""Units of CLO, as files state them."""
MAX_CLO, MAX_CLO_STRETCH = 2e6, 1e7
"""CLO's maxima of bending (g·mm²/s²), and of stretch and shear (g/s²)."""
CLO_DEFAULTS: dict[str, Any] = {
    "fBuLR": 0.8, "fBvLR": 0.8, "fBhLR": 0.8, "fBucklingStiffnessU": 0.8,
    "fBucklingStiffnessV": 0.8, "fBucklingStiffnessH": 0.8, "fSuK": 1e5, "fSvK": 1e5, "fHK": 1e4,
    "fThickness": 0.5, "fFriction": 0.03, "fIDS": 1e-4, "listNonlinearSuK": [],
    "listNonlinearSvK": [], "listNonlinearHK": []}
"""What CLO has by default."""
CLO_UNITS = {**dict.fromkeys(("fBuK", "fBvK", "fBhK"), CLO_BENDING), "fDensity": CLO_DENSITY,
             **dict.fromkeys(("fSuK", "fSvK", "fHK"), CLO_TENSION), "fThickness": "mm"}
CLO_AXES = ("Warp", "Bias", "Weft")
JFAB = {"bendingWarp": "fBvK", "bendingBias": "fBhK", "bendingWeft": "fBuK",
        "bucklingRatioWarp": "fBvLR", "bucklingRatioBias": "fBhLR", "bucklingRatioWeft": "fBuLR",
        "bucklingStiffnessWarp": "fBucklingStiffnessV",
        "bucklingStiffnessBias": "fBucklingStiffnessH",
        "bucklingStiffnessWeft": "fBucklingStiffnessU", "stretchWarp": "fSvK",
        "stretchWeft": "fSuK", "shear": "fHK", "thickness": "fThickness", "friction": "fFriction",
        "density": "fDensity"}
"""Keys of ``mapPhysical``, by the names of CLO's schema of USD: U is the weft."""
BROWZWEAR = 1e7  # dyn·cm per N·m
UNREAL = 1e4  # kg·cm²/s² per N·m
PPF = 1.28e-5  # m²/s²: BEND_SCALE of ppf-contact-solver's energy.cu
STYLE3D = 3.0  # Newton's quadratic hinges: plate of modulus 3 ke
ARCSIM_CURVATURES = np.array([0.0, 10.0, 20.0, 30.0, 40.0])
"""1/m, of ARCSim's table: theta l/(A0 + A1) is twice the number that its columns count in steps of
5/m (``dde.cpp``, ``bending_stiffness``); it is constant beyond the last column."""
CURVE = np.linspace(0.0, 400.0, 81)  # 1/m, of the torque's table


@dataclass(frozen=True)
class Target:
    """An export format.

    Attributes:
        file: usual name.
        lost: what is missing from the file or approximated.
        write: from material and file name to the files' bytes by name, the named file first.
    """

    file: str
    tool: str
    lost: str
    write: Callable[[Material, str], dict[str, bytes]]


def _json(content: object) -> bytes:
    return (json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode()


def _clo_values(material: Material) -> dict[str, float]:
    """What is known of a fabric, by the names of CLO's schema of USD and in CLO's units."""
    buckling, density = material.buckling, 1e-3 * material.density
    values = {f"bending{axis}": bending for axis, bending in zip(
        CLO_AXES, np.minimum(buckling.modulus * CLO, MAX_CLO).tolist(), strict=True)}
    values |= {f"bucklingRatio{axis}": buckling.ratio for axis in CLO_AXES}
    values |= {f"bucklingStiffness{axis}": share for axis, share in zip(
        CLO_AXES, buckling.share.tolist(), strict=True)}
    known = [("stretchWarp", material.stretch and material.stretch[0]),
             ("stretchWeft", material.stretch and material.stretch[1]), ("shear", material.shear)]
    values |= {key: min(value * CLO_STRETCH, MAX_CLO_STRETCH) for key, value in known
               if value is not None}
    values |= {key: value for key, value in (
        ("thickness", material.thickness_mm),
        ("friction", material.friction and min(material.friction, 1.0))) if value is not None}
    return values | {"density": density}


def _jfab(material: Material, name: str) -> dict[str, bytes]:
    known, label = _clo_values(material), material.name
    known = {JFAB[key]: value for key, value in known.items()}
    # A key that is missing would be reset to CLO's default, and the name cleared.
    physical = {"enFabricType": 0, **CLO_DEFAULTS, **known, "qsPhysicalPropertyName": label,
                "qsPhysicalPropertyNameUTF8": label}
    return {name: _json({"qsFabricName": label, "qsFabricNameUTF8": label,
                         "uiFabricVersion": 100, "uiVersion": 100, "mapPhysical": physical,
                         "drapenet": material.about_edges | {
                             "units": {key: CLO_UNITS[key] for key in known if key in CLO_UNITS},
                             "clo_defaults": sorted(set(CLO_DEFAULTS) - set(known))}})}


def _u3m(material: Material, name: str) -> dict[str, bytes]:
    warp, _, weft = (material.modulus * BROWZWEAR).tolist()
    label, moment, measured = material.name, material.written, f"{Path(name).stem}.fab.json"
    weight = round(1e3 * material.density, 6)
    browzwear = {"version": "1.1", "name": label, "mass": repr(weight),
                 "bend": {"length": repr(warp), "width": repr(weft)}}
    browzwear |= {key: repr(value) for key, value in (
        ("thickness", material.thickness_mm), ("friction", material.friction)) if value is not None}
    physics = {"schema": "1.1", "raw_data": None, "custom": {
        "browzwear": browzwear,
        "drapenet": material.about}}
    identity = uuid.UUID(bytes=bytes.fromhex(material.identity[:32]), version=4)
    main = {"schema": "1.1", "custom": None, "material": {
        "id": str(identity), "name": label, "description": "bending from a drape",
        "created": moment, "modified": moment, "front": None, "back": None, "side": None,
        "metadata": None, "physics": {
            "thickness": None, "weight": weight, "devices": {"fab": measured},
            "composition": None, "material_type": None, "construction": None}}}
    return {name: _json(main), measured: _json(physics)}


def _usd(material: Material, name: str) -> dict[str, bytes]:
    def quoted(text: str) -> str:
        return json.dumps(text, ensure_ascii=False)

    label = re.sub(r"^(?=\d)|[^A-Za-z0-9_]", "_", material.name) or "_"
    membrane = {"Stretch": material.stretch and sum(material.stretch) / 2, "Shear": material.shear}
    surface = "".join(
        f"    float physics:surface{key}Stiffness = {value!r} (\n        doc = \"N/m\"\n    )\n"
        for key, value in membrane.items() if value is not None)
    primvars = "".join(
        f"    float[] primvars:clo:{name} = [{value!r}] (\n"
        f"        doc = {quoted(CLO_UNITS.get(JFAB[key], '1'))}\n"
        "        interpolation = \"constant\"\n    )\n"
        for key, value in _clo_values(material).items()
        for name in ((f"{key}Left", f"{key}Right") if key.endswith(("Bias", "shear")) else (key,)))
    return {name: f"""#usda 1.0
(
    defaultPrim = "{label}"
    kilogramsPerUnit = 1
    metersPerUnit = 1
    upAxis = "Z"
)

def Material "{label}" (
    prepend apiSchemas = ["PhysicsSurfaceDeformableMaterialAPI", "CloFabricAPI"]
    customData = {{
        string drapenet = {quoted(json.dumps(material.about_edges, ensure_ascii=False))}
    }}
    displayName = {quoted(material.name)}
)
{{
    float physics:surfaceBendStiffness = {mean_modulus(material.modulus)!r} (
        doc = "N·m"
    )
{surface}{primvars}}}
""".encode()}


def _arcsim(material: Material, name: str) -> dict[str, bytes]:
    alpha, beta = (part * material.ratio for part in (material.alpha, material.beta))
    kappa = np.maximum(ARCSIM_CURVATURES, 1e-9)
    secants = torque(kappa, alpha[:, None], beta[:, None]) / kappa
    rows = secants / ARCSIM  # over the curvature: 4 alpha + 4 beta kappa
    # Rows are indexed by the edge's direction in material axes; cloth bends across the edge.
    return {name: _json({"density": material.density,
                         "bending": rows[[WEFT, BIAS, WARP]].tolist(),
                         "drapenet": material.about_hinges})}


def _ppf(material: Material, name: str) -> dict[str, bytes]:
    warp, _, weft = (material.modulus * material.ratio / (PPF * material.density)).tolist()
    base = min(warp, weft)
    lines = [f"# {line}" for line in json.dumps(material.about_hinges, indent=1).splitlines()]
    lines += ["# bend-warp and bend-weft are added to bend; one of them is 0",
              f"bend = {base!r}", f"bend-warp = {warp - base!r}", f"bend-weft = {weft - base!r}",
              f"shell_density = {material.density!r}"]
    return {name: ("\n".join(lines) + "\n").encode()}


def _script(template: str, content: dict) -> bytes:
    """A module from a ``template`` beside this one, with the ``content`` of its MATERIAL."""
    text = Path(__file__).with_name(template).read_text(encoding="utf-8")
    values = pprint.pformat(content, width=96, sort_dicts=False)
    return text.replace("{MATERIAL}", values).encode()


def _newton(material: Material, name: str) -> dict[str, bytes]:
    modulus = material.modulus * material.ratio
    return {name: _script("newton.txt", {
        "density_kg_m2": material.density, "alpha_N_m": modulus.tolist(),
        "edge_aniso_ke": (modulus[[WEFT, WARP, BIAS]] / STYLE3D).tolist(),
        "tri_aniso_ke": [*material.stretch[::-1], material.shear] if (
            material.stretch and material.shear) else None,
        "about": material.about_hinges})}


def _blender(material: Material, name: str) -> dict[str, bytes]:
    return {name: _script("blender.txt", blender_settings(material) | captured_specimen(material)
                          | {"about": material.about})}


def _neutral(material: Material, name: str) -> dict[str, bytes]:
    return {name: _json({
        "schema": "drapenet-material", "schema_version": 1,
        "directions": list(material.document.names), "alpha_N_m": material.alpha.tolist(),
        "beta_N_m2": material.beta.tolist(), "density_kg_m2": material.density,
        "stretch_N_m": material.stretch, "shear_N_m": material.shear,
        "thickness_mm": material.thickness_mm, "friction": material.friction,
        "drapenet": material.about})}


def cards_of(material: Material) -> list[dict[str, Any]]:
    """The cards of all tools with the values of a material."""
    density, clo, buckling = material.density, _clo_values(material), material.buckling
    stiffness = np.array([clo[f"bending{axis}"] for axis in CLO_AXES])
    columns = {"clo": stiffness, "slider": np.interp(stiffness, *SLIDER[::-1]),
               "buckling": buckling.share, "dyn_cm": material.modulus * BROWZWEAR,
               "unreal": buckling.modulus * UNREAL,
               "unreal_buckling": buckling.modulus * buckling.share * UNREAL}
    values = {f"{column}_{direction}": value for column, row in columns.items()
              for direction, value in zip(DIRECTIONS, row, strict=True)}
    values |= {"kg_per_m2": density, "g_per_m2": 1e3 * density, "g_per_mm2": 1e-3 * density,
               "buckling_ratio": buckling.ratio, "edge_mm": material.settings.edge_mm,
               **at_8_mm(material)}
    values |= {f"clo_{key}": clo[key] for key in ("stretchWarp", "stretchWeft", "shear")
               if key in clo}
    if material.stretch:
        values |= {"stretch_warp": material.stretch[0], "stretch_weft": material.stretch[1]}
    values |= {key: value for key, value in (
        ("shear", material.shear), ("thickness_mm", material.thickness_mm),
        ("friction", material.friction)) if value is not None}
    return cards(values)


def _in_folds(material: Material) -> str:
    """What the one modulus of a tool is."""
    shares = ", ".join(f"{share:.0%}" for share in material.about["modulus_over_alpha"])
    curvature = material.settings.curvature_1_m
    if not curvature:
        return "These are the stiffnesses of nearly flat cloth, α."
    return (f"One modulus is that of cloth bent to a radius of {1e3 / curvature:.3g} mm, {shares} "
            f"of α along {', '.join(material.document.names)}. CLO and Unreal have two: of this "
            "cloth at twice and at two thirds of that radius.")


def _fields(material: Material, name: str) -> dict[str, bytes]:
    return {name: _json({"cards": cards_of(material), "in_folds": _in_folds(material),
                         "drapenet": material.about})}


def _cards(material: Material, name: str) -> dict[str, bytes]:
    return {name: render("cards.html", cards=cards_of(material), name=material.name,
                         curvature=material.settings.curvature_1_m,
                         in_folds=_in_folds(material), about=material.about,
                         moduli=material.document.moduli)}


def _table(material: Material, name: str) -> dict[str, bytes]:
    rows = [{"direction": direction, **interval_columns("alpha_uN_m", moduli.alpha_uN_m),
             **interval_columns("beta_nN_m2", moduli.beta_nN_m2),
             **interval_columns("drape_stiffness_uN_m", moduli.drape_stiffness_uN_m),
             "density_g_m2": csv_number(1e3 * material.density), "fabric": material.name}
            for direction, moduli in material.document.moduli.items()]
    return {name: csv_table(rows).encode()}


def _torque(material: Material, name: str) -> dict[str, bytes]:
    curves = 1e3 * torque(CURVE, material.alpha[:, None], material.beta[:, None])
    columns = ("curvature_1_m", *(f"torque_{axis}_mN" for axis in material.document.names))
    rows = [dict(zip(columns, map(csv_number, row), strict=True))
            for row in np.vstack([CURVE, curves]).T]
    return {name: csv_table(rows).encode()}


TARGETS = {
    "jfab": Target(
        "fabric.jfab", "CLO, Marvelous Designer",
        "β but for two stiffnesses of a hinge; what is not known gets CLO's default; not opened in "
        "CLO",
        _jfab),
    "u3m": Target("fabric.u3m", "Browzwear, U3M 1.1",
                  "bias, β, stretch and shear, whose units no source states; not opened in "
                  "VStitcher", _u3m),
    "usd": Target("fabric.usda", "USD: Unreal (CLO's schema), AOUSD deformables",
                  "β but for two stiffnesses of a hinge; what is not known; the proposal's names "
                  "may change; not opened in Unreal", _usd),
    "arcsim": Target(
        "arcsim.json", "ARCSim",
        "β beyond 40 m⁻¹, and at negative angles, where ARCSim extrapolates the table and cloth of "
        "β < 0 stiffens; add `stretching`, whose scale was not verified, and damping yourself",
        _arcsim),
    "newton": Target("newton_fabric.py", "Newton 1.8",
                     "β; Style3D's own law between the directions; VBD's triangles, which are "
                     "isotropic", _newton),
    "blender": Target("fabric_blender.py", "Blender 4 and 5, a script",
                      "β; differences between warp, bias and weft; tension and shear, with which "
                      "cloth would not fold", _blender),
    "ppf": Target("ppf.toml", "ppf-contact-solver",
                  "β; bias, which is the mean of warp and weft there; stretch and shear", _ppf),
    "json": Target("material.json", "any", "nothing", _neutral),
    "cards": Target("cards.html", "what to type into CLO, VStitcher, Blender, Houdini, Unreal",
                    "β; what is not known of a field is said there", _cards),
    "fields": Target("fields.json", "the cards, as data", "β", _fields),
    "csv": Target("material.csv", "spreadsheets", "origin and warnings; the name is kept", _table),
    "torque": Target("torque.csv", "tools with a curve", "intervals", _torque),
}
ALIASES = {"clo": "jfab", "clo3d": "jfab", "marvelous": "jfab", "marvelousdesigner": "jfab",
           "browzwear": "u3m", "vstitcher": "u3m", "unreal": "usd", "style3d": "newton",
           "vbd": "newton", "houdini": "cards"}


def table() -> str:
    """Name, usual file and tool of each target, and the names of programs, as text."""
    lines = [f"{name:<8}{t.file:<18}{t.tool}" for name, t in TARGETS.items()]
    return "\n".join([*lines, f"also: {_programs()}"])


def _programs() -> str:
    return ", ".join(f"{name} ({target})" for name, target in ALIASES.items())


def names_in(words: str) -> list[str]:
    """Names with commas, in brackets or not."""
    return [word.strip().lower() for word in words.strip("[]").split(",")]


def targets_named(words: str, key: str = "to") -> list[str]:
    """Parse ``words``, the value of ``key``: names of targets with commas, or ``all``."""
    if words == "all":
        return list(TARGETS)
    names = names_in(words)
    for name in names:
        if name not in TARGETS and name not in ALIASES:
            raise InputError(f"{key}={name}: unknown; choose from {', '.join(TARGETS)}, all, or a "
                             f"program: {_programs()}; docs/exports.md says why others are not "
                             "offered")
    return list(dict.fromkeys(ALIASES.get(name, name) for name in names))


def export(material: Material, name: str, out: Path) -> list[Path]:
    """Write a target's file to ``out`` and its further files beside it; their paths."""
    files = {out.with_name(file): data
             for file, data in TARGETS[name].write(material, out.name).items()}
    for file, data in files.items():
        replace_file(file, data)
    return list(files)


def export_all(material: Material, names: Sequence[str], folder: Path) -> list[Path]:
    """Write the targets ``names`` to a folder, under their usual file names."""
    return [path for name in names for path in export(material, name, folder / TARGETS[name].file)]
