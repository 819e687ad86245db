"""A feeder, two motors and a controller of skew, four FMUs in one co-simulation: ``python examples/feeder_motor.py``.

The feeder (``fmus/feeder``, mbfmu) takes the speeds of its rollers and returns their torques and what two light beams
see. Each roller has a motor (``roller_motor.py``, plain PythonFMU, one FMU instanced twice); the tachometer of the left
one reads ERROR too much, so that the left roller is slow and the sheet turns. The controller (``skew_controller.py``)
finds by how much when the leading edge is in the beams, turns the sheet back, and continues against what turned it.

What must come out follows from rigid kinematics (:func:`kinematics`): how fast the sheet turns from the speeds of the
rollers, when its edge is in the beams from geometry, and how the motors follow from their equations without a load. The
co-simulation is given none of it.

The own loop (:func:`co_simulate`) steps one FMU after the other, with what those before it give (Gauss and Seidel), or
all with the values of the last point (Jacobi), as hosts of the ``.ssp`` do. In Jacobi's way it is what libcosim does,
and with zero on every connection at first what FMPy does: skews agree within 1e-6 rad, as nothing is between them but
round-off and what the feeder's tolerance makes of it. Gauss and Seidel's way differs from both by what falls with the
step, 0.6 mrad at 1 ms. From beams to rollers it is two steps faster, in which the sheet still turns; and in FMPy's
first step rollers stand and motors brake, so that the sheet is late, which the controller takes for slower turning.

Writes three FMUs, ``feeder_motor.ssp`` and ``feeder_motor.png`` into a folder (``-o``) and prints a table.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from described_slave import build_slave
from numpy.typing import NDArray
from roller_motor import RollerMotor
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from skew_controller import SkewController
from ssp_system import Run, SspSystem

from fmus.feeder import Feeder
from mbfmu.fmi import Fmu, export
from mbfmu.plotting.figures import finish
from mbfmu.session.run import communication_points
from mbfmu.util.text_table import format_table

Array = NDArray[np.float64]
Fmus = Mapping[str, Path]  # elements in the order in which Gauss and Seidel step them

MODEL = Feeder(path="straight", nips=1, nx=9, nz=7, nip_width=0.004, sensor_distance=0.06)
ERROR = 0.02  # of the left tachometer
STOP_TIME = 0.4  # s
STEP = 1e-3  # s, between communication points
STEPS = (2e-3, 1e-3, 0.5e-3)  # of the study
SKEW = "feeder.sheet.skew"

SYSTEM = SspSystem(
    name="feeder_motor",
    connections=(
        ("feeder", "sensor[1].left.covered", "controller", "left_covered"),
        ("feeder", "sensor[1].right.covered", "controller", "right_covered"),
        ("controller", "left_wanted", "left_motor", "wanted"),
        ("controller", "right_wanted", "right_motor", "wanted"),
        ("feeder", "roller[1].left.torque", "left_motor", "load"),
        ("feeder", "roller[1].right.torque", "right_motor", "load"),
        ("left_motor", "speed", "feeder", "roller[1].left.speed"),
        ("right_motor", "speed", "feeder", "roller[1].right.speed"),
    ),
    recorded=(
        ("feeder", "sheet.skew"),
        ("feeder", "lead.x"),
        ("controller", "skew"),
        ("left_motor", "speed"),
        ("right_motor", "speed"),
    ),
    values={
        "controller.feed_speed": MODEL.speed,
        "controller.radius": MODEL.radius,
        "controller.nip_distance": MODEL.nip_distance,
        "controller.sensor_spread": MODEL.sensor_spread,
        "left_motor.wanted": MODEL.speed / MODEL.radius,
        "left_motor.reads": 1.0 + ERROR,
        "right_motor.wanted": MODEL.speed / MODEL.radius,
    },
)


# ---- what must come out ---------------------------------------------------------------------------------------------


def kinematics(times: Array, *, on: bool = True) -> Run:
    """Return skew and speeds at ``times`` (s) for rollers that do not slip, motors without load and no delay.

    Nips are points across, as those of the feeder are on cells so wide; on finer ones they resist turning, by 1 %.
    """
    motor = RollerMotor(instance_name="motor")  # for its numbers and law
    turn_back = SkewController(instance_name="controller").turn_back
    wanted, reads = MODEL.speed / MODEL.radius, np.array([1.0 + ERROR, 1.0])  # left, right

    def rates(_: float, y: Array, difference: float) -> Array:
        speeds, integrals = y[:2], y[2:4]
        error = wanted + np.array([-0.5, 0.5]) * difference - reads * speeds
        way, turn = MODEL.radius * speeds.mean(), MODEL.radius * (speeds[1] - speeds[0]) / MODEL.nip_distance
        return np.array([*((motor.gain * error + motor.reset * integrals) / motor.inertia), *error, way, turn])

    def solve(begin: float, end: float, y: Array, difference: float) -> Callable[[Any], Array]:
        told = {"dense_output": True, "args": (difference,), "rtol": 1e-10, "atol": 1e-12}
        return solve_ivp(rates, (begin, end), y, "DOP853", **told).sol  # type: ignore[no-any-return]

    end = float(times[-1])
    free = solve(0.0, end, np.array([wanted, wanted, 0.0, 0.0, MODEL.lead, 0.0]), 0.0)

    def ahead(t: float, hand: float) -> float:
        """Return how far the edge, which turns about its middle, is beyond the beam of a side."""
        *_, way, turn = free(t)
        return float(way + 0.5 * hand * MODEL.sensor_spread * np.tan(turn) - MODEL.sensor_distance)

    left, right = (brentq(ahead, 0.0, end, args=(hand,), xtol=1e-12) for hand in (-1.0, 1.0))
    skew, when = MODEL.speed * (left - right) / MODEL.sensor_spread, max(left, right)
    values = free(times)
    if on:
        back = -MODEL.nip_distance / MODEL.radius * skew
        turning = solve(when, when + turn_back, free(when), back * (1.0 / when + 1.0 / turn_back))
        after = solve(when + turn_back, max(end, when + turn_back + STEP), turning(when + turn_back), back / when)
        for since, part in ((when, turning), (when + turn_back, after)):
            values[:, times >= since] = part(times[times >= since])
    names = {"left_motor.speed": 0, "right_motor.speed": 1, "feeder.lead.x": 4, "feeder.sheet.skew": 5}
    found = np.where(times >= when, skew, 0.0)
    return {"time": times, "controller.skew": found, **{name: values[i] for name, i in names.items()}}


# ---- the FMUs and the loop ------------------------------------------------------------------------------------------


def build(folder: Path, model: Feeder = MODEL) -> Fmus:
    """Write three FMUs and return those of the four elements."""
    motor = build_slave(RollerMotor, folder / "motor.fmu")
    return {
        "controller": build_slave(SkewController, folder / "controller.fmu"),
        "left_motor": motor,
        "right_motor": motor,
        "feeder": export(model, folder / "feeder.fmu", native=False),
    }


def co_simulate(fmus: Fmus, step: float, *, on: bool = True, jacobi: bool = False, zeros: bool = False) -> Run:
    """Couple the FMUs.

    Parameters
    ----------
    fmus
        Of the elements.
    step
        Between communication points, s.
    on
        Whether the controller corrects what it finds.
    jacobi
        Step all FMUs with the values of the last point; without it one after the other, with those of now.
    zeros
        Begin with zero on every connection, as FMPy does.
    """
    times = communication_points(STOP_TIME, step)
    groups = [tuple(fmus)] if jacobi else [(name,) for name in fmus]
    system = replace(SYSTEM, values={**SYSTEM.values, "controller.on": on})
    with ExitStack() as stack:
        elements = {name: stack.enter_context(Fmu(path, system.values_of(name))) for name, path in fmus.items()}
        rows = [[elements[name][output] for name, output in SYSTEM.recorded]]
        for t in times[1:]:
            for group in groups:
                connections = [c for c in SYSTEM.connections if c[2] in group]
                given = [0.0 if zeros and t == times[1] else elements[a][output] for a, output, *_ in connections]
                for (*_, end, variable), value in zip(connections, given, strict=True):
                    elements[end][variable] = value
                for name in group:
                    elements[name].step_to(t)
            rows.append([elements[name][output] for name, output in SYSTEM.recorded])
    return SYSTEM.run(times, rows)


# ---- the study and the picture --------------------------------------------------------------------------------------


def study(methods: Mapping[str, Callable[[float], Run]]) -> None:
    """Run every method at every step of STEPS, and print the skew that it finds and leaves, and that of kinematics."""
    expected = kinematics(np.array([0.0, STOP_TIME]))
    lines = [("kinematics", "", *(f"{1e3 * expected[name][-1]:.3f}" for name in ("controller.skew", SKEW)), "")]
    for label, method in methods.items():
        for step in STEPS:
            run = method(step)
            off = np.abs(run[SKEW] - kinematics(run["time"])[SKEW]).max()
            told = [f"{1e3 * value:.3f}" for value in (run["controller.skew"][-1], run[SKEW][-1], off)]
            lines.append((label, f"{1e3 * step:g}", *told))
    header = ("coupling", "step [ms]", "found [mrad]", f"skew at {STOP_TIME:g} s [mrad]", "largest difference [mrad]")
    print(format_table(header, lines))


def draw(runs: Mapping[str, Run], path: Path) -> None:
    """Draw the skew with the controller off and on over kinematics, and the speeds that take it away."""
    figure, (skews, speeds) = plt.subplots(2, 1, figsize=(8.0, 6.0), sharex=True, layout="constrained")
    colors = {"controller off": "#ff725c", "controller on": "#4269d0", "controller on, .ssp in FMPy": "#6cc5b0"}
    for label, run in runs.items():
        style = "--" if ".ssp" in label else "-"
        skews.plot(1e3 * run["time"], 1e3 * run[SKEW], style, color=colors[label], lw=1.4, label=label)
    times = np.linspace(0.0, STOP_TIME, 401)
    for on, label in ((True, "kinematics"), (False, "_")):
        skews.plot(1e3 * times, 1e3 * kinematics(times, on=on)[SKEW], ":", color="black", lw=1.0, label=label)
    for side, color in (("left", "#efb118"), ("right", "#9c6b4e")):
        run = runs["controller on"]
        speeds.plot(1e3 * run["time"], run[f"{side}_motor.speed"], color=color, lw=1.4, label=f"{side} roller")
    skews.set(ylabel="skew of the leading edge [mrad]", title="The left roller is 2 % slow, and the sheet turns")
    speeds.set(xlabel="time [ms]", ylabel="speed, controller on [rad/s]")
    for ax in (skews, speeds):
        ax.margins(x=0.0, y=0.08)
        ax.grid(alpha=0.3)
        ax.legend(fontsize=9)
    finish(figure, path)


def main() -> None:
    """Build, couple, compare, draw."""
    parser = argparse.ArgumentParser(description="A feeder, two motors and a controller of skew in one co-simulation.")
    parser.add_argument("-o", "--output", type=Path, default=Path("results"), metavar="FOLDER")
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)

    fmus = build(folder)
    ssp = SYSTEM.write(folder / "feeder_motor.ssp", fmus, STOP_TIME)
    methods: dict[str, Callable[[float], Run]] = {
        "Gauss-Seidel": lambda step: co_simulate(fmus, step),
        "Jacobi": lambda step: co_simulate(fmus, step, jacobi=True),
        ".ssp in FMPy (Jacobi)": lambda step: SYSTEM.run_in_fmpy(ssp, STOP_TIME, step),
    }
    if find_spec("libcosimpy"):
        methods[".ssp in libcosim (Jacobi)"] = lambda step: SYSTEM.run_in_libcosim(ssp, STOP_TIME, step)
    else:
        print("libcosimpy is not installed (pip install libcosimpy): the .ssp runs in FMPy alone")
    study(methods)
    off = co_simulate(fmus, STEP, on=False)
    expected = kinematics(off["time"], on=False)
    later = off["time"] >= 0.1  # s; the motors have settled
    rates = [np.polyfit(run["time"][later], run[SKEW][later], 1)[0] for run in (off, expected)]
    print(
        f"controller off: turns at {rates[0]:.5f} rad/s, by {1e3 * off[SKEW][-1]:.2f} mrad; kinematics {rates[1]:.5f}"
    )
    in_fmpy = SYSTEM.run_in_fmpy(ssp, STOP_TIME, STEP)
    runs = {"controller off": off, "controller on": co_simulate(fmus, STEP), "controller on, .ssp in FMPy": in_fmpy}
    draw(runs, folder / "feeder_motor.png")
    print(f"written: {', '.join(str(p) for p in (*dict.fromkeys(fmus.values()), ssp, folder / 'feeder_motor.png'))}")


if __name__ == "__main__":
    main()
