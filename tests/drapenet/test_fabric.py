"""The estimate of a fabric from all its sources: the same by every door, and what it says."""

import contextlib
import csv
import io
import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml
from fastapi.testclient import TestClient
from PIL import Image
from services import BreakablePool, settings_for
from workbooks import cells

import drapenet
import infer
from common.errors import InputError
from common.findings import texts
from data.captures.reader import read_capture
from data.readings import QUANTITIES
from drapenet.config import EstimateOptions
from drapenet.fabric import infer as inferring
from drapenet.fabric import many, stages
from drapenet.fabric.combine import combine
from drapenet.fabric.estimate import FabricResult, estimate_fabric
from drapenet.fabric.part import stored_part
from drapenet.fabric.sources import Source, sources_of
from drapenet.measured.captures import Captured
from drapenet.network.checkpoint import read_header
from drapenet.network.inputs import Stated
from drapenet.network.predict import Draws
from drapenet.service import pools, work
from drapenet.service.app import create_app

EXAMPLES = Path(__file__).parents[2] / "examples"
TWILL, PHOTOGRAPH = (EXAMPLES / "captures" / name for name in ("twill", "twill_photograph"))
RIGHT = {"bending_length_mm": {"warp": 28.0, "weft": 19.5}}
EXCHANGED = {"bending_length_mm": {"warp": 17.0, "weft": 31.0}}
STRIP = {"direction": "warp", "width_mm": 50}
BIAS = STRIP | {"direction": "bias", "gauge_mm": 100, "load_g": 50, "extension_mm": 4.1}
WARP = STRIP | {"gauge_mm": 200, "load_g": 500, "extension_mm": 4.2}
HEAVIER = BIAS | {"load_g": 1000, "extension_mm": 8}  # which contradicts the other one


def capture(folder: Path, known: dict | None = None) -> Path:
    """A copy of the bundled capture, with what is known of it."""
    shutil.copytree(TWILL, folder)
    if known:
        with (folder / "capture.yaml").open("a") as file:
            yaml.safe_dump({"known": known}, file)
    return folder


def changed(folder: Path, old: str, new: str) -> Path:
    """A capture with other words in its description."""
    file = folder / "capture.yaml"
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new))
    return folder


def strips(
    folder: Path, known: dict | None = None, labels: dict | None = None, **lengths: list[float]
) -> Path:
    """A folder with bending lengths in mm by direction, read on either face."""
    folder.mkdir(parents=True, exist_ok=True)
    entries = [{"direction": name, "bending_length_mm": value, "face": face}
               for name, values in lengths.items() for value in values for face in ("up", "down")]
    (folder / "strips.yaml").write_text(yaml.safe_dump(
        {"density_g_m2": 210, "strips": entries, **(labels or {})}
        | ({"known": known} if known else {})))
    return folder


def weighted(folder: Path, *entries: dict) -> Path:
    """A folder with strips under weights."""
    folder.mkdir(parents=True)
    (folder / "tension.yaml").write_text(yaml.safe_dump(
        {"density_g_m2": 210, "tension": list(entries)}))
    return folder


def estimated(*captures: Path, strict: bool = False, folder: Path | None = None, **stated: object
              ) -> FabricResult:
    """The estimate from captures, and from what else is ``stated``, by the bundled network."""
    return estimate_fabric(sources_of(captures, **stated), read_header(),
                           EstimateOptions(drapes=0, strict=strict), folder=folder)


def content(folder: Path) -> dict:
    return json.loads((folder / "estimate.json").read_text())


def codes(found: FabricResult) -> list[str]:
    return [one.code for one in found.document.warnings]


def median(found: FabricResult) -> float:
    return found.document.moduli["warp"].alpha_uN_m.median


def width(found: FabricResult, name: str = "warp") -> float:
    low, high = found.document.moduli[name].alpha_uN_m.interval_68
    return high / low


@pytest.fixture(scope="module")
def plain() -> FabricResult:
    """The estimate of the bundled capture."""
    return estimated(TWILL)


# --- One fabric by every door -----------------------------------------------------------------


