"""Model exchange: the equations of a model as an ordinary differential equation, which an importing tool integrates.

The states are all free positions and velocities, also those that loops make dependent::

    x = (q, v)      x' = f(P(x)) - kappa (x - P(x))      y = h(P(x))      kappa = max_k |v_k| / size_k

P brings quaternions to unit length and projects x onto the constraints, positions first, in the constant metric of the
units of the coordinates and with the rank of regular positions (:func:`solvers.projection.projection.project`). In a
constant metric f does not change the distance of x from the constraints, which is therefore only the integration error
of the importing tool; kappa removes it at the rate of the motion. A quaternion e = |e| e_1 has the slope |e| N(e_1) v,
which keeps |e|.

An evaluation is discarded if P does not converge, if the accelerations are not determined, or if P(x) is on another
branch of the motion than the last completed step (:mod:`solvers.projection.branch`). Results depend on x, t and the
inputs only, and what P(x) is compared with changes with completed steps. Some importing tools do not report the steps
of their solver, but points at which they interpolate: they have evaluated at later times when they report a point. As
long as this is so, every evaluation at a later time becomes the position that the next ones are compared with, until
the time goes back.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.arrays.input_kernels import EXTRAPOLATED_LOAD, GRAVITY_LOAD, SUPPORT_MOTION
from mbfmu.mechanics.recursions.dynamics import input_step_limit
from mbfmu.mechanics.signals.step import JUMP_TIME_TOLERANCE
from mbfmu.session.kernels.points import energy_at
from solvers.compiled.kernel import kernel, types
from solvers.outcome import OK
from solvers.projection.branch import BRANCH_RESOLUTION, on_same_branch
from solvers.projection.projection import evaluate_acceleration, project
from solvers.projection.singular import NO_CRITICAL_POINT, record_accepted
from solvers.projection.workspace import BranchHistoryRecord, CriticalRecord, evaluate_and_factor
from solvers.steppers.adams.tree_loop import evaluate_forward_dynamics
from solvers.system import Array

if TYPE_CHECKING:
    from mbfmu.mechanics.arrays.input_kernels import InputRecords
    from solvers.compiled.record import Reals, Table
    from solvers.positions import Positions

# Codes in addition to those of solvers.outcome: the state is on another branch of the motion; it is not finite
LEFT_BRANCH, STATES_NOT_FINITE = -1, -2
MAX_APPROACHES = 100  # times to which a signal halves the way, before the time at which it changes
# of times, relative to the time or 1 s: a jump of a signal takes no longer; see mbfmu.mechanics.signals.step
MAX_JUMP_DURATION_RATIO = 4.0 * JUMP_TIME_TOLERANCE
HALF_TOLERANCE = 1e-6  # relative error of half the way
ACCELERATION = 2  # coefficient of an input that is an acceleration
# Entries of ``Exchange.times``
JUMP, JUMP_END, NEXT_EVENT, COMPLETED, PREVIOUS, COMPARED, EVALUATED, INTERPOLATES, RESTART = range(9)
TIMES = 9
SAME_TIME = 1e-10  # relative, or s


class Branch(NamedTuple):
    """What is known of the branch of the motion: fields of :class:`solvers.projection.workspace.Workspace`."""

    critical: Table[CriticalRecord]
    q_c: Array
    u: Array
    C: Array
    C_tau: Array
    C_pivots: NDArray[np.int64]
    J_last: Array
    branch_history: Table[BranchHistoryRecord]
    frame: Array
    frame_tau: Array
    frame_pivots: NDArray[np.int64]
    q_last: Array
    nu_last: Array

    @staticmethod
    def allocate(nq: int, n: int, m: int) -> Branch:
        """Return zeroed arrays for ``nq`` positions, ``n`` velocities and ``m`` constraints."""
        z, i = np.zeros, np.int64
        critical = CriticalRecord.zeros(1), z(nq), z(m), z((m, n)), z(m), z(m, i)
        frame = z((m, n)), BranchHistoryRecord.zeros(1), z((m, n)), z(m), z(m, i), z(nq), z(m)
        return Branch._make((*critical, *frame))


class Exchange(NamedTuple):
    """What model exchange has in addition to co-simulation.

    Attributes
    ----------
    x, derivatives, nominal
        (nq + n,) states that the importing tool has set, their derivatives and nominal values.
    times
        (TIMES,) times, s: the last event, and the end of a jump of signals there; the next event; the last completed
        step; the previous and the present position that branches are compared with; the last evaluation. Then 1.0 if
        the importing tool reports points at which it interpolates, and 1.0 if the next update of events restarts the
        comparison of branches.
    counts
        (3,) of completed steps, discarded evaluations, and evaluations, as the first of COUNTERS.
    before, completed, previous
        The branch before an evaluation or a report, at the last completed step, and at the previous position that
        branches were compared with.
    """

    x: Array
    derivatives: Array
    nominal: Array
    times: Array
    counts: NDArray[np.int64]
    before: Branch
    completed: Branch
    previous: Branch

    @staticmethod
    def allocate(nq: int, n: int, m: int) -> Exchange:
        """Return zeroed arrays for ``nq`` positions, ``n`` velocities and ``m`` constraints."""
        states, branches = (np.zeros(nq + n) for _ in range(3)), (Branch.allocate(nq, n, m) for _ in range(3))
        return Exchange._make((*states, np.zeros(TIMES), np.zeros(3, np.int64), *branches))

    def memory(self) -> list[NDArray[Any]]:
        """Return the arrays to save; the first is never empty."""
        return [self.times, self.x, self.nominal, self.counts, *self.completed, *self.previous]


@kernel
def copy_critical_point(source: Any, target: Any) -> None:
    """Copy what is known of the critical point between a workspace and a :class:`Branch`."""
    m, n = source.C.shape
    target.critical[0] = source.critical[0]
    for i in range(source.q_c.shape[0]):
        target.q_c[i] = source.q_c[i]
    for i in range(m):
        target.u[i], target.C_tau[i], target.C_pivots[i] = source.u[i], source.C_tau[i], source.C_pivots[i]
        for j in range(n):
            target.C[i, j] = source.C[i, j]


@kernel
def copy_branch(source: Any, target: Any) -> None:
    """The same, with the position that branches are compared with."""
    m, n = source.C.shape
    copy_critical_point(source, target)
    target.branch_history[0] = source.branch_history[0]
    for i in range(source.q_last.shape[0]):
        target.q_last[i] = source.q_last[i]
    for i in range(m):
        target.nu_last[i], target.frame_tau[i] = source.nu_last[i], source.frame_tau[i]
        target.frame_pivots[i] = source.frame_pivots[i]
        for j in range(n):
            target.frame[i, j], target.J_last[i, j] = source.frame[i, j], source.J_last[i, j]


@kernel
def unpack_states(exchange: Exchange, q: Reals, v: Reals) -> bool:
    """(q, v) = x; False if x is not finite."""
    nq, total = q.shape[0], 0.0
    for i in range(nq):
        q[i] = exchange.x[i]
        total += 0.0 * q[i]
    for i in range(v.shape[0]):
        v[i] = exchange.x[nq + i]
        total += 0.0 * v[i]
    return bool(np.isfinite(total))


@kernel
def pack_states(q: Reals, v: Reals, exchange: Exchange) -> None:
    """x = (q, v)."""
    nq = q.shape[0]
    for i in range(nq):
        exchange.x[i] = q[i]
    for i in range(v.shape[0]):
        exchange.x[nq + i] = v[i]


@kernel
def fill_derivatives(
    exchange: Exchange, qdot: Reals, a: Reals, q: Reals, v: Reals, attraction: float, positions: Positions
) -> None:
    """Fill x' by qdot (nq,) and a (n,) at P(x) = (q, v); ``attraction`` is kappa, 1/s."""
    nq, x, out = q.shape[0], exchange.x, exchange.derivatives
    for i in range(nq):
        out[i] = qdot[i] - attraction * (x[i] - q[i])
    for i in range(v.shape[0]):
        out[nq + i] = a[i] - attraction * (x[nq + i] - v[i])
    for k in range(positions.turning.shape[0]):
        first, square = positions.turning[k, 0], 0.0
        for i in range(first, first + 4):
            square += x[i] * x[i]
        norm = np.sqrt(square)
        for i in range(first, first + 4):
            out[i] = norm * qdot[i] - attraction * (x[i] - norm * q[i])


