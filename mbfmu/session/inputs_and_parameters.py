"""Inputs and tunable parameters of a run, which change at the time reached."""

from __future__ import annotations

from collections.abc import Hashable
from math import nan
from typing import Any

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.arrays.given_inputs import GivenInputs
from mbfmu.mechanics.numbers import finite
from mbfmu.modeling.model import Model
from mbfmu.util.diagnostics import Diagnosed
from mbfmu.util.errors import UserError, short

from .events import RunEvents
from .stepper_run import SEQUENCE, StepperRun


class InputsAndParameters(Diagnosed):
    """Base of :class:`.Simulation`: inputs and tunable parameters."""

    model: Model
    compiled: CompiledMechanism
    _given_inputs: GivenInputs | None
    _inputs: dict[Hashable, int]  # numbers of the inputs by name and number
    _run: StepperRun
    _events: RunEvents | None

    def _input(self, key: int | str) -> int:
        """Return the number of an input."""
        index = self._inputs.get(key) if isinstance(key, Hashable) else None
        if index is None:
            if self._given_inputs and key in self._given_inputs.replaced:
                raise UserError(
                    f"input {key!r} is given for the whole run, as a function of time or by points; it cannot be set "
                    "during the run"
                )
            names = ", ".join(repr(name) for name in self._inputs if isinstance(name, str))
            raise UserError(f"there is no input {key!r}; this model has {names or 'none'}")
        return index

    def set_input(self, key: int | str, value: float, rate: float | None = None) -> None:
        """Set an input at the time reached.

        The input of a load is held or extrapolated from this time on, according to the settings. The input of a driven
        joint is its position or rate at the time reached. During the next communication step the joint moves to the
        position that is extrapolated to the end of this step, see :mod:`mbfmu.mechanics.arrays.support_motion`.

        Parameters
        ----------
        key
            Name or number of the input.
        value
            Value in the unit of the input.
        rate
            Time derivative of the input, in its unit per second, with which it continues until it is set again. None:
            it is held or extrapolated.

        Raises
        ------
        UserError
            There is no such input, it is given for the whole run, or a number is not finite. A rate is given for a
            component of gravity, or for an input that has another input as its rate or is that one.
        """
        index, inputs = self._input(key), self.compiled.inputs
        if rate is not None and not inputs.takes_rate(index):
            raise UserError(
                f"a rate was given for input {key!r}, which is a component of gravity, or has an input for its rate or "
                "is that input; set the input of the rate instead, or only the value"
            )
        given = nan if rate is None else finite(f"rate of input {key!r}", rate)
        SEQUENCE.set_input(self._run, index, inputs.checked(index, value), given)

    def retune(self, model: Model) -> None:
        """Change tunable parameters at the time reached.

        Parameters
        ----------
        model
            Model of the same class, with the new values.

        Raises
        ------
        UserError
            A parameter that is not tunable differs, or the structure would change.
        """
        if type(model) is not type(self.model):
            raise UserError(f"the model with new parameters is {short(model)}; allowed: a {type(self.model).__name__}")
        compiled = self._compile_tuned(model)
        SEQUENCE.note_energy(self._run)
        self._adopt_compiled(compiled)
        SEQUENCE.retune(self._run)
        self.model = model

    def _compile_tuned(self, model: Model) -> CompiledMechanism:
        """Return the compiled mechanism of a model that differs from the present one in tunable parameters alone."""
        for p in model.parameters():
            before, after = getattr(self.model, p.name), getattr(model, p.name)
            if before != after and not (p.varies(before) and p.varies(after)):
                why = f", from {before!r} to {after!r}" if p.tunable else ": it is not tunable"
                raise UserError(f"parameter {p.name!r} cannot change during a run{why}")
        return model.compile(self._given_inputs)

    def _adopt_compiled(self, compiled: CompiledMechanism) -> None:
        """Take the numbers of a compiled mechanism of the same structure, those of its events included."""
        if self._events:
            self._events.adopt(compiled.mechanism)
        self.compiled.adopt(compiled)

    def _set_parameter(self, name: str, value: Any) -> None:
        """Set a parameter at the time reached."""
        self.retune(self.model.with_values({name: value}))
