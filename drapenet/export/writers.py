"""Containers of files for other tools: JSON, USD, TOML, YAML, XML, Python scripts, CSV and HTML."""

import json
import pprint
import re
import uuid
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
import yaml

from drapenet.export.cards import cards
from drapenet.export.material import Material
from drapenet.export.quantities import EQUAL_SIDES, FLEX_COLUMNS, FLEX_EDGE, FLEX_ROWS
from drapenet.report.pages import render
from drapenet.result.tables import csv_number, csv_table, interval_columns
from sim.material import torque

SCHEMAS = ("PhysicsMaterialAPI", "PhysicsSurfaceDeformableMaterialAPI", "CloFabricAPI")
SQUARE_SCHEMAS = ("PhysicsSurfaceDeformableSimAPI", "PhysicsCollisionAPI", "MaterialBindingAPI")
THICKNESSES = "physics:thicknesses"  # of a mesh, not of a material
PATCH = 0.1  # m, side of the square in a file of USD
FLEX_4 = 0.75  # young over that for 3.12 in MuJoCo 4.0, whose plate is E t³/12
CURVE = np.linspace(0.0, 400.0, 81)  # 1/m, of the torque's table


class File(NamedTuple):
    """What a file has: the ``given`` values by field, ``about`` itself, and a ``frame`` of them;
    ``known`` has None for fields whose quantity is not known; ``under`` is where they are."""

    material: Material
    name: str
    given: dict[str, Any]
    known: dict[str, Any]
    about: dict[str, Any]
    frame: Any
    under: list[str]


def _json(file: File) -> dict[str, bytes]:
    content = _framed(file)
    place = content
    for key in file.under:
        place = place[key]
    place.update(file.given)
    return {file.name: as_json(content | {"drapenet": file.about})}


def _u3m(file: File) -> dict[str, bytes]:
    label, moment = file.material.name, file.material.written
    measured, given = f"{Path(file.name).stem}.fab.json", file.given
    browzwear = {"version": "1.1", "name": label} | nested(
        {key: repr(value) for key, value in given.items()})
    physics = {"schema": "1.1", "raw_data": None,
               "custom": {"browzwear": browzwear, "drapenet": file.about}}
    identity = uuid.UUID(bytes=bytes.fromhex(file.material.identity[:32]), version=4)
    main = {"schema": "1.1", "custom": None, "material": {
        "id": str(identity), "name": label, "description": "bending by DrapeNet",
        "created": moment, "modified": moment, "front": None, "back": None, "side": None,
        "metadata": None, "physics": {
            "thickness": given.get("thickness"), "weight": given["mass"],
            "devices": {"fab": measured}, "composition": None, "material_type": None,
            "construction": None}}}
    return {file.name: as_json(main), measured: as_json(physics)}


def _usd(file: File) -> dict[str, bytes]:
    """A material, in metres and kilograms, and a square of it, whose mesh has the thickness.

    usd-core 26.11 registers neither CLO's schema nor AOUSD's; of the latter it has that on which it
    is based, ``PhysicsMaterialAPI``. Names and units of the others: CLO's as in Unreal's
    ``InterchangeOpenUSDChaosCloth``, AOUSD's as in its proposal ``wp_deformable_physics``.
    """
    label = re.sub(r"^(?=\d)|[^A-Za-z0-9_]", "_", file.material.name) or "_"
    fields, units = dict(file.given), file.about["units"]
    thickness, physics, primvars = fields.pop(THICKNESSES), "", ""
    for key, value in fields.items():
        doc = f" (\n        doc = {_quoted(units[key])}\n"
        if key.startswith("physics:"):
            physics += f"    float {key} = {value!r}{doc}    )\n"
        else:
            primvars += (f"    float[] {key} = [{value!r}]{doc}"
                         "        interpolation = \"constant\"\n    )\n")
    corners = ", ".join(f"({x:g}, {y:g}, 0)" for x, y in PATCH * np.array(
        [[0, 0], [1, 0], [1, 1], [0, 1]]))
    return {file.name: f"""#usda 1.0
(
    defaultPrim = "{label}"
    kilogramsPerUnit = 1
    metersPerUnit = 1
    upAxis = "Z"
)

def Material "{label}" (
    prepend apiSchemas = [{", ".join(map(_quoted, SCHEMAS))}]
    customData = {{
        string drapenet = {_quoted(json.dumps(file.about, ensure_ascii=False))}
    }}
    displayName = {_quoted(file.material.name)}
)
{{
{physics}{primvars}}}

def Mesh "{label}_square" (
    prepend apiSchemas = [{", ".join(map(_quoted, SQUARE_SCHEMAS))}]
)
{{
    point3f[] points = [{corners}]
    int[] faceVertexCounts = [3, 3]
    int[] faceVertexIndices = [0, 1, 2, 0, 2, 3]
    float[] {THICKNESSES} = [{thickness!r}] (
        doc = {_quoted(units[THICKNESSES])}
    )
    uniform token {THICKNESSES}:elementType = "constant"
    rel material:binding:physics = </{label}>
}}
""".encode()}


def _toml(file: File) -> dict[str, bytes]:
    frame = _framed(file)
    lines = [f"[{_quoted(file.material.name)}]"] * bool(frame)
    lines += [f"{key} = {_quoted(value)}" for key, value in (frame | file.given).items()]
    return {file.name: ("\n".join([*lines, "", *_comments(file.about)]) + "\n").encode()}


def _yaml(file: File) -> dict[str, bytes]:
    lines = yaml.safe_dump(file.given, sort_keys=False)
    return {file.name: ("\n".join([lines, *_comments(file.about)]) + "\n").encode()}


