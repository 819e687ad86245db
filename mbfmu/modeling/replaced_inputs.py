"""Inputs of a model that are replaced by signals: a number, an expression of time, or a column of a file."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np

from mbfmu.mechanics import CompiledMechanism, Mechanism
from mbfmu.mechanics.arrays.given_inputs import GivenInputs
from mbfmu.mechanics.checks import signal_of
from mbfmu.mechanics.numbers import is_finite
from mbfmu.mechanics.signals import Function, Polynomial, Signal, Table
from mbfmu.mechanics.signals.measured import KIND_BY_USE, MeasuredTable
from mbfmu.util.errors import UserError, short

from .table_files import PARQUET_SUFFIXES, read_column

if TYPE_CHECKING:
    from .model import Model

ALLOWED = (
    "a finite number, an expression of the time t, a function of time, a pair (times, values) of two sequences, a "
    "Table, or another signal without inputs"
)
N_TIMES = 501  # of a run, at which the approximation of a function begins
FILE_PATTERN = re.compile(rf"(.+(?:{'|'.join(map(re.escape, ('.csv', *PARQUET_SUFFIXES)))}))(?::(.+))?", re.IGNORECASE)


def signals_of(values: Mapping[str, Any]) -> dict[str, Signal]:
    """Return the signal of every value by the name of its input; raises UserError."""
    if not isinstance(values, Mapping):
        raise UserError(f"inputs are {values!r}; allowed: values by the names of inputs")
    return {name: _signal(f"input {name!r}", value) for name, value in values.items()}


def _signal(what: str, value: Any) -> Signal:
    if isinstance(value, Signal) and value.variables():
        raise UserError(f"{what} is {short(value)}; allowed: {ALLOWED}")
    if isinstance(value, list | tuple | np.ndarray) and len(value) == 2 and all(np.ndim(part) == 1 for part in value):
        table = MeasuredTable(value[0], value[1], KIND_BY_USE)
        table.rows(what)  # refuses what is no table
        return table
    if not (isinstance(value, Signal | str) or callable(value) or is_finite(value)) or np.ndim(value):
        raise UserError(f"{what} is {short(value)}; allowed: {ALLOWED}")
    return signal_of(value, what)


def read_value(name: str, text: str, folder: Path = Path()) -> Any:
    """Return what the text after ``NAME=`` states: a number, a table of a file, or the text of an expression.

    A file has the suffix .csv, .parquet or .pq, and a path relative to ``folder``. The name of a column may follow
    after a colon. Without it the column with the name of the input is read, or the only one.
    """
    try:
        return float(text)
    except ValueError:
        match = FILE_PATTERN.fullmatch(text)
    if not match:
        return text
    try:
        found = read_column(folder / match[1], match[2] or "", default=name)
    except UserError as error:
        raise UserError(f"input {name!r}: {error}") from error
    return MeasuredTable(found.times, found.values, KIND_BY_USE, source=found.source, unit=found.unit)


def in_folder(value: Any, folder: Path) -> Any:
    """Return an entry of ``[inputs]`` whose path of a file is relative to the working directory, not to a folder."""
    return str(folder / value) if isinstance(value, str) and FILE_PATTERN.fullmatch(value) else value


def read_entry(name: str, value: Any, folder: Path) -> Any:
    """Return what an entry of ``[inputs]`` in a scene file states."""
    if isinstance(value, str):
        return read_value(name, value, folder)
    if isinstance(value, dict):
        if not {"times", "values"} <= value.keys() <= {"times", "values", "kind", "beyond"}:
            raise UserError(
                f"input {name!r} has {', '.join(map(repr, value)) or 'no entries'}; allowed: 'times' and 'values', and "
                "'kind' and 'beyond'. A name of an input that contains a point is written in quotes"
            )
        options = {key: one for key, one in value.items() if key in ("kind", "beyond")}
        return MeasuredTable(value["times"], value["values"], **{"kind": KIND_BY_USE} | options)
    return value


def entry_of(name: str, value: Signal) -> Any:
    """Return the entry of ``[inputs]`` that :func:`read_entry` reads; raises UserError if a file cannot contain it."""
    if isinstance(value, Table):
        points = {"times": np.asarray(value.x, float).tolist(), "values": np.asarray(value.y, float).tolist()}
        return points | ({"kind": value.kind} if value.kind != KIND_BY_USE else {}) | {"beyond": value.beyond}
    if isinstance(value, Function) and isinstance(value.law, str):
        return value.law
    if isinstance(value, Polynomial) and len(value.c) == 1:
        return float(value.c[0])
    raise UserError(
        f"input {name!r} is {short(value)}, which a scene file and an FMU that calls Python cannot contain; allowed: a "
        "number, an expression of t or a Table"
    )


def entry_text(name: str, value: Signal) -> str:
    """Return the value of a line of ``[inputs]`` in a scene file; raises UserError if a file cannot contain it."""
    own = entry_of(name, value)
    if isinstance(own, dict):
        return "{" + ", ".join(f"{key} = {json.dumps(one)}" for key, one in own.items()) + "}"
    return json.dumps(own)


def is_approximated(signal: Signal) -> TypeGuard[Function]:
    """Whether a signal is approximated over a run of known length: a function without the time in which it changes."""
    return isinstance(signal, Function) and signal.time == Function.time


def given_for(signals: Mapping[str, Signal]) -> GivenInputs | None:
    """Return the inputs that signals replace, for the compilation of a mechanism; None if there are none."""
    return GivenInputs(signals, {}, np.zeros(1), 1.0) if signals else None  # signals need no times and no tolerance


def compile_replaced(model: str, mechanism: Mechanism, signals: Mapping[str, Signal]) -> CompiledMechanism:
    """Return a compiled mechanism in which signals replace inputs.

    Raises
    ------
    UserError
        There is no such input, or no signal can replace it.
    """
    given = given_for(signals)
    compiled = CompiledMechanism(mechanism, given)
    if given is None:
        return compiled
    for name in given.unused:
        known = [variable.name for variable in compiled.inputs.variables]
        raise UserError(f"model {model!r} has no input {name!r}; allowed: {', '.join(known) or 'it has no inputs'}")
    for held in given.held:
        raise UserError(f"input {held.name!r} of model {model!r} cannot be replaced by a signal: {held.held}")
    return compiled


def check_end(signals: Mapping[str, Signal], stop_time: float) -> None:
    """Refuse tables that begin after the start or end before the end of a run, s; raises UserError."""
    for name, signal in signals.items():
        if isinstance(signal, Table) and signal.beyond == "linear":
            first, last = float(np.min(signal.x)), float(np.max(signal.x))
            if first > 0.0 or last < stop_time:
                raise UserError(
                    f"input {name!r} is given from {first:g} to {last:g} s, but the run is from 0 to {stop_time:g} s; "
                    "give a table for the whole run, or a stop time within the table"
                )


def check_run(model: Model, stop_time: float, tolerance: float) -> None:
    """Refuse signals that cannot replace inputs over a run with this end, s; raises UserError.

    They are tables that do not cover the run, and functions that move a joint and jump, or whose rates jump.
    """
    signals = model.replaced_inputs
    check_end(signals, stop_time)
    functions = {name: signal.law for name, signal in signals.items() if is_approximated(signal)}
    given = given_for(signals)
    if given is None or not functions:
        return
    model.compile(given)
    laws = {name: functions[name] for name in given.driving if name in functions}
    over_run = GivenInputs({**signals, **laws}, {}, np.linspace(0.0, stop_time, N_TIMES), tolerance)
    if laws:
        model.compile(over_run)
    for held in over_run.held:
        raise UserError(
            f"input {held.name!r}, which moves a joint, cannot be replaced by {short(laws.get(held.name))}: {held.held}"
            "; allowed: a motion whose rate does not jump. Give another function, or points in a file"
        )


def describe(signals: Mapping[str, Signal]) -> list[str]:
    """Return a line for every input that is replaced, for summaries."""
    return [f"input {name}: {_text(value)}" for name, value in signals.items()]


def _text(value: Signal) -> str:
    if isinstance(value, Table):
        what = value.source if isinstance(value, MeasuredTable) and value.source else "table"
        return f"{what}, {len(value.x)} points from {np.min(value.x):g} to {np.max(value.x):g} s"
    if isinstance(value, Function) and isinstance(value.law, str):
        return value.law
    return f"{value.c[0]:g}" if isinstance(value, Polynomial) and len(value.c) == 1 else type(value).__name__
