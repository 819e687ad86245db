"""Signals, tables and laws: derivatives against differences, motions and energies against closed forms and SciPy."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import Akima1DInterpolator, CubicSpline, PchipInterpolator

from mbfmu import UserError, equilibrium, linearize, simulate
from mbfmu.mechanics import (
    CompiledMechanism,
    Function,
    Harmonic,
    Input,
    JointForce,
    JointSpring,
    Mechanism,
    Noise,
    PointForce,
    Polynomial,
    Product,
    Ramp,
    Revolute,
    RunUp,
    Spring,
    Step,
    Sum,
    Table,
    TorsionSpring,
    Translational,
    rod,
)
from mbfmu.mechanics.curve import next_point, rows
from mbfmu.mechanics.dispatch import signal as signal_at


def test_a_sum_of_drives_goes_from_rest_to_its_speed_again_though_parts_cancel() -> None:
    """As continuation in the drive's speed does, on the compiled mechanism and on its complex twin."""
    m, turn = Mechanism(), Polynomial
    for k, (a, b) in enumerate(((3.0, 2.0), (2.0, -2.0), (1.0, 0.0))):
        drive = Sum(turn((0.1, a)), Sum(turn((0.0, b)), turn((0.5, 0.25))))
        m.body(f"disk{k}", m.ground, Revolute(drive=drive), mass=1.0, inertia=(1, 1, 1))
    m.body("free", m.ground, Revolute(), mass=1.0, inertia=(1, 1, 1))
    compiled = CompiledMechanism(m)
    for signals in (compiled.signals(compiled.data), compiled.signals(compiled.complex_system().data)):
        speeds, full = compiled.drives.speeds(), compiled.drives.full_speeds()
        for part in (0.0, 0.5, 1.0):
            compiled.drives.run_at(part * full, signals)
        assert compiled.drives.speeds() == speeds
    assert [speed for _, speed, _ in speeds] == [5.25, 0.25, 1.25]


POINTS = np.array([0.0, 0.3, 0.5, 1.2, 2.0])
VALUES = np.array([0.0, 0.4, 0.1, 0.9, 1.0])


def driven(drive: Any) -> CompiledMechanism:
    """A wheel that follows a signal."""
    m = Mechanism()
    m.body("wheel", m.ground, Revolute(drive=drive), mass=1.0, inertia=(1.0, 1.0, 1.0))
    return CompiledMechanism(m)


SIGNALS: dict[str, Any] = {
    "polynomial": Polynomial((0.1, -0.4, 0.3, 0.2)),
    "harmonic": Harmonic(amplitude=0.3, frequency=1.5, phase=0.2, mean=0.1),
    "noise": Noise(density=lambda f: 1e-3 / (1.0 + f), lowest=0.2, highest=3.0, period=4.0, seed=3, mean=0.2),
    "run-up": RunUp(speed=2.0, duration=0.8, start=0.1),
    "step": Step(height=-1.5, begin=0.2, duration=1.1, offset=0.3),
    "spline": Table(POINTS, VALUES),
    "periodic": Table(POINTS, np.append(VALUES[:-1], VALUES[0]), beyond="periodic"),
    "held": Table(POINTS, VALUES, beyond="hold"),
    "sum": Sum(1.0, Harmonic(amplitude=0.3, frequency=1.5), Polynomial((0.0, 2.0))),
    "product": Product(Polynomial((0.0, 2.0)), Harmonic(amplitude=0.3, frequency=1.5), 3.0),
    "nested": Product(Sum(1.0, Step(height=1.0, duration=0.7)), Sum(0.5, Polynomial((0.1, 1.0, 1.0)))),
    "function": lambda t: np.sin(3.0 * t) * np.exp(-t),
    "expression": "sin(3*t)*exp(-t)",
    "told its time": Function("sin(3*t)*exp(-t)", time=0.3),
}


