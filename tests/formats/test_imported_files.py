"""Files that are imported: values, names, loops, and the written code."""

from __future__ import annotations

import re
import shlex
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from imported_texts import ARM, INERTIAL, bar, fixed, mjcf, written
from scipy.spatial.transform import Rotation

import mbfmu as mb
from mbfmu.cli import main
from mbfmu.fmi.python_fmu import own_source
from mbfmu.formats.imported import model_of, source_code
from mbfmu.formats.literals import inertia_text, number_text, rotation_text
from mbfmu.formats.names import RESERVED, Names, identifier
from mbfmu.modeling.scene import scenes

# ---- what is written ------------------------------------------------------------------------------------------------


def test_a_model_has_the_values_of_its_file_as_parameters(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="not-imported"):
        model = mb.load(written(tmp_path, ARM, "arm.urdf"))
    values = {p.name: (p.default, p.unit) for p in model.parameters()}
    assert values["upper_mass"] == (2.0, "kg")
    assert values["shoulder_damping"] == (0.5, "N.m.s/rad")
    assert values["shoulder_friction"] == (0.2, "N.m")
    assert values["elbow_start"] == (0.0, "rad")
    assert values["gravity"] == (9.81, "m/s2")
    compiled = model.compile()
    assert {variable.name for variable in compiled.inputs.variables} == {"shoulder.torque", "elbow.torque"}
    names = [variable.name for variable in compiled.outputs]
    assert names == [
        "shoulder.angle",
        "shoulder.rate",
        "elbow.angle",
        "elbow.rate",
        "tool.x",
        "tool.y",
        "tool.z",
        "energy",
    ]


def test_an_imported_arm_moves_as_its_closed_form(tmp_path: Path) -> None:
    """One link with gravity and a torque of 70 N m, which is limited to 50: (J + m l^2) q'' = tau - m g l cos q."""
    text = ARM.replace('type="continuous"', 'type="fixed"').replace(' friction="0.2"', "")
    found: list[str] = []
    model: Any = mb.load(written(tmp_path, text, "arm.urdf"), report=found.append)
    assert [message.split("[")[1] for message in found] == ["not-imported]", "changed-import]"]
    assert model.shoulder_drive_limit == 30.0
    model = model.with_values({"shoulder_damping": 0.0, "shoulder_drive_limit": 50.0})
    result = mb.simulate(model, 0.2, interval=0.01, solver="adams", tolerance=1e-10, inputs={"shoulder.torque": 70.0})
    inertia = 2 * 0.04 + 2.0 * (0.5**2 + 1.5**2)
    q, v = result["shoulder.angle"], result["shoulder.rate"]
    energy = 0.5 * inertia * v**2 + 2.0 * 9.81 * (0.5 + 1.5) * np.sin(q)
    np.testing.assert_allclose(energy, 50.0 * q, atol=1e-8)
    assert q[-1] > 0.02
    np.testing.assert_allclose(result["tool.z"], 1.0 + 2.0 * np.sin(q), atol=1e-9)


def test_written_code_is_the_model_and_needs_no_mujoco(
    command: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm, target = written(tmp_path, ARM, "arm.urdf"), tmp_path / "robot.py"
    code, out, err = command("import", str(arm), "-o", str(target))
    assert (code, err) == (0, "")
    assert "warning: not imported: velocity limits of joints (shoulder)" in out
    assert out.endswith(f"Arm: 4 bodies, 2 joints, 0 loops and couplings, 10 parameters, 8 outputs\nwrote {target}\n")
    monkeypatch.setitem(sys.modules, "mujoco", None)
    model = mb.find(str(target))(upper_mass=3.0)
    assert model.compile().mechanism.bodies[2].mass == 3.0
    code, _, err = command("import", str(arm), "-o", str(target))
    assert code == 2
    assert "exists and may have been edited" in err
    code, _, err = command("import", str(arm), "-o", str(tmp_path / "other.py"))
    assert code == 2
    assert "pip install 'mbfmu[import]'" in err
    assert sorted(path.name for path in tmp_path.iterdir() if path.is_file()) == ["arm.urdf", "robot.py"]


def test_code_is_short_and_equal_up_to_rounding() -> None:
    assert number_text(0.1 + 0.2) == "0.3"
    assert number_text(-0.0) == "0"
    assert inertia_text(np.diag((0.1 + 0.2, 2.0, 3e-20))) == "(0.3, 2, 0)"
    assert (
        rotation_text(Rotation.from_euler("y", 90, degrees=True).as_matrix())
        == 'Rotation.from_euler("y", 90, degrees=True)'
    )
    assert (
        rotation_text(Rotation.from_euler("xz", (1.5708, 0.2)).as_matrix())
        == 'Rotation.from_euler("xz", (1.5708, 0.2))'
    )
    rng = np.random.default_rng(1)
    for R in Rotation.random(50, rng=rng).as_matrix():
        again = eval(rotation_text(R), {"Rotation": Rotation}).as_matrix()
        np.testing.assert_allclose(again, R, rtol=0.0, atol=3e-15)
    for x in rng.standard_normal(50) * 10.0 ** rng.integers(-20, 20, 50):
        assert float(number_text(x)) == pytest.approx(x, rel=5e-15)


def test_the_page_on_imports_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    page = (Path(__file__).parents[2] / "docs" / "importing.md").read_text()
    (robot,) = re.findall(r"```xml\n(.*?)```", page, flags=re.DOTALL)
    Path("arm.urdf").write_text(robot)
    for line in re.findall(r"^mbfmu .*", page, re.MULTILINE):
        assert main(shlex.split(line, comments=True)[1:]) == 0
    assert any(name.endswith("model.bin") for name in zipfile.ZipFile("arm.fmu").namelist()), "it is native"
    for block in re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL):
        capsys.readouterr()
        exec(compile(block, "docs/importing.md", "exec"), {})
        assert re.findall(r"^print\(.*#\s(.*)", block, re.MULTILINE) == capsys.readouterr().out.splitlines()[-1:]
    model = mb.load("arm.urdf", report=print)
    mb.export(model, "loaded.fmu")
    assert any(name.endswith("model.bin") for name in zipfile.ZipFile("loaded.fmu").namelist())
    assert "class Arm(mb.Model)" in own_source(type(model)), "FMUs that call Python contain the model"
    assert list(scenes(type(model))) == ["default"]


