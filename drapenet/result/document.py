"""``estimate.json``: the model that is made from an estimate, written and read."""

import hashlib
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from common.documents import Excerpt
from common.errors import shown
from common.findings import Finding
from common.types import Density
from data.captures.description import Labels
from data.readings import QUANTITIES
from data.readings.cantilever import MG_CM, bending_length, flexural_rigidity
from data.readings.kes import GF_CM, GF_CM_PER_CM, kes
from data.readings.known import Known, Reported
from drapenet.evidence.source import value_key
from drapenet.measured.base import (
    AnyRecord,
    Finite,
    Quantity,
    Record,
    Recorded,
    Text,
    intervals,
)
from drapenet.measured.strips.record import StripsRecord
from drapenet.measured.tension.record import TensionRecord
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

SCHEMA = "drapenet-estimate"
SCHEMA_VERSION = 6
POORLY_CONSTRAINED = 0.7  # above this ratio of standard deviation and spread over fabrics
CURVATURES = np.array([25.0, 50.0, 100.0, 200.0, 400.0])  # 1/m, of the tabulated law
COLUMNS = (*StripsRecord.names, *TensionRecord.names)
"""Columns that each table has of what is measured beside captures."""
MAX_OUTSIDE_SHARE = 0.16  # of samples outside KES's range; beyond, 68 % intervals would be, too


class DirectionModuli(Excerpt):
    """Moduli along one direction."""

    alpha_uN_m: Quantity = Field(title="linear modulus α")  # noqa: N815
    beta_nN_m2: Quantity = Field(title="quadratic modulus β")  # noqa: N815
    beta_over_alpha_mm: Quantity = Field(title="β/α")
    drape_stiffness_uN_m: Quantity | None = Field(  # noqa: N815  # none: an earlier estimate
        None, title="stiffness in a drape: secant α + βκ at 60 m⁻¹")


class Readings(Excerpt):
    """What testers would measure along one direction."""

    bending_length_mm: Quantity = Field(title="bending length c")
    flexural_rigidity_uN_m: Quantity = Field(title="flexural rigidity G")  # noqa: N815
    flexural_rigidity_mg_cm: Quantity = Field(title="the same in mg·cm")
    kes_b_gf_cm2_per_cm: Quantity | None = Field(
        title="B of KES-FB2; null if the moduli do not determine it")
    kes_2hb_gf_cm_per_cm: Quantity | None = Field(title="2HB of KES-FB2; null as B")
    kes_b_outside_law_probability: float = Field(
        title="share of the samples that do not determine B")


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
    files_sha256: list[str] | None = None  # of an outline
    turns_deg: list[float] | None = None
    drape_coefficient_percent: float | None = None
    nodes: int | None = None
    known: Reported | None = None
    labels: Labels = Labels()

    @property
    def digests(self) -> tuple[str, ...]:
        """Of what was seen and of its files."""
        return self.views_sha256, *(self.files_sha256 or ())

    @property
    def pictures_sha256(self) -> tuple[str, ...]:
        """The digests there are; empty for numbers, which two fabrics may share."""
        return () if self.reported else tuple(filter(None, self.digests))

    @property
    def reported(self) -> bool:
        """Whether it is a drape coefficient without any picture."""
        return bool(self.known and self.known.drape_coefficient_percent and not self.views)


class Cloth(Excerpt):
    """Properties beside the moduli, at the fabric's density."""

    natural_curvature_warp_1_m: Quantity = Field(title="along the warp")
    natural_curvature_weft_1_m: Quantity = Field(title="along the weft")
    membrane_n_per_m: Quantity = Field(title="in-plane stiffness along the yarns")
    hysteresis_share: Quantity = Field(title="of the torque at 1 cm⁻¹")


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


class NextMeasurement(Excerpt):
    """A further measurement of a fabric: by how much it would lower the standard deviations of log
    alpha and of beta, means over the directions, and the minutes of work."""

    measurement: str = Field(title="its name")
    alpha_narrower_percent: float = Field(title="expected reduction of the deviation of log α")
    beta_narrower_percent: float = Field(title="the same of β")
    minutes: float = Field(title="of work, assumed")

    def __str__(self) -> str:
        return (f"{self.measurement}: α {self.alpha_narrower_percent:.0f} %, β "
                f"{self.beta_narrower_percent:.0f} % ({self.minutes:g} min)")


