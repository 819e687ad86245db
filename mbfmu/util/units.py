"""Units: what names such as ``N.m`` or ``rad/s2`` mean in kg, m, s, rad and A."""

from __future__ import annotations

import re
from collections import Counter
from math import pi
from typing import NamedTuple

from .errors import UserError


class Unit(NamedTuple):
    """A product of powers of kg, m, s, rad and A, times a factor."""

    exponents: dict[str, int]
    factor: float


SYMBOLS = {
    "1": Unit({}, 1.0),
    "kg": Unit({"kg": 1}, 1.0),
    "m": Unit({"m": 1}, 1.0),
    "s": Unit({"s": 1}, 1.0),
    "rad": Unit({"rad": 1}, 1.0),
    "A": Unit({"A": 1}, 1.0),
    "V": Unit({"kg": 1, "m": 2, "s": -3, "A": -1}, 1.0),
    "N": Unit({"kg": 1, "m": 1, "s": -2}, 1.0),
    "J": Unit({"kg": 1, "m": 2, "s": -2}, 1.0),
    "W": Unit({"kg": 1, "m": 2, "s": -3}, 1.0),
    "Pa": Unit({"kg": 1, "m": -1, "s": -2}, 1.0),
    "Hz": Unit({"s": -1}, 1.0),
    "g": Unit({"kg": 1}, 1e-3),
    "mm": Unit({"m": 1}, 1e-3),
    "ms": Unit({"s": 1}, 1e-3),
    "min": Unit({"s": 1}, 60.0),
    "deg": Unit({"rad": 1}, pi / 180.0),
    "rev": Unit({"rad": 1}, 2.0 * pi),
    "kN": Unit({"kg": 1, "m": 1, "s": -2}, 1e3),
    "MPa": Unit({"kg": 1, "m": -1, "s": -2}, 1e6),
}

UNIT_FACTOR_PATTERN = re.compile(r"(^|[./])(1|[A-Za-z]+)(-?\d{1,2})?(?=[./]|$)")
DIVISOR_PATTERN = re.compile(r"/\(([^()/]+)\)")


def read_unit(text: str) -> Unit:
    """Return what a unit written as ``a.b2/c/d`` or ``a.b2/(c.d)`` means.

    Raises
    ------
    UserError
        It is written in another way, or a symbol of it is unknown.
    """
    flat = DIVISOR_PATTERN.sub(lambda m: "/" + m[1].replace(".", "/"), text) if isinstance(text, str) else ""
    parts = list(UNIT_FACTOR_PATTERN.finditer(flat)) if flat[:1] not in ("/", ".") else []
    if not parts or "".join(part.group() for part in parts) != flat or any(p.group(2) not in SYMBOLS for p in parts):
        raise UserError(f"unit is {text!r}; allowed: such as 'N.m', 'rad/s2' or 'N.m/(rad.s)', of {', '.join(SYMBOLS)}")
    total: Counter[str] = Counter()
    factor = 1.0
    for part in parts:
        sign, symbol, power = part.groups()
        exponent = int(power or 1) * (-1 if sign == "/" else 1)
        factor *= SYMBOLS[symbol].factor ** exponent
        for base, count in SYMBOLS[symbol].exponents.items():
            total[base] += count * exponent
    return Unit({base: count for base, count in total.items() if count}, factor)


def rate_unit(unit: str) -> str:
    """Return the unit of the rate of a quantity with this unit: ``m/s`` of ``m``, ``m/s2`` of ``m/s``."""
    whole, per, power = unit.rpartition("/s")
    if per and (power == "" or power.isdigit()):
        return f"{whole}/s{int(power or 1) + 1}"
    return "1/s" if unit == "1" else f"{unit}/s"
