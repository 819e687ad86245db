"""Tendons and servos with limits have the forces of MuJoCo, which reads the same file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from imported_texts import INERTIAL, mjcf, written

import mbfmu as mb
from mbfmu.formats.compiler import compile_file
from mbfmu.formats.imported import model_of, source_code
from mbfmu.mechanics import CompiledMechanism

HINGE = "<body name='{0}' pos='0.3 {1} 0'><joint name='j{0}' axis='0 {1} 1' ref='{1}'/>" + INERTIAL + "{2}</body>"
SLIDE = "<body name='s'><joint name='js' type='slide' axis='1 1 0' ref='0.2'/>" + INERTIAL + "<site name='p'/></body>"
BODIES = HINGE.format("a", 1, HINGE.format("b", 2, HINGE.format("c", 3, "<site name='q' pos='1 0 0'/>"))) + SLIDE


def fixed(name: str, joints: str, attributes: str = "") -> str:
    """A fixed tendon; ``joints`` are names and factors, such as "a 2 b -0.5"."""
    words = joints.split()
    pairs = zip(words[::2], words[1::2], strict=True)
    path = "".join(f"<joint joint='j{joint}' coef='{factor}'/>" for joint, factor in pairs)
    return f"<fixed name='{name}' {attributes}>{path}</fixed>"


TENDONS = f"""<tendon>{fixed("sum", "a 0.5 b -2", "stiffness='3' springlength='0.4' damping='0.2'")}
  {fixed("three", "a 1 c -0.7 s 2", "stiffness='1.5'")} {fixed("one", "c 1")} {fixed("twice", "b 2 a 0")}
  <spatial name="cord" stiffness="4" springlength="0.1" damping="0.3"><site site="p"/><site site="q"/></spatial>
</tendon>"""
ACTUATORS = """<actuator>
  <position name="a" joint="ja" kp="20" kv="3" gear="1.5" ctrlrange="-1 1.2" forcerange="-6 5"/>
  <position name="slow" joint="jc" kp="9" forcerange="-4 4"/>
  <velocity name="speed" joint="js" kv="5" ctrlrange="-1 2" forcerange="-3 3"/>
  <general name="runaway" joint="jb" biastype="affine" gainprm="1" biasprm="0.3 2 1"/>
  <general name="pushed" joint="jb" biastype="affine" gainprm="2" biasprm="0.7 0 0" forcerange="-1 1"/>
  <motor name="pull" tendon="sum" gear="2" ctrlrange="-1 1"/>
  <motor name="direct" tendon="one"/>
  <position name="sum" tendon="three" kp="6" kv="0.5" gear="-2" forcerange="-2 3"/>
  <position name="a_b" tendon="twice" kp="4"/>
