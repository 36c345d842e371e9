"""Captures of many fabrics: which are found, what survives interruption, what is in the tables."""

import csv
import re
import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from cloths import capture_views
from photographs import drawn, plate, write
from workbooks import cells

import drapenet
import infer
from common.errors import InputError
from data.captures.writer import write_capture
from drapenet.fabric.entries import entries_of, plain_name
from drapenet.measured.read import sources_in
from drapenet.result.tables import ROLES, csv_table
from sim.rig import SQUARE_RIG

TWILL = Path(__file__).parents[2] / "examples" / "captures" / "twill"
FORMULA = "=cmd|' /C calc'!A0"
SCRIPT = "<script>alert(1)</script>"
LIST = f"""fabric,sample,capture
"{FORMULA}",1,0
"{FORMULA}",2,1
"{SCRIPT}",$x^,2
gone,,nowhere
sound,,{TWILL}
sound,,lost
twice,,3
twice,,4
photo,,5
"""


def rows(file: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(file.read_text("utf-8-sig").splitlines()))


@pytest.fixture(scope="module")
def words(tmp_path_factory, untrained_checkpoint) -> list[str]:
    """Command line for five small captures, a photograph, two missing ones and the bundled one."""
    root = tmp_path_factory.mktemp("root")
    views, intrinsics = capture_views(orientation=0.4)
    for k in range(5):
        if k < 4:  # the last two are the same
            views[0, 45, 60] += 1e-3
        write_capture(root / str(k), views=views, intrinsics=intrinsics, density=0.15,
                      rig=SQUARE_RIG)
    write(root / "5", drawn(), outline={"plate_px": plate(), "camera_height_mm": 1000},
          operator=FORMULA)
    (root / "list.csv").write_text(LIST, "utf-8")
    return [f"captures={root / 'list.csv'}", f"out={root / 'out'}", "workers=1",
            f"checkpoint={untrained_checkpoint}"]


@pytest.fixture(scope="module")
def printed(words, tmp_path_factory) -> str:
    """What the first run prints."""
    with pytest.MonkeyPatch.context() as patch:
        lines: list[str] = []
        patch.setattr("builtins.print", lambda *texts, **_: lines.extend(map(str, texts)))
        infer.main(words)
    return "\n".join(lines)


@pytest.fixture
def out(words, printed) -> Path:
    return Path(words[1].removeprefix("out="))


def test_the_tables_hold_every_fabric(out, printed):
    fabrics = {row["fabric"]: row for row in rows(out / "fabrics.csv")}
    assert {name: row["captures"] for name, row in fabrics.items()} == {
        SCRIPT: "1", "'" + FORMULA: "2", "sound": "1", "photo": "1", "twice": "1"}
    joint, single = fabrics["'" + FORMULA], fabrics[SCRIPT]
    # The fabric's density is half of 300 g/m², and so are its moduli; equal drapes do not vary.
    assert float(single["bias_alpha_uN_m_at_300_g_m2"]) == pytest.approx(
        2 * float(single["bias_alpha_uN_m"]), rel=1e-4)
    assert float(joint["alpha_bias_scatter_factor"]) == pytest.approx(1.0, abs=0.02)
    summary = {row["fabric"]: row for row in rows(out / "summary.csv")}["'" + FORMULA]
    low, high = summary["bias_68"].split(" to ")
    assert len(summary) == 13
    assert float(low) < float(summary["bias_alpha_uN_m"]) < float(high)
    assert summary["bias_68"] in printed and "captures: 7 estimated, 2 failed" in printed
    assert len(rows(out / "captures.csv")) == 7


def test_the_tables_state_failed_captures_and_operators(out):
    sheets = [cells(out / "results.xlsx", sheet) for sheet in (1, 2)]
    for table, key in ((rows(out / "fabrics.csv"), "captures_failed"),
                       (rows(out / "summary.csv"), "captures_failed"),
                       (sheets[0], "captures failed")):
        assert {row["fabric"]: int(row[key]) for row in table} == {
            row["fabric"]: int(row["fabric"] in ("sound", "gone")) for row in table}
    for table in (rows(out / "fabrics.csv"), rows(out / "captures.csv"), *sheets):
        operators = {row["fabric"]: row.get("operator") for row in table}
        operators.pop("gone", None)  # without an estimate
        assert operators.pop("photo").endswith(FORMULA) and not any(operators.values())


