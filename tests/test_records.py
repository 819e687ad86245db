"""Records: one declaration gives the fields in memory and the static types of kernels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
from mypy import api

from mbfmu import Mechanism, UserError, simulate
from mbfmu.mechanics import CompiledMechanism, Joint
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Integers, Mat3, Reals, Record, Table, Vec3, f8, i8

MISSPELLED = Path(__file__).parent / "typed" / "misspelled.py"


class Wheel(Record):
    """A wheel."""

    number: i8
    mass: f8
    center: Vec3
    axes: Mat3
    spokes: Annotated[Reals, (4, 2)]
    neighbors: Annotated[Integers, (2,)]


class Tire(Wheel):
    """A wheel with air."""

    pressure: f8


@kernel
def total(wheels: Table[Wheel]) -> float:
    """Mass of all wheels, and the sum of their heights."""
    found = 0.0
    for k in range(wheels.shape[0]):
        found += wheels[k].mass + wheels[k].center[1]
    return found


def test_a_declaration_gives_the_fields_in_memory() -> None:
    expected = [
        ("number", np.int64), ("mass", np.float64), ("center", np.float64, (3,)), ("axes", np.float64, (3, 3)),
        ("spokes", np.float64, (4, 2)), ("neighbors", np.int64, (2,)),
    ]  # fmt: skip
    assert Wheel.dtype == np.dtype(expected, align=True)
    assert Tire.dtype == np.dtype([*expected, ("pressure", np.float64)], align=True)


def test_kernels_read_the_fields() -> None:
    wheels = Wheel.zeros(3)
    wheels["mass"] = 2.0, 3.0, 4.0
    wheels["center"][1] = 0.0, 0.5, 0.0
    assert total(wheels) == 9.5


class InclineRecord(Record):
    """Slope of a straight line in the x-y plane, and where it begins."""

    slope: f8
    begin: Vec3


@kernel
def place(joint: InclineRecord, qi: int, state: Any) -> None:
    """A slider on a straight line."""
    q, rel = state.q, state.rel[0]
    for i in range(3):
        rel.S[0, i], rel.S[0, 3 + i] = 0.0, 0.0
        for j in range(3):
            rel.R[i, j] = 1.0 if i == j else 0.0
        rel.p[i] = joint.begin[i]
    rel.S[0, 0], rel.S[0, 1] = 1.0, joint.slope
    rel.p[0] += q[qi]
    rel.p[1] += joint.slope * q[qi]


@dataclass(frozen=True, kw_only=True)
class Incline(Joint):
    """A straight line; coordinate: x."""

    record = InclineRecord
    place = place
    nq, nv = 1, 1
    coordinates, units = ("",), ("m",)

    slope: Any
    begin: Any = (0.0, 0.0, 0.0)


def inclined(**given: Any) -> Mechanism:
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    slider = m.body("slider", m.ground, Incline(**given), mass=2.0)
    m.output("x", slider.position("x"))
    m.output("y", slider.position("y"))
    return m


def test_parameters_with_the_name_of_a_field_are_written_to_the_record() -> None:
    record = CompiledMechanism(inclined(slope=-0.75, begin=(0.1, 0.2, 0.3))).records(Incline)
    assert record["slope"].tolist() == [-0.75]
    assert record["begin"].tolist() == [[0.1, 0.2, 0.3]]
    found = simulate(inclined(slope=-0.75, begin=(0.1, 0.2, 0.3)), 1.0, tolerance=1e-8)
    fallen = 0.5 * 9.81 * 0.6  # down the line at 3 : 4, by g sin(angle) t^2 / 2
    assert found["x"][-1] == pytest.approx(0.1 + 0.8 * fallen, rel=1e-6)
    assert found["y"][-1] == pytest.approx(0.2 - 0.6 * fallen, rel=1e-6)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"slope": "steep"}, r"slope of body 'slider' is 'steep'; allowed: a number, or a method fill of Incline that"),
        ({"slope": 1.0, "begin": (1.0, 2.0)}, r"begin of body 'slider' is .*; allowed: numbers of the shape \(3,\)"),
        ({"slope": None}, r"slope of body 'slider' is None; allowed: a number"),
    ],
)
def test_parameters_that_do_not_fit_a_field_are_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        CompiledMechanism(inclined(**given))


def test_a_misspelled_field_is_an_error_of_mypy() -> None:
    found, _, status = api.run(["--strict", "--no-incremental", "--follow-imports=silent", str(MISSPELLED)])
    assert status == 1
    assert '"Ball" has no attribute "mas"' in found
    assert found.count("error:") == 1, found
