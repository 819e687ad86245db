"""What several commands share: arguments that change a scene, names of files, what is printed."""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tqdm import tqdm

from mbfmu.modeling.parameters import Parameter, declared
from mbfmu.modeling.replaced_inputs import check_run, describe, read_value
from mbfmu.modeling.scene import SETTING_NAMES, Scene, load_scene
from mbfmu.modeling.settings import Settings, offered_solvers
from mbfmu.session.run import check_interval
from mbfmu.util.errors import UserError
from mbfmu.util.files import check_writable, write_text
from mbfmu.util.text_table import format_tolerance

from .completion import complete, parameter_names, scene_names

Commands = Any  # argparse's collection of subparsers, whose class is private
EXISTING_FOLDER_TEXT = "An existing folder is kept; the new one gets the suffix -2, -3, ..."
RESULTS_FOLDER = Path("results")  # where results go that are sent nowhere else
MAX_NAME_LENGTH = 80  # characters of a model's or a scene's name in that of a folder
METAVARS = {"s": "S"}  # what stands for a value, by its unit


def add_set(parser: argparse.ArgumentParser) -> None:
    """Add ``--set``."""
    given = parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="value of a parameter of the model, as in --set crank_mass=2; may be repeated",
    )
    complete(given, parameter_names)


def add_input(parser: argparse.ArgumentParser) -> None:
    """Add ``--input``."""
    parser.add_argument(
        "--input",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="signal that replaces an input of the model: a number or an expression of the time t (s), in the unit of "
        "the input, such as --input 'force=10*sin(30*t)'; or a CSV or Parquet file whose first column is the time, "
        "such as --input road.height=road.csv, followed by the name of a column if necessary (road.csv:left). Loads "
        "are interpolated linearly, positions of joints by a spline. FMUs do not have this input. May be repeated",
    )


def add_solver(parser: argparse.ArgumentParser) -> None:
    """Add every setting: what is not given stays as the scene has it."""
    group = parser.add_argument_group(
        "settings",
        "Settings not given here are those of the scene or the model; the defaults shown apply to most models.",
    )
    for setting in declared(Settings):
        option = f"--{setting.name.replace('_', '-')}"
        about = f"{setting.doc} (default {default_text(setting)})".replace("%", "%%")
        if isinstance(setting.default, bool):
            group.add_argument(option, action=argparse.BooleanOptionalAction, help=about)
        elif setting.choices:
            words = offered_solvers() if setting.name == "solver" else setting.listed_choices
            named = group.add_argument(option, metavar="NAME", help=f"{about}: {', '.join(words)}")
            complete(named, list(words))
        else:
            kind, metavar = (int, "N") if isinstance(setting.default, int) else (float, METAVARS.get(setting.unit, "X"))
            group.add_argument(option, type=reader(kind), metavar=metavar, help=about)


def default_text(setting: Parameter) -> str:
    """Return the default of a setting for people."""
    default = setting.default
    if isinstance(default, bool):
        return "yes" if default else "no"
    if isinstance(default, float):
        return format_tolerance(default) if 0.0 < default < 1e-3 else f"{default:g}"
    return str(default)


def reader(kind: type[float]) -> Callable[[str], float]:
    """Return what reads a number of this kind from the command line."""

    def read(text: str) -> float:
        try:
            return kind(text)
        except ValueError as error:
            what = "a whole number" if kind is int else "a number"
            raise argparse.ArgumentTypeError(f"{text!r} is not {what}") from error

    return read


def add_times(parser: argparse.ArgumentParser, stop: str, interval: str) -> None:
    """Add the end of a run and the time between its outputs, with what each is."""
    parser.add_argument("--stop-time", type=reader(float), metavar="S", help=f"{stop}, s")
    parser.add_argument("--interval", type=reader(float), metavar="S", help=f"{interval}, s")


def add_scene(parser: argparse.ArgumentParser) -> None:
    """Add the scene that a command works on."""
    given = parser.add_argument(
        "scene", help="a model (fourbar), one of its scenes (fourbar/paper), a scene file, or my_model.py:MyModel"
    )
    complete(given, scene_names)


def add_output(parser: argparse.ArgumentParser, what: str) -> None:
    """Add ``-o`` for the folder of all results."""
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=RESULTS_FOLDER,
        metavar="DIR",
        help=f"write the folder DIR/{what} (DIR: {RESULTS_FOLDER}). {EXISTING_FOLDER_TEXT}",
    )


def add_fmu_kind(parser: argparse.ArgumentParser) -> None:
    """Add ``--python`` and ``--native``."""
    either = parser.add_mutually_exclusive_group()
    about = "export an FMU that calls Python, also if a native FMU is possible"
    either.add_argument("--python", action="store_true", help=about)
    either.add_argument("--native", action="store_true", help="report an error if a native FMU is not possible")


def add_json(parser: argparse.ArgumentParser) -> None:
    """Take a file for all that is found."""
    parser.add_argument(
        "--json",
        type=Path,
        nargs="?",
        const=Path("-"),
        metavar="FILE",
        help="write all results as JSON; to standard output without FILE",
    )


