"""Estimation of an anisotropic membrane from a square hung by two corners (004, section 5)."""

import math
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from data.fabrics.fabrics import fabric_from_theta, from_theta
from drapenet.refine.minimise import Limits, minimise
from drapenet.refine.objective import value
from experiments.drapes import header, plan_specimen
from experiments.report import Report, label_log_axes, rms, table
from experiments.study import CaseKeys, Sample, Study, samples_of
from sim.cloth import Laws
from sim.draping import Drape, drape, follow
from sim.energies.membrane import OrthotropicStVK
from sim.material import Fabric, is_admissible
from sim.rig import HUNG_SQUARE
from sim.sensitivity import Tangent
from sim.sensitivity.forward import tangent_sensitivities
from sim.solver.potential import forces
from sim.start import interpolate_positions

UNKNOWNS = ("warp", "weft", "shear", "Poisson's ratio")
FITS = {"same mesh, bending known": (True, False), "other mesh, bending known": (False, False),
        "other mesh, bending unknown": (False, True)}
"""By name: whether capture and fit have the same mesh, and whether bending is unknown."""
MAX_NOISE_RATIO = 2.0  # residual over noise; fits with a larger one have other folds
_STEP = 1e-4  # of an unknown, in central differences of the forces
_POISSON = (0.0, 0.4)


def prior() -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation (4,) of the unknowns over specimens of all fabrics.

    Warp and weft have independent membranes, and shear is relative to their geometric mean.
    """
    nuisances = header().nuisances
    (membrane, shear), (spread, more) = ([table[name] for name in ("membrane", "shear")]
                                         for table in (nuisances.means, nuisances.deviations))
    poisson = np.mean(_POISSON)
    return (np.array([membrane, membrane, membrane + shear - math.log(2 * (1 + poisson)), poisson]),
            np.array([spread, spread, math.hypot(spread / 2**0.5, more),
                      np.ptp(_POISSON) / 12**0.5]))


def sample_unknowns(rng: np.random.Generator) -> np.ndarray:
    """Draw unknowns (4,) of one fabric."""
    nuisances = header().nuisances
    low, high = np.log(nuisances.shear)
    while True:
        yarns = (nuisances.means["membrane"]
                 + nuisances.deviations["membrane"] * rng.standard_normal(2))
        poisson = rng.uniform(*_POISSON)
        shear = yarns.mean() - math.log(2 * (1 + poisson)) + rng.uniform(low, high)
        unknowns = np.array([*yarns, shear, poisson])
        if is_stable(unknowns):
            return unknowns


def is_stable(unknowns: np.ndarray) -> bool:
    """Whether a membrane with these unknowns is stable."""
    return bool(unknowns[3] ** 2 * np.exp(unknowns[1] - unknowns[0]) < 1)


def membrane_of(unknowns: np.ndarray) -> OrthotropicStVK:
    """Membrane of the unknowns (4 or more,): logarithms of N/m, then Poisson's ratio."""
    warp, weft, shear = np.exp(unknowns[:3])
    return OrthotropicStVK(warp=warp, weft=weft, shear=shear, poisson=unknowns[3])


