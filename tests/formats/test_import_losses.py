"""Files of which a part is not imported, or is imported in another form: nothing is silent."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from imported_texts import ARM, INERTIAL, LINK, mjcf, moments, urdf, written
from scipy.spatial.transform import Rotation

import mbfmu as mb
from mbfmu.formats import mujoco_table as table
from mbfmu.formats.compiler import compile_file
from mbfmu.formats.imported import model_of, source_code

MESH_GEOM = "<geom type='mesh' mesh='none'/>"
MESH_ASSET = "<asset><mesh name='none' file='none.stl'/></asset>"

LOST = f"""
<body name="a"><joint name="j" stiffness="1" range="-1 1" limited="true"/><geom size="0.1"/><site name="s"/></body>
<body name="b" pos="1 0 0"><joint name="k" type="ball" damping="1" armature="1" stiffness="1" range="0 1"/>
  <geom size="0.1"/><site name="t"/></body>
<body name="c" mocap="true" pos="2 0 0"><geom size="0.1"/></body>
<body name="d" pos="3 0 0"><joint name="l" type="slide" actuatorfrcrange="-1 1"/>{INERTIAL}<site name="v"/></body>
"""
REST = """
<option density="1"/>
<tendon><spatial name="strap" limited="true" range="0 1" stiffness="1"><site site="s"/><site site="t"/>
  <site site="v"/></spatial></tendon>
<actuator><motor name="u" tendon="strap"/><muscle name="v" joint="j" lengthrange="0 1"/>
  <intvelocity name="w" joint="j" actrange="0 1"/>
  <motor name="x" joint="j" ctrlrange="-1 1"/><position name="y" joint="l" kp="2"/>
  <motor name="z" joint="l"/></actuator>
<equality><connect name="off" body1="a" body2="b" anchor="0 0 0" active="false"/>
  <tendon name="e" tendon1="strap"/></equality>
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
        "ranges of tendons, but those between two sites (strap)",
        "springs of tendons, but those between two sites or of up to three joints (strap)",
        "actuators that do not act on hinges, slides or tendons of up to three of them (u)",
        "actuators with dynamics, muscles and user-defined laws (v, w)",
        "limits of the sum of the forces of several actuators, and limits that exclude each other (y, z)",
        "equality constraints that are inactive at the start (off)",
        "equality constraints of tendons with more than two joints, or of spatial tendons (e)",
    ):  # fmt: skip
        assert sum(f"not imported: {expected}" in text for text in texts) == 1, expected
        assert f"- {expected}" in " ".join(code.split())
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


# ---- completeness ---------------------------------------------------------------------------------------------------


def test_every_number_of_a_model_of_mujoco_is_in_the_tables() -> None:
    """A later version may have more; each then needs a decision."""
    model = mujoco.MjModel.from_xml_string(mjcf(f"<body><joint/>{INERTIAL}</body>"))
    tables = table.IMPORTED | table.CONTACT | table.SOFTNESS | table.OF_LOST_ELEMENTS | table.WITHOUT_EFFECT
    tables |= {lost.array for lost in table.LOST_PROPERTIES}
    arrays = {name for name in dir(model) if isinstance(getattr(model, name, None), np.ndarray)}
    assert len(arrays) > 300
    others = {name for name in arrays if name.startswith(table.OTHER_PREFIXES)}
    assert arrays - others - tables == set()
    assert tables - arrays == set()


def test_every_option_and_flag_of_mujoco_is_in_the_tables() -> None:
    options = {name for name in dir(mujoco.MjOption()) if not name.startswith("_")}
    assert options == table.OPTIONS | table.OPTIONS_WITHOUT_EFFECT
    flags = {name.removeprefix("mjDSBL_") for name in dir(mujoco.mjtDisableBit) if name.startswith("mjDSBL_")}
    assert flags == table.FLAGS | table.FLAGS_WITHOUT_EFFECT


# ---- MJCF: one element at a time ------------------------------------------------------------------------------------

ONE = "<body name='a'><joint name='j' {}/>" + INERTIAL + "<site name='s' pos='1 0 0'/></body>"
TWO = ONE.format("") + "<body name='b' pos='0 1 0'><joint name='k'/>" + INERTIAL + "<site name='t'/></body>"
ROPE = "<tendon><spatial name='rope' {}><site site='s'/><site site='t'/></spatial></tendon>"
MOTOR = "<actuator><general name='u' joint='j' {}/></actuator>"


