"""Readings of laboratory testers, and testers by name."""

from pathlib import Path

import numpy as np
import pytest
from cloths import describe
from pydantic import ValidationError
from scipy.optimize import brentq

from common.errors import InputError
from data.captures.description import whole_turns
from data.captures.reader import read_capture
from data.captures.writer import write_capture
from data.fabrics.fabrics import ClothProperties, from_theta
from data.fabrics.prior import load_prior, log_stiffness
from data.fabrics.prior.even import draw_fabrics
from data.readings import QUANTITIES
from data.readings.cantilever import (
    MG_CM,
    SOFTENING,
    bending_length,
    flexural_rigidity,
    strip_lengths,
)
from data.readings.kes import GF_CM, KES_CURVATURES, kes
from data.readings.known import ByDirection, Known
from data.readings.quantity import Quantity, by_name, moduli_at
from data.render.cameras import VIEWS, nominal_camera
from data.render.rays import DepthRenderer
from data.render.scenes import raw_scene
from data.rigs import PLATES
from drapenet.measured.strips.posterior import INCLINE
from sim.cantilever import hang
from sim.cantilever.elastica import MAX_GAMMA, aspect_ratio, elastica, heavy_elastica
from sim.draping import Drape, drape
from sim.energies import bending_law
from sim.material import MICRO, NANO, REFERENCE_DENSITY, Fabric
from sim.rig import GRAVITY, Rig

NAMES = ("square300_cylinder100", "disc360_support120", "rectangle170x250_cylinder90")


def test_a_linear_fabric_reads_its_own_rigidity_within_peirce_s_approximation():
    alpha = np.array([5.0, 30.0, 200.0]) * MICRO
    length = bending_length(alpha, 0 * alpha, 0.2)
    assert 0.2 * GRAVITY * length**3 == pytest.approx(alpha, rel=2e-3)
    assert flexural_rigidity(alpha, 0 * alpha, 0.2) == pytest.approx(alpha, rel=2e-3)
    # Peirce's c = L (cos(theta/2) / (8 tan theta))^(1/3) approximates L/2 at 41.5 degrees.
    peirce = np.cbrt(np.cos(INCLINE / 2) / (8 * np.tan(INCLINE)))
    assert 2 * peirce * length == pytest.approx(np.cbrt(alpha / (0.2 * GRAVITY)), rel=0.02)


def test_units_by_hand():
    # 200 g/m² and 20 mm: FAST-2's 9.807e-6 W c³ µN·m (with 9.80665), ASTM's 0.1 W c³ mg·cm.
    rigidity = 0.2 * GRAVITY * 0.02**3
    assert rigidity / MICRO == pytest.approx(9.807e-6 * 200 * 20**3, rel=1e-3)
    assert rigidity / MG_CM == pytest.approx(0.1 * 200 * 2.0**3, rel=1e-3)
    assert pytest.approx(98.07 * MICRO, rel=1e-4) == GF_CM


@pytest.mark.parametrize("k", [0, 60, 120, 180, 239])
def test_strips_of_the_table_end_on_the_plane(k):
    """Strips of 100 integration steps, solved for their length, make the table."""
    def above(length: float) -> float:
        shape = elastica(length**3, 11, softening=SOFTENING[k] / length, steps=100)
        return aspect_ratio(shape[-1]) - np.tan(INCLINE)

    solved = brentq(above, 0.2, 0.99 * np.cbrt(MAX_GAMMA), xtol=1e-8)
    assert strip_lengths()[k] == pytest.approx(solved, abs=1e-7)
    assert len(strip_lengths()) == len(SOFTENING)


@pytest.mark.parametrize("ratio", [-6e-3, -2e-3, 3e-3])  # m
def test_the_strip_of_the_bending_length_touches_the_plane(ratio):
    alpha, density = 25 * MICRO, 0.15
    length = 2 * bending_length(np.array(alpha), np.array(ratio * alpha), density)
    shape = heavy_elastica(alpha, ratio * alpha, weight=density * GRAVITY, length=float(length))
    assert aspect_ratio(shape[-1]) == pytest.approx(np.tan(INCLINE), rel=2e-3)


