"""The C of native FMUs under sanitizers and valgrind."""

from __future__ import annotations

import random
import shutil
import struct
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest
from fmpy import read_model_description
from test_model_file import BEYOND, INDICES

from fmus.fourbar import FourBar
from mbfmu.fmi import export
from mbfmu.native import layout
from mbfmu.native.contents import complete
from mbfmu.native.runtime import COMPILERS, compiler, compiler_arguments
from mbfmu.native.sundials_files import libraries
from mbfmu.native.targets import host
from mbfmu.session.simulation import Settings

CALLS = 8_000
NO_INSTANCE = 3  # how fuzz.c ends where there is none
SANITIZED = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")

pytestmark = pytest.mark.skipif(
    not host() or not any(map(shutil.which, COMPILERS)), reason="needs a C compiler, and a machine that is known"
)


def unpacked(solver: str, folder: Path) -> list[str]:
    """Solver, resources, token and number of variables of the four-bar's FMU."""
    path = export(FourBar(), folder / "model.fmu", Settings(solver=solver), native=True)
    zipfile.ZipFile(path).extractall(folder)
    described = read_model_description(str(path))
    return [solver, str(folder / "resources"), described.guid, str(len(described.modelVariables))]


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The FMU with Adams."""
    return unpacked("adams", tmp_path_factory.mktemp("fmu"))


@pytest.fixture(scope="module", params=[pytest.param("adams", marks=pytest.mark.campaign), "ida"])
def each_told(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The FMUs with Adams and with IDA."""
    return unpacked(request.param, tmp_path_factory.mktemp("fmu"))


def build(folder: Path, family: str, *flags: str) -> Path:
    """The host that does anything, with the runtime in it."""
    program, source = folder / "fuzz", Path(__file__).with_name("fuzz.c")
    made = [
        *compiler(host()),
        *compiler_arguments(host(), complete(family), folder),
        *flags,
        str(source),
        "-o",
        str(program),
        "-lm",
    ]
    done = subprocess.run(made, capture_output=True, text=True, check=False)
    if done.returncode and flags:
        pytest.skip(f"the compiler has no sanitizers: {done.stderr.splitlines()[-1]}")
    assert done.returncode == 0, done.stderr
    for name, data in libraries(host()).items():  # which it looks for in its own folder
        (folder / name).write_bytes(data)
    return program


@pytest.mark.campaign
def test_any_calls_leave_memory_and_numbers_whole(each_told: list[str], tmp_path: Path):
    family, resources, token, count = each_told
    program = build(tmp_path, family, *SANITIZED)
    steps = 0
    for seed in range(1, 5):
        call = [str(program), resources, token, str(seed), str(CALLS), count]
        done = subprocess.run(call, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        steps += int(done.stdout)
    assert steps > CALLS / 20  # it gets somewhere


def test_a_damaged_file_is_refused_before_anything_beyond_it_is_read(told: list[str], tmp_path: Path):
    """Bits that flip, and indices of nothing under the right checksum, of every section and of the header."""
    family, resources, token, count = told
    program = build(tmp_path, family, *SANITIZED)
    whole, drawn, damaged = (Path(resources) / "model.bin").read_bytes(), random.Random(3), tmp_path / "resources"
    damaged.mkdir()
    header = np.frombuffer(whole, layout.HEADER, 1)[0]
    places = [int(at) for kind, at, *_ in layout.HEADER.fields.values() if kind == np.int64]  # type: ignore[union-attr]
    places = places[3:]  # without the magic and the checksums
    in_header = len(places)
    for section, fields in INDICES.items():
        record = layout.SECTIONS[section]
        for k in range(int(header[f"{section}_count"])):
            places += [int(header[section]) + k * record.itemsize + record.fields[f][1] for f in fields]  # type: ignore[index]
    for k in range(120):
        data = bytearray(whole)
        if k % 2:
            data[drawn.randrange(len(data))] ^= 1 << drawn.randrange(8)
        else:
            struct.pack_into("<q", data, drawn.choice(places[:in_header] if k % 4 else places), drawn.choice(BEYOND))
        signed = bytes(data) if k % 2 else layout.signed(bytes(data), token)
        (damaged / "model.bin").write_bytes(signed)
        call = [str(program), str(damaged), token, "1", "10", count]
        done = subprocess.run(call, capture_output=True, text=True, check=False)
        assert done.returncode == NO_INSTANCE, done.stderr


@pytest.mark.campaign
@pytest.mark.skipif(shutil.which("valgrind") is None, reason="needs valgrind")
def test_valgrind_finds_nothing(each_told: list[str], tmp_path: Path):
    family, resources, token, count = each_told
    program = build(tmp_path, family)
    watched = ["valgrind", "-q", "--error-exitcode=9", "--leak-check=full", "--exit-on-first-error=yes"]
    call = [*watched, str(program), resources, token, "7", "500", count]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
