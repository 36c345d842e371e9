"""Tables of measured fabrics, and the six parameters of a fabric.

The parameter vector theta = (log alpha_warp, log alpha_bias, log alpha_weft, (beta/alpha)_warp,
(beta/alpha)_bias, (beta/alpha)_weft) holds the moduli at the reference density of 300 g/m²:
alpha in N·m inside the logarithm, beta/alpha in m. It is smooth across the sign of beta and
determines the drape at the reference density (Feng et al. 2022, section 5.1.2).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common.documents import read_table
from common.errors import InputError
from sim.material import REFERENCE_DENSITY, Fabric

THETA_NAMES = (
    "log_alpha_warp",
    "log_alpha_bias",
    "log_alpha_weft",
    "beta_over_alpha_warp",
    "beta_over_alpha_bias",
    "beta_over_alpha_weft",
)
"""Components of theta; alpha in N·m at 300 g/m², beta/alpha in m."""

TABLE_COLUMNS = {
    "density": "kg.m-2",
    "linear warp": "SI*1e9",
    "linear weft": "SI*1e9",
    "linear diag": "SI*1e9",
    "nonlinear warp": "SI*1e12",
    "nonlinear weft": "SI*1e12",
    "nonlinear diag": "SI*1e12",
}
"""Columns of the published table and their units, in the order warp, weft, bias ("diag")."""

_COLUMNS = ", ".join(f"{name}[{unit}]" for name, unit in TABLE_COLUMNS.items())

TABLE_DENSITIES = (1e-3, 10.0)  # kg/m²; outside, a density has another unit
LINEAR_UNIT = 1e-9  # N·m
QUADRATIC_UNIT = 1e-12  # N·m²


def to_theta(alpha: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """theta (..., 6) from moduli alpha (..., 3) N·m and beta (..., 3) N·m² at 300 g/m²."""
    alpha = np.asarray(alpha, dtype=np.float64)
    return np.concatenate([np.log(alpha), np.asarray(beta, np.float64) / alpha], axis=-1)


def from_theta(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Moduli alpha (..., 3) N·m and beta (..., 3) N·m² at 300 g/m² from theta (..., 6)."""
    theta = np.asarray(theta, dtype=np.float64)
    alpha = np.exp(theta[..., :3])
    return alpha, theta[..., 3:] * alpha


def fabric_from_theta(theta: np.ndarray) -> Fabric:
    """The fabric with parameters theta (6,), at the reference density."""
    alpha, beta = from_theta(theta)
    return Fabric(alpha=alpha, beta=beta, density=REFERENCE_DENSITY)


@dataclass(frozen=True)
class FabricTable:
    """Distinct fabrics of a table, in order of first appearance.

    Attributes:
        density: (F,) measured mass per area, kg/m².
        alpha: (F, 3) linear moduli warp, bias, weft, N·m, normalised to 300 g/m².
        beta: (F, 3) quadratic moduli, same order, N·m², normalised to 300 g/m².
        multiplicity: (F,) number of rows of each fabric in the published table.
    """

    density: np.ndarray
    alpha: np.ndarray
    beta: np.ndarray
    multiplicity: np.ndarray

    def __len__(self) -> int:
        return len(self.density)

    @property
    def theta(self) -> np.ndarray:
        """(F, 6) parameter vectors."""
        return to_theta(self.alpha, self.beta)


def read_fabric_table(path: str | Path) -> FabricTable:
    """Read a table in the published CSV format, merge repeated rows, normalise to 300 g/m².

    The header names the columns of :data:`TABLE_COLUMNS` with their units in brackets, in any
    order; a column whose name starts with "rows" gives the multiplicity of a row (else 1), and
    further columns are ignored. Rows that agree in all seven values are one fabric.

    Raises:
        InputError: no such file, a missing or repeated column, another unit, a cell that is not a
            number, a density or linear modulus out of range, a multiplicity below 1.
    """
    path = Path(path)
    try:
        header, rows = read_table(path, "fabric table")
    except InputError as error:
        raise InputError(f"{error}; give fabrics=FILE, a CSV file with the columns {_COLUMNS}"
                         ) from None
    if not rows:
        raise InputError(f"{path} holds no fabrics; expected a header line and one row a fabric")
    columns, counted = _locate_columns(header, path)
    merged: dict[tuple[float, ...], int] = {}
    for line, row in rows:
        try:
            values = tuple(float(row[column]) for column in columns)
            count = int(row[counted]) if counted is not None else 1
        except (ValueError, IndexError):
            raise InputError(f"{path}, line {line}: expected {len(header)} numbers") from None
        if not np.isfinite(values).all() or min(values[:4]) <= 0:
            raise InputError(f"{path}, line {line}: all values must be finite, density and linear "
                             "moduli must be positive")
        low, high = TABLE_DENSITIES
        if not low <= values[0] <= high:
            raise InputError(f"{path}, line {line}: density={values[0]:g} is outside {low:g} to "
                             f"{high:g} kg/m²; check the unit")
        if count < 1:
            raise InputError(f"{path}, line {line}: '{header[counted]}' must be at least 1")
        merged[values] = merged.get(values, 0) + count
    table = np.array(list(merged))
    density = table[:, 0]
    scale = (REFERENCE_DENSITY / density)[:, None]
    return FabricTable(
        density=density,
        alpha=table[:, [1, 3, 2]] * LINEAR_UNIT * scale,
        beta=table[:, [4, 6, 5]] * QUADRATIC_UNIT * scale,
        multiplicity=np.array(list(merged.values())),
    )


def _locate_columns(header: list[str], path: Path) -> tuple[list[int], int | None]:
    """Positions of the published columns, and of the multiplicity if there is one."""
    units = {}
    for position, cell in enumerate(header):
        name, _, unit = cell.partition("[")
        name = "rows" if name.startswith("rows") else name.strip()
        if name in units and name in (*TABLE_COLUMNS, "rows"):
            raise InputError(f"{path} has two columns '{name}'; remove one")
        units[name] = (position, unit.rstrip("] "))
    counted, _ = units.get("rows", (None, ""))
    columns = []
    for name, unit in TABLE_COLUMNS.items():
        if name not in units:
            raise InputError(f"{path} has no column '{name}[{unit}]'; a table has {_COLUMNS}")
        position, found = units[name]
        if found != unit:
            raise InputError(f"{path}: column '{name}' is in '{found}', expected '{unit}'")
        columns.append(position)
    return columns, counted
