"""FMI unit definitions from unit names such as ``N.m`` or ``rad/s2``."""

from __future__ import annotations

import re
from collections import Counter

SI = {
    "kg": {"kg": 1},
    "m": {"m": 1},
    "s": {"s": 1},
    "rad": {"rad": 1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "Hz": {"s": -1},
}


def base_exponents(unit: str) -> dict[str, int]:
    """Return the exponents of kg, m, s and rad in a unit written as ``a.b2/c/d``.

    Raises
    ------
    KeyError
        An unknown unit symbol.
    """
    total: Counter[str] = Counter()
    for sign, part in re.findall(r"(^|[./])([A-Za-z]+-?\d*)", unit):
        symbol, power = re.fullmatch(r"([A-Za-z]+)(-?\d*)", part).groups()  # type: ignore[union-attr]
        factor = int(power or 1) * (-1 if sign == "/" else 1)
        for base, exponent in SI[symbol].items():
            total[base] += factor * exponent
    return {base: exponent for base, exponent in total.items() if exponent}
