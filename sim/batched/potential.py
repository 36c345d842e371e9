"""The energy of a batch of cloths on one triangulation, its gradient and its Hessian, in PyTorch.

A state is positions x (3, V, B), m, and edge normals n (3, E, B) (:mod:`sim.solver.state`); steps
and gradients are (n, B) in the order of the free unknowns of a cloth.
Arrays of the geometry end with 1 where the drapes share it.
"""

import copy
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from sim.batched import laws
from sim.batched.solver import BatchedSolver
from sim.cloth import Cloth
from sim.energies import bending_law
from sim.energies.midedge import CONVEX_FLOOR
from sim.mesh import Mesh
from sim.rig import RIM

_UPPER = np.triu_indices(12)


@dataclass
class Value:
    """Energy (B,), J, its gradient (n, B) and the triangles' angles (3, T, B), rad."""

    energy: Tensor
    gradient: Tensor
    angles: Tensor

    def take(self, drapes: Tensor) -> "Value":
        """The values of some of the drapes, by index."""
        return Value(*(value[..., drapes] for value in vars(self).values()))

    def replaced(self, drapes: Tensor, new: "Value") -> "Value":
        """A copy with other values of some of the drapes."""
        return Value(*(old.index_copy(-1, drapes, value) for old, value in
                       zip(vars(self).values(), vars(new).values(), strict=True)))


