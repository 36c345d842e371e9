"""HTTP interface of the service and its page."""

import asyncio
import io
import zipfile
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import swagger_ui_bundle
import uvicorn
from fastapi import APIRouter, FastAPI, Request
from fastapi.middleware.trustedhost import TrustedHostMiddleware
from fastapi.openapi.docs import get_swagger_ui_html
from fastapi.responses import FileResponse, HTMLResponse, JSONResponse, Response
from fastapi.staticfiles import StaticFiles
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import UploadFile
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from common.documents import read_json
from common.errors import InputError
from common.files import folder_named, require_folder
from data.captures.capture import CAPTURE_FILES
from data.rigs import TESTERS
from drapenet.batch.captures import plain_name
from drapenet.config import ServeConfig
from drapenet.export.formats import TARGETS
from drapenet.export.material import MESHES, read_material
from drapenet.network.checkpoint import read_header
from drapenet.report.pages import render
from drapenet.result.files import ESTIMATE, SHOWN
from drapenet.service.jobs import Jobs
from drapenet.service.uploads import KINDS, NUMBERS, TEXTS, RequestError, checked_upload
from drapenet.service.work import DONE, PREVIEW
from sim.rig import RIGS

FILES = (ESTIMATE, PREVIEW, *SHOWN)
STATIC = Path(__file__).parent / "static"
EXAMPLES = Path(__file__).parents[2] / "examples" / "captures"
_TIDY_INTERVAL = 600.0  # s between removals of old results
_POLICY = ("default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
           "connect-src 'self' data: blob:; frame-ancestors 'none'; base-uri 'none'; "
           "form-action 'self'")
_SECURE = {"X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer",
           "Content-Security-Policy": _POLICY}
_MAX_FORM = 1 << 20  # bytes of a request beside its files
_DRAIN_TIMEOUT = 2.0  # s, for which a refused upload is read, so that the client reads the answer
_FORM = {"required": True, "content": {"multipart/form-data": {"schema": {
    "type": "object", "required": ["files"], "properties": {
        **{name: {"type": "number"} for name in NUMBERS},
        **{name: {"type": "string"} for name in TEXTS},
        "files": {"type": "array", "items": {"type": "string", "format": "binary"},
                  "description": f"views, a photograph or table of an outline, a zip with "
                                 f"them, or a scan: {', '.join(KINDS)}"}}}}}}
_STATUSES = {
    404: "no such estimate, or file of it", 408: "the upload took too long",
    409: "not yet available", 413: "too many or too large files",
    415: "a kind of file that is not taken", 422: "not a capture",
    429: "the queue is full: try again"}
_FRESH = {"Cache-Control": "no-store"}
router = APIRouter()


def _responses(*statuses: int) -> dict[int | str, dict[str, Any]]:
    return {status: {"description": _STATUSES[status]} for status in statuses}


def serve(settings: ServeConfig) -> None:
    """Serve until interrupted."""
    require_folder(folder_named(settings.results))
    read_header(settings.checkpoint)  # workers need it: an InputError here is seen
    server = uvicorn.Server(uvicorn.Config(
        create_app(settings), host=settings.host, port=settings.port, log_level="warning",
        ws="none", limit_concurrency=8 * settings.queue + 64, timeout_keep_alive=10,
        timeout_graceful_shutdown=3, server_header=False))
    try:
        listening = server.config.bind_socket()
    except SystemExit:
        raise InputError(f"cannot listen at {settings.host}:{settings.port}; choose another port="
                         ) from None
    print(f"http://{settings.host}:{listening.getsockname()[1]}   (results in {settings.folder}; "
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
    app.openapi_version = "3.0.3"  # as swagger-ui-bundle's page reads it
    allowed = [settings.host, "localhost", "127.0.0.1", "[::1]", *settings.hosts]
    app.add_middleware(TrustedHostMiddleware,
                       allowed_hosts=["*"] if settings.host in ("0.0.0.0", "::") else allowed)
    app.middleware("http")(_guarded)
    app.exception_handler(HTTPException)(_refused)
    app.exception_handler(ClientDisconnect)(_closed)
    app.exception_handler(Exception)(_failed)
    app.mount("/static", StaticFiles(directory=STATIC), name="static")
    app.mount("/swagger", StaticFiles(directory=swagger_ui_bundle.swagger_ui_path), name="swagger")
    _add_pages(app, settings)
    app.include_router(router)
    return app


def _add_pages(app: FastAPI, settings: ServeConfig) -> None:
    examples = [name for name in ("twill", "twill_photograph") if (EXAMPLES / name).is_dir()]
    page = render("service.html", settings=settings, targets=TARGETS, meshes=MESHES,
                  testers={name: RIGS[name] for name in TESTERS}, kinds=KINDS,
                  examples=examples)

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
            _POLICY + "; script-src 'self' 'unsafe-inline'")
        return answer

    @app.get("/examples/{name}.zip", include_in_schema=False)
    def example(name: str) -> Response:
        if name not in examples:
            raise RequestError(404, "no such example")
        return Response(_zipped({
            file.name: file.read_bytes() for file in sorted((EXAMPLES / name).iterdir())
            if file.suffix == ".png" or file.name in CAPTURE_FILES}), media_type="application/zip")


