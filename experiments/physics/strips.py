"""Non-linear and anisotropic strips, and plates, compared with theory.

1. Strips with beta < 0 and beta > 0, compared with the non-linear heavy elastica.
2. Strips cut at 0 to 90 degrees from anisotropic fabrics: *guided*, constrained to cylinders,
   compared with k(phi) of the law, and *free*, as in a tester.
3. Square plates under a small uniform load on finer and finer meshes, compared with series
   solutions.
"""

import numpy as np

from common.errors import InputError
from experiments.physics.guides import guided
from experiments.result import Config, Result, run_cases
from sim.cantilever import aspect_ratio, gamma_of_aspect_ratio, hang, heavy_elastica
from sim.cantilever.elastica import strip_shape
from sim.cantilever.strip import HungStrip
from sim.cloth import Laws
from sim.energies import bending_law
from sim.energies.hinges import modulus_along
from sim.energies.membrane import Corotational
from sim.equilibrium import find_equilibrium
from sim.material import MICRO, REFERENCE_DENSITY, Fabric, gravity_length, plate_constants
from sim.mesh import Mesh, choose_diagonals, grid_faces, grid_points
from sim.rig import GRAVITY
from sim.scene import Scene
from sim.solver.newton import NewtonOptions, Status

_SMALL = 0.01  # reduced curvature below the softening limit of every term of the law


