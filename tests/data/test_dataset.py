import pickle

import fake_drapes
import numpy as np
import pytest
import torch
from test_generate import generate, small_config

from common.errors import InputError
from data.dataset import DrapeDataset
from data.sampling import plan_drape
from data.shards import read_manifest, write_manifest
from data.splits import FRACTIONS, split_by_fabric, thin_out
from data.view_order import ORDERS, reorder_axis, reorder_views


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drapes")
    generate(folder, small_config(drapes=24))
    return folder


def noise(views, intrinsics, generator):
    # As far off as the focal length tells, so that wrong intrinsics show.
    error = 1e-5 * intrinsics[0].float() * torch.randn(views.shape, generator=generator)
    return torch.where(views > 0, views + error, 0)


def equal(a, b):
    return all(np.array_equal(a[key], b[key]) for key in a.keys() | b.keys())


def test_items_are_the_stored_drapes(root):
    dataset = DrapeDataset(root)
    config = small_config()
    assert len(dataset) == dataset.drapes == len(dataset.theta)
    for i in range(len(dataset)):
        item = dataset[i]
        plan = plan_drape(item["index"], config=config.sampling, prior=config.prior)
        assert item["views"].shape == (4, 18, 24) and item["views"].dtype == np.float32
        assert item["fabric"] == plan.fabric
        np.testing.assert_allclose(item["theta"], plan.theta, rtol=1e-6)
        assert item["orientation"] == pytest.approx(plan.orientations[0] % np.pi, rel=1e-6)
        np.testing.assert_array_equal(dataset.theta[i], plan.theta)
    with pytest.raises(IndexError):
        dataset[len(dataset)]


def test_only_converged_drapes_and_the_rest_is_counted(root, caplog):
    with caplog.at_level("WARNING"):
        dataset = DrapeDataset(root)
    outcomes = dataset.manifest["outcomes"]
    assert len(dataset) == outcomes["converged"] < 24
    assert dataset.left_out == {"max_iterations": outcomes["max_iterations"]}
    assert f"{outcomes['max_iterations']} drapes left out of 24" in caplog.text
    assert all(dataset[i]["views"].any() for i in range(len(dataset)))


def test_splits_share_no_fabric_and_miss_no_drape(root):
    fractions = {"train": 0.5, "test": 0.5}
    parts = [DrapeDataset(root, split=name, fractions=fractions) for name in fractions]
    fabrics = [set(part.fabric.tolist()) for part in parts]
    assert fabrics[0] and fabrics[1] and not fabrics[0] & fabrics[1]
    indices = sorted(np.concatenate([part.index for part in parts]).tolist())
    assert indices == DrapeDataset(root).index.tolist()


def test_split_is_stable_and_has_its_fractions():
    names = split_by_fabric(np.arange(5000))
    for name, fraction in FRACTIONS.items():
        assert abs((names == name).mean() - fraction) < 0.02
    np.testing.assert_array_equal(split_by_fabric(np.array([7, 3, 7])), names[[7, 3, 7]])
    assert (split_by_fabric(np.arange(5000), seed=1) != names).mean() > 0.2
    with pytest.raises(InputError, match="add up"):
        split_by_fabric(np.arange(3), fractions={"train": 0.5, "test": 0.4})


def test_smaller_training_sets_are_parts_of_larger_ones():
    fabrics = np.repeat(np.random.default_rng(0).permutation(50), 8)
    fabrics = fabrics[np.random.default_rng(1).permutation(400)]
    before = np.zeros(400, dtype=bool)
    for count in (5, 20, 50):
        kept = thin_out(fabrics, count=count)
        assert len(set(fabrics[kept])) == count and kept.sum() == 8 * count
        assert (kept | ~before).all()
        before = kept
    assert kept.all() and thin_out(fabrics).all()
    few = thin_out(fabrics, count=20, drapes_each=3)
    assert (np.unique(fabrics[few], return_counts=True)[1] == 3).all()
    for fabric in set(fabrics[few]):  # its first three
        assert few[np.flatnonzero(fabrics == fabric)].tolist() == [True] * 3 + [False] * 5
    # Not the first fabrics: those of a shard share their drapes.
    assert set(fabrics[thin_out(fabrics, count=5)]) != set(range(5))
    with pytest.raises(InputError, match="fabrics=51"):
        thin_out(fabrics, count=51)


