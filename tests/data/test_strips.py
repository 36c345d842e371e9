"""Photographs of strips: the curve, its scale and its covariance, and each fault in one line."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from elastica_curves import PRIORS
from PIL import Image
from strip_photographs import (
    ALPHA,
    BETA,
    LONG,
    SHORT,
    SLOPED,
    entry,
    largest_error_mm,
    photograph,
    write,
)

from apps.capture import main
from common.errors import InputError
from common.findings import texts
from drapenet.measured.strips.folder import read_strips

LIGHT = {"cloth": 200.0, "ground": 40.0, "clamp": 150.0}
SEEN = (LONG.pixels(np.zeros((1, 2)))[0] + [4.0, 0.0]).tolist()  # the near edge of the clamp
RULER = {"ruler_px": LONG.pixels(np.array([[-0.04, 0.05], [0.06, 0.05]])).tolist(),
         "ruler_mm": 100}


def read(tmp_path, scene, name="strip.png", picture=None, keys=None, **changes):
    shown = photograph(scene) if picture is None else picture
    folder = write(tmp_path / "strips", {name: shown}, [entry(scene, name) | changes],
                   **({} if keys is None else keys))
    strips = read_strips(folder)
    return strips.photographs[0], strips.warnings


@pytest.mark.parametrize("scene, name, changes", [
    (LONG, "strip.png", {}),
    (SHORT, "strip.jpg", {}),
    (replace(LONG, **LIGHT, thickness=8e-4), "strip.tif", {}),
    (replace(LONG, to_the_left=True, roll=0.08), "strip.png", {}),
    (replace(LONG, clamp=70.0, gradient=0.25, noise=6.0, blur=2.0), "strip.jpeg", {}),
    (replace(LONG, aim=(0.05, 0.01), distance=0.6, field=0.18), "strip.png", {}),
    (LONG, "strip.png", {"clamp_px": SEEN, "roll_deg": 0.0}),
    (LONG, "strip.png", {"scale": RULER}),
    (LONG, "strip.png", {"scale": {"by": "free_length"}}),
], ids=["plain", "short", "light", "left, rolled", "uneven", "aside", "clamp stated", "ruler",
        "free length"])
def test_the_curve_of_a_photograph_is_exact_to_0_4_mm(tmp_path, scene, name, changes):
    strip, warnings = read(tmp_path, scene, name, **changes)
    assert not warnings
    curve, covariance = strip.measured.curve, strip.measured.covariance
    assert largest_error_mm(curve, scene) < 0.4
    assert (curve[0] == 0).all() and (np.diff(curve, axis=0)[1:] @ [0.2, 1] > 0).all()
    assert np.linalg.eigvalsh(covariance[2:, 2:])[0] > 0
    off = (curve - scene.curve[np.linspace(0, 160, len(curve)).astype(int)])[-1]
    deviation = np.sqrt(np.diag(covariance)[-2:])
    assert (np.abs(off) < 4 * deviation).all() and (deviation < 1.5e-3).all()


def test_faint_fibres_at_the_tip_are_not_the_strip(tmp_path):
    light = replace(LONG, **LIGHT)
    picture, tip = photograph(light), light.pixels(light.curve[-1:])[0]
    for way in ((60, 45), (75, 15), (20, 70)):
        cv2.line(picture, tip.astype(int).tolist(), (tip + way).astype(int).tolist(), 70.0, 3)
    strip, _ = read(tmp_path, light, picture=picture, clamp_px=SEEN)
    assert largest_error_mm(strip.measured.curve, light) < 0.4


def test_a_large_photograph_is_reduced(tmp_path):
    small = photograph(LONG)
    large = cv2.resize(small, None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC)
    scale = entry(LONG)["scale"]["mm_per_px"] / 3
    strip, _ = read(tmp_path, LONG, picture=large, scale={"mm_per_px": scale})
    assert strip.picture.shape[1] < large.shape[1]
    assert largest_error_mm(strip.measured.curve, LONG) < 0.4


def test_a_sloping_clamp_is_read_as_stated(tmp_path):
    pictures = {"strip.png": photograph(SLOPED)}
    folder = write(tmp_path / "strips", pictures, [entry(SLOPED)],
                   clamp_slope_deg=float(np.degrees(SLOPED.slope)))
    strips = read_strips(folder)
    assert largest_error_mm(strips.photographs[0].measured.curve, SLOPED) < 0.4
    (found,) = strips.evidence(PRIORS).values()
    assert not strips.warnings and found.alpha == pytest.approx(ALPHA, rel=0.15)
    level = write(tmp_path / "level", pictures, [entry(SLOPED)])
    assert "strip_not_level" in [found.code for found in read_strips(level).warnings]


def test_a_board_gives_the_scale_in_the_plane_of_the_strip(tmp_path):
    scene = replace(LONG, size=(1800, 1300), field=0.46, aim=(0.11, -0.04), board=(0.2, -0.05),
                    yaw=0.03)
    strip, warnings = read(tmp_path, scene, scale={"by": "board"})
    assert largest_error_mm(strip.measured.curve, scene) < 0.9 and not warnings


def test_a_thick_strip_is_read_at_its_middle(tmp_path):
    thin, thick = (read(tmp_path, replace(LONG, thickness=t))[0] for t in (3e-4, 2e-3))
    assert thick.band - thin.band == pytest.approx(1.7e-3, abs=2e-4)
    assert np.abs(thick.measured.curve[-1] - thin.measured.curve[-1]).max() < 6e-4
    assert largest_error_mm(thick.measured.curve, LONG) < 0.4


def test_photographs_of_one_direction_give_its_moduli(tmp_path):
    folder = write(tmp_path / "strips", {"a.png": photograph(SHORT), "b.png": photograph(LONG)},
                   [entry(SHORT, "a.png"), entry(LONG, "b.png"),
                    {"direction": "weft", "bending_length_mm": 21.0}])
    found = read_strips(folder).evidence(PRIORS)
    assert found["warp"].alpha == pytest.approx(ALPHA, rel=0.05)
    assert found["warp"].beta == pytest.approx(BETA, rel=0.35)
    for level, count in ((0.9, 2), (0.01, 0)):
        spans = found["warp"].intervals(level)
        assert ((spans[:, 0] < [ALPHA, BETA]) & (spans[:, 1] > [ALPHA, BETA])).sum() >= count
    one, other = (found[name].posterior.covariance[0, 0] for name in ("warp", "weft"))
    assert one < other
    assert found["weft"].alpha == pytest.approx(0.2 * 9.81 * 0.021**3, rel=0.3)


def bent(at: float, turn: float, over: float) -> np.ndarray:
    """The long strip's curve, turned upwards from a share of it on by so many rad over a share."""
    steps = np.diff(LONG.curve, axis=0)
    angle = turn * np.clip((np.linspace(0, 1, len(steps)) - at) / over, 0, 1)
    cos, sin = np.cos(angle), np.sin(angle)
    turned = [cos * steps[:, 0] + sin * steps[:, 1], cos * steps[:, 1] - sin * steps[:, 0]]
    return np.vstack([[0, 0], np.cumsum(turned, axis=1).T])


