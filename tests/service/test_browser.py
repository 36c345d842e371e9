"""The page in a real browser: ``make test-browser``. Screenshots go to $DRAPENET_SCREENS."""

import io
import json
import os
import re
import shutil
import signal
import time
import zipfile
from pathlib import Path

import pytest
from photographs import AROUND, drawn, over_mat, plate
from PIL import Image
from workbooks import cells

from drapenet.network.checkpoint import BUNDLED
from experiments.speed.service import EXAMPLE, Service, post, wait_until_ended

pytestmark = [pytest.mark.browser,
              pytest.mark.skipif(not BUNDLED.exists(), reason="no network is bundled")]
FILES = [str(file) for file in (*sorted(EXAMPLE.glob("*.png")), EXAMPLE / "capture.yaml")]
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
DRAWING = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
ORIENTATION = 0x0112  # tag of EXIF
SECONDS = 180_000  # ms: a cold start of the worker takes a minute on a busy machine


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    service = Service(tmp_path_factory.mktemp("service"), queue=32, workers=1)
    yield service
    service.stop()


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed; "
                                     "run: make test-browser")
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed; as root, make test-browser installs it")
    with playwright.sync_playwright() as running:
        browser = running.chromium.launch(executable_path=CHROMIUM,
                                          args=["--no-sandbox", *DRAWING])
        yield browser
        browser.close()


@pytest.fixture
def page(browser, service):
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.set_default_timeout(SECONDS)
    page.problems = []
    page.on("pageerror", lambda error: page.problems.append(str(error)))
    page.on("request", lambda request: page.problems.append(request.url)
            if not request.url.startswith((service.url, "blob:", "data:")) else None)
    page.goto(service.url)
    yield page
    assert page.problems == []  # neither errors of the scripts nor requests to other hosts
    page.close()


def keep(page, name: str, *, whole: bool = True) -> None:
    folder = Path(os.environ.get("DRAPENET_SCREENS", "outputs/browser"))
    folder.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=str(folder / name), full_page=whole)


def fits(page) -> bool:
    """Whether nothing is wider than a phone."""
    page.set_viewport_size({"width": 390, "height": 844})
    page.wait_for_timeout(300)
    widths = page.evaluate("[document.documentElement, ...document.querySelectorAll('main section "
                           "*')].map((part) => part.scrollWidth > 390 ? part.outerHTML : '')")
    return not any(widths)


def test_upload_gives_numbers_in_seconds_then_files_and_a_drape_that_turns(page):
    loaded = page.evaluate("performance.getEntriesByType('navigation')[0].duration")
    page.fill("#density", "210")
    page.click("[data-example=twill]")  # a first estimate waits until the worker is ready
    page.wait_for_selector("#downloads:not([hidden])")
    page.set_input_files("#files", FILES)
    page.fill("#form [name=name]", "navy twill")
    page.fill("#form [name=notes]", "roll 12")
    began = time.monotonic()
    page.press("#density", "Enter")  # no mouse is needed
    page.wait_for_selector("#downloads[hidden]", state="attached")
    page.wait_for_selector("#numbers:not([hidden])")
    seconds = time.monotonic() - began
    print(f"page loaded in {loaded / 1e3:.2f} s, numbers {seconds:.1f} s after the upload")
    cells = page.locator("#rows tr")
    assert cells.count() == 3
    assert 40 < float(page.locator("#rows tr:first-child td b").first.inner_text()) < 70
    page.wait_for_selector("#downloads:not([hidden])")
    assert (page.inner_text("#title"), page.inner_text("#notes")) == ("navy twill", "roll 12")
    facts = page.inner_text("#facts")
    for fact in ("square of 300 mm on 100 mm", "210 g/m²", "% simulated", "Nodes"):
        assert fact in facts
    assert "KES B" in page.inner_text("#heads") and "gf·cm²/cm" in page.inner_text("#heads")
    page.wait_for_timeout(1500)
    page.set_viewport_size({"width": 1280, "height": 1270})
    page.wait_for_timeout(500)
    page.evaluate("scrollTo(0, 0)")
    keep(page, "page.png", whole=False)
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
    assert fits(page)
    keep(page, "page_phone.png")


def bending(page) -> str:
    """The value of CLO's card for the bending of the warp, in a card that is open."""
    return page.inner_text("#cards details[open] tr:has-text('Bending-Warp') b >> nth=0")


