"""What a check or a comparison does not evaluate of inputs, which have their start values in its runs."""

from __future__ import annotations

from collections.abc import Sequence

from mbfmu.mechanics import Variable

MAX_NAMED_INPUTS = 3  # inputs that are named


def describe_held_inputs(inputs: Sequence[Variable]) -> str:
    """Return what is not evaluated because inputs stay at their start values; empty if there are none.

    Parameters
    ----------
    inputs
        Those of the model, with their start values.
    """
    if not inputs:
        return ""
    values = [
        f"{v.name!r} ({v.start or 0.0:g}{f' {v.unit}' if v.unit != '1' else ''})" for v in inputs[:MAX_NAMED_INPUTS]
    ]
    more = f" and {len(inputs) - MAX_NAMED_INPUTS} more" if len(inputs) > MAX_NAMED_INPUTS else ""
    return (
        f"other values of {'inputs' if inputs[1:] else 'input'} {', '.join(values)}{more}, which kept this value; to "
        "examine a varying input, replace it in the model by a signal"
    )
