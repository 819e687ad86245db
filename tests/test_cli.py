"""The command line: exit codes, messages, files."""

from __future__ import annotations

import io
import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Barrier
from typing import Any

import pytest
from tqdm import tqdm

import mbfmu as mb
from mbfmu import cli
from mbfmu.__main__ import main as run_module
from mbfmu.cli import main, models, parser
from mbfmu.cli.common import scene_of
from mbfmu.cli.compiling import report_compilation
from mbfmu.cli.results import results
from mbfmu.fmi.python_fmu import own_source
from mbfmu.modeling import find
from mbfmu.modeling.parameters import declared
from mbfmu.modeling.scene import as_toml, load_scene
from mbfmu.modeling.settings import Settings
from mbfmu.modeling.variables import Role, list_variables
from mbfmu.plotting import time_series
from mbfmu.session import run as session_run
from mbfmu.session.result import Result
from mbfmu.util.errors import UserError
from mbfmu.util.progress import report_progress
from solvers import SOLVERS
from solvers.compiled import cache
from solvers.compiled.kernel import kernel
from solvers.steppers import SOLVER_NAMES, drop_unlisted

Command = Callable[..., Any]


def test_run_through_the_fmu_writes_csv_and_png(command: Command, tmp_path: Path) -> None:
    code, out, _ = command("run", "fourbar", "--solver", "adams", "--stop-time", "0.5", "-o", str(tmp_path))
    assert code == 0
    assert "steps" in out
    assert "energy error" in out
    assert out.index("wrote ") == len("".join(out.splitlines(keepends=True)[:-1]))
    assert len(out.splitlines()) <= 6
    assert "partition switches" not in out
    assert "constraints" not in out, "removed constraints are details"
    folder = tmp_path / "fourbar" / "default-adams-1e-6"
    assert f"wrote {folder}\n" in out
    assert sorted(p.name for p in folder.iterdir()) == [
        "default.toml", "motion.npz", "outputs.csv", "outputs.png", "residuals.png", "result.npz",
    ]  # fmt: skip
    assert (folder / "outputs.csv").read_text().count("\n") == 52
    assert (folder / "outputs.png").stat().st_size > 10_000
    saved = Result.load(folder / "result.npz")
    assert saved.title == "fourbar/default, adams, tolerance 1e-6"
    assert len(saved.t) == 51


def test_fmu_and_direct_write_the_same_numbers(command: Command, tmp_path: Path) -> None:
    for extra in ("--direct", "--solver=adams"):
        command(
            "run",
            "fourbar",
            "--solver=adams",
            "--stop-time=1",
            "--plot=energy",
            "-o",
            str(tmp_path / extra.strip("-")),
            extra,
        )
    direct, through_fmu = (
        (tmp_path / way / "fourbar" / "default-adams-1e-6" / "outputs.csv").read_text()
        for way in ("direct", "solver=adams")
    )
    for a, b in zip(direct.splitlines()[1:], through_fmu.splitlines()[1:], strict=True):
        for x, y in zip(a.split(","), b.split(","), strict=True):
            assert float(x) == pytest.approx(float(y), rel=0, abs=1e-12)


@pytest.mark.parametrize(
    ("found", "word"),
    [
        (mb.Diagnostic.error("collapsed-step", "it stopped"), "failed"),
        (mb.Diagnostic.warning("energy-balance", "energy is lost"), "inaccurate"),
    ],
)
def test_a_run_that_may_be_wrong_has_its_warning_in_all_outputs(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, found: mb.Diagnostic, word: str
) -> None:
    told = ("run", "fourbar/paper", "--direct", "--stop-time=0.1", "--plot=energy", "-o", str(tmp_path))
    assert command(*told)[0] == 0
    drawn: list[str] = []
    monkeypatch.setattr(
        "mbfmu.plotting.time_series.set_title", lambda figure, result: drawn.append(time_series.status_label(result))
    )
    monkeypatch.setattr("mbfmu.cli.run.run", lambda *a, **k: replace(session_run.run(*a, **k), diagnostics=(found,)))
    code, out, err = command(*told)
    assert code == 1
    assert err.endswith(f"mbfmu: {found.severity}: {found}\n")
    assert out.endswith(f"paper-hybrid-1e-4-{word}\n")
    assert folders(tmp_path / "fourbar") == ["paper-hybrid-1e-4", f"paper-hybrid-1e-4-{word}"]
    assert drawn[0].startswith(word.upper())


