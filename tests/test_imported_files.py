"""Files that are imported: names, numbers, what is lost, files that are refused, and the written code."""

from __future__ import annotations

import re
import shlex
import sys
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import mbfmu as mb
from mbfmu.cli import main
from mbfmu.formats.imported import model_of, source_code
from mbfmu.formats.literals import inertia_text, number_text, rotation_text
from mbfmu.formats.names import RESERVED, Names, identifier
from mbfmu.util import extras

ROBOTS = Path(__file__).parent / "data" / "robots"
INERTIA = '<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.04"/>'
LINK = f'<inertial><origin xyz="0.5 0 0"/><mass value="2"/>{INERTIA}</inertial>'
INERTIAL = '<inertial pos="0.5 0 0" mass="2" diaginertia="0.02 0.03 0.04"/>'

ARM = f"""
<robot name="arm">
  <link name="base"/>
  <link name="upper">{LINK}</link>
  <link name="lower">{LINK}</link>
  <link name="tool"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/><origin xyz="0 0 1" rpy="1.5707963267948966 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="2" effort="30" velocity="3"/><dynamics damping="0.5" friction="0.2"/>
  </joint>
  <joint name="elbow" type="continuous">
    <parent link="upper"/><child link="lower"/><origin xyz="1 0 0"/><axis xyz="0 0 1"/>
  </joint>
  <joint name="flange" type="fixed"><parent link="lower"/><child link="tool"/><origin xyz="1 0 0"/></joint>
</robot>
"""


def written(tmp_path: Path, text: str | bytes, name: str = "file.xml") -> Path:
    path = tmp_path / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def mjcf(body: str, rest: str = "") -> str:
    return f"<mujoco><worldbody>{body}</worldbody>{rest}</mujoco>"


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
    assert sorted(path.name for path in tmp_path.iterdir()) == ["arm.urdf", "robot.py"]


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
    page = (Path(__file__).parents[1] / "docs" / "importing.md").read_text()
    (robot,) = re.findall(r"```xml\n(.*?)```", page, flags=re.DOTALL)
    Path("arm.urdf").write_text(robot)
    for line in re.findall(r"^mbfmu .*", page, re.MULTILINE):
        assert main(shlex.split(line, comments=True)[1:]) == 0
    assert any(name.endswith("model.bin") for name in zipfile.ZipFile("arm.fmu").namelist()), "it is native"
    for block in re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL):
        capsys.readouterr()
        exec(compile(block, "docs/importing.md", "exec"), {})
        assert re.findall(r"^print\(.*#\s(.*)", block, re.MULTILINE) == capsys.readouterr().out.splitlines()[-1:]


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


def test_identifiers_are_different_and_no_words_of_python() -> None:
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


# ---- what is lost ---------------------------------------------------------------------------------------------------

LOST = f"""
<body name="a"><joint name="j" stiffness="1" range="-1 1" limited="true"/><geom size="0.1"/><site name="s"/></body>
<body name="b" pos="1 0 0"><joint name="k" type="ball" damping="1" armature="1" stiffness="1" range="0 1"/>
  <geom size="0.1"/><site name="t"/></body>
<body name="c" mocap="true" pos="2 0 0"><geom size="0.1"/></body>
<body name="d" pos="3 0 0"><joint name="l" type="slide"/>{INERTIAL}</body>
"""
REST = """
<option density="1"/>
<tendon><spatial name="rope" limited="true" range="0 1"><site site="s"/><site site="t"/></spatial>
  <fixed name="sum" stiffness="1"><joint joint="j" coef="1"/><joint joint="l" coef="2"/></fixed></tendon>
<actuator><motor name="u" tendon="sum"/><muscle name="v" joint="j" lengthrange="0 1"/>
  <intvelocity name="w" joint="j" actrange="0 1"/>
  <motor name="x" joint="j" ctrlrange="-1 1"/><position name="y" joint="l" kp="2" forcerange="-1 1"/></actuator>
<equality><connect name="off" body1="a" body2="b" anchor="0 0 0" active="false"/>
  <tendon name="e" tendon1="sum"/></equality>
<keyframe><key name="home"/></keyframe>
"""