@pytest.mark.parametrize(
    ("text", "lost"),
    [
        (mjcf(ONE.format("stiffness='1 2'")), "nonlinear terms of the stiffness or damping"),
        (mjcf(ONE.format("damping='1 0 2'")), "nonlinear terms of the stiffness or damping"),
        (mjcf(ONE.format("stiffness='1' springyield='0.1'")), "plastic yielding of springs (j)"),
        (mjcf(ONE.format("range='-1 1' margin='0.1'")), "margins of ranges (j)"),
        (mjcf(ONE.format("range='1 -1'")), "ranges whose lower end is above the upper one (j)"),
        (mjcf(ONE.format(""), MOTOR.format("ctrlrange='1 -1'")), "limits of actuators whose lower end is above"),
        (mjcf(ONE.format(""), MOTOR.format("forcerange='1 -1'")), "limits of actuators whose lower end is above"),
        (mjcf(ONE.format("actuatorfrcrange='-1 1' actuatorgravcomp='true'")), "gravity compensation within the limits"),
        (mjcf(TWO, ROPE.format("stiffness='1 2'")), "nonlinear terms"),
        (mjcf(TWO, ROPE.format("damping='0 2'")), "nonlinear terms"),
        (mjcf(TWO, ROPE.format("frictionloss='1'")), "friction, armature"),
        (mjcf(TWO, ROPE.format("armature='1'")), "friction, armature"),
        (mjcf(ONE.format(""), MOTOR.format("damping='0 1'")), "nonlinear terms of the stiffness or damping"),
        (mjcf(ONE.format(""), MOTOR.format("nsample='3' delay='0.01'")), "delays of actuators (u)"),
        (mjcf(ONE.format(""), "<option viscosity='1'/>"), "forces of the fluid"),
        (mjcf(ONE.format("") + MESH_GEOM, MESH_ASSET), "contact between shapes (1 shapes)"),
    ],
)  # fmt: skip
def test_properties_that_are_not_imported_are_listed(tmp_path: Path, text: str, lost: str) -> None:
    found = source_code(written(tmp_path, text))[1]
    assert [d.text.startswith(f"not imported: {lost}") for d in found if d.severity == "warning"] == [True]


JOINT = "stiffness='1' damping='1' range='-1 1' frictionloss='1'"
REST_OF_TWO = (
    ROPE.format("stiffness='1' damping='1'")
    + MOTOR.format("damping='2' gainprm='3'")
    + "<equality><connect body1='a' body2='b' anchor='0 0 0'/></equality>"
)
BODIES = TWO.replace("<joint name='j' ", f"<joint name='j' {JOINT} ").replace("name='a'", "name='a' gravcomp='1'")


def with_flag(tmp_path: Path, flag: str) -> Path:
    option = f"<option><flag {flag}='disable'/></option>" if flag else ""
    return written(tmp_path, mjcf(BODIES, REST_OF_TWO + option))


@pytest.mark.parametrize(
    ("flag", "word"), [("limit", "JointStop"), ("frictionloss", "JointFriction"), ("equality", "m.cut(")]
)
def test_constraints_that_a_flag_disables_are_not_imported(tmp_path: Path, flag: str, word: str) -> None:
    assert word in source_code(with_flag(tmp_path, ""), strict=True)[0]
    assert word not in source_code(with_flag(tmp_path, flag), strict=True)[0]


@pytest.mark.parametrize("flag", ["", "spring", "damper", "gravity", "actuation"])
def test_forces_that_a_flag_disables_are_those_of_mujoco(tmp_path: Path, flag: str) -> None:
    path = with_flag(tmp_path, flag)
    own = model_of(source_code(path, strict=True)[0]).with_values({"stops": False, "j_friction": 0.0})
    check_forces(own.compile(), compile_file(path).model)


def check_forces(compiled: Any, model: Any) -> None:
    """The mass matrix and the force M a, a being the accelerations of MuJoCo without constraints, at a random state."""
    rng, data, M = np.random.default_rng(4), mujoco.MjData(model), np.zeros((model.nv, model.nv))
    data.qpos[:], data.qvel[:] = rng.standard_normal(model.nq), rng.standard_normal(model.nv)
    data.ctrl[:] = 1.7
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, M)
    for index in range(len(compiled.inputs.variables)):
        compiled.inputs.start(index, 1.7)
    terms = compiled.system.allocate_terms()
    compiled.system.fill(0.0, data.qpos, data.qvel, terms)
    np.testing.assert_allclose(terms.M, M, rtol=0.0, atol=1e-13 * np.abs(M).max())
    force = M @ data.qacc_smooth
    np.testing.assert_allclose(-terms.h, force, rtol=0.0, atol=1e-13 * np.abs(force).max())


