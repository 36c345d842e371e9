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

MASS = 1000.0
"""Blender's mass over the cloth's."""
PLATE = 18.0
"""Modulus of the plate over stiffness and area for each vertex, times MASS."""
TENSION = 2.0
"""The least, with which drapes on triangles of 8 mm fold, as with a shear of 108 N/m. Softer
springs, which cloth of less shear would have, stretch: 58 % for 65, where its law has 69."""
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
    the tension of cloth of a large shear on its edges; friction is None if not known. Those that
    begin with ``blender`` are for triangles of 8 mm.
    """
    known, mass = material.known, MASS * material.density
    bending, over_edge = MASS * material.one_modulus / PLATE, LATTICE * known.get("shear", 0.0)
    return {"mass_over_area": mass, "blender_mass": mass * VERTEX,
            "bending_times_area": bending, "blender_bending": bending / VERTEX,
            "tension": TENSION, "tension_over_edge": over_edge,
            "blender_tension": max(TENSION, over_edge * EDGE),
            "self_friction": min(FRICTION * known["friction"], MAX_FRICTION)
            if "friction" in known else None, "blender_quality": QUALITY}
