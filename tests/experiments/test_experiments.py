"""The runner, its cases, and comparisons of drapes on several meshes."""

import json
import subprocess
import sys
from dataclasses import fields
from importlib import import_module

import numpy as np
import pytest

from common.command import compose_config, schema_of
from common.configs import group_options
from common.errors import InputError
from experiments.__main__ import main, module_of, usage
from experiments.comparison import Shape, compare, equilibrium_near
from experiments.estimation import numbers, refine_views
from experiments.page import ORDER, PAGE, page_text
from experiments.papers import views
from experiments.result import (
    EXECUTION_KEYS,
    FILES,
    FOLDERS,
    REPORTS,
    ROOT,
    Result,
    read_report,
    table,
)
from sim.draping import drape
from sim.material import Fabric
from sim.rig import Rig
from sim.scene import make_specimen


def test_places_that_cannot_be_written_to_are_refused_before_the_work(tmp_path):
    (tmp_path / "file").touch()
    for words in (["convergence", "out=/proc/report.json"], ["convergence", f"out={tmp_path}"],
                  ["views", f"out={tmp_path}/file/report.json"],
                  ["views", f"cases={tmp_path}/file"], ["hard", "cases=/proc/runs"]):
        with pytest.raises(InputError, match="cannot write"):
            main(words)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("module", [numbers, views])
def test_the_reports_of_the_documentation_stay_unless_they_are_named(tmp_path, monkeypatch, module):
    name = module.__name__.split(".")[-1]
    report = read_report(name)
    before = [file.read_bytes() for file in (REPORTS / f"{name}.json", PAGE)]
    monkeypatch.setattr(module, "run", lambda config: Result(report | {"settings": 1}))
    monkeypatch.chdir(tmp_path)
    main([name])
    written = json.loads((tmp_path / f"outputs/experiments/{name}.json").read_text("utf-8"))
    assert written["settings"] == 1
    assert before == [file.read_bytes() for file in (REPORTS / f"{name}.json", PAGE)]


def test_every_experiment_has_a_folder_keys_and_a_line():
    assert set(FILES) == set(group_options("experiment"))
    assert {file.parent.name for file in FILES.values()} == set(FOLDERS)
    lines = usage().splitlines()
    for name, file in FILES.items():
        assert callable(import_module(f"experiments.{file.parent.name}.{name}").run)
        keys = {field.name for field in fields(schema_of(f"experiment/{name}"))}
        assert "out" in keys
        assert not any(group_options(key) for key in keys), "Hydra takes it for a group"
        (line,) = (line for line in lines if line.split()[:1] == [name])
        assert line.endswith(".") and len(line) <= 120


def test_the_page_is_generated_from_the_stored_reports():
    reports = {name: read_report(name) for name in ORDER}
    sections = {name: module_of(name).SECTION for name in ORDER}
    assert PAGE.read_text(encoding="utf-8") == page_text(sections, reports)
    for name in ORDER:
        keys = {field.name for field in fields(schema_of(f"experiment/{name}"))}
        assert keys - {*EXECUTION_KEYS} <= set(reports[name]["settings"]) <= keys
        assert (REPORTS / f"{name}.png").is_file()


@pytest.mark.slow
def test_an_experiment_resumes_and_leaves_the_page_unchanged_with_another_output(tmp_path, capsys):
    before = PAGE.read_bytes()
    words = ["views", "fabrics=1", "captures=1", "edge_mm=8", "workers=1",
             f"cases={tmp_path / 'cases'}", f"out={tmp_path / 'views.json'}"]
    main(words)
    first = json.loads((tmp_path / "views.json").read_text(encoding="utf-8"))
    capsys.readouterr()
    main(words)
    assert "to go" not in capsys.readouterr().out
    again = json.loads((tmp_path / "views.json").read_text(encoding="utf-8"))
    assert again["views"] == first["views"] and PAGE.read_bytes() == before


@pytest.mark.parametrize(("words", "complaint"), [
    (["elastika"], "elastica"), (["numbers", "pixel=1"], "pixel=1"),
    (["elastica", "gammas=many"], "gammas"), (["meshes", "fabrics=[silk]"], "silk"),
    (["views", "workers=0", "cases=/tmp/none"], "workers=0"),
    (["laboratory", "fabrics=nowhere.csv"], "nowhere"),
    (["page", "out=a"], "out=a"),
])
def test_invalid_words_are_reported_in_one_line(words, complaint):
    with pytest.raises(InputError, match=complaint) as refusal:
        main(words)
    assert "\n" not in str(refusal.value)


