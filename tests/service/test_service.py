"""The service: from an upload to numbers and files, its limits, and what survives a restart."""

import io
import json
import multiprocessing
import os
import shutil
import signal
import zipfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from fastapi.testclient import TestClient
from photographs import drawn, write
from services import BreakablePool, awaited, ended, joint_estimate_of, post, settings_for
from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware
from workbooks import cells

from data.captures.preview import show
from data.captures.reader import read_capture
from drapenet.export.formats import TARGETS
from drapenet.fabric.stages import by_network
from drapenet.network.checkpoint import read_header
from drapenet.result.document import EstimateDocument
from drapenet.service.app import create_app
from drapenet.service.database import ENDED
from drapenet.service.jobs import Jobs
from drapenet.service.limits import Places

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "captures" / "twill"
PHOTOGRAPH = EXAMPLE.parent / "twill_photograph"
PICTURES = sorted(EXAMPLE.glob("*.png"))


@pytest.fixture(scope="module")
def finished(client) -> dict:
    begun = post(client, [*PICTURES, EXAMPLE / "capture.yaml"], name="Twill <b> 7",
                 notes="navy, roll 12\nÖko")
    assert begun.status_code == 202
    return ended(client, begun.json()["id"])


@pytest.fixture(scope="module")
def unstated(untrained_checkpoint) -> EstimateDocument:
    """The estimate of the photograph alone."""
    return by_network(read_capture(PHOTOGRAPH), read_header(untrained_checkpoint)).document


@pytest.fixture(scope="module")
def known(unstated) -> dict:
    """A known value at the upper end of what the photograph lets expect."""
    length = unstated.laboratory["warp"].bending_length_mm.interval_68[1]
    return {"bending_length_mm": {"warp": round(length, 2)},
            "error_percent": {"bending_length_mm": 2}}


@pytest.fixture(scope="module")
def photographed(client, known) -> dict:
    """The estimate of the photograph and the known value."""
    content = client.get("/examples/twill_photograph.zip").content
    begun = client.post("/estimates", files=[("files", ("a.zip", content))], data={
        f"known.{key}.{name}": str(value) for key, values in known.items()
        for name, value in values.items()})
    assert begun.status_code == 202, begun.text
    return ended(client, begun.json()["id"])


def test_files_are_whole_and_say_nothing_of_the_server(client, finished):
    results = str(client.app.state.jobs.settings.folder)
    assert (finished["state"], finished["error"]) == ("done", None)
    for name in ("estimate.json", "report.html", "report.pdf", "report.png", "preview.png",
                 "drape.glb", "torque.svg"):
        answer = client.get(f"/estimates/{finished['id']}/{name}")
        assert answer.status_code == 200 and len(answer.content) > 1000, name
        assert results.encode() not in answer.content, name
    page = client.get(f"/estimates/{finished['id']}/report.html").text
    assert "<b>" not in page and "Twill" in page and "from 4 depth views of" in page
    scene = trimesh.load(io.BytesIO(client.get(f"/estimates/{finished['id']}/drape.glb").content),
                         file_type="glb")
    assert set(scene.geometry) == {"captured", "simulated", "support"}
    assert not (client.app.state.jobs.settings.folder / finished["id"] / "uploaded").exists()


def test_a_photograph_is_shown_with_its_outline_and_has_a_report(client, photographed):
    address, read = f"/estimates/{photographed['id']}", read_capture(PHOTOGRAPH)
    assert client.get(f"{address}/preview.png").content == show(read)
    shapes = client.get(f"{address}/drape.glb").content
    assert set(trimesh.load(io.BytesIO(shapes), file_type="glb").geometry) == {
        "simulated", "support"}
    assert {"report.png", "torque.svg"} <= set(photographed["files"])
    assert "from the outline of the drape from above" in client.get(f"{address}/report.html").text
    seen = photographed["estimate"]["capture"]
    assert seen["views"] == 0
    # The hem lies below the plate, so that it looks smaller than it is to a phone at 0.5 m.
    assert 0 < seen["drape_coefficient_percent"] - 100 * read.outline.drape_coefficient < 20


