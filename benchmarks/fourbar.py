"""Speed of the four-bar, all ratios in one run: ``python benchmarks/fourbar.py``.

Medians of several runs, compile time apart, the two sides of a ratio measured in turn; for solvers alone see
``explicit.py`` and ``implicit.py``. Printed:

* one fmi2DoStep and one fmi2GetReal of all outputs at 1 ms, against the direct step;
* ``mbfmu run fourbar`` from an empty compile cache and from a full one, and the warm start of an FMU.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from timing import median_times

from fmus.fourbar import FourBar
from mbfmu.fmi import Fmu, export
from mbfmu.session.simulation import Settings, Simulation


def fmu_against_direct(fmu_file: Path) -> None:
    """Cost of the FMI layer per communication step of 1 ms."""
    steps = 2000

    def direct() -> None:
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

        n, h = median_times(direct, hosted)
    print(
        f"direct step and outputs {1e6 * n / steps:.1f} us, fmi2DoStep and fmi2GetReal {1e6 * h / steps:.1f} us; "
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
    with tempfile.TemporaryDirectory() as folder:
        fmu_file = export(FourBar(), Path(folder) / "fourbar.fmu", native=False)
        fmu_against_direct(fmu_file)
        starts(fmu_file)


if __name__ == "__main__":
    main()
