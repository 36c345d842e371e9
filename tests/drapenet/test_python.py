"""What ``import drapenet`` offers."""

from dataclasses import replace

import numpy as np
import pytest
from cloths import describe, write_skirt

import drapenet
import infer
from common.errors import InputError
from data.captures.reader import read_capture


def test_a_fabric_is_estimated_as_by_the_command(untrained_checkpoint, tmp_path):
    capture = write_skirt(tmp_path / "capture", warp_direction=0.4)
    options = {"checkpoint": untrained_checkpoint}
    found = drapenet.estimate(capture, **options)
    infer.main([f"capture={capture}", f"out={tmp_path / 'out'}", "drapes=0",
                f"checkpoint={untrained_checkpoint}"])
    loaded = drapenet.load(tmp_path / "out")
    np.testing.assert_array_equal(found.samples, loaded.samples)
    assert found.warnings == loaded.warnings
    again = drapenet.estimate(read_capture(capture), **options)
    np.testing.assert_allclose(np.median(found.samples, 0), np.median(again.samples, 0), atol=0.02)
    other = write_skirt(tmp_path / "other", orientation=1.2, warp_direction=1.2)
    describe(other, face="down")
    both = drapenet.estimate(capture, other, **options)
    infer.main([f"capture=[{capture},{other}]", f"out={tmp_path / 'both'}", "drapes=0",
                f"checkpoint={untrained_checkpoint}"])
    np.testing.assert_array_equal(both.samples, drapenet.load(tmp_path / "both").samples)
    with pytest.raises(InputError, match="density=150 is more than 1 kg/m²"):
        drapenet.estimate(replace(read_capture(capture), density=150.0), **options)
    with pytest.raises(InputError, match="same views"):
        drapenet.estimate(capture, capture, **options)
    with pytest.raises(InputError, match="not list; several captures are several arguments"):
        drapenet.estimate([capture, other], **options)
    with pytest.raises(InputError, match="give a capture"):
        drapenet.estimate(**options)
    with pytest.raises(InputError, match=r"strips=3 is not of the class str | .*Path"):
        drapenet.estimate(strips=3)
    for word in ("no", 0):
        with pytest.raises(InputError, match=f"refine={word!r} is not of the class bool"):
            drapenet.estimate(capture, refine=word, **options)
    with pytest.raises(InputError, match=r"path=3 is not of the class"):
        drapenet.load(3)


def test_captures_of_a_loaded_estimate_are_in_order_also_from_the_tenth_on(
        untrained_checkpoint, tmp_path):
    stated = list(range(30, 41))
    for k, percent in enumerate(stated):
        (tmp_path / "fabric" / str(k)).mkdir(parents=True)
        (tmp_path / "fabric" / str(k) / "capture.yaml").write_text(
            "density_g_m2: 150\ntester: disc300_support180\n"
            f"known: {{drape_coefficient_percent: {percent}}}\n")
    infer.main([f"capture={tmp_path / 'fabric'}", f"out={tmp_path / 'out'}", "drapes=0",
                f"checkpoint={untrained_checkpoint}"])
    assert [round(100 * seen.coefficient) for seen in drapenet.load(tmp_path / "out").captures
            ] == stated


def test_many_fabrics_are_estimated_by_name(untrained_checkpoint, tmp_path):
    for name, orientation in (("silk", 0.4), ("wool", 1.2)):
        write_skirt(tmp_path / "captures" / name / "1", orientation=orientation)
    (tmp_path / "captures" / "lost" / "1").mkdir(parents=True)
    (tmp_path / "captures" / "lost" / "1" / "note.txt").touch()
    options = {"checkpoint": untrained_checkpoint, "workers": 1}
    source, out = tmp_path / "captures", tmp_path / "out"
    found = drapenet.estimate_fabrics(source, str(out), **options)
    assert list(found) == ["silk", "wool"] and "lost" in (out / "failures.csv").read_text("utf-8")
    np.testing.assert_array_equal(found["wool"].samples, drapenet.load(out / "wool").samples)
    assert not np.array_equal(found["wool"].samples, found["silk"].samples)
    for changed, complaint in (({"refine": "no"}, "refine='no' is not of the class bool"),
                               ({"workers": "2"}, "workers='2': give a whole number"),
                               ({"checkpoint": None}, "checkpoint=None is not of the class")):
        with pytest.raises(InputError, match=complaint):
            drapenet.estimate_fabrics(source, out, **(options | changed))
    with pytest.raises(InputError, match="out= is empty"):
        drapenet.estimate_fabrics(source, "", **options)
