"""What an FMU costs its host, as machine code and by way of Python: ``python benchmarks/native.py``.

Every model runs 10 s in steps of 1 ms, and all its real outputs are read at every point, by the functions of FMI as a C
host calls them: the native FMU, the FMU that calls Python, and a :class:`Simulation` without an FMU, in turn. Then what
a call costs, a state, an instance, and its memory.
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
import time
from collections.abc import Callable
from math import sin
from pathlib import Path

import fmpy
import numpy as np
from timing import median_times

from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from mbfmu.fmi import Fmu, export
from mbfmu.modeling import Model
from mbfmu.native.runtime import compiler
from mbfmu.native.targets import host
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.util.text_table import format_table

STEPS, LENGTH = 10_000, 1e-3  # the second in s
INSTANCES = 1000
CALLS = 1_000_000


class Raw:
    """The functions of an FMU's instance, called with arrays that are made once."""

    def __init__(self, fmu: Fmu) -> None:
        self._dll, self._component = fmu.slave.dll, ctypes.c_void_p(fmu.slave.component)
        references = [fmu.variables[name].valueReference for name in fmu.real_outputs]
        self._count = len(references)
        self._references = (ctypes.c_uint * self._count)(*references)
        self._values = (ctypes.c_double * self._count)()
        self._step, self._get = self._dll["fmi2DoStep"], self._dll["fmi2GetReal"]  # without the types FMPy declares
        self._set, self._input = self._dll["fmi2SetReal"], (ctypes.c_double * 1)()
        self._inputs = {v.name: (ctypes.c_uint * 1)(v.valueReference) for v in fmu.variables.values()}
        self._step.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int]

    def step(self, t: float, length: float) -> int:
        """fmi2DoStep."""
        return int(self._step(self._component, t, length, 1))

    def set(self, name: str, value: float) -> int:
        """fmi2SetReal of one variable."""
        self._input[0] = value
        return int(self._set(self._component, self._inputs[name], ctypes.c_size_t(1), self._input))

    def read(self) -> int:
        """fmi2GetReal of all outputs."""
        return int(self._get(self._component, self._references, ctypes.c_size_t(self._count), self._values))


def driven(path: Path, changed: str = "") -> Callable[[], None]:
    """Return a run of an FMU; the input ``changed`` is set to another value at every point."""

    def run() -> None:
        with Fmu(path) as fmu:
            raw = Raw(fmu)
            for k in range(STEPS):
                if changed:
                    assert raw.set(changed, sin(k * LENGTH)) == 0
                assert raw.step(k * LENGTH, LENGTH) == 0
                raw.read()

    return run


def simulated(model: Model, settings: Settings, changed: str = "") -> Callable[[], None]:
    """Return a run without an FMU; the input ``changed`` is set to another value at every point."""

    def run() -> None:
        simulation = Simulation(model, settings)
        for k in range(STEPS):
            if changed:
                simulation.set_input(changed, sin(k * LENGTH))
            simulation.advance((k + 1) * LENGTH)
            simulation.outputs()

    return run


def in_c(fmu: Fmu) -> list[float]:
    """Return what calls cost a host in C, ns; see native.c."""
    source, headers = Path(__file__).with_suffix(".c"), Path(fmpy.__file__).parent / "c-code"
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder, "native")
        subprocess.run([*compiler(host()), "-O2", f"-I{headers}", source, "-o", program, "-ldl"], check=True)
        (library,) = (fmu._folder / "binaries").glob("*/*.so")
        told = [library, (fmu._folder / "resources").as_uri(), fmu.description.guid, str(CALLS)]
        references = [str(fmu.variables[name].valueReference) for name in fmu.real_outputs]
        said = subprocess.run([program, *told, *references], check=True, capture_output=True, text=True)
    return [float(line) for line in said.stdout.splitlines()]


def memory() -> int:
    """Return the resident memory of this process, bytes."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096


def calls(path: Path) -> None:
    """Print what calls, states and instances cost."""
    with Fmu(path) as fmu:
        steps, reads, taken, given = in_c(fmu)
        print(f"called from C: a step of no length {steps:.0f} ns, {len(fmu.real_outputs)} outputs read {reads:.0f} ns")
        print(f"a state taken {taken:.0f} ns, given back {given:.0f} ns")
        slave, components = fmu.slave, []
        location = (Path(fmu._folder) / "resources").as_uri().encode()
        told = b"one", 1, slave.guid.encode(), location, ctypes.byref(slave.callbacks), 0, 0
        before, begin = memory(), time.process_time()
        for _ in range(INSTANCES):
            components.append(slave.dll.fmi2Instantiate(*told))
        made = time.process_time() - begin
        used = (memory() - before) / INSTANCES
        for component in components:
            slave.fmi2SetupExperiment(component, 0, 0.0, 0.0, 0, 0.0)
            slave.fmi2EnterInitializationMode(component)
            slave.fmi2ExitInitializationMode(component)
        started = time.process_time() - begin
        print(f"{INSTANCES} instances: made in {1e3 * made:.0f} ms, made and started in {1e3 * started:.0f} ms")
        print(f"memory of an instance: {used / 1e3:.0f} kB")
        for component in components:
            slave.fmi2FreeInstance(component)


def main() -> None:
    """Run everything."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        models = FourBar(), Governor(), SwingPendulum()
        cases = [(model, solver, "") for solver in ("adams", "radau", "ida") for model in models]
        cases += [(FourBar(), solver, "crank.torque") for solver in ("ida", "adams")]
        for model, solver, changed in cases:
            settings = Settings(solver=solver)
            own = export(model, Path(folder, "native.fmu"), settings, native=True)
            other = export(model, Path(folder, "python.fmu"), settings, native=False)
            repeats = 5
            runs = driven(own, changed), driven(other, changed), simulated(model, settings, changed)
            times = median_times(*runs, repeats=repeats)
            each = [f"{1e6 * t / STEPS:.2f}" for t in times]
            name = f"{model.name}, changing {changed}" if changed else model.name
            rows.append([name, solver, *each, f"{times[1] / times[0]:.1f}"])
            if changed and solver == "adams":
                kept = Path(folder, "kept.fmu")
                own.rename(kept)
        print(f"us of CPU a step of {1e3 * LENGTH:g} ms with all outputs read, at 1e-6, medians of {repeats}")
        print(format_table(["model", "solver", "native FMU", "Python FMU", "Simulation", "Python / native"], rows))
        calls(kept)


if __name__ == "__main__":
    np.seterr(all="raise")
    main()
