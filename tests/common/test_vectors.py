import numpy as np
import pytest

from common.vectors import angle_between


@pytest.mark.parametrize("angle", [0.0, 1e-12, 0.3, np.pi / 2, 3.0, np.pi])
def test_angles_are_exact_also_between_parallel_vectors(angle):
    one = [0.0, 0.0, 7.0]
    other = 0.1 * np.array([np.sin(angle), 0.0, np.cos(angle)])
    assert angle_between(one, other) == pytest.approx(angle, rel=1e-12, abs=1e-300)


def test_a_vector_and_itself_have_no_angle_however_their_product_rounds():
    vectors = np.random.default_rng(0).normal(size=(1000, 3))
    unit = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    assert ((unit * unit).sum(axis=1) > 1).any()  # there the arc cosine has no value
    assert angle_between(unit, unit).max() == 0.0


def test_many_angles_in_the_plane():
    turn = np.linspace(0.1, 3.0, 12).reshape(3, 4)
    around = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    np.testing.assert_allclose(angle_between(around, [2.0, 0.0]), turn, rtol=1e-14)
