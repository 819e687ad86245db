"""A six-axis robot arm with geared motors: ``python examples/robot_arm.py``.

The model is exported twice as a native FMU. The joints of the first FMU follow inputs, and its outputs are the torques
of the drives (inverse dynamics). The inputs of the second FMU are the torques of the motors. A controller written in
Python steps both through FMPy. ``docs/examples/robot_arm.md`` explains the example.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from fmpy_slave import Slave
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline

import mbfmu as mb
from mbfmu.viewer import Recorder
from mbfmu.viewer.images import Artist, Shot, write_png

Array = NDArray[np.float64]
Run = dict[str, Array]  # signals over time, by name; one column per axis

STEP, STOP_TIME = 1e-3, 1.5  # communication step and end of the run, s
STEPS = (0.5e-3, 1e-3, 2e-3, 4e-3, 8e-3)  # communication steps of the study, s
MOTOR_SPEED = 6000.0 * np.pi / 30.0  # limit of the motors, rad/s
LABELS = ("constant feedforward", "feedforward at the start of the step", "mean feedforward of the step")
COLORS = ("#9aa3b2", "#4269d0", "#ff725c", "#3ca951", "#efb118", "#a463f2")


class Axis(NamedTuple):
    """A joint, the link behind it and its drive; frames are parallel to those of the ground if all angles are zero."""

    at: tuple[float, float, float]  # position of the joint in the frame of the link before it, m
    axis: str
    mass: float  # of the link, kg
    com: tuple[float, float, float]  # center of mass of the link, m
    inertia: tuple[float, float, float]  # of the link about its center of mass, kg m2
    ratio: float  # rotations of the motor per rotation of the joint
    rotor: float  # moment of inertia of the rotor about its axis, kg m2
    rotor_mass: float  # kg
    friction: float  # viscous friction of the joint, N m s/rad


AXES = (
    Axis((0, 0, 0), "z", 14.0, (0.01, 0.02, 0.30), (0.25, 0.25, 0.08), 100.0, 9e-5, 0.9, 6.0),
    Axis((0.03, 0, 0.42), "y", 9.0, (0, 0.04, 0.20), (0.16, 0.15, 0.03), 100.0, 9e-5, 0.9, 6.0),
    Axis((0, 0, 0.44), "y", 6.0, (0.03, -0.02, 0.02), (0.020, 0.035, 0.030), 100.0, 2.6e-5, 0.5, 4.0),
    Axis((0.10, 0, 0.03), "x", 4.0, (0.18, 0, 0.005), (0.008, 0.035, 0.035), 80.0, 7e-6, 0.3, 1.0),
    Axis((0.33, 0, 0), "y", 1.5, (0.03, 0, 0), (0.002, 0.003, 0.003), 80.0, 7e-6, 0.3, 1.0),
    Axis((0.09, 0, 0), "x", 0.3, (0.005, 0, 0), (2e-4, 1e-4, 1e-4), 50.0, 4e-6, 0.2, 0.5),
)
NUMBERS, RATIOS = range(1, len(AXES) + 1), np.array([axis.ratio for axis in AXES])
STIFFNESS = np.array([6000.0, 6000.0, 2000.0, 200.0, 200.0, 40.0])  # of the controller, N m/rad at the joints
DAMPING = np.array([300.0, 300.0, 100.0, 10.0, 10.0, 2.0])  # N m s/rad
TOOL, PAYLOAD_AT, PAYLOAD_SIZE = (0.08, 0, 0), (0.08, 0, 0.02), (0.10, 0.08, 0.12)  # in the frame of the flange, m
TIMES = (0.0, 0.3, 0.6, 0.9, 1.2)  # of the poses, s
LOG_STEP, NOISE = 5e-3, 1.0  # time between two rows of the log of the robot, s; noise of its torque (RMS), N m
COULOMB, VISCOUS = 18.0, 9.0  # friction of joint 2 of the robot whose log is evaluated, N m and N m s/rad
SLOW = 0.02  # rate below which the direction of the dry friction is not evaluated, rad/s
POSES = np.radians(  # angles of the joints: pick, lift, between, above the place, place
    [
        (55, 43, 17, 0, 30, 0),
        (48, 24, 10, 0, 56, 10),
        (0, 8, 5, 40, 60, 60),
        (-48, 30, 0, 20, 60, 80),
        (-60, 48, 6, 0, 36, 90),
    ]
)


@dataclass(frozen=True, kw_only=True)
class RobotArm(mb.Model):
    """Six-axis robot arm with geared motors."""

    name = "robot_arm"
    stop_time, output_interval = STOP_TIME, STEP

    driven: bool = mb.parameter(
        False, structural=True, doc="Joints driven by angles as inputs; false: torques of the motors as inputs"
    )
    payload: float = mb.parameter(5.0, unit="kg", min=0.0, max=10.0, doc="Mass of the payload")
    coulomb: float = mb.parameter(
        0.0,
        unit="N.m",
        min=0.0,
        structural=True,
        doc="Dry friction of joint 2; 0: none",
    )
    viscous: float = mb.parameter(AXES[1].friction, unit="N.m.s/rad", min=0.0, doc="Viscous friction of joint 2")

    def build(self) -> mb.Mechanism:
        """Return the mechanism: z up, x forward, origin in the middle of the foot."""
        m = mb.Mechanism(gravity=(0, 0, -9.81))
        link = m.ground
        for k, (axis, start) in enumerate(zip(AXES, POSES[0], strict=True), 1):
            carrier, place = link, {"at": axis.at, "axis": axis.axis}
            motion: dict[str, Any] = {"start": start, "fixed": True}
            if self.driven:
                angle = mb.Input(
                    name=f"axis{k}.target",
                    unit="rad",
                    rate_name=f"axis{k}.target_rate",
                    acceleration_name=f"axis{k}.target_acceleration",
                    description=f"Angle of joint {k}",
                    start=float(start),
                )
                motion = {"drive": angle}
            link = m.body(
                f"link{k}", carrier, mb.Revolute(**place, **motion), mass=axis.mass, com=axis.com, inertia=axis.inertia
            )

            # Motor: the stator is a part of the link before the joint, the rotor rotates about the axis of the joint.
            rotor = mb.Revolute(**place, start=axis.ratio * start)
            inertia = [0.6 * axis.rotor] * 3
            inertia["xyz".index(axis.axis)] = axis.rotor
            motor = m.body(f"rotor{k}", carrier, rotor, mass=axis.rotor_mass, inertia=inertia)
            gear = m.couple(f"gear{k}", mb.Gear(ratio=axis.ratio), motor, link)
            m.force(f"friction{k}", mb.JointSpring(damping=self.viscous if k == 2 else axis.friction), link)
            if k == 2 and self.coulomb:
                m.force("dry2", mb.JointFriction(coulomb=self.coulomb), link)

            m.output(f"axis{k}.angle", link.coordinate(), f"Angle of joint {k}")
            m.output(f"axis{k}.rate", link.rate(), f"Angular velocity of joint {k}")
            if self.driven:
                m.output(f"axis{k}.torque", link.effort(), f"Torque of drive {k} at the joint, rotor included")
            else:
                torque = mb.Input(name=f"motor{k}.torque", unit="N.m", description=f"Torque of motor {k} on its rotor")
                m.force(f"motor{k}", mb.JointForce(torque), motor)
                m.output(f"gear{k}.torque", gear.effort("b"), f"Torque of gear {k} on link {k}")
            m.shape(link, *link_shapes(k))
            m.shape(motor, mb.Cylinder(radius=0.03, length=0.1, axis=axis.axis, color="#3f4654"))

        payload = m.body("payload", link, mb.Weld(at=PAYLOAD_AT), **mb.box(mass=self.payload, size=PAYLOAD_SIZE))
        m.shape(payload, mb.Box(size=PAYLOAD_SIZE))
        for direction in "xyz":
            m.output(f"tool.{direction}", link.position(direction, TOOL), f"Position {direction} of the tool point")
        m.output("energy", m.energy, "Kinetic and potential energy")
        return m


def link_shapes(k: int) -> list[mb.Cylinder]:
    """Return what link ``k`` looks like: the housing of its joint, and a bar to the next joint."""
    axis, end = AXES[k - 1], np.array(AXES[k].at if k < len(AXES) else TOOL)
    radius, color = (0.09, 0.075, 0.065, 0.05, 0.04, 0.03)[k - 1], "#ef8a17" if k % 2 else "#4a5568"
    housing = mb.Cylinder(radius=radius, length=2.2 * radius, axis=axis.axis, color=color)
    length = float(np.linalg.norm(end))
    middle = 0.5 * end * (1.0 + radius / length)  # the bar begins at the surface of the housing
    return [housing, mb.Cylinder(radius=0.7 * radius, length=length - radius, axis=end, at=middle, color=color)]


def plan_path() -> BSpline:
    """Return the angles of the joints over time: splines of order 7 through the poses, at rest at both ends."""
    rest = [(order, np.zeros(len(AXES))) for order in (1, 2, 3)]
    return make_interp_spline(TIMES, POSES, k=7, bc_type=(rest, rest))


def reference(path: BSpline, t: float) -> Array:
    """Return angles (rad), rates (rad/s) and accelerations (rad/s2) of the joints at time t, one row each."""
    moving = t < TIMES[-1]
    return np.array([path(min(t, TIMES[-1]), order) * (order == 0 or moving) for order in range(3)])


def follow_targets(**parameters: float) -> mb.Result:
    """Return a run of the driven arm along the path, with other parameters of the model."""
    planned = plan_path()
    inputs = {f"axis{k}.target": partial(lambda k, t: float(planned(t)[k - 1]), k) for k in NUMBERS}
    arm = RobotArm(driven=True, **parameters)
    return mb.simulate(arm, TIMES[-1], inputs=inputs, solver="radau", interval=LOG_STEP)


def write_log(path: Path, times: Array, torque: Array, seed: int = 1) -> None:
    """Write a log of the robot: times, angles of all joints, and the torque of drive 2 (N m) with noise."""
    noisy = torque + NOISE * np.random.default_rng(seed).normal(size=len(times))
    head = ["time [s]", *(f"axis{k} [deg]" for k in NUMBERS), "torque2 [N.m]"]
    rows = np.column_stack((times, np.degrees(plan_path()(times)), noisy))
    np.savetxt(path, rows, fmt="%.7g", delimiter=",", header=",".join(head), comments="")


def friction_study(log: Path) -> dict[str, Any]:
    """Return the arguments of the study that identifies the friction of joint 2 from a log.

    The sum of the squares of the deviations of the torque is least where their products with the two terms of the
    friction, sign of the rate and rate, have the mean zero (normal equations).
    """
    measured = mb.read_table(log, "torque2")

    def mean_product(result: mb.Result, term: Array) -> float:
        return float(np.mean((result["axis2.torque"] - measured.y) * term))

    def dry(result: mb.Result) -> float:
        rate = result["axis2.rate"]
        return mean_product(result, np.sign(rate) * (np.abs(rate) > SLOW))

    def sliding(result: mb.Result) -> float:
        return mean_product(result, result["axis2.rate"])

    return {
        "given": RobotArm(driven=True),
        "vary": {"coulomb": {"from": 1.0, "to": 40.0}, "viscous": {"from": 0.0, "to": 20.0}},
        "measure": {"dry": dry, "sliding": sliding},
        "aim": {"target": {"dry": 0.0, "sliding": 0.0}, "most": 40},
        "inputs": {f"axis{k}.target": f"{log}:axis{k}" for k in NUMBERS},
        "fixed": {"solver": "radau"},
        "stop_time": TIMES[-1],
        "output_interval": LOG_STEP,
    }


def identify_friction(log: Path, folder: Path) -> dict[str, float]:
    """Return the dry (N m) and the viscous friction (N m s/rad) of joint 2 by a study of the log."""
    study = mb.study(**friction_study(log), folder=folder)
    assert study.found is not None
    print(f"{len(study.rows)} runs: " + ", ".join(f"{name} {value:.2f}" for name, value in study.found.point.items()))
    return study.found.point


def draw_friction(log: Path, found: dict[str, float], path: Path) -> None:
    """Draw the torque of the log and of the models without dry friction and with the friction that was found."""
    measured = mb.read_table(log, "torque2")
    figure, (torques, deviations) = plt.subplots(2, 1, figsize=(7.5, 5.2), sharex=True, layout="constrained")
    torques.plot(measured.x, measured.y, color="black", lw=0.8, label="log of the robot")
    for label, color, parameters in (
        ("model without dry friction", COLORS[1], {}),
        ("model with the friction that was found", COLORS[2], found),
    ):
        result = follow_targets(**parameters)
        torques.plot(result.t, result["axis2.torque"], color=color, label=label)
        deviations.plot(result.t, measured.y - result["axis2.torque"], color=color)
    torques.set(ylabel="torque of drive 2 [N m]", title="Friction of joint 2")
    deviations.set(xlabel="time [s]", ylabel="deviation [N m]")
    torques.legend(fontsize="small")
    for ax in (torques, deviations):
        ax.grid(alpha=0.3)
    figure.savefig(path, dpi=80)


def communication_times(step: float) -> Array:
    """Return the communication points, s."""
    return step * np.arange(round(STOP_TIME / step) + 1)


def read(slave: Slave, what: str, keys: Any = NUMBERS) -> Array:
    """Return the outputs of an FMU whose name is ``what`` with a number or letter in place of the braces."""
    return np.array([slave[what.format(key)] for key in keys])


def required_torques(fmu: Path, step: float = STEP, order: int = 2) -> Run:
    """Move the driven arm along the path and return its outputs over time, torques in N m of the motors.

    ``order`` is that of the highest derivative that the FMU is given: 0 angles, 1 rates, 2 accelerations.
    """
    path, suffixes, rows = plan_path(), ("", "_rate", "_acceleration")[: order + 1], []
    with Slave(fmu) as slave:
        for t in communication_times(step):
            for suffix, values in zip(suffixes, reference(path, t), strict=False):
                for k, value in zip(NUMBERS, values, strict=True):
                    slave[f"axis{k}.target{suffix}"] = value
            torque = read(slave, "axis{}.torque") / RATIOS
            rows.append(
                (t, read(slave, "axis{}.angle"), read(slave, "axis{}.rate"), torque, read(slave, "tool.{}", "xyz"))
            )
            slave.step(step)
    return collect(("time", "angle", "rate", "torque", "tool"), rows)


def follow_path(fmu: Path, forward: Array, step: float = STEP) -> Run:
    """Control the arm along the path and return its outputs over time.

    ``forward`` are the feedforward torques of the motors (N m), one row per step.
    """
    path, rows = plan_path(), []
    with Slave(fmu, {f"motor{k}.torque": value for k, value in zip(NUMBERS, forward[0], strict=True)}) as slave:
        for t, planned in zip(communication_times(step), forward, strict=True):
            angle, rate = read(slave, "axis{}.angle"), read(slave, "axis{}.rate")
            torque = planned + feedback(reference(path, t), angle, rate)
            for k, value in zip(NUMBERS, torque, strict=True):
                slave[f"motor{k}.torque"] = value
            rows.append((t, angle, rate, torque, read(slave, "tool.{}", "xyz"), read(slave, "gear{}.torque")))
            slave.step(step)
    return collect(("time", "angle", "rate", "torque", "tool", "gear"), rows)


def feedback(target: Array, angle: Array, rate: Array) -> Array:
    """Return the torques of the motors (N m) by a PD controller of every joint; rows of ``target``: angles, rates."""
    return (STIFFNESS * (target[0] - angle) + DAMPING * (target[1] - rate)) / RATIOS


def collect(names: tuple[str, ...], rows: list[tuple[Any, ...]]) -> Run:
    """Return the columns of ``rows`` as arrays, by name."""
    return {name: np.array(column) for name, column in zip(names, zip(*rows, strict=True), strict=True)}


def means(torques: Array) -> Array:
    """Return for every step the mean of the torques at its begin and its end."""
    return 0.5 * (torques + np.vstack((torques[1:], torques[-1:])))


def tool_error(run: Run, driven: Run) -> Array:
    """Return the distance of the tool from its path over time, m."""
    return np.linalg.norm(run["tool"] - driven["tool"], axis=1)


def compare_steps(driven: Path, arm: Path, steps: tuple[float, ...] = STEPS) -> dict[str, Array]:
    """Return the largest errors of the tool (m) for every communication step, by the feedforward torque."""
    errors: dict[str, list[float]] = {name: [] for name in LABELS}
    for step in steps:
        planned = required_torques(driven, step)
        for name, torques in feedforward(planned).items():
            errors[name].append(tool_error(follow_path(arm, torques, step), planned).max())
    return {name: np.array(values) for name, values in errors.items()}


def feedforward(planned: Run) -> dict[str, Array]:
    """Return three feedforward torques of the motors for the torques that the path requires, N m, one row per step."""
    torques = planned["torque"]
    return dict(zip(LABELS, (np.repeat(torques[:1], len(torques), axis=0), torques, means(torques)), strict=True))


def size_drives(run: Run) -> list[dict[str, float]]:
    """Return for every axis the peak values of its drive along the path, and the gear ratios to choose from."""
    drives = []
    for k, axis in enumerate(AXES):
        torque, load, speed = run["torque"][:, k], run["gear"][:, k], axis.ratio * run["rate"][:, k]
        ratios = np.geomspace(10.0, 1000.0, 401)
        peaks = peak_torques(run, k, ratios)
        drives.append(
            {
                "ratio": axis.ratio,
                "gear torque [N m]": np.abs(load).max(),
                "motor torque [N m]": np.abs(torque).max(),
                "RMS torque [N m]": float(np.sqrt(np.mean(torque**2))),
                "motor speed [rpm]": np.abs(speed).max() * 30.0 / np.pi,
                "motor power [W]": (torque * speed).max(),
                "best ratio": ratios[peaks.argmin()],
                "largest ratio": MOTOR_SPEED / np.abs(run["rate"][:, k]).max(),
            }
        )
    return drives


def peak_torques(run: Run, k: int, ratios: Array) -> Array:
    """Return the peak torques of motor k (from 0) along the path, N m, for other gear ratios."""
    acceleration = np.gradient(run["rate"][:, k], run["time"])
    return np.abs(run["gear"][:, k] / ratios[:, None] + AXES[k].rotor * ratios[:, None] * acceleration).max(axis=1)


def draw_torques(run: Run, path: Path) -> None:
    """Draw the torques of the motors over time, and the part of the gears in them."""
    figure, panels = plt.subplots(2, 3, figsize=(10.0, 4.8), sharex=True, layout="constrained")
    for k, ax in enumerate(panels.flat):
        ax.plot(run["time"], run["torque"][:, k], color="#4269d0", label="motor")
        ax.plot(run["time"], run["gear"][:, k] / RATIOS[k], "--", color="#ff725c", lw=1.2, label="gear")
        ax.set(title=f"Axis {k + 1}", xlabel="time [s]" if k > 2 else "", ylabel="" if k % 3 else "torque [N m]")
        ax.grid(alpha=0.3)
    panels[0, 0].legend()
    figure.savefig(path, dpi=80)


def draw_errors(runs: dict[str, Run], errors: dict[str, Array], path: Path) -> None:
    """Draw the errors of the tool over time and over the communication step."""
    figure, (over_time, over_step) = plt.subplots(1, 2, figsize=(10.0, 4.2), layout="constrained")
    for (name, values), color in zip(errors.items(), COLORS, strict=False):
        over_time.semilogy(runs[name]["time"], 1e3 * tool_error(runs[name], runs["driven"]), color=color)
        over_step.loglog(1e3 * np.array(STEPS), 1e3 * values, "o-", color=color, label=name)
    over_time.set(xlabel="time [s]", ylabel="error of the tool [mm]", title="Step of 1 ms", ylim=(1e-5, 1e2))
    over_step.set(xlabel="communication step [ms]", ylabel="largest error of the tool [mm]", title="Step size")
    set_ticks(over_step, 1e3 * np.array(STEPS))
    over_step.legend(loc=(0.02, 0.66), fontsize="small")
    for ax in (over_time, over_step):
        ax.grid(alpha=0.3)
    figure.savefig(path, dpi=80)


def draw_ratios(run: Run, path: Path) -> None:
    """Draw the peak torques of the motors over the gear ratio, and the chosen ratios."""
    figure, ax = plt.subplots(figsize=(5.4, 4.2), layout="constrained")
    ratios = np.geomspace(20.0, 500.0, 200)
    for k, axis in enumerate(AXES):
        peaks = peak_torques(run, k, np.append(ratios, axis.ratio))
        ax.loglog(ratios, peaks[:-1], color=COLORS[k], label=f"axis {k + 1}")
        ax.plot(axis.ratio, peaks[-1], "o", color=COLORS[k])
    ax.set(xlabel="gear ratio", ylabel="peak torque of the motor [N m]", title="Gear ratio (dot: chosen)")
    set_ticks(ax, (20, 50, 100, 200, 500))
    ax.legend(ncols=2, fontsize="small")
    ax.grid(alpha=0.3)
    figure.savefig(path, dpi=80)


def set_ticks(ax: Any, ticks: Any) -> None:
    """Label a logarithmic axis at these numbers."""
    ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    ax.set_xticks([], minor=True)


def draw_arm(path: Path) -> None:
    """Draw the arm at the poses, the earlier ones translucent, and the path of the tool."""
    planned, recorder = plan_path(), Recorder()
    inputs = {f"axis{k}.target": partial(lambda k, t: float(planned(t)[k - 1]), k) for k in NUMBERS}
    mb.simulate(RobotArm(driven=True), TIMES[-1], inputs=inputs, solver="adams", interval=0.02, watch=recorder)
    motion = recorder.motion("robot_arm")
    shot = Shot(width=720, height=540, azimuth=70.0, elevation=25.0, solids_only=True)
    artist = Artist(motion, shot)
    figure = plt.figure(figsize=(7.2, 5.4))
    ax = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    for time in TIMES:
        with TemporaryDirectory() as work:
            write_png(motion, Path(work) / "pose.png", time, shot)
            frame = plt.imread(Path(work) / "pose.png")
        frame[..., 3] *= 1.0 if time == TIMES[-1] else 0.35
        ax.imshow(frame, extent=(-2.0 / 3.0, 2.0 / 3.0, -0.5, 0.5))
    flange = motion.names.index(f"link{len(AXES)}")
    ax.plot(*artist.camera.project(motion.point(flange, TOOL)[:, 0])[0].T, color="#d9483b", lw=1.5)
    ax.set_axis_off()
    figure.savefig(path, dpi=80)


def example(folder: Path) -> dict[str, Run]:
    """Export both FMUs to a folder, run them, print a table of the drives and return the signals over time."""
    settings = mb.Settings(solver="adams", tolerance=1e-7)
    driven = mb.export(RobotArm(driven=True), folder / "robot_arm_driven.fmu", settings, native=True)
    arm = mb.export(RobotArm(), folder / "robot_arm.fmu", settings, native=True)
    runs = {"driven": required_torques(driven)}
    for name, torques in feedforward(runs["driven"]).items():
        runs[name] = follow_path(arm, torques)
    errors = compare_steps(driven, arm)
    for name, values in errors.items():
        print(f"{name}: largest errors of the tool " + ", ".join(f"{1e3 * value:.4f} mm" for value in values))
    for k, drive in enumerate(size_drives(runs[LABELS[-1]]), 1):
        print(f"axis {k}: " + ", ".join(f"{name} {value:.3g}" for name, value in drive.items()))
    draw_arm(folder / "robot_arm_model.png")
    draw_torques(runs[LABELS[-1]], folder / "robot_arm_torques.png")
    draw_ratios(runs[LABELS[-1]], folder / "robot_arm_ratios.png")
    draw_errors(runs, errors, folder / "robot_arm.png")
    return runs


def friction_example(folder: Path) -> None:
    """Write the log of a robot to a folder, identify the friction of its joint 2, and draw the torques."""
    measured = follow_targets(coulomb=COULOMB, viscous=VISCOUS)
    write_log(folder / "robot_log.csv", measured.t, measured["axis2.torque"])
    found = identify_friction(folder / "robot_log.csv", folder / "robot_friction")
    draw_friction(folder / "robot_log.csv", found, folder / "robot_arm_friction.png")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="A six-axis robot arm with geared motors and a controller.")
    parser.add_argument("-o", "--output", type=Path, default=Path("results"), metavar="FOLDER")
    output = parser.parse_args().output
    output.mkdir(parents=True, exist_ok=True)
    example(output)
    friction_example(output)
