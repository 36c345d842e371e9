"""Pages of the service: the start page, the interface's description, the manual, examples."""

import re
from functools import cache
from pathlib import Path

import numpy as np
import swagger_ui_bundle
from fastapi import FastAPI
from fastapi.openapi.docs import get_swagger_ui_html
from fastapi.responses import HTMLResponse, Response
from fastapi.staticfiles import StaticFiles
from markdown import markdown
from markdown.extensions.toc import TocExtension, slugify_unicode
from markupsafe import Markup

from data.captures import description
from data.captures.reader import CAPTURE_FILES, MAX_PICTURES
from data.pictures.mat import CODE, GROUNDS, PARTS
from data.readings import QUANTITIES
from data.rigs import TESTERS
from drapenet.alike import ALIKE
from drapenet.config import ServeConfig
from drapenet.export.formats import TARGETS
from drapenet.export.material import MESHES
from drapenet.measured import KINDS as MEASURED
from drapenet.report.pages import render
from drapenet.service.exports import zipped
from drapenet.service.forms import error_field, typed_kinds, value_fields
from drapenet.service.limits import RequestError
from drapenet.service.received import KINDS, PHOTOGRAPHS
from sim.material import DIRECTIONS, DRAPE_CURVATURE
from sim.rig import RIGS

STATIC = Path(__file__).parent / "static"
ROOT = Path(__file__).parents[2]
EXAMPLES, MANUAL = ROOT / "examples" / "captures", ROOT / "docs"
POLICY = ("default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
          "connect-src 'self' data: blob:; frame-ancestors 'none'; base-uri 'none'; "
          "form-action 'self'")


def add_pages(app: FastAPI, settings: ServeConfig) -> None:
    """Add the pages to the application."""
    examples = {name: zipped({
        file.name: file.read_bytes() for file in sorted((EXAMPLES / name).iterdir())
        if file.suffix in (".jpg", ".png") or file.name in CAPTURE_FILES})
        for name in ("twill_photograph", "twill") if (EXAMPLES / name).is_dir()}
    page = render("service.html", settings=settings, targets=TARGETS, meshes=MESHES,
                  curvature=DRAPE_CURVATURE, testers={name: RIGS[name] for name in TESTERS},
                  kinds=KINDS, examples=examples, manual=MANUAL.is_dir(), directions=DIRECTIONS,
                  photographs=PHOTOGRAPHS, pictures=MAX_PICTURES, stated=description,
                  grounds=[ground for ground in GROUNDS if ground != CODE],
                  mats=[(mat, paper, columns * rows) for (mat, paper), (columns, rows)
                        in PARTS.items()],
                  typed=typed_kinds(), described=list(MEASURED), factor=np.exp(ALIKE),
                  known=[(each.in_words, value_fields(each), 100 * each.error, error_field(each))
                         for each in QUANTITIES.values()])
    app.mount("/static", StaticFiles(directory=STATIC), name="static")
    app.mount("/swagger", StaticFiles(directory=swagger_ui_bundle.swagger_ui_path), name="swagger")

    @app.get("/", include_in_schema=False)
    def start() -> HTMLResponse:
        return HTMLResponse(page)

    @app.get("/docs", include_in_schema=False)
    def docs() -> HTMLResponse:
        answer = get_swagger_ui_html(
            openapi_url="/openapi.json", title="DrapeNet: HTTP interface",
            swagger_js_url="/swagger/swagger-ui-bundle.js",
            swagger_css_url="/swagger/swagger-ui.css",
            swagger_favicon_url="/swagger/favicon-32x32.png")
        answer.headers["Content-Security-Policy"] = (  # its page has a script inside
            POLICY + "; script-src 'self' 'unsafe-inline'")
        return answer

    @app.get("/examples/{name}.zip", include_in_schema=False)
    def example(name: str) -> Response:
        if name not in examples:
            raise RequestError(404, "no such example")
        return Response(examples[name], media_type="application/zip")

    @app.get("/manual/{name}.md", include_in_schema=False)
    def manual(name: str) -> HTMLResponse:
        file = MANUAL / f"{name}.md"
        if not re.fullmatch(r"\w+", name) or not file.is_file():
            raise RequestError(404, "no such page of the manual")
        return HTMLResponse(_manual_page(file.read_text(encoding="utf-8")))

    if MANUAL.is_dir():
        app.mount("/manual", StaticFiles(directory=MANUAL), name="manual")


@cache
def _manual_page(text: str) -> bytes:
    html = markdown(text, extensions=["tables", "fenced_code",
                                      TocExtension(slugify=slugify_unicode)])
    # Links to files of the checkout lead nowhere here.
    html = re.sub(r'<a href="\.\./[^"]*">(.*?)</a>', r"\1", html, flags=re.DOTALL)
    return render("manual.html", title=text.partition("\n")[0].lstrip("# "), text=Markup(html))