@kernel
def fill_nominals(work: Any, exchange: Exchange) -> None:
    """Fill the nominal values: units of positions, and of velocities these times the rates of their coordinates."""
    nq = work.size_q.shape[0]
    for i in range(nq):
        exchange.nominal[i] = work.size_q[i]
    for i in range(work.size.shape[0]):
        exchange.nominal[nq + i] = work.coordinate_rates[i] * work.size[i]


@kernel
def project_states(exchange: Exchange, eqs: Any, t: float, rank: int, positions: Any, work: Any) -> int:
    """(work.q, work.v) = P(x), with its ``terms`` and factors; return a code."""
    if not unpack_states(exchange, work.q, work.v):
        return STATES_NOT_FINITE
    if positions.turning.shape[0] == 0 and eqs.terms.Phi.shape[0] == 0:
        evaluate_and_factor(eqs, t, work.q, work.v, work)
        return OK
    for i in range(work.dq.shape[0]):
        work.dq[i] = 0.0
    eqs.retract(work.q, work.dq, eqs.data)  # quaternions to unit length
    code: int = project(eqs, t, work.q, work.v, rank, work)
    return code


@kernel
def evaluate_projected(exchange: Exchange, eqs: Any, t: float, rank: int, positions: Any, work: Any) -> int:
    """Fill x' by matrices, and leave ``terms`` and factors at P(x) = (work.q, work.v); return a code."""
    code = project_states(exchange, eqs, t, rank, positions, work)
    if code == OK:
        code = evaluate_acceleration(eqs, t, work.q, work.v, rank, work, work.slope)
    if code == OK:
        attraction = 0.0
        if rank > 0:
            for i in range(work.v.shape[0]):
                attraction = max(attraction, work.in_loops[i] * abs(work.v[i]) / work.size[i])
        fill_derivatives(exchange, eqs.terms.qdot, work.slope, work.q, work.v, attraction, positions)
    return code


