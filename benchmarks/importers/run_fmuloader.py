"""An FMU in fmuloader: FILE OUTPUT TYPE STOP_TIME."""

import re
import sys
import zipfile

from fmuloader import fmi2, fmi3

path, output, _, stop_time = sys.argv[1:]
end = float(stop_time)
description = zipfile.ZipFile(path).read("modelDescription.xml").decode()


def found(pattern: str) -> str:
    """Return the group of a pattern in the model description."""
    return re.search(pattern, description)[1]


reference, identifier = (
    int(found(rf'name="{re.escape(output)}" valueReference="(\d+)"')),
    found('modelIdentifier="([^"]+)"'),
)
if found('fmiVersion="(.)') == "2":
    fmu = fmi2.Fmi2Slave(path, model_identifier=identifier)
    fmu.instantiate("fmu", fmi2.Fmi2Type.CO_SIMULATION, guid=found('guid="([^"]+)"'))
    fmu.setup_experiment(start_time=0.0, stop_time=end)
    fmu.enter_initialization_mode()
    read = fmu.get_real
else:
    fmu = fmi3.Fmi3Slave(path, model_identifier=identifier)
    fmu.instantiate_co_simulation("fmu", instantiation_token=found('instantiationToken="([^"]+)"'))
    fmu.enter_initialization_mode(start_time=0.0, stop_time=end)
    read = fmu.get_float64
fmu.exit_initialization_mode()
for k in range(round(end / 0.01)):
    fmu.do_step(k * 0.01, 0.01)
print("result", end, *read([reference]))
