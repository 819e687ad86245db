"""What becomes of each element and attribute of a URDF file.

MuJoCo ignores elements and attributes of URDF files that it does not recognize, misspelled ones too. The table has
those that it reads; all others are reported.
"""

from __future__ import annotations

from xml.etree.ElementTree import Element

from .losses import Losses

_ORIGIN = {"origin": "xyz rpy"}
_GEOMETRY = {
    "geometry": "",
    "geometry/box": "size",
    "geometry/sphere": "radius",
    "geometry/cylinder": "radius length",
    "geometry/capsule": "radius length",
    "geometry/mesh": "filename scale",
}
_MATERIAL = {"material": "name", "material/color": "rgba", "material/texture": "filename"}


def _inside(parent: str, children: dict[str, str]) -> dict[str, str]:
    """Return elements with the path of their parent."""
    return {f"{parent}/{child}": attributes for child, attributes in children.items()}


READ_ELEMENTS = {  # elements, and their attributes, that are imported or have no effect on the motion
    "": "name version",
    **_MATERIAL,
    "link": "name type",
    "link/inertial": "",
    **_inside("link/inertial", _ORIGIN | {"mass": "value", "inertia": "ixx ixy ixz iyy iyz izz"}),
    "link/visual": "name",
    **_inside("link/visual", _ORIGIN | _GEOMETRY | _MATERIAL),
    "link/collision": "name",
    **_inside("link/collision", _ORIGIN | _GEOMETRY),
    "joint": "name type",
    **_inside(
        "joint",
        _ORIGIN
        | {
            "parent": "link",
            "child": "link",
            "axis": "xyz",
            "dynamics": "damping friction",
            "limit": "lower upper effort velocity",
            "mimic": "joint multiplier offset",
        },
    ),
    "mujoco": "",
}
OF_MUJOCO = frozenset({"compiler", "option", "size"})  # children of <mujoco>, which MuJoCo reads
FOREIGN_ELEMENTS = frozenset(  # elements for other programs, or about the measurement of coordinates
    {
        "transmission",
        "gazebo",
        "sensor",
        "joint/calibration",
        "joint/hardwareInterface",
        "link/sensor",
        "link/self_collision_checking",
    }
)


def add_elements(robot: Element, losses: Losses) -> None:
    """Add the elements and attributes of a URDF file that are not read."""
    others: dict[str, int] = {}
    found = [(robot, "", "")]
    for element, path, owner in found:  # which becomes longer meanwhile
        unknown = [key for key in element.attrib if key not in READ_ELEMENTS[path].split()]
        for key in unknown:
            losses.add("unknown", f"{owner}<{element.tag} {key}=>")
        for child in element:
            tag = str(child.tag)
            inner = f"{path}/{tag}" if path else tag
            if path == "mujoco" and tag in OF_MUJOCO:
                continue
            if inner in FOREIGN_ELEMENTS:
                others[tag] = others.get(tag, 0) + 1
            elif inner == "joint/safety_controller":
                losses.add("safety", element.get("name", ""))
            elif inner in READ_ELEMENTS:
                name = child.get("name") if not path else None
                found.append((child, inner, f"{tag} {name}: " if name else owner))
            else:
                losses.add("unknown", f"{owner}<{tag.rpartition('}')[2]}>")
    if others:
        counted = ", ".join(f"{number} <{tag}>" for tag, number in sorted(others.items()))
        losses.note(f"elements for other programs are not used ({counted})", "They have no part in the motion")