@kernel
def find_next_event(t: float, data: Any) -> float:
    """The time after t (s) at which a signal changes, or until which its longest step is known, s; infinite: none.

    A signal that is about to change gives half the way to this time as the next time, and again half of the rest.
    """
    _, until = input_step_limit(t, data)
    for _ in range(MAX_APPROACHES):
        if not until < np.inf:
            break
        _, after = input_step_limit(until, data)
        half = 0.5 * (until - t)
        if not abs(after - until - half) <= HALF_TOLERANCE * half:
            break
        t, until = until, after
    return float(until)


@kernel
def find_end_of_jump(t: float, data: Any) -> float:
    """The time at which a signal that jumps at t (s) has jumped; else t."""
    _, until = input_step_limit(t, data)
    return float(until) if until - t <= MAX_JUMP_DURATION_RATIO * max(1.0, abs(t)) else t


@kernel
def place_inputs(i: InputRecords, t: float) -> None:
    """Let all inputs have their present values at t, s. Motions of joints without an input of the acceleration go on
    from the start at a constant rate.
    """
    for k in range(i.inputs.shape[0]):
        role, number = i.inputs[k].role, i.inputs[k].number
        if role == EXTRAPOLATED_LOAD:
            i.polynomials[i.loads[number].polynomial].t0 = t
        elif role == SUPPORT_MOTION:
            if i.inputs[k].coefficient == ACCELERATION:
                i.polynomials[i.supports[number].polynomial].t0 = t
        elif role != GRAVITY_LOAD:
            i.polynomials[number].t0 = t


