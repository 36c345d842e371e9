"""Structured data from outside: regular files of bounded size and depth, and what they must hold.

Every reader of YAML, JSON or a table goes through here, with a :class:`Schema` beside it; whatever
is wrong ends in an InputError of one line: quantity, value, limit, remedy.
"""

import csv
import json
import os
import reprlib
import stat
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import from_json

from common.errors import InputError, one_line

LARGEST_TEXT = 1 << 16  # bytes, of what people write
LARGEST_TABLE = 8 << 20  # bytes
LARGEST_DOCUMENT = 64 << 20  # bytes, of what programs write
DEEPEST = 20  # levels of a YAML text; of JSON the parser allows 200
T = TypeVar("T", bound="Schema")


class Schema(BaseModel):
    """What a document must hold; a field's description is the remedy where it does not.

    Numbers are finite, whole ones and truth values are not taken for each other, and text is never
    taken for a number. Unknown keys are refused unless a schema ignores them.
    """

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)
    remedy: ClassVar[str] = ""

    @classmethod
    def of(cls: type[T], content: object, what: str | Path) -> T:
        """The content, validated, of the document called ``what``, which messages begin with."""
        try:
            return cls.model_validate(content)
        except ValidationError as error:
            prefix = f"{what}: " if what else ""
            raise InputError(prefix + cls._complaint(error)) from None

    @classmethod
    def _complaint(cls, error: ValidationError) -> str:
        first = min(error.errors(include_url=False), key=lambda one: one["type"] != _UNKNOWN)
        place, kind = first["loc"], first["type"]
        field = cls.model_fields.get(str(place[0])) if place else None
        remedy = (field.description if field else None) or cls.remedy
        name = ".".join(map(str, place))
        if kind == _UNKNOWN:
            known = ", ".join(sorted(cls.model_fields)) if len(place) == 1 else ""
            return f"unknown key {shown(name)}" + (f"; known keys: {known}" if known else "")
        if kind == "missing":
            complaint = f"{name} is missing"
        else:
            limits = {key: getattr(limit, key) for limit in (field.metadata if field else ())
                      for key in ("ge", "le") if hasattr(limit, key)}
            words = _WORDS["outside" if len(limits) == 2 and kind.endswith("_equal") else kind
                           if kind in _WORDS else "value_error"].format_map(
                {"error": one_line(Exception(first["msg"])), **limits, **first.get("ctx", {})})
            complaint = (f"{name}={shown(first['input'])} " if name else "") + words
        return complaint + (f"; {remedy}" if remedy else "")


class Excerpt(Schema):
    """What is read of a document that holds more."""

    model_config = ConfigDict(extra="ignore")


_UNKNOWN = "extra_forbidden"
_WORDS = {
    "outside": "is outside {ge:g}-{le:g}",
    "float_type": "is not a number", "int_type": "is not a whole number",
    "finite_number": "is not a finite number", "string_type": "is not a text",
    "list_type": "is not a list", "dict_type": "is not a mapping", "bool_type": "is not true or "
    "false", "model_type": "is not a mapping", "greater_than": "must be more than {gt:g}",
    "greater_than_equal": "must be at least {ge:g}", "less_than": "must be less than {lt:g}",
    "less_than_equal": "must be at most {le:g}", "too_long": "has {actual_length} items, at most "
    "{max_length} are taken", "too_short": "has {actual_length} items, at least {min_length} are "
    "needed", "string_too_long": "is longer than {max_length} characters",
    "string_pattern_mismatch": "is not of the expected form", "literal_error": "must be {expected}",
    "int_from_float": "is not a whole number", "value_error": "{error}",
}
"""Pydantic's complaints in the words of this project."""


