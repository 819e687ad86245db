"""Names of units."""

from __future__ import annotations

from math import pi
from typing import Any

import pytest

from mbfmu.util.errors import UserError
from mbfmu.util.units import read_unit


@pytest.mark.parametrize(
    ("text", "exponents", "factor"),
    [
        ("N.m", {"kg": 1, "m": 2, "s": -2}, 1.0),
        ("rad/s2", {"rad": 1, "s": -2}, 1.0),
        ("N.m.s/rad", {"kg": 1, "m": 2, "s": -1, "rad": -1}, 1.0),
        ("N.m/(rad.s)", {"kg": 1, "m": 2, "s": -3, "rad": -1}, 1.0),
        ("mm/(s2.m)/kg", {"s": -2, "kg": -1}, 1e-3),
        ("1/s", {"s": -1}, 1.0),
        ("m/m", {}, 1.0),
        ("rev/min", {"rad": 1, "s": -1}, pi / 30.0),
        ("kg.mm-2", {"kg": 1, "m": -2}, 1e6),
    ],
)
def test_what_a_unit_means(text: str, exponents: dict[str, int], factor: float) -> None:
    unit = read_unit(text)
    assert unit.exponents == exponents
    assert unit.factor == pytest.approx(factor, rel=1e-15)


@pytest.mark.parametrize("text", ["furlong", "", "N m", "m//s", "m2x", "/s", "m.", "(N.m)/s", "N/(m/s)", 3, None])
def test_what_is_no_unit(text: Any) -> None:
    with pytest.raises(UserError, match=r"unit is .* allowed: such as"):
        read_unit(text)
