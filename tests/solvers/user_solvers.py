"""The solver of the documentation, and an oscillator that it integrates."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.mechanics import JointSpring, Translational
from solvers import OneStepSolver
from solvers.steppers import plugins

PAGE = (Path(__file__).parents[2] / "docs" / "extending.md").read_text()
(TEXT,) = re.findall(r"```python file=rk4.py\n(.*?)```", PAGE, flags=re.DOTALL)
SPACE: dict[str, Any] = {"__name__": "rk4"}
exec(compile(TEXT, "rk4.py", "exec"), SPACE)
RK4: type[OneStepSolver] = SPACE["RK4"]

MASS, STIFFNESS, AMPLITUDE = 2.0, 50.0, 0.3
RATE = np.sqrt(STIFFNESS / MASS)


@pytest.fixture(autouse=True, scope="module")
def classes_of_one_file() -> Iterator[None]:
    """Other tests of this process may have given classes of the same names: each file starts without them."""
    before = plugins._given.copy()
    plugins._given.clear()
    yield
    plugins._given.clear()
    plugins._given.update(before)


def oscillator(damping: float = 0.0) -> mb.Mechanism:
    m = mb.Mechanism(gravity=(0, 0, 0))
    slider = m.body("slider", m.ground, Translational(axis="x", start=AMPLITUDE), mass=MASS)
    m.force("spring", JointSpring(stiffness=STIFFNESS, damping=damping), slider)
    m.output("x", slider.coordinate())
    return m
