"""How a photograph is read before its estimate, what is taken with it, and the mat to print."""

import base64
import io
import time
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient
from httpx import Response
from photographs import CURVE, drawn, over_mat, plate
from PIL import Image
from scipy.spatial import cKDTree
from services import settings_for

from data.captures.photograph import PhotographedOutline, signed_area
from data.captures.reader import read_capture
from drapenet.service.limits import RequestError
from drapenet.service.uploads import checked_photograph, checked_upload

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "captures"
SETUP = {"tester": "disc300_support180", "camera_height_mm": "parallel"}
DISC = 0.09 * np.column_stack([np.cos(t := np.linspace(0, 2 * np.pi, 720, endpoint=False)),
                               np.sin(t)])
Files = dict[str, bytes]


def picture(*arguments: object, kind: str = "JPEG", **options: object) -> bytes:
    """The file of a drawn photograph."""
    stream = io.BytesIO()
    Image.fromarray(drawn(*arguments, **options)).convert("RGB").save(stream, kind, quality=95)
    return stream.getvalue()


def placed(**changes: float) -> dict[str, str]:
    """Fields that state where the plate is in a picture of 1000 pixels."""
    return {f"plate_{key}": str(value) for key, value in (plate() | changes).items()}


DRAPE = picture()  # 1000 pixels wide


def ask(client: TestClient, files: Files, **fields: str) -> Response:
    return client.post("/outline", files=[("files", one) for one in files.items()], data=fields)


def shown(answer: Response) -> tuple[int, int]:
    """Size of the picture of an answer."""
    kind, _, data = answer.json()["picture"].partition(",")
    assert kind == "data:image/jpeg;base64"
    return Image.open(io.BytesIO(base64.b64decode(data))).size


def test_outline_and_plate_are_in_pixels_of_the_picture(client):
    fine = picture(pixel=2e-4)  # 2000 pixels wide
    answer = ask(client, {"IMG 7.JPG": fine}, **SETUP, **placed(**plate(pixel=2e-4)))
    found = answer.json()
    assert answer.status_code == 200 and found["refusal"] is None
    assert shown(answer) == (found["width"], found["height"]) == (1000, 1000)
    assert (found["scale"], found["movable"], found["centred"]) == (2, True, True)
    stated = plate()  # in pixels of the picture
    assert [found["plate"][key] for key in stated] == pytest.approx(list(stated.values()), abs=0.02)
    line = 4e-4 * (np.array(found["outline"]) - [stated["x"], stated["y"]]) * [1, -1]
    assert abs(signed_area(line)) == pytest.approx(signed_area(CURVE), rel=2e-3)
    assert cKDTree(CURVE).query(line)[0].max() < 1e-3
    assert found["nodes"] == 7 and found["warnings"] == []


def test_what_is_refused_is_shown_with_its_sentence(client):
    found = ask(client, {"a.jpg": DRAPE}, **SETUP).json()
    assert found["picture"] and found["plate"] is None and found["outline"] is None
    assert found["refusal"].startswith("outline.jpg: the scale is not known: lay the printed mat")
    found = ask(client, {"a.jpg": DRAPE}, **SETUP, **placed(x=950.0)).json()
    assert found["plate"]["x"] == pytest.approx(950) and found["outline"] is None
    assert "/" not in found["refusal"].partition(";")[0]


def test_a_scale_alone_leaves_the_plate_to_be_placed(client):
    found = ask(client, {"a.jpg": DRAPE}, **SETUP, mm_per_px="0.4").json()
    assert not found["centred"] and found["movable"]
    assert found["plate"]["diameter"] == pytest.approx(450, abs=0.1)
    assert "the plate's centre is not known" in found["warnings"][0]["text"]


def test_the_plate_is_found_beside_the_photograph_unless_it_is_stated(client):
    files = {"drape.jpg": DRAPE, "plate only.jpg": picture(DISC)}
    found = ask(client, files, **SETUP).json()
    true = plate()
    assert [found["plate"][key] for key in true] == pytest.approx(list(true.values()), abs=0.5)
    moved = ask(client, files, **SETUP, **placed(x=525.0)).json()
    assert moved["plate"]["x"] == pytest.approx(525)
    assert moved["drape_coefficient_percent"] == pytest.approx(
        found["drape_coefficient_percent"], abs=0.15)


def test_a_mat_shows_the_plate_which_cannot_be_moved(client):
    files = {"drape.jpg": over_mat()}
    fields = {"tester": "disc300_support180", "mat": "a2", "plate_height_mm": "150"}
    found = ask(client, files, **fields).json()
    assert not found["movable"] and found["refusal"] is None, found["refusal"]
    middle = (np.array([found["width"], found["height"]]) - 1) / 2
    assert [found["plate"]["x"], found["plate"]["y"]] == pytest.approx(middle.tolist(), abs=0.1)
    other = ask(client, files, **fields | {"mat": "a3"}).json()
    assert other["picture"] and other["plate"] is None and not other["movable"]
    assert "it shows the mat a2, not the mat a3" in other["refusal"]
    half = ask(client, files, tester="disc300_support180", mat="a2").json()
    assert "mat and plate_height_mm belong together" in half["error"]


