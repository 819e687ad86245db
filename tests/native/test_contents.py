"""A library has what its model can call: a run has a smaller one than an exported FMU, with the same bits."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from binding import Binary
from running import needs_linker

from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.sheet import Sheet
from mbfmu.fmi.export import FmuKind, export_scene, native_files
from mbfmu.fmi.run import run_fmu
from mbfmu.mechanics import Mechanism, Revolute, rod
from mbfmu.modeling.model import as_model
from mbfmu.modeling.scene import Scene, default_scene, load_scene
from mbfmu.modeling.settings import Settings
from mbfmu.native import layout
from mbfmu.native.contents import ENTRY_PARTS, Contents, complete, contents_for, entry_part
from mbfmu.native.data import native_model
from mbfmu.native.entries import entries
from mbfmu.native.families import FAMILIES
from mbfmu.native.kernel_table import kernel_tables, numbers_in_fmu, shipped_kernels
from mbfmu.native.runtime import build_dir, cached_library, install_atomically, library, objects
from mbfmu.native.targets import host

RUNTIME = sys.modules[library.__module__]
RUN = ("mechanisms", "equations", "steps")
EXPORTED = ("mechanisms", "mechanisms-derivatives", "equations", "steps", "exchange")


def fourbar() -> Scene:
    return load_scene("fourbar").changed(solver="adams")


def contents_of(scene: Scene, kind: FmuKind) -> Contents:
    return native_files(scene, kind, 2, ()).libraries.contents


@pytest.fixture
def exact(monkeypatch: pytest.MonkeyPatch) -> None:
    """No library is replaced by a complete one."""

    def cached(name: str, contents: Contents) -> Path | None:
        path = build_dir(*RUNTIME._runtime_sources()) / RUNTIME._file(name, contents)
        return path if path.is_file() else None

    monkeypatch.setattr(RUNTIME, "cached_library", cached)


def test_a_run_has_a_smaller_library_than_an_exported_fmu():
    assert contents_of(fourbar(), FmuKind.ONE_RUN) == ("adams", RUN)
    assert contents_of(fourbar(), FmuKind.NATIVE) == ("adams", EXPORTED)


def test_a_sheet_has_kernels_of_sheets_and_a_mechanism_has_none():
    settings = Settings(solver="esdirk")
    sheet = native_model(Sheet(), settings, for_one_run=True).contents
    assert {"sheets", "sheets-derivatives"} <= set(sheet.parts)  # the structured tangent is taken by complex numbers
    assert "exchange" not in sheet.parts
    assert native_model(Governor(), Settings(solver="radau"), for_one_run=True).contents == ("radau", RUN)


def test_a_start_in_a_steady_state_has_its_entry_point():
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    bar = m.body("bar", m.ground, Revolute(start=-1.5), **rod(mass=1.0, length=1.0))
    m.output("bar.angle", bar.angle())
    settings = Settings(solver="adams", start_at_equilibrium=True)
    parts = native_model(as_model(m), settings, for_one_run=True).contents.parts
    assert parts == (*RUN, "steady")


@pytest.mark.parametrize("family", FAMILIES)
def test_every_entry_point_is_in_one_part(family: str):
    known = entries(family)
    assert {entry_part(name) for name in known} == set(ENTRY_PARTS)
    assert complete(family).entries(known) == known
    parts = [Contents(family, (part,)).entries(known) for part in ENTRY_PARTS]
    assert sum(map(len, parts)) == len(known)


def test_every_kernel_has_one_number_in_all_libraries():
    shipped = shipped_kernels()
    assert len(set(shipped)) == len(shipped)
    assert [numbers_in_fmu(())[own] for own in shipped] == list(range(len(shipped)))
    first = 0
    for name, table in kernel_tables().items():
        last = first + len(table.kernels) - 1
        for number in (first, last):
            found = contents_for(
                "adams", [number], exchanges=False, is_steady=False, has_events=False, has_profiles=False
            )
            assert found.parts == (name, "equations", "steps")
        first = last + 1


def test_types_in_symbols_have_the_same_names_in_every_process():
    """Parts that two processes compile fit together."""
    script = """
