"""An estimate on the page: its numbers, drapes, cards and files."""

import io
import json
import re
import zipfile

import cv2
import numpy as np
import pytest
from browsing import FILES, IN_BROWSER, fits, keep, saved, unfold
from serving import post, wait_until_ended
from workbooks import cells

pytestmark = IN_BROWSER
BENDING = "#cards details[open] tr:has-text('Bending-Warp') b >> nth=0"  # of CLO's card


def test_upload_gives_numbers_in_seconds_then_files_and_a_drape_that_turns(page):
    page.fill("#density", "210")
    page.click("#about summary")
    page.click("[data-example=twill]")  # a first estimate waits until the worker is ready
    page.wait_for_selector("#downloads:not([hidden])")
    page.set_input_files("#files", FILES)
    page.fill("#form [name=name]", "navy twill")
    page.fill("#form [name=notes]", "roll 12")
    page.press("#density", "Enter")  # no mouse is needed
    page.wait_for_selector("#downloads[hidden]", state="attached")
    page.wait_for_selector("#numbers:not([hidden])")
    assert page.locator("#rows tr").count() == 3
    assert 40 < float(page.locator("#alphas .n").first.inner_text()) < 70
    page.wait_for_selector("#downloads:not([hidden])")
    assert (page.inner_text("#title"), page.inner_text("#notes")) == ("navy twill", "roll 12")
    assert re.fullmatch(r"warp\n[\d.]+\n[\d.]+ to [\d.]+", page.inner_text("#alphas div >> nth=0"))
    assert "At 210 g/m² it hangs like poplin" in page.inner_text("#meaning")
    page.locator("#earlier", has_text="estimated before, as Twill, simulated").wait_for()
    keep(page, "page.png", whole=False)
    assert fits(page)
    page.evaluate("document.getElementById('result').scrollIntoView()")
    keep(page, "page_phone.png", whole=False)
    unfold(page)
    facts = page.inner_text("#facts")
    for fact in ("square of 300 mm on 100 mm", "210 g/m²", "% simulated", "Nodes"):
        assert fact in facts
    assert "KES B" in page.inner_text("#heads") and "gf·cm²/cm" in page.inner_text("#heads")
    assert page.inner_text("#rows b >> nth=0") == page.inner_text("#alphas .n >> nth=0")
    page.wait_for_timeout(1500)
    canvas = page.locator("#canvas")
    before = canvas.screenshot()
    canvas.focus()
    for _ in range(6):
        page.keyboard.press("ArrowRight")
    after = canvas.screenshot()
    assert before != after
    page.check("#overlay")
    assert canvas.screenshot() != after
    page.click("#cards summary:has-text('Blender')")
    assert "Vertex Mass\t" in page.inner_text("#cards details[open]")
    with page.expect_download() as download:
        page.click("[data-export=jfab]")
    assert download.value.suggested_filename == "navy_twill-fabric.jfab"
    page.reload()  # the address alone brings the result back
    page.wait_for_selector("#downloads:not([hidden])")
    assert page.is_visible("#facts")  # what was opened stays open
    assert fits(page)


def estimated(page, service, density: float, width: int) -> tuple[str, str]:
    """Identity and fabric of an ended estimate of its own density, for a page of this width."""
    page.set_viewport_size({"width": width, "height": 900})
    identity = post(service, density + width / 100).json()["id"]
    return identity, wait_until_ended(service, identity)["fabric_name"]


@pytest.mark.parametrize("width", [1280, 390])
def test_cards_and_files_have_the_curvature_and_tables_the_search(page, service, width):
    identity, fabric = estimated(page, service, 190.0, width)
    page.goto(f"{service.url}/#{identity}")
    unfold(page)
    page.click("#cards summary:text-is('CLO')")
    flat = page.inner_text(BENDING)
    page.fill("#curvature", "50,0")
    page.press("#curvature", "Enter")
    page.wait_for_function("flat => document.querySelector('#cards [open] tr b').textContent !== "
                           "flat", arg=flat)  # the card stays open
    assert "at a curvature of 50 1/m" in page.inner_text("#cards")
    keep(page, f"page_exports_{width}.png")
    name, data = saved(page, "#all-files")
    packed = zipfile.ZipFile(io.BytesIO(data))
    assert name.endswith("-files.zip") and {"report.pdf", "fabric.u3m"} <= set(packed.namelist())
    assert json.loads(packed.read("fabric.jfab"))["mapPhysical"]["fBvK"] == pytest.approx(
        float(page.inner_text(BENDING)), rel=0.01)
    page.fill("#edge", "0")
    page.click("#all-files")
    page.locator("#error-export", has_text="edge_mm").wait_for()
    page.goto(f"{service.url}/#fabrics")
    page.fill("#search", "jersey")
    page.wait_for_selector("#table", state="hidden")
    page.fill("#search", fabric)
    page.locator("#fabrics tr:only-child").wait_for()
    name, data = saved(page, "#table")
    assert name == "results.xlsx"
    assert {row["fabric"] for row in cells(io.BytesIO(data), 1)} == {fabric}
    keep(page, f"page_table_{width}.png")
    assert fits(page)


def test_a_photograph_has_no_captured_surface(page):
    page.click("[data-example=twill_photograph]")
    page.wait_for_selector("#downloads:not([hidden])")
    unfold(page)
    page.wait_for_selector("#overlay", state="hidden")
    assert "outline from above" in page.inner_text("#facts")
    assert page.evaluate("document.querySelector('#preview img').naturalWidth") > 500
    keep(page, "page_photograph.png")


@pytest.mark.parametrize("width", [390, 1280])
def test_the_next_measurement_is_named_with_its_gain_and_minutes(page, service, width):
    identity, _ = estimated(page, service, 205.0, width)
    page.goto(f"{service.url}/#{identity}")
    page.wait_for_selector("#downloads:not([hidden])")
    said = page.text_content("#poor")
    gains = re.findall(r"[^;:]+: α (\d+) %, β (\d+) % \((\d+) min\)", said)
    assert "Measured next, intervals would become narrower by" in said and gains, said
    assert all(max(int(alpha), int(beta)) > 0 < int(minutes) for alpha, beta, minutes in gains)


@pytest.mark.parametrize("width", [390, 1280])
def test_the_code_of_a_passport_opens_the_fabric(page, service, width):
    identity, fabric = estimated(page, service, 195.0, width)
    page.goto(f"{service.url}/estimates/{identity}/report.html")
    code = page.locator("img.code")
    picture = cv2.imdecode(np.frombuffer(code.screenshot(), np.uint8), cv2.IMREAD_GRAYSCALE)
    picture = cv2.resize(picture, None, fx=4, fy=4)
    address = cv2.QRCodeDetector().detectAndDecode(picture)[0]
    assert address == code.get_attribute("alt")
    keep(page, f"page_passport_{width}.png")
    page.goto(address)
    page.wait_for_selector("#downloads:not([hidden])")
    assert page.inner_text("#title") == fabric
