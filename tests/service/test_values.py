"""Strips and known values of a fabric through the service: alone, with captures, contradicting."""

import cv2
import numpy as np
import pytest
import strip_photographs
import yaml
from fastapi.testclient import TestClient
from services import BreakablePool, ended, joint_estimate_of, post, settings_for

from data.readings import QUANTITIES
from data.readings.quantity import Quantity
from drapenet.export.formats import TARGETS
from drapenet.service.app import create_app
from drapenet.service.forms import described_capture

LABELS = {"date": "2026-11-26", "operator": "M. Muster", "laboratory": "Textile laboratory 7"}


def stated(client: TestClient, **fields: object) -> dict:
    """The estimate after fields of the form without a file, at 210 g/m²."""
    form = {key.replace("__", "."): (None, str(value)) for key, value in fields.items()}
    begun = client.post("/estimates", files={"density_g_m2": (None, "210"), **form})
    assert begun.status_code == 202, begun.text
    found = ended(client, begun.json()["id"])
    assert found["state"] == "done", found["error"]
    return found


@pytest.fixture(scope="module")
def lengths(client, tmp_path_factory) -> dict:
    """The estimate by strips.yaml of bending lengths alone."""
    file = tmp_path_factory.mktemp("strips") / "strips.yaml"
    file.write_text(yaml.safe_dump({"density_g_m2": 210, "strips": [
        {"direction": name, "bending_length_mm": value} for name, value in (
            ("warp", 21.5), ("weft", 18.0))]}), encoding="utf-8")
    begun = post(client, [file], name="Grey serge", **LABELS)
    assert begun.status_code == 202, begun.text
    return ended(client, begun.json()["id"])


def test_bending_lengths_alone_give_moduli_and_a_labelled_report(client, lengths):
    assert lengths["state"] == "done" and lengths["name"] == "strips 1", lengths["error"]
    assert lengths["estimate"]["capture"]["labels"] == LABELS | {"fabric": "Grey serge"}
    assert {"report.html", "report.pdf", "torque.svg"} <= set(lengths["files"])
    assert "preview.png" not in lengths["files"]
    page = client.get(f"/estimates/{lengths['id']}/report.html").text
    assert "<h1>Grey serge</h1>" in page and "from 2 strips" in page
    assert all(value in page for value in LABELS.values())
    for name in TARGETS:
        assert client.get(f"/estimates/{lengths['id']}/export/{name}").status_code == 200, name


def test_values_alone_tell_of_a_fabric(client):
    found = stated(client, known__bending_length_mm__warp=22, name="twill",
                   known__bending_stiffness_uN_m=25)
    assert found["name"] == "values 1"
    page = client.get(f"/estimates/{found['id']}/report.html").text
    assert "from known values of testers" in page and "<h1>twill</h1>" in page
    assert "<li>bending length [mm] warp: 22</li>" in page
    assert "<li>bending stiffness by the supplier [µN·m]: 25</li>" in page


def test_a_value_that_contradicts_is_named_and_left_out(client, lengths):
    fabric = lengths["fabric"]
    stated(client, fabric=fabric, known__flexural_rigidity_uN_m__warp=600)
    joint = joint_estimate_of(client, fabric)
    contradiction, = joint["estimate"]["contradictions"]
    line = contradiction["text"]
    assert contradiction in joint["warnings"]
    assert line.startswith("the known flexural rigidity G [µN·m] warp = 600 contradicts strips")
    assert "; left out: " in line and "\n" not in line
    for place in (f"/fabrics/{fabric}", f"/estimates/{lengths['id']}"):
        content = client.get(place).json()
        rows = content.get("estimates") or content["captures"]
        assert [row["contradictions"] for row in rows if row["members"]] == [[contradiction]], place
    assert "<h1>Grey serge</h1>" in client.get(f"/estimates/{joint['id']}/report.html").text
    assert client.get(f"/estimates/{joint['id']}/report.pdf").content.startswith(b"%PDF")
    found = client.get("/fabrics", params={"search": "serge"}).json()["fabrics"]
    assert found[0]["estimate"]["contradictions"] == [contradiction]