@pytest.fixture(scope="module")
def fabric(tmp_path_factory) -> Path:
    """A folder with two photographs, views and a copy of them, strips, strips under weights, and a
    capture that is refused but states a value of the fabric."""
    root = tmp_path_factory.mktemp("root") / "twill"
    for name, source in (("b_photograph", PHOTOGRAPH), ("c_photograph", PHOTOGRAPH),
                         ("y_tension", EXAMPLES / "tension" / "twill")):
        shutil.copytree(source, root / name)
    with Image.open(PHOTOGRAPH / "outline.jpg") as picture:  # another picture of the same drape
        picture.save(root / "c_photograph" / "outline.jpg", quality=80, exif=picture.getexif())
    for name, known in (("a_views", None), ("d_copy", None),
                        ("e_refused", {"bending_length_mm": {"warp": 27.0}})):
        capture(root / name, known)
    (root / "e_refused" / "view_2.png").unlink()
    strips(root / "x_strips", warp=[28.0], weft=[19.5])
    return root


def of_command(fabric: Path) -> dict[str, object]:
    return {"strips": fabric / "x_strips", "tension": fabric / "y_tension"}


@pytest.fixture(scope="module")
def commanded(fabric, tmp_path_factory) -> tuple[Path, str]:
    """The results of the command, and what it prints."""
    out = tmp_path_factory.mktemp("command")
    words = [f"{key}={place}" for key, place in of_command(fabric).items()]
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        infer.main([f"capture={fabric}", *words, f"out={out}", "drapes=0"])
    return out, printed.getvalue()


@pytest.fixture(scope="module")
def batched(fabric, tmp_path_factory) -> Path:
    """The results of a batch, in which there are also fabrics of strips alone."""
    out = tmp_path_factory.mktemp("batch")
    strips(fabric.parent / "lengths" / "only", labels={"fabric": "Twill 7"}, warp=[22.0])
    weighted(fabric.parent / "denim" / "strips", BIAS, WARP)
    weighted(fabric.parent / "wrong" / "strips", BIAS, HEAVIER)
    infer.main([f"captures={fabric.parent}", f"out={out}", "workers=1"])
    return out


def assert_same(found: dict, commanded: dict, root: Path) -> None:
    """Documents are equal but for paths and the name of the fabric."""
    found, expected = (json.loads(json.dumps(document).replace(f"{root}/", ""))
                       for document in (found, commanded))
    for document in (found, expected):
        for part in (document, *document["captures"]):
            part["capture"].pop("labels", None)
    assert found == expected


def test_the_command_says_what_is_joined_and_left_out(commanded, fabric):
    out, printed = commanded
    assert "joint estimate of 3 captures" in printed and "4 strips" in printed
    found, refused = content(out), fabric / "e_refused"
    assert [one["code"] for one in found["warnings"]].count("twin_left_out") == 1
    line, = (one["text"] for one in found["warnings"] if one["code"] == "capture_refused")
    assert line.startswith(f"this estimate is made without {refused}, which is refused: ")
    assert f"warning: {line}" in printed
    assert len(found["captures"]) == 3 and len(found["strips"]) == 1
    assert found["capture"]["rig"] == "square300_cylinder100, disc300_support180"
    assert found["strips"][0]["strips"] == 4
    assert found["measured"][0]["known"]["bending_length_mm"]["warp"] == 27.0
    alone = content(out / "strips_5")
    assert "captures" not in alone and alone["strips"] == found["strips"][:1]


def test_a_batch_gives_the_same_estimate(batched, commanded, fabric):
    assert_same(content(batched / "twill"), content(commanded[0]), fabric.parent)


