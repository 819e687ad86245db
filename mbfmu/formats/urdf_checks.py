"""Errors of URDF files that are found before MuJoCo reads them, since its messages do not name what is wrong."""

from __future__ import annotations

from collections import Counter
from xml.etree.ElementTree import Element

from mbfmu.util.errors import UserError, shorten, suggest

from .losses import listed, printable

JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar", "spherical")
WITH_NUMBERS = frozenset(  # elements
    "origin mass inertia box sphere cylinder capsule mesh axis dynamics limit mimic".split()
)
NUMBER_COUNTS = {  # attributes with numbers, and how many
    **dict.fromkeys(("xyz", "rpy", "size", "scale"), 3),
    **dict.fromkeys(("value", "ixx", "ixy", "ixz", "iyy", "iyz", "izz", "radius", "length"), 1),
    **dict.fromkeys(("lower", "upper", "effort", "velocity", "damping", "friction", "multiplier", "offset"), 1),
}


def check_urdf(what: str, robot: Element) -> None:
    """Raise UserError if links and joints do not form trees, or a number is not a number.

    Parameters
    ----------
    what
        The file, for messages.
    robot
        Root element.
    """
    links, joints = robot.findall("link"), robot.findall("joint")
    for elements, tag in ((links, "link"), (joints, "joint")):
        _check_names(what, elements, tag)
    names = {link.get("name", "") for link in links}
    parents: dict[str, tuple[str, str]] = {}  # joint and parent, by the child
    for joint in joints:
        _check_type(what, joint)
        name = printable(joint.get("name", ""))
        parent, child = (_link_of(what, joint, role, names) for role in ("parent", "child"))
        if child in parents:
            raise UserError(
                f"{what}: link {printable(child)!r} is the child of the joints {printable(parents[child][0])!r} and "
                f"{name!r}; allowed: one joint, since URDF describes trees. Remove one of them, and close the loop "
                "when importing: --close A B"
            )
        parents[child] = joint.get("name", ""), parent
    _check_cycles(what, names, parents)
    _check_mimics(what, joints)
    for element in (*links, *joints):
        _check_numbers(what, element)


def _check_names(what: str, elements: list[Element], tag: str) -> None:
    """Raise UserError if a link or joint has no name, or the name of another one."""
    for number, element in enumerate(elements, 1):
        if not element.get("name"):
            raise UserError(f"{what}: <{tag}> number {number} has no name; give it one")
    counts = Counter(element.get("name", "") for element in elements)
    repeated = [printable(name) for name, count in counts.items() if count > 1]
    if repeated:
        raise UserError(f"{what}: several {tag}s have the same name ({listed(repeated)}); give each its own name")


def _check_type(what: str, joint: Element) -> None:
    """Raise UserError for a type of joint that URDF does not define."""
    kind = joint.get("type", "")
    if kind not in JOINT_TYPES:
        name = printable(joint.get("name", ""))
        raise UserError(f"{what}: joint {name!r} has the type {printable(kind)!r}{suggest(kind, JOINT_TYPES)}")


def _link_of(what: str, joint: Element, role: str, names: set[str]) -> str:
    """Return the parent or the child of a joint; raises UserError if it is missing or no link of the file."""
    name, element = printable(joint.get("name", "")), joint.find(role)
    link = "" if element is None else element.get("link", "")
    if not link:
        raise UserError(f"{what}: joint {name!r} has no {role}; write <{role} link='...'/>")
    if link not in names:
        raise UserError(
            f"{what}: the {role} of joint {name!r} is {printable(link)!r}, which is no link of the file"
            f"{suggest(link, names)}"
        )
    return link


def _check_cycles(what: str, names: set[str], parents: dict[str, tuple[str, str]]) -> None:
    """Raise UserError if each of some links is the child of another one of them."""
    ends = set(names - set(parents))  # links from which the ground is reached
    for first in names:
        way, link = list[str](), first
        while link not in ends and link not in way:
            way.append(link)
            link = parents[link][1]
        if link in way:
            joints = [printable(parents[inside][0]) for inside in way[way.index(link) :]]
            raise UserError(
                f"{what}: joints form a cycle ({listed(joints)}); allowed: trees. Remove one of these joints, and "
                "close the loop when importing: --close A B"
            )
        ends.update(way)


def _check_mimics(what: str, joints: list[Element]) -> None:
    """Raise UserError if a joint follows a joint that does not exist, or itself."""
    names = {joint.get("name", "") for joint in joints}
    for joint in joints:
        mimic = joint.find("mimic")
        leader = "" if mimic is None else mimic.get("joint", "")
        if mimic is not None and (leader not in names or leader == joint.get("name")):
            name = printable(joint.get("name", ""))
            raise UserError(
                f"{what}: joint {name!r} follows the joint {printable(leader)!r}; allowed: another joint of the file"
                f"{suggest(leader, names - {joint.get('name', '')})}"
            )


def _check_numbers(what: str, owner: Element) -> None:
    """Raise UserError if an attribute of a link or a joint does not contain the numbers that it must contain."""
    for element in owner.iter():
        for key, text in element.attrib.items():
            count = NUMBER_COUNTS.get(key)
            if count is None or element.tag not in WITH_NUMBERS:
                continue
            parts = text.split()
            if len(parts) != count or not all(map(is_number, parts)):
                numbers = "a number" if count == 1 else f"{count} numbers separated by spaces"
                place = f"<{printable(str(element.tag))} {key}={shorten(text)!r}>"
                name = printable(owner.get("name", ""))
                raise UserError(f"{what}: {place} of {owner.tag} {name!r}; allowed: {numbers}, with a point as in 0.5")


def is_number(text: str) -> bool:
    """Whether text is a number as MuJoCo reads it."""
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text
