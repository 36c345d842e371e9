"""In-plane stiffness: isotropic corotational elasticity of constant-strain triangles."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from sim.batched.energies.base import (
    ElementBatch,
    cross,
    dot,
    dyads,
    stack_elements,
    stack_numbers,
    stack_places,
)
from sim.energies.membrane import CorotationalMembrane

_LEAST = 1e-12  # stretch below which a triangle counts as a needle, as in the per-sample energy


@dataclass(frozen=True)
class BatchedMembrane(ElementBatch):
    """Batched :class:`sim.energies.membrane.CorotationalMembrane`.

    Attributes:
        areas: (B, N) m².
        shape: (B, 3, 2, N) 1/m, corner by axis.
        mu, lam: (B, 1) N/m.
    """

    areas: Tensor
    shape: Tensor
    mu: Tensor
    lam: Tensor

    @classmethod
    def stack(
        cls, energies: Sequence[CorotationalMembrane], device: torch.device | str = "cpu"
    ) -> "BatchedMembrane":
        return cls(
            **stack_places(energies, device),
            areas=stack_elements([energy.areas for energy in energies], device, fill=0.0),
            shape=stack_elements([energy.shape for energy in energies], device),
            mu=stack_numbers([energy.mu for energy in energies], device),
            lam=stack_numbers([energy.lam for energy in energies], device),
        )

    def value(self, q: Tensor) -> Tensor:
        f = self._deformation(q)
        half, product, mean = _invariants(f)
        s1 = (mean + torch.hypot(half, product)).sqrt()
        normal = cross(f[:, 0], f[:, 1])
        s2 = dot(normal, normal).sqrt() / s1
        squares = (s1 - 1.0) ** 2 + (s2 - 1.0) ** 2
        return (self.areas * (self.mu * squares + 0.5 * self.lam * (s1 + s2 - 2.0) ** 2)).sum(1)

    def gradient(self, q: Tensor) -> Tensor:
        s1, s2, u1, u2, w1, w2 = self._modes(q)
        p1, p2 = self._stresses(s1, s2)
        w1, w2 = (self.areas * p1)[:, None] * w1, (self.areas * p2)[:, None] * w2
        return (w1[:, :, None] * u1[:, None]).addcmul_(w2[:, :, None], u2[:, None]).flatten(1, 2).mT

    def hessian(self, q: Tensor, convexity: float) -> Tensor:
        # The Hessian of an isotropic energy by F has a known eigenbasis: scalings u_i v_i, a twist,
        # a flip, and the two out-of-plane rotations n v_i, whose eigenvalues are stress/stretch.
        s1, s2, u1, u2, w1, w2 = self._modes(q)
        p1, p2 = self._stresses(s1, s2)
        twist, lift1, lift2 = (p1 + p2) / (s1 + s2), p1 / s1, p2 / s2.clamp(min=_LEAST)
        if convexity == 1.0:
            twist, lift1, lift2 = (value.clamp(min=0.0) for value in (twist, lift1, lift2))
        mu, lam, areas = (a[:, None, None] for a in (self.mu, self.lam, self.areas))

        def by_corner(w: Tensor, u: Tensor) -> Tensor:
            return w[:, :, None] * u[:, None]  # (B, 3, 3, N)

        normal = cross(u1, u2)
        scale1, scale2 = by_corner(w1, u1), by_corner(w2, u2)
        cross1, cross2 = by_corner(w1, u2), by_corner(w2, u1)
        twisted, flipped = cross1 - cross2, cross1 + cross2
        lifted1, lifted2 = by_corner(w1, normal), by_corner(w2, normal)
        modes = [scale1, scale2, twisted, flipped, lifted1, lifted2]
        forces = [
            (2.0 * mu + lam) * scale1 + lam * scale2,
            (2.0 * mu + lam) * scale2 + lam * scale1,
            (0.5 * twist)[:, None, None] * twisted,
            mu * flipped,
            lift1[:, None, None] * lifted1,
            lift2[:, None, None] * lifted2,
        ]
        left = torch.stack(modes, dim=1).flatten(2, 3)
        right = (areas[:, None] * torch.stack(forces, dim=1)).flatten(2, 3)
        return dyads(left, right).permute(0, 3, 1, 2)

    def _deformation(self, q: Tensor) -> Tensor:
        """(B, 2, 3, N) columns of the deformation gradients."""
        return dyads(self.shape, self.corners(q))

    def _modes(self, q: Tensor) -> tuple[Tensor, ...]:
        """Singular values s1 >= s2 (B, N) of F, its left vectors u1, u2 (B, 3, N), and w1, w2.

        w (B, 3, N) are the right singular vectors by the corners: shape times v, 1/m.
        """
        f = self._deformation(q)
        half, product, mean = _invariants(f)
        angle = 0.5 * torch.atan2(product, half)
        c, s = angle.cos()[:, None], angle.sin()[:, None]
        s1 = (mean + torch.hypot(half, product)).sqrt()
        u1 = (f[:, 0] * c + f[:, 1] * s) / s1[:, None]
        u2 = f[:, 1] * c - f[:, 0] * s
        s2 = dot(u2, u2).sqrt()
        u2 = u2 / s2.clamp(min=_LEAST)[:, None]
        first, second = self.shape.unbind(2)
        return s1, s2, u1, u2, first * c + second * s, second * c - first * s

    def _stresses(self, s1: Tensor, s2: Tensor) -> tuple[Tensor, Tensor]:
        """Derivatives (B, N) of the energy per area by the singular values, N/m."""
        common = self.lam * (s1 + s2 - 2.0)
        return 2.0 * self.mu * (s1 - 1.0) + common, 2.0 * self.mu * (s2 - 1.0) + common


def _invariants(f: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Half the difference of the squares of F's columns, their product, and half the sum."""
    first, second = dot(f[:, 0], f[:, 0]), dot(f[:, 1], f[:, 1])
    return 0.5 * (first - second), dot(f[:, 0], f[:, 1]), 0.5 * (first + second)
