"""HTTP interface of the service."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from http import HTTPStatus
from importlib.metadata import version
from socket import gethostname
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit

import uvicorn
from fastapi import APIRouter, Depends, FastAPI, Query, Request
from fastapi.exceptions import RequestValidationError
from fastapi.middleware.trustedhost import TrustedHostMiddleware
from fastapi.responses import FileResponse, JSONResponse, Response
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from common.errors import InputError
from common.files import folder_named, require_folder
from drapenet.config import ServeConfig
from drapenet.export.formats import TARGETS
from drapenet.fabric.entries import plain_name
from drapenet.network.checkpoint import read_header
from drapenet.report.pages import render
from drapenet.result.files import ESTIMATE, GARMENTS, SHOWN
from drapenet.service.access import (
    CHALLENGE,
    Guard,
    is_unspecified,
    require_decision,
    url_host,
)
from drapenet.service.archive import Archive
from drapenet.service.database import DONE
from drapenet.service.exports import alike, all_files, export_file, results_table
from drapenet.service.forms import About, form_fields
from drapenet.service.jobs import Jobs, logged
from drapenet.service.limits import RequestError, drain, length_fault, read_form
from drapenet.service.pages import POLICY, add_pages
from drapenet.service.received import KINDS
from drapenet.service.seen import mat_pdf
from drapenet.service.uploads import checked_photograph, checked_upload
from drapenet.service.work import PREVIEW
from sim.material import DRAPE_CURVATURE

FILES = (ESTIMATE, PREVIEW, *SHOWN, *GARMENTS)
_TIDY_INTERVAL = 600.0  # s between removals of old results
_SECURE = {"X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer",
           "Content-Security-Policy": POLICY}
_FIELDS: dict[str, dict[str, Any]] = {
    "files": {"type": "array", "items": {"type": "string", "format": "binary"},
              "description": "views, a photograph or table of an outline, strips.yaml or "
                             "tension.yaml with its photographs, a zip with them, or a scan: "
                             f"{', '.join(KINDS)}; none for known values, or strips under "
                             "weights, of the form"}}
"""Properties of a form, to which an application adds those of all kinds of measurements."""
_FORM = {"required": True, "content": {"multipart/form-data": {"schema": {
    "type": "object", "properties": _FIELDS}}}}
_FRESH = {"Cache-Control": "no-store"}
_MAX_BODY = 1 << 16  # bytes of a JSON body
Words = Annotated[str, Query(max_length=200)]
"""Words that fabrics are searched for."""


async def _client(request: Request) -> str:
    """The address whose places a request takes."""
    return request.client.host if request.client else ""


async def _jobs(request: Request) -> Jobs:
    jobs: Jobs = request.app.state.jobs
    return jobs


Client = Annotated[str, Depends(_client)]
Service = Annotated[Jobs, Depends(_jobs)]


def _finished(identity: str, jobs: Service) -> dict[str, Any]:
    """A finished estimate; RequestError if there is none."""
    content = jobs.row("estimate", identity)
    if content["state"] != DONE:
        raise RequestError(409, "the estimate is not finished")
    return content


Finished = Annotated[dict[str, Any], Depends(_finished)]
router = APIRouter(responses={status: {"description": HTTPStatus(status).phrase}
                              for status in (401, 404, 408, 409, 411, 413, 415, 422, 429, 503)})


def serve(settings: ServeConfig) -> None:
    """Serve until interrupted."""
    require_folder(folder_named(settings.results))
    require_decision(settings)
    read_header(settings.checkpoint)  # workers need it: an InputError here is seen
    server = uvicorn.Server(uvicorn.Config(
        create_app(settings), host=settings.host, port=settings.port, log_level="warning",
        ws="none", limit_concurrency=8 * settings.queue + 64, timeout_keep_alive=10,
        timeout_graceful_shutdown=3, server_header=False,
        proxy_headers=bool(settings.proxies), forwarded_allow_ips=settings.proxies))
    try:
        listening = server.config.bind_socket()
    except SystemExit as stop:
        reason = getattr(stop.__context__, "strerror", None)
        raise InputError(f"cannot listen at host={settings.host} with port={settings.port}"
                         + f" ({reason})" * bool(reason) + "; choose another port=, or an address "
                         "of this machine") from None
    port = listening.getsockname()[1]
    others = f"from other machines http://{gethostname()}:{port}; " * is_unspecified(settings.host)
    print(f"http://{url_host(settings.host)}:{port}   ({others}results in {settings.folder}; "
          "Ctrl-C ends)", flush=True)
    server.run(sockets=[listening])


def create_app(settings: ServeConfig) -> FastAPI:
    """The application."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        app.state.jobs = await run_in_threadpool(Jobs, settings)
        tidying = asyncio.create_task(_tidy(app.state.jobs))
        yield
        tidying.cancel()
        await run_in_threadpool(app.state.jobs.close)

    app = FastAPI(title="DrapeNet", version=version("drapenet"), lifespan=lifespan, docs_url=None,
                  redoc_url=None, description=render("service.md", settings=settings).decode())
    app.state.guard = Guard(settings.password)
    app.openapi_version = "3.0.3"  # as swagger-ui-bundle's page reads it
    allowed = [url_host(settings.host), "localhost", "127.0.0.1", "[::1]", *settings.hosts]
    app.add_middleware(TrustedHostMiddleware,
                       allowed_hosts=["*"] if is_unspecified(settings.host) else allowed)
    app.middleware("http")(_guarded)
    for kind, answer in _ANSWERS.items():
        app.exception_handler(kind)(answer)
    _FIELDS.update({name: {"type": kind} for name, kind in form_fields().items()})
    add_pages(app, settings)
    app.include_router(router)
    return app


