"""The service and the browser that the tests of the page share: both take long to start."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from browsing import SECONDS
from serving import Service

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
DRAWING = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@pytest.fixture(scope="session")
def service(tmp_path_factory):
    service = Service(tmp_path_factory.mktemp("service"), queue=32, workers=1)
    yield service
    service.stop()


@pytest.fixture(scope="session")
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


@contextmanager
def opened(browser, service, **options) -> Iterator:
    """The start page, whose scripts have no errors until the end."""
    page = browser.new_page(**options)
    page.set_default_timeout(SECONDS)
    page.problems = []
    page.on("pageerror", lambda error: page.problems.append(str(error)))
    page.on("request", lambda request: page.problems.append(request.url)
            if not request.url.startswith((service.url, "blob:", "data:")) else None)
    page.goto(service.url)
    yield page
    assert page.problems == []  # neither errors of the scripts nor requests to other hosts
    page.close()


@pytest.fixture
def page(browser, service):
    with opened(browser, service, viewport={"width": 1280, "height": 900}) as page:
        yield page


@pytest.fixture(params=[390, 1280])
def tester(request, browser, service):
    """The page at a tester: on a phone, with a camera, or on a wide screen; with a mat stated."""
    phone = {"is_mobile": True, "has_touch": True, "device_scale_factor": 2}
    with opened(browser, service, viewport={"width": request.param, "height": 844},
                **phone if request.param < 1000 else {}) as page:
        page.click("label:has([name=support][value=disc300_support180])")
        page.fill("[name=plate_height_mm]", "91.2")
        page.fill("#density", "210")
        page.press("#density", "Tab")
        assert page.input_value("#tester") == "disc300_support180"
        yield page
