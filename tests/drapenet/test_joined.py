"""A fabric's estimate from captures, strips and known values: in one command, in batches, in
Python."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

import drapenet
import infer
from common.errors import InputError
from common.findings import texts
from data.captures.reader import read_capture
from drapenet.config import EstimateOptions
from drapenet.fabric import infer as inferring
from drapenet.fabric import stages
from drapenet.fabric.combine import combine
from drapenet.fabric.estimate import estimate_fabric
from drapenet.fabric.part import stored_part
from drapenet.fabric.sources import Source
from drapenet.measured.captures import Captured
from drapenet.network.checkpoint import read_header
from drapenet.network.predict import Draws
from drapenet.result.files import FAULTS

TWILL = Path(__file__).parents[2] / "examples" / "captures" / "twill"
RIGHT = {"bending_length_mm": {"warp": 28.0, "weft": 19.5}}
EXCHANGED = {"bending_length_mm": {"warp": 17.0, "weft": 31.0}}


def capture(folder: Path, known: dict | None = None) -> Path:
    """A copy of the bundled capture, with what is known of it."""
    shutil.copytree(TWILL, folder)
    file = folder / "capture.yaml"
    if known:
        file.write_text(file.read_text() + yaml.safe_dump({"known": known}))
    return folder


def strips(folder: Path, known: dict | None = None, **lengths: list[float]) -> Path:
    """A folder with bending lengths in mm by direction, read on either face."""
    folder.mkdir(parents=True)
    entries = [{"direction": name, "bending_length_mm": value, "face": face}
               for name, values in lengths.items() for value in values for face in ("up", "down")]
    (folder / "strips.yaml").write_text(yaml.safe_dump(
        {"density_g_m2": 210, "fabric": "Twill 7", "strips": entries}
        | ({"known": known} if known else {})))
    return folder


def content(folder: Path) -> dict:
    return json.loads((folder / "estimate.json").read_text())


def medians(found: dict) -> list[float]:
    return [moduli["alpha_uN_m"]["median"] for moduli in found["moduli"].values()]


def width(found: dict, name: str = "warp") -> float:
    low, high = found["moduli"][name]["alpha_uN_m"]["interval_68"]
    return high / low


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> dict:
    """The estimate of the bundled capture."""
    out = tmp_path_factory.mktemp("plain")
    infer.main([f"capture={TWILL}", f"out={out}", "drapes=0"])
    return content(out)


def test_right_values_narrow_and_wrong_ones_are_named_and_change_nothing(tmp_path, plain, capsys):
    for name, known in (("right", RIGHT), ("wrong", EXCHANGED)):
        infer.main([f"capture={capture(tmp_path / name, known)}", f"out={tmp_path / 'o' / name}",
                    "drapes=0"])
    right, wrong = (content(tmp_path / "o" / name) for name in ("right", "wrong"))
    assert not right["warnings"] and width(right) < 0.95 * width(plain)
    assert wrong["moduli"] == plain["moduli"] and wrong["capture"]["known"]
    assert [found["values"]["label"] for found in wrong["warnings"]] == [
        "the known bending length [mm] warp = 17", "the known bending length [mm] weft = 31"]
    assert "warning: the known bending length [mm] warp = 17 contradicts the capture: they say " \
        in capsys.readouterr().out
    with pytest.raises(InputError, match="refused because strict=true: the known bending length"):
        infer.main([f"capture={tmp_path / 'wrong'}", f"out={tmp_path / 'strict'}", "strict=true"])
    assert not (tmp_path / "strict" / "estimate.json").exists()


def test_strips_and_values_work_in_a_batch(tmp_path, plain):
    capture(tmp_path / "root" / "twill" / "a")
    strips(tmp_path / "root" / "twill" / "strips", warp=[27.0, 29.0, 31.0], weft=[18, 20, 19.0])
    strips(tmp_path / "root" / "lengths" / "only", warp=[22.0], weft=[25.0])
    strips(tmp_path / "root" / "values", known={"kes_b_gf_cm2_per_cm": {"warp": 0.2, "weft": 0.1}})
    capture(tmp_path / "root" / "other" / "a")
    strips(tmp_path / "root" / "other" / "b", warp=[60.0, 61.0])
    infer.main([f"captures={tmp_path / 'root'}", f"out={tmp_path / 'out'}", "workers=1"])
    found = {name: content(tmp_path / "out" / name)
             for name in ("twill", "lengths", "values", "other")}
    joint, copied = found["twill"], {"twin_elsewhere", "fabrics_differ"}
    assert {one["code"] for one in joint["warnings"]} == copied
    assert len(joint["warnings"]) == 2 and joint["strips"][0]["strips"] == 12
    assert width(joint) < width(plain) ** 0.8 and width(joint, "bias") < width(plain, "bias")
    assert found["lengths"]["capture"]["labels"]["fabric"] == "Twill 7"
    assert width(found["lengths"]) < 1.6 < width(found["values"], "bias")
    page = {name: (tmp_path / "out" / name / "index.html").read_text("utf-8")
            for name in ("lengths", "other")}
    assert "face on top" in page["other"] and "face on top" not in page["lengths"]
    assert found["values"]["laboratory"]["warp"]["kes_b_gf_cm2_per_cm"]["median"] == pytest.approx(
        0.2, rel=0.15)
    assert medians(found["other"]) == pytest.approx(medians(plain), rel=1e-9)
    first, *others = (one for one in found["other"]["warnings"] if one["code"] not in copied)
    assert all("by itself" in other["text"] for other in others)
    assert first["text"].startswith("the strips along the warp contradict the capture: alpha is ")
    table = (tmp_path / "out" / "fabrics.csv").read_text("utf-8-sig")
    assert len(table.splitlines()) == 5 and "contradict the capture" in table
    page = (tmp_path / "out" / "twill" / "index.html").read_text()
    assert "12 hanging strips alone" in page


def test_what_is_known_by_a_refused_capture_is_kept_for_the_fabric(tmp_path, plain):
    for fabric, known, density in (("right", RIGHT, 210), ("heavy", RIGHT, 300)):
        capture(tmp_path / "root" / fabric / "a")
        refused = capture(tmp_path / "root" / fabric / "b", known)
        (refused / "view_0.png").write_bytes(b"no picture")
        file = refused / "capture.yaml"
        file.write_text(file.read_text().replace("density_g_m2: 210", f"density_g_m2: {density}"))
    infer.main([f"captures={tmp_path / 'root'}", f"out={tmp_path / 'out'}", "workers=1"])
    right, heavy = (content(tmp_path / "out" / name) for name in ("right", "heavy"))
    assert width(right) < 0.95 * width(plain) and len(right["captures"]) == 1
    assert "bending length [mm] warp: 28" in (tmp_path / "out/right/index.html").read_text()
    assert heavy["moduli"] == plain["moduli"]
    lost, = (found["text"] for found in heavy["warnings"] if found["code"] == "known_lost")
    assert "heavy/b, which is refused, is left out: captures and strips of one fabric" in lost


def test_a_fabric_is_estimated_without_a_face_that_is_refused(tmp_path, plain, capsys):
    up, down = (capture(tmp_path / "twill" / name, known) for name, known in (
        ("up", None), ("down", RIGHT)))
    (down / "view_0.png").write_bytes(b"no picture")
    infer.main([f"capture={tmp_path / 'twill'}", f"out={tmp_path / 'out'}", "drapes=0"])
    found = content(tmp_path / "out")
    assert found["capture"]["sources"] == [str(up)] and width(found) < 0.95 * width(plain)
    line = f"this estimate is made without {down}, which is refused: "
    assert [one["code"] for one in found["warnings"]] == ["capture_refused"]
    assert f"warning: {line}" in capsys.readouterr().out
    assert texts(drapenet.estimate(tmp_path / "twill").warnings)[0].startswith(line)
    for words in ([f"capture=[{up},{down}]"], [f"capture={tmp_path / 'twill'}", "strict=true"]):
        with pytest.raises(InputError, match=r"view_0\.png cannot be read"):
            infer.main([*words, f"out={tmp_path / 'none'}", "drapes=0"])


def test_a_face_that_shows_no_drape_is_left_out_as_one_that_cannot_be_read(tmp_path, monkeypatch):
    _, down = (capture(tmp_path / "twill" / name) for name in ("up", "down"))
    file = down / "capture.yaml"  # other views, which are refused when they are observed
    file.write_text(file.read_text().replace("depth_unit_m: 0.001", "depth_unit_m: 0.00101"))
    true = Captured.observed

    def observed(seen):
        if seen.path == down:
            raise InputError("no drape is seen")
        return true(seen)

    monkeypatch.setattr(Captured, "observed", observed)
    line, = texts(drapenet.estimate(tmp_path / "twill").warnings)
    assert line == f"this estimate is made without {down}, which is refused: no drape is seen"
    with pytest.raises(InputError, match="no drape is seen"):
        drapenet.estimate(tmp_path / "twill" / "up", down)


def test_parts_are_made_again_only_when_what_they_are_made_from_changes(tmp_path):
    sources = [capture(tmp_path / "a", RIGHT), strips(tmp_path / "b", warp=[28.0, 29.0])]
    words = [f"capture={sources[0]}", f"strips={sources[1]}", f"out={tmp_path / 'o'}", "drapes=0"]
    infer.main(words)
    files = [tmp_path / "o" / name / "samples.npz" for name in ("capture_0", "strips_1")]
    made = [file.stat().st_mtime_ns for file in files]
    first = (tmp_path / "o" / "estimate.json").read_bytes()
    infer.main(words)
    assert [file.stat().st_mtime_ns for file in files] == made
    assert (tmp_path / "o" / "estimate.json").read_bytes() == first
    files[0].write_bytes(files[0].read_bytes()[:-100])  # a damaged part is made again
    strips(tmp_path / "c", warp=[28.0, 29.5])
    shutil.copy(tmp_path / "c" / "strips.yaml", sources[1] / "strips.yaml")
    infer.main(words)
    assert [file.stat().st_mtime_ns > before for file, before in zip(files, made, strict=True)] == [
        True, True]
    assert medians(content(tmp_path / "o")) != medians(json.loads(first))
    gone = Source(place=tmp_path / "gone")
    assert stored_part(gone, files[1].parent, "").estimate.constraint[0] < 0.3
    with pytest.raises(InputError, match="nothing is known"):
        estimate_fabric([], read_header(), EstimateOptions())


def test_values_are_stated_to_python_as_in_the_files(tmp_path):
    known = RIGHT | {"drape_coefficient_percent": 55.0}
    stated = capture(tmp_path / "stated", known)
    plain, photograph = (read_capture(TWILL.with_name(name))
                         for name in ("twill", "twill_photograph"))
    for others in ((), (photograph,)):
        found = drapenet.estimate(TWILL, *others, known=known)
        by_file = drapenet.estimate(stated, *others)
        np.testing.assert_array_equal(found.samples, by_file.samples)
    assert found.samples.std(axis=0)[0] < drapenet.estimate(plain).samples.std(axis=0)[0]
    found = drapenet.estimate(read_capture(stated))
    of_arrays = drapenet.estimate(plain, known=known)
    np.testing.assert_array_equal(of_arrays.samples, found.samples)
    lengths = {"warp": [28.0, 29.0]}
    np.testing.assert_array_equal(
        drapenet.estimate(strips=strips(tmp_path / "plain", **lengths), known=RIGHT).samples,
        drapenet.estimate(strips=strips(tmp_path / "known", RIGHT, **lengths)).samples)


@pytest.mark.parametrize(("sources", "known", "word"), [
    (("stated",), RIGHT, r"known is in .*stated and an argument; give the values in one"),
    (("a",), {"bending_lenght_mm": 20}, "unknown key 'known.bending_lenght_mm'; known has values"),
    (("a",), {"bending_length_mm": {"warp": "22 mm"}}, "'22 mm' is not a number"),
    (("a",), {"bending_length_mm": {"warp": -22.0}}, "known.bending_length_mm.warp=-22"),
    (("a",), 22.0, "known=22"),
    ((), {"drape_coefficient_percent": 50}, "unknown key 'known.drape_")])
def test_values_that_files_may_not_state_are_refused(tmp_path, sources, known, word):
    capture(tmp_path / "a")
    capture(tmp_path / "stated", RIGHT)
    strips(tmp_path / "strips", warp=[28.0])
    with pytest.raises(InputError, match=word):
        drapenet.estimate(*(tmp_path / name for name in sources), strips=tmp_path / "strips",
                          known=known)


def test_two_captures_that_contradict_each_other_leave_both_possible(tmp_path, plain, monkeypatch):
    """The second is the first as of a fabric of a fifth of the stiffness."""
    parts = [stages.by_network(read_capture(capture(tmp_path / name)), read_header())
             for name in ("a", "b")]
    true = inferring.predict
    changed = id(parts[1].observed.seen.map)

    def predict(network, header, sets):
        found = true(network, header, sets)
        for place, members in enumerate(sets):
            share = sum(id(one.map) == changed for one in members) / len(members)
            theta = found[place].cloth.theta.copy()
            theta[:, :3] -= np.log(5.0) * share
            found[place] = Draws(replace(found[place].cloth, theta=theta), True, 0.0)
        return found

    monkeypatch.setattr(inferring, "predict", predict)
    draws, contradictions = inferring.infer_jointly(
        [inferring.CaptureEvidence(name, part.observed.seen) for name, part in
         zip("ab", parts, strict=True)], read_header())
    estimate = combine(draws, [], 0.21, read_header(), name="the captures",
                       contradictions=contradictions)
    line, = texts(estimate.contradictions)
    assert "contradicts" in line and "the estimate holds for either" in line
    low, high = 1e6 * np.quantile(estimate.moduli()[0][:, 0], [0.1, 0.9])
    median = plain["moduli"]["warp"]["alpha_uN_m"]["median"]
    assert low < 0.4 * median and high > 0.9 * median


def test_a_stage_that_fails_leaves_its_traceback(tmp_path, monkeypatch):
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("of a fault")

    monkeypatch.setattr(stages, "simulate", broken)
    words = [f"capture={TWILL}", f"out={tmp_path}", "drapes=1"]
    with pytest.raises(ZeroDivisionError):
        infer.main(words)  # tests see faults of the program
    monkeypatch.delenv(stages.RAISE)
    infer.main(words)
    line, = (found["text"] for found in content(tmp_path)["warnings"])
    assert "ZeroDivisionError, of a fault; please report it with the file faults.txt" in line
    assert "in broken" in (tmp_path / FAULTS).read_text()


def test_a_photograph_is_a_copy_whatever_is_stated_with_it(tmp_path):
    first, second = (shutil.copytree(TWILL.parent / "twill_photograph", tmp_path / name)
                     for name in ("first", "second"))
    file = second / "capture.yaml"
    described = yaml.safe_load(file.read_text())
    described["outline"]["plate_height_mm"] += 40
    file.write_text(yaml.safe_dump(described))
    captures = [read_capture(folder) for folder in (first, second)]
    assert captures[0].digest != captures[1].digest  # the curves differ
    with pytest.raises(InputError, match=r"first and .*second have the same views"):
        drapenet.estimate(*captures)
