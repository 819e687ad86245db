"""An FMU reports errors, keeps its state after them, and restores a saved state completely or not at all."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException

from fmus.fourbar import FourBar
from mbfmu.fmi import Fmu, export
from mbfmu.session.run import run
from mbfmu.session.serialization import decode_state, encode_state
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.util.errors import UserError
from solvers.compiled import cache

SOLVERS = ["adams", "hybrid", "ida"]


@pytest.fixture
def fmu(fourbar_fmu: Path) -> Iterator[Fmu]:
    with Fmu(fourbar_fmu) as instance:
        instance.step(0.5)
        yield instance


def refuses_a_step(fmu: Fmu, match: str) -> None:
    """A step is discarded with that sentence, and nothing moves."""
    before = fmu.reals()
    with pytest.raises(UserError, match=match):
        fmu.step(0.01)
    np.testing.assert_array_equal(fmu.reals(), before)


# ---- states ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("harm", ["short", "empty", "no head", "another's", "a bit"])
def test_a_bad_state_changes_nothing_and_stops_the_run(fmu: Fmu, fourbar_fmu: Path, tmp_path: Path, harm: str) -> None:
    good = fmu.save()
    fmu.step(0.1)
    before = fmu.reals()
    if harm == "another's":
        other = export(FourBar(crank_mass=2.0), tmp_path / "other.fmu", Settings(solver="adams"), native=False)
        with Fmu(other) as another:
            bad = another.save()
    else:
        bad = {"short": good[:-1], "empty": b"", "no head": good[20:], "a bit": good[:-9] + b"\x01" + good[-8:]}[harm]
    fmu.restore(bad)
    np.testing.assert_array_equal(fmu.reals(), before)
    for _ in range(2):  # and not once only
        refuses_a_step(fmu, "the FMU state cannot be restored")
    fmu.restore(good)
    fmu.t = 0.5
    fmu.step(0.1)
    np.testing.assert_array_equal(fmu.reals(), before)
    assert fmu.message() == ""


def test_no_flipped_bit_is_taken(fmu: Fmu) -> None:
    state = fmu.save()
    owner = "somebody"
    framed = encode_state(owner, {"inputs": [1.5]}, state)
    assert decode_state(owner, framed) == ({"inputs": [1.5]}, state)
    rng = np.random.default_rng(0)
    for place in {*range(50), *rng.integers(0, len(framed), 200).tolist()}:
        bad = bytearray(framed)
        bad[place] ^= 1 << int(rng.integers(8))
        with pytest.raises(UserError):
            decode_state(owner, bytes(bad))
    with pytest.raises(UserError, match="belongs to another model"):
        decode_state("somebody else", framed)


@pytest.mark.parametrize("solver", SOLVERS)
def test_inputs_and_tunable_parameters_come_back(fourbar_fmu: Path, solver: str) -> None:
    with Fmu(fourbar_fmu, {"solver": solver}) as fmu, Fmu(fourbar_fmu) as other:
        fmu["crank.torque"], fmu["gravity"] = 50.0, 3.0
        fmu.step(0.1)
        saved = fmu.save()
        fmu["crank.torque"], fmu["gravity"] = 0.0, 9.81
        fmu.step(0.1)
        for instance in (fmu, other):
            instance.restore(saved)
            instance.t = 0.1
            assert instance["crank.torque"] == 50.0
            assert instance["gravity"] == 3.0
            instance["crank.torque"] = 50.0  # no change
            instance.step(0.1)
        np.testing.assert_allclose(fmu.reals(), other.reals(), rtol=1e-12)
        other.restore(saved)
        other.t = 0.1
        other["crank.torque"] = 0.0  # the value at the start is a change now
        other.step(0.1)
        assert abs(other["crank.rate"] - fmu["crank.rate"]) > 0.01


def test_restoring_rebuilds_nothing(fmu: Fmu, monkeypatch: pytest.MonkeyPatch) -> None:
    saved = fmu.save()
    fmu.step(0.1)
    expected = fmu.reals()

    def rebuilt(*_: object, **__: object) -> None:
        raise AssertionError

    monkeypatch.setattr("fmus.fourbar.FourBar.build", rebuilt)
    fmu.restore(saved)
    fmu.t = 0.5
    fmu.step(0.1)
    np.testing.assert_array_equal(fmu.reals(), expected)


# ---- initialization ----------------------------------------------------------------------------------------------


def test_outputs_are_there_in_initialization_mode(fourbar_fmu: Path) -> None:
    expected = run(FourBar(start_angle=0.4), Settings(solver="adams"), np.array([0.0, 0.01]))
    with Fmu(fourbar_fmu) as fmu:
        fmu.slave.reset()
        fmu.slave.setupExperiment(startTime=0.0)
        fmu.slave.enterInitializationMode()
        drawn = fmu.reals()
        fmu["start_angle"] = 0.4
        np.testing.assert_array_equal(fmu.reals(), expected.values[0])
        assert not np.array_equal(drawn, expected.values[0])
        fmu.slave.exitInitializationMode()
        np.testing.assert_array_equal(fmu.reals(), expected.values[0])


def test_a_failed_initialization_is_no_success(fourbar_fmu: Path) -> None:
    with Fmu(fourbar_fmu) as fmu:
        for _ in range(20):
            fmu.slave.reset()
            fmu.slave.setupExperiment(startTime=0.0)
            fmu.slave.enterInitializationMode()
            fmu["ground_length"] = 50.0
            assert np.isnan(fmu.reals()).all()
            with pytest.raises(FMICallException):
                fmu.slave.exitInitializationMode()
            with pytest.raises(UserError, match="loop cannot close"):
                fmu.step(0.1)
            assert np.isnan(fmu.reals()).all()
        fmu.slave.reset()
        fmu.t = 0.0
        fmu.start({})
        fmu.step(0.1)
        assert fmu.message() == ""


def test_compilation_is_reported(
    fourbar_fmu: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Once an instance that starts a run, and nobody else."""
    start = Simulation.__init__

    def compile_and_start(*given: Any, **named: Any) -> None:
        cache.notify_listeners()
        cache.notify_listeners()
        start(*given, **named)

    with Fmu(fourbar_fmu):
        cache.notify_listeners()
        assert "compiling" not in capfd.readouterr().err
    monkeypatch.setattr(Simulation, "__init__", compile_and_start)
    with Fmu(fourbar_fmu):
        told = capfd.readouterr().err
    assert told.count("compiling; this takes up to three minutes") == 1