@pytest.mark.parametrize("name", SIGNALS)
def test_rates_are_derivatives_of_values(name: str) -> None:
    arrays, h = driven(SIGNALS[name]).kernel_data.arrays, 1e-4
    for t in (-0.35, 0.13, 0.4, 0.77, 1.05, 2.6):
        x, rate, second = (np.array([signal_at(0, t + k * h, arrays)[i] for k in (-2, -1, 0, 1, 2)]) for i in range(3))
        assert rate[2] == pytest.approx((x[0] - 8 * x[1] + 8 * x[3] - x[4]) / (12 * h), abs=1e-7)
        assert second[2] == pytest.approx((rate[0] - 8 * rate[1] + 8 * rate[3] - rate[4]) / (12 * h), abs=1e-5)


def test_values_are_those_of_closed_forms() -> None:
    for t in (-0.2, 0.35, 0.9, 1.7):
        expected = {
            "sum": 1.0 + 0.3 * np.sin(3.0 * pi * t) + 2.0 * t,
            "product": 2.0 * t * 0.3 * np.sin(3.0 * pi * t) * 3.0,
            "function": np.sin(3.0 * t) * np.exp(-t),
            "expression": np.sin(3.0 * t) * np.exp(-t),
        }
        for name, value in expected.items():
            assert signal_at(0, t, driven(SIGNALS[name]).kernel_data.arrays)[0] == pytest.approx(value, rel=1e-14)


def test_a_step_that_drives_has_risen_in_a_steady_state() -> None:
    """A pendulum on a slider that is moved for a second hangs still beyond it; a run starts before it."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    step = Step(height=0.7, begin=1.0, duration=1.0, offset=0.2)
    slider = m.body("slider", m.ground, Translational(axis="x", drive=step))
    bob = m.body("bob", slider, Revolute(start=-1.0), **rod(mass=1.0, length=1.0))
    m.output("x", bob.position("x"))
    m.output("angle", bob.angle())
    found = equilibrium(m)
    assert found.outputs["x"] == pytest.approx(0.9, abs=1e-12)
    assert found.outputs["angle"] == pytest.approx(-0.5 * pi, abs=1e-9)
    before = simulate(m, 1.0, start_at_equilibrium=True)
    np.testing.assert_allclose(before["x"], 0.2, atol=1e-12)
    np.testing.assert_allclose(before["angle"], -0.5 * pi, atol=1e-9)


def test_tables_are_those_of_scipy_and_straight_beyond_their_ends() -> None:
    natural, monotone = CubicSpline(POINTS, VALUES, bc_type="natural"), PchipInterpolator(POINTS, VALUES)
    kinds = {"spline": natural, "monotone": monotone}
    for kind, exact in kinds.items():
        arrays = driven(Table(POINTS, VALUES, kind)).kernel_data.arrays
        for t in np.linspace(0.0, 2.0, 23):
            assert signal_at(0, t, arrays)[0] == pytest.approx(float(exact(t)), abs=1e-14)
        for t, end in ((-0.5, 0.0), (2.7, 2.0)):
            line = float(exact(end) + (t - end) * exact(end, 1))
            x, rate, second = signal_at(0, t, arrays)
            assert (x, rate, second) == pytest.approx((line, float(exact(end, 1)), 0.0), abs=1e-13)


RETURNING = np.append(VALUES[:-1], VALUES[0])


def test_a_periodic_table_goes_round_for_ever() -> None:
    """A spline is SciPy's; the others are those of a table that repeats itself by hand, as far as they look."""
    turns = [POINTS[:-1] + 2.0 * k for k in range(-2, 3)]
    repeated, values = np.concatenate(turns), np.tile(VALUES[:-1], 5)
    known = {
        "spline": CubicSpline(POINTS, RETURNING, bc_type="periodic"),
        "monotone": PchipInterpolator(repeated, values),
        "akima": Akima1DInterpolator(repeated, values),
    }
    for kind, exact in known.items():
        arrays = driven(Table(POINTS, RETURNING, kind, beyond="periodic")).kernel_data.arrays
        for t in (-1e3, -2.0, -0.7, 0.0, 0.1, 0.3, 1.0, 1.9, 2.0, 3.7, 8.4):
            place = np.mod(t, 2.0)
            expected = [float(exact(place, order)) for order in range(3)]
            assert signal_at(0, t, arrays)[:2] == pytest.approx(expected[:2], abs=1e-10)
            if kind == "spline":
                assert signal_at(0, t, arrays)[2] == pytest.approx(expected[2], abs=1e-9)