class EstimateDocument(Excerpt):
    """The content of ``estimate.json``."""

    remedy = "give the estimate.json that infer.py writes"
    schema_: Literal[SCHEMA] = Field(alias="schema")  # type: ignore[valid-type]
    schema_version: Literal[SCHEMA_VERSION]  # type: ignore[valid-type]
    convention: Literal["warp/weft", "stiff/soft"] = Field(
        title="names of the directions: warp/weft, or stiff/soft if the warp is not marked")
    capture: CaptureAbout = Field(
        title="what was measured and stated: source (sources of a joint estimate), density, rig, "
              "face, digests, turns, drape coefficient, nodes, known, labels")
    moduli: dict[str, DirectionModuli] = Field(title="at the fabric's density")
    moduli_at_300_g_m2: dict[str, DirectionModuli] = Field(title="the same keys, at 300 g/m²")
    laboratory: dict[str, Readings] = Field(title="what testers would measure")
    kes_note: Text = Field("", title="where KES readings are not given")
    correlations: dict[str, Any] = Field(title="of log α and β/α: of, matrix")
    share_of_spread_over_fabrics: dict[str, float] = Field(
        title="standard deviation of each modulus over its spread over fabrics")
    poorly_constrained: list[str] = Field(
        title="moduli, and the ratio of the yarns' α, for which this exceeds 0.7")
    mostly_usual: list[Recorded] = Field([], title="the finding that names them, if any")
    assumed: list[Recorded] = Field(
        [], title="findings: what was assumed of the values of testers, if there are any")
    torque_mN: dict[str, Any] = Field(  # noqa: N815
        title="torque per width of each direction at curvature_1_m")
    cloth: Cloth = Field(title="other properties")
    checkpoint: dict[str, Text] = Field(title="the network")
    captures: list[CaptureRecord] | None = Field(
        None, title="of a joint estimate: capture, moduli and warnings of each alone")
    strips: list[StripsRecord] | None = Field(
        None, title="of hanging strips: source, density, moduli of each direction by them alone")
    tension: TensionRecord | None = Field(None, title="by strips under weights")
    measured: list[AnyRecord] | None = Field(None, title="records of other kinds")
    refined: RefinementRecord | None = Field(
        None, title="outcome of a refinement, and the moduli before it")
    resimulation: dict[str, Any] | None = Field(None, title="the simulated drape")
    advice: list[Recorded] | None = Field(
        None, title="specimens or strips that would say more")
    next_measurements: list[NextMeasurement] | None = Field(
        None, title="of an estimate with a report, what would narrow it")
    warnings: list[Recorded] = Field(title="records of findings")
    contradictions: list[Recorded] | None = Field(
        None, title="those of the warnings that name what contradicts the rest")

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
        shares = estimate.constraint
        poor = [name for name, share in shares.items() if share > POORLY_CONSTRAINED]
        document = cls.model_validate({
            "schema": SCHEMA, "schema_version": SCHEMA_VERSION,
            "convention": f"{first}/{names[2]}", "capture": capture,
            "moduli": _moduli(estimate, estimate.density),
            "moduli_at_300_g_m2": _moduli(estimate, REFERENCE_DENSITY),
            "laboratory": _readings(estimate),
            "correlations": {
                "of": [f"{'log ' if k < 3 else ''}{name}"
                       for k, name in enumerate(estimate.modulus_names)],
                "matrix": np.corrcoef(estimate.samples.T).round(3).tolist()},
            "share_of_spread_over_fabrics": {
                name: round(share, 3) for name, share in shares.items()},
            "poorly_constrained": poor,
            "mostly_usual": [Finding("mostly_usual", {"moduli": ", ".join(poor)})] * bool(poor),
            "torque_mN": torque_table(estimate, CURVATURES),
            "cloth": _properties(estimate),
            "checkpoint": checkpoint, **sections, "warnings": list(warnings),
            "contradictions": list(estimate.contradictions)})
        return document.model_copy(update={"assumed": [*document._assumptions()],
                                           "kes_note": document._kes_note()})

    def _kes_note(self) -> str:
        """Where KES readings are not given, and those stated; empty if none."""
        names = [f"{name} ({100 * readings.kes_b_outside_law_probability:.0f} %)"
                 for name, readings in self.laboratory.items() if not readings.kes_b_gf_cm2_per_cm]
        stated = "".join(f"; stated is {each}" for each in self.known_values if "KES " in each)
        return f"KES B and 2HB are not given along {', '.join(names)}: in that share of the " \
               "samples the fabric softens below 1.5 1/cm, so that its moduli do not determine " \
               f"them; up to {100 * MAX_OUTSIDE_SHARE:g} % is allowed{stated}" if names else ""

    def _assumptions(self) -> Iterator[Finding]:
        """What is assumed of the values that are stated, and which directions they leave to the
        prior where there is no drape."""
        values = [(each, known) for known in self.stated for each in known.values()]
        along = {k for (name, k), _ in values if QUANTITIES[name].directions > 1}
        along |= {DIRECTIONS.index(name) for each in self.strips or [] for name in each.moduli}
        if not self.capture.rig and len(along) < len(DIRECTIONS):
            names = " and ".join(self.names[k] for k in sorted(along))
            yield (Finding("bending_usual", {"measured": names}) if along else
                   Finding("bending_unmeasured"))
        errors = {f"{QUANTITIES[name].in_words} {100 * known.error(name):g} %": None
                  for (name, _), known in values if name not in known.error_percent}
        if errors:
            yield Finding("errors_assumed", {"errors": ", ".join(errors)})

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
        return self.capture.source or self.records[0].source

    @property
    def records(self) -> list[Record]:
        """What was measured beside captures."""
        return [*(self.strips or []), *filter(None, [self.tension]), *(self.measured or [])]

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
        single = bool(self.capture.source and self.records)
        counts = Counter({("capture", "captures"): len(self.captures or []) or int(single)})
        for count, *names in (record.counted() for record in self.records):
            counts[names[0], names[1]] += count
        return " and ".join(f"{count} {several if count > 1 else one}"
                            for (one, several), count in counts.items() if count)

    @property
    def stated(self) -> list[Known]:
        """What captures and strips state of the fabric."""
        found = [self.capture.known, *(part.capture.known for part in self.captures or []),
                 *(record.known for record in self.records)]
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


