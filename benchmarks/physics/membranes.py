"""Influence of the membrane on a drape: locking, stiffness, scaling (paper's Figures 5 to 9).

Isotropic fabrics of each alpha:

- *locking*: drapes of one fold configuration on coarse and fine meshes, with 200, 400 and
  5000 N/m and with 5000 N/m behind the guard (strain free from 99 % to 101 %);
- *in-plane insensitivity*: how far a drape moves for membranes of 100 to 1000 N/m, and how far
  for half and twice the alpha, for two laws, from one start;
- *scaling*: the same moduli/density at 100, 300 and 900 g/m².

Drapes "from the fold" start from one drape of 200 N/m, so that their folds are the same; drapes
"from flat" start from the sine start and find other folds.
"""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
from matplotlib.figure import Figure

from benchmarks.common import Config, Result, load_arrays, next_to, run_cases, table
from benchmarks.comparison import compare, same_folds
from data.picture import shade
from sim.drape import drape
from sim.laws import Laws
from sim.material import MICRO, REFERENCE_DENSITY, Fabric
from sim.measures import drape_coefficient, fold_outline
from sim.membranes import Corotational, Guarded, Membrane, OrthotropicStVK
from sim.mesh.specimens import TOPOLOGIES, make_specimen
from sim.newton import Status
from sim.scene import GRAVITY, Rig

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
WOVEN = ("woven", STIFF)
DENSITIES = (0.1, 0.3, 0.9)
LIMIT = 0.01  # mm, between drapes of one modulus/density


def membrane(name: str, stiffness: float) -> Membrane:
    """The membrane called ``name`` with Young's modulus times thickness ``stiffness``, N/m."""
    if name == "corotational":
        return Corotational(stiffness, POISSON)
    if name == "guarded corotational":
        return Guarded(Corotational(stiffness, POISSON))
    if name == "stvk":
        shear = stiffness / (2 * (1 + POISSON))
        return OrthotropicStVK(stiffness, stiffness, POISSON, shear)
    # Yarns that are nearly inextensible and turn freely, as in woven cloth
    return OrthotropicStVK(stiffness, stiffness, 0.0, 40.0)


def settle(
    alpha: float, law: str, stiffness: float, edge_mm: float, seed: int, begin: str | None,
    density: float = REFERENCE_DENSITY,
) -> dict:
    """Drape a fabric of ``alpha`` (µN·m) from the npz file ``begin``, or from flat if None.

    From a file it goes straight to equilibrium at ``density`` (kg/m²), below the door of
    :func:`sim.drape.drape`, which would first reduce it to the reference density.
    """
    rig = Rig()
    fabric = Fabric(np.full(3, alpha * MICRO), density=density)
    laws = Laws(membrane=membrane(law, stiffness))
    if begin is None:
        found = drape(fabric, rig=rig, edge=1e-3 * edge_mm, seed=seed, laws=laws)
        mesh, steps = found.mesh, found.iterations
    else:
        start = load_arrays(Path(begin).parent, Path(begin).stem)
        specimen = make_specimen(rig, edge=1e-3 * edge_mm, topology=seed % TOPOLOGIES)
        found = next_to(start["rest"], start["positions"], specimen, rig, fabric, laws)
        mesh, steps = specimen.mesh, found.newton.iterations
    positions = found.state.positions
    return {
        "status": found.status.value,
        "drape_coefficient": drape_coefficient(positions, mesh.faces, rig),
        "newton_steps": steps,
        "arrays": {"rest": mesh.rest, "positions": positions, "faces": mesh.faces},
    }


class Plan:
    """The cases of a run by name, so that each question can ask for its own."""

    def __init__(self, config: dict) -> None:
        self.config, self.folder = config, Path(config["cases"])
        self.starts: dict[str, dict] = {}
        self.cases: dict[str, dict] = {}
        for alpha in config["alpha"]:
            self.starts[f"start_{alpha:g}"] = self._settings(alpha, "corotational", BASE,
                                                             config["start_mm"], None)

    def _settings(self, alpha: float, law: str, stiffness: float, edge_mm: float,
                  begin: str | None, **more: float) -> dict:
        return {"alpha": alpha, "law": law, "stiffness": stiffness, "edge_mm": edge_mm,
                "seed": self.config["seed"], "begin": begin, **more}

    def case(self, alpha: float, law: str, stiffness: float, edge_mm: float, *,
             folds_of: float | None, density: float | None = None) -> str:
        """Name of a case, entered if new; from flat where ``folds_of`` (an alpha) is None."""
        begin = None if folds_of is None else str(self.folder / f"start_{folds_of:g}.npz")
        more = {} if density is None else {"density": density}
        name = f"{law.replace(' ', '-')}_{stiffness:g}_alpha_{alpha:g}_edge_{edge_mm:g}"
        name += "_flat" if folds_of is None else f"_from_{folds_of:g}"
        name += "" if density is None else f"_rho_{density:g}"
        self.cases[name] = self._settings(alpha, law, stiffness, edge_mm, begin, **more)
        return name


