"""Files that users name: after a failure at any place of a writer, the previous content is there, and nothing else."""

from __future__ import annotations

import ast
import os
import resource
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest

import mbfmu
from fmus.pendulum import SwingPendulum
from mbfmu.cli.common import write_json
from mbfmu.ensemble.records import write_table
from mbfmu.fmi.export import pack
from mbfmu.mechanics import Variable
from mbfmu.modeling.settings import Settings
from mbfmu.plotting.figures import finish
from mbfmu.session.result import Result
from mbfmu.session.run import communication_points, run
from mbfmu.steady.linear import StateSpace
from mbfmu.steady.path import EquilibriumPath, PathBranch, PathState
from mbfmu.util.errors import UserError
from mbfmu.util.files import check_writable, replacing, write_bytes, write_text
from mbfmu.viewer import Motion, Recorder
from mbfmu.viewer.gltf import write_glb
from mbfmu.viewer.html import write_html
from mbfmu.viewer.images import Shot, write_film, write_png
from solvers import Statistics

NOISE = np.random.default_rng(1).random((200, 3))  # nothing that compresses well
BEFORE = b"what was there before"


@cache
def motion() -> Motion:
    recorder = Recorder()
    run(SwingPendulum(), Settings(solver="adams"), communication_points(0.2, 0.02), watch=recorder)
    return recorder.motion("a pendulum")


@cache
def result() -> Result:
    variables = tuple(Variable(f"x{k}", "m", "") for k in range(3))
    return Result(np.arange(200.0), NOISE, variables, Statistics(), 0.0)


def space() -> Any:
    names = {name: tuple(f"{name}{k}" for k in range(3)) for name in ("states", "inputs", "outputs")}
    return SimpleNamespace(A=NOISE, B=NOISE, C=NOISE, D=NOISE, **names)


def equilibrium_path() -> EquilibriumPath:
    states = [PathState(value=x, outputs={"y": y}, positions={}, unstable=0, stability="stable") for x, y, _ in NOISE]
    return EquilibriumPath(input="x", unit="N", units={"y": "m"}, branches=[PathBranch(states=states)])


def picture(path: Path) -> None:
    figure = plt.figure()
    figure.subplots().plot(NOISE)
    finish(figure, path)
    plt.close(figure)


SHOT = Shot(width=160, height=120)
WRITERS: dict[str, Callable[[Path], Any]] = {
    "outputs.csv": lambda path: result().write_csv(path),
    "result.npz": lambda path: result().save(path),
    "motion.npz": lambda path: motion().save(path),
    "path.csv": lambda path: equilibrium_path().write_csv(path),
    "matrices.npz": lambda path: StateSpace.write(space(), path),
    "matrices.mat": lambda path: StateSpace.write(space(), path),
    "page.html": lambda path: write_html(motion(), path),
    "scene.glb": lambda path: write_glb(motion(), path),
    "frame.png": lambda path: write_png(motion(), path, 0.0, SHOT),
    "film.gif": lambda path: write_film(motion(), path, SHOT, fps=10),
    "plot.png": picture,
    "plot.svg": picture,
    "model.fmu": lambda path: pack(path, {"binary": NOISE.tobytes(), "text": b"text"}),
    "rows.json": lambda path: write_json(NOISE.tolist(), path),
    "runs.parquet": lambda path: write_table({"x": NOISE[:, 0], "y": NOISE[:, 1]}, path, "identity"),
    "scene.toml": lambda path: write_text(path, 500 * "model = 'fourbar'\n"),
    "library.so": lambda path: write_bytes(path, NOISE.tobytes()),
}