def saved(page, button: str) -> tuple[str, bytes]:
    """Name and content of what a button saves."""
    with page.expect_download() as download:
        page.click(button)
    return download.value.suggested_filename, Path(download.value.path()).read_bytes()


@pytest.mark.parametrize("width", [1280, 390])
def test_cards_and_files_have_the_curvature_and_tables_the_search(page, service, width):
    page.set_viewport_size({"width": width, "height": 900})
    begun = post(service, 190.0 + width / 100).json()
    fabric = wait_until_ended(service, begun["id"])["fabric_name"]
    page.goto(f"{service.url}/#{begun['id']}")
    page.click("#cards summary:text-is('CLO')")
    flat = bending(page)
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
        float(bending(page)), rel=0.01)
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


def test_captures_join_and_fabrics_are_searched_and_compared(page, service):
    others = [post(service, density).json()["id"] for density in (120.0, 180.0, 260.0)]
    page.set_input_files("#files", FILES)
    page.fill("#form [name=name]", "grey serge")
    page.fill("#form [name=label]", "face up")
    page.click("#submit")
    page.wait_for_selector("#downloads:not([hidden])")
    page.click("#more")
    assert "grey serge" in page.inner_text("#into")
    page.set_input_files("#files", [*FILES[:2], FILES[-1]])
    page.evaluate("document.getElementById('camera').open = true")
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
    for identity in others:
        wait_until_ended(service, identity)
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
    page.focus("#compare")
    began = time.monotonic()
    page.keyboard.press("Enter")
    page.wait_for_selector("#comparison[data-shown]")
    print(f"four fabrics compared in {time.monotonic() - began:.2f} s")
    assert page.locator("#compared th").count() == 4
    assert page.locator("#curves polyline").count() == 12
    page.wait_for_timeout(500)
    keep(page, "page_comparison.png")
    before = page.locator("#drapes").screenshot()
    page.focus("#drapes")
    page.keyboard.press("ArrowLeft")
    assert page.locator("#drapes").screenshot() != before
    assert fits(page)
    keep(page, "page_comparison_phone.png")
    page.goto(service.url + "/#fabrics")
    page.wait_for_selector("#fabrics tr")
    assert fits(page)
    keep(page, "page_fabrics_phone.png")


def test_presets_stay_and_names_change(page, service):
    page.evaluate("document.getElementById('camera').open = true")
    page.select_option("#tester", "disc300_support180")
    page.check("[name=kind][value=above]")
    page.fill("[name=camera_height_mm]", "1250")
    page.fill("#preset-name", "our Cusick")
    page.click("#preset-save")
    page.reload()
    page.evaluate("document.getElementById('camera').open = true")
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


def test_a_photograph_has_no_captured_surface(page):
    page.click("[data-example=twill_photograph]")
    page.wait_for_selector("#downloads:not([hidden])")
    page.wait_for_selector("#overlay", state="hidden")
    assert "outline from above" in page.inner_text("#facts")
    assert page.evaluate("document.querySelector('#preview img').naturalWidth") > 500
    keep(page, "page_photograph.png")


def drag(page, selector: str, right: float, down: float) -> None:
    """Drag the middle of what is seen of an element by pixels of the screen."""
    page.locator(selector).scroll_into_view_if_needed()
    box = page.locator(selector).bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + right / 2, y + down / 2)
    page.mouse.move(x + right, y + down)
    page.mouse.up()


def placed(page) -> dict[str, float]:
    """Where the form has the plate."""
    return {key: float(page.input_value(f"[name=plate_{key}]")) for key in ("x", "y", "diameter")}