def test_everything_that_is_not_imported_is_listed(tmp_path: Path, command: Callable[..., Any]) -> None:
    path = written(tmp_path, mjcf(LOST, REST))
    code, found = source_code(path)
    texts = [str(d) for d in found if d.severity == "warning"]
    for expected in (
        "contact between shapes (3 shapes)", "damping of ball joints and free joints (k)",
        "armature of ball joints and free joints (k)", "springs of ball joints and free joints (k)",
        "ranges of ball joints (k)", "mocap bodies (c)", "forces of the fluid",
        "ranges, friction and armature of tendons (rope)",
        "tendons, but springs between two sites (sum)", "actuators that do not act on a hinge or a slide (u)",
        "actuators with dynamics, muscles and user-defined laws (v, w)",
        "limits of the forces of servos (y)",
        "equality constraints that are inactive at the start (off)",
        "equality constraints but connect, weld and joint (e)",
    ):  # fmt: skip
        assert sum(f"not imported: {expected}" in text for text in texts) == 1, expected
        assert f"- {expected}" in code
    assert len(texts) == 14
    assert {d.text.split(" ")[0] for d in found if d.severity == "note"} == {"keyframes", "ranges"}
    status, _, err = command("import", str(path), "--strict", "-o", str(tmp_path / "x.py"))
    assert status == 2
    assert "14 kinds of elements are not imported: " in err
    assert not (tmp_path / "x.py").exists()


def test_a_complete_import_has_no_warning(tmp_path: Path) -> None:
    code, found = source_code(
        written(tmp_path, mjcf(f"<body><joint damping='1' armature='2'/>{INERTIAL}</body>")), strict=True
    )
    assert found == []
    assert "Not imported" not in code


def test_a_fixed_base_moves_freely_on_request(tmp_path: Path) -> None:
    text = ARM.replace('<link name="base"/>', f'<link name="base">{LINK}</link>')
    path = written(tmp_path, text, "arm.urdf")
    model = mb.load(path, floating=True, report=print)
    assert model.compile().system.n == 9  # with the state of the friction
    assert mb.load(path, report=print).compile().system.n == 3


def urdf(inertia: str, mass: float = 2.0, joint: str = "continuous", rest: str = "") -> str:
    inertial = f'<inertial><origin rpy="0.3 0.2 0.1"/><mass value="{mass}"/>{inertia}</inertial>'
    return (
        f'<robot name="r"><link name="a"/><link name="b">{inertial}</link><joint name="j" type="{joint}">'
        f'<parent link="a"/><child link="b"/><origin xyz="1 0 0"/></joint>{rest}</robot>'
    )


def moments(xx: float, yy: float, zz: float) -> str:
    return f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/>'


@pytest.mark.parametrize(
    ("given", "used"), [((0, 3, 3), (0, 3, 3)), ((1, 2, 3.0003), (1, 2, 3)), ((3, 1, 2), (3, 1, 2))]
)
def test_slender_rods_and_rounded_inertias_are_imported(tmp_path: Path, given: Any, used: Any) -> None:
    """MuJoCo refuses the first two."""
    code, found = source_code(written(tmp_path, urdf(moments(*given))))
    R = Rotation.from_euler("xyz", (0.3, 0.2, 0.1)).as_matrix()
    expected = R @ np.diag(used) @ R.T
    np.testing.assert_allclose(model_of(code).built().bodies[-1].inertia, expected, rtol=0.0, atol=1e-13)
    assert len(found) == (given != used)
    assert all("inertias of bodies are corrected by up to 0.0001 (b)" in str(d) for d in found)


