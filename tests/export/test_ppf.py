"""Files for ppf-contact-solver, turned back by its own rules."""

import json

import pytest
from exported import IN_A_DRAPE, exported, shell

from drapenet.export.formats import export
from drapenet.export.material import read_material


def test_ppf_s_triangles_stretch_and_shear_by_its_rules(known, estimate):
    """mu = E/(2 (1 + nu)) of the extension and lambda = E nu/((1 + nu)(1 - 2 nu)) of the shear, for
    each kg, in a stretch energy mu/2 e² and a shear energy lambda/2 gamma²."""
    data = shell(exported(known, "ppf"))
    young, poisson = data["young-mod"], data["poiss-rat"]
    mu = young / (2 * (1 + poisson))
    lam = young * poisson / ((1 + poisson) * (1 - 2 * poisson))
    assert data["model"] == "baraff-witkin" and 0 < poisson < 0.5
    assert [mu * data["density"], lam * data["density"]] == pytest.approx([650.0, 35.0])
    assert data["friction"] == 0.31 and 2 * data["contact-offset"] == pytest.approx(0.42e-3)


def test_ppf_says_what_keeps_its_defaults(estimate):
    file = exported(estimate, "ppf")
    assert not {"young-mod", "poiss-rat", "friction", "contact-offset"} & set(shell(file))
    about = json.loads("".join(line[2:] for line in file.read_text().splitlines()[:-5]))
    assert {"young-mod", "poiss-rat", "friction", "contact-offset"} < set(about["tool_defaults"])


def test_ppf_s_hinges_across_the_yarns_have_their_moduli(estimate):
    material = read_material(estimate, mesh="equal", edge_mm=4.0)
    file = export(material, "ppf", estimate.parent / "p.toml")[0]
    data = shell(file)
    for sine, direction in ((1.0, 0), (0.0, 2)):  # of an edge's angle to the warp, squared
        bend = data["bend"] + data["bend-warp"] * sine + data["bend-weft"] * (1 - sine)
        assert 1.28e-5 * bend * data["density"] == pytest.approx(
            IN_A_DRAPE[direction] * material.ratio)
    assert "hinge_over_plate_modulus" in file.read_text()
