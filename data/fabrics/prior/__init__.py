"""Priors of fabrics: distributions over theta, fitted to measured fabrics.

A prior is a JSON file; its "kind" selects the class. Those in ``data/weights`` were fitted to the
distinct fabrics published with Feng et al. 2022; to fit one to another table:
``python -m data.fabrics.prior fit fabrics=FILE out=prior.json``.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from common.documents import read_json
from common.errors import InputError, one_line, shown
from common.files import replace_json
from common.types import Theta
from data.fabrics.fabrics import THETA_NAMES
from data.fabrics.prior.base import (
    Prior,
    TablePrior,
    log_stiffness,
    require_fabrics,
    sample_admissible,
)
from data.fabrics.prior.gaussian import GaussianPrior
from data.fabrics.prior.vae import (
    ARCHITECTURES,
    BEND,
    Architecture,
    Coordinates,
    VaePrior,
    plausible_range,
)

__all__ = ["ARCHITECTURES", "BEND", "BUNDLED", "MODELS", "Architecture", "Coordinates",
           "GaussianPrior", "Prior", "TablePrior", "VaePrior", "load_prior", "log_stiffness",
           "plausible_range", "prior_content", "prior_from_content", "require_fabrics",
           "sample_admissible", "save_prior"]

SCHEMA_VERSION = 1
WEIGHTS = Path(__file__).resolve().parents[2] / "weights"
BUNDLED = ("gaussian", "vae")
"""Names of the priors that ship with the project, ``data/weights/NAME.json``."""
KINDS = {kind.kind: kind for kind in (GaussianPrior, VaePrior, TablePrior)}

MODELS: dict[str, Callable[[Theta], Prior]] = {
    "gaussian": GaussianPrior.fit,
    **{name: partial(VaePrior.fit, architecture=architecture)
       for name, architecture in ARCHITECTURES.items()},
}
"""Functions that fit each model to distinct fabrics."""


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
    if not (isinstance(content, dict) and isinstance(kind := content.get("kind"), str)
            and kind in KINDS):
        raise InputError(f"{origin} is not a prior; its \"kind\" must be one of {', '.join(KINDS)}")
    if content.get("schema_version") != SCHEMA_VERSION:
        raise InputError(f"{origin} has the schema version {shown(content.get('schema_version'))}; "
                         f"this program reads version {SCHEMA_VERSION}: fit it again")
    if content.get("parameters") != list(THETA_NAMES):
        raise InputError(f"{origin} describes other parameters than {', '.join(THETA_NAMES)}; fit "
                         "it again")
    try:
        return TypeAdapter(KINDS[kind]).validate_python(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        cause = first.get("ctx", {}).get("error", first["msg"])
        place = ".".join(map(str, first["loc"]))
        raise InputError(f"{origin}: {place}: {one_line(Exception(cause))}; fit it again") from None


def save_prior(prior: Prior, path: str | Path) -> None:
    """Write the prior's JSON file in one step; an existing file is replaced."""
    replace_json(Path(path), prior_content(prior))


def load_prior(name: str | Path) -> Prior:
    """Read a prior: one of :data:`BUNDLED` by name, or a file."""
    path = WEIGHTS / f"{name}.json" if name in BUNDLED else Path(name)
    remedy = f"give the file of a prior; the bundled ones are {', '.join(BUNDLED)}"
    return prior_from_content(read_json(path, remedy=remedy), origin=str(path))
