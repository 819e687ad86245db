"""What all steppers on a system's matrices share: its partition's workspace, its rank, its paces."""

from __future__ import annotations

from math import nan
from typing import Any

import numpy as np

from solvers.compiled.kernel import COMPILED, kernel
from solvers.compiled.tuple_pointer import pin
from solvers.options import Options
from solvers.outcome import OK, Code
from solvers.projection.projection import project
from solvers.projection.rank import find_normal_rank
from solvers.projection.reported import evaluate_state, has_unresolved_forces
from solvers.projection.singular import BIFURCATION, IMPERFECT, NO_CRITICAL_POINT, classify_singularity
from solvers.projection.workspace import Workspace, factor
from solvers.stepper import Stepper, coordinate_rate, require_resolved_position, require_resolved_time, start_rate
from solvers.system import Array, Equations, System, Terms

# The characteristic rate of a coordinate is the first part of its rate at the start, which exceeds that of a small
# oscillation by the root of its amplitude; it is at least the second part of the rate of the motion, since a coordinate
# at rest may move later.
INITIAL_RATE_RATIO, MIN_RATE_RATIO = 0.1, 0.01
RANK_LOSS_RATIO = 1e-9  # singular value of J~, relative to the largest, below which a start takes no rate from it


@kernel
def classify_nearest_singularity(eqs: Any, t: float, q: Any, rank: int, work: Any) -> int:
    """Class of the singular configuration next to q; see :func:`solvers.projection.singular.classify_singularity`."""
    eqs.position(t, q, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    return classify_singularity(eqs, t, q, rank, work)


@kernel
def estimate_rates(
    eqs: Any, t: float, q: Any, v: Any, rank: int, known: float, loop_rate: float, duration: float, work: Any
) -> None:
    """Note the rate of the motion (1/s, see :func:`solvers.stepper.rate_of_start`), and of every coordinate's own part
    in it: a stiff spring at one of them is not to make the others' tolerances coarse.
    """
    if evaluate_state(eqs, t, q, v, rank, work, work.slope, work.lam) != OK:
        for k in range(v.shape[0]):
            work.slope[k] = 0.0
    rate = start_rate(known, duration, work.size, v, work.slope)
    for k in range(v.shape[0]):
        work.coordinate_rates[k] = coordinate_rate(work.size[k], v[k], work.slope[k])
        loop_rate = max(loop_rate, work.coordinate_rates[k] * work.in_loops[k])
    work.rate[0], work.rate[1] = rate, loop_rate if loop_rate != 0.0 else rate
    for k in range(v.shape[0]):
        work.coordinate_rates[k] = max(INITIAL_RATE_RATIO * work.coordinate_rates[k], MIN_RATE_RATIO * rate)


class DenseStepper(Stepper):
    """A stepper on the terms of the equations of motion: small mechanisms, with or without constraints."""

    def __init__(self, system: System, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        super().__init__(system, t0, q0, v0, options)
        self.system = system
        sizes = (system.nq, system.n, system.m)
        self._terms, self._work = Terms.allocate(*sizes), pin(Workspace.allocate(*sizes))
        self._eqs = Equations.of(system, self._terms)
        self._workspace = self._work.value if COMPILED else self._work
        self._workspace.size[:] = system.size
        self._workspace.size_q[:] = system.position_sizes(system.size)
        require_resolved_position(self._q, self._workspace.size_q, self.options.rtol, system.coordinate_names)
        self._rank = find_normal_rank(self._eqs, self._t, self._q, self._v, self._work)
        code = project(self._eqs, self._t, self._q, self._v, self._rank, self._work)
        self.starts_singular = self._loses_rank()
        self.status = self._status(Code(code))
        known = system.rate, system.loop_rate, self.options.duration
        estimate_rates(self._eqs, self._t, self._q, self._v, self._rank, *known, self._work)
        require_resolved_time(self._t, float(self._workspace.rate[0]), self.options.rtol)

    def _loses_rank(self) -> bool:
        """Whether rates there are that constraints determine elsewhere, and not at the reported position."""
        if self._rank == 0 or not np.isfinite(self._terms.J).all():
            return False
        sigma = np.linalg.svd(self._terms.J * self.system.size / self._workspace.row[:, None], compute_uv=False)
        return bool(sigma[self._rank - 1] <= RANK_LOSS_RATIO * sigma[0])

    def bifurcation_gap(self, t: float, q: Array) -> float:
        """Return the gap of the loops to the singular configuration next to q (nq,) at time t, in units of the rows.

        Zero where they pass it exactly; infinite if motions of several degrees of freedom pass next to it; not a number
        where there is none next to it. For a stepper that is not to be advanced: its record of other points is lost.
        """
        if self._rank == 0:
            return nan
        self._workspace.critical["kind"], self._workspace.critical["failed_search_ratio"] = NO_CRITICAL_POINT, 0.0
        kind = classify_nearest_singularity(self._eqs, t, q, self._rank, self._work)
        return {BIFURCATION: 0.0, IMPERFECT: float(abs(self._workspace.critical["bifurcation_gap"][0]))}.get(kind, nan)

    def _growth(self) -> tuple[float, float]:
        """Return the largest rate growth so far and its time (s), see :mod:`solvers.inertia`."""
        record = self._workspace.inertia[0]
        return float(record["largest"]), float(record["at"])

    @property
    def freedom(self) -> int:
        """In how many ways the constraints let the mechanism move."""
        return int(self.system.n - self._rank)

    def _evaluate(self) -> tuple[Code, Array, Array]:
        a, lam = np.zeros(self.system.n), np.zeros(self.system.m)
        code = evaluate_state(self._eqs, self._t, self._q, self._v, self._rank, self._work, a, lam)
        return Code(code), a, lam

    def _undetermined(self) -> bool:
        return bool(has_unresolved_forces(self.options.rtol, self._rank, self._work))