def sections_of(records: Sequence[Record]) -> dict[str, Any]:
    """The sections of a document that have these records."""
    found: dict[str, Any] = {}
    for record in records:
        own = record.kind in EstimateDocument.model_fields
        found.setdefault(record.kind if own else "measured", []).append(record)
    if TensionRecord.kind in found:
        found[TensionRecord.kind], = found[TensionRecord.kind]
    return found


def torque_table(estimate: Estimate, curvatures: np.ndarray) -> dict[str, Any]:
    """Torque per width, mN, at ``curvatures`` (C,), 1/m: median and intervals of each direction."""
    return {"curvature_1_m": curvatures.tolist(), **{
        name: intervals(1e3 * estimate.torques(k, curvatures))
        for k, name in enumerate(estimate.names)}}


def _quantities(samples: Mapping[str, np.ndarray], direction: int) -> dict[str, Any]:
    """Quantities along a direction, of samples (S, 3) by name."""
    return {key: intervals(values[:, direction]) for key, values in samples.items()}


def _moduli(estimate: Estimate, density: Density) -> dict[str, Any]:
    alpha, beta = estimate.moduli(density)
    samples = {"alpha_uN_m": alpha / MICRO, "beta_nN_m2": beta / NANO,
               "beta_over_alpha_mm": 1e3 * beta / alpha,
               "drape_stiffness_uN_m": secant(DRAPE_CURVATURE, alpha, beta) / MICRO}
    return {name: _quantities(samples, k) for k, name in enumerate(estimate.names)}


def _properties(estimate: Estimate) -> dict[str, Any]:
    cloth, scale = estimate.cloth, estimate.density / REFERENCE_DENSITY
    return {"natural_curvature_warp_1_m": intervals(cloth.curl[:, 0]),
            "natural_curvature_weft_1_m": intervals(cloth.curl[:, 1]),
            "membrane_n_per_m": intervals(cloth.membrane * scale),
            "hysteresis_share": intervals(cloth.hysteresis)}


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
