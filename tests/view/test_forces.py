"""Forces next to the poses of a motion: those of cut joints, loads and drives."""

from __future__ import annotations

import numpy as np
import pytest
from recording import recorded

from fmus.fourbar import FourBar
from fmus.governor import Governor
from mbfmu.mechanics import (
    JointForce,
    Mechanism,
    PointForce,
    Polynomial,
    Revolute,
    Spring,
    Torque,
    Translational,
    rod,
)
from mbfmu.modeling import Model
from mbfmu.session.run import communication_points, run
from mbfmu.session.simulation import Settings
from mbfmu.viewer import Motion, Recorder
from mbfmu.viewer.forces import cross, rounded, scales


class Loaded(Model):
    """A slider that is pushed along its coordinate and pulled by a spring, and an arm with a force and a torque."""

    name = "loaded"

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        slider = m.body("slider", m.ground, Translational(axis="x", at=(0.0, 1.0, 0.0)), mass=2.0)
        arm = m.body("arm", m.ground, Revolute(axis="z"), **rod(mass=1.0, length=1.0))
        m.force("push", JointForce(3.0), slider)
        m.force("pull", Spring(stiffness=50.0, free=0.2, at_a=(0.0, 0.1, 0.0), at_b=(1.0, 0.0, 0.0)), slider, arm)
        m.force("motor", JointForce(0.5), arm)
        m.force("weight", PointForce(magnitude=-4.0, axis="y", at_a=(1.0, 0.0, 0.0)), arm)
        m.force("follower", PointForce(magnitude=2.0, axis="y", at_a=(0.5, 0.0, 0.0), fixed_in="body"), arm)
        m.force("twist", Torque(magnitude=0.7), arm)
        m.output("arm.angle", arm.angle())
        return m


def vectors(motion: Motion, name: str, unit: str = "N") -> np.ndarray:
    (k,) = [k for k, arrow in enumerate(motion.arrows) if (arrow.name, arrow.unit) == (name, unit)]
    return motion.forces[:, k]


def test_a_cut_joint_is_drawn_at_the_values_of_its_sensors() -> None:
    result, motion = recorded(FourBar())
    force, (arrow,) = vectors(motion, "pivot"), motion.arrows
    told = np.column_stack((result["pivot.force.x"], result["pivot.force.y"]))
    assert motion.names[arrow.body] == "rocker"  # b is the ground
    assert arrow.at == (-1.0, 0.0, 0.0)
    assert np.linalg.norm(force[:, :2], axis=1) == pytest.approx(np.linalg.norm(told, axis=1), rel=1e-6)
    assert np.abs(force[:, 2]).max() < 1e-6


def test_distance_joint_pulls_along_its_rod_and_a_drive_turns_about_its_axis() -> None:
    result, motion = recorded(Governor(damping=100.0))
    pull = vectors(motion, "rod1")
    assert np.linalg.norm(pull, axis=1) == pytest.approx(np.abs(result["rod1.force"]), rel=1e-5)
    (arrow,) = [arrow for arrow in motion.arrows if arrow.name == "rod1"]
    assert motion.names[arrow.body] == "collar"
    effort = vectors(motion, "spindle", "N.m")[:, 1]
    assert np.abs(effort).max() > 0.1
    assert effort == pytest.approx(result["spindle.effort"], rel=1e-5, abs=1e-5)