@contextmanager
def limited(size: int | None) -> Iterator[None]:
    """Let no file of this process become larger, bytes: writing fails in the middle, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (before[1] if size is None else size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("name", WRITERS)
def test_a_writer_that_fails_in_the_middle_leaves_what_was_there(name: str, tmp_path: Path) -> None:
    write, path = WRITERS[name], tmp_path / name
    write(path)
    size = path.stat().st_size
    assert [file.name for file in tmp_path.iterdir()] == [name]
    path.write_bytes(BEFORE)
    with limited(size // 2), pytest.raises(UserError, match=f"{name}' cannot be written: .*File too large"):
        write(path)
    assert path.read_bytes() == BEFORE
    assert [file.name for file in tmp_path.iterdir()] == [name]
    path.unlink()
    with limited(size // 2), pytest.raises(UserError):
        write(path)
    assert list(tmp_path.iterdir()) == [], "there is no half file where there was none"
    write(path)
    assert path.stat().st_size == pytest.approx(size, rel=0.01), "and it works again"


@pytest.mark.parametrize("raised", [KeyboardInterrupt, SystemExit, ValueError, MemoryError])
def test_an_interrupted_block_leaves_what_was_there(raised: type[BaseException], tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    path.write_bytes(BEFORE)

    def write() -> None:
        with replacing(path) as unfinished:
            unfinished.write_text("half of")
            raise raised

    with pytest.raises(raised):
        write()
    assert path.read_bytes() == BEFORE
    assert list(tmp_path.iterdir()) == [path]


def test_the_content_is_on_the_disk_before_it_has_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, order = tmp_path / "out.csv", []
    path.write_bytes(BEFORE)
    flush, rename = os.fsync, Path.replace

    def flushed(descriptor: int) -> None:
        order.append(("flush", Path(f"/proc/self/fd/{descriptor}").readlink()))
        flush(descriptor)

    def renamed(source: Path, target: Path) -> Path:
        order.append(("rename", source))
        return rename(source, target)

    monkeypatch.setattr(os, "fsync", flushed)
    monkeypatch.setattr(Path, "replace", renamed)
    write_text(path, "new")
    (_, first), (_, second), (_, third) = order
    assert [kind for kind, _ in order] == ["flush", "rename", "flush"]
    assert first == second != path
    assert third == tmp_path
    assert path.read_text() == "new"


def test_permissions_and_links_stay(tmp_path: Path) -> None:
    real, link = tmp_path / "real.csv", tmp_path / "link.csv"
    real.write_bytes(BEFORE)
    real.chmod(0o640)
    link.symlink_to(real)
    write_text(link, "new")
    assert link.is_symlink()
    assert real.read_text() == "new"
    assert stat.S_IMODE(real.stat().st_mode) == 0o640
    before = os.umask(0o027)
    try:
        write_text(tmp_path / "other.csv", "new")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "other.csv").stat().st_mode) == 0o640, "as any program makes a file"
    dangling = tmp_path / "dangling.csv"
    dangling.symlink_to(tmp_path / "nowhere.csv")
    write_text(dangling, "new")
    assert (tmp_path / "nowhere.csv").read_text() == "new"


def test_devices_and_pipes_are_written_in_place(tmp_path: Path) -> None:
    write_text("/dev/null", "nothing")
    assert not Path("/dev/null").is_file()
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    descriptor = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        check_writable(pipe)
        write_text(pipe, "through a pipe")
        assert os.read(descriptor, 100) == b"through a pipe"
    finally:
        os.close(descriptor)
    assert stat.S_ISFIFO(pipe.stat().st_mode)


@pytest.mark.parametrize("write", [check_writable, lambda path: write_text(path, "new")])
def test_what_cannot_be_written_is_named(write: Callable[[Path], None], tmp_path: Path) -> None:
    for path, why in ((tmp_path / "no" / "a.csv", "No such file"), (tmp_path, "Is a directory")):
        with pytest.raises(UserError, match=f"^'{path}' cannot be written: {why}"):
            write(path)
    assert list(tmp_path.iterdir()) == []


def test_a_write_protected_file_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(BEFORE)
    monkeypatch.setattr(os, "access", lambda place, mode: False)  # root may write everything
    for write in (check_writable, lambda place: write_text(place, "new")):
        with pytest.raises(UserError, match=f"'{path}' cannot be written"):
            write(path)
    assert path.read_bytes() == BEFORE


def test_a_check_changes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    check_writable(path)
    assert list(tmp_path.iterdir()) == []
    path.write_bytes(BEFORE)
    before = path.stat().st_mtime_ns
    check_writable(path)
    assert (path.read_bytes(), path.stat().st_mtime_ns) == (BEFORE, before)
    assert list(tmp_path.iterdir()) == [path]


def test_a_name_of_the_largest_length_can_be_written(tmp_path: Path) -> None:
    for name in (251 * "n" + ".csv", "n." + 253 * "c"):
        write_text(tmp_path / name, "new")
        assert (tmp_path / name).read_text() == "new"


# ---- no other writer --------------------------------------------------------------------------------------------

TEMPORARY = {  # functions that write into a temporary folder
    "fmi/python_fmu.py:write_script",
    "fmi/subprocess_export.py:files_uncompiled",
    "native/runtime.py:compiler_arguments",
    "native/runtime.py:link_arguments",
    "native/user_kernels.py:main",
    "native/user_kernels.py:user_library",
    "native/runtime.py:build_lock",  # a file that is locked, and empty
    "native/kernels.py:write",
    "native/kernels.py:write_family",
    "ensemble/worker.py:unpacked",
    "ensemble/fmu_runners.py:__init__",
    "__main__.py:prepare_streams",  # the device, as below
    "cli/__init__.py:main",  # the device that swallows what is written to it
    "util/files.py:write_text",
    "util/files.py:write_bytes",
    "util/files.py:check_writable",
}
ALWAYS = {
    "write_text", "write_bytes", "savez", "savez_compressed", "savetxt", "tofile", "savefig", "savemat", "imsave",
    "write_table", "to_csv", "to_parquet", "to_pickle", "to_netcdf", "saving", "touch", "copyfile", "copy",
    "NamedTemporaryFile",
}  # fmt: skip
OPENS = {"open": 0, "ZipFile": 1}  # where the mode stands, after the path


def writes(call: ast.Call) -> bool:
    """Whether a call writes to a file."""
    method = isinstance(call.func, ast.Attribute)
    name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    owner = getattr(getattr(call.func, "value", None), "id", "")
    if owner == "webbrowser":
        return False
    if name in ("copy", "copyfile"):
        return owner == "shutil"
    if name not in OPENS:
        return name in ALWAYS and method
    place = 0 if name == "open" and method and owner not in ("io", "gzip", "os") else 1
    given = [*call.args[place : place + 1], *(k.value for k in call.keywords if k.arg == "mode")]
    if owner == "os":
        return any("O_WRONLY" in ast.unparse(x) or "O_RDWR" in ast.unparse(x) for x in given)
    return any(not isinstance(x, ast.Constant) or set(str(x.value)) & set("wax+") for x in given)


def written_outside(tree: ast.Module) -> Iterator[tuple[str, int]]:
    """Yield function and line of what is written to a path that :func:`replacing` did not yield."""

    def visit(node: ast.AST, function: str, inside: bool) -> Iterator[tuple[str, int]]:
        if isinstance(node, ast.FunctionDef):
            function, inside = node.name, False
        if isinstance(node, ast.With):
            inside = inside or "replacing(" in "".join(ast.unparse(item) for item in node.items)
        direct = isinstance(node, ast.Call) and writes(node) and ast.unparse(node.func) not in ("files.write_text",)
        if direct and not inside:
            yield function, node.lineno
        for child in ast.iter_child_nodes(node):
            yield from visit(child, function, inside)

    yield from visit(tree, "", False)


def test_no_file_is_opened_for_writing_elsewhere() -> None:
    root, found = Path(mbfmu.__file__).parent, []
    for path in sorted(root.rglob("*.py")):
        name = path.relative_to(root).as_posix()
        for function, line in written_outside(ast.parse(path.read_text("utf-8"))):
            if f"{name}:{function}" not in TEMPORARY:
                found.append(f"{name}:{line} in {function}")
    assert found == [], "write through mbfmu.util.files.replacing"


@pytest.mark.parametrize(
    "text",
    [
        "Path(p).write_text(x)", "p.open('w')", "p.open(mode='ab')", "open(p, 'x')", "open(p, mode)", "ZipFile(p, 'w')",
        "zipfile.ZipFile(p, 'a')", "np.savez(p, a=1)", "figure.savefig(p)", "with writing(p):\n    p.write_bytes(x)",
        "os.open(p, os.O_WRONLY)", "shutil.copy(a, b)",
    ],
)  # fmt: skip
def test_what_writes_is_found(text: str) -> None:
    assert list(written_outside(ast.parse(text)))


@pytest.mark.parametrize(
    "text",
    ["p.open()", "open(p, 'rb')", "ZipFile(p)", "with replacing(p) as q, q.open('wb') as f:\n    np.savez(f)",
     "write_text(p, x)", "os.open(p, os.O_RDONLY)", "x.copy()"],
)  # fmt: skip
def test_what_does_not_write_is_passed_over(text: str) -> None:
    assert not list(written_outside(ast.parse(text)))
