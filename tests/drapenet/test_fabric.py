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
from drapenet.service import pools, work
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


@pytest.fixture(scope="module")
def commanded(fabric, tmp_path_factory) -> Path:
    """The results of the command."""
    out = tmp_path_factory.mktemp("command")
    infer.main([f"capture={fabric}", f"strips={fabric / 'x_strips'}",
                f"tension={fabric / 'y_tension'}", f"out={out}", "drapes=0"])
    return out


def by_batch(fabric: Path, out: Path, patch: pytest.MonkeyPatch) -> Path:
    infer.main([f"captures={fabric.parent}", f"out={out}", "workers=1"])
    return out / "twill"


def by_service(fabric: Path, out: Path, patch: pytest.MonkeyPatch) -> Path:
    """By the tasks of the service's workers, in this process and without drapes."""
    patch.setattr(work, "EstimateOptions", partial(EstimateOptions, drapes=0))
    patch.setattr(pools, "ProcessPool", BreakablePool)
    kept = {"name": fabric.name}
    app = create_app(settings_for(out, "queue=9", "queue_each=9"))
    with TestClient(app, base_url="http://localhost") as client:
        for place in sorted(fabric.iterdir()):
            files = [("files", (file.name, file.read_bytes())) for file in place.iterdir()
                     if file.name != "truth.json"]
            begun = client.post("/estimates", files=files, data=kept | {"label": place.name}).json()
            kept = {"fabric": begun["fabric"]}
            work.work(out / begun["id"], "", "")
            shutil.rmtree(out / begun["id"] / "uploaded")
        app.state.jobs._join(begun["fabric"])
        rows = client.get(f"/fabrics/{begun['fabric']}").json()["estimates"]
        joint = next(row["id"] for row in rows if row["members"])
        work.work(out / joint, "", "")
        assert client.get(f"/estimates/{joint}").json()["error"] is None
    return out / joint


def content(folder: Path) -> dict:
    return json.loads((folder / "estimate.json").read_text())


def without_names(document: dict, root: Path) -> dict:
    """The document with paths as the service has them, and without the fabric's name."""
    found = json.loads(json.dumps(document).replace(f"{root}/", ""))
    for part in (found, *found["captures"]):
        part["capture"].pop("labels", None)
    return found


@pytest.mark.parametrize("door", [by_batch, by_service])
def test_every_door_gives_the_same_estimate(door, commanded, fabric, tmp_path, monkeypatch):
    found = content(door(fabric, tmp_path, monkeypatch))
    root = fabric.parent
    assert without_names(found, root) == without_names(content(commanded), root)


def test_python_gives_the_same_estimate(commanded, fabric):
    found = drapenet.estimate(fabric, strips=fabric / "x_strips", tension=fabric / "y_tension")
    loaded = drapenet.load(commanded)
    np.testing.assert_array_equal(found.samples, loaded.samples)
    assert found.warnings == loaded.warnings and len(found.captures) == len(loaded.captures) == 3


def test_copies_and_refused_sources_are_named_and_what_they_state_is_kept(commanded):
    found = content(commanded)
    codes = [each["code"] for each in found["warnings"]]
    assert codes.count("twin_left_out") == codes.count("capture_refused") == 1
    assert len(found["captures"]) == 3 and len(found["strips"]) == 2
    assert found["strips"][1]["known"]["bending_length_mm"]["warp"] == 27.0
