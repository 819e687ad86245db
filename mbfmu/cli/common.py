"""What several commands share: arguments that change a scene, folders and files for results."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tqdm import tqdm

from mbfmu.errors import UserError
from mbfmu.scene import Scene, load_scene
from solvers import SOLVERS

Commands = Any  # argparse's collection of subparsers, whose class is private


def add_set(p: argparse.ArgumentParser) -> None:
    """Add ``--set``."""
    p.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="change a parameter")


def add_solver(p: argparse.ArgumentParser) -> None:
    """Add what changes a scene's solver."""
    p.add_argument("--solver", metavar="NAME", help=f"one of {', '.join(SOLVERS)} (default ida)")
    p.add_argument("--partition", metavar="NAME", help="of adams: projection, lu or hybrid")
    p.add_argument("--tolerance", type=float, metavar="RTOL", help="relative tolerance (default 1e-6)")
    p.add_argument(
        "--absolute-tolerance", type=float, metavar="ATOL", help="in units of each coordinate; 0: the relative one"
    )
    p.add_argument("--max-step", type=float, metavar="S", help="largest step, s; 0: no limit")
    p.add_argument("--max-order", type=int, metavar="K", help="largest order; 0: the solver's own, 12, of ida 5")
    p.add_argument("--max-steps", type=int, metavar="N", help="most steps between two outputs (default 100000)")
    p.add_argument(
        "--start-at-equilibrium", action="store_true", default=None, help="start in the steady state next to the start"
    )
    p.add_argument(
        "--no-audit", dest="audit", action="store_false", default=None, help="do not hold the energy against the work"
    )


def add_output(p: argparse.ArgumentParser, what: str) -> None:
    """Add ``-o`` for a folder."""
    p.add_argument("-o", "--output", type=Path, default=Path("results"), metavar="DIR", help=f"folder for {what}")


def add_steady(p: argparse.ArgumentParser) -> None:
    """Add the model whose steady state is asked for, and where to look for it."""
    p.add_argument("scene", metavar="model", help="model name, scene, or my_model.py:MyModel")
    add_set(p)
    p.add_argument(
        "--from",
        dest="start",
        action="append",
        default=[],
        metavar="COORDINATE=VALUE",
        help="start Newton here instead of at the model's start (rad or m); may be repeated",
    )


def start_of(options: argparse.Namespace) -> dict[str, float]:
    """Return the coordinates given by ``--from``."""
    return {name: number("--from", value) for name, value in assignments("--from", options.start).items()}


def assignments(option: str, texts: list[str]) -> dict[str, str]:
    """Return names and values of repeated ``NAME=VALUE``."""
    values = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise UserError(f"{option} {text!r}: write NAME=VALUE")
        values[name.strip()] = value.strip()
    return values


def number(option: str, text: str) -> float:
    """Read a number."""
    try:
        return float(text)
    except ValueError as error:
        raise UserError(f"{option}: {text!r} is not a number") from error


def scene_of(options: argparse.Namespace) -> Scene:
    """Return the scene with the command line's changes."""
    scene = load_scene(options.scene)
    return scene.changed(
        model=scene.model.with_values(assignments("--set", options.set)),
        solver=getattr(options, "solver", None),
        partition=getattr(options, "partition", None),
        tolerance=getattr(options, "tolerance", None),
        absolute_tolerance=getattr(options, "absolute_tolerance", None),
        max_step=getattr(options, "max_step", None),
        max_order=getattr(options, "max_order", None),
        max_steps=getattr(options, "max_steps", None),
        inputs=getattr(options, "inputs", None),
        start_at_equilibrium=getattr(options, "start_at_equilibrium", None),
        audit=getattr(options, "audit", None),
        stop_time=getattr(options, "stop_time", None),
        output_interval=getattr(options, "interval", None),
    )


def stem_of(scene: Scene) -> str:
    """Return how the files of a run are named: no solver replaces what another one found."""
    return f"{scene.name}_{scene.settings.name}"


def files_of(target: Path, stem: str) -> tuple[Path, Path, Path]:
    """Return the files of a run, CSV, PNG and poses; complain of folders in their places before anything is run."""
    csv, png, poses = (target / f"{stem}.{kind}" for kind in ("csv", "png", "npz"))
    for path in (csv, png, poses):
        if path.is_dir():
            raise UserError(f"{str(path)!r} cannot be written: it is a folder")
    return csv, png, poses


@contextmanager
def writing(target: Path) -> Iterator[None]:
    """Say in words what cannot be written into a folder."""
    try:
        yield
    except OSError as error:
        raise UserError(f"{str(error.filename or target)!r} cannot be written: {error.strerror}") from error


@contextmanager
def progress(scene: Scene) -> Iterator[Callable[[float], None]]:
    """Show a bar on a terminal while a scene runs; gives what is to be called with the time reached."""
    with tqdm(total=scene.stop_time, unit="s", desc=scene.name, leave=False, disable=not sys.stderr.isatty()) as bar:
        yield lambda t: bar.update(t - bar.n)


def folder(path: Path) -> Path:
    """Make the folder for results."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"folder {str(path)!r} cannot be made: {error.strerror}") from error
    return path


def writable(path: Path) -> None:
    """Complain of a file that cannot be written before anything is run for it; ``-`` is standard output."""
    try:
        if str(path) != "-":
            path.open("a").close()
    except OSError as error:
        raise UserError(f"{str(path)!r} cannot be written: {error.strerror}") from error


def write_json(content: Any, path: Path) -> None:
    """Write JSON to a file, or to standard output for ``-``."""
    text = json.dumps(content, indent=1) + "\n"
    if str(path) == "-":
        sys.stdout.write(text)
        return
    try:
        path.write_text(text)
    except OSError as error:
        raise UserError(f"{str(path)!r} cannot be written: {error.strerror}") from error
