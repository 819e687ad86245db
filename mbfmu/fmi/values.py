"""The values of an FMU as a host reads and sets them, and what it gave that was not taken."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from enum import Enum
from math import isfinite, nan
from typing import Any, ClassVar

import numpy as np
from pythonfmu import Boolean, Fmi2Causality, Fmi2Variability, Real
from pythonfmu import Integer as FmiInteger
from pythonfmu import String as FmiString
from pythonfmu.enums import Fmi2Status

from mbfmu.errors import UserError
from mbfmu.mechanics import Plant
from mbfmu.model import check
from mbfmu.simulation import Settings

from .interface import Interface

Phase = Enum("Phase", ["INSTANTIATED", "INITIALIZING", "RUNNING", "FAILED", "TERMINATED"])


def guarded(callback: Callable[..., Any]) -> Callable[..., Any]:
    """Let no exception escape a callback; :meth:`Values.fail` is told."""

    @functools.wraps(callback)
    def safe(self: Values, *args: Any) -> Any:
        try:
            return callback(self, *args)
        except Exception as error:
            self.fail(in_words(error))
            return False

    return safe


def in_words(error: Exception) -> str:
    """Return the sentence of an error of the user's, else its kind too."""
    return str(error) if isinstance(error, UserError) else f"{type(error).__name__}: {error}"


class Values(Interface):
    """Reads and sets variables by value reference, in the phase of its life that an instance is in.

    What is refused is logged, keeps the value as it was, and is kept for the next step to fail by.
    """

    identifier: ClassVar[str] = "model"

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._phase = Phase.INSTANTIATED
        self._refused: dict[str, str] = {}  # what was given last and not taken -> why
        self._mistakes: list[str] = []  # of the host, since the last step
        self._changed: set[int] = set()  # value references of inputs and parameters set since the last step
        self._fresh = False  # outputs are those of the present state

    def register(self, plant: Plant) -> None:
        """Declare every variable."""
        super().register(plant)
        variables = self.vars.values()
        self._are_real = np.array([isinstance(v, Real) for v in variables])
        self._are_outputs = np.array([v.causality == Fmi2Causality.output for v in variables])

    # ---- reading ------------------------------------------------------------------------------------------------

    def get_real(self, vrs: list[int]) -> list[float]:
        """Return real values; outputs are evaluated once a step, when first asked for."""
        if not vrs or min(vrs) < 0 or max(vrs) >= len(self._buffer) or not self._are_real[vrs].all():
            return [self.get_real([r])[0] if self._known(r, Real) else nan for r in vrs]
        if not self._fresh and self._are_outputs[vrs].any():
            self._refresh()
        values: list[float] = self._buffer[vrs].tolist()
        return values

    def get_integer(self, vrs: list[int]) -> list[int]:
        """Return whole numbers."""
        return [int(self.vars[r].getter()) if self._known(r, FmiInteger) else 0 for r in vrs]

    def get_boolean(self, vrs: list[int]) -> list[bool]:
        """Return truth values."""
        return [bool(self.vars[r].getter()) if self._known(r, Boolean) else False for r in vrs]

    def get_string(self, vrs: list[int]) -> list[str]:
        """Return texts."""
        return [str(self.vars[r].getter()) if self._known(r, FmiString) else "" for r in vrs]

    def _known(self, reference: int, kind: Any) -> bool:
        """Whether there is such a variable; else that is the host's mistake."""
        variable = self.vars.get(reference)
        if isinstance(variable, kind):
            return True
        what = f"{variable.name!r}, a {type(variable).__name__.removeprefix('Quantity')}" if variable else "no variable"
        self._mistake(f"value reference {reference} is {what}; it was used as that of a {kind.__name__}")
        return False

    def _refresh(self) -> None:
        """Fill in the outputs; not numbers where they are not known."""
        raise NotImplementedError

    # ---- setting ------------------------------------------------------------------------------------------------

    def set_real(self, vrs: list[int], values: list[float]) -> None:
        """Take real values; one that is refused fails the next step unless it is given anew."""
        self._set(Real, vrs, values)

    def set_integer(self, vrs: list[int], values: list[int]) -> None:
        """Take whole numbers, likewise."""
        self._set(FmiInteger, vrs, values)

    def set_boolean(self, vrs: list[int], values: list[bool]) -> None:
        """Take truth values, likewise."""
        self._set(Boolean, vrs, values)

    def set_string(self, vrs: list[int], values: list[str]) -> None:
        """Take texts, likewise."""
        self._set(FmiString, vrs, values)

    @guarded
    def _set(self, kind: Any, vrs: list[int], values: list[Any]) -> None:
        for reference, value in zip(vrs, values, strict=True):
            if self._known(reference, kind):
                locked = self._locked(self.vars[reference])
                if locked:
                    self._mistake(f"{self.vars[reference].name!r} was set to {value!r}, but {locked}")
                else:
                    self.vars[reference].setter(value)

    def _locked(self, variable: Any) -> str:
        """Why a variable cannot be set now; empty: it can."""
        if variable.causality == Fmi2Causality.output:
            return "it is an output"
        if variable.variability == Fmi2Variability.constant:
            return "it is fixed since the export"
        if self._phase is Phase.TERMINATED:
            return "the FMU is terminated"
        beginning = self._phase in (Phase.INSTANTIATED, Phase.INITIALIZING)
        if variable.variability == Fmi2Variability.fixed and not beginning:
            return "it is fixed since the initialization"
        return ""

    def _take(self, reference: int, value: float) -> None:
        name = self.vars[reference].name
        why = self._wrong(reference, name, value)
        if why:
            self._refuse(name, why)
            return
        self._refused.pop(name, None)
        same = self._buffer[reference] == value and reference not in self._motions  # a support may have moved since
        if not same or self._phase is not Phase.RUNNING:
            self._buffer[reference] = value
            self._changed.add(reference)
            self._fresh = False

    def _wrong(self, reference: int, name: str, value: float) -> str:
        """What is wrong with a value; empty: nothing."""
        if not isfinite(value):
            return f"{name!r} was set to {value!r}; allowed: a finite number"
        try:
            if reference in self._parameters:
                declared = self._parameters[reference]
                check(self.model.name, declared, bool(value) if isinstance(declared.default, bool) else value)
            elif reference in self._settings.values():
                key = next(k for k, r in self._settings.items() if r == reference)
                given: dict[str, Any] = {key: type(getattr(self.settings, key))(value)}
                Settings(**given)
        except UserError as error:
            return str(error)
        return ""

    def _take_text(self, name: str, value: str) -> None:
        given: dict[str, Any] = {name: value}
        try:
            Settings(**given)
        except UserError as error:
            self._refuse(name, str(error))
            return
        self._refused.pop(name, None)
        self._texts[name] = value
        self._fresh = False

    def _refuse(self, what: str, why: str) -> None:
        """Note what was given and not taken: no step is made until it is given right."""
        self._refused[what] = why
        self._report(why)

    def _mistake(self, text: str) -> None:
        """Note what the host did wrong: the next step is discarded for it."""
        self._mistakes.append(text)
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

    def _warn(self, text: str) -> None:
        self.log(text, Fmi2Status.warning, "logStatusWarning")
