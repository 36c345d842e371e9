"""``estimate.json``: the model that is made from an estimate, written and read."""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import (
    BeforeValidator,
    Field,
    InstanceOf,
    PlainSerializer,
    PlainValidator,
    model_validator,
)

from common.documents import Excerpt
from common.errors import shown
from common.files import printable
from common.findings import Finding, records
from common.types import Density
from data.captures.description import Labels
from data.captures.reported import Reported
from data.readings import QUANTITIES
from data.readings.cantilever import MG_CM, bending_length, flexural_rigidity
from data.readings.kes import GF_CM, GF_CM_PER_CM, kes
from data.readings.known import Known
from drapenet.evidence.source import value_key
from drapenet.result.estimate import Estimate
from sim.material import (
    DIRECTIONS,
    DRAPE_CURVATURE,
    MICRO,
    NANO,
    REFERENCE_DENSITY,
    STIFF_SOFT,
    secant,
)

if TYPE_CHECKING:
    from data.strips.folder import StripSet
    from data.strips.posterior import StripEvidence
    from data.tension.folder import TensionSet

SCHEMA = "drapenet-estimate"
SCHEMA_VERSION = 6
POORLY_CONSTRAINED = 0.7  # above this ratio of standard deviation and spread over fabrics
CURVATURES = np.array([25.0, 50.0, 100.0, 200.0, 400.0])  # 1/m, of the tabulated law
INTERVALS = {"interval_68": 0.68, "interval_90": 0.90}
MAX_OUTSIDE_SHARE = 0.5  # of samples outside KES's range; beyond, its readings are not given
MAX_COMPARED_SHARE = 0.05  # beyond, its readings are given, but not to be compared

Text = InstanceOf[str]
"""A text that may hold a path, whose bytes need not be UTF-8."""
Finite = Annotated[float | None, BeforeValidator(
    lambda value: None if isinstance(value, float) and not math.isfinite(value) else value)]
"""A number, None where it is not finite, for which JSON has no notation."""
Interval = Annotated[list[float], Field(min_length=2, max_length=2)]


def _finding(content: Any) -> Finding:
    """The finding of a record that has a code with a sentence, and its values."""
    if isinstance(content, Finding):
        return content
    try:
        code, values, source = (content[key] for key in ("code", "values", "source"))
        records([found := Finding(code, values, source)])
    except (AttributeError, IndexError, KeyError, TypeError, ValueError):
        raise ValueError("is not the record of a finding") from None
    return found


Recorded = Annotated[Finding, PlainValidator(_finding),
                     PlainSerializer(lambda found: found.record)]
"""A finding; in JSON its :attr:`~common.findings.Finding.record`."""


class Quantity(Excerpt):
    """Median and central intervals of a quantity."""

    median: float
    interval_68: Interval
    interval_90: Interval

    def times(self, factor: float) -> "Quantity":
        """The quantity multiplied by a positive factor."""
        return Quantity(median=factor * self.median,
                        interval_68=[factor * end for end in self.interval_68],
                        interval_90=[factor * end for end in self.interval_90])

    def texts(self, key: str = "interval_68") -> tuple[str, str]:
        """Median and interval as text, with decimals according to the interval's width."""
        low, high = getattr(self, key)
        places = 0
        if (half := (high - low) / 2) > 0:
            places = min(max(1 - math.floor(math.log10(half)), 0), 6)
        return f"{self.median:.{places}f}", f"{low:.{places}f} to {high:.{places}f}"

    def __str__(self) -> str:
        """Median and 68 % interval."""
        return "{} ({})".format(*self.texts())


class DirectionModuli(Excerpt):
    """Moduli along one direction."""

    alpha_uN_m: Quantity  # noqa: N815
    beta_nN_m2: Quantity  # noqa: N815
    beta_over_alpha_mm: Quantity
    drape_stiffness_uN_m: Quantity | None = None  # noqa: N815  # none: an earlier estimate


class Readings(Excerpt):
    """What testers would measure along one direction."""

    bending_length_mm: Quantity
    flexural_rigidity_uN_m: Quantity  # noqa: N815
    flexural_rigidity_mg_cm: Quantity
    kes_b_gf_cm2_per_cm: Quantity | None
    kes_2hb_gf_cm_per_cm: Quantity | None
    kes_b_outside_law_probability: float


