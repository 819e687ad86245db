"""Drives and rates that loops cannot follow: unreachable positions, and rates that are not determined."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.arrays.assembly import free_bodies
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import AssemblyError
from solvers.compiled.tuple_pointer import pin
from solvers.loop_closure import ClosureScratch, is_off_branch
from solvers.outcome import Code, Status
from solvers.system import Array

from .run_messages import SINGULAR_START

JAM_REMEDY = (
    "Use a smaller coefficient of friction, a longer guide, or a center of mass nearer to its axis; or give "
    "normal_force as a law"
)
SEARCH_INTERVALS = 100  # intervals of the requested time, in which loops are closed one after the other
REACHED_TIME_TOLERANCE = 1e-9  # of that time, to which the last position they reach is found
# of that time: where they are tried after it, as a run may pass a singular configuration
TIMES_BEYOND_STOP = (1e-6, 1e-4, 1e-2)
NULL_SPACE_RATIO = 1e-10  # singular values below this part of the largest are zero
# mass of a body, relative to the heaviest that it carries, below which the inertia is nearly singular
LIGHT_BODY_MASS_RATIO = 1e-3
MIN_RATE_PARTICIPATION = 1e-6  # of the largest: what a joint has to do with a motion


def explain_failure(
    compiled: CompiledMechanism, status: Status, q: Array, end: float, starts_singular: bool
) -> Diagnostic:
    """Return why a run stopped at q (nq,) on its way to ``end`` (s), and what to do.

    ``starts_singular``: whether the loops do not determine all rates at the start.
    """
    if status.error is not None:
        return status.explain()
    if jam := find_jam(compiled, status):
        return jam
    stuck = status.code in (Code.BRANCHES, Code.COLLAPSED, Code.NOT_CLOSED)
    advice = describe_free_rates(compiled, status.t, q) if starts_singular else ""
    if advice and status.code in (Code.BRANCHES, Code.UNDECIDABLE):
        return status.explain(advice)
    drives = driven_bodies(compiled)
    until = 2.0 * end - status.t  # beyond the requested time: it may end right there
    last = (
        _find_last_reachable_time(compiled, status.t, q, until)
        if stuck and drives and compiled.system.has_matrices
        else until
    )
    if last == until:
        return status.explain(advise(compiled, status))
    whose = f"the drive of {drives[0]!r} requires" if len(drives) == 1 else "the drives require"
    return Diagnostic.error(
        "unreachable-drive",
        f"{whose} a position that the loops cannot reach after t = {last:.6g} s (the run stopped at "
        f"t = {status.t:.9g} s)",
        "Shorten the motion of the drive, or change the lengths of the loops.",
        subject=drives[0],
        time=last,
    )


def find_jam(compiled: CompiledMechanism, status: Status) -> Diagnostic | None:
    """Return why the friction that follows reactions has no solution at the end of a run; None: it has one."""
    bearings = compiled.data.state.bearings
    if not len(bearings) or status.code not in (Code.NOT_FINITE, Code.COLLAPSED):
        return None
    names = [
        acting.what
        for acting in compiled.mechanism.loads()
        if getattr(acting.load, "follows_reaction", False)
        for _ in acting.load.coordinates
    ]
    late = [k for k in range(len(bearings)) if bearings["jam_time"][k] >= status.t]
    if late:
        what = names[max(late, key=lambda k: float(bearings["jam_time"][k]))]
        text = (
            f"{what} jams at t = {status.t:.9g} s: its friction increases the reaction of the joint, and this the "
            "friction, so that no finite forces satisfy the equations of motion (Painleve's paradox)"
        )
        return Diagnostic.error("jammed-joint", text, JAM_REMEDY, subject=what, time=status.t)
    if bearings["undetermined_time"][0] >= status.t:
        text = (
            f"{names[0]} follows a reaction that is not determined at t = {status.t:.9g} s: constraints are redundant, "
            "or the mechanism is in a singular configuration"
        )
        remedy = (
            "Use loop-closing joints that do not prevent the same motion twice, such as a spherical one, or give "
            "normal_force as a number or a law"
        )
        return Diagnostic.error("undetermined-forces", text, remedy, subject=names[0], time=status.t)
    return None


def driven_bodies(compiled: CompiledMechanism) -> list[str]:
    """Return the names of the bodies whose joints are driven."""
    return [body.name for body in compiled.mechanism.bodies if body.joint.drive is not None]


def advise(compiled: CompiledMechanism, status: Status) -> str:
    """Return what to do after a step that collapsed, too many steps, or near branches, by what the model has; of other
    ends nothing.
    """
    if status.code is Code.NOT_FINITE and len(compiled.data.state.bearings):
        return f"Friction in proportion to the reaction of a joint may have no solution here. {JAM_REMEDY}"
    if status.code is Code.COLLAPSED:
        causes = [*_causes(compiled)]
        if not causes:
            return f"Use a larger tolerance{status.alternatives}."
        what, remedies = (" or ".join(texts) for texts in zip(*causes, strict=True))
        return f"Possible cause: {what}. Possible remedy: {remedies}{status.alternatives}."
    if status.code is Code.MAX_STEPS and (reason := compiled.system.stick_reason):
        return f"Possible cause: {reason}. Use a larger deflection of the friction or tolerance, or increase max_steps."
    if status.code is Code.BRANCHES:
        several = (
            ", or several loops are at slightly different times" if len(compiled.mechanism.constraints) > 1 else ""
        )
        turns = "Do not let a drive stop or turn back there. " if driven_bodies(compiled) else ""
        return (
            f"A loop is in a singular configuration, or very near one{several}. If the position is meant to be passed "
            "exactly, give lengths with all their digits; otherwise change them so that the loop stays farther from "
            f"it. {turns}A finer tolerance may help{status.alternatives}."
        )
    return ""


def _causes(compiled: CompiledMechanism) -> Iterator[tuple[str, str]]:
    """Yield what may make a step collapse in a model, and what helps."""
    if compiled.system.stick_reason:
        yield compiled.system.stick_reason, "use a larger deflection of the friction"
    if any(True for _ in compiled.mechanism.loads()):
        yield "a force that jumps or has a kink", "smooth the force"
    if compiled.system.m:
        yield "a singular configuration nearby", "change the lengths so that the loops stay farther from it"
        if driven_bodies(compiled):
            yield "a drive that moves its loop out of reach", "shorten the motion of the drive"
    if light := describe_light_body(compiled):
        yield light, "give it more mass"


def describe_light_body(compiled: CompiledMechanism) -> str:
    """Return the body that is lightest compared with the heaviest body that it carries; empty: none is light."""
    bodies, masses = compiled.mechanism.bodies, compiled.data.arrays.bodies["mass"]
    carried = np.zeros(len(bodies))
    for body in reversed(bodies[1:]):
        k = body.index
        carried[body.parent] = max(carried[body.parent], carried[k], float(masses[k]))
    own = np.array([float(masses[body.index]) for body in bodies])
    ratios = np.divide(own, carried, out=np.full(len(bodies), np.inf), where=(own > 0.0) & (carried > 0.0))
    k = int(np.argmin(ratios))
    if not ratios[k] < LIGHT_BODY_MASS_RATIO:
        return ""
    return f"body {bodies[k].name!r} of {own[k]:.3g} kg, which carries one of {carried[k]:.3g} kg"


def _find_last_reachable_time(compiled: CompiledMechanism, begin: float, q: Array, end: float) -> float:
    """Return until when loops can be closed, s: ``end`` where nothing ends that."""
    held, whole = np.zeros(compiled.system.n, bool), end - begin
    reached, step = begin, whole / SEARCH_INTERVALS
    way = [(begin, q)]

    def closed(t: float, near: Array) -> Array | None:
        try:
            return compiled.assembly.close(t, near, held)
        except AssemblyError:
            return None

    def beyond(t: float) -> bool:
        """Whether the loops can be closed at t near the present position, or where the way leads to."""
        before, then = next((at for at in reversed(way) if reached - at[0] >= t - reached), way[0])
        ahead = q + (q - then) * ((t - reached) / (reached - before)) if before < reached else q
        return closed(t, q) is not None or closed(t, ahead) is not None

    while reached < end and step > REACHED_TIME_TOLERANCE * whole:
        ahead = min(reached + step, end)
        there = closed(ahead, q)
        if there is None:
            step *= 0.5
        else:
            reached, q = ahead, there
            way.append((reached, q))
    opens = reached < end and not any(beyond(min(reached + part * whole, end)) for part in TIMES_BEYOND_STOP)
    return reached if opens else end


def describe_free_rates(compiled: CompiledMechanism, t: float, q: Array) -> str:
    """Return a message on the rates that choose the branch in a singular configuration q (nq,); empty: all given."""
    names = find_undetermined_rates(compiled, t, q)
    return SINGULAR_START.remedy.format(**free_rates(names)) if names else ""


def free_rates(names: Sequence[str]) -> dict[str, str]:
    """Return the fields of the remedy of SINGULAR_START for joints of these names."""
    quoted = [repr(name) for name in names]
    joints = " and ".join(filter(None, (", ".join(quoted[:-1]), quoted[-1])))
    return {"plural": "s" if len(names) > 1 else "", "joints": joints}


def explain_rates(compiled: CompiledMechanism, t: float, q: Array, v: Array, rank: int, tolerance: float) -> str:
    """Return why the rates v (n,) belong to no branch of the motion in a singular configuration q (nq,); empty: they
    do, or it is none. ``rank`` is that of the constraints nearby; see :func:`solvers.loop_closure.is_off_branch`.
    """
    system: Any = compiled.system
    terms = system.allocate_terms()
    system.fill(t, q, v, terms)
    if not is_off_branch(pin(terms), v, rank, tolerance, pin(ClosureScratch.of(system))):
        return ""
    bodies, first, values = free_bodies(compiled.mechanism), 0, []
    for body in bodies:
        values += [f"{body.name!r} {x:.6g}" for x in v[first : first + body.joint.nv]]
        first += body.joint.nv
    return (
        "the start is a singular configuration, in which several branches of the motion cross, and the given rates are "
        f"not those of any branch ({', '.join(values)}). {describe_free_rates(compiled, t, q) or 'Give other rates'}"
    )


def find_undetermined_rates(compiled: CompiledMechanism, t: float, q: Array) -> tuple[str, ...]:
    """Return the joints whose rates the loops do not determine at q (nq,), and that were not given one."""
    system: Any = compiled.system
    terms = system.allocate_terms()
    system.fill_position(t, q, terms)
    _, sigma, V = np.linalg.svd(terms.J * system.size / system.row_size[:, None])
    null = V[int(np.sum(sigma > NULL_SPACE_RATIO * sigma[0])) :]
    moved = np.linalg.norm(null, axis=0) > MIN_RATE_PARTICIPATION
    first, names = 0, []
    for body in free_bodies(compiled.mechanism):
        if body.joint.rate is None and moved[first : first + body.joint.nv].any():
            names.append(body.name)
        first += body.joint.nv
    return tuple(names)
