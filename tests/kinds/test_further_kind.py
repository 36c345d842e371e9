"""A further kind of measurement is one folder, this one, and a line in KINDS: it comes through
command, Python, batch, service and page without a change elsewhere."""

import csv
import json
import math
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from pebble import ThreadPool
from services import ended, joint_estimate_of, post, settings_for
from weighed_disc import FILE, WeighedDisc

import drapenet
import infer
from common.errors import InputError
from drapenet.measured import KINDS
from drapenet.service import pools
from drapenet.service.app import create_app

TWILL = Path("examples/captures/twill").resolve()
DIAMETER = 300.0
MASS = 210 * math.pi * (5e-4 * DIAMETER) ** 2
TEXT = f"mass_g: {MASS:.4f}\ndiameter_mm: {DIAMETER}\nknown:\n  membrane_n_per_m: 600\n"


@pytest.fixture(autouse=True)
def kind(monkeypatch):
    """The kind among those of the project."""
    monkeypatch.setitem(KINDS, FILE, f"{WeighedDisc.__module__}:{WeighedDisc.__name__}")


def disc(folder: Path, text: str = TEXT) -> Path:
    folder.mkdir(parents=True)
    (folder / FILE).write_text(text, encoding="utf-8")
    return folder


def test_the_command_takes_it_alone_and_beside_a_capture(tmp_path, capsys):
    source = disc(tmp_path / "disc")
    infer.main([f"capture={source}", f"out={tmp_path / 'alone'}", "drapes=0"])
    assert "weighed disc: 210.0" in capsys.readouterr().out
    alone = json.loads((tmp_path / "alone/estimate.json").read_text())
    record, = alone["measured"]
    assert record["kind"] == "disc" and record["source"] == str(source)
    assert alone["capture"]["density_g_m2"] == pytest.approx(210, abs=1e-3)
    infer.main([f"capture=[{TWILL},{source}]", f"out={tmp_path / 'both'}", "drapes=0"])
    assert "joint estimate of 1 capture and 1 weighed disc" in capsys.readouterr().out
    both = json.loads((tmp_path / "both/estimate.json").read_text())
    assert both["measured"] == [record] and len(both["captures"]) == 1
    assert (tmp_path / "both/disc_1/estimate.json").exists()
    found = drapenet.load(tmp_path / "both")
    again = drapenet.estimate(TWILL, source)
    assert found.moduli()[0] == pytest.approx(again.moduli()[0], rel=1e-9)


def test_a_fault_of_it_is_a_line(tmp_path):
    for text, fault in ((TEXT.replace("300.0", "-3"), "diameter_mm=-3"),
                        (TEXT.replace(f"{MASS:.4f}", "1.0"), "check the unit"),
                        ("diameter_mm: 300\n", "mass_g is missing")):
        folder = disc(tmp_path / fault.replace("=", "_"), text)
        with pytest.raises(InputError, match=fault) as refused:
            infer.main([f"capture={folder}", f"out={tmp_path / 'out'}", "drapes=0"])
        assert "\n" not in str(refused.value) and FILE in str(refused.value)


def test_a_batch_joins_it_and_has_its_column(tmp_path):
    (tmp_path / "fabrics/twill").mkdir(parents=True)
    (tmp_path / "fabrics/twill/a").symlink_to(TWILL)
    disc(tmp_path / "fabrics/twill/b")
    disc(tmp_path / "fabrics/serge/b")
    infer.main([f"captures={tmp_path / 'fabrics'}", f"out={tmp_path / 'out'}", "workers=1"])
    with (tmp_path / "out/fabrics.csv").open(encoding="utf-8-sig") as stream:
        rows = {row["fabric"]: row for row in csv.DictReader(stream)}
    assert float(rows["twill"]["weighed_g_m2"]) == pytest.approx(210, abs=0.1)
    assert rows["serge"]["captures"] == "1"
    page = (tmp_path / "out/serge/index.html").read_text(encoding="utf-8")
    assert "weighed disc: 210.0" in page


class Threads(ThreadPool):
    """In place of processes, which would not know the kind."""

    def __init__(self, max_workers: int, **options: object) -> None:
        super().__init__(max_workers=max_workers)

    def schedule(self, function, args=(), **options: object):
        return super().schedule(function, args=args)


@pytest.fixture
def client(monkeypatch, tmp_path, untrained_checkpoint):
    monkeypatch.setattr(pools, "ProcessPool", Threads)
    app = create_app(settings_for(tmp_path / "results", f"checkpoint={untrained_checkpoint}"))
    with TestClient(app, base_url="http://localhost") as client:
        yield client


def test_the_service_takes_its_file_and_its_fields(client, tmp_path):
    page = client.get("/").text
    assert all(f'name="{key}"' in page for key in ("mass_g", "diameter_mm"))
    assert "mass of the disc" in page
    fields = client.get("/openapi.json").json()["paths"]["/estimates"]["post"]["requestBody"]
    assert "mass_g" in str(fields)
    begun = post(client, [disc(tmp_path / "disc") / FILE], name="twill").json()
    found = ended(client, begun["id"])
    assert (found["state"], found["name"]) == ("done", "disc 1"), found["error"]
    assert found["estimate"]["measured"][0]["kind"] == "disc"
    typed = client.post("/estimates", files={key: (None, text) for key, text in (
        ("fabric", begun["fabric"]), ("mass_g", f"{MASS:.3f}".replace(".", ",")),
        ("diameter_mm", "300"))})
    assert typed.status_code == 202, typed.text
    assert ended(client, typed.json()["id"])["name"] == "disc 2"
    joined = joint_estimate_of(client, begun["fabric"])
    assert joined["state"] == "done" and len(joined["estimate"]["measured"]) == 2
