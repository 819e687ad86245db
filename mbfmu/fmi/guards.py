"""Guards against faults of PythonFMU 0.7.0's native wrapper."""

from __future__ import annotations

import atexit
import ctypes
import sys
from pathlib import Path

_guarded: set[str] = set()


def finalize_at_exit(resources: str | None, identifier: str) -> None:
    """Tear the wrapper's interpreter state down while Python still runs.

    Left alone, its library resets a freed pointer when it unloads, and the host aborts at exit with its results
    complete. Only where Python is the host: an embedded interpreter is torn down by the wrapper itself.
    """
    if resources is None or not sys.orig_argv:
        return
    library = Path(resources).parent / "binaries" / "linux64" / f"{identifier}.so"
    if str(library) in _guarded or not library.is_file():
        return
    _guarded.add(str(library))
    handle = ctypes.CDLL(str(library))  # already loaded by the host: a second reference keeps it until exit
    atexit.register(handle.finalizePythonInterpreter)
