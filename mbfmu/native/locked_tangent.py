"""Locked joints in the structured tangent of a native FMU.

In Python every set of locked joints has its own tangent. Here the layout of the tangent T is that of the export, and
the coordinates of locked joints are held by forces f: with their unit vectors as columns of E::

    T dq = r + E f,    E^T dq = 0,      so that     dq = T^-1 r - W (E^T W)^-1 E^T T^-1 r,    W = T^-1 E

W is found when T is factored. The residual of a locked coordinate, which is the force that holds it, is left out.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.arrays.compiled_mechanism import CompiledMechanism
from mbfmu.mechanics.arrays.numbering import joints_to_hold
from mbfmu.mechanics.recursions import dynamics as recursions
from mbfmu.mechanics.tangent import factored
from mbfmu.mechanics.tangent.factored import empty_tangent
from solvers.compiled.kernel import kernel, system_kernel
from solvers.compiled.tuple_pointer import pin, unpin
from solvers.linalg.inversion import invert
from solvers.steppers import recursive_system
from solvers.system import AnySystem, Array


class LockableTangent(NamedTuple):
    """A structured tangent, and what locks up to k joints in it."""

    own: Any  # mbfmu.mechanics.tangent.solving.TangentData, pinned
    arrays: Any  # its arrays, pinned
    n_factored: NDArray[np.int64]  # (1,) how often it has been factored
    bodies: NDArray[np.int64]  # (k,) bodies whose joints can be locked
    places: NDArray[np.int64]  # (k,) free velocities of those that are locked, in its first entries
    n_locked: NDArray[np.int64]  # (1,) their number
    columns: Array  # (k, n) rows of W^T
    inverse: Array  # (k, k) of E^T W in its first rows and columns
    scratch: Array  # (k, k)
    order: NDArray[np.int64]  # (k,) scratch
    forces: Array  # (k,) scratch
    unit: Array  # (n,) scratch

    @staticmethod
    def of(tangent: Any, bodies: list[int], n: int) -> Any:
        """Return that of a mechanism with n coordinates and states by the data of its tangent, pinned."""
        known, k, z, i = unpin(tangent), len(bodies), np.zeros, np.int64
        return pin(
            LockableTangent(
                tangent, known.arrays, known.n_factored, np.array(bodies, i), z(k, i), z(1, i),
                z((k, n)), z((k, k)), z((k, k)), z(k, i), z(k), z(n),
            )
        )  # fmt: skip


def lockable_tangent(compiled: CompiledMechanism, tangent: Any) -> Any:
    """Return the tangent of a compiled mechanism by the data of that of its system, pinned."""
    system: AnySystem = compiled.system
    return LockableTangent.of(tangent, joints_to_hold(compiled.mechanism), system.n)


def tree_tangent(compiled: CompiledMechanism) -> Any:
    """Return that of a large tree."""
    return lockable_tangent(compiled, recursive_system(compiled.system).tangent.callbacks.tangent)


def empty_lockable_tangent() -> Any:
    """Return one whose data have the types that all mechanisms have."""
    return LockableTangent.of(empty_tangent(), [0], 1)


@kernel
def find_locked(tangent: LockableTangent) -> int:
    """Fill the places of the joints that are locked now; return their number."""
    count = 0
    for k in range(tangent.bodies.shape[0]):
        body = tangent.arrays.bodies[tangent.bodies[k]]
        if body.drive >= 0 and body.vf >= 0:
            tangent.places[count] = body.vf
            count += 1
    return count


@system_kernel
def factor_tangent(c1: float, c2: float, weight: Any, symmetric: bool, tangent: Any) -> bool:
    """As :class:`solvers.system.TangentCallbacks` has it."""
    if not factored.factor_tangent(c1, c2, weight, symmetric, tangent.own):
        return False
    count = find_locked(tangent)
    tangent.n_locked[0] = count
    for k in range(count):
        tangent.unit[tangent.places[k]] = 1.0
        factored.solve_tangent(tangent.unit, tangent.own, tangent.columns[k])
        tangent.unit[tangent.places[k]] = 0.0
    if count == 0:
        return True
    for k in range(count):
        for j in range(count):
            tangent.inverse[k, j] = tangent.columns[j, tangent.places[k]]
    used = tangent.inverse[:count, :count], tangent.order[:count], tangent.scratch[:count, :count]
    regular: bool = invert(*used)
    return regular


@system_kernel
def solve_tangent(r: Any, tangent: Any, dq: Any) -> None:
    """As :class:`solvers.system.TangentCallbacks` has it; locked coordinates do not change."""
    factored.solve_tangent(r, tangent.own, dq)
    count = tangent.n_locked[0]
    for k in range(count):
        tangent.forces[k] = 0.0
        for j in range(count):
            tangent.forces[k] += tangent.inverse[k, j] * dq[tangent.places[j]]
    for k in range(count):
        for i in range(dq.shape[0]):
            dq[i] -= tangent.forces[k] * tangent.columns[k, i]
    for k in range(count):
        dq[tangent.places[k]] = 0.0


@system_kernel
def multiply_mass_matrix(a: Any, tangent: Any, tau: Any) -> None:
    """As :class:`solvers.system.TangentCallbacks` has it."""
    factored.multiply_mass_matrix(a, tangent.own, tau)


@system_kernel
def inverse(t: float, q: Any, v: Any, a: Any, lam: Any, data: Any, qdot: Any, tau: Any) -> None:
    """As that of a :class:`solvers.system.TreeSystem`, without the forces that hold locked joints."""
    recursions.inverse(t, q, v, a, lam, data, qdot, tau)
    bodies = data.arrays.bodies
    for i in range(1, bodies.shape[0] if data.arrays.world[0].drives == 1 else 0):
        if bodies[i].drive >= 0 and bodies[i].vf >= 0:
            tau[bodies[i].vf] = 0.0


LOCKABLE_TANGENT_KERNELS = {
    "factor_tangent": factor_tangent,
    "solve_tangent": solve_tangent,
    "multiply_mass_matrix": multiply_mass_matrix,
}
