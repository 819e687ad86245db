"""The feeder's FMU in hosts: the numbers of a direct run, with inputs that change, and whatever else a host may do."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from binding import DISCARD, OK, Binary, Instance
from fmpy import read_model_description, simulate_fmu

from fmus.feeder import Feeder
from mbfmu.fmi import export
from mbfmu.modeling.scene import default_scene
from mbfmu.session.simulation import Simulation

MODEL = Feeder(path="straight", nips=1, nx=5, nz=4, lead=0.0)  # its leading edge is in the nips from the start
STEP, COUNT = 1e-3, 20  # s
SPEED, FORCE = "roller[1].left.speed", "nip[1].force"
TOLD = ("lead.x", "sheet.skew", "roller[1].left.torque", "nip[1].left.slip", "lower[1].force.y")


def speed(t: float) -> float:
    """Of the left roller: it slows down from 10 ms on, so that the sheet turns."""
    return 50.0 - 1e3 * max(0.0, t - 0.01)


def force(t: float) -> float:
    """Of the idlers, which let go at 15 ms: below zero they do not pull."""
    return -3.0 if t > 0.0145 else 4.0


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(MODEL, tmp_path_factory.mktemp("feeder") / "feeder.fmu", native=False)


@pytest.fixture(scope="module")
def references(fmu: Path) -> dict[str, int]:
    return {v.name: v.valueReference for v in read_model_description(str(fmu)).modelVariables}


@pytest.fixture(scope="module")
def direct() -> Mapping[str, Any]:
    """The same inputs without an FMU, each set when it changes: a value that is set again begins a step again."""
    run, last = Simulation(MODEL, default_scene(MODEL).settings), {SPEED: 50.0, FORCE: 4.0}
    rows = [run.outputs().copy()]
    for k in range(COUNT):
        for name, function in ((SPEED, speed), (FORCE, force)):
            if (value := function(k * STEP)) != last[name]:
                run.set_input(name, value)
                last[name] = value
        run.advance(k * STEP + STEP)
        assert not run.failure
        rows.append(run.outputs().copy())
    return dict(zip((v.name for v in run.variables), np.transpose(rows), strict=True))


@pytest.fixture(scope="module")
def binary(fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> Binary:
    return Binary(fmu, tmp_path_factory.mktemp("unpacked"))


class Run:
    """An instance that is driven as a host does."""

    def __init__(self, binary: Binary, references: dict[str, int], **parameters: float) -> None:
        self.fmu: Instance = binary.instantiate()
        self.references = references
        for name, value in parameters.items():
            assert self.set(name, value) == OK
        assert self.fmu.set_up() == OK
        assert self.fmu.call("EnterInitializationMode") == self.fmu.call("ExitInitializationMode") == OK

    def set(self, name: str, value: float) -> int:
        """Return the status."""
        return self.fmu.set("Real", [self.references[name]], [value])

    def told(self) -> list[float]:
        """Return the outputs at the present time."""
        status, values = self.fmu.get("Real", [self.references[name] for name in TOLD])
        assert status == OK
        return values

    def go(self, begin: int, end: int, changing: bool = True) -> Any:
        """Return the outputs after each of these steps."""
        rows = []
        for k in range(begin, end):
            if changing:
                assert self.set(SPEED, speed(k * STEP)) == self.set(FORCE, force(k * STEP)) == OK
            assert self.fmu.step(k * STEP, STEP) == OK
            rows.append(self.told())
        return np.array(rows)


def agrees(rows: Any, direct: Mapping[str, Any]) -> None:
    """Check outputs (steps, columns) against the direct run."""
    for name, column in zip(TOLD, np.transpose(rows), strict=True):
        np.testing.assert_allclose(column, direct[name][1:], rtol=1e-9, atol=1e-12, err_msg=name)


def test_the_scene_is_one_of_contact(direct: Mapping[str, Any]) -> None:
    """The sheet meets its guide, at 12 ms among others, turns, and its rollers are without torque once let go."""
    assert direct["lower[1].force.y"][12] > 0.5 * 9.81 * MODEL.density * MODEL.length * MODEL.width * MODEL.thickness
    assert direct["sheet.skew"][-1] > 1e-4
    np.testing.assert_array_equal(direct["roller[1].left.torque"][-4:], 0.0)
    assert np.abs(direct["roller[1].left.torque"][:-5]).max() > 0.0


def test_in_fmpy_it_is_a_direct_run(fmu: Path, direct: Mapping[str, Any]) -> None:
    t = STEP * np.arange(COUNT + 1)
    given = np.array([(x, speed(x), force(x)) for x in t], dtype=[("time", float), (SPEED, float), (FORCE, float)])
    rows = simulate_fmu(
        str(fmu), stop_time=STEP * COUNT, step_size=STEP, output_interval=STEP, input=given, output=list(TOLD)
    )
    agrees([[row[name] for name in TOLD] for row in rows[1:]], direct)


def test_in_libcosim_it_is_a_direct_run(fmu: Path, references: dict[str, int], direct: Mapping[str, Any]) -> None:
    libcosim = pytest.importorskip("libcosimpy.CosimExecution", reason="needs libcosimpy, which has no wheel for all")
    manipulators, observers, slaves = (
        pytest.importorskip(f"libcosimpy.Cosim{name}") for name in ("Manipulator", "Observer", "Slave")
    )
    execution = libcosim.CosimExecution.from_step_size(step_size=round(STEP * 1e9))  # ns
    index = execution.add_local_slave(slaves.CosimLocalSlave(fmu_path=str(fmu), instance_name="one"))
    observer, host = observers.CosimObserver.create_last_value(), manipulators.CosimManipulator.create_override()
    execution.add_observer(observer)
    execution.add_manipulator(host)
    rows = []
    for k in range(COUNT):
        given = [speed(k * STEP), force(k * STEP)]
        assert host.slave_real_values(index, [references[SPEED], references[FORCE]], given)
        assert execution.step()
        rows.append(observer.last_real_values(index, [references[name] for name in TOLD]))
    agrees(rows, direct)


def test_instances_do_not_disturb_each_other(
    binary: Binary, references: dict[str, int], direct: Mapping[str, Any]
) -> None:
    one, two, other = (Run(binary, references) for _ in range(3))
    rows = []
    for k in range(COUNT):
        rows.append(one.go(k, k + 1)[0])
        left = other.go(k, k + 1, changing=False)[0]
        np.testing.assert_array_equal(two.go(k, k + 1)[0], rows[-1])
    agrees(rows, direct)
    assert np.abs(left[1]) < 0.1 * np.abs(rows[-1][1])  # it was driven straight
    for run in (one, two, other):
        run.fmu.free()


def test_a_state_in_contact_is_taken_up_to_the_bit(binary: Binary, references: dict[str, int]) -> None:
    """By the same instance, by another, and by one that was given another start."""
    run = Run(binary, references)
    run.go(0, 12)
    status, state = run.fmu.save()
    assert status == OK
    data, there, after = run.fmu.to_bytes(state), run.told(), run.go(12, COUNT)
    assert run.fmu.restore(state) == OK
    assert run.told() == there
    np.testing.assert_array_equal(run.go(12, COUNT), after)
    for given in ({}, {"lead": 0.005}):
        other = Run(binary, references, **given)
        status, state = other.fmu.from_bytes(data)
        assert status == other.fmu.restore(state) == OK
        np.testing.assert_array_equal(other.go(12, COUNT), after)
        other.fmu.free()
    run.fmu.free()


def test_what_is_no_number_is_refused_and_the_run_goes_on(binary: Binary, references: dict[str, int]) -> None:
    run = Run(binary, references)
    run.go(0, 3)
    before = run.told()
    for name in (SPEED, FORCE):
        for value in (nan, inf):
            run.set(name, value)
            assert run.fmu.step(3 * STEP, STEP) == DISCARD
            assert binary.logged[-1][1] == f"{name!r} was set to {value}; allowed: a finite number [fmi-call]"
        run.set(name, {SPEED: 50.0, FORCE: 4.0}[name])
    assert run.told() == before
    assert run.fmu.step(3 * STEP, 0.0) == OK
    assert run.told() == before
    assert run.fmu.step(3 * STEP, STEP) == OK
    run.fmu.free()
