"""The energy of a batch of cloths on one triangulation, its gradient and its Hessian, in PyTorch.

A state is positions x (3, V, B), m, and edge normals n (3, E, B) (:mod:`sim.solver.state`); steps
and gradients are (n, B), in the order of the free unknowns of a cloth. Components come first, then
the T elements, then the B drapes. Arrays of the geometry end with 1 where the drapes share it.
"""

import copy
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from sim.batched import laws
from sim.batched.laws import contracted
from sim.batched.solver import BatchedSolver
from sim.cloth import STEP_UNIT, Cloth
from sim.energies.bending_variants import HystereticBending
from sim.energies.external import DEPTH
from sim.energies.membrane import LinearMembrane
from sim.energies.midedge import (
    CLAMP,
    CONVEX_FLOOR,
    MidEdgeBending,
    rows_at_clamp,
    weight_behind,
)
from sim.rig import GRAVITY
from sim.scene import Scene

_BETWEEN = [0, 3, 6, 1, 4, 7, 2, 5, 8, 9, 10, 11]
_PLACES = np.array([[2, 0, 1], [1, 2, 0], [0, 1, 2]])
"""Of the corners of a triangle on its sides: at the start, 0, the end, 1, or opposite, 2."""


@dataclass
class Value:
    """States x and n, their energy (B,), J, its gradient (n, B) and the angles of the triangles
    (3, T, B), rad."""

    x: Tensor
    n: Tensor
    energy: Tensor
    gradient: Tensor
    angles: Tensor

    def __getitem__(self, drapes: tuple) -> "Value":
        """Those of some of the drapes, as of a tensor: ``value[..., index]``."""
        return Value(*(value[drapes] for value in vars(self).values()))

    def replaced(self, drapes: Tensor, new: "Value") -> "Value":
        """A copy with other values of some of the drapes."""
        return Value(*(old.index_copy(-1, drapes, value) for old, value in
                       zip(vars(self).values(), vars(new).values(), strict=True)))


