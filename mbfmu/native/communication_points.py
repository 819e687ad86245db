"""What communication points do in machine code, as in :class:`mbfmu.Simulation`: kernels over instances."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbfmu.mechanics.arrays.bending import find_largest_angle
from mbfmu.mechanics.arrays.points import GRAVITY_LOAD, begin_inputs, set_input, start_motions
from mbfmu.mechanics.recursions.dynamics import energy
from solvers.balance import BALANCE_OK, check_energy_balance, energy_floor
from solvers.compiled.kernel import kernel
from solvers.energy_account import EXCHANGED_ENERGY, PASSAGE_ENERGY
from solvers.outcome import OK

TOLD = np.dtype(
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
        ("bent", np.float64),  # rad, the sharpest angle of a plate's edge at the last communication point
    ],
    align=True,
)


@kernel
def energy_at(s: Any) -> float:
    """Kinetic and potential energy at the reported state, J."""
    done: float = energy(s.clock[0], s.given.q, s.given.v, s.given.eqs.data)
    return done


@kernel
def begin_points(s: Any, code: int) -> None:
    """Begin at the reported state; ``code`` is the result of its assembly."""
    told, b, bodies, mass = s.told[0], s.balance[0], s.given.eqs.data.arrays.bodies, 0.0
    begin_inputs(s.inputs)
    told.code, told.unknown, told.jumps, told.lost, told.bent = code, 0, 0, 0, 0.0
    for k in range(bodies.shape[0]):
        mass += bodies[k].mass
    b.last_passage_energy = 0.0
    b.reference_energy, b.energy_floor = energy_at(s), energy_floor(mass, s.known[2], s.known[0], b.tolerance)


@kernel
def take(s: Any, index: int, value: float) -> int:
    """Take the value of an input at the reported time; return its role."""
    role: int = s.inputs.inputs[index].role
    before = energy_at(s) if role == GRAVITY_LOAD else 0.0
    set_input(s.inputs, index, value, s.clock[0])
    if role == GRAVITY_LOAD:
        s.balance[0].reference_energy += energy_at(s) - before
    return role


@kernel
def note_rates(s: Any, k: int) -> None:
    """Put into ``s.dv`` by how much the accelerations are others at the second of two motions of the supports."""
    for i in range(s.dv.shape[0]):
        s.dv[i] = s.a[i] - (s.dv[i] if k == 1 else 0.0)


@kernel
def leave(s: Any, before: float, jumps: bool) -> None:
    """Let supports depart, with the impulse ``s.dv`` where rates of them jump; its work is no energy error.

    ``before`` is the energy until then, J.
    """
    if start_motions(s.inputs, s.options[0].rtol):
        s.told[0].jumps = 1
    if jumps:
        for i in range(s.dv.shape[0]):
            s.given.v[i] += s.dv[i]
    s.balance[0].reference_energy += energy_at(s) - before


@kernel
def arrive(s: Any, t: float, code: int) -> None:
    """Note how an advance to t (s) has ended."""
    s.clock[0] = t if code == OK else s.given.memory.control[0].t
    s.told[0].code = code


@kernel
def look(s: Any, now: float) -> float:
    """Hold the reported state, of energy ``now``, to its balance; return the energy error, J."""
    energy_error, found = check_energy_balance(s.balance, now, s.given.energy_account)
    told = s.told[0]
    if found != BALANCE_OK and told.lost == BALANCE_OK:
        told.lost, told.lost_at = found, s.clock[0]
        told.energy_error, told.exchanged, told.passage = (
            energy_error,
            s.given.energy_account[EXCHANGED_ENERGY],
            s.given.energy_account[PASSAGE_ENERGY],
        )
    return energy_error


@kernel
def look_at_plates(s: Any) -> None:
    """Note how sharply plates bend at the reported state."""
    if s.cells.shape[0] > 0:
        energy_at(s)  # places the bodies
        s.told[0].bent = find_largest_angle(s.cells, s.given.eqs.data.state.bodies)


@kernel
def tell_balance(s: Any) -> None:
    """Put energy error and throughput in place of the energies that the outputs end in; NaN without energy check."""
    out, last = s.out, s.out.shape[0] - 1
    if s.balance[0].is_checked == 1:
        out[last - 1], out[last] = look(s, out[last - 1]), s.given.energy_account[EXCHANGED_ENERGY]
    else:
        out[last - 1], out[last] = np.nan, np.nan
