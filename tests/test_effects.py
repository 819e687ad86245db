"""What effects of models with elastic bodies cost and change."""

from __future__ import annotations

from typing import Any

import pytest

from fmus.fourbar import FourBar
from mbfmu.simulation import Settings
from mbfmu.studies.effects import Entry, as_text, costs

DOWN = {"crank": -1.5, "coupler": 1.5, "rocker": -1.5}


@pytest.fixture(scope="module")
def entries() -> dict[str, Entry]:
    model = FourBar(coupler_modes=2)
    return {e.case: e for e in costs(model, Settings(tolerance=1e-8), 0.5, DOWN)}


def test_effects_of_the_fourbar(entries: dict[str, Entry]) -> None:
    assert list(entries) == ["as it is", "without gravity", "without elastic coupler", "with material damping"]
    bare, weightless, rigid, damped = entries.values()
    assert (bare.stability, weightless.stability, damped.stability) == ("undamped", "neutral", "undamped")
    assert weightless.outputs["energy"] == pytest.approx(0.0, abs=1e-12)
    assert weightless.outputs["crank.angle"] == pytest.approx(FourBar().start_angle)
    assert rigid.outputs["energy"] == pytest.approx(bare.outputs["energy"], abs=1e-3)
    assert damped.outputs["energy"] < bare.outputs["energy"] - 1e-2
    assert "coupler.deflection" not in rigid.outputs
    assert rigid.evaluation < bare.evaluation


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
    line = next(line for line in text.splitlines() if line.startswith("as it is"))
    assert "unstable" in line


def test_command_of_an_example(command: Any) -> None:
    code, out, _ = command("effects", "examples/spinning_arm.py:SpinningArm", "--stop-time=0.1")
    assert code == 0
    assert "tip.deflection" in out.splitlines()[0]
    assert [line.split("  ")[0] for line in out.splitlines()[2:]] == ["as it is", "without stiffening"]
    assert "unstable" in out.splitlines()[3]
    assert "unstable" not in out.splitlines()[2]


def test_unknown_coordinate_is_named(command: Any) -> None:
    code, _, err = command("effects", "fourbar", "--from=crnk=1")
    assert code == 2
    assert "model 'fourbar' has no coordinate 'crnk'" in err
