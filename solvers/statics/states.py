"""First-order states as unknowns of a steady state.

In a steady state z' = g(t, q, v, z) = 0. Newton's method changes positions, so the equations are given another form, in
which the states are positions too: q* = (q, z). Their equations are -w g = 0, with a weight w that makes them as large
as forces, so that one norm and one threshold of pivots serve for all rows: w = E / (nominal value)^2 / rate, where E is
the energy of the mechanism that moves by its own units at its rate.

Of the bristle of a friction without slip g is zero for every z. Its equation is w rate (z - z0) = 0 with its start
value z0, see :func:`hold_states`; or w rate (z - z0 - G (q - q0)) = 0 with G = dg/dv, if the friction sticks at its
start position q0 as an elastic bristle, see :func:`let_stick`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from solvers.compiled.kernel import COMPILED, callback, types
from solvers.compiled.tuple_pointer import pointer_type
from solvers.positions import Positions, as_motion
from solvers.projection.products import PRODUCT_STEP_SIZE
from solvers.system import Array, System, Terms

MAX_RESTING_RATE = 1e-6  # of a state that is held, in its nominal value and the rate of the mechanism
SLIPPING_START = 4.0  # in nominal values: where the search for the state of a friction that slips begins


class StateEquations(NamedTuple):
    """What the callbacks of :func:`with_states_as_positions` call."""

    dynamics: Any
    retract: Any
    data: Any
    v: Any  # (n,) complex: velocities with the values of the states
    weights: Array  # (k,) w
    rate: Array  # (1,) 1/s
    is_held: Array  # (k,) 1: the state keeps its start value
    start: Array  # (k,) z0
    sticks: Array  # (1,) 1: as they stick at the start position
    start_position: Any  # (nq,) complex, q0
    gradient: Array  # (k, n) G
    change: Any  # (nq,) complex: q - q0
    motion: Any  # (n,) complex: the same as a motion
    layout: Positions


def dynamics(t: float, q: Any, v: Any, data: Any, terms: Any) -> None:
    """All terms at q* = (q, z), with velocities v whose last entries are zero."""
    n, k = v.shape[0], data.weights.shape[0]
    for i in range(n):
        data.v[i] = v[i]
    for i in range(k):
        data.v[n - k + i] = v[n - k + i] + q[q.shape[0] - k + i]
    data.dynamics(t, q, data.v, data.data, terms)
    if data.sticks[0] == 1.0:
        for i in range(data.change.shape[0]):
            data.change[i] = q[i] - data.start_position[i]
        as_motion(data.start_position, data.change, data.layout, data.motion)
    for i in range(k):
        if data.is_held[i] == 1.0:
            resting = data.v[n - k + i] - data.start[i]
            for j in range(n - k):
                resting -= data.gradient[i, j] * data.motion[j]
            terms.h[n - k + i] = data.rate[0] * resting
        terms.h[n - k + i] *= data.weights[i]
        terms.M[n - k + i, n - k + i] = data.weights[i] / data.rate[0]


def retract(q: Any, dq: Any, data: Any) -> None:
    """q* <- q* (+) dq."""
    data.retract(q, dq, data.data)
    k = data.weights.shape[0]
    for i in range(k):
        q[q.shape[0] - k + i] += dq[dq.shape[0] - k + i]


def with_states_as_positions(system: System, t: float, q: Array, z: Array) -> tuple[System, Array]:
    """Return the complex twin of a system with its first-order states as positions, and q* = (q, z).

    A system without states is returned as it is.
    """
    k = system.n_states
    if k == 0:
        return system, q
    terms, v = system.allocate_terms(complex), np.zeros(system.n, complex)
    v[system.n - k :] = z
    system.fill(t, q.astype(complex), v, terms)
    moving = system.n - k
    inertia = np.abs(terms.M.real[:moving, :moving] * np.outer(system.size[:moving], system.size[:moving]))
    rate = system.rate or 1.0
    weights = (float(inertia.max(initial=0.0)) or 1.0) * rate / system.size[moving:] ** 2
    data = StateEquations(
        system.dynamics, system.retract, system.pinned_data, v.copy(), weights, np.array([rate]), np.zeros(k), z.copy(),
        np.zeros(1), np.zeros(system.nq, complex), np.zeros((k, system.n)), np.zeros(system.nq, complex),
        np.zeros(system.n, complex), system.placed,
    )  # fmt: skip
    evaluate, change = _callbacks(data)
    placed = system.placed
    positions = Positions(
        np.concatenate((placed.in_q, np.arange(system.nq, system.nq + k))),
        np.concatenate((placed.in_v, placed.states)),
        placed.turning,
        placed.states[:0],
    )
    extended = replace(
        system, nq=system.nq + k, n_states=0, positions=positions, data=data, dynamics=evaluate, retract=change
    )
    return extended, np.concatenate((q, z))


def hold_states(extended: System, system: System, t: float, q: Array, v: Array) -> None:
    """Let the states keep their start values that do not change in the steady motion: of ``system.held_states`` those
    with g = 0 at z = 0.

    Parameters
    ----------
    extended, system
        The system of :func:`with_states_as_positions`, and the one it was made of.
    t, q, v
        Time, positions (nq,) and velocities (n,) of the steady motion.
    """
    at = v.astype(complex)
    at[system.n_velocities :] = 0.0
    change = np.abs(rates_of_states(system, t, q, at).real) / system.size[system.n_velocities :]
    extended.data.is_held[:] = system.held_states & (change <= MAX_RESTING_RATE * (system.rate or 1.0))


def start_values(extended: System, system: System, t: float, q: Array, v: Array) -> Array:
    """Return the values (k,) from which Newton's method begins, with the arguments of :func:`hold_states`, which comes
    first: the start values, except those of frictions that slip.

    The rate of a bristle depends on its deflection only if it is nearly as large as it can be: Newton's method cannot
    begin with no deflection. Beyond the largest one the rate is linear in the deflection.
    """
    at = v.astype(complex)
    at[system.n_velocities :] = 0.0
    rate = rates_of_states(system, t, q, at).real
    slips = np.asarray(system.held_states, bool) & (extended.data.is_held == 0.0)
    return np.where(slips, SLIPPING_START * system.size[system.n_velocities :] * np.sign(rate), extended.data.start)


@contextmanager
def let_stick(extended: System, system: System, t: float, q: Array, v: Array) -> Iterator[None]:
    """Let the frictions whose states are held stick at positions q (nq,), with the arguments of :func:`hold_states`."""
    data, at = extended.data, v.astype(complex)
    at[system.n_velocities :] = 0.0
    for j in range(system.n_velocities):
        at[j] += PRODUCT_STEP_SIZE * 1j
        data.gradient[:, j] = rates_of_states(system, t, q, at).imag / PRODUCT_STEP_SIZE
        at[j] = v[j]
    data.start_position[:] = q
    data.sticks[0] = 1.0
    try:
        yield
    finally:
        data.sticks[0] = 0.0
        data.motion[:] = 0.0


def can_hold(extended: System, system: System, t: float, q: Array, v: Array) -> bool:
    """Whether the frictions that stick can hold the forces in their states: those, at the end of v (n,), do not
    decrease if the bodies slip further in the direction of the deflections.
    """
    data, z = extended.data, v[system.n_velocities :]
    further = (data.is_held * z) @ data.gradient
    size = float(np.abs(further / system.size).max(initial=0.0))
    if size == 0.0:
        return True
    slow = MAX_RESTING_RATE * (system.rate or 1.0) / size * further
    change = rates_of_states(system, t, q, (v + slow).astype(complex)).real * z * data.is_held
    return bool(np.all(change >= -MAX_RESTING_RATE * np.abs(data.gradient @ slow)))


def rates_of_states(system: System, t: float, q: Array, v: Any) -> Any:
    """Return g (k,) of a complex system."""
    terms = system.allocate_terms(complex)
    system.fill(t, q.astype(complex), v, terms)
    return -terms.h[system.n_velocities :]


def _callbacks(data: StateEquations) -> tuple[Any, Any]:
    if not COMPILED:
        return dynamics, retract
    held, terms, vector = pointer_type(data), pointer_type(Terms.allocate(1, 1, 1, complex)), types.complex128[::1]
    signatures = types.void(types.float64, vector, vector, held, terms), types.void(vector, vector, held)
    functions: tuple[Any, ...] = dynamics, retract
    made: list[Any] = []
    for signature, function in zip(signatures, functions, strict=True):
        made.append(callback(signature)(function))
        # numba does not find the type of a callback in a process that has loaded all code and compiled none
        made[-1]._numba_type_ = types.FunctionType(signature)
    return made[0], made[1]
