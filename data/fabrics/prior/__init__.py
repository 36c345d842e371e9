"""Priors of fabrics: distributions over theta, fitted to measured fabrics.

A prior is a JSON file; its "kind" selects the class. Those in ``data/weights`` were fitted to the
distinct fabrics published with Feng et al. 2022; to fit one to another table:
``python -m data.fabrics.prior fit fabrics=FILE out=prior.json``.
"""

from data.fabrics.prior.base import (
    Prior,
    TablePrior,
    log_stiffness,
    require_fabrics,
    sample_admissible,
)
from data.fabrics.prior.coordinates import BEND, Coordinates, plausible_range
from data.fabrics.prior.files import (
    BUNDLED,
    MODELS,
    load_prior,
    prior_content,
    prior_from_content,
    save_prior,
)
from data.fabrics.prior.gaussian import GaussianPrior
from data.fabrics.prior.vae import ARCHITECTURES, Architecture, VaePrior

__all__ = [
    "ARCHITECTURES",
    "BEND",
    "BUNDLED",
    "MODELS",
    "Architecture",
    "Coordinates",
    "GaussianPrior",
    "Prior",
    "TablePrior",
    "VaePrior",
    "load_prior",
    "log_stiffness",
    "plausible_range",
    "prior_content",
    "prior_from_content",
    "require_fabrics",
    "sample_admissible",
    "save_prior",
]