def test_bodies_that_do_not_move_may_have_any_inertia(tmp_path: Path) -> None:
    rest = f'<link name="c">{LINK}</link><joint name="k" type="continuous"><parent link="b"/><child link="c"/></joint>'
    path = written(tmp_path, urdf(moments(-1, 5, 1), joint="fixed", rest=rest))
    model = model_of(source_code(path, strict=True)[0])
    assert not np.any(model.built().bodies[2].inertia)
    with pytest.raises(mb.UserError, match=r"inertias of bodies are impossible \(b \(-1, 1, 5\), principal moments"):
        source_code(path, floating=True)


def test_links_without_mass_may_be_between_joints(tmp_path: Path) -> None:
    """A universal joint of two hinges; the link between them has no inertia."""
    rest = '<link name="c">{}</link><joint name="k" type="continuous"><parent link="b"/><child link="c"/></joint>'
    path = written(tmp_path, urdf(moments(0, 0, 0), mass=0.0, rest=rest.format(LINK)))
    mechanism = model_of(source_code(path, strict=True)[0]).built()
    assert [body.mass for body in mechanism.bodies] == [0.0, 0.0, 0.0, 2.0]
    written(tmp_path, urdf(moments(0, 0, 0), mass=0.0, rest=rest.format("")))
    with pytest.raises(mb.UserError, match=r"joints move no mass \(those of b, c\)"):
        source_code(path)


def bar(name: str, mass: float, length: float, parent: str, at: float) -> str:
    thin = mass * length**2 / 12.0
    inertial = f'<origin xyz="{length / 2} 0 0"/><mass value="{mass}"/>{moments(0.0, thin, thin)}'
    return (
        f'<link name="{name}"><inertial>{inertial}</inertial></link><joint name="{name}" type="continuous">'
        f'<parent link="{parent}"/><child link="{name}"/><origin xyz="{at} 0 0"/><axis xyz="0 -1 0"/></joint>'
    )


def fixed(name: str, parent: str, at: float) -> str:
    joint = f'<parent link="{parent}"/><child link="{name}"/><origin xyz="{at} 0 0"/>'
    return f'<link name="{name}"/><joint name="{name}_fixed" type="fixed">{joint}</joint>'


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
        (["tool"], "allowed: two bodies, and the kind: spherical, revolute, weld"),
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


# ---- refused files --------------------------------------------------------------------------------------------------

BOMB = b'<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]><mujoco model="&b;"><worldbody/></mujoco>'
MESH = '<geom type="mesh" mesh="shell"/>'
ASSET = '<asset><mesh name="shell" file="shell.stl"/></asset>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"", "is empty"),
        (b" \n ", "is empty"),
        (b"solid mesh", "is not valid XML"),
        (b"\x00\x01\xff\xfe", "is not UTF-8 text at byte 2"),
        ('<?xml version="1.0" encoding="ISO-8859-1"?><robot name="é"/>'.encode("latin-1"), "is not UTF-8 text"),
        (mjcf("<body><joint/><geom size='.1' pos='nan 0 0'/></body>"), "such as <geom pos='nan 0 0'>"),
        (b"<mujoco><worldbody>", "is not valid XML"),
        (BOMB, "document type or entities"),
        (b"<sdf version='1.6'/>", "has the root element <sdf>; allowed: <robot> of URDF and <mujoco> of MJCF"),
        (b"<mujoco/>", "has no joint that moves a body"),
        (b"<robot name='r'><link name='a'/></robot>", "has no joint that moves a body"),
        (mjcf("<body><joint/><weel/></body>"), "unrecognized element; Element 'weel', line 1"),
        (mjcf("<body name='arm'><joint/></body>"), r"Element name 'arm', id 1, line 1\. Give this body a mass"),
        (mjcf("<body name='arm'><joint/><inertial pos='0 0 0' mass='1' diaginertia='1 1 3'/></body>"), "A . B >= C"),
        (mjcf(f"<body><joint axis='0 0 0'/>{INERTIAL}</body>"), "axis too small"),
        (mjcf(f"<body><joint damping='inf'/>{INERTIAL}</body>"), "dof_damping of MuJoCo is not finite at number 0"),
        (mjcf(f"<body><joint ref='nan'/>{INERTIAL}</body>"), "such as <joint ref='nan'>"),
        (mjcf(f"<body name='arm'><joint/>{MESH}</body>", ASSET), r"body 'arm' has its mass and inertia from the mesh"),
        ("<robot name='r' xmlns:xacro='http://www.ros.org/wiki/xacro'><xacro:a/></robot>", "contains macros of xacro"),
        (f"<robot name='r'><link name='a'/><link name='b'>{LINK}</link><joint name='j' type='revolute'>"
         "<parent link='a'/><child link='c'/></joint></robot>", "joint parent or child missing"),
        (mjcf("<body/>" * 20_001), "has 20001 bodies; allowed: up to 20000"),
        (mjcf(f"<replicate count='30000'><body><joint/>{INERTIAL}</body></replicate>"), "bodies; allowed: up to 20000"),
    ],
)  # fmt: skip
def test_files_that_are_no_models_are_refused(tmp_path: Path, text: str | bytes, message: str) -> None:
    begin = time.process_time()
    with pytest.raises(mb.UserError, match=message):
        source_code(written(tmp_path, text))
    assert time.process_time() - begin < 5.0
    assert [path.name for path in tmp_path.iterdir()] == ["file.xml"], "MuJoCo writes no log"