# ---- MJCF: other forms ----------------------------------------------------------------------------------------------


def test_disabled_groups_of_actuators_have_no_input(tmp_path: Path) -> None:
    motors = "".join(f"<motor name='u{k}' joint='j' group='{k}'/>" for k in range(3))
    text = mjcf(ONE.format(""), f"<option actuatorgroupdisable='0 2'/><actuator>{motors}</actuator>")
    code, found = source_code(written(tmp_path, text), strict=True)
    assert [variable.name for variable in model_of(code).compile().inputs.variables] == ["u1.torque"]
    assert "actuators are disabled by the file (u0, u2)" in found[0].text


def test_armature_and_damping_of_actuators_are_those_of_mujoco(tmp_path: Path) -> None:
    """Times the square of the gear ratio, also of actuators whose force is not imported or is disabled."""
    actuators = (
        "<motor joint='j' gear='3' armature='0.2' damping='0.1' group='1'/>"
        "<position joint='j' kp='5' kv='1' gear='2' armature='0.3' damping='0.4'/>"
        "<muscle joint='j' lengthrange='0 1' armature='0.5' damping='0.6'/>"
    )
    text = mjcf(
        ONE.format("armature='0.1' damping='0.7'"),
        f"<option actuatorgroupdisable='1'/><actuator>{actuators}</actuator>",
    )
    path = written(tmp_path, text)
    check_forces(model_of(source_code(path)[0]).compile(), compile_file(path).model)


def test_a_weld_without_torque_is_a_ball_joint(tmp_path: Path) -> None:
    weld = "<equality><weld body1='a' body2='b' anchor='0.1 0.2 0.3' torquescale='{}'/></equality>"
    (whole,), (point,) = (
        model_of(source_code(written(tmp_path, mjcf(TWO, weld.format(scale))))[0]).built().cuts for scale in (1, 0)
    )
    assert (type(whole.cut), type(point.cut)) == (mb.WeldCutJoint, mb.SphericalCutJoint)
    np.testing.assert_allclose((point.cut.at_a, point.cut.at_b), ((0.1, 1.2, 0.3), (0.1, 0.2, 0.3)), atol=1e-15)


def test_joints_that_an_equality_locks_do_not_move(tmp_path: Path) -> None:
    """A double pendulum whose elbow is locked at 0.5 + 0.3 is a pendulum: J q'' = -dV/dq."""
    # k is 0.3 in the position of the file, so that the second link is rotated by 0.5 about y
    joint = "<joint name='k' axis='0 1 0' ref='17.188733853924695' damping='1'/>"
    lower = f"<body name='b' pos='1 0 0'>{joint}{INERTIAL}</body>"
    body = f"<body name='a'><joint name='j' axis='0 1 0'/>{INERTIAL}{lower}</body>"
    q, x, z = 0.3, 1.0 + 0.5 * np.cos(0.5), -0.5 * np.sin(0.5)
    for second in ("", "joint2='j'"):
        equality = f"<equality><joint joint1='k' {second} polycoef='0.5 0 0 0 0'/></equality>"
        code, found = source_code(written(tmp_path, mjcf(body, equality)), strict=True)
        assert [d.text for d in found] == ["joint k is locked by the equality constraint equality1"]
        compiled = model_of(code).compile()
        terms = compiled.system.allocate_terms()
        compiled.system.fill(0.0, np.array((q, 0.8)), np.array((0.7, 0.0)), terms)
        assert terms.M[0, 0] == pytest.approx(2.0 * 0.03 + 2.0 * 0.25 + 2.0 * (x * x + z * z), rel=1e-14)
        assert terms.h[0] == pytest.approx(-2.0 * 9.81 * ((0.5 + x) * np.cos(q) + z * np.sin(q)), rel=1e-14)


def test_outputs_of_bodies_are_the_positions_of_their_frames(tmp_path: Path) -> None:
    """The anchor of the joint is off the frame."""
    body = f"<body name='a' pos='1 2 3'><joint name='j' pos='0.1 0.2 0.3' axis='0 0 1' damping='1'/>{INERTIAL}</body>"
    path = written(tmp_path, mjcf(body))
    compiled, model = model_of(source_code(path)[0]).compile(), compile_file(path).model
    data, out = mujoco.MjData(model), np.zeros(len(compiled.outputs))
    data.qpos[:] = 0.7
    mujoco.mj_forward(model, data)
    compiled.observe(0.0, data.qpos, data.qvel, np.zeros(1), np.zeros(0), out)
    found = {variable.name: value for variable, value in zip(compiled.outputs, out, strict=True)}
    np.testing.assert_allclose([found[f"a.{letter}"] for letter in "xyz"], data.body("a").xpos, atol=1e-14)


