"""An engine and its governor, two FMUs in one co-simulation: ``python examples/governed_engine.py [-o FOLDER]``.

The engine (``throttled_engine.py``, plain PythonFMU) turns the spindle of the governor (``fmus/governor``, mbfmu) by an
elastic shaft; the collar of the governor moves the engine's throttle. At 1 s the load steps from 10 to 25 N.m: the
engine slows down, the governor's arms and collar sink, the throttle opens, and the speed settles a little lower.

Where it settles follows from statics (:func:`settled`), and the way there from one differential equation for the whole
system (:func:`one_equation`). The co-simulation is given neither, so both are a test of it.

Writes both FMUs, ``governed_engine.ssp`` and ``governed_engine.png`` into the folder and prints a table of errors.
:func:`co_simulate` is the loop to copy; ``docs/cosimulation.md`` explains the whole.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from math import cos, log2, sin, sqrt
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from described_slave import build_slave
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from ssp_system import Run, SspSystem
from throttled_engine import ThrottledEngine

from fmus.governor import Governor
from mbfmu.fmi import Fmu, export
from mbfmu.plotting.figures import finish
from mbfmu.session.run import communication_points
from mbfmu.session.simulation import Settings
from mbfmu.util.text_table import format_table

Array = NDArray[np.float64]

STOP_TIME = 6.0  # s
STEP = 1e-3  # s, between communication points
STEPS = (8e-3, 4e-3, 2e-3, 1e-3, 0.5e-3)  # of the study

CONNECTIONS = (  # element and output -> element and input
    ("governor", "spindle.angle", "engine", "spindle_angle"),
    ("governor", "spindle.speed", "engine", "spindle_speed"),
    ("governor", "collar.height", "engine", "collar_height"),
    ("engine", "shaft_torque", "governor", "spindle.torque"),
)
RECORDED = (
    ("engine", "speed"),
    ("engine", "throttle"),
    ("engine", "load"),
    ("governor", "spindle.speed"),
    ("governor", "collar.height"),
)
SYSTEM = SspSystem(name="governed_engine", connections=CONNECTIONS, recorded=RECORDED)
SPEEDS = ("engine.speed", "governor.spindle.speed")

ENGINE = ThrottledEngine(instance_name="engine")  # for its numbers and laws; the co-simulation runs the FMU
GOVERNOR = Governor(driven=False, spindle_inertia=1.0, ball_inertia=1e-3, collar_inertia=1e-3, damping=150.0)


# ---- what must come out ---------------------------------------------------------------------------------------------


class Settled(NamedTuple):
    """A steady state: height of the collar (m), arms below the horizontal (rad), speed (rad/s)."""

    height: float
    angle: float
    speed: float


def settled(load: float) -> Settled:
    """Return the steady state under ``load`` (N.m).

    The throttle balances the load, which gives the height; the height gives the angle of the arms; and at that angle
    the centrifugal force of the balls balances gravity and spring (V' = 0, see :mod:`fmus.governor.model`).
    """
    e, g = ENGINE, GOVERNOR
    height = e.closed_height - load / e.max_torque * (e.closed_height - e.open_height)
    distance = g.pivot_height - height
    angle = brentq(lambda x: g.below_pivot(x) - distance, 0.1, 1.5, xtol=1e-15)
    spring = g.stiffness * (distance - g.free_length)
    moment = 2.0 * g.ball_mass * g.gravity * g.arm_length * cos(angle)
    moment += (g.collar_mass * g.gravity - spring) * lever(angle)
    return Settled(height, angle, sqrt(moment / (2.0 * g.ball_mass * g.arm_length**2 * sin(angle) * cos(angle))))


def lever(angle: float) -> float:
    """Return how far the collar sinks for a turn of the arms, ds/dphi, m/rad."""
    pin, distance = GOVERNOR.rod_position, GOVERNOR.below_pivot(angle)
    return pin * cos(angle) * distance / (distance - pin * sin(angle))


def one_equation(times: Array) -> Run:
    """Return the speeds at ``times`` (s) from one differential equation, good to some 1e-9.

    Flywheel and spindle by their angular momentum, the arms by Lagrange's equation in their angle.
    """
    e, g = ENGINE, GOVERNOR
    pin, balls = g.rod_position, 2.0 * g.ball_mass * g.arm_length**2

    def rates(_: float, y: Array, load: float) -> list[float]:
        twist, flywheel, spindle, angle, rate = y
        c, s, distance, fall = cos(angle), sin(angle), g.below_pivot(angle), lever(angle)
        root = distance - pin * s
        bend = -pin * s + pin**2 * cos(2.0 * angle) / root - (pin**2 * c * s) ** 2 / root**3  # d lever / dphi
        collar = g.collar_mass * (g.gravity - bend * rate**2)  # forces on the collar, downward
        collar -= g.stiffness * (distance - g.free_length) + g.damping * fall * rate
        moment = 2.0 * g.ball_mass * g.gravity * g.arm_length * c - balls * spindle**2 * s * c + collar * fall
        about_pivot = balls + 2.0 * g.ball_inertia + g.collar_mass * fall**2
        about_spindle = g.spindle_inertia + g.collar_inertia + 2.0 * g.ball_inertia + balls * c**2
        torque = e.torque_of_shaft(twist, flywheel - spindle)
        return [
            flywheel - spindle,
            e.acceleration(e.throttle_at(g.pivot_height - distance), load, torque),
            (torque + 2.0 * balls * s * c * rate * spindle) / about_spindle,
            rate,
            moment / about_pivot,
        ]

    def solve(begin: float, end: float, y: list[float], load: float) -> Callable[[Array], Array]:
        return solve_ivp(rates, (begin, end), y, "DOP853", dense_output=True, args=(load,), rtol=1e-11, atol=1e-12).sol  # type: ignore[no-any-return]

    start, step = settled(e.load_before), np.array(e.load_time)
    before = solve(0.0, e.load_time, [0.0, e.start_speed, start.speed, start.angle, 0.0], e.load_before)
    after = solve(e.load_time, float(times[-1]), before(step).tolist(), e.load_after)
    y = np.where(times < step, before(np.minimum(times, step)), after(np.maximum(times, step)))
    return {"time": times, "engine.speed": y[1], "governor.spindle.speed": y[2]}


# ---- the FMUs and the loop ------------------------------------------------------------------------------------------


class Fmus(NamedTuple):
    """The files of the two FMUs."""

    engine: Path
    governor: Path


def build(folder: Path) -> Fmus:
    """Write both FMUs; their start values are those of this example, so that no host has to set any."""
    start = settled(ENGINE.load_before)
    model = replace(GOVERNOR, start_angle=start.angle, spindle_speed=start.speed)
    governor = export(model, folder / "governor.fmu", Settings(solver="adams", tolerance=1e-9))
    engine = build_slave(ThrottledEngine, folder / "engine.fmu")
    return Fmus(engine, governor)


def co_simulate(fmus: Fmus, step: float, *, second_order: bool = False) -> Run:
    """Couple the FMUs in Gauss and Seidel's way: the engine steps first, the governor with what the engine then gives.

    Parameters
    ----------
    fmus
        The two FMUs.
    step
        Between communication points, s.
    second_order
        Give the engine the speed and the height expected in the middle of its step, from the last two points; without
        it the engine uses the last ones, and the coupling is of first order.
    """
    times = communication_points(STOP_TIME, step)
    with Fmu(fmus.governor) as governor, Fmu(fmus.engine, {"collar_height": governor["collar.height"]}) as engine:
        rows = [record(engine, governor)]
        last = now = speed_and_height(governor)
        for t in times[1:]:
            engine["spindle_angle"] = governor["spindle.angle"]
            engine["spindle_speed"], engine["collar_height"] = now + 0.5 * (now - last) if second_order else now
            engine.step_to(t)
            governor["spindle.torque"] = engine["shaft_torque"]
            governor.step_to(t)
            last, now = now, speed_and_height(governor)
            rows.append(record(engine, governor))
    return SYSTEM.run(times, rows)


def speed_and_height(governor: Fmu) -> Array:
    """Return what the engine holds during its step."""
    return np.array([governor["spindle.speed"], governor["collar.height"]])


def record(engine: Fmu, governor: Fmu) -> list[float]:
    """Return what RECORDED names, now."""
    elements = {"engine": engine, "governor": governor}
    return [elements[element][name] for element, name in RECORDED]


# ---- the study and the picture --------------------------------------------------------------------------------------


def error(run: Run) -> float:
    """Return the largest error of a speed after the load's step, rad/s."""
    exact, after = one_equation(run["time"]), run["time"] >= ENGINE.load_time
    return float(max(np.abs(run[name] - exact[name])[after].max() for name in SPEEDS))


def study(methods: dict[str, Callable[[float], Run]]) -> dict[str, list[float]]:
    """Run every method at every step of STEPS, print errors and orders, and return the errors."""
    goal = settled(ENGINE.load_after).speed
    errors: dict[str, list[float]] = {}
    lines = []
    for label, method in methods.items():
        own = errors[label] = []
        for step in STEPS:
            run = method(step)
            own.append(error(run))
            order = f"{log2(own[-2] / own[-1]):.2f}" if len(own) > 1 else ""
            last = run["engine.speed"][-1]
            lines.append((label, f"{1e3 * step:g}", f"{own[-1]:.1e}", order, f"{last:.7f}", f"{last - goal:+.0e}"))
    header = ("coupling", "step [ms]", "error [rad/s]", "order", f"speed at {STOP_TIME:g} s", "less derived")
    print(format_table(header, lines))
    return errors


def draw(run: Run, errors: dict[str, list[float]], path: Path) -> None:
    """Draw the load's step and how it is caught, and next to it the study."""
    figure = plt.figure(figsize=(12.0, 6.5), layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=(1.2, 1.0))
    left = [figure.add_subplot(grid[i, 0]) for i in range(3)]
    panels = {
        "speed [rad/s]": {"governor": run["governor.spindle.speed"], "engine": run["engine.speed"]},
        "torque [N m]": {"load": run["engine.load"], "engine": ENGINE.max_torque * run["engine.throttle"]},
        "height [mm]": {"collar": 1e3 * run["governor.collar.height"]},
    }
    colors = {"governor": "#efb118", "collar": "#efb118", "engine": "#4269d0", "load": "#ff725c"}
    for ax, (label, curves) in zip(left, panels.items(), strict=True):
        for name, values in curves.items():
            ax.plot(run["time"], values, color=colors[name], lw=1.4, label=name)
        ax.set_ylabel(label)
        ax.margins(x=0.0, y=0.12)
        ax.grid(alpha=0.3)
        ax.legend(loc="right", ncols=2, fontsize=9)
    for load, beside in ((ENGINE.load_before, 1.4), (ENGINE.load_after, 3.1)):
        state = settled(load)
        for ax, value, text in (
            (left[0], state.speed, f"statics: {state.speed:.4f} rad/s"),
            (left[2], 1e3 * state.height, f"statics: {1e3 * state.height:.3f} mm"),
        ):
            ax.axhline(value, color="black", lw=0.8, ls=":")
            ax.annotate(text, (beside, value), (0, -4), textcoords="offset points", va="top", fontsize=9)
    left[0].set_title("The load steps at 1 s, and the governor catches the engine")
    left[2].set_xlabel("time [s]")

    study_panel = figure.add_subplot(grid[:, 1])
    steps = [1e3 * step for step in STEPS]
    for (label, own), style in zip(errors.items(), ("o-", "s-", "x--", "+:"), strict=False):
        study_panel.loglog(steps, own, style, ms=7, mfc="none", label=f"{label}: order {log2(own[-2] / own[-1]):.1f}")
    study_panel.set_xticks(steps, [f"{step:g}" for step in steps])
    study_panel.minorticks_off()
    study_panel.set_xlabel("communication step [ms]")
    study_panel.set_ylabel("largest error of a speed after the load's step [rad/s]")
    study_panel.set_title("Error against the whole system in one equation")
    study_panel.grid(alpha=0.3)
    study_panel.legend()
    finish(figure, path)


def main() -> None:
    """Build, couple, compare, draw."""
    parser = argparse.ArgumentParser(description="An engine and its governor, two FMUs in one co-simulation.")
    parser.add_argument("-o", "--output", type=Path, default=Path("results"), metavar="FOLDER")
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)

    fmus = build(folder)
    ssp = SYSTEM.write(folder / "governed_engine.ssp", fmus._asdict(), STOP_TIME)
    methods: dict[str, Callable[[float], Run]] = {
        "Gauss-Seidel": lambda step: co_simulate(fmus, step),
        "Gauss-Seidel, extrapolated": lambda step: co_simulate(fmus, step, second_order=True),
        ".ssp in FMPy (Jacobi)": lambda step: SYSTEM.run_in_fmpy(ssp, STOP_TIME, step),
    }
    if find_spec("libcosimpy"):
        methods[".ssp in libcosim (Jacobi)"] = lambda step: SYSTEM.run_in_libcosim(ssp, STOP_TIME, step)
    else:
        print("libcosimpy is not installed (pip install libcosimpy): the .ssp runs in FMPy alone")
    print(f"derived: {settled(ENGINE.load_before)}, then {settled(ENGINE.load_after)}")
    errors = study(methods)
    draw(co_simulate(fmus, STEP), errors, folder / "governed_engine.png")
    print(f"written: {', '.join(str(p) for p in (*fmus, ssp, folder / 'governed_engine.png'))}")


if __name__ == "__main__":
    main()
