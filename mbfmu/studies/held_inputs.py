"""What a check or a comparison does not evaluate of inputs, which have their start values in its runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from mbfmu.mechanics import Variable
from mbfmu.util.diagnostics import Diagnostic

MAX_NAMED_INPUTS = 3  # inputs that are named


def not_examined(what: str, remedy: str = "") -> Diagnostic:
    """Return a note on what was not examined."""
    return Diagnostic.note("not-examined", f"not examined: {what}", remedy)


def describe_held_inputs(inputs: Sequence[Variable]) -> list[Diagnostic]:
    """Return a note on what is not evaluated because inputs stay at their start values; empty if there are none.

    Parameters
    ----------
    inputs
        Those of the model, with their start values.
    """
    if not inputs:
        return []
    values = [
        f"{v.name!r} ({v.start or 0.0:g}{f' {v.unit}' if v.unit != '1' else ''})" for v in inputs[:MAX_NAMED_INPUTS]
    ]
    more = f" and {len(inputs) - MAX_NAMED_INPUTS} more" if len(inputs) > MAX_NAMED_INPUTS else ""
    what = f"other values of {'inputs' if inputs[1:] else 'input'} {', '.join(values)}{more}, which kept this value"
    remedy = "To examine a varying input, replace it by a signal: --input NAME=VALUE, or Model.with_inputs in Python"
    return [replace(not_examined(what, remedy), subject=inputs[0].name)]
