"""The service: from an upload to numbers and files, its limits, and what survives a restart."""

import io
import json
import multiprocessing
import os
import signal
import time
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from fastapi.testclient import TestClient
from pebble import ProcessFuture

from common.command import compose_config
from data.captures.capture import read_capture
from data.captures.preview import outline_picture
from drapenet.config import ServeConfig
from drapenet.export.formats import TARGETS
from drapenet.inference import network_estimate
from drapenet.network.checkpoint import read_header
from drapenet.service.app import create_app
from drapenet.service.jobs import Jobs
from drapenet.service.uploads import RequestError, Upload
from drapenet.service.work import change_state

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "captures" / "twill"
PHOTOGRAPH = EXAMPLE.parent / "twill_photograph"
PICTURES = sorted(EXAMPLE.glob("*.png"))


def settings_for(results: Path, checkpoint: Path | str = "") -> ServeConfig:
    words = [f"results={results}", f"checkpoint={checkpoint}", "workers=1", "queue=3"]
    return compose_config("serve", words, schema=ServeConfig)


@pytest.fixture(scope="module")
def client(tmp_path_factory, untrained_checkpoint):
    results = tmp_path_factory.mktemp("results")
    app = create_app(settings_for(results, untrained_checkpoint))
    with TestClient(app, base_url="http://localhost") as client:
        yield client


def post(client: TestClient, files: list[Path], **fields: str):
    parts = [("files", (file.name, file.read_bytes())) for file in files]
    return client.post("/estimates", files=parts, data=fields)


def ended(client: TestClient, identity: str) -> dict:
    for _ in range(1200):
        found = client.get(f"/estimates/{identity}").json()
        if found["state"] in ("done", "failed", "interrupted"):
            return found
        time.sleep(0.1)
    raise AssertionError(f"not finished: {found}")


@pytest.fixture(scope="module")
def finished(client) -> dict:
    begun = post(client, [*PICTURES, EXAMPLE / "capture.yaml"], name="Twill <b> 7")
    assert begun.status_code == 202
    return ended(client, begun.json()["id"])


@pytest.fixture(scope="module")
def photographed(client) -> dict:
    content = client.get("/examples/twill_photograph.zip").content
    begun = client.post("/estimates", files=[("files", ("a.zip", content))])
    assert begun.status_code == 202, begun.text
    return ended(client, begun.json()["id"])


@pytest.mark.parametrize("name", ["finished", "photographed"])
def test_numbers_are_those_of_the_command(name, request, untrained_checkpoint):
    found = request.getfixturevalue(name)
    capture = read_capture(EXAMPLE if name == "finished" else PHOTOGRAPH)
    expected = network_estimate(capture, read_header(untrained_checkpoint)).estimate
    assert found["state"] == "done" and found["error"] is None
    moduli = found["estimate"]["moduli"]
    for k, direction in enumerate(("warp", "bias", "weft")):
        assert moduli[direction]["alpha_uN_m"]["median"] == pytest.approx(
            np.median(expected.moduli(capture.density)[0][:, k]) * 1e6, rel=1e-3)


def test_files_are_whole_and_say_nothing_of_the_server(client, finished):
    results = str(client.app.state.jobs.settings.folder)
    for name in ("estimate.json", "report.html", "report.png", "preview.png", "drape.glb",
                 "torque.svg"):
        answer = client.get(f"/estimates/{finished['id']}/{name}")
        assert answer.status_code == 200 and len(answer.content) > 1000, name
        assert results.encode() not in answer.content, name
    page = client.get(f"/estimates/{finished['id']}/report.html").text
    assert "<b>" not in page and "Twill" in page and "from 4 views at" in page
    scene = trimesh.load(io.BytesIO(client.get(f"/estimates/{finished['id']}/drape.glb").content),
                         file_type="glb")
    assert set(scene.geometry) == {"captured", "simulated", "support"}
    folder, _ = client.app.state.jobs.state(finished["id"])
    assert not (folder / "uploaded").exists()


