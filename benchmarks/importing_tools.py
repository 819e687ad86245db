"""Native FMUs in tools that import FMUs: ``python benchmarks/importing_tools.py [TOOL ...]``.

Every tool is installed in a separate virtual environment. It simulates the four-bar (`adams`) and the governor
(`ida`) for 2 s in steps of 10 ms, by the programs in the folder ``importers``, one for each tool. The table shows the
difference of an output at the end from a simulation in Python at a tolerance of 1e-10. Tools read outputs at 1.99 s or
at 2 s; the difference is that at the time that the program prints.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import venv
from pathlib import Path
from typing import NamedTuple

import numpy as np

import mbfmu
from fmus.fourbar import FourBar
from fmus.governor import Governor
from mbfmu.fmi import export
from mbfmu.modeling import Model
from mbfmu.session.simulation import Settings
from mbfmu.util.errors import UserError
from mbfmu.util.text_table import format_table

PROGRAMS = Path(__file__).parent / "importers"
STOP_TIME = 2.0
TIMEOUT = 120.0  # s


class Tool(NamedTuple):
    """A tool, and how its program is called."""

    requirements: tuple[str, ...]  # the first is the tool
    program: str  # in the folder ``importers``
    types: tuple[str, ...] = ("CoSimulation",)
    libraries: bool = False  # whether it needs shared libraries of its environment


BOTH_TYPES = "CoSimulation", "ModelExchange"
TOOLS = {
    "FMPy, old": Tool(("fmpy==0.3.10",), "run_fmpy.py", BOTH_TYPES),
    "FMPy": Tool(("fmpy==0.3.32",), "run_fmpy.py", BOTH_TYPES),
    "libcosim": Tool(("libcosimpy==0.0.6",), "run_libcosim.py"),
    "ecos": Tool(("ecospy==0.7.2", "tbb"), "run_ecos.py", libraries=True),
    "fmuloader": Tool(("fmuloader==0.1.2rc0",), "run_fmuloader.py"),
    "fmucontainer": Tool(("fmu-manipulation-toolbox==2.0", "fmpy==0.3.32"), "run_fmucontainer.py"),
    "cofmupy": Tool(("cofmupy==1.0.0",), "run_cofmupy.py"),
    "CasADi": Tool(("casadi==3.8.2", "fmpy==0.3.32"), "run_casadi.py", ("ModelExchange",)),
}
MODELS: dict[str, tuple[Model, str, str]] = {  # model, its solver, an output
    "four-bar": (FourBar(), "adams", "crank.angle"),
    "governor": (Governor(), "ida", "collar.height"),
}


def installed(folder: Path, tool: Tool) -> Path:
    """Return the Python of a new environment with a tool."""
    venv.create(folder, with_pip=True)
    python = folder / "bin" / "python"
    subprocess.run([python, "-m", "pip", "install", "-q", *tool.requirements], check=True)
    return python


def difference(python: Path, tool: Tool, fmu: Path, output: str, fmi_type: str, reference: mbfmu.Result) -> str:
    """Return by how much an output of an FMU differs in a tool, or why it has none."""
    own = {"LD_LIBRARY_PATH": str(python.parent.parent / "lib")} if tool.libraries else {}
    command = [python, PROGRAMS / tool.program, fmu, output, fmi_type, str(STOP_TIME)]
    try:
        done = subprocess.run(
            command,
            env={**os.environ, **own},
            cwd=fmu.parent,
            capture_output=True,
            text=True,
            timeout=TIMEOUT,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "no end"
    lines = [line for line in done.stdout.splitlines() if line.startswith("result ")]
    if done.returncode or not lines:
        return f"no result ({(done.stderr.strip().splitlines() or [f'exit code {done.returncode}'])[-1][:60]})"
    t, value = map(float, lines[-1].split()[1:])
    return f"{abs(value - np.interp(t, reference.t, reference[output])):.0e}"


def main(names: list[str]) -> None:
    """Print the table."""
    if unknown := [name for name in names if name not in TOOLS]:
        raise UserError(f"there is no tool {unknown[0]!r}; allowed: {', '.join(TOOLS)}")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        references = {}
        for name, (model, solver, _) in MODELS.items():
            references[name] = mbfmu.simulate(model, STOP_TIME, interval=1e-3, solver="adams", tolerance=1e-10)
            for fmi in (2, 3):
                export(model, work / f"{name}{fmi}.fmu", Settings(solver=solver), native=True, fmi=fmi)
        for name in names or TOOLS:
            tool = TOOLS[name]
            python = installed(work / tool.requirements[0], tool)
            for fmi in (2, 3):
                for fmi_type in tool.types:
                    found = [
                        difference(python, tool, work / f"{own}{fmi}.fmu", MODELS[own][2], fmi_type, references[own])
                        for own in MODELS
                    ]
                    rows.append([name, tool.requirements[0].partition("==")[2], f"{fmi}.0", fmi_type, *found])
                    print(*rows[-1], flush=True)
    print(format_table(["tool", "version", "FMI", "type", *MODELS], rows))


if __name__ == "__main__":
    main(sys.argv[1:])
