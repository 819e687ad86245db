"""Inputs stay at their start values in checks and comparisons, which report their names."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import mbfmu as mb
from mbfmu.mechanics import Variable
from mbfmu.studies.held_inputs import describe_held_inputs

MODEL = """
from dataclasses import dataclass
import mbfmu as mb

@dataclass(frozen=True, kw_only=True)
class Car(mb.Model):
    '''A wheel on a road that an input moves.'''
    stop_time = 0.2

    def build(self):
        m = mb.Mechanism(gravity=(0, -9.81, 0))
        height = mb.Input(name="height", unit="m")
        road = m.body("road", m.ground, mb.Translational(axis="y", drive=height), mass=1.0)
        car = m.body("car", road, mb.Translational(axis="y"), mass=1.0)
        m.force("spring", mb.JointSpring(stiffness=100.0), car)
        m.output("car.y", car.position("y"), "height of the car")
        return m
"""
SAYS = "other values of input 'height' (0 m), which kept this value"


@pytest.fixture
def car(tmp_path: Path) -> str:
    file = tmp_path / "car.py"
    file.write_text(MODEL)
    return f"{file}:Car"


def test_a_check_names_inputs_that_do_not_move(car: str, command: Callable[..., Any]) -> None:
    code, out, _ = command("check", car)
    assert code == 0
    assert f"not examined: {SAYS}" in out


@pytest.mark.parametrize("target", [(), ("--target", "1e-2")])
def test_a_comparison_names_inputs_that_do_not_move(
    target: tuple[str, ...], car: str, command: Callable[..., Any], tmp_path: Path
) -> None:
    more = () if target else ("-o", str(tmp_path), "--repeats", "1")
    code, out, _ = command("compare", car, "--tolerance", "1e-4", "--solver", "adams", *more, *target)
    assert code == 0
    assert f"not examined: {SAYS}" in out


def test_without_inputs_nothing_is_reported() -> None:
    assert describe_held_inputs([]) == []
    assert "input" not in mb.check(still(), stop_time=0.1).as_text()


def still() -> mb.Mechanism:
    m = mb.Mechanism(gravity=(0, -9.81, 0))
    m.body("bar", m.ground, mb.Revolute(), **mb.rod(mass=1.0, length=1.0))
    return m


def test_of_many_inputs_the_first_are_named() -> None:
    (told,) = describe_held_inputs([Variable(f"u{k}", "N", "", start=float(k)) for k in range(5)])
    assert told.text.startswith(
        "not examined: other values of inputs 'u0' (0 N), 'u1' (1 N), 'u2' (2 N) and 2 more, which kept this"
    )