@kernel
def begin_evaluation(instance: Any, t: float) -> float:
    """Place the inputs; return the time (s) at which the equations are evaluated: t, or the end of a jump at t."""
    times = instance.exchange.times
    evaluated = times[JUMP_END] if times[JUMP] <= t < times[JUMP_END] else t
    place_inputs(instance.inputs, evaluated)
    return float(evaluated)


class Formulation(NamedTuple):
    """Model exchange by one formulation of the equations; kernels over an instance, most at the time t (s)."""

    project: Any  # (instance, t) -> code: P(x) into q and v of the work
    evaluate: Any  # (instance, t) -> code: x' too
    is_on_branch: Any  # (instance, t) -> bool: whether P(x) is on the branch of the position it is compared with
    keep_previous: Any  # (instance): keep that position and what was known before the evaluation as the previous one
    compare_from: Any  # (instance, t): compare later positions with P(x)
    complete: Any  # (instance): the position that branches are compared with is a completed step
    go_back: Any  # (instance, t): compare with the last position that was reached at t or before
    keep_front: Any  # (instance): keep the position that branches are compared with
    restore_front: Any  # (instance, t): ... and restore it, as the position of time t
    restart: Any  # (instance): forget all positions
    keep: Any  # (instance): keep what an evaluation changes
    restore: Any  # (instance): ... and restore it


@kernel
def project_dense(instance: Any, t: float) -> int:
    """By matrices, as all of the following."""
    problem = instance.given
    rank = problem.memory.control[0].rank
    code: int = project_states(instance.exchange, problem.eqs, t, rank, instance.positions, problem.work)
    return code


@kernel
def evaluate_dense(instance: Any, t: float) -> int:
    """See :class:`Formulation`."""
    problem = instance.given
    rank = problem.memory.control[0].rank
    code: int = evaluate_projected(instance.exchange, problem.eqs, t, rank, instance.positions, problem.work)
    return code


@kernel
def is_on_branch_dense(instance: Any, t: float) -> bool:
    """See :class:`Formulation`."""
    problem = instance.given
    rank = problem.memory.control[0].rank
    same: bool = on_same_branch(problem.eqs, t, problem.work.q, BRANCH_RESOLUTION, rank, problem.work)
    return same


@kernel
def keep_previous_dense(instance: Any) -> None:
    """See :class:`Formulation`."""
    exchange = instance.exchange
    copy_branch(instance.given.work, exchange.previous)
    copy_critical_point(exchange.before, exchange.previous)
    exchange.times[PREVIOUS] = exchange.times[COMPARED]


@kernel
def compare_from_dense(instance: Any, t: float) -> None:
    """See :class:`Formulation`."""
    problem, times = instance.given, instance.exchange.times
    taken = abs(t - times[COMPARED])
    times[COMPARED] = t
    record_accepted(problem.eqs, t, problem.work.q, taken, taken, problem.memory.control[0].rank, problem.work)


@kernel
def complete_dense(instance: Any) -> None:
    """See :class:`Formulation`."""
    exchange = instance.exchange
    copy_branch(instance.given.work, exchange.completed)
    exchange.times[COMPLETED] = exchange.times[COMPARED]


@kernel
def go_back_dense(instance: Any, t: float) -> None:
    """See :class:`Formulation`."""
    exchange, times = instance.exchange, instance.exchange.times
    if t >= times[COMPARED]:
        return
    if times[COMPLETED] <= times[PREVIOUS] <= t:
        copy_branch(exchange.previous, instance.given.work)
        times[COMPARED] = times[PREVIOUS]
    else:
        copy_branch(exchange.completed, instance.given.work)
        times[COMPARED] = times[COMPLETED]


@kernel
def keep_front_dense(instance: Any) -> None:
    """See :class:`Formulation`."""
    copy_branch(instance.given.work, instance.exchange.before)


@kernel
def restore_front_dense(instance: Any, t: float) -> None:
    """See :class:`Formulation`."""
    copy_branch(instance.exchange.before, instance.given.work)
    instance.exchange.times[COMPARED] = t


