"""Derivatives of an equilibrium by its parameters, by implicit differentiation.

An equilibrium is a point q where the forces g(q; p) vanish. Differentiating g(q(p); p) = 0 gives
dq/dp = -H⁻¹ dg/dp with the Hessian H = dg/dq of all energies, contact included. One factor of H
serves all parameters p in forward mode (:func:`sensitivities`) and, as H is symmetric, any number
of them by one solve in reverse mode (:func:`sim.sensitivity.adjoint.equilibria`).
"""

from sim.sensitivity.forward import PARAMETERS, Sensitivities, sensitivities
from sim.sensitivity.tangent import Tangent

__all__ = ["PARAMETERS", "Sensitivities", "Tangent", "sensitivities"]
