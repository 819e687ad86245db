"""Machine code without Python does what a simulation does, bit for bit."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any
from zipfile import ZipFile, ZipInfo

import numpy as np
import pytest
from flexible_models import SwungBracket
from running import Running, needs_linker, stepping

from fmus.feeder import Feeder
from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from mbfmu.fmi.native_fmu import _with_solver
from mbfmu.native import runtime
from mbfmu.native.contents import Contents, complete
from mbfmu.native.entries import image_of
from mbfmu.native.families import FAMILIES
from mbfmu.native.image import MemoryImage
from mbfmu.native.runtime import objects
from mbfmu.native.targets import TARGETS, host
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.util.errors import UserError
from mbfmu.util.progress import when_progressing

TIMES = 0.01 * np.arange(1, 201)
LIBM = {
    "acos",
    "asin",
    "atan",
    "atan2",
    "ceil",
    "cos",
    "exp",
    "floor",
    "hypot",
    "log",
    "pow",
    "sin",
    "sincos",
    "sqrt",
    "tan",
    "tanh",
}
LIBM |= {"asinh", "cosh", "sinh"}  # parts of functions of complex numbers
MEMORY = {"memcpy", "memmove", "memset"}
COMPLEX_POWER = {"numba_cpow"}  # complex_power.c has it

MODELS = {
    "four-bar": (FourBar(), "adams"),
    "four-bar, hybrid": (FourBar(), "hybrid"),
    "four-bar, LU": (FourBar(start_angle=1.0), "adams-lu"),
    "four-bar, radau": (FourBar(), "radau"),
    "elastic coupler": (FourBar(coupler_modes=2), "adams"),
    "body of finite elements": (SwungBracket(), "adams"),
    "governor": (Governor(), "adams"),
    "pendulum": (SwingPendulum(), "adams"),
    "pendulum, radau": (SwingPendulum(), "radau"),
}


@needs_linker
@pytest.mark.parametrize("name", MODELS)
def test_outputs_are_those_of_a_simulation(name: str):
    model, solver = MODELS[name]
    simulation = Simulation(model, Settings(solver=solver))
    native = Running(simulation)
    assert native.call("begin", 0.0) == 0
    for t in TIMES:
        assert native.call("advance", t) == int(simulation.stepper.advance(t).code)
        assert native.call("read") == 0
        np.testing.assert_array_equal(native.out, simulation.outputs())
        if not simulation.stepper.status.ok:
            break


@needs_linker
def test_a_state_goes_to_another_instance():
    first, second = (Running(Simulation(FourBar(), Settings(solver="adams"))) for _ in range(2))
    assert first.call("begin", 0.0) == 0
    for t in TIMES[:50]:
        assert first.call("advance", t) == 0
    second.block[: second.image.saved] = first.block[: first.image.saved]
    for t in TIMES[50:100]:
        assert first.call("advance", t) == second.call("advance", t) == 0
        assert first.call("read") == second.call("read") == 0
        np.testing.assert_array_equal(first.out, second.out)


def test_equal_models_make_equal_images():
    blocks = [image_of(Simulation(FourBar(), Settings(solver="adams")))[1].block() for _ in range(2)]
    assert blocks[0] == blocks[1]


def test_no_address_is_left_in_an_image():
    simulation = Simulation(FourBar(), Settings(solver="adams"))
    image = image_of(simulation)[1]
    words = set(np.frombuffer(image.block(), np.uint64).tolist())
    arrays = [*simulation.stepper.arrays(), *simulation.compiled.data.arrays]
    assert not words & {array.ctypes.data for array in arrays if array.nbytes}
    assert not words & {int(address) for address in simulation.compiled.data.arrays.kernels if address}
    relocated = [at for at, _ in (*image.relocations, *image.kernels)]
    assert not [at for at in relocated if at % 8 or at < image.saved]  # what is saved has none, and may go anywhere


@needs_linker
@pytest.mark.parametrize("solver", ["adams", "hybrid", "radau"])
def test_another_start_is_begun_as_a_simulation_begins(solver: str):
    simulation = Simulation(FourBar(start_angle=0.7, start_rate=2.0), Settings(solver=solver))
    native = Running(Simulation(FourBar(), Settings(solver=solver)))
    start = simulation.compiled.assemble()
    for array, given in zip((native.instance.given.q, native.instance.given.v), start, strict=True):
        native.view(array)[:] = given
    assert native.call("begin", 0.0) == 0
    for t in TIMES[:50]:
        assert native.call("advance", t) == 0
        assert simulation.advance(t).ok
        assert native.call("read") == 0
        np.testing.assert_array_equal(native.out, simulation.outputs())


@needs_linker
@pytest.mark.parametrize(
    "contents",
    [
        *map(stepping, FAMILIES),
        complete("adams"),
        *(pytest.param(complete(family), marks=pytest.mark.campaign) for family in FAMILIES if family != "adams"),
    ],
    ids=lambda contents: contents.name,
)
def test_the_kernels_need_no_more_than_the_c_library(contents: Contents):
    found: dict[str, set[str]] = {}
    for kind in ("--undefined-only", "--defined-only"):
        files = map(str, objects([host()], [contents])[host()])
        told = subprocess.run(("nm", kind, "--extern-only", *files), capture_output=True, text=True, check=True)
        found[kind] = {line.split()[-1] for line in told.stdout.splitlines() if line and not line.endswith(":")}
    assert found["--undefined-only"] - found["--defined-only"] <= LIBM | MEMORY | COMPLEX_POWER


@needs_linker
@pytest.mark.campaign
def test_two_builds_of_the_kernels_give_equal_bytes(tmp_path: Path):
    contents = complete("radau")
    _build_apart(tmp_path, tmp_path / "cache", *contents.objects())
    for path in objects([host()], [contents])[host()]:
        assert (tmp_path / path.name).read_bytes() == path.read_bytes()


@needs_linker
@pytest.mark.campaign
def test_kernels_of_the_cache_are_not_compiled_again(tmp_path: Path):
    """Only entry points are, which are not stored; the code is the same."""
    path = tmp_path / f"{host()}-tree-exchange.o"
    compiled = _build_apart(tmp_path, tmp_path / "cache", "tree-exchange")
    code = path.read_bytes()
    assert _build_apart(tmp_path, tmp_path / "cache", "tree-exchange") < 0.3 * compiled
    assert path.read_bytes() == code


def _build_apart(folder: Path, cache: Path, *names: str) -> int:
    """Build object files in a process with a cache, and return how many functions it has compiled."""
    command = [sys.executable, "-m", "mbfmu.native.kernels", str(folder), host(), *names]
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    return len(subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=True).stdout)


def test_the_kernels_are_compiled_for_a_process_that_compiles_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    given: dict[str, str] = {}

    def build(command: list[str], more: dict[str, str], _: int) -> None:
        given.update(more)
        assert command[4:] == ["x86_64-linux", "mechanisms", "adams-equations"]
        for name in names:
            (Path(command[3]) / name).write_bytes(b"code")

    parts = Contents("adams", ("mechanisms", "equations")).objects()
    names = [f"x86_64-linux-{part}.o" for part in parts]
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    monkeypatch.setattr(runtime, "_run", build)
    runtime._build(tmp_path, ["x86_64-linux"], parts)
    assert given["NUMBA_DISABLE_JIT"] == "0"
    assert all((tmp_path / name).read_bytes() == b"code" for name in names)
    monkeypatch.setattr(runtime, "_run", None)
    runtime._build(tmp_path, ["x86_64-linux"], parts)  # nothing is left to do


@needs_linker
def test_zig_is_downloaded_for_a_build_where_there_is_no_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A wheel of the name, whose program hands on to the compiler of this machine."""
    cc = next(filter(None, map(shutil.which, runtime.COMPILERS)))
    wheel, source, told = tmp_path / "ziglang-1.0-py3-none-any.whl", tmp_path / "one.c", list[str]()
    with ZipFile(wheel, "w") as archive:
        program = ZipInfo("ziglang/zig")
        program.external_attr = 0o100755 << 16
        archive.writestr(program, f'#!/bin/sh\nshift 3\nexec {cc} "$@"\n')
        archive.writestr("ziglang-1.0.dist-info/METADATA", "Metadata-Version: 2.1\nName: ziglang\nVersion: 1.0\n")
        archive.writestr(
            "ziglang-1.0.dist-info/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
        )
        archive.writestr("ziglang-1.0.dist-info/RECORD", "")
    source.write_text("int one(void) { return 1; }\n")
    monkeypatch.setattr(runtime, "has_zig", lambda: False)
    monkeypatch.setattr(runtime, "COMPILERS", ())
    monkeypatch.setattr(runtime, "ZIG", str(wheel))
    with when_progressing(lambda _: None, told.append), runtime.c_compilers([host()]) as commands:
        command = commands[host()]
        assert command[1:] == ["cc", "-target", TARGETS[host()].zig]
        subprocess.run([*command, "-c", str(source), "-o", str(tmp_path / "one.o")], check=True)
    assert (tmp_path / "one.o").is_file()
    assert not Path(command[0]).parent.exists()
    assert told == [f"nothing here compiles C for {host()}: zig is downloaded (100 MB) and removed after the build"]


