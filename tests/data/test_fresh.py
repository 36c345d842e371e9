"""Views rendered for training: what the ray caster sees, and nothing but (seed, epoch, item)."""

from dataclasses import asdict, fields, replace

import cloths
import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from common.errors import InputError
from data.cameras import Camera, CameraRig, Jitter
from data.dataset import DrapeDataset
from data.fabrics import fabric_from_theta
from data.fresh import FreshDataset, Shot, open_views
from data.render import VIEWS, DepthRenderer, render_views
from data.sensor import load_sensor
from data.shards import Shard
from data.view_order import reorder_axis, reorder_views
from sim.mesh.specimens import DEFAULT_EDGES, TOPOLOGIES, default_edge
from sim.scene import Rig

RIG = CameraRig.load()


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return cloths.write_dataset(tmp_path_factory.mktemp("fresh") / "drapes", drapes=20)


@pytest.fixture(scope="module")
def with_views(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fresh") / "views"
    return cloths.write_dataset(folder, drapes=4, orientations=2)


def steps(a, b, tolerance=1e-4):
    """Share of the cloth's pixels whose depths differ by more than ``tolerance``, m."""
    a, b = np.asarray(a), np.asarray(b)
    return (np.abs(a - b) > tolerance).sum() / (b > 0).sum()


def test_the_stored_camera_and_orientation_give_the_stored_picture(with_views):
    dataset = FreshDataset(with_views)
    table = dataset.columns("orientations", "turns", "intrinsics", "world_to_camera")
    picture = RIG.intrinsics
    for drape, (name, row) in enumerate(dataset.places):
        with Shard(with_views / name) as shard:
            positions, _, faces = shard.mesh(row)
            stored = [shard.views(row, k) for k in range(2)]
        caster = DepthRenderer(positions, faces)
        for k in range(2):
            orientations, turns, intrinsics, poses = (column[drape, k] for column in table.values())
            camera = Camera(*intrinsics, picture.width, picture.height, world_to_camera=poses)
            shown = dataset.show([drape], [Shot(camera, orientations, turns)])[0].numpy()
            rays = [caster.view(camera, orientations + turns[view] + view * np.pi / 2)
                    for view in range(VIEWS)]
            assert (shown > 0).sum() > 4000
            assert np.array_equal(shown > 0, np.asarray(rays) > 0)
            assert np.abs(shown - rays).max() < 1e-4
            # Stored pictures show the drape before its vertices were rounded.
            assert steps(shown, stored[k]) < 0.01


def test_a_mirrored_drape_is_the_mirror_image_of_its_views(root):
    """Which makes it an equivalent capture whose warp has the direction that is asked for."""
    dataset = FreshDataset(root)
    camera, psi, turns = RIG.nominal(), 0.7, np.array([0.0, 0.03, -0.02, 0.05])
    assert (camera.cx, RIG.pose.aside, RIG.pose.roll) == ((camera.width - 1) / 2, 0, 0)
    mirrored = dataset.show([3], [Shot(camera, psi, turns, mirror=True)])[0].numpy()
    original = dataset.show([3], [Shot(camera, np.pi - psi, -turns[[0, 3, 2, 1]])])[0].numpy()
    assert steps(mirrored, reorder_views(original, first=0, mirror=True)) < 1e-3
    assert reorder_axis(np.pi - psi, first=0, mirror=True) == pytest.approx(psi)
    plain = dataset.show([3], [Shot(camera, psi, turns)])[0].numpy()
    assert steps(mirrored, plain) > 0.2  # or a wrong mirror would not show


def test_labels_are_the_directions_in_the_pictures(tmp_path):
    still = replace(RIG, jitter=Jitter(**{field.name: 0.0 for field in fields(Jitter)}))
    folder = cloths.write_dataset(tmp_path / "still", drapes=4, rig=still, turn=0.0)
    dataset = FreshDataset(folder, augment=True, orientations_per_epoch=3)
    seen = set()
    for item in range(len(dataset)):
        row = dataset[item]
        name, place = dataset.places[item // 3]
        with Shard(folder / name) as shard:
            positions, _, faces = shard.mesh(place)
        assert row["index"] == place and row["fabric"] == dataset.fabric[item // 3]
        matches = [
            (mirror, half) for mirror in (1.0, -1.0) for half in (0.0, np.pi)
            if steps(row["views"], render_views(positions * [1, mirror, 1], faces, RIG.nominal(),
                                                row["orientation"] + half)) < 0.01]
        assert len(matches) == 1
        seen.add(matches[0])
    assert len(seen) == 4


def test_drapes_of_different_meshes_make_one_batch(tmp_path):
    folder = cloths.write_dataset(tmp_path / "own", drapes=20, edge=0.0, seed=3)
    dataset = FreshDataset(folder)
    sizes, seeds = dataset.columns("edge", "seed").values()
    assert len(set(sizes.tolist())) > 1 and set(sizes.tolist()) <= set(DEFAULT_EDGES)
    kept = {id(faces): faces.numpy().tobytes() for faces in dataset._triangles}
    asked_for = set(zip(sizes.tolist(), (seeds % TOPOLOGIES).tolist(), strict=True))
    assert len(set(kept.values())) == len(kept) == len(asked_for) < 20  # over both shards
    for (name, row), size, theta in zip(dataset.places, sizes, dataset.theta, strict=True):
        assert size == default_edge(fabric_from_theta(theta), Rig())
        with Shard(folder / name) as shard:
            positions, rest, faces = shard.mesh(row)
        assert len(positions) == len(rest) == faces.max() + 1
        # The specimen reaches from edge to edge: no row of the mesh is missing or of zeros.
        np.testing.assert_allclose(np.ptp(rest, axis=0), 0.3, atol=2e-5)
    views = dataset.batch(range(20))["views"]
    for item in range(20):
        assert np.array_equal(views[item], dataset[item]["views"])


def noisy(root, **options):
    return FreshDataset(root, noise=load_sensor("smooth"), augment=True,
                        orientations_per_epoch=2, **options)


@pytest.mark.parametrize("workers", [0, 2])
def test_items_depend_on_seed_epoch_and_drape_only(root, workers):
    dataset, again = noisy(root), noisy(root)
    dataset.set_epoch(3)
    again.set_epoch(3)
    order = np.random.default_rng(0).permutation(len(dataset)).tolist()
    loader = DataLoader(_Batches(again), batch_size=7, sampler=order, num_workers=workers,
                        collate_fn=dict)
    loaded = [(batch, k) for batch in loader for k in range(len(batch["views"]))]
    assert len(loaded) == len(dataset)
    for item, (batch, k) in zip(order, loaded, strict=True):
        for name, value in dataset[item].items():
            assert np.array_equal(batch[name][k].numpy(), value), name


class _Batches(torch.utils.data.Dataset):
    """Lets a loader ask for whole batches."""

    def __init__(self, dataset):
        self.dataset = dataset

    def __len__(self):
        return len(self.dataset)

    def __getitems__(self, items):
        return self.dataset.batch(items)


def test_nothing_is_shown_twice(root):
    dataset = noisy(root)
    first = dataset[5]
    assert first["views"].dtype == np.float32 and first["views"].shape == (4, 180, 240)
    others = [dataset[4], noisy(root, seed=1)[5]]
    dataset.set_epoch(1)
    others.append(dataset[5])
    for other in others:
        assert steps(other["views"], first["views"]) > 0.5
    with pytest.raises(IndexError):
        dataset[len(dataset)]


def test_the_orientations_of_an_epoch_are_spread_over_the_turn(root):
    angles = FreshDataset(root, orientations_per_epoch=4).batch(range(80))["orientation"]
    quarters = torch.floor(angles.view(20, 4) / (np.pi / 2))
    assert quarters.tolist() == [[0, 1, 0, 1]] * 20
    within = angles % (np.pi / 2) / (np.pi / 2)
    assert within.std() == pytest.approx(12**-0.5, rel=0.15)  # uniform


def test_a_camera_rig_survives_its_record():
    assert CameraRig.from_dict(asdict(RIG)) == RIG


def test_views_are_stored_ones_where_there_are_some(root, with_views):
    assert isinstance(open_views(with_views), DrapeDataset)
    assert isinstance(open_views(root), FreshDataset)
    with pytest.raises(InputError, match="views=fresh"):
        DrapeDataset(root)
    with pytest.raises(InputError, match="no dataset"):
        open_views(root / "nowhere")
