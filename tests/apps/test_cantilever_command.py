"""``python -m apps.cantilever``: strips, estimates, and one line for a mistake."""

import json

import numpy as np
import pytest
from elastica_curves import LAWS, curves_of, write_curve
from words import last

from apps.cantilever import main
from common.errors import InputError
from sim.cantilever import elastica


def test_gammas_become_json(tmp_path, capsys, monkeypatch):
    main(["hang", "gamma=1,10"])
    printed = json.loads(capsys.readouterr().out)
    assert [row["gamma"] for row in printed] == [1.0, 10.0]
    for row in printed:
        assert row["aspect_ratio"] == pytest.approx(row["elastica_aspect_ratio"], rel=0.005)
    monkeypatch.setattr("apps.cantilever.simulate", lambda gamma: printed[0])
    main(["hang", "gamma=1", f"out={tmp_path / 'a' / 's.json'}"])
    assert json.loads((tmp_path / "a" / "s.json").read_text()) == printed[:1]


def test_estimate_reads_files_and_writes_moduli(tmp_path, capsys):
    alpha, beta = LAWS[0]
    files = [write_curve(tmp_path / f"{k}.csv", c) for k, c in enumerate(curves_of(alpha, beta))]
    out = tmp_path / "moduli.json"
    for method in ("table", "regression"):
        main(["estimate", f"weft={files[0]},{files[1]}", "density=300", f"method={method}",
              f"out={out}"])
        weft = json.loads(out.read_text())["moduli"]["weft"]
        assert weft["alpha_uN_m"] == pytest.approx(1e6 * alpha, rel=0.01)
        assert weft["beta_nN_m2"] == pytest.approx(1e9 * beta, rel=0.03)
    assert "weft" in capsys.readouterr().out


def test_a_curve_that_does_not_determine_beta_is_named(tmp_path, capsys):
    curve = 0.03 * elastica(0.3, 40)
    curve[1:] += np.random.default_rng(0).normal(0, 3e-4, (39, 2))
    almost_straight = write_curve(tmp_path / "short.csv", curve)
    main(["estimate", f"warp={almost_straight}", "density=300"])
    assert "do not determine beta" in capsys.readouterr().out
    curve = write_curve(tmp_path / "long.csv", curves_of(*LAWS[0])[1])
    main(["estimate", f"warp={curve}", "density=300"])
    assert "do not determine beta" not in capsys.readouterr().out


@pytest.mark.parametrize("words", [
    "estimate strips=none", "hang gamma=",
    "hang gamma=x", "hang gamma=0", "hang gamma=nan", "hang gamma=1,3000", "gamma=1",
    "--colour", "hang colour=red", "estimate", "estimate warp=none.csv", "estimate colour=red",
    "estimate warp=none.csv density=300", "estimate warp=none.csv density=300 rounds=-1"])
def test_mistakes_are_one_line(words):
    with pytest.raises(InputError) as caught:
        main(words.split())
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("words", "said"),
    [(["method=guess"], "regression, table"), (["rounds=1"], "all three"),
     (["slope=95"], "slope"),
     (["slope=nan"], "slope=.nan."), (["density=null"], "density is needed"),
     (["density=0.3"], "5 to 5000 g/m²"), (["density=300000"], "5 to 5000 g/m²"),
     (["weft=FILE,,"], "weft=.*comma"), (["out=/proc/moduli.json"], "cannot write"),
     (["out=FILE/moduli.json"], "cannot write")],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_estimates_that_make_no_sense_are_refused(tmp_path, words, said):
    file = write_curve(tmp_path / "w.csv", curves_of(*LAWS[0])[0])
    words = [word.replace("FILE", str(file)) for word in words]
    with pytest.raises(InputError, match=said):
        main(["estimate", *last(f"warp={file}", "density=300", *words)])


@pytest.mark.parametrize("out", ["/proc/strips.json", "."])
def test_strips_are_not_simulated_for_a_file_that_cannot_be_written(monkeypatch, out):
    monkeypatch.setattr("apps.cantilever.simulate", None)
    with pytest.raises(InputError, match="cannot write"):
        main(["hang", "gamma=1", f"out={out}"])
