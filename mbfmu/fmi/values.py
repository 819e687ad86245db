"""The values of an FMU as a host reads and sets them, and what it gave that was not taken."""

from __future__ import annotations

import functools
import sys
from collections import Counter
from collections.abc import Callable
from enum import Enum
from math import isfinite, nan
from typing import Any, ClassVar

import numpy as np
from pythonfmu import Fmi2Slave
from pythonfmu.enums import Fmi2Status

from mbfmu.mechanics import CompiledMechanism
from mbfmu.modeling.model import Model
from mbfmu.modeling.settings import Settings, check_setting
from mbfmu.modeling.variables import Role, ScalarVariable, Type, list_variables
from mbfmu.session.simulation import Simulation
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import UserError

Phase = Enum("Phase", ["INSTANTIATED", "INITIALIZING", "RUNNING", "FAILED", "TERMINATED"])

INTEGER_TYPES = (Type.INTEGER, Type.ENUMERATION)  # what is read and set as a whole number


def guarded(callback: Callable[..., Any]) -> Callable[..., Any]:
    """Let no exception escape a callback; :meth:`Values.fail` receives it."""

    @functools.wraps(callback)
    def safe(self: Values, *args: Any) -> Any:
        try:
            return callback(self, *args)
        except Exception as error:
            self.fail(error_text(error))
            return False

    return safe


def error_text(error: Exception) -> str:
    """Return the sentence of an error of the user's, else its kind too."""
    return str(error) if isinstance(error, UserError) else f"{type(error).__name__}: {error}"


