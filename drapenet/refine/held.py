"""Simulations of a cloth that stays held, weakly, to the captured surface.

On a mesh a drape has many equilibria close to each other, a millimetre or two apart: its folds
stick where the mesh lets them. A free simulation ends in one of them, the captured cloth in none,
and the difference would be charged to the moduli. Weak springs towards the captured points leave
one equilibrium. The right fabric hardly needs them; a wrong one pulls at them, which shows in the
same residuals, only smaller.
"""

from collections.abc import Sequence

import numpy as np

from drapenet.refine.attraction import Springs, nearest_springs, spring_stiffness
from sim.drape import DrapeResult
from sim.energies.self_contact import SelfContact
from sim.laws import Laws
from sim.material import Fabric
from sim.newton import NewtonOptions
from sim.scene import State
from sim.sensitivity import Sensitivities, follow, sensitivities
from sim.sensitivity.tangent import possible_contact, scene_of

PULL = 0.3
"""Force of the springs at a distance of 1 mm, over the cloth's weight."""
REACH = 6e-3  # m


class HeldCloth:
    """The simulator of :class:`.problem.DrapeProblem` with springs that stay.

    Args:
        springs: their vertices are those of the mesh that will be simulated.
        contact: of the cloth with itself, if it is known to touch itself.
    """

    def __init__(self, springs: Springs, contact: SelfContact | None = None) -> None:
        self._extra = [springs] if contact is None else [springs, contact]

    @classmethod
    def to_surface(
        cls, shape: DrapeResult, points: np.ndarray, normals: np.ndarray, *, pull: float = PULL
    ) -> "HeldCloth":
        """Held across a captured surface, free along it.

        Args:
            shape: the captured shape, as :func:`.attraction.captured_shape` gives it.
            points, normals: (N, 3) m and (N, 3) of the surface, specimen's axes.
            pull: see :data:`PULL`.
        """
        return cls(nearest_springs(scene_of(shape), shape.positions, points, normals, pull=pull,
                                   reach=REACH))

    @classmethod
    def to_vertices(cls, shape: DrapeResult, *, pull: float = PULL) -> "HeldCloth":
        """Held to the vertices of a registered ``shape``.

        Where that touches itself, so does the held cloth: springs would keep cloth apart that the
        contact has to, and the moduli would pay for it.
        """
        scene = scene_of(shape)
        free = np.repeat(np.flatnonzero(~scene.held), 3)
        axes = np.tile(np.eye(3), (len(free) // 3, 1))
        springs = Springs(free, shape.positions[free], axes,
                          spring_stiffness(scene, free, pull))
        contact = possible_contact(shape)
        touches = 0 < contact.value(State(shape.positions, shape.rotations).unknowns) < np.inf
        return cls(springs, contact if touches else None)

    def follow(
        self,
        result: DrapeResult,
        fabric: Fabric,
        *,
        laws: Laws | None = None,
        options: NewtonOptions | None = None,
        sensitivities: Sensitivities | None = None,
    ) -> DrapeResult:
        """As :func:`sim.sensitivity.follow`."""
        return follow(result, fabric, laws=laws, extra=self._extra, options=options,
                      sensitivities=sensitivities)

    def sensitivities(
        self,
        result: DrapeResult,
        *,
        laws: Laws | None = None,
        parameters: Sequence[str] = ("log_alpha", "ratio"),
    ) -> Sensitivities:
        """As :func:`sim.sensitivity.sensitivities`."""
        return sensitivities(result, laws=laws, extra=self._extra, parameters=parameters)
