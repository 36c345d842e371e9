"""Files for Newton, against the hinge law."""

import runpy
from types import SimpleNamespace

import numpy as np
import pytest
from exported import IN_A_DRAPE, exported
from vectors import angle_between

from drapenet.export.formats import export
from sim.energies.hinges import HingeBending
from sim.material import Fabric
from sim.mesh import strip


def test_newton_s_edges_store_the_energy_of_hinges(material, tmp_path):
    """1/2 ke l theta² of every edge against the hinge law, on a bent strip."""
    module = runpy.run_path(str(export(material, "newton", tmp_path / "n.py")[0]))
    assert np.array(module["MATERIAL"]["edge_aniso_ke"]) * 3 / material.ratio == pytest.approx(
        IN_A_DRAPE[[2, 0, 1]])
    assert module["MATERIAL"]["tri_aniso_ke"] is None
    mesh, _ = strip(length=0.03, width=0.01, edge=2e-3, clamp=0.0, diagonals="random", jitter=0.2)
    inner = np.flatnonzero(mesh.edge_faces.min(axis=1) >= 0)
    apexes = np.array([[(set(mesh.faces[f].tolist()) - set(mesh.edges[e].tolist())).pop()
                        for f in mesh.edge_faces[e]] for e in inner])
    builder = SimpleNamespace(
        particle_q=np.column_stack([mesh.rest, np.zeros(len(mesh.rest))]),
        edge_indices=np.column_stack([apexes, mesh.edges[inner]]),
        edge_bending_properties=[(0.0, 0.0)] * len(inner))
    module["set_bending"](builder)
    bend = 8.0  # 1/m
    x, y = mesh.rest.T
    bent = np.column_stack([np.sin(bend * x) / bend, y, (1 - np.cos(bend * x)) / bend])
    normal = np.cross(*(bent[mesh.faces[:, k]] - bent[mesh.faces[:, 0]] for k in (1, 2)))
    pairs = mesh.edge_faces[inner]
    theta = angle_between(normal[pairs[:, 0]], normal[pairs[:, 1]])
    lengths = np.linalg.norm(np.diff(mesh.rest[mesh.edges[inner]], axis=1)[:, 0], axis=1)
    stiffness = np.array(builder.edge_bending_properties)[:, 0]
    law = HingeBending(mesh, np.ones(len(mesh.faces), bool), directed=True,
                       fabric=Fabric(IN_A_DRAPE * material.ratio))
    unknowns = np.concatenate([bent.ravel(), np.zeros(len(mesh.edges))])
    assert 0.5 * (stiffness * lengths * theta**2).sum() == pytest.approx(
        law.value(unknowns), rel=1e-5)


def test_newton_gets_all_that_is_known(known):
    found = runpy.run_path(str(exported(known, "newton")))["MATERIAL"]
    assert found["tri_aniso_ke"] == [400.0, 900.0, 35.0]  # weft, warp, shear
    assert 2 * found["particle_radius"] == pytest.approx(0.42e-3)
    assert found["soft_contact_mu"] == 0.31
    assert found["about"]["tool_defaults"] == ["edge_kd", "tri_ka", "tri_kd", "tri_ke"]
