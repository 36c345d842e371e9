"""Formats of other tools; quantities, units, relations, sources, losses: ``docs/exports.md``.

A tool with one modulus per direction gets the secant of the torque at a curvature, by default the
stiffness in a drape; one whose hinges buckle gets two. What is not known keeps the tool's default.
"""

import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from common.errors import InputError
from common.files import replace_file
from data.readings.cloth import BROWZWEAR
from drapenet.export.blender import at_8_mm, blender_settings, captured_specimen
from drapenet.export.cards import SLIDER, cards
from drapenet.export.clo import AXES, clo_values, jfab
from drapenet.export.material import Material, as_json, left_to_tool, read_material, script
from drapenet.export.simulators import arcsim, newton, ppf
from drapenet.export.usd import usd
from drapenet.report.pages import render
from drapenet.result.tables import csv_number, csv_table, interval_columns
from sim.material import DIRECTIONS, torque

BROWZWEAR_FIELDS = ("stretch.length", "stretch.width", "shear", "thickness", "friction",
                    "stretch_linearity", "shear_linearity", "hysteresis", "shrink")
"""Of the section of VStitcher in a file of U3M, beside bending and mass."""
UNREAL = 1e4  # kg·cm²/s² per N·m
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


def _u3m(material: Material, name: str) -> dict[str, bytes]:
    warp, _, weft = (material.modulus * BROWZWEAR).tolist()
    label, moment, measured = material.name, material.written, f"{Path(name).stem}.fab.json"
    weight = round(1e3 * material.density, 6)
    browzwear: dict[str, Any] = {"version": "1.1", "name": label, "mass": repr(weight),
                 "bend": {"length": repr(warp), "width": repr(weft)}}
    known = material.known
    given = {key: repr(known[value]) for key, value in (
        ("stretch.length", "stretch_warp"), ("stretch.width", "stretch_weft"), ("shear", "shear"),
        ("thickness", "thickness_mm"), ("friction", "friction")) if value in known}
    for key, value in given.items():
        group, _, side = key.partition(".")
        browzwear[group] = {**browzwear.get(group, {}), side: value} if side else value
    physics = {"schema": "1.1", "raw_data": None, "custom": {
        "browzwear": browzwear,
        "drapenet": material.about | left_to_tool(BROWZWEAR_FIELDS, given)}}
    identity = uuid.UUID(bytes=bytes.fromhex(material.identity[:32]), version=4)
    main = {"schema": "1.1", "custom": None, "material": {
        "id": str(identity), "name": label, "description": "bending from a drape",
        "created": moment, "modified": moment, "front": None, "back": None, "side": None,
        "metadata": None, "physics": {
            "thickness": known.get("thickness_mm"), "weight": weight, "devices": {"fab": measured},
            "composition": None, "material_type": None, "construction": None}}}
    return {name: as_json(main), measured: as_json(physics)}


def _neutral(material: Material, name: str) -> dict[str, bytes]:
    known = material.known
    return {name: as_json({
        "schema": "drapenet-material", "schema_version": 1,
        "directions": list(material.document.names), "alpha_N_m": material.alpha.tolist(),
        "beta_N_m2": material.beta.tolist(), "density_kg_m2": material.density,
        "stretch_N_m": [known.get(f"stretch_{yarns}") for yarns in ("warp", "weft")],
        "shear_N_m": known.get("shear"), "thickness_mm": known.get("thickness_mm"),
        "friction": known.get("friction"),
        "drapenet": material.about})}


def cards_of(material: Material) -> list[dict[str, Any]]:
    """The cards of all tools with the values of a material."""
    density, clo, buckling = material.density, clo_values(material), material.buckling
    stiffness = np.array([clo[f"bending{axis}"] for axis in AXES])
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
    return cards(values | material.known)


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
    return {name: as_json({"cards": cards_of(material), "in_folds": _in_folds(material),
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


def _blender(material: Material, name: str) -> dict[str, bytes]:
    settings = blender_settings(material)
    return {name: script("blender.txt", settings | captured_specimen(material) | {
        "about": material.about | left_to_tool(
            ["self_friction", "self_distance_min"],
            ["self_friction"] * (settings["self_friction"] is not None))})}


TARGETS = {
    "jfab": Target(
        "fabric.jfab", "CLO, Marvelous Designer",
        "β but for two stiffnesses of a hinge; what is not known gets CLO's default; not opened in "
        "CLO",
        jfab),
    "u3m": Target("fabric.u3m", "Browzwear, U3M 1.1",
                  "bias, β, linearity of stretch and shear; not opened in VStitcher", _u3m),
    "usd": Target("fabric.usda", "USD: Unreal (CLO's schema), AOUSD deformables",
                  "β but for two stiffnesses of a hinge; differences of warp and weft in AOUSD's; "
                  "the proposal's names may change; not opened in Unreal", usd),
    "arcsim": Target(
        "arcsim.json", "ARCSim",
        "β beyond 40 m⁻¹, and at negative angles, where ARCSim extrapolates the table and cloth of "
        "β < 0 stiffens; friction and thickness, which are of ARCSim's scene; not run in ARCSim",
        arcsim),
    "newton": Target("newton_fabric.py", "Newton 1.8",
                     "β; Style3D's own law between the directions; VBD's triangles, which are "
                     "isotropic", newton),
    "blender": Target("fabric_blender.py", "Blender 4 and 5, a script",
                      "β; differences between warp, bias and weft; stretch, which shear decides on "
                      "triangles; thickness", _blender),
    "ppf": Target("ppf.toml", "ppf-contact-solver",
                  "β; bias, which is the mean of warp and weft there; the difference of their "
                  "stretch; not run in it", ppf),
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


def export_beside(file: Path, names: Sequence[str]) -> str:
    """Write the targets ``names`` beside an ``estimate.json``; a line with the files' names."""
    written = export_all(read_material(file), names, file.parent)
    return f"exports:  {file.parent}: {', '.join(path.name for path in written)}"


def export_all(material: Material, names: Sequence[str], folder: Path) -> list[Path]:
    """Write the targets ``names`` to a folder, under their usual file names."""
    return [path for name in names for path in export(material, name, folder / TARGETS[name].file)]
