"""The study of the membrane of a hung square."""

import numpy as np

from data.fabrics.fabrics import fabric_from_theta
from experiments.papers import hung
from sim.cloth import Laws
from sim.draping import drape, follow
from sim.rig import HUNG_SQUARE
from sim.sensitivity import Tangent
from sim.solver.newton import NewtonOptions

THETA = np.array([*np.log([60e-6, 40e-6, 50e-6]), -2e-3, -2e-3, -2e-3])
EXACT = NewtonOptions(residual=1e-8, step=1e-8, max_iterations=100)


def test_sampled_membranes_have_the_mean_and_deviation_of_the_prior():
    mean, spread = hung.prior()
    rng = np.random.default_rng(0)
    values = np.array([hung.sample_unknowns(rng) for _ in range(2000)])
    np.testing.assert_allclose(values.mean(axis=0), mean, atol=0.1)
    np.testing.assert_allclose(values.std(axis=0), spread, rtol=0.1)


def test_derivatives_of_a_hung_square_match_finite_differences():
    unknowns, fabric = np.array([5.0, 5.5, 3.0, 0.2]), fabric_from_theta(THETA)
    near = follow(drape(fabric, rig=HUNG_SQUARE, edge=0.05,
                        laws=Laws(membrane=hung.membrane_of(unknowns))), fabric, options=EXACT)
    moves = hung.hung_sensitivities(Tangent.of(near), fabric, np.concatenate([unknowns, THETA]))
    assert moves.shape == (10, len(near.rest), 3)
    for k, step in enumerate(1e-3 * np.eye(4)):
        ends = [follow(near, fabric, laws=Laws(membrane=hung.membrane_of(unknowns + sign * step)),
                       options=EXACT).positions for sign in (1, -1)]
        difference = (ends[0] - ends[1]) / 2e-3
        np.testing.assert_allclose(moves[k], difference, atol=2e-3 * np.abs(difference).max())
