"""Limits of the joints of URDF files, as URDF defines them; MuJoCo reads some of them in another way."""

from __future__ import annotations

from xml.etree.ElementTree import Element

from .losses import Losses, listed, printable
from .tree import Tree, stop_stiffness


def apply_limits(robot: Element, tree: Tree, losses: Losses) -> None:
    """Set the ranges of the joints of a URDF file, and add what is lost or changed.

    URDF defines a missing end of a range as zero, and continuous joints without a range. MuJoCo omits ranges with one
    end, and uses those of continuous joints. It uses the absolute value of an effort, and no limit for zero.
    """
    numbers = {tree.name_of("JOINT", number): number for number in range(len(tree.of_joint))}
    unused: dict[str, list[str]] = {"continuous": [], "unlimited": [], "negative": [], "zero": []}
    for element in robot.findall("joint"):
        name, kind, limit = element.get("name", ""), element.get("type"), element.find("limit")
        if limit is None or kind == "fixed":
            continue
        given = {
            key: float(value) for key, value in limit.attrib.items() if key in ("lower", "upper", "effort", "velocity")
        }
        label = printable(name)
        if given.get("velocity"):
            losses.add("velocity limits", name)
        effort = given.get("effort")
        if effort is not None and effort <= 0.0:
            unused["negative" if effort < 0.0 else "zero"].append(label)
        has_range = "lower" in given or "upper" in given
        if name not in numbers:  # planar
            if has_range:
                losses.add("planar range", name)
            continue
        joint = tree.of_joint[numbers[name]][1]
        if not joint.has_one_coordinate:
            continue
        joint.lower = joint.upper = None
        lower, upper = given.get("lower", 0.0), given.get("upper", 0.0)
        if kind == "continuous":
            if lower or upper:
                unused["continuous"].append(label)
        elif not has_range:
            unused["unlimited"].append(label)
        elif lower < upper:
            joint.lower, joint.upper = lower, upper
            j = numbers[name]
            joint.stop_stiffness = stop_stiffness(tree.file.model, j, int(tree.file.model.jnt_dofadr[j]))
        else:
            losses.add("reversed range" if lower > upper else "empty range", name)
    for key, text, remedy in (
        (
            "continuous",
            "ranges of continuous joints are not used",
            "URDF defines none for them. Their type with a range is revolute",
        ),
        ("unlimited", "joints without a range move without limits", "URDF requires lower and upper of them"),
        ("negative", "negative efforts are used as their absolute values", "The limits of the drives are symmetric"),
        ("zero", "efforts of zero are not used as limits", "Set the limits of these drives in the controller"),
    ):
        if unused[key]:
            losses.note(f"{text} ({listed(unused[key])})", remedy)


def add_default_masses(tree: Tree, robot: Element, losses: Losses) -> None:
    """Add which links have their mass from the shapes of contact, since the file gives none."""
    found = []
    for link in robot.findall("link"):
        name = link.get("name", "")
        if link.find("inertial") is None and link.find("collision") is not None and name != "world":
            number = tree.number_of_body(name)
            if tree.file.model.body_mass[number] > 0.0 and tree.file.model.body_weldid[number] > 0:
                found.append(printable(name))
    if found:
        losses.note(
            f"links without <inertial> have the mass of their shapes of contact with 1000 kg/m^3 ({listed(found)})",
            "MuJoCo computes it. Give these links their inertia",
        )
