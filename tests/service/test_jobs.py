"""Fabrics and estimates of a service whose workers finish nothing, and its pools of processes."""

import asyncio
import threading
import time
from dataclasses import replace
from sqlite3 import OperationalError
from types import SimpleNamespace

import pytest
from pebble import ProcessFuture
from services import BreakablePool, settings_for

from common.errors import InputError
from drapenet.service import app
from drapenet.service.archive import COPY
from drapenet.service.database import database_in
from drapenet.service.forms import About
from drapenet.service.jobs import Jobs
from drapenet.service.limits import Places, RequestError
from drapenet.service.seen import LOOK
from drapenet.service.uploads import MARKED, UNMARKED, YARNS, Upload
from drapenet.service.work import preview


@pytest.fixture(autouse=True)
def without_workers(monkeypatch):
    monkeypatch.setattr("drapenet.service.pools.ProcessPool", BreakablePool)


@pytest.fixture
def jobs(tmp_path) -> Jobs:
    return Jobs(settings_for(tmp_path))


def submitted(
    jobs: Jobs, fabric: str = "", label: str = "", directions: str = "",
    density: float | None = None
) -> dict[str, str]:
    jobs.places.take("x")
    return jobs.submit(Upload({"scan.obj": b"v 0 0 0"}, "scan.obj", "a", About(label=label),
                              fabric=fabric, directions=directions, density_g_m2=density), "x")


def with_captures(jobs: Jobs, states: list[str], members: list[str] | None = None) -> str:
    """A fabric with captures 0, 1 and so on, and a joint estimate of ``members``, under way."""
    for k, state in enumerate(states):
        (jobs.settings.folder / str(k)).mkdir()
        jobs.database.add_estimate(str(k), "f", f"label {k}", state=state, ended=time.time(),
                                   about=None if k else ("fabric", ""))
    if members:
        jobs.database.add_estimate("joint", "f", "all captures", members=members)
    return "f"


def test_a_garment_takes_one_place_and_is_lost_with_its_service_or_its_estimate(jobs):
    with_captures(jobs, ["done"])
    for _ in range(2):
        jobs.preview("0", "x")
        assert jobs.database.garment("0") == {"state": "queued", "progress": None, "error": None}
    taken = jobs.settings.queue - 1  # places that are left
    for _ in range(taken):
        jobs.places.take("x")
    with pytest.raises(RequestError, match="are waiting or under way"):
        jobs.places.take("x")
    again = Jobs(jobs.settings)
    assert again.database.garment("0")["state"] == "interrupted"
    again.preview("0", "x")
    [task] = again.workers._unfinished
    task.set_exception(RuntimeError("not for clients"))
    found = again.database.garment("0")
    assert found["state"] == "failed" and found["error"].startswith("the garment failed by a fault")
    again.database.add_estimate("0", "f", "label 0")  # anew
    assert again.database.garment("0") is None


def test_a_worker_writes_a_garment_unless_its_estimate_is_gone(jobs, monkeypatch):
    with_captures(jobs, ["done", "done"])
    written, refused = [], InputError("no skirt of the fabric converged")

    def simulate(estimate, run):
        seen = [(value, jobs.database.garment(estimate)["progress"])
                for value in run(dict, [{"x": 1}, {"x": 2}])]
        assert seen == [({"x": 1}, None), ({"x": 2}, {"made": 1, "expected": 13})]
        if estimate == "1":
            raise refused
        return SimpleNamespace(write=written.append)

    monkeypatch.setattr("drapenet.report.garment.preview", simulate)
    monkeypatch.setattr("drapenet.result.files.read_estimate", lambda folder: (folder.name, None))
    for identity in ("0", "1"):
        jobs.database.add_garment(identity)
        preview(jobs.settings.folder / identity)
    assert jobs.database.garment("0")["state"] == "done"
    assert written == [jobs.settings.folder / "0"]
    assert jobs.database.garment("1")["error"] == str(refused)