class CaptureAbout(Excerpt):
    """The capture of an estimate, or the captures of a joint one, which has ``sources``.

    ``rig`` is empty if strips alone were measured.
    """

    source: Text | None = None
    sources: list[Text] | None = None
    density_g_m2: float = Field(gt=0)
    rig: str
    face: str = "up"
    views: int | None = None
    views_sha256: str = ""
    turns_deg: list[float] | None = None
    drape_coefficient_percent: float | None = None
    nodes: int | None = None
    known: Reported | None = None
    labels: Labels = Labels()

    @property
    def pictures_sha256(self) -> str:
        """Of what was seen; empty for numbers, which two fabrics may share."""
        numbers = self.known and self.known.drape_coefficient_percent and not self.views
        return "" if numbers else self.views_sha256


class Cloth(Excerpt):
    """Properties beside the moduli, at the fabric's density."""

    natural_curvature_warp_1_m: Quantity
    natural_curvature_weft_1_m: Quantity
    membrane_n_per_m: Quantity
    hysteresis_share: Quantity


class PosteriorRecord(Excerpt):
    """Normal posterior of :data:`drapenet.evidence.state.STATE` without hysteresis, from one
    capture and the prior."""

    names: list[str]
    mean: list[float]
    covariance: list[list[float]]


class RefinementRecord(Excerpt):
    """Outcome of a refinement by simulation, and the moduli before it."""

    misfit_before: Finite
    misfit: float
    simulations: int
    failed_simulations: int
    status: str
    message: str
    specimen: dict[str, dict[str, Any]]
    reduced_chi2: Finite = None
    fidelity: dict[str, Any] | None = None
    posterior: PosteriorRecord | None = None  # none: the network's estimate stands
    before: dict[str, DirectionModuli]


class CaptureRecord(Excerpt):
    """The estimate of one capture within a joint one."""

    capture: CaptureAbout
    moduli: dict[str, DirectionModuli]
    warnings: list[Recorded]


class LinearRecord(Excerpt):
    """Evidence of log alpha (N·m), beta/alpha (m) and natural curvature (1/m) at the fabric's
    density: :class:`common.normal.Linear`."""

    rows: list[list[float]]
    values: list[float]


class DirectionStrips(Excerpt):
    """Moduli along one direction by its strips alone."""

    alpha_uN_m: Quantity  # noqa: N815
    beta_nN_m2: Quantity  # noqa: N815
    natural_curvature_1_m: float
    natural_curvature_deviation_1_m: float
    misfit: float
    scatter_of_specimens_percent: float
    evidence: LinearRecord


class StripsRecord(Excerpt):
    """Strips of a folder."""

    source: Text
    density_g_m2: float
    strips: int
    moduli: dict[str, DirectionStrips]
    known: Known | None = None

    @classmethod
    def of_evidence(
        cls, strips: "StripSet", found: Mapping[str, "StripEvidence"]
    ) -> "StripsRecord":
        """Of strips with their evidence by direction."""
        moduli = {}
        for direction, strip in found.items():
            alpha, beta = strip.samples()
            moduli[direction] = {
                "alpha_uN_m": _intervals(alpha / MICRO), "beta_nN_m2": _intervals(beta / NANO),
                "natural_curvature_1_m": strip.curl[0],
                "natural_curvature_deviation_1_m": strip.curl[1], "misfit": strip.misfit,
                "scatter_of_specimens_percent": round(100 * strip.scatter, 1),
                "evidence": {"rows": strip.measured.rows.tolist(),
                             "values": strip.measured.values.tolist()}}
        return cls.model_validate({
            "source": printable(strips.path), "density_g_m2": round(1e3 * strips.density, 6),
            "strips": len(strips), "moduli": moduli, "known": strips.known})


class Stretch(Excerpt):
    """Along the yarns."""

    warp: Quantity
    weft: Quantity


