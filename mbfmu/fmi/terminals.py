"""Terminals: variables that belong together and are connected together.

FMI 2.0.4 has adopted them from FMI 3.0, with the same file.
"""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree.ElementTree import Element, SubElement

from mbfmu.modeling.model import Model
from mbfmu.modeling.variables import Role, ScalarVariable
from mbfmu.util.errors import UserError

from .description import xml_bytes

# name and kind of a member by its unit: turning, and sliding. Torques and forces flow into the mechanism
FLANGE_MEMBERS = (
    {"rad": ("phi", "signal"), "rad/s": ("w", "signal"), "N.m": ("tau", "inflow")},
    {"m": ("s", "signal"), "m/s": ("v", "signal"), "N": ("f", "inflow")},
)


TERMINALS_FILE = "terminalsAndIcons/terminalsAndIcons.xml"


def terminal_files(model: Model, variables: Iterable[ScalarVariable]) -> dict[str, bytes]:
    """Return the file that describes the terminals of a model by its name; empty if the model has none."""
    root = terminals_and_icons(model, variables)
    return {} if root is None else {TERMINALS_FILE: xml_bytes(root)}


def terminals_and_icons(model: Model, variables: Iterable[ScalarVariable]) -> Element | None:
    """Return the root of terminalsAndIcons.xml, for the variables of the FMU; None where a model has no terminals.

    Raises
    ------
    UserError
        Members of a terminal are no variables of one joint coordinate.
    """
    known = {v.name: v for v in variables if v.role in (Role.INPUT, Role.OUTPUT)}
    declared = model.terminals()
    if not declared:
        return None
    root = Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    parent = SubElement(root, "Terminals")
    for name, members in declared.items():
        # what one side alone has is left open where two are connected
        terminal = SubElement(parent, "Terminal", name=name, matchingRule="bus")
        for variable, (member, kind) in zip(members, _flange(name, members, known), strict=True):
            told = {"variableName": variable, "memberName": member, "variableKind": kind}
            SubElement(terminal, "TerminalMemberVariable", told)
    return root


def _flange(name: str, members: Iterable[str], known: dict[str, ScalarVariable]) -> list[tuple[str, str]]:
    """Return name and kind of each member; the unit determines the kind."""
    for member in members:
        if member not in known:
            raise UserError(
                f"terminal {name!r} has {member!r}, which is not an input or output of the FMU; allowed: names "
                "of inputs and "
                "outputs"
            )
    units = [known[member].unit for member in members]
    for flange in FLANGE_MEMBERS:
        if len(set(units)) == len(units) > 0 and set(units) <= set(flange):
            return [flange[unit] for unit in units]
    raise UserError(
        f"terminal {name!r} has variables in {', '.join(units) or 'no unit'}; allowed: one each in rad, rad/s and N.m, "
        "or in m, m/s and N"
    )
