"""A study: a function that gives a sample, the keys of its command, and its report.

A module of a folder of this package is a study if it has a ``STUDY``. Samples are independent: they
are made in processes, and resumed (:mod:`common.cases`).
"""

import ast
import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from common.cases import run_cases
from common.configs import Workers
from common.documents import faults, parse_yaml
from common.errors import InputError
from common.files import require_file, require_folder
from data.dataset.config import VERSION as DRAPES
from experiments.report import Report, write_report

FOLDERS = ("speed", "estimation")
FILES = {file.stem: file for folder in FOLDERS
         for file in sorted((Path(__file__).parent / folder).glob("*.py"))
         if "\nSTUDY = " in file.read_text(encoding="utf-8")}
"""Modules of the studies by name, ordered by folder."""

Sample = dict[str, Any]
"""Result of one case, of JSON types."""
K = TypeVar("K", bound="PlainKeys")


class PlainKeys(BaseModel):
    """Keys of the command of a study, with their defaults; a study adds its own."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False,
                              coerce_numbers_to_str=True)
    out: str = ""  # the report; empty: outputs/experiments/NAME.json

    @classmethod
    def read(cls: type[K], words: list[str]) -> K:
        """Keys of the words ``key=value``, values as in YAML; InputError for others."""
        stated: dict[str, Any] = {}
        lists = [key for key, one in cls.model_fields.items() if isinstance(one.default, tuple)]
        for word in words:
            key, equals, value = word.partition("=")
            if not equals:
                raise InputError(f"{word}: write KEY=VALUE without spaces around =; --help lists "
                                 "the keys")
            if key in lists and value[:1] != "[":
                value = f"[{value}]"
            stated |= parse_yaml(f"{key}: {value}", word) if value else {key: ""}
        try:
            return cls(**stated)
        except ValidationError as error:
            raise InputError(f"{faults(error)}; --help lists the keys") from None

    @classmethod
    def text(cls) -> str:
        """A line for each key, with its default and the comment beside it."""
        source = "".join(inspect.getsource(kind) for kind in cls.__mro__[::-1]
                         if issubclass(kind, PlainKeys))
        lines = []
        for key, one in cls.model_fields.items():
            comment = re.search(rf"^    {key}: .*?(  # .*|)$", source, re.MULTILINE)
            lines.append(f"{key}: {one.default!r}{comment[1] if comment else ''}")
        return "\n".join(lines)


class CaseKeys(PlainKeys):
    """Keys of a study of cases."""

    workers: Workers = 1  # processes, one thread each
    cases: str = ""  # folder of finished cases; empty: outputs/experiments/NAME


EXECUTION_KEYS = ("workers", "cases", "out")
"""Keys that do not change a report."""


@dataclass(frozen=True)
class Study:
    """A study.

    Attributes:
        run: from keys to the report.
        block: of the report, what the documentation shows of it: sentences, tables.
    """

    keys: type[PlainKeys]
    run: Callable[[Any], Report]
    block: Callable[[Report], str] | None = None


def study(name: str) -> Study:
    """The study of a module."""
    return import_module(f"experiments.{FILES[name].parent.name}.{name}").STUDY


def folder_of(keys: CaseKeys) -> Path:
    """The folder of the cases."""
    name = type(keys).__module__.rpartition(".")[2]
    return Path(keys.cases or f"outputs/experiments/{name}")


def samples_of(
    function: Callable[..., Any], keys: CaseKeys, cases: int | Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    """Samples by name of a ``function`` at the top of a module, made or read.

    It takes those of the keys that it names, the settings of its case and, as ``rng``, a generator
    that its seed and number begin.

    Args:
        cases: settings by name, or a count: ``number`` from 0.
    """
    if isinstance(cases, int):
        cases = {f"sample_{k:03}": {"number": k} for k in range(cases)}
    taken = inspect.signature(function).parameters
    known = {key: value for key, value in dict(keys).items()
             if key in taken or (key == "seed" and "rng" in taken)}
    place = {"module": function.__module__, "name": function.__name__}
    found = run_cases(sampled, {name: {"settings": known | dict(settings), **place}
                                for name, settings in cases.items()},
                      folder=folder_of(keys), workers=keys.workers,
                      version=DRAPES)  # a study that samples otherwise is given another folder
    return {name: one["sample"] for name, one in found.items()}


def sampled(*, module: str, name: str, settings: Sample) -> Sample:
    """A sample of a function."""
    function = getattr(import_module(module), name)
    taken = inspect.signature(function).parameters
    if "rng" in taken:
        rng = np.random.default_rng([settings["seed"], settings["number"]])
        settings = {key: value for key, value in settings.items() if key in taken} | {"rng": rng}
    return {"sample": function(**settings)}


def run(name: str, words: list[str]) -> tuple[Path, Report]:
    """Run a study with the ``words`` of its command; write the report."""
    this = study(name)
    keys = this.keys.read(words)
    out = Path(keys.out or f"outputs/experiments/{name}.json").resolve()
    require_file(out)
    if isinstance(keys, CaseKeys):
        require_folder(folder_of(keys))
    settings = {key: value for key, value in dict(keys).items() if key not in EXECUTION_KEYS}
    report = {"settings": settings, **this.run(keys)}
    write_report(out, report)
    return out, report


def about(name: str) -> str:
    """The docstring of a study's module."""
    return ast.get_docstring(ast.parse(FILES[name].read_text(encoding="utf-8"))) or ""
