"""Uploads: what is taken, and as what; what is refused is in tests/refused."""

import base64
import io
import re
import tempfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
import yaml
from photographs import CURVE, drawn, plate, write
from PIL import Image
from spoiled import large_png

from common.command import compose_config
from common.errors import InputError
from data.captures.capture import Capture, ReportedCapture
from data.captures.reader import read_capture
from data.readings import QUANTITIES
from drapenet.config import ServeConfig
from drapenet.measured.strips.description import StripsDescription, read_description
from drapenet.measured.tension.description import TensionDescription
from drapenet.measured.values import ValueSet
from drapenet.service.forms import error_field, value_fields
from drapenet.service.limits import RequestError
from drapenet.service.received import unpacked
from drapenet.service.uploads import Upload, checked_upload
from sim.material import DIRECTIONS

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "captures" / "twill"
_FOLDER = tempfile.TemporaryDirectory()  # until the end of the process
PHOTOGRAPH = write(Path(_FOLDER.name) / "drawn", drawn(), warp_direction_deg=70,
                   outline={"plate_px": plate(), "camera_height_mm": 1200})
PICTURE = (PHOTOGRAPH / "outline.png").read_bytes()
VIEWS = [(file.name, file.read_bytes()) for file in sorted(EXAMPLE.glob("view_*.png"))]
YAML = ("capture.yaml", (EXAMPLE / "capture.yaml").read_bytes())


@pytest.fixture(scope="module")
def settings(tmp_path_factory) -> ServeConfig:
    results = tmp_path_factory.mktemp("results")
    words = [f"results={results}", "megabytes=4"]
    return compose_config("serve", words, schema=ServeConfig)


def zipped(files: list[tuple[str, bytes]], kind: int = zipfile.ZIP_DEFLATED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", kind) as archive:
        for name, data in files:
            archive.writestr(name, data)
    return stream.getvalue()


@pytest.mark.parametrize("kind", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2,
                                  zipfile.ZIP_LZMA])
def test_any_damage_of_a_zip_is_refused_in_a_line(settings, kind):
    whole, refused = zipped([("a/view_0.png", PICTURE[:2000]), YAML], kind), 0
    rng = np.random.default_rng(0)
    for place in rng.integers(len(whole), size=300):
        flipped = bytes([whole[place] ^ int(rng.integers(1, 256))])
        for damaged in (whole[:place], whole[:place] + flipped + whole[place + 1:]):
            try:
                unpacked([("a.zip", damaged)], settings)
            except RequestError as error:
                refused += error.status_code == 422 and "zip" in error.detail
                assert "\n" not in error.detail
    assert refused > 400


def capture_of(upload: Upload, folder: Path) -> Capture:
    folder.mkdir()
    for name, data in upload.files.items():
        (folder / name).write_bytes(data)
    return read_capture(folder)


def test_files_and_a_zip_of_their_folder_make_the_same_capture(settings, tmp_path):
    plain = checked_upload([*VIEWS, YAML], {}, settings)
    beside = checked_upload([*VIEWS, ("._view_0.png", b"\0\5\26\7"), YAML], {}, settings)
    assert plain.files == beside.files
    packed = checked_upload([("My fabric.zip", zipped([
        *((f"twill/{name}", data) for name, data in (*VIEWS, YAML)),
        ("twill/truth.json", b"{}"), ("__MACOSX/twill/._view_0.png", b"x")]))], {}, settings)
    assert plain.files == packed.files
    assert plain.name == packed.name == "Twill, simulated"  # as capture.yaml states
    read, expected = capture_of(plain, tmp_path / "a"), read_capture(EXAMPLE)
    assert np.array_equal(read.views, expected.views)
    assert read.density == expected.density and read.warp_direction == expected.warp_direction


