"""Checks uploads and makes of them a capture folder, a scan, or a folder of strips or values."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path

from common.documents import misnamed, rename_remedy, yaml_text
from common.errors import InputError, shown
from common.files import by_number
from data.captures.description import NEED_WARP, UNLABELLED, Description, Labels
from data.captures.frames import BACKGROUND
from data.captures.reader import CAPTURE_FILES, MAX_PICTURES, OUTLINE_SUFFIXES
from drapenet.config import ServeConfig
from drapenet.fabric.entries import plain_name
from drapenet.measured import KINDS
from drapenet.measured.base import kind_at
from drapenet.service.forms import (
    CAPTURE,
    About,
    described,
    described_capture,
    described_scan,
    fields_of_outline,
    kinds_stated,
    states_plate,
    states_values,
)
from drapenet.service.limits import RequestError
from drapenet.service.received import (
    PHOTOGRAPHS,
    PICTURES,
    SCANS,
    decoded,
    plain_file,
    require_pixels,
    unpacked,
)

_NAMED = re.compile(r"view_\d+(_\d+)?\.(png|npy|ply)")
_PLATE, _MAT = (re.compile(rf"(?<![a-z])({words})(?![a-z])", re.IGNORECASE)
                for words in ("plate|empty", "mat"))
"""In names of pictures from above: of the plate without cloth, and of the mat."""
_BESIDE = re.compile(r"plate|mat_.*")  # stems of pictures beside a photograph
_OUTLINE = re.compile(r"outline(_\d)?")  # stems of pictures of a drape
MARKED, UNMARKED, YARNS = "marked", "unmarked", "yarns"
_NO_FILES = ("no files; give the views of a drape, its photograph or outline from above, a zip "
             "with them, a scan, strips.yaml, tension.yaml, or values")


@dataclass(frozen=True)
class Upload:
    """A request to estimate a capture or strips, with their description, or a scan.

    Attributes:
        labels: which name it.
        kind: capture, strips, tension, or values, and so on; names what has no label.
        scan: name of the file that is a scan; empty for others.
        specimen: what is stated of a scan.
        directions: :data:`MARKED` or :data:`UNMARKED` for a capture by its warp, :data:`YARNS` for
            strips or values along the yarns; empty for others.
        density_g_m2: as it is stated; None if that is in density.txt, which workers read.
        name: of a new fabric, if ``fabric``, the identity of an earlier one, is empty.
        about: its notes, and the label of the capture, which may be empty.
    """

    files: dict[str, bytes]
    scan: str = ""
    name: str = ""
    about: About = field(default_factory=About)
    specimen: Description | None = None
    fabric: str = ""
    kind: str = "capture"
    directions: str = ""
    density_g_m2: float | None = None
    labels: Labels = UNLABELLED


def checked_upload(
    files: list[tuple[str, bytes]], texts: Mapping[str, str], settings: ServeConfig
) -> Upload:
    """Check a form's files, names and bytes, and texts."""
    fields = {key: text.strip() for key, text in texts.items() if text.strip()}
    fabric = fields.pop("fabric", "")
    if not (files or states_values(fields) or kinds_stated(fields)):
        raise RequestError(422, _NO_FILES)
    files = [(decoded(name), data) for name, data in files]
    received = unpacked(files, settings) if files else {}
    try:
        about = About.of({key: fields.pop(key) for key in About.model_fields if key in fields}, "")
        content = _content(received, fields, settings)
    except InputError as error:
        raise RequestError(422, str(error)) from None
    title = Path(files[0][0].replace("\\", "/")).stem if len(files) == 1 else content.kind
    name = about.name or content.labels.fabric or plain_name(title)[:40]
    return replace(content, name=name, about=about, fabric=fabric)


