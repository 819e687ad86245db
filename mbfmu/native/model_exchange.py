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
inputs only, and what is compared changes with completed steps. The exception are importing tools that report completed
steps seldom: an evaluation farther than ``MAX_FRAME_DISTANCE`` from the last reported one replaces it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.arrays.points import EXTRAPOLATED_LOAD, GRAVITY_LOAD, SUPPORT_MOTION
from mbfmu.mechanics.recursions.dynamics import input_step_limit
from mbfmu.mechanics.signals.step import JUMP_TIME_TOLERANCE
from mbfmu.session.kernels.points import energy_at
from solvers.compiled.kernel import kernel, records, types
from solvers.outcome import NOT_FINITE, OK
from solvers.projection.branch import BRANCH_RESOLUTION, on_same_branch
from solvers.projection.projection import evaluate_acceleration, project
from solvers.projection.singular import record_accepted
from solvers.projection.workspace import CRITICAL, distance, evaluate_and_factor
from solvers.steppers.adams.tree_loop import evaluate_forward_dynamics
from solvers.system import Array

if TYPE_CHECKING:
    from mbfmu.mechanics.arrays.points import InputRecords
    from solvers.compiled.record import Reals
    from solvers.positions import Positions
    from solvers.projection.workspace import Workspace

LEFT_BRANCH = -1  # code in addition to those of solvers.outcome: the state is on another branch of the motion
# largest distance from the last completed step in which branches are compared, in units of size
MAX_FRAME_DISTANCE = 0.5
MAX_APPROACHES = 100  # times to which a signal halves the way, before the time at which it changes
# of times, relative to the time or 1 s: a jump of a signal takes no longer; see mbfmu.mechanics.signals.step
MAX_JUMP_DURATION_RATIO = 4.0 * JUMP_TIME_TOLERANCE
HALF_TOLERANCE = 1e-6  # relative error of half the way
# Entries of ``Exchange.times``
EVALUATED_FROM, NEXT_EVENT, COMPLETED, RESTART = range(4)
TIMES = 4


class Exchange(NamedTuple):
    """What model exchange has in addition to co-simulation."""

    x: Array  # (nq + n,) states that the importing tool has set
    derivatives: Array  # (nq + n,)
    nominal: Array  # (nq + n,)
    times: Array  # (TIMES,) s: signals are evaluated no earlier, at a jump; the next event; the last completed step.
    # Then 1.0: the next update of events begins anew, as parameters have changed
    critical: NDArray[Any]  # (1,) copies of fields of the same names of solvers.projection.workspace.Workspace
    q_c: Array
    u: Array
    C: Array
    C_tau: Array
    C_pivots: NDArray[np.int64]

    @staticmethod
    def allocate(nq: int, n: int, m: int) -> Exchange:
        """Return zeroed arrays for ``nq`` positions, ``n`` velocities and ``m`` constraints by matrices."""
        z, pivots = np.zeros, np.zeros(m, np.int64)
        critical = records(1, CRITICAL), z(nq), z(m), z((m, n)), z(m), pivots
        return Exchange(z(nq + n), z(nq + n), z(nq + n), z(TIMES), *critical)

    def memory(self) -> list[NDArray[Any]]:
        """Return the arrays to save."""
        return [self.x, self.nominal, self.times]


@kernel
def keep_critical_point(work: Workspace, exchange: Exchange) -> None:
    """Copy what is known of the critical point."""
    m, n = work.C.shape
    exchange.critical[0] = work.critical[0]
    for i in range(work.q_c.shape[0]):
        exchange.q_c[i] = work.q_c[i]
    for i in range(m):
        exchange.u[i], exchange.C_tau[i], exchange.C_pivots[i] = work.u[i], work.C_tau[i], work.C_pivots[i]
        for j in range(n):
            exchange.C[i, j] = work.C[i, j]


