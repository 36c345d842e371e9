"""Meshes: topology, grids, graded meshes; meshes of specimens are in `sim.mesh.specimen`."""

from sim.mesh.grid import choose_diagonals, grid_faces, grid_points, strip
from sim.mesh.topology import Mesh, adjacency, edges_of, smooth, vertex_normals

__all__ = ["Mesh", "adjacency", "choose_diagonals", "edges_of", "grid_faces",
           "grid_points", "smooth", "strip", "vertex_normals"]