def test_a_photograph_is_shown_with_its_outline_and_has_a_report(client, photographed):
    address, read = f"/estimates/{photographed['id']}", read_capture(PHOTOGRAPH)
    assert client.get(f"{address}/preview.png").content == outline_picture(read)
    shapes = client.get(f"{address}/drape.glb").content
    assert set(trimesh.load(io.BytesIO(shapes), file_type="glb").geometry) == {
        "simulated", "support"}
    assert {"report.png", "torque.svg"} <= set(photographed["files"])
    assert "from the outline from above at" in client.get(f"{address}/report.html").text
    seen = photographed["estimate"]["capture"]
    assert seen["views"] == 0
    # The hem lies below the plate, so that it looks smaller than it is.
    assert 0 < seen["drape_coefficient_percent"] - 100 * read.outline.drape_coefficient < 10


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


def test_bad_capture_fails_with_its_sentence(client):
    begun = post(client, [PICTURES[0]], density_g_m2="200", fx="305", fy="305", cx="119.5",
                 cy="89.5", depth_unit_m="1", tester="square300_cylinder100")
    found = ended(client, begun.json()["id"])
    assert found["state"] == "failed" and found["estimate"] is None
    assert "depth" in found["error"] and "/" not in found["error"].split(";")[0]


def test_photograph_of_unknown_scale_fails_with_its_sentence(client):
    begun = post(client, [PHOTOGRAPH / "outline.png"], density_g_m2="200", camera_height_mm="1200",
                 tester="disc300_support180")
    found = ended(client, begun.json()["id"])
    assert found["state"] == "failed"
    assert found["error"].startswith("outline.png: the scale is not known: give")


def test_unknown_addresses_are_404_and_unfinished_files_409(client, finished):
    identity = finished["id"]
    for address in ("/estimates/nothing", f"/estimates/{'a' * 22}", "/estimates/..%2f..%2fetc",
                    f"/estimates/{identity}/state.json", f"/estimates/{identity}/export/nothing",
                    f"/estimates/{identity}/..%2f{identity}%2fstate.json", "/static/../app.py",
                    "/examples/..zip", "/examples/nothing.zip"):
        answer = client.get(address)
        assert answer.status_code == 404, address
        assert "Traceback" not in answer.text
    jobs = client.app.state.jobs
    folder = jobs.settings.folder / ("b" * 22)
    change_state(folder, state="queued", id="b" * 22, name="x")
    try:
        assert client.get(f"/estimates/{'b' * 22}/report.png").status_code == 409
        assert client.get(f"/estimates/{'b' * 22}/export/json").status_code == 409
    finally:
        (folder / "state.json").unlink()
        folder.rmdir()


def test_refusals_are_sentences(client):
    jobs = client.app.state.jobs
    assert client.post("/estimates", content=b"x").status_code == 415
    large = client.post("/estimates", files=[("files", ("a.png", b"\0" * 34_000_000))])
    assert large.status_code == 413 and "MB" in large.json()["error"]
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
    for _ in range(jobs.settings.queue):  # all are free: no refusal keeps a place
        jobs.reserve()
    try:
        full = post(client, PICTURES)
        assert full.status_code == 429 and "try again" in full.json()["error"]
        assert full.headers["retry-after"]
    finally:
        for _ in range(jobs.settings.queue):
            jobs.release()


def test_page_and_interface_ask_no_other_host(client):
    for address in ("/", "/docs", "/static/app.js", "/static/viewer.js", "/static/style.css"):
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