def test_pages_and_tables_of_a_batch_tell_of_strips_and_values(batched):
    pages = {name: (batched / name / "index.html").read_text("utf-8")
             for name in ("twill", "lengths")}
    assert "4 hanging strips alone" in pages["twill"] and "face on top" in pages["twill"]
    assert "bending length [mm] warp: 27" in pages["twill"]
    assert "face on top" not in pages["lengths"]
    assert content(batched / "lengths")["capture"]["labels"]["fabric"] == "Twill 7"
    rows = {row["fabric"]: row for row in csv.DictReader(
        (batched / "fabrics.csv").read_text("utf-8-sig").splitlines())}
    assert len(rows) == 4 and "contradict each other" in rows["wrong"]["flags"]
    tension = content(batched / "denim")["tension"]
    warp, shear = (tension[f"{name}_n_per_m"] for name in ("stretch", "shear"))
    row = rows["denim"]
    assert float(row["stretch_warp_n_per_m"]) == pytest.approx(warp["warp"]["median"], rel=1e-5)
    assert float(row["shear_n_per_m_high68"]) == pytest.approx(shear["interval_68"][1], rel=1e-5)
    assert row["stretch_weft_n_per_m"] == ""  # not measured
    sheet = [line.get("stretch, of bias: shear median [N/m]")
             for line in cells(batched / "results.xlsx", 1) if line["fabric"] == "denim"]
    assert sheet == [pytest.approx(warp["warp"]["median"]), pytest.approx(shear["median"]), None]


def test_the_service_gives_the_same_estimate(commanded, fabric, tmp_path, monkeypatch):
    """By the tasks of its workers, in this process and without drapes."""
    monkeypatch.setattr(work, "EstimateOptions", partial(EstimateOptions, drapes=0))
    monkeypatch.setattr(pools, "ProcessPool", BreakablePool)
    kept = {"name": fabric.name}
    app = create_app(settings_for(tmp_path, "queue=9", "queue_each=9"))
    with TestClient(app, base_url="http://localhost") as client:
        for place in sorted(fabric.iterdir()):
            files = [("files", (file.name, file.read_bytes())) for file in place.iterdir()
                     if file.name != "truth.json"]
            begun = client.post("/estimates", files=files, data=kept | {"label": place.name}).json()
            kept = {"fabric": begun["fabric"]}
            work.work(tmp_path / begun["id"], "", "")
            shutil.rmtree(tmp_path / begun["id"] / "uploaded")
        app.state.jobs._join(begun["fabric"])
        rows = client.get(f"/fabrics/{begun['fabric']}").json()["estimates"]
        joint = next(row["id"] for row in rows if row["members"])
        work.work(tmp_path / joint, "", "")
        assert client.get(f"/estimates/{joint}").json()["error"] is None
    assert_same(content(tmp_path / joint), content(commanded[0]), fabric.parent)


def test_python_gives_the_same_estimate(commanded, fabric):
    found = drapenet.estimate(fabric, **of_command(fabric))
    loaded = drapenet.load(commanded[0])
    np.testing.assert_array_equal(found.samples, loaded.samples)
    assert found.warnings == loaded.warnings and len(found.captures) == len(loaded.captures) == 3


# --- What an estimate says --------------------------------------------------------------------


def test_right_values_narrow_and_wrong_ones_are_named_and_change_nothing(tmp_path, plain):
    right = estimated(capture(tmp_path / "right", RIGHT))
    wrong = estimated(capture(tmp_path / "wrong", EXCHANGED)).document
    assert not right.document.warnings and width(right) < 0.95 * width(plain)
    assert wrong.moduli == plain.document.moduli and wrong.capture.known
    assert [one.values["label"] for one in wrong.warnings] == [
        "the known bending length [mm] warp = 17", "the known bending length [mm] weft = 31"]
    assert wrong.warnings[0].text.startswith(
        "the known bending length [mm] warp = 17 contradicts the capture: they say ")
    with pytest.raises(InputError, match="refused because strict=true: the known bending length"):
        estimated(tmp_path / "wrong", strict=True, folder=tmp_path / "strict")
    assert not (tmp_path / "strict" / "estimate.json").exists()


def test_strips_narrow_are_enough_alone_or_contradict(tmp_path, plain):
    joint = estimated(TWILL, strips=strips(
        tmp_path / "a", warp=[27.0, 29.0, 31.0], weft=[18, 20, 19.0]))
    assert not joint.document.warnings and joint.document.strips[0].strips == 12
    assert width(joint) < width(plain) ** 0.8 and width(joint, "bias") < width(plain, "bias")
    alone = estimated(strips=strips(tmp_path / "b", warp=[22.0], weft=[25.0]))
    values = estimated(strips=strips(
        tmp_path / "c", {"kes_b_gf_cm2_per_cm": {"warp": 0.2, "weft": 0.1}}))
    assert width(alone) < 1.6 < width(values, "bias")
    low, high = alone.document.laboratory["warp"].bending_length_mm.interval_68
    assert low < 22 < high < 25
    assert QUANTITIES["kes_b_gf_cm2_per_cm"].of(values.estimate.cloth, values.estimate.density)[
        :, 0].mean() == pytest.approx(0.2, rel=0.15)
    other = estimated(TWILL, strips=strips(tmp_path / "d", warp=[60.0, 61.0]))
    assert median(other) == pytest.approx(median(plain), rel=1e-9)
    first, *others = texts(other.document.warnings)
    assert first.startswith("the strips along the warp contradict the capture: alpha is ")
    assert all("by itself" in line for line in others)