def test_places_of_cameras_are_in_pixels_of_the_picture(client):
    """The next picture is taken from straight above, as the camera was too far beside the axis."""
    files = {"drape.jpg": over_mat(beside=(0.15, 0.1))}
    fields = {"tester": "disc300_support180", "mat": "a2", "plate_height_mm": "150"}
    found = ask(client, files, **fields).json()
    centre, across = [found["plate"][key] for key in ("x", "y")], found["plate"]["diameter"]
    foot, = 0.180 / across * (np.array(found["cameras"]) - centre) * [1, -1]  # m, y up
    assert foot.tolist() == pytest.approx([0.15, 0.1], abs=0.02)
    assert found["next_camera"] == pytest.approx(centre, abs=0.2) and found["unclear"] == []
    assert "the hem at the lower left" in found["warnings"][0]["text"]
    above = ask(client, {"drape.jpg": over_mat()}, **fields).json()
    assert len(above["cameras"]) == 1 and above["next_camera"] is None


def test_the_warp_and_the_flat_specimen_are_lines_in_the_picture(client):
    """Of a square they turn with the warp, which counts from the mat's arrow, to the right."""
    files = {"drape.jpg": over_mat()}
    fields = {"tester": "square240_cylinder180", "mat": "a2", "plate_height_mm": "150"}
    for stated, angle in (({}, 0.0), ({"warp_direction_deg": "30"}, 30.0)):
        found = ask(client, files, **fields, **stated).json()
        centre, across = [found["plate"][key] for key in ("x", "y")], found["plate"]["diameter"]
        ends = 0.180 / across * (np.array(found["warp"]) - centre) * [1, -1]  # m, y up
        direction = ends[1] - ends[0]
        assert np.degrees(np.arctan2(*direction[::-1])) == pytest.approx(angle, abs=0.1)
        assert np.linalg.norm(direction) == pytest.approx(0.24 * 2**0.5, rel=5e-3)
        corners = 0.180 / across * (np.array(found["specimen"]) - centre) * [1, -1]
        at = np.argmax(np.linalg.norm(corners, axis=1))
        assert np.linalg.norm(corners[at]) == pytest.approx(0.12 * 2**0.5, rel=5e-3)
        assert np.degrees(np.arctan2(*corners[at][::-1])) % 90 == pytest.approx(
            (angle + 45) % 90, abs=0.3)
    free = ask(client, files, **fields, arrow="none").json()
    assert free["warp"] is None and free["specimen"] is None


def test_rectangles_have_two_sides_and_the_warps_hint_follows_the_mat(client):
    page, script = client.get("/").text, client.get("/static/questions.js").text
    assert '<option value="rectangle_cylinder">' in page and 'id="across"' in page
    for name in ("warp-mat", "warp-picture", "warp-name"):
        assert f'id="{name}"' in page and f"at('{name}')" in script
    fields = SETUP | placed(diameter=250.0) | {
        "tester": "rectangle170x250_cylinder100", "warp_direction_deg": "0"}
    found = ask(client, {"a.jpg": picture(0.6 * CURVE)}, **fields).json()
    sides = np.ptp(np.array(found["specimen"]), axis=0) * 0.1 / 250
    assert found["refusal"] is None
    assert sides == pytest.approx([0.17, 0.25], abs=2e-3)


def test_capture_yaml_is_read_and_other_captures_have_no_photograph(client):
    folder = EXAMPLES / "twill_photograph"
    files = {name: (folder / name).read_bytes() for name in ("outline.jpg", "capture.yaml")}
    found, read = ask(client, files).json(), read_capture(folder).outline
    assert isinstance(read, PhotographedOutline)
    assert found["nodes"] == read.folds
    views = {file.name: file.read_bytes() for file in (EXAMPLES / "twill").iterdir()
             if file.suffix in (".png", ".yaml")}
    for others in (views, {"a.obj": b"v 0 0 0"}, {"strips.yaml": b"density_g_m2: 210"},
                   {"0.png": b"", "density.txt": b"d 200"}):
        assert ask(client, others).status_code == 204


