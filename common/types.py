"""Types of arrays and numbers that name their shape and unit, once for the whole project.

A signature with one of these types needs no shape or unit in its docstring (``make lint``), and is
checked while the tests run (``tests/shapes.py``). A letter stands for one number in all arguments
and the result of a call, ``any`` for any number: N points, V vertices, F triangles, E edges, K
views of H rows and W columns. ``float`` is float32 in files and pictures, float64 in simulations;
SI units.
"""

from typing import Annotated

import numpy as np

Points = Annotated[np.ndarray, "(N, 3) float, m"]
RestPoints = Annotated[np.ndarray, "(V, 2) float, m, coordinates in the flat specimen"]
Faces = Annotated[np.ndarray, "(F, 3) int, vertices of triangles"]
Edges = Annotated[np.ndarray, "(E, 2) int, vertices of edges"]
Views = Annotated[np.ndarray, "(K, H, W) float, z-depth, m, background 0"]
DepthImage = Annotated[np.ndarray, "(H, W) float, z-depth, m, background 0"]
LinearLight = Annotated[np.ndarray, "(H, W, 3) float32, light of red, green, blue, 0 to 1"]
ColourPicture = Annotated[np.ndarray, "(H, W, 3) uint8, as encoded"]
GreyPicture = Annotated[np.ndarray, "(H, W) float32, as encoded, 0 to 255"]
Mask = Annotated[np.ndarray, "(H, W) bool"]
Masks = Annotated[np.ndarray, "(K, H, W) bool"]
GreyViews = Annotated[np.ndarray, "(K, H, W) uint8 grey"]
Pixels = Annotated[np.ndarray, "(N, 2), column and row, pixels"]
Outline = Annotated[np.ndarray, "(any, 2), closed curve seen from above, m"]
PixelPath = Annotated[np.ndarray, "(any, 2), column and row along a curve, pixels"]
Vector = Annotated[np.ndarray, "(3,), m or unit length"]
Pose = Annotated[np.ndarray, "(4, 4), maps points of the rig to the camera, m"]
Turns = Annotated[np.ndarray, "(K,) rad, of the table in each view, right-handed about its axis"]
Moduli = Annotated[np.ndarray, "(3,) N·m, linear moduli alpha of warp, bias, weft"]
QuadraticModuli = Annotated[np.ndarray, "(3,) N·m², quadratic moduli beta of warp, bias, weft"]
ModuliOfMany = Annotated[np.ndarray, "(..., 3) N·m, linear moduli of any number of fabrics"]
QuadraticModuliOfMany = Annotated[np.ndarray, "(..., 3) N·m², quadratic moduli of as many"]
Theta = Annotated[
    np.ndarray, "(..., 6) log alpha (N·m), beta/alpha (m) of warp, bias, weft at 300 g/m²"]
VertexMask = Annotated[np.ndarray, "(V,) bool"]
FaceMask = Annotated[np.ndarray, "(F,) bool"]
StateVector = Annotated[np.ndarray, "(3 V + 3 E,) positions, m, then unit normals of the edges"]
Curvatures = Annotated[np.ndarray, "(N, 3) shape operators Sxx, Syy, Sxy of triangles, 1/m"]
DeflectionCurve = Annotated[np.ndarray, "(any, 2) reach and drop of a strip from its clamp, m"]
Metres = Annotated[float, "m"]
Radians = Annotated[float, "rad"]
Density = Annotated[float, "kg/m²"]
