"""The libraries of SUNDIALS that a native FMU contains, and their license.

They are copies of those that scikit-sundae brings along. So a native FMU and a simulation in Python run the same
machine code of IDA.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from zipfile import ZipFile

from mbfmu.util.errors import UserError
from mbfmu.util.files import write_bytes
from mbfmu.util.processes import run_program
from solvers.compiled.cache import shared_cache_dir

from .targets import TARGETS, host

SUNDIALS_SOLVERS = ("ida",)  # solvers that call SUNDIALS
PACKAGE = "scikit-sundae"  # which brings the libraries along
# in the order of loading
LIBRARIES = ("core", "nvecserial", "sunmatrixdense", "sunlinsoldense", "sunlinsolspgmr", "ida")


# platforms of wheels by target; there is none for ARM64 Linux
WHEELS = {
    "x86_64-linux": ("manylinux2014_x86_64", "manylinux_2_28_x86_64"),
    "x86_64-windows": ("win_amd64",),
    "aarch64-darwin": ("macosx_11_0_arm64",),
    "x86_64-darwin": ("macosx_11_0_x86_64", "macosx_10_13_x86_64"),
}


def libraries(target: str) -> dict[str, bytes]:
    """Return the libraries of SUNDIALS for a target, by the names of their files.

    Those of another machine come from its wheel of the installed version, which pip downloads once.

    Raises
    ------
    UserError
        There are none for it, or they cannot be downloaded.
    """
    if target == host():
        found = {path.name: path.read_bytes() for path in _installed()}
        return _complete(target, found, f"package {PACKAGE!r} is installed without them; install it again")
    if target not in WHEELS:
        return _complete(target, {}, f"{PACKAGE} has none")
    folder = shared_cache_dir() / f"native-sundials-{_version()}-{target}"
    if not folder.is_dir():
        _download(target, folder)
    found = {path.name: path.read_bytes() for path in sorted(folder.iterdir())}
    return _complete(target, found, f"folder {str(folder)!r} is damaged; remove it")


def _complete(target: str, found: dict[str, bytes], why: str) -> dict[str, bytes]:
    """Return libraries that are complete; else raise UserError with the reason."""
    beginning = "sundials_" if TARGETS[target].suffix == ".dll" else "libsundials_"
    if sorted(_library_of(name, beginning) for name in found) != sorted(LIBRARIES):
        raise UserError(
            f"solver 'ida' needs the libraries of SUNDIALS for {target}: {why}. Use another solver, or leave out this "
            "platform",
            "not-native",
        )
    return found


def _version() -> str:
    """Return the version of scikit-sundae, whose libraries every platform gets."""
    return distribution(PACKAGE).version


def _download(target: str, folder: Path) -> None:
    """Put the libraries of the wheel for a target into a folder, at once."""
    platforms = [word for name in WHEELS[target] for word in ("--platform", name)]
    with tempfile.TemporaryDirectory(prefix="mbfmu_") as work:
        command = [sys.executable, "-m", "pip", "download", "--only-binary=:all:", "--no-deps", "--dest", work]
        wanted = f"{PACKAGE}=={_version()}"
        _, errors = run_program([*command, *platforms, wanted])
        wheels, found = list(Path(work).glob("*.whl")), dict[str, bytes]()
        for wheel in wheels:
            with ZipFile(wheel) as archive:
                for name in archive.namelist():
                    if _library_of(Path(name).name, "") in LIBRARIES:
                        found[Path(name).name] = archive.read(name)
        last = errors[-1] if errors else "nothing was downloaded"
        why = f"the wheel of {wanted} has other files" if wheels else f"pip reports {last!r}"
        _complete(target, found, why)
    folder.parent.mkdir(parents=True, exist_ok=True)
    made = Path(tempfile.mkdtemp(dir=folder.parent))
    for name, data in found.items():
        write_bytes(made / name, data)
    try:
        made.rename(folder)
    except OSError:  # another process was faster
        shutil.rmtree(made)


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
