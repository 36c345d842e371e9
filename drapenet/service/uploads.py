"""Checks uploads and writes them as a capture folder or a scan.

File names are set by this module or reduced to plain names of known kinds; no part of an upload is
executed, unpickled or used as a path.
"""

import email.errors
import email.header
import io
import math
import re
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import yaml
from PIL import Image
from pydantic import Field

from common.documents import MAX_TEXT_BYTES, Schema, number, parse_yaml, shown
from common.errors import InputError, one_line
from data.captures.capture import CAPTURE_FILES, INTRINSICS_KEYS, OUTLINE_SUFFIXES
from data.captures.description import (
    MAX_LABEL_LENGTH,
    OUTLINE_TABLES,
    PRINTABLE,
    Description,
    PlateInPicture,
    Specimen,
)
from data.captures.frames import BACKGROUND, header_of
from data.rigs import MISSING_TESTER
from drapenet.batch.captures import plain_name
from drapenet.config import ServeConfig
from drapenet.service.limits import RequestError

PICTURES, SCANS = (".png", ".npy", ".ply"), (".npz", ".obj", ".stl")
PACKED = tuple(dict.fromkeys((*PICTURES, *OUTLINE_SUFFIXES, *SCANS, ".yaml")))
KINDS = (*PACKED, ".zip")
PLACES = {**{key: ("intrinsics", key) for key in INTRINSICS_KEYS},
          **{f"plate_{key}": ("outline", "plate_px", key) for key in PlateInPicture.model_fields},
          **{key: ("outline", key) for key in ("mm_per_px", "camera_height_mm", "unit", "centred")}}
"""Where capture.yaml has the fields of a form that are not at its top."""
TEXTS = ("turns_deg", "tester", "face", "camera_height_mm", "unit", "centred", "refine", "fabric",
         "name", "notes", "label")
NUMBERS = ("density_g_m2", "warp_direction_deg", "depth_unit_m",
           *(key for key in PLACES if key not in TEXTS))
_NAMED = re.compile(r"view_\d+(_\d+)?\.(png|npy|ply)")


class About(Schema):
    """What a user states of a fabric: ``name``, ``notes``; and the ``label`` of its capture."""

    name: str = Field("", max_length=MAX_LABEL_LENGTH, pattern=PRINTABLE,
                      description=f"up to {MAX_LABEL_LENGTH} printable characters")
    notes: Annotated[str, Field(max_length=2000)] = ""
    label: str = Field("", max_length=40, pattern=PRINTABLE,
                       description="up to 40 printable characters")


@dataclass(frozen=True)
class Upload:
    """A request to estimate a capture, with its description, or a scan of a specimen.

    Attributes:
        scan: name of the file that is a scan; empty for a capture.
        name: of a new fabric, if ``fabric``, the identity of an earlier one, is empty.
        about: its notes, and the label of the capture, which may be empty.
    """

    files: dict[str, bytes]
    scan: str
    name: str
    about: About
    refine: bool = False
    specimen: Specimen | None = None
    fabric: str = ""


def checked_upload(
    files: list[tuple[str, bytes]], texts: Mapping[str, str], settings: ServeConfig
) -> Upload:
    """Check a form's files, names and bytes, and texts."""
    fields = {key: text.strip() for key, text in texts.items() if text.strip()}
    refine, fabric = fields.pop("refine", "no"), fields.pop("fabric", "")
    if not files:
        raise RequestError(422, "no files; give the views of a drape, its photograph or outline "
                           "from above, a zip with them, or a scan")
    if refine not in ("no", "yes"):
        raise RequestError(422, f"refine={shown(refine)} must be yes or no")
    files = [(decoded(name), data) for name, data in files]
    contents = _unpacked(files, settings)
    scans = [file for file in contents if Path(file).suffix in SCANS
             or (Path(file).suffix == ".ply" and not _NAMED.fullmatch(file))]
    if scans and len(contents) > 1:
        raise RequestError(422, f"{scans[0]} is a scan and must come alone; views are called "
                           "view_0.png and so on")
    specimen = None
    try:
        about = About.of({key: fields.pop(key) for key in About.model_fields if key in fields}, "")
        if scans:
            stated = {key: _plain(fields[key]) for key in Specimen.model_fields if key in fields}
            specimen = Specimen.of(stated, "")
        else:
            if contents.keys().isdisjoint(CAPTURE_FILES) or "capture.yaml" in contents:
                description = _description(contents.get("capture.yaml", b"{}"), fields)
                contents = _named(contents, from_above="outline" in description)
                contents["capture.yaml"] = yaml.safe_dump(description).encode()
            for file, data in contents.items():
                _require_pixels(file, data, settings)
    except InputError as error:
        raise RequestError(422, str(error)) from None
    title = Path(files[0][0].replace("\\", "/")).stem if len(files) == 1 else "capture"
    return Upload(contents, "".join(scans), about.name or plain_name(title)[:40], about,
                  refine == "yes", specimen, fabric)


def decoded(name: str) -> str:
    """A file's name, which some clients encode as in mail (RFC 2047)."""
    with suppress(ValueError, LookupError, email.errors.MessageError):
        return str(email.header.make_header(email.header.decode_header(name)))
    return name


def _plain(text: str | None) -> Any:
    """The number, also with a decimal comma, or true or false that a field states, or its text."""
    with suppress(ValueError, AttributeError):
        return number(text)
    return {"true": True, "false": False}.get(text, text)