def test_a_table_that_holds_comes_to_its_ends_without_slope() -> None:
    for kind in ("spline", "monotone", "linear"):
        m = Mechanism()
        slider = m.body("slider", m.ground, Translational(), mass=1.0)
        table = Table(POINTS, VALUES, kind, beyond="hold")
        m.force("push", JointForce(table), slider)
        arrays = CompiledMechanism(m).kernel_data.arrays
        for t, value in ((-3.0, 0.0), (-1e-9, 0.0), (0.3, 0.4), (0.5, 0.1), (2.0, 1.0), (2.1, 1.0), (50.0, 1.0)):
            found = signal_at(0, t, arrays)
            assert found[0] == pytest.approx(value, abs=1e-13)
            if not 0.0 <= t < 2.0:
                assert found[1:] == (0.0, 0.0)
        if table.drives:
            assert [signal_at(0, t, arrays)[1] for t in (1e-9, 2.0 - 1e-9)] == pytest.approx([0.0, 0.0], abs=1e-6)


def test_a_spring_with_a_periodic_table_keeps_its_energy_over_whole_turns() -> None:
    """Its mean torque, which does work in every turn, is in its potential too."""
    m = Mechanism()
    wheel = m.body("wheel", m.ground, Revolute(rate=6.0), inertia=(1.0, 1.0, 1.0))
    m.force("cogging", JointSpring(stiffness=Table(POINTS, RETURNING, beyond="periodic")), wheel)
    m.output("angle", wheel.angle())
    m.output("rate", wheel.rate())
    m.output("energy", m.energy)
    found = simulate(m, 3.0, solver="adams", tolerance=1e-9)
    assert found["angle"].max() > 6.0
    assert np.ptp(found["energy"]) < 1e-5
    integral = CubicSpline(POINTS, RETURNING, bc_type="periodic").antiderivative()
    turns, place = np.divmod(found["angle"], 2.0)
    stored = found["energy"] - 0.5 * found["rate"] ** 2
    np.testing.assert_allclose(stored, turns * integral(2.0) + integral(place), atol=1e-9)


LAW = {"function": lambda x: 3.0 * x + 20.0 * x**3, "expression": "3*x + 20*x**3"}


@pytest.mark.parametrize("solver", ["adams", "ida"])
@pytest.mark.parametrize("law", LAW)
def test_a_spring_with_a_function_moves_as_computed_by_scipy(law: str, solver: str) -> None:
    m = Mechanism()
    slider = m.body("slider", m.ground, Translational(axis="x", start=0.9), mass=2.0)
    other = m.body("other", m.ground, Translational(axis="x", at=(0, 1, 0), start=0.9), mass=2.0)
    wheel = m.body("wheel", m.ground, Revolute(start=0.9), inertia=(2.0, 2.0, 2.0))
    m.force("in joint", JointSpring(stiffness=LAW[law], free=0.1, damping=0.3), slider)
    m.force("between", Spring(stiffness=LAW[law], free=0.6, damping=0.3, at_b=(0, 1, 0)), other, m.ground)
    m.force("about", TorsionSpring(stiffness=LAW[law], free=0.1, damping=0.3), m.ground, wheel)
    for body in (slider, other, wheel):
        m.output(body.name, body.coordinate())
    result = simulate(m, 1.0, solver=solver, tolerance=1e-8)
    assert not result.failure
    assert not result.warning

    for name, free in (("slider", 0.1), ("other", 0.6), ("wheel", 0.1)):

        def rates(t: float, y: Any, free: float = free) -> list[float]:
            x = y[0] - free
            return [y[1], -(3.0 * x + 20.0 * x**3 + 0.3 * y[1]) / 2.0]

        exact = solve_ivp(rates, (0.0, 1.0), [0.9, 0.0], rtol=1e-11, atol=1e-12).y[0, -1]
        assert result[name][-1] == pytest.approx(exact, abs=2e-6)


