"""Options of the command: settings, quiet and verbose, completion."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from mbfmu.cli import parser
from mbfmu.cli.common import scene_of
from mbfmu.modeling.parameters import declared
from mbfmu.modeling.scene import as_toml, load_scene
from mbfmu.modeling.settings import Settings
from mbfmu.modeling.variables import Role, list_variables

Command = Callable[..., Any]


OTHER = {
    "solver": "adams-lu", "tolerance": 1e-5, "absolute_tolerance": 1e-7, "max_order": 4,
    "max_steps": 5000, "max_step": 0.01, "input_interpolation": "linear", "start_at_equilibrium": True,
    "energy_check": False,
}  # fmt: skip


def as_option(name: str, value: object) -> str:
    option = name.replace("_", "-")
    return f"--{'' if value else 'no-'}{option}" if isinstance(value, bool) else f"--{option}={value}"


@pytest.mark.parametrize("name", [p.name for p in declared(Settings)])
def test_every_setting_reaches_a_scene_the_command_and_what_is_saved(tmp_path: Path, name: str) -> None:
    """A setting that is new has to be named here."""
    given = {"solver": "adams"} | {name: OTHER[name]}
    path = tmp_path / "s.toml"
    path.write_text('model = "fourbar"\n' + "".join(f"{k} = {json.dumps(v)}\n" for k, v in given.items()))
    expected = replace(load_scene("fourbar").settings, **given)
    assert load_scene(str(path)).settings == expected
    path.write_text(as_toml(load_scene(str(path))))
    assert load_scene(str(path)).settings == expected
    for words in (["run"], ["export"], ["view"], ["effects"]):
        options = parser().parse_args([*words, "fourbar", *(as_option(k, v) for k, v in given.items())])
        assert scene_of(options).settings == expected


def test_every_setting_is_a_variable_of_the_fmu() -> None:
    told = list_variables(load_scene("fourbar").model, Settings())
    settings = {v.name for v in told if v.role is Role.SETTING}
    assert settings == {p.name for p in declared(Settings)}


def test_quiet_prints_the_path_and_nothing_else(command: Command, tmp_path: Path) -> None:
    for before, after in ((["-q"], []), ([], ["-q"])):
        code, out, err = command(*before, "run", "fourbar", "--direct", "--stop-time=0.1", "-o", str(tmp_path), *after)
        assert (code, err) == (0, "")
        assert (Path(out.removesuffix("\n")) / "outputs.csv").is_file()


def test_verbose_prints_statistics_and_settings(command: Command, tmp_path: Path) -> None:
    told = ("run", "fourbar", "--direct", "--stop-time=0.1", "--plot=energy", "-o", str(tmp_path))
    assert "absolute_tolerance = 0" not in command(*told)[1]
    out = command("-v", *told)[1]
    assert "absolute_tolerance = 0" in out
    assert "time_projection = " in out


def test_every_command_may_be_quiet_or_verbose() -> None:
    for command in commands():
        told = options_of(command)
        assert {"-q", "-v"} <= told, command


def commands() -> dict[str, Any]:
    (found,) = (action for action in parser()._actions if action.choices and "run" in action.choices)
    return dict(found.choices)  # type: ignore[arg-type]


def options_of(command: str) -> set[str]:
    return {option for action in commands()[command]._actions for option in action.option_strings}


COMPLETED = {
    "mbfmu ru": "run",
    "mbfmu run fourb": "fourbar/paper",
    "mbfmu -q view fourb": "fourbar/paper",
    "mbfmu run fourbar --solver ad": "adams",
    "mbfmu run fourbar --max-": "--max-order",
    "mbfmu run fourbar --set crank_m": "crank_mass=",
    "mbfmu run fourbar --plot pivot": "pivot.force.x",
    "mbfmu run fourbar --input-interpolation li": "linear",
}


ASK = """
import io, json, os, sys
import argcomplete
from mbfmu import cli
answers = {}
class Done(Exception): pass
def done(code): raise Done
for line in json.loads(sys.argv[1]):
    os.environ |= {"_ARGCOMPLETE": "1", "COMP_LINE": line, "COMP_POINT": str(len(line)), "_ARGCOMPLETE_IFS": "|"}
    answer, complete = io.StringIO(), argcomplete.autocomplete
    cli.argcomplete.autocomplete = lambda p: complete(p, exit_method=done, output_stream=answer)
    try:
        cli.main([])
    except Done:
        answers[line] = [word.strip() for word in answer.getvalue().split("|")]
    cli.argcomplete.autocomplete = complete
print(json.dumps(answers))
"""


def test_the_shell_completes() -> None:
    """As a shell asks, with the line in the environment, but all lines of one process."""
    told = subprocess.run((sys.executable, "-c", ASK, json.dumps(list(COMPLETED))), capture_output=True, check=True)
    answers = json.loads(told.stdout)
    assert {line: word for line, word in COMPLETED.items() if word not in answers[line]} == {}
