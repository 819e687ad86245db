"""Messages of the compiler of MuJoCo, with what to do about them."""

from __future__ import annotations

import re

from mbfmu.util.errors import shorten

REMEDIES = (  # pattern of a message, and what to do
    (
        r"larger than mjMINVAL",
        "MuJoCo requires a mass and moments of inertia above 1e-15 kg and 1e-15 kg m^2 of bodies that move. Give this "
        "body a mass and an inertia (<inertial>), fix it to its parent, or write a file of very small bodies in other "
        "units, such as mm and g",
    ),
    (r"A \+ B >= C", "Correct the inertia: no principal moment is larger than the sum of the two others"),
    (r"repeated name", "Give each element of this kind its own name"),
    (r"bad format|enough data|too much data", "Write all numbers with a point, separated by spaces"),
    (r"Schema violation", "Check the spelling and the place of the element in the reference of MJCF"),
    (r"invalid keyword", "Use a keyword of MJCF; joints are free, ball, slide or hinge"),
    (r"unknown element|not found|unknown transmission|unknown default class", "Check this name, or add the element"),
    (r"free joint can only", "Move this body to the ground, or use other joints"),
    (r"zero quaternion|too small", "Give a vector other than zero"),
    (r"Error opening file", "Add this file, or correct its path"),
    (r"more than 6 dofs|ball followed by", "Divide the joints between several bodies"),
    (r"missing element|missing attribute|required", "Add what is missing"),
)


def message_of(error: Exception) -> str:
    """Return an error of MuJoCo on one line, with what to do about it if that is in REMEDIES."""
    lines = [line.strip() for line in str(error).splitlines()]
    text = "; ".join(line for line in lines if line and not line.startswith("The static bodies"))
    text = re.sub(r"^(XML )?Error: ", "", text)
    remedy = next((remedy for pattern, remedy in REMEDIES if re.search(pattern, text)), "")
    return shorten(f"{text}. {remedy}" if remedy else text)