def test_a_torsion_spring_with_a_table_stores_energy_and_a_function_has_a_slope() -> None:
    x = np.linspace(-2.0, 2.0, 9)
    for stiffness, stored in ((Table(x, 3.0 * x), 0.5 * 3.0 * 0.64), (lambda x: 3.0 * x, 0.0)):
        m = Mechanism()
        wheel = m.body("wheel", m.ground, Revolute(start=0.9), inertia=(2.0, 2.0, 2.0))
        m.force("about", TorsionSpring(stiffness=stiffness, free=0.1), m.ground, wheel)
        m.output("energy", m.energy)
        compiled = CompiledMechanism(m)
        assert compiled.energy(0.0, *compiled.assemble()) == pytest.approx(stored, rel=1e-9, abs=1e-12)
        np.testing.assert_allclose(np.abs(np.linalg.eigvals(linearize(m).A)), np.sqrt(1.5), rtol=1e-8)


@pytest.mark.parametrize("solver", ["adams", "ida"])
def test_a_spring_with_a_table_moves_as_computed_by_scipy_and_keeps_its_energy(solver: str) -> None:
    x, f = np.array([-1.0, -0.2, 0.0, 0.3, 1.0]), np.array([-30.0, -2.0, 0.0, 1.0, 40.0])
    force = CubicSpline(x, f, bc_type="natural")
    m = Mechanism()
    slider = m.body("slider", m.ground, Translational(axis="x", start=0.9), mass=2.0)
    other = m.body("other", m.ground, Translational(axis="x", at=(0, 1, 0), start=0.9), mass=2.0)
    m.force("in joint", JointSpring(stiffness=Table(x, f), free=0.1), slider)
    m.force("between", Spring(stiffness=Table(x, f), free=0.6, at_b=(0, 1, 0)), other, m.ground)
    m.output("slider", slider.coordinate())
    m.output("other", other.coordinate())
    m.output("energy", m.energy)
    found = simulate(m, 1.0, solver=solver, tolerance=1e-9)
    for name, start, free in (("slider", 0.9, 0.1), ("other", 0.9, 0.6)):

        def rates(t: float, y: Any, free: float = free) -> list[float]:
            return [y[1], -float(force(y[0] - free)) / 2.0]

        exact = solve_ivp(rates, (0.0, 1.0), [start, 0.0], rtol=1e-11, atol=1e-12).y[0, -1]
        assert found[name][-1] == pytest.approx(exact, abs=2e-7)
    stored = [float(force.antiderivative()(s) - force.antiderivative()(0.0)) for s in (0.8, 0.3)]
    assert found["energy"][0] == pytest.approx(sum(stored), rel=1e-12)
    assert np.ptp(found["energy"]) < 1e-6


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("law", [lambda t, q, v: -0.7 * v * abs(v), "-0.7 * v * abs(v)"])
def test_a_law_of_the_coordinate_brakes_as_its_closed_form(law: Any, size: float) -> None:
    """m v' = -c v |v|: v = v0 / (1 + c v0 t / m)."""
    m = Mechanism()
    slider = m.body("slider", m.ground, Translational(axis="x", rate=2.0 * size), mass=0.7 * size)
    m.force("brake", JointForce(law), slider)
    m.output("v", slider.rate())
    m.output("energy", m.energy)
    found = simulate(m, 1.0, tolerance=1e-9)
    exact = 2.0 * size / (1.0 + 2.0 * found.t)
    np.testing.assert_allclose(found["v"], exact, rtol=1e-7)


