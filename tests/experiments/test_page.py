"""Page of studies and stored reports."""

import json
from dataclasses import fields

import numpy as np
import pytest

from common.command import schema_of
from common.configs import CONFIG_DIR, group_options
from experiments.common import REPORTS
from experiments.papers.__main__ import ORDER, main, reports, study_named
from experiments.papers.captured import (
    capture_drape,
    drape_specimen,
    ideal_setups,
    infer,
    posterior_bound,
    rms,
    specimen,
    spread,
)
from experiments.papers.recognition import DESCRIPTORS, identification_rates
from experiments.papers.study import PAGE, page


def test_the_page_is_generated_from_the_stored_reports():
    assert PAGE.read_text(encoding="utf-8") == page([study_named(name) for name in ORDER],
                                                    reports())


@pytest.mark.parametrize("name", ORDER)
def test_every_study_has_a_config_a_report_and_a_figure(name):
    study = study_named(name)
    assert study.name == name and (CONFIG_DIR / "study" / f"{name}.yaml").is_file()
    report = json.loads(study.report.read_text(encoding="utf-8"))
    keys = {field.name for field in fields(schema_of(f"study/{name}"))}
    assert set(report["settings"]) == keys
    assert not any(group_options(key) for key in keys), "Hydra takes it for a group"
    assert study.report.with_suffix(".png").is_file()


def test_the_posterior_bound_has_the_unit_of_the_errors():
    information = json.loads((REPORTS / "information.json").read_text(encoding="utf-8"))["rms"]
    absolute = information["all nuisances unknown"]["log_alpha"]
    assert posterior_bound() * rms(spread()[:3]) == pytest.approx(absolute, rel=0.03)
    assert reports()["views"]["bound"] == pytest.approx(posterior_bound())


def test_estimates_are_along_the_true_warp_for_all_orientations():
    plan = specimen(4, seed=1)
    theta = plan.theta.copy()
    theta[:3] = np.log([120e-6, 40e-6, 15e-6])
    theta[3:] = -1e-3
    shape = drape_specimen(type(plan)(**{**plan.__dict__, "theta": theta}), edge=6e-3)
    for number in range(3):
        found = infer(capture_drape(shape, ideal_setups(), np.random.default_rng(number)))
        assert found.theta[0] > found.theta[2] + 0.5


def test_identification_uses_the_nearest_drape():
    values = [0.0, 0.1, 5.0, 9.0, 8.9, 8.7]
    found = [{name: [value] for name in DESCRIPTORS} for value in values]
    result = identification_rates(found, np.array([0, 0, 1, 1, 2, 2]))
    assert result["drapes"] == 6 and result["fabrics"] == 3
    assert result["shares"]["rings"] == pytest.approx(3 / 6)  # 8.9 is nearer to 9.0 than to 8.7
    assert result["chance"] == pytest.approx(1 / 5)


@pytest.mark.slow
def test_a_study_resumes_and_leaves_the_page_unchanged_with_another_output(tmp_path, capsys):
    before = PAGE.read_bytes()
    words = ["views", "fabrics=1", "captures=1", "edge_mm=8", "workers=1",
             f"cases={tmp_path / 'cases'}", f"out={tmp_path / 'views.json'}"]
    main(words)
    first = json.loads((tmp_path / "views.json").read_text(encoding="utf-8"))
    capsys.readouterr()
    main(words)
    assert "to go" not in capsys.readouterr().out
    again = json.loads((tmp_path / "views.json").read_text(encoding="utf-8"))
    assert again["views"] == first["views"] and PAGE.read_bytes() == before