class Values(Fmi2Slave):  # type: ignore[misc]
    """Reads and sets variables by value reference, in the phase of its life that an instance is in.

    All numbers live in one buffer; a value reference is a place in it and in ``variables``. What is refused is logged,
    keeps the value as it was, and is kept for the next step to fail by.
    """

    model: ClassVar[Model]
    settings: ClassVar[Settings] = Settings()
    identifier: ClassVar[str] = "model"

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.simulation: Simulation | None = None
        self.message = ""
        self._phase = Phase.INSTANTIATED
        self._rejected: dict[str, str] = {}  # what was given last and not taken -> why
        self._protocol_errors: Counter[str] = Counter()  # of the host, since the last step
        self._changed_references: set[int] = set()  # value references of inputs and parameters set since the last step
        self._outputs_valid = False  # outputs are those of the present state

    def declare(self, compiled: CompiledMechanism) -> None:
        """Make the list of variables and give each its start value."""
        self.variables = list_variables(self.model, self.settings, compiled)
        self._buffer = np.array([nan if v.start is None else float(v.start) for v in self.variables])
        self._are_real = np.array([v.type is Type.REAL for v in self.variables])
        self._are_outputs = np.array([v.role is Role.OUTPUT for v in self.variables])
        self._outputs = np.flatnonzero(self._are_outputs)
        self._inputs = self._references(Role.INPUT)
        self._settings = {self.variables[r].name: r for r in self._references(Role.SETTING)}
        free = [r for r in self._references(Role.PARAMETER) if self.variables[r].settable]
        self._parameters = {r: self.variables[r].name for r in free}

    def _references(self, role: Role) -> list[int]:
        return [r for r, v in enumerate(self.variables) if v.role is role]

    # ---- reading ------------------------------------------------------------------------------------------------

    def get_real(self, vrs: list[int]) -> list[float]:
        """Return real values; outputs are evaluated once per step, at the first request."""
        if not vrs or min(vrs) < 0 or max(vrs) >= len(self._buffer) or not self._are_real[vrs].all():
            return [self.get_real([r])[0] if self._known(r, Type.REAL) else nan for r in vrs]
        if not self._outputs_valid and self._are_outputs[vrs].any():
            self._refresh()
        values: list[float] = self._buffer[vrs].tolist()
        return values

    def get_integer(self, vrs: list[int]) -> list[int]:
        """Return whole numbers, those of choices among them."""
        return [self._whole(r) if self._known(r, *INTEGER_TYPES) else 0 for r in vrs]

    def _whole(self, reference: int) -> int:
        v = self.variables[reference]
        if v.role is not Role.COUNTER:
            return int(self._buffer[reference])
        return int(getattr(self.simulation.statistics, v.name.removeprefix("solver."))) if self.simulation else 0

    def get_boolean(self, vrs: list[int]) -> list[bool]:
        """Return truth values."""
        return [bool(self._buffer[r]) if self._known(r, Type.BOOLEAN) else False for r in vrs]

    def get_string(self, vrs: list[int]) -> list[str]:
        """Return texts; the solver's message is the only one."""
        return [self.message if self._known(r, Type.STRING) else "" for r in vrs]

    def _known(self, reference: int, *kinds: Type) -> bool:
        """Whether there is such a variable; else that is the host's mistake."""
        there = 0 <= reference < len(self.variables)
        if there and self.variables[reference].type in kinds:
            return True
        v = self.variables[reference] if there else None
        what = f"{v.name!r} of type {v.type.value}" if v else "not a variable of this FMU"
        self._report_protocol_error(
            f"value reference {reference} is {what}, but it was accessed as type {kinds[0].value}"
        )
        return False

    def _refresh(self) -> None:
        """Fill in the outputs; not numbers where they are not known."""
        raise NotImplementedError

    # ---- setting ------------------------------------------------------------------------------------------------

    def set_real(self, vrs: list[int], values: list[float]) -> None:
        """Set real values; one that is refused fails the next step unless it is set again."""
        self._set((Type.REAL,), vrs, values)

    def set_integer(self, vrs: list[int], values: list[int]) -> None:
        """Set integer values, see :meth:`set_real`."""
        self._set(INTEGER_TYPES, vrs, values)

    def set_boolean(self, vrs: list[int], values: list[bool]) -> None:
        """Set Boolean values, see :meth:`set_real`."""
        self._set((Type.BOOLEAN,), vrs, values)

    def set_string(self, vrs: list[int], values: list[str]) -> None:
        """Take no text: none of the variables is one that can be set."""
        self._set((Type.STRING,), vrs, values)

    @guarded
    def _set(self, kinds: tuple[Type, ...], vrs: list[int], values: list[Any]) -> None:
        for reference, value in zip(vrs, values, strict=True):
            if not self._known(reference, *kinds):
                continue
            v = self.variables[reference]
            if locked := self._describe_locked(v):
                self._report_protocol_error(f"{v.name!r} was set to {value!r}, but {locked}")
            elif wrong := self._describe_invalid(v, value):
                self._reject_value(v.name, wrong)
            else:
                self._rejected.pop(v.name, None)
                self._store_value(reference, value)

    def _describe_locked(self, v: ScalarVariable) -> str:
        """Why a variable cannot be set now; empty: it can."""
        if v.role is Role.OUTPUT:
            return "it is an output"
        if v.role in (Role.COUNTER, Role.MESSAGE):
            return "it is an output of the solver"
        if v.variability == "constant":
            return "it is a constant in this FMU; export the FMU again to change it"
        if self._phase is Phase.TERMINATED:
            return "the FMU is terminated; reset it first"
        if v.variability == "fixed" and self._phase not in (Phase.INSTANTIATED, Phase.INITIALIZING):
            return "it can be changed only before the end of the initialization"
        return ""

    def _describe_invalid(self, v: ScalarVariable, value: float) -> str:
        """What is wrong with a value; empty: nothing."""
        if not isfinite(value):
            return f"{v.name!r} was set to {value!r}; allowed: a finite number"
        if v.choices and value not in v.choices:
            allowed = ", ".join(f"{i} ({word})" for i, word in v.choices.items())
            return f"{v.name!r} was set to {value!r}; allowed: {allowed}"
        given = v.value_of(value)
        try:
            if v.role is Role.PARAMETER:
                self.model.with_values({v.name: given})
            elif v.role is Role.SETTING:  # whether it suits the other settings is checked when all are set
                check_setting(v.name, given)
        except UserError as error:
            return str(error)
        return ""

    def _store_value(self, reference: int, value: float) -> None:
        matters = self._buffer[reference] != value or self.variables[reference].role is Role.INPUT
        if matters or self._phase is not Phase.RUNNING:
            self._buffer[reference] = value
            self._changed_references.add(reference)
            self._outputs_valid = False

    def _reject_value(self, what: str, why: str) -> None:
        """Note a value that is not allowed: no step is made until an allowed one is set."""
        why = str(Diagnostic.parse(why, "error", "fmi-call"))
        self._rejected[what] = why
        self._report(why)

    def _report_protocol_error(self, text: str) -> None:
        """Note a wrong call of the importing tool: the next step is discarded for it."""
        text = str(Diagnostic.parse(text, "error", "fmi-call"))
        self._protocol_errors[text] += 1
        if self._protocol_errors[text] == 1:
            self._report(text)

    # ---- telling ------------------------------------------------------------------------------------------------

    def fail(self, reason: str) -> None:
        """Keep the reason where a host can read it."""
        self.message = reason
        self._report(reason)

    def _report(self, text: str) -> None:
        self._print(text)
        self.log(text, Fmi2Status.error, "logStatusError")

    def _print(self, text: str) -> None:
        print(f"{self.identifier} ({self.instance_name}): {text}", file=sys.stderr)  # noqa: T201