def test_steady_states_and_state_matrices_know_the_derivatives_of_a_law() -> None:
    m = Mechanism(gravity=(0.0, -10.0, 0.0))
    slider = m.body("slider", m.ground, Translational(axis="y", start=0.1), mass=2.0)
    m.force("spring", JointForce(lambda t, q, v: -40.0 * q * abs(q) - 3.0 * v), slider)
    m.output("y", slider.coordinate())
    assert equilibrium(m).positions()["slider"] == pytest.approx(-np.sqrt(0.5), rel=1e-9)
    m = Mechanism(gravity=(0.0, -10.0, 0.0))
    slider = m.body("slider", m.ground, Translational(axis="y", start=-0.5), mass=2.0)
    m.force("spring", JointForce("-40*q*abs(q) - 3*v"), slider)
    m.output("y", slider.coordinate())
    values = np.sort_complex(np.linalg.eigvals(linearize(m).A))
    expected = np.sort_complex(np.roots([2.0, 3.0, 80.0 * np.sqrt(0.5)]))
    np.testing.assert_allclose(values, expected, rtol=1e-7)


def test_a_large_tree_takes_laws_and_tables_in_its_tangent() -> None:
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    link = m.ground
    for i in range(70):
        link = m.body(f"link{i}", link, Revolute(at=(0.01 if i else 0, 0, 0)), **rod(mass=0.01, length=0.01))
        m.force(f"hinge{i}", JointForce(lambda t, q, v: -0.05 * q - 1e-4 * v), link)
        m.force(f"stop{i}", JointSpring(stiffness=Table([-1.0, 0.0, 1.0], [-0.1, 0.0, 0.1])), link)
    m.output("tip", link.position("y"))
    assert not CompiledMechanism(m).system.has_matrices
    other = Mechanism(gravity=(0.0, -9.81, 0.0))
    link = other.ground
    for i in range(70):
        link = other.body(f"link{i}", link, Revolute(at=(0.01 if i else 0, 0, 0)), **rod(mass=0.01, length=0.01))
        other.force(f"hinge{i}", JointSpring(stiffness=0.15, damping=1e-4), link)
    other.output("tip", link.position("y"))
    ends = [simulate(made, 0.1, solver="ida", tolerance=1e-7)["tip"][-1] for made in (m, other)]
    assert ends[0] == pytest.approx(ends[1], abs=1e-6)
    assert equilibrium(m).outputs["tip"] == pytest.approx(equilibrium(other).outputs["tip"], abs=1e-9)


PUSHES = {
    "steps": Sum(Step(height=2.0, begin=1.0), Step(height=-2.0, begin=1.01)),
    "product": Product(Step(height=2.0, begin=1.0), Step(height=-1.0, begin=1.01, offset=1.0)),
    "table": Table([0.9, 0.99, 1.0, 1.01, 1.1], [0, 0, 2, 0, 0], "linear"),
    "ramps": Sum(Ramp(height=2.0, begin=1.0, duration=0.01), Ramp(height=-2.0, begin=1.01, duration=0.01)),
}


@pytest.mark.parametrize("push", PUSHES)
@pytest.mark.parametrize("tolerance", [1e-4, 1e-8])
def test_loads_that_jump_are_seen_at_any_tolerance(push: str, tolerance: float) -> None:
    """Some 2 N from 1 s on for 0.01 s on 1 kg at rest: 0.02 m/s, though nothing moved before."""
    m = Mechanism()
    slider = m.body("slider", m.ground, Translational(axis="x"), mass=1.0)
    m.force("push", PointForce(magnitude=PUSHES[push], axis="x"), slider)
    m.output("v", slider.rate())
    assert simulate(m, 3.0, tolerance=tolerance)["v"][-1] == pytest.approx(0.02, rel=20.0 * tolerance)


