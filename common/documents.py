"""Reading of YAML, JSON, text and NPZ files: regular files of bounded size.

Contents are validated by a :class:`Schema`; every fault raises an InputError of one line.
"""

import codecs
import os
import re
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path
from typing import Any, ClassVar, TypeVar, get_args

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import from_json

from common.errors import InputError, one_line, shown

MAX_TEXT_BYTES = 1 << 16  # written by people
MAX_DOCUMENT_BYTES = 64 << 20  # written by programs; also each array of an npz file
T = TypeVar("T", bound="Schema")


class Schema(BaseModel):
    """Content of a document: types are not converted, unknown keys refused, numbers finite.

    A field's title is its meaning, in docs/data_format.md; its description is the remedy in
    error messages.
    """

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)
    remedy: ClassVar[str] = ""

    @classmethod
    def of(cls: type[T], content: object, what: str | Path) -> T:
        """Validate the content of the document ``what``, which error messages begin with."""
        try:
            return cls.model_validate(content)
        except ValidationError as error:
            place = error.errors()[0]["loc"]
            field = cls.model_fields.get(str(place[0])) if place else None
            remedies = [(field.description if field else None) or cls.remedy]
            inner = [part for part in get_args(field.annotation) if hasattr(part, "model_fields")
                     ] if field else []
            for count, models in enumerate(([cls], inner), start=1):
                unknown = [str(fault["loc"][-1]) for fault in error.errors() if len(
                    fault["loc"]) == count and fault["type"] == "extra_forbidden"]
                if models and unknown:
                    keys = models[0].model_fields
                    meant = [near for name in unknown for near in get_close_matches(name, keys, 1)]
                    remedies[:0] = [f"do you mean {', '.join(meant)}"] if meant else []
                    remedies.append(f"the keys are {', '.join(keys)}")
            raise InputError("; ".join([faults(error), *filter(None, remedies)]), source=what
                             ) from None


class Excerpt(Schema):
    """Schema that ignores unknown keys."""

    model_config = ConfigDict(extra="ignore")


_PLAIN = {"float_type": "is not a number; write digits alone, without a unit",
          "int_type": "is not a whole number",
          "string_pattern_mismatch": "has characters that are not taken",
          "model_type": "must be 'key: value' pairs in braces",
          "greater_than": "must be more than {gt:g}{unit}",
          "greater_than_equal": "must be at least {ge:g}{unit}",
          "less_than": "must be less than {lt:g}{unit}",
          "less_than_equal": "must be at most {le:g}{unit}"}
"""Sentences in place of Pydantic's, by the type of fault, with its limit."""
_UNITS = {
    "_g_m2": " g/m²",
    "_mm": " mm",
    "_percent": " %",
    "_deg": "°",
    "_n_per_m": " N/m",
}
"""By the ends of keys."""


