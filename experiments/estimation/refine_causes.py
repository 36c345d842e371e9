"""What costs refinement its accuracy: worlds without some of the nuisances.

Captures as those of ``refine_views variation=real``, of worlds in which a group of nuisances has
its usual value, and of one without any, are estimated by the network and by the refinement, which
know nothing of it.
"""

from pathlib import Path
from typing import Any

import numpy as np

from experiments.estimation.refine_views import ABSENT, METHODS, case, posterior_errors, with_pool
from experiments.result import ESTIMATOR, Config, Result, load_arrays, run_cases

ALL, NONE = "all", "none"


def run(config: Config) -> Result:
    """Refine the captures of all worlds."""
    folder = Path(config["cases"])
    fixed: dict[str, Any] = {key: config[key] for key in (
        "rig", "edge_mm", "truth_mm", "seed")} | {"nuisances": "real"}
    worlds = {NONE: (), **{group: (group,) for group in ABSENT}, ALL: ABSENT}
    # Fabric by fabric: what is finished can be read at any time.
    results = run_cases(case, {f"{world} {number}": fixed | {"number": number, "absent": absent}
                               for number in config["numbers"]
                               for world, absent in worlds.items()},
                        config, folder=folder, sources=ESTIMATOR)
    summary = {}
    for world in worlds:
        names = [f"{world} {number}" for number in config["numbers"]]
        truth = np.array([results[name]["theta"] for name in names])
        arrays = [with_pool(load_arrays(folder, name), gained=results[name]["gained"])
                  for name in names]
        summary[world] = {way: posterior_errors(truth, [each[way] for each in arrays])
                          for way in METHODS}
    return Result({"summary": summary, "cases": results})