def test_strips_under_weights_say_nothing_of_bending(tmp_path, plain):
    alone = estimated(tension=weighted(tmp_path / "a", BIAS, WARP)).document.tension
    both = estimated(TWILL, tension=tmp_path / "a")
    assert both.document.tension == alone and both.estimate.names == ("warp", "bias", "weft")
    assert median(both) == pytest.approx(median(plain), rel=0.01)
    wrong = {"tension": weighted(tmp_path / "b", BIAS, HEAVIER)}
    assert codes(estimated(**wrong)) == ["tension_differs"]
    with pytest.raises(InputError, match="contradict each other"):
        estimated(**wrong, strict=True)


def test_what_is_along_the_yarns_needs_a_marked_warp(tmp_path):
    unmarked = tmp_path / "unmarked"
    unmarked.mkdir()
    (unmarked / "capture.yaml").write_text(
        "density_g_m2: 210\ntester: disc300_support180\nknown: {drape_coefficient_percent: 50}\n")
    bias, warp = (weighted(tmp_path / entry["direction"], entry) for entry in (BIAS, WARP))
    lengths = strips(tmp_path / "lengths", warp=[28.0])
    along, across = (strips(tmp_path / name, known) for name, known in (
        ("along", RIGHT), ("across", {"membrane_n_per_m": 600.0})))
    for allowed in ({"tension": bias}, {"strips": across}):
        assert estimated(unmarked, **allowed).estimate.names[0] == "stiff"
    for refused, said in (({"tension": warp}, "strips"), ({"strips": lengths}, "strips"),
                          ({"strips": along}, "known values")):
        with pytest.raises(InputError, match=f"{said} along the yarns need .*warp_direction_deg"):
            estimated(unmarked, **refused)


def test_what_a_refused_capture_states_is_kept_if_it_is_of_the_fabric(tmp_path, plain):
    found = {}
    for name, density in (("right", 210), ("heavy", 300)):
        capture(tmp_path / name / "a")
        refused = changed(capture(tmp_path / name / "b", RIGHT), "density_g_m2: 210",
                          f"density_g_m2: {density}")
        (refused / "view_0.png").write_bytes(b"no picture")
        found[name] = estimated(tmp_path / name)
    right, heavy = found["right"], found["heavy"]
    assert width(right) < 0.95 * width(plain) and codes(right) == ["capture_refused"]
    assert right.document.capture.sources == [str(tmp_path / "right" / "a")]
    assert heavy.document.moduli == plain.document.moduli
    lost, = (one.text for one in heavy.document.warnings if one.code == "known_lost")
    assert "heavy/b, which is refused, is left out: captures and strips of one fabric" in lost
    named = [tmp_path / "right" / name for name in "ab"]
    for places, strict in ((named, False), ([tmp_path / "right"], True)):
        with pytest.raises(InputError, match=r"view_0\.png cannot be read"):
            estimated(*places, strict=strict)


def test_a_face_that_shows_no_drape_is_left_out_as_one_that_cannot_be_read(tmp_path, monkeypatch):
    _, down = (capture(tmp_path / "twill" / name) for name in ("up", "down"))
    # Other views, which are refused when they are observed.
    changed(down, "depth_unit_m: 0.001", "depth_unit_m: 0.00101")
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


def test_densities_of_one_fabric_may_not_differ_much(tmp_path):
    lengths = strips(tmp_path / "strips", warp=[28.0])
    density = "density_g_m2: 210"
    nearly, heavy = (changed(capture(tmp_path / name), density, f"density_g_m2: {value}")
                     for name, value in (("a", 216), ("b", 232)))
    assert codes(estimated(nearly, strips=lengths)) == ["densities_differ"]
    with pytest.raises(InputError, match=r"from 210 \(.*strips\) to 232 g/m² \(.*b\), more than"):
        estimated(heavy, strips=lengths)