@pytest.mark.parametrize("beta", [0.0, -60.0])  # nN·m²
def test_so_does_a_simulated_specimen(beta):
    fabric = Fabric(alpha=np.full(3, 30 * MICRO), beta=np.full(3, beta * NANO))
    length = 2 * float(bending_length(fabric.alpha[0], fabric.beta[0], REFERENCE_DENSITY))
    strip = hang(fabric, length=length, width=0.03, edge=length / 24, diagonals="random")
    end = strip.curve[-1] - strip.curve[0]
    assert np.degrees(np.arctan2(end[1], end[0])) == pytest.approx(41.5, abs=0.4)


def test_kes_reads_the_secant_of_the_simulated_cloth():
    fabric = Fabric(alpha=np.array([60.0, 40.0, 20.0]) * MICRO,
                    beta=np.array([-100.0, -70.0, -20.0]) * NANO)
    law = bending_law.constants(fabric)
    for k, way in enumerate(([1.0, 0, 0], [0.5, 0.5, 0.5], [0, 1.0, 0])):
        # Torque of a cylinder: derivative of the energy per area that the simulator minimises.
        bent = np.add.outer(KES_CURVATURES, [1e-2, -1e-2]).reshape(-1, 1) * np.array(way)
        energies = bending_law.respond(bent, np.zeros_like(bent), law, bending_law.PLAIN)[0]
        torques = -np.diff(energies.reshape(-1, 2))[:, 0] / 2e-2
        expected = (torques[1] - torques[0]) / (KES_CURVATURES[1] - KES_CURVATURES[0])
        assert kes(fabric.alpha[k], fabric.beta[k])[0] == pytest.approx(expected, rel=1e-6)


def test_kes_is_determined_of_limp_cloth_and_not_of_stiff_as_the_notation_says():
    theta, _ = draw_fabrics(load_prior("vae"), 3000, even_share=1.0)
    alpha, beta = from_theta(theta)
    stiffness, outside = np.exp(log_stiffness(theta)), kes(alpha, beta)[2]
    shares = [outside[(low <= stiffness) & (stiffness < high)].mean()
              for low, high in ((0.0, 4e-6), (16e-6, 64e-6), (200e-6, 1.0))]
    assert np.allclose(shares, [0.02, 0.31, 0.83], atol=0.03)
    # The parabola nearest to a line of slope B with the intercept HB, up to a curvature.
    line, end, at = (20e-6, 0.4e-3), 120.0, np.linspace(0, 120.0, 4001)[:, None]
    fitted, *_ = np.linalg.lstsq(np.hstack([at, at**2]), line[0] * at[:, 0] + line[1], rcond=None)
    assert np.allclose(fitted, [line[0] + 4 * line[1] / end, -10 / 3 * line[1] / end**2], rtol=2e-3)


def test_kes_is_the_secant_and_knows_where_the_law_ends():
    alpha = np.array([100.0, 100.0, 100.0]) * MICRO
    beta = np.array([0.0, -100.0, -500.0]) * NANO
    secant, hysteresis, outside = kes(alpha, beta)
    # alpha + 200/m beta by hand: 100, 80 µN·m; at beta/alpha = -5 mm the torque peaks at 100/m.
    assert secant[:2] / MICRO == pytest.approx([100.0, 80.0], rel=1e-9)
    assert outside.tolist() == [False, False, True]
    # Secants of the parabola alpha kappa + beta kappa² through 50 and 150 1/m: -beta 50 150 at 0
    assert hysteresis[:2] == pytest.approx([0.0, 2 * 100e-9 * 7500], abs=1e-12)


def test_limits_hold_every_fabric_and_no_value_in_another_unit():
    theta, _ = draw_fabrics(load_prior("vae"), 3000, even_share=1.0)
    cloth = ClothProperties(theta, np.zeros((3000, 2)), np.full(3000, 600.0), np.full(3000, 0.2))
    for density in (0.05, 0.8):
        for quantity in QUANTITIES.values():
            values, (low, high) = quantity.of(cloth, density), quantity.limits
            values = values[np.isfinite(values) & (values > 0)]
            assert ((values < low) | (values > high)).mean() < 0.02, quantity.name
    # A bending length in cm, B of KES in N·m²/m, 2HB in N
    for name, value in (("bending_length_mm", 2.84), ("kes_b_gf_cm2_per_cm", 0.24e-4),
                        ("kes_2hb_gf_cm_per_cm", 900.0)):
        with pytest.raises(ValidationError, match=rf"= {value:g}; it must be .*: check unit and"):
            Known(**{name: ByDirection(warp=value)})
    for name, value in (("membrane_n_per_m", 6.0), ("bending_stiffness_uN_m", 6e4)):  # N/mm, nN·m
        with pytest.raises(ValidationError, match="check unit"):
            Known(**{name: value})


