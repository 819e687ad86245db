"""Speed of the four-bar, all ratios in one run: ``python benchmarks/fourbar.py``.

Medians of several runs, compile time apart, the two sides of a ratio measured in turn. Printed:

* ``adams`` at an error of at most 1e-6 rad over 10 s, against RK4 on the pendulum at the same error;
* ``ida`` at tolerance 1e-6 against ``adams`` at ida's error;
* one fmi2DoStep and one fmi2GetReal of all outputs at 1 ms, against the native step;
* ``mbfmu run fourbar`` from an empty compile cache and from a full one, and the warm start of an FMU.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from math import radians
from pathlib import Path

import numpy as np
from floor import rk4

from fmus.fourbar import FourBar
from mbfmu.fmi import Fmu, export
from mbfmu.simulation import Settings, Simulation

END = 10.0
TIMES = np.linspace(0.0, END, 101)
EXACT = FourBar().exact(TIMES)["crank.angle"]  # type: ignore[index]
REPEATS = 15


def median_times(*functions: Callable[[], object]) -> list[float]:
    """Return the median time of each, run in turn, after one run of each that is not counted."""
    times: list[list[float]] = [[] for _ in functions]
    for i in range(REPEATS + 1):
        for own, function in zip(times, functions, strict=True):
            begin = time.perf_counter()
            function()
            if i:
                own.append(time.perf_counter() - begin)
    return [statistics.median(own) for own in times]


def swing(solver: str, tolerance: float) -> tuple[Callable[[], Simulation], float]:
    """Return a run to the end without outputs on the way (the start is not part of it), and its largest error."""
    model = FourBar()
    simulation = Simulation(model, Settings(solver=solver, tolerance=tolerance))
    fresh = simulation.stepper.save()

    def go() -> Simulation:
        simulation.stepper.restore(fresh)
        assert simulation.advance(END).ok
        return simulation

    go()
    simulation.stepper.restore(fresh)
    angles = []
    for t in TIMES[1:]:
        assert simulation.advance(float(t)).ok
        angles.append(simulation.stepper.q[0])
    return go, float(np.abs(np.array(angles) - EXACT[1:]).max())


def floor_at(error: float) -> tuple[Callable[[], object], float]:
    """Return RK4 with the fewest steps that reach ``error``, and its error."""
    weight, inertia = 4.0 * 9.81, 11.0 / 3.0
    run = partial(rk4, radians(10.0), 0.0, weight, inertia)
    for steps in (int(1000 * 1.05**k) for k in range(200)):
        # the largest error over the swing: at single times it passes through zero
        own = max(abs(run(t, round(steps * t / END)) - x) for t, x in zip(TIMES[1:], EXACT[1:], strict=True))
        if own <= error:
            return partial(run, END, steps), own
    raise RuntimeError(f"RK4 does not reach {error}")


def tolerance_for(solver: str, error: float) -> float:
    """Return the loosest tolerance (four a decade) at which ``solver`` reaches ``error``."""
    for tolerance in 10.0 ** np.arange(-4.0, -12.0, -0.25):
        if swing(solver, float(tolerance))[1] <= error:
            return float(tolerance)
    raise RuntimeError(f"{solver} does not reach {error}")


def explicit_against_floor() -> None:
    """Adams against RK4, at 1e-6 rad."""
    tolerance = tolerance_for("adams", 1e-6)
    adams, error = swing("adams", tolerance)
    floor, own = floor_at(error)
    a, f = median_times(adams, floor)
    print(f"adams at rtol {tolerance:.1e}: error {error:.1e} rad, {1e3 * a:.2f} ms")
    print(f"RK4 on the pendulum:  error {own:.1e} rad, {1e3 * f:.3f} ms; ratio {a / f:.1f} (at most 20)")


def implicit_against_explicit() -> None:
    """Ida at 1e-6 against adams at equal error."""
    ida, error = swing("ida", 1e-6)
    tolerance = tolerance_for("adams", error)
    adams, own = swing("adams", tolerance)
    i, a = median_times(ida, adams)
    print(
        f"ida at rtol 1e-6: error {error:.1e} rad, {1e3 * i:.1f} ms; adams at {own:.1e} rad, {1e3 * a:.2f} ms; "
        f"ratio {i / a:.1f} (under 40)"
    )


def fmu_against_native(fmu_file: Path) -> None:
    """Cost of the FMI layer per communication step of 1 ms."""
    steps = 2000

    def native() -> None:
        simulation = Simulation(FourBar(), Settings(solver="adams"))
        for k in range(1, steps + 1):
            simulation.advance(k * 1e-3)
            simulation.outputs()

    with Fmu(fmu_file, {"solver": "adams"}) as fmu:
        references = [fmu.variables[name].valueReference for name in fmu.real_outputs]

        def hosted() -> None:
            fmu.slave.reset()
            fmu.t = 0.0
            fmu.start({"solver": "adams"})
            for k in range(steps):
                fmu.slave.doStep(currentCommunicationPoint=k * 1e-3, communicationStepSize=1e-3)
                fmu.slave.getReal(references)

        n, h = median_times(native, hosted)
    print(
        f"native step and outputs {1e6 * n / steps:.1f} us, fmi2DoStep and fmi2GetReal {1e6 * h / steps:.1f} us; "
        f"difference {1e6 * (h - n) / steps:.1f} us (at most 20)"
    )


def starts(fmu_file: Path) -> None:
    """Cold and warm start of the command, and warm instantiate."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
        for name in ("cold", "warm"):
            begin = time.perf_counter()
            command = [sys.executable, "-c", "from mbfmu.cli import main; main()", "run", "fourbar", "-o", cache]
            subprocess.run(command, env=environment, check=True, capture_output=True)
            print(f"mbfmu run fourbar, {name} start: {time.perf_counter() - begin:.1f} s")
    program = (
        "import sys, time; begin = time.perf_counter()\n"
        "from pathlib import Path; from mbfmu.fmi import Fmu\n"
        "fmu = Fmu(Path(sys.argv[1])); print(time.perf_counter() - begin); fmu.close()"
    )
    command = [sys.executable, "-c", program, str(fmu_file)]
    runs = [subprocess.run(command, check=True, capture_output=True, text=True) for _ in range(5)]
    times = [float(run.stdout) for run in runs]
    print(f"warm instantiate in a fresh process, imports included: {statistics.median(times):.2f} s (under 1.5)")


def main() -> None:
    """Print every figure."""
    explicit_against_floor()
    implicit_against_explicit()
    with tempfile.TemporaryDirectory() as folder:
        fmu_file = export(FourBar(), Path(folder) / "fourbar.fmu")
        fmu_against_native(fmu_file)
        starts(fmu_file)


if __name__ == "__main__":
    main()