@router.post("/estimates", status_code=202, openapi_extra={"requestBody": _FORM})
async def begin(request: Request, jobs: Service, client: Client) -> dict[str, str]:
    """Upload a capture, a scan, strips, strips under weights or known values and start their
    estimate; `fabric` adds them to a fabric."""
    try:
        jobs.places.take(client)
        try:
            files, texts = await read_form(request, jobs.settings)
            upload = await run_in_threadpool(checked_upload, files, texts, jobs.settings)
        except BaseException:
            jobs.places.give(client)
            raise
    except RequestError:
        await drain(request)
        raise
    # The place now belongs to the job: a cancelled request must not release it.
    begun = await run_in_threadpool(jobs.submit, upload, client)
    return begun | {"url": f"/estimates/{begun['id']}", "page": f"/#{begun['id']}"}


@router.post("/outline", openapi_extra={"requestBody": _FORM}, response_model=None)
async def outline(request: Request, jobs: Service, client: Client) -> Response:
    """How the photograph of a capture is read, before its estimate: `picture`, a JPEG as a data
    URL, at most 1000 pixels wide and high, with `outline`, the points of the hem, `plate` (`x`,
    `y`, `diameter`; `centred`: its centre is known; `movable`: not by a mat), `specimen`, the
    border of the flat specimen, and `warp`, a line along it, in its pixels; `nodes`,
    `drape_coefficient_percent` as seen, `warnings`, and `refusal`, a sentence if there is no
    outline; `unclear` are parts of the hem that are not clearly seen; over a mat, `cameras` are the
    places of the pictures' cameras, and `next_camera` is that from which another picture is asked
    for, or null; `scale` is the number of pixels of the file to each: p is (p + 0.5) `scale` - 0.5
    of the file. The density may be missing. 204 if there is no photograph from above.
    """
    try:
        with jobs.looks.places.taken(client):
            files, texts = await read_form(request, jobs.settings)
            checked = await run_in_threadpool(checked_photograph, files, texts, jobs.settings)
            seen = checked and await run_in_threadpool(jobs.look, checked)
    except RequestError:
        await drain(request)
        raise
    return JSONResponse(seen, headers=_FRESH) if seen else Response(status_code=204)


@router.get("/mat.pdf", response_class=Response)
def mat_to_print(
    jobs: Service, client: Client, mat: str = "a3", paper: str = "", ground: str = "code"
) -> Response:
    """The mat that lies under the stand, to be printed at 100 %: `mat` is a3 or a2, `paper` that
    of the printer; by default that of the mat; `ground` is code, white, grey or blue.
    """
    with jobs.looks.places.taken(client):
        data = jobs.looks.outcome(mat_pdf, mat, paper or mat, ground)
    return Response(data, media_type="application/pdf",
                    headers={"Content-Disposition": 'inline; filename="mat.pdf"'})


