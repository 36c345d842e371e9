"""Contact with the cylinder under the plate."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from common.errors import InputError
from sim.batched.energies.base import ElementBatch, stack_elements, stack_numbers, stack_places
from sim.energies.contact import Cylinder, ObstacleContact


@dataclass(frozen=True)
class BatchedContact(ElementBatch):
    """Batched :class:`sim.energies.contact.ObstacleContact` on cylinders.

    All points are computed, whether they touch or not.

    Attributes:
        scale: (B, N) N/m².
        radius: (B, 1) m, of the cylinder.
    """

    scale: Tensor
    radius: Tensor

    @classmethod
    def stack(
        cls, energies: Sequence[ObstacleContact], device: torch.device | str = "cpu"
    ) -> "BatchedContact":
        """The energies as one.

        Raises:
            InputError: an obstacle that is no cylinder, or points of edges among vertices.
        """
        obstacles = [energy.obstacle for energy in energies]
        if not all(isinstance(obstacle, Cylinder) for obstacle in obstacles):
            raise InputError("contact in a batch knows cylinders only")
        if len({energy.share for energy in energies}) > 1:
            raise InputError("the points of a batch must be the means of as many vertices")
        return cls(
            **stack_places(energies, device),
            scale=stack_elements([energy.scale for energy in energies], device, fill=0.0),
            radius=stack_numbers([obstacle.radius for obstacle in obstacles], device),
        )

    def value(self, q: Tensor) -> Tensor:
        depth = self._depth(*self._points(q))
        return (self.scale * depth**3).sum(1) / 3

    def gradient(self, q: Tensor) -> Tensor:
        x, y, z = self._points(q)
        depth = self._depth(x, y, z)
        normal, _ = self._normal(x, y, z)
        force = -(self.scale * depth**2 / self._vertices)[:, None] * normal
        return force.repeat(1, self._vertices, 1).mT

    def hessian(self, q: Tensor, convexity: float) -> Tensor:
        x, y, z = self._points(q)
        depth = self._depth(x, y, z)
        normal, bend = self._normal(x, y, z)
        scale = self.scale / self._vertices**2
        block = (2.0 * scale * depth)[:, None] * normal
        block = block[:, :, None] * normal[:, None]
        if convexity == 0.0:
            # Curvature of the surface: along its tangent, force/radius, pushing outwards.
            tangent = torch.stack([-normal[:, 1], normal[:, 0]], dim=1)
            pushed = (scale * depth**2 * bend)[:, None] * tangent
            block[:, :2, :2] -= pushed[:, :, None] * tangent[:, None]
        return block.repeat(1, self._vertices, self._vertices, 1).permute(0, 3, 1, 2)

    @property
    def _vertices(self) -> int:
        """Of which a point is the mean."""
        return self.entries.shape[1] // 3

    def _points(self, q: Tensor) -> tuple[Tensor, ...]:
        """x, y, z (B, N)."""
        return self.corners(q).mean(1).unbind(1)

    def _depth(self, x: Tensor, y: Tensor, z: Tensor) -> Tensor:
        """(B, N) m, zero outside."""
        return torch.minimum(self.radius - torch.hypot(x, y), -z).clamp(min=0.0)

    def _normal(self, x: Tensor, y: Tensor, z: Tensor) -> tuple[Tensor, Tensor]:
        """Outward normals (B, 3, N) of the nearest surface, its curvature (B, N), 1/m."""
        distance = torch.hypot(x, y)
        sideways = (self.radius - distance < -z).to(distance.dtype)
        inverse = sideways / torch.where(distance > 0, distance, 1.0)
        return torch.stack([x * inverse, y * inverse, 1.0 - sideways], dim=1), inverse
