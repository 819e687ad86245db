"""What implicit steps cost: ``python benchmarks/implicit.py``. CPU time, medians, compile time apart, runs in turn.

* ``ida`` at tolerance 1e-6 against ``adams`` at ida's error, and against ida by way of scikit-sundae;
* the four-bar under a torque that is set every millisecond;
* Andrews' squeezer, against the state of the IVP test set after 0.03 s; with the extra ``bench`` CasADi's IDAS on the
  same bodies, constraints at the level of accelerations.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from math import sin
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from explicit import Swing, exact_motion, loosest
from timing import median_times

from fmus.fourbar import FourBar
from mbfmu.mechanics import CompiledMechanism
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.util.text_table import format_table
from solvers.steppers.ida import dense

sys.path.append(str(Path(__file__).parents[1] / "tests" / "loops"))
from mechanisms import SQUEEZER_END, squeezer

END = 0.03  # s, of the squeezer
STEPS = 1000  # of a millisecond
TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8)


def against_adams() -> None:
    """Print ida's time in units of adams' at equal error, and in units of ida by way of scikit-sundae."""
    model = FourBar()
    exact = exact_motion(model)
    ida = Swing(model, "ida", 1e-6)
    error = ida.error(exact)
    adams, own = loosest(model, "adams", error, exact)
    with patch.object(dense, "is_library_supported", lambda: False):
        bound = Swing(model, "ida", 1e-6)
    i, a, b = median_times(ida.run, adams.run, bound.run)
    print(
        f"four-bar, ida at 1e-6: error {error:.1e} rad, {1e3 * i:.2f} ms; adams at {own:.1e} rad, {1e3 * a:.2f} ms; "
        f"ratio {i / a:.1f} (at most 12); by way of scikit-sundae {1e3 * b:.1f} ms\n"
    )


def under_changing_torque() -> None:
    """Print what a millisecond costs where the torque is set at its beginning."""

    def run(simulation: Simulation, fresh: bytes) -> Callable[[], None]:
        def steps() -> None:
            simulation.stepper.restore(fresh)
            for k in range(STEPS):
                simulation.set_input("crank.torque", sin(0.02 * k))
                assert simulation.advance(1e-3 * (k + 1)).ok

        return steps

    names = "radau", "adams", "ida"
    runs = []
    for name in names:
        simulation = Simulation(FourBar(), Settings(solver=name))
        runs.append(run(simulation, simulation.stepper.save()))
    times = median_times(*runs, repeats=5)
    told = ", ".join(f"{name} {1e6 * t / STEPS:.0f} us" for name, t in zip(names, times, strict=True))
    print(f"four-bar, torque set each ms, a step with Python around it: {told} (at most 30)\n")


def on_the_squeezer() -> None:
    """Print times and errors of Andrews' squeezer."""
    runs: list[tuple[str, float, Callable[[], Any]]] = []
    for solver in ("radau", "ida", "adams"):
        for tolerance in TOLERANCES:
            runs.append((solver, tolerance, _ours(solver, tolerance)))
    try:
        import casadi  # noqa: F401
    except ImportError:
        print("CasADi is not installed: pip install '.[bench]'")
    else:
        runs += [("CasADi IDAS", tolerance, _casadi(tolerance)) for tolerance in TOLERANCES]
    times = median_times(*(run for *_, run in runs), repeats=5)
    lines = [
        (solver, f"{tolerance:.0e}", f"{1e3 * t:.2f}", f"{np.abs(run() - np.array(SQUEEZER_END)).max():.1e}")
        for (solver, tolerance, run), t in zip(runs, times, strict=True)
    ]
    print(format_table(("solver", "rtol", "time [ms]", "error at the end [rad]"), lines))


def _ours(solver: str, tolerance: float) -> Callable[[], Any]:
    simulation = Simulation(squeezer().mechanism, Settings(solver=solver, tolerance=tolerance))
    fresh = simulation.stepper.save()

    def run() -> Any:
        simulation.stepper.restore(fresh)
        assert simulation.advance(END).ok
        return simulation.stepper.q

    return run