@pytest.mark.parametrize("turns", ["0, 90, 180, 270", "0;90;180;270", "[0 90.0 180 270]"])
def test_fields_stand_for_the_description_and_pictures_are_numbered(settings, tmp_path, turns):
    intrinsics = yaml.safe_load(YAML[1])["intrinsics"]
    renamed = [(f"shot {k + 9}.png", data) for k, (_, data) in enumerate(VIEWS)]  # 9, 10, 11, 12
    fields = {"density_g_m2": "123,5", "tester": "square300_cylinder100",
              "turns_deg": turns, **{key: str(value) for key, value in intrinsics.items()}}
    upload = checked_upload(renamed[::-1], fields, settings)
    assert yaml.safe_load(upload.files["capture.yaml"])["turns_deg"] == [0, 90, 180, 270]
    assert [upload.files[f"view_{k}.png"] for k in range(4)] == [data for _, data in VIEWS]
    assert capture_of(upload, tmp_path / "capture").density == pytest.approx(0.1235)


def jpeg(png: bytes) -> bytes:
    stream = io.BytesIO()
    Image.open(io.BytesIO(png)).save(stream, "JPEG", quality=95)
    return stream.getvalue()


def photograph_fields() -> dict[str, str]:
    content = yaml.safe_load((PHOTOGRAPH / "capture.yaml").read_bytes())
    outline = content.pop("outline")
    plate = {f"plate_{key}": value for key, value in outline.pop("plate_px").items()}
    return {key: str(value) for key, value in (content | outline | plate).items()}


@pytest.mark.parametrize(("name", "data"), [("IMG 0007.JPG", jpeg(PICTURE)),
                                            ("shot.png", PICTURE)])
def test_a_photograph_and_the_form_make_the_capture_of_its_folder(name, data, settings, tmp_path):
    upload = checked_upload([(name, data)], photograph_fields(), settings)
    read, expected = capture_of(upload, tmp_path / "capture"), read_capture(PHOTOGRAPH)
    assert np.abs(read.outline.radii - expected.outline.radii).max() < 2e-4
    assert (read.outline.height, read.rig, read.density, read.warp_direction) == (
        expected.outline.height, expected.rig, expected.density, expected.warp_direction)


@pytest.mark.parametrize("name", ["drape 3.csv", "drape 3.txt"])
def test_a_table_of_an_outline_has_a_unit_and_an_origin(name, settings, tmp_path):
    curve = 1e3 * CURVE[::4] + [40, 0]
    table = "\n".join(f"{x:.2f};{y:.2f}" for x, y in curve).encode()
    fields = {"density_g_m2": "210", "tester": "disc300_support180", "unit": "mm",
              "centred": "false", "camera_height_mm": "parallel"}
    outline = capture_of(checked_upload([(name, table)], fields, settings), tmp_path / "c").outline
    assert np.isinf(outline.height) and not outline.centred
    assert outline.radii.max() < 0.15  # from the centroid


def test_a_table_of_a_picture_has_a_sense(settings, tmp_path):
    curve = [200, 200] + 1e3 * CURVE[::4] * [1, -1]
    table = "".join(f"{x:.2f};{y:.2f};\r\n" for x, y in curve).encode("utf-16")
    fields = {"density_g_m2": "210", "tester": "disc300_support180", "unit": "mm",
              "warp_direction_deg": "25"}
    with pytest.raises(InputError, match=r"state outline: {centred: false, y_axis: down}"):
        capture_of(checked_upload([("a.csv", table)], fields, settings), tmp_path / "a")
    stated = fields | {"centred": "false", "y_axis": "down"}
    upload = checked_upload([("a.zip", zipped([("drape/a.csv", table)]))], stated, settings)
    radii = capture_of(upload, tmp_path / "b").outline.radii
    expected = capture_of(checked_upload([("a.csv", table)], stated, settings), tmp_path / "c")
    assert np.array_equal(radii, expected.outline.radii)


