"""Recorded motions and what is drawn of them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recording import recorded
from scipy.spatial.transform import Rotation

from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from mbfmu.mechanics import (
    Beam,
    Box,
    Cylinder,
    Floating,
    Force,
    Joint,
    Mechanism,
    Polynomial,
    Revolute,
    Sphere,
    Spherical,
    SphericalCutJoint,
    Spring,
    Translational,
    rod,
)
from mbfmu.modeling import Model
from mbfmu.session.run import communication_points, run
from mbfmu.session.simulation import Settings
from mbfmu.util.errors import UserError
from mbfmu.viewer import Motion, Recorder
from mbfmu.viewer.camera import Camera, Stage
from mbfmu.viewer.drawing import PIN_COLOR, draw
from mbfmu.viewer.motion import matrices, quaternions
from mbfmu.viewer.picture import Picture


class Arm(Model):
    """A heavy cantilever that turns, bends and is shortened by it."""

    name = "arm"

    def build(self) -> Mechanism:
        beam = Beam(length=2.0, mass=1.0, bending_stiffness=20.0, modes=2, ends=("clamped", "free"), stiffening=True)
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        arm = m.flexible_body("arm", m.ground, Revolute(drive=Polynomial((0.3, 2.0))), beam)
        m.output("tip.deflection", arm.deflection(2.0))
        return m


def test_poses_are_those_of_the_kinematics() -> None:
    result, motion = recorded(Governor(damping=100.0))
    assert np.array_equal(motion.times, result.t)
    collar, arm = motion.names.index("collar"), motion.names.index("arm2")
    assert motion.r[:, collar, 1] == pytest.approx(result["collar.height"], abs=1e-7)
    ball = motion.point(arm, (0.16, 0.0, 0.0))[:, 0]
    assert ball[:, 1] == pytest.approx(0.2 - 0.16 * np.sin(result["arm2.angle"]), abs=1e-6)
    spindle, angle = 0.16 * np.cos(result["arm2.angle"]), result["spindle.angle"]
    assert ball[:, 0] == pytest.approx(spindle * np.cos(angle), abs=1e-6)
    assert ball[:, 2] == pytest.approx(-spindle * np.sin(angle), abs=1e-6)


def test_point_off_the_origin_agrees_with_a_sensor() -> None:
    result, motion = recorded(FourBar())
    middle = motion.point(motion.names.index("coupler"), (1.5, 0.0, 0.0))[:, 0]
    assert middle[:, 0] == pytest.approx(result["coupler.position.x"], abs=1e-6)
    assert middle[:, 1] == pytest.approx(result["coupler.position.y"], abs=1e-6)


def test_bar_passes_through_the_sections_of_an_elastic_body() -> None:
    result, motion = recorded(FourBar(coupler_modes=2))
    (bar,) = motion.picture.bars
    axis = motion.axis(bar)
    middle = len(bar.x) // 2
    assert bar.x[middle] == pytest.approx(1.5)
    assert axis[:, middle, 0] == pytest.approx(result["coupler.position.x"], abs=1e-6)
    assert axis[:, middle, 1] == pytest.approx(result["coupler.position.y"], abs=1e-6)
    assert axis[:, -1] == pytest.approx(motion.r[:, motion.names.index("coupler[3]")], abs=1e-6)


def test_bar_is_shortened_by_bending() -> None:
    _, motion = recorded(Arm())
    (bar,) = motion.picture.bars
    assert np.abs(motion.p).max() > 0.1
    assert motion.axis(bar)[:, -1] == pytest.approx(motion.r[:, motion.names.index("arm[2]")], abs=1e-6)
    small = bar.axis(np.array([0.02, 0.005]), 1.0)
    length = np.linalg.norm(np.diff(small, axis=0), axis=1).sum()
    assert length == pytest.approx(2.0, abs=1e-6)  # to second order in a slope of 0.03
    assert 2.0 - small[-1, 0] > small[-1, 1] ** 2 / 4.0 > 0.0  # a straight arm would be shortened least


def test_scale_magnifies_the_deflection_alone(tmp_path: Path) -> None:
    result, plain = recorded(FourBar(coupler_modes=2))
    motion = plain.scaled(10.0)
    (bar,) = motion.picture.bars
    axis = motion.axis(bar)
    assert axis[:, [0, -1]] == pytest.approx(plain.axis(bar)[:, [0, -1]], abs=1e-9)
    chord = (axis[:, -1] - axis[:, 0]) / 3.0
    away = axis[:, len(bar.x) // 2] - axis[:, 0]
    left = chord[:, 0] * away[:, 1] - chord[:, 1] * away[:, 0]
    assert np.abs(result["coupler.deflection"]).max() > 1e-3
    assert left == pytest.approx(10.0 * result["coupler.deflection"], abs=1e-6)
    assert (motion.caption, plain.caption) == ("deflection × 10", "")
    motion.save(tmp_path / "m.npz")
    assert Motion.load(tmp_path / "m.npz").scale == 1.0


def test_elastic_body_is_a_bar_and_its_sections_are_not_drawn() -> None:
    mechanism = FourBar(coupler_modes=2).build()
    picture = draw(mechanism, 3.0)
    (bar,) = picture.bars
    assert (bar.height, bar.width) == (0.03, 0.03)
    names = [body.name for body in mechanism.bodies]
    assert [names[i] for i in picture.unnamed] == ["coupler.mode", "coupler[1.5]", "coupler[3]"]
    drawn = {names[part.body] for part in picture.parts if part.solid != "cylinder"}
    assert drawn == {"ground", "crank", "rocker"}
    mechanism.profile(mechanism.flexible_bodies[0], height=0.1, width=0.2, color="#102030")
    (bar,) = draw(mechanism, 3.0).bars
    assert (bar.height, bar.width, bar.color) == (0.1, 0.2, "#102030")


def test_bad_profiles_are_named() -> None:
    mechanism = FourBar(coupler_modes=1).build()
    (coupler,) = mechanism.flexible_bodies
    with pytest.raises(UserError, match=r"height of the profile of 'coupler' is 0\.0; allowed"):
        mechanism.profile(coupler, height=0.0, width=0.1)
    with pytest.raises(UserError, match="color is 'red'"):
        mechanism.profile(coupler, height=0.1, width=0.1, color="red")
    with pytest.raises(UserError, match="flexible body of a profile is 'coupler'; it must be one of this mechanism"):
        FourBar(coupler_modes=1).build().profile(coupler, height=0.1, width=0.1)


def test_watching_does_not_change_the_run() -> None:
    times = communication_points(0.3, 0.01)
    plain = run(FourBar(), Settings(), times)
    watched = run(FourBar(), Settings(), times, watch=Recorder())
    assert np.array_equal(plain.values, watched.values)


def test_matrices_of_quaternions() -> None:
    e = Rotation.random(20, random_state=0).as_quat()
    assert matrices(np.roll(e, 1, axis=-1)) == pytest.approx(Rotation.from_quat(e).as_matrix(), abs=1e-15)


def test_quaternions_of_matrices() -> None:
    """Random rotations, and half turns, where the scalar part is zero or rounding."""
    axes = np.vstack((np.eye(3), np.random.default_rng(1).normal(size=(17, 3))))
    half = Rotation.from_rotvec(np.pi * axes / np.linalg.norm(axes, axis=1, keepdims=True))
    rotations = Rotation.concatenate((Rotation.identity(), half, Rotation.random(40, random_state=1)))
    found = quaternions(rotations.as_matrix())
    turned = rotations.inv() * Rotation.from_quat(np.roll(found, -1, axis=1))
    assert turned.magnitude().max() < 4e-15
    assert np.linalg.norm(found, axis=1) == pytest.approx(np.ones(len(found)), rel=1e-15)
    assert quaternions(rotations[:20].as_matrix().reshape(4, 5, 3, 3)).shape == (4, 5, 4)


def test_pose_file_keeps_everything(tmp_path: Path) -> None:
    _, motion = recorded(FourBar(coupler_modes=2), 0.1)
    motion.save(tmp_path / "m.npz")
    again = Motion.load(tmp_path / "m.npz")
    assert again.picture == motion.picture
    assert (again.title, again.names, again.parents) == (motion.title, motion.names, motion.parents)
    assert (again.joints, again.outputs, again.arrows) == (motion.joints, motion.outputs, motion.arrows)
    for name in ("times", "r", "e", "p", "values", "forces"):
        assert np.array_equal(getattr(again, name), getattr(motion, name), equal_nan=True)


def test_pose_file_of_another_version_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "old.npz", about=json.dumps({"format": 1, "title": "old"}), times=np.zeros(1))
    with pytest.raises(UserError, match="is a pose file of another version of mbfmu"):
        Motion.load(tmp_path / "old.npz")


def test_default_picture_contains_every_joint_cut_joint_and_spring() -> None:
    m = Mechanism()
    arm = m.body("arm", m.ground, Revolute(), **rod(mass=1.0, length=1.0))
    hung = m.body("hung", arm, Spherical(at=(1.0, 0.0, 0.0)), **rod(mass=1.0, length=0.5))
    slider = m.body("slider", m.ground, Translational(axis="x", start=0.3), mass=2.0)
    free = m.body("free", m.ground, Floating(), mass=1.0, inertia=(1.0, 1.0, 1.0))
    m.cut("ball", SphericalCutJoint(at_a=(0.5, 0.0, 0.0)), hung, slider)
    m.force("spring", Spring(stiffness=1.0), slider, free)
    picture = draw(m, 2.0)
    assert {part.body for part in picture.parts} == {0, arm.index, hung.index, slider.index, free.index}
    assert sorted(link.solid for link in picture.links) == ["coil", "cylinder"]
    axes = [np.reshape(part.axes, (3, 3)) for part in picture.parts if part.body == arm.index]
    assert max(np.linalg.norm(bar[2]) for bar in axes) == pytest.approx(1.0)  # the bar, as long as the arm
    assert len({part.color for part in picture.parts}) >= 5


def test_user_defined_joints_and_forces_are_drawn_by_their_lines() -> None:
    @dataclass(frozen=True, kw_only=True)
    class Hinge(Joint):
        record, place = Revolute.record, Revolute.place
        nq, nv = 1, 1
        coordinates, units = ("",), ("rad",)
        drawn = "pin"

    @dataclass(frozen=True, kw_only=True)
    class Rope(Force):
        record, apply = Spring.record, Spring.apply
        drawn = "coil"

        def points(self) -> tuple[Any, ...]:
            return (0.0, 2.0, 0.0), (0.5, 0.0, 0.0)

    def pictured(joint: Joint, force: Force) -> Picture:
        m = Mechanism()
        arm = m.body("arm", m.ground, joint, **rod(mass=1.0, length=1.0))
        m.force("rope", force, m.ground, arm)
        return draw(m, 2.0)

    own, ours = pictured(Hinge(), Rope()), pictured(Revolute(), Spring(at_a=(0.0, 2.0, 0.0), at_b=(0.5, 0.0, 0.0)))
    assert [(link.solid, link.at_a, link.at_b) for link in own.links] == [("coil", (0.0, 2.0, 0.0), (0.5, 0.0, 0.0))]
    assert [part.body for part in own.parts if part.color == PIN_COLOR] == [1]
    assert own == ours


def test_shapes_replace_the_default_picture() -> None:
    m = Mechanism()
    body = m.body("body", m.ground, Floating(), mass=1.0)
    m.shape(
        body,
        Box(size=(0.1, 0.2, 0.3), at=(1.0, 0.0, 0.0), color="#102030"),
        Cylinder(radius=0.1, length=2.0, axis="x"),
        Sphere(radius=0.5),
    )
    block, bar, ball = draw(m, 1.0).parts
    assert (block.at, block.color) == ((1.0, 0.0, 0.0), "#102030")
    assert np.reshape(block.axes, (3, 3)) == pytest.approx(np.diag((0.1, 0.2, 0.3)))
    assert bar.axes[6:] == pytest.approx((2.0, 0.0, 0.0))
    assert np.linalg.det(np.reshape(bar.axes, (3, 3))) == pytest.approx(0.02)
    assert ball.color == bar.color != block.color


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Sphere(radius=-1.0), "radius of a sphere"),
        (lambda: Box(size=(1.0, 2.0)), "size of a box"),
        (lambda: Box(size=(1.0, 1.0, 1.0), rotation=np.ones((3, 3))), "rotation of a box"),
        (lambda: Cylinder(radius=1.0, length=1.0, axis="w"), "axis of a cylinder is 'w'"),
        (lambda: Sphere(radius=1.0, color="red"), "color is 'red'; write #rrggbb"),
        (lambda: Sphere(radius=1.0, at=(0.0, 0.0)), "at of a shape of body 'b'"),
        (lambda: "ball", "shape of body 'b' is 'ball'"),
    ],
)
def test_bad_shapes_are_named(make: Callable[[], Any], message: str) -> None:
    m = Mechanism()
    body = m.body("b", m.ground, Revolute(), mass=1.0)
    with pytest.raises(UserError, match=re.escape(message)):
        m.shape(body, make())


@pytest.mark.parametrize(
    "model",
    [FourBar(), FourBar(coupler_modes=2, youngs_modulus=5e9), Governor(), SwingPendulum()],
    ids=["fourbar", "elastic", "governor", "pendulum"],
)
@pytest.mark.parametrize("aspect", [0.5, 2.0])
def test_camera_sees_the_whole_motion(model: Model, aspect: float) -> None:
    _, motion = recorded(model)
    stage = Stage.of(motion)
    assert stage.axes == ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    camera = Camera.looking_at(stage, aspect, stage.azimuth, stage.elevation)
    for body, at in motion.picture.points().items():
        seen, depth = camera.project(motion.point(body, at))
        assert np.all(depth > 0.0)
        assert np.all(np.abs(seen) <= (0.5 * aspect, 0.5))
    for bar in motion.picture.bars:
        assert np.all(np.abs(camera.project(motion.axis(bar))[0]) <= (0.5 * aspect, 0.5))
