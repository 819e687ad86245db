"""Strains of plates and shells, linearized about a position: kernels ``extrapolate``, see
:mod:`mbfmu.mechanics.loads.base`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from solvers.compiled.kernel import kernel

from .plate_energy import differentiate as differentiate_plate
from .plate_energy import follow, plate_scratch, shape, strain
from .shell_energy import deform, shell_scratch, update_rates
from .shell_energy import differentiate as differentiate_shell

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from solvers.compiled.record import Table

    from .plate_energy import PlateRecord
    from .shell_energy import ShellRecord


@kernel
def extrapolate_plates(plates: Table[PlateRecord], arrays: Arrays, state: State) -> None:
    """Generalized strains e + e'."""
    for i in range(plates.shape[0]):
        plate = plates[i]
        here = plate_scratch(plate, state)
        shape(plate, state.bodies, here)
        strain(plate, here)
        follow(plate, state.bodies, here)
        differentiate_plate(plate, here)
        for k in range(12 if plate.membrane == 1 else 9):
            plate.extrapolated[k] = here.strain[k] + here.dstrain[k]


@kernel
def extrapolate_shells(shells: Table[ShellRecord], arrays: Arrays, state: State) -> None:
    """Displacements and turns of the corners d + d'."""
    for i in range(shells.shape[0]):
        shell = shells[i]
        here = shell_scratch(shell, state)
        deform(shell, state.bodies, here)
        update_rates(shell, state.bodies, here)
        differentiate_shell(shell, here)
        for corner in range(4):
            for k in range(6):
                shell.extrapolated[corner, k] = here.d[corner, k] + here.rate[corner, k]
