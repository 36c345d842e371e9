"""Skirts of samples of an estimate: the picture and the file of shapes."""

import io
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from estimates import estimate_of

import drapenet
from common.errors import InputError
from drapenet.report.garment import preview
from sim.material import MICRO, NANO
from sim.skirt import skirt
from sim.solver.newton import Status

ESTIMATE = estimate_of(np.array([120.0, 90.0, 100.0]) * MICRO, np.full(3, -90 * NANO),
                       deviation=0.1)


def coarse(work, plans):
    """Simulated here, on coarse meshes."""
    return [work(**plan | ({"edge": 25e-3} if work is skirt else {})) for plan in plans]


@pytest.fixture(scope="module")
def garments():
    return preview(ESTIMATE, samples=3, seed=5, run=coarse)


def test_a_seed_gives_the_same_bytes_and_another_seed_other_samples(garments, tmp_path):
    again = preview(ESTIMATE, samples=3, seed=5, run=coarse)
    assert (again.picture, again.shapes) == (garments.picture, garments.shapes)
    stiffness = [fabric.alpha[0] for fabric in garments.fabrics]
    assert stiffness == sorted(stiffness) and not garments.failures
    garments.write(tmp_path)
    assert (tmp_path / "garment.png").read_bytes() == garments.picture
    assert (tmp_path / "garment.glb").read_bytes() == garments.shapes
    other = preview(ESTIMATE, samples=3, seed=6, run=lambda work, plans: coarse(work, plans[:1])
                    if work is skirt else [garments.middle] * len(plans))
    assert set(other.rows) != set(garments.rows)


def test_the_file_has_a_node_of_each_sample_with_its_moduli(garments):
    scene = trimesh.load(io.BytesIO(garments.shapes), file_type="glb")
    nodes = {scene.graph.transforms.edge_data["world", name]["metadata"]["sample"]: name
             for name in scene.graph.nodes_geometry}
    assert nodes == {row: f"sample_{row}" for row in garments.rows}
    alpha, beta = ESTIMATE.moduli()
    for row, found in zip(garments.rows, garments.skirts, strict=True):
        extras = scene.graph.transforms.edge_data["world", nodes[row]]["metadata"]
        assert extras["density_g_m2"] == 210
        for key, unit, values in (("alpha_uN_m", MICRO, alpha), ("beta_nN_m2", NANO, beta)):
            assert list(extras[key]) == ["warp", "bias", "weft"]
            np.testing.assert_allclose([*extras[key].values()], values[row] / unit, rtol=1e-3)
        _, geometry = scene.graph[nodes[row]]
        # glTF's y is up, and origins are apart.
        np.testing.assert_allclose(scene.geometry[geometry].vertices,
                                   found.positions[:, [0, 2, 1]] * [1, 1, -1], atol=1e-6)
    places = {tuple(scene.graph[name][0][:3, 3]) for name in nodes.values()}
    assert len(places) == 3


def test_a_skirt_that_fails_is_a_record(garments):
    first, *others = garments.skirts
    failed = replace(garments, skirts=(first.ended(Status.LINE_SEARCH, "no descent"), *others))
    assert failed.failures == {garments.rows[0]: "no descent"}
    scene = trimesh.load(io.BytesIO(failed.shapes), file_type="glb")
    assert set(scene.graph.nodes_geometry) == {f"sample_{row}" for row in garments.rows[1:]}
    assert failed.picture.startswith(b"\x89PNG") and failed.picture != garments.picture


def test_samples_that_no_cloth_can_have_are_not_shown(garments):
    theta = ESTIMATE.samples.copy()
    theta[7:, 1] -= 3  # a bias this soft belongs to no plate, if warp and weft differ
    theta[7:, 0] += 2
    poor = replace(ESTIMATE, cloth=replace(ESTIMATE.cloth, theta=theta))
    chosen = preview(poor, samples=7, run=lambda work, plans: [garments.middle] * len(plans))
    assert set(chosen.rows) == {*range(7)}
    with pytest.raises(InputError, match=r"7 of the 13 samples .* and 12 are needed; estimate"):
        drapenet.preview(poor)
    lost = garments.middle.ended(Status.LINE_SEARCH, "no descent")
    with pytest.raises(InputError, match=r"no skirt .* converged \(no descent\); give another"):
        preview(ESTIMATE, run=lambda work, plans: [lost])
    with pytest.raises(InputError, match="estimate='twill' is not of the class Estimate"):
        drapenet.preview("twill")
