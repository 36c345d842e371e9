"""Photographs of real rectangles on small plates: outlines read, and held against simulated drapes.

The folder ``photographs`` has pictures from above and photographs.csv: file, short_mm and long_mm
of the specimen, plate_mm, the published area_cm2_published and drape_coefficient_percent_published,
and mm_per_px. Each picture is read as that of a capture, or refused.

For each outline close to the published area, the fabric is found whose lowered drapes have the same
mean drape coefficient: *isotropic*, exactly centred, and *fabrics* of the prior, scaled to a mean
alpha, off-centre and with the nuisances of datasets. Rectangles change between modes, so that the
coefficient is not monotonic in alpha; the softest fabric counts. Densities are not known: a drape
depends on alpha over density alone, and alpha is that at 300 g/m². Compared are the number of
folds, the standard deviation of the radius about the centroid, and its spectrum. The camera's
height was not published: :data:`READINGS` lists those tried.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from pydantic import Field

from common.documents import Schema
from common.errors import InputError
from common.findings import texts
from common.tables import number, read_table
from data.captures.description import OutlineSource
from data.captures.photograph import PhotographedOutline, read_outline, signed_area
from data.rigs import read_tester
from experiments.result import Config, Report, Result, load_arrays, run_cases
from experiments.shadows import (
    about_centroid,
    draw_outline,
    features,
    isotropic_fabric,
    shadows,
    specimen,
)
from sim.cloth import Laws
from sim.draping import drape
from sim.energies.bending_variants import Hysteresis
from sim.rig import Rig

TABLE = "photographs.csv"
MAX_OFF = 0.02  # of the published area, up to which an outline is compared
HARMONICS = np.arange(1, 13)
READINGS = {"parallel light": (np.inf, 1.0), "camera 1 m above": (1.0, 1.0),
            "camera 0.7 m above": (0.7, 1.0), "as the bare plate shows": (0.34, 0.75)}
"""Height of the camera above the plate, m, and size of a pixel at the plate over ``mm_per_px``.

The last one is measured. The set (github.com/igarcica/TextileCharacterization, data/EOS) has a
picture, IMG_20230815_184706.jpg, of a bare plate of 110 mm, 936 pixels wide, beside markers of
50 mm on the table, 323 pixels wide, taken with a lens of 25 mm (equivalent). So the camera was
0.34 m above the plate and the plate 0.107 m above the table, whose scale ``mm_per_px`` is. The
plates that show through four of the fabrics have the same scale within 3 %. Off the axis, the
camera was 28 mm, which is neglected."""
KINDS = ("isotropic", "fabrics")
PLATE_HEIGHT = 0.107  # m, above the table, which simulated cloth does not touch


class Row(Schema):
    """A row of :data:`TABLE`."""

    file: str = Field(min_length=1)
    short_mm: float
    long_mm: float
    plate_mm: float
    area_cm2_published: float = Field(gt=0)
    drape_coefficient_percent_published: float
    mm_per_px: float = Field(gt=0, le=10)

    @property
    def rig(self) -> Rig:
        """The tester of the specimen."""
        sides = [self.short_mm, self.long_mm]
        kind = "rectangle" if self.short_mm != self.long_mm else "square"
        size = sides if kind == "rectangle" else self.short_mm
        return read_tester({"specimen": kind, "size_mm": size, "plate_mm": self.plate_mm})


class Photograph(NamedTuple):
    """A row, and the outline of its picture or why there is none."""

    row: Row
    rig: Rig
    outline: PhotographedOutline | None
    reason: str = ""

    @property
    def area_cm2(self) -> float | None:
        """Area within the outline."""
        return 1e4 * signed_area(self.outline.curve) if self.outline else None

    @property
    def ratio(self) -> float | None:
        """Area over the published one."""
        return self.area_cm2 / self.row.area_cm2_published if self.outline else None

    @property
    def report(self) -> Report:
        """What is read, and what was published."""
        found = self.outline
        return {"tester": self.rig.name, "read": found is not None, "reason": self.reason,
                "area_cm2": self.area_cm2, "published_cm2": self.row.area_cm2_published,
                "ratio": self.ratio,
                "coefficient_percent": 100 * found.drape_coefficient if found else None,
                "published_percent": self.row.drape_coefficient_percent_published,
                "warnings": texts(found.warnings) if found else []}

    def radii(self, scale: float) -> np.ndarray:
        """Radii (POINTS,), m, about the centroid, ``scale`` times those read."""
        return scale * self.outline.radii[::2]


def read_rows(folder: Path) -> list[tuple[Row, Rig]]:
    """Rows of the folder's table and their testers."""
    file = folder / TABLE
    header, lines = read_table(file, "table of photographs")
    if missing := [name for name in Row.model_fields if name not in header]:
        raise InputError(f"{file} has no column {missing[0]}; the columns are "
                         f"{', '.join(Row.model_fields)}")
    rows = []
    for line, cells in lines:
        place = f"{file}, line {line}"
        named = dict(zip(header, cells, strict=False))
        row = Row.of({name: _cell(name, named.get(name, "")) for name in Row.model_fields}, place)
        try:
            rows.append((row, row.rig))
        except InputError as error:
            raise InputError(f"{place}: the specimen of {row.file} {error}") from None
    if not rows:
        raise InputError(f"{file} has no rows; give one for each photograph")
    return rows


