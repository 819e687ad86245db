"""An FMU in a container of fmucontainer, which FMPy simulates: FILE OUTPUT TYPE STOP_TIME."""

import subprocess
import sys
from pathlib import Path

import fmpy

path, output, _, stop_time = sys.argv[1:]
fmu = Path(path)
rules = ["rule;from_fmu;from_port;to_fmu;to_port", f"FMU;{fmu.name};;;", f"OUTPUT;{fmu.name};{output};;{output}"]
(fmu.parent / "container.csv").write_text("\n".join(rules) + "\n")
program = Path(sys.executable).parent / "fmucontainer"
subprocess.run([program, "-fmu-directory", str(fmu.parent), "-container", "container.csv:0.01"], check=True)
rows = fmpy.simulate_fmu(
    str(fmu.parent / "container.fmu"), stop_time=float(stop_time), output_interval=0.01, output=[output]
)
print()
print("result", rows[-1]["time"], rows[-1][output])
