"""The model description of FMI 2.0, written from the list of variables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import mbfmu
from mbfmu.modeling.variables import ScalarVariable, Type
from mbfmu.util.units import read_unit

from . import exchange_description as exchange
from .exchange_description import ExchangeInterface, ExchangeVariable

BUILD_DATE = "2000-01-01T00:00:00+00:00"  # the date of every build: equal content gives equal bytes

FMI2_CAPABILITIES = {
    "canHandleVariableCommunicationStepSize": "true",
    "canBeInstantiatedOnlyOncePerProcess": "false",
    "canNotUseMemoryManagementFunctions": "true",
    "canGetAndSetFMUstate": "true",
    "canSerializeFMUstate": "true",
}


LOG_CATEGORIES = {
    "logStatusWarning": "something unusual that does not stop the run",
    "logStatusDiscard": "a step or an evaluation that failed and may be repeated: what happened and what to try",
    "logStatusError": "a failure: what happened, where, and what to try",
    "logAll": "everything",
}


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """Default experiment of an FMU: stop time and output interval, s, and tolerance."""

    stop_time: float
    step_size: float
    tolerance: float


@dataclass(frozen=True, kw_only=True)
class Identity:
    """Identity of an FMU: display name, file name, description, and identifier.

    ``tool`` is the tool besides mbfmu that its binaries contain, which requires Python; empty: machine code.
    """

    name: str
    identifier: str
    description: str
    guid: str
    tool: str = ""

    @property
    def made_by(self) -> str:
        """What wrote the FMU."""
        return " with ".join(filter(None, (f"mbfmu {mbfmu.__version__}", self.tool)))


def model_description(
    identity: Identity,
    experiment: Experiment,
    variables: Sequence[ScalarVariable],
    log_categories: Mapping[str, str],
    interface: ExchangeInterface | None = None,
    takes_rates: bool = False,
) -> Element:
    """Return the root of modelDescription.xml; elements keep the order of the FMI schema.

    ``interface``: that of model exchange; None: the FMU is for co-simulation only. ``takes_rates``: the importing tool
    may give the first derivatives of inputs by time.
    """
    root = Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=identity.name,
        guid=identity.guid,
        description=identity.description,
        author="mbfmu",
        version=mbfmu.__version__,
        license="see documentation/licenses",
        generationTool=identity.made_by,
        generationDateAndTime=BUILD_DATE,
        variableNamingConvention="structured",
    )
    needs = "true" if identity.tool else "false"
    told = {"modelIdentifier": identity.identifier, "needsExecutionTool": needs, **FMI2_CAPABILITIES}
    told["canInterpolateInputs"] = "true" if takes_rates else "false"
    exchanged, moving = (interface.variables, interface.moving_inputs) if interface else ((), ())
    if interface is not None:
        root.set("numberOfEventIndicators", str(len(interface.indicators)))
        own = {"modelIdentifier": identity.identifier, **exchange.FMI2_EXCHANGE_CAPABILITIES}
        SubElement(root, "ModelExchange", own | interface.derivative_capabilities(2))
        told |= interface.derivative_capabilities(2) | interface.output_capabilities()
    SubElement(root, "CoSimulation", told)
    root.extend([*units([*variables, *exchanged]), *_enumerations(variables), *default_run(experiment, log_categories)])
    described = SubElement(root, "ModelVariables")
    for reference, v in enumerate(variables):
        _variable(described, reference, v)
    states = [len(variables) + 1 + k for k, v in enumerate(exchanged) if v.of is None]
    structure = _structure(variables, moving, states)
    exchange.add_fmi2_variables(described, exchanged, len(variables))
    exchange.add_fmi2_structure(structure, exchanged, len(variables))
    root.append(structure)
    return root


def xml_bytes(root: Element) -> bytes:
    """Return an XML file; the elements are indented."""
    indent(root)
    text: bytes = tostring(root, encoding="utf-8", xml_declaration=True)
    return text


def number(value: float) -> str:
    """Return a number as XML has it, to the last digit."""
    return repr(float(value))


def default_run(experiment: Experiment, log_categories: Mapping[str, str]) -> Iterable[Element]:
    """Yield the categories of the log and the default experiment."""
    categories = Element("LogCategories")
    for name, text in log_categories.items():
        SubElement(categories, "Category", name=name, description=text)
    yield categories
    times = {"startTime": 0.0, "stopTime": experiment.stop_time, "stepSize": experiment.step_size}
    told = {**times, "tolerance": experiment.tolerance}
    yield Element("DefaultExperiment", {key: number(value) for key, value in told.items()})


def units(variables: Iterable[ScalarVariable | ExchangeVariable]) -> Iterable[Element]:
    """Yield the definitions of all units, with what people read them in."""
    shown = {v.unit: v.display_unit for v in variables if v.unit != "1"}
    if not shown:
        return
    definitions = Element("UnitDefinitions")
    for name, display in sorted(shown.items()):
        unit = read_unit(name)
        element = SubElement(definitions, "Unit", name=name)
        base = SubElement(element, "BaseUnit", {k: str(n) for k, n in unit.exponents.items()})
        if unit.factor != 1.0:
            base.set("factor", number(unit.factor))
        if display:
            SubElement(element, "DisplayUnit", name=display, factor=number(unit.factor / read_unit(display).factor))
    yield definitions


def _enumerations(variables: Iterable[ScalarVariable]) -> Iterable[Element]:
    """Yield the types of variables that are one of several words."""
    chosen = [v for v in variables if v.choices]
    if not chosen:
        return
    definitions = Element("TypeDefinitions")
    for v in chosen:
        simple = SubElement(definitions, "SimpleType", name=type_name(v), description=v.description)
        kind = SubElement(simple, "Enumeration")
        for i, word in v.choices.items():
            SubElement(kind, "Item", name=word, value=str(i))
    yield definitions


def type_name(v: ScalarVariable) -> str:
    """Return the name of the type of a choice."""
    return f"choice of {v.name}"  # no variable has a blank in its name


def _variable(parent: Element, reference: int, v: ScalarVariable) -> None:
    """Add a variable; start, unit and range belong to its type."""
    scalar = SubElement(
        parent,
        "ScalarVariable",
        name=v.name,
        valueReference=str(reference),
        causality=v.causality,
        variability=v.variability,
        description=v.description,
    )
    if v.causality != "input":
        scalar.set("initial", "calculated" if v.start is None else "exact")
    kind = SubElement(scalar, v.type.value)
    if v.choices:
        kind.set("declaredType", type_name(v))
        kind.set("min", str(min(v.choices)))
        kind.set("max", str(max(v.choices)))
    if v.unit != "1":
        kind.set("unit", v.unit)
    if v.display_unit:
        kind.set("displayUnit", v.display_unit)
    as_text = number if v.type is Type.REAL else lambda x: str(int(x))
    for key, bound in (("min", v.min), ("max", v.max)):
        if isfinite(bound):
            kind.set(key, as_text(bound))
    if v.nominal is not None:
        kind.set("nominal", number(v.nominal))
    if v.start is not None:
        kind.set("start", str(v.start).lower() if isinstance(v.start, bool) else as_text(v.start))


def _structure(variables: Sequence[ScalarVariable], moving: Sequence[str], states: Sequence[int]) -> Element:
    """Return what depends on what: outputs on the inputs that change them at once, on the inputs ``moving`` and on all
    ``states`` (indices of variables, from 1), at the start on everything.
    """
    structure = Element("ModelStructure")
    index = {v.name: str(i) for i, v in enumerate(variables, 1)}
    made = [v for v in variables if v.causality == "output"]
    outputs = SubElement(structure, "Outputs")
    for v in made:
        needs = " ".join([*(index[n] for n in dict.fromkeys((*v.depends_on, *moving))), *map(str, states)])
        SubElement(outputs, "Unknown", index=index[v.name], dependencies=needs)
    unknowns = SubElement(structure, "InitialUnknowns")
    for v in made:
        SubElement(unknowns, "Unknown", index=index[v.name])
    return structure
