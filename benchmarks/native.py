"""Computing time of FMUs, native and with Python: ``python benchmarks/native.py [steps]``.

1. CPU time of a communication step of 1 ms with all real outputs read, in runs of 10 s: of the native FMU and of the
   FMU that calls Python, called from Python, and of a :class:`Simulation` without an FMU, in turn.
2. The same of the native FMU called from C, without the overhead of Python, and the distribution of the times of
   1 000 000 steps (or as many as given), see step_times.c. Real-time applications need the largest.
3. Time of single calls, of saving a state and of an instance, and memory of an instance.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
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
MANY_STEPS = 1_000_000
RUNS = 3  # of the same steps in C; the shortest time of each step counts
COLUMNS = "mean", "median", "99.9 %", "largest", "first", "first in the process", "largest with interruptions"


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


def in_c(source: str, fmu: Fmu, *arguments: str) -> list[float]:
    """Return the numbers that a host in C prints, which is compiled like runtimes and gets all real outputs."""
    headers = Path(fmpy.__file__).parent / "c-code"
    with tempfile.TemporaryDirectory() as folder:
        program, code = Path(folder, "host"), Path(__file__).with_name(source)
        subprocess.run([*compiler(host()), "-O2", f"-I{headers}", code, "-o", program, "-ldl", "-lm"], check=True)
        (library,) = (fmu._folder / "binaries").glob("*/mbfmu*.so")
        own = [library, (fmu._folder / "resources").as_uri(), fmu.description.guid]
        references = [str(fmu.variables[name].valueReference) for name in fmu.real_outputs]
        done = subprocess.run([program, *own, *arguments, *references], check=True, capture_output=True, text=True)
    return [float(line) for line in done.stdout.splitlines()]


def step_times(path: Path, changed: str, steps: int) -> list[str]:
    """Return the times that step_times.c prints, us; see COLUMNS."""
    with Fmu(path) as fmu:
        reference = fmu.variables[changed].valueReference if changed else -1
        found = in_c("step_times.c", fmu, str(steps), str(LENGTH), str(RUNS), str(reference))
    return [f"{1e-3 * time:.{1 if time >= 1e4 else 2}f}" for time in found[: len(COLUMNS)]]


def memory() -> int:
    """Return the resident memory of this process, bytes."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096


def calls(path: Path) -> None:
    """Print what calls, states and instances cost."""
    with Fmu(path) as fmu:
        steps, reads, taken, given = in_c("native.c", fmu, str(CALLS))
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


def main(steps: int) -> None:
    """Run everything."""
    rows, distributions = [], []
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})  # the times are those of one processor
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
            distributions.append([name, solver, *step_times(own, changed, steps)])
            if changed and solver == "adams":
                kept = Path(folder, "kept.fmu")
                own.rename(kept)
        print(f"us of CPU a step of {1e3 * LENGTH:g} ms with all outputs read, at 1e-6, medians of {repeats}")
        print(format_table(["model", "solver", "native FMU", "Python FMU", "Simulation", "Python / native"], rows))
        print(f"the native FMU called from C, us a step: {steps} steps, of each the shortest of {RUNS} times;")
        print("the first step apart")
        print(format_table(["model", "solver", *COLUMNS], distributions))
        calls(kept)


if __name__ == "__main__":
    np.seterr(all="raise")
    main(int(sys.argv[1]) if len(sys.argv) > 1 else MANY_STEPS)