class Results:
    """Finished cases: what they report, and the drapes."""

    def __init__(self, folder: Path, reports: dict[str, dict]) -> None:
        self._folder, self.reports = folder, reports

    def drape(self, name: str) -> SimpleNamespace:
        """Rest, positions and faces of a case."""
        return SimpleNamespace(**load_arrays(self._folder, name))

    def apart(self, name: str, other: str) -> float:
        """Mean vertex displacement between two cases, mm; NaN if one has not converged."""
        if any(self.reports[n]["status"] != Status.CONVERGED.value for n in (name, other)):
            return float("nan")
        return 1e3 * compare(self.drape(name), self.drape(other)).displacement

    def same_folds(self, name: str, other: str) -> bool:
        """Whether two cases have the same fold configuration."""
        outlines = (fold_outline(d.positions, d.rest, Rig())
                    for d in (self.drape(name), self.drape(other)))
        return same_folds(*outlines)


def ask_locking(plan: Plan, alpha: float) -> dict[tuple[str, float], str]:
    """Names of the cases by label of LOCKING and edge, mm."""
    edges = [*plan.config["coarse_mm"], plan.config["fine_mm"]]
    return {
        (label, edge): plan.case(alpha, *which, edge, folds_of=alpha)
        for label, which in LOCKING.items() for edge in edges
    }


def answer_locking(
    results: Results, names: dict[tuple[str, float], str], config: dict
) -> list[dict]:
    """For each membrane and mesh: from its own fine mesh, from 200 N/m on the same mesh."""
    return [
        {
            "membrane": label,
            "edge_mm": edge,
            "from_own_fine_mesh_mm": results.apart(name, names[label, config["fine_mm"]]),
            "from_200_same_mesh_mm": results.apart(name, names["200 N/m", edge]),
            "from_5000_fine_mesh_mm": results.apart(name, names["5000 N/m", config["fine_mm"]]),
            "same_folds": results.same_folds(name, names[label, config["fine_mm"]]),
            **results.reports[name],
        }
        for (label, edge), name in names.items()
    ]


def ask_insensitivity(plan: Plan, alpha: float) -> dict[tuple[str, str, str], str]:
    """Names of the cases by law, change and start ("fold" or "flat")."""
    names, edge = {}, plan.config["edge_mm"]
    for start, folds_of in (("fold", alpha), ("flat", None)):
        for law in LAWS:
            for stiffness in STIFFNESSES:
                names[law, f"{stiffness:g} N/m", start] = plan.case(
                    alpha, law, stiffness, edge, folds_of=folds_of)
            for factor in (0.5, 2.0):
                names[law, f"alpha x {factor:g}", start] = plan.case(
                    factor * alpha, law, BASE, edge, folds_of=folds_of)
        names["woven", "yarns 5000, shear 40 N/m", start] = plan.case(
            alpha, *WOVEN, edge, folds_of=folds_of)
    return names


def answer_insensitivity(results: Results, names: dict[tuple[str, str, str], str]) -> list[dict]:
    """For each law and change: how far the drape lies from the one of 200 N/m, same start."""
    rows = []
    for (law, change, start), name in names.items():
        base = names[law if law in LAWS else "corotational", f"{BASE:g} N/m", start]
        rows.append({
            "membrane": law, "change": change, "start": start,
            "moved_mm": results.apart(name, base), "same_folds": results.same_folds(name, base),
            **results.reports[name],
        })
    return rows


def ask_scaling(plan: Plan, alpha: float) -> dict[tuple[str, float], str]:
    """Names of the cases by what happens to the membrane, and density."""
    names = {}
    for density in DENSITIES:
        factor = density / REFERENCE_DENSITY
        for label, stiffness in (("scaled too", factor * BASE), ("always 200 N/m", BASE)):
            names[label, density] = plan.case(
                factor * alpha, "corotational", stiffness, plan.config["edge_mm"],
                folds_of=alpha, density=density)
    return names


def answer_scaling(results: Results, names: dict[tuple[str, float], str]) -> list[dict]:
    """For each density: how far the drape lies from the one at 300 g/m²."""
    return [
        {"membrane": label, "density_g_m2": 1e3 * density,
         "apart_mm": results.apart(name, names[label, REFERENCE_DENSITY]),
         **results.reports[name]}
        for (label, density), name in names.items()
    ]


