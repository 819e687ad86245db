"""Histories of Adams formulas at jumps and short changes of y' whose times are known.

Ahead of a jump, or of a change within a short interval, a signal halves the longest step from step to step. At a high
order the error estimate of such short steps contains almost nothing of the change, so that they are accepted across
it, and the polynomials through both sides of it, extrapolated over a dozen steps, leave errors of many tolerances.
Therefore

- the order is one ahead of it, where the estimate is half of J h for a jump J;
- steps that end as soon after the jump as the clock resolves are accepted, since J h cannot be made smaller;
- a new history begins where the limit ends.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from solvers.compiled.kernel import kernel
from solvers.resolution import is_discontinuity

from .formulas import restart_history

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.steppers.adams.formulas import History

SHORTENED_LIMIT_RATIO = 0.75  # limit over next step below which a change of y' is near; halved limits are below it
ENDED_LIMIT_RATIO = 1e3  # times: a limit that becomes longer by so much has ended


@kernel
def limit_steps(
    history: History, settings_array: Any, t: float, q: Reals, v: Reals, work: float, longest: float
) -> None:
    """See :class:`solvers.steppers.compiled_loop.MethodKernels`; the order falls ahead of a jump."""
    control, settings = history.control[0], settings_array[0]
    before = settings.max_step
    if longest == before:
        return
    settings.max_step = longest
    if control.start == 0:
        if longest >= ENDED_LIMIT_RATIO * before and is_discontinuity(before, t):
            restart_history(history, t, q, v, work, 0, False)
        elif longest < SHORTENED_LIMIT_RATIO * control.h:
            control.phase1, control.k = 0, 1
    control.h = min(control.h, longest)
