"""What communication points do in machine code, as in :class:`mbfmu.Simulation`: kernels over instances."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbfmu.mechanics.arrays.load_groups import largest_ratio
from mbfmu.mechanics.arrays.points import GRAVITY_LOAD, begin_inputs, set_input, start_motions
from mbfmu.mechanics.recursions.dynamics import energy
from solvers.balance import BALANCE_OK, check_energy_balance, energy_floor
from solvers.compiled.kernel import kernel
from solvers.energy_account import EXCHANGED_ENERGY, PASSAGE_ENERGY
from solvers.outcome import OK

RUN_STATUS = np.dtype(
    [
        ("code", np.int64),  # how the last advance ended
        ("unknown", np.int64),  # 1: the rate of a support that departs jumps where its impulse is not known
        ("jumps", np.int64),  # 1: a support has jumped in position, farther than its rate explains
        ("flaw", np.int64),  # what is wrong with the start, see start_checks.Flaw; zero: nothing
        ("lost", np.int64),  # result of the check of the energy balance in solvers.balance
        ("lost_at", np.float64),  # s, where that was seen first; by how much, and what was exchanged until then, J
        ("energy_error", np.float64),
        ("exchanged", np.float64),
        ("passage", np.float64),  # J, of the last slow passage until then, see solvers.energy_account
        ("before", np.float64),  # J, energy before parameters change
        (
            "limit_ratio",
            np.float64,
        ),  # of elements at the last communication point, see mbfmu.mechanics.loads.base
    ],
    align=True,
)


@kernel
def energy_at(instance: Any) -> float:
    """Kinetic and potential energy at the reported state, J."""
    done: float = energy(instance.clock[0], instance.given.q, instance.given.v, instance.given.eqs.data)
    return done


@kernel
def begin_points(instance: Any, code: int) -> None:
    """Begin at the reported state; ``code`` is the result of its assembly."""
    status, balance, bodies, mass = (
        instance.run_status[0],
        instance.balance[0],
        instance.given.eqs.data.arrays.bodies,
        0.0,
    )
    begin_inputs(instance.inputs)
    status.code, status.unknown, status.jumps, status.lost, status.limit_ratio = code, 0, 0, 0, 0.0
    for k in range(bodies.shape[0]):
        mass += bodies[k].mass
    balance.last_passage_energy = 0.0
    balance.reference_energy, balance.energy_floor = (
        energy_at(instance),
        energy_floor(mass, instance.known[2], instance.known[0], balance.tolerance),
    )


@kernel
def apply_input(instance: Any, index: int, value: float) -> int:
    """Take the value of an input at the reported time; return its role."""
    role: int = instance.inputs.inputs[index].role
    before = energy_at(instance) if role == GRAVITY_LOAD else 0.0
    set_input(instance.inputs, index, value, instance.clock[0])
    if role == GRAVITY_LOAD:
        instance.balance[0].reference_energy += energy_at(instance) - before
    return role


@kernel
def store_velocity_jump(instance: Any, k: int) -> None:
    """Put into ``instance.dv`` the difference of the accelerations at two motions of the supports, ``k`` = 0 and 1."""
    for i in range(instance.dv.shape[0]):
        instance.dv[i] = instance.a[i] - (instance.dv[i] if k == 1 else 0.0)


@kernel
def start_support_motion(instance: Any, before: float, jumps: bool) -> None:
    """Let supports depart, with the impulse ``instance.dv`` where rates of them jump; its work is no energy error.

    ``before`` is the energy until then, J.
    """
    if start_motions(instance.inputs, instance.options[0].rtol):
        instance.run_status[0].jumps = 1
    if jumps:
        for i in range(instance.dv.shape[0]):
            instance.given.v[i] += instance.dv[i]
    instance.balance[0].reference_energy += energy_at(instance) - before


@kernel
def record_outcome(instance: Any, t: float, code: int) -> None:
    """Note how an advance to t (s) has ended."""
    instance.clock[0] = t if code == OK else instance.given.memory.control[0].t
    instance.run_status[0].code = code


@kernel
def check_energy(instance: Any, now: float) -> float:
    """Hold the reported state, of energy ``now``, to its balance; return the energy error, J."""
    energy_error, found = check_energy_balance(instance.balance, now, instance.given.energy_account)
    status = instance.run_status[0]
    if found != BALANCE_OK and status.lost == BALANCE_OK:
        status.lost, status.lost_at = found, instance.clock[0]
        status.energy_error, status.exchanged, status.passage = (
            energy_error,
            instance.given.energy_account[EXCHANGED_ENERGY],
            instance.given.energy_account[PASSAGE_ENERGY],
        )
    return energy_error


@kernel
def measure_limit_ratio(instance: Any) -> None:
    """Note how far elements are from the limits of their theory at the reported state."""
    if instance.monitored.shape[0] > 0:
        energy_at(instance)  # places the bodies
        data = instance.given.eqs.data
        instance.run_status[0].limit_ratio = largest_ratio(instance.monitored, data.arrays, data.state)


@kernel
def fill_energy_outputs(instance: Any) -> None:
    """Put energy error and throughput in place of the energies that the outputs end in; NaN without energy check."""
    out, last = instance.out, instance.out.shape[0] - 1
    if instance.balance[0].is_checked == 1:
        out[last - 1], out[last] = (
            check_energy(instance, out[last - 1]),
            instance.given.energy_account[EXCHANGED_ENERGY],
        )
    else:
        out[last - 1], out[last] = np.nan, np.nan
