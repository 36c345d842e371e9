"""What the page says of faults: of the input, the connection and the service."""

import signal

from browsing import FILES, IN_BROWSER, keep

pytestmark = IN_BROWSER


def test_errors_stand_where_they_arise(page):
    said = page.evaluate("async (text) => (await import('/static/words.js')).plainly(text, "
                         "'disc254_support127_rim3')", "check the scale first, then the tester")
    assert said == ("check first that the specimen is a disc of 254 mm on 127 mm, the sizes that "
                    "“A tin or jar” fills in, then the scale")
    page.click("#submit")
    assert "No picture yet" in page.inner_text("#error-files")
    page.set_input_files("#files", FILES[:-1])  # without a description
    page.click("#submit")
    assert "Weigh the specimen" in page.inner_text("#error-density_g_m2")
    assert page.get_attribute("#density", "aria-invalid") == "true"
    page.fill("#density", "210")
    page.click("#submit")
    assert "Choose what it lies on" in page.inner_text("#error-tester")
    page.select_option("#tester", "square_cylinder")
    page.click("#submit")
    assert "the diameter of the plate" in page.inner_text("#error-tester")
    page.fill("#size", "300")
    page.fill("#plate", "100")
    for name, value in ("fx", 305), ("fy", 305), ("cx", 119.5), ("cy", 89.5), ("depth_unit_m", 1):
        page.fill(f"[name={name}]", str(value))
    page.click("#submit")
    page.wait_for_selector("#failure:not(:empty)")
    assert "check “Depth unit” (" in page.inner_text("#failure")
    assert "error-depth_unit_m" in page.get_attribute("[name=depth_unit_m]", "aria-describedby")
    keep(page, "page_error.png")
    page.fill("#density", "12")
    page.click("#submit")
    page.locator("#error-density_g_m2", has_text="check the unit").wait_for()
    page.click("#other-unit")
    assert "133 g/m²" in page.inner_text("#weight-said")
    page.fill("#density", "210")
    page.click("#other-unit")
    assert page.is_hidden("#other-unit")
    page.goto(page.url.partition("#")[0] + "#" + "x" * 22)
    page.locator("#failure", has_text="no such estimate").wait_for()
    page.click("header a:has-text('Testers and cameras')")
    page.locator(".note", has_text="“Length of its printed scale”").wait_for()


def test_lost_connection_goes_on(page, service):
    page.set_input_files("#files", FILES)
    page.click("#submit")
    page.wait_for_selector("#status:not(:empty)")
    page.context.set_offline(True)
    page.wait_for_selector("#lost:not([hidden])")
    page.wait_for_timeout(1500)
    page.context.set_offline(False)
    page.wait_for_selector("#downloads:not([hidden])")
    assert page.is_hidden("#lost")


def test_service_that_was_killed_goes_on_with_its_estimates(page, service):
    page.click("[data-example=twill]")
    page.wait_for_selector("#downloads:not([hidden])")
    kept = page.url
    page.click("[data-example=twill]")
    page.locator("#status", has_text="Draping").wait_for()
    service.stop(signal.SIGKILL)
    page.wait_for_selector("#lost:not([hidden])")
    service.start()
    page.wait_for_selector("#downloads:not([hidden])")
    assert page.inner_text("#failure") == ""
    page.goto(kept)
    page.reload()
    page.wait_for_selector("#numbers:not([hidden])")
