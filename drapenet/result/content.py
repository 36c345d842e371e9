"""The content of ``estimate.json``; keys state their units."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from drapenet.result.estimate import INTERVALS, Estimate, modulus_names, quantiles, summary
from drapenet.result.laboratory import laboratory
from sim.material import MICRO, NANO, REFERENCE_DENSITY, torque

SCHEMA = "drapenet-estimate"
SCHEMA_VERSION = 2
POORLY_CONSTRAINED = 0.7
"""Minimum ratio of a modulus's standard deviation to its spread over fabrics for which the modulus
is reported as poorly constrained."""
CURVATURES = np.array([25.0, 50.0, 100.0, 200.0, 400.0])  # 1/m, of the tabulated law


@dataclass(frozen=True)
class Result:
    """Result of a capture, or of several captures of a fabric.

    Attributes:
        estimate: with all warnings, including those of capture and refinement.
        content: of ``estimate.json``.
        files: report files, bytes by name (:data:`drapenet.result.output.SHOWN`); empty if no
        report was
            requested.
    """

    estimate: Estimate
    content: dict[str, Any]
    files: dict[str, bytes] = field(default_factory=dict)


def to_json(
    estimate: Estimate, *, capture: dict[str, Any], source: dict[str, Any]
) -> dict[str, Any]:
    """The content of ``estimate.json``.

    Args:
        capture: description of the capture: folder or file, density, rig.
        source: further top-level keys, such as ``checkpoint``.
    """
    names = estimate.names
    poor = [name for name, share in zip(modulus_names(names), estimate.constraint, strict=True)
            if share > POORLY_CONSTRAINED]
    torques = {name: _law(estimate, k) for k, name in enumerate(names)}
    return {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "convention": estimate.convention,
        "capture": capture,
        "moduli": interval_table(estimate, estimate.density),
        "moduli_at_300_g_m2": interval_table(estimate, REFERENCE_DENSITY),
        "laboratory": laboratory(estimate),
        "correlations": {
            "of": [f"{'log ' if k < 3 else ''}{name}"
                   for k, name in enumerate(modulus_names(names))],
            "matrix": np.corrcoef(estimate.samples.T).round(3).tolist(),
        },
        "share_of_spread_over_fabrics": dict(zip(modulus_names(names),
                                                 estimate.constraint.round(3).tolist(),
                                                 strict=True)),
        "poorly_constrained": poor,
        "torque_mN": {"curvature_1_m": CURVATURES.tolist(), **torques},
        f"{names[0]}_axis": {
            "direction_deg": float(np.degrees(estimate.axis)),
            "meaning": "in the first view, 0 to the right, 90 away from the camera, modulo 180",
            "probability": round(estimate.certainty, 3),
        },
        **source,
        "warnings": list(estimate.warnings),
    }


def interval_table(estimate: Estimate, density: float) -> dict[str, dict[str, Any]]:
    """Medians and intervals of the moduli by direction, in the units of reports.

    ``density``: kg/m².
    """
    alpha, beta = estimate.moduli(density)
    units = {"alpha_uN_m": alpha / MICRO, "beta_nN_m2": beta / NANO,
             "beta_over_alpha_mm": 1e3 * beta / alpha}
    return {name: {unit: summary(values[:, k]) for unit, values in units.items()}
            for k, name in enumerate(estimate.names)}


def torque_samples(estimate: Estimate, direction: int, curvature: np.ndarray) -> np.ndarray:
    """(S, C) torque per width, N, of each sample at ``curvature`` (C,), 1/m."""
    alpha, beta = (part[:, direction, None] for part in estimate.moduli(estimate.density))
    return torque(curvature, alpha, beta)


def _law(estimate: Estimate, direction: int) -> dict[str, Any]:
    values = torque_samples(estimate, direction, CURVATURES) * 1e3
    return {"median": np.median(values, axis=0).tolist(),
            **{key: np.transpose([quantiles(column, level) for column in values.T]).tolist()
               for key, level in INTERVALS.items()}}
