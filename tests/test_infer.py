"""infer.py as a user runs it: good captures, and every kind of bad one."""

import json
import math
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from checkpoints import change_description
from cloths import capture_views
from PIL import Image
from words import last

import infer
from common.cli import run_command
from common.errors import InputError
from data.captures.capture import captures_in, read_capture, write_capture
from data.render.cameras import Intrinsics
from drapenet.network.checkpoint import load_model, read_header
from sim.drape import drape
from sim.material import DIRECTIONS, MICRO, is_admissible
from sim.rig import SQUARE_RIG

SHARED = Path(__file__).parents[2] / "shared" / "captures"


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """A sound capture, which a test may spoil."""
    views, intrinsics = capture_views(orientation=0.4)
    folder = tmp_path / "capture"
    write_capture(folder, views=views, intrinsics=intrinsics, density=0.15, rig=SQUARE_RIG,
                  warp_direction=0.4)
    return folder


@pytest.fixture
def checkpoint(untrained_checkpoint: Path, tmp_path: Path) -> Path:
    """A checkpoint, which a test may spoil."""
    folder = tmp_path / "checkpoint"
    folder.mkdir()
    return Path(shutil.copy(untrained_checkpoint, folder / "net.safetensors"))


def words(capture: Path, checkpoint: Path, *more: str) -> list[str]:
    return last(f"capture={capture}", f"checkpoint={checkpoint}", f"out={capture.parent / 'out'}",
            *more)


def test_the_same_views_twice_are_not_two_captures(
    capture: Path, checkpoint: Path, tmp_path: Path
) -> None:
    copy = shutil.copytree(capture, tmp_path / "copy")
    for second in (capture, copy):
        with pytest.raises(InputError, match=f"{capture} and {second} have the same views"):
            infer.main(last(f"capture=[{capture},{second}]", f"checkpoint={checkpoint}",
                            f"out={tmp_path / 'out'}"))


def test_a_doubtful_capture_is_refused_where_that_is_wanted(
    capture: Path, checkpoint: Path, tmp_path: Path
) -> None:
    first, second = capture / "view_1.png", capture / "view_2.png"
    first.rename(capture / "other.png")
    second.rename(first)
    (capture / "other.png").rename(second)
    with pytest.raises(InputError) as refusal:
        infer.main(words(capture, checkpoint, "strict=true"))
    infer.main(words(capture, checkpoint, "drapes=0", f"out={tmp_path / 'doubted'}"))
    content = json.loads((tmp_path / "doubted" / "estimate.json").read_text())
    assert len(content["warnings"]) > 1
    assert str(refusal.value).endswith("; strict=false estimates it with a warning")
    assert "refused because strict=true: " in str(refusal.value)
    assert all(line in str(refusal.value) for line in content["warnings"])
    assert not (capture.parent / "out" / "estimate.json").exists()


def test_exports_stand_beside_the_estimate(capture: Path, checkpoint: Path) -> None:
    infer.main(words(capture, checkpoint, "drapes=0", "export=jfab,torque"))
    names = {file.name for file in (capture.parent / "out").iterdir()}
    assert names == {"estimate.json", "fabric.jfab", "torque.csv"}
    with pytest.raises(InputError, match="export=zfab: unknown"):
        infer.main(words(capture, checkpoint, "export=zfab"))


def spoil_yaml(**changes: object) -> Callable[[Path, Path], None]:
    def change(capture: Path, _: Path) -> None:
        file = capture / "capture.yaml"
        content = yaml.safe_load(file.read_text()) | changes
        file.write_text(yaml.safe_dump({k: v for k, v in content.items() if v is not None}))
    return change


def spoil_header(**changes: object) -> Callable[[Path, Path], None]:
    return lambda _, checkpoint: change_description(checkpoint, **changes)


def spoil_view(action: Callable[[Path], object]) -> Callable[[Path, Path], None]:
    return lambda capture, _: action(capture / "view_2.png")


def save(size: tuple[int, int]) -> Callable[[Path], None]:
    return lambda file: Image.fromarray(np.zeros(size, np.uint16)).save(file)


def truncate(file: Path) -> None:
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


