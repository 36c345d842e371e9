"""A skirt of an estimated fabric (002, section 7.4.3), in this simulator and in Newton."""


import numpy as np
from matplotlib.figure import Figure

from common.errors import InputError
from common.types import Points
from data.dataset.plan import DrapePlan
from data.fabrics.fabrics import fabric_from_theta
from data.render.setups import Setups
from experiments.comparison import Shape, compare
from experiments.drapes import capture_drape, drape_as_planned, infer, plan_specimen
from experiments.report import Report, label_log_axes, rms, table
from experiments.study import CaseKeys, Sample, Study, samples_of
from sim.equilibrium import Equilibrium
from sim.material import Fabric
from sim.measures import fold_count, shadow_radius
from sim.mesh import Mesh
from sim.rig import DISC_RIG
from sim.scene import Scene
from sim.skirt import SKIRT, settled, skirt

TRUE, ESTIMATED, LINEAR = "true", "estimated", "estimated, α alone"
OTHER_START = "true, other start"
NEWTON = ("Newton, true", "Newton, estimated")  # of the stored report
_CAPTURE_EDGE = 2e-3  # m, at the rim of the captured specimen


class Keys(CaseKeys):
    fabrics: int = 10  # drawn from the prior
    edge_mm: float = 10.0  # mesh edge length at the waist
    seed: int = 731
    workers: int = 2


def fabric(*, number: int, edge_mm: float, seed: int) -> Sample:
    """Skirts of one fabric, from its moduli and from those estimated from one depth capture.

    Of each: mean distance from the skirt of the true moduli and mean difference of their outlines
    from above, mm, and the number of folds.
    """
    plan = plan_specimen(number, rig=DISC_RIG, nuisances="real", seed=seed)
    truth, estimate = fabric_from_theta(plan.theta), estimated(plan, seed)
    hung, other = (_sound(skirt(truth, edge=1e-3 * edge_mm, seed=seed + k)) for k in (0, 1))
    worn, scene = hung.positions, hung.cloth.scene
    shapes = {OTHER_START: Shape.of(other.cloth.scene, other.positions)}
    for name, one in ((ESTIMATED, estimate), (LINEAR, Fabric(estimate.alpha))):
        shapes[name] = Shape.of(scene, _sound(settled(scene, worn, one)).positions)
    result = {name: difference(scene, worn, shape) for name, shape in shapes.items()}
    result[TRUE] = {"folds": fold_count(worn, scene.mesh.rest, SKIRT)}
    return result | {"log_alpha": np.log(estimate.alpha / truth.alpha).tolist()}


def estimated(plan: DrapePlan, seed: int) -> Fabric:
    """The network's posterior mean from four depth views of a drape with all nuisances."""
    shape = drape_as_planned(plan, edge=_CAPTURE_EDGE)
    rng = np.random.default_rng([seed, plan.fabric])
    capture = capture_drape(shape, Setups.load("real"), rng, DISC_RIG)
    return fabric_from_theta(infer(capture, DISC_RIG).estimate.theta)


def _sound(found: Equilibrium) -> Equilibrium:
    """A skirt that converged; InputError for another."""
    if not found.converged:
        raise InputError(f"a skirt did not converge ({found.message}); choose another seed=")
    return found


def difference(scene: Scene, worn: Points, other: Shape) -> dict[str, float]:
    """A skirt compared with the skirt ``worn``."""
    outlines = [shadow_radius(part.positions, Mesh(part.rest, part.faces), points=720)
                for part in (Shape.of(scene, worn), other)]
    return {"distance_mm": 1e3 * compare(Shape.of(scene, worn), other).displacement,
            "outline_mm": 1e3 * float(np.abs(outlines[1] - outlines[0]).mean()),
            "coverage_percent": 100 * float(np.square(outlines[1]).sum()
                                            / np.square(outlines[0]).sum() - 1),
            "folds": fold_count(other.positions, other.rest, SKIRT)}


def run(keys: Keys) -> Report:
    """Run all fabrics."""
    return {"fabrics": samples_of(fabric, keys, keys.fabrics, kind="fabric")}


def _column(report: Report, model: str, key: str) -> np.ndarray:
    """Values of all fabrics that have this model."""
    return np.array([one[model][key] for one in report["fabrics"].values() if model in one])


def block(report: Report) -> str:
    """Summary and table."""
    errors = [one["log_alpha"] for one in report["fabrics"].values()]
    text = (f"The estimates' errors of log α are {rms(errors):.2f} (rms); distances are from the "
            "skirt of the true moduli.")
    folds = _column(report, TRUE, "folds")
    rows = []
    for model in (ESTIMATED, LINEAR, OTHER_START, *NEWTON):
        distance = _column(report, model, "distance_mm")
        if len(distance):
            change = _column(report, model, "folds") - folds[:len(distance)]
            rows.append([
                model, len(distance), f"{np.median(distance):.1f}, {distance.max():.1f}",
                f"{np.median(_column(report, model, 'outline_mm')):.1f}",
                f"{np.median(_column(report, model, 'coverage_percent')):+.1f}",
                f"{np.abs(change).mean():.1f}"])
    head = ["moduli", "skirts", "distance, mm: median, largest", "outline, mm", "covered area, %",
            f"folds, of {folds.mean():.1f}"]
    return f"{text}\n\n{table(head, rows)}"


def draw(report: Report) -> Figure:
    """Plot distances against the error of the moduli."""
    figure = Figure(figsize=(6, 3.6), layout="constrained")
    axes = figure.subplots()
    errors = [rms(np.array(one["log_alpha"])) for one in report["fabrics"].values()]
    for model, marker in ((ESTIMATED, "o"), (LINEAR, "^"), (OTHER_START, "s")):
        axes.plot(errors, _column(report, model, "distance_mm"), marker, label=model)
    axes.set(xlabel="error of log α, rms over directions", ylabel="distance of skirts [mm]",
             yscale="log")
    label_log_axes(axes.yaxis)
    axes.legend(fontsize=8, frameon=False)
    return figure


STUDY = Study(Keys, run, block, draw)
