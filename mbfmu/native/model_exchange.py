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
the time goes back. Other tools report no steps, and evaluate derivatives in a second instance, at few points: before
the first completed step, positions that are far from each other are not compared.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from mbfmu.session.kernels.points import energy_at
from solvers.compiled.kernel import kernel, types
from solvers.outcome import OK

from . import exchange_dense as dense
from . import exchange_eliminated as eliminated
from . import exchange_tree as tree
from .derivatives import INPUTS, NOTHING, differentiate_motion
from .exchange_branches import comparisons
from .exchange_memory import (
    COMPARED,
    COMPLETED,
    EVALUATED,
    INTERPOLATES,
    JUMP,
    JUMP_END,
    LEFT_BRANCH,
    NEXT_EVENT,
    PREVIOUS,
    RESTART,
    Branch,
    EliminatedBranch,
    fill_nominals,
    pack_states,
)
from .exchange_times import begin_evaluation, find_end_of_jump, find_next_event

SAME_TIME = 1e-10  # relative, or s


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
    linearize: Any  # (instance, t, driving) -> code: the point of derivatives is P(x)
    differentiate: Any  # (instance) -> code: derivatives at the point along the direction in the linearization
    branch: Callable[[int, int, int], Any]  # (nq, n, m): memory for what is known of the branch, zeroed


DENSE = Formulation(
    project=dense.project_dense,
    evaluate=dense.evaluate_dense,
    is_on_branch=dense.is_on_branch_dense,
    restart=dense.forget_branch,
    linearize=dense.linearize_dense,
    differentiate=dense.differentiate_dense,
    branch=Branch.allocate,
    **comparisons(dense.copy_branch, dense.copy_critical_point, dense.record_position),
)
TREE = Formulation(
    project=tree.project_tree,
    evaluate=tree.evaluate_tree,
    is_on_branch=tree.is_on_branch_tree,
    keep_previous=tree.unchanged_tree,
    compare_from=tree.unchanged_at_tree,
    complete=tree.unchanged_tree,
    go_back=tree.unchanged_at_tree,
    keep_front=tree.unchanged_tree,
    restore_front=tree.unchanged_at_tree,
    restart=tree.unchanged_tree,
    keep=tree.unchanged_tree,
    restore=tree.unchanged_tree,
    linearize=tree.linearize_tree,
    differentiate=tree.differentiate_tree,
    branch=Branch.allocate,
)
ELIMINATED = Formulation(
    project=eliminated.project_eliminated,
    evaluate=eliminated.evaluate_eliminated,
    is_on_branch=eliminated.is_on_branch_eliminated,
    restart=tree.unchanged_tree,
    linearize=eliminated.linearize_eliminated,
    differentiate=eliminated.differentiate_eliminated,
    branch=EliminatedBranch.allocate,
    **comparisons(eliminated.copy_branch, eliminated.copy_branch, eliminated.record_position),
)
FORMULATIONS = {  # by the families of :mod:`.families`
    "adams": DENSE, "radau": DENSE, "ida": DENSE, "tree": TREE, "esdirk": TREE, "tree_ida": TREE,
    "eliminated": ELIMINATED, "eliminated_ida": ELIMINATED,
}  # fmt: skip


@kernel
def is_conservative(instance: Any) -> bool:
    """Whether no force does work that is no change of the energy, and nothing is an input."""
    world = instance.session.data.arrays.world[0]
    return bool(world.nonconservative == 0 and instance.inputs.inputs.shape[0] == 0)


def exchange_entries(family: str, read: Callable[..., int]) -> dict[str, tuple[Callable[..., int], tuple[Any, ...]]]:
    """Return the entry points of model exchange by their names, with the types of what they are called with.

    ``read`` fills the outputs at the reported state, see :class:`mbfmu.session.kernels.sequence.Sequence`.
    """
    own = FORMULATIONS[family]
    project_at, evaluate_at, is_on_branch = own.project, own.evaluate, own.is_on_branch
    keep_previous, compare_from, complete = own.keep_previous, own.compare_from, own.complete
    go_back, begin_anew, keep, restore = own.go_back, own.restart, own.keep, own.restore
    keep_front, restore_front = own.keep_front, own.restore_front
    linearize_at, differentiate_there = own.linearize, own.differentiate

    def exchange_start(instance: Any, t: float) -> int:
        """Let x be the reported state, at the start of a run at t (s)."""
        exchange, problem = instance.exchange, instance.given
        pack_states(problem.q, problem.v, exchange)
        fill_nominals(instance.work, exchange)
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
        evaluated, session, work = begin_evaluation(instance, t), instance.session, instance.work
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
        if code == OK and is_conservative(instance):
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
        exchange, work, data = instance.exchange, instance.work, instance.eqs.data
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

    def exchange_linearize(instance: Any, t: float) -> int:
        """Let derivatives be those at (t, P(x))."""
        evaluated = begin_evaluation(instance, t)
        keep(instance)
        code = linearize_at(instance, evaluated, INPUTS)
        restore(instance)
        instance.linearization.point[0].conservative = 1 if is_conservative(instance) else 0
        return int(code)

    def exchange_linearize_reported(instance: Any, t: float) -> int:
        """Let derivatives be those at the reported state of co-simulation, which x is."""
        keep(instance)
        code = linearize_at(instance, t, NOTHING)
        restore(instance)
        instance.linearization.point[0].conservative = 0
        return int(code)

    def exchange_differentiate(instance: Any) -> int:
        """Fill the derivatives at that point along the direction of the linearization."""
        return int(differentiate_there(instance))

    def exchange_differentiate_motion(instance: Any) -> int:
        """Fill the derivatives of outputs by time at that point."""
        differentiate_motion(instance.inputs, instance.positions, instance.linearization)
        return OK

    functions = exchange_start, exchange_evaluate, exchange_report, exchange_read, exchange_accept, exchange_update
    timed = (*functions, exchange_linearize, exchange_linearize_reported)
    found: dict[str, tuple[Callable[..., int], tuple[Any, ...]]] = {f.__name__: (f, (types.float64,)) for f in timed}
    return found | {f.__name__: (f, ()) for f in (exchange_differentiate, exchange_differentiate_motion)}
