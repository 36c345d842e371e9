"""Cards of what to type into tools."""

import json

import numpy as np
import pytest
from exported import ALPHA, BETA, CURVATURE, exported

from drapenet.export.cards import DEFAULT


def test_cards_say_what_to_type_and_what_is_not_known(estimate):
    content = json.loads(exported(estimate, "fields").read_text())
    cards = {card["tool"]: card for card in content["cards"]}
    assert set(cards) == {"CLO", "Marvelous Designer", "VStitcher", "Blender", "Houdini", "Unreal"}
    typed = {tool: {field["field"]: field["value"] for field in card["fields"]}
             for tool, card in cards.items()}
    assert typed["CLO"]["Bending-Weft"] == "19900" and typed["CLO"]["Density"] == "0.00021"
    # 47 300 lies between 65 (20 000) and 83 (200 000) of CLO's scale.
    assert typed["CLO"]["Bending-Warp as 0 to 100"] == "67.7"
    assert typed["CLO"]["Buckling Stiffness-Warp"] == "0.799"
    assert typed["VStitcher"]["Bend Length"] == "425" and typed["VStitcher"]["Mass"] == "210"
    assert typed["Unreal"]["Bending Stiffness Bias"] == "0.28"
    assert typed["Unreal"]["Buckling Stiffness Bias"] == "0.219"
    assert typed["Unreal"]["Stretch Stiffness Warp"] is typed["CLO"]["Thickness"] is None
    notes = {field["field"]: field.get("note") for field in cards["CLO"]["fields"]}
    assert notes["Thickness"] == DEFAULT and notes["Bending-Weft"] is None
    assert typed["Blender"]["Vertex Mass"] == "0.0116"  # a thousand times 55.4 mm²
    assert typed["Houdini"]["Bend Stiffness"] is None
    assert all(card["unknown"] and card["source"] and card["where"] for card in cards.values())
    page = exported(estimate, "cards").read_text()
    assert "<th scope=\"row\">Bending-Weft</th><td class=\"number\">19900 g·mm²/s²</td>" in page
    assert "not known" in page and "warp stands for" not in page
    ratios = 1 + CURVATURE * BETA / ALPHA
    assert content["drapenet"]["modulus_over_alpha"] == pytest.approx(ratios, abs=1e-3)
    assert ", ".join(f"{ratio:.0%}" for ratio in ratios) in page


def test_cards_have_all_that_is_known(known):
    content = json.loads(exported(known, "fields").read_text())
    typed = {card["tool"]: {field["field"]: field["value"] for field in card["fields"]}
             for card in content["cards"]}
    assert (typed["CLO"]["Stretch-Weft"], typed["CLO"]["Shear"]) == ("400000", "35000")
    assert typed["Unreal"]["Stretch Stiffness Bias"] == "35"
    assert typed["VStitcher"]["Thickness"] == "0.42" and typed["Houdini"]["Friction"] == "0.31"
    assert (typed["VStitcher"]["Stretch Length"], typed["VStitcher"]["Shear"]) == ("900", "35")
    # Springs of k on triangles of equal sides have the shear stiffness sqrt(3)/4 k; tension is k
    # times the edge, 8 mm.
    tension = float(typed["Blender"]["Stiffness: Tension, Compression, Shear"])
    assert tension / 0.008 * np.sqrt(3) / 4 == pytest.approx(35, rel=0.01)
    assert typed["Blender"]["Collisions, Self Collisions: Friction"] == "31"