def loop(cloth: ClothProperties, density: float) -> np.ndarray:
    """A laboratory's own reading."""
    return moduli_at(cloth, density)[0] / MICRO


def test_a_quantity_of_a_laboratory_is_checked():
    cloth = ClothProperties(np.zeros((5, 6)), np.zeros((5, 2)), np.ones(5), np.zeros(5))
    mine = Quantity("loop_uN_m", 3, 0.05, loop)
    assert mine.of(cloth, 0.2).shape == (5, 3) and by_name([mine]) == {"loop_uN_m": mine}
    with pytest.raises(ValueError, match="two quantities have the key loop_uN_m"):
        by_name([mine, mine])
    for directions, error in ((2, 0.05), (3, 5.0), (3, 0.0)):
        with pytest.raises(ValueError, match="must be 1 or 3, and error"):
            Quantity("loop_uN_m", directions, error, loop)
    with pytest.raises(ValueError, match=r"predict gives an array \(5, 3\), not \(5, 1\)"):
        Quantity("loop_uN_m", 1, 0.05, loop).of(cloth, 0.2)


@pytest.fixture(scope="module", params=NAMES)
def shape(request) -> Drape:
    """A drape of a rather stiff fabric."""
    return drape(Fabric(alpha=[60 * MICRO] * 3, beta=[0.0] * 3), rig=Rig.from_name(request.param),
                 edge=6e-3, seed=1)


def test_a_tester_of_any_size_drapes_renders_and_reads_back(tmp_path, shape):
    rig = shape.rig
    views = DepthRenderer(shape.positions, shape.faces).views(nominal_camera(rig), 0.3)
    folder = tmp_path / "capture"
    write_capture(folder, views=views, intrinsics=nominal_camera(rig).intrinsics, density=0.3,
                  rig=rig)
    sides = [round(1e3 * side) for side in rig.sides]
    describe(folder, tester={"specimen": rig.specimen,
                          "size_mm": sides if rig.specimen == "rectangle" else sides[0],
                          "plate_mm": round(1e3 * rig.plate_diameter)})
    capture = read_capture(folder)
    assert shape.converged and capture.rig == rig and capture.warnings == ()
    cloth = capture.views > 0
    assert np.abs(capture.views - views)[cloth].max() < 0.51e-3
    assert cloth.sum() > 0.999 * (views > 0).sum()  # few pixels are taken for outliers
    describe(folder, tester=None)
    with pytest.raises(InputError, match="states no tester; give tester: square300_cylinder100, d"):
        read_capture(folder)


def test_cloth_on_a_tester_of_any_size_is_cut_out_of_its_scene(tmp_path, shape):
    scene = raw_scene(shape.positions, shape.faces, np.random.default_rng(1), rig=shape.rig,
                      turns=whole_turns(VIEWS), sensor="smooth")
    write_capture(tmp_path / "capture", views=scene.frames, intrinsics=scene.camera.intrinsics,
                  density=0.3, rig=shape.rig)
    assert read_capture(tmp_path / "capture").cut is not None


def test_the_manual_states_heights_and_weights_of_specimens_on_a_tin():
    text = (Path(__file__).parents[2] / "docs" / "use.md").read_text("utf-8")
    text = " ".join(text.partition("#### With a tin")[2].partition("####")[0].split())
    disc, square = (Rig.from_name(name) for name in ("disc254_support127", "square250_cylinder127"))
    for rig, height in ((disc, 75), (square, 125)):
        assert f"{1e3 * rig.overhang:.0f} mm" in text and f"needs {height} mm" in text
        assert 10 <= height - 1e3 * rig.overhang < 13
    weight = 150 * disc.specimen_area
    assert f"weighs {weight:.1f} g at 150 g/m²" in text and f"one of {100 / weight:.0f} %" in text
    low, high = PLATES
    assert f"outer diameter, {low:g} to {high:g} mm" in text
