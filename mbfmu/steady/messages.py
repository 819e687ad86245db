"""What the search for a steady state reports."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.loads.base import MAX_ACCURATE_RATIO
from mbfmu.steady.checks import STEADY_TOLERANCE
from mbfmu.util.diagnostics import Diagnostic
from solvers.statics.newton import Outcome, Solution
from solvers.system import Array

OUTCOME_TEXTS = {
    Outcome.NO_PROGRESS: "neither Newton iteration nor pseudo-transient continuation converged",
    Outcome.SINGULAR: "the Jacobian is singular, and no position nearby balances the remaining force",
    Outcome.UNDETERMINED: "the search ended in a singular configuration, in which the forces of the loop-closing "
    "joints are not determined",
    Outcome.NOT_FINITE: "the equations gave a value that is not finite",
}

SLIDING_TEXT = (
    "the friction of contacts is proportional to slip and holds nothing at rest, so that a sheet without "
    "supports has no unique steady state: add a support, try another start (--from), or run it until it has "
    "settled"
)

MOVING_TEXT = (
    "in a steady state drives and cyclic coordinates, on which nothing depends, move on, and everything else is at rest"
)
NO_RATE_TEXT = "nothing depends on this coordinate, but no steady state was found with the start rates"


def describe_held_states(names: Sequence[str], *, sticks: bool) -> tuple[Diagnostic, ...]:
    """Return a note on the states of frictions without slip: they keep their start values, or stick."""
    if not names:
        return ()
    if sticks:
        states = f"{names[0]!r}{f' and {len(names) - 1} more' if len(names) > 1 else ''}"
        text = f"friction holds the start position (state {states}), and could hold positions nearby, too"
        return (Diagnostic.note("steady-state", text),)
    subject = f"{names[0]!r} keeps its start value"
    if len(names) > 1:
        subject = f"{names[0]!r} and {len(names) - 1} more keep their start values"
    text = f"{subject}: friction exerts no other force in this state, although it could hold positions nearby, too"
    return (Diagnostic.note("steady-state", text),)


def describe_dropped_rates(compiled: CompiledMechanism, v: Array, at_rest: NDArray[np.bool_]) -> tuple[Diagnostic, ...]:
    """Return notes if the model's start has other rates than the steady state, v (n,).

    ``at_rest`` (n,) are cyclic coordinates without their start rates, since none was found with them.
    """
    given, names = compiled.assembly.start_velocities(), compiled.system.coordinate_names
    given[len(given) - compiled.system.n_states :] = 0.0  # where the search for the states begins
    is_dropped = (given != v) & (given != 0.0)
    notes: list[Diagnostic] = []
    for own, reason in ((~at_rest, MOVING_TEXT), (at_rest, NO_RATE_TEXT)):
        if dropped := [f"{names[k]!r} ({given[k]:g})" for k in np.flatnonzero(is_dropped & own)]:
            notes.append(
                Diagnostic.note("steady-state", f"the given rate of {', '.join(dropped)} is not kept: {reason}")
            )
    return tuple(notes)


def describe_mesh(compiled: CompiledMechanism, q: Array) -> tuple[Diagnostic, ...]:
    """Return a warning if elements are beyond the limits of their theory in a state, q (nq,)."""
    if compiled.limit_ratio(0.0, q) <= MAX_ACCURATE_RATIO:
        return ()
    return (Diagnostic.parse(compiled.describe_limit(0.0, q), "warning", "coarse-mesh"),)


def describe_failure(
    what: str, compiled: CompiledMechanism, solution: Solution, v: Array, pushed: str, held: Sequence[str]
) -> str:
    """Return why a search ended without a steady state.

    Parameters
    ----------
    what
        What was not found.
    compiled
        The model.
    solution
        Where the search ended.
    v
        Velocities (n,) of the steady state, m/s and rad/s.
    pushed
        The motion on which loads act at the start without resistance; empty: there is none.
    held
        Names of first-order states that keep their start values.
    """
    system, worst = compiled.system, int(np.argmax(np.abs(solution.forces)))
    gap = compiled.length * float(np.abs(solution.gaps / system.row_size).max(initial=0.0))
    if pushed:
        return (
            f"{what}: at the start nothing resists {pushed}, on which the loads act; add a support, or try another "
            "start (--from)"
        )
    if held:
        advice = "friction cannot hold the start: run the model until it stops"
    else:
        advice = SLIDING_TEXT if system.nonsmooth_reason else "try another start (--from)"
    return (
        f"{what}: {OUTCOME_TEXTS[solution.outcome]}; residual {abs(solution.forces[worst]):.3g} N or N m at "
        f"{system.coordinate_names[worst]!r}, loops open by {gap:.3g} m{describe_slip(compiled, solution, v)}; {advice}"
    )


def describe_slip(compiled: CompiledMechanism, solution: Solution, v: Array) -> str:
    """Return the nonholonomic constraint that velocities v (n,) violate most where a search ended; empty: none."""
    system, rows = compiled.system, compiled.system.nonholonomic
    if not (len(rows) and v.any()):
        return ""
    terms = system.allocate_terms()
    system.fill(0.0, solution.q[: system.nq], v, terms)
    slips = np.abs(terms.J @ v - terms.nu)[rows]
    worst = int(slips.argmax())
    fastest = float(np.abs(v / system.size).max())
    if slips[worst] <= STEADY_TOLERANCE * fastest * system.row_size[rows[worst]]:
        return ""
    return f", constraint {system.constraint_names[rows[worst]]!r} violated by {slips[worst]:.3g} m/s"
