"""The mat with the code, and hems where it is visible."""

import hashlib

import numpy as np
import pytest
from photographs import ANGLE, RADIUS, distances_mm, over_mat, write_over_mat

from common.errors import InputError
from data.captures.reader import read_capture
from data.pictures.code import CELL, cells
from data.pictures.mat import MATS, mat_pages, mat_picture

PALE = (150, 145, 150)  # as light as the code in the mean
SHADES = {"white": (250, 250, 250), "pale": PALE, "grey": (128, 128, 128), "dark": (40, 40, 40)}


def read(folder, **changes):
    """A capture of a drawn picture over the code."""
    return read_capture(write_over_mat(folder, over_mat(ground="code", **changes)))


def rms(values) -> float:
    return float(np.sqrt(np.square(values).mean()))


def test_printed_mats_stay_readable_and_no_two_neighbours_are_alike():
    code = cells()
    assert hashlib.sha256(code.tobytes()).hexdigest()[:16] == "7def316f30f14cd1"
    assert (code[1:] != code[:-1]).all() and (code[:, 1:] != code[:, :-1]).all()
    assert (np.bincount(code.ravel()) > 0.25 * code.size).all()
    largest = np.max([mat.size[::-1] for mat in MATS.values()], axis=0)
    assert (np.array(code.shape) * CELL >= largest).all()


def test_the_code_is_printed_in_black_and_white_and_less_than_half_of_it_is_ink():
    page = mat_picture("a2", "code")
    assert ((page == 0) | (page == 255)).mean() > 0.999  # but for the edges of letters
    assert 0.3 < (page < 128).mean() < 0.5


def test_the_middle_of_the_mat_is_a_sheet_of_any_paper_for_a_foot():
    assert mat_pages("foot", "a4").startswith(b"%PDF")
    with pytest.raises(InputError, match="mat=foot paper=letter"):
        mat_pages("foot", "a9")


@pytest.mark.parametrize("shade", SHADES)
def test_cloth_of_any_lightness_is_read_to_a_pixel(tmp_path, shade):
    """Of 0.6 mm; what OpenCV draws is wider by half of one."""
    found = read(tmp_path, cloth=SHADES[shade])
    assert rms(distances_mm(found)) < 0.6 and not found.outline.unclear.any()


def test_parts_that_are_laid_beside_each_other_are_read_where_they_lie(tmp_path):
    def moved(picture: np.ndarray) -> np.ndarray:
        picture = picture.copy()
        middle = picture.shape[1] // 2
        picture[:, middle:] = np.roll(picture[:, middle:], 2, axis=0)  # 1.3 mm
        return picture

    assert rms(distances_mm(read(tmp_path, cloth=PALE, changed=moved))) < 0.7


def test_what_hides_the_code_beside_the_hem_is_no_cloth_or_named_with_its_side(tmp_path):
    def hidden(picture: np.ndarray) -> np.ndarray:
        picture = picture.copy()
        row, column = (side // 2 for side in picture.shape[:2])
        picture[row - 60 : row + 60, column + 100 : column + 290] = (30, 90, 160)
        return picture

    found = read(tmp_path, cloth=PALE, changed=hidden).outline
    true = np.interp(np.arange(720) * np.pi / 360, ANGLE, RADIUS, period=2 * np.pi)
    off = np.abs(found.radii - true)
    assert (off < 3 * found.error).mean() > 0.97
    assert off.max() < 3e-3 or any(" right" in warning.text for warning in found.warnings)


def test_an_overexposed_mat_is_named_with_its_side(tmp_path):
    def glaring(picture: np.ndarray) -> np.ndarray:
        picture = picture.copy()
        right = picture[:, picture.shape[1] // 2 :]
        right[:] = np.minimum(1.6 * right.astype(float) + 100, 255)
        return picture

    found = read(tmp_path, changed=glaring)
    said, = (one.text for one in found.warnings if one.code == "mat_overexposed")
    assert "at the right" in said and rms(distances_mm(found)) < 1.5
