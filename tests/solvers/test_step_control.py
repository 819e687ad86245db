"""What the step loops share: the step after a rejection, the options of a run, and queries that change nothing."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from solvers import Options
from solvers.compiled.kernel import records
from solvers.steppers.adams import formulas, hybrid, pece
from solvers.steppers.adams import loop as adams_loop
from solvers.steppers.adams import tree_loop as tree_adams_loop
from solvers.steppers.radau import loop as radau_loop
from solvers.steppers.step_control import MIN_STEP_RATIO, retry_step

RATE, TIME = 5.0, 2.0  # 1/s, s
JUMP = 1e-9 * TIME  # s, longest step that a signal allows ahead of a jump


@pytest.mark.parametrize(
    ("h", "max_step", "may_force", "expected"),
    [
        (1e-3, np.inf, True, (1e-3, False)),
        (0.5 * MIN_STEP_RATIO * TIME, np.inf, True, (0.0, False)),  # no signal jumps
        (0.5 * MIN_STEP_RATIO * TIME, JUMP, True, (MIN_STEP_RATIO * TIME, True)),
        (0.5 * MIN_STEP_RATIO * TIME, JUMP, False, (0.0, False)),  # it was tried, or another test refuses the step
        (MIN_STEP_RATIO * TIME, JUMP, True, (MIN_STEP_RATIO * TIME, True)),
        (np.nan, np.inf, True, (0.0, False)),
    ],
)
def test_the_step_after_a_rejected_one(
    h: float, max_step: float, may_force: bool, expected: tuple[float, bool]
) -> None:
    assert retry_step(h, RATE, max_step, TIME, may_force) == expected


def test_the_shortest_step_at_the_start_is_a_part_of_the_time_in_which_the_motion_changes() -> None:
    smallest = MIN_STEP_RATIO / RATE
    assert retry_step(2.0 * smallest, RATE, np.inf, 0.0, False) == (2.0 * smallest, False)
    assert retry_step(0.5 * smallest, RATE, np.inf, 0.0, False) == (0.0, False)


@pytest.mark.parametrize(
    ("loop", "set_options"),
    [
        (adams_loop, pece.set_options),
        (tree_adams_loop, pece.set_options),
        (radau_loop, radau_loop.set_options),
    ],
)
def test_every_loop_has_the_options_of_the_run(loop: ModuleType, set_options: Any) -> None:
    options = Options(rtol=1e-4, atol=1e-5, max_step=0.25, max_steps=321, energy_check=True)
    settings = records(1, loop.SETTINGS)
    set_options(options.record(), settings)
    assert settings["max_step"][0] == 0.25
    assert settings["max_steps"][0] == 321
    assert settings["energy_check"][0] == 1
    assert settings["atol"][0] == pytest.approx(0.1 * settings["rtol"][0], rel=1e-12)


def test_the_question_for_a_jump_of_the_energy_changes_nothing() -> None:
    control, settings = records(1, formulas.CONTROL), records(1, adams_loop.SETTINGS)
    settings["energy_jump"], settings["rtol"] = 0.01, 1e-6
    control["regime"], control["last_energy"], control["energy_scale"] = hybrid.LU, 10.0, 2.0
    before = control.copy()
    assert hybrid.has_energy_jump(10.1, 1.0, 0.0, control[0], settings[0])
    assert not hybrid.has_energy_jump(10.01, 1.0, 0.0, control[0], settings[0])
    assert control == before
    hybrid.record_energy_level(10.1, 3.0, control[0])
    assert (control["last_energy"][0], control["energy_scale"][0]) == (10.1, 3.0)
    assert not hybrid.has_energy_jump(10.1, 1.0, 0.0, control[0], settings[0])
