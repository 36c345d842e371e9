"""Influence of the membrane on a drape: locking, stiffness, scaling (paper's Figures 5 to 9).

Isotropic fabrics of each alpha:

- *locking*: drapes on coarse and fine meshes, with 200, 400 and 5000 N/m and with 5000 N/m beyond
  the guard (no stress for stretches of 99 % to 101 %);
- *in-plane insensitivity*: displacements for membranes of 100 to 1000 N/m, compared with those for
  half and twice the alpha, for two laws;
- *scaling*: the same moduli/density at 100, 300 and 900 g/m².

All start from one drape with 200 N/m, so that they have the same folds.
"""

from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from common.types import FaceMask
from data.render.shade import shade
from experiments.comparison import FinishedDrapes, Shape, equilibrium_near
from experiments.result import Config, Result, run_cases
from sim.cloth import Laws
from sim.drape import drape
from sim.energies.base import Energy
from sim.energies.membrane import (
    Corotational,
    Membrane,
    OfStretches,
    OrthotropicStVK,
    StrainMembrane,
)
from sim.material import MICRO, REFERENCE_DENSITY, Fabric
from sim.measures import drape_coefficient
from sim.mesh import Mesh
from sim.mesh.specimen import TOPOLOGIES
from sim.rig import Rig
from sim.scene import make_specimen

POISSON = 0.3
LAWS = ("corotational", "stvk")
STIFFNESSES = (100.0, 200.0, 500.0, 1000.0)  # N/m, the paper's range
BASE, DOUBLE, STIFF = 200.0, 400.0, 5000.0
LOCKING = {
    "200 N/m": ("corotational", BASE),
    "400 N/m": ("corotational", DOUBLE),
    "5000 N/m": ("corotational", STIFF),
    "5000 N/m, guarded": ("guarded corotational", STIFF),
}
DENSITIES = (0.1, 0.3, 0.9)


ROUNDING_WIDTH = 0.5  # of the smooth transition at each limit of the band, in half bands