@router.get("/estimates/{identity}")
def state(identity: str, jobs: Service) -> JSONResponse:
    """State and result of an estimate: `state` is queued, running, done, failed or interrupted;
    `estimate` has the content of estimate.json as soon as the network's estimate is available,
    `curves` the torques; `members` are the captures of a joint estimate, `captures` all estimates
    of the fabric with their `contradictions`; `garment` has state, progress and error of a preview.
    """
    folder, content = jobs.settings.folder / identity, jobs.row("estimate", identity)
    del content["task"], content["tries"]
    files = [name for name in FILES if (folder / name).is_file()]
    captures = jobs.row("fabric", content["fabric"])["estimates"]
    return JSONResponse(content | {"files": files, "captures": captures,
                                   "garment": jobs.database.garment(identity)}, headers=_FRESH)


@router.get("/estimates/{identity}/same_pictures")
def same_pictures(identity: str, jobs: Service) -> JSONResponse:
    """Other fabrics' captures that have a picture of an estimate."""
    return JSONResponse(jobs.database.same_pictures(identity), headers=_FRESH)


@router.get("/estimates/{identity}/alike")
def like_this_one(
    found: Finished, jobs: Service, client: Client, count: int = Query(5, ge=1, le=200)
) -> JSONResponse:
    """Other fabrics, the most alike first, then published ones, with a `source`: `probability` that
    they cannot be told apart, `highest` as it could be with their errors; `place` is the result.
    """
    with jobs.exports.places.taken(client):
        return JSONResponse(jobs.exports.outcome(alike, jobs.settings.folder, found["id"], count),
                            headers=_FRESH)


@router.post("/estimates/{identity}/garment", status_code=202)
def garment(found: Finished, jobs: Service, client: Client) -> None:
    """Start the preview of an estimate: garment.png and garment.glb, skirts of twelve of its
    samples, in about a minute."""
    jobs.preview(found["id"], client)


def _settings(
    mesh: str = "unstructured", edge_mm: float = 5.0, curvature_1_m: float = DRAPE_CURVATURE
) -> dict[str, object]:
    """Settings of exports, which :func:`drapenet.export.material.read_material` checks."""
    return {"mesh": mesh, "edge_mm": edge_mm, "curvature_1_m": curvature_1_m}


Settings = Annotated[dict[str, object], Depends(_settings)]


@router.get("/estimates/{identity}/files.zip", response_class=Response)
def estimate_zip(
    found: Finished, jobs: Service, client: Client, settings: Settings
) -> Response:
    """A zip of the files of an estimate and of those for all other tools; what a tool refuses is
    stated in `refused.txt`. `mesh`, `edge_mm` and `curvature_1_m` are those of an export.
    """
    with jobs.exports.places.taken(client):
        data = jobs.exports.outcome(all_files, jobs.settings.folder / found["id"], FILES,
                                    settings | {"name": found["fabric_name"]})
    return _attachment(f"{plain_name(found['fabric_name'])}-files.zip", data)


@router.get("/estimates/{identity}/{file}", response_class=FileResponse)
def file(identity: str, file: str, jobs: Service) -> FileResponse:
    """A file of an estimate: estimate.json, report.png, strips.png, report.html, report.pdf,
    drape.glb, torque.svg, preview.png, or garment.png and garment.glb of a preview."""
    folder = jobs.settings.folder / jobs.row("estimate", identity)["id"]
    if file not in FILES:
        raise RequestError(404, f"no such file; there are {', '.join(FILES)}")
    if not (folder / file).is_file():
        raise RequestError(409, f"{file} is not yet available")
    return FileResponse(folder / file, headers=_FRESH)


@router.get("/estimates/{identity}/export/{name}", response_class=Response)
def export(
    name: str, found: Finished, jobs: Service, client: Client, settings: Settings
) -> Response:
    """A file for another tool, or a zip of several files; `mesh` and `edge_mm` are for tools with
    hinges, `curvature_1_m` is that of the secant for tools with one modulus.
    """
    if name not in TARGETS:
        raise RequestError(404, f"no such tool; there are {', '.join(TARGETS)}")
    title = f"{plain_name(found['fabric_name'])}-{TARGETS[name].file}"
    with jobs.exports.places.taken(client):
        title, data = jobs.exports.outcome(export_file, jobs.settings.folder / found["id"], name,
                                           title, settings | {"name": found["fabric_name"]})
    return _attachment(title, data)


