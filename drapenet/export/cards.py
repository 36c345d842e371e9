"""Cards "type this here": values for the fields of tools, and what is not known of them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

SLIDER = ((0.0, 10.0, 28.0, 48.0, 65.0, 83.0, 100.0), (0.0, 1e2, 1e3, 3e3, 2e4, 2e5, 2e6))
"""CLO's scale of 0 to 100 and its bending stiffness, linear between these."""

PROGRAMS = {"clo": "CLO", "clo3d": "CLO", "marvelous": "Marvelous Designer",
            "marvelousdesigner": "Marvelous Designer", "browzwear": "VStitcher",
            "vstitcher": "VStitcher", "blender": "Blender", "houdini": "Houdini",
            "unreal": "Unreal"}
"""Cards by the names of programs."""
DEFAULT = "keep the tool's default, or that of a similar fabric"
"""Note of a field whose quantity the estimate does not state."""


def cards(values: Mapping[str, float]) -> list[dict[str, Any]]:
    """The content of ``cards.yaml`` with these values of its quantities; a field without a value
    has None, and one whose quantity is not known says so."""
    text = Path(__file__).with_name("cards.yaml").read_text(encoding="utf-8")
    return [card | {"fields": [field | (
        {"value": _digits(values[quantity])} if quantity in values else
        {"value": None} | ({"note": DEFAULT} if quantity else {}))
        for field in card["fields"] for quantity in [field.get("value")]]}
        for card in yaml.safe_load(text)]


def card_lines(card: Mapping[str, Any]) -> list[str]:
    """A card as text."""
    width = max(len(field["field"]) for field in card["fields"])
    fields = [f"  {field['field']:<{width}}  "
              + (f"{field['value']} {field.get('unit', '')}".rstrip() if field["value"] else
                 "not known") + (f"   ({field['note']})" if "note" in field else "")
              for field in card["fields"]]
    return [f"{card['tool']}, {card['where']}:", *fields, f"  {card['unknown']}"]


def _digits(value: float) -> str:
    """Three digits, as people type them."""
    return np.format_float_positional(float(f"{value:.3g}"), trim="-")
