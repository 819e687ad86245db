"""SUNDIALS IDA on a large tree ('ida' where the system is a :class:`solvers.system.TreeSystem`).

Unknowns y = (q, v), residual by inverse dynamics alone::

    q' - N(q) v + k (q - unit(q)) = 0,      M v' + h = 0

Newton's linear systems go to GMRES, whose preconditioner is the structured tangent (all but exact, so one or two
iterations do). With g the first residual as a motion,

    (c^2 M + c D + K) dtheta = r2 + c M g,    dv = c dtheta - g,    dq = N dtheta,     c = IDA's cj.

D g is left out of the right-hand side: it only matters to the preconditioner.

**Order** 2 unless more is asked for: BDF of orders 3 to 5 are unstable on undamped modes above their region, and a
sheet has thousands; their step count then hardly depends on the tolerance. **Absolute tolerances** are relative to the
size of each coordinate (an angle of a sheet's joint is curvature times cell, and the errors of a chain of joints add
up), those of rates a thousand times that a second.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from sksundae.ida import IDA, IDAPrecond

from .held import hold
from .ida import LENGTH_RATE, STEPS_A_CALL, IDADriver
from .kernel import kernel
from .stepper import Code, Options, Statistics
from .system import Array, TreeSystem

RATE = 1000.0  # 1/s, absolute tolerance of a rate to that of its coordinate
ORDER = 2
KRYLOV = 5


class Scratch(NamedTuple):
    """Writable copies of what IDA passes, and scratch."""

    q: Array  # (nq,)
    v: Array  # (n,)
    a: Array  # (n,)
    qdot: Array  # (nq,)
    unit: Array  # (nq,) q with unit quaternions
    zero: Array  # (n,)
    tau: Array  # (n,)

    @staticmethod
    def allocate(nq: int, n: int) -> Scratch:
        """Return zeroed arrays."""
        return Scratch(*(np.zeros(k) for k in (nq, n, n, nq, nq, n, n)))


@kernel
def residual(inverse: Any, retract: Any, t: float, y: Any, yp: Any, res: Any, data: Any, s: Any) -> bool:
    """Fill ``res``; False where it is not finite."""
    nq, n = s.q.shape[0], s.v.shape[0]
    for i in range(nq):
        s.q[i] = y[i]
        s.unit[i] = y[i]
    for i in range(n):
        s.v[i] = y[nq + i]
        s.a[i] = yp[nq + i]
    inverse(t, s.q, s.v, s.a, data, s.qdot, s.tau)
    retract(s.unit, s.zero, data)
    finite = True
    for i in range(nq):
        res[i] = yp[i] - s.qdot[i] + LENGTH_RATE * (s.q[i] - s.unit[i])
    for i in range(n):
        res[nq + i] = s.tau[i]
        finite = finite and np.isfinite(s.tau[i])
    return finite


@kernel
def _forward(forward: Any, t: float, q: Any, v: Any, data: Any, qdot: Any, a: Any) -> int:
    return int(forward(t, q, v, data, qdot, a))


def accelerate(s: TreeSystem, t: float, q: Array, v: Array, qdot: Array, a: Array) -> Code:
    """Fill qdot (nq,) and a (n,) by the forward dynamics."""
    if _forward(s.forward, t, q, v, s.held_data, qdot, a) != 0:
        return Code.NO_MASS
    return Code.OK if np.isfinite(a).all() else Code.NOT_FINITE


def as_motion(s: TreeSystem, q: Array, rate: Array) -> Array:
    """Return v (n,) with N v = rate (nq,) as far as there is one."""
    v = np.zeros(s.n)
    v[s.plain[1]] = rate[s.plain[0]]
    for i, j in s.quaternions:
        v[j : j + 3] = 4.0 * quaternion_map(q[i : i + 4]).T @ rate[i : i + 4]
    return v


def as_positions(s: TreeSystem, q: Array, v: Array) -> Array:
    """Return N v (nq,)."""
    rate = np.zeros(s.nq)
    rate[s.plain[0]] = v[s.plain[1]]
    for i, j in s.quaternions:
        rate[i : i + 4] = quaternion_map(q[i : i + 4]) @ v[j : j + 3]
    return rate


def position_sizes(s: TreeSystem, sizes: Array) -> Array:
    """Return sizes of positions (nq,) from those of motions (n,)."""
    positions = np.zeros(s.nq)
    positions[s.plain[0]] = sizes[s.plain[1]]
    for i, j in s.quaternions:
        positions[i : i + 4] = 0.5 * sizes[j : j + 3].min()
    return positions


def quaternion_map(e: Array) -> Array:
    """Return (4, 3) e' = e o (0, w) / 2 as a matrix on w, body axes."""
    w, x, y, z = e
    return 0.5 * np.array([[-x, -y, -z], [w, -z, y], [z, w, -x], [-y, x, w]])