def test_photographed_strips_show_their_curves(client, tmp_path):
    scenes = {"warp 1.png": strip_photographs.LONG, "warp 2.png": strip_photographs.SHORT}
    folder = strip_photographs.write(
        tmp_path / "strips", {name: strip_photographs.photograph(scene)
                              for name, scene in scenes.items()},
        [strip_photographs.entry(scene, name) for name, scene in scenes.items()])
    found = ended(client, post(client, sorted(folder.iterdir())).json()["id"])
    assert found["state"] == "done" and "preview.png" in found["files"], found["error"]
    preview = client.get(f"/estimates/{found['id']}/preview.png").content
    picture = cv2.imdecode(np.frombuffer(preview, np.uint8), cv2.IMREAD_COLOR).astype(int)
    green = (picture[..., 1] > 180) & (picture[..., [0, 2]] < 120).all(axis=-1)
    assert green.sum() > 500
    alpha = found["estimate"]["moduli"]["warp"]["alpha_uN_m"]["median"]
    assert alpha == pytest.approx(1e6 * strip_photographs.ALPHA, rel=0.15)


def test_strips_under_weights_of_the_form_join_and_are_reported(client, lengths):
    strips = [("bias", 25, 100, 4.1), ("warp", 500, 200, 2.4), ("weft", 500, 200, 6)]
    keys = ("direction", "load_g", "gauge_mm", "extension_mm", "width_mm")
    found = stated(client, fabric=lengths["fabric"], **{
        f"tension__{k}__{key}": value for k, strip in enumerate(strips)
        for key, value in zip(keys, (*strip, 50), strict=True)})
    tension = found["estimate"]["tension"]
    assert found["name"] == "tension 1" and "preview.png" in found["files"]
    assert tension["measured"] == ["warp", "bias", "weft"]
    # Load per width over four times the extension: 29.9 N/m.
    assert 24 < tension["shear_n_per_m"]["median"] < 36
    joint = joint_estimate_of(client, lengths["fabric"])
    assert joint["state"] == "done" and joint["estimate"]["tension"] == tension, joint["error"]
    page = client.get(f"/estimates/{joint['id']}/report.html").text
    assert "By 3 strips under weights" in page and "with marks, loads and extensions" in page
    card = client.get(f"/estimates/{joint['id']}/export/jfab").json()["mapPhysical"]
    assert card["fHK"] == pytest.approx(1e3 * tension["shear_n_per_m"]["median"])


def test_a_new_quantity_appears_on_the_page(tmp_path, monkeypatch):
    def of_nothing(*arguments: object) -> np.ndarray:
        raise AssertionError

    new = Quantity("handle_n", 3, 0.25, of_nothing, "handle <n>")
    monkeypatch.setattr("drapenet.service.pools.ProcessPool", BreakablePool)
    monkeypatch.setattr("drapenet.service.pages.QUANTITIES", {**QUANTITIES, new.name: new})
    with TestClient(create_app(settings_for(tmp_path)), base_url="http://localhost") as client:
        page = client.get("/").text
        fields = client.get("/openapi.json").json()["paths"]["/estimates"]["post"]["requestBody"]
    for name in ("handle_n.warp", "handle_n.weft", "error_percent.handle_n"):
        assert f'name="known.{name}"' in page
    assert 'placeholder="25"' in page and "handle &lt;n&gt;" in page
    assert "bending length [mm]" in page and 'name="known.membrane_n_per_m"' in page
    properties = fields["content"]["multipart/form-data"]["schema"]["properties"]
    assert {"known.bending_length_mm.bias", "known.membrane_n_per_m", "operator"} <= set(properties)


def test_a_density_in_the_form_replaces_a_weight_in_the_file():
    document = b"weight_g: 10.6\ntester: disc300_support180\n"
    assert described_capture(document, {})[1].density == pytest.approx(0.15, rel=1e-3)
    assert described_capture(document, {"density_g_m2": "210"})[1].density == pytest.approx(0.21)
