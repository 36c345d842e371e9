"""What the benchmarks share: resumed work, and the search for a scan's modulus."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks import (
    batched,
    common,
    default_mesh,
    information,
    meshes,
    perturbed,
    refine_views,
    report,
)
from benchmarks.common import load_arrays, run_cases, table
from benchmarks.scans import DEFAULTS, Search, rounded, turn_cloth
from common.errors import InputError
from drapenet.comparison import compare
from sim.cloth import Cloth
from sim.drape import drape
from sim.material import Fabric
from sim.mesh.specimens import make_specimen
from sim.newton import NewtonOptions
from sim.scene import Rig


def count_calls(log: str, value: float) -> dict:
    """A case's work that leaves a trace of having been done."""
    with Path(log).open("a", encoding="utf-8") as file:
        file.write(f"{value}\n")
    return {"square": value**2, "arrays": {"row": np.arange(value)}}


def test_finished_cases_are_not_done_again(tmp_path, monkeypatch):
    log = tmp_path / "log"
    cases = {f"case{k}": {"log": str(log), "value": k} for k in (3, 2)}

    def run() -> dict:
        return run_cases(count_calls, cases, folder=tmp_path / "cases", workers=1)

    assert run() == {"case3": {"square": 9}, "case2": {"square": 4}}
    assert run() == {"case3": {"square": 9}, "case2": {"square": 4}}
    assert sorted(log.read_text().split()) == ["2", "3"]
    assert load_arrays(tmp_path / "cases", "case3")["row"].tolist() == [0, 1, 2]
    cases["case2"]["value"] = 5  # other settings under the same name
    (tmp_path / "cases" / "case3.json").write_text("{torn")
    assert run() == {"case3": {"square": 9}, "case2": {"square": 25}}
    assert sorted(log.read_text().split()) == ["2", "3", "3", "5"]
    monkeypatch.setattr(common, "sources_digest", lambda *_: "another simulator")
    run()
    assert len(log.read_text().split()) == 6


def test_no_workers_are_refused(tmp_path):
    with pytest.raises(InputError, match="workers=0"):
        run_cases(count_calls, {"a": {"log": "", "value": 1}}, folder=tmp_path, workers=0)


def test_places_that_cannot_be_written_to_are_told_before_the_work(tmp_path):
    (tmp_path / "file").touch()
    free = str(tmp_path / "new" / "report.json")
    defaults = {"count": 1, "cases": str(tmp_path / "cases"), "work": "", "out": free}
    assert common.parse_settings(defaults, ["count=2"]) == defaults | {"count": 2}
    for word in ("out=/proc/report.json", f"out={tmp_path}", f"out={tmp_path}/file/report.json",
                 f"cases={tmp_path}/file", "work=/proc/runs"):
        with pytest.raises(InputError, match="cannot write"):
            common.parse_settings(defaults, [word])
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("path", sorted(Path(common.__file__).parent.glob("*.py")),
                         ids=lambda path: path.stem)
def test_commands_print_their_usage_and_look_at_their_places(path):
    text = path.read_text(encoding="utf-8")
    if "run_command(" in text:
        assert "run_command(main, usage=__doc__)" in text
        assert "config = parse_settings(DEFAULTS, argv)" in text


def test_table_is_aligned():
    lines = table(["name", "x"], [["long name", 1.23456], ["b", 7]]).splitlines()
    assert lines[2] == "| long name | 1.23 |"
    assert len({len(line) for line in lines}) == 1


def fake_search(coefficients: dict[float, float]) -> Search:
    search = Search(DEFAULTS)
    search.drapes = {a: {"alpha_uN_m": a, "coefficient": c, "status": "converged"}
                     for a, c in coefficients.items()}
    return search


def test_search_halves_the_interval_that_encloses_the_scan():
    search = fake_search({1.0: 10.0, 4.0: 30.0, 16.0: 60.0})
    assert search.between(40.0) == pytest.approx(8.0)
    assert search.between(20.0) == pytest.approx(2.0)
    assert search.between(70.0) is None
    assert search.nearest(40.0)["alpha_uN_m"] == 4.0
    search.drapes[8.0] = {"alpha_uN_m": 8.0, "coefficient": 90.0, "status": "line_search"}
    assert search.nearest(90.0)["alpha_uN_m"] == 16.0  # not a drape that failed
    assert search.between(40.0) is None  # nor tried again


def test_search_closes_in_on_any_coefficient():
    def coefficient(alpha: float) -> float:
        return 100 * alpha / (alpha + 10) + 3 * np.sin(9 * np.log(alpha))

    search = fake_search({a: coefficient(a) for a in (1.0, 10.0, 100.0)})
    for _ in range(8):
        alpha = search.between(55.0)
        search.drapes[alpha] = {"alpha_uN_m": alpha, "coefficient": coefficient(alpha),
                                "status": "converged"}
    assert search.nearest(55.0)["coefficient"] == pytest.approx(55.0, abs=0.5)
    assert all(alpha == rounded(alpha) for alpha in search.drapes)


