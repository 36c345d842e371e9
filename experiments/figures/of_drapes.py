"""Blocks about simulated cloth: meshes, strips, testers, lowering, real outlines and fabrics."""

from experiments.figures.reports import RIGS, Reports
from experiments.result import rms, table


def testers(reports: Reports) -> str:
    """Errors of the cantilever estimators."""
    def share(value: float) -> str:
        return f"{value:.0f} %" if value >= 10 else f"{value:.2g} %"

    names = {"noisy": "guided, 0.3 mm noise,", "corrected": "table, corrected"}
    rows = [[" ".join(names.get(word, word) for word in strips.split()),
             *(share(found[name][key]) for name in ("alpha", "beta")
               for key in ("median", "rms", "largest"))]
            for strips, found in reports["testers"]["errors_percent"].items()]
    return table(["strips, estimator", "α: median", "rms", "largest", "β: median", "rms",
                  "largest"], rows)


def default_mesh(reports: Reports) -> str:
    """Displacements of drapes on the default and other meshes from a fine mesh."""
    kinds = reports["default_mesh"]["meshes"]
    rows = []
    for kind, rig in RIGS.items():
        for row in kinds[rig]:
            if kind == "discs" and not row["mesh"].startswith("default"):
                continue
            name = row["mesh"] if row["mesh"].startswith("default") else f"{row['mesh']} mm"
            rows.append([kind, name, *(f"{row[f'{key}_mm']:.2f}"
                                       for key in ("mean", "median", "largest")),
                         f"{row['within_limit']} of {row['same_folds']}",
                         f"{row['mean_cpu_seconds']:.2f}"])
    return table(["specimens", "edges at the rim", "mean, mm", "median", "largest",
                  "within 0.8 mm", "CPU-seconds a drape"], rows)


def outlines(reports: Reports) -> str:
    """Folds, radii and spectra of real and simulated outlines at equal drape coefficient."""
    starts = {"flat": "lowered", "curled": "lowered, natural curvature from both faces",
              "specimens": "lowered, nuisances of specimens",
              "fabrics": "lowered, fabrics of the prior with nuisances", "ring": "ring"}
    rows = [[{"parallel": "parallel light", "camera": "camera 0.7 m above"}[reading], label,
             *(f"{found[key]:.{digits}f}" for key, digits in (
                 ("folds_real", 2), ("folds", 2), ("folds_rms", 2), ("deviation_real_mm", 1),
                 ("deviation_mm", 1), ("spectrum", 2)))]
            for reading, each in reports["outlines"]["summary"].items()
            for name, label in starts.items() for found in [each[name]["all"]]]
    return table(["pictures read as", "start", "folds, real", "simulated", "rms difference",
                  "deviation of the radius, mm, real", "simulated",
                  "spectra differ by, deviations"], rows)


def laboratory(reports: Reports) -> str:
    """Drape coefficients and nodes of laboratory fabrics, measured and simulated."""
    rows = [[one["fabric"], one["composition"], one["tester"].replace("_", " "), one["membrane"],
             one["hysteresis"], f"{one['measured']:.1f}",
             f"{one['coefficient']:.1f} ({one['coefficient'] - one['measured']:+.1f})",
             "" if one["nodes_measured"] is None else f"{one['nodes_measured']:.0f}",
             f"{one['nodes']:.1f}"] for one in reports["laboratory"]["fabrics"]]
    changes = [[one["change"], f"{one['mean']:+.1f}", f"{one['rms']:.1f}", f"{one['clo']:+.1f}"]
               for one in reports["laboratory"].get("explanations", [])]
    return "\n\n".join((
        table(["fabric", "", "tester", "stretch and shear", "2HB", "DC measured, %", "simulated",
               "nodes measured", "simulated"], rows),
        table(["P1 to P6 with", "simulated less measured, points", "rms", "CLO less simulated"],
              changes)))


def lowering(reports: Reports) -> str:
    """Folds and drape coefficients of lowered drapes, one setting changed at a time."""
    found = reports["lowering"]
    rows = [[row["variant"], *(f"{folds:.1f}, {dc:.1f}" for folds, dc in zip(
        row["folds"], row["coefficients"], strict=True))] for row in found["variants"]]
    return table(["folds, drape coefficient in %",
                  *(f"{alpha:g} µN·m" for alpha in found["settings"]["alphas"])], rows)


def photographs(reports: Reports) -> str:
    """Coefficients, folds, radii and spectra of real and simulated rectangles, by reading."""
    rows = [[reading, kind, found["photographs"], f"{found['alpha_uN_m']:.0f}",
             *(f"{factor * found[name][key]:.{digits}f}" for name, factor, digits, keys in (
                 ("coefficient", 100, 0, ("real",)),
                 ("folds", 1, 1, ("real", "simulated", "rms", "scatter")),
                 ("deviation_mm", 1, 1, ("real", "simulated", "rms", "scatter")))
               for key in keys),
             f"{rms(found['spectrum_mm']['rms']):.1f}, {rms(found['spectrum_mm']['scatter']):.1f}"]
            for reading, kinds in reports["photographs"]["summary"].items()
            for kind, found in kinds.items()]
    return table(["pictures read as", "simulated", "photographs", "α, µN·m, median", "DC, %",
                  "folds, real", "simulated", "rms difference", "scatter",
                  "deviation of the radius, mm, real", "simulated", "rms difference", "scatter",
                  "harmonics 1 to 12, mm: difference, scatter"], rows)


def blender(reports: Reports) -> str:
    """Drapes of exported fabrics in Blender and in this simulator."""
    report = reports["blender"]
    rows = [[f"{float(alpha):g}", *(f"{one['coefficient'][k]:.1f} %" for k in range(2)),
             *(f"{one['folds'][k]:.1f}" for k in range(2))]
            for alpha, one in report["alpha_uN_m"].items()]
    return table(["α [µN·m]", "drape coefficient here", "in Blender", "folds here",
                  "in Blender"], rows)