def test_an_input_may_be_part_of_a_sum() -> None:
    m = Mechanism()
    slider = m.body("slider", m.ground, Translational(axis="x"), mass=1.0)
    m.force("push", PointForce(magnitude=Sum(1.0, Input(name="u", unit="N", start=2.0)), axis="x"), slider)
    m.output("v", slider.rate())
    assert simulate(m, 1.0, tolerance=1e-8)["v"][-1] == pytest.approx(3.0, rel=1e-6)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: driven(Ramp(height=1.0, duration=0.5)), "which no joint can follow"),
        (lambda: driven(Sum(1.0, Input(name="u", unit="rad"))), "which no joint can follow"),
        (lambda: driven(Step(height=1.0)), "which no joint can follow"),
        (lambda: driven(Table([0, 1, 2], [0, 1, 0], "linear")), "which no joint can follow"),
        (lambda: driven(Table([0, 1, 1], [0, 1, 0])), "each greater than the one before"),
        (lambda: driven(Table([0, 1], [0, 1, 0])), "as many x as y"),
        (lambda: driven(Table([0, 1], [0, 1], "cubic")), "kind of a table is 'cubic'"),
        (
            lambda: driven(Table([0, 1, 2], [0, 1, 2], beyond="periodic")),
            "its first value is 0 and its last 2; allowed: equal values",
        ),
        (lambda: driven(Table([0, 1, 2], [0, 1, 2], beyond="stop")), "beyond of a table is 'stop'; allowed: 'linear'"),
        (lambda: driven(Table([0, 1, 2], [0, 1, 2], "akima", beyond="hold")), "which no joint can follow"),
        (lambda: driven(Sum(1.0)), "Sum has 1 parts"),
        (lambda: driven("0.1*sin(300*t)"), "drive of body 'wheel' changes faster than"),
        (lambda: driven("+".join(["t"] * 5000)), "which is not an expression"),
        (lambda: driven("sin(q)"), "'q' is not known"),
        (lambda: driven("sin(t"), "which is not an expression: '\\(' was never closed(?! .<unknown>)"),
        (lambda: driven("2*t^2"), "a power is written x"),
        (lambda: driven("__import__('os')"), "'__import__' is not known"),
        (lambda: driven("t.real"), "allowed: numbers, t and functions"),
        (lambda: driven(lambda t, x: t), "takes 2 arguments; allowed: 1"),
        (lambda: JointForce(lambda t, q: q), "takes 2 arguments; allowed: 3"),
        (
            lambda: driven(Harmonic(amplitude=np.nan, frequency=1.0)),
            "amplitude of a Harmonic is nan; it must be a finite",
        ),
        (
            lambda: driven(Harmonic(amplitude=1.0, frequency=np.inf)),
            "frequency of a Harmonic is inf; it must be a fini",
        ),
        (
            lambda: driven(Harmonic(amplitude=True, frequency=1.0)),
            "amplitude of a Harmonic is True; it must be a finit",
        ),
        (lambda: driven(Step(height=np.inf, duration=1.0)), "height of a Step is inf; it must be a finite number"),
        (
            lambda: driven(Step(height=1.0, duration=-1.0)),
            "duration of a Step is -1.0; allowed: finite and not negative",
        ),
        (lambda: driven(RunUp(speed=np.nan, duration=1.0)), "speed of a RunUp is nan; it must be a finite number"),
        (lambda: driven(RunUp(speed=1.0, duration=0.0)), "duration of a RunUp is 0.0; allowed: finite and greater"),
        (lambda: Function(lambda t: t, time=0.0), "function of time changes is 0.0; allowed: finite and greater"),
    ],
)
def test_what_is_no_signal_is_refused(make: Any, message: str) -> None:
    with pytest.raises(UserError, match=message):
        make()


@pytest.mark.parametrize("beyond", ["hold", "periodic"])
def test_the_next_point_of_a_curve_is_the_first_after_a_time(beyond: str) -> None:
    x = np.array([0.25, 1.0, 1.125, 2.25])
    numbers = rows("a curve", x, [0.0, 1.0, 2.0, 0.0], "linear", beyond)
    count = -len(numbers) if beyond == "periodic" else len(numbers)
    points = (x[:-1] + 2.0 * np.arange(-9, 9)[:, np.newaxis]).ravel() if beyond == "periodic" else numbers[:, 0]
    near = *x, *(x - 2.0), *np.nextafter(x, -9.0)
    for t in (*np.random.default_rng(1).uniform(-9.0, 9.0, 50), *near):
        later = points[points > t]
        assert next_point(numbers.ravel(), 0, count, t) == (later.min() if later.size else np.inf), t