def test_a_photograph_of_a_strip_is_found_by_its_name_in_another_normal_form(settings):
    document = PHOTOGRAPHED.replace(b"weft.jpg", "K\u00f6per.jpg".encode())
    upload = checked_upload([("strips.yaml", document), ("warp 1.PNG", large_png(6000, 4000)),
                             ("Ko\u0308per.jpg", jpeg(PICTURE))], {}, settings)
    assert "K\u00f6per.jpg" in upload.files


def test_a_field_replaces_its_value_alone(settings):
    document = (PHOTOGRAPH / "capture.yaml").read_bytes()
    upload = checked_upload([("a.png", large_png(6000, 4000)), ("capture.yaml", document)],
                            {"camera_height_mm": "1500,5", "density_g_m2": "90"}, settings)
    before, content = yaml.safe_load(document), yaml.safe_load(upload.files["capture.yaml"])
    assert content == before | {"density_g_m2": 90, "outline": before["outline"] | {
        "camera_height_mm": 1500.5}}


def test_pictures_among_views_are_no_outline(settings):
    files = [*VIEWS, YAML, ("table.jpg", b"not read"), ("log.csv", b"a;b")]
    upload = checked_upload([("a.zip", zipped(files))], {}, settings)
    assert not any(name.startswith("outline") for name in upload.files)


def test_a_name_as_in_mail_is_that_of_its_file(settings):
    name = "=?UTF-8?B?" + base64.b64encode("dräp/view_0.png".encode()).decode() + "?="
    upload = checked_upload([(name, VIEWS[0][1]), YAML], {}, settings)
    assert "view_0.png" in upload.files


def test_names_are_never_paths(settings):
    names = ["../../../etc/view_0.png", "/root/view_1.png", "..\\..\\view_2.png", "a/b/view_3.png"]
    files = [(name, data) for name, (_, data) in zip(names, VIEWS, strict=True)]
    for sent in ([*files, YAML], [("x.zip", zipped([*files, YAML]))]):
        upload = checked_upload(sent, {}, settings)
        assert sorted(upload.files) == ["capture.yaml", *(f"view_{k}.png" for k in range(4))]


LENGTHS = b"""
density_g_m2: 210
operator: M. Muster
date: 2026-11-26
strips:
  - {direction: warp, bending_length_mm: 21.5}
  - {direction: weft, bending_length_mm: 18}
"""
PHOTOGRAPHED = b"""
density_g_m2: 200
fabric: Serge
scale: {mm_per_px: 0.1}
strips:
  - {file: "shots/warp 1.PNG", direction: warp, free_length_mm: 60}
  - {file: weft.jpg, direction: weft, free_length_mm: 50}
"""


def values_of(upload: Upload, folder: Path) -> ValueSet:
    (folder / "values.yaml").write_bytes(upload.files["values.yaml"])
    return ValueSet.read(folder, {})


def strips_of(upload: Upload, folder: Path) -> StripsDescription:
    folder.mkdir()
    (folder / "strips.yaml").write_bytes(upload.files["strips.yaml"])
    return read_description(folder)


def test_bending_lengths_need_no_picture(settings, tmp_path):
    upload = checked_upload([("strips.yaml", LENGTHS)], {"laboratory": "Textile lab 7",
                                                         "density_g_m2": "205,5"}, settings)
    read = strips_of(upload, tmp_path / "strips")
    assert (upload.kind, upload.name, list(upload.files)) == ("strips", "strips", ["strips.yaml"])
    assert [entry.bending_length_mm for entry in read.strips] == [21.5, 18]
    assert read.density_g_m2 == 205.5
    assert read.labels.stated() == {"date": "2026-11-26", "operator": "M. Muster",
                                    "laboratory": "Textile lab 7"}


