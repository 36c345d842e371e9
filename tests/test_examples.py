"""The code in the documentation runs as it stands, and what it names is there."""

import re
import runpy
from pathlib import Path

import pytest
from elastica_curves import PRIORS
from here import here

import common.cases
import sim.many
from data.captures.reader import read_capture
from data.render import phone
from drapenet.measured.strips.folder import read_strips
from drapenet.views.located import LocatedViews
from drapenet.views.outline import outline_of_map
from drapenet.views.radial_map import radial_map
from sim.draping import Drape, drape
from sim.rig import Rig

ROOT = Path(__file__).resolve().parent.parent
TEXT, GALLERY = ((ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
                 for name in ("extending", "gallery"))
SECTIONS = {part.splitlines()[0]: part for text in (TEXT, GALLERY)
            for part in re.split(r"^## ", text, flags=re.MULTILINE)[1:]}
SCRIPTS = [pytest.param(name, marks=[pytest.mark.slow] * ("minutes" in name))
           for name, part in SECTIONS.items() if "```python" in part]
CHEAPER = {"How sure is a simulated garment?": {"12, replace": "3, replace", "0.01}": "0.02}"}}
"""Fewer and coarser drapes of the same code."""
FOLDERS = [ROOT, ROOT / "drapenet", ROOT / "data" / "captures", ROOT / "sim" / "energies"]
"""In which the names of files in the text are relative."""


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_section_runs_as_one_script(name, tmp_path, monkeypatch):
    blocks = re.findall(r"^```python\n(.*?)^```", SECTIONS[name], flags=re.MULTILINE | re.DOTALL)
    for module in (common.cases, sim.many):
        monkeypatch.setattr(module, "worker_pool", lambda workers: here(1))
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    script = tmp_path / "script.py"
    text = "\n".join(blocks)
    for words, cheaper in CHEAPER.get(name, {}).items():
        assert text.count(words) == 1
        text = text.replace(words, cheaper)
    script.write_text(text, encoding="utf-8")
    runpy.run_path(str(script), run_name="__main__")


def test_files_that_are_named_exist():
    names = re.findall(r"`([\w/]+(?:/|\.py))`", TEXT)
    assert len(names) > 10
    for name in names:
        assert any((folder / name).exists() for folder in FOLDERS), name


def test_the_example_makes_whole_scenes_of_the_same_drape(tmp_path, monkeypatch):
    main = runpy.run_path(str(ROOT / "examples" / "make_capture.py"))["main"]
    words = ["edge_mm=12", "seed=7", f"out={tmp_path / 'c'}"]
    simulated = []

    def once(*args: object, **settings: object) -> Drape:
        simulated.append(simulated[0] if simulated else drape(*args, **settings))
        return simulated[0]

    monkeypatch.setitem(main.__globals__, "drape", once)
    monkeypatch.setattr(phone, "_SIZE", (1344, 1008))
    coefficients = []
    for raw in ("false", "true"):  # the second replaces the first
        main([*words, f"raw={raw}"])
        capture = read_capture(tmp_path / "c")
        found = radial_map(LocatedViews.of(capture))
        coefficients.append(outline_of_map(found, Rig()).coefficient(Rig()))
    assert (tmp_path / "c" / "background.png").is_file()
    assert capture.cut and len(capture.views) == 4
    assert coefficients[1] == pytest.approx(coefficients[0], abs=0.02)
    main([*words, "photograph=true"])
    photograph = read_capture(tmp_path / "c").outline  # the deep hem looks smaller to a camera
    assert coefficients[0] - 0.12 < photograph.drape_coefficient < coefficients[0] + 0.02


def test_practice_strips_are_estimated(tmp_path):
    main = runpy.run_path(str(ROOT / "examples" / "make_strips.py"))["main"]
    main([f"out={tmp_path}", "alpha=30,30,30", "beta=-60,-60,-60", "curl=3,-3"])
    found = read_strips(tmp_path).evidence(PRIORS)["warp"]
    assert found.alpha == pytest.approx(30e-6, rel=0.12)
    assert found.curl[0] == pytest.approx(3.0, abs=1.0)
