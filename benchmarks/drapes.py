"""Time drapes on one core: ``python -m benchmarks.drapes [resolution=51] [out=FILE]``.

For a stiff, a median and a soft fabric: seconds, Newton steps and where the time went.
"""

import json
import os
import platform
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np

from sim.cli import parse_overrides, run_command
from sim.drape import drape
from sim.files import replace_file
from sim.linear import available_solvers
from sim.material import Fabric

ALPHAS = (100.0, 20.0, 5.0)  # µN·m, isotropic, beta/alpha = -2 mm


def machine() -> dict:
    """Hardware and versions."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "numba", "scipy", "torch")},
    }


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            return next(line.split(":")[1].strip() for line in file if "model name" in line)
    except (OSError, StopIteration):
        return platform.processor()


def main(argv: list[str]) -> None:
    """Run, print the JSON, and write it to ``out`` if given."""
    config = parse_overrides({"resolution": 51, "out": ""}, argv)
    drape(Fabric(np.full(3, 1e-4)), resolution=16)  # compiles or loads the kernels
    runs = []
    for alpha in ALPHAS:
        moduli = np.full(3, alpha * 1e-6)
        began = time.process_time()
        result = drape(Fabric(moduli, -2e-3 * moduli), resolution=config["resolution"])
        runs.append(
            {
                "alpha_uN_m": alpha,
                "status": result.status.value,
                "cpu_seconds": round(time.process_time() - began, 2),
                "newton_steps": result.iterations,
                "seconds_by_activity": {k: round(v, 2) for k, v in result.time_spent.items()},
            }
        )
    report = {
        "machine": machine(),
        "dtype": "float64",
        "linear_solver": available_solvers()[0],
        "resolution": config["resolution"],
        "runs": runs,
    }
    text = json.dumps(report, indent=2)
    print(text)
    if config["out"]:
        replace_file(Path(config["out"]), (text + "\n").encode())


if __name__ == "__main__":
    run_command(main)