@pytest.fixture
def idle(monkeypatch) -> None:
    """The web process cannot read an estimate for an export."""
    def refuse(*arguments: object) -> None:
        raise AssertionError("computed in the web process")

    monkeypatch.setattr("drapenet.export.material.read_material", refuse)
    monkeypatch.setattr("drapenet.report.overview.fabrics_workbook", refuse)


def test_values_with_a_capture_move_its_estimate(unstated, known, photographed):
    before = unstated.laboratory["warp"].bending_length_mm
    found, value = photographed["estimate"], known["bending_length_mm"]["warp"]
    after = found["laboratory"]["warp"]["bending_length_mm"]
    assert before.median < after["median"] < 1.02 * value
    assert np.ptp(after["interval_68"]) < np.ptp(before.interval_68) / 2
    assert found["capture"]["known"]["bending_length_mm"]["warp"] == value
    assert found["capture"]["labels"]["fabric"] == photographed["fabric_name"]
    assert not found["contradictions"]


@pytest.mark.usefixtures("idle")
def test_exports_can_be_fetched(client, finished):
    for name, target in TARGETS.items():
        answer = client.get(f"/estimates/{finished['id']}/export/{name}")
        assert answer.status_code == 200, (name, answer.text)
        title = answer.headers["content-disposition"].partition("filename=")[2].strip('"')
        if title.endswith(".zip"):
            inside = zipfile.ZipFile(io.BytesIO(answer.content)).infolist()
            assert any(one.filename.endswith(target.file) for one in inside) and len(inside) > 1
            assert all(one.compress_size < one.file_size for one in inside)
        else:
            assert title == f"Twill_b_7-{target.file}"
    answer = client.get(f"/estimates/{finished['id']}/export/newton?edge_mm=500")
    assert answer.status_code == 422 and "edge_mm" in answer.json()["error"]


def test_bad_capture_fails_with_its_sentence_and_can_be_removed(client):
    begun = post(client, [PICTURES[0]], density_g_m2="200", fx="305", fy="305", cx="119.5",
                 cy="89.5", depth_unit_m="1", tester="square300_cylinder100")
    found = ended(client, begun.json()["id"])
    assert found["state"] == "failed" and found["estimate"] is None
    assert "depth" in found["error"] and "/" not in found["error"].split(";")[0]
    assert client.delete(f"/fabrics/{found['fabric']}").status_code == 204
    assert client.get(f"/estimates/{found['id']}").status_code == 404
    assert not (client.app.state.jobs.settings.folder / found["id"]).exists()


def test_photograph_of_unknown_scale_fails_with_its_sentence(client, tmp_path):
    folder = write(tmp_path / "drawn", drawn())
    begun = post(client, [folder / "outline.png"], density_g_m2="200", camera_height_mm="1200",
                 tester="disc300_support180")
    found = ended(client, begun.json()["id"])
    assert found["state"] == "failed"
    assert found["error"].startswith("outline.png: the scale is not known: lay the printed mat")


def test_unknown_addresses_are_404_and_unfinished_files_409(client, finished):
    identity = finished["id"]
    for address in ("/estimates/nothing", f"/estimates/{'a' * 22}", "/estimates/..%2f..%2fetc",
                    f"/estimates/{identity}/state.json", f"/estimates/{identity}/export/nothing",
                    f"/estimates/{identity}/..%2f{identity}%2fstate.json", "/static/../app.py",
                    "/examples/..zip", "/examples/nothing.zip"):
        answer = client.get(address)
        assert answer.status_code == 404, address
        assert "Traceback" not in answer.text
    database = client.app.state.jobs.database
    database.add_estimate("b" * 22, "c" * 22, "x", about=("waiting", ""))
    assert client.get(f"/estimates/{'b' * 22}/report.png").status_code == 409
    for rest in ("export/json", "files.zip"):
        assert client.get(f"/estimates/{'b' * 22}/{rest}").status_code == 409
    assert client.delete(f"/fabrics/{'c' * 22}").status_code == 409
    database.remove("fabric", "c" * 22)
    assert client.get(f"/estimates/{'b' * 22}").status_code == 404