</actuator>"""


def imported(path: Path) -> tuple[Any, Any]:
    """The imported model, of which everything must be imported, and the model of MuJoCo."""
    return model_of(source_code(path, strict=True)[0]), compile_file(path).model


def forces(model: Any, compiled: CompiledMechanism, seed: int, size: float) -> tuple[Any, Any, Any]:
    """Forces M q'' by the import and by MuJoCo at a random state, and its control forces."""
    rng, data, M = np.random.default_rng(seed), mujoco.MjData(model), np.zeros((model.nv, model.nv))
    data.qpos[:], data.qvel[:] = size * rng.standard_normal(model.nq), size * rng.standard_normal(model.nv)
    data.ctrl[:] = size * rng.standard_normal(model.nu)
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, M)
    for index, variable in enumerate(compiled.inputs.variables):
        compiled.inputs.start(index, float(data.ctrl[model.actuator(variable.name.rpartition(".")[0]).id]))
    terms = compiled.system.allocate_terms()
    compiled.system.fill(0.0, data.qpos, data.qvel, terms)
    return -terms.h, M @ data.qacc_smooth, data.actuator_force.copy()


@pytest.mark.parametrize("size", [0.1, 1.0, 10.0])
def test_forces_of_tendons_and_limited_servos_are_those_of_mujoco(tmp_path: Path, size: float) -> None:
    own, model = imported(written(tmp_path, mjcf(BODIES, TENDONS + ACTUATORS)))
    compiled, at_limits = own.compile(), set[str]()
    for seed in range(8):
        found, expected, acting = forces(model, compiled, seed, size)
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-13 * np.abs(expected).max())
        ends = model.actuator_forcerange
        at_limits |= {model.actuator(k).name for k in range(model.nu) if acting[k] in ends[k] and ends[k].any()}
    assert at_limits >= ({"a", "slow", "speed", "pushed", "sum"} if size == 10.0 else set())


def test_gains_and_limits_of_controls_are_parameters(tmp_path: Path) -> None:
    own, _ = imported(written(tmp_path, mjcf(BODIES, TENDONS + ACTUATORS)))
    values = {p.name: (p.default, p.unit) for p in own.parameters()}
    assert values["a_gain"] == (30.0, "N.m")
    assert values["a_stiffness"] == (45.0, "N.m/rad")
    assert values["a_damping"] == (6.75, "N.m.s/rad")
    assert values["sum_stiffness_2"] == (3.0, "N.m/rad"), "the tendon; the actuator has the name sum, too"
    assert values["three_stiffness"][1] == "1", "a sum of m and rad"


@pytest.mark.parametrize("solver", ["adams", "radau"])
def test_a_saturated_servo_moves_as_its_closed_form(tmp_path: Path, solver: str) -> None:
    """A mass of 2 kg at a force limit of 3 N reaches x = 3 t^2 / 4 before the servo leaves the limit."""
    body = f"<body name='m' gravcomp='1'><joint name='x' type='slide' axis='1 0 0'/>{INERTIAL}</body>"
    servo = "<actuator><position name='servo' joint='x' kp='50' kv='1' forcerange='-3 3'/></actuator>"
    own, model = imported(written(tmp_path, mjcf(body, servo)))
    mass = float(model.body_mass[1])
    result = mb.simulate(own, 1.0, interval=0.1, solver=solver, tolerance=1e-9, inputs={"servo.control": 5.0})
    np.testing.assert_allclose(result["x.position"], 1.5 / mass * result.t**2, atol=1e-8)


# ---- equality constraints -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("tendons", "equality", "kind"),
    [
        (fixed("t", "a 0.5 b -2"), "<tendon tendon1='t' polycoef='0.3 0 0 0 0'/>", mb.Gear),
        (fixed("t", "a 2") + fixed("u", "b -3"), "<tendon tendon1='t' tendon2='u' polycoef='.1 .5 .2 0 0'/>", mb.Cam),
        (fixed("t", "a 2") + fixed("u", "s 3"), "<tendon tendon1='t' tendon2='u' polycoef='.1 .5 0 0 0'/>", mb.Gear),
        (fixed("t", "c 2 b 0"), "<tendon tendon1='t' polycoef='0.3 0 0 0 0'/>", None),
        (
            fixed("t", "a 2 b 1") + fixed("u", "c 0"),
            "<tendon tendon1='t' tendon2='u' polycoef='.1 .5 .2 0 0'/>",
            mb.Gear,
        ),
    ],
)
def test_equality_constraints_of_two_joints_are_those_of_mujoco(
    tmp_path: Path, tendons: str, equality: str, kind: Any
) -> None:
    text = mjcf(BODIES, f"<tendon>{tendons}</tendon><equality>{equality}</equality>")
    own, model = imported(written(tmp_path, text))
    data = mujoco.MjData(model)
    if kind is None:
        (lock,) = (body.joint.drive for body in own.built().bodies if body.joint.drive is not None)
        data.joint("jc").qpos[:] = lock
    else:
        assert [type(handle.coupling) for handle in own.built().couplings] == [kind]
        data.qpos[:] = np.random.default_rng(3).standard_normal(model.nq)
        compiled = own.compile()
        terms = compiled.system.allocate_terms()
        compiled.system.fill(0.0, data.qpos, np.zeros(model.nv), terms)
    mujoco.mj_forward(model, data)
    J = np.array(data.efc_J[: model.nv]) if not mujoco.mj_isSparse(model) else None
    assert data.nefc == 1
    if kind is None:
        assert data.efc_pos[0] == pytest.approx(0.0, abs=1e-14)
        return
    k = int(np.argmax(np.abs(terms.J[0])))
    np.testing.assert_allclose(terms.J[0] * J[k] / terms.J[0, k], J, rtol=0.0, atol=1e-9)
    assert terms.Phi[0] * J[k] / terms.J[0, k] == pytest.approx(data.efc_pos[0], abs=1e-12)


def test_a_rope_is_a_stop_of_the_distance(tmp_path: Path) -> None:
    rope = "<tendon><spatial name='r' range='{}'><site site='p'/><site site='q'/></spatial></tendon>"
    own, model = imported(written(tmp_path, mjcf(BODIES, rope.format("0 0.3"))))
    (stop,) = (force for name, force, *_ in own.built().forces if name == "r_stop")
    assert (type(stop), stop.lower, stop.upper) == (mb.DistanceStop, None, 0.3)
    time, ratio = model.tendon_solref_lim[0]
    expected = 1.0 / (model.tendon_solimp_lim[0][1] * time * ratio) ** 2 / model.tendon_invweight0[0]
    assert stop.stiffness == pytest.approx(expected, rel=1e-3)
    own, _ = imported(written(tmp_path, mjcf(BODIES, rope.format("0.1 0.3"))))
    (stop,) = (force for name, force, *_ in own.built().forces if name == "r_stop")
    assert (stop.lower, stop.upper) == (0.1, 0.3)
    assert not own.with_values({"stops": False}).built().forces


# ---- what has no counterpart ----------------------------------------------------------------------------------------

THREE = fixed("t", "a 1 b 1 c 1")
FOUR = fixed("t", "a 1 b 1 c 1 s 1", "stiffness='1'")
PATH = "<spatial name='t' {}><site site='p'/><site site='q'/><site site='r'/></spatial><!-- -->"


@pytest.mark.parametrize(
    ("tendons", "rest", "message"),
    [
        (THREE, "<equality><tendon tendon1='t'/></equality>", "equality constraints of tendons with more than two"),
        (FOUR, "", "springs of tendons, but those between two sites or of up to three joints"),
        (fixed("t", "a 1", "stiffness='1' springlength='0 1'"), "", "springs of tendons with a range of unloaded"),
        (fixed("t", "a 1 b 1", "range='0 1'"), "", "ranges of tendons, but"),
        (PATH.format("stiffness='1'"), "", "springs of tendons, but"),
        (PATH.format("range='0 1'"), "", "ranges of tendons, but"),
        (PATH.format(""), "<actuator><motor tendon='t'/></actuator>", "actuators that do not act on hinges, slides or"),
        (
            fixed("t", "a 1 b 1", "actuatorfrcrange='-1 1'"),
            "<actuator><motor tendon='t'/><position tendon='t' kp='1'/></actuator>",
            "limits of the sum of the forces of several actuators",
        ),
        (
            fixed("t", "a 1 b 1"),
            "<actuator><position tendon='t' kp='1' forcerange='1 2'/><motor joint='ja' forcerange='-2 -1'/></actuator>",
            "",
        ),
    ],
)  # fmt: skip
def test_tendons_without_a_counterpart_are_listed(tmp_path: Path, tendons: str, rest: str, message: str) -> None:
    bodies = BODIES + f"<body name='d' pos='0 1 0'><freejoint/>{INERTIAL}<site name='r'/></body>"
    found = source_code(written(tmp_path, mjcf(bodies, f"<tendon>{tendons}</tendon>{rest}")))[1]
    texts = [d.text for d in found if d.severity == "warning"]
    assert [text.startswith(f"not imported: {message}") for text in texts] == [True] * bool(message), texts


def test_limits_of_the_only_actuator_of_a_tendon_or_a_joint_are_imported(tmp_path: Path) -> None:
    tendon = fixed("t", "a 1 b 1", "actuatorfrcrange='-1 1'")
    bodies = BODIES.replace("name='js'", "name='js' actuatorfrcrange='-0.5 0.5'")
    rest = "<actuator><position name='u' tendon='t' kp='4' gear='3'/><position name='v' joint='js' kp='5'/></actuator>"
    own, model = imported(written(tmp_path, mjcf(bodies, f"<tendon>{tendon}</tendon>{rest}")))
    compiled = own.compile()
    for seed in range(4):
        found, expected, _ = forces(model, compiled, seed, 2.0)
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-13 * np.abs(expected).max())
