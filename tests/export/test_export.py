"""The command, its neutral files, names and meshes."""

import json
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from exported import ALPHA, BETA, IN_A_DRAPE, exported, shell, write

from common.errors import InputError
from common.files import replace_json
from drapenet.export.__main__ import main
from drapenet.export.formats import ALIASES, TARGETS
from drapenet.export.material import MAX_CELLS, MIN_CELLS, hinge_ratio, read_material
from experiments.physics.hinges import simulated_ratio
from sim.material import MICRO, STIFF_SOFT, torque


def test_the_default_modulus_is_the_stiffness_in_a_drape_of_the_report(estimate):
    stated = [moduli["drape_stiffness_uN_m"]["median"] for moduli in
              json.loads(estimate.read_text())["moduli"].values()]
    assert read_material(estimate).modulus / MICRO == pytest.approx(stated, rel=1e-12)
    content = json.loads(estimate.read_text())
    for moduli in content["moduli"].values():
        del moduli["drape_stiffness_uN_m"]
    replace_json(estimate, content)  # as written before the estimate stated it
    assert read_material(estimate).modulus == pytest.approx(IN_A_DRAPE)


def test_one_measured_yarn_is_written_where_a_tool_has_a_field_for_it(known):
    content = json.loads(known.read_text())
    content["tension"]["measured"] = ["warp"]
    replace_json(known, content)
    physical = json.loads(exported(known, "jfab").read_text())
    assert physical["mapPhysical"]["fSvK"] == 900e3
    assert {"fSuK", "fHK"} < set(physical["drapenet"]["tool_defaults"])
    assert physical["drapenet"]["not_known"] == ["stretch along the weft", "shear"]
    data = json.loads(exported(known, "json").read_text())
    assert data["stretch_N_m"] == [900.0, None] and data["shear_N_m"] is None
    assert "young-mod" not in shell(exported(known, "ppf"))


def test_neutral_files_return_what_was_estimated(estimate):
    data = json.loads(exported(estimate, "json").read_text())
    assert data["alpha_N_m"] == pytest.approx(ALPHA) and data["beta_N_m2"] == pytest.approx(BETA)
    rows = [line.split(",") for line in exported(estimate, "csv").read_text().splitlines()]
    assert [row[0] for row in rows[1:]] == ["warp", "bias", "weft"]
    assert [float(row[1]) * MICRO for row in rows[1:]] == pytest.approx(ALPHA)
    curve = np.loadtxt(exported(estimate, "torque"), delimiter=",", skiprows=1)
    assert curve[20, 1:] * 1e-3 == pytest.approx(torque(curve[20, 0], ALPHA, BETA), rel=1e-4)
    write(estimate, STIFF_SOFT)  # the warp is not marked, so that no file may call yarns warp
    for target in ("json", "csv", "torque"):
        text = exported(estimate, target).read_text().partition('"drapenet"')[0]
        assert "stiff" in text and "soft" in text and "warp" not in text


def test_a_file_of_one_tool_does_not_replace_that_of_another(estimate, tmp_path):
    out = tmp_path / "exp"
    for program in ("clo", "unreal"):
        main([f"estimate={estimate}", f"to={program}", f"out={out}"])
    assert {file.name for file in out.iterdir()} == {"fabric.jfab", "fabric.usda"}
    before = (out / "fabric.jfab").read_bytes()
    with pytest.raises(InputError, match=r"the file for to=usd ends in \.usda; give such a name"):
        main([f"estimate={estimate}", "to=unreal", f"out={out / 'fabric.jfab'}"])
    assert (out / "fabric.jfab").read_bytes() == before
    main([f"estimate={estimate}", "to=unreal", f"out={out / 'silk.usda'}"])
    assert (out / "silk.usda").exists()


def test_the_message_for_an_unknown_tool_names_programs(estimate, capsys):
    with pytest.raises(InputError, match=r"or a program: clo \(jfab\), .*unreal \(usd\)"):
        main([f"estimate={estimate}", "to=maya"])
    main(["to=list"])
    assert "unreal (usd)" in capsys.readouterr().out


def test_all_targets_of_one_estimate_have_the_same_bytes_again(estimate):
    folders = [estimate.parent / name for name in ("first", "second")]
    for folder in folders:
        main([f"estimate={estimate}", "to=all", f"out={folder}"])
    names = sorted(file.name for file in folders[0].iterdir())
    assert len(names) == len(TARGETS) + 1
    for name in names:
        assert (folders[0] / name).read_bytes() == (folders[1] / name).read_bytes()


