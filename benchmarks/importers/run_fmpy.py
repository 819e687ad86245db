"""An FMU in FMPy: FILE OUTPUT TYPE STOP_TIME."""

import sys

import fmpy

path, output, fmi_type, stop_time = sys.argv[1:]
rows = fmpy.simulate_fmu(
    path, stop_time=float(stop_time), output_interval=0.01, fmi_type=fmi_type, relative_tolerance=1e-6, output=[output]
)
print("result", rows[-1]["time"], rows[-1][output])
