"""Strips and values from other tests on the page."""

import pytest
from browsing import IN_BROWSER, fits, keep, unfold

pytestmark = IN_BROWSER


def test_strips_and_values_join_and_what_contradicts_is_shown_at_once(page, tmp_path):
    file = tmp_path / "strips.yaml"
    file.write_text("density_g_m2: 210\nstrips:\n- {direction: warp, bending_length_mm: 21.5}\n",
                    encoding="utf-8")
    page.set_input_files("#files", [str(file)])
    unfold(page)
    page.fill("#form [name=name]", "olive serge")
    page.fill("#warp", "30")  # of a capture, and not sent
    page.fill("#form [name=operator]", "M. Muster")
    page.click("#submit")
    page.wait_for_selector("#downloads:not([hidden])")
    assert "1 strip" in page.inner_text("#facts") and "M. Muster" in page.inner_text("#facts")
    page.click("#more")
    keep(page, "page_values.png")
    name = "known.flexural_rigidity_uN_m.warp"
    page.fill(f"[name='{name}']", "-600")
    page.click("#submit")
    page.locator(f"[id='error-{name}']", has_text="more than 0").wait_for()
    page.fill(f"[name='{name}']", "600")
    page.click("#submit")
    page.locator("#contradictions", has_text="all captures: the known flexural rigidity G [µN·m] "
                 "warp = 600 contradicts").wait_for()
    assert page.input_value(f"[name='{name}']") == "600"  # until the next specimen
    page.click("#captures a:has-text('all captures')")
    page.locator("#warnings .contradiction", has_text="left out").wait_for()
    page.locator("#links", has_text="Report (PDF)").wait_for()
    page.click("header a:has-text('Fabrics')")
    page.locator("#fabrics", has_text="left out").wait_for()
    assert fits(page)


@pytest.mark.parametrize("width", [390, 1280])
def test_strips_under_weights_are_typed_and_give_stretch_and_shear(page, width):
    page.set_viewport_size({"width": width, "height": 900})
    unfold(page)
    page.fill("#density", "210")
    strips = [("bias", "50", "100", "25", "4.1"), ("warp", "50", "100", "500", "2"),
              ("weft", "50", "100", "500", "5"), ("bias", "50", "100", "25", "-4.3")]
    page.click("#add-strip")
    for row, (direction, *numbers) in enumerate(strips):
        page.select_option(f"[name='tension.{row}.direction']", direction)
        for key, number in zip(("width_mm", "gauge_mm", "load_g", "extension_mm"), numbers,
                               strict=True):
            page.fill(f"[name='tension.{row}.{key}']", number)
    page.click("#submit")
    page.locator("[id^='error-tension']").first.wait_for()  # an extension below nothing
    page.fill("[name='tension.3.extension_mm']", "4.3")
    page.click("#submit")
    page.wait_for_selector("#downloads:not([hidden])")
    facts = page.inner_text("#facts")
    assert "4 strips under weights" in facts and "Stretch and shear" in facts
    assert page.evaluate("document.querySelector('#preview img').naturalWidth") > 300
    keep(page, f"page_strips_{width}.png")
    assert fits(page)
