"""What model descriptions declare: readable by importers, local where it is no output, dependencies that are true."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element, fromstring

import pytest
from binding import Binary
from fmpy.validation import validate_fmu

from fmus.fourbar import FourBar
from mbfmu.fmi import Fmu, export
from mbfmu.fmi.description import LOG_CATEGORIES, Experiment, Identity
from mbfmu.fmi.description3 import model_description
from mbfmu.mechanics import Input, JointForce, Mechanism, PointForce, Product, Revolute, Spring, Translational, rod
from mbfmu.modeling import Model
from mbfmu.modeling.settings import Settings
from mbfmu.modeling.variables import Role, list_variables
from mbfmu.session.simulation import Simulation

ADAMS = Settings(solver="adams", tolerance=1e-6, energy_check=False)
NEEDS = {  # of the excavator's outputs: inputs that change them at the moment they are set, by the laws of the forces
    "cylinder.force": {"cylinder.push"},
    "pressed.force": {"cylinder.push", "area"},
    "motor.effort": {"motor.torque"},
    "spring.force": set(),
    "arm.angle": set(),
    "arm.rate": set(),
    "arm.acceleration": {"cylinder.push", "area", "motor.torque", "gravity.y"},
    "bearing.force": {"cylinder.push", "area", "motor.torque", "gravity.y"},
}


@dataclass(frozen=True, kw_only=True)
class Excavator(Model):
    """An arm that a cylinder, a motor and a spring load."""

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, Input(name="gravity.y", unit="m/s2", start=-9.81), 0.0))
        sled = m.body("sled", m.ground, Translational(axis="x", drive=Input(name="sled.x", unit="m")), mass=1.0)
        arm = m.body("arm", sled, Revolute(start=0.3), **rod(mass=2.0, length=1.0))
        push, area = Input(name="cylinder.push", unit="N"), Input(name="area", unit="1", start=1.0)
        torque = Input(name="motor.torque", unit="N.m", rate_name="motor.torque.rate")
        cylinder = m.force("cylinder", PointForce(magnitude=push, axis="y", at_a=(0.5, 0, 0)), arm)
        both = Product(push, area)
        pressed = m.force("pressed", PointForce(magnitude=both, axis="y", at_a=(0.7, 0, 0)), arm)
        motor = m.force("motor", JointForce(magnitude=torque), arm)
        spring = m.force("spring", Spring(stiffness=30.0, damping=2.0, at_a=(0.4, 0, 0), at_b=(0, 1, 0)), arm)
        for name, sensor in (
            ("cylinder.force", cylinder.force("y")), ("pressed.force", pressed.force("y")),
            ("motor.effort", motor.effort()), ("spring.force", spring.force("x")), ("arm.angle", arm.angle()),
            ("arm.rate", arm.rate()), ("arm.acceleration", arm.point_acceleration("y", (0.3, 0.0, 0.0))),
            ("bearing.force", arm.joint_force("y")),
        ):  # fmt: skip
            m.output(name, sensor)
        return m


def declared(root: Element) -> dict[str, set[str]]:
    """Dependencies that a description of FMI 2.0 declares."""
    names = [v.get("name", "") for v in root.iter("ScalarVariable")]
    outputs = root.find("ModelStructure/Outputs")
    assert outputs is not None
    return {
        names[int(u.get("index", "0")) - 1]: {names[int(k) - 1] for k in u.get("dependencies", "").split()}
        for u in outputs
    }


def test_outputs_declare_the_inputs_that_change_them_and_no_others(tmp_path: Path) -> None:
    path = export(Excavator(), tmp_path / "model.fmu", ADAMS, native=False)
    assert validate_fmu(str(path)) == []
    found = declared(fromstring(zipfile.ZipFile(path).read("modelDescription.xml")))
    assert {name: needs for name, needs in found.items() if name in NEEDS} == NEEDS


def test_what_is_declared_is_what_a_simulation_does() -> None:
    """Set at one time, with products that are not zero."""
    simulation = Simulation(Excavator(), ADAMS, 0.0, {"cylinder.push": 3.0, "motor.torque": 1.0})
    assert simulation.advance(0.05).ok
    names = [v.name for v in simulation.compiled.outputs]
    for v in simulation.compiled.inputs.variables:
        own = {"cylinder.push": 3.0, "motor.torque": 1.0}.get(v.name, v.start)
        before = simulation.outputs()[: len(names)].copy()
        simulation.set_input(v.name, own + 2.0)
        after = simulation.outputs()[: len(names)].copy()
        simulation.set_input(v.name, own)
        changed = {n for n, a, b in zip(names, before, after, strict=True) if abs(a - b) > 1e-9 * (1.0 + abs(a))}
        assert changed == {n for n in names if v.name in NEEDS[n]}, v.name


def test_what_the_solver_reports_is_local(fourbar_fmu: Path) -> None:
    """Importers connect outputs; whole numbers and texts are none."""
    root = fromstring(zipfile.ZipFile(fourbar_fmu).read("modelDescription.xml"))
    reports = [v for v in root.iter("ScalarVariable") if v.get("name", "").startswith("solver.")]
    assert len(reports) == 7
    assert {v.get("causality") for v in reports} == {"local"}
    for v in root.iter("ScalarVariable"):
        assert v.get("causality") != "output" or v[0].tag == "Real", v.get("name")
    assert validate_fmu(str(fourbar_fmu)) == []
    with Fmu(fourbar_fmu) as fmu:
        fmu.step(0.1)
        assert fmu["solver.steps"] > 0
        assert fmu.message() == ""
        assert not [name for name in fmu.outputs if name.startswith("solver.")]
        reference = fmu.variables["solver.steps"].valueReference
        fmu.slave.setInteger([reference], [3])
        with pytest.raises(ValueError, match=r"'solver\.steps' was set to 3, but it is an output of the solver"):
            fmu.step(0.1)


def test_descriptions_of_fmi_3_have_what_older_importers_read() -> None:
    """FMPy 0.3.10 to 0.3.22 pass every attribute of a type to a class that only has a name and a unit."""
    variables = list_variables(FourBar(), ADAMS)
    identity = Identity(name="m", identifier="m", description="m", guid="m")
    experiment = Experiment(stop_time=1.0, step_size=0.1, tolerance=1e-6)
    root = model_description(identity, experiment, variables, LOG_CATEGORIES, ())
    types = list(root.iter("EnumerationType"))
    assert len(types) == sum(1 for v in variables if v.choices) > 0
    for kind in types:
        assert set(kind.attrib) == {"name"}
    assert {v.get("causality") for v in root.iter() if v.get("name", "").startswith("solver.")} == {"local"}
    outputs = {v.name for v in variables if v.role is Role.OUTPUT}
    structure = root.find("ModelStructure")
    assert structure is not None
    assert len(structure.findall("Output")) == len(outputs)


def test_an_fmu_that_calls_python_logs_nothing_where_the_log_is_off(fourbar_fmu: Path, tmp_path: Path) -> None:
    binary = Binary(fourbar_fmu, tmp_path)
    fmu = binary.instantiate(logging=False)
    assert fmu.set_up() == fmu.call("EnterInitializationMode") == fmu.call("ExitInitializationMode") == 0
    fmu.get("Real", [9999])
    assert fmu.step(0.0, 0.1) != 0
    assert binary.logged == []
    fmu.free()