@dataclass(frozen=True)
class Guarded:
    """A membrane that is nearly free of stress in a band of small strains, against locking.

    Feng et al. 2022 (section 4.1) let cloth deform freely between 99 % and 101 % by updating its
    reference state during the simulation. In their final state only the strain e = s - 1 beyond the
    band, the *excess*, stores energy; s are the principal stretches. Here this is an energy,

        r psi(e) + (1 - r) psi(excess(e)),

    so that an equilibrium is the minimum of one function, which does not depend on the path. The
    excess has continuous second derivatives. With r = 0, flat cloth without load could deform
    freely within the band and no equilibrium would be unique.
    """

    membrane: Corotational  # outside the band
    low: float = 0.99  # stretches that bound the band
    high: float = 1.01
    share: float = 0.02  # r

    def energy(self, mesh: Mesh, active: FaceMask) -> Energy:
        return StrainMembrane(mesh, active, OfStretches(self))

    def scaled(self, factor: float) -> "Guarded":
        return replace(self, membrane=self.membrane.scaled(factor))

    def response(self, strain: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        excess, slope, bend = self.excess(strain)
        inside, outside = self.membrane.response(strain), self.membrane.response(excess)
        tangent = slope[:, :, None] * outside[2] * slope[:, None, :]
        diagonal = np.arange(strain.shape[1])
        tangent[:, diagonal, diagonal] += bend * outside[1]
        outer = outside[0], slope * outside[1], tangent
        return tuple(self.share * a + (1 - self.share) * b
                     for a, b in zip(inside, outer, strict=True))

    def excess(self, strain: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Strain (N, 2) beyond the band and its first two derivatives, componentwise."""
        low, high = self.low - 1, self.high - 1
        above, below = _ramp(strain / high), _ramp(strain / low)
        return (high * above[0] + low * below[0], above[1] + below[1],
                above[2] / high + below[2] / low)


def _ramp(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """max(x - 1, 0), smoothed over a width around 1, and its first two derivatives."""
    width = ROUNDING_WIDTH
    u = np.clip((x - 1) / width + 0.5, 0.0, 1.0)
    value = width * u**3 * (1 - 0.5 * u) + np.maximum(x - 1 - 0.5 * width, 0.0)
    return value, u * u * (3 - 2 * u), 6 * u * (1 - u) / width


def membrane(name: str, stiffness: float) -> Membrane:
    """Membrane ``name`` with the product ``stiffness``, N/m, of Young's modulus and thickness."""
    if name == "corotational":
        return Corotational(stiffness, POISSON)
    if name == "guarded corotational":
        return Guarded(Corotational(stiffness, POISSON))
    return OrthotropicStVK(stiffness, stiffness, POISSON, stiffness / (2 * (1 + POISSON)))


def simulate(
    *, alpha: float, edge_mm: float, law: str, stiffness: float, density: float, seed: int,
    begin: str | None,
) -> dict:
    """Simulate a :class:`Case` from the drape in the npz file ``begin``, or from flat if None.

    From a file, the equilibrium at ``density`` (kg/m²) is found directly, without
    :func:`sim.drape.drape`, which scales fabrics to the reference density.
    """
    rig = Rig()
    fabric = Fabric(np.full(3, alpha * MICRO), density=density)
    laws = Laws(membrane=membrane(law, stiffness))
    if begin is None:
        found = drape(fabric, rig=rig, edge=1e-3 * edge_mm, seed=seed, laws=laws, start="sine")
        mesh, steps = found.mesh, found.iterations
    else:
        start = Shape.load(Path(begin).parent, Path(begin).stem)
        specimen = make_specimen(rig, edge=1e-3 * edge_mm, topology=seed % TOPOLOGIES)
        found = equilibrium_near(start, specimen, rig, fabric, laws)
        mesh, steps = specimen.mesh, found.outcome.iterations
    positions = found.state.positions
    return {"status": found.status.value, "newton_steps": steps,
            "drape_coefficient": drape_coefficient(positions, mesh.faces, rig),
            "arrays": {"rest": mesh.rest, "positions": positions, "faces": mesh.faces}}


@dataclass(frozen=True)
class Case:
    """A fabric of ``alpha``, µN·m, at ``density``, kg/m², with a membrane, and mesh edges."""

    alpha: float
    edge_mm: float
    law: str = "corotational"
    stiffness: float = BASE
    density: float = REFERENCE_DENSITY

    @property
    def name(self) -> str:
        """Name of its files."""
        numbers = "_".join(f"{value:g}" for value in (self.stiffness, self.alpha, self.edge_mm,
                                                      self.density))
        return f"{self.law.replace(' ', '-')}_{numbers}"


def locking_cases(alpha: float, config: Config) -> dict[tuple[str, float], Case]:
    """Cases by label of :data:`LOCKING` and edge, mm."""
    edges = [*config["coarse_mm"], config["fine_mm"]]
    return {(label, edge): Case(alpha, edge, law, stiffness)
            for label, (law, stiffness) in LOCKING.items() for edge in edges}


def insensitivity_cases(alpha: float, config: Config) -> dict[tuple[str, str], Case]:
    """Cases by membrane law and change."""
    edge = config["edge_mm"]
    return {(law, change): case for law in LAWS for change, case in (
        *((f"{stiffness:g} N/m", Case(alpha, edge, law, stiffness)) for stiffness in STIFFNESSES),
        *((f"alpha x {factor:g}", Case(factor * alpha, edge, law)) for factor in (0.5, 2.0)))}


def scaling_cases(alpha: float, config: Config) -> dict[tuple[str, float], Case]:
    """Cases by scaling of the membrane, and density."""
    edge = config["edge_mm"]
    return {(label, density): Case(density / REFERENCE_DENSITY * alpha, edge, stiffness=stiffness,
                                   density=density)
            for density in DENSITIES for label, stiffness in (
                ("scaled too", density / REFERENCE_DENSITY * BASE), ("always 200 N/m", BASE))}


def comparison_rows(alpha: float, drapes: FinishedDrapes, config: Config) -> dict[str, list[dict]]:
    """Rows of the three tables for one fabric.

    Locking has displacements from the fine mesh with the same membrane, from 200 N/m on the same
    mesh and from 5000 N/m on the fine mesh; insensitivity those from the case of 200 N/m, and
    scaling those from 300 g/m².
    """
    fine = config["fine_mm"]
    locking, changed, scaled = (
        {key: case.name for key, case in cases(alpha, config).items()}
        for cases in (locking_cases, insensitivity_cases, scaling_cases))
    return {
        "locking": [{
            "membrane": label, "edge_mm": edge,
            "from_own_fine_mesh_mm": drapes.displacement(case, locking[label, fine]),
            "from_200_same_mesh_mm": drapes.displacement(case, locking["200 N/m", edge]),
            "from_5000_fine_mesh_mm": drapes.displacement(case, locking["5000 N/m", fine]),
            "same_folds": drapes.same_folds(case, locking[label, fine]),
            **drapes.results[case]} for (label, edge), case in locking.items()],
        "insensitivity": [{
            "membrane": law, "change": change,
            "moved_mm": drapes.displacement(case, changed[law, f"{BASE:g} N/m"]),
            "same_folds": drapes.same_folds(case, changed[law, f"{BASE:g} N/m"]),
            **drapes.results[case]} for (law, change), case in changed.items()],
        "scaling": [{
            "membrane": label, "density_g_m2": 1e3 * density,
            "apart_mm": drapes.displacement(case, scaled[label, REFERENCE_DENSITY]),
            **drapes.results[case]} for (label, density), case in scaled.items()],
    }


def plot(drapes: FinishedDrapes, config: Config) -> Figure:
    """Show membranes without and with the guard on the coarsest and on the fine mesh."""
    coarse, fine = config["coarse_mm"][0], config["fine_mm"]
    columns = [("5000 N/m", coarse), ("5000 N/m, guarded", coarse), ("200 N/m", coarse),
               ("5000 N/m", fine), ("5000 N/m, guarded", fine), ("200 N/m", fine)]
    alphas = config["alpha"]
    figure = Figure(figsize=(3.0 * len(columns), 3.1 * len(alphas)), layout="constrained")
    axes = figure.subplots(len(alphas), len(columns), squeeze=False)
    for row, alpha in zip(axes, alphas, strict=True):
        cases = locking_cases(alpha, config)
        for axis, (label, edge) in zip(row, columns, strict=True):
            d = drapes.shapes[cases[label, edge].name]
            axis.imshow(shade(d.positions, d.faces, plate_radius=Rig().plate_radius))
            axis.set_title(f"{label}, {edge:g} mm\nα = {alpha:g} µN·m", fontsize=9)
            axis.axis("off")
    return figure


def run(config: Config) -> Result:
    """Simulate all cases."""
    folder = Path(config["cases"])
    starts = {alpha: Case(alpha, config["start_mm"]) for alpha in config["alpha"]}
    run_cases(simulate, {
        f"start_{case.name}": {**asdict(case), "seed": config["seed"], "begin": None}
        for case in starts.values()}, config)
    drapes = FinishedDrapes(folder, run_cases(simulate, {
        case.name: {**asdict(case), "seed": config["seed"],
                    "begin": str(folder / f"start_{start.name}.npz")}
        for alpha, start in starts.items()
        for cases in (locking_cases, insensitivity_cases, scaling_cases)
        for case in cases(alpha, config).values()}, config))
    found = {alpha: comparison_rows(alpha, drapes, config) for alpha in config["alpha"]}
    worst = max(row["apart_mm"] for questions in found.values() for row in questions["scaling"]
                if row["membrane"] == "scaled too")
    return Result({"scaling_worst_mm": worst,
                   "fabrics": {f"{alpha:g}": questions for alpha, questions in found.items()}},
                  plot(drapes, config))
