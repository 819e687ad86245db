"""What a plate or a shell element feels at a point: its curvature and strain, moments and forces per length, stress.

An element is a polynomial over its cell, so each of these is a sum over its own strains, with weights that depend on
the point: found once, when the sensor is made.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.sensors.base import Sensor
from mbfmu.sheets.elements.plate_energy import PlateRecord, plate_scratch, shape, strain
from mbfmu.sheets.elements.shell_energy import ShellRecord, deform, shell_scratch
from solvers.compiled.kernel import kernel

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from solvers.compiled.record import Reals


@kernel
def in_plate(sensor: Any, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`. Weights times the generalized strains."""
    here = plate_scratch(sensor, state)
    shape(sensor, state.bodies, here)
    strain(sensor, here)
    total = sensor.start + 0.0 * here.strain[0]
    for k in range(9 + 3 * sensor.membrane):
        total += sensor.weight[k] * here.strain[k]
    return total


@kernel
def in_shell(sensor: Any, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`. Weights times the displacements and turns of the corners."""
    here = shell_scratch(sensor, state)
    deform(sensor, state.bodies, here)
    total = sensor.start + 0.0 * here.d[0, 0]
    for i in range(4):
        for k in range(6):
            total += sensor.weight[i, k] * here.d[i, k]
    return total


def _record(weights: tuple[int, ...], element: np.dtype[Any]) -> np.dtype[Any]:
    """Return the record of an element, behind weights: a record that begins as another is taken for that by numba."""
    fields: list[Any] = [(name, element[name]) for name in element.names or ()]
    return np.dtype([("start", np.float64), ("weight", np.float64, weights), *fields], align=True)


@dataclass(frozen=True, kw_only=True)
class _InElement(Sensor):
    """A sum over the strains of an element; ``bodies`` are those at its corners.

    Parameters
    ----------
    element
        The :class:`.Plate` or :class:`.Shell`.
    start, weights
        Value without strains, and coefficient of each strain, with the shape of the record.
    """

    element: Any
    start: float
    weights: Any

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the element and the weights."""
        self.element.fill(record, site)
        record["start"], record["weight"] = self.start, self.weights


@dataclass(frozen=True, kw_only=True)
class InPlate(_InElement):
    """... over the twelve generalized strains of a plate."""

    record = _record((12,), PlateRecord.dtype)
    read = in_plate


@dataclass(frozen=True, kw_only=True)
class InShell(_InElement):
    """... over the displacements and turns of the four corners of a shell."""

    record = _record((4, 6), ShellRecord.dtype)
    read = in_shell
