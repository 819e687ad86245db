"""Arrays and the time of native FMUs of FMI 3, terminals, and files for people."""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy import extract, read_model_description, simulate_fmu
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu
from lxml import etree

from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from fmus.sheet import Sheet
from mbfmu.fmi import export
from mbfmu.mechanics import Mechanism, Revolute, rod
from mbfmu.modeling import Model
from mbfmu.modeling.settings import Settings
from mbfmu.modeling.variables import arrays, list_variables
from mbfmu.native.runtime import COMPILERS
from mbfmu.native.targets import host
from mbfmu.session.simulation import Simulation
from mbfmu.util.errors import UserError

ADAMS = Settings(solver="adams")
GRID = Sheet(nx=5, nz=4, grid_outputs=True)
SCHEMA = Path(fmpy.__file__).parent / "schema" / "fmi3" / "fmi3TerminalsAndIcons.xsd"

native = pytest.mark.skipif(
    not host() or not any(map(shutil.which, COMPILERS)), reason="needs a C compiler, and a machine that is known"
)


@dataclass(frozen=True, kw_only=True)
class Swing(Model):
    """A pendulum whose arrays and constants are given by the test."""

    several: Any = ()
    held: Any = ()

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0, -9.81, 0))
        bob = m.body("bob", m.ground, Revolute(), **rod(mass=1.0, length=1.0))
        for axis in "xy":
            m.output(f"tip.{axis}", bob.position(axis, (1.0, 0.0, 0.0)))
        m.output("angle", bob.angle())
        return m

    def arrays(self) -> Mapping[str, Sequence[Any]]:
        return dict(self.several)

    def terminals(self) -> Mapping[str, Sequence[str]]:
        return dict(self.held)


@pytest.mark.parametrize(
    ("names", "told"),
    [
        ([], "array 'all' is .*; allowed: names of outputs, in lists of equal lengths"),
        ("tip.x", "allowed: names of outputs"),
        ([["tip.x", "tip.y"], ["angle"]], "allowed: names of outputs"),
        (["tip.x", "tip.z"], "array 'all' has 'tip.z', which is not an output"),
        (
            ["tip.x", "tip.x"],
            "array 'all' has 'tip.x', which is not an output of the model or already in another array",
        ),
        (["tip.x", "angle"], "array 'all' has 'tip.x' in m and 'angle' in rad"),
    ],
)
def test_what_is_no_array_is_refused(names: Any, told: str):
    model = Swing(several={"all": names}.items())
    with pytest.raises(UserError, match=told):
        arrays(model, list_variables(model, ADAMS))


def test_the_name_of_an_array_is_no_other_variable_s():
    model = Swing(several={"angle": ["tip.x", "tip.y"]}.items())
    with pytest.raises(UserError, match="'angle' has the same name as the output"):
        arrays(model, list_variables(model, ADAMS))


def test_a_field_of_a_sheet_is_an_array_over_its_cells():
    model = Sheet(nx=5, nz=4, field="moment.xz")
    (found,) = (a for a in arrays(model, list_variables(model, ADAMS)) if a.name == "moment.xz")
    assert (found.shape, found.unit, found.elements[4]) == ((4, 3), "N.m/m", "moment.xz[1,1]")


class Running:
    """An FMU of FMI 3 that has begun."""

    def __init__(self, path: Path) -> None:
        description = read_model_description(str(path))
        self.variables = {v.name: v for v in description.modelVariables}
        self.folder = extract(str(path))
        self.slave = FMU3Slave(
            guid=description.guid or description.instantiationToken,
            unzipDirectory=self.folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="one",
        )
        self.slave.instantiate()
        self.slave.enterInitializationMode(startTime=0.0)
        self.slave.exitInitializationMode()

    def read(self, *names: str, count: int) -> list[float]:
        return list(self.slave.getFloat64([self.variables[name].valueReference for name in names], nValues=count))

    def close(self) -> None:
        self.slave.terminate()
        self.slave.freeInstance()
        shutil.rmtree(self.folder)


@pytest.fixture(scope="module")
def sheet_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(GRID, tmp_path_factory.mktemp("sheet") / "sheet.fmu", ADAMS, native=True, fmi=3)


@pytest.fixture
def sheet(sheet_fmu: Path) -> Iterator[Running]:
    running = Running(sheet_fmu)
    yield running
    running.close()


@native
def test_nodes_of_a_sheet_are_one_array_in_the_order_of_its_indices(sheet: Running):
    variable = sheet.variables["node.position"]
    assert variable.shape == (5, 4, 3)
    assert (variable.causality, variable.unit) == ("output", "m")
    assert "node[0,0].x" not in sheet.variables
    sheet.slave.doStep(currentCommunicationPoint=0.0, communicationStepSize=0.002)
    simulation = Simulation(GRID, ADAMS)
    assert simulation.advance(0.002).ok
    known = dict(zip((v.name for v in simulation.variables), simulation.outputs(), strict=True))
    expected = [known[f"node[{i},{k}].{axis}"] for i in range(5) for k in range(4) for axis in "xyz"]
    assert sheet.read("node.position", count=60) == expected
    mixed = sheet.read("energy", "node.position", "time", "tip.y", count=63)
    assert mixed == [known["energy"], *expected, 0.002, known["tip.y"]]


@native
def test_a_wrong_number_of_values_is_refused(sheet: Running):
    for names, count in (
        (["node.position"], 59),
        (["node.position"], 61),
        (["node.position", "tip.x"], 2),
        (["tip.x"], 0),
    ):
        with pytest.raises(Exception, match="fmi3GetFloat64"):
            sheet.read(*names, count=count)
    reference = sheet.variables["node.position"].valueReference
    with pytest.raises(Exception, match="fmi3SetFloat64"):  # it is an output
        sheet.slave.setFloat64([reference], [0.0] * 60)
    assert len(sheet.read("node.position", count=60)) == 60