def test_the_plate_is_moved_in_the_photograph_before_its_estimate(page, tmp_path):
    file = tmp_path / "IMG_0007.jpg"
    Image.fromarray(drawn(pixel=2e-4)).save(file, quality=95)
    page.set_input_files("#files", [str(file)])
    assert page.is_hidden("#seen")  # the tester is not known
    page.select_option("#tester", "disc300_support180")
    page.locator("#seen-refusal", has_text="the scale is not known").wait_for()
    assert page.input_value("[name=plate_x]") == ""
    true, view = plate(pixel=2e-4), page.locator("#seen-picture").bounding_box()
    across = view["width"] / 2000  # pixels of the screen to one of the file
    drag(page, "#seen-picture .knob", (true["diameter"] / 2 - 450) * across, 0)
    assert placed(page)["diameter"] == pytest.approx(true["diameter"], abs=3 / across)
    drag(page, "#seen-picture circle:first-child", (true["x"] - 999.5) * across,
         (true["y"] - 999.5) * across)
    assert placed(page) == pytest.approx(true, abs=3 / across)
    page.locator("#seen-status", has_text="Outline found: 7 nodes").wait_for()
    assert page.locator("#seen-picture polygon").get_attribute("points")
    keep(page, "page_outline.png")
    before, status = placed(page), page.inner_text("#seen-status")
    page.focus("#seen-picture g")
    page.keyboard.press("ArrowRight")  # a pixel of the picture, which has half of the file's
    page.keyboard.press("Shift+ArrowUp")
    for _ in range(10):
        page.keyboard.press("+")
    moved = {"x": before["x"] + 2, "y": before["y"] - 20, "diameter": before["diameter"] + 40}
    assert placed(page) == pytest.approx(moved, abs=0.2)
    page.wait_for_function("before => !['', before].includes(document.getElementById("
                           "'seen-status').textContent) && !document.getElementById("
                           "'seen-status').textContent.startsWith('Reading')", arg=status)
    seen = re.search(r"Outline found.* ([\d.]+ %)", page.inner_text("#seen-status"))
    page.fill("[name=camera_height_mm]", "parallel")
    page.fill("#density", "150")
    page.click("#submit")
    page.wait_for_selector("#numbers:not([hidden])")
    assert f"{seen[1]} captured" in page.inner_text("#facts")
    assert fits(page)
    keep(page, "page_outline_phone.png")
    page.select_option("[name=mat]", "a3")
    assert page.is_hidden("[name=plate_x]") and page.is_visible("[name=plate_height_mm]")
    page.set_input_files("#files", FILES)
    page.wait_for_selector("#seen", state="hidden")
    assert page.input_value("[name=plate_x]") == ""


@pytest.fixture(params=[390, 1280])
def tester(request, browser, service):
    """The page at a tester: on a phone, with a camera, or on a wide screen; with a mat stated."""
    phone = {"is_mobile": True, "has_touch": True, "device_scale_factor": 2}
    page = browser.new_page(viewport={"width": request.param, "height": 844},
                            **phone if request.param < 1000 else {})
    page.set_default_timeout(SECONDS)
    page.problems = []
    page.on("pageerror", lambda error: page.problems.append(str(error)))
    page.goto(service.url)
    page.evaluate("document.getElementById('camera').open = true")
    page.select_option("#tester", "disc300_support180")
    page.check("[name=kind][value=above]")
    page.select_option("[name=mat]", "a2")
    page.fill("[name=plate_height_mm]", "91.2")
    page.fill("#density", "210")
    page.press("#density", "Tab")
    page.evaluate("document.getElementById('camera').open = false")
    yield page
    assert page.problems == []
    page.close()


def taken(page, picture: dict | str, *, further: bool = False) -> None:
    """Take a picture, with the camera on a phone, and wait until it is read."""
    wide = page.viewport_size["width"] > 1000
    assert page.is_visible("label:has(#shot)") != wide
    before = page.evaluate("document.getElementById('seen-picture').children[0].href.baseVal")
    page.set_input_files("#another" if further else "#files" if wide else "#shot", picture)
    page.wait_for_function(
        "before => ![before, ''].includes(document.querySelector('#seen-picture image').href"
        ".baseVal) && !document.getElementById('seen-status').textContent.startsWith('Reading')",
        arg=before)


def drawn_over_mat(name: str, **picture) -> dict:
    return {"name": name, "mimeType": "image/jpeg", "buffer": over_mat(**picture)}


def is_in_view(page, selector: str) -> bool:
    box = page.locator(selector).bounding_box()
    return box["y"] >= -1 and box["y"] + box["height"] <= page.viewport_size["height"] + 1


