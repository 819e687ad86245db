"""A runtime at work in this process."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbfmu.mechanics import CompiledMechanism
from mbfmu.native.contents import EQUATIONS, STEPS, Contents
from mbfmu.native.entries import family_of, image_of
from mbfmu.native.kernel_table import kernel_tables
from mbfmu.native.runtime import COMPILERS, PACKAGE_DIR, objects
from mbfmu.native.targets import host
from mbfmu.session.simulation import Settings, Simulation
from solvers.compiled.tuple_pointer import unpin
from solvers.outcome import OK

needs_linker = pytest.mark.skipif(
    not host() or not any(map(shutil.which, COMPILERS)), reason="needs a C compiler, and a machine that is known"
)


def stepping(family: str) -> Contents:
    """What steps of any model need: without model exchange, events and starts in a steady state."""
    return Contents(family, (*kernel_tables(), EQUATIONS, STEPS))


@cache
def runtime(family: str) -> ctypes.CDLL:
    """The kernels of a family for this machine, with nothing around them; built where they are not there."""
    compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
    assert compiler is not None
    code = map(str, objects([host()], [stepping(family)])[host()])
    with tempfile.TemporaryDirectory() as folder:
        path, power = f"{folder}/kernels.so", str(PACKAGE_DIR / "c" / "complex_power.c")
        sources = [*code, "-fPIC", power]
        subprocess.run([compiler, "-shared", *sources, "-o", path, "-lm", "-Wl,-Bsymbolic"], check=True)
        return ctypes.CDLL(path)


class Running:
    """An instance at work in this process, by C's calls alone."""

    def __init__(self, simulation: Simulation) -> None:
        self.instance, self.image = instance, image = image_of(simulation)
        room = np.zeros(image.size + 64, np.uint8)
        begin = -room.ctypes.data % 64
        self.block = room[begin : begin + image.size]
        self.block[:] = np.frombuffer(image.block(), np.uint8)
        words, here = self.block.view(np.uint64), self.block.ctypes.data
        self._root, self._family = here + image.root, family_of(simulation)
        table: list[Any] = []
        for own in kernel_tables().values():
            table += (ctypes.c_void_p * len(own.kernels)).in_dll(runtime(self._family), own.symbol)
        for at, target in image.relocations:
            words[at // 8] = here + target
        for at, number in image.kernels:
            words[at // 8] = table[number]
        self.out, self.run_status = self.view(instance.out), self.view(instance.session.status)[0]

    def view(self, array: NDArray[Any]) -> NDArray[Any]:
        """Return the numbers or records of the block that an array of :func:`image_of` stands for."""
        at = self.image.at(array)
        plain = array.dtype if array.dtype.names is None else np.dtype(array.dtype.descr)
        return self.block[at : at + array.nbytes].view(plain)

    def call(self, name: str, *more: float) -> int:
        """Call an entry point, with whole numbers as such; return its code."""
        function = getattr(runtime(self._family), f"mb_{self._family}_{name}")
        types = [ctypes.c_int64 if isinstance(x, int) else ctypes.c_double for x in more]
        function.argtypes = [ctypes.c_void_p] * 3 + types
        code, error = ctypes.c_int64(), ctypes.c_void_p()
        assert function(ctypes.byref(code), ctypes.byref(error), self._root, *more) == 0
        return code.value


def adopt(native: Running, compiled: CompiledMechanism, at_work: bool = False) -> None:
    """Give an instance the numbers of another compiled mechanism, as a host does that sets parameters."""
    instance, system = native.instance, compiled.system
    mine, theirs = unpin(unpin(instance.eqs.data).arrays), compiled.data.arrays
    pairs = [(a, b) for a, b in zip(mine, theirs, strict=True) if a is not mine.kernels]
    if not at_work:  # where solvers keep their units
        pairs += [(instance.work.size, system.size), (instance.start.scratch.row, system.row_size)]
        native.view(instance.known)[:2] = system.rate, getattr(system, "loop_rate", 0.0)
    for array, numbers in pairs:
        if array.nbytes:
            native.view(array).view(np.uint8)[:] = np.frombuffer(numbers.tobytes(), np.uint8)


def pair(make: Any, settings: Settings) -> tuple[Simulation, Running]:
    """A simulation and machine code of one like it, both begun."""
    native = Running(Simulation(make(), settings))
    assert native.call("begin", 0.0) == OK
    return Simulation(make(), settings), native


def follow(simulation: Simulation, native: Running, length: float, first: int = 0, last: int = 10) -> None:
    """Steps with equal rows of outputs."""
    for k in range(first, last):
        status = simulation.advance((k + 1) * length)
        assert native.call("step", (k + 1) * length) == int(status.code) == OK
        assert native.call("read") == OK
        np.testing.assert_array_equal(native.out, simulation.outputs())
    assert native.run_status["lost"] == bool(simulation.warning)
