"""Which fabrics exist: distributions over theta, fitted to measured fabrics.

A prior is a JSON file; its "kind" selects the class: one normal distribution (:mod:`gaussian`), a
mixture (:mod:`mixture`) or a variational autoencoder (:mod:`vae`). Those in ``data/weights`` were
fitted to the distinct fabrics published with Feng et al. 2022; to fit one to another table,

    python -m data.prior fit fabrics=FILE out=prior.json
"""

from data.prior.base import Prior
from data.prior.files import (
    BUNDLED,
    MODELS,
    load_prior,
    prior_content,
    prior_from_content,
    sample_admissible,
    save_prior,
)
from data.prior.gaussian import GaussianPrior
from data.prior.mixture import MixturePrior
from data.prior.vae import VaePrior

__all__ = [
    "BUNDLED",
    "MODELS",
    "GaussianPrior",
    "MixturePrior",
    "Prior",
    "VaePrior",
    "load_prior",
    "prior_content",
    "prior_from_content",
    "sample_admissible",
    "save_prior",
]
