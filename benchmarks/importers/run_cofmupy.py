"""An FMU in CoFMUPy, which sets inputs without a connection to zero: FILE OUTPUT TYPE STOP_TIME."""

import json
import sys
from pathlib import Path

import fmpy
from cofmupy import Coordinator

path, output, _, stop_time = sys.argv[1:]
inputs = [v for v in fmpy.read_model_description(path).modelVariables if v.causality == "input"]
starts = {v.name: float(v.start) for v in inputs if v.type in ("Real", "Float64")}
configuration = {
    "root": str(Path(path).parent),
    "fmus": [{"id": "fmu", "name": "fmu", "path": Path(path).name, "initialization": starts}],
    "connections": [],
}
Path("cofmupy.json").write_text(json.dumps(configuration))
coordinator = Coordinator()
coordinator.start("cofmupy.json")
for _ in range(round(float(stop_time) / 0.01)):
    coordinator.do_step(0.01)
print("result", stop_time, coordinator.get_results()["fmu", output][-1])