def folders(place: Path) -> list[str]:
    """Return the names of all that is in a folder, hidden or not."""
    return sorted(path.name for path in place.iterdir())


def test_a_run_again_leaves_the_first_alone(command: Command, tmp_path: Path) -> None:
    told = ("run", "fourbar/paper", "--direct", "--stop-time=0.1", "--plot=energy", "-o", str(tmp_path))
    first = tmp_path / "fourbar" / "paper-hybrid-1e-4"
    assert command(*told)[0] == 0
    before = {path.name: path.read_bytes() for path in first.iterdir()}
    assert command(*told)[0] == 0
    assert folders(tmp_path / "fourbar") == ["paper-hybrid-1e-4", "paper-hybrid-1e-4-2"]
    assert {path.name: path.read_bytes() for path in first.iterdir()} == before


def test_the_scene_in_a_folder_runs_the_same_again(command: Command, tmp_path: Path) -> None:
    told = ("--direct", "--stop-time=0.1", "--plot=energy", "-q", "-o", str(tmp_path))
    _, first, _ = command("run", "fourbar/paper", "--set=crank_mass=2", "--max-order=3", *told)
    again = load_scene(str(Path(first.strip()) / "paper.toml"))
    assert again.settings == replace(load_scene("fourbar/paper").settings, max_order=3)
    assert (again.name, again.stop_time, again.model.crank_mass) == ("fourbar/paper", 0.1, 2.0)  # type: ignore[attr-defined]
    _, second, _ = command("run", str(Path(first.strip()) / "paper.toml"), *told)
    assert second == first.replace("-crank_mass=2", "")  # only `--set` is part of the name
    numbers = [(Path(folder.strip()) / "outputs.csv").read_text() for folder in (first, second)]
    assert numbers[0] == numbers[1]


def test_processes_that_end_at_once_do_not_meet(tmp_path: Path) -> None:
    def write(number: int) -> str:
        with results(tmp_path, load_scene("fourbar"), "x") as place:
            place.file("who").write_text(str(number))
            start.wait()
            return (place.keep() / "who").read_text()

    start = Barrier(8)
    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(write, range(8))) == [str(number) for number in range(8)]
    assert folders(tmp_path / "fourbar") == ["x", *(f"x-{number}" for number in range(2, 9))]


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


def test_the_former_name_of_direct_is_accepted_with_a_notice(command: Command, tmp_path: Path) -> None:
    told = ("run", "fourbar", "--native", "--stop-time=0.01", "--plot=energy", "-o", str(tmp_path))
    code, out, err = command(*told)
    assert code == 0
    assert "--native of `mbfmu run` is now --direct" in err
    assert "FMU" not in out


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


