"""One fabric by every door: the same estimate, whoever asks for it."""

import json
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml
from fastapi.testclient import TestClient
from PIL import Image
from services import BreakablePool, settings_for

import drapenet
import infer
from drapenet.config import EstimateOptions
from drapenet.service import jobs, work
from drapenet.service.app import create_app

EXAMPLES = Path(__file__).parents[2] / "examples"
TWILL, PHOTOGRAPH = (EXAMPLES / "captures" / name for name in ("twill", "twill_photograph"))
KNOWN = {"known": {"bending_length_mm": {"warp": 27.0}}}


@pytest.fixture(scope="module")
def fabric(tmp_path_factory) -> Path:
    """A folder with two photographs, views and a copy of them, strips, strips under weights, and a
    capture that is refused but states a value of the fabric."""
    root = tmp_path_factory.mktemp("root") / "twill"
    for name, source in (("a_views", TWILL), ("b_photograph", PHOTOGRAPH), ("d_copy", TWILL),
                         ("e_refused", TWILL), ("y_tension", EXAMPLES / "tension" / "twill")):
        shutil.copytree(source, root / name)
    shutil.copytree(PHOTOGRAPH, root / "c_photograph")
    with Image.open(PHOTOGRAPH / "outline.jpg") as picture:  # another picture of the same drape
        picture.save(root / "c_photograph" / "outline.jpg", quality=80, exif=picture.getexif())
    (root / "e_refused" / "view_2.png").unlink()
    with (root / "e_refused" / "capture.yaml").open("a") as file:
        yaml.safe_dump(KNOWN, file)
    (root / "x_strips").mkdir()
    entries = [{"direction": name, "bending_length_mm": value, "face": face}
               for name, value in (("warp", 28.0), ("weft", 19.5)) for face in ("up", "down")]
    (root / "x_strips" / "strips.yaml").write_text(yaml.safe_dump(
        {"density_g_m2": 210, "strips": entries}))
    return root


def by_command(fabric: Path, out: Path) -> dict:
    infer.main([f"capture={fabric}", f"strips={fabric / 'x_strips'}",
                f"tension={fabric / 'y_tension'}", f"out={out}", "drapes=0"])
    return json.loads((out / "estimate.json").read_text())


def by_batch(fabric: Path, out: Path) -> dict:
    infer.main([f"captures={fabric.parent}", f"out={out}", "workers=1"])
    return json.loads((out / "twill" / "estimate.json").read_text())


def by_service(fabric: Path, out: Path) -> dict:
    """By the tasks of the service's workers, in this process and without drapes."""
    with pytest.MonkeyPatch.context() as patch, TestClient(
            create_app(settings_for(out)), base_url="http://localhost") as client:
        patch.setattr(work, "EstimateOptions", partial(EstimateOptions, drapes=0))
        queue, kept = client.app.state.jobs, {"name": fabric.name}
        patch.setattr(jobs, "new_pool", lambda *_: BreakablePool())
        queue._workers = BreakablePool()
        for place in sorted(fabric.iterdir()):
            files = [("files", (file.name, file.read_bytes())) for file in place.iterdir()
                     if file.name != "truth.json"]
            begun = client.post("/estimates", files=files, data=kept | {"label": place.name}).json()
            kept = {"fabric": begun["fabric"]}
            work.work(out / begun["id"], "", "")
            shutil.rmtree(out / begun["id"] / "uploaded")
        queue._join(begun["fabric"])
        rows = client.get(f"/fabrics/{begun['fabric']}").json()["estimates"]
        joint = next(row["id"] for row in rows if row["members"])
        work.work(out / joint, "", "")
    return json.loads((out / joint / "estimate.json").read_text())


@pytest.fixture(scope="module")
def commanded(fabric, tmp_path_factory) -> dict:
    return by_command(fabric, tmp_path_factory.mktemp("command"))


def without_names(document: dict, root: Path) -> dict:
    """The document with its names as the service has them, and without what draws."""
    text = json.dumps(document).replace(f"{root}/", "")
    return {key: value for key, value in json.loads(text).items() if key != "labels"}


@pytest.mark.parametrize("door", [by_batch, by_service])
def test_every_door_gives_the_same_estimate(door, commanded, fabric, tmp_path):
    found, expected = (without_names(each, fabric.parent)
                       for each in (door(fabric, tmp_path), commanded))
    for part in (found["capture"], *(each["capture"] for each in found["captures"])):
        part.pop("labels", None)
    for part in (expected["capture"], *(each["capture"] for each in expected["captures"])):
        part.pop("labels", None)
    assert found == expected


def test_python_gives_the_same_estimate(commanded, fabric):
    found = drapenet.estimate(fabric, strips=fabric / "x_strips", tension=fabric / "y_tension")
    assert [each.record for each in found.warnings] == commanded["warnings"]
    for k, name in enumerate(found.names):
        assert 1e6 * np.median(found.moduli()[0][:, k]) == (
            commanded["moduli"][name]["alpha_uN_m"]["median"])


def test_copies_and_refused_sources_are_named_and_what_they_state_is_kept(commanded):
    codes = [each["code"] for each in commanded["warnings"]]
    assert codes.count("twin_left_out") == codes.count("capture_refused") == 1
    assert len(commanded["captures"]) == 3 and len(commanded["strips"]) == 2
    assert commanded["strips"][1]["known"]["bending_length_mm"]["warp"] == 27.0
