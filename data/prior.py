"""Which fabrics exist: distributions over theta, fitted to measured fabrics.

A prior is a JSON file; its "kind" selects the class (:data:`KINDS`), so that richer models can
stand behind the same four methods. The Gaussian shipped in ``data/weights/gaussian.json`` was
fitted to the distinct fabrics published with Feng et al. 2022; the command to fit another is

    python -m data.prior fit table=fabrics.csv out=prior.json
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Protocol

import numpy as np

from data.fabrics import THETA_NAMES, from_theta, read_fabric_table
from sim.cli import parse_overrides, run_command
from sim.errors import InputError
from sim.files import replace_file
from sim.material import is_admissible

SCHEMA_VERSION = 1
BUNDLED = Path(__file__).parent / "weights" / "gaussian.json"
MAXIMUM_TRIES = 10_000


class Prior(Protocol):
    """A distribution over theta (see :mod:`data.fabrics`)."""

    kind: ClassVar[str]

    @classmethod
    def fit(cls, theta: np.ndarray) -> "Prior":
        """Fit to the distinct fabrics theta (F, 6)."""

    def sample(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draw theta (n, 6), admissible or not."""

    def log_likelihood(self, theta: np.ndarray) -> np.ndarray:
        """Log density (n,) of theta (n, 6), per unit of theta."""

    def as_dict(self) -> dict:
        """All parameters, in JSON's types."""

    @classmethod
    def from_dict(cls, content: dict) -> "Prior":
        """The inverse of :meth:`as_dict`; InputError where a parameter makes no sense."""


