"""Trees of captures: what is found, what survives interruption, what reaches a spreadsheet."""

import csv
import shutil
from pathlib import Path

import pytest
from cloths import capture_views

import infer
from common.errors import InputError
from data.captures.capture import write_capture
from drapenet.batch.captures import entries_of, plain_name
from drapenet.result.table import csv_table
from sim.rig import SQUARE_RIG

TWILL = Path(__file__).parents[2] / "examples" / "captures" / "twill"
NAMES = [("=cmd|' /C calc'!A0", "1", "a"), ("=cmd|' /C calc'!A0", "2", "a"),
         ("<script>alert(1)</script>", "$x^", "b")]


@pytest.fixture(scope="module")
def captured() -> tuple:
    return capture_views(orientation=0.4)


def write(folder: Path, captured: tuple, density: float = 0.15) -> Path:
    views, intrinsics = captured
    write_capture(folder, views=views, intrinsics=intrinsics, density=density,
                  rig=SQUARE_RIG)
    return folder


def rows(file: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(file.read_text("utf-8-sig").splitlines()))


def test_a_tree_is_estimated_resumed_and_shown(tmp_path, captured, untrained_checkpoint, capsys):
    root, out = tmp_path / "root", tmp_path / "out"
    lines = ["fabric,sample,capture"]
    for k, (fabric, sample, _) in enumerate(NAMES):
        views = captured[0].copy()
        views[0, 45, 60] += 1e-3 * k  # the same views twice are not repeats
        write(root / str(k), (views, captured[1]))
        quoted = fabric.replace('"', '""')
        lines.append(f'"{quoted}",{sample},{k}')
    lines.append("gone,,nowhere")
    (root / "list.csv").write_text("\n".join(lines), "utf-8")
    words = [f"captures={root / 'list.csv'}", f"out={out}", f"checkpoint={untrained_checkpoint}",
             "workers=2"]
    infer.main(words)
    tables = {name: (out / name).read_bytes() for name in ("fabrics.csv", "captures.csv",
                                                           "failures.csv")}
    fabrics = rows(out / "fabrics.csv")
    assert [row["fabric"] for row in fabrics] == ["<script>alert(1)</script>",
                                                  "'" + NAMES[0][0]]
    assert [row["captures"] for row in fabrics] == ["1", "2"]
    assert float(fabrics[1]["warp_or_stiff_alpha_uN_m"]) > 0
    # The fabric's density is half of 300 g/m², and so are its moduli; equal drapes do not vary.
    assert float(fabrics[0]["bias_alpha_uN_m_at_300_g_m2"]) == pytest.approx(
        2 * float(fabrics[0]["bias_alpha_uN_m"]), rel=1e-4)
    assert float(fabrics[1]["alpha_bias_scatter_factor"]) == pytest.approx(1.0, abs=0.02)
    failure, = rows(out / "failures.csv")
    assert failure["fabric"] == "gone" and "does not exist" in failure["reason"]
    pages = [file.read_text("utf-8") for file in out.rglob("*.html")]
    printed = capsys.readouterr().out
    assert "4 captures of 3 fabrics: 0 estimated, 0 failed, 4 to go" in printed
    assert "captures: 3 estimated, 1 failed, see" in printed
    summary = rows(out / "summary.csv")
    assert len(summary[0]) == 11 and summary[1]["captures"] == "2"
    low, high = summary[1]["bias_68"].split(" to ")
    assert float(low) < float(summary[1]["bias_alpha_uN_m"]) < float(high)
    assert summary[1]["bias_68"] in printed
    assert len(pages) == 3 and not any("<script>" in page for page in pages)
    assert "&lt;script&gt;" in (out / "index.html").read_text("utf-8")
    # What was finished stays; what is not, or has changed, is done again; tables are the same.
    done = sorted(out.rglob("done.json"))
    times = {file: file.stat().st_mtime_ns for file in done}
    done[0].unlink()
    capsys.readouterr()
    infer.main(words)
    assert "of 3 fabrics: 2 estimated, 1 failed, 1 to go" in capsys.readouterr().out
    assert all(file.stat().st_mtime_ns == times[file] for file in done[1:])
    assert {name: (out / name).read_bytes() for name in tables} == tables
    file = root / "2" / "capture.yaml"
    file.write_text(file.read_text().replace("150.0", "300.0"))
    infer.main(words)
    assert rows(out / "fabrics.csv")[0]["density_g_m2"] == "300"
    # A damaged file costs its fabric, and no other.
    samples = sorted(out.rglob("samples.npz"))[0]
    samples.write_bytes(samples.read_bytes()[:-100])
    fabric = out / samples.relative_to(out).parts[0]
    assert (fabric / "estimate.json").exists()
    capsys.readouterr()
    infer.main([*words, "export=csv"])
    assert len(rows(out / "fabrics.csv")) == 1
    assert not (fabric / "estimate.json").exists() and not (fabric / "index.html").exists()
    assert capsys.readouterr().out.count("exports: ") == len(list(out.rglob("material.csv"))) == 1
    assert any("is damaged (BadZipFile); remove it" in row["reason"]
               for row in rows(out / "failures.csv"))