def test_views_are_studied_with_the_captures_that_are_read(monkeypatch):
    def fabric(error, read):
        return {str(count): {"refused": 5, "error": np.full((n, 6), error).tolist(),
                             "deviation": np.ones((n, 6)).tolist(), "rank": [[0.5] * 6] * n}
                for count, n in zip(views.VIEWS, read, strict=True)}

    found = {"soft": fabric(1.0, [2] * 6), "stiff": fabric(3.0, [2, 1, 0, 0, 0, 0])}
    monkeypatch.setattr(views, "run_fabrics", lambda case, config: found)
    report = views.run({}).report
    assert [one["captures"] for one in report["views"].values()] == [4, 3, 2, 2, 2, 2]
    assert report["views"]["2"]["log_alpha"] == pytest.approx(np.sqrt(11 / 3))
    assert report["views"]["3"]["log_alpha"] == 1.0 and report["refused"]["1"] == 10


def test_keys_that_are_null_may_be_numbers():
    name = "experiment/speed"
    words = ["edges_mm=[3,null]", "drapes=2"]
    assert compose_config(name, words, schema=schema_of(name)).edges_mm == [3.0, None]
    name = "experiment/convergence"
    given, default = (compose_config(name, words, schema=schema_of(name)).edge_mm
                      for words in (["edge_mm=3"], []))
    assert (given, default) == (3.0, None)


def test_the_command_lists_the_experiments_and_shows_keys(capsys):
    listed = subprocess.run([sys.executable, "-m", "experiments"], cwd=ROOT, capture_output=True,
                            text=True, check=True).stdout
    assert listed.startswith("Run an experiment.")
    main(["numbers", "--help"])
    shown = capsys.readouterr().out
    assert shown.startswith(numbers.__doc__.splitlines()[0]) and "\nfabrics: experiments" in shown


def test_table_is_aligned():
    lines = table(["name", "x"], [["long name", 1.23456], ["b", 7]]).splitlines()
    assert lines[2] == "| long name | 1.23 |"
    assert len({len(line) for line in lines}) == 1


@pytest.fixture(scope="module")
def draped():
    return drape(Fabric(np.full(3, 40e-6)), edge=8e-3, seed=2)


def test_cloth_placed_on_its_own_mesh_stays_and_on_another_one_nearly(draped):
    for edge, low, high in ((8e-3, 0.0, 1e-6), (6e-3, 1e-4, 5e-3)):
        specimen = make_specimen(Rig(), edge=edge, topology=2)
        found = equilibrium_near(draped, specimen, Rig(), draped.fabric)
        shape = Shape.of(specimen, found.state.positions)
        assert found.converged
        assert low <= compare(draped, shape).displacement < high


def test_posteriors_are_judged_by_errors_and_coverage():
    rng = np.random.default_rng(0)
    scale = np.array([0.1] * 3 + [1e-3] * 3)
    middle = rng.standard_normal((400, 6)) * scale
    truth = middle + rng.standard_normal((400, 6)) * scale
    samples = [one + rng.standard_normal((2000, 6)) * scale for one in middle]
    found = refine_views.posterior_errors(truth, samples)
    assert found["log_alpha"] == pytest.approx(0.1, rel=0.07)
    assert found["beta_over_alpha_mm"] == pytest.approx(1.0, rel=0.07)
    assert found["log_alpha_median"] == pytest.approx(0.0674, rel=0.1)
    assert list(found["inside"].values()) == pytest.approx([0.50, 0.68, 0.90], abs=0.03)


def test_drapes_of_three_meshes_are_compared(tmp_path):
    reports = []
    for edge in (8, 4):
        out = tmp_path / f"meshes_{edge}.json"
        main(["meshes", "fabrics=[stiff]", f"edge_mm={edge}", "start_mm=4",
              f"cases={tmp_path / str(edge)}", f"out={out}"])
        reports.append(json.loads(out.read_text(encoding="utf-8")))
    coarse, fine = reports
    assert fine["pairs"] == 3 and fine["largest_mean_mm"] > 0
    assert fine["passed"] is (fine["same_folds"] > 0 and fine["largest_mean_mm"] < 0.7)
    # The coarser the mesh, the more the drape depends on it.
    assert (max(row["mean_mm"] for row in coarse["meshes"])
            > max(row["mean_mm"] for row in fine["meshes"]))
