"""The balance of a run: silent where the motion is right, loud where energy and work do not agree."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import simpson, solve_ivp

from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from mbfmu.cli import main
from mbfmu.fmi.export import export
from mbfmu.fmi.harness import Fmu
from mbfmu.mechanics import Harmonic, Input, JointForce, JointSpring, Mechanism, PointForce, Revolute, rod
from mbfmu.mechanics.arrays.systems import Systems
from mbfmu.modeling import Model, parameter
from mbfmu.modeling.scene import Scene
from mbfmu.session import kept_starts
from mbfmu.session.run import Result, communication_points, run
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.studies.compare import compare, describe_outcome
from mbfmu.studies.reference import reference
from mbfmu.studies.timing import Budget
from mbfmu.util.errors import UserError

SOLVERS = ("adams", "hybrid", "ida", "radau")
TIMES = np.linspace(0.0, 3.0, 151)


@dataclass(frozen=True, kw_only=True)
class Arm(Model):
    """An arm of two rods, on a shaken hinge or a free one, damped, pulled and weighed by inputs."""

    driven: bool = parameter(True, structural=True)
    damping: float = parameter(0.05, unit="N.m.s/rad", tunable=True)
    mass: float = parameter(1.0, unit="kg", tunable=True)

    def build(self) -> Mechanism:
        weight = Input(name="weight", unit="m/s2", start=-9.81)
        m = Mechanism(gravity=(0, weight, 0))
        hinge = Revolute(drive=Harmonic(amplitude=0.3, frequency=0.5)) if self.driven else Revolute(start=0.3)
        upper = m.body("upper", m.ground, hinge, **rod(mass=self.mass, length=1.0))
        lower = m.body("lower", upper, Revolute(at=(1, 0, 0), start=-0.5), **rod(mass=1.0, length=1.0))
        m.force("friction", JointSpring(damping=self.damping), lower)
        pull = Input(name="pull", unit="N")
        m.force("pull", PointForce(magnitude=pull, axis="x", at_a=(1, 0, 0)), lower)
        if self.driven:
            m.output("upper.effort", upper.effort(), "torque of the drive")
        m.output("upper.rate", upper.rate(), "speed of the drive")
        m.output("lower.rate", lower.rate(), "speed of the lower hinge")
        m.output("energy", m.energy, "kinetic and potential energy")
        return m


def loss(result: Result) -> float:
    return float(np.abs(result["energy_error"]).max())


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8, 1e-10])
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(
    "model",
    [FourBar(), Governor(), Governor(driven=False), SwingPendulum(), Arm()],
    ids=["loop", "driven loop", "free loop", "driven tree", "damped"],
)
def test_a_right_run_keeps_its_balance(model: Model, solver: str, tolerance: float) -> None:
    result = run(model, Settings(solver=solver, tolerance=tolerance), TIMES)
    assert not result.failure
    assert not result.warning
    assert loss(result) < 100.0 * tolerance * result["energy_throughput"][-1]


@pytest.mark.parametrize("solver", SOLVERS)
def test_work_is_that_of_drive_and_damper(solver: str) -> None:
    times = np.linspace(0.0, 2.0, 2001)
    result = run(Arm(), Settings(solver=solver, tolerance=1e-9), times)
    power = result["upper.effort"] * result["upper.rate"] - 0.05 * result["lower.rate"] ** 2
    booked = result["energy"] - result["energy"][0] - result["energy_error"]
    assert abs(booked[-1]) > 0.1
    for end in (501, 1001, 2001):
        assert booked[end - 1] == pytest.approx(simpson(power[:end], x=times[:end]), abs=2e-7)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
@pytest.mark.parametrize("solver", SOLVERS)
def test_damping_that_the_equations_do_not_have_is_seen(solver: str, tolerance: float, monkeypatch: Any) -> None:
    """A damper that the balance does not contain dissipates energy like a regularization or a wrong projection."""
    damped = Arm(driven=False, damping=2e3 * tolerance)
    settings = Settings(solver=solver, tolerance=tolerance)
    assert not run(damped, settings, TIMES).warning
    monkeypatch.setattr(Systems, "_works", lambda self: False)
    kept_starts._kept.clear()  # of the run before, with the damper
    told: list[str] = []
    result = run(damped, settings, TIMES, warn=told.append)
    assert [str(found) for found in told] == [result.warning]
    assert "J less than the work done on the mechanism" in result.warning


@pytest.mark.parametrize(("factor", "text"), [(1.02, "J more than the work"), (0.98, "J less than the work")])
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_jump_at_a_singular_position_is_seen_at_once_and_named(solver: str, factor: float, text: str) -> None:
    simulation = Simulation(FourBar(), Settings(solver=solver))
    simulation.advance(0.1)
    while np.sin(simulation.stepper.q[0]) > 0.02:
        simulation.advance(simulation.t + 1e-3)
    assert not simulation.warning
    simulation.stepper._v *= factor
    simulation.stepper.restart()
    jumped = simulation.t
    simulation.advance(jumped + 1e-3)
    assert f"t = {simulation.t:.6g} s" in simulation.warning
    assert text in simulation.warning
    assert "near a singular configuration" in simulation.warning
    assert "pivot" in simulation.warning


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_balance_closes_over_changes_and_a_restored_state(solver: str) -> None:
    simulation = Simulation(Arm(), Settings(solver=solver, tolerance=1e-8))
    names = [variable.name for variable in simulation.compiled.inputs.variables]
    saved, found = b"", {}
    for step in range(40):
        if step % 8 == 3:
            simulation.set_input(names.index("weight"), -9.81 - step)
            simulation.set_input(names.index("pull"), 0.5 * step)
        if step == 20:
            simulation.retune(Arm(damping=0.2, mass=3.0))
        simulation.advance(0.05 * (step + 1))
        if step == 24:
            saved = simulation.save()
        if step == 30:
            found["first"] = float(simulation.outputs()[-2])
    assert abs(simulation.outputs()[-2]) < 1e-5
    assert not simulation.warning
    other = Simulation(Arm(), Settings(solver=solver, tolerance=1e-8))
    other.restore(saved)
    for step in range(25, 31):
        if step % 8 == 3:
            other.set_input(names.index("weight"), -9.81 - step)
            other.set_input(names.index("pull"), 0.5 * step)
        other.advance(0.05 * (step + 1))
    assert other.outputs()[-2] == pytest.approx(found["first"], abs=0.0 if solver != "ida" else 1e-6)


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_energy_check_leaves_the_motion_as_it_is_and_can_be_left_out(solver: str) -> None:
    with_it = run(Arm(), Settings(solver=solver), TIMES)
    without = run(Arm(), Settings(solver=solver, energy_check=False), TIMES)
    np.testing.assert_array_equal(with_it.values[:, :-2], without.values[:, :-2])
    assert np.isnan(without["energy_error"]).all()
    assert not without.warning


def test_the_command_ends_with_an_error(tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    monkeypatch.setattr(Systems, "_works", lambda self: False)
    end = ["--stop-time", "1", "-o", str(tmp_path)]
    assert main(["run", "governor/damped", *end, "--direct"]) == 1
    out, err = capsys.readouterr()
    assert "energy error" in out
    assert "LARGER than the tolerance explains" in out
    assert "the energy error is too large at t = " in err
    assert main(["run", "governor/damped", "--direct", "--no-energy-check", *end]) == 0


def test_compare_marks_the_row(monkeypatch: Any) -> None:
    scene = Scene(name="x", model=Governor(damping=5.0), settings=Settings(), stop_time=0.5, output_interval=0.05)
    times = communication_points(scene.stop_time, scene.output_interval)
    right = reference(scene, [{}], times, 1e-6, Budget(60.0))
    monkeypatch.setattr(Systems, "_works", lambda self: False)
    with pytest.raises(UserError, match=r"has no reference \(adams at 1e-12: the energy error is too large at t = "):
        compare(scene, solvers=["adams"], tolerances=[1e-6], repeats=1)
    monkeypatch.setattr("mbfmu.studies.compare.reference", lambda *_: right)
    found = compare(scene, solvers=["adams"], tolerances=[1e-6], repeats=1)
    assert describe_outcome(found.rows[0]).startswith("inaccurate")
    assert found.best() == []
    assert found.rows[0].energy_error == np.abs(found.energies["adams"][1]).max() > 0.0


def test_an_fmu_reports_it_in_its_message(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(Systems, "_works", lambda self: False)
    path = export(Governor(damping=5.0), tmp_path / "wrong.fmu", native=False)
    with Fmu(path) as fmu:
        fmu.step(0.5)
        assert "the energy error is too large" in fmu.message()
        assert abs(fmu["energy_error"]) > 1e-3
    with Fmu(path, {"energy_check": False}) as fmu:
        fmu.step(0.5)
        assert fmu.message() == ""


def swinging(torque: Any = 0.0, start: float = 0.3) -> Mechanism:
    """A rod of 1 kg and 1 m, and its rate as the first output."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    arm = m.body("arm", m.ground, Revolute(start=start, fixed=True), **rod(mass=1.0, length=1.0))
    m.force("motor", JointForce(magnitude=torque), arm)
    m.output("rate", arm.rate())
    m.output("angle", arm.angle())
    return m


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(("tolerance", "torque"), [(1e-4, 100.0), (1e-4, 10.0), (1e-6, 100.0), (1e-6, 10.0)])
def test_a_load_that_jumps_raises_no_alarm(solver: str, tolerance: float, torque: float) -> None:
    """Just before, the motion was slow, and so was what the tolerance let its energy stray."""
    load, dt, jump = Input(name="torque", unit="N.m"), 0.1, 5
    simulation = Simulation(swinging(load), Settings(solver=solver, tolerance=tolerance))

    def rate(_: float, y: Any, given: float) -> list[float]:
        return [y[1], 3.0 * (given - 0.5 * 9.81 * np.cos(y[0]))]

    state = np.array([0.3, 0.0])
    for k in range(12):
        given = 0.0 if k < jump else torque + 1e-9 * k  # it changes at every point, so that the solver stops there
        simulation.set_input("torque", given)
        assert simulation.advance(dt * (k + 1)).ok
        state = solve_ivp(rate, (0.0, dt), state, "DOP853", args=(given,), rtol=1e-12, atol=1e-12).y[:, -1]
        assert simulation.outputs()[1] == pytest.approx(state[0], abs=10.0 * tolerance, rel=10.0 * tolerance)
    assert simulation.warning == ""


@pytest.mark.parametrize("solver", ["adams", "hybrid"])
def test_what_is_exchanged_is_not_less_than_what_can_be_seen(solver: str) -> None:
    result = run(swinging(), Settings(solver=solver), np.linspace(0.0, 0.5, 51))
    kinetic = 0.5 / 3.0 * result["rate"] ** 2
    seen = np.maximum.accumulate(kinetic) - np.minimum.accumulate(kinetic)
    told = result["energy_throughput"]
    assert np.all(told[3:] >= 0.5 * seen[3:])


@pytest.mark.parametrize(("error", "is_ratio"), [(1.0, True), (1e9, False)])
def test_a_ratio_to_the_energy_exchanged_is_stated_if_it_is_below_one(error: float, is_ratio: bool) -> None:
    simulation = Simulation(Arm(driven=False), Settings(solver="adams"))
    simulation.advance(0.5)
    simulation.session.balance["reference_energy"] += error
    simulation.advance(0.6)
    assert "J less than the work done on the mechanism" in simulation.warning
    assert ("of energy exchanged" in simulation.warning) == is_ratio
