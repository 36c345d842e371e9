"""Cards "type this here": values for the fields of tools, and what is not known of them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from drapenet.export.material import Material
from drapenet.export.quantities import filled, quantities

PROGRAMS = {"clo": "CLO", "clo3d": "CLO", "marvelous": "Marvelous Designer",
            "marvelousdesigner": "Marvelous Designer", "browzwear": "VStitcher",
            "vstitcher": "VStitcher", "blender": "Blender", "houdini": "Houdini",
            "unreal": "Unreal"}
"""Cards by the names of programs."""
DEFAULT = "keep the tool's default, or that of a similar fabric"
"""Note of a field whose quantity the estimate does not state."""


def cards(material: Material) -> list[dict[str, Any]]:
    """The content of ``cards.yaml`` for a fabric: every field has field, value, unit and
    note; without a value it has None, and says so where its quantity is not known."""
    text = Path(__file__).with_name("cards.yaml").read_text(encoding="utf-8")
    found, values = yaml.safe_load(text), quantities(material)
    for card in found:
        given = filled(card["fields"], values)
        card["fields"] = [{
            "field": row["field"],
            "value": _digits(given[row["field"]]) if row["field"] in given else None,
            "unit": row.get("unit", ""),
            "note": row.get("note", "") if row["field"] in given or "value" not in row else DEFAULT}
            for row in card["fields"]]
    return found


def card_lines(card: Mapping[str, Any]) -> list[str]:
    """A card as text."""
    width = max(len(field["field"]) for field in card["fields"])
    fields = [f"  {field['field']:<{width}}  "
              + (f"{field['value']} {field['unit']}".rstrip() if field["value"] else "not known")
              + (f"   ({field['note']})" if field["note"] else "") for field in card["fields"]]
    return [f"{card['tool']}, {card['where']}:", *fields, f"  {card['unknown']}"]


def _digits(value: float) -> str:
    """Three digits, as people type them."""
    return np.format_float_positional(float(f"{value:.3g}"), trim="-")