class _Loader(yaml.SafeLoader):
    """SafeLoader without aliases, which multiply, and without repeated keys or deep nesting."""

    depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose one node."""
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("aliases (*name) are not taken: write the value out")
        if self.depth == DEEPEST:
            raise yaml.YAMLError(f"more than {DEEPEST} levels")
        self.depth += 1
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def construct_mapping(self, node: Any, deep: bool = False) -> dict:
        """Construct a mapping whose keys differ."""
        return _without_repeats([(self.construct_object(key, deep=True),
                                  self.construct_object(value, deep=deep))
                                 for key, value in node.value])

    def construct_yaml_map(self, node: Any) -> Any:
        """Construct a mapping at once: nothing refers to it."""
        return self.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:map", _Loader.construct_yaml_map)


def _without_repeats(pairs: list[tuple[Any, Any]]) -> dict:
    found = dict(pairs)
    if len(found) < len(pairs):
        (twice, _), = Counter(key for key, _ in pairs).most_common(1)
        raise ValueError(f"the key {shown(twice)} is there twice; remove one")
    return found


def parse_yaml(text: str, what: str | Path) -> Mapping:
    """A YAML text of ``key: value`` lines, called ``what`` in messages."""
    try:
        content = yaml.load(text, _Loader)
    except (yaml.YAMLError, ValueError, LookupError, AttributeError, TypeError,
            RecursionError) as error:
        # Most come from values that contradict their tag: "!!int ''".
        raise InputError(f"{what} is not valid YAML ({one_line(error)})") from None
    if not isinstance(content, Mapping):
        raise InputError(f"{what} must hold 'key: value' lines, such as 'density_g_m2: 150'")
    return content


def parse_json(data: bytes | str, what: str | Path, remedy: str = "copy it again") -> Any:
    """A JSON document called ``what``: neither NaN, nor deep nesting, nor repeated keys."""
    try:
        from_json(data, allow_inf_nan=False)  # bounds the depth, which json does not
        return json.loads(data, object_pairs_hook=_without_repeats)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{what} is damaged or not a JSON document ({one_line(error)}); "
                         f"{remedy}") from None


def read_yaml(file: Path) -> Mapping:
    """A YAML file of ``key: value`` lines."""
    return parse_yaml(read_text(file), file)


def read_json(file: Path, *, remedy: str = "copy it again") -> Any:
    """A JSON file."""
    return parse_json(read_bytes(file, LARGEST_DOCUMENT, "JSON file"), file, remedy)


def read_text(file: Path, largest: int = LARGEST_TEXT, kind: str = "description") -> str:
    """A short text file in UTF-8, with or without a byte order mark."""
    try:
        return read_bytes(file, largest, kind).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{file} is not UTF-8 text; save it in this encoding") from None


def read_table(
    file: Path, kind: str, largest: int = LARGEST_TABLE
) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """A CSV file: cells of its header, and of each further row, with the number of its line.

    Empty rows are left out; the header of an empty file is empty.
    """
    lines = read_text(file, largest, kind).splitlines()
    # Spreadsheets write semicolons where the comma is decimal.
    separator = ";" if lines and ";" in lines[0] and "," not in lines[0] else ","
    reader = csv.reader(lines, delimiter=separator, skipinitialspace=True, strict=True)
    try:
        rows = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise InputError(f"{file} cannot be read as a table ({one_line(error)}); give a CSV "
                         "file") from None
    return [cell.strip() for cell in rows[0][1]] if rows else [], rows[1:]


def read_bytes(file: Path, largest: int, kind: str) -> bytes:
    """A regular file of up to ``largest`` bytes, which should be a ``kind``.

    Neither a pipe, which would block, nor a device, which may have no end.
    """
    try:
        descriptor = os.open(file, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            size = _require(file, os.fstat(descriptor), largest, kind)
            with open(descriptor, "rb", closefd=False) as stream:
                data = stream.read(size + 1)  # which allocates as much
        finally:
            os.close(descriptor)
    except (OSError, ValueError) as error:  # ValueError of a name with a null byte
        raise _unreadable(file, error) from None
    if len(data) > size:
        raise InputError(f"{file} was being written while it was read; run the command again when "
                         "it is complete")
    return data


def require_regular(file: Path, largest: int, kind: str) -> None:
    """InputError unless ``file`` can be read as :func:`read_bytes` does; for libraries that open
    files themselves.
    """
    try:
        _require(file, os.stat(file), largest, kind)
    except (OSError, ValueError) as error:
        raise _unreadable(file, error) from None


def _unreadable(file: Path, error: Exception) -> InputError:
    if isinstance(error, InputError):
        return error
    return InputError(f"{file} cannot be read ({getattr(error, 'strerror', None) or error}); check "
                      "the path and the permissions")


def _require(file: Path, found: os.stat_result, largest: int, kind: str) -> int:
    if not stat.S_ISREG(found.st_mode):
        raise InputError(f"{file} is not a regular file; give a {kind}")
    if found.st_size > largest:
        raise InputError(f"{file} has {found.st_size} bytes; a {kind} has at most {largest}")
    return found.st_size


def shown(value: object) -> str:
    """``value`` as Python writes it, cut short: a hostile file's may be endless, or have lines."""
    with suppress(ValueError):  # of whole numbers with thousands of digits
        return reprlib.repr(value)[:60]
    return "a number of thousands of digits"


def differences(old: object, new: object, prefix: str = "") -> list[str]:
    """Dotted names of the settings that differ."""
    if not (isinstance(old, dict) and isinstance(new, dict)):
        return [] if old == new else [prefix]
    names = sorted(old.keys() | new.keys())
    return [difference for name in names for difference in
            differences(old.get(name), new.get(name), f"{prefix}.{name}" if prefix else name)]
