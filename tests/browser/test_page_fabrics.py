"""The fabrics on the page: joined, searched, compared, named and removed."""

from browsing import FILES, IN_BROWSER, fits, keep, unfold
from serving import post, wait_until_ended

pytestmark = IN_BROWSER


def test_captures_join_and_fabrics_are_searched_and_compared(page, service):
    others = [post(service, density).json()["id"] for density in (120.0, 180.0, 260.0)]
    page.set_input_files("#files", FILES)
    unfold(page)
    page.fill("#form [name=name]", "grey serge")
    page.fill("#form [name=label]", "face up")
    page.click("#submit")
    page.wait_for_selector("#downloads:not([hidden])")
    page.click("#more")
    assert "grey serge" in page.inner_text("#into")
    page.set_input_files("#files", [*FILES[:2], FILES[-1]])
    page.check("#override input")
    page.fill("[name=turns_deg]", "0, 90")
    page.fill("#form [name=label]", "face up")
    page.click("#submit")  # the label is taken
    page.locator("#error-label", has_text="another capture").wait_for()
    page.fill("#form [name=label]", "two views")
    page.click("#submit")
    page.click("#captures a:has-text('all captures')")
    page.locator("#facts", has_text="2 captures").wait_for()
    keep(page, "page_fabric.png")
    [wait_until_ended(service, identity) for identity in others]
    page.click("header a:has-text('Fabrics')")
    page.fill("#search", "SERGE two")
    page.locator("#fabrics tr:only-child").wait_for()
    page.fill("#search", "")
    page.locator("#fabrics tr").nth(3).wait_for()
    boxes = page.locator("#fabrics [type=checkbox]")
    for k in range(4):
        boxes.nth(k).check()
    assert boxes.count() == 4 or boxes.nth(4).is_disabled()
    keep(page, "page_fabrics.png")
    page.press("#compare", "Enter")
    page.wait_for_selector("#comparison[data-shown]")
    assert page.locator("#compared th").count() == 4
    assert page.locator("#curves polyline").count() == 12
    page.reload()
    page.wait_for_selector("#comparison[data-shown]")
    page.wait_for_timeout(500)
    keep(page, "page_comparison.png")
    before = page.locator("#drapes").screenshot()
    page.focus("#drapes")
    page.keyboard.press("ArrowLeft")
    assert page.locator("#drapes").screenshot() != before
    assert fits(page, "page_comparison_phone.png")
    page.goto(service.url + "/#fabrics")
    page.wait_for_selector("#fabrics tr")
    assert fits(page, "page_fabrics_phone.png")


def test_fabrics_like_a_result_are_named_and_compared(page, service):
    identities = [post(service, density).json()["id"] for density in (333.0, 340.0, 700.0)]
    [wait_until_ended(service, identity) for identity in identities]
    page.goto(f"{service.url}/#{identities[0]}")
    page.click("#alike-first")
    page.locator("#alike-first", has_text="Like this one: fabric of 340 g/m², 80 %").wait_for()
    rows = page.locator("#alike-rows tr")
    assert "warp +2, bias +2, weft +2, weight +2 %" in rows.first.inner_text()
    assert "KES B" in rows.last.inner_text() and "below 5 %" in rows.last.inner_text()
    keep(page, "page_alike.png")
    assert fits(page, "page_alike_phone.png")
    rows.first.locator("a:has-text('compare')").click()
    page.wait_for_selector("#comparison[data-shown]")
    assert page.locator("#compared th").count() == 2


def test_presets_stay_and_names_change(page, service):
    unfold(page)
    page.click("label:has([value=disc254_support127])")
    page.fill("#rim", "3")
    page.click("label:has([name=weighed][value=specimen])")
    page.fill("#density", "7,6")
    assert page.inner_text("#support-said") == "Disc of 254 mm on a top of 127 mm, rim 3 mm."
    assert page.inner_text("#weight-said") == "150 g/m², for its area."
    page.select_option("#tester", "disc300_support180")
    page.select_option("[name=mat]", "")
    page.fill("[name=camera_height_mm]", "1250")
    page.fill("#preset-name", "our Cusick")
    page.click("#preset-save")
    page.reload()
    unfold(page)
    assert page.input_value("[name=camera_height_mm]") == "1250"
    assert page.input_value("#tester") == "disc300_support180"
    page.select_option("#preset", "")
    assert page.input_value("[name=camera_height_mm]") == ""
    identity = post(service, 210.0).json()["id"]
    wait_until_ended(service, identity)
    page.goto(f"{service.url}/#{identity}")
    page.click("#edit")
    page.fill("#editor [name=name]", "a <b>new</b> name")
    page.keyboard.press("Enter")
    page.locator("#title", has_text="a <b>new</b> name").wait_for()
    page.on("dialog", lambda dialog: dialog.accept())
    page.click("#remove-fabric")
    page.wait_for_selector("#library:not([hidden])")
    assert "new</b>" not in page.inner_text("#library")
