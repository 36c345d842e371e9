"""infer.py as a user runs it: good captures, every kind of bad input, faults of later stages."""

import json
import math
import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from cloths import describe, write_skirt
from photographs import CURVE, drawn, plate, write
from PIL import Image
from words import last

import infer
from common.errors import InputError
from common.files import locked
from common.findings import Finding
from data.captures.reader import read_capture
from drapenet.config import EstimateOptions
from drapenet.fabric import next_measurements, stages
from drapenet.fabric.stages import CaptureEstimate, estimate_capture
from drapenet.measured.captures import Captured
from drapenet.measured.read import sources_in
from drapenet.network.checkpoint import BUNDLED, read_header
from drapenet.result.files import FAULTS, SHOWN, STRIPS, read_estimate
from sim.material import DIRECTIONS, MICRO, is_admissible

NUMBERS = {"estimate.json", "samples.npz", "observation.npz", "part.json"}  # files of an estimate
SHARED = Path(__file__).parents[2] / "shared" / "captures"
TWILL = Path(__file__).parents[1] / "examples" / "captures" / "twill"
TENSION = """
density_g_m2: 210
tension:
- {direction: bias, width_mm: 50, gauge_mm: 100, load_g: 50, extension_mm: 4.1}
- {direction: warp, width_mm: 50, gauge_mm: 200, load_g: 500, extension_mm: 4.2}
known: {thickness_mm: 0.42, thickness_kpa: 0.2, friction_deg: {fabric: 24, board: 18.5}}
"""


@pytest.fixture
def capture(tmp_path) -> Path:
    """A sound capture, which a test may spoil."""
    return write_skirt(tmp_path / "capture", warp_direction=0.4)


@pytest.fixture(scope="module")
def checkpoint(untrained_checkpoint) -> Path:
    return untrained_checkpoint


@pytest.fixture
def out(tmp_path) -> Path:
    return tmp_path / "out"


def no_drape(*_: object) -> None:
    """In place of a drape on another tester, for what comes next, which costs a second."""


def as_before(result: CaptureEstimate, **_: object) -> CaptureEstimate:
    """In place of a stage."""
    return result


def words(capture: Path, checkpoint: Path, *more: str) -> list[str]:
    return last(f"capture={capture}", f"checkpoint={checkpoint}", f"out={capture.parent / 'out'}",
                *more)


def content_of(out: Path) -> dict:
    return json.loads((out / "estimate.json").read_text())


def test_a_bad_capture_is_told_before_torch_is_loaded(capture, checkpoint):
    (capture / "view_1.png").unlink()
    code = ("import sys, infer\ntry:\n    infer.main(sys.argv[1:])\n"
            "except ValueError as error:\n    print(error, 'torch' in sys.modules)")
    done = subprocess.run([sys.executable, "-c", code, *words(capture, checkpoint)],
                          capture_output=True, text=True, check=True,
                          cwd=Path(infer.__file__).parent)
    assert "view_1.png" in done.stdout and done.stdout.strip().endswith("False")


def test_a_doubtful_capture_is_refused_if_strict(capture, checkpoint, out):
    first, second = capture / "view_1.png", capture / "view_2.png"
    first.rename(capture / "other.png")
    second.rename(first)
    (capture / "other.png").rename(second)
    with pytest.raises(InputError, match="refused because strict=true: ") as refusal:
        infer.main(words(capture, checkpoint, "strict=true"))
    assert not out.exists()
    infer.main(words(capture, checkpoint, "drapes=0"))
    warnings = content_of(out)["warnings"]
    assert len(warnings) > 1 and all(one["text"] in str(refusal.value) for one in warnings)


# --- Captures and estimates -------------------------------------------------------------------


def test_the_bundled_capture_is_sound_and_its_truth_is_a_fabric():
    capture = read_capture(TWILL)
    assert not capture.warnings and capture.warp_direction is not None
    assert len(np.unique(capture.views)) > 100  # millimetres, not the steps of 8 bits
    truth = json.loads((TWILL / "truth.json").read_text())
    assert truth["density_g_m2"] == pytest.approx(capture.density * 1e3)
    alpha = np.array([truth["moduli"][name]["alpha_uN_m"] for name in DIRECTIONS])
    assert is_admissible(alpha * MICRO, np.zeros(3))


