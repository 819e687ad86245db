"""What a model is: a frozen dataclass of parameters whose ``build`` makes a mechanism.

>>> from dataclasses import dataclass
>>> from mbfmu.mechanics import Mechanism, Revolute, rod
>>> @dataclass(frozen=True, kw_only=True)
... class Pendulum(Model):
...     '''A swinging rod.'''
...     length: float = parameter(1.0, unit="m", min=1e-3, doc="length of the rod")
...     def build(self):
...         m = Mechanism(gravity=(0, -9.81, 0))
...         bar = m.body("bar", m.ground, Revolute(), **rod(mass=1.0, length=self.length))
...         m.output("bar.angle", bar.angle(), "angle from the horizontal")
...         return m
>>> Pendulum(length=2.0).build().outputs[0][0]
'bar.angle'
"""

from __future__ import annotations

import traceback
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import CompiledMechanism, Mechanism
from mbfmu.mechanics.arrays.given_inputs import GivenInputs
from mbfmu.mechanics.signals import Signal
from mbfmu.util.errors import RENAMED, UserError, missing_attribute, require_arguments, suggest

from .parameters import Parameter, check, declared, read_text
from .replaced_inputs import compile_replaced, signals_of


@dataclass(frozen=True, kw_only=True)
class Model:
    """Base class of all models. Subclass it as a frozen dataclass, declare parameters, and write :meth:`build`.

    Parameters
    ----------
    **given
        Values of parameters by name; others keep their defaults.

    Attributes
    ----------
    name
        Name on the command line and of the FMU; by default that of the class in lower case.
    stop_time, output_interval
        Stop time and output interval of the default experiment, s.
    tolerance, default_solver
        Tolerance and solver of the default experiment.
    settling
        Parameters that damp the motion, with which a comparison simulates until the steady state is reached.
    viewing
        Parameters that ``mbfmu view`` sets by default.
    effects
        By name of an optional effect, the parameters that turn it on; zero turns it off.
    reserved
        Names that no parameter may have.
    replaced_inputs
        Signals by the names of the inputs that they replace, see :meth:`with_inputs`.

    Raises
    ------
    UserError
        There is no such parameter, a value is not allowed, or the class is not a dataclass.
    """

    name: ClassVar[str] = ""
    stop_time: ClassVar[float] = 10.0
    output_interval: ClassVar[float] = 0.01
    tolerance: ClassVar[float] = 1e-6
    default_solver: ClassVar[str] = "ida"
    settling: ClassVar[Mapping[str, float]] = MappingProxyType({})
    viewing: ClassVar[Mapping[str, Any]] = MappingProxyType({})
    effects: ClassVar[Mapping[str, Mapping[str, float]]] = MappingProxyType({})
    reserved: ClassVar[tuple[str, ...]] = (
        "name",
        "stop_time",
        "output_interval",
        "tolerance",
        "default_solver",
        "settling",
        "viewing",
        "effects",
        "arrays",
        "terminals",
        "replaced_inputs",
    )
    replaced_inputs: ClassVar[Mapping[str, Signal]] = MappingProxyType({})

    def __new__(cls, *_: Any, **given: Any) -> Self:
        """Check that the class is a dataclass, and the names of the parameters; raises UserError."""
        declared(cls)  # type: ignore[arg-type]  # classes are hashable
        require_arguments(cls, given)
        return super().__new__(cls)

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if not cls.__dict__.get("name"):
            cls.name = cls.__name__.lower()
        if not isinstance(cls.name, str | Field):
            raise UserError(f"name of model {cls.__name__} is {cls.name!r}; allowed: text")

    def __post_init__(self) -> None:
        """Check every parameter; raises UserError naming it, its value and what is allowed."""
        for p in self.parameters():
            object.__setattr__(self, p.name, check(self.name, p, getattr(self, p.name)))

    if not TYPE_CHECKING:  # static checkers shall find misspelled names

        def __getattr__(self, name: str) -> Any:
            if name in RENAMED:
                raise missing_attribute("a Model", name)
            return object.__getattribute__(self, name)  # raises the error of Python or of a property of a model

    def build(self) -> Mechanism:
        """Return the mechanism for these parameters."""
        raise UserError(f"model {self.name!r} has no method build(); write one that returns a Mechanism")

    def built(self) -> Mechanism:
        """Return the mechanism that ``build`` returns.

        Raises
        ------
        UserError
            ``build`` fails, or does not return a mechanism.
        """
        try:
            mechanism = self.build()
        except UserError:
            raise
        except Exception as error:
            at = traceback.extract_tb(error.__traceback__)[-1]
            raise UserError(
                f"model {self.name!r}: build() fails with {type(error).__name__}: {error} "
                f"({Path(at.filename).name}, line {at.lineno})"
            ) from error
        if not isinstance(mechanism, Mechanism):
            raise UserError(f"model {self.name!r}: build() returns {mechanism!r}; it must return a Mechanism")
        return mechanism

    def compile(self, given_inputs: GivenInputs | None = None) -> CompiledMechanism:
        """Return the compiled mechanism; raises the errors of :meth:`built`.

        Parameters
        ----------
        given_inputs
            Inputs given for the whole run, see :mod:`mbfmu.mechanics.arrays.given_inputs`.
        """
        if self.replaced_inputs and given_inputs is None:
            return compile_replaced(self.name, self.built(), self.replaced_inputs)
        return CompiledMechanism(self.built(), given_inputs)

    def arrays(self) -> Mapping[str, Sequence[Any]]:
        """Return outputs that are one array in FMI 3: nested lists of their names, by the name of the array."""
        return {}

    def terminals(self) -> Mapping[str, Sequence[str]]:
        """Return the terminals of the FMU: names of inputs and outputs along one joint coordinate, by the name of the
        terminal. Their units identify them: position (rad, m), rate (rad/s, m/s), torque (N.m) or force (N) on it.
        """
        return {}

    def exact(self, times: NDArray[np.float64]) -> dict[str, NDArray[np.float64]] | None:
        """Return outputs whose exact motion is known, as a reference of comparisons.

        Parameters
        ----------
        times
            Times (k,), s.

        Returns
        -------
        dict[str, Array] or None
            Exact outputs (k,) by name; None: none is known.
        """
        return None

    def independent(self, times: NDArray[np.float64]) -> dict[str, tuple[NDArray[np.float64], float]] | None:
        """Return outputs from another code or an experiment, as a reference of comparisons.

        Parameters
        ----------
        times
            Times (k,), s.

        Returns
        -------
        dict[str, tuple[Array, float]] or None
            Outputs (k,) and their uncertainty, in their unit, by name; None: there is no such reference.
        """
        return None

    def exact_equilibrium(self) -> dict[str, float] | None:
        """Return outputs whose value in the steady state is known, by name; None: none is."""
        return None

    def branch_gap(self, outputs: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64] | None:
        """Return the distance from the correct branch of the motion.

        Parameters
        ----------
        outputs
            Outputs (k,) of a run, by name.

        Returns
        -------
        Array or None
            Distance (k,), zero on the correct branch; None: the motion has no other branch.
        """
        return None

    @classmethod
    def parameters(cls) -> tuple[Parameter, ...]:
        """Return the declared parameters in order."""
        return declared(cls)  # type: ignore[arg-type]  # classes are hashable

    def other_values(self) -> dict[str, int | float | str]:
        """Return the numbers and texts of the fields that are no parameters, by name."""
        values = {own.name: getattr(self, own.name) for own in fields(self) if not own.metadata}
        return {name: value for name, value in values.items() if isinstance(value, int | float | str)}

    def require_parameters(self, where: str) -> None:
        """Refuse fields that are no parameters and do not have their defaults, if they have one.

        Parameters
        ----------
        where
            What would not contain their values, such as an FMU.

        Raises
        ------
        UserError
            There is one.
        """
        for own in fields(self):
            value = getattr(self, own.name)
            if own.metadata or not own.init or value is own.default:
                continue
            default = own.default if own.default_factory is MISSING else own.default_factory()
            if default is not MISSING and repr(value) != repr(default):
                raise UserError(
                    f"field {own.name!r} of model {self.name!r} is {value!r}, and no parameter: {where} would contain "
                    f"its default instead. Declare it as a parameter, such as `{own.name}: float = "
                    "mb.parameter(1.0)`, or make the value the default of a class derived from this one"
                )

    @classmethod
    def title(cls) -> str:
        """Return the first line of the docstring."""
        return ((cls.__doc__ or "").strip() or cls.name).splitlines()[0]

    def _hint(self, name: str) -> str:
        """Return what a name is instead of a parameter, as the end of a message."""
        known = [p.name for p in self.parameters()]
        if name in (variable.name for variable in self.compile().inputs.variables):
            return (
                "; it is an input. Set its value by Input(start=...) in the model, or simulate with "
                f"mb.simulate(model, inputs={{{name!r}: ...}})"
            )
        if not known:
            return (
                ": it has no parameters. Declare one in a class derived from mbfmu.Model, and build the mechanism from "
                "it in build()"
            )
        return suggest(name, known)

    def with_values(self, values: Mapping[str, Any]) -> Self:
        """Return a copy with other parameter values.

        Parameters
        ----------
        values
            Values by parameter name; text is read as a number, a Boolean or a choice.

        Raises
        ------
        UserError
            There is no such parameter, or the value is not allowed.
        """
        known = {p.name: p for p in self.parameters()}
        changes = {}
        for name, value in values.items():
            if name not in known:
                raise UserError(f"model {self.name!r} has no parameter {name!r}{self._hint(name)}")
            changes[name] = read_text(known[name], value) if isinstance(value, str) else value
        return replace(self, **changes)._keeping(self.replaced_inputs)

    def with_inputs(self, values: Mapping[str, Any]) -> Self:
        """Return a copy in which inputs are replaced by signals, for example to check a car on a road.

        Parameters
        ----------
        values
            Values by the names of inputs: a number, an expression of the time t (s), a function of time, a pair (times,
            values) of arrays, a :class:`.Table` or another signal. They are added to those of the model.

        Raises
        ------
        UserError
            There is no such input, or the value is not allowed.
        """
        changed = self.with_values({})._keeping({**self.replaced_inputs, **signals_of(values)})
        changed.compile()  # refuses names that are no inputs
        return changed

    def _keeping(self, signals: Mapping[str, Signal]) -> Self:
        """Return this copy with signals in place of inputs."""
        if signals:
            object.__setattr__(self, "replaced_inputs", dict(signals))
        return self


@dataclass(frozen=True, kw_only=True)
class MechanismModel(Model):
    """A mechanism without parameters, as it is."""

    name = "mechanism"
    mechanism: Mechanism

    def build(self) -> Mechanism:
        """Return it."""
        return self.mechanism


def as_model(model: Any) -> Model:
    """Return what was given for a model, if it is one."""
    if isinstance(model, Model):
        return model
    if isinstance(model, Mechanism):
        return MechanismModel(mechanism=model)
    if isinstance(model, type) and issubclass(model, Model):
        raise UserError(f"model is the class {model.__name__}; give an instance of it: {model.__name__}()")
    raise UserError(f"model is {model!r}; allowed: a Mechanism, or an instance of a subclass of mbfmu.Model")
