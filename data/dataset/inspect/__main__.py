"""Verify a dataset of drapes and report its statistics.

    python -m data.dataset.inspect FOLDER [out=REPORT]  # or outputs/inspect/NAME_OF_DATASET

Checks that the shards of the dataset in FOLDER are those listed in its dataset.json, then reports
outcomes, parameters compared with the prior, drapes and disk use. Writes report.json,
histograms.png and contact_sheet.png to REPORT (docs/data_format.md). Does not change FOLDER.
"""

from dataclasses import dataclass
from pathlib import Path

from common.command import command
from common.errors import InputError
from common.files import replace_file, replace_json, require_folder
from data.dataset.inspect.check import check_dataset
from data.dataset.inspect.figures import RANGE, prior_samples, read_drapes, report
from data.dataset.inspect.pictures import contact_sheet, histograms, take_shots

WIDTH = 22  # width of a table's first column


@dataclass
class InspectConfig:
    """``configs/inspect.yaml``."""

    data: str
    out: str
    intersections: int
    sheet: int


@command("inspect", InspectConfig, first="data")
def main(config: InspectConfig) -> None:
    """Verify the dataset; print and write the report."""
    if not config.data:
        raise InputError("the folder of a dataset is missing: "
                         "python -m data.dataset.inspect FOLDER")
    if config.intersections < 0:
        raise InputError(f"intersections={config.intersections} must not be negative")
    if config.sheet < 1:
        raise InputError(f"sheet={config.sheet} must be at least 1")
    root = Path(config.data)
    out = Path(config.out or Path("outputs/inspect") / root.resolve().name)
    require_folder(out)
    manifest = check_dataset(root)
    drapes = read_drapes(root, manifest, intersections=config.intersections)
    prior = prior_samples(manifest)
    shots = take_shots(root, manifest, drapes, count=config.sheet)
    content = report(manifest, drapes, prior)
    print("\n".join(describe(content)))
    replace_json(out / "report.json", content)
    replace_file(out / "histograms.png", histograms(drapes, prior[0]))
    if shots:
        replace_file(out / "contact_sheet.png", contact_sheet(shots))
    print(f"\nwritten to {out}: report.json, histograms.png"
          + (", contact_sheet.png" if shots else ""))


def describe(content: dict) -> list[str]:
    """Format the result of :func:`data.dataset.inspect.figures.report` as lines of text."""
    n, disk = content["drapes"], content["disk"]
    rate = content["rejection_rate"]
    lines = [
        f"{n} drapes of {content['fabrics']} fabrics, {content['converged']} converged "
        f"({content['converged'] / n:.1%}); {content['fabrics_with_a_drape']} fabrics have one",
        f"content {content['dataset']['hash'][:16]}, settings "
        f"{content['dataset']['identity'][:16]}; shards agree with dataset.json",
        f"impossible fabrics rejected: {rate['dataset']:.2%}, by the prior itself "
        f"{rate['prior']:.2%}",
        "",
        f"{'initial state':<{WIDTH}}{'drapes':>8}{'converged':>11}{'mean folds':>12}",
        *(f"{name:<{WIDTH}}{row['drapes']:>8}{row['converged']:>11}{_number(row['mean_folds']):>12}"
          for name, row in content["starts"].items()),
        "",
    ]
    if content["failures"]:
        lines += [f"{'failure':<{WIDTH}}{'drapes':>8}  first", *(
            f"{row['status']:<{WIDTH}}{row['drapes']:>8}  {row['first']}: {row['message']}"
            for row in content["failures"]), ""]
    low, high = RANGE
    lines.append(f"{'at 300 g/m²':<{WIDTH}}{'1 %':>8}{'10 %':>9}{'median':>9}{'90 %':>9}{'99 %':>9}"
                 f"   outside the prior's {low:.0%} to {high:.0%} ({1 - high + low:.0%} expected)")
    for name, row in content["parameters"].items():
        label = f"{name.replace('_over_', '/').replace('_', ' ')} [{row['unit']}]"
        outside = "" if row["outside"] is None else f"   {row['outside']:.1%}"
        lines += [_range(label, row["dataset"]) + outside, _range("  prior", row["prior"])]
    lines += [
        "",
        _range("drape coefficient", content["drape_coefficient"]),
        _range("largest strain", content["stretch"]),
        _range("iterations", content["iterations"]),
        "folds: " + ", ".join(f"{count} with {folds}" for folds, count in content["folds"].items()),
        _self_intersections(content["self_intersections"], content["converged"]),
        "",
        f"{'disk':<{WIDTH}}{'MB':>8}{'kB a drape':>12}",
        *(f"{part:<{WIDTH}}{size / 1e6:>8.2f}{size / 1e3 / n:>12.1f}"
          for part, size in disk.items()),
    ]
    return lines


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _range(label: str, quantiles: dict[str, float] | None) -> str:
    columns = ("0.01", "0.1", "0.5", "0.9", "0.99")
    values = [_number(None if quantiles is None else quantiles[q]) for q in columns]
    return f"{label:<{WIDTH}}{values[0]:>8}" + "".join(f"{value:>9}" for value in values[1:])


def _self_intersections(figures: dict, converged: int) -> str:
    of = "all" if figures["looked_at"] == converged else f"{figures['looked_at']} of"
    line = f"self-intersections: {figures['intersecting']} of {of} {converged} converged drapes"
    if figures["drapes"]:
        line += f" (first: {', '.join(map(str, figures['drapes'][:8]))})"
    return line


if __name__ == "__main__":
    main()