def test_the_requirement_of_zig_is_that_of_the_package():
    described = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())
    assert described["project"]["optional-dependencies"]["native"] == [runtime.ZIG]


def test_progress_of_a_build_is_reported_and_its_error_has_its_cause():
    parts: list[float] = []
    script = "import sys; [print('..', end='', flush=True) for _ in range(3)]; sys.exit('the disk is full')"
    with when_progressing(parts.append, print), pytest.raises(UserError, match="reports 'the disk is full'") as error:
        runtime._run([sys.executable, "-c", script], {}, 5)
    assert error.value.diagnostic.code == "no-runtime"
    assert parts
    assert parts == sorted(parts)
    assert parts[-1] == 1.0  # not more, if more is compiled than expected


def test_a_solver_that_is_not_there_is_refused():
    model = Feeder(path="straight", nips=1, nx=5, nz=4)
    with pytest.raises(UserError, match=r"do not support solver 'ida' for this large model, since .* use 'esdirk'"):
        image_of(Simulation(model, Settings(solver="ida")))


def test_a_model_gets_a_solver_that_suits_it_and_is_in_machine_code():
    model, told = Feeder(path="straight", nips=1, nx=5, nz=4), list[Any]()
    assert _with_solver(model, Settings(solver=model.default_solver), told.append).solver == "esdirk"
    assert not told


def test_tuples_are_laid_once_and_arrays_must_not_have_gaps():
    shared = np.arange(4.0)
    addresses = np.zeros(1, np.int64)
    image = MemoryImage(((shared, 7), shared, addresses), [shared], [(addresses, [-1])])
    assert image.saved == 64
    assert len({target for _, target in image.relocations}) == 3
    with pytest.raises(ValueError, match="without gaps"):
        MemoryImage((np.zeros((4, 4))[:, 1], addresses), [], [(addresses, [-1])])


def test_a_part_of_an_array_is_a_part_of_it_in_the_block():
    whole, addresses = np.arange(8.0), np.zeros(1, np.int64)
    image = MemoryImage((whole, whole[2:5], addresses), [whole], [(addresses, [-1])])
    targets = [target for _, target in image.relocations]
    assert targets[1] - targets[0] == 16
    with pytest.raises(ValueError, match="shares memory with one that came first"):
        MemoryImage((whole[2:5], whole, addresses), [], [(addresses, [-1])])