def faults(error: ValidationError) -> str:
    """All unknown keys, and up to three other faults in one line: path of the field, value, and
    Pydantic's message.
    """
    lines, unknown = [], []
    for fault in error.errors():
        name, text = ".".join(map(str, fault["loc"])), one_line(Exception(fault["msg"]))
        if fault["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
            unknown.append(shown(name))
        elif fault["type"] == "missing":
            lines.append(f"{name} is missing")
        elif re.fullmatch(r"[+-]?\d{1,9},\d{1,9}", shown(fault["input"]).strip("'")):
            lines.append(f"{name}={fault['input']} has a decimal comma; write a point")
        elif fault["type"] in _PLAIN:
            unit = next((unit for end, unit in _UNITS.items() if name.endswith(end)), "")
            said = _PLAIN[fault["type"]].format(**fault.get("ctx", {}), unit=unit)
            lines.append(f"{name}={shown(fault['input'])} {said}")
        else:
            # Sentences of the project's validators go on after the value, or the key of several.
            alone = not name or isinstance(fault["input"], dict)
            value = name if alone else f"{name}={shown(fault['input'])}"
            lines.append(f"{value}: {text}".replace(": Value error, ", " ").strip(": "))
    keys = [f"unknown key{'s' * (len(unknown) > 1)} {', '.join(unknown[:12])}"] if unknown else []
    return "; ".join([*keys, *lines][:3])


_DECIMALS = re.compile(r"\d+([eE][-+]?\d+)?")


def _glued_comment(node: Any) -> str:
    """The comment, such as #42, after a text or nothing, that a name may have been meant to be."""
    plain = isinstance(node, yaml.ScalarNode) and not node.style
    if not plain or node.tag.rpartition(":")[2] not in ("str", "null"):
        return ""
    mark = node.end_mark
    found = re.compile(r"[ \t]*(#\w[^\s\0]*)").match(mark.buffer, mark.pointer)
    return found[1] if found else ""


_NUMBERS = {
    "int": (re.compile(r"[-+]?[0-9]+(_[0-9]+)*$"), int),
    "float": (re.compile(r"[-+]?(([0-9]+(_[0-9]+)*\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?"
                         r"|\.(inf|Inf|INF))$|\.(nan|NaN|NAN)$"),
              lambda text: float(re.sub(r"\.(?=inf|nan)", "", text.lower())))}
"""Decimal numbers, and what makes them of their text."""
_NUMBER_TAGS = {f"tag:yaml.org,2002:{name}": number for name, number in _NUMBERS.items()}


def decimal(kind: Any) -> Any:
    """A class of PyYAML's loaders or dumpers with decimal numbers, as people write them.

    YAML 1.1 reads 0150 as 104, 1:30 as 90, and 1e3 as a text. Here they are 150, a text, as 0x10
    and dates are, and 1000.
    """
    dropped = {*_NUMBER_TAGS, "tag:yaml.org,2002:timestamp"} if hasattr(
        kind, "construct_object") else {}  # a dumper quotes texts that others read as numbers
    kind.yaml_implicit_resolvers = {
        first: [(tag, pattern) for tag, pattern in resolvers if tag not in dropped]
        for first, resolvers in kind.yaml_implicit_resolvers.items()}
    for tag, (pattern, make) in _NUMBER_TAGS.items():
        kind.add_implicit_resolver(tag, pattern, [*"-+.0123456789"])
        if dropped:
            kind.add_constructor(tag, lambda loader, node, make=make: make(
                loader.construct_scalar(node)))
    return kind


@decimal
class _Dumper(yaml.SafeDumper):
    """Quotes texts that :class:`_Loader` would read as numbers."""


def yaml_text(content: Mapping) -> str:
    """The YAML text that :func:`parse_yaml` reads as ``content``, with its keys in their order."""
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False)


@decimal
class _Loader(yaml.SafeLoader):
    """Refuses aliases, which may expand exponentially, and repeated keys."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose one node."""
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("aliases (*name) are not taken: write the value out")
        return super().compose_node(parent, index)

    def mapping_of(self, node: Any) -> dict:
        """Construct a mapping whose keys differ."""
        mapping, before = {}, ""
        for key_node, value_node in node.value:
            key = self.construct_object(key_node, deep=True)
            if value_node.value == "" and _DECIMALS.fullmatch(str(key_node.value)):
                raise InputError(f"{before},{key_node.value} has a decimal comma; write a point")
            if comment := _glued_comment(value_node):
                raise InputError(f"{key_node.value}: {comment} is a comment there and would be "
                                 "dropped; put the whole value in quotes, or a space after #")
            if key in mapping:
                raise yaml.YAMLError(f"the key {shown(key)} occurs twice; remove one")
            mapping[key] = self.construct_object(value_node, deep=True)
            before = f"{key}={value_node.value}" * isinstance(value_node.value, str)
        return mapping


_Loader.add_constructor("tag:yaml.org,2002:map", _Loader.mapping_of)