def _attachment(title: str, data: bytes) -> Response:
    """A file to be saved under its title, whose letters beyond ASCII a header cannot have."""
    ascii_title = title.encode("ascii", "replace").decode().replace("?", "_")
    return Response(data, media_type="application/octet-stream", headers=_FRESH | {
        "Content-Disposition": f"attachment; filename=\"{ascii_title}\""})


@router.get("/fabrics")
def fabrics(
    jobs: Service, search: Words = "", first: int = Query(0, ge=0, le=10**6),
    count: int = Query(50, ge=1, le=200),
) -> JSONResponse:
    """Fabrics, the newest first, that have all words of `search` in their name, notes, testers or
    labels; `result` is the joint or latest estimate, `estimate` its summary.
    """
    rows = jobs.database.fabrics(search.split(), first, count)
    return JSONResponse({"fabrics": rows}, headers=_FRESH)


@router.get("/fabrics.xlsx", response_class=Response)
def spreadsheet(jobs: Service, client: Client, search: Words = "") -> Response:
    """A workbook of the fabrics that a search finds: a sheet of their results, and one of their
    captures.
    """
    with jobs.exports.places.taken(client):
        return _attachment(*jobs.exports.outcome(results_table, jobs.settings.folder,
                                                 search.split()))


@router.get("/fabrics.zip", response_class=Response)
def everything(jobs: Service, client: Client) -> Archive:
    """All fabrics with their files and database, as a folder of results of another service."""
    return Archive(jobs.settings.folder, jobs.exports.places.taken(client),
                   jobs.settings.export_seconds)


@router.get("/fabrics/{identity}")
def fabric(identity: str, jobs: Service) -> JSONResponse:
    """A fabric with the states and contradictions of its captures and of their joint estimate."""
    return JSONResponse(jobs.row("fabric", identity), headers=_FRESH)


@router.patch("/fabrics/{identity}")
def change_fabric(identity: str, about: About, jobs: Service) -> JSONResponse:
    """Give a fabric another `name` or `notes`."""
    jobs.row("fabric", identity)  # 404 if there is none
    if stated := about.model_dump(include={"name", "notes"}, exclude_unset=True):
        jobs.database.change("fabric", identity, **stated)
    return JSONResponse(jobs.row("fabric", identity))


@router.delete("/{kind}/{identity}", status_code=204)
def remove(kind: Literal["estimates", "fabrics"], identity: str, jobs: Service) -> None:
    """Remove a fabric with its files, or an estimate: the others of its fabric are joined again."""
    jobs.remove(kind[:-1], identity)


async def _guarded(
    request: Request, call_next: Callable[[Request], Awaitable[Response]]
) -> Response:
    """Refuse requests without the password and from pages of other sites, and add security headers
    to responses.
    """
    if refusal := request.app.state.guard.refusal(request):
        await drain(request)
        return _answer(*refusal)
    origin = request.headers.get("origin")
    if request.method not in ("GET", "HEAD") and origin is not None and (
            urlsplit(origin).netloc != request.headers.get("host")):
        return _answer(403, "requests from other sites' pages are not taken")
    if request.method == "PATCH" and (fault := length_fault(request, _MAX_BODY)):
        return _answer(*fault)
    answer = await call_next(request)
    for name, value in _SECURE.items():
        answer.headers.setdefault(name, value)
    return answer


def _answer(status: int, sentence: str) -> JSONResponse:
    headers = {401: CHALLENGE, 429: {"Retry-After": "30"}}.get(status, {})
    return JSONResponse({"error": sentence}, status_code=status, headers=_SECURE | headers)


_ANSWERS = {
    HTTPException: lambda _, error: _answer(error.status_code, str(error.detail)),
    RequestValidationError: lambda _, error: _answer(
        422, f"{error.errors()[0]['loc'][-1]}: {error.errors()[0]['msg']}"),
    ClientDisconnect: lambda *_: _answer(400, "the connection was closed before the upload was "
                                         "complete"),
    Exception: lambda *_: _answer(500, "a fault of the program, which the service's log states")}


async def _tidy(jobs: Jobs) -> None:
    while True:
        with logged("old results are not removed"):  # such as by a full disk
            await run_in_threadpool(jobs.tidy)
        await asyncio.sleep(_TIDY_INTERVAL)