def test_parts_are_made_again_only_when_what_they_are_made_from_changes(tmp_path):
    lengths = strips(tmp_path / "b", warp=[28.0, 29.0])
    out = tmp_path / "o"
    make = partial(estimated, capture(tmp_path / "a", RIGHT), strips=lengths, folder=out)
    first = make()
    files = [out / name / "samples.npz" for name in ("capture_0", "strips_1")]

    def times() -> Sequence[int]:
        return [file.stat().st_mtime_ns for file in files]

    made, written = times(), (out / "estimate.json").read_bytes()
    make()
    assert times() == made and (out / "estimate.json").read_bytes() == written
    files[0].write_bytes(files[0].read_bytes()[:-100])  # a damaged part is made again
    make()
    assert [now > before for now, before in zip(times(), made, strict=True)] == [True, False]
    repaired = times()
    files[0].with_name("observation.npz").unlink()  # and so is an incomplete one
    make()
    assert times()[0] > repaired[0] and (out / "estimate.json").read_bytes() == written
    strips(lengths, warp=[28.0, 29.5])
    again = make()
    assert all(now > before for now, before in zip(times(), made, strict=True))
    assert median(again) != median(first)
    gone = Source(place=tmp_path / "gone")
    assert stored_part(gone, files[1].parent, "").estimate.constraint["alpha warp"] < 0.3
    with pytest.raises(InputError, match="nothing is known"):
        estimate_fabric([], read_header(), EstimateOptions())


def test_a_strict_batch_lists_what_it_refuses_and_estimates_the_fabric_from_the_rest(tmp_path):
    root, out = tmp_path / "root", tmp_path / "out"
    strips(root / "twill" / "a", warp=[28.0, 29.0])
    strips(root / "twill" / "b", {"bending_length_mm": {"warp": 12.0}}, warp=[28.0, 29.0])
    for strict in ("true", "false"):
        infer.main([f"captures={root}", f"out={out}", "workers=1", f"strict={strict}"])
        failures = (out / "failures.csv").read_text("utf-8-sig").splitlines()[1:]
        assert len(failures) == (strict == "true")
        found = [one["code"] for one in content(out / "twill")["warnings"]]
        assert ("capture_refused" in found) == (strict == "true")


def test_a_fault_of_the_program_costs_a_batch_one_capture(tmp_path, monkeypatch):
    root, out = tmp_path / "root", tmp_path / "out"
    for name in ("a", "b"):
        strips(root / "twill" / name, warp=[28.0, 29.0])
    made = many.make_in_folder

    def faulty(source: Source, folder: Path, *settings: object) -> str:
        return 1 // 0 if folder.name == "b" else made(source, folder, *settings)

    monkeypatch.setattr(many, "make_in_folder", faulty)
    infer.main([f"captures={root}", f"out={out}", "workers=1"])
    row, = (out / "failures.csv").read_text("utf-8-sig").splitlines()[1:]
    assert "ZeroDivisionError" in row and "please report it" in row
    assert content(out / "twill")["strips"][0]["strips"] == 4


def test_a_photograph_is_a_copy_whatever_is_stated_with_it(tmp_path):
    first, second = (shutil.copytree(PHOTOGRAPH, tmp_path / name) for name in ("first", "second"))
    file = second / "capture.yaml"
    described = yaml.safe_load(file.read_text())
    described["outline"]["plate_height_mm"] += 40
    file.write_text(yaml.safe_dump(described))
    captures = [read_capture(folder) for folder in (first, second)]
    assert captures[0].digest != captures[1].digest  # the curves differ
    with pytest.raises(InputError, match=r"first and .*second have the same views"):
        drapenet.estimate(*captures)


