"""A material of USD with CLO's schema, which Unreal imports, and AOUSD's of deformable surfaces.

usd-core 26.11 registers neither; of the latter it has the schema on which it is based,
``PhysicsMaterialAPI``, with friction and density. Names and units of the others: CLO's as in
Unreal's ``InterchangeOpenUSDChaosCloth``, AOUSD's as its proposal ``wp_deformable_physics`` states
them, where stretch and shear are force over distance, bending force times distance.
"""

import json
import re

from drapenet.export.clo import UNITS, clo_values
from drapenet.export.material import Material, left_to_tool

SCHEMAS = ("PhysicsMaterialAPI", "PhysicsSurfaceDeformableMaterialAPI", "CloFabricAPI")
CLO = ("stretchWarp", "stretchWeft", "shear", "thickness", "friction", "internalDamping",
       "shrinkage")
"""Names of CLO's schema that may not be known."""
SURFACE = ("physics:surfaceStretchStiffness", "physics:surfaceShearStiffness",
           "physics:surfaceThickness", "physics:density", "physics:staticFriction",
           "physics:dynamicFriction")
"""The same of the deformables'."""
ASSUMED_MM = 1.0
"""Thickness where none is known: the weight is density times thickness, and tools that read no
thickness of a material take the proposal's, which is this."""


def usd(material: Material, name: str) -> dict[str, bytes]:
    """The file of a fabric, in metres and kilograms."""
    label = re.sub(r"^(?=\d)|[^A-Za-z0-9_]", "_", material.name) or "_"
    values, surface = clo_values(material), _surface(material)
    about = material.about_edges | left_to_tool(
        [*(f"primvars:clo:{key}" for key in CLO), *SURFACE],
        [*(f"primvars:clo:{key}" for key in values), *surface])
    if "thickness_mm" not in material.known:
        about["thickness_assumed_mm"] = ASSUMED_MM
    physics = "".join(f"    float {key} = {value!r} (\n        doc = {_quoted(unit)}\n    )\n"
                      for key, (value, unit) in surface.items())
    primvars = "".join(
        f"    float[] primvars:clo:{side} = [{value!r}] (\n"
        f"        doc = {_quoted(UNITS.get(key, '1'))}\n"
        "        interpolation = \"constant\"\n    )\n"
        for key, value in values.items()
        for side in ((f"{key}Left", f"{key}Right") if key.endswith(("Bias", "shear")) else (key,)))
    return {name: f"""#usda 1.0
(
    defaultPrim = "{label}"
    kilogramsPerUnit = 1
    metersPerUnit = 1
    upAxis = "Z"
)

def Material "{label}" (
    prepend apiSchemas = [{", ".join(map(_quoted, SCHEMAS))}]
    customData = {{
        string drapenet = {_quoted(json.dumps(about, ensure_ascii=False))}
    }}
    displayName = {_quoted(material.name)}
)
{{
{physics}{primvars}}}
""".encode()}


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _surface(material: Material) -> dict[str, tuple[float, str]]:
    """Values of a deformable surface and their units, by attribute."""
    known = material.known
    values = {"physics:surfaceBendStiffness": (material.one_modulus, "N·m")}
    if material.stretch:
        values["physics:surfaceStretchStiffness"] = sum(material.stretch) / 2, "N/m"
    if "shear" in known:
        values["physics:surfaceShearStiffness"] = known["shear"], "N/m"
    thickness = 1e-3 * known.get("thickness_mm", ASSUMED_MM)
    values |= {"physics:surfaceThickness": (thickness, "m"),
               "physics:density": (material.density / thickness, "kg/m³")}
    if "friction" in known:
        values["physics:staticFriction"] = known["friction"], "1"
    return values
