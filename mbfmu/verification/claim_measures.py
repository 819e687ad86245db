"""Measures of numbers that the documentation states: functions of few arguments, which return one number in seconds."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import atan, cos, sin
from typing import Any

import numpy as np

from mbfmu.mechanics import FlexibleBody, Mechanism, Revolute, Weld, rod
from mbfmu.modeling.registry import find
from mbfmu.modeling.scene import load_scene
from mbfmu.session.run import simulate
from mbfmu.session.simulation import Simulation
from mbfmu.sheets import Wall, add_contact, add_sheet
from mbfmu.steady.equilibrium import modes
from mbfmu.studies.compare import Row, compare
from mbfmu.util.errors import UserError
from mbfmu.util.extras import import_optional

from .mechanisms.case import G
from .mechanisms.planar import n_four_bar
from .references import integrated
from .suite import select
from .verdict import check

TABLE_TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)  # of the tables of errors and computing times
TABLE_SOLVERS = ("adams", "hybrid", "radau", "ida")


# ---- four-bar that passes its singular configuration -----------------------------------------------------------------


@cache
def _four_bar_angle(solver: str) -> tuple[Any, Any, Any]:
    """Return times, s, the simulated angle of the crank and the exact one, rad, until the run ends."""
    model = find("fourbar")()
    result = simulate(model, 10.0, interval=1e-3, solver=solver, tolerance=1e-8)
    exact = model.exact(result.t)
    assert exact is not None
    return result.t, result["crank.angle"], exact["crank.angle"]


def _count_passages(angle: Any) -> int:
    """Return how often an angle passes a multiple of pi."""
    return int(np.count_nonzero(np.diff(np.floor(angle / np.pi))))


def passages_of_four_bar() -> float:
    """Return how often the simulated four-bar passes its singular configuration in 10 s."""
    return _count_passages(_four_bar_angle("adams")[1])


def passages_before_adams_lu_fails() -> float:
    """Return how often `adams-lu` passes the singular configuration before it stops or leaves the exact motion."""
    _, angle, exact = _four_bar_angle("adams-lu")
    wrong = np.flatnonzero(np.abs(angle - exact) > 0.1)
    return _count_passages(exact[: wrong[0] if len(wrong) else len(exact)])


# ---- errors and computing times of the included models ---------------------------------------------------------------


@cache
def _comparison(scene: str) -> dict[tuple[str, float], Row]:
    """Return the runs of a scene by solver and tolerance, timed in interleaved rounds."""
    found = compare(load_scene(scene), solvers=TABLE_SOLVERS, tolerances=TABLE_TOLERANCES)
    return {(row.solver, row.rtol): row for row in found.rows}


def _row(scene: str, solver: str, tolerance: float) -> Row:
    """Return a run; raises UserError if it is not among those of the comparison."""
    rows = _comparison(scene)
    if (solver, tolerance) not in rows:
        raise UserError(f"the comparison of {scene!r} has no run of {solver!r} at a tolerance of {tolerance:g}")
    return rows[solver, tolerance]


def relative_error(scene: str, solver: str, tolerance: float) -> float:
    """Return the largest error of an output of a scene divided by its range; infinite if the run does not end."""
    error = _row(scene, solver, tolerance).error
    return np.inf if error is None else error


def steps(scene: str, solver: str, tolerance: float) -> float:
    """Return the number of steps of a run."""
    return float(_row(scene, solver, tolerance).steps or 0)


def cpu_time_ratio(scene: str, solver: str, tolerance: float, other: str, other_tolerance: float) -> float:
    """Return the computing time of a run divided by that of another one; both are measured in turn."""
    return _row(scene, solver, tolerance).cpu_s / _row(scene, other, other_tolerance).cpu_s


def error_in_suite(problem: str, solver: str, tolerance: float) -> float:
    """Return the error of a problem of the suite where it is largest by the allowed one; infinite if there is none."""
    (found,) = select([problem])
    (line,) = check(found, [solver], [tolerance])
    return np.inf if line.error is None else line.error


# ---- solvers ---------------------------------------------------------------------------------------------------------


@cache
def error_of_pendulum_by_tolerance(solver: str) -> float:
    """Return the largest error of a pendulum in 100 periods by the tolerance, for tolerances of 1e-6 and 1e-8."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    body = m.body("rod", m.ground, Revolute(start=-1.0, fixed=True), **rod(mass=1.0, length=1.0))
    m.output("angle", body.angle(), "Angle of the rod")

    def right(_: float, y: Any) -> Any:
        return y[1], -1.5 * G * np.cos(y[0])

    stop_time = 100.0 * 1.65  # s; the period is 1.65 s at 0.57 rad from the vertical
    exact = integrated(right, (-1.0, 0.0), (1.0, 4.0), lambda _, y: (y[0],), stop_time)
    ratios = []
    for tolerance in (1e-6, 1e-8):
        result = simulate(m, stop_time, interval=0.05, solver=solver, tolerance=tolerance)
        ratios.append(np.abs(result["angle"] - exact.solution(np.array(exact.start), result.t)[:, 0]).max() / tolerance)
    return float(max(ratios))


