"""Estimation of moduli from drapes of other simulators by several methods (001, sec. 6; 000)."""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import minimize as scipy_minimise

from common.errors import InputError
from data.dataset.plan import DrapePlan
from data.fabrics.fabrics import THETA_NAMES, fabric_from_theta, from_theta, to_theta
from data.fabrics.prior import load_prior
from drapenet.refine.minimise import LeastSquares, Limits, Status, minimise
from drapenet.refine.positions import RobustPositions
from drapenet.refine.problem import Problem
from drapenet.refine.unknowns import SpecimenPrior, Unknowns
from drapenet.surface.springs import plane_springs
from experiments.drapes import drape_specimen, plan_specimen
from experiments.page import Section
from experiments.papers.descriptors import DescriptorObjective, GridSpectrum, RingSpectrum
from experiments.papers.transfer import ratio
from experiments.physics import style3d
from experiments.result import Config, Report, Result, label_log_axes, rms, run_fabrics
from sim.cloth import Cloth, Laws
from sim.drape import Drape, follow
from sim.energies.hinges import mean_modulus
from sim.material import REFERENCE_DENSITY, Fabric, is_admissible, torque
from sim.mesh.specimen import TOPOLOGIES
from sim.scene import make_specimen
from sim.start import interpolate_positions

SIGMA = 0.3  # initial standard deviation of CMA-ES, in units of the problem
SEED = 0  # of CMA-ES
_INFEASIBLE_VALUE = 1e30  # replaces an infinite value where a method requires a finite one


class Exhausted(Exception):  # noqa: N818 (ends a method from within a library's loop)
    """Raised when a problem has been evaluated as often as allowed."""


