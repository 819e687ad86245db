"""The command ``mbfmu``: one module a subcommand."""
# PYTHON_ARGCOMPLETE_OK

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Sequence
from typing import NoReturn

import argcomplete

import mbfmu
from mbfmu.session.interrupts import termination_raised
from mbfmu.util.errors import RENAMED, UserError, shorten

from . import (
    cache,
    check,
    compare,
    effects,
    equilibrium,
    export,
    imports,
    linearize,
    models,
    modes,
    path,
    run,
    runtime,
    scenes,
    ssp,
    study,
    verify,
    view,
)
from .compiling import report_compilation
from .completion import COMPLETION_COMMAND

COMMANDS = (
    run,
    check,
    view,
    export,
    ssp,
    imports,
    equilibrium,
    path,
    linearize,
    modes,
    effects,
    compare,
    study,
    verify,
    models,
    scenes,
    runtime,
    cache,
)

COMMAND_EXAMPLES = f"""examples:
  mbfmu run fourbar                        simulate a model through its FMU; write CSV and pictures
  mbfmu run fourbar --solver adams --direct
  mbfmu run fourbar/paper                  a scene that is part of a model
  mbfmu run my_scene.toml
  mbfmu check fourbar                      numerical difficulties of a model, and a suitable solver
  mbfmu view governor/damped               3-D animation of a run as an HTML file
  mbfmu export fourbar --set crank_length=0.8 -o fourbar.fmu
  mbfmu export fourbar --python            FMU that calls Python
  mbfmu export my_model.py:MyModel
  mbfmu import robot.urdf -o robot.py      a model from a URDF or MJCF file
  mbfmu ssp governor --with engine=engine.fmu --connect engine.shaft_torque=governor.spindle.torque
                                           the model and other FMUs as one connected system (SSP)
  mbfmu equilibrium governor               steady state at constant speed, with its stability
  mbfmu equilibrium governor --sweep spindle_speed=5:20:0.5
  mbfmu path governor --over spindle.drive=5:20
                                           steady states over a load or a speed, past limit points
  mbfmu linearize governor                 state matrices at the steady state
  mbfmu modes sheet -n 8                   natural frequencies and mode shapes
  mbfmu effects sheet                      cost and influence of the optional effects of a model
  mbfmu compare fourbar                    accuracy and CPU time of the solvers
  mbfmu compare fourbar --target 1e-6      recommended solver and tolerance for a required accuracy
  mbfmu study tolerances.toml              Monte Carlo, sweeps and sensitivity, on this machine or a cluster
  mbfmu verify --quick                     problems of the literature: is every result right
  mbfmu models governor                    all variables of a model, and its scenes
  mbfmu cache warm                         compile everything now

Warnings and errors end in a code such as [energy-balance]; see the page "Warnings and errors" of the documentation.

The exit code is 0 for success, 1 for a run (`run`, `check`) that ended early or whose energy error is too large and for
a wrong result of `verify`, 2 for an invalid argument, and 130 after Ctrl-C.

For completion of commands, models, scenes, parameters and solvers in the shell, add this line to ~/.bashrc or ~/.zshrc:
  {COMPLETION_COMMAND}
"""


class Parser(argparse.ArgumentParser):
    """A parser whose messages are short, whatever was given."""

    def error(self, message: str) -> NoReturn:
        """Print how the command is used and what is wrong, and end with exit code 2."""
        words = re.findall(r"--(?:no-)?([a-z-]+)", message)
        renamed = {word: RENAMED[name] for word in words if (name := word.replace("-", "_")) in RENAMED}
        hints = [f"; {old!r} is now called {new.replace('_', '-')!r}" for old, new in renamed.items()]
        super().error(shorten(message) + "".join(hints))


class Formatter(argparse.HelpFormatter):
    """Keeps text that comes in lines as it is, and wraps other text."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return text if "\n" in text else super()._fill_text(text, width, indent)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code: 0, 1 for a run that stopped early, 2 for a user's mistake."""
    described = parser()
    argcomplete.autocomplete(described)
    options = described.parse_args(arguments)
    try:
        with termination_raised(), report_compilation(reported=options.verbose or not options.quiet):
            return int(options.command(options))
    except UserError as error:
        print(f"mbfmu: {shorten(str(error))}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("mbfmu: interrupted; unfinished results are deleted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of a pipe, such as head, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except OSError as error:
        print(f"mbfmu: {error.filename or 'standard output'}: {error.strerror}", file=sys.stderr)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 2


def parser() -> argparse.ArgumentParser:
    """Return the parser of all subcommands."""
    top = Parser(
        prog="mbfmu",
        description="Simulation of multibody mechanisms, and their export as FMUs.",
        epilog=COMMAND_EXAMPLES,
        formatter_class=Formatter,
    )
    top.add_argument("--version", action="version", version=f"mbfmu {mbfmu.__version__}")
    top.set_defaults(quiet=False, verbose=False)
    add_verbosity(top)
    commands = top.add_subparsers(required=True, metavar="COMMAND")
    for module in COMMANDS:
        module.add(commands)
    for command in commands.choices.values():
        command.formatter_class = Formatter
        add_verbosity(command)
    return top


def add_verbosity(p: argparse.ArgumentParser) -> None:
    """Add ``-q`` and ``-v``, which may stand before or after the subcommand."""
    either = p.add_mutually_exclusive_group()
    for letter, name, about in (
        ("-q", "--quiet", "print only the paths of written files, and errors"),
        ("-v", "--verbose", "print details, such as all settings, statistics of the solver, and compilation"),
    ):
        either.add_argument(letter, name, action="store_true", default=argparse.SUPPRESS, help=about)
