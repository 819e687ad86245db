"""First-order states of loads along joint coordinates in the structured tangent: condensed onto these coordinates.

The state z of such a load, such as the bristle of a joint with friction, depends on one coordinate q. Like the
velocities it changes by c1 dz, and its rate by c2 dz. With the rate g of z and the force Q along q the rows of both are

    [ T_qq  T_qz ] [ dq ]   [ r_q ]         T_qz = -c1 dQ/dz          T_zz = c2 - c1 dg/dz
    [ T_zq  T_zz ] [ dz ] = [ r_z ],        T_zq = -(dg/dq + c1 dg/dv)

dz = (r_z - T_zq dq) / T_zz leaves the stiffness T_qq - T_qz T_zq / T_zz along q and the force r_q - T_qz r_z / T_zz.
How a state changes with other coordinates is left out, as other loads along coordinates leave it out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbfmu.mechanics.dispatch import apply_load
from mbfmu.mechanics.steps import COMPLEX_STEP_SIZE
from solvers.compiled.kernel import kernel
from solvers.system import Array

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from mbfmu.mechanics.tangent.layout import Layout
    from solvers.compiled.record import Reals


class StateTerms(NamedTuple):
    """Terms of k first-order states, each with one coordinate."""

    column: Array  # (k,) T_qz
    row: Array  # (k,) T_zq
    pivot: Array  # (k,) T_zz
    load: Array  # (n,) forces along the coordinates with those of the states

    @staticmethod
    def allocate(count: int, n: int) -> StateTerms:
        """Return zeroed terms of ``count`` states among ``n`` coordinates and states."""
        return StateTerms(np.zeros(count), np.zeros(count), np.zeros(count), np.zeros(n))


@kernel
def set_armature_stiffness(c2: float, arrays: Arrays, along: Reals) -> None:
    """along (nv,) <- c2 times the armatures of the joints."""
    for i in range(along.shape[0]):
        along[i] = 0.0
    for i in range(1, arrays.bodies.shape[0]):
        if arrays.bodies[i].armature != 0.0:
            along[arrays.bodies[i].vi] = c2 * arrays.bodies[i].armature


@kernel
def add_coordinate_stiffness(
    c1: float, c2: float, layout: Layout, arrays: Arrays, state: State, perturbed: State, along: Reals,
    terms: StateTerms,
) -> bool:  # fmt: skip
    """Add to ``along`` (nv,) the stiffness of the loads along coordinates, each by the coordinate itself, and fill the
    terms of their states; False if a state cannot be condensed.
    """
    first = state.v.shape[0] - arrays.world[0].states
    for k in range(layout.along.shape[0]):
        load, body = arrays.loads[layout.along[k, 0]], arrays.bodies[layout.along[k, 1]]
        q, v, number = body.qi + layout.along[k, 2], body.vi + layout.along[k, 2], layout.along[k, 3]
        z = first + number
        if layout.along[k, 2] < body.nq - 4 * body.quaternion:
            perturbed.q[q] = state.q[q] + COMPLEX_STEP_SIZE * 1j
        perturbed.v[v] = state.v[v] + c1 * COMPLEX_STEP_SIZE * 1j
        perturbed.Q[v] = 0.0
        if number >= 0:
            perturbed.Q[z] = 0.0
        apply_load(load, state.time[0], arrays, perturbed)
        along[v] -= perturbed.Q[v].imag / COMPLEX_STEP_SIZE
        perturbed.q[q], perturbed.v[v] = state.q[q], state.v[v]
        if number >= 0:
            terms.row[number] = -perturbed.Q[z].imag / COMPLEX_STEP_SIZE
            perturbed.v[z] = state.v[z] + c1 * COMPLEX_STEP_SIZE * 1j
            perturbed.Q[v], perturbed.Q[z] = 0.0, 0.0
            apply_load(load, state.time[0], arrays, perturbed)
            terms.column[number] = -perturbed.Q[v].imag / COMPLEX_STEP_SIZE
            terms.pivot[number] = c2 - perturbed.Q[z].imag / COMPLEX_STEP_SIZE
            perturbed.v[z] = state.v[z]
            if not terms.pivot[number] > 0.0:
                return False
            along[v] -= terms.column[number] * terms.row[number] / terms.pivot[number]
    return True


@kernel
def condense_states(r: Reals, layout: Layout, arrays: Arrays, terms: StateTerms) -> None:
    """terms.load (n,) <- r with the forces along coordinates that their states leave."""
    first = r.shape[0] - arrays.world[0].states
    for i in range(r.shape[0]):
        terms.load[i] = r[i]
    for k in range(layout.along.shape[0]):
        body, number = arrays.bodies[layout.along[k, 1]], layout.along[k, 3]
        if number >= 0 and body.vf >= 0:
            terms.load[body.vf + layout.along[k, 2]] -= terms.column[number] * r[first + number] / terms.pivot[number]


@kernel
def expand_states(r: Reals, layout: Layout, arrays: Arrays, terms: StateTerms, dq: Reals) -> None:
    """Fill the changes of the states in dq (n,) from those of their coordinates."""
    first = r.shape[0] - arrays.world[0].states
    for k in range(layout.along.shape[0]):
        body, number = arrays.bodies[layout.along[k, 1]], layout.along[k, 3]
        if number >= 0:
            moved = terms.row[number] * dq[body.vf + layout.along[k, 2]] if body.vf >= 0 else 0.0
            dq[first + number] = (r[first + number] - moved) / terms.pivot[number]
