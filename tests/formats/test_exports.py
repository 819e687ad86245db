"""Mechanisms as MJCF and URDF files: imported again, and in MuJoCo, they have the same equations of motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from export_checks import Given, check_equal, close, random_state, solid, terms_of
from scipy.spatial.transform import Rotation

import mbfmu as mb
from mbfmu.formats.imported import model_of, source_code

TURN = Rotation.from_euler("xyz", (0.3, -0.2, 0.5))


@dataclass(frozen=True, kw_only=True)
class Tree(mb.Model):
    """All joints that MJCF has, springs, drives and shapes; ``with_balls``: joints that URDF does not have, too."""

    name = "tree"
    with_balls: bool = True

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0.0, 0.0, -9.81))
        tilted = mb.Revolute(at=(0.1, 0.2, 0.3), rotation=TURN, axis=(1, 2, 3), start=0.4, armature=0.7)
        a = m.body("a", m.ground, tilted, **solid(1))
        b = m.body("b", a, mb.Translational(at=(0.5, 0, 0), axis="y", start=-0.3), **solid(2))
        c = m.body("c", b, mb.Weld(at=(0, 0.4, 0), rotation=TURN), **solid(3))
        d = m.body("d", c, mb.Universal(at=(0.2, 0, 0), rotation=TURN, start=(0.3, 0.2)), **solid(4))
        e = m.body("e", d, mb.Cylindrical(axis="x", start=(0.1, -0.2)), **solid(5))
        f = m.body("f", m.ground, mb.Planar(at=(1, 0, 0), axis="y", start=(0.1, 0.2, 0.3)), **solid(6))
        g = m.body("g", f, mb.Revolute(axis="z"), **mb.rod(mass=2.0, length=0.5))
        if self.with_balls:
            m.body("h", g, mb.Spherical(at=(0.5, 0, 0), rotation=TURN), **solid(7))
            m.body("i", m.ground, mb.Floating(start=(1, 2, 3, 1, 0, 0, 0)), **solid(8))
            m.force("rope", mb.Spring(stiffness=30.0, damping=2.0, free=0.5, at_a=(0, 0, 1)), d, f)
            m.force("spring", mb.JointSpring(stiffness=40.0, damping=3.0, free=0.2), a)
            m.force("pull", mb.JointForce(mb.Product(mb.Input(name="pull", unit="1"), 2.5)), g)
            m.force("lift", mb.PointForce(magnitude=0.4 * 2.0 * 9.81, axis="z", at_a=(0.25, 0, 0)), g)
        m.force("damper", mb.JointDamper(damping=1.5), b)
        limited = m.limiter("push_limit", mb.Input(name="push", unit="N"), lower=-1.0, upper=1.0, unit="N")
        m.force("push", mb.JointForce(limited), b)
        m.output("tip.x", e.position("x", (0.1, 0.2, 0.3)))
        m.shape(a, mb.Capsule(radius=0.1, length=0.3, axis="x", at=(1, 0, 0), color="#ff0000", opacity=0.5))
        m.shape(c, mb.Box(size=(1, 2, 3), rotation=TURN))
        return m


def loops(**angles: float) -> mb.Mechanism:
    """Two four-bars closed by a ball joint and by a hinge, a gear, and a plate welded to the ground."""
    m = mb.Mechanism(gravity=(0.0, 0.0, -9.81))
    crank = m.body("crank", m.ground, mb.Revolute(axis="y", start=1.0), **solid(1))
    coupler = m.body("coupler", crank, mb.Revolute(at=(1, 0, 0), axis="y", start=-1.1), **solid(2))
    rocker = m.body("rocker", m.ground, mb.Revolute(at=(3, 0, 0), axis="y", start=1.2), **solid(3))
    m.cut("pin", mb.SphericalCutJoint(at_a=(3, 0, 0), at_b=(1, 0, 0)), coupler, rocker)
    wheel = m.body("wheel", m.ground, mb.Revolute(at=(0, 1, 0), start=0.4), **solid(4))
    m.couple("gear", mb.Gear(ratio=-2.0, offset=0.3), wheel, crank)
    plate = m.body("plate", m.ground, mb.Floating(start=(5, 0, 0, 1, 0, 0, 0)), **solid(5))
    m.cut("grip", mb.WeldCutJoint(at_b=(0.1, 0.2, 0.3), at_a=(5.1, 0.2, 0.3)), m.ground, plate)
    return m


@dataclass(frozen=True, kw_only=True)
class Loops(mb.Model):
    """See :func:`loops`."""

    name = "loops"

    def build(self) -> mb.Mechanism:
        return loops()


def test_a_tree_is_the_same_after_export_and_import(tmp_path: Path) -> None:
    model, path = Tree(), tmp_path / "tree.xml"
    found = mb.write_mjcf(model, path, strict=True)
    assert [d.text.split(" (")[0] for d in found] == ["inertias of bodies are changed by a negligible amount"]
    code, lost = source_code(path, strict=True)
    assert lost == []
    again = model_of(code)
    check_equal(model.compile(), again.compile())
    assert [variable.name for variable in again.compile().inputs.variables] == ["push.force", "pull.control"]
    assert {body.name for body in model.built().bodies} <= {body.name for body in again.built().bodies}
    assert [type(shape).__name__ for _, shape in again.built().shapes] == ["Capsule", "Box"]
    start = {p.name: p.default for p in again.parameters()}
    assert start["a_start"] == pytest.approx(0.4, abs=1e-15)


def test_mujoco_has_the_accelerations_of_the_exported_tree(tmp_path: Path) -> None:
    model, path = Tree(), tmp_path / "tree.xml"
    mb.write_mjcf(model, path)
    own, reference = model.compile(), mujoco.MjModel.from_xml_path(str(path))
    data, M = mujoco.MjData(reference), np.zeros((reference.nv, reference.nv))
    balls = [
        int(adr) + 3 * (kind == 0)
        for adr, kind in zip(reference.jnt_qposadr, reference.jnt_type, strict=True)
        if kind < 2
    ]
    data.qpos[:], data.qvel[:] = random_state(reference.nq, reference.nv, balls)
    data.ctrl[:] = [0.7 if "pull" in reference.actuator(k).name else 3.0 for k in range(reference.nu)]
    mujoco.mj_forward(reference, data)
    mujoco.mj_fullM(reference, data, M)
    terms = terms_of(own, data.qpos, data.qvel)
    close(terms.M, M)
    close(-terms.h, M @ data.qacc_smooth)
    own.place_bodies(0.0, data.qpos)
    states = own.data.state.bodies
    for body in own.mechanism.bodies[1:]:
        close(states[body.index]["r"] + states[body.index]["A"] @ body.com, data.body(body.name).xipos)


def test_a_tree_is_the_same_after_export_and_import_as_urdf(tmp_path: Path) -> None:
    model, path = Tree(with_balls=False), tmp_path / "tree.urdf"
    found = mb.write_urdf(model, path)
    lost = [d.text.removeprefix("not exported: ").split(" (")[0] for d in found if d.severity == "warning"]
    assert lost == ["start positions", "armatures of joints"]
    compiled = model.compile()
    q, v = random_state(compiled.system.n, compiled.system.n, [])
    first, second = (terms_of(own, q, v) for own in (compiled, model_of(source_code(path)[0]).compile()))
    armature = np.zeros_like(first.M)
    armature[0, 0] = 0.7
    close(second.M, first.M - armature)
    close(second.h, first.h)


def test_loops_and_gears_are_the_same_after_export_and_import(tmp_path: Path) -> None:
    """The closure errors at the start, and the row space of the Jacobian at a state in which the loops are closed."""
    model, path = Loops(), tmp_path / "loops.xml"
    mb.write_mjcf(model, path, strict=True)
    again = model_of(source_code(path, strict=True)[0])
    own, other = model.compile(), again.compile()
    q, _ = own.assemble()
    same, _ = other.assemble()
    v = np.zeros(own.system.n)
    first, second = terms_of(own, q, v), terms_of(other, same, v)
    close(second.M, first.M, 1e-9)
    for terms in (first, second):
        assert np.abs(terms.Phi).max() < 1e-9
    rows = [
        np.linalg.svd(terms.J, full_matrices=False)[2][: np.linalg.matrix_rank(terms.J)] for terms in (first, second)
    ]
    np.testing.assert_allclose(rows[1].T @ rows[1], rows[0].T @ rows[0], rtol=0.0, atol=1e-9)
    reference = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(reference)
    mujoco.mj_forward(reference, data)
    assert np.abs(data.efc_pos).max() < 1e-9, "the loops are closed in MuJoCo"


# ---- other mechanisms, losses and errors ----------------------------------------------------------------------------


def graph() -> mb.Mechanism:
    """Joints that are declared from the outer body to the inner one, with frames off those of the bodies."""
    m = mb.Mechanism(gravity=(1.0, 2.0, -9.0))
    a, b = m.body("a", **solid(1)), m.body("b", **solid(2))
    m.joint("first", a, m.ground, mb.Universal(at=(0.1, 0.2, 0.3), rotation=TURN), at_b=(1, 0, 0))
    m.joint("second", b, a, mb.Revolute(at=(0, 0.5, 0), rotation=TURN), at_b=(0.3, 0.2, 0.1))
    m.output("b.x", b.position("x", (0.1, 0, 0)))
    return m


def test_joints_of_a_graph_are_exported_in_the_direction_of_the_tree(tmp_path: Path) -> None:
    model, path = Given(make=graph), tmp_path / "graph.xml"
    mb.write_mjcf(model, path, strict=True)
    own, other = model.compile(), model_of(source_code(path, strict=True)[0]).compile()
    # the universal joint is reversed: its second angle comes first
    q, v = random_state(3, 3, [])
    order = [1, 0, 2]
    first, second = terms_of(own, q, v), terms_of(other, q[order], v[order])
    close(second.M, first.M[np.ix_(order, order)])
    close(second.h, first.h[order])


def with_stop() -> mb.Mechanism:
    m = mb.Mechanism(gravity=(0, 0, -9.81))
    a = m.body("a", m.ground, mb.Revolute(axis="y"), **solid(1))
    b = m.body("b", a, mb.Revolute(at=(1, 0, 0), axis="y", start=0.3), **solid(2))
    m.force("stop", mb.JointStop(lower=-1.0, upper=1.5, stiffness=1234.0, damping=1.0), b)
    m.force("spring", mb.JointSpring(stiffness=2.0, free=0.5, damping=0.3), b)
    m.force("servo", mb.JointSpring(stiffness=6.0, free=-0.1, damping=0.4), b)
    m.output("elbow.angle", b.angle())
    return m


def test_stops_springs_and_names_of_joints_remain(tmp_path: Path) -> None:
    """The stiffness of the stop follows from a time constant; two springs have the sum of their torques."""
    path = tmp_path / "stop.xml"
    mb.write_mjcf(Given(make=with_stop), path, strict=True)
    model = model_of(source_code(path, strict=True)[0])
    stop = next(force for name, force, *_ in model.built().forces if name == "elbow_stop")
    assert (stop.lower, stop.upper) == (-1.0, 1.5)
    assert stop.stiffness == pytest.approx(1234.0, rel=1e-3)
    values = {p.name: p.default for p in model.parameters()}
    assert (values["elbow_stiffness"], values["elbow_damping"]) == (8.0, pytest.approx(0.7))
    check_equal(Given(make=with_stop).compile(), model.compile())


def test_driven_joints_in_loops_start_in_the_position_of_their_drive(tmp_path: Path) -> None:
    """The governor: a driven spindle comes first, so that free coordinates have other numbers than all."""
    model, path = mb.find("governor")(), tmp_path / "governor.xml"
    found = mb.write_mjcf(model, path)
    assert "motions of driven joints (spindle)" in found[0].text
    reference = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(reference)
    mujoco.mj_forward(reference, data)
    own = model.compile()
    places, axes = own.poses(0.0, own.assemble()[0])
    for body in own.mechanism.bodies[1:]:
        close(places[body.index] + axes[body.index] @ body.com, data.body(body.name).xipos, 1e-9)


def test_a_floating_base_is_imported_again(tmp_path: Path) -> None:
    def base() -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0, 0, -9.81))
        a = m.body("base", m.ground, mb.Floating(), **solid(1))
        m.body("arm", a, mb.Revolute(at=(1, 0, 0), rotation=TURN), **solid(2))
        return m

    for write, name in ((mb.write_mjcf, "base.xml"), (mb.write_urdf, "base.urdf")):
        write(Given(make=base), tmp_path / name, strict=True)
        check_equal(Given(make=base).compile(), model_of(source_code(tmp_path / name, strict=True)[0]).compile())


def locked() -> mb.Mechanism:
    m = mb.Mechanism(gravity=(0, 0, -9.81))
    a = m.body("a", m.ground, mb.Revolute(axis="y"), **solid(1))
    m.body("b", a, mb.Revolute(at=(1, 0, 0), axis="y", drive=0.7), **solid(2))
    return m


@pytest.mark.parametrize("write", [mb.write_mjcf, mb.write_urdf])
def test_joints_with_a_constant_drive_are_locked(tmp_path: Path, write: Any) -> None:
    path = tmp_path / "locked.xml"
    write(Given(make=locked), path, strict=True)
    code, _ = source_code(path, strict=True)
    own, other = Given(make=locked).compile(), model_of(code).compile()
    assert own.system.n == other.system.n == 1
    start = np.array((0.3, 0.7))
    first = terms_of(own, start, np.zeros(2))
    second = terms_of(other, start[: other.assemble()[0].size], np.zeros(2))
    close(second.M, first.M)
    close(second.h, first.h)


def lossy() -> mb.Mechanism:
    m = mb.Mechanism(gravity=("sin(t)", 0, mb.Input(name="g", unit="m/s2", start=-9.81)))
    a = m.body("a", m.ground, mb.Revolute(rate=1.0), **solid(1))
    b = m.body("b", m.ground, mb.Revolute(drive="0.1 * t"), **solid(2))
    m.force("torque", mb.JointForce("sin(t)"), a)
    m.force("stop", mb.JointStop(upper=1.0, stiffness=10.0), a)
    m.force("friction", mb.JointFriction(coulomb=1.0, static=2.0, stribeck=1.0), a)
    m.force("wind", mb.Torque(magnitude=1.0, axis="x"), a)
    m.couple("cam", mb.Cam("0.1 * sin(q)", width=1.0), a, b)
    m.cut("rod", mb.DistanceCutJoint(at_a=(1, 0, 0), at_b=(2, 0, 0), length=1.0), a, b)
    m.lag("filter", mb.Input(name="u", unit="1"), time_constant=1.0)
    m.shape(a, mb.Panel(size=(1, 1)))
    return m


def test_what_is_not_exported_is_listed(tmp_path: Path) -> None:
    for write in (mb.write_mjcf, mb.write_urdf):
        found = [d.text.removeprefix("not exported: ") for d in write(Given(make=lossy), tmp_path / "x.xml")]
        for expected in (
            "velocities of joints at the start (a)", "motions of driven joints (b)", "couplings other than gears (cam)",
            "loop-closing joints of these types (rod: DistanceCutJoint)", "inputs of gravity", "forces (wind)",
            "forces that depend on time, sensors or blocks (torque)",
            "stops at one end of a coordinate, and a second stop of a coordinate (stop)",
            "Stribeck friction and static friction above sliding friction (friction)", "shapes of these bodies (a)",
            "blocks, states and controllers (filter)", "gravity that depends on time (x)",
        ):  # fmt: skip
            assert expected in found, expected
        assert len(found) == 12
        with pytest.raises(mb.UserError, match=r"12 kinds of elements are not exported: .*not-exported"):
            write(Given(make=lossy), tmp_path / "y.xml", strict=True)
        assert not (tmp_path / "y.xml").exists()


def with_screw() -> mb.Mechanism:
    m = mb.Mechanism()
    m.body("nut", m.ground, mb.Screw(lead=0.1), **solid(1))
    return m


def with_fork() -> mb.Mechanism:
    m = mb.Mechanism()
    a = m.body("a", m.ground, mb.Revolute())
    for name in ("b", "c"):
        m.body(name, a, mb.Revolute(), **solid(1))
    return m


def with_child() -> mb.Mechanism:
    m = mb.Mechanism()
    a = m.body("a", m.ground, mb.Revolute(), **solid(1))
    m.body("b", a, mb.Floating(), **solid(1))
    return m


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (with_screw, "joint 'nut' is a Screw, which these formats do not have; allowed: Weld"),
        (with_fork, "body 'a' has a joint and no mass; allowed in MJCF"),
        (with_child, "joint 'b' has six degrees of freedom relative to body 'a'"),
    ],
)
def test_mechanisms_without_a_counterpart_are_refused(tmp_path: Path, make: Any, message: str) -> None:
    with pytest.raises(mb.UserError, match=message):
        mb.write_mjcf(Given(make=make), tmp_path / "x.xml")


def test_the_command_writes_both_formats(
    command: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    status, out, err = command("export", "pendulum", "--mjcf")
    assert (status, err) == (0, "")
    assert out.endswith("wrote pendulum.xml\n")
    assert mujoco.MjModel.from_xml_path("pendulum.xml").nv == 3
    status, out, err = command("export", "pendulum", "--urdf", "-o", "swing.urdf")
    assert (status, err) == (0, "")
    assert "warning: not exported: gravity" in out
    status, _, err = command("export", "pendulum", "--urdf", "--strict")
    assert status == 2
    assert "not-exported" in err
    status, _, err = command("export", "pendulum", "--strict")
    assert status == 2
    assert "--strict is given without --mjcf or --urdf" in err


@pytest.mark.parametrize(
    "given",
    [
        ["--solver", "adams"], ["--tolerance", "1e-6"], ["--no-start-at-equilibrium"], ["--stop-time", "1"],
        ["--interval", "0.1"], ["--fmi", "3"], ["--native"], ["--platforms", "x86_64-linux"],
    ],
)  # fmt: skip
def test_options_of_fmus_are_refused_for_other_files(
    command: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for kind in ("--mjcf", "--urdf"):
        status, _, err = command("export", "pendulum", kind, *given)
        assert (status, list(tmp_path.iterdir())) == (2, [])
        assert f"{given[0]} is given with {kind}; allowed: options of the mechanism, such as --set" in err