def test_the_spreadsheet_has_the_numbers_of_the_tables_with_units(out):
    fabrics = {row["fabric"]: row for row in rows(out / "fabrics.csv")}
    sheet = cells(out / "results.xlsx", 1)
    gone = sheet.pop()
    assert gone["fabric"] == "gone" and "direction" not in gone
    assert gone["warnings in words"].startswith("no estimate: nowhere: ")
    assert [(row["capture"], row["reason"]) for row in cells(out / "results.xlsx", 3)] == [
        (row["capture"], row["reason"]) for row in rows(out / "failures.csv")]
    assert [row["direction"] for row in sheet] == ["stiff", "bias", "soft"] * 3 + [
        "warp", "bias", "weft"] + ["stiff", "bias", "soft"]
    assert {row["face"] for row in sheet} == {"up"}
    for number, row in enumerate(sheet):
        role = ROLES[number % 3]
        table = fabrics["'" + row["fabric"] if row["fabric"] == FORMULA else row["fabric"]]
        for name, unit, key in (("α", "µN·m", "alpha_uN_m"),
                                ("bending length", "mm", "bending_length_mm"),
                                ("KES B", "gf·cm²/cm", "kes_b_gf_cm2_per_cm")):
            for end in ("", " low68", " high90"):
                value = row.get(f"{name}{end or ' median'} [{unit}]")
                column = f"{role}_{key}{end.replace(' ', '_')}"
                assert value == (pytest.approx(float(table[column]), rel=1e-5)
                                 if table[f"{role}_{key}"] else None)
        assert row["drape coefficient [%]"] == float(table["drape_coefficient_percent"])
        assert row["nodes"] == float(table["nodes"]) > 0
    assert len(cells(out / "results.xlsx", 2)) == 3 * len(rows(out / "captures.csv"))


def test_every_column_of_the_tables_is_documented(out):
    text = (Path(__file__).parents[2] / "docs" / "data_format.md").read_text("utf-8")
    lines = [line.split(" | ") for line in text.partition("## Tables of many fabrics")[2]
             .partition("## A prior")[0].splitlines() if line.startswith("| `")]
    ends = ["", *(f"_{end}{level}" for level in (68, 90) for end in ("low", "high"))]
    documented = {name.replace("ROLE", role) + end for first, *_ in lines
                  for name in re.findall("`([^`]+)`", first) for role in ROLES
                  for end in (ends if "(interval)" in first else [""])}
    assert set(rows(out / "fabrics.csv")[0]) == documented
    captures = set(rows(out / "captures.csv")[0])
    assert captures - documented == {"sample", "capture"}


def test_a_fabric_has_a_report_of_its_captures(out):
    page = (out / "cmd_C_calc_A0" / "index.html").read_text("utf-8")
    assert "from 2 captures." in page and page.count("data:image/png") == 4  # views, spread, code
    assert "all fabrics" in page and str(out.parent) not in page
    assert len(list(out.rglob("report.pdf"))) == 5  # of each fabric


def test_failures_are_listed_with_their_reasons(out):
    gone, lost = rows(out / "failures.csv")
    assert gone["fabric"] == "gone" and "does not exist" in gone["reason"]
    assert lost["fabric"] == "sound" and "does not exist" in lost["reason"]


def test_a_capture_that_repeats_another_is_left_out_and_named(out):
    root = out.parent
    line = (f"{root / '4'} has the same pictures as {root / '3'} and is left out: give each "
            "capture once")
    fabric = next(row for row in rows(out / "fabrics.csv") if row["fabric"] == "twice")
    assert line in fabric["flags"]
    first, second = [row for row in rows(out / "captures.csv") if row["fabric"] == "twice"]
    assert line not in first["flags"] and line in second["flags"]
    assert fabric["bias_alpha_uN_m"] == first["bias_alpha_uN_m"]


def test_a_fabric_with_warnings_is_marked_wherever_it_is_shown(out, printed):
    fabrics = {row["fabric"]: row for row in rows(out / "fabrics.csv")}
    sound = fabrics["sound"]
    assert sound["flags"].startswith("this estimate is made without ") and "lost" in sound["flags"]
    assert sound["captures_with_warnings"] == "0" and fabrics["photo"]["flags"] == ""
    assert "by itself: " in fabrics["'" + FORMULA]["flags"]
    counts = {row["fabric"]: int(row["warnings"]) for row in rows(out / "summary.csv")}
    assert counts["photo"] == 0 and counts["sound"] == 1 and counts["'" + FORMULA] >= 2
    lines = printed.splitlines()
    assert any(line.startswith("photo") and line.endswith(" -") for line in lines)
    page = (out / "index.html").read_text("utf-8")
    assert page.count('<tbody class="doubted">') == 4


def test_names_are_text_in_the_pages(out):
    pages = [file.read_text("utf-8") for file in out.rglob("*.html")]
    assert len(pages) == 6 and not any("<script>" in page for page in pages)
    assert "&lt;script&gt;" in (out / "index.html").read_text("utf-8")