def test_estimate_says_what_it_is_and_is_the_same_again(capture, checkpoint, out, capsys):
    infer.main(words(capture, checkpoint, "drapes=0", "export=jfab,torque"))
    files = {file.name: file.read_bytes() for file in out.iterdir()}
    assert set(files) == NUMBERS | {"fabric.jfab", "torque.csv"}
    content = content_of(out)
    assert (content["schema"], content["schema_version"]) == ("drapenet-estimate", 6)
    assert content["capture"]["density_g_m2"] == 150
    assert list(content["moduli"]) == ["warp", "bias", "weft"]
    for name, moduli in content["moduli"].items():
        reference = content["moduli_at_300_g_m2"][name]
        for unit in ("alpha_uN_m", "beta_nN_m2"):
            quantity = moduli[unit]
            assert quantity["median"] == pytest.approx(reference[unit]["median"] / 2)
            assert quantity["interval_90"][0] < quantity["interval_68"][0] < quantity["median"]
        assert 0.1 < moduli["alpha_uN_m"]["median"] < 1000  # µN·m of a fabric, not another unit
    assert content["checkpoint"]["sha256"] == read_header(checkpoint).sha256
    assert 0 < content["capture"]["drape_coefficient_percent"] < 100
    assert content["capture"]["turns_deg"] == pytest.approx([0, 90, 180, 270], abs=1)
    assert "68 % interval" in capsys.readouterr().out
    infer.main(words(capture, checkpoint, "drapes=0"))
    assert all((out / name).read_bytes() == files[name] for name in NUMBERS)


@pytest.mark.parametrize("turns", [[0], [0, 120, 240], [0, 45, 90, 180, 270]])
def test_a_capture_has_any_number_of_views(checkpoint, tmp_path, out, turns):
    capture = write_skirt(tmp_path / "capture", turns=np.radians(turns))
    infer.main(words(capture, checkpoint, "drapes=0"))
    assert content_of(out)["capture"]["views"] == len(turns)
    assert content_of(out)["capture"]["turns_deg"] == pytest.approx(turns, abs=2)


def test_a_photograph_has_an_estimate_and_a_report(checkpoint, tmp_path, out, capsys):
    folder = write(tmp_path / "capture", drawn(), warp_direction_deg=30,
                   outline={"plate_px": plate(), "camera_height_mm": 1000})
    infer.main(words(folder, checkpoint, "drapes=1", "edge_mm=16"))
    content = content_of(out)
    assert content["capture"]["views"] == 0 and content["capture"]["turns_deg"] is None
    assert list(content["moduli"]) == ["warp", "bias", "weft"]
    # The network is untrained, so that the simulated drape is another.
    assert {found["code"] for found in content["warnings"]} <= {"coefficient_differs"}
    assert raised_by(folder, content) > 3  # of its perspective
    assert "drape coefficient" in capsys.readouterr().out
    assert "two hanging strips along warp and weft each" in {
        following["measurement"] for following in content["next_measurements"]}
    found = content["resimulation"]
    assert found["statuses"] == ["converged"] and found["folds_captured"] == 7
    assert {file.name for file in out.iterdir()} == NUMBERS | {*SHOWN} - {STRIPS}
    scene = trimesh.load(out / "drape.glb")
    assert set(scene.geometry) == {"simulated", "support"}


def test_an_outline_without_perspective_stays_as_it_is(checkpoint, tmp_path, out):
    table = "".join(f"{x:.3f},{y:.3f}\n" for x, y in 1e3 * CURVE)
    folder = write(tmp_path / "capture", f"x_mm,y_mm\n{table}", "outline.csv",
                   outline={"camera_height_mm": "parallel"})
    infer.main(words(folder, checkpoint, "drapes=0"))
    assert abs(raised_by(folder, content_of(out))) < 3


def raised_by(folder: Path, content: dict) -> float:
    """By how much the drape coefficient of an estimate is above that of the outline, %."""
    return (content["capture"]["drape_coefficient_percent"]
            - 100 * read_capture(folder).outline.drape_coefficient)


