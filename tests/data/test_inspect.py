"""The report on a dataset: figures against the shards, refusals, pictures."""

import json
import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path

import cv2
import fake_drapes
import numpy as np
import pytest
from test_generate import generate, small_config

from common.errors import InputError
from common.files import replace_json
from common.provenance import digest
from data.dataset.folder import MANIFEST, read_manifest
from data.dataset.inspect import (
    as_text,
    check_dataset,
    contact_sheet,
    main,
    prior_samples,
    read_drapes,
    report,
    take_shots,
)
from data.dataset.plan import plan_drape
from data.dataset.shards import Shard
from data.fabrics.fabrics import fabric_from_theta, from_theta
from data.fabrics.prior import TablePrior, load_prior
from data.render.cameras import nominal_camera
from sim.measures import maximum_stretch
from sim.mesh.specimen import TOPOLOGIES
from sim.scene import make_specimen

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    """A dataset, a few of whose drapes failed."""
    folder = tmp_path_factory.mktemp("bare") / "set"
    generate(folder, small_config(drapes=24))
    return folder


@pytest.fixture(scope="module")
def tangled(tmp_path_factory):
    """A dataset in which every drape that starts from folds intersects itself."""
    folder = tmp_path_factory.mktemp("tangled") / "set"
    generate(folder, small_config(drapes=10, seed=1), solver=fake_drapes.tangled)
    return folder


def column(folder, name):
    parts = []
    for path in sorted(folder.glob("shard_*.h5")):
        parts.append(Shard(path).column(name))
    return np.concatenate(parts)


def statistics_of(folder, intersections=100):
    manifest = check_dataset(folder)
    drapes = read_drapes(folder, manifest, intersections=intersections)
    return report(manifest, drapes, prior_samples(manifest)), drapes, manifest


def test_counts_are_those_of_the_shards(bare):
    content, _, manifest = statistics_of(bare)
    status, start = column(bare, "status"), column(bare, "start")
    converged = status == "converged"
    assert 0 < converged.sum() < 24  # else this dataset tests little
    assert content["drapes"] == 24 and content["converged"] == converged.sum()
    assert content["fabrics"] == manifest["fabrics"] == 12
    assert content["fabrics_with_a_drape"] == len(set(column(bare, "fabric")[converged]))
    assert content["rejection_rate"]["dataset"] == pytest.approx(manifest["rejection_rate"])
    failed = np.flatnonzero(~converged)
    assert content["failures"] == [{"status": "max_iterations", "drapes": len(failed),
                                    "first": failed[0], "message": "the fake gave up"}]
    assert {name: row["drapes"] for name, row in content["starts"].items()} == Counter(start)
    assert content["starts"]["fold"]["converged"] == (converged & (start == "fold")).sum()
    folds = Counter(column(bare, "folds")[converged].tolist())
    assert content["folds"] == {str(n): folds[n] for n in sorted(folds)}
    coefficient = column(bare, "drape_coefficient")[converged]
    assert content["drape_coefficient"]["0.5"] == pytest.approx(np.median(coefficient))


def test_parameters_are_those_of_the_fabrics_with_a_drape(bare):
    _, drapes, manifest = statistics_of(bare)
    prior, rate = prior_samples(manifest)
    theta = column(bare, "theta")[column(bare, "status") == "converged"]
    theta = np.unique(theta, axis=0)
    rows = report(manifest, drapes, (prior, rate))["parameters"]
    alpha, _ = from_theta(theta)
    assert rows["alpha_bias"]["unit"] == "µN·m" and rows["beta_over_alpha_weft"]["unit"] == "mm"
    assert rows["alpha_bias"]["dataset"]["0.5"] == pytest.approx(np.median(alpha[:, 1]) * 1e6)
    assert rows["beta_over_alpha_weft"]["dataset"]["1"] == pytest.approx(theta[:, 5].max() * 1e3)
    # The prior is the dataset's own: twelve fabrics of it seldom lie outside of 98 % of it.
    assert max(row["outside"] for row in rows.values()) < 0.4
    shifted = report(manifest, drapes, (prior + 20 * np.eye(6)[1], rate))["parameters"]
    assert shifted["alpha_bias"]["outside"] == 1.0
    assert shifted["alpha_weft"] == rows["alpha_weft"]


def test_strain_is_that_of_the_solvers_mesh(bare):
    _, drapes, _ = statistics_of(bare)
    converged = column(bare, "status") == "converged"
    np.testing.assert_array_equal(np.isfinite(drapes["stretch"]), converged)
    config = small_config()
    for index in np.flatnonzero(converged)[:5].tolist():
        plan = plan_drape(index, config=config.sampling, prior=config.prior)
        settings = {"rig": plan.rig, "edge": config.edge, "offset": tuple(plan.offset)}
        drape = fake_drapes.cone(fabric_from_theta(plan.theta), start=plan.start, seed=plan.seed,
                                 **settings)
        specimen = make_specimen(topology=plan.seed % TOPOLOGIES, **settings)
        exact = maximum_stretch(drape.positions, drape.rest, drape.faces, specimen.held)
        assert exact > 0.02
        assert drapes["stretch"][index] == pytest.approx(exact, abs=1e-3)


def test_self_intersections_are_found_where_somebody_looks(tangled):
    content, drapes, _ = statistics_of(tangled)
    converged = column(tangled, "status") == "converged"
    folded = converged & (column(tangled, "start") == "fold")
    assert 0 < folded.sum() < converged.sum()
    assert content["self_intersections"] == {
        "looked_at": converged.sum(), "intersecting": folded.sum(),
        "drapes": np.flatnonzero(folded).tolist()}
    assert (drapes["crossings"][~converged] == -1).all()
    content, drapes, _ = statistics_of(tangled, intersections=3)
    assert content["self_intersections"]["looked_at"] == 3
    looked_at = np.flatnonzero(drapes["crossings"] >= 0)
    assert {looked_at[0], looked_at[-1]} == set(np.flatnonzero(converged)[[0, -1]])