_TYPED = ((re.compile("[\u00a0\u2007\u202f\u3000]"), " "),  # spaces that do not break, or are wide
          (re.compile(r"^([ \t]*\w+) *\uff1a *", re.MULTILINE), r"\1: "),  # full-width colon
          (re.compile(r"(?<=[ ,:\[{])\u2212(?=[.\d])"), "-"),  # minus sign
          (re.compile(r"^( *\w+:)\t+", re.MULTILINE), r"\1 "))
"""Marks of word processors and Asian keyboards, and what stands for them."""
_IN_QUOTES = re.compile(r'(\s*"\w+:.*"\s*)+')


def parse_yaml(text: str, what: str | Path) -> Mapping:
    """Parse YAML text of ``key: value`` lines, named ``what`` in errors."""
    for mark, meant in _TYPED:
        text = mark.sub(meant, text)
    if _IN_QUOTES.fullmatch(text):
        raise InputError("has each line in quotes, as spreadsheets write it; remove those at the "
                         "ends of lines, in a text editor", source=what, joint=" ")
    try:
        content = yaml.load(text, _Loader)
    except InputError as error:
        raise InputError(error.message, source=what) from None
    except Exception as error:  # PyYAML raises any for values that contradict their tag: "!!int ''"
        raise InputError(f"is not valid YAML ({_syntax_fault(error, text)})", source=what,
                         joint=" ") from None
    if not isinstance(content, Mapping):
        raise InputError("must hold 'key: value' lines, such as 'density_g_m2: 150'",
                         source=what, joint=" ")
    return content


def _syntax_fault(error: Exception, text: str) -> str:
    """What is wrong with a YAML text, with the line and what to do about it."""
    mark = getattr(error, "problem_mark", None)
    lines = text.splitlines()
    if mark is None or mark.line >= len(lines):
        return one_line(error)
    problem = getattr(error, "problem", None) or one_line(error)
    if "\t" in problem or r"'\t'" in problem:
        problem = "a tab stands before it"
    return (f"line {mark.line + 1}, {shown(lines[mark.line].strip())}: {problem}; put texts with "
            ": # @ and other marks in quotes, and indent with spaces")


def parse_json(data: bytes | str, what: str | Path, remedy: str = "copy it again") -> Any:
    """Parse JSON, named ``what`` in errors, without NaN and deep nesting."""
    try:
        return from_json(data, allow_inf_nan=False)
    except ValueError as error:
        raise InputError(f"is damaged or not a JSON document ({one_line(error)}); {remedy}",
                         source=what, joint=" ") from None


def read_yaml(file: Path) -> Mapping:
    """Read a YAML file of ``key: value`` lines."""
    return parse_yaml(read_text(file), file)


def read_json(file: Path, *, remedy: str = "copy it again") -> Any:
    """Read a JSON file."""
    return parse_json(read_bytes(file, MAX_DOCUMENT_BYTES, "JSON file"), file, remedy)


def read_text(file: Path, max_bytes: int = MAX_TEXT_BYTES, kind: str = "description") -> str:
    """Read a text file of up to ``max_bytes`` bytes, see :func:`decoded_text`."""
    return decoded_text(read_bytes(file, max_bytes, kind), file)


_IN_UTF8 = "save it in UTF-8, in a spreadsheet as CSV UTF-8"


def decoded_text(data: bytes, what: str | Path) -> str:
    """Text in UTF-8, or in what its byte order mark states; ``what`` begins errors."""
    marked = data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    try:
        text = data.decode("utf-16" if marked else "utf-8-sig")
    except UnicodeDecodeError as error:
        line, word = 1 + data.count(b"\n", 0, error.start), shown(_around(data, error.start))
        found = "UTF-16, as its first bytes state" if marked else (
            f"UTF-8 (line {line} has {word} if it is in Windows-1252)")
        raise InputError(f"is not text in {found}; {_IN_UTF8}", source=what, joint=" ") from None
    if "\0" in text:
        raise InputError("is not text in UTF-8: it has zero bytes, as UTF-16 without a byte order "
                         f"mark; {_IN_UTF8}", source=what, joint=" ")
    return text


