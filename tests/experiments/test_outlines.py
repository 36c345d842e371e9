"""Outlines of drapes seen from above, and of real ones against simulated, where they are known."""

import json

import numpy as np
import pytest

import experiments.physics.outlines
from common.errors import InputError
from experiments.physics.outlines import (
    HARMONICS,
    POINTS,
    READINGS,
    Keys,
    Simulated,
    compare,
    features,
    means,
    radii_of,
    run,
    summarise,
)
from sim.measures import shadow_radius
from sim.mesh import Mesh
from sim.rig import Rig
from sim.scene import make_specimen


def test_shadow_of_a_flat_square_is_the_square():
    mesh = make_specimen(Rig(), edge=0.006, grading=1).mesh
    flat = np.column_stack([mesh.rest, np.zeros(len(mesh.rest))])
    azimuth = 2 * np.pi * np.arange(360) / 360
    expected = 0.15 / np.maximum(np.abs(np.cos(azimuth)), np.abs(np.sin(azimuth)))
    assert np.allclose(shadow_radius(flat, mesh), expected, rtol=1e-9)
    # A hem 50 mm below the plate's plane looks 1/1.05 as large from 1 m.
    lower = flat - [0, 0, 0.05]
    assert np.allclose(shadow_radius(lower, mesh, height=1.0), expected / 1.05, rtol=1e-9)


def test_shadow_of_cloth_folded_under_is_its_outermost_part():
    """A band whose hem runs around the axis twice, once inside and once outside."""
    angle = 2 * np.pi * np.arange(60) / 60
    rings = [radius * np.column_stack([np.cos(angle), np.sin(angle)]) for radius in (0.1, 0.2)]
    inner = np.arange(60)
    outer, after = inner + 60, np.roll(inner, -1)
    faces = np.concatenate([np.column_stack([inner, outer, after + 60]),
                            np.column_stack([inner, after + 60, after])])
    mesh = Mesh(np.concatenate(rings), faces)
    # Draped with the circles exchanged, so that the rest's border is inside.
    positions = np.column_stack([np.concatenate(rings[::-1]), np.zeros(120)])
    radius = shadow_radius(positions, mesh, points=60)
    assert np.allclose(radius, 0.2)


ALPHAS, CURLS = (1.0, 10.0, 100.0), (-12.0, 0.0, 12.0)


def expected(alpha, curl=0.0):
    """Features of a fabric whose drape coefficient grows by 20 points a decade, and with curl."""
    return np.concatenate([[0.3 + 0.2 * np.log10(alpha) + 0.005 * curl, 8.0, 6.0],
                           np.full(len(HARMONICS), 1.0)])


@pytest.fixture
def simulated():
    return Simulated(ALPHAS, CURLS, np.array([[expected(a, c) for c in CURLS] for a in ALPHAS]))


def test_a_fabric_inside_the_grid_is_found(simulated):
    for alpha in (1.5, 10.0, 80.0):
        log_alpha, curl = simulated.fitted([expected(alpha)[0]], curled=False)
        assert np.exp(log_alpha) == pytest.approx(alpha, rel=1e-3) and curl == 0
        for truth in (-11.0, 4.0):
            faces = [expected(alpha, sign * truth)[0] for sign in (1, -1)]
            log_alpha, curl = simulated.fitted(faces, curled=True)
            assert np.exp(log_alpha) == pytest.approx(alpha, rel=1e-3)
            assert curl == pytest.approx(truth, abs=0.01)


@pytest.mark.parametrize(("alpha", "curl"), [(0.8, 0.0), (150.0, 0.0), (10.0, 14.0), (10.0, -30.0),
                                             (90.0, 30.0)])
def test_a_fabric_outside_the_grid_is_not_the_one_at_its_border(simulated, alpha, curl):
    faces = [expected(alpha, sign * curl)[0] for sign in (1, -1)]
    assert simulated.fitted(faces, curled=True) is None
    if not curl:
        assert simulated.fitted(faces[:1], curled=False) is None
    with pytest.raises(ValueError, match="out of bounds"):
        simulated.at(np.log(alpha), curl)


def test_summaries_leave_out_fabrics_outside_the_grid_by_name(simulated):
    noise = 0.1 * np.random.default_rng(0).normal(size=(4, 3 + len(HARMONICS)))
    noise[:, 0] = 0
    real = np.concatenate([expected(alpha) + noise for alpha in (20.0, 50.0, 200.0)])
    fabrics, up = np.repeat([3, 4, 5], 4), np.tile([True, True, False, False], 3)
    rows = compare(fabrics, up, real, simulated, curled=True)
    summary = summarise(rows)
    assert summary["outside"] == ["5 up", "5 down"] and summary["faces"] == 4
    assert summary == summarise(rows[:4]) | {"outside": ["5 up", "5 down"],
                                             "bands": summary["bands"]}
    # Drape coefficients of 56, 64 and 76 %
    assert [found["faces"] for found in summary["bands"].values()] == [2, 2, 0]
    assert summary["bands"]["60-80 %"] == means(rows[2:])
    assert [row["alpha_uN_m"] for row in rows[:4]] == pytest.approx([20, 20, 50, 50], rel=1e-3)
    assert means(rows[4:]) == {"faces": 0, "outside": ["5 up", "5 down"]}