def test_refusals_are_sentences(client):
    jobs = client.app.state.jobs
    assert client.post("/estimates", content=b"x").status_code == 415
    large = client.post("/estimates", files=[("files", ("a.png", b"\0" * 34_000_000))])
    assert large.status_code == 413 and "MB" in large.json()["error"]
    chunked = client.post("/estimates", content=b"x", headers={"transfer-encoding": "chunked"})
    assert chunked.status_code == 411 and "chunks" in chunked.json()["error"]
    form = {"content-type": "multipart/form-data; boundary=x"}
    assert client.post("/estimates", content=b"--x\r\nnonsense", headers=form).status_code == 422
    foreign = client.post("/estimates", headers={"origin": "http://elsewhere.example"},
                          files=[("files", ("a.png", b""))])
    assert foreign.status_code == 403
    assert foreign.headers["x-content-type-options"] == "nosniff"
    twice = client.post("/estimates", files=[("files", ("a.png", b"")), ("name", (None, "one")),
                                             ("name", (None, "two"))])
    assert twice.status_code == 422 and "'name' is given twice" in twice.json()["error"]
    assert client.get("/", headers={"host": "elsewhere.example"}).status_code == 400
    for k in range(jobs.settings.queue):  # all are free: no refusal keeps a place
        jobs.places.take(f"client {k}")
    try:
        full = post(client, PICTURES)
        assert full.status_code == 429 and "try again" in full.json()["error"]
        assert full.headers["retry-after"]
    finally:
        for k in range(jobs.settings.queue):
            jobs.places.give(f"client {k}")


