"""How files of other tools are written."""

import json
import pprint
from collections.abc import Iterable
from pathlib import Path


def as_json(content: object) -> bytes:
    """A JSON file."""
    return (json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode()


def script(template: str, content: dict) -> bytes:
    """A module from a ``template`` beside this one, with the ``content`` of its MATERIAL."""
    text = Path(__file__).with_name(template).read_text(encoding="utf-8")
    values = pprint.pformat(content, width=96, sort_dicts=False)
    return text.replace("{MATERIAL}", values).encode()


def left_to_tool(fields: Iterable[str], given: Iterable[str]) -> dict[str, list[str]]:
    """The entry of a file's metadata that names those ``fields`` of a tool that are not ``given``,
    so that the tool's own values stand."""
    return {"tool_defaults": sorted({*fields} - {*given})}
