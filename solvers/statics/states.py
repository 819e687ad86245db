"""First-order states as unknowns of a steady state.

In a steady state z' = g(t, q, v, z) = 0. Newton's method changes positions, so the equations are given another form, in
which the states are positions too: q* = (q, z). Their equations are -w g = 0, with a weight w that makes them as large
as forces, so that one norm and one threshold of pivots serve for all rows: w = E / (nominal value)^2 / rate, where E is
the energy of the mechanism that moves by its own units at its rate.

Of a state that is held at rest g is zero for every z. Its equation is w rate (z - z0) = 0 with its start value z0.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from solvers.compiled.kernel import COMPILED, callback, types
from solvers.compiled.tuple_pointer import pointer_type
from solvers.positions import Positions
from solvers.system import Array, System, Terms


class StateEquations(NamedTuple):
    """What the callbacks of :func:`with_states_as_positions` call."""

    dynamics: Any
    retract: Any
    data: Any
    v: Any  # (n,) complex: velocities with the values of the states
    weights: Array  # (k,) w
    rate: Array  # (1,) 1/s
    is_held: Array  # (k,) 1: the state keeps its start value
    start: Array  # (k,)


def dynamics(t: float, q: Any, v: Any, data: Any, terms: Any) -> None:
    """All terms at q* = (q, z), with velocities v whose last entries are zero."""
    n, k = v.shape[0], data.weights.shape[0]
    for i in range(n):
        data.v[i] = v[i]
    for i in range(k):
        data.v[n - k + i] = v[n - k + i] + q[q.shape[0] - k + i]
    data.dynamics(t, q, data.v, data.data, terms)
    for i in range(k):
        if data.is_held[i] == 1.0:
            terms.h[n - k + i] = data.rate[0] * (data.v[n - k + i] - data.start[i])
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
    is_held = np.array(system.held_states or [False] * k, float)
    data = StateEquations(
        system.dynamics, system.retract, system.pinned_data, v.copy(), weights, np.array([rate]), is_held, z.copy()
    )
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
