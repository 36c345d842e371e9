"""Estimates as text for terminals and spreadsheets."""

import csv
import io
import math
from collections.abc import Sequence
from typing import Any

MAX_NAME_WIDTH = 28  # characters of a fabric's name
_FORMULA = tuple("=+-@\t\r\n")  # first characters of cells that spreadsheets evaluate


def with_interval(quantity: dict[str, Any], key: str = "interval_68") -> tuple[str, str]:
    """Median and interval as text, with decimals according to the interval's width."""
    low, high = quantity[key]
    places = 0
    if (half := (high - low) / 2) > 0:
        places = min(max(1 - math.floor(math.log10(half)), 0), 6)
    return f"{quantity['median']:.{places}f}", f"{low:.{places}f} to {high:.{places}f}"


def interval_columns(name: str, quantity: dict[str, Any] | None) -> dict[str, str]:
    """Median and intervals as columns of a CSV table; empty for None."""
    columns = {name: "", **{f"{name}_{end}{level}": "" for level in (68, 90)
                            for end in ("low", "high")}}
    if quantity:
        values = [quantity["median"], *quantity["interval_68"], *quantity["interval_90"]]
        columns = dict(zip(columns, map(csv_number, values), strict=True))
    return columns


def csv_number(value: float) -> str:
    """A number for a CSV table."""
    return f"{value:.6g}"


def csv_table(rows: Sequence[dict[str, object]], columns: Sequence[str] = ()) -> str:
    """CSV table for spreadsheets; ``columns`` is needed if there may be no rows."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, list(columns or (rows[0] if rows else ())),
                            lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: _cell(value) for name, value in row.items()} for row in rows)
    return stream.getvalue()


def _cell(value: object) -> object:
    """Escape text that a spreadsheet would evaluate as a formula; numbers are not changed."""
    if not isinstance(value, str) or not value.startswith(_FORMULA):
        return "" if value is None else value
    try:
        float(value)
    except ValueError:
        return "'" + value
    return value


def format_table(content: dict[str, Any]) -> str:
    """The content of ``estimate.json`` as lines for a terminal."""
    density = content["capture"]["density_g_m2"]
    lines = [f"at {density:g} g/m²:",
             f"{'':8}{'alpha [µN·m]':>14}{'68 % interval':>20}{'beta [nN·m²]':>16}"
             f"{'68 % interval':>20}"]
    for name, moduli in content["moduli"].items():
        (alpha, alphas), (beta, betas) = map(with_interval, (moduli["alpha_uN_m"],
                                                             moduli["beta_nN_m2"]))
        lines.append(f"{name:8}{alpha:>14}{alphas:>20}{beta:>16}{betas:>20}")
    if poor := content["poorly_constrained"]:
        shares = content["share_of_spread_over_fabrics"]
        lines.append("poorly constrained (± share of the spread over fabrics): "
                     + ", ".join(f"{name} {shares[name]:.0%}" for name in poor))
    if refined := content.get("refined"):
        before = ", ".join(
            f"{name} {with_interval(moduli['alpha_uN_m'])[0]}"
            for name, moduli in refined["before"].items())
        lines.append(f"alpha before refinement: {before}")
        first = refined["misfit_before"]
        lines.append(f"misfit {'-' if first is None else format(first, '.0f')} before, "
                     f"{refined['misfit']:.0f} after {refined['simulations']} simulations "
                     f"({refined['status']})")
    lines.append(f"{'':8}{'bending length':>14}{'rigidity G':>14}{'KES B':>18}{'KES 2HB':>18}")
    for name, readings in content["laboratory"].items():
        length, rigidity, kes, two_hb = (readings[key] for key in (
            "bending_length_mm", "flexural_rigidity_uN_m", "kes_b_gf_cm2_per_cm",
            "kes_2hb_gf_cm_per_cm"))
        lines.append(f"{name:8}{with_interval(length)[0] + ' mm':>14}"
                     f"{with_interval(rigidity)[0] + ' µN·m':>14}"
                     + ("  outside the law" if kes is None else
                        f"{with_interval(kes)[0] + ' gf·cm²/cm':>18}"
                        f"{with_interval(two_hb)[0] + ' gf·cm/cm':>18}"))
    name, axis = next((key[:-5], value) for key, value in content.items() if key.endswith("_axis"))
    lines.append(f"{name} axis {axis['direction_deg']:.0f}° in the first view (probability "
                 f"{axis['probability']:.2f})")
    if coefficient := content["capture"].get("drape_coefficient_percent"):
        simulated = content.get("resimulation", {}).get("drape_coefficient_percent")
        lines.append(f"drape coefficient {coefficient:.1f} %, as captured"
                     + (f", {simulated:.1f} % simulated" if simulated else ""))
    if captures := content.get("captures"):
        lines.insert(0, f"joint estimate of {len(captures)} captures")
    return "\n".join(lines + [f"warning: {line}" for line in content["warnings"]])


def format_fabrics(rows: Sequence[tuple[str, int, dict[str, Any], int]]) -> str:
    """A line for each fabric: name, captures, alpha with its 68 % interval from the content of
    ``estimate.json``, and the number of warnings.
    """
    names = [name if len(name) <= MAX_NAME_WIDTH else f"{name[: MAX_NAME_WIDTH - 1]}…"
             for name, *_ in rows]
    width = max(len("fabric"), *map(len, names))
    lines = [f"{'fabric':{width}}{'captures':>10}"
             + "".join(f"{f'alpha {role}':>24}" for role in ("warp/stiff", "bias", "weft/soft"))
             + f"{'warnings':>10}   [µN·m, 68 %]"]
    for name, (_, captures, content, warnings) in zip(names, rows, strict=True):
        figures = [f"{median} ({interval})" for median, interval in (
            with_interval(moduli["alpha_uN_m"]) for moduli in content["moduli"].values())]
        lines.append(f"{name:{width}}{captures:>10}"
                     + "".join(f"{figure:>24}" for figure in figures)
                     + f"{warnings or '-':>10}")
    return "\n".join(lines)
