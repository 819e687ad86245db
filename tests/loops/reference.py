"""Motions of closed loops by a formulation and an integrator that share nothing with the package.

Every body has six coordinates (three in the plane), every joint is a constraint (:mod:`maximal`). The accelerations
follow from the equations of index 1,

    | M       (C J)^T | | v'     |   | f       |
    | C J     0       | | lambda | = | C gamma |

C J are the rows without what is redundant: C is the identity, or from the singular value decomposition of J where a
step begins. SciPy's DOP853 advances x and v; after every step both go back onto the constraints on the shortest way.

Near a singular configuration the constraints turn within a time ~ sigma / |sigma'|, sigma a singular value of J. Steps
that do not resolve this turn may end on the other branch. Therefore a step is not longer than a part of this time
(``resolution``). It is repeated with half the length if the tangent has turned by more than 20 degrees or if the frame
of rows and tangents has changed its orientation, which is impossible on one branch. An exact singular configuration is
not passed: the motion ends there and reports it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, inf, radians
from typing import Any

import numpy as np
from formulation import formulate
from maximal import Maximal
from scipy.integrate import DOP853
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu
from tree import NotCovered, Units, backward, forward, sizes, units

from mbfmu.mechanics import CompiledMechanism, Mechanism

TOLERANCE = 1e-12  # of DOP853, relative to the mechanism's own units
RESOLUTION = 0.3  # largest step by sigma / |sigma'|
REDUNDANT = 1e-10  # singular values below this part of the largest are those of redundant constraint equations
SINGULAR = 3e-7  # ... below this one the position counts as singular: the motion ends
TURN = cos(radians(20.0))  # least cosine between the tangents before and after a step
NOISE = 1e-18  # over (sigma / largest sigma)^2: errors of a step that rounding, a hundred times larger, would hide
LARGE = 150  # unknowns from which on the equations are solved as sparse ones
SHORTEST = 1e-13  # step, in the mechanism's unit of time


@dataclass
class Motion:
    """A motion at some times, in the compiled mechanism's coordinates.

    Attributes
    ----------
    times, q, v
        (k,) s, (k, nq), (k, n); fewer than requested where the motion ended early.
    energy
        (k,) kinetic energy and that of gravity and springs, J.
    gap
        (k,) least sigma / largest sigma met since the time before.
    steps
        Taken.
    ended
        Why it ended early; empty: it did not.
    """

    times: Any
    q: Any
    v: Any
    energy: Any
    gap: Any
    steps: int
    ended: str = ""


@dataclass
class Reference(Motion):
    """A motion with a measure of its error.

    Attributes
    ----------
    difference
        (k,) how far positions are from those of a run at a looser tolerance and with shorter steps, in
        lengths of the mechanism and rad.
    """

    difference: Any = None

    def trusted_until(self, tolerance: float) -> float:
        """Return the last time up to which the two runs stay together to ``tolerance``."""
        off = np.flatnonzero(~(self.difference <= tolerance))
        return float(
            self.times[off[0] - 1] if len(off) and off[0] > 0 else self.times[0] if len(off) else self.times[-1]
        )


def reference(
    mechanism: Mechanism, times: Any, start: tuple[Any, Any] | None = None, *, tolerance: float = TOLERANCE
) -> Reference:
    """The motion at ``times`` (k,), ascending from the start; ``start``: (q, v) of the compiled mechanism, None: as it
    assembles.

    The second run, at thirty times the tolerance and half the resolution, estimates the error of the first.
    """
    if start is None:
        start = CompiledMechanism(mechanism).assemble(float(times[0]))
    best = integrate(mechanism, times, start, tolerance=tolerance)
    other = integrate(mechanism, best.times, start, tolerance=30.0 * tolerance, resolution=0.5 * RESOLUTION)
    k = len(other.times)
    difference = np.full(len(best.times), np.nan)
    difference[:k] = distance(mechanism, start[1], best.q[:k], other.q)
    return Reference(**vars(best), difference=difference)


def distance(mechanism: Mechanism, v0: Any, q: Any, other: Any) -> Any:
    """Largest difference (k,) of positions (k, nq): displacements in lengths of the mechanism, angles in rad."""
    scale = sizes(mechanism, units(mechanism, v0))[0]
    off = np.abs(np.asarray(q) - other)
    i = 0
    for body in mechanism.bodies[1:]:
        if body.joint.drive is None:
            i += body.joint.nq
            if body.joint.quaternion:
                there = np.abs(np.asarray(q)[:, i - 4 : i] + np.asarray(other)[:, i - 4 : i])
                nearer = there.max(axis=1) < off[:, i - 4 : i].max(axis=1)
                off[nearer, i - 4 : i] = there[nearer]
    return (off / scale).max(axis=1, initial=0.0)


def integrate(
    mechanism: Mechanism,
    times: Any,
    start: tuple[Any, Any],
    *,
    tolerance: float = TOLERANCE,
    resolution: float = RESOLUTION,
    nudge: float = 0.0,
    seed: int = 0,
) -> Motion:
    """One run. After every step velocities are pushed along the tangents by ``nudge``, at random (``seed``).

    The nudge is relative to 1 + |v|, in the mechanism's units, as the errors of a solver's steps are; positions are
    pushed by what such an error makes in a step.
    """
    if mechanism.flexible_bodies or mechanism.elements or mechanism.pressures:
        raise NotCovered("flexible bodies")
    times = np.asarray(times, float)
    unit = units(mechanism, start[1])
    poses = forward(mechanism, float(times[0]), *start)
    body = formulate(mechanism, unit, float(times[0]) / unit.time, poses)
    run = _Run(body, unit, times / unit.time, start[0], tolerance, resolution, nudge, seed).motion()
    run.times = times[: len(run.q)]
    return run


class _Factors:
    """The constraints at a state: C, tangents N, and the time within which they turn."""

    def __init__(self, body: Maximal, t: float, x: Any, v: Any) -> None:
        rows = body.rows(t, x, v)
        self.m, self.n = rows.J.shape
        U, s, Vt = np.linalg.svd(rows.J)
        largest = float(s[0]) if len(s) else 1.0
        self.rank = rank = int(np.sum(s > REDUNDANT * largest))
        self.U, self.s, self.V, self.N = U[:, :rank], s[:rank], Vt[:rank].T, Vt[rank:]
        self.ratio = float(s[rank - 1]) / largest if rank else 1.0
        self.C = None if rank == self.m else self.U.T
        self.CJ = rows.J if self.C is None else self.C @ rows.J
        self.pace = self._pace(body, t, x, v, rows.J)

    def _pace(self, body: Maximal, t: float, x: Any, v: Any, J: Any) -> float:
        """Least sigma / |sigma'| of all singular values."""
        if self.rank == 0:
            return inf
        small = 1e-7 / max(1.0, float(np.abs(v).max(initial=0.0)))
        after = body.rows(t + small, body.move(x, small * v), v).J
        change = np.abs(np.einsum("ik,ij,jk->k", self.U, (after - J) / small, self.V, optimize=True))
        return float(np.min(self.s / np.maximum(change, 1e-300)))

    def onto(self, off: Any) -> Any:
        """Shortest change of the coordinates that makes up for ``off`` in the rows."""
        return self.V @ ((self.U.T @ off) / self.s)

    def follows(self, before: _Factors) -> bool:
        """Whether this may be the same branch a step later."""
        if self.rank != before.rank:
            return False
        A, cosines, B = np.linalg.svd(self.N @ before.N.T)
        if len(cosines) and cosines[-1] < TURN:
            return False
        turned = (A @ B).T @ self.N  # tangents, carried on
        rows, old = self.CJ, before.CJ
        if self.C is not None or before.C is not None:
            A, _, B = np.linalg.svd(self.U.T @ before.U)
            rows, old = (A @ B).T @ (self.U.T @ self._J), before.U.T @ before._J
        return bool(_orientation(rows, turned) == _orientation(old, before.N))

    @property
    def _J(self) -> Any:
        return self.U @ (self.s[:, None] * self.V.T)