def _around(data: bytes, place: int) -> str:
    """The word around a byte, as Windows-1252."""
    before = re.split(rb"\s", data[max(place - 20, 0) : place])[-1]
    after = re.split(rb"\s", data[place : place + 20])[0]
    return (before + after).decode("cp1252", errors="replace")


def misnamed(names: Iterable[str], file: str) -> str:
    """The one of ``names`` that stands for ``file``, NAME.yaml, in another case, with a copy's
    number or suffixes, which Windows hides; or ''."""
    meant = re.compile(rf"{file.removesuffix('.yaml')} ?(\(\d+\))?\.ya?ml(\.ya?ml|\.txt)*", re.I)
    return next((name for name in sorted(names) if meant.fullmatch(name)), "")


def require_file_in(folder: Path, name: str, content: str) -> Path:
    """The file ``name`` of a folder; InputError, with what to write in it, if there is none."""
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder; give the one that holds {name}")
    if not (folder / name).exists():
        if other := misnamed(os.listdir(folder), name):
            raise InputError(f"{folder / other}: {rename_remedy(name)}")
        raise InputError(f"{folder} has no {name}; write it with {content} (docs/use.md)")
    return folder / name


def rename_remedy(file: str) -> str:
    """What to do with a file that is :func:`misnamed`."""
    return f"rename it to {file} (Windows shows suffixes under View, File name extensions)"


def read_bytes(file: Path, max_bytes: int, kind: str) -> bytes:
    """Read a regular file of up to ``max_bytes`` bytes; ``kind`` names its type in errors."""
    require_regular(file, max_bytes, kind)
    with reading(file, "check the permissions"):
        return file.read_bytes()


def require_regular(file: Path, max_bytes: int, kind: str) -> None:
    """InputError for pipes, which would block, devices, which may be endless, and large files."""
    with reading(file, "check the path and the permissions"):
        size = file.stat().st_size
    if not file.is_file():
        raise InputError(f"is not a regular file; give a {kind}", source=file, joint=" ")
    if size > max_bytes:
        raise InputError(f"has {size} bytes; a {kind} has at most {max_bytes}", source=file,
                         joint=" ")


def read_arrays(file: Path, names: Sequence[str], *, expected: str) -> dict[str, np.ndarray]:
    """Arrays ``names``, of any shape, of an npz file; ``expected`` describes it in errors."""
    require_regular(file, MAX_DOCUMENT_BYTES, "file of arrays")
    arrays = {}
    with reading(file, f"give {expected}"), zipfile.ZipFile(file) as archive:
        for name in names:
            if f"{name}.npy" not in archive.namelist():
                raise InputError(f"has no array '{name}'; give {expected}", source=file, joint=" ")
            member = archive.getinfo(f"{name}.npy")
            if member.file_size > MAX_DOCUMENT_BYTES:
                raise ValueError(f"{name} is too large")
            # A header may claim any size: memory is not committed before it is written to.
            arrays[name] = np.lib.format.read_array(archive.open(member))
    return arrays


@contextmanager
def reading(file: Path, remedy: str) -> Iterator[None]:
    """Raise an InputError of one line for any error of a library that reads a damaged ``file``."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # of zipfile, zlib, tokenize and others, some without a class
        reason = getattr(error, "strerror", None) or one_line(error)
        raise InputError(f"cannot be read ({reason}); {remedy}", source=file, joint=" ") from None


def differences(old: object, new: object, prefix: str = "") -> list[str]:
    """Dotted names of the settings in which ``old`` and ``new`` differ."""
    if not (isinstance(old, dict) and isinstance(new, dict)):
        return [] if old == new else [prefix]
    names = sorted(old.keys() | new.keys())
    return [difference for name in names for difference in
            differences(old.get(name), new.get(name), f"{prefix}.{name}" if prefix else name)]
