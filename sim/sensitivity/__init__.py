"""How an equilibrium changes with what it is made of: derivatives without another simulation.

An equilibrium is a point q where the forces g(q; p) vanish. Differentiating g(q(p); p) = 0 gives
dq/dp = -H⁻¹ dg/dp with the Hessian H = dg/dq of all energies, contact among them (as in DiffCloth,
Li et al. 2022). One factor of H serves all parameters p forwards (:func:`sensitivities`) and, as H
is symmetric, any number of them backwards in one solve
(:func:`sim.sensitivity.adjoint.equilibria`).
"""

from sim.sensitivity.follow import follow
from sim.sensitivity.forward import PARAMETERS, Sensitivities, sensitivities
from sim.sensitivity.tangent import Tangent

__all__ = ["PARAMETERS", "Sensitivities", "Tangent", "follow", "sensitivities"]
