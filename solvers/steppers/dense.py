"""What all steppers on a system's matrices share: its partition's workspace, its rank, its paces."""

from __future__ import annotations

from math import nan
from typing import Any

import numpy as np

from solvers.compiled.held import hold
from solvers.compiled.kernel import COMPILED, kernel
from solvers.options import Options
from solvers.outcome import Code
from solvers.projection.projection import close
from solvers.projection.rank import normal_rank
from solvers.projection.reported import evaluate, unresolved
from solvers.projection.singular import CROSSING, MISS, NONE, judge
from solvers.projection.workspace import Workspace, factor
from solvers.stepper import Stepper, own_rates, require_placed, require_resolved
from solvers.system import Array, Equations, System, Terms

# The pace of a coordinate: of its rate at the start, which is above that of a small oscillation by the root of its
# amplitude; and the least, of the rate of the motion, for what rests at the start may move later.
SLOWER, SLOWEST = 0.1, 0.01
UNDETERMINED = 1e-9  # singular value of J~, relative to the largest, below which a start takes no rate from it


@kernel
def find_critical(eqs: Any, t: float, q: Any, rank: int, work: Any) -> int:
    """What the singular position next to q is; see :func:`solvers.projection.singular.judge`."""
    eqs.position(t, q, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    return judge(eqs, t, q, rank, work)


class DenseStepper(Stepper):
    """A stepper on the terms of the equations of motion: small mechanisms, with or without constraints."""

    def __init__(self, system: System, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        super().__init__(system, t0, q0, v0, options)
        self.system = system
        sizes = (system.nq, system.n, system.m)
        self._terms, self._work = Terms.allocate(*sizes), hold(Workspace.allocate(*sizes))
        self._eqs = Equations.of(system, self._terms)
        self._units = self._work.value if COMPILED else self._work
        self._units.size[:] = system.size
        self._units.size_q[:] = self._position_sizes()
        require_placed(self._q, self._units.size_q, self.options.rtol)
        self._rank = normal_rank(self._eqs, self._t, self._q, self._v, self._work)
        code = close(self._eqs, self._t, self._q, self._v, self._rank, self._work)
        self.starts_singular = self._loses_rank()
        self.status = self._status(Code(code))
        self._measure_pace()

    def _loses_rank(self) -> bool:
        """Whether rates there are that constraints determine elsewhere, and not at the reported position."""
        if self._rank == 0 or not np.isfinite(self._terms.J).all():
            return False
        sigma = np.linalg.svd(self._terms.J * self.system.size / self._units.row[:, None], compute_uv=False)
        return bool(sigma[self._rank - 1] <= UNDETERMINED * sigma[0])

    def gap(self, t: float, q: Array) -> float:
        """Return by how much the loops miss the singular position next to q (nq,) at time t, in units of the rows.

        Zero where they pass it exactly; infinite where motions of more than one freedom pass beside it; not a number
        where there is none next to it. For a stepper that is not to be advanced: it forgets what it knew of others.
        """
        if self._rank == 0:
            return nan
        self._units.critical["kind"], self._units.critical["in_vain"] = NONE, 0.0
        kind = find_critical(self._eqs, t, q, self._rank, self._work)
        return {CROSSING: 0.0, MISS: float(abs(self._units.critical["gap"][0]))}.get(kind, nan)

    @property
    def freedom(self) -> int:
        """In how many ways the constraints let the mechanism move."""
        return int(self.system.n - self._rank)

    def _position_sizes(self) -> Array:
        """Return the unit of every position (nq,): that of its coordinate, 1 of a quaternion's entries."""
        s, sizes = self.system, np.zeros(self.system.nq)
        for k in range(s.n):
            s.fill(self._t, self._q, np.eye(s.n)[k], self._terms)
            sizes = np.maximum(sizes, np.abs(self._terms.qdot) * s.size[k])
        return np.where(sizes > 0.0, sizes, 1.0) if s.nq != s.n else s.size

    def _measure_pace(self) -> None:
        """Note the rate of the motion (1/s), what is known beforehand or that of its velocity or acceleration, and of
        every coordinate's own part in it: a stiff spring at one of them is not to make the others' tolerances coarse.
        """
        code, a, _ = self._evaluate()
        own = own_rates(self.system, self._v, a if code is Code.OK else np.zeros(self.system.n))
        rate = max(self.system.rate, own.max(initial=0.0)) or 1.0
        require_resolved(self._t, rate, self.options.rtol)
        loops = max(self.system.loop_rate, (own * self._units.looped).max(initial=0.0)) or rate
        self._units.rate[:] = rate, loops
        self._units.pace[:] = np.maximum(SLOWER * own, SLOWEST * rate)

    def _evaluate(self) -> tuple[Code, Array, Array]:
        a, lam = np.zeros(self.system.n), np.zeros(self.system.m)
        code = evaluate(self._eqs, self._t, self._q, self._v, self._rank, self._work, a, lam)
        return Code(code), a, lam

    def _undetermined(self) -> bool:
        return bool(unresolved(self.options.rtol, self._rank, self._work))