def add_steady(parser: argparse.ArgumentParser) -> None:
    """Add the model whose steady state is computed, and the start of the search."""
    add_scene(parser)
    add_set(parser)
    add_input(parser)
    parser.add_argument(
        "--from",
        dest="start",
        action="append",
        default=[],
        metavar="COORDINATE=VALUE",
        help="start the search exactly at this coordinate, not at the start of the model, as in --from arm1=0.8 (rad "
        "or m); may "
        "be repeated",
    )


def start_of(options: argparse.Namespace) -> dict[str, float]:
    """Return the coordinates given by ``--from``."""
    return {name: number("--from", value) for name, value in assignments("--from", options.start).items()}


def assignments(option: str, texts: list[str]) -> dict[str, str]:
    """Return names and values of repeated ``NAME=VALUE``, each name once."""
    values: dict[str, str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise UserError(f"{option} {text!r}; allowed: NAME=VALUE")
        if name.strip() in values:
            raise UserError(
                f"{option} {text!r}: {name.strip()} is given twice, before as {values[name.strip()]}; allowed: "
                "one value"
            )
        values[name.strip()] = value.strip()
    return values


def number(option: str, text: str) -> float:
    """Read a number."""
    try:
        return float(text)
    except ValueError as error:
        raise UserError(f"{option}: {text!r} is not a number; give a number such as 0.5 or 1e-3") from error


def scene_of(options: argparse.Namespace) -> Scene:
    """Return the scene with the command line's changes."""
    scene = load_scene(options.scene)
    changed = scene.changed(
        model=scene.model.with_values(assignments("--set", options.set)),
        **{name: getattr(options, name, None) for name in SETTING_NAMES},
        stop_time=getattr(options, "stop_time", None),
        output_interval=getattr(options, "interval", None),
    )
    given = assignments("--input", getattr(options, "input", []))
    if given:
        values = {name: read_value(name, text) for name, text in given.items()}
        changed = changed.changed(model=changed.model.with_inputs(values))
    check_run(changed.model, changed.stop_time, changed.settings.tolerance)
    if getattr(options, "interval", None) is not None:
        check_interval(changed.stop_time, changed.output_interval)
    return changed


def scene_part(scene: Scene) -> str:
    """Return the name of a scene without its model's, for the name of a file."""
    return file_name(scene.name.removeprefix(f"{scene.model.name}/"))


def run_part(scene: Scene, given: Sequence[str] = ()) -> str:
    """Return the name of the folder of a run: its scene, solver and tolerance, and the values of ``--set``."""
    name = f"{scene_part(scene)}-{scene.settings.solver}-{format_tolerance(scene.settings.tolerance)}"
    changes = file_name(",".join(f"{key}={value}" for key, value in assignments("--set", list(given)).items()))
    return f"{name}-{changes}" if given else name


def file_stem(scene: Scene, given: Sequence[str] = ()) -> str:
    """Return the name of the files of a run, so that no run replaces what one of other settings found."""
    return f"{file_name(scene.model.name)}/{run_part(scene, given)}"


def file_name(text: str) -> str:
    """Return text as a name that every file system takes."""
    return re.sub(r"[^\w .,+=-]", "_", text)[:MAX_NAME_LENGTH].strip(" .") or "unnamed"


@contextmanager
def progress(scene: Scene, quiet: bool = False) -> Iterator[Callable[[float], None]]:
    """Show a bar on a terminal while a scene runs; gives what is to be called with the time reached."""
    with bar(scene.stop_time, scene.name, quiet, "s") as shown:
        yield lambda t: shown.update(t - shown.n)


def bar(total: float, what: str, quiet: bool, unit: str = "it") -> Any:
    """Return a bar on a terminal; none shows where nobody looks or wants one."""
    return tqdm(total=total, unit=unit, desc=what, leave=False, disable=quiet or not sys.stderr.isatty())


def print_inputs(options: argparse.Namespace, scene: Scene) -> None:
    """Print the signals that replace inputs of the model."""
    for line in describe(scene.model.replaced_inputs):
        print_unless_quiet(options, line)


def print_unless_quiet(options: argparse.Namespace, text: str) -> None:
    """Print what ``-q`` leaves out."""
    if not options.quiet:
        print(text)


def print_if_verbose(options: argparse.Namespace, text: str) -> None:
    """Print what ``-v`` asks for."""
    if options.verbose:
        print(text)


def print_paths(options: argparse.Namespace, *paths: Path) -> None:
    """Print where results are: with ``-q`` the paths alone, which a script can read."""
    print("\n".join(map(str, paths)) if options.quiet else f"wrote {' and '.join(map(str, paths))}")


def folder(path: Path) -> Path:
    """Make the folder for results."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"folder {str(path)!r} cannot be created: {error.strerror}", "file-access") from error
    return path


def writable(path: Path) -> None:
    """Complain of a file that cannot be written before anything is run for it; ``-`` is standard output."""
    if str(path) != "-":
        check_writable(path)


def write_json(content: Any, path: Path) -> None:
    """Write JSON to a file, or to standard output for ``-``."""
    text = json.dumps(content, indent=1) + "\n"
    if str(path) == "-":
        sys.stdout.write(text)
    else:
        write_text(path, text)