def checked_photograph(
    files: list[tuple[str, bytes]], texts: Mapping[str, str], settings: ServeConfig
) -> dict[str, bytes] | None:
    """Check the files of a form and the fields that state how its photograph from above is read,
    which need not be complete for an estimate; None if there is no photograph from above."""
    fields = {key: text.strip() for key, text in texts.items() if text.strip()}
    received = unpacked([(decoded(name), data) for name, data in files], settings) if files else {}
    others = KINDS.keys() - {CAPTURE}
    if not received.keys().isdisjoint(others) or _scans(received):
        return None
    try:
        content = _capture(received, fields_of_outline(fields), settings)
    except InputError as error:
        raise RequestError(422, str(error)) from None
    photographs = [name for name in content.files if _OUTLINE.fullmatch(Path(name).stem)
                   and Path(name).suffix in PHOTOGRAPHS]
    return content.files if photographs else None


def _content(
    received: dict[str, bytes], fields: Mapping[str, str], settings: ServeConfig
) -> Upload:
    """What was sent: the description of a kind, or nothing but values, a scan, or else a capture.
    """
    for name in KINDS:
        if name not in received and (other := misnamed(received, name)):
            raise RequestError(422, f"{other}: {rename_remedy(name)}")
    stated = kinds_stated(fields, alone=not received)
    found: dict[str, str] = {}  # file by kind
    for file, kind in KINDS.items():
        if file in received or file in stated:
            found.setdefault(kind, file)
    if len(found) > 1:
        first, second, *_ = found.values()
        kind = kind_at(KINDS[second])
        raise RequestError(422, f"{first} and {kind.apart.format(noun=kind.noun)}")
    if others := [file for kind, file in found.items() if kind != KINDS[CAPTURE]]:
        return _described(others[0], received, fields, settings)
    scans = _scans(received)
    if scans and len(received) > 1:
        raise RequestError(422, f"{scans[0]} is a scan and must come alone; views are called "
                           "view_0.png and so on")
    if scans:
        specimen = described_scan(fields)
        return Upload(received, scans[0], specimen=specimen, directions=_directions(specimen),
                      density_g_m2=specimen.density_g_m2, labels=specimen.labels)
    return _capture(received, fields, settings)


def _scans(received: dict[str, bytes]) -> list[str]:
    """Names of the files that are scans."""
    return [file for file in received if Path(file).suffix in SCANS
            or (Path(file).suffix == ".ply" and not _NAMED.fullmatch(file))]


def _capture(
    received: dict[str, bytes], fields: Mapping[str, str], settings: ServeConfig
) -> Upload:
    """A capture, whose pictures are called as in a capture folder."""
    labels, directions, density = UNLABELLED, UNMARKED, None
    if received.keys().isdisjoint(CAPTURE_FILES) or CAPTURE in received:
        document, description = described_capture(received.get(CAPTURE, b"{}"), fields)
        source = description.outline
        received = _named(received, from_above=source is not None,
                          several=source is not None and source.mat is not None)
        if states_plate(fields):  # a field replaces what files state
            received = {name: data for name, data in received.items()
                        if Path(name).stem != "plate"}
        received[CAPTURE], labels = document, description.labels
        directions, density = _directions(description), description.density_g_m2
    elif fields:
        raise RequestError(422, f"{next(iter(fields))} cannot be stated beside density.txt; give "
                           f"{CAPTURE} in its place")
    for file, data in received.items():
        stem = Path(file).stem
        require_pixels(file, data, settings,
                       photograph=bool(_OUTLINE.fullmatch(stem) or _BESIDE.fullmatch(stem)))
    return Upload(received, directions=directions, density_g_m2=density, labels=labels)


def _directions(description: Description) -> str:
    """Whether the warp of a capture is marked, as its known values may need."""
    if description.known and description.known.along_yarns and not description.marked:
        raise RequestError(422, f"known values along the yarns {NEED_WARP}")
    return MARKED if description.marked else UNMARKED


def _described(
    file: str, received: dict[str, bytes], fields: Mapping[str, str], settings: ServeConfig
) -> Upload:
    """What has a description ``file``, with the photographs that it or the form names, or values
    alone."""
    kind = kind_at(KINDS[file])
    content, description = described(received.get(file, b"{}"), file, fields)
    pictures = _pictures_named(content.get(description.entries) or [], description.pictures, file,
                               received, settings)
    if file not in received and (others := received.keys() - pictures.keys()):
        raise RequestError(422, f"{min(others)} and {kind.noun} of the form: give one after the "
                           "other")
    return Upload(pictures | {file: yaml_text(content).encode()}, labels=description.labels,
                  kind=kind.name,
                  directions=YARNS * description.needs_warp,
                  density_g_m2=description.density_g_m2)


