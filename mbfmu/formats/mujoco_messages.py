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
)


def message_of(error: Exception) -> str:
    """Return an error of MuJoCo on one line, with what to do about it if that is in REMEDIES."""
    lines = [line.strip() for line in str(error).splitlines()]
    text = "; ".join(line for line in lines if line and not line.startswith("The static bodies"))
    text = re.sub(r"^(XML )?Error: ", "", text)
    remedy = next((remedy for pattern, remedy in REMEDIES if re.search(pattern, text)), "")
    return shorten(f"{text}. {remedy}" if remedy else text)
