"""How an advance ends, in a code, a sentence, and what to try next."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple


class Code(IntEnum):
    """How an :meth:`Stepper.advance` ended; the numbers are those the kernels return."""

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
    Code.OK: ("reached the time asked for", ""),
    Code.NOT_CLOSED: (
        "no position or rate nearby satisfies the constraints",
        "At the start: give positions nearer to a closed loop, or other rates. Later: see whether a drive moves its "
        "loop out of reach, or turns back in a singular position{others}.",
    ),
    Code.NO_MASS: (
        "a motion that the constraints allow moves no mass",
        "Give a mass or inertia to the bodies that move freely, or lock the coordinate.",
    ),
    Code.UNDECIDABLE: (
        "the mechanism is in a singular position where branches of the motion cross, and nothing tells which to "
        "follow: it is at rest, or several loops are singular at once",
        "Start slightly off the singular position, or with a velocity along the branch that is meant.",
    ),
    Code.NOT_FINITE: (
        "the equations of motion gave a value that is not finite",
        "Look at forces and signals for a division by zero or an overflow near the time reached.",
    ),
    Code.MAX_STEPS: (
        "the largest number of steps for one call was taken",
        "Check whether something moves far faster than intended. Else loosen the tolerance, allow more steps "
        "(max_steps), or divide the interval into shorter ones.",
    ),
    Code.COLLAPSED: (
        "the step has become so small that the time no longer changes",
        "A force may jump or have a kink here, a singular position may be near, a drive may move its loop out of "
        "reach, or a body of next to no mass may carry a heavy one. Smooth the force, shorten the motion of the drive, "
        "or give the light body more mass{others}.",
    ),
    Code.BRANCHES: (
        "two branches of the motion are so close that no step is short enough to tell them apart",
        "A loop is in a singular position, or very near one, or several loops are at slightly different times. If the "
        "position is meant to be passed exactly, give lengths with all their digits; otherwise change them so that the "
        "loop stays farther from it. Do not let a drive stop or turn back there. A finer tolerance may help{others}.",
    ),
}


class Status(NamedTuple):
    """Result of :meth:`Stepper.advance`."""

    code: Code
    t: float  # s, where the stepper stands now
    others: tuple[str, ...] = ()  # solvers to try where this one does not go on

    @property
    def ok(self) -> bool:
        """Whether the requested time was reached."""
        return self.code is Code.OK

    @property
    def message(self) -> str:
        """What happened, and when."""
        return f"{MESSAGES[self.code][0]} (t = {self.t:.9g} s)"

    @property
    def remedy(self) -> str:
        """What to try next; empty where nothing is wrong."""
        names = " or ".join(repr(name) for name in self.others)
        return MESSAGES[self.code][1].format(others=f", or try {names}" if names else "")


class SolverError(ArithmeticError):
    """A requested quantity cannot be determined by the solver; the message names the remedy."""

    def __init__(self, status: Status) -> None:
        super().__init__(f"{status.message}. {status.remedy}")
        self.status = status