def print_tables(alpha: float, answers: dict[str, list[dict]], config: dict) -> None:
    """Print what was found for one fabric."""
    print(f"\n## alpha = {alpha:g} µN·m\n\nLocking, mean displacements in mm\n")
    print(table(
        ["membrane", "edges at the rim, mm", "drape coeff.", "from own fine mesh",
         "from 200 N/m, same mesh", "from 5000 N/m, fine mesh", "same folds", "steps", "status"],
        [[r["membrane"], r["edge_mm"], r["drape_coefficient"], r["from_own_fine_mesh_mm"],
          r["from_200_same_mesh_mm"], r["from_5000_fine_mesh_mm"], r["same_folds"],
          r["newton_steps"], r["status"]] for r in answers["locking"]]))
    print(f"\nMoved from 200 N/m, {config['edge_mm']:g} mm edges at the rim\n")
    print(table(
        ["membrane", "change", "start", "moved, mm", "same folds", "status"],
        [[r["membrane"], r["change"], r["start"], r["moved_mm"], r["same_folds"], r["status"]]
         for r in answers["insensitivity"]]))
    print("\nSame moduli/density\n")
    print(table(
        ["membrane", "g/m²", "from 300 g/m², mm", "status"],
        [[r["membrane"], r["density_g_m2"], r["apart_mm"], r["status"]]
         for r in answers["scaling"]]))


def weight_alone() -> float:
    """Upper bound, mm, of what doubling 200 N/m moves cloth that hangs straight from the plate.

    The longest line of a square specimen runs from the rim to a corner; under its own weight it
    stretches by density g L²/(2 k).
    """
    rig = Rig()
    length = rig.specimen_size / np.sqrt(2) - rig.plate_radius
    return 1e3 * REFERENCE_DENSITY * GRAVITY * length**2 / 2 * (1 / BASE - 1 / DOUBLE)


def picture(results: Results, locking: dict[float, dict], config: dict) -> Figure:
    """The stiff membrane on the coarsest mesh without and with the guard, and on the fine one."""
    coarse, fine = config["coarse_mm"][0], config["fine_mm"]
    columns = [("5000 N/m", coarse), ("5000 N/m, guarded", coarse), ("200 N/m", coarse),
               ("5000 N/m", fine), ("5000 N/m, guarded", fine), ("200 N/m", fine)]
    figure = Figure(figsize=(3.0 * len(columns), 3.1 * len(locking)), layout="constrained")
    axes = figure.subplots(len(locking), len(columns), squeeze=False)
    for row, (alpha, names) in zip(axes, locking.items(), strict=True):
        for axis, (label, edge) in zip(row, columns, strict=True):
            d = results.drape(names[label, edge])
            axis.imshow(shade(d.positions, d.faces, plate_radius=Rig().plate_radius))
            axis.set_title(f"{label}, {edge:g} mm\nα = {alpha:g} µN·m", fontsize=9)
            axis.axis("off")
    return figure


def run(config: Config) -> Result:
    """Ask, drape, answer, and print the tables."""
    plan = Plan(config)
    asked = {
        alpha: {"locking": ask_locking(plan, alpha),
                "insensitivity": ask_insensitivity(plan, alpha),
                "scaling": ask_scaling(plan, alpha)}
        for alpha in config["alpha"]
    }
    run = {"folder": plan.folder, "workers": config["workers"]}
    run_cases(settle, plan.starts, **run)
    results = Results(plan.folder, run_cases(settle, plan.cases, **run))
    answers = {
        alpha: {"locking": answer_locking(results, names["locking"], config),
                "insensitivity": answer_insensitivity(results, names["insensitivity"]),
                "scaling": answer_scaling(results, names["scaling"])}
        for alpha, names in asked.items()
    }
    for alpha, found in answers.items():
        print_tables(alpha, found, config)
    worst = max(r["apart_mm"] for found in answers.values() for r in found["scaling"]
                if r["membrane"] == "scaled too")
    print(f"\nscaling: largest difference {worst:.1e} mm (limit {LIMIT} mm)")
    bound = weight_alone()
    print(f"weight alone would move a corner by {bound:.2f} mm when 200 N/m are doubled")
    locking = {alpha: names["locking"] for alpha, names in asked.items()}
    return Result({
        "scaling_worst_mm": worst, "weight_alone_mm": bound,
        "fabrics": {f"{alpha:g}": found for alpha, found in answers.items()},
    }, picture(results, locking, config))
