"""Reading and validation of input documents: regular files of bounded size and nesting depth.

All YAML, JSON and CSV files are read here and validated by a :class:`Schema`; every fault raises an
InputError of one line: quantity, value, limit, remedy.
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

MAX_TEXT_BYTES = 1 << 16  # written by people
MAX_TABLE_BYTES = 8 << 20
MAX_DOCUMENT_BYTES = 64 << 20  # written by programs
MAX_LEVELS = 20  # nesting depth of YAML; the JSON parser allows 200
T = TypeVar("T", bound="Schema")


class Schema(BaseModel):
    """Required content of a document; a field's description is the remedy in error messages.

    Validation is strict: numbers are finite, and text, integers and booleans are not converted to
    each other. Unknown keys are refused unless a schema ignores them.
    """

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)
    remedy: ClassVar[str] = ""

    @classmethod
    def of(cls: type[T], content: object, what: str | Path) -> T:
        """Validate the content of the document ``what``, which error messages begin with."""
        try:
            return cls.model_validate(content)
        except ValidationError as error:
            prefix = f"{what}: " if what else ""
            raise InputError(prefix + cls._message(error)) from None

    @classmethod
    def _message(cls, error: ValidationError) -> str:
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
            words = _MESSAGES["outside" if len(limits) == 2 and kind.endswith("_equal") else kind
                           if kind in _MESSAGES else "value_error"].format_map(
                {"error": one_line(Exception(first["msg"])), **limits, **first.get("ctx", {})})
            complaint = (f"{name}={shown(first['input'])} " if name else "") + words
        return complaint + (f"; {remedy}" if remedy else "")


class Excerpt(Schema):
    """Schema that ignores unknown keys."""

    model_config = ConfigDict(extra="ignore")


_UNKNOWN = "extra_forbidden"
_MESSAGES = {
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
"""Error messages by Pydantic's error type."""


class _Loader(yaml.SafeLoader):
    """SafeLoader that refuses aliases (exponential expansion), repeated keys and deep nesting."""

    depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose one node."""
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("aliases (*name) are not taken: write the value out")
        if self.depth == MAX_LEVELS:
            raise yaml.YAMLError(f"more than {MAX_LEVELS} levels")
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
        """Construct a mapping at once; without aliases nothing refers to it before."""
        return self.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:map", _Loader.construct_yaml_map)


def _without_repeats(pairs: list[tuple[Any, Any]]) -> dict:
    found = dict(pairs)
    if len(found) < len(pairs):
        (twice, _), = Counter(key for key, _ in pairs).most_common(1)
        raise ValueError(f"the key {shown(twice)} occurs twice; remove one")
    return found


def parse_yaml(text: str, what: str | Path) -> Mapping:
    """Parse YAML text of ``key: value`` lines; ``what`` names it in error messages."""
    try:
        content = yaml.load(text, _Loader)
    except (yaml.YAMLError, ValueError, LookupError, AttributeError, TypeError,
            RecursionError) as error:
        # Mostly values that contradict their tag: "!!int ''".
        raise InputError(f"{what} is not valid YAML ({one_line(error)})") from None
    if not isinstance(content, Mapping):
        raise InputError(f"{what} must hold 'key: value' lines, such as 'density_g_m2: 150'")
    return content


def parse_json(data: bytes | str, what: str | Path, remedy: str = "copy it again") -> Any:
    """Parse JSON, named ``what`` in errors, without NaN, deep nesting and repeated keys."""
    try:
        from_json(data, allow_inf_nan=False)  # bounds the depth, which json does not
        return json.loads(data, object_pairs_hook=_without_repeats)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{what} is damaged or not a JSON document ({one_line(error)}); "
                         f"{remedy}") from None


def read_yaml(file: Path) -> Mapping:
    """Read a YAML file of ``key: value`` lines."""
    return parse_yaml(read_text(file), file)


def read_json(file: Path, *, remedy: str = "copy it again") -> Any:
    """Read a JSON file."""
    return parse_json(read_bytes(file, MAX_DOCUMENT_BYTES, "JSON file"), file, remedy)


def read_text(file: Path, max_bytes: int = MAX_TEXT_BYTES, kind: str = "description") -> str:
    """Read a text file in UTF-8, with or without byte order mark, of up to ``max_bytes`` bytes."""
    try:
        return read_bytes(file, max_bytes, kind).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{file} is not UTF-8 text; save it in this encoding") from None


def read_table(
    file: Path, kind: str, max_bytes: int = MAX_TABLE_BYTES
) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Read a CSV file: the cells of its header, and line number and cells of each further row.

    Empty rows are skipped; the header of an empty file is empty.
    """
    lines = read_text(file, max_bytes, kind).splitlines()
    # In locales with a decimal comma, spreadsheets separate cells by semicolons.
    separator = ";" if lines and ";" in lines[0] and "," not in lines[0] else ","
    reader = csv.reader(lines, delimiter=separator, skipinitialspace=True, strict=True)
    try:
        rows = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise InputError(f"{file} cannot be read as a table ({one_line(error)}); give a CSV "
                         "file") from None
    return [cell.strip() for cell in rows[0][1]] if rows else [], rows[1:]


def read_bytes(file: Path, max_bytes: int, kind: str) -> bytes:
    """Read a regular file of up to ``max_bytes`` bytes; ``kind`` names its type in errors.

    Pipes, which would block, and devices, which may be endless, are refused.
    """
    try:
        descriptor = os.open(file, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            size = _checked_size(file, os.fstat(descriptor), max_bytes, kind)
            with open(descriptor, "rb", closefd=False) as stream:
                data = stream.read(size + 1)  # allocates this much
        finally:
            os.close(descriptor)
    except (OSError, ValueError) as error:  # ValueError: null byte in the name
        raise _unreadable(file, error) from None
    if len(data) > size:
        raise InputError(f"{file} was being written while it was read; run the command again when "
                         "it is complete")
    return data


def require_regular(file: Path, max_bytes: int, kind: str) -> None:
    """Check ``file`` as :func:`read_bytes` does, for libraries that open files themselves."""
    try:
        _checked_size(file, os.stat(file), max_bytes, kind)
    except (OSError, ValueError) as error:
        raise _unreadable(file, error) from None


def _unreadable(file: Path, error: Exception) -> InputError:
    if isinstance(error, InputError):
        return error
    return InputError(f"{file} cannot be read ({getattr(error, 'strerror', None) or error}); check "
                      "the path and the permissions")


def _checked_size(file: Path, found: os.stat_result, max_bytes: int, kind: str) -> int:
    if not stat.S_ISREG(found.st_mode):
        raise InputError(f"{file} is not a regular file; give a {kind}")
    if found.st_size > max_bytes:
        raise InputError(f"{file} has {found.st_size} bytes; a {kind} has at most {max_bytes}")
    return found.st_size


def shown(value: object) -> str:
    """``repr`` of a value, shortened: values from files may be long or contain line breaks."""
    with suppress(ValueError):  # integers of thousands of digits
        return reprlib.repr(value)[:60]
    return "a number of thousands of digits"


def differences(old: object, new: object, prefix: str = "") -> list[str]:
    """Dotted names of the settings in which ``old`` and ``new`` differ."""
    if not (isinstance(old, dict) and isinstance(new, dict)):
        return [] if old == new else [prefix]
    names = sorted(old.keys() | new.keys())
    return [difference for name in names for difference in
            differences(old.get(name), new.get(name), f"{prefix}.{name}" if prefix else name)]
