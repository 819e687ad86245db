"""An FMU in ecos: FILE OUTPUT TYPE STOP_TIME."""

import sys

from ecospy import EcosSimulation, EcosSimulationStructure

path, output, _, stop_time = sys.argv[1:]
structure = EcosSimulationStructure()
structure.add_model("fmu", path)
with EcosSimulation(structure=structure, step_size=0.01) as simulation:
    simulation.init()
    simulation.step_until(float(stop_time))
    print("result", simulation.get_time(), simulation.get_real(f"fmu::{output}"))