@kernel
def restart_dense(instance: Any) -> None:
    """See :class:`Formulation`."""
    work = instance.given.work
    work.branch_history[0].is_frame_known, work.branch_history[0].pivot_ratio = 0, 0.0
    work.critical[0].kind, work.critical[0].failed_search_ratio = NO_CRITICAL_POINT, 0.0


@kernel
def keep_dense(instance: Any) -> None:
    """See :class:`Formulation`."""
    copy_critical_point(instance.given.work, instance.exchange.before)


@kernel
def restore_dense(instance: Any) -> None:
    """See :class:`Formulation`."""
    copy_critical_point(instance.exchange.before, instance.given.work)


@kernel
def project_tree(instance: Any, t: float) -> int:
    """By recursions, as all of the following: there are quaternions only."""
    problem = instance.given
    if not unpack_states(instance.exchange, problem.work.q, problem.work.v):
        return STATES_NOT_FINITE
    problem.eqs.retract(problem.work.q, problem.work.zero, problem.eqs.data)
    return OK


@kernel
def evaluate_tree(instance: Any, t: float) -> int:
    """See :class:`Formulation`."""
    problem, work = instance.given, instance.given.work
    code: int = project_tree(instance, t)
    if code == OK:
        code = evaluate_forward_dynamics(problem.eqs, t, work.q, work.v, work.qdot, work.a)
    if code == OK:
        fill_derivatives(instance.exchange, work.qdot, work.a, work.q, work.v, 0.0, instance.positions)
    return code


@kernel
def is_on_branch_tree(instance: Any, t: float) -> bool:
    """There is one branch."""
    return True


@kernel
def unchanged_at_tree(instance: Any, t: float) -> None:
    """There is one branch."""


@kernel
def unchanged_tree(instance: Any) -> None:
    """There is one branch, and evaluations change nothing."""


DENSE = Formulation(
    project_dense, evaluate_dense, is_on_branch_dense, keep_previous_dense, compare_from_dense, complete_dense,
    go_back_dense, keep_front_dense, restore_front_dense, restart_dense, keep_dense, restore_dense,
)  # fmt: skip
TREE = Formulation(
    project_tree, evaluate_tree, is_on_branch_tree, unchanged_tree, unchanged_at_tree, unchanged_tree,
    unchanged_at_tree, unchanged_tree, unchanged_at_tree, unchanged_tree, unchanged_tree, unchanged_tree,
)  # fmt: skip
FORMULATIONS = {
    "adams": DENSE,
    "radau": DENSE,
    "ida": DENSE,
    "tree": TREE,
    "esdirk": TREE,
    "tree_ida": TREE,
}  # by family of steppers


