"""Systems of FMUs: the archive against the schema of SSP 1.0, in two tools, and mistakes."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import fmpy.ssp
import numpy as np
import pytest
from fmpy.ssp.simulation import simulate_ssp
from lxml import etree

import mbfmu as mb
from mbfmu.cli import main
from mbfmu.fmi.ssp import write_ssp
from mbfmu.util.errors import UserError


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return mb.export(
        mb.find("pendulum")(), tmp_path_factory.mktemp("ssp") / "p.fmu", mb.Settings(solver="adams"), native=False
    )


@pytest.fixture(scope="module")
def ends(pendulum: Path) -> tuple[str, str]:
    """Return an output and an input of the pendulum, in the same unit."""
    described = fmpy.read_model_description(str(pendulum))
    inputs = [v for v in described.modelVariables if v.causality == "input" and v.type == "Real"]
    outputs = [v for v in described.modelVariables if v.causality == "output" and v.type == "Real"]
    return next((o.name, i.name) for i in inputs for o in outputs if o.unit == i.unit)


def test_the_description_follows_the_schema_and_equal_systems_are_equal_bytes(
    pendulum: Path, ends: tuple[str, str], tmp_path: Path
) -> None:
    def write(name: str) -> Path:
        links = [(f"one.{ends[0]}", f"other.{ends[1]}")]
        parameter = next(p.name for p in mb.find("pendulum")().parameters() if p.tunable)
        value = getattr(mb.find("pendulum")(), parameter)
        return write_ssp(
            tmp_path / name / "s.ssp", {"one": pendulum, "other": pendulum}, links, {f"other.{parameter}": value}
        )

    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    first, second = write("a"), write("b")
    assert first.read_bytes() == second.read_bytes()
    with zipfile.ZipFile(first) as archive:
        assert sorted(archive.namelist()) == ["SystemStructure.ssd", "resources/one.fmu"]
        root = etree.fromstring(archive.read("SystemStructure.ssd"))
    schema = Path(fmpy.ssp.__file__).parent / "schema" / "SystemStructureDescription.xsd"
    etree.XMLSchema(etree.parse(str(schema))).assertValid(root)
    assert len(root.findall(".//{*}Connection")) == 1
    assert len(root.findall(".//{*}Parameter")) == 1


@pytest.mark.parametrize("tool", ["fmpy", "libcosim"])
def test_a_model_alone_moves_as_its_simulation_does(
    tmp_path: Path, tool: str, capsys: pytest.CaptureFixture[str]
) -> None:
    if tool == "libcosim" and find_spec("libcosimpy") is None:
        pytest.skip("libcosimpy is not installed")
    ssp, step, steps = tmp_path / "p.ssp", 0.01, 40
    assert main(["ssp", "pendulum", "--solver", "adams", "--set", "free_length=0.5", "-o", str(ssp)]) == 0
    capsys.readouterr()
    model = mb.find("pendulum")(free_length=0.5)
    result = mb.simulate(model, solver="adams", stop_time=step * steps, interval=step)
    name = next(v.name for v in result.variables if v.unit == "rad")
    if tool == "fmpy":
        found = simulate_ssp(str(ssp), stop_time=step * steps, step_size=step)
        got = found[f"pendulum.{name}"][: steps - 1]  # FMPy gives the result of a step the time of its beginning
    else:
        from libcosimpy.CosimExecution import CosimExecution
        from libcosimpy.CosimObserver import CosimObserver

        execution = CosimExecution.from_ssp_file(str(ssp), round(step * 1e9))
        observer = CosimObserver.create_last_value()
        execution.add_observer(observer)
        index = execution.slave_index_from_instance_name("pendulum")
        place = next(v.reference for v in execution.slave_variables(index) if v.name.decode() == name)
        got = []
        for _ in range(steps - 1):
            assert execution.step()
            got.append(observer.last_real_values(index, [place])[0])
    np.testing.assert_allclose(got, result[name][1:steps], rtol=0.0, atol=1e-9)


MISTAKES: dict[str, tuple[Callable[[Path, str, str], dict[str, object]], str]] = {
    "no component": (lambda p, o, i: {"connections": [(f"two.{o}", f"one.{i}")]}, "no component 'two'"),
    "no variable": (lambda p, o, i: {"connections": [(f"one.{o}x", f"one.{i}")]}, "there is no such variable"),
    "reversed": (
        lambda p, o, i: {"connections": [(f"one.{i}", f"one.{o}")]},
        "its causality is 'input'; allowed: output",
    ),
    "twice": (lambda p, o, i: {"connections": [(f"one.{o}", f"one.{i}")] * 2}, "allowed: one output"),
    "no FMU": (lambda p, o, i: {"components": {"one": p / "none.fmu"}}, "does not exist"),
    "a text": (lambda p, o, i: {"components": {"one": Path(__file__)}}, "is not an FMU"),
    "a name": (lambda p, o, i: {"components": {"o.ne": p / "p.fmu"}}, "letters, digits and underscores"),
    "no parameter": (
        lambda p, o, i: {"values": {f"one.{o}": 1.0}},
        "its causality is 'output'; allowed: parameter or input",
    ),
    "no number": (lambda p, o, i: {"values": {"one.tolerance": np.nan}}, "a finite number"),
    "a word": (lambda p, o, i: {"values": {"one.tolerance": "small"}}, "a finite number"),
    "nothing": (lambda p, o, i: {"components": {}}, "no components"),
    "a limit": (lambda p, o, i: {"values": {"one.tolerance": -1.0}}, "allowed by its FMU"),
    "stop": (lambda p, o, i: {"stop_time": -1.0}, "greater than zero"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_refused_and_nothing_is_written(
    mistake: str, pendulum: Path, ends: tuple[str, str], tmp_path: Path
) -> None:
    change, text = MISTAKES[mistake]
    arguments = {"components": {"one": pendulum}, **change(pendulum.parent, *ends)}
    with pytest.raises(UserError, match=text):
        write_ssp(tmp_path / "s.ssp", **arguments)  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []


def test_units_of_both_ends_agree(pendulum: Path, ends: tuple[str, str], tmp_path: Path) -> None:
    described = fmpy.read_model_description(str(pendulum))
    unit = next(v.unit for v in described.modelVariables if v.name == ends[1])
    other = next(v.name for v in described.modelVariables if v.causality == "output" and v.unit not in (None, unit))
    with pytest.raises(UserError, match="allowed: equal units"):
        write_ssp(tmp_path / "s.ssp", {"one": pendulum}, [(f"one.{other}", f"one.{ends[1]}")])
