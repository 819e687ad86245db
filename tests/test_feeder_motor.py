"""The feeder, two motors and a controller of skew: the co-simulation against kinematics and two SSP hosts."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from math import exp
from pathlib import Path

import feeder_motor as example
import numpy as np
import pytest
from feeder_motor import MODEL, SKEW, STOP_TIME, SYSTEM, Fmus, co_simulate, kinematics
from fmpy.validation import validate_fmu
from ssp_system import Run

from mbfmu.fmi import Fmu

STEP = 1e-3  # s
FREE = replace(MODEL, guides=False, gravity_y=0.0)  # nothing but nips, for its time
build = example.build


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Fmus:
    return build(tmp_path_factory.mktemp("feeder_motor"), FREE)


@pytest.fixture(scope="module")
def ssp(fmus: Fmus) -> Path:
    return SYSTEM.write(fmus["feeder"].with_name("feeder_motor.ssp"), fmus, STOP_TIME)


@pytest.fixture(scope="module")
def off(fmus: Fmus) -> Run:
    return co_simulate(fmus, STEP, on=False)


@pytest.fixture(scope="module")
def on(fmus: Fmus) -> Run:
    return co_simulate(fmus, STEP)


def test_fmus_validate(fmus: Fmus) -> None:
    for name in ("controller", "left_motor", "feeder"):
        assert validate_fmu(str(fmus[name])) == []


def test_the_sheet_turns_at_the_difference_of_the_rollers_over_their_distance(off: Run) -> None:
    later = off["time"] >= 0.1
    slow, fast = MODEL.speed / (1.0 + example.ERROR), MODEL.speed
    rate = np.polyfit(off["time"][later], off[SKEW][later], 1)[0]
    assert rate == pytest.approx((fast - slow) / MODEL.nip_distance, rel=0.01)
    assert off["left_motor.speed"][-1] == pytest.approx(slow / MODEL.radius, rel=1e-3)
    np.testing.assert_allclose(off[SKEW], kinematics(off["time"], on=False)[SKEW], atol=4e-4)


def test_the_controller_finds_the_skew_and_takes_it_away(off: Run, on: Run) -> None:
    expected = kinematics(on["time"])
    assert on["controller.skew"][-1] == pytest.approx(expected["controller.skew"][-1], rel=0.02)
    assert abs(on[SKEW][-1]) < 0.05 * off[SKEW][-1]
    np.testing.assert_allclose(on[SKEW], expected[SKEW], atol=4e-4)
    for side in ("left", "right"):
        name = f"{side}_motor.speed"
        assert on[name][-1] == pytest.approx(expected[name][-1], rel=1e-3)


def test_the_coupling_converges_to_kinematics(fmus: Fmus) -> None:
    runs = [co_simulate(fmus, step, jacobi=True) for step in (2e-3, 0.5e-3)]
    found = [np.abs(run[SKEW] - kinematics(run["time"])[SKEW]).max() for run in runs]
    assert found[1] < 0.3 * found[0]


@pytest.mark.parametrize("host", ["fmpy", "libcosim"])
def test_the_ssp_is_the_own_loop(fmus: Fmus, ssp: Path, host: str) -> None:
    """Round-off alone is between them, and what the feeder's tolerance of 1e-4 makes of it: a speed that has settled is
    set again or is not, and steps begin elsewhere.
    """
    if host == "libcosim":
        pytest.importorskip("libcosimpy")
    run_in: Callable[[Path, float, float], Run] = getattr(SYSTEM, f"run_in_{host}")
    told, own = run_in(ssp, STOP_TIME, STEP), co_simulate(fmus, STEP, jacobi=True, zeros=host == "fmpy")
    assert own[SKEW].max() > 0.009
    np.testing.assert_allclose(told["time"], own["time"][1:], atol=1e-12)
    for name, tolerance in ((SKEW, 5e-5), ("controller.skew", 1e-6), ("left_motor.speed", 1e-2)):
        np.testing.assert_allclose(told[name], own[name][1:], atol=tolerance, err_msg=name)


def test_the_ssp_does_what_gauss_and_seidel_s_loop_does(ssp: Path, off: Run, on: Run) -> None:
    told = SYSTEM.run_in_fmpy(ssp, STOP_TIME, STEP)
    np.testing.assert_allclose(told[SKEW], on[SKEW][1:], atol=1.5e-3)
    told = SYSTEM.run_in_fmpy(ssp, STOP_TIME, STEP, {"controller.on": False})
    np.testing.assert_allclose(told[SKEW], off[SKEW][1:], atol=1.5e-3)


def test_the_motor_follows_its_equations(fmus: Fmus) -> None:
    """Both poles of the loop are at -100/s where the tachometer is right: e = step (1 - 100 t) exp(-100 t)."""
    with Fmu(fmus["left_motor"], {"wanted": 50.0}) as motor:
        motor.step(0.0)
        assert motor["speed"] == 50.0
        motor["wanted"] = 51.0
        for t in (0.003, 0.01, 0.04):
            motor.step_to(t)
            assert motor["speed"] == pytest.approx(51.0 - (1.0 - 100.0 * t) * exp(-100.0 * t), abs=1e-5)
        motor["load"] = 1.0  # too much for it
        speed = motor["speed"]
        motor.step(0.01)
        assert motor["torque"] == 0.1
        assert motor["speed"] - speed == pytest.approx(-0.9 / 2e-5 * 0.01, rel=0.01)


def test_the_slaves_go_on_from_a_saved_state(fmus: Fmus) -> None:
    with Fmu(fmus["left_motor"]) as motor, Fmu(fmus["left_motor"]) as other:
        motor["load"] = 0.01
        motor.step(0.01)
        other.restore(motor.save())
        for each in (motor, other):
            each.slave.doStep(0.01, 0.005)
        assert other["speed"] == motor["speed"] != 50.0
    with Fmu(fmus["controller"]) as controller, Fmu(fmus["controller"]) as other:
        controller["right_covered"] = 0.25
        controller.step(1e-3)
        other.restore(controller.save())
        for each in (controller, other):
            each["right_covered"] = 0.75
            each.slave.doStep(1e-3, 1e-3)
        assert other["right_seen"] == controller["right_seen"] == pytest.approx(0.5e-3, abs=1e-15)


def test_the_script_writes_everything(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(example, "STEPS", (2e-3,))
    monkeypatch.setattr(example, "STEP", 2e-3)
    monkeypatch.setattr(example, "build", lambda folder: build(folder, FREE))
    monkeypatch.setattr(sys, "argv", ["feeder_motor.py", "-o", str(tmp_path / "out")])
    example.main()
    names = {"controller.fmu", "motor.fmu", "feeder.fmu", "feeder_motor.ssp", "feeder_motor.png"}
    assert {path.name for path in (tmp_path / "out").iterdir()} == names
    assert "Gauss-Seidel" in capsys.readouterr().out