def _pictures_named(
    entries: Sequence[dict[str, str]], keys: Sequence[str], file: str, received: dict[str, bytes],
    settings: ServeConfig
) -> dict[str, bytes]:
    """The photographs that the ``keys`` of entries of a description name, which get plain names."""
    pictures = {}
    for entry, key in product(entries, keys):
        if not entry.get(key):
            continue
        name = plain_file(entry[key])
        if name not in received or Path(name).suffix not in PHOTOGRAPHS:
            raise RequestError(422, f"{file} names {shown(entry[key])}, which is not among the "
                               f"photographs sent ({', '.join(PHOTOGRAPHS)}); add it")
        require_pixels(name, received[name], settings, photograph=True)
        pictures[name], entry[key] = received[name], name
    return pictures


def _named(
    files: dict[str, bytes], *, from_above: bool, several: bool
) -> dict[str, bytes]:
    """Rename images to view_0 and so on, in the order of their names, or what shows or lists an
    outline to outline, and pictures beside it to plate or mat_1 and so on, unless named so already;
    ``from_above``: whether a PNG is a photograph, ``several``: whether the drape may be in several.
    """
    images = [name for name in files if Path(name).suffix in PICTURES and name != BACKGROUND]
    stems = {Path(name).stem for name in files}
    if any(map(_NAMED.fullmatch, files)):
        return files
    if from_above or not images or any(
            _OUTLINE.fullmatch(stem) or _PLATE.search(stem) for stem in stems):
        return _from_above(files, several=several)
    renamed = {name: f"view_{k}{Path(name).suffix}"
               for k, name in enumerate(sorted(images, key=by_number))}
    return {renamed.get(name, name): data for name, data in files.items()}


def _from_above(files: dict[str, bytes], *, several: bool) -> dict[str, bytes]:
    """Files of a drape seen from above, called outline, or outline_1 and so on where there may be
    ``several``, plate, and mat_1 and so on."""
    taken = [name for name in files if Path(name).suffix in OUTLINE_SUFFIXES]
    outlines = [name for name in taken if _OUTLINE.fullmatch(Path(name).stem)] or taken
    beside = [name for name in taken if Path(name).suffix in PHOTOGRAPHS
              and len(taken) > 1 and not _OUTLINE.fullmatch(Path(name).stem)]
    plates = [name for name in beside if _PLATE.search(Path(name).stem)]
    mats = [name for name in sorted(beside, key=by_number)
            if name not in plates and _MAT.search(Path(name).stem)]
    outlines = [name for name in outlines if name not in (*plates, *mats)]
    if len(plates) > 1:
        raise RequestError(422, f"{plates[0]} and {plates[1]}: give one picture of the plate "
                           "without cloth")
    if len(outlines) > (MAX_PICTURES if several else 1):
        raise RequestError(422, f"{outlines[0]} and {outlines[1]}: which of them shows the drape? "
                           "A capture has one photograph or table of an outline, or with the mat "
                           f"up to {MAX_PICTURES} photographs; call that outline"
                           f"{Path(outlines[0]).suffix}, the plate without cloth plate.jpg, and "
                           "further pictures of the mat mat_1.jpg, mat_2.jpg")
    if beside and not outlines:
        raise RequestError(422, f"{', '.join(taken)}: no photograph of the drape is among them; "
                           f"call it outline{Path(taken[0]).suffix}")
    stems = dict.fromkeys(outlines, "outline") | dict.fromkeys(plates, "plate") | {
        name: f"mat_{k}" for k, name in enumerate(mats, 1)}
    if len(outlines) > 1:
        stems |= {name: f"outline_{k}"
                  for k, name in enumerate(sorted(outlines, key=by_number), 1)}
    return {f"{stems[name]}{Path(name).suffix}" if name in stems else name: data
            for name, data in files.items()}
