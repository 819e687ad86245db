"""Result of an advance: code, message and advice."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

from .diagnostics import Diagnostic


class Code(IntEnum):
    """Result codes of :meth:`Stepper.advance`; the numbers are those of the kernels."""

    OK = 0
    NOT_CLOSED = 1
    NO_MASS = 2
    UNDECIDABLE = 3
    NOT_FINITE = 4
    MAX_STEPS = 5
    COLLAPSED = 6
    BRANCHES = 7


CODES = tuple(Code)  # by number
OK, NOT_CLOSED, NO_MASS, UNDECIDABLE, NOT_FINITE, MAX_STEPS, COLLAPSED, BRANCHES = map(int, Code)  # for kernels

MESSAGES: dict[Code, tuple[str, str]] = {
    Code.OK: ("reached the requested time", ""),
    Code.NOT_CLOSED: (
        "no position or velocity near the present one satisfies the constraints",
        "At the start: give positions nearer to a closed loop, or other rates. Later: check whether a drive requires a "
        "position that its loop cannot reach, or reverses in a singular configuration{alternatives}.",
    ),
    Code.NO_MASS: (
        "a coordinate can move without moving mass",
        "Give a mass or inertia to the bodies that move freely, or lock the coordinate.",
    ),
    Code.UNDECIDABLE: (
        "the mechanism is in a singular configuration where several branches of the motion cross, and its velocity "
        "does not determine the branch: it is at rest, or several loops are singular at the same time",
        "Start slightly outside the singular configuration, or with a velocity along the intended branch.",
    ),
    Code.NOT_FINITE: (
        "the equations of motion returned a value that is not finite",
        "Check forces and signals for a division by zero or an overflow near this time.",
    ),
    Code.MAX_STEPS: (
        "the maximum number of steps was reached before the end of the interval",
        "Check whether a body moves far faster than intended. Otherwise use a larger tolerance, increase max_steps, or "
        "use shorter intervals between outputs (communication steps).",
    ),
    Code.COLLAPSED: (
        "the step has become so small that the time no longer changes",
        "A force may jump here, or the constraints or the inertia may be nearly singular. Smooth the force, or change "
        "the mechanism{alternatives}.",
    ),
    Code.BRANCHES: (
        "two branches of the motion are so close that no step is short enough to tell them apart",
        "A loop is in a singular configuration, or very near one. If the position is meant to be passed exactly, give "
        "lengths with all their digits; otherwise change them so that the loop stays farther from it. A finer "
        "tolerance may help{alternatives}.",
    ),
}

KEYS: dict[Code, str] = {  # of :data:`solvers.diagnostics.TITLES`
    Code.NOT_CLOSED: "loop-not-closed",
    Code.NO_MASS: "no-inertia",
    Code.UNDECIDABLE: "undetermined-branch",
    Code.NOT_FINITE: "not-finite",
    Code.MAX_STEPS: "too-many-steps",
    Code.COLLAPSED: "collapsed-step",
    Code.BRANCHES: "close-branches",
}


class UserSolverError(ValueError):
    """Error in the code of a solver from outside the package, whose ``__cause__`` is the exception that was raised."""

    def __init__(self, diagnostic: Diagnostic) -> None:
        super().__init__(str(diagnostic))
        self.diagnostic = diagnostic


class Status(NamedTuple):
    """Result of :meth:`Stepper.advance`."""

    code: Code
    t: float  # s, reported time
    fallback_solvers: tuple[str, ...] = ()  # solvers to try if this one cannot continue
    error: UserSolverError | None = None  # why it has stopped, if that is in the code of a solver from outside

    @property
    def ok(self) -> bool:
        """Whether the requested time was reached."""
        return self.code is Code.OK

    @property
    def message(self) -> str:
        """Error message with the time; empty if there is none."""
        return f"{MESSAGES[self.code][0]} (t = {self.t:.9g} s)"

    @property
    def remedy(self) -> str:
        """Advice; empty if nothing is wrong."""
        return MESSAGES[self.code][1].format(alternatives=self.alternatives)

    @property
    def alternatives(self) -> str:
        """Other solvers to try, as the last clause of an advice; empty if there are none."""
        names = " or ".join(repr(name) for name in self.fallback_solvers)
        return f", or try {names}" if names else ""

    def explain(self, advice: str = "") -> Diagnostic:
        """Return what happened, when, and what to do: ``advice`` instead of the general remedy."""
        if self.error is not None:
            return self.error.diagnostic
        return Diagnostic.error(KEYS[self.code], self.message, advice or self.remedy, time=self.t)


class SolverError(ArithmeticError):
    """A requested quantity cannot be determined by the solver; the message names the remedy."""

    def __init__(self, status: Status) -> None:
        super().__init__(str(status.explain()))
        self.status = status