# ---- URDF -----------------------------------------------------------------------------------------------------------


def hinge(limit: str, kind: str = "revolute") -> str:
    return urdf(moments(2, 2, 3), joint=kind).replace("</joint>", f"{limit}</joint>", 1)


@pytest.mark.parametrize(
    ("limit", "kind", "message"),
    [
        ("<limit lower='1' upper='-1' effort='1'/>", "revolute", "ranges whose lower end is above the upper one (j)"),
        ("<limit lower='0' upper='0' effort='1'/>", "revolute", "ranges whose ends coincide (j)"),
        ("<limit lower='-1' upper='1' effort='-3'/>", "revolute", "negative efforts are used as their absolute values"),
        ("<limit lower='-1' upper='1' effort='0'/>", "revolute", "efforts of zero are not used as limits (j)"),
        ("<limit effort='3'/>", "revolute", "joints without a range move without limits (j)"),
        ("<limit lower='-1' upper='1' effort='3'/>", "continuous", "ranges of continuous joints are not used (j)"),
        ("<limit lower='-1' upper='1' effort='3' velocity='-2'/>", "revolute", "velocity limits of joints (j)"),
        ("<limit lower='-1' upper='1'/>", "planar", "ranges of planar joints (j)"),
        ("<safety_controller k_velocity='3'/>", "revolute", "soft limits of <safety_controller> (j)"),
        ("<dynamics dampng='1'/>", "revolute", "URDF does not define (joint j: <dynamics dampng=>)"),
        ("<Limit lower='1'/>", "revolute", "URDF does not define (joint j: <Limit>)"),
        ("<calibration rising='0'/>", "revolute", "elements for other programs are not used (1 <calibration>)"),
    ],
)  # fmt: skip
def test_limits_that_are_not_used_as_they_are_written_are_reported(
    tmp_path: Path, limit: str, kind: str, message: str
) -> None:
    found = source_code(written(tmp_path, hinge(limit, kind), "r.urdf"))[1]
    assert sum(message in d.text for d in found) == 1, [d.text for d in found]


def test_limits_of_drives_are_absolute_values(tmp_path: Path) -> None:
    path = written(tmp_path, hinge("<limit upper='1' effort='-3'/>"), "r.urdf")
    model = model_of(source_code(path)[0])
    assert {p.name: p.default for p in model.parameters()}["j_drive_limit"] == 3.0
    (stop,) = (force for name, force, *_ in model.built().forces if name == "j_stop")
    assert (stop.lower, stop.upper) == (0.0, 1.0), "a missing end is zero"


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_inertias_of_any_size_are_imported(tmp_path: Path, size: float) -> None:
    """Bodies of a thousandth of a gram, too, with products of inertia."""
    mass, scale = 1e-6 * size**3, 1e-12 * size**5
    R = Rotation.from_euler("xyz", (0.3, 0.2, 0.1)).as_matrix()
    own = np.array(((3.0, 0.2, 0.1), (0.2, 2.0, -0.3), (0.1, -0.3, 1.5))) * scale
    text = "".join(
        f' i{"xyz"[i]}{"xyz"[j]}="{float(own[i, j])!r}"' for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    )
    path = written(tmp_path, urdf(f"<inertia{text}/>", mass=mass), "r.urdf")
    body = model_of(source_code(path, strict=True)[0]).built().bodies[-1]
    assert body.mass == pytest.approx(mass, rel=1e-14)
    np.testing.assert_allclose(body.inertia, R @ own @ R.T, rtol=0.0, atol=1e-13 * scale)


def test_links_without_inertial_have_the_mass_of_their_shapes(tmp_path: Path) -> None:
    """As in MuJoCo; URDF defines no mass."""
    shape = '<link name="b"><collision><geometry><box size="0.1 0.2 0.3"/></geometry></collision></link>'
    path = written(tmp_path, re.sub(r'<link name="b">.*?</link>', shape, urdf(moments(1, 1, 1))), "r.urdf")
    code, found = source_code(path)
    assert model_of(code).built().bodies[-1].mass == pytest.approx(1000.0 * 0.1 * 0.2 * 0.3)
    assert any("links without <inertial> have the mass of their shapes of contact" in d.text for d in found)
