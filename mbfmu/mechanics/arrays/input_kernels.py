"""What communication points do with the inputs of a mechanism: kernels over the records of all its inputs.

A host sets inputs at a point (:func:`set_input`); :func:`begin_support_motions` is called for the step to the next one.
Loads that are extrapolated are so from there. Supports receive their target, and :func:`start_motions` is called once
its effect is known.

Where rates of supports jump, the free velocities do so all at once. Over an instant only what is unbounded counts:
M dv + J^T dlambda = -m du, J dv = dnu, where m du is the part of h that the drives' accelerations make. The same
equations give v' by accelerations of du, less that by none: :func:`perturb_motions` gives the drives
a part of them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.kind import record_of
from mbfmu.mechanics.records import WorldRecord
from mbfmu.mechanics.signals import Input
from solvers.compiled.kernel import kernel, records
from solvers.compiled.record import Record, Table, i8

from .load_extrapolation import LoadRecord, load_finished, load_starts, set_load_input, skip_load_point, start_load
from .support_motion import (
    SegmentRecord,
    SupportRecord,
    adopt_segment,
    follow_path,
    motion_finished,
    perturb_motion,
    plan_motion,
    set_motion_input,
    set_motion_rate,
    start_motion,
)

if TYPE_CHECKING:
    from mbfmu.mechanics.signals.polynomial import PolynomialRecord

RAMP_ROUNDING = 1e-15  # relative rounding error of a load that continues with its rate
# Roles of inputs
HELD_LOAD, GRAVITY_LOAD, EXTRAPOLATED_LOAD, SUPPORT_MOTION = 0, 1, 2, 3
# At a point: extrapolated loads change; a support motion starts; a rate of one jumps
LOADS_CHANGED, MOTION_STARTS, RATE_JUMPS = 1, 2, 4


class InputRecord(Record):
    """An input: where its values are kept."""

    role: i8
    number: i8  # of its polynomial, its load or its support
    coefficient: i8  # of the polynomial, or component of gravity
    takes_rate: i8  # 1: the host may give its time derivative with the value


class InputRecords(NamedTuple):
    """The inputs of a mechanism as kernels take them."""

    inputs: Table[InputRecord]  # (inputs,)
    loads: Table[LoadRecord]  # those that go on between points
    supports: Table[SupportRecord]
    segments: Table[SegmentRecord]  # (supports,) those they are on
    ahead: Table[SegmentRecord]  # (supports,) those they depart for
    polynomials: NDArray[Any]  # every polynomial of the mechanism, where it lies in Arrays.memory
    before: NDArray[Any]  # (supports,) polynomials that were perturbed
    world: Table[WorldRecord]  # (1,) of Arrays

    @staticmethod
    def allocate(
        inputs: int, loads: int, supports: int, polynomials: NDArray[Any], world: Table[WorldRecord]
    ) -> InputRecords:
        """Return zeroed records for the given numbers, with the existing polynomials and ground."""
        segments, ahead = SegmentRecord.zeros(supports), SegmentRecord.zeros(supports)
        before = records(supports, polynomials.dtype)
        moved = SupportRecord.zeros(supports), segments, ahead, polynomials, before
        return InputRecords(InputRecord.zeros(inputs), LoadRecord.zeros(loads), *moved, world)

    @staticmethod
    def example() -> InputRecords:
        """Return records of the types that every mechanism has."""
        return InputRecords.allocate(1, 1, 1, records(1, record_of(Input)), WorldRecord.zeros(1))

    def memory(self) -> list[NDArray[Any]]:
        """Return their history, without the polynomials and gravity."""
        return [self.loads, self.supports, self.segments]

    def values(self) -> list[NDArray[Any]]:
        """Return the polynomials and gravity, which are parts of other arrays."""
        return [self.polynomials, self.world["gravity"]]


@kernel
def begin_inputs(i: InputRecords) -> None:
    """Let all begin as the polynomials say; nothing is known of the time before."""
    for k in range(i.loads.shape[0]):
        start_load(i.loads[k], i.polynomials[i.loads[k].polynomial])
    for k in range(i.supports.shape[0]):
        start_motion(i.supports[k], i.segments[k], i.polynomials[i.supports[k].polynomial])


@kernel
def hold_value(coefficient: int, value: float, t: float, polynomial: PolynomialRecord) -> bool:
    """Set the value (coefficient 0) or the rate (1) of a load from t on.

    A load with a rate continues from its present value.

    Returns whether this changes the polynomial; if not, it is left as it is.
    """
    present = polynomial.c[0] + (t - polynomial.t0) * polynomial.c[1]
    if value == (polynomial.c[1] if coefficient == 1 else present):
        return False
    polynomial.t0, polynomial.c[0] = t, present
    polynomial.c[coefficient] = value
    return True


@kernel
def hold_ramp(value: float, rate: float, t: float, polynomial: PolynomialRecord) -> bool:
    """Set the value and the rate of a load from t on; return whether this changes the polynomial."""
    present = polynomial.c[0] + (t - polynomial.t0) * polynomial.c[1]
    rounding = RAMP_ROUNDING * (abs(value) + abs((t - polynomial.t0) * rate))
    if rate == polynomial.c[1] and (value == present or (rate != 0.0 and abs(value - present) <= rounding)):
        return False
    polynomial.t0, polynomial.c[0], polynomial.c[1] = t, value, rate
    return True


@kernel
def begin_polynomial(coefficient: int, value: float, t: float, polynomial: PolynomialRecord) -> None:
    """Let a polynomial begin at t with another value of a coefficient; it has not moved before."""
    polynomial.t0 = t
    polynomial.c[coefficient] = 0.5 * value if coefficient == 2 else value


@kernel
def start_input(i: InputRecords, index: int, value: float, t: float) -> None:
    """Set the value of an input at the start time t, s. A motion of the input begins at t, whatever t is."""
    own = i.inputs[index]
    if own.role == GRAVITY_LOAD:
        i.world[0].gravity[own.coefficient] = value
    elif own.role == SUPPORT_MOTION:
        support = i.supports[own.number]
        begin_polynomial(own.coefficient, value, t, i.polynomials[support.polynomial])
        start_motion(support, i.segments[own.number], i.polynomials[support.polynomial])
    elif own.role == EXTRAPOLATED_LOAD:
        load = i.loads[own.number]
        begin_polynomial(own.coefficient, value, t, i.polynomials[load.polynomial])
        start_load(load, i.polynomials[load.polynomial])
    else:
        begin_polynomial(own.coefficient, value, t, i.polynomials[own.number])


@kernel
def set_input(i: InputRecords, index: int, value: float, rate: float, t: float) -> bool:
    """Take the value of an input at time t; return whether the equations of motion change at t.

    A load is held or extrapolated from t on; one with a rate continues from its present value. The target of a
    support is recorded for :func:`begin_support_motions`, which changes the equations later.

    ``rate`` is the time derivative at t, with which an input that takes a rate continues until it is set again; not a
    number: none is given.
    """
    own = i.inputs[index]
    if own.role == GRAVITY_LOAD:
        if i.world[0].gravity[own.coefficient] == value:
            return False
        i.world[0].gravity[own.coefficient] = value
        return True
    if own.role == SUPPORT_MOTION:
        set_motion_input(own.coefficient, value, i.supports[own.number])
        if own.takes_rate == 1:
            set_motion_rate(rate, i.supports[own.number])
        return False
    if own.role == EXTRAPOLATED_LOAD:
        load = i.loads[own.number]
        polynomial = i.polynomials[load.polynomial]
        changed = not load_finished(polynomial) or polynomial.c[0] != value
        set_load_input(t, value, rate, load, polynomial)
        return bool(changed or not load_finished(polynomial))
    if own.takes_rate == 1:
        return hold_ramp(value, 0.0 if np.isnan(rate) else rate, t, i.polynomials[own.number])
    return hold_value(own.coefficient, value, t, i.polynomials[own.number])


@kernel
def begin_support_motions(i: InputRecords, t: float, end: float) -> int:
    """Begin a step from t to ``end``, s; return the sum of what applies of LOADS_CHANGED,
    MOTION_STARTS and RATE_JUMPS.
    """
    found = 0
    for k in range(i.loads.shape[0]):
        load = i.loads[k]
        if load_starts(t, end, load, i.polynomials[load.polynomial]):
            found |= LOADS_CHANGED
    for k in range(i.supports.shape[0]):
        support = i.supports[k]
        plan_motion(t, end, support, i.segments[k], i.polynomials[support.polynomial], i.ahead[k])
        if support.departs == 1:
            found |= MOTION_STARTS
            if support.jump != 0.0:
                found |= RATE_JUMPS
    return found


@kernel
def perturb_motions(i: InputRecords, t: float, part: float) -> None:
    """Let supports that depart have, at t, an acceleration of a part of the jump of their rate.

    The first part is zero; :func:`restore_motions` takes all back.
    """
    for k in range(i.supports.shape[0]):
        support = i.supports[k]
        if support.departs == 1:
            polynomial = i.polynomials[support.polynomial]
            if part == 0.0:
                follow_path(polynomial.t0, polynomial.c, i.before[k])
            perturb_motion(t, part * support.jump, i.segments[k], polynomial)


@kernel
def restore_motions(i: InputRecords) -> None:
    """Let supports that depart be on their way still."""
    for k in range(i.supports.shape[0]):
        if i.supports[k].departs == 1:
            follow_path(i.before[k].t0, i.before[k].c, i.polynomials[i.supports[k].polynomial])


@kernel
def start_motions(i: InputRecords, tolerance: float) -> bool:
    """Let supports depart; whether the position of one jumps, farther than its rate explains.

    ``tolerance``: of a jump that is none, in units of the coordinate.
    """
    jumps = False
    for k in range(i.supports.shape[0]):
        support, ahead = i.supports[k], i.ahead[k]
        if support.departs == 1:
            follow_path(ahead.begin, ahead.path, i.polynomials[support.polynomial])
            adopt_segment(ahead, support, i.segments[k])
            if abs(ahead.position - ahead.path[0]) <= tolerance * support.size:
                ahead.jumps = 0
            jumps = jumps or ahead.jumps == 1
    return jumps


@kernel
def skip_points(i: InputRecords, t: float) -> None:
    """Note a communication point at which nothing changed."""
    for k in range(i.loads.shape[0]):
        skip_load_point(t, i.loads[k], i.polynomials[i.loads[k].polynomial])


@kernel
def all_finished(i: InputRecords) -> bool:
    """Whether every support and every load continues unchanged until an input is set."""
    settled = True
    for k in range(i.supports.shape[0]):
        settled = settled and motion_finished(i.supports[k], i.segments[k])
    for k in range(i.loads.shape[0]):
        settled = settled and load_finished(i.polynomials[i.loads[k].polynomial])
    return settled
