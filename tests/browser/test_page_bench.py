"""Values of a bench on the page, without any picture."""

import json

import pytest
from browsing import IN_BROWSER, fits, keep, saved

pytestmark = IN_BROWSER
BENCH = {"#bench-weight": "210", "[name='known.overhang_mm.warp']": "44",
         "[name='known.overhang_mm.weft']": "36", "[name='known.thickness_mm']": "0,42",
         "[name='known.thickness_kpa']": "0.2", "[name='known.friction_deg.fabric']": "24",
         "[name='known.drape_coefficient_percent']": "52", "[data-pulled=warp]": "5",
         "[data-pulled=weft]": "-9", "[name=kes_g_gf_per_cm_deg]": "0.6"}


@pytest.mark.parametrize(("width", "height"), [(390, 844), (1280, 800)])
def test_a_bench_without_a_picture_gives_files_for_tools(page, width, height):
    page.set_viewport_size({"width": width, "height": height})
    page.click("#bench > summary")
    page.click("#bench details >> nth=0 >> summary")
    for field, text in BENCH.items():
        page.fill(field, text)
    assert page.input_value("#density") == "210"
    page.click("text=Estimate from values")
    page.locator("#error", has_text="Choose the specimen and plate").wait_for()
    page.select_option("#bench-tester", "disc300_support180")
    page.click("text=Estimate from values")
    page.locator("[id='error-tension.1.extension_mm']", has_text="-9").wait_for()
    assert page.evaluate("document.activeElement.dataset.pulled") == "weft"
    page.fill("[data-pulled=weft]", "9")
    keep(page, f"page_bench_{width}.png")
    page.click("text=Estimate from values")
    page.wait_for_selector("#downloads:not([hidden])")
    page.click("#all-numbers > summary")
    assert "errors were assumed" in page.inner_text("#poor").lower()
    assert "overhang_mm warp 44, weft 36" in page.inner_text("#facts")
    card = json.loads(saved(page, "[data-export=jfab] >> nth=0")[1])["mapPhysical"]
    assert card["fThickness"] == 0.42 and 30e3 < card["fHK"] < 38e3 and 3e6 < card["fSuK"] < 5e6
    keep(page, f"page_bench_result_{width}.png")
    assert fits(page)
    page.click("#next-specimen")
    assert page.input_value("[name='known.overhang_mm.warp']") == ""