@pytest.mark.parametrize("extra", [(), ("--direct",)])
def test_an_interrupted_run_leaves_nothing_behind(tmp_path: Path, extra: tuple[str, ...]) -> None:
    """Ctrl-C after a second of a run that would take long."""
    told = ("run", "pendulum", "--stop-time=1e5", "--interval=1", "--max-steps=1000000000", "-o", str(tmp_path))
    process = subprocess.Popen(
        (sys.executable, "-m", "mbfmu", *told, *extra), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        while process.poll() is None and not (tmp_path / "pendulum").is_dir():
            time.sleep(0.1)
        time.sleep(3.0)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert (process.returncode, out) == (130, "")
    assert "mbfmu: interrupted" in err
    assert "Traceback" not in err
    assert folders(tmp_path) == []


@pytest.mark.parametrize("there", [False, True])
def test_folders_made_for_what_was_not_kept_are_removed(tmp_path: Path, there: bool) -> None:
    root = tmp_path / "deep" / "results"
    if there:
        root.mkdir(parents=True)
    with pytest.raises(KeyboardInterrupt), results(root, load_scene("fourbar"), "x"):
        raise KeyboardInterrupt
    assert root.is_dir() == there
    assert (tmp_path / "deep").is_dir() == there
    assert not (root / "fourbar").exists()


def test_a_name_is_given_one_value(command: Command) -> None:
    code, _, err = command("compare", "sheet", "--resolution", "nx=7,nx=9")
    assert (code, err) == (
        2,
        "mbfmu: --resolution 'nx=9': nx is given twice, before as 7; allowed: one value [invalid-value]\n",
    )


def test_a_model_may_import_modules_of_its_folder(tmp_path: Path) -> None:
    """Two models, each with a module of the same name next to it, do not meet."""
    for folder, length in (("a", 1.0), ("b", 2.0)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "lengths.py").write_text(f"LENGTH = {length}\n")
        (tmp_path / folder / "model.py").write_text(
            "import mbfmu as mb\nfrom dataclasses import dataclass\nfrom lengths import LENGTH\n\n\n"
            "@dataclass(frozen=True, kw_only=True)\nclass Arm(mb.Model):\n    name = 'arm'\n"
            f"    length: float = mb.parameter(LENGTH, doc='of {folder}', unit='m')\n"
        )
    before = list(sys.path)
    assert [find(f"{tmp_path / folder / 'model.py'}:Arm")().length for folder in ("a", "b")] == [1.0, 2.0]
    assert sys.path == before
    assert "lengths" not in sys.modules
    with pytest.raises(
        UserError, match="model 'Arm' imports 'lengths' from the folder of its file, which is not part of"
    ):
        own_source(find(f"{tmp_path / 'a' / 'model.py'}:Arm"))


@pytest.mark.parametrize("way", ["root", "model", "above"])
def test_a_file_in_the_place_of_a_folder_is_reported_before_the_run(command: Command, tmp_path: Path, way: str) -> None:
    root = {"root": tmp_path / "file", "model": tmp_path, "above": tmp_path / "file" / "results"}[way]
    (tmp_path / ("fourbar" if way == "model" else "file")).write_text("kept")
    code, out, err = command("run", "fourbar", "-o", str(root))
    assert (code, out) == (2, "")
    assert err.startswith("mbfmu: folder ")
    assert "cannot be created" in err


def test_a_folder_that_is_read_only_is_reported_before_the_run(command: Command) -> None:
    code, out, err = command("run", "fourbar", "-o", "/proc/results")
    assert (code, out) == (2, "")
    assert err == "mbfmu: folder '/proc/results/fourbar' cannot be created: No such file or directory [file-access]\n"


def test_names_with_spaces_and_slashes_are_folders(command: Command, tmp_path: Path) -> None:
    place = tmp_path / "my models"
    place.mkdir()
    source = place / "my model.py"
    source.write_text("from fmus.fourbar import FourBar\nclass Mine(FourBar):\n    name = 'crank / rocker'\n")
    (place / "a scene.toml").write_text('model = "my model.py:Mine"\nstop_time = 0.02\n')
    root = tmp_path / "my results"
    for told in ((f"{source}:Mine", "--stop-time=0.02"), (str(place / "a scene.toml"),)):
        assert command("run", *told, "--direct", "--plot=energy", "-o", str(root))[0] == 0
    assert folders(root) == ["crank _ rocker"]
    assert folders(root / "crank _ rocker") == ["a scene-ida-1e-6", "default-ida-1e-6"]
    saved = root / "crank _ rocker" / "a scene-ida-1e-6" / "a scene.toml"
    assert load_scene(str(saved)).model.name == "crank / rocker"


def test_models_lists_parameters_with_units(command: Command) -> None:
    code, out, _ = command("models")
    assert code == 0
    (crank,) = (line for line in out.splitlines() if line.startswith("crank_length") and "pin" in line)
    assert crank.split()[:3] == ["crank_length", "1", "m"]
    assert "tunable" in out
    assert "fixed at export" in out


def test_compare_writes_rows(command: Command, tmp_path: Path) -> None:
    scene = tmp_path / "short.toml"
    scene.write_text('model = "fourbar"\nstop_time = 0.1\n')
    rows_file = tmp_path / "rows.json"
    code, out, _ = command("compare", str(scene), "--repeats=1", "-o", str(tmp_path), "--json", str(rows_file))
    assert code == 0
    assert "adams-lu" not in out
    rows = json.loads(rows_file.read_text())
    assert len(rows) == 4 * len(drop_unlisted(SOLVERS))
    folder = tmp_path / "fourbar" / "short-compare"
    assert folders(folder) == ["energy.png", "rows.json", "table.txt", "work_precision.png"]
    assert (folder / "rows.json").read_text() == rows_file.read_text()
    assert {"solver", "rtol", "cpu_s", "spread", "error", "worst", "branch_jump", "status"} <= set(rows[0])
    assert all(row["status"] == "ok" for row in rows)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("run", "fourbra"), "unknown model 'fourbra'"),
        (("run", "fourbar", "--set", "crank_length"), "allowed: NAME=VALUE"),
        (("run", "fourbar", "--set", "crank_length=-1"), "at least 0.001 m"),
        (("run", "fourbar", "--set", "ground_length=9"), "loop cannot close"),
        (("run", "fourbar", "--tolerance", "1e-20"), "1e-12"),
        (("run", "fourbar", "--solver", "rk4"), "solver is 'rk4'"),
        (("run", "no_such.toml"), "cannot be read"),
        (("export", "fourbar", "-o", "x.zip"), "must end in .fmu"),
        (("export", "fourbar", "-o", "/proc/x.fmu"), "'/proc/x.fmu' cannot be written"),
        (("compare", "fourbar", "--json", "/nowhere/x.json"), "'/nowhere/x.json' cannot be written"),
        (("compare", "fourbar", "--solver", "rk4"), "solver is 'rk4'"),
        (("compare", "fourbar", "--tolerance", "0.1"), "tolerance is 0.1; allowed: 1e-12 to 0.01"),
        (("compare", "fourbar", "--repeats", "0"), "repeats is 0; allowed: a whole number from 1 on"),
        (("compare", "fourbar", "--budget", "0"), "budget is 0.0 s; allowed: a number of seconds greater than zero"),
        (("compare", "fourbar", "--output", "crnk"), "model 'fourbar' has no output 'crnk'"),
        (("compare", "fourbar", "--resolution", "crank_mass=2"), "'crank_mass' is no resolution of model 'fourbar'"),
        (("compare", "fourbar", "--resolution", "coupler_modes"), "--resolution 'coupler_modes'; allowed: NAME=VALUE"),
        (("compare", "sheet", "--resolution", "nx=1,nz=5"), "parameter 'nx' of 'sheet' is 1.0; allowed"),
        (("compare", "fourbar", "--target", "-1"), "target is '-1'; allowed: a number above zero"),
        (("compare", "fourbar", "--target", "1 mi"), "target is '1 mi': unit is 'mi'; allowed"),
        (("compare", "fourbar", "--save", "x.toml"), "--save is given without --target"),
        (("compare", "fourbar", "--target", "1e-3", "--save", "x.txt"), "a file whose name ends in .toml"),
        (("cache", "warm", "nothing"), "unknown model 'nothing'"),
        (
            ("run", "fourbar", "--set", "coupler_mass=0", "--set", "crank_mass=0", "--set", "rocker_mass=0"),
            "no inertia",
        ),
        (("run", "fourbar", "--set", "start_angle=0", "--direct"), "branches of the motion cross"),
    ],
)
def test_mistakes_get_a_message_and_exit_code_2(command: Command, arguments: tuple[str, ...], message: str) -> None:
    code, _, err = command(*arguments)
    assert code == 2
    assert message in err
    assert "Traceback" not in err