def test_a_dataset_of_measured_fabrics_is_inspected(tmp_path):
    fabrics = load_prior("gaussian").sample(5, np.random.default_rng(0))
    generate(tmp_path, replace(small_config(drapes=4), prior=TablePrior(fabrics)))
    theta, _ = prior_samples(check_dataset(tmp_path))
    assert (theta[:, None] == fabrics).all(axis=2).any(axis=1).all()


def test_the_contact_sheet_shows_cloth_where_drapes_are(bare):
    _, drapes, _ = statistics_of(bare)
    camera = nominal_camera()
    shots = take_shots(bare, drapes, count=9)
    failed = [shot for shot in shots if shot.failed]
    assert len(shots) == 9 + len(failed) and failed[0].caption.endswith("max_iterations")
    drawn = [int(shot.caption.split(":")[0]) for shot in shots if not shot.failed]
    coefficients = column(bare, "drape_coefficient")[drawn]
    assert (np.diff(coefficients) >= 0).all()
    assert coefficients[[0, -1]] == pytest.approx(
        [np.nanmin(column(bare, "drape_coefficient")),
         np.nanmax(column(bare, "drape_coefficient"))])
    for shot in shots:
        assert 0.05 < (shot.view > 0).mean() < 0.6
        (centre,), (depth,) = camera.project(np.zeros((1, 3)))
        u, v = centre.round().astype(int)
        assert shot.view[v, u] == pytest.approx(depth, abs=2e-3)
    picture = cv2.imdecode(np.frombuffer(contact_sheet(shots), np.uint8), cv2.IMREAD_COLOR)
    assert 0.2 < (picture.min(axis=2) < 200).mean() < 0.6


def test_a_dataset_without_a_drape_has_a_report_too(tmp_path, capsys):
    generate(tmp_path / "set", small_config(drapes=3), solver=fake_drapes.overflowing)
    main([f"data={tmp_path / 'set'}", f"out={tmp_path / 'report'}"])
    content = json.loads((tmp_path / "report" / "report.json").read_text(encoding="utf-8"))
    assert content["converged"] == 0 and content["drape_coefficient"] is None
    assert content["failures"][0]["status"] == "exception"
    assert "FloatingPointError: overflow" in capsys.readouterr().out
    assert not (tmp_path / "report" / "contact_sheet.png").exists()


def test_the_report_knows_neither_folder_nor_machine(bare, tmp_path, capsys):
    before = {path: path.stat().st_mtime_ns for path in bare.iterdir()}
    shutil.copytree(bare, tmp_path / "elsewhere")
    for root, out in ((bare, "a"), (tmp_path / "elsewhere", "b")):
        main([f"data={root}", f"out={tmp_path / out}", "sheet=3", "intersections=2"])
    for name in ("report.json", "contact_sheet.png"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    assert {path: path.stat().st_mtime_ns for path in bare.iterdir()} == before
    content = json.loads((tmp_path / "a" / "report.json").read_text(encoding="utf-8"))
    text = capsys.readouterr().out
    assert as_text(content) in text
    assert "max_iterations" in text


def rewrite(folder, **changes):
    replace_json(folder / MANIFEST, read_manifest(folder) | changes)


def relist(folder):
    """Let the manifest say of its shards what they are."""
    digests = {name: Shard(folder / name).digest for name in read_manifest(folder)["shards"]}
    rewrite(folder, shards=digests, hash=digest(digests))


def flipped(folder):
    content = bytearray((folder / "shard_00001.h5").read_bytes())
    content[len(content) // 2] ^= 1
    (folder / "shard_00001.h5").write_bytes(content)


def copied(number, *, listed=False):
    """The second shard once more as the shard of this number, which the manifest may list."""
    def copy(folder):
        shutil.copy(folder / "shard_00001.h5", folder / f"shard_0000{number}.h5")
        if listed:
            relist(folder)
    return copy


@pytest.mark.parametrize(("spoil", "complaint"), [
    (lambda folder: (folder / "shard_00002.h5").unlink(), r"lacks shard_00002\.h5"),
    (copied(6), r"does not list: shard_00006\.h5"),
    (flipped, r"shard_00001\.h5 is damaged"),
    (copied(2), r"shard_00002\.h5 differ from"),
    (copied(2, listed=True), "differ from those in the shards"),
    (lambda folder: rewrite(folder, drapes=25), "differ from those in the shards"),
    (lambda folder: rewrite(folder, outcomes={"converged": 24}), "outcomes differ"),
    (lambda folder: rewrite(folder, hash="0" * 64), "do not match its content"),
    (lambda folder: rewrite(folder, complete=False), "unfinished"),
])
def test_a_manifest_that_does_not_match_its_shards_is_refused(bare, tmp_path, spoil, complaint):
    folder = tmp_path / "set"
    shutil.copytree(bare, folder)
    spoil(folder)
    with pytest.raises(InputError, match=complaint) as refusal:
        main([f"data={folder}", f"out={tmp_path / 'report'}"])
    assert "\n" not in str(refusal.value)
    assert not (tmp_path / "report").exists()


def test_a_whole_shard_of_another_dataset_is_refused(bare, tangled, tmp_path):
    folder = tmp_path / "set"
    shutil.copytree(bare, folder)
    shutil.copy(tangled / "shard_00001.h5", folder / "shard_00001.h5")
    relist(folder)
    with pytest.raises(InputError, match=r"shard_00001\.h5 differ from dataset\.json"):
        check_dataset(folder)
