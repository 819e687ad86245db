"""Reading of XML files, and limits of their size, before MuJoCo compiles them."""

from __future__ import annotations

import re
from math import prod
from pathlib import Path
from xml.etree import ElementTree

from mbfmu.util.errors import UserError, short, shorten

MAX_BODIES = 20_000  # MuJoCo needs minutes for more: its time is proportional to the square of the number
MAX_CHAIN = 1000  # bodies in a row: the time of MuJoCo is proportional to the third power
MAX_FILE_SIZE = 200_000_000  # bytes
FORMATS = {"mujoco": "MJCF", "robot": "URDF"}
BODY_TAGS = {"MJCF": "body", "URDF": "link"}
COUNTED_TAGS = ("composite", "flexcomp")  # elements from which MuJoCo makes as many bodies as their count
MAX_ATTRIBUTES = 1000  # of an element: the time of XML parsers is proportional to the square of the number
XACRO_ELEMENT = "ros.org/wiki/xacro"  # part of the namespace of macros
XACRO_EXPRESSION = re.compile(r"\$[{(]")


def read_xml(path: Path) -> tuple[str, ElementTree.Element]:
    """Return the format of a file, URDF or MJCF, and its root element.

    Raises
    ------
    UserError
        The file cannot be read, is not XML of one of these formats, is too large, or contains macros of xacro.
    """
    content = _read(path)
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise UserError(f"{str(path)!r} is not valid XML: {error}") from error
    if root.tag not in FORMATS:
        raise UserError(
            f"{str(path)!r} has the root element <{shorten(root.tag)}>; allowed: <robot> of URDF and <mujoco> of MJCF"
        )
    kind = FORMATS[root.tag]
    _check_size(path, kind, root)
    _check_xacro(path, kind, root)
    return kind, root


def _read(path: Path) -> bytes:
    """Return the content of a file; entities are refused, since they may expand to any size."""
    try:
        size = path.stat().st_size
        if size > MAX_FILE_SIZE:
            raise UserError(f"{str(path)!r} has {size / 1e6:.0f} MB; allowed: up to {MAX_FILE_SIZE / 1e6:.0f} MB")
        text = path.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UserError(f"{str(path)!r} cannot be read: {reason}", "file-access") from error
    if not text.strip():
        raise UserError(f"{str(path)!r} is empty; allowed: a model in URDF or MJCF")
    if re.search(rb"<!\s*(DOCTYPE|ENTITY)", text, re.IGNORECASE):
        raise UserError(f"{str(path)!r} contains a document type or entities; remove <!DOCTYPE ...> from the file")
    try:
        text.decode("utf-8")
    except UnicodeDecodeError as error:
        raise UserError(
            f"{str(path)!r} is not UTF-8 text at byte {error.start}; convert it: iconv -f ISO-8859-1 -t UTF-8"
        ) from error
    return text


def _check_xacro(path: Path, kind: str, root: ElementTree.Element) -> None:
    """Refuse files that xacro has not expanded."""
    for element in root.iter():
        found = f"<{element.tag.rpartition('}')[2]}> of xacro" if XACRO_ELEMENT in str(element.tag) else ""
        for key, value in element.attrib.items():
            if kind == "URDF" and XACRO_EXPRESSION.search(value):
                found = f"the expression <{element.tag} {key}={short(value)}> of xacro"
        if found:
            raise UserError(f"{str(path)!r} contains {found}; expand the macros: xacro robot.urdf.xacro -o robot.urdf")


def _check_size(path: Path, kind: str, root: ElementTree.Element) -> None:
    """Refuse models that MuJoCo would need minutes or hours for."""
    count = _count_bodies(root, BODY_TAGS[kind])
    if count > MAX_BODIES:
        raise UserError(f"{str(path)!r} has {count:.6g} bodies; allowed: up to {MAX_BODIES}. Divide the model")
    for element in root.iter():
        if len(element.attrib) > MAX_ATTRIBUTES:
            raise UserError(
                f"{str(path)!r} has an element <{shorten(element.tag)}> of {len(element.attrib)} attributes; allowed: "
                f"up to {MAX_ATTRIBUTES}"
            )
    parents = {}
    for joint in root.findall("joint") if kind == "URDF" else ():
        child, parent = joint.find("child"), joint.find("parent")
        if child is not None and parent is not None:
            parents[child.get("link")] = parent.get("link")
    depths: dict[str | None, int] = {}
    for last in parents:
        chain, link = list[str | None](), last
        while link in parents and link not in depths and len(chain) <= len(parents):
            chain.append(link)
            link = parents.get(link)
        for number, name in enumerate(reversed(chain), depths.get(link, 0) + 1):
            depths[name] = number
    if max(depths.values(), default=0) > MAX_CHAIN:
        raise UserError(
            f"{str(path)!r} has a chain of {max(depths.values())} joints; allowed: up to {MAX_CHAIN}. Write such a "
            "chain as a loop in Python"
        )


def _count_bodies(root: ElementTree.Element, tag: str) -> float:
    """Return the number of bodies, those of <replicate> as often as they are repeated."""
    count, found = 0.0, [(root, 1.0)]
    while found:
        element, times = found.pop()
        if element.tag == "replicate":
            times *= _number_in(element)
        count += times * (element.tag == tag)
        if element.tag in COUNTED_TAGS:
            count += times * _number_in(element)
        found += [(child, times) for child in element]
    return count


def _number_in(element: ElementTree.Element) -> float:
    """Return the product of the numbers in the attribute ``count``; MuJoCo refuses what is not a number."""
    try:
        return prod(max(float(part), 1.0) for part in element.get("count", "1").split())
    except ValueError:
        return 1.0
