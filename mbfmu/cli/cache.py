"""``mbfmu cache``."""

from __future__ import annotations

import argparse

from mbfmu.modeling.registry import models
from mbfmu.modeling.scene import load_scene
from mbfmu.modeling.settings import AUTO, Settings
from mbfmu.session.simulation import Simulation
from mbfmu.steady.equilibrium import equilibrium
from mbfmu.util.errors import UserError
from solvers.compiled import cache, storage
from solvers.steppers import SOLVER_NAMES, drop_unlisted

from .common import Commands, bar, print_if_verbose
from .completion import complete, scene_names


def add(commands: Commands, about: str) -> None:
    """Describe ``mbfmu cache``."""
    p = commands.add_parser(
        "cache",
        help=about,
        description="Kernels are compiled when they are first needed. The machine code is kept in a cache folder "
        "and used by "
        "all environments with the same versions of mbfmu and numba. Without an argument the command prints the folder "
        "and its size.",
        epilog="examples:\n  mbfmu cache\n  mbfmu cache warm fourbar governor\n  mbfmu cache clear --old\n",
    )
    p.add_argument(
        "what",
        nargs="?",
        choices=("warm", "clear"),
        help="warm: compile everything that the models need; clear: remove the machine code, but no other files in "
        "its folder",
    )
    p.add_argument(
        "--old",
        action="store_true",
        help="with clear: remove only the machine code of other versions of mbfmu or numba, such as those of other "
        "environments or checkouts",
    )
    named = p.add_argument(
        "scenes", metavar="model", nargs="*", help="model or scene to compile for (default: all models)"
    )
    complete(named, scene_names)
    p.set_defaults(command=command_cache)


def command_cache(options: argparse.Namespace) -> int:
    """Report on the machine code, compile it or remove it."""
    if options.old and options.what != "clear":
        raise UserError("--old is an option of `mbfmu cache clear` only; leave it out")
    if options.what == "warm":
        warm(options.scenes or sorted(models()), options)
    elif options.what == "clear":
        if options.scenes:
            raise UserError(f"`mbfmu cache clear` removes the code of all models; leave out {options.scenes[0]!r}")
        clear(keep_current=options.old)
    folders = storage.find_code_folders()
    print(f"{cache.cache_root()}: {in_megabytes(sum(folder.size for folder in folders))} of machine code")
    if old := sum(folder.size for folder in folders if not folder.is_current):
        print(
            f"{in_megabytes(old)} of it is from other versions of mbfmu or numba; `mbfmu cache clear --old` removes it"
        )
    return 0


def clear(*, keep_current: bool) -> None:
    """Remove machine code; print how much that was, and what is left because it is none.

    Raises
    ------
    UserError
        A file cannot be removed.
    """
    removed = storage.clear(keep_current=keep_current)
    print(f"removed {removed.files} files of machine code, {in_megabytes(removed.size)}")
    if foreign := storage.find_foreign():
        print(f"left {len(foreign)} other files in {cache.cache_root()}, such as {foreign[0]}")
    if removed.failures:
        path, reason = removed.failures[0]
        raise UserError(f"{len(removed.failures)} files cannot be removed, such as {str(path)!r}: {reason}")


def in_megabytes(size: int) -> str:
    """Return a number of bytes as text."""
    return f"{size / 1e6:.0f} MB"


def warm(references: list[str], options: argparse.Namespace) -> None:
    """Start every model under every solver that it can have, look for a steady state, and about it; check it."""
    from mbfmu.studies.check import check

    chosen = [load_scene(reference).model for reference in references]
    runs = [(model, solver) for model in chosen for solver in (*drop_unlisted(SOLVER_NAMES), "equilibrium", "check")]
    for model in chosen:
        model.compile()  # a model that cannot be built is reported, and not skipped
    with bar(len(runs), "warm", options.quiet, "run") as shown:
        for model, solver in runs:
            shown.set_description(f"{model.name} {solver}")
            shown.update()
            print_if_verbose(options, f"{model.name} {solver}")
            try:
                if solver == "equilibrium":
                    equilibrium(model).shapes(1)
                elif solver == "check":
                    check(model, 1e-4 * model.stop_time, solver=AUTO)
                else:
                    Simulation(model, Settings(solver=solver))
            except UserError:
                continue  # not for this model
