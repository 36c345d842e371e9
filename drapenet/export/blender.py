"""Settings of Blender's cloth for a fabric.

Blender multiplies gravity by 1/1000 and no other force, so that a physical drape needs masses a
thousand times those of the cloth, or stiffnesses of a thousandth. An angular spring at an edge
of length l turns the triangle beside it by a force of 0.1 k l a radian, k its stiffness, shared by
the three corners (``SIM_mass_spring.cc``, ``implicit_blender.cc``), which on triangles of equal
sides is a plate of modulus 28.9 k A / 1000, A being the area for each vertex. On triangles of 8 mm,
whose springs of tension must be weak for them to fold, drapes of 300 g/m² are softer: with 20 in
its place discs are too limp, with 16 squares too stiff (docs/validation/blender.json).

Triangles have springs along their edges alone, of the constant tension over mean edge. On triangles
of equal sides they are a sheet of shear stiffness sqrt(3)/4 and stretch stiffness 2/sqrt(3) of that
constant: it can have the shear of a fabric or its stretch. A drape needs the shear.
"""

from typing import Any

from drapenet.export.material import Material
from sim.rig import DISC_RIG, Rig

MASS = 1000.0
"""Blender's mass over the cloth's."""
PLATE = 18.0
"""Modulus of the plate over stiffness and area for each vertex, times MASS."""
TENSION = 2.0
"""Of fabrics of unknown shear: drapes on triangles of 8 mm fold, as with 108 N/m."""
LATTICE = 4 / 3**0.5
"""Tension over mean edge and shear stiffness."""
FRICTION, MAX_FRICTION = 100.0, 80.0
"""Blender's friction of cloth on itself over the coefficient (``collision.cc``), and its limit."""
QUALITY = 15
EDGE = 0.008
VERTEX = EDGE**2 * 3**0.5 / 2
"""Edge, m, of the triangles that cards are for, and area for each vertex, m²."""


def blender_settings(material: Material) -> dict[str, Any]:
    """Settings of a mesh of triangles; mass of a vertex and bending stiffness depend on its area,
    the tension of cloth of known shear on its edges; what is not known is None.
    """
    known = material.known
    return {"mass_over_area": MASS * material.density,
            "bending_times_area": MASS * material.one_modulus / PLATE,
            "tension": None if "shear" in known else TENSION,
            "tension_over_edge": LATTICE * known["shear"] if "shear" in known else None,
            "self_friction": min(FRICTION * known["friction"], MAX_FRICTION)
            if "friction" in known else None, "quality": QUALITY}


def captured_specimen(material: Material) -> dict[str, Any]:
    """Specimen and plate of the drape test, m, and the captured drape coefficient, % or None.

    They are those of the first capture over a plate, or else of the common disc."""
    document = material.document
    shown = [part.capture for part in document.captures or []] or [document.capture]
    captured = [(rig, one.drape_coefficient_percent) for one in shown
                for name in one.rig.split(", ") if name
                and (rig := Rig.from_name(name)).has_plate]
    rig, percent = captured[0] if captured else (DISC_RIG, None)
    return {"tester": rig.name, "specimen_m": list(rig.sides)[:1 if rig.specimen == "disc" else 2],
            "plate_m": rig.plate_diameter,
            "captured_percent": percent}


def at_8_mm(material: Material) -> dict[str, float]:
    """What to type for a mesh of triangles of 8 mm, by quantity of ``cards.yaml``."""
    settings = blender_settings(material)
    typed = {"blender_mass": settings["mass_over_area"] * VERTEX,
             "blender_bending": settings["bending_times_area"] / VERTEX,
             "blender_tension": settings["tension"] or settings["tension_over_edge"] * EDGE,
             "blender_quality": QUALITY}
    friction = settings["self_friction"]
    return typed if friction is None else typed | {"blender_friction": friction}
