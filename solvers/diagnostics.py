"""Diagnostics: notes, warnings and errors of a run, and their codes; ``mbfmu.util.diagnostics`` adds those of models.

A code is a word that stays the same when a message is reworded, so that it can be searched for. ``docs/messages.md``
has a section for each. As text, in exceptions and in the log of an FMU, a diagnostic is

    what was found. What to do [code]

where the first part is one sentence, contains names in quotes, and a time as ``t = 1.5 s``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal, Self

TITLES = {
    "loop-not-closed": "The constraints cannot be satisfied near the present state",
    "no-inertia": "A coordinate can move without moving mass",
    "undetermined-branch": "Motion from a singular configuration is not determined",
    "not-finite": "The equations of motion return a value that is not finite",
    "too-many-steps": "The maximum number of steps is reached",
    "collapsed-step": "The step size is too small to continue",
    "close-branches": "Two branches of the motion cannot be distinguished",
    "clock-resolution": "Time or position too large for the tolerance",
    "limited-tolerance": "The solver uses another tolerance than requested",
    "ill-conditioned-mass": "The mass matrix is nearly singular",
    "large-error": "The global error may be much larger than the tolerance",
    "unsuitable-solver": "The solver cannot be used with this model",
    "broken-solver": "A solver from another package has an error",
    "invalid-value": "An argument, a name or a file is not valid",
}
CODE_PATTERN = re.compile(r" \[([a-z]+(?:-[a-z]+)+)\]")
NAME_PATTERN = re.compile(r"'([^']*)'")
TIME_PATTERN = re.compile(r"\bt = (-?[\d.]+(?:e[-+]?\d+)?) s\b")

Severity = Literal["note", "warning", "error"]


@dataclass(frozen=True)
class Diagnostic:
    """One note, warning or error; ``str()`` returns it as text that ends in its code in brackets.

    Attributes
    ----------
    severity
        ``"note"``: the result is right; ``"warning"``: it may be wrong, or something else is computed than requested;
        ``"error"``: there is no result, or it ends early.
    code
        Code, described on the page of warnings and errors, such as ``"energy-balance"``.
    time
        Simulated time, s; None if it concerns no time.
    subject
        Name of the body, joint, loop, input, output, solver or setting that it concerns; empty if there is none.
    text
        What was found, with its values: one sentence without a full stop at the end.
    remedy
        What it means and what to do: one or several sentences; may be empty.
    """

    severity: Severity
    code: str
    time: float | None = None
    subject: str = ""
    text: str = ""
    remedy: str = ""

    @classmethod
    def note(cls, code: str, text: str, remedy: str = "", *, subject: str = "", time: float | None = None) -> Self:
        """Return a note."""
        return cls("note", code, time, subject, text, remedy)

    @classmethod
    def warning(cls, code: str, text: str, remedy: str = "", *, subject: str = "", time: float | None = None) -> Self:
        """Return a warning."""
        return cls("warning", code, time, subject, text, remedy)

    @classmethod
    def error(cls, code: str, text: str, remedy: str = "", *, subject: str = "", time: float | None = None) -> Self:
        """Return an error."""
        return cls("error", code, time, subject, text, remedy)

    @classmethod
    def parse(cls, message: str, severity: Severity, code: str) -> Self:
        """Return the diagnostic of a text, such as one from an exception or from the log of an FMU.

        A code in the text is used in place of ``code``: a message that quotes another one has the code of that. Subject
        and time are the first name in quotes and the first ``t = ... s`` of the first sentence.
        """
        quoted: list[str] = CODE_PATTERN.findall(message)
        text, _, remedy = without_code(message).partition(". ")
        name, time = NAME_PATTERN.search(text), TIME_PATTERN.search(text)
        return cls(
            severity, quoted[-1] if quoted else code, float(time[1]) if time else None, name[1] if name else "", text,
            remedy,
        )  # fmt: skip

    @property
    def message(self) -> str:
        """Text and remedy, without the code."""
        return ". ".join(filter(None, (self.text, self.remedy)))

    def __str__(self) -> str:
        return f"{self.message} [{self.code}]"


def without_code(text: str) -> str:
    """Return a message without codes, as part of another one."""
    return CODE_PATTERN.sub("", text)