class Recorded:
    """A least-squares problem whose evaluations are counted, limited and recorded.

    Attributes:
        trace: number of evaluations, unknowns (n,) and value of each improvement, the start first.
    """

    def __init__(self, problem: LeastSquares, most: int) -> None:
        self.start = np.clip(problem.start, problem.low, problem.high)
        self.low, self.high = problem.low, problem.high
        self.evaluations = 0
        self.trace: list[tuple[int, np.ndarray, float]] = []
        self._problem, self._most = problem, most

    @property
    def best(self) -> float:
        """The lowest value so far."""
        return self.trace[-1][2] if self.trace else math.inf

    def value(self, x: np.ndarray) -> float:
        """The problem's value."""
        if self.evaluations >= self._most:
            raise Exhausted
        value = float(self._problem.value(x))
        self.evaluations += 1
        if value < self.best:
            self.trace.append((self.evaluations, np.array(x), value))
        return value

    def linearised(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """The problem's residuals and derivatives."""
        return self._problem.linearised(x)


def levenberg_marquardt(problem: Recorded, limits: Limits) -> Status:
    """The minimiser of the refinement."""
    return minimise(problem, limits=limits).status


def lbfgs(problem: Recorded, limits: Limits) -> Status:
    """SciPy's L-BFGS-B on the value and its gradient."""
    start, first = problem.start, problem.value(problem.start)
    if not math.isfinite(first):
        return Status.FAILED

    def value_and_gradient(x: np.ndarray) -> tuple[float, np.ndarray]:
        value = first if np.array_equal(x, start) else problem.value(x)
        linearised = problem.linearised(x) if math.isfinite(value) else None
        if linearised is None:
            # Larger than any feasible value and without slope, so that the line search backtracks.
            return 10.0, np.zeros_like(x)
        residuals, jacobian = linearised
        return value / first, jacobian.T @ residuals / first

    result = scipy_minimise(
        value_and_gradient, start, jac=True, method="L-BFGS-B",
        bounds=list(zip(problem.low, problem.high, strict=True)),
        options={"ftol": limits.decrease, "gtol": 1e-9, "maxfun": 10**6, "maxiter": 10**6})
    return Status.CONVERGED if result.success else Status.STALLED


def cma_es(problem: Recorded, limits: Limits) -> Status:
    """CMA-ES of the package cma, with its default population size."""
    import cma  # slow import

    if not math.isfinite(problem.value(problem.start)):
        return Status.FAILED
    strategy = cma.CMAEvolutionStrategy(problem.start, SIGMA, {
        "bounds": [problem.low.tolist(), problem.high.tolist()], "seed": SEED + 1,
        "verbose": -9, "tolx": limits.step / 10, "tolfun": 0, "tolfunhist": 0, "tolflatfitness": 5,
    })
    while not strategy.stop():
        points = strategy.ask()
        strategy.tell(points, [min(problem.value(np.asarray(x)), _INFEASIBLE_VALUE)
                               for x in points])
    return Status.CONVERGED


METHODS: dict[str, Callable[[Recorded, Limits], Status]] = {
    "lm": levenberg_marquardt, "lbfgs": lbfgs, "cmaes": cma_es}


def run_method(problem: LeastSquares, method: str, limits: Limits) -> tuple[Status, Recorded]:
    """Minimise by one of :data:`METHODS` within ``limits``: status, and the record of the search.
    """
    recorded = Recorded(problem, limits.evaluations)
    try:
        return METHODS[method](recorded, limits), recorded
    except Exhausted:
        return Status.EXHAUSTED, recorded


TARGETS = {"plate": "this project's plate, another mesh", "hinges": "hinges, another mesh",
           "style3d": "Style3D"}
SEARCHES = {
    "lm": "vertices, Levenberg–Marquardt", "lbfgs": "vertices, L-BFGS-B",
    "cmaes": "vertices, CMA-ES", "grid": "2-D spectrum (000, Eq. 9), Levenberg–Marquardt",
    "rings": "spectrum along rings, Levenberg–Marquardt"}
_SOURCES = ("sim", "drapenet/refine", "experiments/papers/descriptors.py",
            "experiments/physics/style3d.py")
_SPRING_FORCE = 0.05  # of the springs at 1 mm, relative to the weight, as for scans
_CURVATURE = 50.0  # 1/m, at which secant moduli are compared
_START_STIFFNESS = 2.0  # relative stiffness of the drape at which Style3D starts


def isotropic_mean(theta: np.ndarray) -> np.ndarray:
    """Theta (6,) of the mean over directions, because hinges do not separate the directions."""
    return to_theta(*([mean_modulus(moduli)] * 3 for moduli in from_theta(theta)))


def scale_moduli(theta: np.ndarray, factor: float) -> np.ndarray:
    """Theta (6,) of all moduli times a factor."""
    return theta + np.array([np.log(factor)] * 3 + [0.0] * 3)


def perturb(theta: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Theta (6,) of moduli times independent random factors in [0.5, 2]."""
    alpha, beta = from_theta(theta)
    while True:
        factors = 2 ** rng.uniform(-1, 1, (2, 3))
        if is_admissible(alpha * factors[0], beta * factors[1]):
            return to_theta(alpha * factors[0], beta * factors[1])


def simulate_target(
    target: str, plan: DrapePlan, *, edge: float, seconds: float
) -> tuple[Drape, np.ndarray, float]:
    """Simulate a drape on another mesh or in another simulator: a drape on the same mesh (for
    Style3D, the start), the positions, and their displacement in the last quarter, mm."""
    other = {"edge": edge, "seed": plan.seed + 1}  # the next triangulation
    if target == "plate":
        found = drape_specimen(plan, **other)
        return found, found.positions, 0.0
    hinges = replace(plan, theta=scale_moduli(plan.theta, ratio()))
    if target == "hinges":
        found = drape_specimen(hinges, **other, laws=Laws(bending="hinge"))
        return found, found.positions, 0.0
    above = drape_specimen(replace(plan, theta=scale_moduli(plan.theta, _START_STIFFNESS)), **other)
    settled = style3d.simulate(above.scene, above.positions, density=REFERENCE_DENSITY,
                               modulus=from_theta(hinges.theta)[0], seconds=seconds)
    return above, settled.positions, settled.motion


def register(shape: Drape, positions: np.ndarray, fabric: Fabric, topology: int,
               edge: float) -> Drape:
    """Interpolate positions (V, 3), m, to another mesh; the result is not an equilibrium."""
    mesh = make_specimen(shape.rig, edge=edge, topology=topology)
    at = interpolate_positions(shape.rest, positions, mesh.mesh.rest)
    at[mesh.held] = shape.rig.place(mesh.mesh.rest[mesh.held])
    return Drape(fabric=fabric, rig=shape.rig, edge=edge, cloth=Cloth(mesh, fabric),
                 state=mesh.state(at))


def case(
    *, number: int, target: str, edge_mm: float, seconds: float, simulations: int,
    simulations_free: int, seed: int,
) -> dict[str, Any]:
    """Results of all searches for one drape; "failed" has the reason without one."""
    plan = plan_specimen(number, seed=seed)
    truth = isotropic_mean(plan.theta)
    if target.startswith("style3d"):
        truth[3:] = 0.0  # it has no quadratic modulus
    plan, edge = replace(plan, theta=truth), 1e-3 * edge_mm
    try:
        shape, positions, motion = simulate_target(target, plan, edge=0.8 * edge, seconds=seconds)
        start = perturb(isotropic_mean(plan_specimen(number, seed=seed).theta),
                          np.random.default_rng([seed, number]))
        fabric = fabric_from_theta(start)
        captured = register(shape, positions, fabric, plan.seed % TOPOLOGIES, edge)
        initial = drape_specimen(replace(plan, theta=start), edge=edge, start="ring")
    except InputError as error:
        return {"failed": str(error)}
    rest, rig = captured.rest, captured.rig
    springs = plane_springs(captured.scene, captured.positions, pull=_SPRING_FORCE)
    vertices = RobustPositions(captured.positions, vertices=~captured.held)
    unknown = {"free": THETA_NAMES, "prior": SpecimenPrior.of(load_prior("gaussian"))}
    searches: dict[str, Any] = {}
    for search in SEARCHES:
        began = time.process_time()
        if search in METHODS:
            problem = Problem(captured, Unknowns.of(start), vertices,
                              springs=lambda _: springs, **unknown)
        else:
            kind, near = ((GridSpectrum, captured) if search == "grid" else (RingSpectrum, initial))
            descriptor = kind(rest, rig)
            problem = Problem(near, Unknowns.of(start), DescriptorObjective(
                descriptor, descriptor.describe(captured.positions)), **unknown)
        limits = Limits(evaluations=simulations_free if search == "cmaes" else simulations)
        status, record = run_method(problem, search if search in METHODS else "lm", limits)
        cpu = time.process_time() - began
        searches[search] = {"simulations": problem.effort.solves, "seconds": cpu,
                     "status": status.value, "theta": None, "drape": None}
        if problem.best is None:
            continue
        best = problem.best.unknowns
        free = follow(captured, best.fabric)
        searches[search] |= {
            "theta": best.theta.tolist(), "alpha": (best.theta - truth)[:3].tolist(),
            "ratio_mm": (1e3 * (best.theta - truth)[3:]).tolist(),
            "trace": [[evaluations, rms((problem.split(x)[0].theta - truth)[:3])]
                      for evaluations, x, _ in record.trace],
            "drape": 1e3 * float(np.linalg.norm(
                free.positions - captured.positions, axis=1).mean()) if free.converged else None}
    return {"truth": truth.tolist(), "start": (start - truth)[:3].tolist(), "motion": motion,
            "ways": searches}


def run(config: Config) -> Result:
    """Run all fabrics by target."""
    missing = style3d.missing("drapes of Style3D are")
    return Result({"ratio": ratio(), "targets": {
        target: run_fabrics(case, config | {"target": target}, sources=_SOURCES, subfolder=target)
        for target in TARGETS if not (missing and target == "style3d")}})


def _secant_error(theta: list[float], truth: list[float]) -> np.ndarray:
    """Log (3,) of estimated over true secant moduli at :data:`_CURVATURE`."""
    one, other = (torque(np.array(_CURVATURE), *from_theta(np.array(t))) for t in (theta, truth))
    return np.log(one / other)


def _search_results(report: Report, target: str, search: str) -> list[dict[str, Any]]:
    """Results of a search for a target that have an estimate, with the true theta."""
    return [one["ways"][search] | {"truth": one["truth"]}
            for one in report["targets"][target].values()
            if "ways" in one and one["ways"][search]["theta"]]


def _summary(report: Report) -> dict[tuple[str, str], dict[str, float]]:
    """By target and search: root mean square errors of alpha and secant, %, and beta/alpha, mm;
    medians of the other quantities."""
    found = {}
    for target in report["targets"]:
        for search in SEARCHES:
            if results := _search_results(report, target, search):
                found[target, search] = {
                    "fabrics": len(results),
                    "alpha": 100 * rms(np.array([o["alpha"] for o in results])),
                    "mean": 100 * float(np.mean([o["alpha"] for o in results])),
                    "secant": 100 * rms(np.array([_secant_error(o["theta"], o["truth"])
                                                  for o in results])),
                    "ratio": rms(np.array([o["ratio_mm"] for o in results])),
                    **{key: float(np.median([o[key] for o in results
                                             if o[key] is not None] or np.nan))
                       for key in ("drape", "simulations", "seconds")}}
    return found


def rows(report: Report) -> tuple[list[str], list[list[object]]]:
    """Table of results by target and search."""
    head = ["drape made by", "search", "fabrics", "log α, %: rms, mean",
            f"secant at {_CURVATURE:g} m⁻¹, %", "β/α, mm", "drape, mm", "simulations", "CPU, s"]
    return head, [[TARGETS[target], SEARCHES[search], one["fabrics"],
                   f"{one['alpha']:.0f}, {one['mean']:+.0f}", f"{one['secant']:.0f}",
                   f"{one['ratio']:.2f}", f"{one['drape']:.2f}", f"{one['simulations']:.0f}",
                   f"{one['seconds']:.1f}"]
                  for (target, search), one in _summary(report).items()]


def draw(report: Report) -> Figure:
    """Plot errors of alpha by target and search, and errors over the number of simulations."""
    figure = Figure(figsize=(10, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    for k, (search, name) in enumerate(SEARCHES.items()):
        for place, target in enumerate(report["targets"], start=1):
            errors = [100 * rms(np.array(one["alpha"]))
                      for one in _search_results(report, target, search)]
            at = place + 0.14 * (k - 2)
            left.plot(np.full(len(errors), at), errors, ".", color=f"C{k}", alpha=0.4)
            if errors:
                left.plot(at, rms(np.array(errors)), "_", color=f"C{k}", ms=13, mew=2.5,
                          label=name if place == 1 else None)
        traces = [np.array(one["trace"]) for one in _search_results(report, "plate", search)]
        numbers = np.unique(np.concatenate([trace[:, 0] for trace in traces] or [[]]))
        right.step(numbers, [100 * rms(np.array([trace[trace[:, 0] <= n][-1, 1]
                                                 for trace in traces])) for n in numbers],
                   where="post", color=f"C{k}")
    left.set(yscale="log", ylabel="error of α [%]")
    left.set_xticks(range(1, len(report["targets"]) + 1),
                    [TARGETS[target].replace(", ", ",\n") for target in report["targets"]])
    right.set(xscale="log", yscale="log", xlabel="simulations")
    right.set_title(TARGETS["plate"], fontsize="medium")
    label_log_axes(left.yaxis, right.xaxis, right.yaxis)
    figure.legend(loc="outside lower center", ncols=3, fontsize="small", frameon=False)
    return figure


def summarise(report: Report) -> str:
    """Summary in sentences."""
    found = _summary(report)

    def of(target: str, search: str = "lm") -> str:
        one = found[target, search]
        return f"{one['alpha']:.0f} % ({one['simulations']:.0f} simulations)"

    initial = 100 * rms(np.array([one["start"] for one in report["targets"]["plate"].values()
                                if "start" in one]))
    text = (f"From the vertices of the plate's drape on another mesh, Levenberg–Marquardt finds α "
            f"to {of('plate')}, CMA-ES to {of('plate', 'cmaes')}, L-BFGS-B to "
            f"{of('plate', 'lbfgs')}, from starts {initial:.0f} % away. From a drape of hinges "
            f"Levenberg–Marquardt finds it to {of('hinges')}. Without registered vertices, the "
            f"spectrum along rings gives {of('plate', 'rings')}. ")
    if "style3d" not in report["targets"]:
        return text + (f"Drapes of Newton's Style3D are left out: it was not installed "
                       f"(`{style3d.INSTALL}`).")
    motion = max(one["motion"] for one in report["targets"]["style3d"].values()
                 if "motion" in one)
    softened = found["style3d", "lm"]
    return text + (f"From drapes of Style3D Levenberg–Marquardt gives {of('style3d')}: cloth "
                   "without β is estimated as stiffer cloth that softens, with an error of "
                   f"{softened['secant']:.0f} % in the secant at {_CURVATURE:g} m⁻¹. These drapes "
                   f"moved by at most {motion:.2f} mm in the last quarter of the simulation.")


SECTION = Section(
    "Moduli from drapes of other simulators",
    "001, section 6 (Tables 2 and 3), and 000, section 5",
    "How accurately do several optimisation methods find the moduli, and at what cost?",
    summarise, rows, draw,
    "DiffCloth's T-shirt (six parameters, 001, Table 3) took 4 500 time steps with L-BFGS-B and "
    "53 500 with CMA-ES, which took 1.1 to 14 times as many in its other examples; comparable in "
    "kind, as motions of its own simulator. 000 finds the bending stiffness of its own shapes "
    "within 4 % after 13 iterations and reproduces Houdini's cloth within 2.4 to 6 mm at worst, "
    "without true moduli to compare with.",
    "Fabrics are isotropic, because hinges do not separate the directions. The six unknown moduli "
    "start at the truth times 0.5 to 2 and have the fabric prior. For drapes of hinges, the true "
    "modulus is the hinge modulus divided by the ratio in [exports](exports.md); for Style3D, β/α "
    "= 0. Vertices are known exactly, and springs of 0.05 of the cloth's weight at 1 mm hold the "
    "cloth to them. Style3D starts from this project's drape of twice the stiffness, without "
    "friction on the cylinder: with its one projection per step, a coefficient of 0.4 left "
    "three drapes bitwise unchanged, and more projections double the time. *drape*: displacement "
    "of cloth with the estimated moduli after release at the registered drape. Drape, simulations "
    "and CPU time are medians over fabrics.")