def test_a_trusted_proxy_states_the_client(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(Places, "take", lambda self, client: seen.append(client))
    monkeypatch.setattr(Places, "give", lambda self, client: None)
    for proxies, client in (("10.0.0.1", "192.0.2.7"), ("", "10.0.0.1")):
        settings = replace(settings_for(tmp_path), proxies=proxies)
        app = create_app(settings)
        app.state.jobs = SimpleNamespace(places=Places("", total=1, each=1), settings=settings)
        wrapped = ProxyHeadersMiddleware(app, trusted_hosts=settings.proxies) if proxies else app
        asked = TestClient(wrapped, base_url="http://localhost", client=("10.0.0.1", 5))
        asked.post("/estimates", headers={"x-forwarded-for": "192.0.2.7"}, content=b"")
        assert seen[-1] == client


def test_page_and_interface_ask_no_other_host(client):
    for address in ("/", "/docs", "/static/app.js", "/static/outline.js", "/static/viewer.js",
                    "/static/style.css"):
        answer = client.get(address)
        assert answer.status_code == 200
        assert "http://" not in answer.text.replace("http://www.w3.org", ""), address
        assert "https://" not in answer.text, address
        assert "default-src 'self'" in answer.headers["content-security-policy"]
    described = client.get("/openapi.json").json()
    answers = described["paths"]["/estimates"]["post"]["responses"]
    assert {"413", "415", "422", "429"} <= set(answers)
    sizes = sum(len(client.get(address).content) for address in (
        "/", "/static/app.js", "/static/viewer.js", "/static/style.css", "/static/three.js"))
    assert sizes < 2_000_000


@pytest.mark.slow
def test_worker_that_dies_is_a_failure_of_its_estimate_alone(client):
    begun = post(client, [*PICTURES, EXAMPLE / "capture.yaml"]).json()
    awaited(client, begun["url"], lambda found: found["state"] == "running")
    for worker in multiprocessing.active_children():
        os.kill(worker.pid, signal.SIGKILL)  # also those of other pools
    found = ended(client, begun["id"])
    assert found["state"] == "failed" and "report this capture" in found["error"]
    again = post(client, [*PICTURES, EXAMPLE / "capture.yaml"]).json()
    assert ended(client, again["id"])["state"] == "done"


@pytest.fixture(scope="module")
def joined(client, finished) -> dict:
    """The joint estimate of the finished capture and of another."""
    identity = finished["fabric"]
    more = post(client, [*PICTURES[:2], EXAMPLE / "capture.yaml"], fabric=identity,
                label="two views", turns_deg="0, 90")
    assert more.json()["fabric"] == identity, more.text
    assert ended(client, more.json()["id"])["state"] == "done"
    return joint_estimate_of(client, identity)


def test_captures_of_a_fabric_have_one_join(client, finished, joined):
    assert joined["state"] == "done", joined["error"]
    document = joined["estimate"]
    assert joined["members"] == [part["id"] for part in client.get(
        f"/fabrics/{finished['fabric']}").json()["estimates"][:2]]
    assert document["capture"]["sources"] == ["Twill_b_7/capture_1", "Twill_b_7/two_views"]
    assert len(joined["curves"]["warp"]["median"]) == len(joined["curves"]["curvature_1_m"])
    assert client.get(f"/estimates/{joined['id']}/export/jfab").status_code == 200


def test_the_same_views_are_joined_once_said_and_can_be_removed(client, finished, joined):
    taken = post(client, [*PICTURES, EXAMPLE / "capture.yaml"], fabric=finished["fabric"],
                 label="two views")
    assert taken.status_code == 422 and taken.json()["error"].startswith("label=two views")
    jobs, again = client.app.state.jobs, "a" * 32  # as its estimate would be
    shutil.copytree(jobs.settings.folder / finished["id"], jobs.settings.folder / again)
    jobs.database.add_estimate(again, finished["fabric"], "capture 2", state="done",
                               estimate=finished["estimate"],
                               task=jobs.database.estimate(finished["id"])["task"])
    jobs._join(finished["fabric"])
    found = awaited(client, f"/estimates/{joined['id']}", lambda found: (
        found["state"] == "done" and "twin_left_out" in str(found["warnings"])))
    twin, = (one["text"] for one in found["warnings"] if one["code"] == "twin_left_out")
    assert "the same pictures as" in twin and "/root" not in twin
    assert found["estimate"]["moduli"] == joined["estimate"]["moduli"]
    assert client.delete(f"/estimates/{again}").status_code == 204
    assert ended(client, joined["id"])["state"] == "done"
    assert client.get(f"/estimates/{again}").status_code == 404


def test_fabrics_are_named_noted_and_searched(client, finished):
    identity = finished["fabric"]
    found = client.get("/fabrics", params={"search": "öko TWILL square300"}).json()["fabrics"]
    assert [row["id"] for row in found] == [identity]
    assert found[0]["estimate"]["capture"]["density_g_m2"] == 210
    assert client.get("/fabrics", params={"search": "twill jersey"}).json()["fabrics"] == []
    assert client.get("/fabrics", params={"search": "100%"}).json()["fabrics"] == []
    address = f"/fabrics/{identity}"
    changed = client.patch(address, json={"notes": "roll 13; DROP TABLE fabric"}).json()
    assert changed["name"] == "Twill <b> 7" and changed["notes"].startswith("roll 13")
    for body, status in (({"name": "x" * 81}, 422), ({"name": "a\nb"}, 422), ({"id": "x"}, 422),
                         ([], 422), ({"notes": "x" * 70_000}, 413), ({"notes": "\ud800"}, 422)):
        answer = client.patch(address, content=json.dumps(body),
                              headers={"content-type": "application/json"})
        assert answer.status_code == status, body
        assert answer.json()["error"]
    assert client.patch(f"/fabrics/{'q' * 22}", json={}).status_code == 404
    assert client.get("/fabrics?count=0").status_code == 422


def test_the_zip_of_all_fabrics_is_a_folder_of_results(client, finished, tmp_path, monkeypatch):
    answer = client.get("/fabrics.zip")
    assert answer.status_code == 200 and answer.headers["content-type"] == "application/zip"
    with zipfile.ZipFile(io.BytesIO(answer.content)) as packed:
        packed.extractall(tmp_path)
        table = packed.read("fabrics.csv").decode().splitlines()
    assert table[0].startswith("fabric,capture,folder,density_g_m2,")
    assert any(line.startswith(f"Twill <b> 7,capture 1,{finished['id']},210,") for line in table)
    monkeypatch.setattr("drapenet.service.pools.ProcessPool", BreakablePool)
    content = Jobs(settings_for(tmp_path)).row("estimate", finished["id"])
    assert content["estimate"] == finished["estimate"]
    assert (tmp_path / finished["id"] / "drape.glb").exists()


@pytest.mark.usefixtures("idle")
def test_all_files_of_an_estimate_come_in_a_zip(client, finished):
    address = f"/estimates/{finished['id']}/files.zip"
    answer = client.get(address, params={"curvature_1_m": 50})
    title = answer.headers["content-disposition"].partition("filename=")[2]
    assert title == '"Twill_b_7-files.zip"'
    with zipfile.ZipFile(io.BytesIO(answer.content)) as packed:
        found = {name: packed.read(name) for name in packed.namelist()}
    for name in finished["files"]:
        assert found[name] == client.get(f"/estimates/{finished['id']}/{name}").content, name
    assert {target.file for target in TARGETS.values()} <= set(found)
    assert json.loads(found["fabric.jfab"])["drapenet"]["modulus_at_curvature_1_m"] == 50
    refused = client.get(address, params={"edge_mm": 500})
    assert refused.status_code == 422 and "edge_mm=500" in refused.json()["error"]


def test_a_photograph_of_another_fabric_is_said(client, finished):
    again = post(client, [*PICTURES, EXAMPLE / "capture.yaml"], name="serge").json()
    assert not [one for one in ended(client, again["id"])["warnings"]
                if one["code"] == "twin_elsewhere"]  # such as with a corrected density
    same = client.get(f"/estimates/{again['id']}/same_pictures").json()
    assert {"id": finished["id"], "name": finished["name"], "fabric_name": "Twill <b> 7"} in same
    like, *_ = client.get(f"/estimates/{again['id']}/alike?count=1").json()
    assert like["fabric"] == "Twill <b> 7" and like["probability"] == pytest.approx(
        like["highest"], abs=0.02)
    client.delete(f"/fabrics/{again['fabric']}")
    assert client.get(f"/estimates/{again['id']}/same_pictures").json() == []


@pytest.mark.usefixtures("idle")
def test_the_table_of_the_fabrics_that_a_search_finds(client, finished):
    answer = client.get("/fabrics.xlsx", params={"search": "<b> twill"})
    assert 'filename="results.xlsx"' in answer.headers["content-disposition"]
    row = cells(io.BytesIO(answer.content), 1)[0]
    listed, = client.get("/fabrics", params={"search": "<b> twill"}).json()["fabrics"]
    assert row["fabric"] == listed["name"] == "Twill <b> 7"
    median = listed["estimate"]["moduli"]["warp"]["alpha_uN_m"]["median"]
    assert row["α median [µN·m]"] == pytest.approx(median)
    assert client.get("/fabrics.xlsx", params={"search": "x" * 201}).status_code == 422


def test_the_manual_is_a_page(client):
    page = client.get("/manual/service.md")
    assert page.status_code == 200 and "<table>" in page.text and 'id="for-programs"' in page.text
    assert client.get("/manual/images/page.png").status_code == 200
    for name in ("nothing.md", "..%2fREADME.md", "../serve.py", "%2e%2e/serve.py"):
        assert client.get(f"/manual/{name}").status_code == 404, name


@pytest.mark.slow
def test_a_garment_is_simulated_when_it_is_asked_for(client, finished):
    assert client.post("/estimates/none/garment").status_code == 404
    place = f"/estimates/{finished['id']}"
    assert client.post(f"{place}/garment").status_code == 202
    garment = awaited(client, place, lambda found: found["garment"]["state"] in ENDED)["garment"]
    assert (garment["state"], garment["error"]) == ("done", None)
    scene = trimesh.load(io.BytesIO(client.get(f"{place}/garment.glb").content), "glb")
    assert len(scene.geometry) == 12
    assert client.get(f"{place}/garment.png").content.startswith(b"\x89PNG")
