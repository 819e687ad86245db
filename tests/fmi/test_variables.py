"""One list of variables: names, units and dependencies are true, and everything is written from it."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import read_model_description
from fmpy.validation import validate_fmu

from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from fmus.sheet import Sheet
from mbfmu.fmi import Fmu, export
from mbfmu.mechanics import Input, JointForce, Mechanism, Revolute, SpeedInput, SphericalCutJoint, Translational, rod
from mbfmu.modeling import Model, parameter
from mbfmu.modeling.variables import Role, Type, list_variables
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.util.errors import UserError

MODELS: list[Model] = [
    FourBar(),
    FourBar(coupler_modes=2),
    Governor(),
    Governor(driven=False),
    SwingPendulum(),
    Sheet(nx=4, nz=3),
]


@dataclass(frozen=True, kw_only=True)
class Moved(Model):
    """Everything that an input can be: a support, a speed, a load with its rate, gravity."""

    gripped: bool = parameter(True, doc="held at the tip", structural=True)
    color: str = parameter("red", doc="of the paint", choices=("red", "green"))
    angle: float = parameter(0.3, unit="deg", doc="of the arm at the start")

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, Input(name="gravity.y", unit="m/s2", start=-9.81), 0.0))
        sled = m.body("sled", m.ground, Translational(axis=(1, 0, 0), drive=Input(name="sled.x", unit="m")), mass=1.0)
        base = m.body("base", sled, Revolute(axis=(0, 1, 0), drive=SpeedInput(name="base.speed", unit="rad/s")))
        arm = m.body("arm", base, Revolute(start=np.deg2rad(self.angle)), **rod(mass=1.0, length=1.0))
        tip = m.body("tip", arm, Revolute(at=(1.0, 0.0, 0.0)), **rod(mass=1.0, length=0.5))
        if self.gripped:
            hook = m.cut("hook", SphericalCutJoint(at_a=(1.2, 0.3, 0.0), at_b=(0.5, 0.0, 0.0)), base, tip)
            m.output("hook.force", hook.force("x"), "at the tip")
        torque = Input(name="torque", unit="N.m", rate_name="torque.rate")
        m.force("motor", JointForce(magnitude=torque), arm)
        m.output("arm.angle", arm.angle(), "angle")
        m.output("arm.rate", arm.rate(), "rate")
        m.output("arm.acceleration", arm.point_acceleration("x", (0.3, 0.0, 0.0)), "acceleration of a point")
        m.output("base.effort", base.effort(), "torque of the drive")
        m.output("arm.force", arm.joint_force("x"), "force in the joint")
        m.output("energy", m.energy, "kinetic and potential energy")
        m.output("jacobi", m.jacobi_integral, "energy less the action of the drives")
        return m


@pytest.mark.parametrize("model", [*MODELS, Moved(gripped=False)], ids=repr)
def test_dependencies_are_true(model: Model) -> None:
    """What an input changes at the moment it is set is declared."""
    settings = Settings(solver="adams", tolerance=1e-6, energy_check=False)
    variables = list_variables(model, settings)
    simulation = Simulation(model, settings)
    simulation.advance(1e-4)
    outputs = [v for v in variables if v.role is Role.OUTPUT and not v.name.startswith("energy_")]
    before = simulation.outputs()[: len(outputs)].copy()
    for v in variables:
        if v.role is not Role.INPUT:
            continue
        simulation.set_input(v.name, v.start + 3.0)
        after = simulation.outputs()[: len(outputs)].copy()
        simulation.set_input(v.name, v.start)
        changed = {o.name for o, a, b in zip(outputs, before, after, strict=True) if abs(a - b) > 1e-9 * (1 + abs(a))}
        told = {o.name for o in outputs if v.name in o.depends_on}
        assert changed <= told, v.name


@pytest.mark.parametrize("model", [*MODELS, Moved()], ids=repr)
def test_every_real_variable_has_a_magnitude_and_what_is_an_angle_reads_in_degrees(
    model: Model, tmp_path: Path
) -> None:
    path = export(model, tmp_path / "m.fmu", Settings(solver="adams"), native=False)
    assert validate_fmu(str(path)) == []
    described = {v.name: v for v in read_model_description(str(path)).modelVariables}
    for v in list_variables(model, Settings(solver="adams").for_model(model)):
        told = described[v.name]
        assert (told.type, told.causality, told.variability) == (v.type.value, v.causality, v.variability)
        assert (told.description or "") == v.description
        if v.type is Type.REAL and v.causality in ("input", "output"):
            assert told.nominal is not None
            assert float(told.nominal) > 0.0
        assert (told.displayUnit == "deg") == (told.unit == "rad")
        if v.start is not None and not v.choices:
            assert float({"true": 1, "false": 0}.get(told.start, told.start)) == float(v.start)


def test_nominals_follow_the_size_of_the_mechanism() -> None:
    def nominals(model: Model) -> dict[str, float | None]:
        return {v.name: v.nominal for v in list_variables(model, Settings()) if v.role is Role.OUTPUT}

    small, large = FourBar(), replace(FourBar(), **{f"{bar}_length": 1e3 for bar in ("crank", "rocker")})
    large = replace(large, ground_length=3e3, coupler_length=3e3)
    assert nominals(large)["coupler.position.x"] == 1e3 * (nominals(small)["coupler.position.x"] or 0.0)
    assert nominals(large)["crank.angle"] == nominals(small)["crank.angle"] == 1.0


def test_what_is_not_there_at_the_start_is_not_called_tunable() -> None:
    told = [
        {v.name: v for v in list_variables(Sheet(nx=4, nz=3, pressure=p), Settings())}["pressure"] for p in (0.0, 0.5)
    ]
    assert [v.variability for v in told] == ["fixed", "tunable"]
    run = Simulation(Sheet(nx=4, nz=3), Settings(solver="adams"))
    with pytest.raises(UserError, match=r"'pressure' cannot change during a run, from 0\.0 to 0\.5"):
        run.retune(Sheet(nx=4, nz=3, pressure=0.5))


def test_page_command_and_description_agree(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from mbfmu.cli import main

    path = export(FourBar(crank_mass=2.5), tmp_path / "m.fmu", Settings(solver="adams", tolerance=1e-7), native=False)
    page = zipfile.ZipFile(path).read("documentation/index.html").decode()
    assert main(["models", "fourbar"]) == 0
    listed = capsys.readouterr().out
    for v in read_model_description(str(path)).modelVariables:
        assert f"<td>{v.name}</td>" in page
        assert re.search(rf"^{re.escape(v.name)} ", listed, re.MULTILINE), v.name
    assert "<td>2.5</td>" in page
    assert "<td>adams</td>" in page


@dataclass(frozen=True, kw_only=True)
class Named(Model):
    """A swing whose output and parameters are named by its test."""

    solver: float = parameter(1.0, doc="named as a setting")

    def build(self) -> Mechanism:
        return swing("bar.angle")


def swing(output: str, load: Input | float = 0.0, told: str = "angle", nominal: float | None = None) -> Mechanism:
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    bar = m.body("bar", m.ground, Revolute(), **rod(mass=1.0, length=1.0))
    m.force("motor", JointForce(magnitude=load), bar)
    m.output(output, bar.angle(), told, nominal)
    return m


def made(build: Callable[[], Mechanism], **parameters: Any) -> Model:
    fields = {name: parameter(1.0, unit=unit, doc=name) for name, unit in parameters.items()}
    kind = type(
        "Made", (Model,), {"__annotations__": dict.fromkeys(fields, "float"), **fields, "build": lambda _: build()}
    )
    model: Model = dataclass(frozen=True, kw_only=True)(kind)()
    return model


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (Named(), "the setting of the solver 'solver' has the same name as the parameter"),
        (made(lambda: swing("length"), length="m"), "the output 'length' has the same name as the parameter"),
        (made(lambda: swing("bad name <&> ü")), "has a name that is not allowed in an FMU"),
        (made(lambda: swing("bar..angle")), "has a name that is not allowed in an FMU"),
        (made(lambda: swing("time")), "same name as the time|name 'time'"),
        (made(lambda: swing("solver.steps")), "the count of the solver 'solver.steps' has the same name as the output"),
        (made(lambda: swing("a", Input(name="torque", unit="furlong"))), "the input 'torque': unit is 'furlong'"),
        (made(lambda: swing("a"), length="cubit"), "the parameter 'length': unit is 'cubit'"),
        (made(lambda: swing("a"), length="m999"), "the parameter 'length': unit is 'm999'"),
        (made(lambda: swing("a", told="bell \a")), "the description of the output 'a' is 'bell"),
        (made(lambda: swing("a", nominal=-1.0)), "the nominal value of the output 'a' is -1.0"),
        (made(lambda: swing("a", nominal=float("nan"))), "the nominal value of the output 'a' is nan"),
    ],
)
def test_what_no_fmu_can_be_made_of_is_refused_at_export(model: Model, message: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=message):
        export(model, tmp_path / "m.fmu", native=False)
    assert not list(tmp_path.iterdir())


def test_an_fmu_of_a_scene_runs_as_the_scene_does(tmp_path: Path) -> None:
    from mbfmu.cli import main

    path = tmp_path / "m.fmu"
    assert main(["export", "fourbar/paper", "--interval", "0.02", "--tolerance", "1e-5", "-o", str(path)]) == 0
    told = read_model_description(str(path)).defaultExperiment
    assert (float(told.stopTime), float(told.stepSize), float(told.tolerance)) == (10.0, 0.02, 1e-5)


def test_choices_are_read_and_set_by_name(fourbar_fmu: Path, tmp_path: Path) -> None:
    with Fmu(fourbar_fmu, {"solver": "hybrid"}) as fmu:
        assert fmu["solver"] == "hybrid"
    with Fmu(fourbar_fmu, {"solver": 2}) as fmu:
        assert fmu["solver"] == "adams"
    with pytest.raises(UserError, match="solver is 'euler'; allowed: adams"):
        Fmu(fourbar_fmu, {"solver": "euler"})
    path = export(Moved(color="green"), tmp_path / "m.fmu", Settings(solver="adams-lu"), native=False)
    with Fmu(path) as fmu:
        assert fmu["color"] == "green"
        assert fmu["solver"] == "adams-lu"
        fmu["color"] = 1
        with pytest.raises(UserError, match="'color' was set to 1, but it is a constant in this FMU"):
            fmu.step(0.01)


def test_a_load_is_felt_before_the_step(fourbar_fmu: Path) -> None:
    """As the dependencies say: a master that iterates an algebraic loop sets and reads at one time."""
    with Fmu(fourbar_fmu) as fmu:
        fmu.step(0.1)
        free = fmu["coupler.acceleration.x"]
        fmu["crank.torque"] = 5.0
        loaded, angle = fmu["coupler.acceleration.x"], fmu["crank.angle"]
        assert abs(loaded - free) > 1e-3
        fmu["crank.torque"] = 0.0
        assert fmu["coupler.acceleration.x"] == pytest.approx(free, rel=1e-9)
        assert fmu["crank.angle"] == angle
