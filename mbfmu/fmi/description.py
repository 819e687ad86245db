"""What PythonFMU's model description lacks: units, ranges, initial unknowns, reproducible dates."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Any
from xml.etree.ElementTree import Element, SubElement

from pythonfmu import Real

from .units import base_exponents

EPOCH = "2000-01-01T00:00:00+00:00"  # the date of every build: equal content gives equal bytes


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """Unit and range of a real variable."""

    unit: str = "1"
    min: float = -float("inf")
    max: float = float("inf")
    nominal: float | None = None


class QuantityReal(Real):  # type: ignore[misc]
    """A real variable with a unit and a range."""

    def __init__(self, name: str, quantity: Quantity, **options: Any) -> None:
        super().__init__(name, **options)
        self.quantity = quantity

    def to_xml(self) -> Element:
        """Return the variable's element."""
        element: Element = super().to_xml()
        real, q = element.find("Real"), self.quantity
        assert real is not None
        if q.unit != "1":
            real.set("unit", q.unit)
        for key in ("min", "max"):
            if isfinite(getattr(q, key)):
                real.set(key, repr(float(getattr(q, key))))
        if q.nominal is not None:
            real.set("nominal", repr(float(q.nominal)))
        return element


def complete(root: Element, variables: list[Any], inputs_feed_through: bool) -> Element:
    """Add units, initial unknowns and dependencies; fix the date. Elements keep the order of the FMI schema."""
    root.set("generationDateAndTime", EPOCH)
    units = sorted({v.quantity.unit for v in variables if isinstance(v, QuantityReal)} - {"1"})
    if units:
        definitions = Element("UnitDefinitions")
        for unit in units:
            base = {k: str(n) for k, n in base_exponents(unit).items()}
            SubElement(SubElement(definitions, "Unit", name=unit), "BaseUnit", base)
        root.insert(list(root).index(root.find("CoSimulation")) + 1, definitions)  # type: ignore[arg-type]
    structure = root.find("ModelStructure")
    assert structure is not None
    outputs = structure.find("Outputs")
    if outputs is None:
        return root
    inputs = [str(i + 1) for i, v in enumerate(variables) if v.causality.name == "input"]
    unknowns = SubElement(structure, "InitialUnknowns")
    for output in outputs:
        if not inputs_feed_through:
            output.set("dependencies", "")
        elif inputs:
            output.set("dependencies", " ".join(inputs))
        SubElement(unknowns, "Unknown", index=output.get("index", ""))
    return root
