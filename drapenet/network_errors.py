"""How the network errs on cloth: measured once for a checkpoint, kept in its JSON file.

The network has learned from drapes on meshes; cloth has none, and what a mesh does to a drape
depends on how softly the fabric bends. So the mean error is linear in the level of what the network
says, the mean of its three log alphas; around it errors are normally distributed, those of
different moduli together. ``benchmarks.network_errors`` measures them.
"""

from dataclasses import dataclass

import numpy as np

from common.errors import InputError
from data.prior.base import check_covariances, read_array, read_count
from drapenet.convention import LINEAR


@dataclass(frozen=True)
class NetworkErrors:
    """Distribution of the network's errors (6,) on cloth, in the targets' units.

    Attributes:
        mean: (6,) where the level is ``level``.
        slope: (6,) of the mean, by the level.
        level: log N·m.
        covariance: (6, 6) around the mean, positive definite.
        fabrics: that it was measured with.
    """

    mean: np.ndarray
    slope: np.ndarray
    level: float
    covariance: np.ndarray
    fabrics: int

    @classmethod
    def fit(cls, estimates: np.ndarray, truth: np.ndarray) -> "NetworkErrors":
        """From targets (N, 6) that the network estimated, N > 8, and the true ones (N, 6)."""
        estimates = np.asarray(estimates, dtype=np.float64)
        errors = estimates - truth
        level = estimates[:, LINEAR].mean()
        basis = np.column_stack([np.ones(len(estimates)),
                                 estimates[:, LINEAR].mean(axis=1) - level])
        (mean, slope), *_ = np.linalg.lstsq(basis, errors, rcond=None)
        rest = errors - basis @ np.stack([mean, slope])
        return cls(mean, slope, float(level), rest.T @ rest / (len(errors) - 2), len(errors))

    @classmethod
    def independent(cls, deviation: np.ndarray) -> "NetworkErrors":
        """Of mean zero and deviation (6,), those of one modulus not knowing of the others."""
        return cls(np.zeros(6), np.zeros(6), 0.0, np.diag(deviation**2), 0)

    @property
    def deviation(self) -> np.ndarray:
        """(6,) of each error around its mean."""
        return np.sqrt(np.diag(self.covariance))

    def mean_at(self, estimate: np.ndarray) -> np.ndarray:
        """(6,) mean error where the network says ``estimate`` (6,)."""
        return self.mean + self.slope * (estimate[LINEAR].mean() - self.level)

    def as_dict(self) -> dict:
        """All parameters, in JSON's types."""
        return {"mean": self.mean.tolist(), "slope": self.slope.tolist(), "level": self.level,
                "covariance": self.covariance.tolist(), "fabrics": self.fabrics}

    @classmethod
    def from_dict(cls, content: object) -> "NetworkErrors":
        """The inverse of :meth:`as_dict`; InputError where a parameter makes no sense."""
        if not isinstance(content, dict):
            raise InputError("they are no table of parameters")
        mean, slope = (read_array(content, name, (6,)) for name in ("mean", "slope"))
        covariance = read_array(content, "covariance", (6, 6))
        check_covariances(covariance, "their covariance must be symmetric and positive definite")
        return cls(mean, slope, float(read_array(content, "level", ())), covariance,
                   read_count(content, "fabrics"))
