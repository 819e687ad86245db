"""An FMU for co-simulation (FMI 2.0) through FMPy's slave API, with variables by their names. mbfmu is not needed."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave


class Slave:
    """An instance of an FMU: ``slave["crank.angle"]`` reads a variable, an assignment sets one.

    Parameters
    ----------
    path
        FMU file.
    values
        Start values of parameters and inputs, by name.
    """

    def __init__(self, path: Path, values: Mapping[str, float] | None = None) -> None:
        description = read_model_description(str(path))
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        self.folder, self.time = extract(str(path)), 0.0
        self.fmu = FMU2Slave(
            guid=description.guid,
            unzipDirectory=self.folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=description.modelName,
        )
        self.fmu.instantiate()
        self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        for name, value in (values or {}).items():
            self[name] = value
        self.fmu.exitInitializationMode()

    def __getitem__(self, name: str) -> float:
        return float(self.fmu.getReal([self.references[name]])[0])

    def __setitem__(self, name: str, value: float) -> None:
        self.fmu.setReal([self.references[name]], [value])

    def step(self, size: float) -> None:
        """Advance by one communication step, s."""
        self.fmu.doStep(currentCommunicationPoint=self.time, communicationStepSize=size)
        self.time += size

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: Any) -> None:
        self.fmu.terminate()
        self.fmu.freeInstance()
        shutil.rmtree(self.folder, ignore_errors=True)
