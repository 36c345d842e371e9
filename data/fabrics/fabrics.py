"""Tables of measured fabrics, the six parameters of a fabric, and its other properties.

The parameter vector theta = (log alpha_warp, log alpha_bias, log alpha_weft, (beta/alpha)_warp,
(beta/alpha)_bias, (beta/alpha)_weft) holds the moduli at the reference density of 300 g/m²:
alpha in N·m inside the logarithm, beta/alpha in m. It is smooth across the sign of beta and
determines the drape at the reference density (Feng et al. 2022, section 5.1.2).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common.errors import InputError
from common.tables import number, read_table
from common.types import ModuliOfMany, QuadraticModuliOfMany, Theta
from sim.material import REFERENCE_DENSITY, Fabric

THETA_NAMES = ("log_alpha_warp", "log_alpha_bias", "log_alpha_weft",
               "beta_over_alpha_warp", "beta_over_alpha_bias", "beta_over_alpha_weft")
"""Components of theta; alpha in N·m at 300 g/m², beta/alpha in m."""

TABLE_COLUMNS = (
    "density[kg.m-2]", "linear warp[SI*1e9]", "linear weft[SI*1e9]", "linear diag[SI*1e9]",
    "nonlinear warp[SI*1e12]", "nonlinear weft[SI*1e12]", "nonlinear diag[SI*1e12]")
"""Columns of the published table with their units, in the order warp, weft, bias ("diag")."""

TABLE_DENSITIES = (1e-3, 10.0)  # kg/m²; outside, a density has another unit
LINEAR_UNIT, QUADRATIC_UNIT = 1e-9, 1e-12  # N·m, N·m²


def to_theta(alpha: ModuliOfMany, beta: QuadraticModuliOfMany) -> Theta:
    """Parameters of moduli at 300 g/m²."""
    alpha = np.asarray(alpha, dtype=np.float64)
    return np.concatenate([np.log(alpha), np.asarray(beta, np.float64) / alpha], axis=-1)


def from_theta(theta: Theta) -> tuple[ModuliOfMany, QuadraticModuliOfMany]:
    """Moduli at 300 g/m²."""
    theta = np.asarray(theta, dtype=np.float64)
    alpha = np.exp(theta[..., :3])
    return alpha, theta[..., 3:] * alpha


def fabric_from_theta(theta: Theta) -> Fabric:
    """The fabric of a parameter vector, at the reference density."""
    alpha, beta = from_theta(theta)
    return Fabric(alpha=alpha, beta=beta, density=REFERENCE_DENSITY)


@dataclass(frozen=True)
class FabricTable:
    """Distinct fabrics of a table, in order of first appearance; moduli (F, 3) at 300 g/m²."""

    density: np.ndarray  # (F,) kg/m², measured
    alpha: ModuliOfMany
    beta: QuadraticModuliOfMany
    multiplicity: np.ndarray  # (F,) rows of each fabric

    def __len__(self) -> int:
        return len(self.density)

    @property
    def theta(self) -> Theta:
        """Parameter vectors of all fabrics."""
        return to_theta(self.alpha, self.beta)


def read_fabric_table(path: str | Path) -> FabricTable:
    """Read a table in the published CSV format, merge repeated rows, normalise to 300 g/m².

    The header names :data:`TABLE_COLUMNS` in any order; a column whose name starts with "rows"
    gives the multiplicity of a row (else 1), and further columns are ignored.
    """
    try:
        header, rows = read_table(Path(path), "fabric table")
    except InputError as error:
        raise InputError(f"{error}; give fabrics=FILE, a CSV file with the columns "
                         f"{', '.join(TABLE_COLUMNS)}") from None
    if not rows:
        raise InputError(f"{path} holds no fabrics; expected a header line and one row a fabric")
    columns, counted = _locate_columns(header, path)
    merged: dict[tuple[float, ...], int] = {}
    for line, row in rows:
        place = f"{path}, line {line}"
        try:
            values = tuple(number(row[column]) for column in columns)
            count = int(row[counted]) if counted is not None else 1
        except (ValueError, IndexError):
            raise InputError(f"{place}: expected {len(header)} numbers") from None
        low, high = TABLE_DENSITIES
        if not np.isfinite(values).all() or min(values[:4]) <= 0 or count < 1:
            raise InputError(f"{place}: all values must be finite, density, linear moduli and the "
                             "number of rows must be positive")
        if not low <= values[0] <= high:
            raise InputError(f"{place}: density={values[0]:g} is outside {low:g} to {high:g} kg/m²;"
                             " check the unit")
        merged[values] = merged.get(values, 0) + count
    table = np.array(list(merged))
    scale = (REFERENCE_DENSITY / table[:, 0])[:, None]
    return FabricTable(table[:, 0], table[:, [1, 3, 2]] * LINEAR_UNIT * scale,
                       table[:, [4, 6, 5]] * QUADRATIC_UNIT * scale,
                       np.array(list(merged.values())))


def _locate_columns(header: list[str], path: str | Path) -> tuple[list[int], int | None]:
    """Positions of the published columns, and of the multiplicity if there is one."""
    names = [name.strip().replace(" [", "[") for name in header]
    names = ["rows" if name.startswith("rows") else name for name in names]
    for name in (*TABLE_COLUMNS, "rows"):
        if names.count(name) > 1 or (name not in names and name != "rows"):
            raise InputError(f"{path} must have one column '{name}'; a table has "
                             f"{', '.join(TABLE_COLUMNS)}")
    return ([names.index(name) for name in TABLE_COLUMNS],
            names.index("rows") if "rows" in names else None)


@dataclass(frozen=True)
class ClothProperties:
    """Fabrics at 300 g/m².

    Attributes:
        curl: (..., 2) 1/m, natural curvature along warp and weft with the marked face up.
        membrane: (...,) N/m, stiffness along the yarns.
        hysteresis: (...,) share of the torque, :class:`sim.energies.bending_variants.Hysteresis`.
    """

    theta: Theta
    curl: np.ndarray
    membrane: np.ndarray
    hysteresis: np.ndarray

    def chosen(self, rows: np.ndarray) -> "ClothProperties":
        """The fabrics of ``rows``, indices or a mask."""
        return ClothProperties(*(part[rows] for part in vars(self).values()))
