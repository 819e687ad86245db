"""List of the variables of a running model: values that an importing tool sets and reads, and their attributes.

The FMU, its model description, its documentation page and ``mbfmu models`` are written from this list. A variable's
place in it is its value reference.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from math import inf
from typing import Any

import numpy as np

from mbfmu import mechanics
from mbfmu.mechanics import CompiledMechanism, Variable
from mbfmu.util.errors import UserError
from mbfmu.util.units import read_unit

from .model import Model
from .parameters import Parameter, declared, span
from .settings import Settings

COUNTERS = {
    "steps": "Number of steps",
    "rejected": "Number of rejected steps",
    "rhs_evals": "Number of evaluations of the equations of motion",
    "partition_switches": "Number of changes between LU and projection partition",
    "restarts": "Number of restarts of the integrator",
    "stability_limited": "Number of steps of adams and hybrid that are limited by stability instead of accuracy",
}

ENERGY_OUTPUTS = (
    Variable("energy_error", "J", "Energy error: change of energy minus work of drives, dampers and given forces"),
    Variable("energy_throughput", "J", "Energy throughput: range of the kinetic energy plus work in either direction"),
)  # of the energy check of a run

NOT_XML_CHARACTER = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
VARIABLE_NAME_PATTERN = re.compile(r"[A-Za-z_]\w*(\[\d+(,\d+)*\])?(\.[A-Za-z_]\w*(\[\d+(,\d+)*\])?)*", re.ASCII)


class Type(Enum):
    """Types of FMI 2."""

    REAL = "Real"
    INTEGER = "Integer"
    BOOLEAN = "Boolean"
    STRING = "String"
    ENUMERATION = "Enumeration"


class Role(Enum):
    """Type of a variable, for messages and tables."""

    PARAMETER = "parameter"
    SETTING = "setting of the solver"
    INPUT = "input"
    OUTPUT = "output"
    COUNTER = "count of the solver"
    MESSAGE = "message of the solver"

    @property
    def plural(self) -> str:
        """Of several, as a title."""
        word, *rest = self.value.split(" ", 1)
        return " ".join([word + "s", *rest]).capitalize()


@dataclass(frozen=True, kw_only=True)
class ScalarVariable:
    """A variable of the interface, in the terms of FMI 2.

    Attributes
    ----------
    start
        Value until it is set; of an enumeration the number of the choice, from 1. None: it is calculated.
    depends_on
        Names of the inputs that change an output at the moment they are set.
    """

    name: str
    role: Role
    type: Type
    causality: str
    variability: str
    description: str
    unit: str = "1"
    start: float | bool | None = None
    min: float = -inf
    max: float = inf
    nominal: float | None = None
    choices: dict[int, str] = field(default_factory=dict)  # by their numbers
    allowed: str = ""  # allowed values as text
    depends_on: tuple[str, ...] = ()

    @property
    def display_unit(self) -> str:
        """What people read it in; empty: its unit."""
        return "deg" if self.unit == "rad" else ""

    @property
    def size(self) -> str:
        """Number of its values as text; empty: one."""
        return ""

    @property
    def settable(self) -> bool:
        """Whether a host may ever set it."""
        return self.causality in ("parameter", "input")

    @property
    def start_text(self) -> str:
        """Its start for people."""
        if self.start is None:
            return ""
        if self.choices:
            return self.choices[int(self.start)]
        return str(self.start).lower() if isinstance(self.start, bool) else f"{self.start:.9g}"

    def value_of(self, number: float) -> Any:
        """Return what a number that a host has set stands for, in the type that models and settings take."""
        if self.choices:
            return self.choices[int(number)]
        return {Type.BOOLEAN: bool, Type.INTEGER: int}.get(self.type, float)(number)


@dataclass(frozen=True, kw_only=True)
class ArrayVariable(ScalarVariable):
    """Outputs that are one variable in FMI 3.

    Attributes
    ----------
    shape
        How many there are in every direction.
    elements
        Their names; the last index runs first.
    """

    shape: tuple[int, ...]
    elements: tuple[str, ...]

    @property
    def size(self) -> str:
        """Number of its values as text."""
        return " x ".join(map(str, self.shape))


VARIABILITY = {"fixed": "fixed", "tunable": "tunable", "constant": "fixed at export"}  # of parameters
EFFECT_PREFIX = "Optional effect: "  # begins the description of a parameter that switches an effect


def columns(variables: Sequence[ScalarVariable]) -> dict[str, list[str]]:
    """Return the columns of a table of variables, by their titles; empty columns are omitted."""
    found = {
        "name": [v.name for v in variables],
        "size": [v.size for v in variables],
        "start value": [v.start_text for v in variables],
        "unit": ["" if v.unit == "1" else v.unit for v in variables],
        "range": [v.allowed for v in variables],
        "variability": [VARIABILITY.get(v.variability, "") for v in variables],
        "depends directly on": [", ".join(v.depends_on) for v in variables],
        "effect": ["optional" if v.description.startswith(EFFECT_PREFIX) else "" for v in variables],
        "description": [_capitalize(v.description.removeprefix(EFFECT_PREFIX)) for v in variables],
    }
    return {title: cells for title, cells in found.items() if any(cells)}


def _capitalize(text: str) -> str:
    """Return the text with an upper-case first letter."""
    return text[:1].upper() + text[1:]


def list_variables(
    model: Model, settings: Settings, compiled: CompiledMechanism | None = None
) -> tuple[ScalarVariable, ...]:
    """Return every variable of a model under these settings; ``compiled`` saves building it again.

    Raises
    ------
    UserError
        A name is taken twice or no structured name of FMI, or a unit is unknown.
    """
    compiled = compiled or model.compile()
    found = (*parameters(model), *solver_settings(settings), *inputs(compiled), *outputs(compiled), *solver_outputs())
    check_variables(found)
    return tuple(
        replace(v, nominal=v.nominal or compiled.nominal(v.unit)) if v.role in (Role.INPUT, Role.OUTPUT) else v
        for v in found
    )


def arrays(model: Model, variables: Sequence[ScalarVariable]) -> tuple[ArrayVariable, ...]:
    """Return the arrays that a model makes of its outputs, which are among its variables.

    Raises
    ------
    UserError
        What is declared is no array of outputs of one unit, or shares one with another array, or its name is taken.
    """
    known = {v.name: v for v in variables if v.role is Role.OUTPUT}
    found = [_array(name, nested, known) for name, nested in model.arrays().items()]
    check_variables((*variables, *found))
    return tuple(found)


def _array(name: str, nested: Any, known: dict[str, ScalarVariable]) -> ArrayVariable:
    """Return an array of outputs, by their names in nested lists; they are known no more."""
    table = np.array(nested, object)
    names: list[str] = table.ravel().tolist()
    if not names or not table.ndim or not all(isinstance(own, str) for own in names):
        raise UserError(f"array {name!r} is {nested!r}; allowed: names of outputs, in lists of equal lengths")
    elements = []
    for own in names:
        if own not in known:
            raise UserError(
                f"array {name!r} has {own!r}, which is not an output of the model or already in another array; "
                "allowed: names "
                "of outputs, each in one array"
            )
        elements.append(known.pop(own))
    first = elements[0]
    for element in elements:
        if element.unit != first.unit:
            raise UserError(
                f"array {name!r} has {first.name!r} in {first.unit} and {element.name!r} in {element.unit}; "
                "allowed: one unit"
            )
    return ArrayVariable(
        name=name,
        role=Role.OUTPUT,
        type=Type.REAL,
        causality="output",
        variability="continuous",
        description=f"{names[0]} to {names[-1]}",
        unit=first.unit,
        nominal=first.nominal,
        depends_on=tuple(dict.fromkeys(n for own in elements for n in own.depends_on)),
        shape=table.shape,
        elements=tuple(names),
    )


def parameters(model: Model) -> Iterator[ScalarVariable]:
    """Yield the parameters of a model; what decides the structure is constant."""
    for p in model.parameters():
        value = getattr(model, p.name)
        variability = "constant" if p.structural else "tunable" if p.varies(value) else "fixed"
        yield parameter(p, Role.PARAMETER, value, variability)


def solver_settings(settings: Settings) -> Iterator[ScalarVariable]:
    """Yield the settings; a solver from outside the package is one of the choices if it is in use."""
    for p in declared(Settings):
        if p.name == "solver" and settings.solver not in p.choices:
            p = replace(p, choices=(*p.choices, settings.solver))  # noqa: PLW2901
        yield parameter(p, Role.SETTING, getattr(settings, p.name), "fixed")


def parameter(p: Parameter, role: Role, value: Any, variability: str) -> ScalarVariable:
    """Return what is declared of a parameter, with its value as the start."""
    kinds = ((bool, Type.BOOLEAN), (int, Type.INTEGER), (np.integer, Type.INTEGER), (float, Type.REAL))
    kind = next((found for python, found in kinds if isinstance(p.default, python)), None)
    if kind is None and not p.choices:
        raise UserError(f"parameter {p.name!r} has the default {p.default!r}; allowed: a number, or text with choices")
    constant = variability == "constant"
    return ScalarVariable(
        name=p.name,
        role=role,
        type=kind if kind and not p.choices else Type.ENUMERATION,
        causality="local" if constant else "parameter",
        variability=variability,
        description=p.doc,
        unit=p.unit,
        start=p.choices.index(value) + 1 if p.choices else value,
        min=p.min,
        max=p.max,
        choices={i: word for i, word in enumerate(p.choices, 1) if word in p.listed_choices or word == value},
        allowed=span(p),
    )


def inputs(compiled: CompiledMechanism) -> Iterator[ScalarVariable]:
    """Yield the inputs."""
    for v in compiled.inputs.variables:
        yield describe_signal(v, Role.INPUT, start=v.start, allowed="any finite number")


def outputs(compiled: CompiledMechanism) -> Iterator[ScalarVariable]:
    """Yield the outputs, and those of the energy check."""
    names = [v.name for v in compiled.inputs.variables]
    reached = [*compiled.feedthrough(), *(() for _ in ENERGY_OUTPUTS)]
    for v, at_once in zip((*compiled.outputs, *ENERGY_OUTPUTS), reached, strict=True):
        yield describe_signal(v, Role.OUTPUT, depends_on=tuple(names[i] for i in at_once))


def describe_signal(v: mechanics.Variable, role: Role, **attributes: Any) -> ScalarVariable:
    """Return an input or output of a compiled mechanism with its attributes."""
    return ScalarVariable(
        name=v.name,
        role=role,
        type=Type.REAL,
        causality=role.value,
        variability="continuous",
        description=v.description,
        unit=v.unit,
        nominal=v.nominal,
        **attributes,
    )


def solver_outputs() -> Iterator[ScalarVariable]:
    """Yield what the solver reports of itself: local variables, which importers do not connect to others."""
    message_text = "Last error or warning and what to do; empty if there is none"
    counters = [(name, Role.COUNTER, Type.INTEGER, text) for name, text in COUNTERS.items()]
    for name, role, kind, text in [*counters, ("message", Role.MESSAGE, Type.STRING, message_text)]:
        yield ScalarVariable(
            name=f"solver.{name}",
            role=role,
            type=kind,
            causality="local",
            variability="discrete",
            description=text,
        )


def check_variables(variables: Iterable[ScalarVariable]) -> None:
    """Refuse names that FMI does not allow, duplicate names, and unknown units."""
    seen: dict[str, ScalarVariable] = {}
    for v in variables:
        what = f"the {v.role.value} {v.name!r}"
        if not VARIABLE_NAME_PATTERN.fullmatch(v.name):
            raise UserError(
                f"{what} has a name that is not allowed in an FMU; allowed: letters, digits and _, with dots "
                "between parts and "
                "indices such as [1,2]"
            )
        if v.name == "time" or v.name in seen:
            other = "the time" if v.name == "time" else f"the {seen[v.name].role.value}"
            raise UserError(f"{what} has the same name as {other}; choose another name")
        seen[v.name] = v
        require_xml_text(f"the description of {what}", v.description)
        if v.nominal is not None and not (isinstance(v.nominal, int | float) and 0.0 < v.nominal < inf):
            raise UserError(f"the nominal value of {what} is {v.nominal!r}; allowed: a finite number above zero")
        try:
            read_unit(v.unit)
        except UserError as error:
            raise UserError(f"{what}: {error}") from error


def require_xml_text(what: str, text: Any) -> None:
    """Refuse what cannot be written in XML."""
    if not isinstance(text, str) or NOT_XML_CHARACTER.search(text):
        raise UserError(f"{what} is {text!r}; allowed: text without control characters")


def require_unique(names: Iterable[str]) -> None:
    """Refuse a name that two variables have."""
    name, count = Counter(names).most_common(1)[0]
    if count > 1:
        raise UserError(f"{count} variables are named {name!r}: names of parameters, inputs and outputs must differ")