# ---- names ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("left arm", "left_arm"), ("Gelenk-Fläche/2", "Gelenk_Flache_2"), ("2nd", "_2nd"), ("右腕", ""),
        ("a__b", "a__b"),
        ("__init__", "init"), ("Ørsted 'x'\n", "Orsted_x"), ("ﬁn", "fin"), ("x" * 200, "x" * 60),
    ],
)  # fmt: skip
def test_names_become_identifiers(name: str, expected: str) -> None:
    assert identifier(name) == expected


def test_identifiers_are_different_and_no_keywords_of_python() -> None:
    names = Names(RESERVED)
    found = [names.new(name, "part") for name in ("class", "a b", "a-b", "a_b", "a_b_2", "m", "右", "左", "print")]
    assert found == ["class_2", "a_b", "a_b_2", "a_b_3", "a_b_2_2", "m_2", "part", "part_2", "print_2"]


def test_any_names_in_a_file_give_a_model_that_can_be_exported(tmp_path: Path) -> None:
    names = [
        '"""',
        "'; import os #",
        "a\\",
        "lambda",
        "self",
        "m",
        "a b",
        "a-b",
        "右腕",
        "x" * 300,
        "{x}",
        "&amp;%s",
        "gravity",
    ]
    bodies = "".join(
        f"<body name='{name.replace(chr(39), '&apos;')}'><joint name='{name.replace(chr(39), '&apos;')}' damping='1' "
        f"range='0 1' frictionloss='1'/>{INERTIAL}</body>"
        for name in names
    )
    code, found = source_code(written(tmp_path, mjcf(bodies), 'a"""b.xml'))
    model = model_of(code)
    mechanism = model.built()
    assert len(mechanism.bodies) == len(names) + 1
    assert len({body.name for body in mechanism.bodies}) == len(names) + 1
    assert all(name.isidentifier() for body in mechanism.bodies for name in (body.name,))
    assert "'a b': a_b" in code
    assert len(found) == 1


def test_a_file_without_names_gets_names_with_numbers(tmp_path: Path) -> None:
    body = f"<body><joint/><joint axis='1 0 0'/>{INERTIAL}<body><freejoint/>{INERTIAL}</body></body>"
    body = body.replace("<body><freejoint/>", "<body><joint type='ball'/>")
    code, _ = source_code(written(tmp_path, mjcf(body), "123 ?.xml"))
    model = model_of(code)
    assert [b.name for b in model.built().bodies] == ["ground", "body1_1", "body1", "body2"]
    assert model.name == "_123"