def test_turning_the_cloth_moves_its_points_along():
    angle = 2 * np.pi * np.arange(720) / 720
    outline = (1 + 0.2 * np.cos(3 * angle) + 0.1 * np.sin(angle))[:, None] * np.column_stack(
        [np.cos(angle), np.sin(angle)])
    turned = turn_cloth(outline, np.pi / 2)
    np.testing.assert_allclose(turned[180], [0.0, 1.2], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(turned, axis=1),
                               np.roll(np.linalg.norm(outline, axis=1), 180))


def test_batched_drapes_are_timed_and_compared(tmp_path):
    out = tmp_path / "batched.json"
    batched.main(["drapes=2", "edge_mm=10", "repeats=1", "workers=2", "batches=2",
                  "edges_mm=10", "check=1", f"out={out}"])
    found = json.loads(out.read_text())
    alone, (row,) = found["each_on_its_own"], found["together"]
    assert alone["converged"] == row["converged"] == 2
    assert alone["largest_difference_m"] < 1e-6
    rates = alone["drapes_per_second_workers"], alone["drapes_per_second_one_core"]
    assert alone["ratio"] == pytest.approx(rates[0] / rates[1])
    assert row["batch"] == 2 and row["edge_mm"] == 10 and row["peak_memory_GiB"] > 0.1
    assert sum(row["share_by_activity"].values()) == pytest.approx(1.0, abs=0.05)
    # Rounding may lead the two ways into other folds.
    distances = found["agreement"]["distances_m"]
    assert len(distances) == 1 and distances[0] < 0.1
    assert found["agreement"]["same_shape"] == (distances[0] <= batched.SAME)


@pytest.fixture(scope="module")
def draped():
    return drape(Fabric(np.full(3, 40e-6)), edge=8e-3, seed=2)


def test_cloth_placed_on_its_own_mesh_stays_and_on_another_one_nearly(draped):
    for edge, low, high in ((8e-3, 0.0, 1e-6), (6e-3, 1e-4, 5e-3)):
        specimen = make_specimen(Rig(), edge=edge, topology=2)
        found = common.next_to(draped.rest, draped.positions, specimen, Rig(), draped.fabric)
        shape = default_mesh.Shape(specimen, found.state.positions)
        assert found.converged
        assert low <= compare(draped, shape).displacement < high


def test_the_fine_mesh_has_four_times_the_triangles(draped):
    specimen = default_mesh.fine_specimen(Rig(), draped, topology=2)
    assert len(specimen.mesh.faces) >= 4 * len(draped.faces)
    rim = np.flatnonzero(specimen.held[specimen.mesh.edges].all(axis=1)
                         & (np.linalg.norm(specimen.mesh.rest[specimen.mesh.edges], axis=2)
                            > 0.999 * Rig().plate_radius).all(axis=1))
    ends = specimen.mesh.rest[specimen.mesh.edges[rim]]
    assert np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) == pytest.approx(4e-3, rel=0.05)


def test_distances_of_meshes_are_those_of_drapes_with_the_same_folds():
    def row(apart: float, cost: float, *, folds: bool = True, converged: bool = True) -> dict:
        return {"mesh": "3", "apart_mm": apart, "same_folds": folds, "converged": converged,
                "cpu_seconds": cost}

    rows = row(0.6, 1.0), row(1.0, 2.0), row(9.0, 3.0, folds=False), row(8.0, 6.0, converged=False)
    (found,) = summary = default_mesh.summarise([{"meshes": [one]} for one in rows])
    assert found["same_folds"] == 2 and found["within_limit"] == 1
    assert found["mean_mm"] == pytest.approx(0.8) and found["largest_mm"] == 1.0
    assert found["mean_cpu_seconds"] == pytest.approx(3.0)
    assert default_mesh.verdict(summary) == (
        "default mesh: 0.80 mm from fine, 3.00 CPU-seconds (mean of 4 drapes)")


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_gpu_figures_need_a_gpu(tmp_path):
    with pytest.raises(InputError, match="no GPU"):
        batched.main(["device=cuda", f"out={tmp_path / 'batched.json'}"])
    assert not list(tmp_path.iterdir())


def test_reports_are_collected(tmp_path):
    settings = [f"folder={tmp_path}", f"out={tmp_path / 'bench.json'}"]
    with pytest.raises(InputError, match="no report"):
        report.main(settings)
    (tmp_path / "render.json").write_text('{"views": 2}')
    (tmp_path / "speed.json").write_text('{"drapes": 1}')
    report.main(settings)
    found = json.loads((tmp_path / "bench.json").read_text())
    assert found == {"speed": {"drapes": 1}, "render": {"views": 2}}


