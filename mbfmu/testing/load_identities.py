"""Identities of the loads of a mechanism: their tangents, limits of validity and scratch memory."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from mbfmu.mechanics import CompiledMechanism, Load
from mbfmu.mechanics.arrays.bounds import OWN_PACKAGES
from mbfmu.mechanics.dispatch import (
    apply_load,
    load_longest_step,
    load_monitor,
    load_potential,
    load_power,
    load_tangent,
)
from mbfmu.mechanics.kind import kernel_of
from mbfmu.mechanics.records import to_complex_state
from mbfmu.mechanics.recursions.dynamics import update_kinematics
from mbfmu.mechanics.steps import COMPLEX_STEP_SIZE, step
from solvers.compiled.tuple_pointer import pin, unpin
from solvers.system import Array

from .identities import Deviation, State, compare

TAKEN = 0.01  # s, the last step of a solver
C1 = 3.0  # of the tangent: derivatives by velocities are multiplied by it, 1/s
MIN_SCALE = 1e-300  # of numbers that are compared relative to their own size


def has_tangent(load: Load) -> bool:
    """Whether a load has a user-defined kernel ``tangent``; those of the package have separate tests."""
    tangent = kernel_of(load, "tangent")
    return tangent is not None and not tangent.__module__.startswith(OWN_PACKAGES)


def load_tangents(compiled: CompiledMechanism, at: State) -> Iterator[Deviation]:
    """The tangent of a load is minus the derivative of what it applies, by complex steps of the motions of its bodies.

    It adds to the matrix, whatever is in there and in the scratch memory.
    """
    rng, data = np.random.default_rng(2), compiled.data
    update_kinematics(at.t, at.q, at.v, *compiled.kernel_data)
    arrays, state = pin(compiled.tangent_arrays()), compiled.kernel_data[1]
    system, perturbed = compiled.complex_system(), to_complex_state(data.state)
    for e, acting in enumerate(compiled.mechanism.loads()):
        if not has_tangent(acting.load):
            continue
        bodies = [body.index for body in acting.bodies]
        count, here, moved = 6 * len(bodies), data.state.bodies, system.data.state.bodies
        expected = np.zeros((count, count))
        for j in range(count):
            for p, i in enumerate(bodies):
                step(here[i], moved[i], j - 6 * p, C1)
            apply_load(system.data.arrays.loads[e], at.t, *unpin(system.pinned_data))
            expected[:, j] = -np.concatenate([moved["F"][i].imag / COMPLEX_STEP_SIZE for i in bodies])
        for i in bodies:
            step(here[i], moved[i], -1, 0.0)
        names = [f"row {k}, column {j} of the tangent of {acting.what}" for k in range(count) for j in range(count)]
        data.state.scratch[:] = 0
        perturbed.scratch[:] = 0
        for start in (np.zeros((count, count)), np.abs(expected).max() * rng.normal(size=(count, count))):
            K = start.copy()
            used = load_tangent(data.arrays.loads[e], C1, arrays, state, pin(perturbed), K)
            found = K - start if used == 1.0 else np.where(K == start, 0.0, np.nan)  # 0.0: nothing may be added
            yield compare(found, expected, names, least=MIN_SCALE)


def load_values(compiled: CompiledMechanism, at: State) -> Iterator[Deviation]:
    """Kernels do not depend on what earlier calls left in the scratch memory, and monitors and longest steps are at
    least zero.
    """
    rng, memory = np.random.default_rng(3), compiled.data.state.scratch
    elsewhere, q = 0.1 * rng.normal(size=compiled.system.n), at.q.copy()
    compiled.system.apply(q, elsewhere)
    expected = _results(compiled, at, np.zeros_like(memory))
    _results(compiled, at._replace(q=q, v=at.v + elsewhere), None)
    found = _results(compiled, at, memory.copy())
    for name, values in expected.items():
        names = [f"{name}, after a call in another state," for _ in values]
        yield compare(found[name], values, names, least=MIN_SCALE)
        if name.startswith(("monitor", "longest step")):
            yield compare(values, np.maximum(values, 0.0), [name])


def _results(compiled: CompiledMechanism, at: State, memory: Any) -> dict[str, Array]:
    """Return what every kernel of the loads gives at a state; before each the scratch memory is set to ``memory``
    (bytes), None: is left as it is.
    """
    data, (arrays, state) = compiled.data, compiled.kernel_data
    update_kinematics(at.t, at.q, at.v, arrays, state)
    own, found = data.state, dict[str, Array]()
    for e, acting in enumerate(compiled.mechanism.loads()):
        load = data.arrays.loads[e]
        for name in ("force", "potential", "power", "monitor", "longest step"):
            if memory is not None:
                own.scratch[:] = memory
            if name == "force":
                own.bodies["F"][:], own.Q[:] = 0.0, 0.0
                apply_load(load, at.t, arrays, state)
                value: Any = np.concatenate((own.bodies["F"].ravel(), own.Q))
            elif name == "power":
                value = load_power(load, at.t, arrays, state)
            elif name == "longest step":
                value = 1.0 / load_longest_step(load, TAKEN, arrays, state)
            else:
                value = (load_potential if name == "potential" else load_monitor)(load, arrays, state)
            found[f"{name} of {acting.what} (load {e})"] = np.atleast_1d(value)
    return found