@pytest.mark.parametrize(("words", "changes", "complaint"), [
    (["to=zfab"], {}, "to=zfab: unknown; choose from jfab"), ([], {}, "to= is missing; give one"),
    (["to=jfab", f"name={'x' * 81}"], {}, "name='xxx"),
    (["to=jfab", "name=a\tb"], {}, "printable characters"),
    (["to=ppf", "mesh=hexagons"], {}, "mesh='hexagons'"),
    (["to=ppf", "edge_mm=500"], {}, "edge_mm=500.0"),
    (["to=ppf", "edge_mm=40"], {}, "edge_mm=40 is too coarse for this fabric"),
    (["to=jfab", "curvature_1_m=-5"], {}, "curvature_1_m=-5.0"),
    (["to=csv"], {"schema": "other"}, "schema='other'"),
    (["to=csv"], {"schema_version": 1}, "schema_version=1"),
    (["to=csv"], {"moduli": {}}, "directions"), (["to=csv"], {"capture": None}, "capture=None"),
    (["to=csv"], {"capture": {"density_g_m2": -1.0, "rig": ""}}, "density_g_m2=-1.0"),
])
def test_bad_input_is_an_error_and_no_file(tmp_path, words, changes, complaint):
    path = write(tmp_path / "estimate.json", **changes)
    with pytest.raises(InputError, match=complaint):
        main([f"estimate={path}", *words])
    assert [file.name for file in tmp_path.iterdir()] == ["estimate.json"]


def test_the_docs_hold_every_tool():
    text = (Path(__file__).parents[2] / "docs" / "exports.md").read_text(encoding="utf-8")
    for name, t in TARGETS.items():
        row, = (line for line in text.splitlines() if line.startswith(f"| `{name}` | {t.tool} | "))
        assert row.endswith(f" | {t.lost} |") and row.count("|") == 7
    assert "\n## Not offered\n" in text and set(ALIASES.values()) <= set(TARGETS)


def test_the_name_of_the_fabric_is_in_the_files(estimate):
    for name, wanted in (("", "twill"), ("Blé 7/8", "Blé 7/8")):
        jfab = json.loads(exported(estimate, "jfab", name=name).read_text())
        assert jfab["qsFabricName"].endswith(wanted) and jfab["drapenet"]["name"].endswith(wanted)
        main_file = json.loads(exported(estimate, "u3m", name=name).read_text())["material"]
        assert main_file["name"].endswith(wanted)
        written = datetime.fromisoformat(main_file["created"].replace("Z", "+00:00")).timestamp()
        assert written == pytest.approx(estimate.stat().st_mtime, abs=1)
        usda = exported(estimate, "usd", name=name).read_text()
        assert f'{wanted}"' in usda and "/Fabric" not in usda
        assert exported(estimate, "csv", name=name).read_text().splitlines()[1].endswith(wanted)
    formula = exported(estimate, "csv", name="=1+1").read_text()
    assert formula.splitlines()[1].endswith(",'=1+1")


def test_programs_stand_for_their_format_and_folders_for_their_estimate(estimate, capsys):
    main([f"estimate={estimate.parent}", "to=CLO,unreal,jfab", "curvature_1_m=120"])
    printed = capsys.readouterr().out
    assert [Path(line).name for line in printed.splitlines()[:2]] == ["fabric.jfab", "fabric.usda"]
    assert "warning: curvature_1_m=120 is outside the law" in printed
    write(estimate, STIFF_SOFT)
    main([f"estimate={estimate}", "to=json"])
    assert "does not mark the warp" in capsys.readouterr().out


@pytest.mark.parametrize(("mesh", "cells"), [
    ("unstructured", 7), ("alternating", 9), ("equal", 6), ("random", 6)])
def test_ratios_of_meshes_are_those_of_simulated_strips(mesh, cells):
    assert hinge_ratio(mesh, cells) == pytest.approx(simulated_ratio(mesh, cells), abs=1e-3)


def test_every_mesh_has_ratios_near_those_of_the_validation(estimate):
    for mesh, low, high in (("unstructured", 1.0, 1.1), ("alternating", 1.18, 1.24),
                            ("equal", 1.15, 1.25), ("random", 1.08, 1.2)):
        assert low < read_material(estimate, mesh=mesh).ratio < high
        assert all(0.9 < hinge_ratio(mesh, n) < 1.3 for n in range(MIN_CELLS, MAX_CELLS + 1))
        assert hinge_ratio(mesh, 10 * MAX_CELLS) == hinge_ratio(mesh, MAX_CELLS)
