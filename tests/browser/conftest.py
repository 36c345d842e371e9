"""The service and the browser that the tests of the page share: both take long to start."""

import shutil

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