# ---- what a host may do wrong ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "name", "value", "match"),
    [
        ("Real", None, 1.0, "value reference 9999 is not a variable"),
        ("Real", "energy", 1.0, "'energy' was set to 1.0, but it is an output"),
        ("Real", "crank_length", 1.1, "'crank_length' was set to 1.1, but it can be changed only before the end"),
        ("Integer", "gravity", 3, "'gravity' of type Real, but it was accessed as type Integer"),
        ("Integer", "coupler_modes", 3, "it is a constant in this FMU"),
        ("String", "solver", "ida", "'solver' of type Enumeration, but it was accessed as type String"),
        ("Boolean", "solver.steps", True, "'solver.steps' of type Integer, but it was accessed as type Boolean"),
    ],
)
def test_a_mistake_in_setting_costs_one_step(fmu: Fmu, kind: str, name: str | None, value: object, match: str) -> None:
    reference = fmu.variables[name].valueReference if name else 9999
    getattr(fmu.slave, f"set{kind}")([reference], [value])
    refuses_a_step(fmu, match)
    fmu.step(0.01)
    assert fmu.message() == ""


def test_many_mistakes_are_reported_in_few_words(fmu: Fmu) -> None:
    for reference in (*range(9000, 9020), *[9000] * 1000):
        fmu.slave.getReal([reference])
    refuses_a_step(fmu, r"9000 is not a variable.* \(1001 times\); .*15 other errors")
    assert len(fmu.message()) < 1000