def test_a_tolerance_that_is_not_run_is_reported(command: Command, tmp_path: Path) -> None:
    fine = ("run", "fourbar", "--direct", "--stop-time=0.1", "--plot=energy", "-o", str(tmp_path))
    assert "warning: The solver uses a tolerance of 1e-09 instead of 1e-12" in command(*fine, "--tolerance=1e-12")[1]
    assert "note:" not in command(*fine)[1]


def test_a_huge_number_is_refused_with_a_message(command: Command, tmp_path: Path) -> None:
    code, _, err = command("run", "fourbar", "--direct", "--set", "crank_length=1e200", "-o", str(tmp_path))
    assert code == 2
    assert err.startswith("mbfmu: ")


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


def test_python_m_is_the_command() -> None:
    found = subprocess.run((sys.executable, "-m", "mbfmu", "--version"), capture_output=True, text=True, check=True)
    assert found.stdout.startswith("mbfmu ")


def test_two_models_of_one_file_and_two_solvers_keep_their_results(command: Command, tmp_path: Path) -> None:
    source = tmp_path / "two.py"
    model = "class {}(FourBar):\n    pass\n"
    source.write_text("from fmus.fourbar import FourBar\n" + model.format("First") + model.format("Second"))
    for name, solver in (("First", "adams"), ("Second", "adams"), ("Second", "ida")):
        told = (f"{source}:{name}", f"--solver={solver}", "--direct", "--stop-time=0.02", "--plot=energy")
        assert command("run", *told, "-o", str(tmp_path))[0] == 0
    assert folders(tmp_path / "first") == ["default-adams-1e-6"]
    assert folders(tmp_path / "second") == ["default-adams-1e-6", "default-ida-1e-6"]


