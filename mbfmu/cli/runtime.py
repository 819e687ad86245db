"""``mbfmu runtime``."""

from __future__ import annotations

import argparse

from mbfmu.errors import UserError

from .common import Commands, show, show_more


def add(commands: Commands) -> None:
    """Describe ``mbfmu runtime``."""
    p = commands.add_parser(
        "runtime",
        help="build the machine code that native FMUs run by",
        description="A native FMU (`mbfmu export --native`) is a model as data and a runtime, a library of machine "
        "code that is the same for all models. The one for this machine is built by the first export that needs it; "
        "this command builds it beforehand, or those of other machines, which takes `pip install mbfmu[native]`. "
        "Without `build` it says which are there.",
        epilog="examples:\n  mbfmu runtime\n  mbfmu runtime build\n"
        "  mbfmu runtime build --platforms x86_64-linux x86_64-windows aarch64-linux\n",
    )
    p.add_argument("what", nargs="?", choices=("build",), help="build what is not there yet, in minutes")
    add_platforms(p, "build for these machines; for this one without it")
    p.add_argument(
        "--pack",
        action="store_true",
        help="put them into the package too, so that a wheel that is built from it brings them along",
    )
    p.set_defaults(command=command_runtime)


def add_platforms(p: argparse.ArgumentParser, about: str) -> None:
    """Add ``--platforms``."""
    from mbfmu.native.targets import TARGETS

    names = tuple(TARGETS)
    p.add_argument(
        "--platforms", nargs="+", choices=names, default=[], metavar="NAME", help=f"{about}: {', '.join(names)}"
    )


def command_runtime(options: argparse.Namespace) -> int:
    """Build runtimes, or list them."""
    from mbfmu.native.runtime import library, pack, there
    from mbfmu.native.targets import TARGETS, host

    if options.what is None:
        if options.platforms or options.pack:
            raise UserError("--platforms and --pack go with `mbfmu runtime build`")
        for name in TARGETS:
            path = there(name)
            print(f"{name}: {path if path else 'not built'}")
        return 0
    for name in options.platforms or [host()]:
        if not name:
            raise UserError(
                f"this machine is none of those that can be built for; give --platforms: {', '.join(TARGETS)}"
            )
        path = pack(name) if options.pack else library(name)
        show(options, f"{name}: {path}")
        show_more(options, f"{path.stat().st_size / 1e3:.0f} kB")
    return 0