def test_chains_that_would_take_hours_are_refused(tmp_path: Path) -> None:
    joints = "".join(
        f'<link name="l{i}">{LINK}</link><joint name="j{i}" type="continuous"><parent link="l{i - 1}"/>'
        f'<child link="l{i}"/></joint>'
        for i in range(1, 25_000)
    )
    path = written(tmp_path, f'<robot name="r"><link name="l0"/>{joints}</robot>', "chain.urdf")
    with pytest.raises(mb.UserError, match="has 25000 bodies"):
        source_code(path)
    path.write_text('<robot name="r"><link name="l0"/>' + joints[: joints.index('<link name="l2000"')] + "</robot>")
    with pytest.raises(mb.UserError, match="has a chain of 1999 joints; allowed: up to 1000"):
        source_code(path)


def test_paths_that_are_no_files_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "none.urdf", Path("/dev/null"), Path("a\0b")):
        with pytest.raises(mb.UserError, match=r"cannot be read|is empty"):
            mb.load(path)


def test_a_mesh_that_has_no_part_in_the_motion_may_be_missing(tmp_path: Path) -> None:
    path = written(tmp_path, mjcf(f"<body><joint/>{INERTIAL}{MESH}</body>", ASSET))
    assert source_code(path)[1] == []


def test_warnings_of_mujoco_are_notes(tmp_path: Path) -> None:
    text = mjcf(f"<body><joint/>{INERTIAL}</body>", "<compiler settotalmass='4'/>")
    (found,) = source_code(written(tmp_path, text), strict=True)[1]
    assert found.severity == "note"
    assert "MuJoCo reports: compiler attribute 'settotalmass' is deprecated" in found.text


def test_an_old_version_of_mujoco_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    old = type(sys)("mujoco")
    old.__version__ = "3.3.7"  # type: ignore[attr-defined]
    monkeypatch.setattr(extras, "import_module", lambda _: old)
    with pytest.raises(mb.UserError, match=r"mujoco 3\.3\.7 is installed; 4\.0 or newer is required"):
        source_code(written(tmp_path, ARM))


@pytest.mark.parametrize("name", ["&quot;", "&quot;&quot;&quot;", "日本&quot;", "\\"])
def test_names_of_which_nothing_remains_are_replaced(tmp_path: Path, name: str) -> None:
    path = tmp_path / "odd.xml"
    body = '<body><joint name="h"/><geom size=".1" pos=".2 0 0" contype="0" conaffinity="0"/></body>'
    path.write_text(
        f'<mujoco><worldbody>{body}</worldbody><actuator><motor name="{name}" joint="h"/></actuator></mujoco>'
    )
    assert len(mb.load(path).compile().inputs.variables) == 1
