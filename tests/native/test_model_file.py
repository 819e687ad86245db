"""A damaged resources/model.bin is refused with a message, and never run."""

from __future__ import annotations

import random
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from binding import ERROR, OK, Binary
from running import needs_linker

from fmus.fourbar import FourBar
from mbfmu.fmi import export
from mbfmu.native import layout
from mbfmu.native.checksum import crc64
from mbfmu.session.simulation import Settings

pytestmark = needs_linker

BEYOND = (-2, -(2**63), 2**31, 2**62, 2**63 - 1)  # indices of nothing; -1 means that there is none


@pytest.fixture(scope="module")
def binary(tmp_path_factory: pytest.TempPathFactory) -> Binary:
    folder = tmp_path_factory.mktemp("fmu")
    settings = Settings(solver="adams")
    return Binary(export(FourBar(coupler_modes=2), folder / "model.fmu", settings, native=True, fmi=2), folder)


@pytest.fixture
def file(binary: Binary) -> Iterator[Path]:
    """The model's file, which is whole again afterwards."""
    path = Path(binary.resources.removeprefix("file://")) / "model.bin"
    whole = path.read_bytes()
    binary.logged.clear()
    yield path
    path.write_bytes(whole)
    binary.instantiate().free()


def is_refused(binary: Binary, file: Path, data: bytes) -> bool:
    """Whether no instance can be made of the data, and the log names the file."""
    file.write_bytes(data)
    binary.logged.clear()
    return binary.component() is None and f"file '{file}'" in binary.logged[-1][1]


def test_the_checksum_is_that_of_xz() -> None:
    """Check value of the catalogue of CRCs, and what xz writes of its one block."""
    assert crc64(b"123456789") % 2**64 == 0x995DC9BBDF1939FA
    import lzma

    data = bytes(range(256)) * 5 + b"end"
    packed = lzma.compress(data, check=lzma.CHECK_CRC64)
    size = 4 * (1 + struct.unpack("<I", packed[-8:-4])[0])  # of the index, which the check stands before
    assert packed[-12 - size - 8 : -12 - size] == (crc64(data) % 2**64).to_bytes(8, "little")


def test_every_bit_flip_and_every_cut_is_refused(binary: Binary, file: Path) -> None:
    whole, drawn = file.read_bytes(), random.Random(7)
    for k in range(900):
        flipped = bytearray(whole)
        at = k if k < len(layout.HEADER.names or ()) * 8 else drawn.randrange(len(whole))
        flipped[at] ^= 1 << drawn.randrange(8)
        assert is_refused(binary, file, bytes(flipped)), at
    for length in (0, 7, 100, layout.HEADER.itemsize, len(whole) // 2, len(whole) - 1):
        assert is_refused(binary, file, whole[:length])
    assert is_refused(binary, file, whole + b"\0")
    for _ in range(100):  # several bytes, one after the other
        at, count = drawn.randrange(len(whole) - 64), drawn.randrange(1, 64)
        data = whole[:at] + drawn.randbytes(count) + whole[at + count :]
        assert data == whole or is_refused(binary, file, data)


INDICES = {  # fields of records that are indices, with what decides how many there are
    "variables": ("name", "allowed", "type", "role", "number", "settable"),
    "entries": ("at", "input", "sums", "count"),
    "sums": ("terms", "count"),
    "terms": ("factors", "count"),
    "factors": ("variable",),
    "relocations": ("at", "target"),
    "kernels": ("at", "target"),
    "sentences": ("what", "remedy"),
    "failures": ("before", "between", "after"),
    "rows": ("name",),
    "coordinates": ("name",),
    "cuts": ("name",),
}


def test_every_index_that_is_out_of_bounds_is_refused_though_the_checksum_is_right(binary: Binary, file: Path) -> None:
    whole, token = file.read_bytes(), binary.description.guid
    header = np.frombuffer(whole, layout.HEADER, 1)[0]
    tried = 0
    for section, fields in INDICES.items():
        record = layout.SECTIONS[section]
        assert header[f"{section}_count"], section
        last = int(header[section]) + (int(header[f"{section}_count"]) - 1) * record.itemsize
        for first in {int(header[section]), last}:
            for field in fields:
                at = first + record.fields[field][1]  # type: ignore[index]  # it has names
                for value in BEYOND:
                    data = whole[:at] + struct.pack("<q", value) + whole[at + 8 :]
                    assert is_refused(binary, file, layout.signed(data, token)), (section, field, value)
                    tried += 1
    assert tried > 200
    assert not is_refused(binary, file, layout.signed(whole, token))


def test_every_number_of_the_header_that_is_out_of_bounds_is_refused(binary: Binary, file: Path) -> None:
    whole, token = file.read_bytes(), binary.description.guid
    words = {name: at for name, (kind, at, *_) in layout.HEADER.fields.items() if kind == np.int64}  # type: ignore[union-attr]
    for name in words.keys() - {"magic", "table_sum", "block_sum", "libraries_sum", "block"}:
        for value in BEYOND:
            data = whole[: words[name]] + struct.pack("<q", value) + whole[words[name] + 8 :]
            assert is_refused(binary, file, layout.signed(data, token)), (name, value)


def test_a_file_that_changes_while_the_fmu_runs_is_noticed_where_it_is_read_again(binary: Binary, file: Path) -> None:
    fmu = binary.instantiate()
    assert fmu.set_up() == fmu.call("EnterInitializationMode") == fmu.call("ExitInitializationMode") == OK
    flipped = bytearray(file.read_bytes())
    flipped[-9] ^= 4
    file.write_bytes(bytes(flipped))
    assert fmu.step(0.0, 0.01) == OK  # its own copy is whole
    assert fmu.call("Reset") == fmu.set_up() == fmu.call("EnterInitializationMode") == OK
    assert fmu.call("ExitInitializationMode") == ERROR
    assert "is missing or was changed" in binary.logged[-1][1]
    fmu.free()