def test_its_limits_are_those_of_uploads(client, monkeypatch):
    assert client.post("/outline", content=b"x").status_code == 415
    answer = ask(client, {"a.jpg": b"GIF89a"}, **SETUP)
    assert answer.status_code == 422 and "cannot be read" in answer.json()["error"]
    assert ask(client, {"a.jpg": DRAPE}).json()["error"].startswith("tester is missing")
    foreign = client.post("/outline", headers={"origin": "http://elsewhere.example"})
    assert foreign.status_code == 403
    places = client.app.state.jobs.looks.places
    for _ in range(4):
        places.take("testclient")
    try:
        assert ask(client, {"a.jpg": DRAPE}, **SETUP).status_code == 429
    finally:
        for _ in range(4):
            places.give("testclient")
    looks = client.app.state.jobs.looks
    with monkeypatch.context() as patch:
        patch.setattr(looks, "_seconds", 0.2)
        with pytest.raises(RequestError, match=r"not read in 0.2 s; try again"):
            looks.outcome(time.sleep, 5)
    assert ask(client, {"a.jpg": DRAPE}, **SETUP).status_code == 200
    assert not list(client.app.state.jobs.settings.folder.glob(".photograph-*"))


MAT = {"tester": "disc300_support180", "mat": "a3", "plate_height_mm": "120"}


@pytest.mark.parametrize(("stated", "names", "expected"), [
    (MAT, ["IMG_1.HEIC", "IMG_2.HEIC"], ["outline_1.heic", "outline_2.heic"]),
    (MAT, ["b 10.jpg", "b 9.jpg", "mat.jpg"], ["mat_1.jpg", "outline_1.jpg", "outline_2.jpg"]),
    (MAT, ["outline.jpg", "outline_2.jpg", "ruler.jpg"],
     ["outline_1.jpg", "outline_2.jpg", "ruler.jpg"]),
    (SETUP, ["IMG_1.HEIC"], ["outline.heic"]),
    (SETUP, ["template.jpg"], ["outline.jpg"]),
    (SETUP, ["plate.jpg"], ["outline.jpg"]),
    (SETUP, ["a.jpg", "Plate 2.heif"], ["outline.jpg", "plate.heif"]),
    (SETUP, ["matte satin.jpg", "empty.png"], ["outline.jpg", "plate.png"]),
    (SETUP, ["drape.png", "plate.png"], ["outline.png", "plate.png"]),
    (SETUP, ["mat_10.jpg", "mat 9.jpg", "x.jpg"], ["mat_1.jpg", "mat_2.jpg", "outline.jpg"]),
    (SETUP, ["outline.jpg", "MAT.jpg", "plate.jpg", "ruler.jpg"],
     ["mat_1.jpg", "outline.jpg", "plate.jpg", "ruler.jpg"]),
])
def test_pictures_from_above_are_named_by_what_they_show(tmp_path, stated, names, expected):
    checked = checked_photograph([(name, pixel(name)) for name in names], stated,
                                 settings_for(tmp_path))
    assert checked is not None and sorted(checked) == sorted(["capture.yaml", *expected])
    for name, source in (("outline_1.jpg", "b 9.jpg"), ("mat_1.jpg", "mat 9.jpg")):
        assert source not in names or checked[name] == pixel(source)


def pixel(name: str) -> bytes:
    """A picture whose size depends on its name."""
    stream = io.BytesIO()
    kind = {".heic": "HEIF", ".heif": "HEIF", ".png": "PNG"}.get(Path(name).suffix.lower(), "JPEG")
    Image.new("RGB", (64 + 2 * len(name), 64)).save(stream, kind)
    return stream.getvalue()


def test_heic_becomes_the_capture_of_its_folder(tmp_path):
    fields = SETUP | placed() | {"density_g_m2": "100"}
    upload = checked_upload([("IMG.HEIC", picture(kind="HEIF"))], fields,
                            settings_for(tmp_path / "results"))
    for name, data in upload.files.items():
        (tmp_path / name).write_bytes(data)
    outline = read_capture(tmp_path).outline
    assert outline and outline.folds == 7


def test_the_mat_is_a_pdf_of_its_pages(client):
    whole = client.get("/mat.pdf")
    assert whole.headers["content-type"] == "application/pdf" and whole.content[:5] == b"%PDF-"
    parts = client.get("/mat.pdf?mat=a3&paper=a4").content
    assert b"/Count 2" in parts and b"/Count 1" in whole.content
    assert client.get("/mat.pdf?ground=grey").content != whole.content
    assert client.get("/mat.pdf?ground=pink").json()["error"].endswith("white, grey, blue")
    for query in ("mat=../a3", "mat=a3&paper=a9", "mat=a2&paper=tabloid"):
        answer = client.get(f"/mat.pdf?{query}")
        assert answer.status_code == 422
        assert answer.json()["error"].endswith("mat=foot paper=letter")
    page = client.get("/").text
    assert 'href="/mat.pdf?mat=a3&amp;paper=a4"' in page
    assert 'href="/mat.pdf?mat=foot&amp;paper=a4"' in page
