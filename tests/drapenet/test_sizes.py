"""Sizes of specimen and plate, measured on points of cones over a plate."""

import numpy as np
import pytest

from data.captures.capture import warnings_of
from data.render.cameras import nominal_camera
from drapenet.views.checks import MAX_SIZE_ERROR, size_checks
from drapenet.views.located import LocatedViews
from drapenet.views.sizes import Sizes, measured_sizes
from sim.rig import DISC_RIG, Rig


class Cone(LocatedViews):
    """Points of a disc that is flat on its plate and falls steeply beyond it."""

    size, plate, azimuths, slope = 0.3, 0.18, 1.0, np.radians(50)

    @property
    def clouds(self):
        """Points in one view, about a millimetre apart."""
        rng = np.random.default_rng(0)
        length = self.size / 2 * np.sqrt(rng.random(60_000))
        azimuth = 2 * np.pi * self.azimuths * rng.random(len(length))
        beyond = np.maximum(length - self.plate / 2, 0.0)
        radius = length - beyond * (1 - np.cos(self.slope))
        return [np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth),
                                 -beyond * np.sin(self.slope)])]


def measured(rig: Rig = DISC_RIG, **shape: float) -> Sizes:
    views = np.zeros((1, 1, 1), np.float32)
    cone = Cone.exact(views, nominal_camera(rig), rig, np.zeros(1))
    for name, value in shape.items():
        object.__setattr__(cone, name, value)
    return measured_sizes(cone)


@pytest.mark.parametrize("size", [0.24, 0.30, 0.36])
@pytest.mark.parametrize("plate", [0.12, 0.18])
def test_sizes_do_not_depend_on_the_stated_ones(size, plate):
    found = measured(size=size, plate=plate)
    assert found.specimen == pytest.approx(size, rel=0.07)
    assert found.plate == pytest.approx(plate, rel=0.07)
    assert [one.code for one in warnings_of(size_checks(found, MAX_SIZE_ERROR))] == [
        *["specimen_size"] * (size != 0.30), *["plate_size"] * (plate != 0.18)]


def test_a_tenth_of_a_drape_has_no_size():
    found = measured(azimuths=0.1)
    assert np.isnan([found.specimen, found.plate]).all()
    assert warnings_of(size_checks(found, MAX_SIZE_ERROR)) == []
