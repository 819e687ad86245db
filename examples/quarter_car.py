"""A quarter car with double wishbones, bushings and a semi-active damper on a road: ``python examples/quarter_car.py``.

The suspension is exported as a native FMU. Its inputs are the height of the road and the controlled force of the
damper; its outputs are the acceleration of the body, the travel of the wheel and the camber. A skyhook controller
written in Python steps the FMU through FMPy. ``docs/examples/quarter_car.md`` explains the example.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from fmpy_slave import Slave
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

import mbfmu as mb

# Points at the design height (m): x forward, y outward, z up, origin on the road below the center of the car.
WHEEL = (0.0, 0.75, 0.32)  # center of the wheel
LOWER_HINGE, LOWER_BALL, LOWER_SPREAD = (0.0, 0.35, 0.22), (0.0, 0.70, 0.20), 0.15  # spread: hinges are at +- this x
UPPER_HINGE, UPPER_BALL, UPPER_SPREAD = (0.0, 0.42, 0.46), (0.0, 0.66, 0.50), 0.10
STRUT_TOP, STRUT_FOOT = (0.0, 0.45, 0.65), (0.0, 0.58, 0.207)  # on the body and on the lower arm
TIE = (-0.12, 0.0, 0.0)  # of the tie rod from the center line of the lower arm, to which it is parallel
STEP, STOP_TIME = 1e-3, 3.0  # communication step and end of the run, s
SAMPLING = 2.5e-3  # time between two points of the measured road, s; the car moves by 0.05 m
SPEED, ROUGHNESS = (
    20.0,
    256e-6,
)  # of the car, m/s; of the road, m3: power spectral density at 0.1 cycles/m, ISO 8608 class C
SOFT, PASSIVE, HARD, SKYHOOK = 600.0, 2000.0, 4000.0, 6000.0  # N s/m: range of the damper, passive damper, controller

Run = dict[str, NDArray[np.float64]]  # signals over time, by name
Law = Callable[[float, float], float]  # coefficient of the damper (N s/m) from speeds of body and damper (m/s)


@dataclass(frozen=True, kw_only=True)
class QuarterCar(mb.Model):
    """Quarter car with double wishbones, bushings and a road that moves the tire."""

    name = "quarter_car"
    stop_time, output_interval = STOP_TIME, STEP

    body_mass: float = mb.parameter(350.0, unit="kg", min=1.0, doc="Mass of the body on this wheel")
    wheel_mass: float = mb.parameter(35.0, unit="kg", min=1.0, doc="Mass of wheel, upright and brake")
    spring: float = mb.parameter(6e4, unit="N/m", min=1.0, doc="Stiffness of the spring")
    preload: float = mb.parameter(5560.0, unit="N", min=0.0, doc="Force of the spring at the design height")
    damping: float = mb.parameter(SOFT, unit="N.s/m", min=0.0, doc="Coefficient of the damper without control")
    tire: float = mb.parameter(2e5, unit="N/m", min=1.0, doc="Stiffness of the tire")
    tire_radius: float = mb.parameter(0.34, unit="m", min=0.1, doc="Radius of the tire without load")
    bushing: float = mb.parameter(5e6, unit="N/m", min=1.0, doc="Radial stiffness of a bushing")
    bushing_turn: float = mb.parameter(50.0, unit="N.m/rad", min=0.0, doc="Rotational stiffness of a bushing")

    def build(self) -> mb.Mechanism:
        """Return the mechanism."""
        m = mb.Mechanism(gravity=(0, 0, -9.81))
        body = m.body("body", m.ground, mb.Translational(axis="z"), mass=self.body_mass)

        # Road, contact point and wheel. The tire pushes, and never pulls, along z; the contact point follows the wheel.
        height = mb.Input(name="road.height", unit="m", rate_name="road.rate", description="Height of the road")
        road = m.body("road", m.ground, mb.Translational(axis="z", at=(WHEEL[0], WHEEL[1], 0), drive=height))
        along = m.body("contact.x", road, mb.Translational(axis="x"))
        across = m.body("contact.y", along, mb.Translational(axis="y"))
        hub = m.body("hub", across, mb.Translational(axis="z", start=WHEEL[2]))
        upright = m.body("upright", hub, mb.Spherical(), mass=self.wheel_mass, inertia=(0.8, 1.2, 0.8))
        tire = m.force("tire", mb.JointStop(lower=self.tire_radius, stiffness=self.tire, damping=0.05), hub)

        # Arms on two bushings each, ball joints to the upright, and the tie rod.
        for name, hinge, ball, spread, mass in (
            ("lower", LOWER_HINGE, LOWER_BALL, LOWER_SPREAD, 5.0),
            ("upper", UPPER_HINGE, UPPER_BALL, UPPER_SPREAD, 3.0),
        ):
            end = difference(ball, hinge)
            arm = m.body(
                f"{name}.arm", body, mb.Floating(at=hinge), mass=mass, com=0.5 * end, inertia=(0.05, 0.02, 0.06)
            )
            for side, x in (("front", spread), ("rear", -spread)):
                bushing = mb.Bushing(
                    stiffness=(0.2 * self.bushing, self.bushing, self.bushing),
                    damping=(1e2, 2e3, 2e3),
                    rotational_stiffness=self.bushing_turn,
                    at_a=(x, hinge[1], hinge[2]),
                    at_b=(x, 0, 0),
                )
                m.force(f"{name}.{side}", bushing, body, arm)
            m.shape(arm, *(bar((x, 0, 0), end) for x in (spread, -spread)))
            m.cut(f"{name}.ball", mb.SphericalCutJoint(at_a=end, at_b=difference(ball, WHEEL)), arm, upright)
            if name == "lower":
                length = float(np.linalg.norm(end))
                rod = mb.DistanceCutJoint(length=length, at_a=np.add(hinge, TIE), at_b=difference(ball, WHEEL) + TIE)
                m.cut("tie.rod", rod, body, upright)
                foot, lower = difference(STRUT_FOOT, hinge), arm

        # Strut: a tube on the body, and a rod that slides in it and ends on the lower arm.
        axis = difference(STRUT_FOOT, STRUT_TOP)
        length = float(np.linalg.norm(axis))
        across = (0.0, -axis[2], axis[1])
        tube = m.body(
            "tube",
            body,
            mb.Universal(axis="x", second=across, at=STRUT_TOP),
            mass=3.0,
            com=0.3 * axis,
            inertia=(0.02, 0.02, 0.02),
        )
        rod = m.body(
            "rod",
            tube,
            mb.Translational(axis=axis, start=length),
            mass=2.0,
            com=-0.3 * axis,
            inertia=(0.01, 0.01, 0.01),
        )
        m.cut("strut.foot", mb.SphericalCutJoint(at_b=foot), rod, lower)
        free = length + self.preload / self.spring
        m.force("strut", mb.JointSpring(stiffness=self.spring, damping=self.damping, free=free), rod)
        control = mb.Input(
            name="damper.force", unit="N", description="Controlled force of the damper, positive in extension"
        )
        m.force("control", mb.JointForce(control), rod)

        m.shape(body, mb.Box(size=(0.4, 0.12, 0.6), at=(0, 0.34, 0.42), color="#9aa3b2", opacity=0.35))
        m.shape(road, mb.Box(size=(0.8, 0.5, 0.01), color="#9aa3b2"))
        balls = [difference(ball, WHEEL) for ball in (LOWER_BALL, UPPER_BALL)]
        wheel = mb.Cylinder(radius=self.tire_radius, length=0.18, axis="y", color="#1d2430", opacity=0.3)
        m.shape(upright, bar(*balls), bar(balls[0], balls[0] + TIE), wheel)

        m.output("body.height", body.coordinate(), "Height of the body above the design height")
        m.output("body.speed", body.rate(), "Vertical speed of the body")
        m.output("body.acceleration", body.acceleration(), "Vertical acceleration of the body")
        travel = m.relative_position(upright, body, "z", at_a=WHEEL)
        m.output("wheel.travel", travel, "Height of the wheel relative to the body, zero at the design height")
        m.output("wheel.axis", upright.direction("z", "y"), "Sine of the angle of the wheel's axis, negative camber")
        m.output("damper.speed", rod.rate(), "Speed of the damper, positive in extension")
        m.output("tire.force", tire.effort(), "Vertical force of the tire")
        m.output("energy", m.energy, "Kinetic and potential energy")
        return m


def difference(a: tuple[float, ...], b: tuple[float, ...]) -> NDArray[np.float64]:
    """Return the vector from point b to point a, m."""
    return np.subtract(a, b)


def bar(a: NDArray[np.float64] | tuple[float, ...], b: NDArray[np.float64]) -> mb.Cylinder:
    """Return a round bar between two points of a body, for pictures."""
    way = np.subtract(b, a)
    return mb.Cylinder(radius=0.015, length=float(np.linalg.norm(way)), axis=way, at=np.add(a, 0.5 * way))


def rigid_linkage(angle: float) -> tuple[float, float]:
    """Return travel (m) and camber (rad) with rigid hinges for an angle of the lower arm from the design, rad.

    The arms and the upright are a planar four-bar linkage with y + z i as complex numbers.
    """
    hinge, ball, top, upper, wheel = (
        complex(*p[1:]) for p in (LOWER_HINGE, LOWER_BALL, UPPER_BALL, UPPER_HINGE, WHEEL)
    )
    moved = hinge + (ball - hinge) * np.exp(1j * angle)
    line, height, arm = upper - moved, abs(top - ball), abs(top - upper)
    cosine = (height**2 + abs(line) ** 2 - arm**2) / (
        2.0 * height * abs(line)
    )  # angle in the triangle of the upper ball
    turned = line / abs(line) * np.exp(-1j * np.arccos(cosine)) * height / (top - ball)
    return (moved + (wheel - ball) * turned - wheel).imag, -np.angle(turned)


def road(seed: int = 1) -> CubicSpline:
    """Return the height of the road (m) over time (s): sines of random phase, ISO 8608, after a flat meter."""
    rng = np.random.default_rng(seed)
    waves, width = np.arange(0.02, 2.0, 0.01), 0.01  # cycles/m
    heights = np.sqrt(2.0 * ROUGHNESS * width) * 0.1 / waves
    x = np.arange(0.0, SPEED * STOP_TIME + 1.0, 0.05)
    profile = np.sin(2.0 * np.pi * (np.outer(x, waves) + rng.random(len(waves)))) @ heights
    fade = np.clip((x - 1.0) / 5.0, 0.0, 1.0)
    return CubicSpline(x / SPEED, fade**2 * (3.0 - 2.0 * fade) * profile)


def write_road(path: Path, profile: CubicSpline) -> None:
    """Write the height of a road over time to a CSV file, as a measurement does."""
    times = np.arange(0.0, STOP_TIME + 0.5 * SAMPLING, SAMPLING)
    rows = (f"{t:.4f},{1e3 * height:.6f}\n" for t, height in zip(times, profile(times), strict=True))
    path.write_text("time [s],left [mm]\n" + "".join(rows))


def skyhook(body_speed: float, damper_speed: float) -> float:
    """Return the coefficient whose force is that of a damper between body and sky, within what the damper can do."""
    if body_speed * damper_speed <= 0.0:
        return SOFT  # any force of the damper would accelerate the body
    return min(max(SKYHOOK * body_speed / damper_speed, SOFT), HARD)


def drive(fmu: Path, law: Law, profile: CubicSpline) -> Run:
    """Step the FMU over a road with a law of the damper and return the signals over time."""
    names = ("body.acceleration", "body.speed", "damper.speed", "wheel.travel", "wheel.axis", "tire.force")
    rows = []
    with Slave(fmu) as slave:
        for i in range(round(STOP_TIME / STEP) + 1):
            t = i * STEP
            values = [slave[name] for name in names]
            coefficient = law(slave["body.speed"], slave["damper.speed"])
            rows.append([t, float(profile(t)), *values, coefficient])
            slave["road.height"], slave["road.rate"] = float(profile(t)), float(profile(t, 1))
            slave["damper.force"] = -(coefficient - SOFT) * slave["damper.speed"]
            slave.step(STEP)
    return dict(zip(("time", "road", *names, "coefficient"), np.array(rows).T, strict=True))


def draw(runs: dict[str, Run], path: Path) -> None:
    """Draw the accelerations over time, and the camber over the travel together with that of rigid hinges."""
    figure, axes = plt.subplot_mosaic(
        [["road", "camber"], ["body", "camber"]], figsize=(10.0, 4.6), layout="constrained"
    )
    for (label, run), color in zip(runs.items(), ("#9aa3b2", "#4269d0"), strict=True):
        axes["body"].plot(run["time"], run["body.acceleration"], color=color, lw=1.2, label=label)
    axes["road"].plot(run["time"], 1e3 * run["road"], color="black", lw=1.0)
    axes["camber"].plot(
        1e3 * run["wheel.travel"], -np.degrees(np.arcsin(run["wheel.axis"])), color="#4269d0", label="FMU"
    )
    rigid = np.array([rigid_linkage(angle) for angle in np.linspace(-0.15, 0.15, 61)])
    axes["camber"].plot(1e3 * rigid[:, 0], np.degrees(rigid[:, 1]), ":", color="black", label="rigid hinges")
    axes["road"].set(ylabel="road [mm]", title="Rough road at 20 m/s")
    axes["body"].set(xlabel="time [s]", ylabel="body acceleration [m/s²]")
    axes["camber"].set(xlabel="wheel travel [mm]", ylabel="camber [deg]", title="Camber")
    for ax in axes.values():
        ax.grid(alpha=0.3)
    axes["body"].legend(loc="upper left", ncols=2)
    axes["camber"].legend()
    figure.savefig(path, dpi=80)


def example(folder: Path) -> dict[str, Run]:
    """Export the car to a folder, drive it with both dampers and return the signals over time."""
    car = QuarterCar()
    start = mb.equilibrium(car)
    print(
        f"at rest: tire force {start.outputs['tire.force']:.2f} N, travel {1e3 * start.outputs['wheel.travel']:.2f} mm"
    )
    modes = sorted(abs(complex(mode.eigenvalue)) / (2.0 * np.pi) for mode in start.modes)
    print(f"body and wheel oscillate at {modes[0]:.3f} Hz and {modes[1]:.2f} Hz")
    settings = mb.Settings(solver="adams", tolerance=1e-6, start_at_equilibrium=True)
    fmu = mb.export(car, folder / "quarter_car.fmu", settings, native=True)
    runs = {"passive": drive(fmu, lambda *_: PASSIVE, road()), "skyhook": drive(fmu, skyhook, road())}
    for label, run in runs.items():
        acceleration, force = (run[name].std() for name in ("body.acceleration", "tire.force"))
        print(f"{label}: body acceleration {acceleration:.3f} m/s2, variation of the tire force {force:.0f} N (RMS)")
    draw(runs, folder / "quarter_car.png")
    write_road(folder / "road.csv", road())
    return runs


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="A quarter car with double wishbones and a semi-active damper.")
    parser.add_argument("-o", "--output", type=Path, default=Path("results"), metavar="FOLDER")
    output = parser.parse_args().output
    output.mkdir(parents=True, exist_ok=True)
    example(output)
