"""The command ``mbfmu``: one module a subcommand, which is loaded if the subcommand is given."""
# PYTHON_ARGCOMPLETE_OK

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Container, Sequence
from importlib import import_module
from typing import NoReturn

import argcomplete

import mbfmu
from mbfmu.session.interrupts import termination_raised
from mbfmu.util.errors import RENAMED, UserError, shorten

COMPLETION_COMMAND = 'eval "$(register-python-argcomplete mbfmu)"'  # in ~/.bashrc or ~/.zshrc

# name of a command: its module and what it does; a module is loaded if the command is given
COMMANDS = {
    "run": ("run", "run a scene or a model and write its outputs, pictures and motion"),
    "check": ("check", "report numerical difficulties of a scene and recommend a solver"),
    "view": ("view", "3-D animation of a run: an HTML file for any browser, glTF, PNG, GIF or MP4"),
    "export": ("export", "export a model as an FMU, or as an MJCF or URDF file"),
    "ssp": ("ssp", "export a model with other FMUs as one connected system (SSP)"),
    "import": ("imports", "write a model from a URDF or MJCF file"),
    "equilibrium": ("equilibrium", "steady state at constant drive speed, or at rest, with its stability"),
    "path": ("path", "follow the equilibrium over a load or another input, past limit points (snap-through, buckling)"),
    "linearize": ("linearize", "state matrices at a steady state"),
    "modes": ("modes", "natural frequencies, damping and mode shapes at a steady state"),
    "effects": ("effects", "cost and influence of each optional effect of a model"),
    "compare": ("compare", "compare accuracy and CPU time of the solvers, or recommend one for a required accuracy"),
    "study": ("study", "Monte Carlo, parameter sweeps, sensitivity and optimization"),
    "verify": ("verify", "verify this installation by problems with known solutions"),
    "models": ("models", "list the models and their parameters, or all variables of a model"),
    "scenes": ("scenes", "list the scenes of the models"),
    "runtime": ("runtime", "build the runtime libraries of native FMUs"),
    "cache": ("cache", "compile all kernels now, or remove compiled code"),
}

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
    given = sys.argv[1:] if arguments is None else list(arguments)
    try:
        described = parser({*given, *os.environ.get("COMP_LINE", "").split()})
        argcomplete.autocomplete(described)
        options = described.parse_args(given)
        from .compiling import report_compilation  # loads numba

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


def parser(words: Container[str] = COMMANDS) -> argparse.ArgumentParser:
    """Return the parser of all subcommands, with the arguments of those that are among the words of a command line."""
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
    for name, (module, about) in COMMANDS.items():
        if name in words:
            import_module(f".{module}", __package__).add(commands, about)
        else:
            commands.add_parser(name, help=about)
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