def test_a_loop_is_closed_on_request(tmp_path: Path) -> None:
    """A parallelogram swings as a pendulum: (2 m l^2 / 3 + M l^2) w^2 / 2 + (m + M) g l sin q is constant."""
    links = bar("crank", 1.0, 1.0, "base", 0.0) + bar("coupler", 2.0, 3.0, "crank", 1.0)
    links += bar("rocker", 1.0, -1.0, "coupler", 3.0) + fixed("end", "rocker", -1.0) + fixed("pivot", "base", 3.0)
    path = written(tmp_path, f'<robot name="fourbar"><link name="base"/>{links}</robot>', "fourbar.urdf")
    assert "mb.RevoluteCutJoint(" in source_code(path, close=[("end", "pivot", "revolute")])[0]
    model = mb.load(path, strict=True, close=[("end", "pivot")])
    model = model.with_values({"crank_start": 1.0, "coupler_start": -1.0, "rocker_start": 1.0})
    result = mb.simulate(model, 0.5, interval=0.05, solver="adams", tolerance=1e-9)
    q, w = result["crank.angle"], result["crank.rate"]
    energy = 0.5 * (2.0 / 3.0 + 2.0) * w**2 + 3.0 * 9.81 * np.sin(q)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-7)
    assert abs(q[-1] - q[0]) > 0.1
    np.testing.assert_allclose(result["coupler.angle"], -q, atol=1e-7)


@pytest.mark.parametrize(
    ("close", "message"),
    [
        (["tool"], "allowed: two bodies, and the kind: spherical, revolute, weld; or a TOML file"),
        (["none.toml"], "file of loops 'none.toml' cannot be read"),
        (["tol", "base"], "the file has no body 'tol'; did you mean 'tool'"),
        (["tool", "base", "hinge"], "kind 'hinge'; allowed: revolute, spherical, weld"),
        (["tool", "tool"], "connects a body to itself"),
    ],
)
def test_loops_that_cannot_be_closed_are_refused(
    tmp_path: Path, command: Callable[..., Any], close: list[str], message: str
) -> None:
    code, _, err = command("import", str(written(tmp_path, ARM, "arm.urdf")), "-o", "-", "--close", *close)
    assert code == 2
    assert message in err


@pytest.mark.parametrize("name", ["&quot;", "&quot;&quot;&quot;", "日本&quot;", "\\"])
def test_names_of_which_nothing_remains_are_replaced(tmp_path: Path, name: str) -> None:
    path = tmp_path / "odd.xml"
    body = '<body><joint name="h"/><geom size=".1" pos=".2 0 0" contype="0" conaffinity="0"/></body>'
    path.write_text(
        f'<mujoco><worldbody>{body}</worldbody><actuator><motor name="{name}" joint="h"/></actuator></mujoco>'
    )
    assert len(mb.load(path).compile().inputs.variables) == 1


def test_a_file_of_loops_gives_points_and_axes(tmp_path: Path) -> None:
    """The same four-bar without links at the ends of its bars."""
    links = bar("crank", 1.0, 1.0, "base", 0.0) + bar("coupler", 2.0, 3.0, "crank", 1.0)
    links += bar("rocker", 1.0, -1.0, "coupler", 3.0)
    path = written(tmp_path, f'<robot name="fourbar"><link name="base"/>{links}</robot>', "fourbar.urdf")
    loops = '[[close]]\na = "rocker"\nb = "base"\njoint = "revolute"\nat_a = [-1, 0, 0]\nat_b = [3, 0, 0]\n'
    loops += "axis_a = [0, 1, 0]\naxis_b = [0, 2, 0]\n"
    file = written(tmp_path, loops, "loops.toml")
    for close in (file, str(file), [[str(file)]]):
        (handle,) = mb.load(path, strict=True, close=close).built().cuts
        assert (handle.a.name, handle.b.name) == ("rocker", "base")
        np.testing.assert_allclose((handle.cut.at_a, handle.cut.at_b), ((-1, 0, 0), (3, 0, 0)))
        for R in handle.cut.frames():
            np.testing.assert_allclose(R[:, 2], (0, 1, 0), atol=1e-15)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[[loop]]\na = "x"', r"contains \['loop'\]; allowed: tables \[\[close\]\] with a, b, joint, at_a"),
        ('close = "x"', "allowed: tables"),
        ('[[close]]\na = "tool"', r"\[\[close\]\] number 1 has b = None; allowed: the name of a body"),
        ('[[close]]\na = "tool"\nb = "base"\nat = [0]', "has the key 'at'; did you mean 'at_b'|'at_a'"),
        ('[[close]]\na = "tool"\nb = "base"\nat_a = [0]', "at_a is .* needs three finite numbers"),
        ('[[close]]\na = "tool"\nb = "base"\naxis_a = [1, 0, 0]', "has axes and is spherical"),
        ('[[close]]\na = "tool"\nb = "base"\njoint = "revolute"\naxis_a = [0, 0, 0]', "axis_a"),
        ("[[close", "is not valid TOML"),
    ],
)  # fmt: skip
def test_wrong_files_of_loops_are_refused(tmp_path: Path, text: str, message: str) -> None:
    path, file = written(tmp_path, ARM, "arm.urdf"), written(tmp_path, text, "loops.toml")
    with pytest.raises(mb.UserError, match=message):
        mb.load(path, close=file, report=print)
