"""What the network reads and learns: maps, outlines and pictures of drapes, and targets."""

import shutil
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from cloths import skirt, write_dataset

from common.errors import InputError
from data.dataset.config import DatasetConfig, SamplingConfig
from data.dataset.folder import finished_manifest
from data.dataset.generate import generate_dataset
from data.dataset.shards import MOVED_BY, Shard, to_moves
from data.fabrics.fabrics import ClothProperties
from data.fabrics.nuisances import Nuisances
from data.fabrics.prior import load_prior
from data.render.cameras import Camera, camera_pose, nominal_camera
from data.render.rays import DepthRenderer
from data.render.setups import Setups
from drapenet.network import dataset
from drapenet.network.captures import CaptureSet
from drapenet.network.dataset import make_maps, maps_of_shard, neighbour
from drapenet.network.targets import (
    QUARTER,
    SYMMETRIES,
    TARGETS,
    Symmetry,
    TargetScale,
    cloth_of,
    stiffer_first,
    targets_of,
)
from drapenet.report.drape import resimulate_outline
from drapenet.views.directions import AZIMUTHS
from drapenet.views.located import LocatedViews
from drapenet.views.outline import DrapeOutline, contour, outline_of_curve, silhouettes
from drapenet.views.pictures import SIDE, DepthPictures
from sim.draping import drape, follow
from sim.material import MICRO, SWAPPED, Fabric
from sim.measures import drape_coefficient
from sim.mesh import Mesh
from sim.rig import DISC_RIG, SMALL_DISC_RIG, SQUARE_RIG, Rig
from sim.scene import make_specimen
from sim.sensitivity import sensitivities
from sim.start import LOWERED

SETUPS = replace(Setups.load(), sensors={"none": 1.0})  # costs least
FABRIC = Fabric(np.array([30.0, 20.0, 25.0]) * MICRO, np.array([-60.0, -50.0, -40.0]) * 1e-9)
ANGLE = np.linspace(0, 2 * np.pi, 400, endpoint=False)
RIG = Rig()
CLOTH = skirt(edge=0.012)  # none of its symmetries
QUARTERS = np.arange(4) * np.pi / 2
PROPERTIES = ClothProperties(np.array([[-10.5, -11.0, -11.2, -2e-3, -3e-3, -1e-3]]),
                        np.array([[4.0, -2.0]]), np.array([500.0]), np.array([0.2]))


def part_of(dataset: Path, shards: int) -> dict:
    """The manifest of a dataset's first shards."""
    manifest = finished_manifest(dataset)
    return manifest | {"shards": dict([*manifest["shards"].items()][:shards])}