def exchange_entries(family: str, read: Callable[..., int]) -> dict[str, tuple[Callable[..., int], tuple[Any, ...]]]:
    """Return the entry points of model exchange by their names, with the types of what they are called with.

    ``read`` fills the outputs at the reported state, see :class:`mbfmu.session.kernels.sequence.Sequence`.
    """
    own = FORMULATIONS[family]
    project_at, evaluate_at, is_on_branch = own.project, own.evaluate, own.is_on_branch
    keep_previous, compare_from, complete = own.keep_previous, own.compare_from, own.complete
    go_back, begin_anew, keep, restore = own.go_back, own.restart, own.keep, own.restore
    keep_front, restore_front = own.keep_front, own.restore_front

    def exchange_start(instance: Any, t: float) -> int:
        """Let x be the reported state, at the start of a run at t (s)."""
        exchange, problem = instance.exchange, instance.given
        pack_states(problem.q, problem.v, exchange)
        fill_nominals(problem.work, exchange)
        for k in (JUMP, JUMP_END, COMPLETED, PREVIOUS, COMPARED, EVALUATED):
            exchange.times[k] = t
        exchange.times[INTERPOLATES], exchange.times[RESTART] = 1.0, 1.0
        for k in range(exchange.counts.shape[0]):
            exchange.counts[k] = 0
        begin_anew(instance)
        complete(instance)
        return OK

    def exchange_evaluate(instance: Any, t: float) -> int:
        """Fill x' at (t, x); return a code of solvers.outcome, LEFT_BRANCH or STATES_NOT_FINITE."""
        counts, times = instance.exchange.counts, instance.exchange.times
        evaluated = begin_evaluation(instance, t)
        times[EVALUATED] = evaluated
        go_back(instance, evaluated)
        keep(instance)
        code = evaluate_at(instance, evaluated)
        counts[2] += 1
        if code == OK and not is_on_branch(instance, evaluated):
            code = LEFT_BRANCH
        if code == OK and times[INTERPOLATES] > 0.0 and evaluated > times[COMPARED]:
            keep_previous(instance)
            compare_from(instance, evaluated)
        else:
            restore(instance)
        if code != OK:
            counts[1] += 1
        return int(code)

    def exchange_report(instance: Any, t: float) -> int:
        """Fill x and x' at the reported state of co-simulation."""
        pack_states(instance.q, instance.v, instance.exchange)
        keep(instance)
        code = evaluate_at(instance, t)
        restore(instance)
        return int(code)

    def exchange_read(instance: Any, t: float) -> int:
        """Fill the outputs at (t, P(x)), which becomes the reported state."""
        evaluated, session, work = begin_evaluation(instance, t), instance.session, instance.given.work
        keep(instance)
        code = project_at(instance, evaluated)
        if code == OK:
            for i in range(work.q.shape[0]):
                instance.q[i] = work.q[i]
            for i in range(work.v.shape[0]):
                instance.v[i] = work.v[i]
            instance.clock[0] = evaluated
            code = read(instance)
            instance.clock[0] = t
        restore(instance)
        for k in range(instance.exchange.counts.shape[0]):
            instance.counts[k] = instance.exchange.counts[k]
        is_conservative = session.data.arrays.world[0].nonconservative == 0 and instance.inputs.inputs.shape[0] == 0
        if code == OK and is_conservative:
            energy = energy_at(session, evaluated, instance.q, instance.v)
            instance.out[instance.out.shape[0] - 2] = energy - session.balance[0].reference_energy
        return int(code)

    def exchange_accept(instance: Any, t: float) -> int:
        """Record that a step of the importing tool ended at (t, x); LEFT_BRANCH if it ended on another branch."""
        evaluated, times = begin_evaluation(instance, t), instance.exchange.times
        is_ahead = times[EVALUATED] > evaluated + SAME_TIME * max(1.0, abs(evaluated))
        times[INTERPOLATES] = 1.0 if is_ahead else 0.0
        front = times[COMPARED]
        code = project_at(instance, evaluated)
        if code != OK:
            return int(code)
        instance.exchange.counts[0] += 1
        keep_front(instance)
        go_back(instance, evaluated)
        is_same = is_on_branch(instance, evaluated)
        compare_from(instance, evaluated)
        complete(instance)
        if is_ahead and front > evaluated:
            restore_front(instance, front)
            return OK
        return OK if is_same else LEFT_BRANCH

    def exchange_update(instance: Any, t: float) -> int:
        """Update at an event at t (s): x becomes P(x), and the next event is found."""
        exchange, work, data = instance.exchange, instance.given.work, instance.given.eqs.data
        exchange.times[JUMP], exchange.times[JUMP_END] = t, find_end_of_jump(t, data)
        evaluated = begin_evaluation(instance, t)
        exchange.times[NEXT_EVENT] = find_next_event(evaluated, data)
        if exchange.times[RESTART] > 0.0:
            begin_anew(instance)
        go_back(instance, evaluated)
        code = project_at(instance, evaluated)
        if code != OK:
            return int(code)
        pack_states(work.q, work.v, exchange)
        for k in (COMPARED, PREVIOUS, EVALUATED):
            exchange.times[k] = evaluated
        exchange.times[RESTART] = 0.0
        compare_from(instance, evaluated)
        complete(instance)
        return OK

    functions = exchange_start, exchange_evaluate, exchange_report, exchange_read, exchange_accept, exchange_update
    return {function.__name__: (function, (types.float64,)) for function in functions}
