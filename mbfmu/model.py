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

import sys
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import Field, dataclass, field, fields, replace
from functools import cache
from importlib.metadata import entry_points
from math import inf, isfinite
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from mbfmu.errors import UserError, require_arguments, suggest
from mbfmu.mechanics import Mechanism, Plant
from mbfmu.mechanics.arrays.given import Courses
from mbfmu.modules import load_module

GROUP = "mbfmu.models"
LARGEST = 2**31 - 1  # of a whole number in an FMU
OWN = (
    "name",
    "stop_time",
    "output_interval",
    "settling",
    "viewing",
    "effects",
    "arrays",
    "terminals",
    "default_solver",
)  # attributes of a model


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
    resolution: tuple[float, ...]

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
        Allowed words; such a parameter is structural.
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
    about |= {"tunable": tunable, "optional": optional}
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
        if p.name in OWN or (p.name == "tolerance" and issubclass(cls, Model)):
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
            if isfinite(value) and not (value == int(value) and abs(value) <= LARGEST):
                raise UserError(f"{what}: {name} is {value!r}; allowed: a whole number, at most {LARGEST}")


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

    def plant(self, courses: Courses | None = None) -> Plant:
        """Return the compiled mechanism; raises the errors of :meth:`built`.

        Parameters
        ----------
        courses
            Inputs given for the whole run, see :mod:`mbfmu.mechanics.arrays.given`.
        """
        return Plant(self.built(), courses)

    def arrays(self) -> Mapping[str, Sequence[Any]]:
        """Return outputs that are one array in FMI 3: nested lists of their names, by the name of the array."""
        return {}

    def terminals(self) -> Mapping[str, Sequence[str]]:
        """Return the terminals of FMI 3: names of inputs and outputs along one joint coordinate, by the name of the
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

    @classmethod
    def title(cls) -> str:
        """Return the first line of the docstring."""
        return ((cls.__doc__ or "").strip() or cls.name).splitlines()[0]

    def _hint(self, name: str) -> str:
        """Return what a name is instead of a parameter, as the end of a message."""
        known = [p.name for p in self.parameters()]
        if name in (variable.name for variable in self.plant().inputs.variables):
            return (
                "; it is an input. Set its value by Input(start=...) in the model, or simulate with "
                f"mb.simulate(model, inputs={{{name!r}: ...}})"
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
        return replace(self, **changes)


@dataclass(frozen=True, kw_only=True)
class Bare(Model):
    """A mechanism without parameters, as it is."""

    name = "mechanism"
    mechanism: Mechanism

    def build(self) -> Mechanism:
        """Return it."""
        return self.mechanism


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
        return ", ".join(map(repr, declared.choices))
    if isinstance(declared.default, bool):
        return "true or false"
    unit = "" if declared.unit == "1" else f" {declared.unit}"
    kind = "whole numbers, " if isinstance(declared.default, int) else ""
    if declared.min == -inf:
        return f"{kind}any finite number" if declared.max == inf else f"{kind}at most {declared.max:g}{unit}"
    if declared.max == inf:
        return f"{kind}at least {declared.min:g}{unit}"
    return f"{kind}{declared.min:g} to {declared.max:g}{unit}"


def of_user(model: Any) -> Model:
    """Return what was given for a model, if it is one."""
    if isinstance(model, Model):
        return model
    if isinstance(model, Mechanism):
        return Bare(mechanism=model)
    if isinstance(model, type) and issubclass(model, Model):
        raise UserError(f"model is the class {model.__name__}; give an instance of it: {model.__name__}()")
    raise UserError(f"model is {model!r}; allowed: a Mechanism, or an instance of a subclass of mbfmu.Model")


def models() -> dict[str, type[Model]]:
    """Return all models registered under the entry-point group ``mbfmu.models``.

    Returns
    -------
    dict[str, type[Model]]
        Classes of the models, by name.
    """
    found = {}
    for point in entry_points(group=GROUP):
        found[point.name] = _model_class(point.load(), f"entry point {point.name!r}")
    return found


def find(reference: str) -> type[Model]:
    """Return the model of a registered name or of a Python file.

    Parameters
    ----------
    reference
        Name of a registered model, or path of a Python file and class: ``path/to/file.py:Class``; the class may be
        left out if the file has one model.

    Returns
    -------
    type[Model]
        Class of the model; ``find("fourbar")(crank_mass=2.0)`` is a model.

    Raises
    ------
    UserError
        No such model, file or class.
    """
    if ".py" in reference:
        path, _, name = reference.rpartition(":") if ".py:" in reference else (reference, "", "")
        return load(Path(path), name)
    points = {point.name: point for point in entry_points(group=GROUP)}
    if reference not in points:
        raise UserError(
            f"unknown model {reference!r}{suggest(reference, points)} (or name a file: my_model.py:MyModel)"
        )
    return _model_class(points[reference].load(), f"entry point {reference!r}")


def at_defaults(cls: type[Model]) -> Model:
    """Return the model with the defaults of all its parameters."""
    declared(cls)  # type: ignore[arg-type]  # reports errors of the declaration first
    try:
        return cls()
    except TypeError as error:
        raise UserError(
            f"model {cls.__name__} has a parameter without default: {error}; give each parameter a default"
        ) from error


def load(path: Path, name: str = "") -> type[Model]:
    """Return a model class from a file; ``name`` may be left out where the file has one model."""
    try:
        there = path.is_file()
    except OSError:  # no name of a file
        there = False
    if not there:
        raise UserError(f"model file {str(path)!r} does not exist")
    module = load_module(path)
    own = {
        k: v
        for k, v in vars(module).items()
        if isinstance(v, type) and issubclass(v, Model) and v.__module__ == module.__name__
    }
    if not name and len(own) == 1:
        return next(iter(own.values()))
    if name not in own:
        raise UserError(f"{str(path)!r} has no model {name!r}; it has: {', '.join(own) or 'none'}")
    return own[name]


def _model_class(found: Any, what: str) -> type[Model]:
    if not (isinstance(found, type) and issubclass(found, Model)):
        raise UserError(f"{what} is {found!r}, which is not a subclass of mbfmu.model.Model")
    return found