@pytest.fixture(scope="module")
def files(cloth_dataset, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("maps")
    make_maps(cloth_dataset, part_of(cloth_dataset, 2), out, setups=SETUPS, captures=1, seed=3,
              workers=2)
    return out


def test_files_do_not_depend_on_workers_or_interruptions(files, cloth_dataset):
    folder, = files.iterdir()
    made = sorted(folder.iterdir())
    bytes_of = {file: file.read_bytes() for file in made}
    sorted(folder.glob("*.json"))[1].unlink()
    maps = make_maps(cloth_dataset, part_of(cloth_dataset, 2), files, setups=SETUPS, captures=1,
                     seed=3)
    assert {file: file.read_bytes() for file in sorted(folder.iterdir())} == bytes_of
    assert len(maps) == 16 and not maps.moved.any()
    assert np.isfinite(maps.distance).all() and (maps.weight.max(axis=(1, 2)) > 0).all()


def test_maps_of_an_extended_dataset_are_those_of_all_its_drapes(tmp_path):
    folder = tmp_path / "set"
    for drapes in (6, 8):
        config = DatasetConfig(drapes, SamplingConfig(), load_prior("gaussian"), edge=0.012,
                               drapes_per_shard=4)
        manifest = generate_dataset(config, folder, solver=skirt)
        maps = make_maps(folder, manifest, tmp_path / "maps", setups=SETUPS, captures=1, seed=3)
        assert maps.index.tolist() == list(range(drapes))
    made, = (tmp_path / "maps").iterdir()
    assert len(list(made.glob("*.npz"))) == 3  # those of the first shard once


def test_another_version_makes_maps_again(files, cloth_dataset, tmp_path, monkeypatch, capsys):
    copy = shutil.copytree(files, tmp_path / "maps")
    for version, made in ((dataset.VERSION, False), (-1, True), (-1, False)):
        monkeypatch.setattr(dataset, "VERSION", version)
        make_maps(cloth_dataset, part_of(cloth_dataset, 1), copy, setups=SETUPS, captures=1, seed=3)
        assert ("1 to go" in capsys.readouterr().out) == made


def test_pictures_are_beside_the_maps_where_they_are_asked_for(files, cloth_dataset, tmp_path):
    manifest = part_of(cloth_dataset, 1)
    plain, seen = (make_maps(cloth_dataset, manifest, folder, setups=SETUPS, captures=1, seed=3,
                             pictures=pictures)
                   for folder, pictures in ((files, False), (tmp_path, True)))
    assert plain.pictures.shape[:2] == (8, 0) and seen.pictures.shape == (8, 4, SIDE, SIDE)
    np.testing.assert_array_equal(plain.distance, seen.distance)
    shown = np.isfinite(seen.pictures).mean(axis=(2, 3))
    many = {2: 2, 4: 4, 6: 2, 8: 4}  # others are between quarter turns of the first
    for views, row in zip(seen.views, shown, strict=True):
        assert (row > 0.05).sum() == many.get(views, 1)


def test_maps_of_a_shard_that_is_not_listed_are_refused(cloth_dataset, tmp_path):
    manifest = finished_manifest(cloth_dataset)
    shards = {"shard_00000.h5": manifest["shards"]["shard_00001.h5"]}
    with pytest.raises(InputError, match=r"shard_00000\.h5 differs from dataset\.json") as refusal:
        make_maps(cloth_dataset, manifest | {"shards": shards}, tmp_path, setups=SETUPS,
                  captures=1, seed=3)
    assert "\n" not in str(refusal.value)


def test_captures_of_a_drape_differ(cloth_dataset):
    shard = Shard(next(cloth_dataset.glob("shard_*.h5")))
    maps = maps_of_shard(shard, setups=SETUPS, captures=2, seed=4, neighbours=False, outlines=0)
    assert len(maps) == 2 * len(np.unique(maps.index))
    assert not np.array_equal(maps.distance[0], maps.distance[1])


def test_drapes_of_several_testers_have_depth_captures_and_outlines(tmp_path, monkeypatch):
    rigs = [SQUARE_RIG, SMALL_DISC_RIG]
    folder = write_dataset(tmp_path / "several", drapes=8, seed=2,
                           testers=tuple(rig.name for rig in rigs))
    monkeypatch.setattr(Shard, "moves", lambda shard, row: np.full(
        (7, *shard.mesh(row)[0].shape), 1e-4))
    maps = make_maps(folder, finished_manifest(folder), tmp_path, setups=SETUPS, captures=2,
                     seed=4, neighbours=True, outlines=2)
    sizes = {(rig.specimen_size, rig.plate_diameter / rig.specimen_size) for rig in rigs}
    assert set(zip(maps.size, maps.plate, strict=True)) == sizes and len(maps) == 32
    assert (maps.disc == (maps.size == SMALL_DISC_RIG.specimen_size)).all()
    shadow = maps.views == 0  # outlines only
    assert shadow.sum() == 16 and maps.moved.sum() == 24
    assert sorted(maps.depth[~shadow]) == list(range(16)) and (maps.depth[shadow] == -1).all()
    assert (maps.weight.max(axis=(1, 2)) > 0).all() and np.isfinite(maps.hem).mean() > 0.7
    views = maps.depth_views(np.arange(32), ~shadow)
    assert (views["weight"].max(axis=(1, 2)) > 0).tolist() == (~shadow).tolist()
    assert np.isnan(views["hem"][shadow]).all()
    assert (maps.silhouettes[:, -1] <= maps.silhouettes[:, 0]).all()  # from the lowest camera
    assert len(CaptureSet(maps)) == 8 * 4


def test_moves_are_the_derivatives_of_a_stored_drape():
    """Of a lowered one with hysteresis, against that of cloth with a stiffer bias or membrane."""
    one = drape(FABRIC, edge=6e-3, seed=1, keep=True,
                laws=Nuisances(membrane=300.0, shear=0.5, hysteresis=0.2).laws)
    stored = to_moves(sensitivities(one, parameters=MOVED_BY).positions)
    found = (stored["moves"] * stored["move_units"][:, None]).transpose(1, 0, 2)
    bias = replace(FABRIC, alpha=FABRIC.alpha * [1.0, 1.01, 1.0])
    taut = Nuisances(membrane=301.5, shear=0.5).laws.membrane
    for fabric, laws, predicted in (
        (bias, one.laws,
         found[1] * np.log(1.01) - found[4] * 50e-9 / 20e-6 * (1 / 1.01 - 1)),
        (FABRIC, replace(one.laws, membrane=taut), found[6] * np.log(1.005)),
    ):
        moved = follow(one, fabric, laws=laws).positions - one.positions
        assert np.linalg.norm(predicted - moved) < 0.1 * np.linalg.norm(moved)


def test_neighbours_have_the_fabrics_mean_and_covariance():
    rng = np.random.default_rng(0)
    fabrics = rng.normal(size=(3000, 6)) * [1, 0.8, 1, 1e-3, 1e-3, 1e-3] - 11.0
    steps = np.array([neighbour(theta, fabrics, rng) for theta in fabrics])
    moved = fabrics + steps[:, :6]
    assert moved.mean(axis=0) == pytest.approx(fabrics.mean(axis=0), abs=0.02)
    assert moved.std(axis=0) / fabrics.std(axis=0) == pytest.approx(np.ones(6), abs=0.05)
    assert 0.1 < steps[:, 0].std() / fabrics[:, 0].std() < 0.4


def test_the_radius_of_a_curve_runs_from_azimuth_zero() -> None:
    radius = 0.12 + 0.01 * np.cos(2 * (ANGLE - 0.4))
    curve = radius[:, None] * np.column_stack([np.cos(ANGLE), np.sin(ANGLE)])
    azimuth = (np.arange(AZIMUTHS) + 0.5) * 2 * np.pi / AZIMUTHS
    outline = outline_of_curve(curve, zero=0.4)
    np.testing.assert_allclose(outline.radius, 0.12 + 0.01 * np.cos(2 * azimuth), atol=1e-4)


def test_a_flat_specimen_covers_all_of_its_area() -> None:
    for rig in (DISC_RIG, SQUARE_RIG, Rig((0.17, 0.25), 0.09)):
        x, y = (np.array(rig.sides) / 2)[:, None] / np.maximum(
            np.abs([np.cos(ANGLE), np.sin(ANGLE)]), 1e-12)
        radius = np.full(len(ANGLE), 0.15) if rig.specimen == "disc" else np.minimum(x, y)
        curve = radius[:, None] * np.column_stack([np.cos(ANGLE), np.sin(ANGLE)])
        assert outline_of_curve(curve).coefficient(rig) == pytest.approx(1.0, abs=0.01)


def test_half_an_outline_has_no_drape_coefficient() -> None:
    radius = np.where(np.arange(AZIMUTHS) < AZIMUTHS * 0.45, 0.12, np.nan)
    assert np.isnan(DrapeOutline(radius).coefficient(DISC_RIG))


def test_a_low_hem_looks_smaller_to_a_camera() -> None:
    """A cone whose hem is 50 mm below the plate: 6 mm smaller from 1 m (similar triangles)."""
    mesh = make_specimen(DISC_RIG, edge=8e-3).mesh
    radius = np.linalg.norm(mesh.rest, axis=1)
    slope = 0.05 / radius.max()
    cone = np.column_stack([mesh.rest, -slope * radius])
    parallel, near = silhouettes(cone, mesh.edges, np.array([np.inf, 1.0]), zero=0.0)
    np.testing.assert_allclose(near, parallel / 1.05, rtol=1e-3)
    assert (parallel - near).mean() == pytest.approx(7.1e-3, abs=1e-3)


def test_an_outline_from_above_is_that_of_the_contour(skirted) -> None:
    """From any height down to the lowest, against all edges; also where the hem is tucked under."""
    mesh = Mesh(skirted.rest, skirted.faces)
    heights = np.array([np.inf, 1.0, 0.5, 0.4])
    depth = skirted.positions[:, 2:] / skirted.positions[:, 2].min()
    tucked = skirted.positions * np.where([True, True, False], 1 - 0.5 * depth**3, 1.0)
    for positions in (skirted.positions, tucked):
        edges = contour(positions, mesh, 0.4)
        np.testing.assert_array_equal(*(silhouettes(positions, used, heights, zero=0.2)
                                        for used in (edges, mesh.edges)))
        hem = mesh.edges[mesh.edge_faces[:, 1] < 0]
        assert len(hem) <= len(edges) < 0.4 * len(mesh.edges)
    of_hem = silhouettes(tucked, hem, heights, zero=0.2)
    assert (silhouettes(tucked, edges, heights, zero=0.2) - of_hem).mean() > 2e-3


def test_lowered_cloth_is_shown_beside_a_photograph_whose_perspective_is_corrected() -> None:
    fabric = Fabric(np.array([30, 20, 25]) * MICRO, np.zeros(3))
    seen = drape(fabric, rig=DISC_RIG, edge=9e-3, start=LOWERED, seed=0)
    radius, = silhouettes(seen.positions, seen.mesh.edges, np.array([1.0]), zero=0.3)
    photograph = DrapeOutline(radius, 1.0)
    found = resimulate_outline(fabric, photograph, DISC_RIG, edge=9e-3, drapes=1)
    np.testing.assert_array_equal(found.drape.positions, seen.positions)
    coefficient = drape_coefficient(seen.positions, seen.faces, DISC_RIG)
    assert photograph.coefficient(DISC_RIG) < coefficient - 0.05
    assert photograph.corrected(DISC_RIG).coefficient(DISC_RIG) == pytest.approx(
        coefficient, abs=0.015)
    unknown = DrapeOutline(radius, np.nan)
    assert unknown.corrected(DISC_RIG) is unknown
    assert found.overlap > 0.95 and not found.warnings(coefficient)
    for captured, count in ((found.coefficient + 0.14, 0), (found.coefficient - 0.16, 1),
                            (np.nan, 0)):
        assert [one.code for one in found.warnings(captured)] == ["coefficient_differs"] * count


def pictures(
    positions: np.ndarray = CLOTH.positions, *, warp: float = 0.3, turns: np.ndarray = QUARTERS,
    camera: Camera | None = None, rig: Rig = RIG,
) -> DepthPictures:
    """Of cloth whose azimuth 0 is in the direction ``warp`` in the first view."""
    camera = camera or nominal_camera(rig)
    views = DepthRenderer(positions, CLOTH.faces).views(camera, warp, turns)
    return DepthPictures.of(LocatedViews.exact(views, camera, rig, turns), warp)


def alike(one: np.ndarray, other: np.ndarray) -> float:
    """Share of pixels that are equal within 0.6 mm of 300 mm, or both empty."""
    same = np.isclose(one.astype(float), other.astype(float), atol=2e-3, equal_nan=True)
    return float(same.mean())


def test_depth_is_counted_from_the_plate_in_sizes():
    found = pictures().depth.astype(float)
    assert np.isfinite(found).mean(axis=(1, 2)).min() > 0.15
    assert abs(np.nanmedian(found)) < 0.2 and np.nanmax(np.abs(found)) < 0.6
    border = np.concatenate([found[:, 0], found[:, -1], found[:, :, 0], found[:, :, -1]])
    assert np.isnan(border).all()  # the whole cloth is inside


def test_pictures_do_not_depend_on_the_picture_size_or_the_focal_length():
    there = nominal_camera()
    finer = there.resized(480, 360)
    wider = Camera(0.8 * there.fx, 0.8 * there.fy, there.cx, there.cy, there.width, there.height,
                   there.world_to_camera)
    for camera in (finer, wider):
        assert alike(pictures().depth, pictures(camera=camera).depth) > 0.93
    aside = Camera(there.fx, there.fy, there.cx, there.cy, there.width, there.height, camera_pose(
        distance=0.55, pitch=np.radians(55), above=0.036))
    assert alike(pictures().depth, pictures(camera=aside).depth) < 0.9


def test_pictures_of_a_specimen_of_twice_the_size_are_the_same():
    large = Rig((0.6, 0.6), 0.2)
    found = pictures(2 * CLOTH.positions, rig=large)
    assert alike(pictures().depth, found.depth) > 0.97


@pytest.mark.parametrize("warp", [0.3, 1.9, -2.0])
def test_the_first_picture_has_azimuth_0_nearest_to_the_right(warp):
    """A view further on is the same picture, so that its number does not matter."""
    found, later = (pictures(warp=warp + shift) for shift in (0.0, np.pi / 2))
    assert abs(found.angle) <= np.pi / 4
    assert (warp - found.angle) / (np.pi / 2) == pytest.approx(round(warp / (np.pi / 2)))
    assert later.angle == pytest.approx(found.angle)
    assert alike(found.depth, later.depth) > 0.99


def test_views_between_quarter_turns_are_left_out():
    four = pictures().depth
    eight = pictures(turns=np.arange(8) * np.pi / 4).depth
    np.testing.assert_array_equal(four, eight)
    one = pictures(turns=np.zeros(1), warp=0.3 + np.pi / 2).depth
    np.testing.assert_array_equal(one[1], pictures(warp=0.3 + np.pi / 2).depth[1])
    assert np.isnan(one[[0, 2, 3]]).all()
    three = pictures(turns=np.arange(3) * 2 * np.pi / 3).depth
    assert np.isfinite(three).any(axis=(1, 2)).tolist() == [True, False, False, False]


@pytest.mark.parametrize(("quarters", "mirror"), list(product(range(4), (False, True))))
def test_symmetries_of_pictures_are_those_of_the_specimen(quarters, mirror):
    """As of maps: the specimen is reflected at azimuth 0, then turned from azimuth 0."""
    symmetry = Symmetry(np.array([quarters * QUARTER]), np.array([mirror]))
    seen = pictures()
    found = symmetry.of_pictures(seen.depth[None])[0]
    angle = symmetry.of_angles(np.array([seen.angle])).item()
    turn = np.linalg.matrix_power(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), quarters)
    moved = CLOTH.positions * ([1, -1, 1] if mirror else 1) @ turn.T
    expected = pictures(moved, warp=-0.3 if mirror else 0.3)
    assert angle == pytest.approx(expected.angle)
    assert alike(found, expected.depth) > 0.98
    assert alike(seen.depth, found) < 0.95 or (quarters, mirror) == (0, False)