def test_forces_act_alone_where_they_take_hold() -> None:
    _, motion = recorded(Loaded(), 0.3)
    slider, arm = motion.names.index("slider"), motion.names.index("arm")
    assert {arrow.name for arrow in motion.arrows} == {"push", "pull", "motor", "weight", "follower", "twist"}
    assert vectors(motion, "push") == pytest.approx(np.tile((3.0, 0.0, 0.0), (31, 1)), abs=1e-6)
    assert vectors(motion, "weight") == pytest.approx(np.tile((0.0, -4.0, 0.0), (31, 1)), abs=1e-6)
    assert vectors(motion, "motor", "N.m") == pytest.approx(np.tile((0.0, 0.0, 0.5), (31, 1)), abs=1e-6)
    assert vectors(motion, "twist", "N.m") == pytest.approx(np.tile((0.0, 0.0, 0.7), (31, 1)), abs=1e-6)
    along = motion.point(arm, (1.0, 0.0, 0.0))[:, 0] - motion.r[:, arm]
    assert vectors(motion, "follower") == pytest.approx(2.0 * along[:, [1, 0, 2]] * (-1.0, 1.0, 1.0), abs=1e-6)
    way = motion.point(arm, (1.0, 0.0, 0.0))[:, 0] - motion.point(slider, (0.0, 0.1, 0.0))[:, 0]
    length = np.linalg.norm(way, axis=1, keepdims=True)
    assert vectors(motion, "pull") == pytest.approx(50.0 * (length - 0.2) * way / length, rel=1e-4, abs=1e-4)


def test_reading_forces_does_not_change_the_run() -> None:
    times = communication_points(0.3, 0.01)
    for solver in ("ida", "adams"):
        plain = run(Loaded(), Settings(solver=solver), times)
        watched = run(Loaded(), Settings(solver=solver), times, watch=Recorder())
        assert np.array_equal(plain.values, watched.values, equal_nan=True)


def test_outputs_are_those_of_the_run() -> None:
    result, motion = recorded(Governor(damping=100.0))
    assert [name for name, _ in motion.outputs] == list(result.names)
    assert [unit for _, unit in motion.outputs] == [variable.unit for variable in result.variables]
    assert np.array_equal(motion.values, result.values, equal_nan=True)


def test_scale_is_round_and_suits_most_arrows_of_any_size() -> None:
    _, motion = recorded(Governor())
    for k in (1e-9, 1.0, 1e12):
        found = scales(motion.arrows, motion.forces.astype(float) * k, 1e-3 * k)
        value, length = found["N"]
        assert rounded(value) == pytest.approx(value)
        assert 0.05 * 1e-3 * k <= length <= 0.15001 * 1e-3 * k
        sizes = [np.linalg.norm(motion.forces[:, i], axis=-1) * k for i, a in enumerate(motion.arrows) if a.unit == "N"]
        assert np.percentile(np.concatenate(sizes), 95) * length / value < 0.4e-3 * k
    assert [rounded(x) for x in (0.99, 1.0, 4.9, 5.0, 0.02)] == pytest.approx([0.5, 1.0, 2.0, 5.0, 0.02])


def test_forces_that_are_not_known_set_no_scale() -> None:
    _, motion = recorded(FourBar(), 0.1)
    forces = motion.forces.astype(float)
    forces[3] = np.nan
    forces[4] = np.inf
    assert scales(motion.arrows, forces, 1.0)["N"] == scales(motion.arrows, np.delete(forces, (3, 4), axis=0), 1.0)["N"]
    assert scales(motion.arrows, 0.0 * motion.forces, 1.0) == {}


def test_driven_joint_without_effort_has_no_arrow() -> None:
    class Idle(Model):
        name = "idle"

        def build(self) -> Mechanism:
            m = Mechanism()
            wheel = m.body("wheel", m.ground, Revolute(drive=Polynomial((0.0, 1.0))), mass=1.0, inertia=(1.0, 1.0, 1.0))
            m.output("angle", wheel.angle())
            return m

    _, motion = recorded(Idle(), 0.1)
    assert motion.arrows == ()
    assert motion.joints == ("", "revolute, driven")


def test_vector_products_of_rows() -> None:
    a, b = np.random.default_rng(0).normal(size=(2, 7, 3))
    np.testing.assert_allclose(cross(a, b), np.cross(a, b), rtol=1e-15, atol=1e-15)
    assert cross(a[:0], b[:0]).shape == (0, 3)