def test_a_full_disk_is_reported(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_options: object) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(models, "command_models", full)
    monkeypatch.setattr("os.dup2", lambda *_: None)
    code, _, err = command("models")
    assert (code, err) == (2, "mbfmu: standard output: No space left on device\n")


# ---- what is requested on the command line ---------------------------------------------------------------------------


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


def test_outputs_to_draw_are_chosen_by_pattern(command: Command, tmp_path: Path) -> None:
    told = ("run", "fourbar", "--direct", "--stop-time=0.1", "-o", str(tmp_path))
    code, _, err = command(*told, "--plot", "pivot.*", "--plot", "crnk.angle")
    assert (code, err) == (2, "mbfmu: no output 'crnk.angle'; did you mean 'crank.angle'? [invalid-value]\n")
    assert command(*told, "--plot", "pivot.*")[0] == 0


def test_models_and_scenes_are_listed(command: Command) -> None:
    code, out, _ = command("scenes")
    assert code == 0
    assert re.search(r"^fourbar/paper +hybrid +1e-4 +10 s +Kim and Kim's settings", out, re.MULTILINE)
    assert re.search(r"^sheet/default +ida +1e-5 +0\.5 s +default values$", out, re.MULTILINE)
    assert "governor" not in command("scenes", "fourbar")[1]
    out = command("models", "fourbar")[1]
    for title in ("Parameters", "Settings of the solver", "Outputs", "Scenes"):
        assert f"\n{title}\n" in out
    assert "at least 0.001 m" in out
    assert load_scene("fourbar/default").settings == load_scene("fourbar").settings


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