def test_a_tree_of_broken_captures_ends_with_an_error_and_a_list(tmp_path, untrained_checkpoint):
    (tmp_path / "root" / "a" / "b").mkdir(parents=True)
    (tmp_path / "root" / "a" / "b" / "view_0.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match="none of 1 captures"):
        infer.main([f"captures={tmp_path / 'root'}", f"out={tmp_path / 'out'}",
                    f"checkpoint={untrained_checkpoint}", "workers=1"])
    assert "neither capture.yaml" in rows(tmp_path / "out" / "failures.csv")[0]["reason"]
    assert rows(tmp_path / "out" / "fabrics.csv") == []


def test_a_fabric_with_warnings_is_marked_wherever_it_is_shown(
    tmp_path, untrained_checkpoint, capsys
):
    for place in ("sound/1", "faulty/1", "faulty/2", "twice/1", "twice/2"):
        shutil.copytree(TWILL, tmp_path / "root" / place)
    faulty = tmp_path / "root" / "faulty" / "2"
    shutil.copy(TWILL / "view_1.png", faulty / "view_2.png")
    shutil.copy(TWILL / "view_2.png", faulty / "view_1.png")
    out = tmp_path / "out"
    words = [f"captures={tmp_path / 'root'}", f"checkpoint={untrained_checkpoint}", "workers=1"]
    infer.main([*words, f"out={out}"])
    faulty, sound = rows(out / "fabrics.csv")
    assert sound["flags"] == "" and sound["captures_with_warnings"] == "0"
    assert "root/faulty/2 has " in faulty["flags"] and "by itself: " in faulty["flags"]
    count, none = (row["warnings"] for row in rows(out / "summary.csv"))
    assert int(count) >= 1 and none == "0"
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("faulty") and line.endswith(f" {count}") for line in lines)
    assert any(line.startswith("sound") and line.endswith(" -") for line in lines)
    page = (out / "index.html").read_text("utf-8")
    assert page.count('<tr class="doubted">') == 1 and f"<strong>{count} warning" in page
    twice, = rows(out / "failures.csv")
    assert "root/twice/2 have the same views" in twice["reason"]
    infer.main([*words, f"out={tmp_path / 'strict'}", "strict=true"])
    failure, _ = rows(tmp_path / "strict" / "failures.csv")
    assert failure["sample"] == "" and failure["capture"] == "2"
    assert failure["reason"].startswith("refused because strict=true: ")


def test_trees_of_every_depth_are_found(tmp_path):
    for place in ("denim/1/first", "denim/1/second", "silk/only", "wool", "felt/2/side/third"):
        (tmp_path / place).mkdir(parents=True)
        (tmp_path / place / "capture.yaml").touch()
    (tmp_path / ".hidden").mkdir()
    (tmp_path / ".hidden" / "capture.yaml").touch()
    (tmp_path / "denim" / "notes.txt").touch()
    (tmp_path / "denim" / "empty").mkdir()
    (tmp_path / "twill").mkdir()
    (tmp_path / "twill" / "linked").symlink_to(tmp_path / "wool")
    (tmp_path / "twill" / "loop").symlink_to(tmp_path)
    (tmp_path / "twill" / "top").symlink_to("/")
    found = {(one.fabric, one.sample, one.capture) for one in entries_of(tmp_path)}
    assert found == {("denim", "1", "first"), ("denim", "1", "second"), ("silk", "", "only"),
                     ("wool", "", "wool"), ("felt", "2/side", "third"), ("twill", "", "linked")}
    with pytest.raises(InputError, match=r"is one capture: give capture="):
        entries_of(tmp_path / "wool")
    with pytest.raises(InputError, match="holds no captures"):
        entries_of(tmp_path / "denim" / "empty")


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


@pytest.mark.parametrize(("text", "message"), [
    ("name,capture\na,b\n", "no column 'fabric'"),
    ("fabric,capture\na,\n", "line 2"),
    ("fabric,capture\n", "holds no captures"),
    ("fabric,capture\n\"a,b\n", "cannot be read"),
    (b"\xff\xfe\x00", "UTF-8"),
])
def test_bad_lists_are_refused_in_one_line(tmp_path, text, message):
    file = tmp_path / "list.csv"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError, match=message) as raised:
        entries_of(file)
    assert "\n" not in str(raised.value)


def test_cells_are_no_formulas_but_numbers_stay():
    values = ("=1+1", "@x", "\tx", "-2.5", "+3", -2.5, None, "plain", 'x,"y"\nz')
    text = csv_table([dict(enumerate(values))])
    assert list(csv.reader(text.splitlines(keepends=True)))[1] == [
        "'=1+1", "'@x", "'\tx", "-2.5", "+3", "-2.5", "", "plain", 'x,"y"\nz']


def test_the_line_of_a_faulty_row_counts_empty_ones(tmp_path):
    file = tmp_path / "list.csv"
    file.write_text("fabric,capture\nsilk,one\n\nsilk,\n")
    with pytest.raises(InputError, match="line 4: fabric='silk' and capture='' must"):
        entries_of(file)