def _cell(name: str, text: str) -> str | float:
    if name == "file":
        return text.strip()
    try:
        return number(text)
    except ValueError:
        return text  # refused with its name by the schema


def read_photograph(folder: Path, row: Row, rig: Rig) -> Photograph:
    """The outline of a picture, or why it is refused."""
    file = folder / row.file
    try:
        return Photograph(row, rig, read_outline(file, OutlineSource(mm_per_px=row.mm_per_px), rig))
    except InputError as error:
        return Photograph(row, rig, None, str(error).removeprefix(f"{file}: "))


def drape_case(
    *, kind: str, tester: str, alpha: float, ratio_mm: float, hysteresis: float, edge_mm: float,
    seeds: int
) -> dict[str, Any]:
    """Outlines (seeds, POINTS), m, of lowered drapes in all readings, and the depths, mm, that they
    reach below the plate; ``kind``: of :data:`KINDS`."""
    rig, edge = Rig.from_name(tester), 1e-3 * edge_mm
    if kind == "fabrics":
        shapes = [specimen(alpha, None, seed, edge, rig) for seed in range(seeds)]
    else:
        laws, fabric = Laws(bending=Hysteresis(hysteresis)), isotropic_fabric(alpha, ratio_mm)
        shapes = [drape(fabric, rig=rig, edge=edge, seed=seed, laws=laws) for seed in range(seeds)]
    depths = [-1e3 * float(shape.positions[:, 2].min()) for shape in shapes if shape.converged]
    heights = {name: height for name, (height, _) in READINGS.items()}
    return shadows(shapes, heights) | {"depths_mm": depths}


def run(config: Config) -> Result:
    """Read all photographs; simulate, fit and compare those that agree with the published area."""
    folder = Path(config["photographs"])
    found = [read_photograph(folder, *row) for row in read_rows(folder)]
    report: dict[str, Any] = {"photographs": {one.row.file: one.report for one in found}}
    sound = [one for one in found if one.ratio and abs(one.ratio - 1) <= MAX_OFF]
    simulated, failed = _simulated(sound, config)
    report |= {"read": sum(one.outline is not None for one in found), "sound": len(sound),
               "of": len(found), "failed": failed}
    report["readings"] = {reading: {kind: {
        one.row.file: _compared(one, reading, kind, simulated, config) for one in sound}
        for kind in KINDS} for reading in READINGS}
    report["summary"] = {reading: {kind: summarise(rows) for kind, rows in kinds.items()}
                         for reading, kinds in report["readings"].items()}
    return Result(report, _figure(sound, report, config))


def _cases(one: Photograph, kind: str, config: Config) -> dict[str, float]:
    """Names of the cases of a photograph's tester, and their alphas, µN·m, from soft to stiff."""
    return {f"{kind}_{one.rig.name}_{alpha:g}": alpha for alpha in sorted(config["alphas"])}


def _simulated(sound: Sequence[Photograph], config: Config) -> tuple[dict[str, np.ndarray], int]:
    """By case and reading, ``NAME READING``, the features of all drapes, (N, 3 + H), and by case
    their depths, (N,) mm; and how many drapes failed."""
    settings = {key: config[key] for key in ("ratio_mm", "hysteresis", "edge_mm", "seeds")}
    cases = {name: settings | {"kind": kind, "tester": one.rig.name, "alpha": alpha}
             for kind in KINDS for one in sound
             for name, alpha in _cases(one, kind, config).items()}
    results = run_cases(drape_case, cases, config)
    if empty := [name for name in cases if results[name]["failed"] == settings["seeds"]]:
        raise InputError(f"no drape converged of {', '.join(empty)} (kind, tester, alpha); choose "
                         "other alphas=")
    found = {}
    for name, case in cases.items():
        arrays = load_arrays(Path(config["cases"]), name)
        for reading in READINGS:
            radii = np.array([about_centroid(radius) for radius in arrays[reading]])
            found[f"{name} {reading}"] = features(radii, Rig.from_name(case["tester"]), HARMONICS)
        found[name] = np.array(results[name]["depths_mm"])
    return found, sum(result["failed"] for result in results.values())


