"""The largest error that is accepted, and the outputs that can be held to it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite

from mbfmu.studies.comparison_report import listed
from mbfmu.studies.reference import Reference
from mbfmu.util.errors import MAX_VALUE_LENGTH, UserError, short
from mbfmu.util.text_table import format_tolerance
from mbfmu.util.units import read_unit

MAX_REFERENCE_UNCERTAINTY = 0.5  # of the target: largest uncertainty of the reference, which is subtracted from it


@dataclass(frozen=True, kw_only=True)
class Target:
    """An error: a part of the ranges of outputs (``unit`` is empty), or absolute in a unit."""

    value: float
    unit: str = ""

    def __str__(self) -> str:
        """Return it for people."""
        return f"{self.value:.3g} {self.unit}" if self.unit else f"{format_tolerance(self.value)} of the range"

    def suits(self, unit: str) -> bool:
        """Whether outputs of a unit can be held to it."""
        return not self.unit or read_unit(unit).exponents == read_unit(self.unit).exponents

    def of_range(self, unit: str, scale: float) -> float:
        """Return it as a part of the range of an output."""
        return self.value * read_unit(self.unit).factor / (read_unit(unit).factor * scale) if self.unit else self.value


def read_target(target: float | str | Target) -> Target:
    """Return a target from a number (a part of ranges), or from text such as ``1e-4``, ``0.2 mm`` and ``1e-3rad``.

    Raises
    ------
    UserError
        It is no number above zero, or its unit is unknown.
    """
    if isinstance(target, Target):
        return target
    text = str(target)
    known = len(text) <= MAX_VALUE_LENGTH  # matching takes the square of the length
    found = re.fullmatch(r"\s*([-+.\d]+(?:[eE][-+]?\d+)?)\s*(\S*)\s*", text) if known else None
    try:
        value = float(found.group(1)) if found else inf
    except ValueError:
        value = inf
    if not found or not (isfinite(value) and value > 0.0):
        raise UserError(
            f"target is {short(target)}; allowed: a number above zero, such as 1e-4 of the range, or with a unit: "
            "'0.2 mm'"
        )
    if found.group(2):
        try:
            read_unit(found.group(2))
        except UserError as error:
            raise UserError(f"target is {target!r}: {error}") from error
    return Target(value=value, unit=found.group(2))


def narrow_reference(reference_data: Reference, target: Target, outputs: Sequence[str]) -> Reference:
    """Return a reference of the outputs alone that are held to a target.

    Raises
    ------
    UserError
        The target does not suit them, or is finer than they are known.
    """
    suited = {name: unit for name, unit in reference_data.units.items() if target.suits(unit)}
    if not suited or (outputs and len(suited) < len(reference_data.units)):
        others = [f"{name} [{unit}]" for name, unit in reference_data.units.items() if name not in suited]
        raise UserError(f"target {target} does not suit {listed(others)}; allowed: a unit of theirs, or none")
    known_to = {name: reference_data.motion.doubt[name] / reference_data.motion.scale[name] for name in suited}
    limits = {name: target.of_range(unit, reference_data.motion.scale[name]) for name, unit in suited.items()}
    clear = {name: unit for name, unit in suited.items() if known_to[name] <= MAX_REFERENCE_UNCERTAINTY * limits[name]}
    if not clear or (outputs and len(clear) < len(suited)):
        worst = max if outputs else min  # all of them, or any
        doubt, name = worst((known_to[name] / limits[name], name) for name in suited if name not in clear)
        least = replace(target, value=doubt * target.value / MAX_REFERENCE_UNCERTAINTY)
        raise UserError(
            f"target {target} is smaller than the uncertainty of the reference: {name} is known to "
            f"{known_to[name]:.1g} of its "
            f"range; allowed: from {least} on, or finer resolutions, or a larger budget"
        )
    unclear = {n: f"uncertainty {known_to[n]:.0e} of its range" for n in suited if n not in clear}
    return replace(reference_data, units=clear, not_evaluated=reference_data.not_evaluated | unclear)