import sys
from mbfmu.native.entries import example
from solvers.compiled.tuple_pointer import pointer_type
print(*(pointer_type(example(name)) for name in sys.argv[1:]))
"""
    found = [
        subprocess.run(
            [sys.executable, "-c", script, *names], capture_output=True, text=True, check=True
        ).stdout.split()
        for names in (("ida", "tree"), ("tree", "ida"))
    ]
    assert found[0] == found[1][::-1]
    assert len(set(found[0])) == 2


@needs_linker
@pytest.mark.parametrize("family", ["adams", "ida"])
def test_the_parts_of_a_run_call_no_others(family: str):
    found: dict[str, set[str]] = {}
    for kind in ("--undefined-only", "--defined-only"):
        files = map(str, objects([host()], [Contents(family, RUN)])[host()])
        printed = subprocess.run(("nm", kind, "--extern-only", *files), capture_output=True, text=True, check=True)
        found[kind] = {line.split()[-1] for line in printed.stdout.splitlines() if line and not line.endswith(":")}
    assert not [name for name in found["--undefined-only"] - found["--defined-only"] if name.startswith("mb")]


@needs_linker
@pytest.mark.usefixtures("exact")
def test_both_libraries_give_the_same_bits(tmp_path: Path):
    times, scene, found = 0.01 * np.arange(101), fourbar(), []
    for kind, parts in ((FmuKind.ONE_RUN, RUN), (FmuKind.NATIVE, EXPORTED)):
        path = tmp_path / f"{kind}.fmu"
        export_scene(scene, path, kind)
        with zipfile.ZipFile(path) as archive:
            (name,) = (name for name in archive.namelist() if name.endswith(".so"))
            assert archive.read(name) == library(host(), Contents("adams", parts)).read_bytes()
        found.append(run_fmu(path, scene.model, scene.settings, times))
    assert found[0].values.shape == (101, len(found[0].variables))
    np.testing.assert_array_equal(found[0].values, found[1].values)
    assert found[0].statistics == found[1].statistics


@needs_linker
@pytest.mark.usefixtures("exact")
def test_a_model_that_needs_more_than_its_library_has_is_refused(tmp_path: Path):
    scene = default_scene(FourBar()).changed(solver="adams")
    export_scene(scene, tmp_path / "run.fmu", FmuKind.ONE_RUN)
    binary = Binary(tmp_path / "run.fmu", tmp_path)
    file, token = Path(binary.resources.removeprefix("file://")) / "model.bin", binary.description.guid
    whole = file.read_bytes()
    header = np.frombuffer(whole, layout.HEADER, 1)[0]
    kernel = int(header["kernels"]) + layout.RELOCATION.fields["target"][1]  # type: ignore[index]  # it has names
    beyond = len(kernel_tables()["mechanisms"].kernels)  # the first of sheets
    places = {"exchange": 1, "steady": 1}
    changes = [(layout.HEADER.fields[name][1], value) for name, value in places.items()]  # type: ignore[index]
    for at, number in (*changes, (kernel, beyond)):
        file.write_bytes(layout.signed(whole[:at] + number.to_bytes(8, "little") + whole[at + 8 :], token))
        binary.logged.clear()
        assert binary.component() is None
        assert f"file '{file}'" in binary.logged[-1][1]
    file.write_bytes(layout.signed(whole, token))
    binary.instantiate().free()


@pytest.mark.parametrize("damage", [b"", b"half", b"other bytes", None])
def test_a_damaged_library_in_the_cache_counts_as_missing(
    damage: bytes | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(RUNTIME, "build_dir", lambda *_: tmp_path / "cache")
    monkeypatch.setattr(RUNTIME, "_packed_dir", lambda: tmp_path / "packed")
    contents = Contents("adams", RUN)
    made, path = tmp_path / "made", tmp_path / "cache" / RUNTIME._file(host(), contents)
    made.write_bytes(b"half and half")
    install_atomically(made, path)
    assert cached_library(host(), contents) == path
    if damage is None:
        path.unlink()
    else:
        path.write_bytes(damage)
    assert cached_library(host(), contents) is None
    install_atomically(made, path)
    assert cached_library(host(), contents) == path