class TensionRecord(Excerpt):
    """Strips under weights: stiffnesses at the fabric's density, ``measured`` or of usual fabrics.
    """

    source: Text
    density_g_m2: float
    strips: int
    measured: list[str]
    shear_n_per_m: Quantity
    stretch_n_per_m: Stretch
    friction_n_per_m: dict[str, float]
    weight_for_10_percent_g: dict[str, float]
    readings: dict[str, Quantity]
    along_yarns: bool
    findings: list[Recorded]
    known: Known | None = None

    @classmethod
    def of_strips(cls, tension: "TensionSet") -> "TensionRecord":
        """Of strips, estimated."""
        found = tension.evidence()
        warp, weft, shear = found.stiffness
        names = [DIRECTIONS[k] for k in found.measured]
        return cls.model_validate({
            "source": printable(tension.path), "density_g_m2": round(1e3 * tension.density, 6),
            "strips": len(tension.strips), "measured": names,
            "shear_n_per_m": _intervals(shear),
            "stretch_n_per_m": {"warp": _intervals(warp), "weft": _intervals(weft)},
            "friction_n_per_m": {name: float(found.friction[DIRECTIONS.index(name)])
                                 for name in tension.directions},
            "weight_for_10_percent_g": tension.loads(found),
            "readings": {key: _intervals(values) for key, values in found.readings().items()},
            "along_yarns": tension.along_yarns, "findings": list(found.findings),
            "known": tension.known})

    @property
    def lines(self) -> list[str]:
        """The stiffnesses in words."""
        stated = {"warp": ("stretch along the warp", self.stretch_n_per_m.warp),
                  "weft": ("stretch along the weft", self.stretch_n_per_m.weft),
                  "bias": ("shear", self.shear_n_per_m)}
        found = [f"{name} {value} N/m" + ("" if direction in self.measured else
                                          ", not measured: of usual fabrics")
                 for direction, (name, value) in stated.items()]
        loads = ", ".join(f"{direction} {value:.0f} g" for direction, value in
                          self.weight_for_10_percent_g.items())
        return found + [f"weight that stretches these strips by 10 %: {loads}"] * bool(loads)


class NextMeasurement(Excerpt):
    """A further measurement of a fabric: by how much it would lower the standard deviations of log
    alpha and of beta, means over the directions, and the minutes of work."""

    measurement: str
    alpha_narrower_percent: float
    beta_narrower_percent: float
    minutes: float

    def __str__(self) -> str:
        return (f"{self.measurement}: α {self.alpha_narrower_percent:.0f} %, β "
                f"{self.beta_narrower_percent:.0f} % ({self.minutes:g} min)")