def test_a_reported_drape_coefficient_is_a_capture(checkpoint, tmp_path, out):
    known = {"drape_coefficient_percent": 55, "nodes": 7, "membrane_n_per_m": 300}
    folder = write(tmp_path / "capture", "", "notes.txt", known=known)
    infer.main(words(folder, checkpoint))
    content = content_of(out)
    assert content["capture"]["drape_coefficient_percent"] == 55
    assert content["convention"] == "stiff/soft" and "resimulation" not in content
    assert content["capture"]["known"]["membrane_n_per_m"] == 300  # which the network reads
    assert {file.name for file in out.iterdir()} == NUMBERS | {"report.html", "report.pdf",
                                                               "torque.svg"}


@pytest.mark.parametrize("key", ["capture", "captures"])
def test_a_folder_that_another_run_writes_to_is_refused(capture, checkpoint, out, key):
    source = capture if key == "capture" else capture.parent
    with locked(out), pytest.raises(InputError, match="another run is writing to this folder"):
        infer.main([f"{key}={source}", f"checkpoint={checkpoint}", f"out={out}", "drapes=0"])
    assert not out.exists()


def test_results_are_named_after_their_capture_and_not_overwritten_by_another(
    capture, checkpoint, tmp_path, monkeypatch
):
    for fabric in ("poplin", "007"):
        shutil.copytree(capture, tmp_path / "raw" / fabric / "s1" / "c1")
    monkeypatch.chdir(tmp_path)
    more = [f"checkpoint={checkpoint}", "drapes=0"]
    for fabric in ("poplin", "007"):
        infer.main([f"capture=raw/{fabric}/s1/c1", *more])
    results = tmp_path / "outputs" / "infer"
    assert {folder.name for folder in results.iterdir()} == {"007_s1_c1", "poplin_s1_c1"}
    file = results / "poplin_s1_c1" / "estimate.json"
    before = file.read_bytes()
    with pytest.raises(InputError, match=r"holds the estimate of raw/poplin/s1/c1, which would "):
        infer.main(["capture=raw/007/s1/c1", f"out={file.parent}", *more])
    assert file.read_bytes() == before
    file.write_text("{")  # damaged: it is replaced
    infer.main(["capture=raw/poplin/s1/c1", *more])
    assert file.read_bytes() == before
    name = 50 * "\u7d39"  # of 150 bytes
    shutil.copytree(capture, tmp_path / name / name)
    infer.main([f"capture={name}/{name}", *more])
    assert (results / f"{name[:34]}_{name}" / "estimate.json").exists()


@pytest.mark.skipif(not SHARED.is_dir(), reason="the published captures are not here")
@pytest.mark.parametrize(("name", "turns"), [("mesh0", (90, 92, 86)), ("mesh1", (82, 93, 95))])
def test_the_published_format_runs_as_it_is(name, turns, checkpoint, out):
    """The table's turns as found in another way, see configs/camera."""
    infer.main([f"capture={SHARED / name}", f"checkpoint={checkpoint}", f"out={out}", "drapes=0"])
    content = content_of(out)
    assert content["capture"]["density_g_m2"] == 300
    found = {one["code"]: one["text"] for one in content["warnings"]}
    assert "depth_coarse" in found
    assert np.diff(content["capture"]["turns_deg"]) == pytest.approx(turns, abs=1.5)
    assert ("turned by 82° in view 1" in found.get("table_turned", "")) == (turns[0] == 82)


# --- Report and refinement --------------------------------------------------------------------


@pytest.fixture(scope="module")
def reported(tmp_path_factory, checkpoint) -> SimpleNamespace:
    """The folder of a fabric of two captures, and its estimate with its reports."""
    root = tmp_path_factory.mktemp("reported")
    names = ["up", os.fsdecode(b"$a$ and $$ caf\xe9 \n")]
    for name, turn in zip(names, (0.0, 1.0), strict=True):
        write_skirt(root / "fabric" / name, orientation=turn, warp_direction=turn)
    first, second = sources_in(root / "fabric", "capture")
    assert (first.name, second.name) == (names[1], names[0])
    describe(first, operator="A")
    describe(second, fabric="Navy 7", operator="B", face="down")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(next_measurements, "expected_drape", no_drape)
        infer.main([f"capture={root / 'fabric'}", f"checkpoint={checkpoint}",
                    f"out={root / 'out'}", "drapes=1", "edge_mm=16"])
    return SimpleNamespace(fabric=root / "fabric", second=second, out=root / "out")


