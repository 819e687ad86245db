"""The C functions of an FMU, called as they are: every argument that a host can pass, every status that comes back."""

from __future__ import annotations

import ctypes
import zipfile
from collections.abc import Sequence
from ctypes import byref, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from pathlib import Path
from typing import Any

from fmpy import read_model_description

from mbfmu.fmi.export import FmuKind, export_scene
from mbfmu.modeling import Model
from mbfmu.modeling.scene import Scene
from mbfmu.session.simulation import Settings

OK, WARNING, DISCARD, ERROR, FATAL = range(5)
TRUE = 1

LOGGER = ctypes.CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p)
ALLOCATE = ctypes.CFUNCTYPE(c_void_p, c_size_t, c_size_t)
RELEASE = ctypes.CFUNCTYPE(None, c_void_p)
FINISHED = ctypes.CFUNCTYPE(None, c_void_p, c_int)

KINDS: dict[str, Any] = {"Real": c_double, "Integer": c_int, "Boolean": c_int, "String": c_char_p}


def export_for_one_run(model: Model, path: Path, settings: Settings) -> Path:
    """Write a native FMU for co-simulation, with constant parameters: the rest takes half a minute to compile."""
    scene = Scene(name=model.name, model=model, settings=settings, stop_time=1.0, output_interval=0.1)
    assert export_scene(scene, path, FmuKind.ONE_RUN, falls_back=False) is FmuKind.ONE_RUN
    return path


class Callbacks(ctypes.Structure):
    """fmi2CallbackFunctions."""

    _fields_ = (
        ("logger", LOGGER),
        ("allocate", ALLOCATE),
        ("release", RELEASE),
        ("finished", FINISHED),
        ("environment", c_void_p),
    )


class Binary:
    """An FMU unzipped into a folder, with its library loaded; it stays so until the process ends."""

    def __init__(self, path: Path, folder: Path) -> None:
        zipfile.ZipFile(path).extractall(folder)
        self.description = read_model_description(str(path))
        identifier = self.description.coSimulation.modelIdentifier
        self.resources = (folder / "resources").as_uri()
        self.functions = ctypes.CDLL(str(folder / "binaries" / "linux64" / f"{identifier}.so"))
        self.functions.fmi2Instantiate.restype = c_void_p
        self.logged: list[tuple[int, str]] = []
        libc = ctypes.CDLL(None)
        libc.calloc.restype = c_void_p
        self._callbacks = Callbacks(
            LOGGER(self._log), ALLOCATE(libc.calloc), RELEASE(libc.free), FINISHED(lambda _e, _s: None), None
        )

    def _log(self, _environment: Any, _instance: bytes, status: int, _category: bytes, text: bytes) -> None:
        self.logged.append((status, text.decode()))

    def instantiate(self, *, logging: bool = True) -> Instance:
        """Return a new instance."""
        component = self.component(logging=logging)
        assert component, self.logged
        return Instance(self, component)

    def component(self, kind: int = 1, *, logging: bool = True) -> int | None:
        """Return what fmi2Instantiate does: for co-simulation (1) or model exchange (0)."""
        told = b"one", c_int(kind), self.description.guid.encode(), self.resources.encode()
        found: int | None = self.functions.fmi2Instantiate(*told, byref(self._callbacks), c_int(0), c_int(logging))
        return found


class Instance:
    """An instance, and its states; methods return the status, and what was read."""

    def __init__(self, binary: Binary, component: int) -> None:
        self.binary, self._component = binary, c_void_p(component)

    def call(self, name: str, *arguments: Any) -> int:
        """Return the status of fmi2``name``."""
        return int(self.binary.functions["fmi2" + name](self._component, *arguments))

    def set_up(self, start: float = 0.0, stop: float | None = None, tolerance: float | None = None) -> int:
        """fmi2SetupExperiment."""
        given = [c_int(tolerance is not None), c_double(tolerance or 0.0), c_double(start)]
        return self.call("SetupExperiment", *given, c_int(stop is not None), c_double(stop or 0.0))

    def step(self, t: float, step: float) -> int:
        """fmi2DoStep."""
        return self.call("DoStep", c_double(t), c_double(step), c_int(TRUE))

    def get(self, kind: str, references: Sequence[int]) -> tuple[int, list[Any]]:
        """fmi2GetReal and its like."""
        count = len(references)
        values = (KINDS[kind] * count)()
        return self.call("Get" + kind, (c_uint * count)(*references), c_size_t(count), values), list(values)

    def set(self, kind: str, references: Sequence[int], values: Sequence[Any]) -> int:
        """fmi2SetReal and its like."""
        count = len(references)
        given = (KINDS[kind] * count)(*values)
        return self.call("Set" + kind, (c_uint * count)(*references), c_size_t(count), given)

    def save(self) -> tuple[int, c_void_p]:
        """fmi2GetFMUstate."""
        state = c_void_p()
        return self.call("GetFMUstate", byref(state)), state

    def restore(self, state: c_void_p) -> int:
        """fmi2SetFMUstate."""
        return self.call("SetFMUstate", state)

    def release(self, state: c_void_p) -> int:
        """fmi2FreeFMUstate."""
        return self.call("FreeFMUstate", byref(state))

    def to_bytes(self, state: c_void_p) -> bytes:
        """fmi2SerializeFMUstate."""
        size = c_size_t()
        assert self.call("SerializedFMUstateSize", state, byref(size)) == OK
        data = (ctypes.c_char * size.value)()
        assert self.call("SerializeFMUstate", state, data, size) == OK
        return data.raw

    def from_bytes(self, data: bytes) -> tuple[int, c_void_p]:
        """fmi2DeSerializeFMUstate."""
        state = c_void_p()
        return self.call("DeSerializeFMUstate", data, c_size_t(len(data)), byref(state)), state

    def free(self) -> None:
        """fmi2FreeInstance."""
        self.binary.functions.fmi2FreeInstance(self._component)
