"""A run of ``ida`` that takes far more steps than another solver would: the remark comes early, and is true."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from fmus.sheet import Sheet
from mbfmu.cli import main
from mbfmu.mechanics import JointSpring, Mechanism, Revolute, rod
from mbfmu.modeling.settings import Settings
from mbfmu.session import step_count
from mbfmu.session.run import communication_points, run
from mbfmu.session.simulation import Simulation
from solvers import Options, stepper
from solvers.compiled.kernel import COMPILED

pytestmark = pytest.mark.skipif(not COMPILED, reason="takes minutes without a compiler")

EARLY = 2000  # steps of a run that would take 100 000
STRIP: dict[str, Any] = {"nx": 15, "nz": 3, "width": 0.02}


def strip() -> Sheet:
    """A clamped strip without damping and gravity, which a force bends."""
    return Sheet(**STRIP, load="tip", gravity_y=0.0)


def release(simulation: Simulation) -> None:
    """Take the force away at the start."""
    if simulation.t == 0.0:
        simulation.set_input("force.y", 0.0)


def released(solver: str, stop_time: float) -> mb.Result:
    """Return the run of a strip that is released bent."""
    return mb.simulate(
        strip(), stop_time, solver=solver, interval=0.1 * stop_time, watch=release, inputs={"force.y": 2e-3},
        start_at_equilibrium=True,
    )  # fmt: skip


def links(stiffness: float = 1e3) -> Mechanism:
    """70 rods on undamped springs, N m/rad: a chain of 1 m and 1 kg, on a free hinge."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    body = m.ground
    for k in range(70):
        joint = Revolute(at=(1.0 / 70 if k else 0.0, 0.0, 0.0), start=0.0 if k else -0.3, fixed=True)
        body = m.body(f"link{k}", body, joint, **rod(mass=1.0 / 70, length=1.0 / 70))
        if k:
            m.force(f"spring{k}", JointSpring(stiffness=stiffness), body)
    return m


def test_an_undamped_strip_released_bent_takes_no_more_steps_than_its_motion() -> None:
    """Tolerances of rates came from rounding at rest: 105 806 steps for 0.1 s, and 2998 by esdirk."""
    result = released("ida", 0.01)
    assert not result.failure
    assert result.statistics.steps < 1000
    assert not any("has taken" in text for text in map(str, result.diagnostics))


def test_links_that_ida_follows_at_a_small_tolerance_are_reported_and_esdirk_is_not_recommended() -> None:
    """The order is not limited at 1e-8: vibrations exceed the tolerance, and all of them are followed."""
    told: list[str] = []
    result = run(links(), Settings(tolerance=1e-8), communication_points(0.05, 5e-3), warn=told.append)
    assert not result.failure
    assert [d for d in result.diagnostics if "has taken" in d.text] == told
    assert len(told) == 1
    assert re.findall(r"'(\w+)' needed", str(told[0])) == ["adams"]


def test_the_check_does_not_change_the_motion() -> None:
    watched = Simulation(links(), Settings(tolerance=1e-8))
    watched.step_count_check.end = 1.0
    assert watched.advance(5e-3).ok
    assert any("has taken" in text for text in map(str, watched.diagnostics))
    plain = stepper("ida", watched.compiled.system, 0.0, *watched.start, Options(rtol=1e-8))
    assert plain.advance(5e-3).ok
    np.testing.assert_array_equal(plain.q, watched.stepper.q)
    assert plain.statistics == watched.statistics


def test_a_run_that_ends_soon_is_not_reported() -> None:
    """4000 steps of the same links, and 1500 of loose ones."""
    short = run(links(), Settings(tolerance=1e-8), communication_points(5e-3, 1e-3), warn=pytest.fail)
    loose = run(links(1e-1), Settings(tolerance=1e-8), communication_points(0.1, 1e-2), warn=pytest.fail)
    assert short.statistics.steps > EARLY
    assert not short.diagnostics
    assert not loose.diagnostics


def test_the_command_line_prints_the_warning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(step_count, "MIN_EXPECTED_STEPS", 3000)
    monkeypatch.setattr(step_count, "MIN_STEPS_UNKNOWN_END", EARLY)
    sets = [f"--set={name}={value}" for name, value in (STRIP | {"curl_x": 5.0}).items()]
    times, wanted = ["--stop-time=0.004", "--interval=0.001"], ["--tolerance=1e-6", f"--output={tmp_path / 'out'}"]
    code = main(["run", "sheet", "--direct", *sets, *times, "--solver=ida", *wanted])
    written = capsys.readouterr()
    assert code == 0, written.err
    assert f"mbfmu: note: 'ida' has taken {EARLY} steps" in written.err
    assert "has taken" in written.out