class TreeIDAStepper(IDADriver):
    """IDA on a large tree."""

    def __init__(self, system: TreeSystem, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        super().__init__(system, t0, q0, v0, options)
        self.system = system
        self._scratch = Scratch.allocate(system.nq, system.n)
        self._held = hold(self._scratch)
        self._counts, self._begun, self._pending = np.zeros(3), np.zeros(1), True
        self._cj = 1.0
        self._ida = self._new_ida()

    def _new_ida(self) -> IDA:
        s, o = self.system, self.options
        sizes = o.absolute * s.size
        atol = np.concatenate((position_sizes(s, sizes), RATE * sizes))
        return IDA(
            self._residual,
            rtol=o.rtol,
            atol=atol,
            linsolver="gmres",
            krylov_dim=KRYLOV,
            precond=IDAPrecond(self._set_up, self._precondition),
            max_step=0.0 if np.isinf(o.max_step) else o.max_step,
            max_order=ORDER if o.max_order is None else min(5, o.max_order),
            max_num_steps=min(STEPS_A_CALL, o.max_steps),
            max_conv_fails=30,
        )

    def _residual(self, t: float, y: Array, yp: Array, res: Array) -> None:
        s = self.system
        self._counts[0] += 1.0
        if not residual(s.inverse, s.retract, t, y, yp, res, s.held_data, self._held):
            self._counts[2] += 1.0

    def _set_up(self, t: float, y: Array, yp: Array, res: Array, cj: float) -> None:
        self._counts[1] += 1.0
        self._residual(t, y, yp, np.empty_like(res))
        self.system.tangent.factor(cj, cj * cj)
        self._cj = cj

    def _precondition(
        self, t: float, y: Array, yp: Array, res: Array, r: Array, z: Array, cj: float, delta: float
    ) -> None:
        s, c = self.system, self._cj
        g = as_motion(s, y[: s.nq], r[: s.nq])
        turn = s.tangent.solve(r[s.nq :] + c * s.tangent.inertia(g))
        z[: s.nq] = as_positions(s, y[: s.nq], turn)
        for i, _ in s.quaternions:  # their length
            e = y[i : i + 4]
            z[i : i + 4] += e * (e @ r[i : i + 4]) / (c + LENGTH_RATE)
        z[s.nq :] = c * turn - g

    def _begin(self) -> Code:
        code, a, _ = self._evaluate()
        if code is Code.OK:
            self._ida.init_step(self._t, np.concatenate((self._q, self._v)), np.concatenate((self._scratch.qdot, a)))
            self._pending = False
            self._begun[0] += 1.0
        return code

    def _take(self, t: float, y: Array) -> Code:
        self._t, self._q, self._v = t, y[: self.system.nq].copy(), y[self.system.nq :].copy()
        return Code.OK

    def _evaluate(self) -> tuple[Code, Array, Array]:
        s, a = self.system, np.zeros(self.system.n)
        return accelerate(s, self._t, self._q, self._v, self._scratch.qdot, a), a, np.zeros(0)

    @property
    def statistics(self) -> Statistics:
        """What the run has cost so far; IDA's steps, order and step size are not available."""
        return Statistics(rhs_evals=int(self._counts[0]), restarts=max(0, int(self._begun[0]) - 1))
