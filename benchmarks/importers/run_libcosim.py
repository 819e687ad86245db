"""An FMU in libcosim: FILE OUTPUT TYPE STOP_TIME."""

import re
import sys
import zipfile

from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave

path, output, _, stop_time = sys.argv[1:]
description = zipfile.ZipFile(path).read("modelDescription.xml").decode()
reference = int(re.search(rf'name="{re.escape(output)}" valueReference="(\d+)"', description)[1])
execution = CosimExecution.from_step_size(step_size=10_000_000)  # ns
slave = execution.add_local_slave(CosimLocalSlave(fmu_path=path, instance_name="fmu"))
observer = CosimObserver.create_last_value()
execution.add_observer(observer)
for _ in range(round(float(stop_time) / 0.01)):
    assert execution.step()
print()
print("result", stop_time, *observer.last_real_values(slave, [reference]))
