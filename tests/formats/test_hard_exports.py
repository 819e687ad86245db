"""Exports of names, masses and relations that MJCF or URDF do not allow, and of files that cannot be read."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from export_checks import Given, check_equal, solid

import mbfmu as mb
from mbfmu.formats.imported import model_of, source_code

Make = Callable[[], mb.Mechanism]


def named(*names: str) -> Make:
    """A chain of hinges, and a joint of two coordinates whose parts have names that the second body may have."""

    def make() -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0, 0, -9.81))
        parent = m.body(names[0], m.ground, mb.Universal(), **solid(1))
        for k, name in enumerate(names[1:]):
            parent = m.body(name, parent, mb.Revolute(at=(1, 0, 0), axis="y"), **solid(2 + k))
        return m

    return make


@pytest.mark.parametrize(
    "names",
    [
        ("world", "b"),
        ("m.ground", "world", "world_2"),
        ("a<b>&\"c'", "]]>", "<!-- x"),
        ("a", "a_first", "a_a_first", "a_first_2"),
        ("Äpfel/1", "日本", " b "),
    ],
)
def test_any_names_of_bodies_can_be_exported(tmp_path: Path, names: tuple[str, ...]) -> None:
    make = named(*names)
    own = Given(make=make).compile()
    for write, path in ((mb.write_mjcf, tmp_path / "x.xml"), (mb.write_urdf, tmp_path / "x.urdf")):
        found = write(Given(make=make), path, strict=True)
        changed = [d.text for d in found if d.text.startswith("names of bodies are changed (")]
        assert len(changed) == any(name in ("world", "m.ground") for name in names)
        check_equal(own, model_of(source_code(path, strict=True)[0]).compile())
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "x.xml")).nv == 1 + len(names)


def hinge(name: str, m: mb.Mechanism, **options: Any) -> Any:
    return m.body(name, m.ground, mb.Revolute(axis="y", **options), **solid(1))


def gears(**options: Any) -> Make:
    """A joint follows two others, of which the first one is locked with ``drive``."""

    def make() -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0, 0, -9.81))
        a, b, c = hinge("a", m, **options), hinge("b", m), hinge("c", m)
        m.couple("first", mb.Gear(ratio=2.0), b, a)
        m.couple("second", mb.Gear(ratio=3.0), b, c)
        return m

    return make


def force(apply: Callable[[mb.Mechanism, Any], None]) -> Make:
    def make() -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0, 0, -9.81))
        apply(m, hinge("a", m))
        return m

    return make


def limited(gain: float) -> Callable[[mb.Mechanism, Any], None]:
    def apply(m: mb.Mechanism, body: Any) -> None:
        signal = mb.Product(mb.Input(name="u", unit="1"), gain)
        m.force("push", mb.JointForce(m.limiter("limits", signal, lower=-1, upper=2, unit="N.m")), body)

    return apply


def moving_stop(m: mb.Mechanism, body: Any) -> None:
    m.force("stop", mb.JointStop(lower=mb.Input(name="end", unit="rad", start=-1.0), upper=1, stiffness=9), body)


def started(m: mb.Mechanism, body: Any) -> None:
    m.force("push", mb.JointForce(mb.Input(name="u", unit="N.m", start=3.0)), body)


def missing_mesh(m: mb.Mechanism, body: Any) -> None:
    m.shape(body, mb.MeshFile("missing.stl"))


@pytest.mark.parametrize(
    ("make", "write", "lost"),
    [
        (gears(), mb.write_mjcf, []),
        (gears(), mb.write_urdf, ["gears of joints that are locked or follow two joints"]),
        (gears(drive=0.3), mb.write_urdf, ["gears of joints that are locked or follow two joints", "start positions"]),
        (force(limited(0.0)), mb.write_mjcf, ["forces that depend on time, sensors or blocks"]),
        (force(limited(-2.0)), mb.write_mjcf, []),
        (force(moving_stop), mb.write_mjcf, ["forces"]),
        (force(started), mb.write_mjcf, ["start values of inputs"]),
        (force(missing_mesh), mb.write_urdf, ["mesh files that cannot be read"]),
    ],
)
def test_losses_of_relations_and_forces(tmp_path: Path, make: Make, write: Any, lost: list[str]) -> None:
    path = tmp_path / "x.xml"
    found = [d.text.removeprefix("not exported: ") for d in write(Given(make=make), path) if d.severity == "warning"]
    assert [text.split(" (")[0].split(", since")[0] for text in found] == lost
    source_code(path)
    if write is mb.write_mjcf:
        mujoco.MjModel.from_xml_path(str(path))


def test_a_limit_of_a_drive_with_a_negative_gain_is_that_of_its_torque(tmp_path: Path) -> None:
    mb.write_mjcf(Given(make=force(limited(-2.0))), tmp_path / "x.xml", strict=True)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "x.xml"))
    data = mujoco.MjData(model)
    for control, torque in ((-0.6, 1.2), (-9.0, 2.0), (9.0, -1.0)):
        data.ctrl[:] = control
        mujoco.mj_forward(model, data)
        assert data.qfrc_actuator[0] == pytest.approx(torque, rel=1e-12)


def one_input_twice() -> mb.Mechanism:
    m, signal = mb.Mechanism(), mb.Input(name="u", unit="N.m")
    for name in ("a", "b"):
        m.force(f"push {name}", mb.JointForce(signal), hinge(name, m))
    return m


def test_an_input_of_two_joints_becomes_two_controls(tmp_path: Path) -> None:
    (found,) = mb.write_mjcf(Given(make=one_input_twice), tmp_path / "x.xml")
    assert found.text == "push a and push b have a control each"


# ---- masses and depth -----------------------------------------------------------------------------------------------


def small(size: float, com: float = 0.0) -> Make:
    """A cube of water on a hinge, of a size in m."""

    def make() -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0, 0, -9.81))
        mass = 1e3 * size**3
        inertia = np.full(3, mass * size**2 / 6.0)
        m.body("cube", m.ground, mb.Revolute(axis="y"), mass=mass, com=(com * size, 0, 0), inertia=inertia)
        return m

    return make


@pytest.mark.parametrize(("size", "com", "lost"), [(1e-4, 0.5, 1), (1e-3, 0.5, 0), (1.0, 0.0, 0), (1e3, 0.5, 0)])
def test_a_change_of_the_inertia_that_changes_the_motion_is_a_warning(
    tmp_path: Path, size: float, com: float, lost: int
) -> None:
    """The frequency of the pendulum in MuJoCo is that of the model, or there is a warning."""
    found = mb.write_mjcf(Given(make=small(size, com)), tmp_path / "x.xml")
    assert sum(d.severity == "warning" for d in found) == lost
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "x.xml"))
    data, M = mujoco.MjData(model), np.zeros((1, 1))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, M)
    exact = 1e3 * size**5 * (1.0 / 6.0 + com**2)
    assert (M[0, 0] == pytest.approx(exact, rel=1e-5, abs=0.0)) == (not lost)


def light(joint: Any) -> Make:
    def make() -> mb.Mechanism:
        m = mb.Mechanism()
        m.body("b", m.body("a", m.ground, joint), mb.Revolute(), **solid(1))
        return m

    return make


def elastic() -> mb.Mechanism:
    m = mb.Mechanism()
    m.flexible_body("rod", m.ground, mb.Revolute(), mb.Beam(length=1.0, mass=1.0, bending_stiffness=9.0, modes=2))
    return m


def chain() -> mb.Mechanism:
    m = mb.Mechanism()
    last = m.ground
    for k in range(491):
        last = m.body(f"b{k}", last, mb.Weld() if k else mb.Revolute(), **solid(1))
    return m


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (light(mb.Spherical()), "body 'a' has a joint and no mass; allowed in MJCF"),
        (light(mb.Floating()), "body 'a' has a joint and no mass; allowed in MJCF"),
        (elastic, "the mechanism has flexible bodies or sheets; allowed: rigid bodies"),
        (chain, "body 'b490' is the last of a chain of 491 bodies; allowed in MJCF: up to 490"),
    ],
)
def test_what_mujoco_would_refuse_is_refused(tmp_path: Path, make: Make, message: str) -> None:
    with pytest.raises(mb.UserError, match=message):
        mb.write_mjcf(Given(make=make), tmp_path / "x.xml")


def test_links_without_mass_are_reported(tmp_path: Path) -> None:
    found = mb.write_urdf(Given(make=light(mb.Revolute())), tmp_path / "x.urdf")
    assert "links have no mass (a)" in [d.text for d in found]


# ---- meshes ---------------------------------------------------------------------------------------------------------

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], float)
FLAT = [[0, 1, 2], [1, 3, 2]]


def binary(triangles: Any) -> bytes:
    rows = [struct.pack("<12fH", 0, 0, 0, *CORNERS[corners].ravel(), 0) for corners in triangles]
    return b"\0" * 80 + struct.pack("<I", len(triangles)) + b"".join(rows)


def text(triangles: Any) -> bytes:
    lines = [" ".join(["vertex", *map(str, CORNERS[corner])]) for corners in triangles for corner in corners]
    return "\n".join(["solid x", *lines]).encode()


@pytest.mark.parametrize(
    ("content", "is_drawn"), [(binary(FLAT), True), (text(FLAT), False), (binary(FLAT[:1]), False)]
)
def test_meshes_that_mujoco_cannot_read_are_lost(tmp_path: Path, content: bytes, is_drawn: bool) -> None:
    (tmp_path / "mesh.stl").write_bytes(content)

    def make() -> mb.Mechanism:
        m = mb.Mechanism()
        m.shape(hinge("a", m), mb.MeshFile(str(tmp_path / "mesh.stl")))
        return m

    found = mb.write_mjcf(Given(make=make), tmp_path / "x.xml")
    assert ["mesh files that MuJoCo cannot read" in d.text for d in found] == [True] * (not is_drawn)
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "x.xml")).ngeom == is_drawn