def _compared(
    one: Photograph, reading: str, kind: str, simulated: dict[str, np.ndarray], config: Config
) -> dict[str, Any]:
    """Real and simulated features of a photograph, and the scatter of the latter between drapes;
    None if no fabric of the grid has its drape coefficient."""
    real = features(one.radii(READINGS[reading][1])[None], one.rig, HARMONICS)[0]
    cases = _cases(one, kind, config)
    found = [simulated[f"{name} {reading}"] for name in cases]
    rows = np.array([[*drapes.mean(axis=0), *drapes.std(axis=0, ddof=min(1, len(drapes) - 1)),
                      simulated[name].mean()] for name, drapes in zip(cases, found, strict=True)])
    log_alphas = np.log(list(cases.values()))
    fits = crossings(log_alphas, rows[:, 0], real[0])
    row = {"real": real.tolist(), "alphas_uN_m": np.exp(fits).tolist(),
           "coefficients": rows[:, 0].tolist()}
    if not len(fits):
        return row | dict.fromkeys(("simulated", "scatter", "depth_mm"))
    *values, depth = (np.interp(fits[0], log_alphas, column) for column in rows.T)
    mean, scatter = np.split(np.array(values), 2)
    return row | {"simulated": mean.tolist(), "scatter": scatter.tolist(), "depth_mm": float(depth)}


def crossings(places: np.ndarray, values: np.ndarray, wanted: float) -> np.ndarray:
    """Ascending places where lines between ``values`` (N,) at ascending ``places`` (N,) have the
    ``wanted`` value."""
    below = values < wanted
    k = np.flatnonzero(below[:-1] != below[1:])
    return places[k] + (wanted - values[k]) / (values[k + 1] - values[k]) * np.diff(places)[k]


def summarise(rows: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Means over the photographs whose drape coefficient a fabric of the grid has, the others by
    name; of none: their number alone. Scatters are of single drapes, root mean squares."""
    inside = [row for row in rows.values() if row["simulated"] is not None]
    number = {"photographs": len(inside),
              "outside": [file for file, row in rows.items() if row["simulated"] is None]}
    if not inside:
        return number
    real, mean, scatter = (np.array([row[key] for row in inside])
                           for key in ("real", "simulated", "scatter"))
    off, spread = (np.sqrt(np.square(values).mean(axis=0)) for values in (mean - real, scatter))
    shown = {"coefficient": 0, "folds": 1, "deviation_mm": 2}
    return number | {
        name: {"real": float(real[:, k].mean()), "simulated": float(mean[:, k].mean()),
               "rms": float(off[k]), "scatter": float(spread[k])} for name, k in shown.items()} | {
        "spectrum_mm": {"real": real[:, 3:].mean(axis=0).tolist(),
                        "simulated": mean[:, 3:].mean(axis=0).tolist(),
                        "rms": off[3:].tolist(), "scatter": spread[3:].tolist()},
        "alpha_uN_m": float(np.median([row["alphas_uN_m"][0] for row in inside])),
        "ambiguous": sum(len(row["alphas_uN_m"]) > 1 for row in inside),
        "on_table": sum(row["depth_mm"] > 1e3 * PLATE_HEIGHT for row in inside)}


def _figure(sound: Sequence[Photograph], report: Report, config: Config) -> Figure | None:
    """Outlines as the bare plate shows them: real ones (black) above a drape (blue) of each kind of
    the nearest fabric inside the grid; None without photographs."""
    if not sound:
        return None
    reading = list(READINGS)[-1]
    figure = Figure(figsize=(1.5 * len(sound), 4.8), layout="constrained")
    for column, one in zip(figure.subplots(3, len(sound), squeeze=False).T, sound, strict=True):
        name = Path(one.row.file).stem.removesuffix("_v").replace("_", " ")
        draw_outline(column[0], one.radii(READINGS[reading][1]), name, "black", one.rig)
        for axes, kind in zip(column[1:], KINDS, strict=True):
            fits = report["readings"][reading][kind][one.row.file]["alphas_uN_m"]
            if not fits:
                axes.set_axis_off()
                continue
            cases = _cases(one, kind, config)
            near = min(cases, key=lambda name, at=fits[0], of=cases: abs(np.log(of[name] / at)))
            radius = about_centroid(load_arrays(Path(config["cases"]), near)[reading][0])
            draw_outline(axes, radius, f"{kind}, {cases[near]:g} µN·m", "tab:blue", one.rig)
    return figure
