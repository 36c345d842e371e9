"""What the process for exports makes: the workbook of a search, the zip of an estimate's files."""

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
from estimates import document_of, estimate_of
from workbooks import cells

from common.errors import InputError
from common.files import replace_json
from drapenet.export.formats import TARGETS, export_all
from drapenet.export.material import read_material
from drapenet.result.advice import advice_of
from drapenet.result.document import EstimateDocument
from drapenet.result.files import write_estimate
from drapenet.service.database import DONE, FAILED, RUNNING, Database
from drapenet.service.exports import REFUSED, alike, all_files, results_table
from drapenet.service.jobs import JOINT
from sim.material import MICRO, NANO
from sim.rig import Rig

ALPHA = np.array([52.0, 31.0, 22.0]) * MICRO
SETTINGS = {"mesh": "alternating", "edge_mm": 4.0, "curvature_1_m": 50.0, "name": "Köper 7"}


def document(
    scale: float = 1.0, coefficient: float = 60.0, source: str = "twill"
) -> EstimateDocument:
    """Of a fabric whose alpha is ``scale`` times :data:`ALPHA`."""
    return document_of(estimate_of(scale * ALPHA, np.full(3, -100 * NANO)), capture={
        "source": source, "rig": "square300_cylinder100", "density_g_m2": 210.0,
        "drape_coefficient_percent": coefficient, "nodes": 6})


@pytest.fixture
def database(tmp_path) -> Database:
    """Two fabrics, of one and two captures, and what is not an estimate of either."""
    database = Database(tmp_path)

    def add(identity: str, fabric: str, state: str = DONE, created: float = 0.0,
            **values: object) -> None:
        database.add_estimate(identity, fabric, values.pop("name", identity), state=state,
                              created=created, **values)

    content = {key: document(scale, coefficient, f"serge/{key}").content()
               for key, scale, coefficient in (
                   ("a", 1.0, 60.0), ("b", 2.0, 70.0), ("c", 3.0, 50.0), ("joint", 2.4, 60.0))}
    add("a", "twill", about=("navy twill", ""), created=1, estimate=content["a"])
    add("b", "serge", about=("=grey serge", ""), created=2, estimate=content["b"])
    add("c", "serge", created=3, estimate=content["c"])
    add("failed", "serge", FAILED, created=4, error="no drape is seen")
    add("joint", "serge", name=JOINT, created=5, estimate=content["joint"], members=["b", "c"])
    add("none", "new", RUNNING, about=("new", ""), created=6, estimate=content["a"])
    return database


def sheets(folder: Path, search: str = "") -> tuple[list[dict], list[dict]]:
    title, data = results_table(folder, search.split())
    assert title == "results.xlsx"
    return cells(io.BytesIO(data), 1), cells(io.BytesIO(data), 2)


def test_the_workbook_has_the_result_of_each_fabric_and_its_captures(tmp_path, database):
    fabrics, captures = sheets(tmp_path)
    assert [row["fabric"] for row in fabrics] == ["=grey serge"] * 3 + ["navy twill"] * 3
    assert [row["captures"] for row in fabrics[::3]] == [2, 1]
    assert [row["captures failed"] for row in fabrics[::3]] == [1, 0]
    assert [row["α median [µN·m]"] for row in fabrics[:3]] == pytest.approx(2.4e6 * ALPHA)
    assert fabrics[0]["drape coefficient [%]"] == 60 and fabrics[0]["warnings"] == 0
    assert [row["capture"] for row in captures[::3]] == ["b", "c", "a"]
    for row, scale in zip(captures[::3], (2, 3, 1), strict=True):
        assert row["α median [µN·m]"] == pytest.approx(scale * 52)


def test_a_copy_does_not_count(tmp_path, database):
    for identity, scale in (("b", 2.0), ("c", 3.0)):
        content = document(scale, source=f"serge/{identity}").content()
        content["capture"]["files_sha256"] = ["1" * 64]
        database.change("estimate", identity, estimate=content)
    fabrics, captures = sheets(tmp_path, "serge")
    assert {row["captures"] for row in fabrics} == {1}
    assert {row["capture"]: row.get("warnings in words", "") for row in captures} == {
        "b": "", "c": "serge/c has the same pictures as serge/b and is left out: give each capture "
                      "once"}


def test_the_workbook_states_the_faces_that_were_draped(tmp_path, database):
    up = document(source="serge/b").content()
    down = up | {"capture": up["capture"] | {"source": "serge/c", "face": "down"}}
    database.change("estimate", "c", estimate=down)
    about = {key: value for key, value in up["capture"].items() if key not in ("source", "face")}
    database.change("estimate", "joint", estimate=up | {
        "capture": about | {"sources": ["serge/b", "serge/c"]},
        "captures": [{key: each[key] for key in ("capture", "moduli", "warnings")}
                     for each in (up, down)]})
    database.change("estimate", "a", estimate=up | {  # of strips alone
        "capture": about | {"sources": [], "rig": ""}})
    fabrics, captures = sheets(tmp_path)
    assert [row.get("face") for row in fabrics[::3]] == ["up and down", ""]
    assert [row.get("face") for row in captures[::3]] == ["up", "down", ""]