def test_targets_of_a_fabric_are_undone() -> None:
    size = np.array([0.36])
    back = cloth_of(targets_of(PROPERTIES, size), size)
    for name, part in vars(PROPERTIES).items():
        np.testing.assert_allclose(getattr(back, name), part, rtol=1e-12, err_msg=name)


def test_similar_specimens_have_the_same_targets() -> None:
    """As sim.similarity's tests: lengths times s, alpha times s³, beta times s⁴, membrane times s,
    curvatures divided by s."""
    scale = 1.3
    theta = PROPERTIES.theta + np.array([3 * np.log(scale)] * 3 + [0.0] * 3)
    theta[:, 3:] *= scale
    larger = ClothProperties(theta, PROPERTIES.curl / scale, PROPERTIES.membrane * scale,
                             PROPERTIES.hysteresis)
    np.testing.assert_allclose(targets_of(larger, np.array([scale * 0.3])),
                               targets_of(PROPERTIES, np.array([0.3])), rtol=1e-12)


def test_the_stiffer_yarns_come_first_with_their_curl() -> None:
    targets = targets_of(PROPERTIES, np.array([0.3]))
    swapped = ClothProperties(PROPERTIES.theta[:, SWAPPED], PROPERTIES.curl[:, ::-1],
                              PROPERTIES.membrane, PROPERTIES.hysteresis)
    exchanged = targets_of(swapped, np.array([0.3]))
    np.testing.assert_array_equal(stiffer_first(targets), targets)
    np.testing.assert_array_equal(stiffer_first(exchanged), targets)


