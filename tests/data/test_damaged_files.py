"""The smallest of the damaged files that readers once failed at otherwise than by one line."""

import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from common.errors import InputError
from data.captures.frames import read_array, read_picture


def test_a_picture_without_pixels_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "view_0.png"
    Image.fromarray(np.full((60, 80), 500, np.uint16)).save(file)
    data = file.read_bytes()
    at = data.index(b"IDAT") - 4
    length = int.from_bytes(data[at : at + 4], "big")
    file.write_bytes(data[:at] + data[at + length + 12 :])
    with pytest.raises(InputError, match="export the view again"):
        read_picture(file, modes={"I;16"}, kind="16-bit grey")


def test_an_exploding_picture_takes_no_more_than_its_pixels(tmp_path: Path) -> None:
    file = tmp_path / "view_0.png"
    Image.fromarray(np.full((60, 80), 500, np.uint16)).save(file)
    data = file.read_bytes()
    at = data.index(b"IDAT") - 4
    bomb = b"IDAT" + zlib.compress(bytes(1 << 24), 9)
    file.write_bytes(data[:at] + (len(bomb) - 4).to_bytes(4, "big") + bomb
                     + zlib.crc32(bomb).to_bytes(4, "big") + data[-12:])
    assert not read_picture(file, modes={"I;16"}, kind="16-bit grey").any()


@pytest.mark.parametrize("header", [b"{'descr': '<f8', 'fortran_order': False, 'shape': (60, 80",
                                    b"{'descr': '|O', 'fortran_order': False, 'shape': (60, 80), }",
                                    b"((((((((", b"\xff"])
def test_a_torn_header_of_an_array_is_refused(tmp_path: Path, header: bytes) -> None:
    file = tmp_path / "view_0.npy"
    file.write_bytes(b"\x93NUMPY\x01\x00" + (len(header) + 1).to_bytes(2, "little") + header
                     + b"\n" + bytes(60 * 80 * 8))
    with pytest.raises(InputError, match=r"view_0\.npy"):
        read_array(file)
