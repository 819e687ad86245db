"""What model descriptions declare for model exchange: states, their derivatives, and the capabilities."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple
from xml.etree.ElementTree import Element, SubElement

from mbfmu.native.exchange_states import ExchangeState, Indicator

FMI2_EXCHANGE_CAPABILITIES = {
    "needsExecutionTool": "false",
    "completedIntegratorStepNotNeeded": "false",
    "canBeInstantiatedOnlyOncePerProcess": "false",
    "canNotUseMemoryManagementFunctions": "true",
    "canGetAndSetFMUstate": "true",
    "canSerializeFMUstate": "true",
}
FMI3_EXCHANGE_CAPABILITIES = {
    "needsExecutionTool": "false",
    "canBeInstantiatedOnlyOncePerProcess": "false",
    "canGetAndSetFMUState": "true",
    "canSerializeFMUState": "true",
    "needsCompletedIntegratorStep": "true",
}


DERIVATIVE_CAPABILITIES = {  # by the version of FMI
    2: {"providesDirectionalDerivative": "true"},
    3: {"providesDirectionalDerivatives": "true", "providesAdjointDerivatives": "true"},
}


class ExchangeVariable(NamedTuple):
    """A continuous state, a derivative, or an event indicator.

    Attributes
    ----------
    reference
        Value reference.
    of
        Number of the state that it is the derivative of; None: it is none.
    """

    name: str
    reference: int
    description: str
    unit: str
    nominal: float | None
    of: int | None

    @property
    def display_unit(self) -> str:
        """What people read it in; empty: its unit."""
        return "deg" if self.unit == "rad" else ""

    def attributes(self) -> dict[str, str]:
        """Return the attributes that both versions of FMI have on one element or two."""
        return {"name": self.name, "valueReference": str(self.reference), "causality": "local"} | {
            "variability": "continuous", "description": self.description, "initial": "calculated",
        }  # fmt: skip

    def type_attributes(self) -> dict[str, str]:
        """Return the attributes of the real type."""
        told = {} if self.unit == "1" else {"unit": self.unit}
        told |= {"displayUnit": self.display_unit} if self.display_unit else {}
        return told | ({} if self.nominal is None else {"nominal": repr(self.nominal)})


class ExchangeInterface(NamedTuple):
    """What an FMU with model exchange declares.

    Attributes
    ----------
    variables
        States, then their derivatives.
    moving_inputs
        Names of the inputs that move joints: outputs depend on them at once in model exchange, not in co-simulation.
    has_derivatives
        Whether directional derivatives are provided.
    indicators
        Event indicators; variables in FMI 3.0 only.
    """

    variables: Sequence[ExchangeVariable]
    moving_inputs: Sequence[str]
    has_derivatives: bool
    indicators: Sequence[ExchangeVariable] = ()

    def derivative_capabilities(self, fmi: int) -> dict[str, str]:
        """Return the attributes of directional derivatives, for both types of FMU."""
        return DERIVATIVE_CAPABILITIES[fmi] if self.has_derivatives else {}

    def output_capabilities(self) -> dict[str, str]:
        """Return the attributes of derivatives of outputs by time, for co-simulation."""
        return {"maxOutputDerivativeOrder": "1"} if self.has_derivatives else {}


def exchange_variables(states: Sequence[ExchangeState], first: int) -> list[ExchangeVariable]:
    """Return the states, then their derivatives, with value references from ``first`` on."""
    found = [
        ExchangeVariable(s.name, first + k, s.description, s.unit, s.nominal or None, None)
        for k, s in enumerate(states)
    ]
    after = first + len(states)
    return found + [
        ExchangeVariable(s.derivative, after + k, f"Derivative of {s.name}", s.derivative_unit, None, k)
        for k, s in enumerate(states)
    ]


def indicator_variables(indicators: Sequence[Indicator], first: int) -> list[ExchangeVariable]:
    """Return the event indicators, with value references from ``first`` on."""
    return [
        ExchangeVariable(own.name, first + k, own.description, own.unit, None, None) for k, own in enumerate(indicators)
    ]


def add_fmi2_variables(described: Element, variables: Sequence[ExchangeVariable], before: int) -> None:
    """Add variables of FMI 2.0 to ModelVariables, which has ``before`` variables."""
    for v in variables:
        scalar = SubElement(described, "ScalarVariable", v.attributes())
        kind = SubElement(scalar, "Real", v.type_attributes())
        if v.of is not None:
            kind.set("derivative", str(before + 1 + v.of))


def add_fmi2_structure(structure: Element, variables: Sequence[ExchangeVariable], before: int) -> None:
    """Add the derivatives and initial unknowns of FMI 2.0 to ModelStructure; derivatives depend on everything."""
    if not variables:
        return
    unknowns = structure.find("InitialUnknowns")
    derivatives = Element("Derivatives")
    for k, v in enumerate(variables, before + 1):
        if v.of is not None:
            SubElement(derivatives, "Unknown", index=str(k))
        if unknowns is not None:
            SubElement(unknowns, "Unknown", index=str(k))
    structure.insert(1, derivatives)


def add_fmi3_variables(described: Element, variables: Sequence[ExchangeVariable]) -> None:
    """Add variables of FMI 3.0 to ModelVariables."""
    for v in variables:
        element = SubElement(described, "Float64", v.attributes() | v.type_attributes())
        if v.of is not None:
            element.set("derivative", str(variables[v.of].reference))
