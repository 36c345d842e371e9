"""Estimates and documents of fabrics known almost exactly."""

import numpy as np

from common.findings import Finding
from data.fabrics.fabrics import ClothProperties, to_theta
from drapenet.result.document import EstimateDocument
from drapenet.result.estimate import Estimate
from sim.material import DIRECTIONS, REFERENCE_DENSITY

DOUBT = Finding("pixel_on_plate_large", {"value": 2.9, "limit": 2.6})
CHECKPOINT = {"file": "net.safetensors", "sha256": "0" * 64, "dataset_sha256": "0" * 64}


def estimate_of(
    alpha: np.ndarray, beta: np.ndarray, *, density: float = 0.21,
    names: tuple[str, str, str] = DIRECTIONS, deviation: float = 1e-6,
) -> Estimate:
    """Samples whose medians are alpha, N·m, and beta, N·m², of a fabric of this density, kg/m²."""
    scale = REFERENCE_DENSITY / density
    theta = to_theta(np.asarray(alpha) * scale, np.asarray(beta) * scale)
    steps = deviation * np.vstack([np.eye(6), -np.eye(6)]) * [1, 1, 1, 3e-3, 3e-3, 3e-3]
    samples = theta + np.vstack([np.zeros(6), steps])
    count = len(samples)
    cloth = ClothProperties(samples, np.zeros((count, 2)), np.full(count, 600.0),
                            np.full(count, 0.2))
    return Estimate(cloth, names, density, np.array([0.9] * 3 + [1.4e-3] * 3 + [0.5]))


def document_of(estimate: Estimate, **options: object) -> EstimateDocument:
    """The document of an estimate of the capture ``twill``."""
    about = {"source": "twill", "rig": "square300_cylinder100", "views_sha256": "0",
             "density_g_m2": round(1e3 * estimate.density, 6)}
    return EstimateDocument.from_estimate(
        estimate, **{"capture": about, "checkpoint": CHECKPOINT} | options)