def test_a_step_of_no_length_is_a_good_one(fmu: Fmu) -> None:
    fmu.slave.getReal([9999])
    refuses_a_step(fmu, "9999 is not a variable")
    fmu.step(0.0)
    assert fmu.message() == ""


def test_reading_what_is_not_there_gives_no_number(fmu: Fmu) -> None:
    angle = fmu.variables["crank.angle"].valueReference
    got = fmu.slave.getReal([angle, 9999, 2**31 + 5])
    assert got[0] == fmu["crank.angle"]
    assert np.isnan(got[1:]).all()
    refuses_a_step(fmu, "9999 is not a variable")
    assert fmu.slave.getInteger([angle]) == [0]
    refuses_a_step(fmu, "'crank.angle' of type Real, but it was accessed as type Integer")
    fmu.step(0.01)


def test_a_value_out_of_range_is_refused_until_it_is_given_again(fmu: Fmu) -> None:
    fmu["gravity"] = float("inf")
    for _ in range(2):
        refuses_a_step(fmu, "'gravity' was set to inf")
    fmu["gravity"] = 9.0
    fmu.step(0.01)
    assert fmu["gravity"] == 9.0


def test_a_mistake_during_initialization_costs_a_step_and_not_the_instance(fourbar_fmu: Path) -> None:
    with Fmu(fourbar_fmu) as fmu:
        fmu.slave.reset()
        fmu.slave.setupExperiment(startTime=0.0)
        fmu.slave.enterInitializationMode()
        assert np.isnan(fmu.slave.getReal([9999])).all()
        fmu.slave.exitInitializationMode()
        fmu.t = 0.0
        refuses_a_step(fmu, "9999 is not a variable")
        fmu.step(0.1)


def test_a_clock_that_is_a_little_slow_moves_nothing_back(fmu: Fmu) -> None:
    fmu.slave.doStep(currentCommunicationPoint=0.5 - 5e-10, communicationStepSize=1e-10)
    assert fmu.message() == ""


def test_times_must_agree(fmu: Fmu) -> None:
    for t, h, match in [
        (0.4, 0.1, r"a step from 0\.4 s was requested, but the FMU has reached 0\.5 s"),
        (0.5, -0.1, "allowed: finite times, and a step size that"),
        (float("nan"), 0.1, "allowed: finite times"),
    ]:
        with pytest.raises(FMICallException):
            fmu.slave.doStep(currentCommunicationPoint=t, communicationStepSize=h)
        assert re.search(match, fmu.message())
    fmu.slave.doStep(currentCommunicationPoint=0.5 + 1e-13, communicationStepSize=0.1)


def test_nothing_moves_after_the_end(fourbar_fmu: Path) -> None:
    with Fmu(fourbar_fmu) as fmu:
        fmu.step(0.1)
        fmu.slave.terminate()
        refuses_a_step(fmu, "the FMU is terminated")


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_discarded_step_can_be_tried_again_shorter(tmp_path: Path, solver: str) -> None:
    """A torque beyond all numbers is not survived, but left behind."""
    path = export(FourBar(), tmp_path / "fourbar.fmu", Settings(solver=solver, tolerance=1e-6), native=False)
    with Fmu(path) as fmu:
        fmu.step(0.2)
        before = fmu.reals()
        fmu["crank.torque"] = 1e300
        with pytest.raises(UserError):
            fmu.step(1.0)
        assert fmu.message()
        fmu["crank.torque"] = 0.0
        after = fmu.reals()
        angle = fmu.real_outputs.index("crank.angle")
        assert after[angle] == before[angle]
        fmu.step(0.05)
        assert fmu.message() == ""
        exact = FourBar().exact(np.array([0.0, 0.25]))
        assert exact is not None
        assert fmu["crank.angle"] == pytest.approx(exact["crank.angle"][1], abs=1e-4)