@pytest.mark.parametrize("joined", [False, True])
def test_a_fabric_takes_16_captures_beside_those_that_failed(jobs, joined):
    states = ["done"] * 15 + ["failed", "interrupted"]
    fabric = with_captures(jobs, states, ["0", "1"] if joined else None)
    assert submitted(jobs, fabric)["fabric"] == fabric  # the sixteenth
    with pytest.raises(RequestError, match="has 16 captures, the most that are joined; remove"):
        submitted(jobs, fabric)


def test_a_label_is_of_one_capture(jobs):
    fabric = with_captures(jobs, ["done"])
    with pytest.raises(RequestError, match="label=label 0 is that of another capture"):
        submitted(jobs, fabric, "label 0")


@pytest.mark.parametrize("kinds", [(UNMARKED, YARNS), (YARNS, UNMARKED)])
def test_values_along_the_yarns_and_captures_without_a_warp_are_kept_apart(jobs, kinds):
    for one, other in ((MARKED, YARNS), (UNMARKED, ""), (UNMARKED, UNMARKED)):
        submitted(jobs, submitted(jobs, directions=one)["fabric"], directions=other)
        for _ in (one, other):
            jobs.places.give("x")
    fabric = submitted(jobs, directions=kinds[0])["fabric"]
    with pytest.raises(RequestError, match="values along the yarns, of a fabric need captures "
                                           "whose warp is marked: state its direction"):
        submitted(jobs, fabric, directions=kinds[1])


def test_a_density_of_another_fabric_is_refused_before_its_estimate(jobs):
    first = submitted(jobs, density=210.0)
    fabric = first["fabric"]
    submitted(jobs, fabric, density=229.0)
    with pytest.raises(RequestError, match=r"from 210 \(capture 1\) to 232 g/m² \(this one\), more "
                       r"than 10% apart; correct density_g_m2.* or remove the wrong capture$"):
        submitted(jobs, fabric, density=232.0)
    jobs.database.change("estimate", first["id"], state="failed")  # it is not joined
    jobs.places.give("x")
    submitted(jobs, fabric, density=232.0)


def test_a_fabric_that_cannot_be_joined_stands_for_its_drape_and_says_so(jobs):
    fabric = with_captures(jobs, ["done", "done"], ["0", "1"])
    jobs.database.change("estimate", "0", estimate={"capture": {"rig": "disc300_support180"}})
    jobs.database.change("estimate", "1", estimate={"capture": {"rig": ""}})
    jobs.database.change("estimate", "joint", state="failed", error="no warp")
    (row,) = jobs.database.fabrics([])
    assert row["id"] == fabric and row["result"] == "0" and row["apart"] == "no warp"


def test_a_capture_is_not_lost_in_a_removal_of_its_fabric(jobs, monkeypatch):
    """It is sent after the fabric has been checked, and before it is removed."""
    fabric, remove, outcome = with_captures(jobs, ["done"]), jobs.database.remove, []

    def submit() -> None:
        try:
            outcome.append(submitted(jobs, fabric)["id"])
        except RequestError as error:
            outcome.append(error.status_code)

    sending = threading.Thread(target=submit)

    def slowly(table: str, identity: str) -> None:
        sending.start()
        sending.join(0.5)  # a capture that is taken meanwhile would be removed
        remove(table, identity)

    monkeypatch.setattr(jobs.database, "remove", slowly)
    jobs.remove("fabric", fabric)
    sending.join()
    assert outcome == [404]


def test_what_a_joint_estimate_reads_stays_until_its_end(jobs):
    with_captures(jobs, ["done", "done", "done", "failed"], ["0", "1", "2"])
    for table, identity in (("estimate", "1"), ("estimate", "joint"), ("fabric", "f")):
        with pytest.raises(RequestError, match="under way"):
            jobs.remove(table, identity)
    jobs.remove("estimate", "3")
    jobs.database.change("estimate", "joint", state="done")
    (jobs.settings.folder / "joint").mkdir()
    jobs.remove("estimate", "1")
    assert jobs.row("estimate", "joint")["members"] == ["0", "2"]
    jobs.database.change("estimate", "joint", state="done")
    jobs.remove("estimate", "2")  # one capture is left: nothing to join
    assert [row["id"] for row in jobs.row("fabric", "f")["estimates"]] == ["0"]
    assert [one.name for one in jobs.settings.folder.iterdir() if one.is_dir()] == ["0"]