BAD = {
    "missing view": (spoil_view(Path.unlink), "view_2.png"),
    "a gap in the views": (lambda c, _: (c / "view_3.png").rename(c / "view_5.png"),
                           "view_3.png"),
    "ninth view": (lambda c, _: [shutil.copy(c / "view_0.png", c / f"view_{k}.png")
                                 for k in range(4, 9)], "9 files"),
    "turns of other views": (spoil_yaml(turns_deg=[0, 90]), "turns_deg"),
    "copied view": (lambda c, _: shutil.copy(c / "view_0.png", c / "view_2.png"),
                    "view_0.png and view_2.png are the same picture"),
    "wrong size": (spoil_view(save((70, 90))), "90x70"),
    "all background": (spoil_view(save((90, 120))), "background"),
    "truncated PNG": (spoil_view(truncate), "view_2.png"),
    "text called png": (spoil_view(lambda f: f.write_text("not a picture")), "view_2.png"),
    "no tester": (spoil_yaml(tester=None), "states no tester; "),
    "a large specimen": (spoil_yaml(tester={"specimen": "disc", "size_mm": 500, "plate_mm": 180}),
                         "a specimen of 500 mm; give 200 to 400 mm"),
    "another tester than the network's": (
        spoil_yaml(tester="disc254_support127"),
        "the tester disc254_support127 but the checkpoint of square300_cylinder100"),
    "density NaN": (spoil_yaml(density_g_m2=math.nan), "density"),
    "density negative": (spoil_yaml(density_g_m2=-150), "density"),
    "density too small": (spoil_yaml(density_g_m2=9.9), "10-1000"),
    "density too large": (spoil_yaml(density_g_m2=1001), "10-1000"),
    "density missing": (spoil_yaml(density_g_m2=None), "density"),
    "density a word": (spoil_yaml(density_g_m2="heavy"), "density"),
    "folder missing": (lambda c, _: shutil.rmtree(c), "does not exist"),
    "intrinsics of another picture": (
        spoil_yaml(intrinsics={"fx": -1.0, "fy": 100.0, "cx": 59.5, "cy": 44.5}), "intrinsics"),
    "checkpoint of another rig": (spoil_header(rig="disc300_support180"), "disc300_support180"),
    "checkpoint of another schema": (spoil_header(schema_version=7), "schema_version=7 must be 3"),
    "checkpoint missing": (lambda _, f: f.unlink(), "no checkpoint file"),
    "checkpoint damaged": (lambda _, f: truncate(f), "copy it again"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_and_exit_code_2_and_no_file(
    capture: Path, checkpoint: Path, case: str, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
) -> None:
    spoil, message = BAD[case]
    spoil(capture, checkpoint)
    before = sorted(capture.parent.rglob("*"))
    monkeypatch.setattr(sys, "argv", ["infer.py", *words(capture, checkpoint)])
    with pytest.raises(SystemExit) as ending:
        run_command(infer.main)
    assert ending.value.code == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("error: ") and printed.err.count("\n") == 1
    assert message in printed.err
    assert sorted(capture.parent.rglob("*")) == before


def test_a_tester_without_a_network_is_refused_with_those_that_have_one(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    spoil_yaml(tester="disc240_support180")(capture, tmp_path)
    monkeypatch.setattr(sys, "argv", ["infer.py", f"capture={capture}", f"out={tmp_path / 'out'}"])
    with pytest.raises(SystemExit) as ending:
        run_command(infer.main)
    error = capsys.readouterr().err
    assert ending.value.code == 2 and error.count("\n") == 1
    assert "know disc300_support180 and square300_cylinder100: give checkpoint=FILE" in error


@pytest.mark.parametrize(("word", "message"), [
    ("drapes=9", "drapes=9"), ("colour=red", "colour"), ("drapes", "key=value"),
    ("edge_mm=0.3", "edge=0.3 mm"), ("capture=", "capture=DIR"), ("checkpoint=.", "checkpoint"),
    ("checkpoint=7", "no checkpoint file 7; "), ("refine=more", "refine=more"),
    ("refine=scan", "none or depth"), ("refine=depth refine.edge_mm=100", "edge=100 mm"),
    ("refine.starts=2", "refine.starts"),
    ("refine=depth refine.starts=0.5", "refine.starts=0.5 must be a positive whole number"),
    ("membrane_n_per_m=-1", "membrane_n_per_m=-1"),
    ("membrane_n_per_m=0", "membrane_n_per_m=0"),
    ("drapes=-1", "drapes=-1"), ("workers=0", "workers=0")])
def test_bad_words_are_one_line(
    capture: Path, checkpoint: Path, word: str, message: str, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
) -> None:
    monkeypatch.setattr(sys, "argv", ["infer.py", *words(capture, checkpoint, *word.split())])
    with pytest.raises(SystemExit) as ending:
        run_command(infer.main)
    assert ending.value.code == 2
    assert message in capsys.readouterr().err
    assert not (capture.parent / "out").exists()


def test_a_bad_capture_is_told_before_torch_is_loaded(capture: Path, checkpoint: Path) -> None:
    (capture / "view_1.png").unlink()
    code = ("import sys, infer\ntry:\n    infer.main(sys.argv[1:])\n"
            "except ValueError as error:\n    print(error, 'torch' in sys.modules)")
    done = subprocess.run([sys.executable, "-c", code, *words(capture, checkpoint)],
                          capture_output=True, text=True, check=True,
                          cwd=Path(infer.__file__).parent)
    assert "view_1.png" in done.stdout and done.stdout.strip().endswith("False")


def test_the_bundled_capture_is_sound_and_its_truth_is_a_fabric() -> None:
    folder = Path(__file__).parents[1] / "examples" / "captures" / "twill"
    capture = read_capture(folder)
    assert not capture.warnings and capture.warp_direction is not None
    assert len(np.unique(capture.views)) > 100  # millimetres, not the steps of 8 bits
    truth = json.loads((folder / "truth.json").read_text())
    assert truth["density_g_m2"] == pytest.approx(capture.density * 1e3)
    alpha = np.array([truth["moduli"][name]["alpha_uN_m"] for name in DIRECTIONS])
    assert is_admissible(alpha * MICRO, np.zeros(3))


def test_help_says_how_to_call_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setattr(sys, "argv", ["infer.py", "--help"])
    with pytest.raises(SystemExit) as ending:
        infer.main()
    assert ending.value.code == 0
    assert "infer.py capture=DIR" in capsys.readouterr().out


def test_a_folder_is_named_as_it_is_written(
    capture: Path, checkpoint: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(capture.rename(capture.parent / "007").parent)
    infer.main(["capture=007", f"checkpoint={checkpoint}", "drapes=0"])
    assert (capture.parent / "outputs" / "infer" / "007" / "estimate.json").exists()


def test_the_estimate_of_another_capture_is_not_overwritten(
    capture: Path, checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for fabric in ("poplin", "denim"):
        shutil.copytree(capture, tmp_path / "raw" / fabric / "s1" / "c1")
    monkeypatch.chdir(tmp_path)
    more = [f"checkpoint={checkpoint}", "drapes=0"]
    for fabric in ("poplin", "denim"):
        infer.main([f"capture=raw/{fabric}/s1/c1", *more])
    found = sorted(tmp_path.glob("outputs/infer/*"))
    assert [one.name for one in found] == ["denim_s1_c1", "poplin_s1_c1"]
    kept = (found[1] / "estimate.json").read_bytes()
    with pytest.raises(InputError, match=r"holds the estimate of raw/poplin/s1/c1, which would "):
        infer.main(["capture=raw/denim/s1/c1", f"out={found[1]}", *more])
    assert (found[1] / "estimate.json").read_bytes() == kept
    (found[1] / "estimate.json").write_text("{")  # damaged: nobody's
    infer.main(["capture=raw/poplin/s1/c1", *more])
    assert (found[1] / "estimate.json").read_bytes() == kept


def test_captures_below_samples_are_found_and_fabrics_are_not_joined(tmp_path: Path) -> None:
    for place in ("poplin/s1/c1", "poplin/s1/c2", "poplin/s2/c1"):
        (tmp_path / place).mkdir(parents=True)
        (tmp_path / place / "capture.yaml").touch()
    fabric = tmp_path / "poplin"
    assert captures_in(fabric) == [fabric / "s1/c1", fabric / "s1/c2", fabric / "s2/c1"]
    assert captures_in(fabric / "s1") == [fabric / "s1/c1", fabric / "s1/c2"]
    assert captures_in(fabric / "s1" / "c1") == [fabric / "s1/c1"]
    with pytest.raises(InputError, match=r"looks like FABRIC/SAMPLE/CAPTURE .*: give captures="):
        captures_in(tmp_path)


def test_estimate_says_what_it_is(
    capture: Path, checkpoint: Path, capsys: pytest.CaptureFixture
) -> None:
    infer.main(words(capture, checkpoint, "drapes=0"))
    out = capture.parent / "out"
    assert [file.name for file in out.iterdir()] == ["estimate.json"]
    content = json.loads((out / "estimate.json").read_text())
    assert (content["schema"], content["schema_version"]) == ("drapenet-estimate", 2)
    assert content["capture"]["density_g_m2"] == 150
    assert list(content["moduli"]) == ["warp", "bias", "weft"]
    for name, own in content["moduli"].items():
        reference = content["moduli_at_300_g_m2"][name]
        for unit in ("alpha_uN_m", "beta_nN_m2"):
            assert own[unit]["median"] == pytest.approx(reference[unit]["median"] / 2)
            assert own[unit]["interval_90"][0] < own[unit]["interval_68"][0] < own[unit]["median"]
        assert 0.1 < own["alpha_uN_m"]["median"] < 1000  # µN·m of a fabric, not another unit
    assert content["checkpoint"]["sha256"] == read_header(checkpoint).sha256
    assert content["warp_axis"]["direction_deg"] == pytest.approx(math.degrees(0.4))
    assert content["capture"]["turns_deg"] == pytest.approx([0, 90, 180, 270], abs=1)
    assert "68 % interval" in capsys.readouterr().out


@pytest.mark.parametrize("turns", [[0], [0, 120, 240], [0, 45, 90, 180, 270]])
def test_a_capture_has_any_number_of_views(
    checkpoint: Path, tmp_path: Path, turns: list[float]
) -> None:
    views, intrinsics = capture_views(turns=np.radians(turns))
    write_capture(tmp_path / "capture", views=views, intrinsics=intrinsics, density=0.15,
                  rig=SQUARE_RIG, turns=np.radians(turns))
    infer.main(words(tmp_path / "capture", checkpoint, "drapes=1", "edge_mm=12"))
    content = json.loads((tmp_path / "out" / "estimate.json").read_text())
    assert content["capture"]["views"] == len(turns)
    assert content["capture"]["turns_deg"] == pytest.approx(turns, abs=2)
    assert (tmp_path / "out" / "report.png").exists()


def test_captures_of_one_fabric_give_one_estimate(
    checkpoint: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    for name, turn in (("a", 0.0), ("b", 1.0)):
        views, intrinsics = capture_views(orientation=turn)
        write_capture(tmp_path / "fabric" / name, views=views, intrinsics=intrinsics, density=0.15,
                      rig=SQUARE_RIG, warp_direction=turn)
    infer.main(words(tmp_path / "fabric", checkpoint, "drapes=0"))
    content = json.loads((tmp_path / "out" / "estimate.json").read_text())
    assert "joint estimate of 2 captures" in capsys.readouterr().out
    assert len(content["captures"]) == 2
    for k in range(2):
        alone = json.loads((tmp_path / "out" / f"capture_{k}" / "estimate.json").read_text())
        assert content["captures"][k]["moduli"] == alone["moduli"]
        one, both = (c["moduli"]["warp"]["alpha_uN_m"]["interval_68"] for c in (alone, content))
        assert math.log(both[1] / both[0]) < math.log(one[1] / one[0])
        assert {*alone} - {"resimulation"} <= {*content}
    file = tmp_path / "fabric" / "b" / "capture.yaml"
    changed = yaml.safe_load(file.read_text())
    file.write_text(yaml.safe_dump(changed | {"density_g_m2": 166.0}))
    with pytest.raises(InputError, match="densities from 150 to 166 g/m², more than 10% apart"):
        infer.main(words(tmp_path / "fabric", checkpoint, "drapes=0"))
    changed.pop("warp_direction_deg")
    file.write_text(yaml.safe_dump(changed))
    with pytest.raises(InputError, match="state warp_direction_deg, or none"):
        infer.main(words(tmp_path / "fabric", checkpoint, "drapes=0"))


def test_large_pictures_give_the_same_drape(checkpoint: Path, tmp_path: Path) -> None:
    """A picture four times as large is thinned out, not cut."""
    views, intrinsics = capture_views()
    large = np.repeat(np.repeat(views, 4, axis=1), 4, axis=2)
    more = {name: 4 * getattr(intrinsics, name) + (1.5 if name in ("cx", "cy") else 0)
            for name in ("fx", "fy", "cx", "cy")}
    write_capture(tmp_path / "capture", views=large, density=0.15, rig=SQUARE_RIG,
                  intrinsics=Intrinsics(**more, width=480, height=360))
    read = read_capture(tmp_path / "capture")
    assert read.views.shape == (4, 180, 240)
    assert (read.views > 0).mean() == pytest.approx((views > 0).mean(), rel=0.02)


def test_report_shows_a_drape_of_the_estimate(capture: Path, checkpoint: Path) -> None:
    infer.main(words(capture, checkpoint, "drapes=1", "edge_mm=12"))
    out = capture.parent / "out"
    content = json.loads((out / "estimate.json").read_text())
    assert content["resimulation"]["statuses"] == ["converged"]
    assert 0.3 < content["resimulation"]["silhouette_overlap"] <= 1
    with Image.open(out / "report.png") as picture:
        assert picture.size[0] > 1000
        assert np.asarray(picture.convert("L")).std() > 20  # not an empty page


@pytest.mark.parametrize("name", ["$a$ and $$", os.fsdecode(b"caf\xe9 \n")])
def test_a_report_that_fails_does_not_lose_the_estimate(
    capture: Path, checkpoint: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    capture = capture.rename(capture.with_name(name))
    given = words(capture, checkpoint, "drapes=1", "edge_mm=20")
    infer.main(given)
    out = capture.parent / "out"
    assert (out / "report.html").exists() and (out / "report.png").exists()

    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("no\nfont")

    monkeypatch.setattr("drapenet.report.figures.draw_report", fail)
    infer.main(given)
    content = json.loads((out / "estimate.json").read_text())
    assert content["capture"]["source"] == str(capture)
    assert content["warnings"][-1] == "there is no report: RuntimeError, no font"
    assert [file.name for file in out.iterdir()] == ["estimate.json"]


def test_refinement_says_what_has_changed(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    folder = Path(__file__).parents[1] / "examples" / "captures" / "twill"
    infer.main([f"capture={folder}", f"out={tmp_path / 'out'}", "refine=depth", "refine.edge_mm=4"])
    content = json.loads((tmp_path / "out" / "estimate.json").read_text())
    refined = content["refined"]
    assert refined["misfit"] <= refined["misfit_before"]
    assert refined["specimen"]["membrane_n_per_m"]["median"] > 50
    truth = json.loads((folder / "truth.json").read_text())["moduli"]
    for name, moduli in content["moduli"].items():
        alpha = moduli["alpha_uN_m"]["median"]
        assert alpha == pytest.approx(truth[name]["alpha_uN_m"], rel=0.3)
        assert refined["before"][name]["alpha_uN_m"]["median"] != alpha
    assert content["resimulation"]["silhouette_overlap"] > 0.95
    assert "alpha before refinement" in capsys.readouterr().out


def test_a_refinement_that_fails_leaves_the_network_its_answer(
    capture: Path, checkpoint: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, kept = capture.parent / "out", []
    infer.main(words(capture, checkpoint, "drapes=0"))
    alone = json.loads((out / "estimate.json").read_text())

    def fail(*_: object, **__: object) -> None:
        kept.append(json.loads((out / "estimate.json").read_text()))
        raise np.linalg.LinAlgError("Eigenvalues did not converge")

    (out / "estimate.json").unlink()
    monkeypatch.setattr("drapenet.refine.refine.refined_capture", fail)
    infer.main(words(capture, checkpoint, "drapes=0", "refine=depth"))
    content = json.loads((out / "estimate.json").read_text())
    assert kept == [alone]
    assert content.pop("warnings") == [*alone.pop("warnings"), (
        "refinement failed: LinAlgError, Eigenvalues did not converge; the network's estimate is "
        "given")]
    assert content == alone


def test_the_report_drapes_cloth_with_the_stated_membrane(
    capture: Path, checkpoint: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    laws = []

    def recorded(*args: object, **options: object) -> object:
        laws.append(options["laws"])
        return drape(*args, **options)

    monkeypatch.setattr("drapenet.report.drape.drape", recorded)
    density = read_capture(capture).density
    infer.main(words(capture, checkpoint, "drapes=1", "edge_mm=12",
                     "membrane_n_per_m=500"))
    assert laws[0].membrane.stiffness == pytest.approx(500 * 0.3 / density)


def test_a_rejected_refinement_is_not_shown_as_the_estimate(
    capture: Path, checkpoint: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rejected = SimpleNamespace(draws=None, content={
        "misfit_before": None, "misfit": 20.0, "simulations": 15, "status": "interrupted",
        "specimen": {}}, warnings=("the network's estimate stands",),
                               resimulation=SimpleNamespace(as_dict=dict,
                                                            warnings=["another drape"]))
    monkeypatch.setattr("drapenet.refine.refine.refined_capture", lambda *_, **__: rejected)
    infer.main(words(capture, checkpoint, "drapes=0", "refine=depth"))
    content = json.loads((capture.parent / "out" / "estimate.json").read_text())
    assert "resimulation" not in content and "another drape" not in content["warnings"]
    assert "the network's estimate stands" in content["warnings"]


@pytest.mark.skipif(not SHARED.is_dir(), reason="the published captures are not here")
@pytest.mark.parametrize(("name", "turns"), [("mesh0", (90, 92, 86)), ("mesh1", (82, 93, 95))])
def test_the_published_format_runs_as_it_is(
    name: str, turns: tuple[int, ...], checkpoint: Path, tmp_path: Path
) -> None:
    """The table's turns as found in another way, see configs/camera."""
    infer.main([f"capture={SHARED / name}", f"checkpoint={checkpoint}", f"out={tmp_path / 'out'}",
                "drapes=0"])
    content = json.loads((tmp_path / "out" / "estimate.json").read_text())
    assert content["capture"]["density_g_m2"] == 300
    assert any("8-bit" in warning for warning in content["warnings"])
    assert np.diff(content["capture"]["turns_deg"]) == pytest.approx(turns, abs=1.5)
    doubted = any("turned by 82° in view 1" in warning for warning in content["warnings"])
    assert doubted == (turns[0] == 82)


def test_a_report_of_another_capture_does_not_stay(capture: Path, checkpoint: Path) -> None:
    out = capture.parent / "out"
    out.mkdir()
    (out / "report.png").write_bytes(b"of another fabric")
    infer.main(words(capture, checkpoint, "drapes=0"))
    assert [file.name for file in out.iterdir()] == ["estimate.json"]


def test_a_folder_in_the_way_of_the_report_is_told_before_work(
    capture: Path, checkpoint: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drapenet.inference.estimate_capture", None)
    (capture.parent / "out" / "report.png").mkdir(parents=True)
    with pytest.raises(InputError, match="it is a folder"):
        infer.main(words(capture, checkpoint, "drapes=0"))


def test_a_capture_upside_down_is_doubted(tmp_path: Path) -> None:
    twill = read_capture(Path(__file__).parents[1] / "examples" / "captures" / "twill")
    folder = tmp_path / "capture"
    write_capture(folder, views=twill.views[:, ::-1], intrinsics=twill.intrinsics,
                  density=twill.density, rig=twill.rig)
    infer.main([f"capture={folder}", f"out={tmp_path / 'out'}", "drapes=1", "edge_mm=12"])
    content = json.loads((tmp_path / "out" / "estimate.json").read_text())
    for doubt in ("check that the pictures are upright", "check the pictures, their intrinsics"):
        assert any(doubt in warning for warning in content["warnings"])


def test_the_same_capture_gives_the_same_estimate(capture: Path, checkpoint: Path) -> None:
    infer.main(words(capture, checkpoint, "drapes=0"))
    first = (capture.parent / "out" / "estimate.json").read_bytes()
    infer.main(words(capture, checkpoint, "drapes=0"))
    assert (capture.parent / "out" / "estimate.json").read_bytes() == first
    assert load_model(read_header(checkpoint)).training is False
