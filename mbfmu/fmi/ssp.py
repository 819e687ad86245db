"""Systems of connected FMUs as archives of System Structure and Parameterization (SSP) 1.0.

An archive contains the FMUs, a description of the system with connectors of each FMU, the connections between them, and
values of parameters. FMPy and libcosim simulate such archives. libcosim supports connections between FMUs only, not
connectors of the whole system, and FMPy requires that every connector of an input is connected. Connectors are
therefore all outputs of the FMUs, and the inputs that are connected.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Iterable, Mapping
from math import inf
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, SubElement, indent, register_namespace, tostring

import numpy as np
from fmpy import read_model_description

from mbfmu.mechanics.numbers import is_finite, is_whole, positive
from mbfmu.util.errors import UserError, suggest
from mbfmu.util.files import replacing

NAMESPACES = {
    part: f"http://ssp-standard.org/SSP1/SystemStructure{name}"
    for part, name in (("ssd", "Description"), ("ssv", "ParameterValues"), ("ssc", "Common"))
}
SSP_TYPES = {"Real": "Real", "Integer": "Integer", "Boolean": "Boolean"}  # of connectors, by the type in FMI 2.0
CONNECTED = ("input", "output")  # causalities of connectors
ARCHIVE_DATE = (1980, 1, 1, 0, 0, 0)  # of every file, so that equal systems are equal bytes


class Connector(NamedTuple):
    """An input, output or parameter of a component."""

    causality: str  # of FMI 2.0
    type: str  # of FMI 2.0
    unit: str  # empty: none
    least: float  # allowed value
    most: float


def write_ssp(
    path: Path | str,
    components: Mapping[str, Path | str],
    connections: Iterable[tuple[str, str]] = (),
    values: Mapping[str, float] | None = None,
    *,
    stop_time: float = 1.0,
) -> Path:
    """Write a system of FMUs. Equal content gives equal bytes.

    Parameters
    ----------
    path
        Path of the archive in an existing folder; it must end in ``.ssp``.
    components
        Files of FMI 2.0 for co-simulation by the names of the components. Several components may share a file.
    connections
        Pairs of an output and an input, each as ``"component.variable"``.
    values
        Values of parameters, and start values of inputs, as ``{"component.variable": value}``. Tools that ignore them,
        such as FMPy, use the start values of the FMUs.
    stop_time
        Stop time of the default experiment, s.

    Returns
    -------
    Path
        Path of the archive.

    Raises
    ------
    UserError
        A file is not an FMU of this kind; a name is not allowed, or not a variable of this kind; the two ends of a
        connection differ in type or unit; an input is connected twice; or the archive cannot be written.
    """
    path = Path(path)
    if path.suffix != ".ssp":
        raise UserError(f"SSP file is {str(path)!r}; its name must end in .ssp")
    if not path.parent.is_dir():
        raise UserError(f"folder {str(path.parent)!r} does not exist")
    positive("stop time", stop_time)
    if not components:
        raise UserError("there are no components; allowed: one FMU or more, by their names")
    files = {name: Path(file) for name, file in components.items()}
    connectors = {name: connectors_of(name, file) for name, file in files.items()}
    root = _describe(path.stem, _names_in_archive(files), connectors, list(connections), values or {}, stop_time)
    indent(root)
    description = b'<?xml version="1.0" encoding="UTF-8"?>\n' + tostring(root)
    sources = {archived: files[name] for name, archived in _names_in_archive(files).items()}
    with replacing(path) as unfinished, zipfile.ZipFile(unfinished, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(zipfile.ZipInfo("SystemStructure.ssd", ARCHIVE_DATE), description, zipfile.ZIP_DEFLATED)
        for archived, file in sorted(sources.items()):
            archive.writestr(zipfile.ZipInfo(archived, ARCHIVE_DATE), file.read_bytes(), zipfile.ZIP_STORED)
    return path


def connectors_of(component: str, file: Path) -> dict[str, Connector]:
    """Return inputs, outputs and parameters of the FMU of a component by their names; UserError if it is none."""
    if not re.fullmatch(r"[A-Za-z_]\w*", component, re.ASCII):
        raise UserError(f"component is called {component!r}; allowed: letters, digits and underscores")
    if not file.is_file():
        raise UserError(f"FMU {str(file)!r} of component {component!r} does not exist")
    try:
        described: Any = read_model_description(str(file), validate=False)
    except Exception as error:  # whatever FMPy and its libraries raise for a file that is not an FMU
        raise UserError(f"file {str(file)!r} of component {component!r} is not an FMU: {error}") from error
    if described.fmiVersion != "2.0" or described.coSimulation is None:
        raise UserError(
            f"FMU {str(file)!r} of component {component!r} is of FMI {described.fmiVersion}"
            f"{'' if described.coSimulation else ' without co-simulation'}; allowed: co-simulation of FMI 2.0"
        )
    return {
        v.name: Connector(v.causality, v.type, v.unit or "", float(v.min or -inf), float(v.max or inf))
        for v in described.modelVariables
        if v.type in SSP_TYPES and v.causality in (*CONNECTED, "parameter")
    }


def _names_in_archive(files: Mapping[str, Path]) -> dict[str, str]:
    """Return the name in the archive of each component's file; a file that several components share is stored once."""
    names: dict[Path, str] = {}
    for component, file in files.items():
        names.setdefault(file.resolve(), f"resources/{component}.fmu")
    return {component: names[file.resolve()] for component, file in files.items()}