def test_a_broken_pool_of_exports_is_replaced_once(jobs, monkeypatch):
    made = []

    class Pool(BreakablePool):
        def __init__(self, **options: object) -> None:
            super().__init__(**options)
            made.append(self)
            time.sleep(0.2)  # in which another export may come

        def schedule(self, function: object, **options: object) -> ProcessFuture:
            future = ProcessFuture()
            future.set_result("exported")
            return future

    monkeypatch.setattr("drapenet.service.pools.ProcessPool", Pool)
    broken, outcomes = jobs.exports._pool, []
    broken.active = False
    threads = [threading.Thread(target=lambda: outcomes.append(jobs.exports.outcome(print)))
               for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert outcomes == ["exported"] * 3
    assert made == [jobs.exports._pool] and broken.joined


@pytest.mark.parametrize("begun", [COPY, LOOK])
def test_temporary_files_of_a_killed_service_are_removed(tmp_path, begun):
    (tmp_path / f"{begun}abc").mkdir()
    (tmp_path / f"{begun}abc" / "file").write_bytes(b"x")
    Jobs(settings_for(tmp_path))
    assert not list(tmp_path.glob(f"{begun}*"))


def test_a_client_has_some_of_the_places():
    places = Places("estimates", total=3, each=2)
    places.take("a")
    places.take("a")
    with pytest.raises(RequestError, match="2 estimates of your address"):
        places.take("a")
    places.take("b")
    with pytest.raises(RequestError, match="3 estimates are waiting"):
        places.take("c")
    places.give("a")
    places.take("a")


def test_a_restart_goes_on_with_what_was_under_way(tmp_path):
    settings = settings_for(tmp_path)
    database = database_in(tmp_path)
    kept, waiting, lost, joint = (letter * 22 for letter in "kwlj")
    for identity, values in ((kept, {"state": "done", "ended": time.time()}),
                             (waiting, {"state": "running", "tries": 1}),
                             (lost, {"state": "running", "tries": 3})):
        (tmp_path / identity / "uploaded").mkdir(parents=True)
        database.add_estimate(identity, identity, "a", about=(identity, ""), task={}, **values)
    database.add_estimate(joint, kept, "b", state="done")  # two captures, not yet joined
    torn = tmp_path / ("t" * 22) / "uploaded"
    torn.mkdir(parents=True)
    (tmp_path / "photographs").mkdir()  # not of the service
    jobs = Jobs(settings)
    assert {key: jobs.row("estimate", key)["state"] for key in (kept, waiting, lost)} == {
        kept: "done", waiting: "queued", lost: "interrupted"}
    assert not torn.exists() and (tmp_path / "photographs").exists()
    assert (tmp_path / waiting / "uploaded").exists()
    assert not (tmp_path / lost / "uploaded").exists()
    assert jobs.row("fabric", kept)["estimates"][-1]["members"] == [kept, joint]


def test_the_oldest_fabrics_go(tmp_path):
    jobs = Jobs(replace(settings_for(tmp_path), keep=2, keep_hours=100 / 3600))
    for letter, age in (("a", 200), ("b", 50), ("c", 20), ("d", 10)):
        identity = letter * 22
        (tmp_path / identity).mkdir()
        jobs.database.add_estimate(identity, identity, "x", about=(letter, ""), state="done",
                                   created=time.time() - 1000, ended=time.time() - age)
    jobs.database.add_estimate("e" * 22, "f" * 22, "x", about=("under way", ""), created=0.0)
    jobs.tidy()  # "a" is too old, "b" the oldest of three
    assert {one.name[0] for one in tmp_path.iterdir() if one.is_dir()} == {"c", "d"}
    assert {row["name"] for row in jobs.database.fabrics([], 0, 9)} == {"c", "d", "under way"}


def test_a_broken_pool_is_replaced_and_its_places_come_back(jobs):
    first, second = (submitted(jobs)["id"] for _ in range(2))
    broken = jobs.workers._pool
    broken.active = False
    third = submitted(jobs)["id"]
    assert broken.joined and jobs.workers._pool is not broken
    assert [jobs.row("estimate", one)["state"] for one in (first, second, third)] == [
        "failed", "failed", "queued"]
    assert "report this capture" in jobs.row("estimate", first)["error"]
    for _ in range(jobs.settings.queue - 1):
        jobs.places.take("y")
    with pytest.raises(RequestError):
        jobs.places.take("y")


@pytest.mark.parametrize("added", [False, True])
def test_an_estimate_that_cannot_be_begun_does_not_wait_without_its_files(jobs, monkeypatch, added):
    fabric = with_captures(jobs, ["done"]) if added else ""

    def refuse(self: Jobs, *arguments: object) -> None:
        raise OSError("no process can be started")

    monkeypatch.setattr(Jobs, "_schedule", refuse)
    with pytest.raises(RequestError) as refused:
        submitted(jobs, fabric)
    assert refused.value.status_code == 507
    assert [row["id"] for row in jobs.database.estimates()] == ["0"] * added
    assert len(jobs.database.fabrics([], 0, 9)) == added
    assert [one.name for one in jobs.settings.folder.iterdir() if one.is_dir()] == ["0"] * added
    for _ in range(jobs.settings.queue):  # its place is free again
        jobs.places.take("y")


def test_what_is_not_named_is_numbered_by_its_kind(jobs):
    fabric = with_captures(jobs, ["done"])
    for kind in ("capture", "strips", "values", "values"):
        jobs.places.take("x")
        jobs.submit(Upload({}, "", "a", About(), fabric=fabric, kind=kind), "x")
        jobs.places.give("x")
    assert [row["name"] for row in jobs.row("fabric", fabric)["estimates"]][1:] == [
        "capture 1", "strips 1", "values 1", "values 2"]


def test_the_text_of_an_exception_is_for_the_log(jobs, tmp_path, caplog):
    identity = submitted(jobs)["id"]
    future, = jobs.workers._unfinished
    future.set_exception(OSError(f"cannot open {tmp_path}/secret"))
    state = jobs.row("estimate", identity)
    assert state["state"] == "failed" and "secret" not in state["error"]
    assert "secret" in caplog.text and identity in caplog.text


def test_what_hinders_a_joint_estimate_is_logged_and_stated(jobs, monkeypatch, caplog):
    with_captures(jobs, ["done", "queued"])
    schedule = jobs._schedule

    def broken(identity: str, client: str | None = None) -> None:
        raise RuntimeError("no worker for it")

    monkeypatch.setattr(jobs, "_schedule", broken)
    jobs.database.change("estimate", "1", state="done")
    future = ProcessFuture()
    future.set_result(None)
    jobs._ended("1", None, future)
    (row,) = jobs.database.fabrics([])
    assert "no worker for it" in caplog.text and row["id"] in caplog.text
    assert "report this capture" in row["apart"] and row["result"] == "1"
    monkeypatch.setattr(jobs, "_schedule", schedule)
    with_third = submitted(jobs, "f")["id"]  # then all are joined anew
    jobs.database.change("estimate", with_third, state="done")
    jobs._join("f")
    assert jobs.row("fabric", "f")["estimates"][-1]["state"] == "queued"


def test_an_end_that_cannot_be_stored_is_logged(jobs, monkeypatch, caplog):
    def full(*arguments: object, **values: object) -> None:
        raise OperationalError("database or disk is full")

    monkeypatch.setattr(jobs.database, "change", full)
    jobs._end("estimate", "a", "failed", "not finished")
    assert "the end of the estimate a is not stored" in caplog.text and "full" in caplog.text


def test_tidying_goes_on_after_an_error(monkeypatch, caplog):
    """Of the database, say, on a full disk: the case that old results are removed for."""
    calls = []

    class Full:
        def tidy(self) -> None:
            calls.append("tidy")
            raise OperationalError("database or disk is full")

    monkeypatch.setattr(app, "_TIDY_INTERVAL", 0.01)
    with pytest.raises(TimeoutError):
        asyncio.run(asyncio.wait_for(app._tidy(Full()), timeout=1))
    assert len(calls) > 1 and "database or disk is full" in caplog.text