class EstimateDocument(Excerpt):
    """The content of ``estimate.json``."""

    remedy = "give the estimate.json that infer.py writes"
    schema_: Literal[SCHEMA] = Field(alias="schema")  # type: ignore[valid-type]
    schema_version: Literal[SCHEMA_VERSION]  # type: ignore[valid-type]
    convention: Literal["warp/weft", "stiff/soft"]
    capture: CaptureAbout
    moduli: dict[str, DirectionModuli]
    moduli_at_300_g_m2: dict[str, DirectionModuli]
    laboratory: dict[str, Readings]
    kes_note: Text = ""  # where KES readings are not given, or not to be compared
    correlations: dict[str, Any]
    share_of_spread_over_fabrics: dict[str, float]
    poorly_constrained: list[str]
    torque_mN: dict[str, Any]  # noqa: N815
    cloth: Cloth
    checkpoint: dict[str, Text]
    captures: list[CaptureRecord] | None = None
    strips: list[StripsRecord] | None = None
    tension: TensionRecord | None = None
    refined: RefinementRecord | None = None
    resimulation: dict[str, Any] | None = None
    advice: list[Recorded] | None = None
    next_measurements: list[NextMeasurement] | None = None  # none: without a report
    warnings: list[Recorded]
    contradictions: list[Recorded] | None = None  # those among the warnings

    @model_validator(mode="after")
    def _require_directions(self) -> "EstimateDocument":
        if tuple(self.moduli) not in (DIRECTIONS, STIFF_SOFT):
            raise ValueError(f"moduli: the directions {shown(list(self.moduli))} are unknown")
        if any(moduli.alpha_uN_m.median <= 0 for moduli in self.moduli.values()):
            raise ValueError("moduli: alpha must be positive")
        return self

    @classmethod
    def from_estimate(
        cls, estimate: Estimate, *, capture: CaptureAbout | Mapping[str, Any],
        checkpoint: Mapping[str, str], warnings: Sequence[Finding] = (), **sections: Any,
    ) -> "EstimateDocument":
        """The document of an estimate, with all ``warnings`` and optional ``sections``."""
        names, first = estimate.names, estimate.names[0]
        shares = dict(zip(estimate.modulus_names, estimate.constraint.round(3).tolist(),
                          strict=True))
        laboratory = _readings(estimate)
        return cls.model_validate({
            "schema": SCHEMA, "schema_version": SCHEMA_VERSION,
            "convention": f"{first}/{names[2]}", "capture": capture,
            "moduli": _moduli(estimate, estimate.density),
            "moduli_at_300_g_m2": _moduli(estimate, REFERENCE_DENSITY),
            "laboratory": laboratory, "kes_note": _kes_note(laboratory),
            "correlations": {
                "of": [f"{'log ' if k < 3 else ''}{name}" for k, name in enumerate(shares)],
                "matrix": np.corrcoef(estimate.samples.T).round(3).tolist()},
            "share_of_spread_over_fabrics": shares,
            "poorly_constrained": [
                name for name, share in zip(shares, estimate.constraint, strict=True)
                if share > POORLY_CONSTRAINED],
            "torque_mN": torque_table(estimate, CURVATURES),
            "cloth": _properties(estimate),
            "checkpoint": checkpoint, **sections, "warnings": list(warnings),
            "contradictions": list(estimate.contradictions)})

    def warned(self, *found: Finding) -> "EstimateDocument":
        """The document with further warnings."""
        return self.model_copy(update={"warnings": [*self.warnings, *found]}) if found else self

    @property
    def names(self) -> tuple[str, str, str]:
        """The three directions."""
        first, second, third = self.moduli
        return first, second, third

    @property
    def identity(self) -> str:
        """Of this estimate with all that its document states: the beginning of a SHA-256."""
        text = json.dumps(self.content(), sort_keys=True)
        return hashlib.sha256(text.encode(errors="surrogateescape")).hexdigest()[:16]

    @property
    def label(self) -> str:
        """Names the capture or the strips in sentences."""
        return self.capture.source or self.strip_folders[0]

    @property
    def strip_folders(self) -> list[str]:
        """Folders of strips, hanging and under weights."""
        return [*(each.source for each in self.strips or []),
                *([self.tension.source] if self.tension else [])]

    @property
    def density(self) -> Density:
        """Of the fabric."""
        return 1e-3 * self.capture.density_g_m2

    @property
    def stiffness_in_a_drape(self) -> str:
        """The constant moduli that drape as the cloth does, in words; empty if not computed."""
        found = {name: moduli.drape_stiffness_uN_m for name, moduli in self.moduli.items()}
        return f"stiffness in a drape (secant at {DRAPE_CURVATURE:g} 1/m): " + ", ".join(
            f"{name} {value} µN·m" for name, value in found.items()) if all(found.values()) else ""

    def alphas_at(self, density: Density) -> list[Quantity]:
        """Alpha of the three directions, µN·m, of this cloth at another density."""
        return [moduli.alpha_uN_m.times(density / self.density) for moduli in self.moduli.values()]

    @property
    def parts(self) -> str:
        """Captures and strips of a joint estimate; empty for that of a single capture."""
        counts = {"capture": len(self.captures or []),
                  "strip": sum(each.strips for each in self.strips or []),
                  "strip under weight": self.tension.strips if self.tension else 0}
        return " and ".join(f"{count} {name}{'s' * (count > 1)}"
                            for name, count in counts.items() if count)

    @property
    def stated(self) -> list[Known]:
        """What captures and strips state of the fabric."""
        found = [self.capture.known, *(part.capture.known for part in self.captures or []),
                 *(each.known for each in self.strips or []),
                 self.tension.known if self.tension else None]
        return [known for known in found if known]

    @property
    def known_values(self) -> list[str]:
        """Known values of the fabric in words, each once."""
        left_out = {(found.source, found.values["value"]) for found in self.contradictions or []}
        evidence = (
            QUANTITIES[name].stated(k, value).replace(" = ", ": ")
            + " (left out, see the warnings)" * ((value_key(name, k), value) in left_out)
            for known in self.stated for (name, k), value in known.values().items())
        return list(dict.fromkeys([*evidence, *(
            line for known in self.stated for line in known.handling)]))

    @property
    def mostly_usual(self) -> list[Finding]:
        """What is poorly constrained, if anything."""
        return [Finding("mostly_usual", {"moduli": ", ".join(self.poorly_constrained)})
                ] * bool(self.poorly_constrained)

    def followed_by(self, found: Sequence[NextMeasurement]) -> "EstimateDocument":
        """The document with what may be measured next."""
        return self.model_copy(update={"next_measurements": list(found)})

    @property
    def narrowing(self) -> str:
        """What may be measured next, in words; empty if it was not computed."""
        return ("intervals would become narrower by " + "; ".join(map(str, self.next_measurements))
                if self.next_measurements else "")

    def content(self) -> dict[str, Any]:
        """The document in JSON's types."""
        return self.model_dump(by_alias=True, exclude_unset=True)

    @property
    def has_kes(self) -> bool:
        """Whether the moduli determine KES B along any direction."""
        return any(readings.kes_b_gf_cm2_per_cm for readings in self.laboratory.values())