def _description(document: bytes, fields: Mapping[str, str]) -> dict[str, Any]:
    """The content of ``capture.yaml``, in which a form's fields replace values."""
    if len(document) > MAX_TEXT_BYTES:
        raise RequestError(413, f"capture.yaml has {len(document)} bytes; at most "
                           f"{MAX_TEXT_BYTES}")
    try:
        content = dict(parse_yaml(document.decode("utf-8"), "capture.yaml"))
    except UnicodeDecodeError:
        raise RequestError(422, "capture.yaml is not text in UTF-8; save it as such") from None
    for key, text in fields.items():
        *groups, name = PLACES.get(key, (key,))
        place = content
        for group in groups:
            stated = place.get(group)
            place[group] = dict(stated) if isinstance(stated, Mapping) else {}
            place = place[group]
        place[name] = _plain(text) if key != "turns_deg" else [
            _plain(word) for word in re.split(r"[,;\s]+", text.strip("[] "))]
    if Description.of(content, "").tester is None:
        raise RequestError(422, f"tester is missing; {MISSING_TESTER}")
    return content


def _unpacked(files: list[tuple[str, bytes]], settings: ServeConfig) -> dict[str, bytes]:
    """Files by plain name, with zips unpacked."""
    contents: dict[str, bytes] = {}
    for name, data in files:
        if (suffix := _suffix(name)) not in KINDS:
            raise RequestError(415, f"{shown(name)}: files of this kind are not taken; give "
                               f"{', '.join(KINDS)}")
        for inner, content in _members(data, settings) if suffix == ".zip" else [(name, data)]:
            plain = Path(plain_name(Path(inner.replace("\\", "/")).name)).stem + _suffix(inner)
            if plain in contents:
                raise RequestError(422, f"two files are called {plain}; give one capture at a time")
            contents[plain] = content
    if not contents:
        raise RequestError(422, f"the zip holds no files of the kinds {', '.join(PACKED)}")
    if len(contents) > settings.files:
        raise RequestError(413, f"{len(contents)} files; at most {settings.files}")
    return contents


def _suffix(name: str) -> str:
    suffix = Path(name.replace("\\", "/")).suffix.lower()
    return ".yaml" if suffix == ".yml" else suffix


def _members(data: bytes, settings: ServeConfig) -> list[tuple[str, bytes]]:
    """Names and contents of a zip's visible files of the kinds taken."""
    members, left = [], settings.bytes
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = archive.infolist()
            if len(entries) > 4 * settings.files:
                raise RequestError(413, f"the zip has {len(entries)} entries; at most "
                                   f"{settings.files} files")
            for entry in entries:
                hidden = Path(entry.filename.replace("\\", "/")).name.startswith((".", "_"))
                if entry.is_dir() or hidden or _suffix(entry.filename) not in PACKED:
                    continue
                with archive.open(entry) as stream:  # the stated size may be wrong
                    content = stream.read(left + 1)
                left -= len(content)
                if left < 0:
                    raise RequestError(413, "the zip unpacks to more than "
                                       f"{settings.bytes / 1e6:g} MB")
                members.append((entry.filename, content))
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, OSError, EOFError, ValueError,
            zipfile.zlib.error) as error:
        raise RequestError(422, f"the zip cannot be read ({one_line(error)}); pack it again"
                           ) from None
    return members


def _require_pixels(name: str, data: bytes, settings: ServeConfig) -> None:
    """Refuse, before decoding, a picture of too many pixels."""
    suffix, size = Path(name).suffix, ()
    photograph = Path(name).stem == "outline" and suffix not in OUTLINE_TABLES
    most = settings.photograph_pixels if photograph else settings.pixels
    try:
        if suffix == ".npy":
            size, _ = header_of(data)
        elif suffix == ".png" or photograph:
            with Image.open(io.BytesIO(data), formats=["PNG", "JPEG", "TIFF"]) as picture:
                size = picture.size
    except (Image.DecompressionBombError, Image.DecompressionBombWarning):
        size = (math.inf,)
    except Exception as error:  # libraries raise any exception for malformed headers
        raise RequestError(422, f"{name} cannot be read ({one_line(error)}); export it again"
                      ) from None
    if math.prod(size) > most:
        raise RequestError(413, f"{name} has more than {most / 1e6:g} million pixels; save it "
                           "smaller")


def _named(files: dict[str, bytes], *, from_above: bool) -> dict[str, bytes]:
    """Rename images to view_0 and so on, in the order of their names, or what shows or lists an
    outline to outline, unless named so already; ``from_above``: whether a PNG is a photograph."""
    images = [name for name in files if Path(name).suffix in PICTURES and name != BACKGROUND]
    if any(_NAMED.fullmatch(name) or Path(name).stem == "outline" for name in files):
        return files
    if from_above or not images:
        outlines = [name for name in files if Path(name).suffix in OUTLINE_SUFFIXES]
        if len(outlines) > 1:
            raise RequestError(422, f"{outlines[0]} and {outlines[1]}: a capture has one photograph"
                               " or table of an outline; give the other by itself")
        return {f"outline{Path(name).suffix}" if name in outlines else name: data
                for name, data in files.items()}
    images.sort(key=lambda name: [int(part) if part.isdigit() else part
                                  for part in re.split(r"(\d+)", name)])
    renamed = {name: f"view_{k}{Path(name).suffix}" for k, name in enumerate(images)}
    return {renamed.get(name, name): data for name, data in files.items()}
