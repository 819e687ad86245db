"""The model description of FMI 3.0, written from the list of variables."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import isfinite
from xml.etree.ElementTree import Element, SubElement

import mbfmu
from mbfmu.modeling.variables import ArrayVariable, ScalarVariable, Type

from . import exchange_description as exchange
from .description import BUILD_DATE, Experiment, Identity, default_run, number, type_name, units
from .exchange_description import ExchangeInterface

FMI3_TYPES = {
    Type.REAL: "Float64",
    Type.INTEGER: "Int64",
    Type.BOOLEAN: "Boolean",
    Type.STRING: "String",
    Type.ENUMERATION: "Enumeration",
}
FMI3_CAPABILITIES = {
    "needsExecutionTool": "false",
    "canBeInstantiatedOnlyOncePerProcess": "false",
    "canGetAndSetFMUState": "true",
    "canSerializeFMUState": "true",
    "canHandleVariableCommunicationStepSize": "true",
}
TIME_NAME = "time"  # the independent variable, whose value reference comes after all others


def listed(
    variables: Sequence[ScalarVariable], arrays: Sequence[ArrayVariable]
) -> Iterator[tuple[int, ScalarVariable]]:
    """Yield what FMI 3 has with its value references: an array in place of its elements, where the first is."""
    references = {a.name: len(variables) + 1 + k for k, a in enumerate(arrays)}
    within = {name: a for a in arrays for name in a.elements}
    for reference, v in enumerate(variables):
        array = within.get(v.name)
        if array is None:
            yield reference, v
        elif array.elements[0] == v.name:
            yield references[array.name], array


def model_description(
    identity: Identity,
    experiment: Experiment,
    variables: Sequence[ScalarVariable],
    log_categories: Mapping[str, str],
    arrays: Sequence[ArrayVariable],
    interface: ExchangeInterface | None = None,
) -> Element:
    """Return the root of modelDescription.xml; elements keep the order of the FMI schema.

    ``arrays`` are declared in place of those of the variables that are in them. ``interface``: that of model exchange;
    None: the FMU is for co-simulation only.
    """
    root = Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=identity.name,
        instantiationToken=identity.guid,
        description=identity.description,
        author="mbfmu",
        version=mbfmu.__version__,
        license="see documentation/licenses",
        generationTool=identity.made_by,
        generationDateAndTime=BUILD_DATE,
        variableNamingConvention="structured",
    )
    capabilities = {"modelIdentifier": identity.identifier, **FMI3_CAPABILITIES}
    if interface is not None:
        own = {"modelIdentifier": identity.identifier, **exchange.FMI3_EXCHANGE_CAPABILITIES}
        SubElement(root, "ModelExchange", own | interface.derivative_capabilities(3))
        capabilities |= interface.derivative_capabilities(3) | interface.output_capabilities()
    SubElement(root, "CoSimulation", capabilities)
    exchanged = [*interface.variables, *interface.indicators] if interface else []
    root.extend([*units([*variables, *exchanged]), *_enumerations(variables), *default_run(experiment, log_categories)])
    described = SubElement(root, "ModelVariables")
    told = list(listed(variables, arrays))
    for reference, v in told:
        _variable(described, reference, v)
    SubElement(
        described,
        "Float64",
        name=TIME_NAME,
        valueReference=str(len(variables)),
        causality="independent",
        variability="continuous",
        description="time",
        unit="s",
    )
    exchange.add_fmi3_variables(described, exchanged)
    root.append(_structure(told, interface))
    return root


def _enumerations(variables: Iterable[ScalarVariable]) -> Iterable[Element]:
    """Yield the types of variables that are one of several words."""
    chosen = [v for v in variables if v.choices]
    if not chosen:
        return
    definitions = Element("TypeDefinitions")
    for v in chosen:
        kind = SubElement(definitions, "EnumerationType", name=type_name(v))  # older FMPy reads no description here
        for i, word in v.choices.items():
            SubElement(kind, "Item", name=word, value=str(i))
    yield definitions


def _variable(parent: Element, reference: int, v: ScalarVariable) -> None:
    """Add a variable."""
    told = {"name": v.name, "valueReference": str(reference), "causality": v.causality, "variability": v.variability}
    told |= {"description": v.description}
    if v.causality != "input":
        told["initial"] = "calculated" if v.start is None else "exact"
    if v.choices:
        told |= {"declaredType": type_name(v), "min": str(min(v.choices)), "max": str(max(v.choices))}
    if v.unit != "1":
        told["unit"] = v.unit
    if v.display_unit:
        told["displayUnit"] = v.display_unit
    as_text = number if v.type is Type.REAL else lambda x: str(int(x))
    told |= {key: as_text(bound) for key, bound in (("min", v.min), ("max", v.max)) if isfinite(bound)}
    if v.nominal is not None:
        told["nominal"] = number(v.nominal)
    if v.start is not None:
        told["start"] = str(v.start).lower() if isinstance(v.start, bool) else as_text(v.start)
    element = SubElement(parent, FMI3_TYPES[v.type], told)
    for count in v.shape if isinstance(v, ArrayVariable) else ():
        SubElement(element, "Dimension", start=str(count))


def _structure(variables: Sequence[tuple[int, ScalarVariable]], interface: ExchangeInterface | None) -> Element:
    """Return what depends on what: outputs on the inputs that change them at once, in model exchange also on those that
    move joints and on all states, at the start on everything.
    """
    exchanged, moving = (interface.variables, interface.moving_inputs) if interface else ((), ())
    structure = Element("ModelStructure")
    reference = {v.name: str(k) for k, v in variables}
    made = [v for _, v in variables if v.causality == "output"]
    states = [str(v.reference) for v in exchanged if v.of is None]
    for v in made:
        needs = " ".join([*(reference[name] for name in dict.fromkeys((*v.depends_on, *moving))), *states])
        SubElement(structure, "Output", valueReference=reference[v.name], dependencies=needs)
    for own in exchanged:
        if own.of is not None:
            SubElement(structure, "ContinuousStateDerivative", valueReference=str(own.reference))
    for k in (*(reference[v.name] for v in made), *(str(own.reference) for own in exchanged)):
        SubElement(structure, "InitialUnknown", valueReference=k)
    for own in interface.indicators if interface else ():
        SubElement(structure, "EventIndicator", valueReference=str(own.reference))
    return structure