def test_python_takes_the_same_fabrics_by_name(out, words, untrained_checkpoint):
    options = {"checkpoint": untrained_checkpoint, "workers": 1}
    times = {file: file.stat().st_mtime_ns for file in out.rglob("part.json")}
    source = Path(words[0].removeprefix("captures="))
    found = drapenet.estimate_fabrics(source, str(out), **options)
    assert {*found} == {file.parent.name for file in out.glob("*/fabric.json")} and len(found) == 5
    samples = [each.samples for each in found.values()]
    for name, (first, second) in zip(found, pairwise([*samples, samples[0]]), strict=True):
        np.testing.assert_array_equal(first, drapenet.load(out / name).samples)
        assert not np.array_equal(first, second)
    assert {file: file.stat().st_mtime_ns for file in times} == times  # finished ones are read


def test_unfinished_damaged_and_changed_captures_are_estimated_again(out, words, capsys):
    tables = {name: (out / name).read_bytes() for name in ("captures.csv", "failures.csv")}
    done = sorted(out.rglob("part.json"))
    times = {file: file.stat().st_mtime_ns for file in done}
    assert len(done) == 9
    done[0].unlink()
    samples = done[-1].with_name("samples.npz")
    sound = samples.read_bytes()
    samples.write_bytes(sound[:-100])
    infer.main([*words, "export=csv"])
    printed = capsys.readouterr().out
    assert "7 of 9 captures are finished; 2 to go" in printed
    assert samples.read_bytes() == sound
    assert printed.count("exports: ") == len(list(out.rglob("material.csv"))) == 5
    assert all(file.stat().st_mtime_ns == times[file] for file in done[1:-1])
    assert {name: (out / name).read_bytes() for name in tables} == tables
    file = out.parent / "2" / "capture.yaml"
    file.write_text(file.read_text().replace("150.0", "300.0"))
    infer.main(words)
    assert "8 of 9 captures are finished" in capsys.readouterr().out
    assert {row["density_g_m2"] for row in rows(out / "fabrics.csv")
            if row["fabric"] == SCRIPT} == {"300"}


