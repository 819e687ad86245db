"""Codes of the warnings and errors of the solvers; ``mbfmu.util.codes`` adds those of models, runs and FMUs.

A code is a word in brackets at the end of a message. It stays the same when the message is reworded, so that it can be
searched for. ``docs/messages.md`` has a section for each.
"""

from __future__ import annotations

import re

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


def coded(code: str, text: str) -> str:
    """Return a message that ends in its code; one that quotes another message takes over the code of that."""
    quoted: list[str] = CODE_PATTERN.findall(text)
    return f"{without_code(text)} [{quoted[-1] if quoted else code}]"


def without_code(text: str) -> str:
    """Return a message without codes, as part of another one."""
    return CODE_PATTERN.sub("", text)


def code_of(text: str) -> str:
    """Return the code that a message ends in; empty: it has none, and is no warning and no error."""
    found = CODE_PATTERN.search(text, text.rfind(" ["))
    return found[1] if text.endswith("]") and found else ""
