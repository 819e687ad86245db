"""The robot arm: its torques by Newton and Euler's equations, and its controlled motion by SciPy."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import robot_arm as example
from numpy.typing import ArrayLike, NDArray
from robot_arm import AXES, NUMBERS, PAYLOAD_AT, PAYLOAD_SIZE, RATIOS, RobotArm
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from mbfmu import read_table, simulate
from mbfmu.ensemble.definition import define
from mbfmu.ensemble.design import Point
from mbfmu.ensemble.objective import optimize_objective
from mbfmu.ensemble.worker import forget_job, run_batch
from mbfmu.native.runtime import COMPILERS
from mbfmu.native.targets import host

Array = NDArray[np.float64]
GRAVITY = np.array([0.0, 0.0, -9.81])  # m/s2

needs_compiler = pytest.mark.skipif(
    not host() or not any(map(shutil.which, COMPILERS)), reason="needs a C compiler, and a machine that is known"
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the example writes."""
    path = tmp_path_factory.mktemp("robot_arm")
    example.example(path)
    return path


def cross(a: Array, b: Array) -> Array:
    """Vector products of the columns of (3, m); faster than that of NumPy for a few."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@dataclass
class Frame:
    """Axes and origin of a link in global axes, and m motions of it."""

    axes: Array  # (3, 3) columns
    origin: Array  # (3, 1), m
    w: Array  # (3, m) angular velocity, rad/s
    dw: Array  # (3, m) its rate
    a: Array  # (3, m) acceleration of the origin less gravity, m/s2

    def wrench(self, at: ArrayLike, mass: float, inertia: ArrayLike) -> tuple[Array, Array, Array]:
        """Return center (3, 1), force and moment (3, m) of a rigid body by Newton and Euler's equations.

        ``at`` (m) is its center of mass, ``inertia`` (kg m2) its principal moments, both in these axes.
        """
        arm = self.axes @ np.reshape(at, (3, 1))
        force = mass * (self.a + cross(self.dw, arm) + cross(self.w, cross(self.w, arm)))
        tensor = self.axes * inertia @ self.axes.T
        return self.origin + arm, force, tensor @ self.dw + cross(self.w, tensor @ self.w)


def torques(angles: Array, rates: Array, accelerations: Array, payload: float) -> Array:
    """Return the torques of the drives at the joints (6, m), N m, for angles (6,), rates and accelerations (6, m).

    A drive moves everything that follows its joint, overcomes friction, and accelerates its rotor, whose torque counts
    ``ratio`` times.
    """
    m = rates.shape[1]
    frame = Frame(np.eye(3), np.zeros((3, 1)), np.zeros((3, m)), np.zeros((3, m)), np.zeros((3, m)) - GRAVITY[:, None])
    parts, joints = [], []  # number of the link and wrench of every part; axis, origin and own torque of every joint
    for link, (axis, angle, rate, acceleration) in enumerate(zip(AXES, angles, rates, accelerations, strict=True)):
        unit = np.eye(3)["xyz".index(axis.axis)]
        n, arm = (frame.axes @ unit)[:, None], frame.axes @ np.reshape(axis.at, (3, 1))
        moved = frame.a + cross(frame.dw, arm) + cross(frame.w, cross(frame.w, arm))
        spin, w, dw = axis.ratio * rate, frame.w, frame.dw
        rotor = Frame(frame.axes, frame.origin + arm, w + n * spin, dw, moved)
        rotor.dw = dw + n * axis.ratio * acceleration + cross(w, n * spin)
        wrench = rotor.wrench(np.zeros(3), axis.rotor_mass, axis.rotor * (0.6 + 0.4 * unit))
        parts.append((link - 1, *wrench))
        joints.append((n, rotor.origin, axis.ratio * (n.T @ wrench[2])[0] + axis.friction * rate))
        turned = frame.axes @ Rotation.from_rotvec(angle * unit).as_matrix()
        frame = Frame(turned, rotor.origin, w + n * rate, dw + n * acceleration + cross(w, n * rate), moved)
        parts.append((link, *frame.wrench(axis.com, axis.mass, axis.inertia)))
    x, y, z = PAYLOAD_SIZE
    block = payload / 12.0 * np.array([y * y + z * z, z * z + x * x, x * x + y * y])
    parts.append((len(AXES) - 1, *frame.wrench(PAYLOAD_AT, payload, block)))
    result = []
    for link, (n, origin, own) in enumerate(joints):
        after = [moment + cross(at - origin, force) for of, at, force, moment in parts if of >= link]
        result.append((n.T @ sum(after))[0] + own)
    return np.array(result)


def accelerations(angles: Array, rates: Array, torque: Array, payload: float) -> Array:
    """Return accelerations (6,), rad/s2, for torques at the joints (6,), N m: the equations are linear in them."""
    still, units = np.zeros((6, 7)), np.column_stack((np.zeros((6, 2)), np.eye(6)))
    found = torques(angles, np.column_stack((rates, still)), units, payload)
    solution: Array = np.linalg.solve(found[:, 2:] - found[:, 1:2], torque - found[:, 0])
    return solution


def required(times: Array, payload: float) -> Array:
    """Return the torques at the joints (k, 6) that the path requires, N m."""
    path = example.plan_path()
    moves = [example.reference(path, t) for t in times]
    return np.array([torques(q, v[:, None], a[:, None], payload)[:, 0] for q, v, a in moves])


def controlled(forward: Array, payload: float, step: float) -> Array:
    """Return the angles (k, 6) at the communication points by SciPy, for torques (k, 6) of the motors."""
    path, y, found = example.plan_path(), np.concatenate((example.POSES[0], np.zeros(6))), []
    for k, planned in enumerate(forward):
        found.append(y[:6])
        held = RATIOS * (planned + example.feedback(example.reference(path, k * step), y[:6], y[6:]))

        def rates(_: float, y: Array, held: Array = held) -> Array:
            return np.concatenate((y[6:], accelerations(y[:6], y[6:], held, payload)))

        y = solve_ivp(rates, (0.0, step), y, rtol=1e-9, atol=1e-10).y[:, -1]
    return np.array(found)


@pytest.mark.parametrize("payload", [0.0, 5.0])
def test_drives_need_the_torques_of_newton_and_euler(payload: float) -> None:
    path = example.plan_path()
    inputs = {f"axis{k}.target": partial(lambda k, t: float(path(t)[k - 1]), k) for k in NUMBERS}
    result = simulate(
        RobotArm(driven=True, payload=payload), example.TIMES[-1], inputs=inputs, solver="adams", interval=0.02
    )
    assert not result.failure
    assert not result.warning
    found, exact = np.array([result[f"axis{k}.torque"] for k in NUMBERS]).T, required(result.t, payload)
    for k in range(6):
        np.testing.assert_allclose(found[:, k], exact[:, k], atol=1e-7 * np.abs(exact[:, k]).max())


def test_the_friction_of_a_joint_is_identified_from_a_log(tmp_path: Path) -> None:
    """The log is that of Newton and Euler's equations with friction in closed form and noise.

    The result is the least-squares solution of the exact motion, up to a fifth of the standard deviation by the noise.
    """
    times = np.arange(0.0, example.TIMES[-1] + 1e-9, example.LOG_STEP)
    rate = example.plan_path()(times, 1)[:, 1]
    terms = np.column_stack((np.sign(rate) * (np.abs(rate) > example.SLOW), rate))
    without = required(times, 5.0)[:, 1] - AXES[1].friction * rate
    friction = np.array([example.COULOMB, example.VISCOUS])
    example.write_log(tmp_path / "log.csv", times, without + terms @ friction)
    measured = read_table(tmp_path / "log.csv", "torque2").y
    exact = np.linalg.solve(terms.T @ terms, terms.T @ (measured - without))
    deviation = example.NOISE * np.sqrt(np.diag(np.linalg.inv(terms.T @ terms)))
    assert (np.abs(exact - friction) < 3.0 * deviation).all()

    study = example.friction_study(tmp_path / "log.csv")
    definition = define({"scene": study.pop("given"), **study})
    job = definition.job()

    def evaluate(points: list[Point]) -> list[dict[str, float]]:
        found = run_batch(job, list(enumerate(points)))
        assert not any(outcome.message for outcome in found)
        return [dict(zip(("dry", "sliding"), outcome.measures, strict=True)) for outcome in found]

    assert definition.aim is not None
    found = optimize_objective(definition.aim, definition.vary, evaluate, 1).point
    forget_job(job)
    np.testing.assert_allclose([found["coulomb"], found["viscous"]], exact, atol=0.2 * deviation.min())
    example.draw_friction(tmp_path / "log.csv", found, tmp_path / "friction.png")


@needs_compiler
@pytest.mark.parametrize(("order", "expected"), [(1, 1.0), (2, 2.0)])
def test_torques_of_the_fmu_converge_with_the_step(folder: Path, order: int, expected: float) -> None:
    """Rates: error proportional to the step; accelerations: to its square."""
    errors = []
    for step in (4e-3, 2e-3, 1e-3):
        run = example.required_torques(folder / "robot_arm_driven.fmu", step, order)
        exact = required(run["time"], 5.0) / RATIOS
        errors.append((np.abs(run["torque"] - exact) / np.abs(exact).max(axis=0)).max())
    assert np.diff(np.log2(errors)) == pytest.approx([-expected] * 2, abs=0.4)
    assert errors[-1] < (0.05, 1e-3)[order - 1]


@needs_compiler
def test_the_controlled_arm_moves_as_by_scipy(folder: Path) -> None:
    step = 4e-3
    forward = required(example.communication_times(step), 5.0) / RATIOS
    run = example.follow_path(folder / "robot_arm.fmu", forward, step)
    count = 150
    target = example.plan_path()(run["time"][:count])
    exact = controlled(forward[:count], 5.0, step) - target
    error = run["angle"][:count] - target
    assert np.abs(exact).max() > 1e-4  # rad
    np.testing.assert_allclose(error, exact, atol=1e-6 * np.abs(exact).max())


@needs_compiler
def test_the_error_of_the_tool_decreases_with_the_step(folder: Path) -> None:
    driven, arm = folder / "robot_arm_driven.fmu", folder / "robot_arm.fmu"
    initial, at_start, mean = example.compare_steps(driven, arm, (4e-3, 2e-3, 1e-3)).values()
    assert initial.min() > 5e-3
    assert np.diff(np.log2(at_start)) == pytest.approx([-1.0] * 2, abs=0.1)
    assert np.diff(np.log2(mean)) == pytest.approx([-2.0] * 2, abs=0.1)
    assert mean[-1] < 1e-5


@needs_compiler
def test_the_gear_carries_the_torque_of_the_motor_less_that_of_its_rotor(folder: Path) -> None:
    """Axis 1, whose stator is at rest: ratio * torque = gear + ratio^2 * inertia * acceleration."""
    run = example.follow_path(folder / "robot_arm.fmu", required(example.communication_times(1e-3), 5.0) / RATIOS)
    acceleration = np.array([example.reference(example.plan_path(), t)[2, 0] for t in run["time"]])
    axis = AXES[0]
    rotor = axis.ratio**2 * axis.rotor * acceleration
    np.testing.assert_allclose(
        run["gear"][:, 0] + rotor, axis.ratio * run["torque"][:, 0], atol=0.02 * np.abs(run["gear"][:, 0]).max()
    )
