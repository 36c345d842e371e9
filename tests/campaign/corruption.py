"""Damage to files that knows their structure: a function of the file's bytes and a generator."""

import io
import json
import random
import re
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np

NUMBERS = (0, -1, 1, 2**31 - 1, 2**31, 2**63, 10**30, 10**400, 1e-300, 1e308, -1e308, 0.5, -0.0)
VALUES = (*NUMBERS, None, True, False, "", "x" * 3000, "a\nb", "\0", "\udcff", "nan", "1e3", [], {},
          [[]], [None], {"": 0}, [1] * 50, float("nan"), float("inf"))
WORDS = ("nan", "inf", "-1", "0", "1e400", "9" * 400, "0x10", "", "-", "\u00b5", "\0", '"', "[",
         "{", "*a", "&a", "<<: ", "!!python/object:os.system", "!!binary", "? ", "- ", "#", "\t",
         ",", "=")


def damaged_bytes(data: bytes, rng: random.Random) -> bytes:
    """Bits, spans, ends."""
    found = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8))):
        at = rng.randrange(len(found) + 1)
        span = min(rng.choice((1, 2, 4, 16, 256)), len(found) - at)
        way = rng.randrange(7)
        if way == 0 and at < len(found):
            found[at] ^= 1 << rng.randrange(8)
        elif way == 1:
            found[at : at + span] = rng.choice((b"\0", b"\xff", b"\x7f", b"0")) * span
        elif way == 2:
            del found[at : at + span]
        elif way == 3:
            found[at:at] = rng.randbytes(span)
        elif way == 4:
            found[at:at] = found[at : at + span]
        elif way == 5:
            number = rng.choice((0, 1, 2**31 - 1, 2**32 - 1, 2**63 - 1, 2**64 - 1))
            found[at : at + 8] = struct.pack(rng.choice("<>") + "Q", number)[: max(span, 1)]
        else:
            del found[at:]
    return bytes(found)


def damaged_text(data: bytes, rng: random.Random) -> bytes:
    """Lines, words and numbers of a text."""
    text = data.decode("utf-8", "replace")
    for _ in range(rng.choice((1, 1, 2, 4))):
        lines = text.split("\n")
        at = rng.randrange(len(lines))
        way = rng.randrange(6)
        if way == 0:
            del lines[at]
        elif way == 1:
            lines.insert(rng.randrange(len(lines) + 1), lines[at])
        elif way == 2:
            other = rng.randrange(len(lines))
            lines[at], lines[other] = lines[other], lines[at]
        elif way == 3 and (found := list(re.finditer(r"[-+.\w]+", lines[at]))):
            word = rng.choice(found)
            lines[at] = lines[at][: word.start()] + rng.choice(WORDS) + lines[at][word.end() :]
        elif way == 4:
            place = rng.randrange(len(lines[at]) + 1)
            lines[at] = lines[at][:place] + rng.choice(WORDS) + lines[at][place:]
        else:
            lines[at] *= rng.choice((2, 300))
        text = "\n".join(lines)
    return text.encode("utf-8", "surrogatepass") if rng.random() < 0.8 else damaged_bytes(
        text.encode("utf-8", "surrogatepass") or b" ", rng)


def damaged_value(value: Any, rng: random.Random) -> Any:
    """One place of a tree of mappings and lists, another value in it, or none."""
    if isinstance(value, dict | list) and value and rng.random() < 0.85:
        keys = list(value) if isinstance(value, dict) else range(len(value))
        key = rng.choice(keys)
        copy = dict(value) if isinstance(value, dict) else list(value)
        way = rng.random()
        if way < 0.1:
            del copy[key]
        elif way < 0.15 and isinstance(copy, dict):
            copy[rng.choice(("", "x", "__class__", "a\nb"))] = copy.pop(key)
        elif way < 0.2 and isinstance(copy, list):
            copy *= rng.choice((2, 40))
        else:
            copy[key] = damaged_value(value[key], rng)
        return copy
    if isinstance(value, int | float) and not isinstance(value, bool) and rng.random() < 0.5:
        return float(max(-1e99, min(value, 1e99))) * rng.choice((-1, 10, 1000, 1e-3, 1e9, 1e-9))
    return rng.choice(VALUES)


def damaged_json(data: bytes, rng: random.Random) -> bytes:
    """Values, then sometimes the text."""
    content = json.loads(data)
    for _ in range(rng.choice((1, 1, 2, 3))):
        content = damaged_value(content, rng)
    text = json.dumps(content).encode("utf-8", "surrogatepass")
    return text if rng.random() < 0.8 else damaged_text(text, rng)