def tabulated_law(curvature: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Linear pieces (4, K - 1) through curvatures (K,) from 0, 1/m, and torques (K,), N."""
    rise = np.diff(torque)
    if not (rise > 0).all():
        raise InputError("the torque must increase with the curvature")
    return np.stack([curvature[:-1], torque[:-1], rise / np.diff(curvature), np.zeros_like(rise)])


def cylinder_torque(fabric: Fabric, angle: float, curvature: np.ndarray) -> np.ndarray:
    """Torque (K,), N, per width of cylinders of ``curvature`` (K,), 1/m, at ``angle``, rad.

    The derivative of the plate's energy (:mod:`sim.energies.bending_law`) with respect to kappa.
    """
    law = bending_law.constants(fabric)
    cos, sin = np.cos(angle), np.sin(angle)
    direction = np.array([cos**2, sin**2, cos * sin])
    bent = curvature[:, None] * direction
    return bending_law.respond(bent, np.zeros_like(bent), law, bending_law.PLAIN)[1] @ direction


def cylinder_moduli(fabric: Fabric, angle: float) -> tuple[float, float]:
    """k(phi): alpha, N·m, and beta, N·m², of a cylinder bent along ``angle`` (rad from warp).

    Its torque is alpha kappa + beta kappa² up to the softening limit in warp, bias and weft, and
    in other directions as long as no term of the law has reached its limit.
    """
    kappa = _SMALL / max(np.abs(fabric.beta / fabric.alpha).max(), 1e-6)
    once, twice = cylinder_torque(fabric, angle, np.array([kappa, 2 * kappa]))
    return float((4 * once - twice) / (2 * kappa)), float((twice - 2 * once) / (2 * kappa**2))


def free_modulus(fabric: Fabric, angle: float) -> float:
    """Linear modulus, N·m, of a narrow free strip along ``angle``, rad, for small deflections.

    1/(m D^-1 m) with the plate's stiffness D (3, 3) for (Sxx, Syy, Sxy) and the components m of a
    unit moment along the strip: the other two moments are zero.
    """
    a11, a22, a12, a66 = plate_constants(fabric.alpha)
    stiffness = np.array([[a11, a12, 0.0], [a12, a22, 0.0], [0.0, 0.0, 4 * a66]])
    cos, sin = np.cos(angle), np.sin(angle)
    moments = np.array([cos**2, sin**2, 2 * cos * sin])
    return float(1 / (moments @ np.linalg.solve(stiffness, moments)))


SIDE = 0.1  # m
SMALL_GRAVITY = 1e-3 * GRAVITY
SOFT_MEMBRANE = 1.0
"""N/m, for the small gravity: the membrane bears no load, and its rounding errors are small."""

CLAMPED = 0.00126532  # centre deflection of a clamped isotropic square plate, times q a⁴/D
PLATES = {
    "supported, isotropic": ((30e-6, 30e-6, 30e-6), False),
    "supported, orthotropic": ((30e-6, 20e-6, 15e-6), False),
    "clamped, isotropic": ((30e-6, 30e-6, 30e-6), True),
}
"""alpha in warp, bias and weft, N·m, and whether the sides are clamped (else simply supported)."""


def plate(*, kind: str, cells: int) -> dict:
    """Relative error of the deflection at the centre of a plate of ``cells`` by ``cells``."""
    alpha, clamped = PLATES[kind]
    fabric = Fabric(np.array(alpha))
    ring = 1 if clamped else 0
    shape = (cells + 1 + 2 * ring,) * 2
    step = SIDE / cells
    points = grid_points(shape, (SIDE + 2 * ring * step,) * 2, 0.0, np.random.default_rng(0))
    points -= ring * step
    # With an even number of cells the diagonals cut the corners, so that only triangles of the
    # clamped ring have all vertices held.
    faces = grid_faces(choose_diagonals(shape, "alternating", np.random.default_rng(0)))
    mesh = Mesh(rest=points.reshape(-1, 2), faces=faces)
    inside = ((mesh.rest > 0.5 * step) & (mesh.rest < SIDE - 0.5 * step)).all(axis=1)
    flat = np.column_stack([mesh.rest, np.zeros(len(mesh.rest))])
    scene = Scene(mesh=mesh, held=~inside, gravity=SMALL_GRAVITY)
    found = find_equilibrium(
        scene, fabric, scene.state(flat),
        laws=Laws(membrane=Corotational(SOFT_MEMBRANE)),
        options=NewtonOptions(residual=1e-6, step=1e-6),
    )
    if not found.converged:
        raise InputError(f"the plate '{kind}' does not converge: {found.message}")
    middle = np.argmin(np.linalg.norm(mesh.rest - SIDE / 2, axis=1))
    load = REFERENCE_DENSITY * SMALL_GRAVITY
    exact = load * SIDE**4 * (CLAMPED / fabric.alpha[0] if clamped else navier(fabric))
    deflection = -float(found.state.positions[middle, 2])
    return {"kind": kind, "cells": cells, "error": float(deflection / exact - 1)}


def navier(fabric: Fabric) -> float:
    """Deflection at the centre of a simply supported square plate, divided by q a⁴, 1/(N·m)."""
    a11, a22, a12, a66 = plate_constants(fabric.alpha)
    m = np.arange(1, 400, 2)[:, None]
    n = m.T
    sign = np.where((m + n) // 2 % 2 == 1, 1.0, -1.0)
    form = a11 * m**4 + 2 * (a12 + 2 * a66) * m**2 * n**2 + a22 * n**4
    return float((16 * sign / (np.pi**6 * m * n * form)).sum())


LENGTH, WIDTH = 0.09, 0.03  # m
WEIGHT = REFERENCE_DENSITY * GRAVITY
MAX_CURVATURE = 400.0  # 1/m, above that of any strip
GAMMAS = (1.0, 10.0, 50.0, 200.0)
RATIOS = (-4.0, -2.0, 2.0, 4.0)  # beta/alpha, mm
ANGLES = (0.0, 22.5, 45.0, 67.5, 90.0)  # degrees
FABRICS = {
    "mild": ((30.0, 20.0, 15.0), (0.0, 0.0, 0.0)),
    "soft bias": ((60.0, 20.0, 15.0), (0.0, 0.0, 0.0)),
    "negative A12": ((40.0, 12.0, 30.0), (0.0, 0.0, 0.0)),
    "softening": ((30.0, 20.0, 15.0), (-3.0, -3.0, -2.0)),
    "bias softens most": ((30.0, 20.0, 15.0), (-2.0, -4.0, -1.0)),
}
"""alpha in µN·m and beta/alpha in mm, in warp, bias and weft."""


def make_fabric(name: str) -> Fabric:
    """Fabric ``name`` of :data:`FABRICS`."""
    alpha, ratio = (np.array(values) for values in FABRICS[name])
    return Fabric(alpha=alpha * MICRO, beta=1e-3 * ratio * alpha * MICRO)


def strip_modulus(strip: HungStrip, gravity: float = GRAVITY) -> dict:
    """H/W of a strip, and the modulus, µN·m, of the linear elastica with the same H/W."""
    if strip.result.status is not Status.CONVERGED:
        return {"status": strip.result.status.value}
    ratio = aspect_ratio(strip.curve[-1])
    return {
        "status": "converged",
        "aspect_ratio": ratio,
        "modulus": apparent_modulus(ratio, gravity) / MICRO,
        "twist": strip.twist,
    }


def apparent_modulus(ratio: float, gravity: float = GRAVITY) -> float:
    """alpha, N·m, of a linear fabric whose strip of :data:`LENGTH` has this H/W."""
    return REFERENCE_DENSITY * gravity * LENGTH**3 / gamma_of_aspect_ratio(ratio)


def edge_for(alpha: float, cells: int) -> float:
    """Mesh edge, m, with at least ``cells`` per bending length and an integer number in all."""
    spacing = min(gravity_length(alpha, REFERENCE_DENSITY) / cells, LENGTH / 40)
    return LENGTH / np.ceil(LENGTH / spacing)


def nonlinear(*, gamma: float, ratio: float, cells: int) -> dict:
    """Compare an isotropic strip of beta/alpha = ``ratio`` mm with its elastica."""
    alpha = WEIGHT * LENGTH**3 / gamma
    beta = 1e-3 * ratio * alpha
    edge = edge_for(alpha, cells)
    fabric = Fabric(np.full(3, alpha), np.full(3, beta))
    result = strip_modulus(hang(fabric, length=LENGTH, width=6 * edge, edge=edge))
    theory = {
        "elastica": aspect_ratio(heavy_elastica(alpha, beta, weight=WEIGHT, length=LENGTH)[-1]),
        "linear_elastica": aspect_ratio(
            heavy_elastica(alpha, 0.0, weight=WEIGHT, length=LENGTH)[-1]
        ),
    }
    return {"gamma": gamma, "ratio_mm": ratio, **result, **theory}


def angled(*, fabric: str, angle: float, cells: int) -> dict:
    """Moduli, µN·m, of a strip cut at ``angle`` degrees, guided and free."""
    cloth, radians = make_fabric(fabric), float(np.radians(angle))
    alpha, _ = cylinder_moduli(cloth, radians)
    edge = edge_for(alpha, cells)
    options = {"angle": radians, "length": LENGTH, "edge": edge}
    shapes = {
        "guided": hang(cloth, **options, width=4 * edge, laws=guided(Laws(), 4)),
        "free": hang(cloth, **options, width=WIDTH, across=max(10, round(WIDTH / (2 * edge)))),
    }
    curvature = np.linspace(0, MAX_CURVATURE, 4001)
    law = tabulated_law(curvature, cylinder_torque(cloth, radians, curvature))
    cylinder = strip_shape(law, weight=WEIGHT, length=LENGTH)
    result: dict = {
        "fabric": fabric,
        "angle": angle,
        "alpha": alpha / MICRO,
        "apparent": apparent_modulus(aspect_ratio(cylinder[-1])) / MICRO,
        "eq8": float(modulus_along(cloth.alpha, np.array(radians))) / MICRO,
    }
    for name, strip in shapes.items():
        result[name] = strip_modulus(strip)
    return result


def run_case(*, part: str, **settings) -> dict:
    """Run a case of one of the three parts."""
    return {"nonlinear": nonlinear, "angled": angled, "plate": plate}[part](**settings)


def run(config: Config) -> Result:
    """Compare strips and plates with theory."""
    if any(n < 4 or n % 2 for n in config["plates"]):
        raise InputError(f"plates={config['plates']} must be even numbers of cells, at least 4")
    cells = config["cells"]
    cases = {f"gamma{gamma:g}_ratio{ratio:g}":
             {"part": "nonlinear", "gamma": gamma, "ratio": ratio, "cells": cells}
             for gamma in GAMMAS for ratio in RATIOS}
    cases |= {f"{fabric.replace(' ', '_')}_{angle:g}":
              {"part": "angled", "fabric": fabric, "angle": angle, "cells": cells}
              for fabric in FABRICS for angle in ANGLES}
    cases |= {f"{kind.replace(', ', '_')}_{n}": {"part": "plate", "kind": kind, "cells": n}
              for kind in PLATES for n in config["plates"]}
    results = run_cases(run_case, cases, config)
    parts = {part: [results[name] for name, case in cases.items() if case["part"] == part]
             for part in ("nonlinear", "angled", "plate")}
    bent = [{**r, "deviation": r["aspect_ratio"] / r["elastica"] - 1}
            for r in parts["nonlinear"] if "aspect_ratio" in r]
    cut = [{**r, "deviation": r["guided"]["modulus"] / r["apparent"] - 1}
           for r in parts["angled"] if "modulus" in r["guided"]]
    plates = {kind: [(r["cells"], r["error"]) for r in parts["plate"] if r["kind"] == kind]
              for kind in PLATES}
    return Result({"nonlinear": bent, "angled": cut, "plates": plates})
