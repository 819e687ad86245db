"""Guards against faults of PythonFMU 0.7.0's native wrapper."""

from __future__ import annotations

import ctypes
import sys
from pathlib import Path

WRAPPER = "pythonfmu-export.so"  # PythonFMU's library if it is behind the front of an FMU, in the same folder

_guarded: set[str] = set()  # libraries
_folders: set[str] = set()  # resources


def finalize_at_exit(resources: str | None, identifier: str) -> None:
    """Let the wrapper end its interpreter as the first thing that happens when the process ends.

    It holds the interpreter in a static pointer. When the process ends the pointer is destroyed, which ends Python, and
    then the library's destructor resets it once more: it writes into memory that has been freed, and the host aborts
    with its results complete. What is registered last at exit comes first: the pointer is reset while all libraries
    are loaded, and nothing is left to do for the others. An importing tool without Python and one that is written in
    Python need the same. The front of an FMU does this itself.
    """
    if resources is None:
        return
    library = Path(resources).parent / "binaries" / "linux64" / f"{identifier}.so"
    if str(library) in _guarded or not library.is_file() or (library.parent / WRAPPER).is_file():
        return
    _guarded.add(str(library))
    wrapper = ctypes.CDLL(str(library))  # loaded by the host: a second reference, which keeps it beyond its unloading
    ctypes.CDLL(None).__cxa_atexit(wrapper.finalizePythonInterpreter, None, None)


def import_once(resources: str | None) -> None:
    """Keep one of the entries that the wrapper puts before ``sys.path``, one more with every instance, and none of
    folders that have gone since.
    """
    if resources is not None:
        _folders.add(resources)
        gone = {folder for folder in _folders if not Path(folder).is_dir()}
        sys.path[:] = [resources, *(place for place in sys.path if place not in gone | {resources})]
        _folders.difference_update(gone)