def test_symmetries_keep_a_known_warp_on_an_axis() -> None:
    """Two spots on the warp stay there, or lie on the weft where the two are exchanged."""
    rows = np.zeros((1, AZIMUTHS))
    rows[0, [0, AZIMUTHS - 1, AZIMUTHS // 2 - 1, AZIMUTHS // 2]] = 1.0  # cells beside the axis
    for k in range(SYMMETRIES):
        symmetry = Symmetry.number(k, 1)
        quarter = AZIMUTHS // 4 if symmetry.exchanged[0] else 0
        np.testing.assert_array_equal(symmetry.of_rows(rows), np.roll(rows, quarter, 1))
    rng = np.random.default_rng(0)
    for exchanged in (True, False) * 10:
        drawn = Symmetry.draw(known=np.array([True]), disc=np.array([True]),
                              exchanged=np.array([exchanged]), rng=rng)
        assert drawn.exchanged[0] == exchanged
        np.testing.assert_array_equal(drawn.of_rows(rows),
                                      np.roll(rows, AZIMUTHS // 4 * exchanged, 1))


@pytest.mark.parametrize(("disc", "count"), [(False, 4), (True, AZIMUTHS)])
def test_an_unknown_warp_may_be_turned_as_the_specimen_allows(disc: bool, count: int) -> None:
    rng = np.random.default_rng(0)
    drawn = {int(Symmetry.draw(known=np.array([False]), disc=np.array([disc]), rng=rng).cells[0])
             for _ in range(2000)}
    assert len(drawn) == count


def test_the_scale_is_the_same_for_warp_and_weft() -> None:
    targets = np.random.default_rng(0).normal(size=(50, TARGETS)) * np.arange(1, TARGETS + 1)
    scale = TargetScale.fit(targets)
    np.testing.assert_allclose(scale.decode(scale.encode(targets)), targets)
    assert scale.std[0] == scale.std[2] and scale.mean[6] == scale.mean[7]