def test_a_specimen_is_photographed_and_estimated_before_it_is_taken_down(tester, tmp_path):
    """With a picture of twelve megapixels, which is reduced to three, turned, and its tags kept."""
    page, width = tester, tester.viewport_size["width"]
    file = tmp_path / "image.jpg"
    with Image.open(EXAMPLE.with_name("twill_photograph") / "outline.jpg") as picture:
        exif = picture.getexif()
        large = picture.resize((3024, 4032)).rotate(90, expand=True)
        exif[ORIENTATION] = 6  # by a quarter clockwise
        large.save(file, quality=92, exif=exif)
    sizes = []
    page.on("request", lambda request: sizes.append(int(request.all_headers()["content-length"]))
            if request.url.endswith("/outline") else None)
    began = time.monotonic()
    taken(page, str(file))
    print(f"the outline is shown {time.monotonic() - began:.1f} s after the picture, width {width}")
    assert sizes[-1] < 0.5 * file.stat().st_size
    assert "Nothing in it is doubtful" in page.inner_text("#seen-status")
    assert len(page.get_attribute("#seen-picture polygon", "points").split()) > 300
    assert page.is_hidden("#seen-way") and page.is_visible("label:has(#another)")
    assert is_in_view(page, "#seen-picture")
    keep(page, f"page_specimen_{width}.png", whole=False)
    again = page.evaluate("""async () => {
      const { reduced } = await import('/static/pictures.js');
      const sent = await reduced(document.getElementById('files').files[0]);
      return [...new Uint8Array(await sent.arrayBuffer())];
    }""")
    with Image.open(io.BytesIO(bytes(again))) as sent:
        assert sent.size == (1512, 2016)
        assert sent.getexif()[ORIENTATION] == 1
        assert sent.getexif().get_ifd(0x8769)[41989] == exif.get_ifd(0x8769)[41989]
    assert is_in_view(page, "#submit") or width > 1000
    page.click("#submit")
    page.wait_for_selector("#numbers:not([hidden])")
    assert is_in_view(page, "#title")
    keep(page, f"page_specimen_result_{width}.png", whole=False)
    assert "210 g/m²" in page.inner_text("#facts")
    page.click("#next-specimen")
    assert page.input_value("#density") == "210" and page.is_visible("#kept")
    assert page.is_hidden("#seen")
    assert page.evaluate("document.getElementById('files').files.length") == 0
    page.fill("#density", "215")
    assert page.is_hidden("#kept")
    page.press("#density", "Tab")
    page.reload()  # as by a phone whose camera needs the memory
    assert page.input_value("#density") == "215"
    assert page.input_value("#tester") == "disc300_support180"
    assert page.input_value("[name=plate_height_mm]") == "91.2"
    taken(page, str(file))
    assert "Nothing in it is doubtful" in page.inner_text("#seen-status")
    assert fits(page)


def test_a_doubtful_picture_says_what_is_wrong_where_and_where_to_stand_next(tester):
    page, width = tester, tester.viewport_size["width"]
    page.evaluate("document.getElementById('camera').open = true")
    page.select_option("[name=mat]", "a3")
    page.fill("[name=plate_height_mm]", "150")
    page.press("[name=plate_height_mm]", "Tab")
    page.evaluate("document.getElementById('camera').open = false")
    disc = 0.119 * AROUND
    taken(page, drawn_over_mat("image.jpg", curve=disc, mat="a3", cloth=(30, 30, 30),
                               beside=(0.0, 0.05)))
    said = page.inner_text("#seen-warnings li:first-child strong")
    assert said.startswith("the hem at the lower side and upper side lies within 10 mm of the edge")
    assert page.get_attribute("#seen-picture .unclear", "d").count("M") >= 2
    assert page.is_visible("#seen-way")
    start, end = arrow(page)
    assert end[1] > start[1]  # as far downwards as the camera was up
    keep(page, f"page_doubtful_{width}.png", whole=False)
    taken(page, drawn_over_mat("image.jpg", curve=disc, mat="a3", cloth=(30, 30, 30),
                               beside=(0.0, -0.08)), further=True)
    assert page.inner_text("#pictures").split() == ["outline_1", "×", "outline_2", "×"]
    assert page.locator("#seen-warnings li").count() == 0 and page.is_hidden("#seen-way")
    page.click("#pictures button >> nth=1")
    page.locator("#seen-warnings", has_text="within 10 mm").wait_for()
    assert page.locator("#pictures li").count() == 0
    taken(page, drawn_over_mat("image.jpg", mat="a3", beside=(0.15, 0.1), cloth=(30, 30, 30)))
    assert "the hem at the lower left, on the far side" in page.inner_text("#seen-warnings")
    start, end = arrow(page)
    middle = page.evaluate("document.getElementById('seen-picture').viewBox.baseVal.width") / 2
    assert end == pytest.approx([middle, middle], abs=1)
    assert start[0] > middle > start[1]  # from the upper right
    keep(page, f"page_beside_{width}.png", whole=False)
    assert fits(page)


