"""Files of a request: plain names, the content of zips, pictures of limited size.

No part of an upload is executed, unpickled or used as a path.
"""

import email.errors
import email.header
import io
import math
import zipfile
from contextlib import suppress
from pathlib import Path

from PIL import Image

from common.errors import one_line, shown
from data.captures.description import OUTLINE_TABLES
from data.captures.frames import header_of
from data.captures.reader import OUTLINE_SUFFIXES
from data.pictures.reading import FORMATS
from drapenet.config import ServeConfig
from drapenet.fabric.entries import plain_name
from drapenet.service.limits import RequestError

PICTURES, SCANS = (".png", ".npy", ".ply"), (".npz", ".obj", ".stl", ".glb")
PHOTOGRAPHS = tuple(kind for kind in OUTLINE_SUFFIXES if kind not in OUTLINE_TABLES)
PACKED = tuple(dict.fromkeys((*PICTURES, *OUTLINE_SUFFIXES, *SCANS, ".yaml")))
KINDS = (*PACKED, ".zip")


def decoded(name: str) -> str:
    """A file's name, which some clients encode as in mail (RFC 2047)."""
    with suppress(ValueError, LookupError, email.errors.MessageError):
        return str(email.header.make_header(email.header.decode_header(name)))
    return name


def plain_file(name: str) -> str:
    """A file's name without folders and special characters."""
    return Path(plain_name(Path(name.replace("\\", "/")).name)).stem + _suffix(name)


def unpacked(files: list[tuple[str, bytes]], settings: ServeConfig) -> dict[str, bytes]:
    """Files by plain name, with zips unpacked."""
    contents: dict[str, bytes] = {}
    for name, data in files:
        if (suffix := _suffix(name)) not in KINDS:
            raise RequestError(415, f"{shown(name)}: files of this kind are not taken; give "
                               f"{', '.join(KINDS)}")
        for inner, content in _members(data, settings) if suffix == ".zip" else [(name, data)]:
            if Path(inner.replace("\\", "/")).name.startswith("."):
                continue  # of the system, such as ._outline.jpg of macOS
            plain = plain_file(inner)
            if plain in contents:
                raise RequestError(422, f"two files are called {plain}; give one capture, or the "
                                   "strips of one fabric, at a time")
            contents[plain] = content
    if not contents:
        raise RequestError(422, f"there are no files of the kinds {', '.join(PACKED)}; those that "
                           "begin with a dot are left out")
    if len(contents) > settings.files:
        raise RequestError(413, f"{len(contents)} files; at most {settings.files}")
    return contents


def _suffix(name: str) -> str:
    suffix = Path(name.replace("\\", "/")).suffix.lower()
    return ".yaml" if suffix == ".yml" else suffix


def _members(data: bytes, settings: ServeConfig) -> list[tuple[str, bytes]]:
    """Names and contents of a zip's files of the kinds taken."""
    members, left = [], settings.bytes
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = archive.infolist()
            if len(entries) > 4 * settings.files:
                raise RequestError(413, f"the zip has {len(entries)} entries; at most "
                                   f"{settings.files} files")
            for entry in entries:
                if entry.is_dir() or _suffix(entry.filename) not in PACKED:
                    continue
                with archive.open(entry) as stream:  # the stated size may be wrong
                    content = stream.read(left + 1)
                left -= len(content)
                if left < 0:
                    raise RequestError(413, "the zip unpacks to more than "
                                       f"{settings.bytes / 1e6:g} MB")
                members.append((entry.filename, content))
    except RequestError:
        raise
    except Exception as error:  # of zipfile, zlib, lzma and others, as of any damaged file
        raise RequestError(422, f"the zip cannot be read ({one_line(error)}); pack it again"
                           ) from None
    return members


def require_pixels(name: str, data: bytes, settings: ServeConfig, *, photograph: bool) -> None:
    """Refuse, before decoding, a picture of too many pixels; a ``photograph`` may have more."""
    suffix, size = Path(name).suffix, ()
    most = settings.photograph_pixels if photograph else settings.pixels
    try:
        if suffix == ".npy":
            size, _ = header_of(data)
        elif suffix == ".png" or (photograph and suffix in PHOTOGRAPHS):
            with Image.open(io.BytesIO(data), formats=FORMATS) as picture:
                size = picture.size
    except (Image.DecompressionBombError, Image.DecompressionBombWarning):
        size = (math.inf,)
    except Exception as error:  # libraries raise any exception for malformed headers
        raise RequestError(422, f"{name} cannot be read ({one_line(error)}); export it again"
                           ) from None
    if math.prod(size) > most:
        raise RequestError(413, f"{name} has more than {most / 1e6:g} million pixels; save it "
                           "smaller")