def damaged_png(data: bytes, rng: random.Random) -> bytes:
    """Chunks of a PNG, with right checksums."""
    if rng.random() < 0.25:
        return damaged_bytes(data, rng)
    chunks, at = [], 8
    while at < len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + size]))
        at += 12 + size
    for _ in range(rng.choice((1, 1, 2))):
        k = rng.randrange(len(chunks))
        kind, content = chunks[k]
        way = rng.randrange(7)
        if way == 0:
            chunks[k] = kind, damaged_bytes(content, rng)
        elif way == 1:
            chunks.insert(rng.randrange(len(chunks) + 1), chunks[k])
        elif way == 2:
            del chunks[k]
            chunks = chunks or [(b"IEND", b"")]
        elif way == 3:
            width, height = (rng.choice((0, 1, 60, 80, 4096, 5000, 2**31 - 1)) for _ in range(2))
            chunks[0] = b"IHDR", struct.pack(">II", width, height) + chunks[0][1][8:]
        elif way == 4:
            chunks[0] = b"IHDR", chunks[0][1][:8] + bytes((
                *rng.choice(((8, 0), (16, 2), (8, 3), (1, 0), (16, 6), (16, 7))), 0, 0,
                rng.randrange(3)))
        elif way == 5:
            chunks.insert(1, (rng.choice((b"zTXt", b"iCCP", b"tEXt", b"tRNS", b"acTL", b"eXIf")),
                              b"a\0\0" + zlib.compress(bytes(1 << 20))))
        else:
            pixels = damaged_bytes(zlib.decompress(b"".join(
                part for name, part in chunks if name == b"IDAT") or zlib.compress(b"")) or b"a",
                rng) if rng.random() < 0.5 else bytes(1 << 22)
            chunks = [chunk for chunk in chunks if chunk[0] != b"IDAT"]
            chunks.insert(1, (b"IDAT", zlib.compress(pixels, 1)))
            break
    return data[:8] + b"".join(
        struct.pack(">I", len(part)) + name + part + struct.pack(">I", zlib.crc32(name + part))
        for name, part in chunks)


def damaged_npy(data: bytes, rng: random.Random) -> bytes:
    """Header or values of a NumPy file."""
    way = rng.random()
    if way < 0.3:
        return damaged_bytes(data, rng)
    array = np.load(io.BytesIO(data))
    if way < 0.7:
        shape = rng.choice(((10**12,), array.shape[::-1], (*array.shape, 1), (0, 0), (2**31, 2**31),
                            (-1, 3), ()))
        kind = rng.choice((array.dtype.str, "|O", "<f2", ">f8", "<c16", "<M8[s]", "|V9", "<i8",
                           "[('a', '<f8')]"))
        header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".encode()
        return (b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header) + 1) + header + b"\n"
                + array.tobytes())
    values = array.astype(np.float64) if rng.random() < 0.3 else array.copy()
    flat = values.reshape(-1)
    for _ in range(rng.choice((1, 5, 50))):
        if flat.size:
            flat[rng.randrange(flat.size)] = rng.choice(
                (0, 1, -1, 10**9) if flat.dtype.kind == "i" else (0, -1, 1e30, np.nan, np.inf))
    stream = io.BytesIO()
    np.save(stream, values if rng.random() < 0.7 else values[: len(values) // 2])
    return stream.getvalue()


def damaged_zip(data: bytes, rng: random.Random, member: Callable = damaged_npy) -> bytes:
    """A member of an archive, or its directory."""
    if rng.random() < 0.3:
        return damaged_bytes(data, rng)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        files = [(name, archive.read(name)) for name in archive.namelist()]
    k = rng.randrange(len(files))
    way = rng.random()
    if way < 0.1:
        del files[k]
    elif way < 0.2:
        files[k] = rng.choice(("", "../x.npy", "a" * 300, "/etc/x.npy")), files[k][1]
    elif way < 0.3:
        files.append(files[k])
    elif way < 0.35:
        files[k] = files[k][0], files[k][1][:128] + bytes(80 << 20)
    else:
        files[k] = files[k][0], member(files[k][1], rng)
    stream = io.BytesIO()
    kind = rng.choice((zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED))
    with warnings.catch_warnings(), zipfile.ZipFile(stream, "w", kind) as archive:
        warnings.simplefilter("ignore", UserWarning)  # a name twice is meant
        for name, content in files:
            archive.writestr(name or "x", content)
    return stream.getvalue()


def damaged_safetensors(data: bytes, rng: random.Random) -> bytes:
    """The header of a safetensors file, its metadata, or its numbers."""
    if rng.random() < 0.3:
        return damaged_bytes(data, rng)
    size = int.from_bytes(data[:8], "little")
    header, numbers = json.loads(data[8 : 8 + size]), data[8 + size :]
    about = header.get("__metadata__", {})
    if about and rng.random() < 0.6:
        name = rng.choice(list(about))
        about[name] = damaged_json(about[name].encode(), rng).decode("utf-8", "replace")
    else:
        header = damaged_value(header, rng)
    text = json.dumps(header).encode("utf-8", "surrogatepass")
    return struct.pack("<Q", len(text)) + text + numbers
