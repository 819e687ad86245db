"""``mbfmu runtime``."""

from __future__ import annotations

import argparse

from mbfmu.util.errors import UserError

from .common import Commands, print_if_verbose, print_unless_quiet


def add(commands: Commands, about: str) -> None:
    """Describe ``mbfmu runtime``."""
    p = commands.add_parser(
        "runtime",
        help=about,
        description="A native FMU consists of the data of the model and of a runtime library, which is the same for "
        "all models that call the same code. The library for this machine is built by the first native export that "
        "needs it. `mbfmu runtime build` builds those of all solvers now, which serve all models, also for other "
        "platforms. Other platforms require zig (`pip install ziglang`). Without zig, pip downloads it (100 MB) for "
        "the build and removes it. Without `build` the command lists the families of solvers for which libraries "
        "exist.",
        epilog="examples:\n  mbfmu runtime\n  mbfmu runtime build\n"
        "  mbfmu runtime build --platforms x86_64-linux x86_64-windows aarch64-linux\n",
    )
    p.add_argument(
        "what", nargs="?", choices=("build",), help="build the libraries that do not exist yet; takes minutes"
    )
    add_platforms(p, "platforms to build for (default: this machine)")
    p.add_argument(
        "--pack",
        action="store_true",
        help="also copy the libraries into the package, so that wheels built from it include them",
    )
    p.set_defaults(command=command_runtime)


def add_platforms(parser: argparse.ArgumentParser, about: str) -> None:
    """Add ``--platforms``."""
    from mbfmu.native.targets import TARGETS

    names = tuple(TARGETS)
    parser.add_argument(
        "--platforms", nargs="+", choices=names, default=[], metavar="NAME", help=f"{about}: {', '.join(names)}"
    )


def command_runtime(options: argparse.Namespace) -> int:
    """Build runtimes, or list them."""
    from mbfmu.native.contents import complete
    from mbfmu.native.families import FAMILIES
    from mbfmu.native.runtime import build, cached_libraries, family_of_library, library, pack
    from mbfmu.native.sundials_files import libraries
    from mbfmu.native.targets import TARGETS, host

    if options.what is None:
        if options.platforms or options.pack:
            raise UserError("--platforms and --pack are options of `mbfmu runtime build` only; leave them out")
        for name in TARGETS:
            found = sorted(cached_libraries(name))
            families = dict.fromkeys(family_of_library(name, path) for path in found)
            print(f"{name}: {', '.join(families) if found else 'not built'}")
            for path in found:
                print_if_verbose(options, f"  {path}")
        return 0
    names = options.platforms or [host()]
    if not all(names):
        raise UserError(f"no runtime can be built for this machine; use --platforms with one of {', '.join(TARGETS)}")
    build(names, [complete(family) for family in FAMILIES])
    for name in names:
        for family in FAMILIES:
            path = pack(name, family) if options.pack else library(name, complete(family))
            print_unless_quiet(options, f"{name}, {family}: {path}")
            print_if_verbose(options, f"{path.stat().st_size / 1e3:.0f} kB")
        try:
            libraries(name)  # downloaded now, so that a later export needs no network
        except UserError as error:
            print_unless_quiet(options, f"{name}: {error}")
    return 0
