"""Jumps of the velocities at events of native FMUs, as :mod:`mbfmu.session.impulses` finds them in Python.

The jump dv by an impulse p is found by the factors of the solver: M dv + J^T Lambda = p and J dv = 0 are the equations
of motion with p in place of the forces. Without matrices, M^-1 p is found by the recursions along the tree, and with
constraints by their elimination along the tree, see :mod:`mbfmu.session.kernels.eliminated_jumps`.

A joint is locked by the signal that it follows then, as a driven joint, and keeps its places among the free
coordinates, where its velocity and its acceleration are zero. In the matrices its rows and columns are decoupled, see
:func:`.recursions.dynamics.decouple_locked_joints`; the recursions treat it as driven, and so do the elimination of
constraints and the structured tangent (:mod:`.locked_tangent`). In loops the rank of the constraints is found again,
since constraint equations may depend on each other then.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from mbfmu.session.kernels.eliminated_jumps import DEPENDENT_ROW_RATIO, DETERMINED, IMMOBILE, find_jump
from solvers.compiled.kernel import jit_uncached, kernel
from solvers.linalg.dense import rank_at
from solvers.outcome import OK
from solvers.projection.projection import UNRESOLVED_PIVOT_RATIO, evaluate_regular_acceleration
from solvers.projection.workspace import count_freedom, evaluate_and_factor

from .event_actions import fill_approach_rates, fill_slopes, solve_impacts, stop_by_event
from .event_memory import (
    BOUNCE,
    MASSLESS,
    NO_FAILURE,
    NOT_LOCKED,
    PRESCRIBED,
    PRESCRIBED_LOCK,
    SINGULAR,
    EventMemory,
)
from .exchange_memory import RESTART
from .touched_stops import has_hit, leave_out_touched, mark_taking_part, note_pushed


@kernel
def keep_factors(instance: Any) -> None:
    """Of solvers that keep no factors over events."""


@kernel
def renew_tangent(instance: Any) -> None:
    """Of solvers that use the structured tangent."""
    instance.given.eqs.tangent.n_factored[0] += 1


class Jumps(NamedTuple):
    """How a family finds the jump of the velocities by an impulse; kernels over an instance."""

    prepare: Any  # (instance) -> one of FAILURES: the factors at the reported state
    respond: Any  # (instance, impulse (n,), response (n,)) -> one of FAILURES: the jump, by these factors
    # (instance, t) -> code and rate (1/s): adapts the solver to constraints of another rank; None: it has none
    adapt: Any = None
    renew: Any = keep_factors  # (instance): lets the solver factor its matrix again


class JumpKernels(NamedTuple):
    """What events do to the velocities; kernels over an instance that fill its ``dv``."""

    fill_responses: Any  # (instance) -> one of FAILURES: the jumps by unit impulses of the stops that take part
    # (instance) -> bool: the impact of the stops in ``base`` and of those that are touched; False: there is none, or it
    # stops the run
    bounce: Any
    push: Any  # (instance, place, value) -> one of FAILURES: an impulse on one coordinate
    lock: Any  # (instance, lock) -> one of FAILURES: the impulse that brings the rate of a joint to zero
    adapt: Any  # (instance) -> one of FAILURES: adapts the solver to joints that were locked or released


@kernel
def prepare_dense(instance: Any) -> int:
    """See :class:`Jumps`."""
    evaluate_and_factor(instance.eqs, instance.clock[0], instance.q, instance.v, instance.work)
    return NO_FAILURE


@kernel
def respond_dense(instance: Any, impulse: Any, response: Any) -> int:
    """Fill the jump of the velocities (n,) by an impulse (n,) at the reported state; return one of FAILURES.

    The terms and factors of the state are those of the last :func:`evaluate_and_factor`.
    """
    eqs, work, rank = instance.eqs, instance.work, instance.given.memory.control[0].rank
    if rank_at(work.pivot, rank, UNRESOLVED_PIVOT_RATIO) < rank:
        return SINGULAR
    n = impulse.shape[0]
    for i in range(n):
        eqs.terms.h[i] = -impulse[i]
    for i in range(eqs.terms.gamma.shape[0]):
        eqs.terms.gamma[i] = 0.0
    if evaluate_regular_acceleration(eqs.terms, rank, work, response) != OK:
        return MASSLESS
    given, pushed = 0.0, 0.0  # largest part of the impulse, and of what the constraints let move something
    for i in range(n):
        given = max(given, abs(work.size[i] * impulse[i]))
    for k in range(count_freedom(rank, work)):
        part = 0.0
        for i in range(n):
            part += work.T[k, i] * impulse[i]
        pushed = max(pushed, abs(part))
    for i in range(n):
        response[i] *= 1.0 if pushed > DEPENDENT_ROW_RATIO * given else 0.0
    return NO_FAILURE


@kernel
def prepare_tree(instance: Any) -> int:
    """See :class:`Jumps`."""
    eqs, rate = instance.eqs, instance.events.position_rate
    code = eqs.forward(instance.clock[0], instance.q, instance.v, eqs.data, rate, instance.a)
    return NO_FAILURE if code == 0 else MASSLESS


@kernel
def respond_tree(instance: Any, impulse: Any, response: Any) -> int:
    """See :class:`Jumps`."""
    eqs, locks, bodies = instance.eqs, instance.events.locks, instance.eqs.data.arrays.bodies
    for k in range(locks.shape[0]):
        if locks[k].is_locked == 1:
            response[locks[k].velocity] = 0.0
            bodies[locks[k].body].vf = -1  # as of a driven joint
    eqs.mobility(impulse, eqs.data, response)
    for k in range(locks.shape[0]):
        bodies[locks[k].body].vf = locks[k].velocity
    return NO_FAILURE


@kernel
def prepare_eliminated(instance: Any) -> int:
    """See :class:`Jumps`: every response evaluates the state."""
    return NO_FAILURE


@kernel
def respond_eliminated(instance: Any, impulse: Any, response: Any) -> int:
    """See :class:`Jumps`."""
    state = instance.clock[0], instance.q, instance.v
    code = find_jump(instance.eqs, *state, impulse, UNRESOLVED_PIVOT_RATIO, instance.work, response)
    if code == DETERMINED:
        return NO_FAILURE
    return MASSLESS if code == IMMOBILE else SINGULAR


@kernel
def hold_joint(instance: Any, lock: int) -> None:
    """Let a joint follow its signal, which is its present coordinate."""
    own, arrays = instance.events.locks[lock], instance.eqs.data.arrays
    polynomial = instance.inputs.polynomials[own.polynomial]
    polynomial.t0, polynomial.c[0] = 0.0, instance.q[own.position]
    for k in range(1, polynomial.c.shape[0]):
        polynomial.c[k] = 0.0
    arrays.bodies[own.body].drive, own.is_locked = own.signal, 1
    for k in range(arrays.couplings.shape[0]):
        coupling, place = arrays.couplings[k], arrays.bodies[own.body].vi
        coupling.fa = -1 if coupling.va == place else coupling.fa
        coupling.fb = -1 if coupling.vb == place else coupling.fb
    arrays.world[0].drives = 1
    instance.session.balance[0].has_one_freedom = 0


@kernel
def release_joint(instance: Any, lock: int) -> int:
    """Let a joint move freely; return one of FAILURES."""
    locks = instance.events.locks
    if lock < 0 or locks[lock].is_locked == 0:
        return NOT_LOCKED
    own, arrays = locks[lock], instance.eqs.data.arrays
    own.is_locked, arrays.bodies[own.body].drive = 0, -1
    for k in range(arrays.couplings.shape[0]):
        coupling, place = arrays.couplings[k], arrays.bodies[own.body].vi
        coupling.fa = own.velocity if coupling.va == place else coupling.fa
        coupling.fb = own.velocity if coupling.vb == place else coupling.fb
    return NO_FAILURE


@kernel
def is_locked(instance: Any, velocity: int) -> bool:
    """Whether the joint of a free velocity is locked."""
    locks, found = instance.events.locks, False
    for k in range(locks.shape[0]):
        found = found or (locks[k].velocity == velocity and locks[k].is_locked == 1)
    return found


@kernel
def failure_of_immobile_joint(instance: Any, place: int) -> int:
    """One of FAILURES for a joint whose rate no impulse changes: it can be locked if constraints hold it at rest."""
    if instance.lam.shape[0] == 0:
        return MASSLESS
    allowed = instance.options[0].rtol * instance.work.size[place]
    return NO_FAILURE if abs(instance.v[place]) <= allowed else PRESCRIBED_LOCK


@kernel
def stop_by_first_hit(events: EventMemory, failure: int) -> None:
    """Note that the first stop that takes part in an impact stops the run."""
    for k in range(events.hit.shape[0]):
        if events.hit[k] == 1:
            stop_by_event(events, events.sensed[k], failure)


@kernel
def fill_demand(instance: Any) -> None:
    """Fill the changes of the rates of sensors that their stops require."""
    events = instance.events
    fill_approach_rates(instance, instance.v, events.demand)
    for row in range(events.actions.shape[0]):
        action = events.actions[row]
        if action.kind == BOUNCE and events.hit[action.place] == 1:
            rate = events.demand[action.place]
            events.demand[action.place] = rate + events.values[row] * max(rate, 0.0)


@kernel
def fill_effects(events: EventMemory) -> None:
    """Fill the changes of the rates of sensors by unit impulses of the stops that are hit."""
    n, count = events.impulse.shape[0], events.sensed.shape[0]
    for k in range(count):
        for j in range(count):
            events.effects[k, j] = 0.0
            for i in range(n):
                events.effects[k, j] -= events.slopes[k, i] * events.responses[j, i] if events.hit[j] == 1 else 0.0


@kernel
def combine_responses(events: EventMemory, dv: Any) -> None:
    """Fill the jump of the velocities (n,) by the impulses of all stops that are hit."""
    for i in range(dv.shape[0]):
        dv[i] = 0.0
        for k in range(events.sensed.shape[0]):
            dv[i] += events.impulses[k] * events.responses[k, i] if events.hit[k] == 1 else 0.0


@kernel
def never_adapt(instance: Any, t: float) -> tuple[int, float]:
    """Of families without constraints."""
    return OK, 0.0


def jump_kernels(jumps: Jumps) -> JumpKernels:
    """Return what events do to the velocities in a family."""
    prepare, respond = jumps.prepare, jumps.respond

    @jit_uncached
    def fill_responses(instance: Any) -> int:
        """Fill the jumps by unit impulses of the stops that take part; return one of FAILURES."""
        events, n = instance.events, instance.events.impulse.shape[0]
        failure = prepare(instance)
        for k in range(events.sensed.shape[0]):
            if events.hit[k] == 0:
                continue
            for i in range(n):
                events.impulse[i] = -events.slopes[k, i]
            if failure == NO_FAILURE:
                failure = respond(instance, events.impulse, instance.dv)
            for i in range(n):
                events.responses[k, i] = instance.dv[i]
        return int(failure)

    @jit_uncached
    def bounce(instance: Any) -> bool:
        """Fill the jump by the impact of the stops that take part; False: there is none, or it stops the run."""
        events, resting = instance.events, instance.resting
        is_any = mark_taking_part(instance)
        while is_any:
            fill_slopes(instance)
            failure = fill_responses(instance)
            if failure != NO_FAILURE:
                stop_by_first_hit(events, failure)
                return False
            fill_demand(instance)
            fill_effects(events)
            wrong = solve_impacts(events)
            if wrong < 0:
                note_pushed(events, resting)
                combine_responses(events, instance.dv)
                return True
            if not leave_out_touched(events, resting, wrong):
                stop_by_event(events, events.sensed[wrong], PRESCRIBED)
                return False
            is_any = has_hit(events)
        return False

    @jit_uncached
    def push(instance: Any, place: int, value: float) -> int:
        events = instance.events
        for i in range(events.impulse.shape[0]):
            events.impulse[i], instance.dv[i] = 0.0, 0.0
        if is_locked(instance, place):  # the joint transmits it
            return NO_FAILURE
        events.impulse[place] = value
        failure: int = prepare(instance)
        if failure == NO_FAILURE:
            failure = respond(instance, events.impulse, instance.dv)
        return failure

    @jit_uncached
    def lock(instance: Any, number: int) -> int:
        place, dv = instance.events.locks[number].velocity, instance.dv
        failure: int = push(instance, place, 1.0)
        if failure == NO_FAILURE and not dv[place] > 0.0:
            failure = failure_of_immobile_joint(instance, place)
            dv[place] = 1.0
        if failure != NO_FAILURE:
            return failure
        factor = -instance.v[place] / dv[place]
        for i in range(dv.shape[0]):
            dv[i] = -instance.v[i] if i == place else factor * dv[i]
        return NO_FAILURE

    adapt_constraints, renew = jumps.adapt if jumps.adapt else never_adapt, jumps.renew

    @jit_uncached
    def adapt(instance: Any) -> int:
        renew(instance)
        if instance.lam.shape[0] == 0:
            return NO_FAILURE
        code, _ = adapt_constraints(instance, instance.clock[0])
        instance.exchange.times[RESTART] = 1.0  # positions before are on other branches
        return NO_FAILURE if code == OK else SINGULAR

    return JumpKernels(fill_responses, bounce, push, lock, adapt)


def continuation_of(adapt: Any, restart: Any) -> Any:
    """Return a kernel (instance, event): continue with other locks, which the event has changed.

    ``adapt`` is that of :class:`JumpKernels`, ``restart`` (instance) restarts the solver.
    """

    @jit_uncached
    def continue_with_other_locks(instance: Any, event: int) -> None:
        failure = adapt(instance)
        if failure != NO_FAILURE:
            stop_by_event(instance.events, event, failure)
        restart(instance)

    return continue_with_other_locks


DENSE_JUMPS = Jumps(prepare_dense, respond_dense)
TREE_JUMPS = Jumps(prepare_tree, respond_tree)
ELIMINATED_JUMPS = Jumps(prepare_eliminated, respond_eliminated)