@kernel
def restore_critical_point(exchange: Exchange, work: Workspace) -> None:
    """Undo what an evaluation has found of another critical point."""
    m, n = work.C.shape
    work.critical[0] = exchange.critical[0]
    for i in range(work.q_c.shape[0]):
        work.q_c[i] = exchange.q_c[i]
    for i in range(m):
        work.u[i], work.C_tau[i], work.C_pivots[i] = exchange.u[i], exchange.C_tau[i], exchange.C_pivots[i]
        for j in range(n):
            work.C[i, j] = exchange.C[i, j]


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
        return NOT_FINITE
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
def record_position(exchange: Exchange, eqs: Any, t: float, rank: int, work: Any) -> None:
    """Record (t, work.q), with its ``terms`` and factors, as the last completed step."""
    taken = abs(t - exchange.times[COMPLETED])
    exchange.times[COMPLETED] = t
    record_accepted(eqs, t, work.q, taken, taken, rank, work)


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
    """Let all inputs have their present values at t, s."""
    for k in range(i.inputs.shape[0]):
        role, number = i.inputs[k].role, i.inputs[k].number
        if role == EXTRAPOLATED_LOAD:
            i.courses[i.loads[number].course].t0 = t
        elif role == SUPPORT_MOTION:
            i.courses[i.supports[number].course].t0 = t
        elif role != GRAVITY_LOAD:
            i.courses[number].t0 = t


@kernel
def begin_evaluation(instance: Any, t: float) -> float:
    """Place the inputs; return the time (s) at which the equations are evaluated: t, or the end of a jump at t."""
    evaluated = max(t, instance.exchange.times[EVALUATED_FROM])
    place_inputs(instance.inputs, evaluated)
    return float(evaluated)


class Formulation(NamedTuple):
    """Model exchange by one formulation of the equations. All kernels take an instance and the time t (s)."""

    project: Any  # -> code: P(x) into q and v of the work
    evaluate: Any  # -> code: x' too
    on_same_branch: Any  # -> bool: whether P(x) is on the branch of the last completed step
    is_far: Any  # -> bool: whether P(x) is too far from it to be compared with it
    record: Any  # record P(x) as the last completed step
    keep: Any  # (instance): keep what evaluations change
    restore: Any  # (instance): ... and restore it
    restart: Any  # (instance): forget the last completed step


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
def on_same_branch_dense(instance: Any, t: float) -> bool:
    """See :class:`Formulation`."""
    problem = instance.given
    rank = problem.memory.control[0].rank
    same: bool = on_same_branch(problem.eqs, t, problem.work.q, BRANCH_RESOLUTION, rank, problem.work)
    return same


@kernel
def is_far_dense(instance: Any, t: float) -> bool:
    """See :class:`Formulation`."""
    work = instance.given.work
    known = instance.given.memory.control[0].rank > 0 and work.branch_history[0].is_frame_known == 1
    return bool(known and distance(work.q_last, work.q, work) > MAX_FRAME_DISTANCE)


@kernel
def record_dense(instance: Any, t: float) -> None:
    """See :class:`Formulation`."""
    problem = instance.given
    record_position(instance.exchange, problem.eqs, t, problem.memory.control[0].rank, problem.work)


@kernel
def keep_dense(instance: Any) -> None:
    """See :class:`Formulation`."""
    keep_critical_point(instance.given.work, instance.exchange)


@kernel
def restore_dense(instance: Any) -> None:
    """See :class:`Formulation`."""
    restore_critical_point(instance.exchange, instance.given.work)


@kernel
def restart_dense(instance: Any) -> None:
    """See :class:`Formulation`."""
    work = instance.given.work
    work.branch_history[0].is_frame_known, work.branch_history[0].pivot_ratio = 0, 0.0
    work.critical[0].kind, work.critical[0].failed_search_ratio = 0, 0.0


@kernel
def project_tree(instance: Any, t: float) -> int:
    """By recursions, as all of the following: there are quaternions only."""
    problem = instance.given
    if not unpack_states(instance.exchange, problem.work.q, problem.work.v):
        return NOT_FINITE
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
def on_same_branch_tree(instance: Any, t: float) -> bool:
    """There is one branch."""
    return True


@kernel
def is_far_tree(instance: Any, t: float) -> bool:
    """There is one branch."""
    return False


