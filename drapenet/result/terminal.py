"""An estimate in the words of the terminal."""

from pathlib import Path

from common.findings import texts
from drapenet.result.document import EstimateDocument
from drapenet.result.files import ESTIMATE, SHOWN


def print_estimate(document: EstimateDocument, folder: Path | None) -> None:
    """Print an estimate and the names of its files."""
    assert folder, "written before it is printed"
    print(f"{terminal_text(document)}\nestimate: {folder / ESTIMATE}")
    if files := [str(folder / name) for name in SHOWN if (folder / name).exists()]:
        print(f"report:   {', '.join(files)}")


def terminal_text(document: EstimateDocument) -> str:
    """An estimate as lines for a terminal."""
    lines = [f"joint estimate of {document.parts}"] if document.parts else []
    lines += [f"at {document.capture.density_g_m2:g} g/m²:",
              f"{'':8}{'alpha [µN·m]':>14}{'68 % interval':>20}{'beta [nN·m²]':>16}"
              f"{'68 % interval':>20}"]
    for name, moduli in document.moduli.items():
        (alpha, alphas), (beta, betas) = moduli.alpha_uN_m.texts(), moduli.beta_nN_m2.texts()
        lines.append(f"{name:8}{alpha:>14}{alphas:>20}{beta:>16}{betas:>20}")
    lines += [document.stiffness_in_a_drape] * bool(document.stiffness_in_a_drape)
    lines += texts([*document.mostly_usual, *document.assumed])
    if refined := document.refined:
        before = ", ".join(f"{name} {moduli.alpha_uN_m.texts()[0]}"
                           for name, moduli in refined.before.items())
        misfit = "-" if refined.misfit_before is None else f"{refined.misfit_before:.0f}"
        lines += [f"alpha before refinement: {before}",
                  f"misfit {misfit} before, {refined.misfit:.0f} after "
                  f"{refined.simulations} simulations ({refined.status}): half the sum of "
                  "squared deviations over their errors"]
    lines += [line for record in document.records if record.bends for line in record.lines()]
    kes = document.has_kes
    lines.append(f"{'':8}{'bending length':>14}{'rigidity G':>14}"
                 + f"{'KES B':>18}{'KES 2HB':>18}" * kes)
    for name, each in document.laboratory.items():
        cells = [(14, each.bending_length_mm, "mm"), (14, each.flexural_rigidity_uN_m, "µN·m"), *[
            (18, each.kes_b_gf_cm2_per_cm, "gf·cm²/cm"),
            (18, each.kes_2hb_gf_cm_per_cm, "gf·cm/cm")] * kes]
        lines.append(f"{name:8}" + "".join(
            f"{f'{value.texts()[0]} {unit}' if value else '–':>{width}}"
            for width, value, unit in cells))
    lines += [line for record in document.records if not record.bends for line in record.lines()]
    lines += [document.kes_note] * bool(document.kes_note)
    cloth = document.cloth
    curvature = cloth.natural_curvature_warp_1_m, cloth.natural_curvature_weft_1_m
    lines.append(f"natural curvature {curvature[0]} 1/m along {document.names[0]}, "
                 f"{curvature[1]} 1/m along {document.names[2]}")
    if coefficient := document.capture.drape_coefficient_percent:
        simulated = (document.resimulation or {}).get("drape_coefficient_percent")
        lines.append(f"drape coefficient {coefficient:.1f} %, as captured"
                     + (f", {simulated:.1f} % simulated" if simulated else ""))
    lines += [f"measured next, {document.narrowing}"] * bool(document.narrowing)
    lines += [f"advice: {line}" for line in texts(document.advice or [])]
    return "\n".join(lines + [f"warning: {line}" for line in texts(document.warnings)])