def test_photographs_of_strips_are_those_that_the_description_names(settings, tmp_path):
    sent = [("strips.yml", PHOTOGRAPHED), ("warp 1.PNG", large_png(6000, 4000)),
            ("weft.jpg", jpeg(PICTURE)), ("ruler.jpg", b"not read")]
    packed = [("strips.zip", zipped([(f"serge/{name}", data) for name, data in sent]))]
    for files in (sent, packed):
        upload = checked_upload(files, {}, settings)
        assert (upload.kind, upload.name) == ("strips", "Serge")
        assert sorted(upload.files) == ["strips.yaml", "warp_1.png", "weft.jpg"]
    read = strips_of(upload, tmp_path / "strips")
    assert [entry.file for entry in read.strips] == ["warp_1.png", "weft.jpg"]


PULLED = b"""
density_g_m2: 210
clip_g: 6
tension:
  - {direction: bias, width_mm: 50, gauge_mm: 100, load_g: 25, without: s/a 0.jpg, with: a25.PNG}
  - {direction: warp, width_mm: 50, gauge_mm: 200, load_g: 500, extension_mm: 2.4}
"""
STRIP = {"direction": "bias", "width_mm": "50", "gauge_mm": "100", "load_g": "25",
         "extension_mm": "4,1"}


def strips_in_a_form(*strips: dict[str, str]) -> dict[str, str]:
    return {f"tension.{number}.{key}": value for number, strip in enumerate(strips)
            for key, value in strip.items()}


def test_strips_under_weights_are_in_a_file_or_in_the_form(settings, tmp_path):
    sent = [("tension.yml", PULLED), ("a 0.jpg", jpeg(PICTURE)), ("ruler.jpg", b"not read"),
            ("a25.PNG", large_png(4000, 3000))]
    for files in (sent, [("t.zip", zipped([(f"twill/{name}", data) for name, data in sent]))]):
        upload = checked_upload(files, {"operator": "M. Muster"}, settings)
        assert (upload.kind, upload.directions) == ("tension", "yarns")
        assert sorted(upload.files) == ["a25.png", "a_0.jpg", "tension.yaml"]
    (tmp_path / "tension.yaml").write_bytes(upload.files["tension.yaml"])
    read = TensionDescription.in_folder(tmp_path)
    assert (read.tension[0].without, read.tension[0].under) == ("a_0.jpg", "a25.png")
    assert read.labels.operator == "M. Muster"
    form = {"density_g_m2": "210", "clip_g": "6", "name": "twill", "known.membrane_n_per_m": "600",
            **strips_in_a_form(STRIP, STRIP | {"load_g": "50", "extension_mm": "9",
                                               "specimen": "2"})}
    upload = checked_upload([], form, settings)
    assert (upload.kind, upload.name, upload.directions) == ("tension", "twill", "")
    (tmp_path / "tension.yaml").write_bytes(upload.files["tension.yaml"])
    read = TensionDescription.in_folder(tmp_path)
    assert [(strip.load_g, strip.extension_mm, strip.specimen) for strip in read.tension] == [
        (25, 4.1, ""), (50, 9, "2")]
    assert read.clip_g == 6 and read.known.values() == {("membrane_n_per_m", 0): 600}
    named = strips_in_a_form({key: STRIP[key] for key in STRIP if key != "extension_mm"} | {
        "without": "a 0.jpg", "with": "a25.PNG"})
    upload = checked_upload(sent[1:2] + sent[3:], {"density_g_m2": "210", **named}, settings)
    assert sorted(upload.files) == ["a25.png", "a_0.jpg", "tension.yaml"]


VALUES = {"known.bending_length_mm.warp": "21,5", "known.membrane_n_per_m": "600",
          "known.error_percent.bending_length_mm": "3"}
KNOWN = {"bending_length_mm": {"warp": 21.5}, "membrane_n_per_m": 600,
         "error_percent": {"bending_length_mm": 3}}


