"""Records: one declaration gives the fields in memory and the static types of kernels."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from mypy import api

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


def test_a_misspelled_field_is_an_error_of_mypy() -> None:
    found, _, status = api.run(["--strict", "--no-incremental", "--follow-imports=silent", str(MISSPELLED)])
    assert status == 1
    assert '"Ball" has no attribute "mas"' in found
    assert found.count("error:") == 1, found
