"""FMUs connected as an archive of System Structure and Parameterization 1.0, and two hosts that run it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from fmpy.ssp.simulation import simulate_ssp
from fmpy.ssp.ssd import Parameter, ParameterSet
from numpy.typing import NDArray

from mbfmu import write_ssp
from mbfmu.session.run import communication_points

Array = NDArray[np.float64]
Run = dict[str, Array]  # "time" (s) and the recorded variables, each as "element.name"


@dataclass(frozen=True, kw_only=True)
class SspSystem:
    """Elements that are FMUs, connected from element to element.

    Attributes
    ----------
    name
        Of the system.
    connections
        Element and output, element and input.
    recorded
        Elements and outputs that a run returns.
    values
        Start values of parameters by "element.name", where the FMU's own are not the right ones.
    """

    name: str
    connections: tuple[tuple[str, str, str, str], ...]
    recorded: tuple[tuple[str, str], ...]
    values: Mapping[str, float] = field(default_factory=dict)

    def values_of(self, element: str) -> dict[str, float]:
        """Return the start values of an element by the names of its variables."""
        return {
            name.removeprefix(f"{element}."): value
            for name, value in self.values.items()
            if name.startswith(f"{element}.")
        }

    def run(self, times: Array, rows: list[list[float]]) -> Run:
        """Return rows of what is recorded by name."""
        values = np.array(rows)
        return {"time": times, **{f"{element}.{name}": values[:, i] for i, (element, name) in enumerate(self.recorded)}}

    def write(self, path: Path, fmus: Mapping[str, Path], stop_time: float) -> Path:
        """Write the archive; ``fmus`` are the elements' files, of which several elements may share one."""
        connections = [(f"{start}.{output}", f"{end}.{variable}") for start, output, end, variable in self.connections]
        return write_ssp(path, fmus, connections, self.values, stop_time=stop_time)

    def run_in_fmpy(self, ssp: Path, stop_time: float, step: float, values: Mapping[str, float] | None = None) -> Run:
        """Run the archive in FMPy: all FMUs step with the values of the last point (Jacobi).

        FMPy starts every connection at zero: the first step is a jolt, look at what comes after it has died. It takes
        no start values from an archive, so they are passed, with ``values`` in addition to them or instead.
        """
        told = [Parameter(name=name, value=value) for name, value in {**self.values, **(values or {})}.items()]
        result = simulate_ssp(
            str(ssp), stop_time=stop_time, step_size=step, parameter_set=ParameterSet(parameters=told)
        )
        times = result["time"] + step  # FMPy gives each step's result the time of its beginning
        return {"time": times, **{f"{element}.{name}": result[f"{element}.{name}"] for element, name in self.recorded}}

    def run_in_libcosim(self, ssp: Path, stop_time: float, step: float) -> Run:
        """Run the archive in libcosim, which couples like FMPy but carries the start values over."""
        from libcosimpy.CosimExecution import CosimExecution
        from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
        from libcosimpy.CosimObserver import CosimObserver

        log_output_level(CosimLogLevel.WARNING)
        execution = CosimExecution.from_ssp_file(str(ssp), round(step * 1e9))  # ns
        observer = CosimObserver.create_last_value()
        execution.add_observer(observer)
        index = {element: execution.slave_index_from_instance_name(element) for element, _ in self.recorded}
        reference = {(k, v.name.decode()): v.reference for k in index.values() for v in execution.slave_variables(k)}
        times = communication_points(stop_time, step)[1:]
        rows = []
        for t in times:
            if not execution.step():
                raise RuntimeError(f"libcosim stopped before {t} s")
            rows.append(
                [observer.last_real_values(index[e], [reference[index[e], name]])[0] for e, name in self.recorded]
            )
        return self.run(times, rows)