def test_a_restart_keeps_results_and_says_what_it_lost(tmp_path):
    settings = replace(settings_for(tmp_path), keep=2, keep_hours=100 / 3600)
    kept, lost, torn, old = (tmp_path / (letter * 22) for letter in "klto")
    change_state(kept, id=kept.name, name="k", state="done", ended=time.time())
    change_state(lost, id=lost.name, name="l", state="running", stage="refining", ended=None)
    (lost / "uploaded").mkdir()
    (torn / "uploaded").mkdir(parents=True)
    change_state(old, id=old.name, name="o", state="done", ended=time.time() - 200)
    jobs = Jobs(settings)
    try:
        assert jobs.state(kept.name)[1]["state"] == "done"
        assert jobs.state(lost.name)[1]["state"] == "interrupted"
        assert "upload the capture again" in jobs.state(lost.name)[1]["error"]
        assert not (lost / "uploaded").exists() and not torn.exists()
        jobs.tidy()
        with pytest.raises(RequestError):
            jobs.state(old.name)
        change_state(tmp_path / ("m" * 22), state="failed", ended=time.time() - 50)
        jobs.tidy()  # the oldest of three goes
        assert {one.name for one in tmp_path.iterdir()} == {kept.name, lost.name}
    finally:
        jobs.close()


class BreakablePool:
    """A pool of workers that finish no task, ``active`` until a test breaks it."""

    def __init__(self, **options: object) -> None:
        self.active, self.joined = True, False

    def schedule(self, function: Callable, **options: object) -> ProcessFuture:
        return ProcessFuture()

    def stop(self) -> None:
        """Nothing: the status of a broken pool does not change."""

    def join(self, **options: object) -> None:
        self.joined = True


def test_a_broken_pool_is_replaced_and_its_places_come_back(tmp_path, monkeypatch):
    monkeypatch.setattr("drapenet.service.jobs.ProcessPool", BreakablePool)
    jobs = Jobs(settings_for(tmp_path))

    def submitted() -> str:
        jobs.reserve()
        return jobs.submit(Upload({"scan.obj": b"v 0 0 0"}, "scan.obj", "a"))

    first, second, broken = submitted(), submitted(), jobs._pool
    broken.active = False
    third = submitted()
    assert broken.joined and jobs._pool is not broken
    assert [jobs.state(one)[1]["state"] for one in (first, second, third)] == [
        "failed", "failed", "queued"]
    assert "report this capture" in jobs.state(first)[1]["error"]
    for _ in range(jobs.settings.queue - 1):
        jobs.reserve()
    with pytest.raises(RequestError):
        jobs.reserve()


def test_the_text_of_an_exception_is_for_the_log(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr("drapenet.service.jobs.ProcessPool", BreakablePool)
    jobs = Jobs(settings_for(tmp_path))
    jobs.reserve()
    identity = jobs.submit(Upload({"scan.obj": b"v 0 0 0"}, "scan.obj", "a"))
    future, = jobs._unfinished
    future.set_exception(OSError(f"cannot open {tmp_path}/secret"))
    state = jobs.state(identity)[1]
    assert state["state"] == "failed" and "secret" not in state["error"]
    assert "secret" in caplog.text and identity in caplog.text


@pytest.mark.slow
def test_worker_that_dies_is_a_failure_of_its_estimate_alone(client):
    begun = post(client, [*PICTURES, EXAMPLE / "capture.yaml"]).json()
    for _ in range(600):
        if client.get(begun["url"]).json()["state"] == "running":
            break
        time.sleep(0.05)
    for worker in multiprocessing.active_children():
        os.kill(worker.pid, signal.SIGKILL)  # also those of other pools
    found = ended(client, begun["id"])
    assert found["state"] == "failed" and "report this capture" in found["error"]
    again = post(client, [*PICTURES, EXAMPLE / "capture.yaml"]).json()
    assert ended(client, again["id"])["state"] == "done"


def test_an_unreadable_state_is_404(client):
    folder = client.app.state.jobs.settings.folder / ("z" * 22)
    folder.mkdir()
    (folder / "state.json").write_text(json.dumps([1]))
    assert client.get(f"/estimates/{folder.name}").status_code == 404
    (folder / "state.json").unlink()
    folder.rmdir()
