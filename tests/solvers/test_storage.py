"""Removal of machine code: nothing else in the folder of the cache is removed."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from solvers.compiled import cache, storage
from solvers.compiled.kernel import COMPILED

OTHER = "0123456789abcdef"  # fingerprint of other sources


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of the cache: below it the sources of a checkout, as with NUMBA_CACHE_DIR set to one."""
    found = tmp_path / "mbfmu"
    monkeypatch.setattr(cache, "cache_root", lambda: found)
    for function in (cache.shared_cache_dir, cache.module_cache_dir):
        monkeypatch.setattr(cache, function.__name__, function.__wrapped__)
    return found


SOURCES = (
    "__init__.py",
    "cli/cache.py",
    "kernels/readme.txt",
    f"kernels/notes-{OTHER}/notes.py",
    f"kernels/notes-{OTHER}/x.nbc.bak",
    "kernels/stray.nbi",
    f"kernels/{OTHER}.nbi",
    f"native/native-{OTHER}/lock",
    f"{OTHER}/plan.nbi",
    f"{OTHER}/deep/folder/a.nbi",
    f"{OTHER}/native-{OTHER}/model.c",
    "a.nbi",
)


def write(home: Path, *names: str) -> set[Path]:
    for name in names:
        (home / name).parent.mkdir(parents=True, exist_ok=True)
        (home / name).write_bytes(b"12345")
    return {home / name for name in names}


def files(home: Path) -> set[Path]:
    return {path for path in home.rglob("*") if path.is_file() or path.is_symlink()}


def ours(fingerprint: str) -> tuple[str, ...]:
    """Return names of files as the compiler and the linker write them."""
    return (
        f"kernels/solvers.linalg.dense-{fingerprint}/dense.factor-12.py312.nbi",
        f"kernels/solvers.linalg.dense-{fingerprint}/dense.factor-12.py312.1.nbc",
        f"kernels/solvers.linalg.dense-{fingerprint}/dense.factor-12.py312.2.nbc.tmp.1a2b",
        f"kernels/my model-v2_ab12cd34-{fingerprint}-89abcdef/demo.outer-3.py312.nbi",
        f"{fingerprint}/native-{OTHER}/lock",
        f"{fingerprint}/native-{OTHER}/x86_64-linux.so",
        f"{fingerprint}/native-{OTHER}/x86_64-linux.o",
        f"{fingerprint}/native-{OTHER}/tmpab12",
        f"{fingerprint}/solvers.linalg.dense/dense.factor-12.py312.nbi",  # as up to version 0.2.0
    )


def test_clear_removes_machine_code_and_leaves_sources(home: Path) -> None:
    write(home, *ours(OTHER), *ours(cache.shared_cache_dir().name))
    kept = write(home, *SOURCES)
    removed = storage.clear()
    assert files(home) == kept
    assert removed == (2 * len(ours(OTHER)), 10 * len(ours(OTHER)), ())
    assert set(storage.find_foreign()) == kept
    assert not (home / f"kernels/solvers.linalg.dense-{OTHER}").exists(), "empty folders go too"


def test_clear_leaves_no_folder_where_all_was_machine_code(home: Path) -> None:
    write(home, *ours(OTHER))
    assert storage.clear().files == len(ours(OTHER))
    assert not home.exists()
    assert storage.clear() == (0, 0, ()), "nothing is there"


def test_old_code_is_that_of_other_sources(home: Path) -> None:
    """Current: the folders that a process with these sources uses, of modules of mbfmu and of users."""
    module = "solvers.linalg.dense"
    current = write(
        home,
        f"kernels/{cache.module_cache_dir(module).name}/a.nbi",
        f"kernels/{cache.module_cache_dir('a_model_of_users').name}-89abcdef/a.nbi",
        f"{cache.shared_cache_dir().name}/native-{OTHER}/x86_64-linux.so",
    )
    write(home, *ours(OTHER))
    assert {file for folder in storage.find_code_folders() if folder.is_current for file in folder.files} == current
    removed = storage.clear(keep_current=True)
    assert removed.files == len(ours(OTHER))
    assert files(home) == current


def test_symbolic_links_are_not_followed(home: Path, tmp_path: Path) -> None:
    there = tmp_path / "elsewhere"
    outside = write(there, "a.nbi", "b.nbc")
    folder = home / "kernels" / f"solvers.linalg.dense-{OTHER}"
    folder.parent.mkdir(parents=True)
    folder.symlink_to(there)
    write(home, f"kernels/real-{OTHER}/a.nbi")
    link = home / "kernels" / f"real-{OTHER}" / "b.nbi"
    link.symlink_to(there / "b.nbc")
    (home / OTHER).symlink_to(there.parent)
    assert storage.clear().files == 1
    assert files(there) == outside
    assert link.is_symlink()
    assert folder.is_symlink()


KERNEL = """
from solvers.compiled.kernel import kernel

@kernel
def double(x):
    return 2 * x

double(3), double(1.5)
"""


@pytest.mark.skipif(not COMPILED, reason="nothing is compiled")
def test_all_that_the_compiler_writes_is_machine_code(home: Path, tmp_path: Path) -> None:
    script = tmp_path / "odd name.py"
    script.write_text(KERNEL)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(home.parent), "PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run((sys.executable, script), env=environment, check=True)
    assert len(files(home)) >= 3, "the code of two signatures, and the file of turns"
    assert storage.find_foreign() == []
    assert storage.clear().files >= 3
    assert not home.exists()


def test_what_cannot_be_removed_is_reported(
    home: Path, command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    write(home, *ours(OTHER))

    def refuse(path: Path) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "unlink", refuse)
    code, out, err = command("cache", "clear")
    assert code == 2
    assert "removed 0 files" in out
    assert f"{len(ours(OTHER))} files cannot be removed" in err
    assert "Permission denied" in err


def test_the_command_reports_what_it_removed(home: Path, command: Callable[..., Any]) -> None:
    write(home, *ours(OTHER), *ours(cache.shared_cache_dir().name))
    kept = write(home, *SOURCES)
    out = command("cache")[1]
    assert f"{home}: 0 MB of machine code" in out
    assert "0 MB of it is from other versions" in out
    code, out, _ = command("cache", "clear", "--old")
    assert code == 0
    assert f"removed {len(ours(OTHER))} files" in out
    assert "other versions" not in out
    code, out, _ = command("cache", "clear")
    assert f"removed {len(ours(OTHER))} files" in out
    assert f"left {len(kept)} other files" in out
    assert files(home) == kept


@pytest.mark.parametrize("what", [("cache", "--old"), ("cache", "warm", "--old")])
def test_old_goes_with_clear(what: tuple[str, ...], command: Callable[..., Any]) -> None:
    code, _, err = command(*what)
    assert code == 2
    assert "--old is an option of `mbfmu cache clear` only" in err
