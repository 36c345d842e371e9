"""``python -m apps.cantilever``: strips, estimates, and one line for a mistake."""

import json

import numpy as np
import pytest
from elastica_curves import LAWS, curves_of, write_curve

from apps.cantilever import main
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
