"""A scissor lift with a hydraulic cylinder and a controller of its height: ``python examples/scissor_lift.py``.

The lift is exported as a native FMU: the force of the cylinder is its input, the height of the platform its output.
The controller is written in Python and steps the FMU through FMPy. The force that holds the lift at rest is known from
virtual work (:func:`static_force`). ``docs/examples/scissor_lift.md`` explains the example.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from math import atan2, cos, hypot, radians, sin
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from fmpy_slave import Slave
from numpy.typing import NDArray

import mbfmu as mb

STAGES, LENGTH, WIDTH = 3, 2.0, 0.8  # number of stages; length of the arms and distance of the two sides, m
LOWER, UPPER = 0.2, 1.6  # pins of the cylinder: distances from the left ends of the first and the second rising arm, m
TUBE, RAM = 1.2, 1.3  # lengths, m
STEP, STOP_TIME = 0.005, 20.0  # communication step and end of the run, s
RAISE, LOADED, PAYLOAD = (1.0, 8.0, 1.2), 12.0, 2000.0  # begin, end (s) and height (m) of the motion; s; N
GRAVITY = 9.81  # m/s2
SEALS, CLAMP = 400.0, 2e4  # dry friction of the seals, and of the seals and the closed clamp, N
PUMP_STOPS, CLOSING, CARRIED = 3.0, 0.05, 500.0  # stop of the pump, s; time in which the clamp closes, s; load, N

Run = dict[str, NDArray[np.float64]]  # signals over time, by name


@dataclass(frozen=True, kw_only=True)
class ScissorLift(mb.Model):
    """Scissor lift of three stages with a hydraulic cylinder."""

    name = "scissor_lift"
    stop_time, output_interval = STOP_TIME, STEP

    angle: float = mb.parameter(
        radians(10), unit="rad", min=0.05, max=1.2, doc="Initial angle of the arms to the floor"
    )
    arm_mass: float = mb.parameter(30.0, unit="kg", min=1.0, doc="Mass of a pair of arms with its cross tubes")
    platform_mass: float = mb.parameter(150.0, unit="kg", min=0.0, doc="Mass of the platform")
    tube_mass: float = mb.parameter(20.0, unit="kg", min=0.0, doc="Mass of the tube of the cylinder")
    ram_mass: float = mb.parameter(10.0, unit="kg", min=0.0, doc="Mass of the ram of the cylinder")
    damping: float = mb.parameter(2e4, unit="N.s/m", min=0.0, doc="Viscous damping of the cylinder")
    dry: bool = mb.parameter(False, doc="Whether the cylinder has dry friction of its seals and a clamp of its ram")

    def build(self) -> mb.Mechanism:
        """Return the mechanism: x along the floor, y up, origin in the fixed foot."""
        half, sides = 0.5 * LENGTH, {"left": -0.5 * WIDTH, "right": 0.5 * WIDTH}
        arm = mb.box(mass=self.arm_mass, size=(LENGTH, 0.12, WIDTH))
        m = mb.Mechanism(gravity=(0, -GRAVITY, 0))

        # Arms: the frame of a rising arm is at its left end, that of a falling arm at its middle, on the rising arm.
        rising, falling = [], []
        for k in range(STAGES):
            below, foot = m.ground, mb.Revolute(start=self.angle, fixed=True)
            if k:
                below, foot = falling[-1], mb.Revolute(at=(-half, 0, 0), start=2 * self.angle)
            rising.append(m.body(f"rising{k + 1}", below, foot, **arm | {"com": (half, 0, 0)}))
            middle = mb.Revolute(at=(half, 0, 0), start=-2 * self.angle)
            falling.append(m.body(f"falling{k + 1}", rising[-1], middle, **arm))
        top = mb.Revolute(at=(-half, 0, 0), start=self.angle)
        platform = m.body("platform", falling[-1], top, mass=self.platform_mass, com=(half, 0, 0))

        # Loops: a hinge, a roller and a slider on either side. Those of the second side are redundant.
        for side, z in sides.items():
            m.cut(f"roller.{side}", mb.PlaneCutJoint(axis="y", at_b=(half, 0, z)), m.ground, falling[0])
            for k in range(1, STAGES):
                hinge = mb.RevoluteCutJoint(at_a=(LENGTH, 0, z), at_b=(half, 0, z))
                m.cut(f"hinge{k + 1}.{side}", hinge, rising[k - 1], falling[k])
            m.cut(f"slider.{side}", mb.PlaneCutJoint(axis="y", at_b=(LENGTH, 0, z)), platform, rising[-1])

        # Cylinder: the frame of its tube is at the lower pin, that of its ram at the upper pin.
        x, y = cylinder(self.angle)
        tilt = mb.Revolute(at=(LOWER, 0, 0), start=atan2(y, x) - self.angle)
        tube = m.body("tube", rising[0], tilt, **mb.rod(mass=self.tube_mass, length=TUBE))
        stroke = mb.Translational(axis="x", start=hypot(x, y))
        ram = m.body("ram", tube, stroke, **mb.rod(mass=self.ram_mass, length=-RAM))
        m.cut("pin", mb.RevoluteCutJoint(at_b=(UPPER, 0, 0)), ram, rising[1])
        force = mb.Input(name="cylinder.force", unit="N", description="Force of the oil on the ram")
        m.force("oil", mb.JointForce(force), ram)
        m.force("friction", mb.JointSpring(damping=self.damping), ram)
        if self.dry:
            held = mb.Input(name="ram.friction", unit="N", start=SEALS, description="Dry friction of seals and clamp")
            dry = mb.JointFriction(coulomb=1.0, stribeck=0.1, static=1.1, normal_force=held)
            m.output("friction.force", m.force("dry", dry, ram).effort(), "Dry friction on the ram")
        load = mb.Input(name="platform.load", unit="N", description="Weight on the platform")
        m.force("load", mb.PointForce(magnitude=load, axis=(0, -1, 0), at_a=(half, 0, 0)), platform)

        for body, at in [(arm, half) for arm in rising] + [(arm, 0.0) for arm in falling]:
            m.shape(body, *(mb.Box(size=(LENGTH, 0.1, 0.04), at=(at, 0, z)) for z in sides.values()))
        m.shape(platform, mb.Box(size=(1.1 * LENGTH, 0.04, 1.2 * WIDTH), at=(half, 0.07, 0)))
        m.shape(tube, mb.Cylinder(radius=0.06, length=TUBE, axis="x", at=(0.5 * TUBE, 0, 0)))
        m.shape(ram, mb.Cylinder(radius=0.035, length=RAM, axis="x", at=(-0.5 * RAM, 0, 0)))

        m.output("platform.height", platform.position("y"), "Height of the platform")
        m.output("platform.speed", platform.velocity("y"), "Speed of the platform")
        m.output("cylinder.length", ram.coordinate(), "Distance of the pins of the cylinder")
        m.output("cylinder.speed", ram.rate(), "Speed of the ram in the tube")
        m.output("energy", m.energy, "Kinetic and potential energy")
        return m


def cylinder(angle: float) -> tuple[float, float]:
    """Return the vector from the lower to the upper pin of the cylinder, m, for an angle of the arms, rad."""
    return (UPPER - LOWER) * cos(angle), (LENGTH + UPPER - LOWER) * sin(angle)


def static_force(lift: ScissorLift, height: float, load: float) -> float:
    """Return the force of the cylinder that holds the platform at ``height`` (m) under ``load`` (N).

    Virtual work: force times d(length)/d(angle) equals the sum of weight times d(height)/d(angle).
    """
    s = height / (STAGES * LENGTH)
    c = (1.0 - s * s) ** 0.5
    x, y = cylinder(atan2(s, c))
    dx, dy = (LOWER - UPPER) * s, y / s * c
    length = hypot(x, y)
    stretch = (x * dx + y * dy) / length
    tilt = (dy - y * stretch / length) / length  # derivative of the sine of the angle of the cylinder
    weights = (  # mass in kg, derivative of its height in m/rad
        (lift.platform_mass + load / GRAVITY, STAGES * LENGTH * c),
        (lift.arm_mass, STAGES**2 * LENGTH * c),  # two pairs of arms per stage, with their centers at its middle
        (lift.tube_mass, LOWER * c + 0.5 * TUBE * tilt),
        (lift.ram_mass, (LENGTH + UPPER) * c - 0.5 * RAM * tilt),
    )
    return GRAVITY * sum(mass * rise for mass, rise in weights) / stretch


class HeightController:
    """PI controller of the speed of the platform, whose reference follows the error of the height."""

    height_gain, gain, integral_gain = 1.5, 1.5e4, 6e4  # 1/s, N s/m, N/m

    def __init__(self, force: float) -> None:
        self.integral = force  # N; the force that the lift starts with

    def force(self, height: float, speed: float, target: float, target_speed: float) -> float:
        """Return the force of the next step, N; heights in m, speeds in m/s."""
        error = target_speed + self.height_gain * (target - height) - speed
        self.integral += self.integral_gain * STEP * error
        return self.integral + self.gain * error


def reference(t: float, start: float) -> tuple[float, float]:
    """Return the desired height (m) and speed (m/s): a rise from ``start`` without jumps of the acceleration."""
    begin, end, rise = RAISE
    x = min(max((t - begin) / (end - begin), 0.0), 1.0)
    return start + rise * x**3 * (10 - 15 * x + 6 * x**2), rise * 30 * x**2 * (1 - x) ** 2 / (end - begin)


def raise_platform(fmu: Path, lift: ScissorLift) -> Run:
    """Step the FMU with its controller and return the signals over time; a payload is put on after the rise."""
    start = STAGES * LENGTH * sin(lift.angle)
    force = static_force(lift, start, 0.0)
    controller = HeightController(force)
    names = ("platform.height", "platform.speed", "cylinder.length", "cylinder.speed", "energy")
    rows = []
    with Slave(fmu, {"cylinder.force": force}) as slave:
        for i in range(round(STOP_TIME / STEP) + 1):
            t = i * STEP
            values = [slave[name] for name in names]
            target, target_speed = reference(t, start)
            force = controller.force(values[0], values[1], target, target_speed)
            load = PAYLOAD if t >= LOADED else 0.0
            rows.append([t, *values, force, load, target])
            slave["cylinder.force"], slave["platform.load"] = force, load
            slave.step(STEP)
    return dict(zip(("time", *names, "force", "load", "target"), np.array(rows).T, strict=True))


def energy_error(run: Run, lift: ScissorLift) -> float:
    """Return the change of the energy minus the work of cylinder, payload and friction from start to end, J."""
    work = np.sum(run["force"][:-1] * np.diff(run["cylinder.length"]))  # forces are constant between the steps
    work -= np.sum(run["load"][:-1] * np.diff(run["platform.height"]))
    work -= lift.damping * np.trapezoid(run["cylinder.speed"] ** 2, run["time"])
    return float(run["energy"][-1] - run["energy"][0] - work)


def draw(run: Run, lift: ScissorLift, path: Path) -> None:
    """Draw height and force, and the static force for every height and load with the viscous force added to it."""
    figure, (heights, forces) = plt.subplots(2, 1, figsize=(7.5, 5.2), sharex=True, layout="constrained")
    heights.plot(run["time"], run["target"], "--", color="black", lw=1.0, label="reference")
    heights.plot(run["time"], run["platform.height"], color="#4269d0", label="platform")
    static = [static_force(lift, *pair) for pair in zip(run["platform.height"], run["load"], strict=True)]
    forces.plot(run["time"], run["force"] / 1e3, color="#ff725c", label="cylinder")
    static += lift.damping * run["cylinder.speed"]
    forces.plot(run["time"], static / 1e3, ":", color="black", label="static and viscous force, closed form")
    heights.set(ylabel="height [m]", title="Scissor lift: rise of 1.2 m, then a payload of 2 kN")
    forces.set(xlabel="time [s]", ylabel="force [kN]")
    for ax, place in ((heights, "lower right"), (forces, "upper center")):
        ax.grid(alpha=0.3)
        ax.legend(loc=place)
    figure.savefig(path, dpi=80)


def write_pump(path: Path, lift: ScissorLift) -> None:
    """Write forces of the oil and dry friction of the ram over time: the pump stops, and the clamp closes."""
    rest, closed = static_force(lift, STAGES * LENGTH * sin(lift.angle), CARRIED), PUMP_STOPS + CLOSING
    rows = (
        (0.0, rest, SEALS), (0.5, rest + 1500.0, SEALS), (PUMP_STOPS, rest - 1000.0, SEALS), (closed, 0.0, CLAMP),
        (10.0, 0.0, CLAMP),
    )  # fmt: skip
    lines = [f"{t:g},{1e-3 * oil:.6f},{1e-3 * friction:.6f}" for t, oil, friction in rows]
    path.write_text("\n".join(["time [s],oil [kN],friction [kN]", *lines]) + "\n")


def hold_platform(pump: Path, lift: ScissorLift) -> mb.Result:
    """Return a run in which the clamp of the ram holds the lift when the pump has stopped."""
    oil, friction = (mb.read_table(pump, column, kind="linear") for column in ("oil", "friction"))
    inputs = {"cylinder.force": oil, "ram.friction": friction, "platform.load": CARRIED}
    return mb.simulate(lift, 10.0, interval=0.01, solver="ida", tolerance=1e-7, inputs=inputs)


def draw_hold(result: mb.Result, lift: ScissorLift, path: Path) -> None:
    """Draw the height, and the friction of the ram with the static force."""
    figure, (heights, forces) = plt.subplots(2, 1, figsize=(7.5, 4.6), sharex=True, layout="constrained")
    heights.plot(result.t, result["platform.height"], color="#4269d0")
    forces.plot(result.t, result["friction.force"] / 1e3, color="#ff725c", label="friction on the ram")
    static = [static_force(lift, height, CARRIED) / 1e3 for height in result["platform.height"]]
    forces.plot(result.t, static, ":", color="black", label="static force, closed form")
    heights.set(ylabel="height [m]", title=f"The pump stops at {PUMP_STOPS:g} s, and the clamp closes")
    forces.set(xlabel="time [s]", ylabel="force [kN]", xlim=(0.0, 6.0))
    for ax in (heights, forces):
        ax.grid(alpha=0.3)
    forces.legend()
    figure.savefig(path, dpi=80)


def example(folder: Path) -> Run:
    """Export the lift to a folder, control it, compare with the static force and return the signals over time."""
    lift = ScissorLift()
    fmu = mb.export(lift, folder / "scissor_lift.fmu", mb.Settings(solver="adams", tolerance=1e-7), native=True)
    run = raise_platform(fmu, lift)
    for when in (0.0, LOADED - STEP, STOP_TIME):
        i = round(when / STEP)
        height, force = run["platform.height"][i], run["force"][i]
        exact = static_force(lift, height, run["load"][i])
        print(f"{when:6.3f} s: height {height:.5f} m, force of the cylinder {force:.2f} N, static {exact:.2f} N")
    print(f"change of energy minus work: {energy_error(run, lift):.1e} J of {np.ptp(run['energy']):.0f} J")
    draw(run, lift, folder / "scissor_lift.png")
    clamped = ScissorLift(dry=True)
    write_pump(folder / "pump.csv", clamped)
    held = hold_platform(folder / "pump.csv", clamped)
    print(f"held at {held['platform.height'][-1]:.5f} m by a friction of {held['friction.force'][-1]:.2f} N")
    draw_hold(held, clamped, folder / "scissor_lift_clamp.png")
    return run


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="A scissor lift with a hydraulic cylinder and a controller.")
    parser.add_argument("-o", "--output", type=Path, default=Path("results"), metavar="FOLDER")
    output = parser.parse_args().output
    output.mkdir(parents=True, exist_ok=True)
    example(output)