def _script(file: File) -> dict[str, bytes]:
    """A module from the template of the frame, with the content of its MATERIAL."""
    text = Path(__file__).with_name(file.frame).read_text(encoding="utf-8")
    values = pprint.pformat(nested(file.known) | {"about": file.about}, width=96, sort_dicts=False)
    return {file.name: text.replace("{MATERIAL}", values).encode()}


def _mujoco(file: File) -> dict[str, bytes]:
    """Models of 3.12 and of 4.0 with a patch, held at a side, of triangles of equal sides, on which
    both bend alike in all directions."""
    j, i = np.divmod(np.arange(FLEX_ROWS * FLEX_COLUMNS), FLEX_COLUMNS)
    points = FLEX_EDGE * np.column_stack([i + 0.5 * (j % 2), 0.75**0.5 * j, 0.0 * j])
    a = np.arange((FLEX_ROWS - 1) * FLEX_COLUMNS).reshape(-1, FLEX_COLUMNS)[:, :-1]
    b, odd = a + FLEX_COLUMNS, np.arange(FLEX_ROWS - 1)[:, None] % 2
    faces = np.concatenate([np.stack([a, a + 1, b + odd], axis=-1),
                            np.stack([a + 1 - odd, b + 1, b], axis=-1)]).reshape(-1, 3)
    friction = file.given.get("contact.friction")
    about = _comments(file.about | {"hinge_over_plate_modulus": EQUAL_SIDES})
    text = Path(__file__).with_name("mujoco.txt").read_text(encoding="utf-8").format_map({
        "about": "\n".join(about).replace("--", "- -"),
        "name": quoteattr(file.material.name),
        "points": " ".join(f"{x:.6g}" for x in points.ravel()),
        "faces": " ".join(map(str, faces.ravel())), "pins": " ".join(map(str, range(FLEX_COLUMNS))),
        "friction": f' friction="{friction!r} 0.005 0.0001"' if friction is not None else "",
        "mass": repr(file.given["mass"]), "radius": repr(file.given["radius"]),
        "thickness": repr(file.given["elasticity.thickness"]),
        "young": "{young}", "version": "{version}"})
    young, second = file.given["elasticity.young"], f"{Path(file.name).stem}_4.xml"
    return {name: text.replace("{young}", repr(value)).replace("{version}", version).encode()
            for name, value, version in ((file.name, young, "3.12"),
                                         (second, FLEX_4 * young, "4.0"))}


def _page(file: File) -> dict[str, bytes]:
    material = file.material
    return {file.name: render(
        "cards.html", cards=cards(material), name=material.name, about=material.about,
        curvature=material.settings.curvature_1_m, in_folds=_in_folds(material),
        moduli=material.document.moduli)}


def _cards(file: File) -> dict[str, bytes]:
    return {file.name: as_json({"cards": cards(file.material),
                                "in_folds": _in_folds(file.material),
                                "drapenet": file.material.about})}


def _table(file: File) -> dict[str, bytes]:
    rows = [{"direction": direction, **interval_columns("alpha_uN_m", moduli.alpha_uN_m),
             **interval_columns("beta_nN_m2", moduli.beta_nN_m2),
             **interval_columns("drape_stiffness_uN_m", moduli.drape_stiffness_uN_m),
             "density_g_m2": csv_number(1e3 * file.material.density), "fabric": file.material.name}
            for direction, moduli in file.material.document.moduli.items()]
    return {file.name: csv_table(rows).encode()}


def _torque(file: File) -> dict[str, bytes]:
    material = file.material
    curves = 1e3 * torque(CURVE, material.alpha[:, None], material.beta[:, None])
    columns = ("curvature_1_m", *(f"torque_{axis}_mN" for axis in material.document.names))
    rows = [dict(zip(columns, map(csv_number, row), strict=True))
            for row in np.vstack([CURVE, curves]).T]
    return {file.name: csv_table(rows).encode()}


WRITERS: dict[str, Callable[[File], dict[str, bytes]]] = {
    "json": _json,
    "u3m": _u3m,
    "usd": _usd,
    "toml": _toml,
    "yaml": _yaml,
    "script": _script,
    "mujoco": _mujoco,
    "page": _page,
    "cards": _cards,
    "table": _table,
    "torque": _torque}
"""The files' bytes by name, the named file first."""


def as_json(content: object) -> bytes:
    """A JSON file."""
    return (json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode()


def nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values by names with dots as dictionaries of dictionaries."""
    found: dict[str, Any] = {}
    for key, value in values.items():
        *groups, last = key.split(".")
        place = found
        for group in groups:
            place = place.setdefault(group, {})
        place[last] = value
    return found


def _framed(file: File) -> dict[str, Any]:
    """The frame, with the fabric's name."""
    return json.loads(json.dumps(file.frame or {}).replace('"NAME"', _quoted(file.material.name)))


def _comments(about: Mapping[str, Any]) -> list[str]:
    return [f"# {line}" for line in json.dumps(about, indent=1).splitlines()]


def _quoted(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)


def _in_folds(material: Material) -> str:
    """What the one modulus of a tool is."""
    shares = ", ".join(f"{share:.0%}" for share in material.about["modulus_over_alpha"])
    curvature = material.settings.curvature_1_m
    if not curvature:
        return "These are the stiffnesses of nearly flat cloth, α."
    return (f"One modulus is that of cloth bent to a radius of {1e3 / curvature:.3g} mm, {shares} "
            f"of α along {', '.join(material.document.names)}. CLO and Unreal have two: of this "
            "cloth at twice and at two thirds of that radius.")
