"""Checks uploads and writes them as a capture folder or a scan.

File names are set by this module or reduced to plain names of known kinds; no part of an upload is
executed, unpickled or used as a path.
"""

import io
import math
import re
import warnings
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from PIL import Image
from pydantic import BeforeValidator, Field
from starlette.exceptions import HTTPException

from common.documents import MAX_TEXT_BYTES, Schema, parse_yaml, shown
from common.errors import InputError, one_line
from data.captures.capture import CAPTURE_FILES, INTRINSICS_KEYS
from data.captures.description import Description, checked_density
from data.captures.frames import BACKGROUND, header_of
from data.testers import tester_choices
from drapenet.batch.captures import plain_name
from drapenet.service.settings import Settings

PICTURES, SCANS = (".png", ".npy", ".ply"), (".npz", ".obj")
PACKED = (*PICTURES, *SCANS, ".yaml", ".txt")
KINDS = (*PACKED, ".zip")
_NAMED = re.compile(r"view_\d+(_\d+)?\.(png|npy|ply)")


def _number(text: str) -> float:
    with suppress(ValueError):
        return float(text.replace(",", "."))
    raise ValueError("is not a number")


def _angles(text: str) -> list[float]:
    with suppress(ValueError):
        return [float(word) for word in re.split(r"[,;\s]+", text.strip("[] "))]
    raise ValueError("must be angles with commas between them, such as 0, 90, 180")


_Number = Annotated[float, BeforeValidator(_number)] | None
_Text = Annotated[str, Field(max_length=200)] | None


class Form(Schema):
    """A form's fields; those left empty are taken from ``capture.yaml``."""

    density_g_m2: _Number = None
    warp_direction_deg: _Number = None
    turns_deg: Annotated[list[float], BeforeValidator(_angles)] | None = None
    depth_unit_m: _Number = None
    fx: _Number = None
    fy: _Number = None
    cx: _Number = None
    cy: _Number = None
    tester: _Text = None
    face: _Text = None
    refine: Literal["no", "yes"] = "no"
    name: _Text = None


TEXTS = ("turns_deg", "tester", "face", "refine", "name")
NUMBERS = tuple(name for name in Form.model_fields if name not in TEXTS)


class RequestError(HTTPException):
    """A refused request: HTTP status and a sentence as its detail."""


@contextmanager
def _explained() -> Iterator[None]:
    """Raise RequestError with the status 422 for an InputError."""
    try:
        yield
    except InputError as error:
        raise RequestError(422, str(error)) from None


@dataclass(frozen=True)
class Upload:
    """A request to estimate.

    Attributes:
        files: bytes by name; plain names.
        fields: of the form.
        scan: name of the file that is a scan; None where the files are a capture.
        name: given by the user.
    """

    files: dict[str, bytes]
    fields: dict[str, Any]
    scan: str | None
    name: str

    @property
    def refine(self) -> bool:
        """Whether to refine by simulation."""
        return self.fields.get("refine") == "yes"


@_explained()
def checked_upload(
    files: list[tuple[str, bytes]], texts: Mapping[str, str], settings: Settings
) -> Upload:
    """Check a form's ``files``, names and bytes, and ``texts``.

    Raises:
        RequestError: with the status 413, 415 or 422.
    """
    given = {key: text.strip() for key, text in texts.items() if text.strip()}
    fields = Form.of(given, "").model_dump(exclude_none=True)
    if not files:
        raise RequestError(422, "no files; give the views of a drape, a zip with them, or a scan")
    title = Path(files[0][0].replace("\\", "/")).stem if len(files) == 1 else "capture"
    found = _unpacked(files, settings)
    scans = [name for name in found if Path(name).suffix in SCANS
             or (Path(name).suffix == ".ply" and not _NAMED.fullmatch(name))]
    if scans and len(found) > 1:
        raise RequestError(422, f"{scans[0]} is a scan and must come alone; views are called "
                           "view_0.png and so on")
    for name, data in found.items():
        _require_pixels(name, data, settings.pixels)
    if scans:
        checked_density(fields.get("density_g_m2"))
    return Upload(found, fields, scans[0] if scans else None,
                  plain_name(fields.get("name") or title)[:40])


@_explained()
def write_upload(upload: Upload, folder: Path) -> None:
    """Write an upload to a new ``folder``, a capture with its description, or the scan alone.

    Raises:
        RequestError: fields and files that are not a capture.
    """
    folder.mkdir(parents=True)
    files = dict(upload.files)
    if upload.scan is None:
        if not any(mark in files for mark in CAPTURE_FILES) or "capture.yaml" in files:
            files = _numbered(files)
            files["capture.yaml"] = _description(files.pop("capture.yaml", None), upload.fields)
    for name, data in files.items():
        (folder / name).write_bytes(data)