@dataclass(frozen=True)
class GaussianPrior:
    """A normal distribution of theta.

    Attributes:
        mean: (6,) mean of theta.
        covariance: (6, 6) covariance of theta, positive definite.
        fabrics: number of fabrics it was fitted to.
    """

    mean: np.ndarray
    covariance: np.ndarray
    fabrics: int
    kind: ClassVar[str] = "gaussian"

    TAIL: ClassVar[float] = 0.01
    """Share of the fabrics at each end of each parameter that is moved to that quantile before
    fitting. Cantilever tests of very limp cloth give a few beta/alpha many deviations away (one
    of +40 mm among 201, all others between -17 and +1), which would otherwise triple the spread
    along the warp and make one fabric in ten stiffen when bent instead of one in a hundred."""

    @classmethod
    def fit(cls, theta: np.ndarray) -> "GaussianPrior":
        """Fit to the distinct fabrics theta (F, 6), F > 6, the tails drawn in by ``TAIL``."""
        theta = np.asarray(theta, dtype=np.float64)
        if theta.ndim != 2 or theta.shape[1] != 6 or len(theta) <= 6:
            raise InputError(f"a prior needs more than 6 distinct fabrics, not {len(theta)}")
        low, high = np.quantile(theta, [cls.TAIL, 1 - cls.TAIL], axis=0)
        drawn_in = np.clip(theta, low, high)
        return cls(drawn_in.mean(axis=0), np.cov(drawn_in.T), len(theta))

    def sample(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draw theta (n, 6), admissible or not."""
        # The factor is fixed here (numpy's own choice of factorisation may change).
        factor = np.linalg.cholesky(self.covariance)
        return self.mean + rng.standard_normal((n, 6)) @ factor.T

    def log_likelihood(self, theta: np.ndarray) -> np.ndarray:
        """Log density (n,) of theta (n, 6), per unit of theta."""
        factor = np.linalg.cholesky(self.covariance)
        white = np.linalg.solve(factor, (np.atleast_2d(theta) - self.mean).T)
        log_volume = np.log(np.diag(factor)).sum() + 3 * np.log(2 * np.pi)
        return -0.5 * (white**2).sum(axis=0) - log_volume

    def as_dict(self) -> dict:
        """All parameters, in JSON's types."""
        return {
            "mean": self.mean.tolist(),
            "covariance": self.covariance.tolist(),
            "fabrics": self.fabrics,
        }

    @classmethod
    def from_dict(cls, content: dict) -> "GaussianPrior":
        """The inverse of :meth:`as_dict`; InputError where a parameter makes no sense."""
        try:
            mean = np.array(content["mean"], dtype=np.float64)
            covariance = np.array(content["covariance"], dtype=np.float64)
            fabrics = int(content["fabrics"])
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise InputError("a Gaussian prior needs a readable mean, covariance and number of "
                             f"fabrics ({type(error).__name__}: {error})") from None
        if mean.shape != (6,) or covariance.shape != (6, 6):
            raise InputError("a Gaussian prior needs a mean of 6 and a covariance of 36 numbers")
        finite = np.isfinite(mean).all() and np.isfinite(covariance).all()
        if not finite or not np.allclose(covariance, covariance.T):
            raise InputError("the covariance of a Gaussian prior must be finite and symmetric")
        if np.linalg.eigvalsh(covariance).min() <= 0:
            raise InputError("the covariance of a Gaussian prior must be positive definite")
        return cls(mean, covariance, fabrics)


KINDS: dict[str, type[Prior]] = {GaussianPrior.kind: GaussianPrior}


def prior_content(prior: Prior) -> dict:
    """What a prior's JSON file holds."""
    return {
        "schema_version": SCHEMA_VERSION,
        "kind": prior.kind,
        "parameters": list(THETA_NAMES),
        "units": "alpha in N·m, beta/alpha in m, at 300 g/m²",
        **prior.as_dict(),
    }


def prior_from_content(content: object, *, origin: str) -> Prior:
    """The prior in a decoded JSON file; ``origin`` names the file in complaints."""
    kind = content.get("kind") if isinstance(content, dict) else None
    if not isinstance(kind, str) or kind not in KINDS:
        raise InputError(f"{origin} is no prior; its \"kind\" must be one of {', '.join(KINDS)}")
    if content.get("schema_version") != SCHEMA_VERSION:
        raise InputError(f"{origin} has another schema version than {SCHEMA_VERSION}; fit it anew")
    if content.get("parameters") != list(THETA_NAMES):
        raise InputError(f"{origin} describes other parameters than {', '.join(THETA_NAMES)}")
    try:
        return KINDS[kind].from_dict(content)
    except InputError as error:
        raise InputError(f"{origin}: {error}") from None


def save_prior(prior: Prior, path: str | Path) -> None:
    """Write the prior's JSON file; a file that is there is replaced in one step."""
    text = json.dumps(prior_content(prior), indent=1, ensure_ascii=False) + "\n"
    replace_file(Path(path), text.encode())


def load_prior(path: str | Path | None = None) -> Prior:
    """Read a prior; None is the one that ships with the project.

    Raises:
        InputError: no such file, or not a prior.
    """
    path = BUNDLED if path is None else Path(path)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot read the prior {path}: {error.strerror}") from None
    except ValueError:
        raise InputError(f"{path} is no prior: not a JSON file") from None
    return prior_from_content(content, origin=str(path))


def sample_admissible(prior: Prior, rng: np.random.Generator) -> tuple[np.ndarray, int]:
    """Draw theta (6,) until a stable plate has these moduli; also return how many had none.

    Raises:
        InputError: none of the first ``MAXIMUM_TRIES`` is admissible.
    """
    for rejected in range(MAXIMUM_TRIES):
        theta = prior.sample(1, rng)[0]
        if is_admissible(*from_theta(theta)):
            return theta, rejected
    raise InputError(f"none of {MAXIMUM_TRIES} samples of the prior is a possible fabric")


USAGE = """\
usage: python -m data.prior fit table=FILE [out=FILE]

Fits the Gaussian prior to a table of measured fabrics (the published CSV format: density
[kg.m-2], linear moduli [SI*1e9], nonlinear moduli [SI*1e12], each warp, weft, diag) and writes
its parameters as JSON, without out= in place of the bundled prior. Another file is used with
`python -m data.generate prior.file=FILE`."""


def main(argv: list[str]) -> None:
    """The command line: ``fit table=FILE [out=FILE]``."""
    if not argv or argv[0] in ("-h", "--help"):
        print(USAGE)
        return
    if argv[0] != "fit":
        raise InputError(f"unknown command '{argv[0]}'; the only one is: fit table=FILE")
    options = parse_overrides({"table": "", "out": str(BUNDLED)}, argv[1:])
    if not options["table"]:
        raise InputError("a table of fabrics is needed: fit table=FILE")
    table = read_fabric_table(options["table"])
    prior = GaussianPrior.fit(table.theta)
    save_prior(prior, options["out"])
    alpha, _ = from_theta(prior.mean)
    print(f"{len(table)} distinct fabrics in {int(table.multiplicity.sum())} rows")
    print("median alpha warp, bias, weft (µN·m): " + ", ".join(f"{a * 1e6:.3g}" for a in alpha))
    print("mean beta/alpha (mm): " + ", ".join(f"{b * 1e3:.3g}" for b in prior.mean[3:]))
    deviation = np.sqrt(np.diag(prior.covariance))
    print("spread of alpha (factor): " + ", ".join(f"{np.exp(s):.3g}" for s in deviation[:3]))
    print("spread of beta/alpha (mm): " + ", ".join(f"{s * 1e3:.3g}" for s in deviation[3:]))
    print(f"written to {options['out']}")


if __name__ == "__main__":
    run_command(main)