def test_noise_and_augmentation_depend_on_epoch_and_drape_only(root):
    options = {"noise": noise, "augment": True, "orientations_per_epoch": 2}
    dataset, again = DrapeDataset(root, **options), DrapeDataset(root, **options)
    for epoch in (3, 0):
        dataset.set_epoch(epoch)
        again.set_epoch(epoch)
        order = range(len(dataset))
        first = [dataset[i] for i in order]
        second = [again[i] for i in reversed(order)][::-1]
        assert all(equal(a, b) for a, b in zip(first, second, strict=True))
    dataset.set_epoch(1)
    assert not any(np.array_equal(dataset[i]["views"], first[i]["views"]) for i in order)
    other = DrapeDataset(root, seed=1, **options)
    assert not any(np.array_equal(other[i]["views"], first[i]["views"]) for i in order)


def test_an_epoch_visits_different_orientations(root):
    dataset = DrapeDataset(root, orientations_per_epoch=2)
    assert len(dataset) == 2 * dataset.drapes
    assert dataset[0]["index"] == dataset[1]["index"]
    assert not np.array_equal(dataset[0]["views"], dataset[1]["views"])
    with pytest.raises(InputError, match="2 stored"):
        DrapeDataset(root, orientations_per_epoch=3)


def test_augmented_views_are_equivalent_captures(root):
    plain = DrapeDataset(root, orientations_per_epoch=2)
    augmented = DrapeDataset(root, orientations_per_epoch=2, augment=True)
    seen = set()
    for epoch in range(8):
        augmented.set_epoch(epoch)
        for i in range(len(augmented)):
            drape = i // 2
            item = augmented[i]
            matches = []
            for k in range(2):
                views = plain[2 * drape + k]["views"]
                for first, mirror in ORDERS:
                    angle = plain.orientations[drape, k] + plain.turns[drape, k, first]
                    if np.array_equal(item["views"],
                                      reorder_views(views, first=first, mirror=mirror)):
                        axis = reorder_axis(angle, first=first, mirror=mirror)
                        matches.append(axis)
                        seen.add((k, first, mirror))
            assert len(matches) == 1
            assert item["orientation"] == pytest.approx(matches[0], abs=1e-6)
    assert len(seen) == 16


def test_transform_comes_last(root):
    dataset = DrapeDataset(root, noise=noise, transform=lambda views: views[:, ::2, ::2].copy())
    assert dataset[0]["views"].shape == (4, 9, 12)


def test_loader_workers_give_the_same_batches(root):
    dataset = DrapeDataset(root, noise=noise, augment=True)
    dataset[0]  # opens a file before the workers are forked
    alone = list(torch.utils.data.DataLoader(dataset, batch_size=5))
    shared = list(torch.utils.data.DataLoader(dataset, batch_size=5, num_workers=2))
    assert len(alone) == len(shared)
    for a, b in zip(alone, shared, strict=True):
        assert torch.equal(a["views"], b["views"])
        assert torch.equal(a["orientation"], b["orientation"])
    assert alone[0]["views"].dtype == alone[0]["theta"].dtype == torch.float32


def test_pickled_dataset_leaves_open_files_behind(root):
    dataset = DrapeDataset(root)
    item = dataset[0]
    assert equal(pickle.loads(pickle.dumps(dataset))[0], item)


def test_no_dataset_or_an_unfinished_one(root, tmp_path):
    with pytest.raises(InputError, match="no dataset"):
        DrapeDataset(tmp_path)
    write_manifest(tmp_path, read_manifest(root) | {"complete": False})
    with pytest.raises(InputError, match="unfinished"):
        DrapeDataset(tmp_path)
    manifest = read_manifest(root)
    manifest["config"]["sampling"]["orientations"] = 1
    write_manifest(tmp_path, manifest)
    with pytest.raises(InputError, match="contradicts itself"):
        DrapeDataset(tmp_path)
    with pytest.raises(InputError, match="unknown split"):
        DrapeDataset(root, split="training")
    with pytest.raises(InputError, match="seed=-1"):
        DrapeDataset(root, seed=-1)


def test_a_changed_shard_is_refused(tmp_path):
    generate(tmp_path)
    shard = tmp_path / "shard_00000.h5"
    content = bytearray(shard.read_bytes())
    content[len(content) // 2] ^= 1
    shard.write_bytes(content)
    with pytest.raises(InputError, match="damaged"):
        DrapeDataset(tmp_path)
    shard.unlink()
    with pytest.raises(InputError, match="cannot read"):
        DrapeDataset(tmp_path)


def test_a_dataset_of_failures_is_refused(tmp_path):
    generate(tmp_path, small_config(drapes=1), solver=fake_drapes.overflowing)
    with pytest.raises(InputError, match="no converged drape"):
        DrapeDataset(tmp_path)