def _unpacked(files: list[tuple[str, bytes]], settings: Settings) -> dict[str, bytes]:
    """Files by plain name, with zips unpacked."""
    found: dict[str, bytes] = {}
    for name, data in files:
        for inner, content in (_members(data, settings) if _suffix(name) == ".zip"
                               else [(name, data)]):
            plain = plain_name(Path(inner.replace("\\", "/")).name)
            plain = Path(plain).stem + _suffix(inner)
            if plain in found:
                raise RequestError(422, f"two files are called {plain}; give one capture at a time")
            found[plain] = content
    if not found:
        raise RequestError(422, f"the zip holds no files of the kinds {', '.join(PACKED)}")
    if len(found) > settings.files:
        raise RequestError(413, f"{len(found)} files; at most {settings.files}")
    return found


def _ending(name: str) -> str:
    suffix = Path(name.replace("\\", "/")).suffix.lower()
    return ".yaml" if suffix == ".yml" else suffix


def _suffix(name: str) -> str:
    suffix = _ending(name)
    if suffix not in KINDS:
        raise RequestError(415, f"{shown(name)}: files of this kind are not taken; give "
                           f"{', '.join(KINDS)}")
    return suffix


def _members(data: bytes, settings: Settings) -> list[tuple[str, bytes]]:
    """Names and contents of a zip's files, without those of other kinds and hidden ones."""
    found, left = [], settings.bytes
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = archive.infolist()
            if len(entries) > 4 * settings.files:
                raise RequestError(413, f"the zip has {len(entries)} entries; at most "
                                   f"{settings.files} files")
            for entry in entries:
                name = Path(entry.filename.replace("\\", "/")).name
                known = _ending(name) in PACKED
                if entry.is_dir() or not known or name.startswith((".", "_")):
                    continue
                with archive.open(entry) as stream:  # the stated size may be wrong
                    content = stream.read(left + 1)
                left -= len(content)
                if left < 0:
                    raise RequestError(413, "the zip unpacks to more than "
                                       f"{settings.bytes / 1e6:g} MB")
                found.append((entry.filename, content))
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, OSError, EOFError, ValueError,
            zipfile.zlib.error) as error:
        raise RequestError(422, f"the zip cannot be read ({one_line(error)}); pack it again"
                           ) from None
    return found


def _require_pixels(name: str, data: bytes, most: int) -> None:
    """Refuse an image whose header states more than ``most`` pixels, before decoding, and a text
    file that is too large.
    """
    suffix = Path(name).suffix
    if suffix in (".yaml", ".txt") and len(data) > MAX_TEXT_BYTES:
        raise RequestError(413, f"{name} has {len(data)} bytes; at most {MAX_TEXT_BYTES}")
    try:
        if suffix == ".png":
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", Image.DecompressionBombWarning)
                with Image.open(io.BytesIO(data), formats=["PNG"]) as picture:
                    size = picture.size
        elif suffix == ".npy":
            size, _ = header_of(data)
        else:
            return
    except Image.DecompressionBombError:
        raise RequestError(413, f"{name} has too many pixels; at most {most / 1e6:g} million"
                           ) from None
    except Exception as error:  # libraries raise any exception for malformed headers
        raise RequestError(422, f"{name} cannot be read ({one_line(error)}); export the view again"
                      ) from None
    if (count := math.prod(size)) > most:
        raise RequestError(413, f"{name} has {count} pixels; at most {most / 1e6:g} million, "
                           "save it smaller")


def _numbered(files: dict[str, bytes]) -> dict[str, bytes]:
    """Rename images to view_0 and so on, in the order of their names, unless named so already."""
    others = [name for name in files if Path(name).suffix in PICTURES and name != BACKGROUND]
    if not others or any(_NAMED.fullmatch(name) for name in others):
        return files
    others.sort(key=lambda name: [int(part) if part.isdigit() else part
                                  for part in re.split(r"(\d+)", name)])
    renamed = {old: f"view_{k}{Path(old).suffix}" for k, old in enumerate(others)}
    return {renamed.get(name, name): data for name, data in files.items()}


def _description(given: bytes | None, fields: Mapping[str, Any]) -> bytes:
    """``capture.yaml``: the given one, updated by the form's fields."""
    try:
        text = (given or b"{}").decode("utf-8")
        content = dict(parse_yaml(text, "capture.yaml"))
        content |= {key: fields[key] for key in (*NUMBERS[:3], "turns_deg", "tester", "face")
                    if key in fields}
        intrinsics = {key: fields[key] for key in INTRINSICS_KEYS if key in fields}
        if intrinsics:
            content["intrinsics"] = intrinsics
        if Description.of(content, "").tester is None:
            raise RequestError(422, f"tester is missing; {tester_choices()}")
        return yaml.safe_dump(content).encode()
    except UnicodeDecodeError:
        raise RequestError(422, "capture.yaml is not text in UTF-8; save it as such") from None
    except (yaml.YAMLError, RecursionError) as error:
        raise RequestError(422, f"capture.yaml cannot be read ({one_line(error)})") from None
