"""The libraries of SUNDIALS that a native FMU contains, and their license.

They are copies of those that scikit-sundae brings along. So a native FMU and a simulation in Python run the same
machine code of IDA.
"""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from mbfmu.util.errors import UserError

from .targets import TARGETS, host

SUNDIALS_SOLVERS = ("ida",)  # solvers that call SUNDIALS
PACKAGE = "scikit-sundae"  # which brings the libraries along
# in the order of loading
LIBRARIES = ("core", "nvecserial", "sunmatrixdense", "sunlinsoldense", "sunlinsolspgmr", "ida")


def libraries(target: str) -> dict[str, bytes]:
    """Return the libraries of SUNDIALS for a target, by the names of their files.

    Raises
    ------
    UserError
        They are not installed here.
    """
    found = {path.name: path.read_bytes() for path in _installed() if target == host()}
    beginning = "sundials_" if TARGETS[target].suffix == ".dll" else "libsundials_"
    if sorted(_library_of(name, beginning) for name in found) != sorted(LIBRARIES):
        raise UserError(
            f"solver 'ida' needs the libraries of SUNDIALS for {target}, but {PACKAGE} is installed here for "
            f"{host() or 'another machine'} only; export for {host() or 'that machine'}, or use the solver 'radau'",
            "not-native",
        )
    return found


def _installed() -> list[Path]:
    """Return the paths of the libraries that are installed here."""
    try:
        files = distribution(PACKAGE).files or ()
    except PackageNotFoundError:
        return []
    paths = (Path(str(file.locate())) for file in files)
    return [path for path in paths if _library_of(path.name, "") in LIBRARIES and path.is_file()]


def _library_of(name: str, beginning: str) -> str:
    """Return which library of SUNDIALS a file is by its name, such as libsundials_core-943007ef.so.7.9.0."""
    stem = name.removeprefix("lib")
    known = name.startswith(beginning) and stem.startswith("sundials_")
    return stem.removeprefix("sundials_").split("-")[0].split(".")[0] if known else ""


def license_text() -> str:
    """Return the license of SUNDIALS, which scikit-sundae brings along.

    Raises
    ------
    UserError
        It is not there.
    """
    for file in distribution(PACKAGE).files or ():
        if file.name == "LICENSES_bundled":
            entries, title, conditions = file.read_text("utf-8").partition("BSD-3-Clause License\n")
            for entry in entries.split("\n\n"):
                if entry.lstrip().startswith("Name: SUNDIALS"):
                    return f"{entry.strip()}\n\n{title}{conditions}"
    raise UserError(f"package {PACKAGE!r} is installed without the license of SUNDIALS; install it again")
