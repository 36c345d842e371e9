"""Blocks about simulated cloth: real outlines and laboratory fabrics."""

from experiments.figures.reports import Reports
from experiments.result import Report, table


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