def _orientation(rows: Any, tangents: Any) -> float:
    return float(np.linalg.slogdet(np.vstack((rows, tangents)))[0])


class _Run:
    """The state of one integration; times in the mechanism's unit."""

    def __init__(
        self,
        body: Maximal,
        unit: Units,
        times: Any,
        near: Any,
        tolerance: float,
        resolution: float,
        nudge: float,
        seed: int,
    ) -> None:
        self.body, self.unit, self.times = body, unit, times
        self.tolerance, self.resolution, self.near = tolerance, resolution, near
        x, v = body.start()
        self.nx, t = len(x), float(times[0])
        self.nudge, self.rng = nudge, np.random.default_rng(seed)
        self.factors = _Factors(body, t, x, v)
        for _ in range(4):
            x, v = self._project(t, x, v, self.factors)
            self.factors = _Factors(body, t, x, v)
        body.remember(x, v)
        self.steps, self.turned, self.gap = 0, 0.0, self.factors.ratio
        self.solver = DOP853(self._slope, t, np.r_[x, v], max(float(times[-1]), t), rtol=tolerance, atol=tolerance)

    def _slope(self, t: float, y: Any) -> Any:
        """y' = (x', v')."""
        body, C = self.body, self.factors.C
        x, v = y[: self.nx], y[self.nx :]
        rows = body.rows(t, x, v)
        f = body.forces(t, x, v)
        J, gamma = (rows.J, rows.gamma) if C is None else (C @ rows.J, C @ rows.gamma)
        n, m = body.n, len(gamma)
        K, right = np.zeros((n + m, n + m)), np.concatenate((f, gamma))
        K[:n, :n], K[:n, n:], K[n:, :n] = body.M, J.T, J
        a = splu(csc_matrix(K)).solve(right) if n + m > LARGE and C is None else np.linalg.solve(K, right)
        return np.concatenate((body.rate(x, v), a[:n]))

    def _project(self, t: float, x: Any, v: Any, factors: _Factors) -> tuple[Any, Any]:
        """Positions and velocities on the constraints."""
        if factors.rank == 0:
            return self.body.move(x, 0.0 * v), v
        for _ in range(2):
            x = self.body.move(x, -factors.onto(self.body.rows(t, x, v).Phi))
        rows = self.body.rows(t, x, v)
        for _ in range(2):
            v = v - factors.onto(rows.J @ v - rows.nu)
        return x, v

    def _step(self, until: float) -> str:
        """One accepted step of at most to ``until``; a word where there is none."""
        solver = self.solver
        t, y, f, wanted = solver.t, solver.y, solver.f, solver.h_abs
        limit = self.resolution * self.factors.pace
        solver.rtol = solver.atol = max(self.tolerance, NOISE / self.factors.ratio**2)
        while True:
            solver.t, solver.y, solver.f, solver.status = t, y, f, "running"
            solver.t_bound, solver.max_step = until, max(min(limit, 2.0 * wanted), 2.0 * SHORTEST)
            solver.h_abs = min(wanted, solver.max_step)
            try:
                with np.errstate(over="ignore", invalid="ignore"):
                    message = solver.step()
            except np.linalg.LinAlgError:  # a stage far off the constraints
                limit = 0.2 * min(solver.h_abs, until - t)
                if limit < SHORTEST:
                    return "the accelerations are not determined"
                continue
            if solver.status == "failed":
                return f"the step collapses: {message}"
            x, v = solver.y[: self.nx], solver.y[self.nx :]
            after = _Factors(self.body, solver.t, x, v)
            if after.follows(self.factors):
                break
            limit = 0.5 * (solver.t - t)
            if limit < SHORTEST:
                return "the tangent turns at once"
        if self.nudge:
            size = self.nudge * (1.0 + float(np.abs(v).max()))
            x = self.body.move(x, size * min(1.0, solver.t - t) * self._along(after))
            v = v + size * self._along(after)
        x, v = self._project(solver.t, x, v, after)
        self.body.remember(x, v)
        self.factors = after
        if wanted > until - t:  # the next step need not be as short as the way to the output was
            solver.h_abs = max(solver.h_abs, min(wanted, limit))
        solver.y = np.r_[x, v]
        solver.f = self._slope(solver.t, solver.y)
        self.steps += 1
        self.gap = min(self.gap, after.ratio)
        self._count_turns(solver.t - t, x, v)
        return "a singular position" if after.ratio < SINGULAR else ""

    def _along(self, factors: _Factors) -> Any:
        """A random tangent (n,) whose largest component is one."""
        way = factors.N.T @ self.rng.normal(size=len(factors.N))
        return way / max(float(np.abs(way).max(initial=0.0)), 1e-300)

    def _count_turns(self, h: float, x: Any, v: Any) -> None:
        """Keep ``near`` within half a turn of every angle."""
        self.turned += 2.0 * h * float(np.abs(v).max(initial=0.0))
        if self.turned > 1.0:
            self.near = self._coordinates(x, v)[0]

    def _coordinates(self, x: Any, v: Any) -> tuple[Any, Any]:
        self.turned = 0.0
        q, rates = backward(self.body.mechanism, self.body.poses(x, v), self.near)
        self.near = q
        return q, rates

    def motion(self) -> Motion:
        """Run to the last time, or as far as it goes."""
        q, v, energy, gap, ended = [], [], [], [], ""
        for t in self.times:
            while self.solver.t < t and not ended:
                ended = self._step(float(t))
            if ended:
                ended = f"{ended} at t = {self.solver.t * self.unit.time:.9g} s"
                break
            x, u = self.solver.y[: self.nx], self.solver.y[self.nx :]
            here = self._coordinates(x, u)
            q.append(here[0])
            v.append(here[1])
            energy.append(self.body.energy(float(t), x, u))
            gap.append(self.gap)
            self.gap = self.factors.ratio
        return Motion(
            self.times[: len(q)], np.array(q), np.array(v), np.array(energy), np.array(gap), self.steps, ended
        )
