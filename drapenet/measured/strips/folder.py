"""A folder of strips of one fabric, and the evidence of its moduli by direction."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from common.errors import InputError
from common.files import printable
from common.findings import Finding
from common.normal import Normal
from common.types import DeflectionCurve, Metres, Radians
from drapenet.evidence.state import prior_along
from drapenet.measured.base import Measured, Prior, intervals
from drapenet.measured.strips.description import FILE, StripsDescription, read_description
from drapenet.measured.strips.photograph import PhotographedStrip, read_strip
from drapenet.measured.strips.posterior import BendingLength, StripEvidence, direction_evidence
from drapenet.measured.strips.record import StripsRecord
from sim.cantilever.moduli import StripModuli, correct
from sim.material import BIAS, DIRECTIONS, MICRO, NANO
from sim.rig import GRAVITY

BENDING_LENGTH_ERROR = 0.02  # relative standard deviation of a reading at 41.5°
ROUNDS = 6  # of the correction for the twist of free strips


@dataclass(frozen=True, kw_only=True)
class StripSet(Measured):
    """The strips of one fabric."""

    name, noun, schema, recorded = "strips", "strips", StripsDescription, StripsRecord
    apart = "strips.yaml: give the capture and the strips one after the other"
    photographs: tuple[PhotographedStrip, ...] = ()
    lengths: tuple[tuple[str, BendingLength], ...] = ()  # with their directions, as typed in
    slope: Radians = 0.0  # of all clamps below the horizontal
    width: Metres = 0.03

    @classmethod
    def read(cls, place: Path, stated: Mapping[str, Any]) -> "StripSet":
        return read_strips(place)

    def __len__(self) -> int:
        return len(self.photographs) + len(self.lengths)

    @property
    def needs_warp(self) -> bool:
        return len(self) > 0

    @property
    def curves(self) -> dict[str, list[DeflectionCurve]]:
        """The photographed curves of each direction that has some."""
        return {direction: curves for direction in DIRECTIONS if (curves := [
            strip.measured.curve for strip in self.photographs if strip.direction == direction])}

    @property
    def complete(self) -> bool:
        """Whether all three directions were photographed."""
        return set(self.curves) == set(DIRECTIONS)

    def record(self, prior: Prior) -> StripsRecord:
        moduli = {}
        for direction, strip in self.evidence(prior_along(prior(), self.density)).items():
            alpha, beta = strip.samples()
            moduli[direction] = {
                "alpha_uN_m": intervals(alpha / MICRO), "beta_nN_m2": intervals(beta / NANO),
                "natural_curvature_1_m": strip.curl[0],
                "natural_curvature_deviation_1_m": strip.curl[1], "misfit": strip.misfit,
                "scatter_of_specimens_percent": round(100 * strip.scatter, 1),
                "evidence": {"rows": strip.measured.rows.tolist(),
                             "values": strip.measured.values.tolist()}}
        return StripsRecord.model_validate({
            "source": printable(self.path), "density_g_m2": round(1e3 * self.density, 6),
            "strips": len(self), "moduli": moduli, "known": self.known})

    def tables(self) -> dict[str, bytes]:
        """A CSV file of each curve, with x_mm and y_mm, y up."""
        return {f"{Path(strip.name).stem}.csv": "".join(
            ["x_mm,y_mm\n", *(f"{x:.4f},{-y:.4f}\n" for x, y in 1e3 * strip.measured.curve)]
            ).encode() for strip in self.photographs}

    def shown(self) -> bytes:
        from data.captures.preview import png  # Matplotlib
        from drapenet.measured.strips.preview import strips_figure

        return png(strips_figure(self.photographs)) if self.photographs else b""

    def evidence(self, priors: Mapping[str, Normal]) -> dict[str, StripEvidence]:
        """Evidence of log alpha (N·m), beta/alpha (m) and natural curvature (1/m) of each direction
        that was measured, at the density of the fabric; InputError if the strips of one do not fit
        each other.

        Where all directions were photographed, simulated strips correct the means for the twist of
        free strips (:func:`sim.cantilever.moduli.correct`).

        Args:
            priors: of these three at that density, by direction.
        """
        found = {}
        for direction in DIRECTIONS:
            strips = [strip.measured for strip in self.photographs if strip.direction == direction]
            lengths = [length for name, length in self.lengths if name == direction]
            if not (strips or lengths):
                continue
            try:
                found[direction] = direction_evidence(
                    strips, lengths, weight=self.density * GRAVITY, prior=priors[direction],
                    slope=self.slope)
            except InputError as error:
                raise InputError(f"{self.path / FILE}: {direction}: {error}") from None
        if self.complete:
            # Curves contain the natural curvature, which these moduli do not.
            flat = {direction: StripModuli(found[direction].alpha, found[direction].beta)
                    for direction in self.curves}
            fabric = correct(self.curves, flat, density=self.density, rounds=ROUNDS,
                             width=self.width, slope=self.slope)
            for k, direction in enumerate(DIRECTIONS):
                found[direction] = found[direction].moved_to(fabric.alpha[k], fabric.beta[k])
        return found


def read_strips(folder: str | Path) -> StripSet:
    """Read ``strips.yaml`` and the photographs it names; InputError for the first fault."""
    folder = Path(folder)
    description = read_description(folder)
    slope = float(np.radians(description.clamp_slope_deg))
    photographs = tuple(read_strip(folder, entry, description, slope=slope)
                        for entry in description.strips if entry.file)
    strips = StripSet(
        **description.common(folder), photographs=photographs, lengths=_lengths(description),
        slope=slope, width=1e-3 * description.width_mm)
    warnings = [*strips.warnings, *(one for strip in photographs for one in strip.warnings)]
    if (bias := DIRECTIONS[BIAS]) in strips.curves and not strips.complete:
        warnings.append(Finding("strips_twist", {"direction": bias}))
    return strips.changed(warnings=tuple(warnings))


def _lengths(description: StripsDescription) -> tuple[tuple[str, BendingLength], ...]:
    return tuple(
        (entry.direction, BendingLength(1e-3 * entry.bending_length_mm,
                                        1e-3 * entry.bending_length_mm * BENDING_LENGTH_ERROR,
                                        entry.sign, entry.specimen))
        for entry in description.strips if entry.bending_length_mm)