def _describe(
    name: str,
    sources: Mapping[str, str],
    connectors: Mapping[str, Mapping[str, Connector]],
    connections: Iterable[tuple[str, str]],
    values: Mapping[str, float],
    stop_time: float,
) -> Element:
    """Return the root of SystemStructure.ssd."""
    for prefix, address in NAMESPACES.items():
        register_namespace(prefix, address)
    root = Element(_tag("ssd:SystemStructureDescription"), version="1.0", name=name)
    system = SubElement(root, _tag("ssd:System"), name=name)
    parent = SubElement(system, _tag("ssd:Elements"))
    bound, checked = _bindings(values, connectors), _checked(connections, connectors)
    connected = {end for _, end in checked}
    for component, known in connectors.items():
        kind = {"name": component, "type": "application/x-fmu-sharedlibrary", "source": sources[component]}
        element = SubElement(parent, _tag("ssd:Component"), kind)
        listed = SubElement(element, _tag("ssd:Connectors"))
        for variable, connector in known.items():
            if connector.causality == "output" or (component, variable) in connected:
                place = SubElement(listed, _tag("ssd:Connector"), name=variable, kind=connector.causality)
                SubElement(place, _tag(f"ssc:{SSP_TYPES[connector.type]}"))
        if bound.get(component):
            _add_values(element, bound[component], known)
    if checked:
        parent = SubElement(system, _tag("ssd:Connections"))
        for (start, output), (end, variable) in checked:
            ends = {"startElement": start, "startConnector": output, "endElement": end, "endConnector": variable}
            SubElement(parent, _tag("ssd:Connection"), ends)
    SubElement(root, _tag("ssd:DefaultExperiment"), startTime="0.0", stopTime=repr(float(stop_time)))
    return root


def _tag(name: str) -> str:
    prefix, _, local = name.partition(":")
    return f"{{{NAMESPACES[prefix]}}}{local}"


def _add_values(element: Element, values: Mapping[str, float], known: Mapping[str, Connector]) -> None:
    """Add values of parameters, by the names of variables, to a component."""
    binding = SubElement(SubElement(element, _tag("ssd:ParameterBindings")), _tag("ssd:ParameterBinding"))
    parameters = SubElement(binding, _tag("ssd:ParameterValues"))
    parameters = SubElement(parameters, _tag("ssv:ParameterSet"), version="1.0", name="values")
    parameters = SubElement(parameters, _tag("ssv:Parameters"))
    for variable, value in values.items():
        kind = known[variable].type
        text = {"Real": repr(float(value)), "Boolean": str(bool(value)).lower()}.get(kind, f"{value}")
        SubElement(SubElement(parameters, _tag("ssv:Parameter"), name=variable), _tag(f"ssv:{kind}"), value=text)


def _bindings(
    values: Mapping[str, float], connectors: Mapping[str, Mapping[str, Connector]]
) -> dict[str, dict[str, float]]:
    """Return the values of each component's parameters, by the names of variables."""
    found: dict[str, dict[str, float]] = {}
    for name, value in values.items():
        component, variable = _find(name, "value of", ("parameter", "input"), connectors)
        known = connectors[component][variable]
        allowed, fits = {
            "Real": ("a finite number", is_finite(value)),
            "Boolean": ("True or False", isinstance(value, bool)),
        }.get(known.type, ("a whole number", is_whole(value)))
        if not fits or np.ndim(value):
            raise UserError(f"parameter {name!r} is {value!r}; allowed: {allowed}")
        if not known.least <= value <= known.most:
            raise UserError(f"parameter {name!r} is {value!r}; allowed by its FMU: {known.least:g} to {known.most:g}")
        found.setdefault(component, {})[variable] = value
    return found


def _find(
    name: str, role: str, causalities: tuple[str, ...], connectors: Mapping[str, Mapping[str, Connector]]
) -> tuple[str, str]:
    """Return component and variable of ``"component.variable"``; UserError if it has none of these causalities.

    ``role`` is what the name is given for.
    """
    component, _, variable = name.partition(".")
    if component not in connectors:
        raise UserError(f"{role} {name!r}: there is no component {component!r}{suggest(component, connectors)}")
    known = connectors[component]
    allowed = [own for own, connector in known.items() if connector.causality in causalities]
    if variable not in allowed:
        what = f"its causality is {known[variable].causality!r}" if variable in known else "there is no such variable"
        near = suggest(variable, allowed) if allowed else f"; component {component!r} has none"
        raise UserError(f"{role} {name!r}: {what}; allowed: {' or '.join(causalities)}{near}")
    return component, variable


def _checked(
    connections: Iterable[tuple[str, str]], connectors: Mapping[str, Mapping[str, Connector]]
) -> list[tuple[tuple[str, str], tuple[str, str]]]:
    """Return both ends of each connection as component and variable."""
    found: dict[tuple[str, str], tuple[str, str]] = {}
    for source, target in connections:
        start = _find(source, "start of a connection,", ("output",), connectors)
        end = _find(target, "end of a connection,", ("input",), connectors)
        if end in found:
            raise UserError(
                f"input {target!r} is connected to {'.'.join(found[end])!r} and to {source!r}; allowed: one output"
            )
        one, other = (connectors[component][variable] for component, variable in (start, end))
        if one.type != other.type:
            raise UserError(f"{source!r} is {one.type} and {target!r} is {other.type}; allowed: equal types")
        if one.unit and other.unit and one.unit != other.unit:
            raise UserError(
                f"{source!r} is in {one.unit} and {target!r} in {other.unit}; allowed: equal units. Convert the value "
                "in one of the FMUs"
            )
        found[end] = start
    return [(start, end) for end, start in found.items()]
