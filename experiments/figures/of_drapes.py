"""Blocks about simulated cloth: strips, testers, lowering, real outlines and fabrics."""

import numpy as np

from experiments.figures.reports import Reports
from experiments.result import Report, rms, table


def testers(reports: Reports) -> str:
    """Errors of the cantilever estimators."""
    def share(value: float) -> str:
        return f"{value:.0f} %" if value >= 10 else f"{value:.2g} %"

    names = {"noisy": "guided, 0.3 mm noise,", "corrected": "table, corrected"}
    rows = [[" ".join(names.get(word, word) for word in strips.split()),
             *(share(found[name][key]) for name in ("alpha", "beta")
               for key in ("median", "largest"))]
            for strips, found in reports["testers"]["errors_percent"].items()]
    return table(["strips, estimator", "α: median", "largest", "β: median", "largest"], rows)


def outlines(reports: Reports) -> str:
    """Folds, radii and spectra of real and simulated outlines at equal drape coefficient, read as
    seen under parallel light."""
    starts = {"flat": "lowered", "curled": "lowered, natural curvature from both faces",
              "specimens": "lowered, nuisances of specimens",
              "fabrics": "lowered, fabrics of the prior with nuisances",
              "learned": "lowered, fabrics that the network learns from", "ring": "ring"}
    summary = reports["outlines"]["summary"]["parallel"]
    rows = [[label, *(f"{summary[name][key]:.{digits}f}" for key, digits in (
        ("folds_real", 2), ("folds", 2), ("folds_rms", 2), ("deviation_real_mm", 1),
        ("deviation_mm", 1), ("spectrum", 2)))] for name, label in starts.items()]
    whole = table(["start", "folds, real", "simulated", "rms difference",
                   "deviation of the radius, mm, real", "simulated",
                   "spectra differ by, deviations"], rows)
    bands = [band for band, found in summary["flat"]["bands"].items() if found["faces"]]

    def each(found: Report, kind: str) -> str:
        second, fourth = (found[f"harmonics{kind}_mm"][number] for number in ("2", "4"))
        return f"{found[f'folds{kind}']:.1f}; {second:.1f}, {fourth:.1f}"

    return whole + "\n\n" + table(
        ["folds; harmonics 2 and 4 in mm, at drape coefficients of", *bands],
        [["real", *(each(summary["flat"]["bands"][band], "_real") for band in bands)],
         *([label, *(each(summary[name]["bands"][band], "") for band in bands)]
           for name, label in starts.items())])


def laboratory(reports: Reports) -> str:
    """Drape coefficients of laboratory fabrics, measured and simulated with the default
    membrane."""
    testers = {one["tester"]: None for one in reports["laboratory"]["fabrics"]}
    rows: dict[str, list[str]] = {}
    for one in reports["laboratory"]["fabrics"]:
        if one["membrane"] == "default":
            row = rows.setdefault(one["fabric"], [
                one["fabric"], f"{one['measured']:.0f}", *["–"] * len(testers)])
            row[2 + list(testers).index(one["tester"])] = f"{one['coefficient']:.0f}"
    return table(["drape coefficient, %", "measured",
                  *(name.replace("_", " ") for name in testers)], rows.values())


def lowering(reports: Reports) -> str:
    """Folds and drape coefficients of lowered drapes, one setting changed at a time."""
    found = reports["lowering"]
    rows = [[row["variant"], *(f"{folds:.1f}, {dc:.1f}" for folds, dc in zip(
        row["folds"], row["coefficients"], strict=True))] for row in found["variants"]]
    return table(["folds, drape coefficient in %",
                  *(f"{alpha:g} µN·m" for alpha in found["settings"]["alphas"])], rows)


def blender(reports: Reports) -> str:
    """Drapes of exported fabrics in Blender and in this simulator."""
    found = [one["coefficient"] for one in reports["blender"]["fabrics"]]
    off, alike = (np.array([one["blender"] - one[key] for one in found])
                  for key in ("law", "one_modulus"))
    return (f"Drape coefficients in Blender are off by {rms(off):.1f} points (rms), "
            f"{abs(off).max():.1f} at most; those of {(abs(off) < 3).sum()} of the {len(found)} "
            f"discs by less than 3. Of the same modulus they are {-alike.mean():.1f} points "
            "lower than here.")


def secants(reports: Reports) -> str:
    """Drapes with constant moduli, less those with the law, by the curvature of the secants."""
    summary = reports["secants"]["summary"]
    names = [name for name in summary if name != "all"]
    rows = [[f"{kappa} m⁻¹", *(text for name in names
                               for text in _differences(summary[name][kappa]))]
            for kappa in summary["all"]]
    what = ("drape coefficient, mean (rms, largest)", "folds, mean (rms)")
    return table(["secant at", *(f"{name.replace('_', ' ')}: {each}" for name in names
                                 for each in what)], rows)


def _differences(found: Report) -> tuple[str, str]:
    points, folds = found["coefficients"], found["folds"]
    return (f"{points['mean']:+.1f} ({points['rms']:.1f}, {points['largest']:.1f})",
            f"{folds['mean']:+.1f} ({folds['rms']:.1f})")
