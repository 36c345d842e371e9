"""Shaded pictures show the cloth the right way round."""

import numpy as np

from data.render.shade import shade

SIZE = (60, 50)


def picture(*corners: tuple[float, float, float], **options: float) -> np.ndarray:
    """Where a picture of one triangle differs from one whose triangle is out of sight."""
    far = np.array([[9.0, 0.0, 0.0], [9.1, 0.0, 0.0], [9.0, 0.1, 0.0]])
    options = {"plate_radius": 0.01, "size": SIZE, "supersampling": 2, **options}
    faces = np.array([[0, 1, 2]])
    # The shadow follows the cloth's extent, so the second triangle is in both.
    both = np.array([[0, 1, 2], [3, 4, 5]])
    shown = shade(np.vstack([corners, far]), both, **options)
    hidden = shade(np.vstack([corners, far]), faces + 3, **options)
    assert shown.shape == (SIZE[1], SIZE[0], 3) and shown.dtype == np.uint8
    return (shown != hidden).any(axis=2)


def place(mask: np.ndarray) -> tuple[float, float]:
    """Mean column and row of the cloth, from the picture's middle."""
    rows, columns = np.nonzero(mask)
    return columns.mean() - (SIZE[0] - 1) / 2, rows.mean() - (SIZE[1] - 1) / 2


def square(x: float, y: float, z: float) -> list[tuple[float, float, float]]:
    return [(x - 0.03, y - 0.03, z), (x + 0.03, y - 0.03, z), (x, y + 0.06, z)]


def test_from_above_x_is_right_and_y_is_up():
    right, row = place(picture(*square(0.12, 0.0, 0.0), elevation=90.0))
    assert right > 12 and abs(row) < 3
    column, up = place(picture(*square(0.0, 0.12, 0.0), elevation=90.0))
    assert up < -12 and abs(column) < 1


def test_from_the_front_x_is_right_and_z_is_up():
    right, _ = place(picture(*square(0.12, 0.0, 0.0)))
    assert right > 12
    _, high = place(picture(*square(0.0, 0.0, 0.05)))
    _, low = place(picture(*square(0.0, 0.0, -0.10)))
    # 0.15 m at 25 degrees, 150 pixels a metre.
    assert abs((low - high) - 0.15 * np.cos(np.radians(25)) * 150) < 1.5


def test_both_sides_are_lit():
    corners = square(0.0, 0.0, 0.0)
    options = {"plate_radius": 0.01, "size": SIZE, "supersampling": 1, "elevation": 90.0}
    above, below = (shade(np.array(corners), np.array([face]), **options)
                    for face in ((0, 1, 2), (0, 2, 1)))
    assert np.array_equal(above, below) and len(np.unique(above)) > 2
