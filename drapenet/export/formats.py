"""Formats of other tools: rows of ``formats.yaml``; relations and sources: ``docs/exports.md``.

A tool with one modulus per direction gets the secant of the torque at a curvature, by default the
stiffness in a drape; one whose hinges buckle gets two. What is not known keeps the tool's default.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from common.errors import InputError
from common.files import replace_file
from drapenet.export.material import Material, read_material
from drapenet.export.quantities import ASSUMED_MM, filled, hinge_quantities, quantities
from drapenet.export.writers import WRITERS, File


@dataclass(frozen=True)
class Target:
    """An export format, a row of ``formats.yaml``.

    Attributes:
        file: usual name.
        lost: what is missing from the file or approximated.
        fields: their name, quantity, unit, note and limits.
        edges, hinges: the values hold for the stated edges, or mesh, alone.
    """

    file: str
    tool: str
    lost: str
    writer: str
    fields: Sequence[Mapping[str, Any]] = ()
    frame: Any = None
    under: list[str] = field(default_factory=list)
    edges: bool = False
    hinges: bool = False

    def write(self, material: Material, name: str) -> dict[str, bytes]:
        """The files' bytes by name, the file ``name`` first."""
        values = quantities(material) | (hinge_quantities(material) if self.hinges else {})
        given = filled(self.fields, values)
        about = (material.about_hinges if self.hinges else material.about_edges if self.edges else
                 material.about) | {
            "tool_defaults": sorted({row["field"] for row in self.fields} - {*given}),
            "units": {row["field"]: row["unit"] for row in self.fields
                      if row["field"] in given and "unit" in row}}
        if limited := [row["field"] for row in self.fields if given.get(row["field"], np.nan) in (
                row.get("least"), row.get("most"))]:
            about["limited"] = limited
        if "thickness" not in values and any(row.get("value") == "assumed" for row in self.fields):
            about["thickness_assumed_mm"] = ASSUMED_MM
        known = {row["field"]: given.get(row["field"]) for row in self.fields if "value" in row}
        return WRITERS[self.writer](File(
            material, name, given, known, about, self.frame, self.under))


TARGETS = {name: Target(**row) for name, row in yaml.safe_load(
    Path(__file__).with_name("formats.yaml").read_text(encoding="utf-8")).items()}
ALIASES = {
    "clo": "jfab",
    "clo3d": "jfab",
    "marvelous": "jfab",
    "marvelousdesigner": "jfab",
    "browzwear": "u3m",
    "vstitcher": "u3m",
    "unreal": "usd",
    "style3d": "newton",
    "vbd": "newton",
    "houdini": "cards",
    "isaac": "isaaclab",
    "contourcraft": "hood"}


def table() -> str:
    """Name, usual file and tool of each target, and the names of programs, as text."""
    lines = [f"{name:<10}{t.file:<20}{t.tool}" for name, t in TARGETS.items()]
    return "\n".join([*lines, f"also: {_programs()}"])


def _programs() -> str:
    return ", ".join(f"{name} ({target})" for name, target in ALIASES.items())


def names_in(words: str) -> list[str]:
    """Names with commas, in brackets or not."""
    return [word.strip().lower() for word in words.strip("[]").split(",")]


def targets_named(words: str, key: str = "to") -> list[str]:
    """Parse ``words``, the value of ``key``: names of targets with commas, or ``all``."""
    if words == "all":
        return list(TARGETS)
    names = names_in(words)
    for name in names:
        if name not in TARGETS and name not in ALIASES:
            raise InputError(f"{key}={name}: unknown; choose from {', '.join(TARGETS)}, all, or a "
                             f"program: {_programs()}; docs/exports.md says why others are not "
                             "offered")
    return list(dict.fromkeys(ALIASES.get(name, name) for name in names))


def export(material: Material, name: str, out: Path) -> list[Path]:
    """Write a target's file to ``out`` and its further files beside it; their paths."""
    return _written(TARGETS[name].write(material, out.name), out.parent)


def _written(files: Mapping[str, bytes], folder: Path) -> list[Path]:
    for name, data in files.items():
        replace_file(folder / name, data)
    return [folder / name for name in files]


def files_of(material: Material, names: Iterable[str]) -> tuple[dict[str, bytes], list[str]]:
    """Files of the targets ``names`` under their usual names, and the sentences of those that
    refuse."""
    files: dict[str, bytes] = {}
    refusals = []
    for target in (TARGETS[name] for name in names):
        try:
            files |= target.write(material, target.file)
        except InputError as error:
            refusals.append(f"{target.file} ({target.tool}): {error}")
    return files, refusals


def export_beside(file: Path, names: Sequence[str]) -> str:
    """Write the targets ``names`` beside an ``estimate.json``, and those again that are there of
    one before; lines with the files' names, what refuses, and what is not known."""
    material = read_material(file)
    before = [name for name, target in TARGETS.items() if (file.parent / target.file).exists()]
    written, refusals = export_all(material, dict.fromkeys([*names, *before]), file.parent)
    unknown = ", ".join(material.not_known)
    lines = [f"exports:  {file.parent}: {', '.join(path.name for path in written) or 'none'}",
             *(f"left out: {refusal}" for refusal in refusals),
             *["for finer meshes: python -m drapenet.export edge_mm=, estimate="
               f"{file.parent}"] * bool(refusals),
             *[f"not known, so that tools keep their defaults: {unknown}"] * bool(unknown)]
    return "\n".join(lines)


def export_all(
    material: Material, names: Iterable[str], folder: Path
) -> tuple[list[Path], list[str]]:
    """Write :func:`files_of` to a folder; their paths, and the sentences of what refuses."""
    files, refusals = files_of(material, names)
    return _written(files, folder), refusals