@kernel
def record_tree(instance: Any, t: float) -> None:
    """There is nothing to record but the time."""
    instance.exchange.times[COMPLETED] = t


@kernel
def unchanged_tree(instance: Any) -> None:
    """Evaluations change nothing."""


DENSE = Formulation(
    project_dense, evaluate_dense, on_same_branch_dense, is_far_dense, record_dense, keep_dense, restore_dense,
    restart_dense,
)  # fmt: skip
TREE = Formulation(
    project_tree, evaluate_tree, on_same_branch_tree, is_far_tree, record_tree, unchanged_tree, unchanged_tree,
    unchanged_tree,
)  # fmt: skip
FORMULATIONS = {"adams": DENSE, "radau": DENSE, "tree": TREE}  # by family of steppers


def exchange_entries(family: str, read: Callable[..., int]) -> dict[str, tuple[Callable[..., int], tuple[Any, ...]]]:
    """Return the entry points of model exchange by their names, with the types of what they are called with.

    ``read`` fills the outputs at the reported state, see :class:`mbfmu.session.kernels.sequence.Sequence`.
    """
    own = FORMULATIONS[family]
    project_at, evaluate_at, same_branch, is_far, record, keep, restore, begin_anew = own

    def exchange_start(instance: Any, t: float) -> int:
        """Let x be the reported state, at the start of a run at t (s)."""
        exchange, problem = instance.exchange, instance.given
        pack_states(problem.q, problem.v, exchange)
        fill_nominals(problem.work, exchange)
        exchange.times[EVALUATED_FROM], exchange.times[COMPLETED], exchange.times[RESTART] = t, t, 1.0
        return OK

    def exchange_evaluate(instance: Any, t: float) -> int:
        """Fill x' at (t, x); return a code of solvers.outcome, or LEFT_BRANCH."""
        control, evaluated = instance.given.memory.control[0], begin_evaluation(instance, t)
        keep(instance)
        code = evaluate_at(instance, evaluated)
        control.evaluations += 1
        if code == OK and not same_branch(instance, evaluated):
            code = LEFT_BRANCH
        if code == OK and is_far(instance, evaluated):
            record(instance, evaluated)
        else:
            restore(instance)
        if code != OK:
            control.rejected += 1
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
        is_conservative = session.data.arrays.world[0].nonconservative == 0 and instance.inputs.inputs.shape[0] == 0
        if code == OK and is_conservative:
            energy = energy_at(session, evaluated, instance.q, instance.v)
            instance.out[instance.out.shape[0] - 2] = energy - session.balance[0].reference_energy
        return int(code)

    def exchange_accept(instance: Any, t: float) -> int:
        """Record that a step of the importing tool ended at (t, x); LEFT_BRANCH if it ended on another branch."""
        evaluated = begin_evaluation(instance, t)
        code = project_at(instance, evaluated)
        if code != OK:
            return int(code)
        same = same_branch(instance, evaluated)
        record(instance, evaluated)
        instance.given.memory.control[0].steps += 1
        return OK if same else LEFT_BRANCH

    def exchange_update(instance: Any, t: float) -> int:
        """Update at an event at t (s): x becomes P(x), and the next event is found."""
        exchange, work, data = instance.exchange, instance.given.work, instance.given.eqs.data
        exchange.times[EVALUATED_FROM] = find_end_of_jump(t, data)
        evaluated = begin_evaluation(instance, t)
        exchange.times[NEXT_EVENT] = find_next_event(evaluated, data)
        if exchange.times[RESTART] > 0.0:
            begin_anew(instance)
        code = project_at(instance, evaluated)
        if code != OK:
            return int(code)
        exchange.times[RESTART], exchange.times[COMPLETED] = 0.0, evaluated
        pack_states(work.q, work.v, exchange)
        record(instance, evaluated)
        return OK

    functions = exchange_start, exchange_evaluate, exchange_report, exchange_read, exchange_accept, exchange_update
    return {function.__name__: (function, (types.float64,)) for function in functions}