def test_captures_of_one_fabric_give_one_estimate_and_report(reported):
    out = reported.out
    assert {file.name for file in out.iterdir() if file.is_file()} == {
        "estimate.json", "samples.npz", "fabric.json", "report.html", "report.pdf"}
    page = (out / "report.html").read_text("utf-8")
    assert "<h1>Navy 7</h1>" in page and page.count("data:image/png") == 4  # moduli, code
    content = content_of(out)
    assert content["capture"]["labels"] == {"fabric": "Navy 7", "operator": "A / B"}
    assert len(content["captures"]) == 2
    for k in range(2):
        alone = content_of(out / f"capture_{k}")
        assert content["captures"][k]["moduli"] == alone["moduli"] != content["moduli"]
        assert {*alone} - {"resimulation"} <= {*content}
    assert alone["capture"]["labels"]["operator"] == "B"
    assert 3 <= alone["capture"]["nodes"] <= 9  # five folds, four corners


def test_report_shows_a_drape_of_the_estimate(reported):
    out = reported.out / "capture_0"
    content = content_of(out)
    assert content["capture"]["source"].endswith("$a$ and $$ caf\ufffd \n")
    read_estimate(out)  # JSON's parsers refuse half characters
    assert content["resimulation"]["statuses"] == ["converged"]
    assert 0.3 < content["resimulation"]["silhouette_overlap"] <= 1
    assert (out / "report.pdf").read_bytes().startswith(b"%PDF-") and (out / "drape.glb").exists()
    assert "<h1>$a$ and $$ caf\ufffd \n</h1>" in (out / "report.html").read_text("utf-8")
    with Image.open(out / "report.png") as picture:
        assert picture.size[0] > 1000
        assert np.asarray(picture.convert("L")).std() > 20  # not an empty page


def test_reports_of_another_estimate_go(reported, checkpoint, capsys):
    describe(reported.second, warp_direction_deg=None)
    infer.main([f"capture={reported.fabric}", f"checkpoint={checkpoint}",
                f"out={reported.out}", "drapes=0"])
    assert "joint estimate of 2 captures" in capsys.readouterr().out
    assert not (reported.out / "report.html").exists()
    assert {file.name for file in (reported.out / "capture_0").iterdir()} == NUMBERS
    content = content_of(reported.out)
    assert content["convention"] == "stiff/soft"
    assert content["captures"][0]["moduli"].keys() == {"warp", "bias", "weft"}


def test_a_report_that_cannot_be_written_does_not_lose_the_estimate(capture, checkpoint, out):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (290_000, limits[1]))  # bytes of a file
    try:
        infer.main(words(capture, checkpoint, "drapes=1", "edge_mm=16"))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    names = {file.name for file in out.iterdir()}
    assert NUMBERS <= names and "drape.glb" not in names
    assert content_of(out)["warnings"][-1]["text"].startswith(
        f"there is no report: InputError, cannot write {out}")


def test_a_stage_that_fails_leaves_its_traceback(capture, checkpoint, out, monkeypatch):
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("of a fault")

    monkeypatch.setattr(stages, "simulate", broken)
    monkeypatch.setattr(stages, "report", as_before)
    line = words(capture, checkpoint, "drapes=1")
    with pytest.raises(ZeroDivisionError):
        infer.main(line)  # tests see faults of the program
    monkeypatch.delenv(stages.RAISE)
    infer.main(line)
    assert ("ZeroDivisionError, of a fault; please report it with the file faults.txt"
            in content_of(out)["warnings"][-1]["text"])
    assert "in broken" in (out / FAULTS).read_text()


def test_a_refinement_that_fails_leaves_the_network_s_estimate(
        capture, checkpoint, out, monkeypatch):
    monkeypatch.delenv(stages.RAISE)
    found = []
    for refine in (None, {"by": "simulation"}):  # a setting is missing
        estimate_capture(Captured.of(read_capture(capture)), read_header(checkpoint),
                         EstimateOptions(refine=refine, drapes=0), out=out)
        found.append(content_of(out))
    alone, content = found
    assert content.pop("warnings")[-1]["text"].startswith(
        "the network's estimate is not refined: KeyError")
    assert alone.pop("warnings") is not None and content == alone


