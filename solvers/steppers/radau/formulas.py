"""The formulas of Radau IIA, order 5 in three stages, for q' = N(q) v, v' = a(t, q, v).

The stages V_i = v + Z_i at t + c_i h satisfy Z = h A a(Q, V), with positions Q_i = q + h sum_j A_ij N_j V_j that follow
from them. Newton's matrix falls apart by the eigenvalues of A^-1, gamma and alpha +- i beta, into

    E(lambda) = lambda / h - a_v - (h / lambda) a_q                        (n, n), real and complex

as positions are eliminated. The error is that of an embedded formula of order 3, filtered by E(gamma). Source: Hairer
and Wanner, *Solving Ordinary Differential Equations II* (1996), sections IV.5 and IV.8; the elimination is that of
second-order equations, p. 127 there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import inlined, kernel, records
from solvers.energy_account import ACCOUNT_FIELDS
from solvers.linalg.dense import factor_lu, solve_lu
from solvers.positions import has_quaternions
from solvers.system import Array

if TYPE_CHECKING:
    from solvers.compiled.record import Integers, Reals

N_STAGES = 3
R6 = np.sqrt(6.0)
NODES = np.array([(4.0 - R6) / 10.0, (4.0 + R6) / 10.0, 1.0])
A = np.array(
    [
        [(88.0 - 7.0 * R6) / 360.0, (296.0 - 169.0 * R6) / 1800.0, (-2.0 + 3.0 * R6) / 225.0],
        [(296.0 + 169.0 * R6) / 1800.0, (88.0 + 7.0 * R6) / 360.0, (-2.0 - 3.0 * R6) / 225.0],
        [(16.0 - R6) / 36.0, (16.0 + R6) / 36.0, 1.0 / 9.0],
    ]
)  # the last row is the step itself
E = np.array([-(13.0 + 7.0 * R6), -13.0 + 7.0 * R6, -1.0]) / 3.0  # of the embedded formula, on Z

_values, _vectors = np.linalg.eig(np.linalg.inv(A))
_real, _complex = int(np.argmin(abs(_values.imag))), int(np.argmax(_values.imag))
_inverse = np.linalg.inv(_vectors)
REAL_EIGENVALUE, COMPLEX_EIGENVALUE = float(_values[_real].real), complex(_values[_complex])  # eigenvalues of A^-1
TO_REAL, TO_COMPLEX = _inverse[_real].real.copy(), _inverse[_complex].copy()  # Z into the two parts
FROM_REAL, FROM_COMPLEX = _vectors[:, _real].real.copy(), 2.0 * _vectors[:, _complex]  # and back: real part of the sum

CONTROL = np.dtype(
    [
        ("t", "f8"), ("h", "f8"), ("hold", "f8"),  # time reached, next step, last step
        ("start", "i8"), ("is_projected", "i8"),  # y' at y is to be evaluated again; y satisfies the constraints
        ("truncated_steps", "i8"),  # steps yet to take that end at the requested time
        ("extrapolates", "i8"),  # the polynomial of the last step predicts the stages of this one
        ("contraction", "f8"),  # last correction of Newton, in units of the one before
        ("has_derivatives", "i8"), ("derivatives_at_start", "i8"),  # of a are at hand; they were evaluated at y
        ("last_error", "f8"), ("last_error_step", "f8"),  # of the last accepted step, and its size
        ("last_estimate", "f8"),  # of that error, however small
        ("inertia_factor", "f8"),  # tolerance where the mass matrix is nearly singular, in units of that elsewhere
        ("corner_end", "f8"),  # s, end of the last step that was refused because of a corner of a force
        ("rank", "i8"),
        ("steps", "i8"), ("rejected", "i8"), ("evaluations", "i8"), ("starts", "i8"), ("matrices", "i8"),
        ("refused", "i8"),  # steps that might have jumped to another branch
        ("near_miss_factor", "f8"), ("max_near_miss_factor", "f8"), ("min_gap", "f8"),  # see adams.formulas
        ("undetermined", "i8"), ("undetermined_at", "f8"),
        *ACCOUNT_FIELDS,
    ],
    align=True,
)  # fmt: skip


class Memory(NamedTuple):
    """All an integration remembers, and scratch; copying these arrays copies the integration."""

    control: NDArray[Any]  # (1,)  record of CONTROL
    q: Array  # (nq,)  state at control.t
    v: Array  # (n,)
    work: Array  # (1,)  W, J
    qdot: Array  # (nq,)  its derivatives
    a: Array  # (n,)
    power: Array  # (1,)  W
    q0: Array  # (nq,)  where the last step began
    v0: Array  # (n,)
    work0: Array  # (1,)
    qdot0: Array  # (nq,)
    a0: Array  # (n,)
    power0: Array  # (1,)
    Z: Array  # (3, n)  stages of v less v0
    a_q: Array  # (n, n)  derivatives of a by a motion of q, and by v, in units of size
    a_v: Array  # (n, n)
    tol_q: Array  # (nq,)  tolerance of q in this step
    tol_v: Array  # (n,)  of v
    Q: Array  # (3, nq)  positions of the stages
    N: Array  # (3, nq)  N V there
    F: Array  # (3, n)  accelerations there
    P: Array  # (3,)  powers there, W
    E1: Array  # (n, n)  factors of E(gamma)
    E2: NDArray[np.complex128]  # (n, n)  of E(alpha + i beta)
    order1: NDArray[np.int64]  # (n,)
    order2: NDArray[np.int64]  # (n,)
    b1: Array  # (n,)
    x1: Array  # (n,)
    b2: NDArray[np.complex128]  # (n,)
    x2: NDArray[np.complex128]  # (n,)
    e_q: Array  # (n,)  error of the step in a motion of q
    e_v: Array  # (n,)  in v

    @staticmethod
    def allocate(nq: int, n: int) -> Memory:
        """Return zeroed memory for ``nq`` positions and ``n`` velocities."""
        z, three = np.zeros, N_STAGES
        order1, order2 = z(n, np.int64), z(n, np.int64)
        b2, x2 = z(n, np.complex128), z(n, np.complex128)
        return Memory(
            records(1, CONTROL), z(nq), z(n), z(1), z(nq), z(n), z(1), z(nq), z(n), z(1), z(nq), z(n), z(1),
            z((three, n)), z((n, n)), z((n, n)), z(nq), z(n), z((three, nq)), z((three, nq)), z((three, n)), z(three),
            z((n, n)), z((n, n), np.complex128), order1, order2, z(n), z(n), b2, x2, z(n), z(n),
        )  # fmt: skip


@kernel
def factor_newton(h: float, memory: Any) -> bool:
    """Factor E(gamma) and E(alpha + i beta) for steps of h; False where one is singular."""
    n = memory.v.shape[0]
    for i in range(n):
        for j in range(n):
            memory.E1[i, j] = -memory.a_v[i, j] - (h / REAL_EIGENVALUE) * memory.a_q[i, j]
            memory.E2[i, j] = -memory.a_v[i, j] - (h / COMPLEX_EIGENVALUE) * memory.a_q[i, j]
        memory.E1[i, i] += REAL_EIGENVALUE / h
        memory.E2[i, i] += COMPLEX_EIGENVALUE / h
    return factor_lu(memory.E1, n, memory.order1) and factor_lu(memory.E2, n, memory.order2)


@kernel
def correct_stages(h: float, memory: Any, size: Any) -> float:
    """Correct ``memory.Z`` once by Newton's method from the accelerations ``memory.F``.

    Returns the square of the correction in tolerances.
    """
    n = memory.v.shape[0]
    for i in range(n):
        real, pair = 0.0, 0.0j
        for s in range(N_STAGES):
            real += TO_REAL[s] * (memory.F[s, i] - REAL_EIGENVALUE / h * memory.Z[s, i])
            pair += TO_COMPLEX[s] * (memory.F[s, i] - COMPLEX_EIGENVALUE / h * memory.Z[s, i])
        memory.b1[i], memory.b2[i] = real / size[i], pair / size[i]
    solve_lu(memory.E1, n, memory.order1, memory.b1, memory.x1)
    solve_lu(memory.E2, n, memory.order2, memory.b2, memory.x2)
    square = 0.0
    for i in range(n):
        for s in range(N_STAGES):
            change = size[i] * (FROM_REAL[s] * memory.x1[i] + (FROM_COMPLEX[s] * memory.x2[i]).real)
            memory.Z[s, i] += change
            square += (change / memory.tol_v[i]) ** 2
    return square / N_STAGES


@kernel
def estimate_error(h: float, memory: Any, size: Any, states: Integers) -> float:
    """The error of the step from ``memory.Z``, in tolerances; that of quaternions is not filtered."""
    nq, n = memory.q.shape[0], memory.v.shape[0]
    turns = has_quaternions(nq, n, states)
    for i in range(n):
        memory.e_q[i], memory.e_v[i] = memory.v0[i], memory.a0[i]
        for s in range(N_STAGES):
            memory.e_v[i] += E[s] * memory.Z[s, i] / h
            for k in range(N_STAGES):
                memory.e_q[i] += E[s] * A[s, k] * (memory.v0[i] + memory.Z[k, i])
    for i in range(n):
        memory.b1[i] = memory.e_v[i] / size[i]
        for j in range(n):
            memory.b1[i] += (h / REAL_EIGENVALUE) * memory.a_q[i, j] * memory.e_q[j] / size[j]
    solve_lu(memory.E1, n, memory.order1, memory.b1, memory.x1)
    square = 0.0
    for i in range(n):
        memory.e_v[i] = size[i] * memory.x1[i]
        memory.e_q[i] = (h / REAL_EIGENVALUE) * (memory.e_q[i] + memory.e_v[i])
        square += (memory.e_v[i] / memory.tol_v[i]) ** 2
        if i < nq and not turns:
            square += (memory.e_q[i] / memory.tol_q[i]) ** 2
    if turns:
        for i in range(nq):
            slope = memory.qdot0[i]
            for s in range(N_STAGES):
                for k in range(N_STAGES):
                    slope += E[s] * A[s, k] * memory.N[k, i]
            square += (h / REAL_EIGENVALUE * slope / memory.tol_q[i]) ** 2
    return np.sqrt(square)


@kernel
def estimate_work_error(h: float, memory: Memory) -> float:
    """The error of W over the step by the same formula, J."""
    found = memory.power0[0]
    for s in range(N_STAGES):
        for k in range(N_STAGES):
            found += E[s] * A[s, k] * memory.P[k]
    return h / REAL_EIGENVALUE * found


@inlined
def divided_differences(y0: float, y1: float, y2: float, y3: float) -> tuple[float, float, float]:
    """Divided differences over 0 and the nodes: those from 0 on, of first to third order."""
    first, second, third = (y1 - y0) / NODES[0], (y2 - y1) / (NODES[1] - NODES[0]), (y3 - y2) / (1.0 - NODES[1])
    rise, later = (second - first) / NODES[1], (third - second) / (1.0 - NODES[0])
    return first, rise, later - rise


@kernel
def extrapolate(h: float, memory: Memory) -> None:
    """``memory.Z`` of the next step, of h, from the polynomial of the last one, of ``hold``."""
    ratio = h / memory.control[0].hold
    for i in range(memory.v.shape[0]):
        z1, z2, z3 = memory.Z[0, i], memory.Z[1, i], memory.Z[2, i]
        d1, d2, d3 = divided_differences(0.0, z1, z2, z3)
        for s in range(N_STAGES):
            x = 1.0 + NODES[s] * ratio
            memory.Z[s, i] = x * (d1 + (x - NODES[0]) * (d2 + (x - NODES[1]) * d3)) - z3


@inlined
def integrate_cubic(x: float, h: float, y0: float, y1: float, y2: float, y3: float) -> float:
    """Integral, from the beginning to x in 0..1 of the step, of the cubic with these values there and at the nodes."""
    d1, d2, d3 = divided_differences(y0, y1, y2, y3)
    a, b = NODES[0], NODES[1]
    linear, square = d1 - a * d2 + a * b * d3, d2 - (a + b) * d3
    return h * x * (y0 + x * (linear / 2.0 + x * (square / 3.0 + x * d3 / 4.0)))


@inlined
def quartic(x: float) -> float:
    """Integral from 0 to x of the polynomial that is zero at the nodes, by its slope at 0; zero at 0 and 1."""
    return x * (1.0 + x * (-4.5 + x * (6.0 - 2.5 * x)))


@inlined
def quintic(x: float) -> float:
    """Integral of :func:`quartic`; zero at 0 and 1."""
    return x * x * (0.5 + x * (-1.5 + x * (1.5 - 0.5 * x)))


@kernel
def interpolate(t: float, memory: Memory, states: Integers, q: Reals, v: Reals) -> float:
    """State (q, v) at t in the last step, and W, J: of order 5, as the ends of steps are.

    The error of the cubic through the stages is O(h^4) between the ends. To first order that error is a multiple of
    :func:`quartic`, the multiple h times the difference of v' from the slope of the cubic where the step begins. The
    multiple is gamma times the filtered error of the step, ``memory.e_v``: where the motion is stiff, v' itself is
    known to no digit that a long step leaves. q and W are integrals. What closing the end has changed is added
    gradually.
    """
    control = memory.control[0]
    x, h = 1.0 - (control.t - t) / control.hold, control.hold
    fraction = x * x * (3.0 - 2.0 * x)
    for i in range(q.shape[0]):
        rates = memory.qdot0[i], memory.N[0, i], memory.N[1, i], memory.N[2, i]
        rest = memory.q[i] - memory.q0[i] - integrate_cubic(1.0, h, *rates)
        q[i] = memory.q0[i] + integrate_cubic(x, h, *rates) + fraction * rest
    if not has_quaternions(q.shape[0], v.shape[0], states):
        for i in range(q.shape[0]):
            q[i] += h * REAL_EIGENVALUE * memory.e_v[i] * quintic(x)
    for i in range(v.shape[0]):
        d1, d2, d3 = divided_differences(0.0, memory.Z[0, i], memory.Z[1, i], memory.Z[2, i])
        rest = memory.v[i] - memory.v0[i] - memory.Z[2, i]
        v[i] = memory.v0[i] + x * (d1 + (x - NODES[0]) * (d2 + (x - NODES[1]) * d3)) + fraction * rest
        v[i] += REAL_EIGENVALUE * memory.e_v[i] * quartic(x)
    powers = memory.power0[0], memory.P[0], memory.P[1], memory.P[2]
    rest = memory.work[0] - memory.work0[0] - integrate_cubic(1.0, h, *powers)
    return memory.work0[0] + integrate_cubic(x, h, *powers) + fraction * rest
