"""What effects of models with flexible bodies cost and change."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest

from fmus.fourbar import FourBar
from fmus.governor import Governor
from mbfmu.session.simulation import Settings
from mbfmu.studies.effects import Case, Entry, advice, as_text, cases, costs
from mbfmu.util.errors import UserError

DOWN = {"crank": -1.5, "coupler": 1.5, "rocker": -1.5}


@pytest.fixture(scope="module")
def entries() -> dict[str, Entry]:
    model = FourBar(coupler_modes=2)
    return {e.case: e for e in costs(model, Settings(tolerance=1e-8), 0.5, DOWN)}


def test_effects_of_the_fourbar(entries: dict[str, Entry]) -> None:
    assert list(entries) == ["as defined", "without gravity", "without elastic coupler", "with material damping"]
    bare, weightless, rigid, damped = entries.values()
    assert (bare.stability, weightless.stability, damped.stability) == ("undamped", "neutral", "undamped")
    assert weightless.result["crank.angle"] == pytest.approx(FourBar().start_angle)
    assert rigid.result["energy"][-1] == pytest.approx(bare.result["energy"][-1], abs=1e-3)
    assert damped.result["energy"][-1] < bare.result["energy"][-1] - 1e-2
    assert max(bare.changes.values()) < 1e-4  # what the tolerance leaves open
    assert "coupler.deflection" not in rigid.changes
    assert rigid.evaluation.median < bare.evaluation.median
    assert bare.values == "gravity = 9.81 m/s2, coupler_modes = 2"
    assert (weightless.values, damped.values) == ("gravity = 0 m/s2", "coupler_damping = 0.0005 s")


def test_changes_are_those_over_the_whole_run(entries: dict[str, Entry]) -> None:
    bare, weightless, *_ = entries.values()
    moved = np.abs(bare.result["crank.rate"] - weightless.result["crank.rate"])
    assert weightless.changes["crank.rate"] == pytest.approx(moved.max() / np.ptp(bare.result["crank.rate"]))
    assert bare.scale["crank.rate"] == pytest.approx(np.ptp(bare.result["crank.rate"]))


@pytest.mark.parametrize(
    ("was_on", "change", "noise", "message"),
    [
        (False, 4e-4, 0.0, "drag changes no output by more than 0.1 %: leave it off"),
        (True, 4e-4, 0.0, "drag changes no output by more than 0.1 %: switch it off"),
        (False, 0.2, 1e-4, "drag changes tip.y by 20 % of its range: switch it on where it acts"),
        (True, 0.2, 1e-4, "drag changes tip.y by 20 % of its range: keep it on"),
        (False, 2e-3, 3e-3, "by more than the integration error, 0.3 % of the range of tip.y: use a smaller"),
    ],
)
def test_advice(entries: dict[str, Entry], was_on: bool, change: float, noise: float, message: str) -> None:
    case = Case(name="with drag", effect="drag", was_on=was_on, values="", model=FourBar())
    found = {"tip.y": change, "energy": 0.5}
    assert message in advice(case, entries["as defined"].result, found, {"tip.y": noise}, ["tip.y"])


def test_first_frequency_is_that_of_an_oscillation(entries: dict[str, Entry]) -> None:
    bare, weightless, rigid, _ = entries.values()
    model = FourBar()
    bars = model.crank_mass + model.rocker_mass
    square = (0.5 * bars + model.coupler_mass) * model.gravity / (bars / 3.0 + model.coupler_mass)
    assert bare.frequency == pytest.approx(square**0.5 / 6.283185307, rel=1e-9)
    assert rigid.frequency == pytest.approx(bare.frequency)
    assert weightless.frequency is not None
    assert weightless.frequency > 5.0  # of the coupler, not of the swing that gravity no longer drives


def test_unstable_state_has_no_first_frequency() -> None:
    model = FourBar()
    text = as_text(costs(model, Settings(), 0.01), ["crank.angle"])
    line = next(line for line in text.splitlines() if line.startswith("as defined"))
    assert "unstable" in line


def test_command_of_an_example(command: Any) -> None:
    code, out, _ = command("effects", "examples/spinning_arm.py:SpinningArm", "--stop-time=0.1")
    assert code == 0
    assert "tip.deflection" in out.splitlines()[0]
    assert [line.split("  ")[0] for line in out.splitlines()[2:4]] == ["as defined", "without stiffening"]
    assert "unstable" in out.splitlines()[3]
    assert "unstable" not in out.splitlines()[2]


def test_unknown_coordinate_is_named(command: Any) -> None:
    code, _, err = command("effects", "fourbar", "--from=crnk=1")
    assert code == 2
    assert "model 'fourbar' has no coordinate 'crnk'" in err


def test_an_effect_without_values_is_refused() -> None:
    @dataclass(frozen=True, kw_only=True)
    class Odd(Governor):
        """Effects as a list of names."""

        effects: ClassVar[Any] = {"damper": ("damping",)}

    with pytest.raises(UserError, match=r"'damper' is \('damping',\); allowed: values that switch it on"):
        cases(Odd())
