"""Targets are those of the fabric in units of its weight and the specimen's size."""

import numpy as np
import pytest

from data.fabrics.fabrics import ClothProperties
from drapenet.network.targets import (
    SYMMETRIES,
    TARGETS,
    Symmetry,
    TargetScale,
    cloth_of,
    stiffer_first,
    targets_of,
)
from drapenet.views.directions import AZIMUTHS
from sim.material import SWAPPED

CLOTH = ClothProperties(np.array([[-10.5, -11.0, -11.2, -2e-3, -3e-3, -1e-3]]),
                        np.array([[4.0, -2.0]]), np.array([500.0]), np.array([0.2]))


def test_targets_of_a_fabric_are_undone() -> None:
    size = np.array([0.36])
    back = cloth_of(targets_of(CLOTH, size), size)
    for name, part in vars(CLOTH).items():
        np.testing.assert_allclose(getattr(back, name), part, rtol=1e-12, err_msg=name)


def test_similar_specimens_have_the_same_targets() -> None:
    """As sim.similarity's tests: lengths times s, alpha times s³, beta times s⁴, membrane times s,
    curvatures divided by s."""
    scale = 1.3
    theta = CLOTH.theta + np.array([3 * np.log(scale)] * 3 + [0.0] * 3)
    theta[:, 3:] *= scale
    larger = ClothProperties(theta, CLOTH.curl / scale, CLOTH.membrane * scale, CLOTH.hysteresis)
    np.testing.assert_allclose(targets_of(larger, np.array([scale * 0.3])),
                               targets_of(CLOTH, np.array([0.3])), rtol=1e-12)


def test_the_stiffer_yarns_come_first_with_their_curl() -> None:
    targets = targets_of(CLOTH, np.array([0.3]))
    swapped = ClothProperties(CLOTH.theta[:, SWAPPED], CLOTH.curl[:, ::-1], CLOTH.membrane,
                              CLOTH.hysteresis)
    exchanged = targets_of(swapped, np.array([0.3]))
    np.testing.assert_array_equal(stiffer_first(targets), targets)
    np.testing.assert_array_equal(stiffer_first(exchanged), targets)


def test_symmetries_keep_a_known_warp_on_an_axis() -> None:
    """Two spots on the warp stay there, or lie on the weft where the two are exchanged."""
    rows = np.zeros((1, AZIMUTHS))
    rows[0, [0, AZIMUTHS - 1, AZIMUTHS // 2 - 1, AZIMUTHS // 2]] = 1.0  # cells beside the axis
    for k in range(SYMMETRIES):
        symmetry = Symmetry.number(k, 1)
        quarter = AZIMUTHS // 4 if symmetry.exchanged[0] else 0
        np.testing.assert_array_equal(symmetry.of_rows(rows), np.roll(rows, quarter, 1))
    rng = np.random.default_rng(0)
    for exchanged in (True, False) * 10:
        drawn = Symmetry.draw(known=np.array([True]), disc=np.array([True]),
                              exchanged=np.array([exchanged]), rng=rng)
        assert drawn.exchanged[0] == exchanged
        np.testing.assert_array_equal(drawn.of_rows(rows),
                                      np.roll(rows, AZIMUTHS // 4 * exchanged, 1))


@pytest.mark.parametrize(("disc", "count"), [(False, 4), (True, AZIMUTHS)])
def test_an_unknown_warp_may_be_turned_as_the_specimen_allows(disc: bool, count: int) -> None:
    rng = np.random.default_rng(0)
    drawn = {int(Symmetry.draw(known=np.array([False]), disc=np.array([disc]), rng=rng).cells[0])
             for _ in range(2000)}
    assert len(drawn) == count


def test_the_scale_is_the_same_for_warp_and_weft() -> None:
    targets = np.random.default_rng(0).normal(size=(50, TARGETS)) * np.arange(1, TARGETS + 1)
    scale = TargetScale.fit(targets)
    np.testing.assert_allclose(scale.decode(scale.encode(targets)), targets)
    assert scale.std[0] == scale.std[2] and scale.mean[6] == scale.mean[7]
