"""Parameters: fields of a dataclass with a unit, limits or choices, and a description."""

from __future__ import annotations

import sys
from dataclasses import Field, dataclass, field, fields
from functools import cache
from math import inf, isfinite
from typing import Any

import numpy as np

from mbfmu.util.errors import UserError

MAX_INTEGER = 2**31 - 1  # of a whole number in an FMU


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """What is known of a parameter besides its value."""

    name: str
    default: float | int | bool | str
    unit: str
    min: float
    max: float
    doc: str
    tunable: bool
    optional: bool
    structural: bool
    choices: tuple[str, ...]
    unlisted: tuple[str, ...]
    resolution: tuple[float, ...]

    @property
    def listed_choices(self) -> tuple[str, ...]:
        """The choices that are offered to users."""
        return tuple(word for word in self.choices if word not in self.unlisted)

    def varies(self, value: Any) -> bool:
        """Whether a run with this value at its start may change it."""
        return self.tunable and not (self.optional and value == 0)


def parameter(
    default: Any,
    *,
    unit: str = "1",
    min: float = -inf,
    max: float = inf,
    doc: str = "",
    tunable: bool = False,
    optional: bool = False,
    structural: bool = False,
    choices: tuple[str, ...] = (),
    unlisted: tuple[str, ...] = (),
    resolution: tuple[float, ...] = (),
) -> Any:
    """Declare a parameter of a model.

    Parameters
    ----------
    default
        Default value; its type (float, int, bool, or str with ``choices``) is the type of the parameter.
    unit
        FMI unit; ``"1"`` for a pure number.
    min, max
        Allowed range, ends included.
    doc
        Description in a few words, starting with a noun.
    tunable
        Whether it may change during a run; it must not change the structure of the mechanism.
    optional
        Whether the mechanism has no corresponding element if the value is zero. Such a parameter cannot change from or
        to zero during a run.
    structural
        Whether it determines the inputs and outputs; an FMU has it fixed at export.
    choices
        Allowed words; such a parameter is structural. In an FMU they are numbered from 1 in this order.
    unlisted
        Those of the choices that are accepted, but are not in help texts and messages. An FMU has them only if it was
        exported with this value.
    resolution
        For a parameter of the discretization: values of a comparison, from coarse to
        fine. All such parameters of a model are refined together, the first value of each with the first of all others.
        Sizes of cells are proportional to the inverse of the values. If one of them is zero, nothing is discretized and
        nothing is tried.

    Returns
    -------
    dataclasses.Field
        Field of the dataclass; errors of the declaration are reported when the model is first used.
    """
    about = {"unit": unit, "min": min, "max": max, "doc": doc, "choices": choices, "resolution": resolution}
    about |= {"tunable": tunable, "optional": optional, "unlisted": unlisted}
    about["structural"] = structural or bool(choices)
    return field(default=default, metadata=about)


@cache
def declared(cls: Any) -> tuple[Parameter, ...]:
    """Return the parameters of a dataclass in order; raises UserError for an incomplete declaration."""
    if any(isinstance(value, Field) for value in vars(cls).values()):
        raise UserError(
            f"model {cls.__name__} declares parameters, but is not a dataclass, which gives them their values: write "
            "@dataclass(frozen=True, kw_only=True) above the class"
        )
    found = tuple(Parameter(name=f.name, default=f.default, **f.metadata) for f in fields(cls) if f.metadata)  # type: ignore[arg-type]
    for p in found:
        if p.name in getattr(cls, "reserved", ()):
            raise UserError(
                f"parameter {p.name!r} of model {cls.__name__} is named as an attribute that every model has; "
                "give it another name"
            )
        check_declaration(cls.__name__, p)
    lengths = {p.name: len(p.resolution) for p in found if p.resolution}
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{name} has {count}" for name, count in lengths.items())
        raise UserError(f"model {cls.__name__}: its lists of resolutions must have equal lengths; {told}")
    return found


def check_declaration(model: str, p: Parameter) -> None:
    """Refuse what an FMU could not say of a parameter."""
    what = f"parameter {p.name!r} of model {model}"
    if not isinstance(p.doc, str):
        raise UserError(f"{what}: doc is {p.doc!r}; allowed: text")
    if not all(isinstance(c, str) and c for c in p.choices) or len(set(p.choices)) < len(p.choices):
        raise UserError(f"{what}: choices are {p.choices!r}; allowed: words, each once")
    if isinstance(p.default, str) and not p.choices:
        raise UserError(f"{what}: the default is the text {p.default!r}; give all allowed words with choices=(...)")
    for value in p.resolution:
        check(model, p, value)
    if p.resolution and (p.choices or isinstance(p.default, bool) or list(p.resolution) != sorted(p.resolution)):
        raise UserError(f"{what}: resolution is {p.resolution!r}; allowed: numbers, each no less than the one before")
    real = isinstance(p.default, float)
    if p.unit != "1" and not real:
        raise UserError(
            f"{what}: unit is {p.unit!r}, but the parameter is not a real number; give a real "
            "default, or leave out unit"
        )
    if isinstance(p.default, int) and not isinstance(p.default, bool):
        for name, value in (("default", p.default), ("min", p.min), ("max", p.max)):
            if isfinite(value) and not (value == int(value) and abs(value) <= MAX_INTEGER):
                raise UserError(f"{what}: {name} is {value!r}; allowed: a whole number, at most {MAX_INTEGER}")


def check(model: str, declared: Parameter, value: Any) -> Any:
    """Return the value in the parameter's type, or say what is wrong with it."""
    kind = type(declared.default)
    what = f"parameter {declared.name!r} of {model!r} is {value!r}"
    if declared.choices:
        if value not in declared.choices:
            raise UserError(f"{what}; allowed: {span(declared)}")
        return value
    if kind is bool or isinstance(value, bool | np.bool_):
        if kind is bool and isinstance(value, bool | np.bool_):
            return bool(value)
        raise UserError(f"{what}; allowed: {'true or false' if kind is bool else 'a number'}")
    number = isinstance(value, int | float | np.integer | np.floating)
    if not number or not abs(value) <= sys.float_info.max:  # an int may be larger
        raise UserError(f"{what}; allowed: a finite number")
    if kind is int and value != int(value):
        raise UserError(f"{what}; allowed: a whole number")
    if not declared.min <= value <= declared.max:
        raise UserError(f"{what}; allowed: {span(declared)}")
    return kind(value)


def read_text(declared: Parameter, text: str) -> Any:
    """Convert text to a value of the parameter's type if possible; :func:`check` checks the rest."""
    if declared.choices:
        return text
    if isinstance(declared.default, bool):
        return {"true": True, "false": False}.get(text.lower(), text)
    try:
        return float(text)
    except ValueError:
        return text


def span(declared: Parameter) -> str:
    """Return the allowed range as text."""
    if declared.choices:
        return ", ".join(map(repr, declared.listed_choices))
    if isinstance(declared.default, bool):
        return "true or false"
    unit = "" if declared.unit == "1" else f" {declared.unit}"
    kind = "whole numbers, " if isinstance(declared.default, int) else ""
    if declared.min == -inf:
        return f"{kind}any finite number" if declared.max == inf else f"{kind}at most {declared.max:g}{unit}"
    if declared.max == inf:
        return f"{kind}at least {declared.min:g}{unit}"
    return f"{kind}{declared.min:g} to {declared.max:g}{unit}"
