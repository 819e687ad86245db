"""Assembly of loops in a native FMU, by the matrices of the constraint equations: kernels over instances."""

from __future__ import annotations

from typing import Any

from solvers.compiled.kernel import kernel
from solvers.loop_closure import ASSEMBLED, find_closed_positions, find_consistent_velocities

from .start_checks import find_turned


@kernel
def close_positions(instance: Any, t: float) -> int:
    """Let the reported positions be those of the start with closed loops; return a code of :mod:`solvers.loop_closure`.

    If it is not ASSEMBLED, ``worst`` of the scratch contains the cause.
    """
    problem, start = instance.given, instance.start
    code: int = find_closed_positions(instance.eqs, t, start.q, problem.q, start.scratch)
    return find_turned(instance, start.scratch.worst[0]) if code == ASSEMBLED else code


@kernel
def close_velocities(instance: Any, t: float) -> int:
    """The same of the velocities, at these positions."""
    problem, start, rate = instance.given, instance.start, instance.known[0]
    code: int = find_consistent_velocities(instance.eqs, t, problem.q, start.v, rate, problem.v, start.scratch)
    return code