@router.post("/estimates", status_code=202, openapi_extra={"requestBody": _FORM},
             responses=_responses(408, 413, 415, 422, 429))
async def begin(request: Request) -> dict[str, str]:
    """Upload a capture or a scan and start its estimate."""
    jobs: Jobs = request.app.state.jobs
    try:
        jobs.reserve()
    except RequestError:
        await _drain(request)
        raise
    try:
        files, texts = await _form(request, jobs.settings)
        upload = await run_in_threadpool(checked_upload, files, texts, jobs.settings)
    except BaseException:
        jobs.release()
        raise
    # The place now belongs to the job: a cancelled request must not release it.
    identity = await run_in_threadpool(jobs.submit, upload)
    return {"id": identity, "url": f"/estimates/{identity}", "page": f"/#{identity}"}


@router.get("/estimates/{identity}", responses=_responses(404))
def state(identity: str, request: Request) -> JSONResponse:
    """State and result of an estimate: `state` is queued, running, done, failed or interrupted;
    `estimate` has the content of estimate.json as soon as the network's estimate is available.
    """
    folder, content = request.app.state.jobs.state(identity)
    files = [name for name in FILES if (folder / name).is_file()]
    estimate = read_json(folder / ESTIMATE) if ESTIMATE in files else None
    return JSONResponse(content | {"estimate": estimate, "files": files}, headers=_FRESH)


@router.get("/estimates/{identity}/{file}", response_class=FileResponse,
            responses=_responses(404, 409))
def file(identity: str, file: str, request: Request) -> FileResponse:
    """A file of an estimate: estimate.json, report.png, report.html, drape.glb, torque.svg or
    preview.png.
    """
    folder, _ = request.app.state.jobs.state(identity)
    if file not in FILES:
        raise RequestError(404, f"no such file; there are {', '.join(FILES)}")
    if not (folder / file).is_file():
        raise RequestError(409, f"{file} is not yet available")
    return FileResponse(folder / file, headers=_FRESH)


@router.get("/estimates/{identity}/export/{name}", response_class=Response,
            responses=_responses(404, 409, 422))
def export(identity: str, name: str, request: Request, mesh: str = "unstructured",
           edge_mm: float = 5.0, curvature_1_m: float = 0.0) -> Response:
    """A file for another tool, or a zip of several files; `mesh` and `edge_mm` are for tools with
    hinges, `curvature_1_m` is that of the secant for tools with one modulus.
    """
    folder, content = request.app.state.jobs.state(identity)
    if name not in TARGETS:
        raise RequestError(404, f"no such tool; there are {', '.join(TARGETS)}")
    if content["state"] != DONE:
        raise RequestError(409, "the estimate is not finished")
    title = f"{plain_name(content['name'])}-{TARGETS[name].file}"
    try:
        material = read_material(folder / ESTIMATE, curvature_1_m=curvature_1_m, mesh=mesh,
                                 edge_mm=edge_mm, name=content["name"])
        files = TARGETS[name].write(material, title)
    except InputError as error:
        raise RequestError(422, str(error).replace(str(folder), "")) from None
    data = files[title] if len(files) == 1 else _zipped(files)
    title = title if len(files) == 1 else f"{Path(title).stem}.zip"
    ascii_title = title.encode("ascii", "replace").decode().replace("?", "_")
    return Response(data, media_type="application/octet-stream",
                    headers={"Content-Disposition": f"attachment; filename=\"{ascii_title}\""})