def wavy(radius, folds=7, amplitude=5e-3):
    return radius + amplitude * np.cos(2 * np.pi * folds * np.arange(POINTS) / POINTS)


def pretend(*, alpha, seeds, curl, **_):
    """A case whose drapes are wider the stiffer the cloth, and fail if it is limp and curled."""
    failed = seeds if alpha < 2 and curl else 0
    radii = [wavy(0.11 + 0.01 * np.log10(alpha) + 2e-4 * curl)] * (seeds - failed)
    return {"failed": failed, "arrays": {name: np.reshape(radii, (-1, POINTS))
                                         for name in READINGS}}


@pytest.fixture
def config(tmp_path, monkeypatch):
    """Settings of a short comparison with outlines of two fabrics, one of them too stiff."""
    monkeypatch.setattr(experiments.physics.outlines, "drape_case", pretend)
    azimuths = 2 * np.pi * np.arange(170) / 170
    shapes = [np.interp(azimuths, 2 * np.pi * np.arange(POINTS) / POINTS, wavy(radius))
              * [np.cos(azimuths), np.sin(azimuths)]
              for radius in (0.122, 0.123, 0.124, 0.123, 0.147, 0.146, 0.147, 0.148)]
    file = tmp_path / "outlines.npz"
    np.savez(file, fabric=np.repeat([2, 7], 4), face_up=[True, True, False, False] * 2,
             outline=np.swapaxes(shapes, 1, 2))
    return Keys(outlines=str(file), alphas=(3.0, 30.0, 300.0), curls=(-12.0, 0.0, 12.0), seeds=2,
                specimens=2, cases=str(tmp_path / "cases"))


def test_outlines_are_compared(config):
    report = run(config)
    figure = report.pop("figure")
    json.dumps(report, allow_nan=False)
    for each in report["summary"].values():
        for name in ("flat", "curled", "ring", "specimens", "fabrics"):
            assert each[name]["outside"] == ["7 up", "7 down"]
            assert each[name]["faces"] == 2
            assert each[name]["folds_real"] == each[name]["folds"] == 7
    rows = report["parallel"]["flat"]
    assert rows[0]["simulated"][0] == pytest.approx(rows[0]["real"][0], abs=1e-3)
    assert len(figure.axes) == 4  # of the one fabric inside the grid


@pytest.fixture
def only(config):
    """A function that keeps some of the outlines in the file, given a mask of (fabric, up)."""
    def keep(chosen) -> None:
        arrays = dict(np.load(config.outlines))
        kept = np.flatnonzero(chosen(arrays["fabric"], arrays["face_up"]))
        np.savez(config.outlines, **{name: array[kept] for name, array in arrays.items()})

    return keep


def test_a_fabric_with_one_face_and_one_simulated_drape_is_shown(config, only):
    only(lambda fabric, up: ~up)
    report = run(config.model_copy(update={"seeds": 1, "specimens": 1}))
    assert [row["face"] for row in report["parallel"]["flat"]] == ["down", "down"]
    titles = [axes.get_title().partition("\n")[0] for axes in report["figure"].axes
              if axes.axison]
    assert titles == ["fabric 2", "fabric 2", "30 µN·m"]
    only(lambda fabric, up: fabric == 7)  # outside the grid
    assert run(config)["figure"] is None


def test_a_face_with_one_outline_and_an_empty_file_are_sentences(config, only):
    only(lambda fabric, up: (fabric == 7) | (np.cumsum((fabric == 2) & up) == 1))
    with pytest.raises(InputError, match=r"fabric 2 has one outline with its face up; give"):
        run(config)
    only(lambda fabric, up: fabric == 0)
    with pytest.raises(InputError, match="has no outlines; give at least two"):
        run(config)


def test_a_place_of_the_grid_without_drapes_is_named(config):
    with pytest.raises(InputError, match=r"converged of lowered_1\.5_-12, lowered_1\.5_12 "):
        run(config.model_copy(update={"alphas": (1.5, 3.0, 30.0)}))


def test_the_mean_radius_of_an_outline_is_its_coefficient():
    azimuths = 2 * np.pi * np.arange(170) / 170
    radii = radii_of(0.12 * np.column_stack([np.cos(azimuths), np.sin(azimuths)]))
    found = features(radii[None])[0]
    assert found[0] == pytest.approx((0.12**2 - 0.09**2) / (0.15**2 - 0.09**2), rel=1e-6)
    assert found[1] == 0 and found[2] == pytest.approx(0, abs=1e-6)