def torque_table(estimate: Estimate, curvatures: np.ndarray) -> dict[str, Any]:
    """Torque per width, mN, at ``curvatures`` (C,), 1/m: median and intervals of each direction."""
    return {"curvature_1_m": curvatures.tolist(), **{
        name: _intervals(1e3 * estimate.torques(k, curvatures))
        for k, name in enumerate(estimate.names)}}


def _intervals(samples: np.ndarray) -> dict[str, Any]:
    """Median and central intervals of samples (S, ...), over the first axis."""
    return {"median": np.median(samples, axis=0).tolist(), **{
        key: np.quantile(samples, [(1 - level) / 2, (1 + level) / 2], axis=0).tolist()
        for key, level in INTERVALS.items()}}


def _quantities(samples: Mapping[str, np.ndarray], direction: int) -> dict[str, Any]:
    """Quantities along a direction, of samples (S, 3) by name."""
    return {key: _intervals(values[:, direction]) for key, values in samples.items()}


def _moduli(estimate: Estimate, density: Density) -> dict[str, Any]:
    alpha, beta = estimate.moduli(density)
    samples = {"alpha_uN_m": alpha / MICRO, "beta_nN_m2": beta / NANO,
               "beta_over_alpha_mm": 1e3 * beta / alpha,
               "drape_stiffness_uN_m": secant(DRAPE_CURVATURE, alpha, beta) / MICRO}
    return {name: _quantities(samples, k) for k, name in enumerate(estimate.names)}


def _properties(estimate: Estimate) -> dict[str, Any]:
    cloth, scale = estimate.cloth, estimate.density / REFERENCE_DENSITY
    return {"natural_curvature_warp_1_m": _intervals(cloth.curl[:, 0]),
            "natural_curvature_weft_1_m": _intervals(cloth.curl[:, 1]),
            "membrane_n_per_m": _intervals(cloth.membrane * scale),
            "hysteresis_share": _intervals(cloth.hysteresis)}


def _readings(estimate: Estimate) -> dict[str, Any]:
    alpha, beta = estimate.moduli()
    length = bending_length(alpha, beta, estimate.density)
    rigidity = flexural_rigidity(alpha, beta, estimate.density)
    secant, hysteresis, outside = kes(alpha, beta)
    strip = {"bending_length_mm": 1e3 * length, "flexural_rigidity_uN_m": rigidity / MICRO,
             "flexural_rigidity_mg_cm": rigidity / MG_CM}
    bending = {"kes_b_gf_cm2_per_cm": secant / GF_CM,
               "kes_2hb_gf_cm_per_cm": hysteresis / GF_CM_PER_CM}
    readings = {}
    for k, (name, share) in enumerate(
            zip(estimate.names, outside.mean(axis=0).tolist(), strict=True)):
        within = share <= MAX_OUTSIDE_SHARE
        readings[name] = {
            **_quantities(strip, k),
            **(_quantities(bending, k) if within else dict.fromkeys(bending)),
            "kes_b_outside_law_probability": round(share, 3)}
    return readings


def _kes_note(laboratory: Mapping[str, Mapping[str, Any]]) -> str:
    """Directions along which KES readings are not given or not to be compared; empty if none."""
    share = "kes_b_outside_law_probability"
    doubtful = {name: readings for name, readings in laboratory.items()
                if readings[share] > MAX_COMPARED_SHARE}
    parts = []
    for what, given in (("not given", False), ("not to be compared with measured values", True)):
        names = [f"{name} ({100 * readings[share]:.0f} %)" for name, readings in doubtful.items()
                 if bool(readings["kes_b_gf_cm2_per_cm"]) == given]
        parts += [f"{what} along {', '.join(names)}"] * bool(names)
    return f"KES B and 2HB are {' and '.join(parts)}: in that share of the samples the fabric " \
           "softens below 1.5 1/cm, so that its moduli do not determine them" if parts else ""