def test_values_are_sent_alone_or_with_a_capture_a_scan_or_strips(settings, tmp_path):
    alone = checked_upload([], {"density_g_m2": "210", "name": "twill", **VALUES}, settings)
    assert (alone.kind, alone.name) == ("values", "twill")
    strips = checked_upload([("strips.yaml", LENGTHS)], VALUES, settings)
    for known in (values_of(alone, tmp_path).known, strips_of(strips, tmp_path / "strips").known):
        assert known.model_dump(exclude_unset=True) == KNOWN
    views = capture_of(checked_upload([*VIEWS, YAML], VALUES, settings), tmp_path / "views")
    form = {"density_g_m2": "210", "fx": "1", **VALUES}
    scan = checked_upload([("a.obj", b"v 0 0 0")], form | {"warp_direction_deg": "30"},
                          settings).specimen
    for known in (views.known, scan.known):
        assert known.model_dump(exclude_unset=True) == KNOWN


def test_uploads_state_their_density(settings):
    def density(*files: tuple[str, bytes], **form: str) -> float | None:
        return checked_upload([*files], form, settings).density_g_m2

    values = {"known.membrane_n_per_m": "600", "density_g_m2": "210"}
    assert density(**values) == density(("a.obj", b"v 0 0 0"), density_g_m2="210") == 210
    assert density(*VIEWS, YAML, density_g_m2="190") == 190
    assert density(("strips.yaml", LENGTHS), density_g_m2="190") == 190
    bare = (YAML[0], re.sub(rb"density_g_m2:.*", b"", YAML[1]))
    weighed = density(*VIEWS, bare, tester="disc300_support180", weight_g="14.137167")
    assert weighed == pytest.approx(200)  # 14.1 g of a disc of 300 mm


def test_uploads_state_whether_their_directions_are_known(settings):
    def directions(*files: tuple[str, bytes], **form: str) -> str:
        return checked_upload([*files], form, settings).directions

    bare = (YAML[0], re.sub(rb"warp_direction_deg:.*", b"", YAML[1]))
    assert directions(*VIEWS, YAML) == directions(*VIEWS, bare, warp_direction_deg="0") == "marked"
    assert directions(*VIEWS, bare) == "unmarked"
    values = {"known.bending_length_mm.warp": "21", "density_g_m2": "210"}
    assert directions(**values) == directions(("strips.yaml", LENGTHS)) == "yarns"
    assert directions(**{"known.membrane_n_per_m": "600", "density_g_m2": "210"}) == ""


def test_a_drape_coefficient_alone_is_of_values_or_of_a_face_a_capture(settings, tmp_path):
    form = {"density_g_m2": "210", "tester": "disc300_support180",
            "known.drape_coefficient_percent": "52", "known.nodes": "7"}
    upload = checked_upload([], form | strips_in_a_form(STRIP), settings)
    read = values_of(upload, tmp_path)
    assert upload.kind == "values" and read.capture.known.nodes == 7 and len(read.strips) == 1
    for face in ({}, {"face": "down"}):
        upload = checked_upload([], form | face, settings)
        assert ("capture.yaml" in upload.files) == bool(face)
    read = capture_of(upload, tmp_path / "capture")
    assert isinstance(read, ReportedCapture) and read.sign == -1


def test_each_quantity_of_the_registry_is_a_field(settings, tmp_path):
    for quantity in QUANTITIES.values():
        names = value_fields(quantity)
        values = [float(f"{(k + 2) * quantity.limits[0]:g}") for k in range(len(names))]
        upload = checked_upload([], {"density_g_m2": "210", error_field(quantity): "7",
                                     **dict(zip(names, map(str, values), strict=True))},
                                settings)
        known = values_of(upload, tmp_path).known
        assert known.values() == {(quantity.name, k): value for k, value in enumerate(values)}
        assert known.error(quantity.name) == 0.07 and len(names) in (1, len(DIRECTIONS))


@pytest.mark.parametrize(("key", "most"), [("name", 80), ("notes", 2000)])
def test_long_texts_are_refused(key, most, settings):
    with pytest.raises(RequestError, match=f"{most}") as refused:
        checked_upload([*VIEWS, YAML], {key: "x" * (most + 1)}, settings)
    assert refused.value.status_code == 422