@native
def test_what_an_array_follows_is_what_its_elements_follow(sheet_fmu: Path):
    described = read_model_description(str(sheet_fmu))
    outputs = {unknown.variable.name for unknown in described.outputs}
    assert {"node.position", "free_edge.y", "tip.x"} <= outputs
    elastic = FourBar(coupler_modes=2)
    found = {a.name: a for a in arrays(elastic, list_variables(elastic, ADAMS))}
    assert found["coupler.mode.acceleration"].depends_on == ("crank.torque",)
    assert found["coupler.mode.rate"].depends_on == ()
    assert found["coupler.mode.rate"].shape == (2,)


@native
def test_fmpy_records_arrays_and_the_time_goes_on(sheet_fmu: Path):
    rows = simulate_fmu(str(sheet_fmu), stop_time=0.004, output_interval=0.002, output=["node.position", "tip.y"])
    assert rows["node.position"].shape == (3, 5, 4, 3)
    np.testing.assert_array_equal(rows["node.position"][:, 0, 2, 1], rows["tip.y"])


@native
def test_choices_are_read_as_whole_numbers_and_named_in_their_type(sheet: Running):
    solver = sheet.variables["solver"]
    assert solver.type == "Enumeration"
    (number,) = sheet.slave.getInt64([solver.valueReference])
    names = {int(item.value): item.name for item in solver.declaredType.items}
    assert names[number] == "adams"
    with pytest.raises(Exception, match="fmi3SetInt64"):
        sheet.slave.setInt64([solver.valueReference], [1])


TERMINALS: dict[str, tuple[Model, str, dict[str, tuple[str, str]]]] = {
    "four-bar": (
        FourBar(),
        "crank",
        {"crank.angle": ("phi", "signal"), "crank.rate": ("w", "signal"), "crank.torque": ("tau", "inflow")},
    ),
    "governor": (Governor(), "spindle", {"spindle.drive": ("w", "signal"), "spindle.effort": ("tau", "inflow")}),
    "free governor": (
        Governor(driven=False),
        "spindle",
        {"spindle.angle": ("phi", "signal"), "spindle.speed": ("w", "signal"), "spindle.torque": ("tau", "inflow")},
    ),
    "pendulum": (SwingPendulum(), "crank", {"crank.drive": ("w", "signal"), "crank.effort": ("tau", "inflow")}),
}


@native
@pytest.mark.parametrize("kind", ["native, FMI 3", "native, FMI 2", "Python"])
@pytest.mark.parametrize("name", TERMINALS)
def test_a_shaft_is_a_terminal_of_variables_that_there_are(name: str, kind: str, tmp_path: Path):
    model, shaft, members = TERMINALS[name]
    path = export(model, tmp_path / "model.fmu", ADAMS, native=kind != "Python", fmi=3 if kind.endswith("3") else 2)
    assert validate_fmu(str(path)) == []
    known = {v.name for v in read_model_description(str(path)).modelVariables}
    with zipfile.ZipFile(path) as archive:
        root = etree.fromstring(archive.read("terminalsAndIcons/terminalsAndIcons.xml"))
    etree.XMLSchema(etree.parse(str(SCHEMA))).assertValid(root)
    (terminal,) = root.iter("Terminal")
    assert terminal.get("name") == shaft
    told = {m.get("variableName"): (m.get("memberName"), m.get("variableKind")) for m in terminal}
    assert told == members
    assert set(told) <= known


@native
def test_models_without_terminals_have_no_file_of_them(tmp_path: Path):
    for fmi in (2, 3):
        path = export(Swing(), tmp_path / "model.fmu", ADAMS, native=True, fmi=fmi)
        assert not [name for name in zipfile.ZipFile(path).namelist() if "terminals" in name]


@native
@pytest.mark.parametrize(("native_one", "fmi"), [(True, 2), (True, 3), (False, 2)])
def test_files_for_people_have_the_places_of_the_standard(native_one: bool, fmi: int, tmp_path: Path):
    path = export(FourBar(), tmp_path / "model.fmu", ADAMS, native=native_one, fmi=fmi)
    with zipfile.ZipFile(path) as archive:
        names = set(archive.namelist())
        listed = archive.read("documentation/licenses/license.txt").decode()
    folder = "documentation/licenses/"
    licenses = {name.removeprefix(folder) for name in names if name.startswith(folder)} - {"license.txt"}
    assert licenses == {line[2:] for line in listed.splitlines() if line.startswith("- ")}
    assert {"terminalsAndIcons/icon.png", "documentation/index.html"} <= names
    assert ("model.png" in names) == (fmi == 2)
    assert ("documentation/externalDependencies.txt" in names) == (not native_one)
    assert ("documentation/source/core.c" in names) == native_one


@native
@pytest.mark.parametrize(
    ("several", "members", "told"),
    [
        ({}, ("angle", "torque"), "terminal 'shaft' has 'torque', which is not an input or output of the FMU"),
        ({"tip": ("tip.x", "tip.y")}, ("tip.x",), "terminal 'shaft' has 'tip.x', which is not an input"),
        ({}, ("angle", "tip.x"), "terminal 'shaft' has variables in rad, m; allowed: one each in rad"),
        ({}, (), "terminal 'shaft' has variables in no unit"),
    ],
)
def test_what_is_no_terminal_is_refused(several: dict[str, Any], members: tuple[str, ...], told: str, tmp_path: Path):
    model = Swing(several=several.items(), held={"shaft": members}.items())
    with pytest.raises(UserError, match=told):
        export(model, tmp_path / "model.fmu", ADAMS, native=True, fmi=3)