def _casadi(tolerance: float) -> Callable[[], Any]:
    """Return a run of CasADi's IDAS: q' = v, v' and lambda from M v' + h + J^T lambda = 0, J v' = gamma."""
    import casadi as ca

    mechanism = squeezer().mechanism
    compiled = CompiledMechanism(mechanism)
    q0, v0 = compiled.assemble()
    q, v, a = ca.SX.sym("q", 7), ca.SX.sym("v", 7), ca.SX.sym("a", 7)
    lam = ca.SX.sym("lam", 6)

    def turned(angle: Any, x: float, y: float) -> Any:
        return ca.vertcat(ca.cos(angle) * x - ca.sin(angle) * y, ca.sin(angle) * x + ca.cos(angle) * y)

    A, B, C = (-0.06934, -0.00227), (-0.03635, 0.03273), (0.014, 0.072)
    on = {"K1": None, "K2": ("K1", (0.007, 0.0)), "K3": B, "K5": A, "K4": ("K5", (0.04, 0.0)), "K7": A}
    on["K6"] = ("K7", (0.0, -0.04))
    about = {
        "K1": (0.04325, 2.194e-6, (0.00092, 0.0)), "K2": (0.00365, 4.410e-7, (-0.0115, 0.0)),
        "K3": (0.02373, 5.255e-6, (0.01043, -0.01874)), "K5": (0.07050, 1.169e-5, (0.02308, 0.00916)),
        "K4": (0.00706, 5.667e-7, (0.0, -0.00579)), "K7": (0.05498, 1.912e-5, (-0.00449, -0.01228)),
        "K6": (0.00706, 5.667e-7, (0.00579, 0.0)),
    }  # fmt: skip
    place: dict[str, tuple[Any, Any]] = {}
    T = 0
    for k, (name, parent) in enumerate(on.items()):
        if parent is not None and isinstance(parent[0], str):
            origin, angle = place[parent[0]]
            origin, angle = origin + turned(angle, *parent[1]), angle + q[k]
        else:
            origin, angle = ca.vertcat(*(parent or (0.0, 0.0))), q[k]
        place[name] = origin, angle
        mass, inertia, com = about[name]
        speed = ca.jtimes(origin + turned(angle, *com), q, v)
        T += 0.5 * mass * ca.dot(speed, speed) + 0.5 * inertia * ca.jtimes(angle, q, v) ** 2

    def point(name: str, x: float, y: float) -> Any:
        origin, angle = place[name]
        return origin + turned(angle, x, y)

    stretch = ca.norm_2(point("K3", 0.02, -0.018) - ca.vertcat(*C)) - 0.07785
    tip = point("K2", -0.028, 0.0)
    Phi = ca.vertcat(point("K3", 0.0, -0.035) - tip, point("K4", 0.0, -0.02) - tip, point("K6", 0.02, 0.0) - tip)
    p = ca.gradient(T, v)
    force = ca.gradient(T, q) - ca.gradient(0.5 * 4530.0 * stretch**2, q)
    force[0] += 0.033
    J = ca.jacobian(Phi, q)
    balance = ca.jacobian(p, v) @ a + ca.jtimes(p, q, v) - force + J.T @ lam
    turn = ca.jtimes(ca.jtimes(Phi, q, v), q, v) + J @ a
    dae = {"x": ca.vertcat(q, v), "z": ca.vertcat(a, lam), "ode": ca.vertcat(v, a), "alg": ca.vertcat(balance, turn)}
    options = {"reltol": tolerance, "abstol": tolerance, "max_num_steps": 100_000}
    solve = ca.integrator("squeezer", "idas", dae, 0.0, END, options)
    first = ca.Function("first", [dae["z"], dae["x"]], [dae["alg"]])
    z0 = ca.rootfinder("start", "newton", first)(np.zeros(13), np.concatenate((q0, v0)))

    def run() -> Any:
        return np.asarray(solve(x0=np.concatenate((q0, v0)), z0=z0)["xf"]).ravel()[:7]

    return run


if __name__ == "__main__":
    against_adams()
    under_changing_torque()
    on_the_squeezer()
