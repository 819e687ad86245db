"""``mbfmu runtime``."""

from __future__ import annotations

import argparse

from mbfmu.util.errors import UserError

from .common import Commands, print_if_verbose, print_unless_quiet


def add(commands: Commands) -> None:
    """Describe ``mbfmu runtime``."""
    p = commands.add_parser(
        "runtime",
        help="build the runtime library of native FMUs",
        description="A native FMU (`mbfmu export --native`) consists of the data of the model and of a runtime "
        "library, "
        "which is the same for all models. The library for this machine is built by the first native export. `mbfmu "
        "runtime build` builds it now, also for other platforms, which requires `pip install mbfmu[native]`. Without "
        "`build` the command lists the libraries that exist.",
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
    from mbfmu.native.runtime import cached_library, library, pack
    from mbfmu.native.sundials_files import libraries
    from mbfmu.native.targets import TARGETS, host

    if options.what is None:
        if options.platforms or options.pack:
            raise UserError("--platforms and --pack are options of `mbfmu runtime build` only; leave them out")
        for name in TARGETS:
            path = cached_library(name)
            print(f"{name}: {path if path else 'not built'}")
        return 0
    for name in options.platforms or [host()]:
        if not name:
            raise UserError(
                f"no runtime can be built for this machine; use --platforms with one of {', '.join(TARGETS)}"
            )
        path = pack(name) if options.pack else library(name)
        print_unless_quiet(options, f"{name}: {path}")
        print_if_verbose(options, f"{path.stat().st_size / 1e3:.0f} kB")
        try:
            libraries(name)  # downloaded now, so that a later export needs no network
        except UserError as error:
            print_unless_quiet(options, f"{name}: {error}")
    return 0