def drawn(places: np.ndarray, width: int, shade: float) -> np.ndarray:
    """The long strip's picture with a line through places (N, 2), m, of the middle plane."""
    return cv2.polylines(PICTURE.copy(), [np.rint(LONG.pixels(places)).astype(np.int32)], False,
                         shade, width)


PICTURE = photograph(LONG)
CHECKS = (np.indices(PICTURE.shape) // 60).sum(axis=0) % 2 == 0


@pytest.mark.parametrize(("changed", "said"), [
    ({"scene": replace(LONG, curve=0.02 * LONG.curve), "free_length_mm": 62}, "no strip leaves"),
    ({"scene": replace(LONG, clamp=None)}, "no clamp was found"),
    ({"scene": replace(LONG, blur=25.0)}, ";"),
    ({"scene": replace(LONG, roll=0.44)}, "no horizontal edge of the clamp is seen"),
    ({"scene": replace(LONG, curve=bent(0.4, 1.3, 1e-3))}, "it curls: use a longer strip"),
    ({"scene": replace(LONG, curve=bent(0.6, -1.2, 1e-3))}, "has a kink of"),
    ({"hangs": "left"}, "hangs to the other side of its clamp"),
    ({"free_length_mm": 80.0}, "free_length_mm states 80"),
    ({"scale": {"mm_per_px": 0.0116}}, "larger than the picture at this scale"),
    ({"picture": PICTURE[:680]}, "touches the border of the picture"),
    ({"picture": np.where(CHECKS, PICTURE, PICTURE // 2)}, "use a plain ground"),
    ({"picture": np.ascontiguousarray(PICTURE[::-1])}, "check that the picture is upright"),
    ({"picture": drawn(LONG.curve * [1.15, 0.4] - [0, 0.004], 5, 70.0)}, "2 pieces differ"),
    ({"picture": drawn(LONG.curve[80] + np.diag([0, 0.012]), 3, 70.0)}, "centre line"),
])
def test_each_fault_of_a_photograph_has_a_line(tmp_path, changed, said):
    try:
        answer = "; ".join(texts(read(tmp_path, **{"scene": LONG} | changed)[1]))
    except InputError as refusal:
        answer = str(refusal)
    assert said in answer and "\n" not in answer and ";" in answer


def test_what_is_uncertain_is_a_warning(tmp_path):
    def codes(**keys):
        changes = keys.pop("changes", {})
        found = read(tmp_path, LONG, picture=PICTURE, keys=keys, **changes)[1]
        assert all(line.startswith("strip.png: ") for line in texts(found))
        return [one.code for one in found]

    assert "camera_distance_missing" in codes(changes={"camera_distance_mm": None})
    assert "strip_thin" in codes(thickness_mm=5.0)


def test_the_preview_writes_the_curves_that_an_estimate_takes(tmp_path, capsys):
    strip, _ = read(tmp_path, LONG)
    main([f"frames={tmp_path / 'strips'}", f"out={tmp_path / 'out'}"])
    assert "picture" in capsys.readouterr().out
    curve = [1e-3, -1e-3] * np.loadtxt(tmp_path / "out" / "strip.csv", delimiter=",", skiprows=1)
    assert np.abs(curve - strip.measured.curve).max() < 1e-6
    with Image.open(tmp_path / "out" / "capture.png") as picture:
        assert min(picture.size) > 300