def _zipped(files: Mapping[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED)
    return stream.getvalue()


async def _form(
    request: Request, settings: ServeConfig
) -> tuple[list[tuple[str, bytes]], dict[str, str]]:
    """Files and text fields of a multipart request."""
    if not request.headers.get("content-type", "").startswith("multipart/form-data"):
        await _drain(request)
        raise RequestError(415, "send the files as multipart/form-data, in the field files")
    limited = Request(request.scope, _limited(request, settings))
    files, texts = [], {}
    async with limited.form(max_files=settings.files, max_fields=32, max_part_size=1 << 16) as form:
        for key, value in form.multi_items():
            if isinstance(value, UploadFile):
                if key != "files":
                    raise RequestError(422, f"unknown field {key[:60]!r} with a file; give files")
                files.append((value.filename or "unnamed", await value.read()))
            elif key in texts:
                raise RequestError(422, f"the field {key[:60]!r} is given twice; give it once")
            else:
                texts[key] = value
    return files, texts


def _limited(request: Request, settings: ServeConfig) -> Callable[[], Awaitable[Any]]:
    """The messages of a request, of limited size and duration."""
    clock, total = asyncio.get_running_loop().time, 0
    end = clock() + settings.upload_seconds

    async def receive() -> Any:
        nonlocal total
        try:
            message = await asyncio.wait_for(request.receive(), max(0.0, end - clock()))
        except asyncio.TimeoutError:
            raise RequestError(408, f"the upload took more than {settings.upload_seconds:g} s; try "
                               "again") from None
        total += len(message.get("body", b""))
        if total > settings.bytes + _MAX_FORM:
            raise RequestError(413, f"the upload has more than {settings.bytes / 1e6:g} MB")
        return message

    return receive


async def _drain(request: Request) -> None:
    """Read some of the body of a refused request, so that the client reads the response."""
    async def read() -> None:
        total = 0
        async for part in request.stream():
            total += len(part)
            if total > _MAX_FORM:
                return

    with suppress(Exception):  # the request is refused in any case
        await asyncio.wait_for(read(), _DRAIN_TIMEOUT)


async def _guarded(
    request: Request, call_next: Callable[[Request], Awaitable[Response]]
) -> Response:
    """Refuse requests from pages of other sites, and add security headers to responses."""
    origin = request.headers.get("origin")
    if request.method not in ("GET", "HEAD") and origin is not None and (
            urlsplit(origin).netloc != request.headers.get("host")):
        return _answer(403, "requests from other sites' pages are not taken")
    answer = await call_next(request)
    for name, value in _SECURE.items():
        answer.headers.setdefault(name, value)
    return answer


def _answer(status: int, sentence: str) -> JSONResponse:
    headers = _SECURE | ({"Retry-After": "30"} if status == 429 else {})
    return JSONResponse({"error": sentence}, status_code=status, headers=headers)


async def _refused(request: Request, error: HTTPException) -> JSONResponse:
    return _answer(error.status_code, str(error.detail))


async def _closed(request: Request, error: ClientDisconnect) -> JSONResponse:
    return _answer(400, "the connection was closed before the upload was complete")


async def _failed(request: Request, error: Exception) -> JSONResponse:
    return _answer(500, "a fault of the program, which the service's log states")


async def _tidy(jobs: Jobs) -> None:
    while True:
        await run_in_threadpool(jobs.tidy)
        await asyncio.sleep(_TIDY_INTERVAL)