def arrow(page) -> list[list[float]]:
    """Start and tip of the arrow, pixels of the picture."""
    first = page.get_attribute("#seen-way path", "d")[1:].split("M")[0]
    return [[float(number) for number in point.split(",")] for point in first.split("L")]


def test_strips_and_values_join_and_what_contradicts_is_shown_at_once(page, tmp_path):
    file = tmp_path / "strips.yaml"
    file.write_text("density_g_m2: 210\nstrips:\n- {direction: warp, bending_length_mm: 21.5}\n",
                    encoding="utf-8")
    page.set_input_files("#files", [str(file)])
    page.fill("#form [name=name]", "olive serge")
    page.fill("#warp", "30")  # of a capture, and not sent
    page.evaluate("document.querySelector('[name=operator]').closest('details').open = true")
    page.fill("#form [name=operator]", "M. Muster")
    page.click("#submit")
    page.wait_for_selector("#downloads:not([hidden])")
    assert "1 strip" in page.inner_text("#facts") and "M. Muster" in page.inner_text("#facts")
    page.click("#more")
    page.evaluate("document.getElementById('known').closest('details').open = true")
    keep(page, "page_values.png")
    name = "known.flexural_rigidity_uN_m.warp"
    page.fill(f"[name='{name}']", "-600")
    page.click("#submit")
    page.locator(f"[id='error-{name}']", has_text="greater than 0").wait_for()
    page.fill(f"[name='{name}']", "600")
    page.click("#submit")
    page.locator("#contradictions", has_text="left out").wait_for()
    assert "all captures: the known flexural rigidity G [µN·m] warp = 600 contradicts" in (
        page.inner_text("#contradictions"))
    assert page.input_value(f"[name='{name}']") == ""
    page.click("#captures a:has-text('all captures')")
    page.locator("#warnings .contradiction", has_text="left out").wait_for()
    page.locator("#links", has_text="Report (PDF)").wait_for()
    page.click("header a:has-text('Fabrics')")
    page.locator("#fabrics", has_text="left out").wait_for()
    assert fits(page)


def test_errors_stand_where_they_arise(page):
    page.click("#submit")
    assert "No files yet" in page.inner_text("#error-files")
    page.set_input_files("#files", FILES[:-1])  # without a description
    assert page.evaluate("document.getElementById('camera').open")
    page.click("#submit")
    assert "Weigh the specimen" in page.inner_text("#error-density_g_m2")
    assert page.get_attribute("#density", "aria-invalid") == "true"
    page.fill("#density", "210")
    page.click("#submit")
    assert "Choose the tester" in page.inner_text("#error-tester")
    page.select_option("#tester", "square_cylinder")
    page.click("#submit")
    assert "the diameter of the plate" in page.inner_text("#error-tester")
    page.fill("#size", "300")
    page.fill("#plate", "100")
    for name, value in (("fx", 305), ("fy", 305), ("cx", 119.5), ("cy", 89.5)):
        page.fill(f"[name={name}]", str(value))
    page.fill("[name=depth_unit_m]", "1")
    page.click("#submit")
    page.wait_for_selector("#failure:not(:empty)")
    assert "depth_unit_m" in page.inner_text("#failure")
    assert "depth" in page.inner_text("#error-depth_unit_m")
    assert "error-depth_unit_m" in page.get_attribute("[name=depth_unit_m]", "aria-describedby")
    keep(page, "page_error.png")
    page.fill("#density", "2")
    page.click("#submit")
    page.locator("#error-density_g_m2", has_text="check the unit").wait_for()
    page.fill("#density", "210")
    page.goto(page.url.partition("#")[0] + "#" + "x" * 22)
    page.locator("#failure", has_text="no such estimate").wait_for()


def test_lost_connection_goes_on(page, service):
    page.context.set_offline(False)
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
    page.check("#refine")
    page.click("[data-example=twill]")
    page.locator("#status", has_text="refines").wait_for()
    service.stop(signal.SIGKILL)
    page.wait_for_selector("#lost:not([hidden])")
    service.start()
    page.wait_for_selector("#downloads:not([hidden])")
    assert page.inner_text("#failure") == ""
    page.goto(kept)
    page.reload()
    page.wait_for_selector("#numbers:not([hidden])")
