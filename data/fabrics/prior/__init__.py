"""Priors of fabrics: distributions over theta, fitted to measured fabrics.

A prior is a JSON file; its "kind" selects the class: one normal distribution (:mod:`gaussian`), a
mixture (:mod:`mixture`), a variational autoencoder (:mod:`vae`) or the fabrics of a table
(:mod:`table`). Those in ``data/weights`` were
fitted to the distinct fabrics published with Feng et al. 2022. To fit one to another table:

    python -m data.fabrics.prior fit fabrics=FILE out=prior.json
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from common.documents import read_json, shown
from common.errors import InputError
from common.files import replace_json
from data.fabrics.fabrics import THETA_NAMES, from_theta
from data.fabrics.prior.base import Prior
from data.fabrics.prior.gaussian import GaussianPrior
from data.fabrics.prior.mixture import MixturePrior
from data.fabrics.prior.table import TablePrior
from data.fabrics.prior.vae import ARCHITECTURES, VaePrior
from sim.material import is_admissible

SCHEMA_VERSION = 1
WEIGHTS = Path(__file__).resolve().parents[2] / "weights"
BUNDLED = ("gaussian", "mixture", "vae")
"""Names of the priors that ship with the project, ``data/weights/NAME.json``."""
MAX_TRIES = 10_000

KINDS = {kind.kind: kind for kind in (GaussianPrior, MixturePrior, VaePrior, TablePrior)}

MODELS: dict[str, Callable[[np.ndarray], Prior]] = {
    "gaussian": GaussianPrior.fit,
    **{f"gmm{k}": partial(MixturePrior.fit, components=k) for k in range(3, 8)},
    **{name: partial(VaePrior.fit, architecture=architecture)
       for name, architecture in ARCHITECTURES.items()},
}
"""Functions that fit each model to distinct fabrics theta (F, 6): those of Table 1 of Feng et al.
2022, and the Gaussian."""


def prior_content(prior: Prior) -> dict:
    """Content of a prior's JSON file."""
    return {
        "schema_version": SCHEMA_VERSION,
        "kind": prior.kind,
        "parameters": list(THETA_NAMES),
        "units": "alpha in N·m, beta/alpha in m, at 300 g/m²",
        **prior.as_dict(),
    }


def prior_from_content(content: object, *, origin: str) -> Prior:
    """The prior of a decoded JSON file; ``origin`` names the file in error messages."""
    kind = content.get("kind") if isinstance(content, dict) else None
    if not isinstance(kind, str) or kind not in KINDS:
        raise InputError(f"{origin} is not a prior; its \"kind\" must be one of {', '.join(KINDS)}")
    if content.get("schema_version") != SCHEMA_VERSION:
        raise InputError(f"{origin} has the schema version {shown(content.get('schema_version'))}; "
                         f"this program reads version {SCHEMA_VERSION}: fit it again")
    if content.get("parameters") != list(THETA_NAMES):
        raise InputError(f"{origin} describes other parameters than {', '.join(THETA_NAMES)}; fit "
                         "it again")
    try:
        return KINDS[kind].from_dict(content)
    except InputError as error:
        raise InputError(f"{origin}: {error}; fit it again") from None


def save_prior(prior: Prior, path: str | Path) -> None:
    """Write the prior's JSON file in one step; an existing file is replaced."""
    replace_json(Path(path), prior_content(prior))


def load_prior(name: str | Path) -> Prior:
    """Read a prior: one of :data:`BUNDLED` by name, or a file.

    Raises:
        InputError: no such file, or not a prior.
    """
    path = WEIGHTS / f"{name}.json" if name in BUNDLED else Path(name)
    remedy = f"give the file of a prior; the bundled ones are {', '.join(BUNDLED)}"
    return prior_from_content(read_json(path, remedy=remedy), origin=str(path))


def sample_admissible(prior: Prior, rng: np.random.Generator) -> tuple[np.ndarray, int]:
    """Draw theta (6,) until its moduli are admissible; return also the number of rejected samples.

    Moduli are admissible if the plate is stable: linear moduli are positive, so that alpha by Feng
    et al. 2022, Eq. 8, is positive in all directions, and the bias modulus is above
    :func:`sim.material.bias_limit`. The torque is then positive at every curvature, because the law
    departs from the parabola before its peak (:func:`sim.material.torque`).

    Raises:
        InputError: none of the first ``MAX_TRIES`` samples is admissible.
    """
    for rejected in range(MAX_TRIES):
        theta = prior.sample(1, rng)[0]
        if is_admissible(*from_theta(theta)):
            return theta, rejected
    raise InputError(f"none of {MAX_TRIES} samples of the prior is a possible fabric; fit it "
                     "to more fabrics")
