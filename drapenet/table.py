"""Estimates in the units that people see, for files and for the terminal."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from drapenet.convention import LINEAR, RATIO
from sim.material import MICRO, NANO, Fabric


def moduli_table(names: Sequence[str], fabric: Fabric) -> dict[str, dict[str, float]]:
    """The moduli by direction, in the units that people see."""
    return {name: {"alpha_uN_m": alpha / MICRO, "beta_nN_m2": beta / NANO}
            for name, alpha, beta in zip(names, fabric.alpha.tolist(), fabric.beta.tolist(),
                                         strict=True)}


def error_table(names: Sequence[str], errors: np.ndarray) -> dict[str, dict[str, float]]:
    """Standard errors (6,) of theta by direction, in the units that people see."""
    return {name: {"alpha_percent": 100 * math.expm1(log_alpha), "beta_over_alpha_mm": 1e3 * ratio}
            for name, log_alpha, ratio in zip(names, errors[LINEAR].tolist(),
                                              errors[RATIO].tolist(), strict=True)}


def format_table(content: dict[str, Any]) -> str:
    """The content of ``estimate.json`` as lines for a terminal."""
    density = content["capture"]["density_g_m2"]
    lines = [f"{'':8}{f'at {density:g} g/m²':^29}{'at 300 g/m²':^29}{'typical error':^16}",
             f"{'':8}{'alpha [µN·m]':>14}{'beta [nN·m²]':>15}{'alpha [µN·m]':>14}"
             f"{'beta [nN·m²]':>15}{'of alpha':>12}"]
    for name, own in content["moduli"].items():
        at_reference = content["moduli_at_300_g_m2"][name]
        error = content["typical_error"][name]["alpha_percent"]
        lines.append(f"{name:8}{own['alpha_uN_m']:14.2f}{own['beta_nN_m2']:15.1f}"
                     f"{at_reference['alpha_uN_m']:14.2f}{at_reference['beta_nN_m2']:15.1f}"
                     f"{error:11.0f}%")
    if refined := content.get("refined"):
        before = ", ".join(f"{name} {change['alpha_before_uN_m']:.2f} "
                           f"({change['alpha_percent']:+.0f}%)"
                           for name, change in refined["change"].items())
        lines.append(f"alpha before refinement: {before}")
        first = refined["misfit_before"]
        lines.append(f"misfit {'-' if first is None else format(first, '.0f')} before, "
                     f"{refined['misfit']:.0f} after {refined['simulations']} simulations "
                     f"({refined['status']})")
    axis = content["stiff_axis"]
    lines.append(f"stiff axis {axis['direction_deg']:.0f}° in the first view "
                 f"(confidence {axis['confidence']:.2f}), convention {content['convention']}")
    return "\n".join(lines + [f"warning: {line}" for line in content["warnings"]])
