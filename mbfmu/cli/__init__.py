"""The command ``mbfmu``: one module a subcommand."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

import mbfmu
from mbfmu.errors import UserError
from solvers.compiled.cache import when_compiling

from . import cache, compare, effects, equilibrium, export, linearize, models, modes, run, view

COMMANDS = (run, view, export, equilibrium, linearize, modes, effects, compare, models, cache)

EXAMPLES = """examples:
  mbfmu run fourbar                        export the FMU, run it through FMPy, write CSV and PNG
  mbfmu run fourbar --solver adams --native
  mbfmu run fourbar/paper                  a scene that ships with a model
  mbfmu run my_scene.toml
  mbfmu view results/fourbar_ida.npz       3-D animation of that run, an HTML file for any browser
  mbfmu view governor/damped --gif governor.gif
  mbfmu export fourbar --set crank_length=0.8 -o fourbar.fmu
  mbfmu export my_model.py:MyModel
  mbfmu equilibrium governor               steady state at constant speed, and whether it is stable
  mbfmu equilibrium governor --sweep spindle_speed=5:20:0.5
  mbfmu linearize governor -o governor.npz state matrices about the steady state
  mbfmu modes sheet -n 8                   natural frequencies and shapes
  mbfmu effects sheet                      what each effect costs and changes
  mbfmu compare fourbar --json rows.json   what accuracy costs in time
  mbfmu models                             every model with its parameters
  mbfmu cache warm                         compile everything beforehand
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code: 0, 1 for a run that stopped early, 2 for a user's mistake."""
    options = parser().parse_args(arguments)
    try:
        with when_compiling(tell_compiling):
            return int(options.command(options))
    except UserError as error:
        print(f"mbfmu: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("mbfmu: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of a pipe, such as head, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except OSError as error:
        print(f"mbfmu: {error.filename or 'standard output'}: {error.strerror}", file=sys.stderr)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 2


def tell_compiling() -> None:
    """Say in a terminal why it takes long."""
    if sys.stderr.isatty():
        print("compiling, once on this machine: a minute or two", file=sys.stderr)


def parser() -> argparse.ArgumentParser:
    """Return the parser of all subcommands."""
    top = argparse.ArgumentParser(
        prog="mbfmu",
        description="Multibody mechanisms in relative coordinates, as FMUs.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("--version", action="version", version=f"mbfmu {mbfmu.__version__}")
    commands = top.add_subparsers(required=True, metavar="COMMAND")
    for module in COMMANDS:
        module.add(commands)
    return top