def test_the_workbook_has_a_line_of_a_fabric_without_an_estimate(tmp_path, database):
    database.change("estimate", "none", state=FAILED, error="the picture shows no cloth")
    fabrics, _ = sheets(tmp_path, "new")
    assert fabrics == [{"fabric": "new", "captures": 0, "captures failed": 1,
                        "warnings in words": "no estimate: none: the picture shows no cloth"}]


def test_the_workbook_says_what_the_drape_does_not_show_and_what_to_drape(tmp_path, database):
    advice = advice_of(Rig.from_name("disc300_support180"), 0.946)
    poor = document().model_copy(update={
        "poorly_constrained": ["beta/alpha warp", "alpha bias", "beta/alpha bias"],
        "advice": advice})
    database.change("estimate", "a", estimate=poor.content())
    fabrics, captures = sheets(tmp_path, "navy")
    for row, letters in zip(fabrics, ("β", "α, β", ""), strict=True):
        assert row["poorly constrained"] == letters and "a disc of 360 mm" in row["advice"]
    assert captures[0]["advice"] == fabrics[0]["advice"]


def test_the_workbook_follows_the_search(tmp_path, database):
    fabrics, captures = sheets(tmp_path, "TWILL square300")
    assert {row["fabric"] for row in [*fabrics, *captures]} == {"navy twill"}
    assert sheets(tmp_path, "jersey") == ([], [])


def test_the_workbook_says_which_captures_a_result_leaves_out(tmp_path, database):
    database.change("estimate", "joint", state=FAILED, error="the same views")
    fabrics, captures = sheets(tmp_path, "serge")
    failed = cells(io.BytesIO(results_table(tmp_path, ["serge"])[1]), 3)
    assert [(row["capture"], row["reason"]) for row in failed] == [
        ("failed", "no drape is seen"), ("", "the same views")]
    assert fabrics[0]["α median [µN·m]"] == pytest.approx(3 * 52)  # of the latest
    assert fabrics[0]["warnings in words"] == (
        "this estimate is made without serge/b, not joined with it")
    assert len(captures) == 6


def test_fabrics_like_an_estimate_are_results_of_others_by_name(tmp_path, database):
    for identity, scale in (("a", 1.0), ("b", 2.0), ("c", 3.0), ("joint", 1.05)):
        (tmp_path / identity).mkdir()
        write_estimate(tmp_path / identity, estimate_of(scale * ALPHA, np.full(3, -100 * NANO)),
                       document(scale))
    first, *others = alike(tmp_path, "a", 20)
    assert (first["fabric"], first["place"], first["alike"]) == ("=grey serge", "joint", "100 %")
    assert first["warp_difference_percent"] == pytest.approx(5, abs=1)
    assert len(others) == 2 and all(one["source"] and not one["place"] for one in others)
    assert alike(tmp_path, "c", 1)[0]["fabric"] == "navy twill"  # not of its own fabric
    (tmp_path / "joint" / "samples.npz").unlink()
    assert len(alike(tmp_path, "a", 20)) == 2


@pytest.fixture
def folder(tmp_path) -> Path:
    """The folder of an estimate with a report and a file that is not for its user."""
    folder = tmp_path / "estimate"
    folder.mkdir()
    replace_json(folder / "estimate.json", document().content())
    (folder / "report.html").write_text("<p>report", encoding="utf-8")
    (folder / "samples.npz").write_bytes(b"")
    return folder


def zip_of(folder: Path, **changes: object) -> dict[str, bytes]:
    data = all_files(folder, ["estimate.json", "report.html", "report.pdf"], SETTINGS | changes)
    with zipfile.ZipFile(io.BytesIO(data)) as packed:
        return {name: packed.read(name) for name in packed.namelist()}


def test_the_zip_has_the_report_and_the_files_of_all_tools(folder, tmp_path):
    found = zip_of(folder)
    expected, _ = export_all(read_material(folder, **SETTINGS), list(TARGETS), tmp_path / "all")
    assert found == {file.name: file.read_bytes() for file in [
        folder / "estimate.json", folder / "report.html", *expected]}


def test_a_tool_that_refuses_is_named_in_the_zip_with_its_sentence(folder):
    found = zip_of(folder, edge_mm=40.0)
    lines = found[REFUSED].decode().splitlines()
    assert " ".join(line.partition(" (")[0] for line in lines) == (
        "arcsim.json newton_fabric.py isaaclab_fabric.py ppf.toml ppf_addon.toml hood.yaml")
    assert all("): edge_mm=40 is too coarse for this fabric" in line for line in lines)
    assert {"fabric.jfab", "report.html"} <= set(found) and "ppf.toml" not in found
    with pytest.raises(InputError, match="mesh='hexagons'"):
        zip_of(folder, mesh="hexagons")
