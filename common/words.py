"""Settings in words of a command line over those of a file in ``configs/``: KEY=VALUE, of a nested
key A.B=VALUE, or GROUP=OPTION. ${KEY} in a text is the value of another key."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from types import NoneType
from typing import Any, Literal, get_args, get_origin, get_type_hints

from pydantic import ConfigDict, TypeAdapter, ValidationError

from common.configs import composed, merge
from common.documents import faults, parse_yaml
from common.errors import InputError


def stated(
    name: str, words: Sequence[str], schema: type, folder: Path | None = None
) -> dict[str, Any]:
    """The content of ``NAME.yaml`` of a ``folder`` or of ``configs`` with the settings in ``words``
    in place of its own, unchecked but for their keys; their form follows from the ``schema``. A
    word that begins with + adds its key."""
    options: dict[str, str] = {}
    new = {word[1:].partition("=")[0] for word in words if word.startswith("+")}
    for word in (word.removeprefix("+") for word in words):
        key, equals, options[key] = word.partition("=")
        if not equals:
            raise InputError(f"{word}: write KEY=VALUE without spaces around =, in quotes if it "
                             "has spaces: 'KEY=MY VALUE'; --help lists the keys")
    content = composed(name, options, folder)  # takes those of groups out
    for key, text in options.items():
        kind, (*path, last) = schema, key.split(".")
        _at(content, path if key in new else [*path, last], f"{key}={text}")
        for part in [*path, last]:
            kind = get_type_hints(kind).get(part) if is_dataclass(kind) else None
        merge(_at(content, path, key), {last: value_of(text, kind, key)})
    return _filled(content, content)


def _at(content: Any, path: Iterable[str], word: str) -> Any:
    """What stands at a path of keys, of which a ``word`` speaks."""
    for part in path:
        if not isinstance(content, Mapping) or part not in content:
            raise InputError(f"{word}: unknown key; --help lists the keys")
        content = content[part]
    return content


def _filled(value: Any, content: Mapping[str, Any]) -> Any:
    """A value with those of other keys of ``content`` in place of ``${KEY}``."""
    if isinstance(value, Mapping):
        return {key: _filled(item, content) for key, item in value.items()}
    if isinstance(value, list):
        return [_filled(item, content) for item in value]
    return value if not isinstance(value, str) else re.sub(
        r"\$\{([^}]*)\}", lambda key: str(_at(content, key[1].split("."), value)), value)


def checked(content: Any, schema: type) -> Any:
    """Settings as an instance of ``schema``."""
    # That of nested dataclasses, too.
    schema.__pydantic_config__ = ConfigDict(  # type: ignore[attr-defined]
        extra="forbid", allow_inf_nan=False, coerce_numbers_to_str=True)
    try:
        return TypeAdapter(schema).validate_python(content)
    except ValidationError as error:
        raise InputError(faults(error)) from None


def value_of(text: str, kind: Any, key: str) -> Any:
    """The value of a type that a ``text`` states for a ``key``: texts as they are written or in
    quotes, also in lists, whose brackets may be left out; of other types YAML, unchecked."""
    kinds = get_args(kind)
    if NoneType in kinds:
        return None if text == "null" else value_of(text, kinds[kinds[0] is NoneType], key)
    listed, bracketed = get_origin(kind) is list, text[:1] == "[" and text[-1:] == "]"
    if listed and not bracketed:
        text = f"[{text}]"
    if (listed and _is_text(kinds[0])) or (kind is Any and bracketed):
        return [_unquoted(item) for item, _ in _ITEM.findall(text[1:-1]) if item]
    if _is_text(kind):
        return _unquoted(text)
    if text[:1] == "{":
        text = re.sub(r":(?=\S)", ": ", text)
    return parse_yaml(f"value: {text}", key)["value"]


_ITEM = re.compile(r"""\s*('(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*"|(?:\$\{[^}]*\}|[^,])*?)\s*(,|$)""")
"""One text of a list, in quotes or without commas, and what ends it."""


def _is_text(kind: Any) -> bool:
    return kind in (str, Any) or get_origin(kind) is Literal


def _unquoted(text: str) -> str:
    if text.startswith("~/"):  # which shells leave as it is after KEY=
        return str(Path(text).expanduser())
    quote = text[:1]
    if len(text) > 1 and quote in "'\"" and text[-1] == quote:
        return text[1:-1].replace(f"\\{quote}", quote)
    return text