class BatchedPotential:
    """The energies of ``cloths`` with the default laws, on meshes of the same faces.

    Attributes:
        tensors: (..., B) or (..., 1) of the drapes by name, constant. :meth:`having` adds those of
            a motion: the aim (3, V, B) and stiffness (V, B) of its inertia, the ring's (V, 1) and
            height (B,).
        solver: of the Hessians, shared.
    """

    def __init__(self, cloths: list[Cloth], device: str | torch.device = "cpu") -> None:
        bendings = [cloth.bending for cloth in cloths if isinstance(cloth.bending, MidEdgeBending)]
        membranes = [cloth.laws.membrane for cloth in cloths
                     if isinstance(cloth.laws.membrane, LinearMembrane)]
        first, bending, self.count = cloths[0], bendings[0], len(cloths)
        mesh, active, potential = first.scene.mesh, first.scene.active, first.potential
        self.vertices, self.unknowns = len(mesh.rest), potential.unknowns
        self.energy_scale, self._nonzeros = potential.energy_scale, len(potential.pattern.indices)

        def place(array: np.ndarray) -> Tensor:
            return torch.from_numpy(np.ascontiguousarray(array)).to(device)

        self.faces, self.sides = place(mesh.faces[active].T), place(mesh.face_edges[active].T)
        self.places = place(_PLACES)
        self.ends, self.free = place(mesh.edges.T), place(potential.free)
        beside = mesh.edge_faces
        counts = beside >= 0
        held = counts & ~active[beside]
        counts &= held | ~held.any(axis=1, keepdims=True)
        self._around = place(mesh.faces.T), place(beside.T), place(counts.T[:, :, None])
        count = self.faces.shape[1]
        slots, pairs = potential.pattern.slots[1], bending.pairs
        self._diagonal, self._pairs = place(potential.pattern.diagonal), place(pairs.T)
        forces = bending.dofs[:count, :12].T.ravel()
        self._forces = Sums(forces, np.arange(forces.size), self.unknowns, device)
        at = np.arange(12)
        inside = np.where(at[:, None] > at, -1, slots[:count, _place(at[:, None], at)])
        inside = inside.transpose(1, 2, 0)  # -1 also below the diagonal
        parts = [inside[:9, :9], inside[:9, 9:], inside[9:, 9:]]
        # The blocks between the unknowns of pairs: rows of the first triangle's coordinates x, y
        # and z at its corners, then of its edges' rotations
        row, column = bending.places[:, 0, :, None], bending.places[:, 1, None]
        between = np.take_along_axis(slots[count:, :, None], _place(
            np.minimum(row, column), np.maximum(row, column)).reshape(len(pairs), 144, 1), 1)
        between, equal = (block.reshape(-1, 12, 12).transpose(1, 2, 0)[_BETWEEN]
                          for block in (between, row == column))
        entries = np.concatenate([part.ravel() for part in (*parts, between)])
        # An unknown of both triangles counts twice on the diagonal.
        twice = np.flatnonzero(equal) + entries.size - equal.size
        rows, targets = [np.arange(entries.size), twice], [entries, entries[twice]]
        # The ends of points in contact, equal for a vertex, share the blocks (3, 3) of the points.
        vertices, middles = (contact.dofs[:, ::3].T // 3 for contact in first.obstacles)
        self._points = place(np.hstack([vertices.repeat(2, 0), middles]))
        points, of_vertices = np.arange(self._points.shape[1]), vertices.shape[1]
        self._of_ends = place(np.where(points < of_vertices, 1.0, 0.25)[:, None])
        for place_of, at, size in zip(potential.pattern.slots[-2:], np.split(points, [of_vertices]),
                                      (3, 6), strict=True):
            row, column = (index[:, None] % 3 for index in np.triu_indices(size))
            rows.append((len(rows[0]) + (3 * row + column) * len(points) + at).ravel())
            targets.append(place_of.T.ravel())
        self._entries = Sums(np.concatenate(targets), np.concatenate(rows), self._nonzeros, device)
        sides = (pairs.T.ravel() + count * np.arange(3)[:, None]).ravel()
        self._of_pairs = Sums(sides, np.arange(sides.size), 3 * count, device)
        constants = [laws.plate_rows(bent.law) | {"membrane": membrane.matrix}
                     for bent, membrane in zip(bendings, membranes, strict=True)]
        if isinstance(bending, HystereticBending):
            constants = [row | laws.variant_rows(bent.variant) | {
                name: np.broadcast_to(getattr(bent, name), (count, 3)).T
                for name in ("natural", "moments")} for row, bent in zip(
                    constants, bendings, strict=True)]
        self.tensors = {name: place(np.stack([row[name] for row in constants], -1))
                        for name in constants[0]}
        scenes = [cloth.scene for cloth in cloths]
        shared = all(scene.mesh is mesh for scene in scenes)
        self.tensors |= self._geometry(first, bending, scenes[:1] if shared else scenes)
        if isinstance(bending, HystereticBending):
            self.tensors["origin"] = torch.zeros(3, count, self.count).to(self.tensors["areas"])
            layers = np.stack([np.broadcast_to(bent.layers, count) for bent in bendings], -1)
            self.tensors["bending_areas"] = self.tensors["bending_areas"] * place(layers)
        places = np.concatenate([np.repeat(mesh.rest, 3, axis=0), mesh.rest[mesh.edges].mean(1)])
        row_of = np.full(self.unknowns + 1, -1)
        row_of[potential.free] = np.arange(potential.size)
        self.solver = BatchedSolver(potential.pattern, [row_of[bending.dofs]],
                                    places[potential.free], device)

    def _geometry(
        self, cloth: Cloth, bending: MidEdgeBending, scenes: list[Scene]
    ) -> dict[str, Tensor]:
        """Arrays (..., G) of the meshes and rigs of G scenes by name, as those of the energies of
        a ``cloth`` among them, with its ``bending``."""
        scene, device = cloth.scene, self.faces.device
        mesh, active = scene.mesh, torch.from_numpy(np.flatnonzero(scene.active)).to(device)
        rest = torch.from_numpy(np.stack([of.mesh.rest.T for of in scenes], -1)).to(device)
        corners = rest[:, self._around[0]]  # (2, 3, F, G)
        side = corners.roll(1, 1) - corners.roll(-1, 1)
        double = side[0, 0] * side[1, 1] - side[1, 0] * side[0, 1]
        square = side.square().sum(0)
        areas, across = double / 2, torch.stack([side[1], -side[0]])
        on_vertices = areas.new_zeros(self.vertices, len(scenes)).index_add_(
            0, self._around[0].ravel(), (areas / 3).repeat(3, 1))
        sides = torch.from_numpy(mesh.face_edges.T.copy()).to(device)
        on_edges = areas.new_zeros(len(mesh.edges), len(scenes)).index_add_(
            0, sides.ravel(), areas.repeat(3, 1))
        lengths = (rest[:, self.ends[1]] - rest[:, self.ends[0]]).square().sum(0).sqrt().mean(0)
        weight = cloth.fabric.density * scene.gravity
        units = torch.ones(self.unknowns, 1).to(areas)[self.free] * lengths
        units[self.free < 3 * self.vertices] = 1.0
        radius, rim = (areas.new_tensor([getattr(of.obstacles[0], name) for of in scenes])
                       for name in ("radius", "rim"))
        pressure = scene.contact_pressure * weight / 4 / (DEPTH * radius) ** 2
        free = torch.from_numpy(~scene.held).to(device)
        nx, ny = across / (square * areas).sqrt()
        areas, square, double = areas[active], square[:, active], double[active]
        first, second = (torch.from_numpy(rows).to(device) for rows in rows_at_clamp(
            mesh, scene.active, bending.pole == np.pi))
        # As sim.energies.midedge.clamp_weights; there are triangles of both kinds around a plate.
        bent = torch.where(first[:, None], CLAMP, torch.ones_like(areas))
        bent[second] = weight_behind(areas[first].sum(0), areas[second].sum(0))
        maps = torch.stack([nx * nx, ny * ny, nx * ny])[:, :, active] * square.sqrt() * bent
        bent = areas / bent
        jumps = bent[self._pairs].sum(0) / 12
        around = torch.zeros_like(bent).index_add_(0, self._pairs.ravel(), jumps.repeat(2, 1))
        return {
            "areas": areas, "bending_areas": bent, "slenderness": square / double, "maps": maps,
            "jumps": jumps, "around": around,
            "gradients": (-across[:, :, active] / double).transpose(0, 1), "radius": radius,
            "rim": rim,
            "weights": weight * on_vertices, "contact": pressure * torch.cat(
                [on_vertices[free], on_edges[free[self.ends].any(0)]]),
            "force_scale": cloth.fabric.density * GRAVITY * on_vertices.mean(0) * units,
            "length_scale": STEP_UNIT / units,
            "pole": torch.from_numpy(np.minimum(bending.pole, 1e3).T[..., None]).to(device),
            "sign": torch.from_numpy(bending.signs.T[..., None]).to(device)}

    def take(self, drapes: Tensor) -> "BatchedPotential":
        """The potential of some of the drapes, by index."""
        part = copy.copy(self)
        part.count = len(drapes)
        part.tensors = {name: value[..., drapes] if value.shape[-1] > 1 else value
                    for name, value in self.tensors.items()}
        return part

    def having(self, **tensors: Tensor) -> "BatchedPotential":
        """The potential with other, or further, tensors of :attr:`tensors`."""
        other = copy.copy(self)
        other.tensors = self.tensors | tensors
        return other

    def normals(self, x: Tensor) -> Tensor:
        """Normals (3, E, B) that bisect the angles, as :meth:`sim.solver.state.State.at`."""
        faces, beside, counts = self._around
        a, b, c = x[:, faces].unbind(1)
        unit = _unit(torch.linalg.cross(b - a, c - a, dim=0))
        total = (unit[:, beside] * counts).sum(1)
        return _unit(torch.where(total.square().sum(0) > 1e-18, total, unit[:, beside[0]]))

    def moved(self, x: Tensor, n: Tensor, step: Tensor) -> tuple[Tensor, Tensor]:
        """The states after steps (n, B), as :func:`sim.solver.state.moved`."""
        full = step.new_zeros(self.unknowns, step.shape[1]).index_copy(0, self.free, step)
        ahead = x + self._on_vertices(full).transpose(0, 1)
        before, after = (_unit(y[:, self.ends[1]] - y[:, self.ends[0]]) for y in (x, ahead))
        scale = (n * after).sum(0) / (1 + (before * after).sum(0)).clamp(min=1e-12)
        n, turn = n - scale * (before + after), full[3 * self.vertices :]
        n = turn.cos() * n + turn.sin() * torch.linalg.cross(after, n, dim=0)
        return ahead, _unit(n - (n * after).sum(0) * after)

    def slid(self, x: Tensor, n: Tensor) -> "BatchedPotential":
        """The potential whose origins of hysteresis, if there is any, have followed the cloth to a
        state."""
        if "origin" not in self.tensors:
            return self
        return self.having(origin=laws.slid_origin(_Shape(self, x, n).curvatures, self.tensors))

    def _jumps(self, curvatures: Tensor) -> tuple[Tensor, Tensor]:
        """Derivatives (3, T, B), N·m², of the energy of jumps by the curvatures, and these less the
        natural ones."""
        curvatures = curvatures - self.tensors.get("natural", 0.0)
        first, second = curvatures[:, self._pairs].unbind(1)
        jump = self.tensors["jumps"] * (first - second)
        moments = self._of_pairs(torch.cat([jump, -jump], 1)).view_as(curvatures)
        return contracted(self.tensors["form"][:, :, None], moments[:, None])[:, 0], curvatures

    def evaluate(self, x: Tensor, n: Tensor) -> Value:
        """Energy, gradient and angles at states."""
        tensors, shape = self.tensors, _Shape(self, x, n)
        density, stress, _ = laws.plate(shape.curvatures, tensors)
        value, slope, _ = laws.barrier(shape.angles, tensors["pole"])
        scale, bent = tensors["softest"] * tensors["slenderness"], tensors["bending_areas"]
        jumps, unlike = self._jumps(shape.curvatures)
        energy = (scale * value + 0.5 * jumps * unlike).sum((0, 1))
        energy = energy + (bent * density).sum(0)
        moment = scale * slope + contracted(tensors["maps"], (bent * stress + jumps)[:, None])[:, 0]
        density, stress, _ = laws.membrane(shape.strains, tensors["membrane"])
        energy = energy + (tensors["areas"] * density).sum(0) + (tensors["weights"] * x[2]).sum(0)
        # By corner and coordinate
        pulls = (moment[:, None] * shape.levers).sum(0)[:, None] * shape.unit
        pulls += tensors["areas"] * (shape.strain_rows(tensors) * stress[:, None, None]).sum(0)
        forces = self._forces(torch.cat([pulls.flatten(0, 1), moment * tensors["sign"]]))
        on_vertices = self._on_vertices(forces)
        on_vertices[:, 2] += tensors["weights"]
        depth, normal, _ = self._contact(x[:, self._points].mean(1))
        energy = energy + (tensors["contact"] * depth**3).sum(0) / 3
        push = (-0.5 * tensors["contact"] * depth**2 * normal).transpose(0, 1)
        for end in self._points:
            on_vertices.index_add_(0, end, push)
        if "aim" in tensors:
            off, below = x - tensors["aim"], (tensors["height"] - x[2]).clamp(min=0)
            energy = energy + 0.5 * (tensors["inertia"] * off**2).sum((0, 1))
            energy = energy + (tensors["ring"] * below**3).sum(0) / 3
            on_vertices += (tensors["inertia"] * off).transpose(0, 1)
            on_vertices[:, 2] -= tensors["ring"] * below**2
        return Value(x, n, energy, forces[self.free], shape.angles)

    def hessian(self, x: Tensor, n: Tensor, convexity: Tensor, shift: Tensor) -> Tensor:
        """CSR data (nnz, B) of the Hessians with each drape's ``convexity`` and ``shift`` (B,), as
        :meth:`sim.solver.potential.QuadraticModel.hessian` blends them."""
        tensors, shape = self.tensors, _Shape(self, x, n)
        in_plane, other = (2 * convexity).clamp(0, 1), (2 * convexity - 1).clamp(0, 1)
        _, moment, bent = laws.plate(shape.curvatures, tensors, tangent=True)
        _, stress, strained = laws.membrane(shape.strains, tensors["membrane"], tangent=True)
        floor = CONVEX_FLOOR * tensors["form"].diagonal(dim1=0, dim2=1).amin(-1)
        tangents = torch.stack([strained, bent], 2)  # (3, 3, 2, T, B)
        laws.raise_eigenvalues(tangents, torch.stack([torch.zeros_like(floor), floor])[:, None],
                               torch.stack([in_plane, other])[:, None])
        strained, bent = tangents.unbind(2)
        form = tensors["form"][:, :, None]
        bent = tensors["bending_areas"] * bent + tensors["around"] * form
        # In-plane: the strain's derivatives, and the stress times its second derivatives
        rows = shape.strain_rows(tensors).flatten(1, 2)  # (3, 9, T, B)
        entries = contracted(rows, tensors["areas"] * contracted(strained, rows))
        entries = entries.unflatten(1, (3, 3)).unflatten(0, (3, 3))  # corner, coordinate, again
        stress = tensors["areas"] * (stress + in_plane * (laws.tension(stress) - stress))
        stress = torch.stack([stress[0], stress[2], stress[2], stress[1]]).unflatten(0, (2, 2))
        gradients = tensors["gradients"].transpose(0, 1)
        entries.diagonal(dim1=1, dim2=3).add_(
            contracted(contracted(stress, gradients), gradients)[..., None])
        # Bending: levers times stiffness, and moments times second derivatives of angles
        _, slope, fold = laws.barrier(shape.angles, tensors["pole"])
        scale, maps = tensors["softest"] * tensors["slenderness"], tensors["maps"]
        moment = tensors["bending_areas"] * moment + self._jumps(shape.curvatures)[0]
        moment = scale * slope + contracted(maps, moment[:, None])[:, 0]
        stiff = contracted(contracted(bent, maps), maps)
        stiff.diagonal(dim1=0, dim2=1).add_((scale * fold).movedim(0, -1))
        turned = contracted(stiff, shape.levers)  # by angle and corner
        spread = 0.5 * contracted(shape.levers, turned)
        vectors = shape.bends((1 - other) * moment) + spread[:, :, None] * shape.unit
        entries.addcmul_(shape.unit[:, None, None], vectors[:, None])
        entries.addcmul_(vectors.permute(1, 2, 0, 3, 4)[:, :, :, None], shape.unit)
        sign = tensors["sign"]
        mixed = (sign * turned.transpose(0, 1))[:, None] * shape.unit[:, None]  # corner, k, angle
        stiff = stiff * sign[:, None] * sign
        depth, normal, bend = self._contact(x[:, self._points].mean(1), bend=True)
        block = 2 * normal[:, None] * normal + (1 - other) * depth * bend
        block *= self._of_ends * tensors["contact"] * depth
        data = self._entries(torch.cat([values.reshape(-1, self.count) for values in (
            entries, mixed, stiff, *self._between(shape, form), block)]))
        diagonal = x.new_zeros(self.unknowns, self.count)
        if "aim" in tensors:
            on_vertices = self._on_vertices(diagonal)
            on_vertices += tensors["inertia"][:, None]
            on_vertices[:, 2] += 2 * tensors["ring"] * (tensors["height"] - x[2]).clamp(min=0)
        shift = shift * tensors["force_scale"] / tensors["length_scale"]
        return data.index_add_(0, self._diagonal, diagonal[self.free] + shift)

    def _between(self, shape: "_Shape", form: Tensor) -> list[Tensor]:
        """Blocks between the unknowns of the two triangles of pairs, by the rows of the first."""
        maps, (first, second) = self.tensors["maps"], self._pairs
        turns = torch.cat([contracted(maps.transpose(0, 1), shape.levers), (
            maps * self.tensors["sign"]).expand_as(shape.levers)], 1)  # (3, 6, T, B)
        block = contracted(-self.tensors["jumps"] * contracted(form, turns)[:, :, first],
                           turns[:, :, second])
        block = torch.cat([(block[:, :3, None] * shape.unit[:, second]).flatten(1, 2),
                           block[:, 3:]], 1)  # (6, 12, M, B)
        return [*(block[:3] * unit for unit in shape.unit[:, first]), block[3:]]

    def _on_vertices(self, values: Tensor) -> Tensor:
        """A view (V, 3, B) of the coordinates' part of values (U, B) of all unknowns."""
        return values[: 3 * self.vertices].unflatten(0, (self.vertices, 3))

    def _contact(self, point: Tensor, *, bend: bool = False) -> tuple[Tensor, Tensor, Tensor]:
        """Depths (N, B) of points (3, N, B) in the plate's cylinder, normals (3, N, B) and second
        derivatives (3, 3, N, B) of the depths, empty if they are not wanted; see
        :class:`sim.rig.Cylinder`."""
        radius, distance = self.tensors["radius"], torch.hypot(point[0], point[1])
        rim = self.tensors["rim"]
        out, up = distance - (radius - rim), point[2] + rim
        rounded, side = (out > 0) & (up > 0), (out > up).to(point)
        over = torch.where(rounded, torch.hypot(out, up), torch.maximum(out, up))
        curved = rounded / torch.where(rounded, over, 1.0)
        across = torch.where(rounded, out * curved, side)
        along = torch.where(rounded, up * curved, 1 - side)
        distance = torch.where(distance > 0, distance, 1.0)
        x, y = point[:2] / distance
        depth, normal = (rim - over).clamp(min=0), torch.stack([across * x, across * y, along])
        if not bend:
            return depth, normal, point.new_empty(0)
        around = torch.stack([-y, x, 0 * x])
        meridian = torch.stack([-along * x, -along * y, across])
        return depth, normal, -(across / distance * around[:, None] * around
                                + curved * meridian[:, None] * meridian)


class Sums:
    """Sums (``count``, B) of the ``rows`` (N,) of values (M, B), over those with the same of the
    ``targets`` (N,), -1: none. Threads that add to one place would be slower."""

    def __init__(
        self, targets: np.ndarray, rows: np.ndarray, count: int, device: str | torch.device
    ) -> None:
        order = np.argsort(targets, kind="stable")
        starts = np.searchsorted(targets[order], np.arange(count + 1))
        self._rows, self._starts = (torch.from_numpy(index.astype(np.int64)).to(device)
                                     for index in (rows[order[starts[0] :]], starts - starts[0]))

    def __call__(self, values: Tensor) -> Tensor:
        return torch.embedding_bag(values.reshape(-1, values.shape[-1]), self._rows, self._starts,
                                   include_last_offset=True)[0]


class _Shape:
    """What energies need of the triangles: sides and arms, area vectors, angles, strains."""

    def __init__(self, potential: BatchedPotential, x: Tensor, n: Tensor) -> None:
        tensors = potential.tensors
        corners = x[:, potential.faces]  # (3, 3, T, B): coordinate, corner
        after = corners.roll(-1, 1)
        self.side, self.arm = corners.roll(1, 1) - after, corners - after
        across = torch.linalg.cross(self.side[:, 0], self.arm[:, 0], dim=0)
        double = across.square().sum(0).sqrt()
        self.unit, self.square = across / double, self.side.square().sum(0)
        normals, length = n[:, potential.sides], self.square.sqrt()
        outwards = torch.linalg.cross(self.side, self.unit[:, None].expand_as(self.side), dim=0)
        self.angles = torch.atan2((normals * outwards).sum(0), length * (
            normals * self.unit[:, None]).sum(0))
        self.curvatures = (tensors["maps"] * self.angles).sum(1)
        self.foot = (self.arm * self.side).sum(0) / self.square
        slope = length / -double
        parts = (self.foot - 1) * slope, -self.foot * slope, slope  # at start, end and corner
        self._places, self._sides = potential.places, torch.arange(3, device=x.device)
        self.levers = torch.stack(parts)[self._places, self._sides[:, None]]
        self._deformation = (corners[:, :, None] * tensors["gradients"]).sum(1)  # (3, 2, T, B)
        u, v = self._deformation.unbind(1)
        self.strains = torch.stack([0.5 * (u.square().sum(0) - 1), 0.5 * (v.square().sum(0) - 1),
                                    (u * v).sum(0)])

    def strain_rows(self, tensors: dict[str, Tensor]) -> Tensor:
        """Derivatives (3, 3, 3, T, B) of the strains by corner and coordinate."""
        u, v = self._deformation.unbind(1)
        gu, gv = tensors["gradients"][:, :, None].unbind(1)
        return torch.stack([u * gu, v * gv, u * gv + v * gu])

    def bends(self, moment: Tensor) -> Tensor:
        """(3, 3, 3, T, B) by two corners and coordinate: the vectors of the moments' second
        derivatives, see :func:`sim.energies.dihedral.add_side_bends`."""
        t, r = self.foot, 1 - self.foot
        up = self.arm - t * self.side
        height = up.square().sum(0).sqrt()
        weight = moment / (height * self.square)
        high, long, mixed = moment / height**3 * up, weight * self.side, 0.5 * weight * up
        near, far = r * high + long, t * high - long
        vectors = torch.stack([  # by start, end and corner
            r * near + mixed, t * near - mixed, -near, r * far - mixed, t * far + mixed, -far,
            -r * high, -t * high, high]).unflatten(0, (3, 3))
        at = self._places.T
        return vectors[at[:, None], at, :, self._sides].sum(2)


def _place(row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Places in the upper triangle, row by row, of a block of 17 unknowns."""
    return row * (33 - row) // 2 + column


def _unit(vectors: Tensor) -> Tensor:
    return vectors / vectors.square().sum(0).sqrt()
