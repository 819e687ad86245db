"""Energies of the whole mechanism, and how far its constraints are open."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbfmu.mechanics.recursions.energy import driven_action
from solvers.compiled.kernel import kernel

from .base import Follows, Sensor

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from mbfmu.mechanics.sensors.base import QuantityRecord
    from solvers.compiled.record import Reals


@kernel
def kinetic(sensor: QuantityRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    return state.energy[0]


@kernel
def potential(sensor: QuantityRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    return state.energy[1]


@kernel
def total(sensor: QuantityRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    return state.energy[0] + state.energy[1]


@kernel
def jacobi(sensor: QuantityRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    return state.energy[0] + state.energy[1] - driven_action(arrays, state)


@kernel
def residual(sensor: QuantityRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    return largest_residual(sensor.component == 1, arrays, state)


@kernel
def largest_residual(velocity: bool, arrays: Arrays, state: State) -> float:
    """Largest |Phi| or |Phi'| of the kept rows, each times its residual scale: m or m/s."""
    worst = 0.0
    for i in range(arrays.cuts.shape[0]):
        cut = arrays.cuts[i]
        for r in range(cut.row, cut.end):
            if arrays.kept[r] < 0:
                continue
            row = state.rows[r]
            open_ = row.Phi
            if velocity:
                open_ = 0.0
                for k in range(6):
                    open_ += row.Ga[k] * state.bodies[cut.a].Y[k] + row.Gb[k] * state.bodies[cut.b].Y[k]
            worst = max(worst, abs(open_ * arrays.residual_scale[r]))
    for i in range(arrays.couplings.shape[0]):
        coupling, here = arrays.couplings[i], state.coupled[i]
        if arrays.kept[coupling.row] >= 0:
            rate = state.v[coupling.va] - here.slope * state.v[coupling.vb]
            open_ = rate if velocity else here.Phi
            worst = max(worst, abs(open_ * arrays.residual_scale[coupling.row]))
    return worst


@dataclass(frozen=True, kw_only=True)
class KineticEnergy(Sensor):
    """Of all bodies."""

    unit: str = "J"
    read = kinetic
    reads_energy = True


@dataclass(frozen=True, kw_only=True)
class PotentialEnergy(Sensor):
    """Of gravity (zero at the global origin) and of what stores energy."""

    unit: str = "J"
    read = potential
    reads_energy = True
    follows = Follows.GRAVITY


@dataclass(frozen=True, kw_only=True)
class Energy(PotentialEnergy):
    """Kinetic and potential."""

    read = total


@dataclass(frozen=True, kw_only=True)
class JacobiIntegral(PotentialEnergy):
    """Energy less the action of the drives; see :func:`.recursions.energy.driven_action`."""

    read = jacobi


@dataclass(frozen=True, kw_only=True)
class Residual(Sensor):
    """Largest residual of the constraints, m; component 1: of their rates, m/s.

    A residual in another unit than m counts by the length of the mechanism: 1 rad as the path of a point that far from
    the axis, and that of a coupling relative to what its coordinates change it by when each moves by its unit.
    """

    read = residual