def test_alpha_along_other_axes_is_the_same_plates() -> None:
    from benchmarks.simulated_scans import alpha_along
    from drapenet.refine.captured import Cloth

    theta = np.log([40e-6, 25e-6, 20e-6])
    cloth = Cloth(np.r_[theta, -2e-3 * np.ones(3)], warp=0.2)
    np.testing.assert_allclose(alpha_along(cloth, 0.2), np.exp(theta))
    np.testing.assert_allclose(alpha_along(cloth, 0.2 + np.pi / 2), np.exp(theta)[::-1])
    alike = Cloth(np.r_[np.log([60e-6, 40e-6, 60e-6]), np.zeros(3)])
    turned = alpha_along(alike, np.pi / 4)
    np.testing.assert_allclose(turned, [40e-6, 60e-6, 40e-6])


def test_the_axes_of_bounds_can_be_read(tmp_path, monkeypatch):
    pictures = []
    monkeypatch.setattr(information, "write_figure", lambda _, figure: pictures.append(figure))
    found = json.loads((common.REPORTS / "information.json").read_text(encoding="utf-8"))
    information.draw(found, tmp_path / "information.png")
    for axes in pictures[0].axes:
        low, high = axes.get_ylim()
        assert sum(low <= tick <= high for tick in axes.get_yticks()) >= 3


def test_errors_are_compared_with_the_bound_of_the_same_fabric():
    results = {f"views_{k}": {"theta": [0.0] * 6, "found": [error] * 6, "estimated": [0.1] * 6}
               for k, error in enumerate((0.2, -0.3, 5.0, 0.1))}
    bounds = {f"bound_{k}": {"bound": bound}
              for k, bound in enumerate(([0.1] * 6, [0.3] * 6, None, [0.1] * 5 + [0.01]))}
    factors = refine_views.over_bound(results, bounds)
    assert factors["refined from views"] == pytest.approx([1.4826] * 5 + [2 * 1.4826])
    assert factors["network"] == pytest.approx([1.4826] * 6)


def test_fabrics_with_other_folds_are_gathered_until_there_are_enough(monkeypatch):
    def cases(work, cases, **options):
        return {name: {"other_folds": case["number"] % 3 == 0} for name, case in cases.items()}

    monkeypatch.setattr(refine_views, "run_cases", cases)
    config = refine_views.DEFAULTS | {"fabrics": 4}
    assert list(refine_views.gather(config)) == ["views_0", "views_1", "views_2", "views_3"]
    other = refine_views.gather(config | {"other_folds": True})
    assert list(other) == ["views_0", "views_3", "views_6", "views_9"]


def test_meshes_are_compared_at_every_spacing(tmp_path, capsys):
    out = tmp_path / "meshes.json"
    meshes.main(["fabrics=stiff", "laws=midedge", "edge_mm=4", "refinement_mm=8,4", "start_mm=4",
                 f"cases={tmp_path / 'cases'}", f"out={out}"])
    content = json.loads(out.read_text(encoding="utf-8"))
    coarse, fine = content["spacings"][:3], content["spacings"][3:]
    assert fine == content["meshes"]
    assert {row["edge_mm"] for row in coarse} == {8.0}
    # The coarser the mesh, the more the drape depends on it.
    assert max(row["mean_mm"] for row in coarse) > max(row["mean_mm"] for row in fine) > 0.0
    largest = [f"{max(row['mean_mm'] for row in rows):.2f}" for rows in (coarse, fine)]
    cells = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["|", "stiff", "|", largest[0], "|", largest[1], "|"] in cells


def test_drapes_of_different_folds_are_marked_in_the_table_of_spacings():
    def pair(mean_mm: float, *, same_folds: bool) -> dict:
        return {"fabric": "soft", "edge_mm": 3.0, "mean_mm": mean_mm, "same_folds": same_folds}

    assert meshes.spacing_rows([pair(1.0, same_folds=True), pair(0.2, same_folds=False)]) == [
        ["soft", "1.00"]]
    assert meshes.spacing_rows([pair(1.0, same_folds=True), pair(8.0, same_folds=False)]) == [
        ["soft", "(8.00)"]]


def test_searches_are_perturbed_alike_for_equal_starts_and_changed_outcomes_are_listed(draped):
    scene = draped.scene
    potential = Cloth(scene, draped.fabric).potential
    stop = NewtonOptions(max_iterations=0)
    moves = [perturbed.Perturbation(seed, 1e-9).minimise(potential, draped.state.q, stop).q
             - draped.state.q for seed in (None, 0, 0, 1)]
    assert not moves[0].any() and np.array_equal(moves[1], moves[2])
    assert not np.array_equal(moves[1], moves[3])
    coordinates = moves[1][: 3 * len(draped.rest)].reshape(-1, 3)
    assert not coordinates[scene.held].any()
    assert coordinates[~scene.held].std() == pytest.approx(1e-9, rel=0.1)
    plain = {"a": "passed", "b": "passed", "c": "failed"}
    runs = [plain, plain | {"b": "failed"}, plain | {"b": "failed", "c": "passed"}]
    assert perturbed.compare(plain, runs) == {
        "b": {"unperturbed": "passed", "perturbed": {"passed": 1, "failed": 2}},
        "c": {"unperturbed": "failed", "perturbed": {"failed": 2, "passed": 1}}}