class BatchedPotential:
    """The energies of ``cloths`` with the default kinds of laws and meshes of the same faces.

    Attributes:
        own: tensors (..., B) or (..., 1) of the drapes; those of a motion may be added: the aim
            (3, V, B) and scale (V, B) of its inertia, ring (V, 1) and height (B,).
        pattern, solver: of the Hessians, shared.
    """

    def __init__(self, cloths: list[Cloth], device: str | torch.device = "cpu") -> None:
        first, one = cloths[0], cloths[0].bending
        mesh, potential = first.scene.mesh, first.potential
        self.device, self.count = torch.device(device), len(cloths)
        self.vertices, self.unknowns = len(mesh.rest), potential.unknowns
        self.pattern, self.energy_scale = potential.pattern, potential.energy_scale
        active = first.scene.active
        self.faces, self.sides = self._place(mesh.faces[active].T, mesh.face_edges[active].T)
        self.ends, self.free = self._place(mesh.edges.T, potential._free)
        self.targets, self.diagonal = self._place(
            one.dofs[:, [0, 3, 6, 1, 4, 7, 2, 5, 8, 9, 10, 11]].T, self.pattern.diagonal)
        slots = [np.where(slot < 0, len(self.pattern.indices), slot).T
                 for slot in self.pattern.slots]
        row, column = _UPPER
        self.slots = self._place(*(slots[1][kind] for kind in (
            column < 9, (row < 9) & (column >= 9), row >= 9)))
        self.contacts = [self._place(contact.dofs[:, ::3].T // 3, slot) for contact, slot in
                         zip(first.obstacles, slots[-2:], strict=True)]
        self._pairs = self._place(*_UPPER)
        self.own = self._own(cloths)
        places = np.concatenate([np.repeat(mesh.rest, 3, axis=0), mesh.rest[mesh.edges].mean(1)])
        rows = np.full(self.unknowns + 1, -1)
        rows[potential._free] = np.arange(potential.size)
        self.solver = BatchedSolver(self.pattern, [rows[one.dofs]], places[potential._free], device)

    def _place(self, *arrays: np.ndarray) -> list[Tensor]:
        return [torch.from_numpy(np.ascontiguousarray(array, np.int64)).to(self.device)
                for array in arrays]

    def _own(self, cloths: list[Cloth]) -> dict[str, Tensor]:
        by_mesh = {id(cloth.scene.mesh): cloth for cloth in cloths}
        geometry = {key: _geometry(cloth) for key, cloth in by_mesh.items()}
        rows = [geometry[id(cloth.scene.mesh)] for cloth in cloths]
        own = {name: np.stack([row[name] for row in (rows if len(by_mesh) > 1 else rows[:1])], -1)
               for name in rows[0]}
        fabrics = [cloth.fabric for cloth in cloths]
        own |= {"law": np.stack([bending_law.constants(fabric) for fabric in fabrics], -1),
                "softest": np.array([fabric.alpha.min() for fabric in fabrics]),
                "membrane": np.stack([cloth.laws.membrane.matrix[0] for cloth in cloths], -1)}
        return {name: torch.from_numpy(np.ascontiguousarray(value)).to(self.device)
                for name, value in own.items()}

    def take(self, drapes: Tensor) -> "BatchedPotential":
        """The potential of some of the drapes, by index."""
        part = copy.copy(self)
        part.count = len(drapes)
        part.own = {name: value[..., drapes] if value.shape[-1] > 1 else value
                    for name, value in self.own.items()}
        return part

    @property
    def law(self) -> bending_law.PlateConstants:
        """Constants of the fabrics, (B,) each."""
        return bending_law.PlateConstants(*self.own["law"])

    def moved(self, x: Tensor, n: Tensor, step: Tensor) -> tuple[Tensor, Tensor]:
        """The states after steps (n, B), as :func:`sim.solver.state.moved`."""
        full = step.new_zeros(self.unknowns, step.shape[1])
        full[self.free] = step
        coordinates = 3 * self.vertices
        ahead = x + full[:coordinates].unflatten(0, (self.vertices, 3)).transpose(0, 1)
        before, after = (_unit(y[:, self.ends[1]] - y[:, self.ends[0]]) for y in (x, ahead))
        scale = (n * after).sum(0) / (1 + (before * after).sum(0)).clamp(min=1e-12)
        n = n - scale * (before + after)
        turn = full[coordinates:]
        n = turn.cos() * n + turn.sin() * torch.linalg.cross(after, n, dim=0)
        return ahead, _unit(n - (n * after).sum(0) * after)

    def evaluate(self, x: Tensor, n: Tensor) -> Value:
        """Energy, gradient and angles."""
        own, shape = self.own, _Shape(self, x, n)
        density, stress, _ = laws.plate(shape.curvatures, self.law)
        value, slope, _ = laws.barrier(shape.angles, own["pole"])
        scale = own["softest"] * own["slenderness"]
        energy = (own["bending_areas"] * density + (scale * value).sum(0)).sum(0)
        moment = scale * slope + own["bending_areas"] * (own["maps"] * stress[:, None]).sum(0)
        pulls = (moment[:, None] * shape.levers).sum(0) * shape.unit[:, None]  # (3, 3, T, B)
        density, stress, _ = laws.membrane(shape.strains, *own["membrane"])
        areas, rows = own["areas"], shape.strain_rows(own)
        energy = energy + (areas * density).sum(0)
        pulls = pulls + areas * (rows * stress[:, None, None]).sum(0)
        forces = x.new_zeros(self.unknowns, self.count)
        forces.index_add_(0, self.targets[:9].ravel(), pulls.flatten(0, 2))
        forces.index_add_(0, self.targets[9:].ravel(), (moment * own["sign"]).flatten(0, 1))
        on_vertices = forces[: 3 * self.vertices].unflatten(0, (self.vertices, 3))
        on_vertices[:, 2] += own["weights"]
        energy = energy + (own["weights"] * x[2]).sum(0)
        for index, (ends, _) in enumerate(self.contacts):
            depth, normal, _ = self._contact(x, ends, index)
            scale = own[f"contact{index}"]
            energy = energy + (scale * depth**3).sum(0) / 3
            push = -scale * depth**2 / len(ends) * normal
            for end in ends:
                on_vertices.index_add_(0, end, push.transpose(0, 1))
        if "aim" in own:
            off, below = x - own["aim"], (own["height"] - x[2]).clamp(min=0)
            energy = energy + 0.5 * (own["inertia"] * off**2).sum((0, 1))
            energy = energy + (own["ring"] * below**3).sum(0) / 3
            on_vertices += (own["inertia"] * off).transpose(0, 1)
            on_vertices[:, 2] -= own["ring"] * below**2
        return Value(energy, forces[self.free], shape.angles)

    def hessian(self, x: Tensor, n: Tensor, convexity: Tensor, shift: Tensor) -> Tensor:
        """CSR data (nnz, B) of the Hessians with each drape's ``convexity`` and ``shift`` (B,), as
        :meth:`sim.solver.potential.QuadraticModel.hessian` blends them."""
        own, shape, law = self.own, _Shape(self, x, n), self.law
        in_plane, other = (2 * convexity).clamp(0, 1), (2 * convexity - 1).clamp(0, 1)
        data = x.new_zeros(len(self.pattern.indices) + 1, self.count)  # last: absent entries
        row, column = (pair[self._pairs[1] < 9] for pair in self._pairs)
        # In-plane
        _, stress, tangent = laws.membrane(shape.strains, *own["membrane"])
        laws.raise_eigenvalues(tangent, torch.zeros_like(in_plane), in_plane)
        stress = own["areas"] * (stress + in_plane * (laws.tension(stress) - stress))
        rows = shape.strain_rows(own).transpose(1, 2).flatten(1, 2)  # (3, 9, T, B)
        turned = own["areas"] * (tangent[:, :, None] * rows).sum(1)
        entries = sum(rows[m, row] * turned[m, column] for m in range(3))
        gu, gv = own["gradients"].unbind(1)
        spread = (stress[0] * gu + stress[2] * gv, stress[2] * gu + stress[1] * gv)
        same = row % 3 == column % 3
        a, b = row[same] // 3, column[same] // 3
        entries[same] += spread[0][a] * gu[b] + spread[1][a] * gv[b]
        # Bending
        _, stress, tangent = laws.plate(shape.curvatures, law)
        floor = CONVEX_FLOOR * torch.minimum(torch.minimum(law.A11, law.A22), 4 * law.A66)
        laws.raise_eigenvalues(tangent, floor, other)
        _, slope, fold = laws.barrier(shape.angles, own["pole"])
        scale, maps, areas = own["softest"] * own["slenderness"], own["maps"], own["bending_areas"]
        moment = scale * slope + areas * (maps * stress[:, None]).sum(0)
        stiff = (tangent[:, :, None] * maps[None]).sum(1)  # (3, 3, T, B) by curvature and angle
        stiff = areas * (maps[:, :, None] * stiff[:, None]).sum(0)
        for i in range(3):
            stiff[i, i] += scale[i] * fold[i]
        turned = (stiff[:, :, None] * shape.levers[None]).sum(1)  # by angle and corner
        spread = (shape.levers[:, :, None] * turned[:, None]).sum(0)
        vectors = shape.bends((1 - other) * moment) + 0.5 * spread[:, :, None] * shape.unit
        a, k, b, m = row // 3, row % 3, column // 3, column % 3
        entries += shape.unit[k] * vectors[a, b, m] + vectors[b, a, k] * shape.unit[m]
        sign = own["sign"]
        mixed = (sign * turned.transpose(0, 1))[:, None] * shape.unit[:, None]  # corner, k, angle
        stiff = (stiff * sign[:, None] * sign)[tuple(torch.triu_indices(3, 3))]
        for slots, values in zip(self.slots, (entries, mixed.flatten(0, 2), stiff), strict=True):
            data.index_add_(0, slots.ravel(), values.reshape(-1, self.count))
        # Obstacles
        for index, (ends, slots) in enumerate(self.contacts):
            self._add_contact(data, x, ends, slots, index, 1 - other)
        diagonal = x.new_zeros(self.unknowns, self.count)
        if "aim" in own:
            on_vertices = diagonal[: 3 * self.vertices].unflatten(0, (self.vertices, 3))
            on_vertices += own["inertia"][:, None]
            on_vertices[:, 2] += 2 * own["ring"] * (own["height"] - x[2]).clamp(min=0)
        data[self.diagonal] += diagonal[self.free] + shift * self.regularisation
        return data[:-1]

    @property
    def regularisation(self) -> Tensor:
        """(n, 1) or (n, B), see :class:`sim.solver.potential.Potential`."""
        return self.own["force_scale"] / self.own["length_scale"]

    def _contact(self, x: Tensor, ends: Tensor, index: int) -> tuple[Tensor, Tensor, tuple]:
        """Depths (N, B) of the points, normals (3, N, B) and what their derivatives need."""
        point, radius = x[:, ends].mean(1), self.own["radius"]
        rim = RIM * radius
        distance = torch.hypot(point[0], point[1])
        distance = torch.where(distance > 0, distance, 1.0)
        out, up = torch.hypot(point[0], point[1]) - (radius - rim), point[2] + rim
        rounded, side = (out > 0) & (up > 0), (out > up).to(x)
        over = torch.where(rounded, torch.hypot(out, up), 1.0)
        across, along = torch.where(rounded, out / over, side), torch.where(
            rounded, up / over, 1 - side)
        depth = (rim - torch.where(rounded, over, torch.maximum(out, up))).clamp(min=0)
        radial = point[:2] / distance
        normal = torch.cat([across * radial, along[None]])
        return depth, normal, (radial, across, along, across / distance, rounded / over)

    def _add_contact(
        self, data: Tensor, x: Tensor, ends: Tensor, slots: Tensor, index: int, exact: Tensor
    ) -> None:
        depth, normal, more = self._contact(x, ends, index)
        touching = torch.nonzero((depth > 0).any(1))[:, 0]
        if not len(touching):
            return
        depth, normal = depth[touching], normal[:, touching]
        radial, across, along, ring, rim = (part[..., touching, :] for part in more)
        scale = self.own[f"contact{index}"][touching] * depth / len(ends) ** 2
        around = torch.stack([-radial[1], radial[0], torch.zeros_like(across)])
        over = torch.cat([-along * radial, across[None]])
        block = scale * (2 * normal[:, None] * normal - exact * depth * (
            ring * around[:, None] * around + rim * over[:, None] * over))
        row, column = np.triu_indices(3 * len(ends))
        data.index_add_(0, slots[:, touching].ravel(), block[row % 3, column % 3].flatten(0, 1))


class _Shape:
    """What energies need of the triangles: sides and arms, area vectors, angles, strains."""

    def __init__(self, potential: BatchedPotential, x: Tensor, n: Tensor) -> None:
        own, corners = potential.own, x[:, potential.faces]  # (3, 3, T, B): coordinate, corner
        self.side = corners.roll(-2, 1) - corners.roll(-1, 1)
        self.arm = corners - corners.roll(-1, 1)
        across = torch.linalg.cross(self.side[:, 0], self.arm[:, 0], dim=0)
        self.double = across.square().sum(0).sqrt()
        self.unit = across / self.double
        self.square = self.side.square().sum(0)
        normals = n[:, potential.sides]
        outwards = torch.linalg.cross(self.side, across[:, None].expand_as(self.side), dim=0)
        self.angles = torch.atan2((normals * outwards).sum(0), self.square.sqrt() * (
            normals * across[:, None]).sum(0))
        self.curvatures = (own["maps"] * self.angles).sum(1)
        self.foot = (self.arm * self.side).sum(0) / self.square
        slope = -self.square.sqrt() / self.double
        self.levers = torch.empty(3, 3, *slope.shape[1:], dtype=x.dtype, device=x.device)
        for i, (start, end) in enumerate(((1, 2), (2, 0), (0, 1))):
            self.levers[i, i], self.levers[i, end] = slope[i], -self.foot[i] * slope[i]
            self.levers[i, start] = (self.foot[i] - 1) * slope[i]
        self.deformation = (corners[:, :, None] * own["gradients"]).sum(1)  # (3, 2, T, B)
        u, v = self.deformation.unbind(1)
        self.strains = torch.stack([0.5 * (u.square().sum(0) - 1), 0.5 * (v.square().sum(0) - 1),
                                    (u * v).sum(0)])

    def strain_rows(self, own: dict[str, Tensor]) -> Tensor:
        """Derivatives (3, 3, 3, T, B) of the strains by coordinate and corner."""
        u, v = (part[:, None] for part in self.deformation.unbind(1))
        gu, gv = own["gradients"].unbind(1)
        return torch.stack([u * gu, v * gv, u * gv + v * gu])

    def bends(self, moment: Tensor) -> Tensor:
        """(3, 3, 3, T, B) by two corners and coordinate: the vectors of the moments' second
        derivatives, see :func:`sim.energies.dihedral.add_side_bends`."""
        t, r = self.foot, 1 - self.foot
        up = self.arm - t * self.side
        height = up.square().sum(0).sqrt()
        high = moment * up / height**3
        long = moment * self.side / (height * self.square)
        mixed = 0.5 * moment * up / (height * self.square)
        near, far = r * high + long, t * high - long
        vectors = ((r * near + mixed, t * near - mixed, -near),  # start, end, corner
                   (r * far - mixed, t * far + mixed, -far), (-r * high, -t * high, high))
        result = torch.zeros(3, *high.shape, dtype=high.dtype, device=high.device)
        for i, order in enumerate(((1, 2, 0), (2, 0, 1), (0, 1, 2))):
            for p, one in enumerate(order):
                for q, other in enumerate(order):
                    result[one, other] += vectors[p][q][:, i]
        return result


def _unit(vectors: Tensor) -> Tensor:
    return vectors / vectors.square().sum(0).sqrt()


def _geometry(cloth: Cloth) -> dict[str, np.ndarray]:
    """Arrays of a cloth's mesh and rig, by name; see :class:`BatchedPotential`."""
    bending, potential = cloth.bending, cloth.potential
    pole = np.where(np.isinf(bending.pole), 1e3, bending.pole)  # no angle reaches it
    return {
        "areas": cloth.membrane.areas, "bending_areas": bending.areas, "pole": pole.T,
        "maps": bending.maps.transpose(1, 2, 0), "slenderness": bending._slenderness.T,
        "sign": bending._sign.T, "gradients": cloth.membrane._shape.transpose(1, 2, 0),
        "weights": cloth.weight.weights, "radius": np.array(cloth.scene.obstacles[0].radius),
        "force_scale": potential._force_scale, "length_scale": potential._length_scale,
    } | {f"contact{index}": contact._scale for index, contact in enumerate(cloth.obstacles)}


def state(mesh: Mesh, active: np.ndarray, x: Tensor) -> Tensor:
    """Normals (3, E, B) that bisect the angles at positions x, as
    :meth:`sim.solver.state.State.at`."""
    faces = torch.from_numpy(mesh.faces.T).to(x.device)
    beside = mesh.edge_faces
    counts = beside >= 0
    held = counts & ~active[beside]
    counts &= held | ~held.any(axis=1, keepdims=True)
    counts, beside = (torch.from_numpy(part.T.copy()).to(x.device) for part in (counts, beside))
    a, b, c = (x[:, corner] for corner in faces)
    unit = _unit(torch.linalg.cross(b - a, c - a, dim=0))
    total = (unit[:, beside] * counts[:, :, None]).sum(1)
    flat = total.square().sum(0) > 1e-18
    return _unit(torch.where(flat, total, unit[:, beside[0]]))