def test_a_rejected_refinement_is_not_shown_as_the_estimate(
    capture, checkpoint, out, monkeypatch, capsys
):
    rejected = SimpleNamespace(draws=None, content={
        "misfit_before": math.inf,
        "misfit": 20.0,
        "simulations": 15,
        "failed_simulations": 0,
        "status": "interrupted",
        "message": "",
        "specimen": {}},
        warnings=(Finding("refinement_no_better"),),
        resimulation=SimpleNamespace(as_dict=dict, warnings=[Finding("silhouette_differs")]))
    monkeypatch.setattr("drapenet.refine.refine.refine_capture", lambda *_, **__: rejected)
    infer.main(words(capture, checkpoint, "drapes=0", "refine=simulation"))
    content = content_of(out)
    codes = [found["code"] for found in content["warnings"]]
    assert "resimulation" not in content and "silhouette_differs" not in codes
    assert "misfit - before, 20 after 15 simulations (interrupted): half the" in (
        capsys.readouterr().out)
    assert "refinement_no_better" in codes
    assert content["refined"]["misfit_before"] is None
    assert content["refined"]["before"] == content["moduli"]


@pytest.mark.slow
@pytest.mark.skipif(not BUNDLED.exists(), reason="no network is bundled")
def test_refinement_says_what_has_changed(out, capsys):
    infer.main([f"capture={TWILL}", f"out={out}", "refine=simulation", "refine.edge_mm=4"])
    content = content_of(out)
    refined = content["refined"]
    assert refined["misfit"] <= refined["misfit_before"]
    assert refined["specimen"]["membrane_n_per_m"]["median"] > 50
    truth = json.loads((TWILL / "truth.json").read_text())["moduli"]
    for name, moduli in content["moduli"].items():
        alpha = moduli["alpha_uN_m"]["median"]
        assert alpha == pytest.approx(truth[name]["alpha_uN_m"], rel=0.3)
        assert refined["before"][name]["alpha_uN_m"]["median"] != alpha
    assert content["resimulation"]["silhouette_overlap"] > 0.95
    assert "alpha before refinement" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.skipif(not BUNDLED.exists(), reason="no network is bundled")
def test_a_preview_is_skirts_of_twelve_samples_beside_the_estimate(out, capsys):
    infer.main([f"capture={TWILL}", f"out={out}", "drapes=0", "preview=true", "workers=2"])
    line = capsys.readouterr().out.splitlines()[-1]
    assert line == f"garment:  {out / 'garment.png'}, {out / 'garment.glb'}"  # none is missing
    with Image.open(out / "garment.png") as picture:
        assert picture.size[0] > picture.size[1] > 500
    scene = trimesh.load(out / "garment.glb")
    skirts = [*scene.geometry.values()]
    assert len(skirts) == 12 and len({len(skirt.faces) for skirt in skirts}) == 1
    assert all(0.3 < np.ptp(skirt.vertices, axis=0).max() < 1.0 for skirt in skirts)  # m
    assert not np.allclose(np.ptp(skirts[0].vertices, axis=0), np.ptp(skirts[-1].vertices, axis=0))


def test_strips_under_weights_are_printed_and_reported(tmp_path, out, capsys, monkeypatch):
    monkeypatch.setattr(next_measurements, "expected_drape", no_drape)
    (tmp_path / "tension").mkdir()
    (tmp_path / "tension" / "tension.yaml").write_text(TENSION)
    infer.main([f"tension={tmp_path / 'tension'}", f"out={out}"])
    printed = capsys.readouterr().out
    assert "by strips under weights: shear " in printed and "weight that stretches" in printed
    found = content_of(out)["tension"]
    low, high = found["shear_n_per_m"]["interval_90"]
    # Load over four times the extension, 60, without the yarns' stretch.
    assert low < 60 < high and 50 < found["shear_n_per_m"]["median"] < 75
    assert 3000 < found["stretch_n_per_m"]["warp"]["median"] < 5000
    assert found["measured"] == ["warp", "bias"]
    page = (out / "report.html").read_text()
    assert "Stretch and shear" in page and "thickness: 0.42 mm at 0.2 kPa" in page
    assert "slides on board at: 18.5°" in page and "By 2 strips under weights" in page
    assert "the strips as they were read, with marks, loads and extensions" in page
    picture = np.asarray(Image.open(out / "strips.png").convert("RGB")).astype(int)
    points = (picture[..., 0] > 150) & (picture[..., 1:] < 90).all(axis=2)  # of both directions
    assert points[:, : points.shape[1] // 2].any() and points[:, points.shape[1] // 2 :].any()
