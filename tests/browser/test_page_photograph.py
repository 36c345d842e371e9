"""The photograph as the page reads it before its estimate: the plate, the tester, doubts."""

import io
import re

import numpy as np
import pytest
from browsing import FILES, IN_BROWSER, fits, keep, unfold
from photographs import ANGLE, AROUND, drawn, over_mat, plate
from PIL import Image
from serving import EXAMPLE

pytestmark = IN_BROWSER
ORIENTATION = 0x0112  # tag of EXIF


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
    page.locator("#still", has_text="please say what it lies on and how high its top is").wait_for()
    page.wait_for_selector("#seen-picture image")  # as it is, for the tester is not known
    unfold(page)
    page.select_option("#tester", "disc300_support180")
    page.fill("[name=plate_height_mm]", "150")
    page.press("[name=plate_height_mm]", "Tab")
    page.click("#no-mat")
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
    assert fits(page, "page_outline_phone.png")
    page.select_option("[name=mat]", "a3")
    assert page.is_hidden("[name=plate_x]") and page.is_visible("[name=plate_height_mm]")
    page.set_input_files("#files", FILES)
    page.wait_for_selector("#seen", state="hidden")
    assert page.input_value("[name=plate_x]") == ""


def taken(page, picture: dict | str, *, further: bool = False) -> None:
    """Take a picture, with the camera on a phone, and wait until it is read."""
    wide = page.viewport_size["width"] > 1000
    assert page.is_visible("label:has(#shot)") and page.is_visible("label:has(#gallery)") != wide
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
    taken(page, str(file))
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
    assert "210 g/m²" in page.text_content("#facts")
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
    page.fill("[name=plate_height_mm]", "150")
    page.press("[name=plate_height_mm]", "Tab")
    hem = (0.12 - 0.003 * np.cos(10 * ANGLE))[:, None] * AROUND  # along the border of the paper
    taken(page, drawn_over_mat("image.jpg", curve=hem, mat="a3", cloth=(30, 30, 30),
                               beside=(0.0, 0.05)))
    said = page.inner_text("#seen-warnings li:first-child strong")  # by the mat that is seen
    assert page.input_value("[name=mat]") == "a3"
    assert said.startswith("the hem at the lower side and upper side lies within 10 mm of the edge")
    assert page.get_attribute("#seen-picture .unclear", "d").count("M") >= 2
    assert page.is_visible("#seen-way")
    start, end = arrow(page)
    assert end[1] > start[1]  # as far downwards as the camera was up
    keep(page, f"page_doubtful_{width}.png", whole=False)
    taken(page, drawn_over_mat("image.jpg", curve=hem, mat="a3", cloth=(30, 30, 30),
                               beside=(0.0, -0.08)), further=True)
    assert page.inner_text("#pictures").split() == ["picture", "1", "×", "picture", "2", "×"]
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