def least_tolerance(solver: str, loops: int) -> float:
    """Return the tolerance that a run of a row of four-bars uses if 1e-12 is given; without loops, of a chain."""
    if loops:
        mechanism = n_four_bar(int(loops)).mechanism
    else:
        mechanism = Mechanism(gravity=(0.0, -G, 0.0))
        parent = mechanism.ground
        for k in range(70):
            at = (0.1 if k else 0.0, 0.0, 0.0)
            parent = mechanism.body(f"rod{k}", parent, Revolute(at=at), **rod(mass=0.1, length=0.1))
    found: list[float] = []

    def watch(simulation: Simulation) -> None:
        found.append(max(simulation.stepper.min_rtol, 1e-12))

    simulate(mechanism, 0.01, interval=0.01, solver=solver, tolerance=1e-12, watch=watch)
    return found[-1]


# ---- sheets and flexible bodies --------------------------------------------------------------------------------------


@cache
def creep_of_resting_sheet(creep: float) -> float:
    """Return how far, m, a strip of paper on a slope at 0.7 of its largest friction force creeps from 1 to 10 s."""
    return _drift_on_slope(creep, None)


def creep_of_sticking_sheet(deflection: float) -> float:
    """Return the same with friction that sticks."""
    return _drift_on_slope(1e-3, deflection)


def _drift_on_slope(creep: float, deflection: float | None) -> float:
    friction, share = 0.3, 0.7
    slope = atan(share * friction)
    m = Mechanism(gravity=(G * sin(slope), -G * cos(slope), 0.0))
    strip = add_sheet(
        m,
        "strip",
        length=0.3,
        width=0.05,
        thickness=1e-4,
        youngs_modulus=4e9,
        density=800.0,
        grid=(9, 3),
        tree="master",
        membrane=True,
        damping=5e-4,
    )
    table = Wall(at=(0.0, -5e-5, 0.0))
    add_contact(m, "table", strip, table, friction=friction, creep=creep, deflection=deflection)
    m.output("x", strip.node(4, 1).position("x"))
    result = simulate(m, 10.0, interval=1.0, solver="esdirk", tolerance=1e-4)
    return float(result["x"][-1] - result["x"][1])


def frequency_error_of_clamped_bar(cells: int) -> float:
    """Return by how much, in percent, the first bending frequency of a bar of quadratic hexahedra is too high."""
    skfem, mesh_io = import_optional("skfem", "fe"), import_optional("skfem.io.meshio", "fe")
    length, side, young, density = 3.0, 0.03, 2e11, 7800.0
    across = np.linspace(-0.5 * side, 0.5 * side, 2)
    mesh = mesh_io.to_meshio(skfem.MeshHex.init_tensor(np.linspace(0.0, length, int(cells) + 1), across, across))
    ends = {"root": lambda x: x[:, 0] < 1e-9}
    body = FlexibleBody.from_mesh(mesh, density, young, 0.3, ends, modes=4)
    m = Mechanism()
    m.flexible_body("bar", m.ground, Weld(), body)
    inertia = young * side**4 / 12.0 / (density * side**2 * length**4)
    exact = 1.8751040687**2 * np.sqrt(inertia)  # rad/s: beam of Euler and Bernoulli, clamped and free
    return float(100.0 * (modes(m, 2)[0].mode.frequency / exact - 1.0))


MEASURES: dict[str, Callable[..., float]] = {
    f.__name__: f
    for f in (
        passages_of_four_bar,
        passages_before_adams_lu_fails,
        relative_error,
        steps,
        cpu_time_ratio,
        error_in_suite,
        error_of_pendulum_by_tolerance,
        least_tolerance,
        creep_of_resting_sheet,
        creep_of_sticking_sheet,
        frequency_error_of_clamped_bar,
    )
}