def test_two_captures_that_contradict_each_other_leave_both_possible(tmp_path, plain, monkeypatch):
    """The second is the first as of a fabric of a fifth of the stiffness."""
    parts = [stages.by_network(read_capture(capture(tmp_path / name)), read_header())
             for name in ("a", "b")]
    true = inferring.predict
    softer = id(parts[1].observed.seen.map)

    def predict(network, header, sets, stated):
        found = true(network, header, sets, stated)
        for place, members in enumerate(sets):
            share = sum(id(one.map) == softer for one in members) / len(members)
            theta = found[place].cloth.theta.copy()
            theta[:, :3] -= np.log(5.0) * share
            found[place] = Draws(replace(found[place].cloth, theta=theta), True, 0.0)
        return found

    monkeypatch.setattr(inferring, "predict", predict)
    draws, contradictions = inferring.infer_jointly(
        [inferring.CaptureEvidence(name, part.observed.seen) for name, part in
         zip("ab", parts, strict=True)], read_header(), Stated())
    estimate = combine(draws, [], 0.21, read_header(), name="the captures",
                       contradictions=contradictions)
    line, = texts(estimate.contradictions)
    assert "contradicts" in line and "the estimate holds for either" in line
    low, high = 1e6 * np.quantile(estimate.moduli()[0][:, 0], [0.1, 0.9])
    assert low < 0.4 * median(plain) and high > 0.9 * median(plain)


# --- What Python offers -----------------------------------------------------------------------


def test_values_are_stated_to_python_as_in_the_files(tmp_path, plain):
    known = RIGHT | {"drape_coefficient_percent": 55.0}
    stated = capture(tmp_path / "stated", known)
    photograph = read_capture(PHOTOGRAPH)
    lengths = {"warp": [28.0, 29.0]}
    for given, by_file in (
            (drapenet.estimate(TWILL, photograph, known=known),
             drapenet.estimate(stated, photograph)),
            (drapenet.estimate(read_capture(TWILL), known=known),
             drapenet.estimate(read_capture(stated))),
            (drapenet.estimate(strips=strips(tmp_path / "plain", **lengths), known=RIGHT),
             drapenet.estimate(strips=strips(tmp_path / "known", RIGHT, **lengths)))):
        np.testing.assert_array_equal(given.samples, by_file.samples)
        assert given.samples.std(axis=0)[0] < plain.estimate.samples.std(axis=0)[0]


@pytest.mark.parametrize(("sources", "known", "word"), [
    (("stated",), RIGHT, r"known is in .*stated and an argument; give the values in one"),
    (("a",), {"bending_lenght_mm": 20}, "unknown key 'known.bending_lenght_mm'; known has values"),
    (("a",), 22.0, "known=22"),
    ((), {"drape_coefficient_percent": 50}, "unknown key 'known.drape_")])
def test_values_that_files_may_not_state_are_refused(tmp_path, sources, known, word):
    capture(tmp_path / "a")
    capture(tmp_path / "stated", RIGHT)
    strips(tmp_path / "strips", warp=[28.0])
    with pytest.raises(InputError, match=word):
        drapenet.estimate(*(tmp_path / name for name in sources), strips=tmp_path / "strips",
                          known=known)


def test_a_capture_of_arrays_is_estimated_as_that_of_its_folder_and_checked(plain):
    arrays = read_capture(TWILL)
    np.testing.assert_allclose(np.median(drapenet.estimate(arrays).samples, 0),
                               np.median(plain.estimate.samples, 0), atol=0.02)
    with pytest.raises(InputError, match="density=210 is more than 1 kg/m²"):
        drapenet.estimate(replace(arrays, density=210.0))


def test_captures_of_a_loaded_estimate_are_in_order_also_from_the_tenth_on(
        untrained_checkpoint, tmp_path):
    stated = list(range(30, 41))
    for k, percent in enumerate(stated):
        (tmp_path / "fabric" / str(k)).mkdir(parents=True)
        (tmp_path / "fabric" / str(k) / "capture.yaml").write_text(
            "density_g_m2: 150\ntester: disc300_support180\n"
            f"known: {{drape_coefficient_percent: {percent}}}\n")
    infer.main([f"capture={tmp_path / 'fabric'}", f"out={tmp_path / 'out'}", "drapes=0",
                f"checkpoint={untrained_checkpoint}"])
    assert [round(100 * seen.coefficient) for seen in drapenet.load(tmp_path / "out").captures
            ] == stated
