"""The steps before a run that have everything compiled integrate nothing; unsuitable solvers are refused at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from fmus.fourbar import FourBar
from fmus.governor import Governor
from mbfmu.mechanics import CompiledMechanism
from mbfmu.modeling.settings import Settings
from mbfmu.session.simulation import Simulation
from mbfmu.session.warmup import MAX_WARMUP_STEPS, compile_kernels
from mbfmu.util.errors import UserError
from solvers import stepper
from solvers.options import Options
from solvers.steppers import MAX_RADAU_COORDINATES, describe_refusal


def chain(count: int, length: float = 1.0, gravity: float = 9.81, stiffness: float = 0.0) -> mb.Mechanism:
    """Return a chain of rods suspended from the ground, released at rest."""
    m = mb.Mechanism(gravity=(0, -gravity, 0))
    body = m.ground
    for k in range(count):
        joint = mb.Revolute(at=(length if k else 0.0, 0, 0), start=0.0 if k else -1.3)
        body = m.body(f"b{k}", body, joint, **mb.rod(mass=1.0, length=length))
    if stiffness:
        m.force("spring", mb.JointSpring(stiffness=stiffness, damping=1e-6 * stiffness), body)
    return m


FAMILY: dict[str, Callable[[], mb.Mechanism]] = {
    "a pendulum": lambda: chain(2),
    "of a millimeter": lambda: chain(2, 1e-3),
    "of a kilometer": lambda: chain(2, 1e3),
    "weightless": lambda: chain(2, gravity=0.0),
    "pulled by much": lambda: chain(2, gravity=1e9),
    "stiff": lambda: chain(2, stiffness=1e9),
    "four-bar": lambda: FourBar().build(),
    "governor, driven": lambda: Governor().build(),
    "59 coordinates": lambda: chain(59),
    "61 coordinates": lambda: chain(61),
}


@pytest.mark.parametrize("t0", [0.0, 10.0])
@pytest.mark.parametrize("name", FAMILY)
def test_a_trial_integrates_nothing(name: str, t0: float) -> None:
    """It takes a few steps at any size and stiffness, all goes well, and no coordinate moves by a tolerance."""
    compiled = CompiledMechanism(FAMILY[name]())
    q, v = compiled.assemble(t0)
    for solver in ("adams", "ida", "radau", "esdirk"):
        if describe_refusal(solver, compiled.system):
            continue
        trial = stepper(solver, compiled.system, t0, q, v, Options(rtol=1e-8, max_steps=MAX_WARMUP_STEPS))
        assert compile_kernels(trial, compiled, len(compiled.outputs) + 2), solver
        assert trial.statistics.steps <= 2 * MAX_WARMUP_STEPS, solver
        assert trial.t > t0, solver
        moved = np.abs(trial.q - q) / np.maximum(1.0, np.abs(q))
        assert np.max(moved) < 2e-5, solver


def test_a_trial_does_not_depend_on_what_the_run_is_asked_for() -> None:
    """A run that may take one step, or none of any length, starts as others do."""
    for changes in ({"max_steps": 1}, {"max_step": 1e-9}, {"tolerance": 1e-12}):
        assert Simulation(chain(2), replace(Settings(solver="adams"), **changes)).t == 0.0


@pytest.mark.parametrize("count", [MAX_RADAU_COORDINATES, MAX_RADAU_COORDINATES + 1])
def test_radau_is_refused_where_its_matrices_are_too_large(count: int) -> None:
    compiled = CompiledMechanism(chain(count))
    refused = describe_refusal("radau", compiled.system)
    if count <= MAX_RADAU_COORDINATES:
        assert refused == ""
        return
    assert refused == (
        f"solver 'radau' is given {count} joint coordinates and 0 constraints; allowed: at most 200 coordinates; use "
        "'ida', or 'adams' if the model is not stiff [unsuitable-solver]"
    )
    assert describe_refusal("ida", compiled.system) == describe_refusal("adams", compiled.system) == ""
    with pytest.raises(UserError, match="solver 'radau' is given"):
        Simulation(chain(count), Settings(solver="radau"))


def test_a_run_of_the_feeder_by_radau_is_refused_at_once(
    command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[object] = []
    monkeypatch.setattr("solvers.steppers.dense.DenseStepper.__init__", lambda *_: started.append(_))
    code, _, err = command("run", "feeder", "--solver", "radau", "--direct")
    assert code == 2
    assert "solver 'radau' is given" in err
    assert "use 'ida'" in err
    assert started == []
