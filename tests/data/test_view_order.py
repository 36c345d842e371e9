import numpy as np
import pytest

from data.cameras import CameraRig
from data.render import DepthRenderer
from data.view_order import ORDERS, reorder_axis, reorder_views, restore_axis

FACES = np.array([[0, 1, 2]])


def flag(orientation):
    """Views of a plate with one long corner along the warp, after a mirror-friendly camera."""
    positions = np.array([[0.12, 0.0, 0.0], [-0.05, 0.03, 0.0], [-0.05, -0.03, 0.0]])
    return DepthRenderer(positions, FACES).views(CameraRig.load().nominal(), orientation)


@pytest.mark.parametrize(("first", "mirror"), ORDERS)
def test_reordered_views_are_those_of_the_reordered_axis(first, mirror):
    angle = 0.4
    reordered = reorder_views(flag(angle), first=first, mirror=mirror)
    # An axis has two directions; the picture shows which one this flag has.
    axis = reorder_axis(angle, first=first, mirror=mirror)
    misfit = min(np.abs((reordered > 0) ^ (flag(a) > 0)).mean() for a in (axis, axis + np.pi))
    another = np.abs((reordered > 0) ^ (flag(axis + np.pi / 2) > 0)).mean()
    assert misfit < 2e-4
    assert another > 20 * max(misfit, 1e-4)


@pytest.mark.parametrize(("first", "mirror"), ORDERS)
def test_the_axis_can_be_restored(first, mirror):
    for angle in (0.1, 1.5, 3.0):
        there = reorder_axis(angle, first=first, mirror=mirror)
        assert restore_axis(there, first=first, mirror=mirror) == pytest.approx(angle)


def test_the_eight_orders_are_distinct_and_keep_the_views():
    views = np.random.default_rng(0).random((4, 2, 3))
    orders = [reorder_views(views, first=f, mirror=m) for f, m in ORDERS]
    assert len({o.tobytes() for o in orders}) == 8
    for order in orders:
        np.testing.assert_array_equal(np.sort(order.ravel()), np.sort(views.ravel()))
    np.testing.assert_array_equal(orders[0], views)
