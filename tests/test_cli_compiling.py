"""Machine code and the command: what is loaded, compiled and kept."""

from __future__ import annotations

import io
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tqdm import tqdm

from mbfmu import cli
from mbfmu.__main__ import main as run_module
from mbfmu.cli import main, models, parser
from mbfmu.cli.compiling import report_compilation
from mbfmu.util.progress import report_progress
from solvers.compiled import cache
from solvers.compiled.kernel import kernel
from solvers.steppers import SOLVER_NAMES, drop_unlisted

Command = Callable[..., Any]


def test_ctrl_c_while_modules_are_loaded_is_reported(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Interrupted:
        def find_spec(self, name: str, *_: object) -> None:
            if name == "mbfmu.cli":
                raise KeyboardInterrupt

    monkeypatch.delitem(sys.modules, "mbfmu.cli")
    monkeypatch.delattr("mbfmu.cli", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Interrupted(), *sys.meta_path])
    assert run_module() == 130
    assert capsys.readouterr().err == "mbfmu: interrupted before the start\n"


@pytest.mark.parametrize(
    ("arguments", "unused"),
    [
        (("--version",), ("numba", "numpy")),
        (("--help",), ("numba", "numpy")),
        (("models",), ("matplotlib", "scipy.linalg")),
    ],
)
def test_commands_import_only_what_they_need(arguments: tuple[str, ...], unused: tuple[str, ...]) -> None:
    code = (
        f"import sys; from mbfmu.cli import main; sys.argv[1:] = {arguments}\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        f"print([name for name in {unused} if name in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert found.splitlines()[-1] == "[]"


def test_every_command_is_listed_with_the_module_that_adds_it() -> None:
    """A parser in which only one command is loaded accepts the arguments of this command, and lists all others."""
    names = {
        module.stem for module in Path(cli.__file__).parent.glob("*.py") if "\ndef add(" in module.read_text("utf-8")
    }
    assert {module for module, _ in cli.COMMANDS.values()} == names
    for name in cli.COMMANDS:
        (found,) = (action for action in parser({name})._actions if action.choices and "run" in action.choices)
        assert list(found.choices) == list(cli.COMMANDS)
        assert [key for key, own in found.choices.items() if own._defaults.get("command")] == [name]


def test_the_compiler_is_announced_and_timed(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before anything is compiled, once, and with its time afterwards; never with -q."""

    def compiles(_options: object) -> int:
        never = time.time()  # has this been compiled before
        fresh = kernel(lambda x: x + never)
        assert fresh(1.0) == 1.0 + never
        return 0

    monkeypatch.setattr(models, "command_models", compiles)
    assert main(["models"]) == 0
    lines = capfd.readouterr().err.splitlines()
    assert lines[0].startswith("compiling; this takes up to three minutes")
    assert re.fullmatch(r"compiled in \d+\.\d s", lines[1])
    assert len(lines) == 2
    assert main(["models", "-q"]) == 0
    assert capfd.readouterr().err == ""


def test_a_build_of_machine_code_shows_its_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    bars: list[tqdm] = []

    def bar(*arguments: Any) -> tqdm:
        bars.append(tqdm(total=arguments[0], file=io.StringIO()))
        return bars[-1]

    monkeypatch.setattr("mbfmu.cli.compiling.bar", bar)
    with report_compilation(reported=True):
        for _ in range(2):  # two builds, one after the other
            for part in (0.2, 0.7, 1.0):
                report_progress(part)
        assert [shown.n for shown in bars] == [100.0, 100.0]
        report_progress(0.5)
    assert (len(bars), bars[-1].disable) == (3, True)  # closed if a build fails


def test_the_cache_reports_where_it_is(command: Command) -> None:
    code, out, _ = command("cache")
    assert code == 0
    assert str(cache.cache_root()) in out
    assert "MB of machine code" in out


def test_the_cache_is_warmed_for_a_model(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[str] = []
    monkeypatch.setattr("mbfmu.cli.cache.Simulation", lambda _model, settings: started.append(settings.solver))
    code, out, _ = command("cache", "warm", "pendulum")
    assert code == 0
    assert started == list(drop_unlisted(SOLVER_NAMES))
    assert "MB of machine code" in out