class HungFit:
    """Fit of a hung square (:class:`drapenet.refine.minimise.LeastSquares`).

    Unknowns are :data:`UNKNOWNS` and, if ``free``, the theta of bending, in units of their standard
    deviation over fabrics. Residuals are those of the points, in units of ``sigma``, and of the
    prior; a fit is the mode of the posterior.

    Args:
        reference: a hung square on the mesh of the fit.
        points: captured vertices, whose coordinates have noise of ``sigma``.
    """

    def __init__(self, reference: Drape, points: np.ndarray, theta: np.ndarray, *, free: bool,
                 sigma: float) -> None:
        bending = header().scale
        self._points, self._theta, self._sigma = points, theta, sigma
        self._reference, self._last, self._least = reference.at(points), reference, math.inf
        count = 10 if free else 4
        self._mean, self._spread = (np.concatenate(pair)[:count] for pair in zip(
            prior(), (bending.mean[:6], bending.std[:6]), strict=True))
        self.start = np.zeros(count)
        self.low, self.high = self.start - 4.0, self.start + 4.0
        low, high = (np.array(_POISSON) - self._mean[3]) / self._spread[3]
        self.low[3], self.high[3] = low, high

    def unknowns(self, x: np.ndarray) -> np.ndarray:
        """Unknowns in physical units, see :func:`membrane_of`."""
        return self._mean + self._spread * x

    def value(self, x: np.ndarray) -> float:
        """Half the sum of squares, infinite where there is no equilibrium."""
        unknowns = self.unknowns(x)
        alpha, beta = from_theta(unknowns[4:] if len(unknowns) > 4 else self._theta)
        if not (is_stable(unknowns) and is_admissible(alpha, beta)):
            return math.inf
        laws = Laws(membrane=membrane_of(unknowns))
        found = follow(self._reference, Fabric(alpha, beta), laws=laws, keep=True)
        if not found.converged:
            return math.inf
        self._last, total = found, value(self._residuals(found, x))
        if total < self._least:
            self._reference, self._least = found, total
        return total

    def linearised(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Residuals and Jacobian at the last ``x`` of :meth:`value`, None without a tangent."""
        tangent = Tangent.of(self._last)
        if not tangent.ok:
            return None
        moves = hung_sensitivities(tangent, self._last.fabric, self.unknowns(x))
        jacobian = moves[:, ~self._last.held].reshape(len(x), -1).T * self._spread / self._sigma
        return self._residuals(self._last, x), np.vstack([jacobian, np.eye(len(x))])

    def _residuals(self, found: Drape, x: np.ndarray) -> np.ndarray:
        gap = (found.positions - self._points)[~found.held] / self._sigma
        return np.concatenate([gap.ravel(), x])


def hung_sensitivities(tangent: Tangent, fabric: Fabric, unknowns: np.ndarray) -> np.ndarray:
    """Derivatives (N, V, 3) of equilibrium positions with respect to unknowns (N,), m per unit."""
    scene, size = tangent.cloth.scene, tangent.cloth.potential.unknowns

    def inner_forces(unknowns: np.ndarray) -> np.ndarray:
        return forces([membrane_of(unknowns).energy(scene.mesh, scene.active)], tangent.q, size)

    steps = _STEP * np.eye(len(unknowns))[:4]
    moves = [-tangent.response(
        (inner_forces(unknowns + step) - inner_forces(unknowns - step)) / (2 * _STEP))
             for step in steps]
    if len(unknowns) > 4:
        moves += [*tangent_sensitivities(tangent, fabric, ("log_alpha", "ratio")).moves]
    return np.array(moves)[:, : tangent.coordinates].reshape(len(unknowns), -1, 3)


class Keys(CaseKeys):
    fabrics: int = 6  # drawn from the prior, each with another membrane
    edge_mm: float = 15.0  # mesh edge length of the fitted square
    truth_mm: float = 11.0  # of the captured one
    noise_mm: float = 1.0  # standard deviation, of each captured coordinate
    evaluations: int = 25  # maximum per fit
    seed: int = 414
    workers: int = 2


def fabric(
    rng: np.random.Generator, *, number: int, edge_mm: float, truth_mm: float, noise_mm: float,
    evaluations: int, seed: int
) -> Sample:
    """True unknowns of one fabric, and the estimates and standard deviations of each fit that
    succeeded, in units of the standard deviation over fabrics.
    """
    theta, sigma = plan_specimen(number, seed=seed).theta, 1e-3 * noise_mm
    unknowns, bending = sample_unknowns(rng), fabric_from_theta(theta)
    mean, spread = prior()
    result: dict[str, Any] = {"true": ((unknowns - mean) / spread).tolist(), "fits": {}}
    laws = Laws(membrane=membrane_of(unknowns))
    coarse, fine = (drape(bending, rig=HUNG_SQUARE, edge=1e-3 * edge, seed=number, laws=laws)
                    for edge in (edge_mm, truth_mm))
    if not (coarse.converged and fine.converged):
        return result
    shapes = {True: coarse.positions,
              False: interpolate_positions(fine.rest, fine.positions, coarse.rest)}
    noise = rng.normal(0, sigma, coarse.positions.shape) * ~coarse.held[:, None]
    for name, (same, free) in FITS.items():
        problem = HungFit(coarse, shapes[same] + noise, theta, free=free, sigma=sigma)
        outcome = minimise(problem, limits=Limits(evaluations=evaluations))
        if math.isfinite(problem.value(outcome.x)) and (
                ends := problem.linearised(outcome.x)) is not None:
            residuals, jacobian = ends
            deviation = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
            result["fits"][name] = {
                "x": outcome.x[:4].tolist(), "deviation": deviation[:4].tolist(),
                "status": outcome.status.value, "evaluations": outcome.evaluations,
                "left_mm": noise_mm * rms(residuals[: -len(outcome.x)])}
    return result


def run(keys: Keys) -> Report:
    """Run all fabrics."""
    return {"spread": prior()[1].tolist(),
            "fabrics": samples_of(fabric, keys, keys.fabrics, kind="fabric")}


def _accepted_fits(report: Report, name: str) -> list[tuple[list[float], dict[str, Any]]]:
    """True unknowns and fits of the fabrics with residuals below :data:`MAX_NOISE_RATIO`."""
    limit = MAX_NOISE_RATIO * report["settings"]["noise_mm"]
    return [(one["true"], fit) for one in report["fabrics"].values()
            if (fit := one["fits"].get(name)) and fit["left_mm"] < limit]


def _errors(report: Report, name: str) -> np.ndarray:
    """Errors (N, 4) of accepted fits, in units of the standard deviation over fabrics."""
    return np.array([np.subtract(fit["x"], true) for true, fit in _accepted_fits(report, name)])


def block(report: Report) -> str:
    """Summary and table."""
    known = [name for name, error in zip(UNKNOWNS, _errors(report, [*FITS][-1]).T, strict=True)
             if rms(error) < 1 / 3]
    text = (f"With {report['settings']['noise_mm']:g} mm of noise per coordinate; errors over the "
            f"spread over fabrics are below a third in the last case for "
            f"{', '.join(known) or 'none'}. The remaining fits ended in other folds, which their "
            "residuals reveal.")
    head = ["fit", "in the true folds", "residual, mm",
            f"of {', '.join(UNKNOWNS)}: error, rms", "error, median", "bias",
            "stated standard deviation"]
    lines = []
    for name in FITS:
        errors_of, fits = _errors(report, name), [fit for _, fit in _accepted_fits(report, name)]
        if fits:
            middle = np.median(np.abs(errors_of), axis=0) * report["spread"]
            stated = np.array([fit["deviation"] for fit in fits])
            lines.append([
                name, f"{len(fits)} of {len(report['fabrics'])}",
                f"{np.median([fit['left_mm'] for fit in fits]):.2f}",
                ", ".join(f"{rms(column):.2f}" for column in errors_of.T),
                ", ".join([*(f"{100 * np.expm1(one):.0f} %" for one in middle[:3]),
                           f"{middle[3]:.2f}"]),
                ", ".join(f"{one:+.2f}" for one in errors_of.mean(axis=0)),
                ", ".join(f"{rms(column):.3f}" for column in stated.T)])
    return f"{text}\n\n{table(head, lines)}"


def draw(report: Report) -> Figure:
    """Plot estimates over true values, a panel per unknown."""
    figure = Figure(figsize=(11, 3.2), layout="constrained")
    middle, spread = prior()[0], np.array(report["spread"])
    for k, (axes, unknown) in enumerate(zip(figure.subplots(1, 4), UNKNOWNS, strict=True)):
        for colour, name in zip(("C0", "C1", "C3"), FITS, strict=True):
            pairs = np.array([(true[k], fit["x"][k])
                              for true, fit in _accepted_fits(report, name)]).reshape(-1, 2)
            pairs = middle[k] + spread[k] * pairs
            axes.plot(*(np.exp(pairs) if k < 3 else pairs).T, "o", ms=4, alpha=0.7, color=colour,
                      label=name)
        limits = [min(axes.get_xlim()[0], axes.get_ylim()[0]),
                  max(axes.get_xlim()[1], axes.get_ylim()[1])]
        axes.plot(limits, limits, color="0.6", lw=0.8)
        if k < 3:
            axes.set(xscale="log", yscale="log")
            label_log_axes(axes.xaxis, axes.yaxis)
            axes.tick_params(axis="x", labelrotation=60)
        unit = " [N/m]" if k < 3 else ""
        axes.set(title=unknown, xlabel=f"true{unit}", ylabel=f"found{unit}")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center",
                  ncols=len(FITS), fontsize=8, frameon=False)
    return figure


STUDY = Study(Keys, run, block, draw)
