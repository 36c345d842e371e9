"""A captured drape whose vertices belong to points of the flat specimen."""

import math
from dataclasses import dataclass, replace

import numpy as np

from sim.drape import DrapeResult, scene_on
from sim.laws import Laws
from sim.material import Fabric
from sim.mesh import Mesh, edges_of
from sim.mesh.specimens import Specimen
from sim.newton import Status
from sim.scene import Rig
from sim.sensitivity.tangent import possible_contact

_ON_PLATE = 1.003  # of the plate's radius: vertices on its rim are held


@dataclass(frozen=True)
class CapturedShape:
    """A registered drape.

    Attributes:
        positions: (V, 3) m, on the rig's axes.
        rest: (V, 2) m, in any material axes.
        faces: (F, 3), counter-clockwise at rest.
        rig: with a plate.
        held_share: of the plate's radius, within which the plate holds the cloth; further out
            cloth lies on it, may lift and slide, and turns over the rim as it likes.
    """

    positions: np.ndarray
    rest: np.ndarray
    faces: np.ndarray
    rig: Rig
    held_share: float = 1.0

    @property
    def held(self) -> np.ndarray:
        """(V,) bool, vertices that the plate holds."""
        return self._within(self.held_share)

    @property
    def hanging(self) -> np.ndarray:
        """(V,) bool, vertices beyond the plate."""
        return ~self._within(1.0)

    @property
    def strain(self) -> float:
        """By how much the hanging edges differ from their rest lengths, root mean square."""
        edges = edges_of(self.faces)[0]
        edges = edges[self.hanging[edges].any(axis=1)]
        length, rest = (np.linalg.norm(p[edges[:, 0]] - p[edges[:, 1]], axis=1)
                        for p in (self.positions, self.rest))
        return float(np.sqrt(np.mean((length / rest - 1) ** 2)))

    def _within(self, share: float) -> np.ndarray:
        return np.linalg.norm(self.rest, axis=1) <= _ON_PLATE * share * self.rig.plate_radius

    def as_drape(self, fabric: Fabric) -> DrapeResult:
        """The shape as a drape of ``fabric`` that has not settled yet."""
        mesh = Mesh(self.rest, self.faces)
        ends = mesh.rest[mesh.edges]
        lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        state = scene_on(Specimen(mesh, self.held), self.rig).state(self.positions)
        drape = DrapeResult(
            fabric=fabric, rig=self.rig, mesh=mesh, held=self.held, state=state, laws=Laws(),
            extra=(), touches=False, edge=float(lengths.mean()), status=Status.MAX_ITERATIONS,
            message="captured", residual=math.inf, step=math.inf, positive_definite=False,
            self_intersections=0, iterations=0, seconds=0.0, time_spent={})
        contact = possible_contact(drape).value(state.q)
        return replace(drape, touches=0 < contact < math.inf)