def test_only_broken_captures_are_an_error(tmp_path, untrained_checkpoint):
    (tmp_path / "root" / "a" / "b").mkdir(parents=True)
    (tmp_path / "root" / "a" / "b" / "view_0.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match="none of 1 captures"):
        infer.main([f"captures={tmp_path / 'root'}", f"out={tmp_path / 'out'}",
                    f"checkpoint={untrained_checkpoint}", "workers=1"])
    assert "neither capture.yaml" in rows(tmp_path / "out" / "failures.csv")[0]["reason"]
    assert rows(tmp_path / "out" / "fabrics.csv") == []


def test_results_of_other_captures_are_not_replaced(out, words):
    shutil.copytree(TWILL, out.parent / "other" / "fabric")
    with pytest.raises(InputError, match="estimates of other captures"):
        infer.main([f"captures={out.parent / 'other'}", *words[1:]])


def tree(root: Path, *places: str) -> Path:
    """Folders that look like captures."""
    for place in places:
        (root / place).mkdir(parents=True)
        (root / place / "capture.yaml").touch()
    return root


def test_trees_of_every_depth_are_found(tmp_path):
    tree(tmp_path, "denim/1/first", "denim/1/second", "silk/only", "wool", "felt/2/side/third",
         ".hidden")
    (tmp_path / "denim" / "notes.txt").touch()
    (tmp_path / "denim" / "empty").mkdir()
    (tmp_path / "twill").mkdir()
    (tmp_path / "twill" / "linked").symlink_to(tmp_path / "wool")
    (tmp_path / "twill" / "loop").symlink_to(tmp_path)
    (tmp_path / "twill" / "top").symlink_to("/")
    entries = {(entry.fabric, entry.sample, entry.capture) for entry in entries_of(tmp_path)}
    assert entries == {("denim", "1", "first"), ("denim", "1", "second"), ("silk", "", "only"),
                       ("wool", "", "wool"), ("felt", "2/side", "third"), ("twill", "", "linked")}
    with pytest.raises(InputError, match=r"is one capture: give capture="):
        entries_of(tmp_path / "wool")
    with pytest.raises(InputError, match="holds no captures"):
        entries_of(tmp_path / "denim" / "empty")


def test_captures_are_found_in_the_order_of_their_numbers(tmp_path):
    tree(tmp_path, "2/1/9", "2/1/10", "2/1/11", "10/1/0", "2/1/2", "2/x-1/0", "2/x/0")
    found = [str(entry.path.relative_to(tmp_path)) for entry in entries_of(tmp_path)]
    assert found == ["2/1/2", "2/1/9", "2/1/10", "2/1/11", "2/x/0", "2/x-1/0", "10/1/0"]
    names = [path.name for path in sources_in(tmp_path / "2" / "1", "capture")]
    assert names == ["2", "9", "10", "11"]


def test_captures_below_samples_are_found_and_fabrics_are_not_joined(tmp_path):
    fabric = tree(tmp_path, "poplin/s1/c1", "poplin/s1/c2", "poplin/s2/c1") / "poplin"
    assert sources_in(fabric, "capture") == [fabric / "s1/c1", fabric / "s1/c2", fabric / "s2/c1"]
    assert sources_in(fabric / "s1", "capture") == [fabric / "s1/c1", fabric / "s1/c2"]
    assert sources_in(fabric / "s1" / "c1", "capture") == [fabric / "s1/c1"]
    with pytest.raises(InputError, match=r"looks like FABRIC/SAMPLE/CAPTURE .*: give captures="):
        sources_in(tmp_path, "capture")


def test_results_of_names_that_a_file_system_confuses_lie_apart_and_inside(tmp_path):
    names = ["Silk", "silk", "a/b", "a:b", "../../up", "..", "con\nsole", "  "]
    text = "fabric,capture\n" + "".join(f'"{name}",x\n' for name in names[:-2])
    file = tmp_path / "list.csv"
    file.write_text(text + "Silk,x\n", "utf-8")
    places = [one.place for one in entries_of(file)]
    assert len({str(place).casefold() for place in places}) == len(places)
    assert places[-1].parent == places[0].parent  # the same fabric
    assert all(not place.is_absolute() and ".." not in place.parts for place in places)
    assert all(plain_name(name) not in ("", ".", "..") for name in names)


def test_a_list_may_have_semicolons(tmp_path):
    for name, text in (("a", "fabric,capture\nsilk,one\n"), ("b", "fabric;capture\nsilk;one\n"),
                       ("c", "fabric;sample;capture\n\"silk, red\";;one\n")):
        (tmp_path / name).write_text(text)
    found = [entries_of(tmp_path / name)[0] for name in "abc"]
    assert [(one.fabric, one.sample, one.capture) for one in found] == [
        ("silk", "", "one"), ("silk", "", "one"), ("silk, red", "", "one")]


def test_a_list_names_folders_as_windows_and_macos_write_them(tmp_path):
    (tmp_path / "Ko\u0308per" / "first").mkdir(parents=True)
    (tmp_path / "list.csv").write_bytes("\r\n".join([
        "sep=;", "fabric;capture", "K\u00f6per;K\u00f6per\\first",
        "Ko\u0308per;Ko\u0308per/first", ";",
    ]).encode("utf-16"))
    found = entries_of(tmp_path / "list.csv")
    assert all(one.path.is_dir() for one in found) and len(found) == 2
    assert {one.fabric for one in found} == {"K\u00f6per"}  # one fabric


def test_cells_are_no_formulas_but_numbers_stay():
    values = ("=1+1", "@x", "\tx", "-2.5", "+3", -2.5, None, "plain", 'x,"y"\nz')
    text = csv_table([dict(enumerate(values))])
    assert list(csv.reader(text.splitlines(keepends=True)))[1] == [
        "'=1+1", "'@x", "'\tx", "-2.5", "+3", "-2.5", "", "plain", 'x,"y"\nz']


def test_copies_in_another_fabric_and_other_labels_are_named(words, tmp_path):
    made = Path(words[0].partition("=")[2]).parent
    for place, capture, label in (("one/a", "0", ""), ("two/a", "0", "fabric: Twill\n"),
                                  ("two/b", "1", "fabric: Denim\noperator: M. M.\n"),
                                  ("two/c", "0", "fabric: Twill\n"), ("apart/a", "2", ""),
                                  ("apart/b", "0", "")):
        shutil.copytree(made / capture, tmp_path / "root" / place)
        file = tmp_path / "root" / place / "capture.yaml"
        density = 210 if place == "apart/b" else 150
        file.write_text(re.sub("density_g_m2: .*", f"density_g_m2: {density}", file.read_text())
                        + label)
    infer.main([f"captures={tmp_path / 'root'}", f"out={tmp_path / 'out'}", *words[2:]])
    fabrics = rows(tmp_path / "out" / "fabrics.csv")
    assert [row["captures"] for row in fabrics] == ["1", "2"]  # without the copy two/c
    one, two = (row["flags"] for row in fabrics)
    first, second, copy = (str(tmp_path / "root" / name) for name in ("one/a", "two/a", "two/c"))
    assert f"{copy} has the same pictures as {second} and is left out" in two
    assert f"{first} has the same pictures as {second}, of another fabric" in one
    assert f"{second} has the same pictures as {first}, of another fabric" in two
    assert "the captures state different fabrics (Twill / Denim)" in two
    failure, = rows(tmp_path / "out" / "failures.csv")
    assert re.search(r"from 150 \(.*apart/a\) to 210 g/m² \(.*apart/b\), .*; .*apart/b has the "
                     "same pictures as", failure["reason"]) and "apart/" not in one + two
