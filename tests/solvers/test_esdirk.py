"""ESDIRK3(2) on large trees: its coefficients, its order, what it keeps, and closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from fmus.sheet import Sheet
from mbfmu.mechanics import (
    Floating,
    Input,
    JointForce,
    JointSpring,
    Mechanism,
    Revolute,
    RevoluteCutJoint,
    Table,
    Translational,
    rod,
)
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.util.errors import UserError
from solvers.steppers.esdirk.formulas import EMBEDDED_WEIGHTS, GAMMA, A, B, C

MANY = 70  # coordinates: a large tree


def of(mechanism: Mechanism, **settings: Any) -> Simulation:
    return Simulation(mechanism, Settings(solver="esdirk", **settings))


def row(simulation: Simulation, *names: str) -> NDArray[np.float64]:
    found = dict(zip([v.name for v in simulation.variables], simulation.outputs(), strict=True))
    return np.array([found[name] for name in names])


def test_coefficients_are_of_order_three_with_an_embedded_method_of_order_two() -> None:
    ones = np.ones(4)
    np.testing.assert_allclose(A @ ones, C, atol=1e-15)
    np.testing.assert_allclose([B @ ones, B @ C, B @ C**2, B @ A @ C], [1.0, 1 / 2, 1 / 3, 1 / 6], atol=1e-14)
    np.testing.assert_allclose([EMBEDDED_WEIGHTS @ ones, EMBEDDED_WEIGHTS @ C], [1.0, 1 / 2], atol=1e-14)
    assert abs(EMBEDDED_WEIGHTS @ C**2 - 1 / 3) > 1e-3
    np.testing.assert_allclose(np.diag(A), [0.0, GAMMA, GAMMA, GAMMA])


def test_it_is_l_stable() -> None:
    def growth(z: complex) -> float:
        return abs(1.0 + z * B @ np.linalg.solve(np.eye(4) - z * A, np.ones(4)))

    assert growth(-1e8) < 1e-6
    assert max(growth(1j * y) for y in np.logspace(-3, 5, 400)) <= 1.0 + 1e-12


def swings(stiffness: float = 30.0, torque: bool = False) -> Mechanism:
    """Pendulums next to each other, the last one on a spring."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    for k in range(MANY):
        b = m.body(f"b{k}", m.ground, Revolute(start=-1.5 + 0.5 * k / MANY), **rod(mass=0.5, length=0.4))
    m.force("spring", JointSpring(stiffness=stiffness), b)
    if torque:
        m.force("motor", JointForce(Input(name="torque", unit="N.m")), b)
    m.output("angle", m.turn(b))
    return m


def exact_swing(end: float, stiffness: float = 30.0) -> float:
    def rates(_t: float, y: NDArray[np.float64]) -> list[float]:
        inertia = 0.5 * 0.4**2 / 3.0
        return [y[1], (-stiffness * y[0] - 0.5 * 9.81 * 0.2 * np.cos(y[0])) / inertia]

    start = -1.5 + 0.5 * (MANY - 1) / MANY
    return float(solve_ivp(rates, (0.0, end), [start, 0.0], rtol=1e-12, atol=1e-13, method="DOP853").y[0, -1])


def in_fixed_steps(mechanism: Mechanism, h: float) -> Simulation:
    """Steps of h, s, whose stages are solved to rounding."""
    simulation = of(mechanism, tolerance=1e-2, max_step=h)
    stepper: Any = simulation.stepper
    stepper._settings["stage_tolerance"], stepper._memory.control["h"] = 1e-8, h
    return simulation


def test_steps_are_of_order_three() -> None:
    errors = []
    for h in (4e-3, 2e-3, 1e-3):
        simulation = in_fixed_steps(swings(), h)
        assert simulation.advance(0.2).ok
        errors.append(abs(row(simulation, "angle")[0] - exact_swing(0.2)))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 2.6).all()
    assert (orders < 3.5).all()


def rotors() -> Mechanism:
    """Free bodies next to each other that tumble."""
    m = Mechanism(gravity=(0.0, 0.0, 0.0))
    for k in range(MANY // 6 + 1):
        joint = Floating(at=(float(k), 0.0, 0.0), rate=(0.3, 0.0, 0.0, 4.0, 0.2, 0.1))
        b = m.body(f"b{k}", m.ground, joint, mass=1.0, inertia=(0.02, 0.03, 0.01))
    for k in range(4):
        m.output(f"e{k}", b.quaternion(k))
    return m


def exact_attitude(end: float) -> NDArray[np.float64]:
    """By Euler's equations."""
    J = np.array([0.02, 0.03, 0.01])

    def rates(_t: float, y: NDArray[np.float64]) -> NDArray[np.float64]:
        e, w = y[:4], y[4:]
        turned = 0.5 * np.append(-e[1:] @ w, e[0] * w + np.cross(e[1:], w))
        return np.append(turned, -np.cross(w, J * w) / J)

    start = np.array([1.0, 0.0, 0.0, 0.0, 4.0, 0.2, 0.1])
    found: NDArray[np.float64] = solve_ivp(rates, (0.0, end), start, rtol=1e-12, atol=1e-13, method="DOP853").y[:4, -1]
    return found


def test_quaternions_turn_according_to_euler_to_order_three() -> None:
    errors = []
    for h in (0.08, 0.04, 0.02):
        simulation = in_fixed_steps(rotors(), h)
        assert simulation.advance(1.0).ok
        e = row(simulation, "e0", "e1", "e2", "e3")
        assert abs(e @ e - 1.0) < 1e-14
        exact = exact_attitude(1.0)
        errors.append(min(abs(e - exact).max(), abs(e + exact).max()))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 2.6).all()
    assert (orders < 3.5).all()


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
def test_the_error_is_in_proportion(tolerance: float) -> None:
    """After five periods."""
    simulation = of(swings(), tolerance=tolerance)
    assert simulation.advance(1.0).ok
    assert abs(row(simulation, "angle")[0] - exact_swing(1.0)) < 60.0 * tolerance
    assert simulation.warning == ""


@pytest.mark.parametrize("tolerance", [1e-3, 1e-4, 1e-6])
def test_a_stiff_joint_that_starts_off_its_rest_is_not_jumped_over(tolerance: float) -> None:
    """It is there after some milliseconds, and has turned the other body by what their inertias say."""
    J, m = np.array([0.03, 0.01]), Mechanism(gravity=(0.0, 0.0, 0.0))
    for k in range(MANY // 2 + 1):
        a = m.body(f"a{k}", m.ground, Revolute(axis="z"), mass=1.0, inertia=(0.02, 0.02, J[0]))
        b = m.body(f"b{k}", a, Revolute(axis="z", start=0.3), mass=1.0, inertia=(0.02, 0.02, J[1]))
        m.force(f"tie{k}", JointSpring(stiffness=1e6, damping=1e3), b)
    m.output("first", m.turn(a))
    m.output("second", m.turn(b))
    simulation = of(m, tolerance=tolerance)
    assert simulation.advance(0.5).ok
    first, second = row(simulation, "first", "second")
    assert second == pytest.approx(first, abs=tolerance)
    assert first == pytest.approx(0.3 * J[1] / J.sum(), abs=10.0 * tolerance)
    assert simulation.warning == ""


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
def test_attitudes_too(tolerance: float) -> None:
    simulation = of(rotors(), tolerance=tolerance)
    assert simulation.advance(1.0).ok
    e, exact = row(simulation, "e0", "e1", "e2", "e3"), exact_attitude(1.0)
    assert min(abs(e - exact).max(), abs(e + exact).max()) < 10.0 * tolerance


def linkage(copies: int, size: float = 1.0, doubled: bool = False) -> Mechanism:
    """Slider-cranks next to each other, of different lengths; the last one is an output, and may be held twice."""
    m = Mechanism(gravity=(0.0, -9.81 * size, 0.0))
    for k in range(copies):
        far = 0.1 * (k % 3) * size
        crank = m.body(f"crank{k}", m.ground, Revolute(start=0.6, fixed=True), **rod(mass=1.0, length=0.3 * size))
        at = (0.3 * size, 0.0, 0.0)
        link = m.body(f"link{k}", crank, Revolute(at=at, start=-0.9), **rod(mass=0.7, length=0.8 * size + far))
        slider = m.body(f"slider{k}", m.ground, Translational(axis="x", start=size), mass=0.4)
        m.cut(f"pin{k}", RevoluteCutJoint(at_a=(0.8 * size + far, 0.0, 0.0)), link, slider)
        if doubled and k == copies - 1:
            m.cut("again", RevoluteCutJoint(at_a=(0.8 * size + far, 0.0, 0.0)), link, slider)
    m.output("angle", m.turn(crank))
    m.output("gap", m.position_residual)
    return m


def exact_crank(end: float, far: float) -> float:
    """Lagrange's equation of one slider-crank, its derivatives by complex steps."""
    r, l, g = 0.3, 0.8 + far, 9.81

    def along(x: complex) -> tuple[complex, complex, complex, complex]:
        """d/dx of link's center, its turn, and the slider; then the potential."""
        s, c = np.sin(x), np.cos(x)
        turn = -r * c / np.sqrt(l * l - (r * s) ** 2)  # of the link, sin b = -r s / l
        sin_b, cos_b = -r * s / l, np.sqrt(1.0 - (r * s / l) ** 2)
        vx, vy = -r * s - 0.5 * l * sin_b * turn, r * c + 0.5 * l * cos_b * turn
        slide = -r * s - l * sin_b * turn
        inertia = r * r / 3.0 + 0.7 * (vx * vx + vy * vy + l * l * turn * turn / 12.0) + 0.4 * slide * slide
        return inertia, g * (0.5 * r * s + 0.7 * (r * s + 0.5 * l * sin_b)), turn, slide

    def rates(_t: float, y: NDArray[np.float64]) -> list[float]:
        inertia, potential, *_ = along(y[0] + 1e-30j)
        slope, pull = inertia.imag / 1e-30, potential.imag / 1e-30
        return [y[1], float((-0.5 * slope * y[1] ** 2 - pull) / inertia.real)]

    return float(solve_ivp(rates, (0.0, end), [0.6, 0.0], rtol=1e-12, atol=1e-13, method="DOP853").y[0, -1])


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-6])
def test_loops_move_according_to_lagrange(size: float, tolerance: float) -> None:
    copies = 36  # 108 coordinates under constraints
    simulation = of(linkage(copies, size), tolerance=tolerance)
    assert simulation.advance(1.0).ok
    angle, gap = row(simulation, "angle", "gap")
    assert abs(angle - exact_crank(1.0, 0.1 * ((copies - 1) % 3))) < 150.0 * tolerance
    assert gap < 1e-10 * size
    assert simulation.warning == ""


@pytest.mark.parametrize(("copies", "tolerance"), [(0, 1e-6), (36, 1e-4)])
def test_corners_of_a_force_are_resolved_in_the_velocity(copies: int, tolerance: float) -> None:
    """A force rises and falls in 20 ms; its impulse is the momentum of a cart that was at rest."""
    m = linkage(copies) if copies else swings()
    pulse = Table((0.1, 0.11, 0.12), (0.0, 100.0, 0.0), kind="linear", beyond="hold")
    cart = m.body("cart", m.ground, Translational(axis="x"), mass=1.0)
    m.force("pulse", JointForce(pulse), cart)
    m.output("rate", cart.rate())
    simulation = of(m, tolerance=tolerance)
    assert simulation.advance(0.2).ok
    assert row(simulation, "rate")[0] == pytest.approx(1.0, abs=30.0 * tolerance)
    assert simulation.warning == ""


def test_a_redundant_constraint_equation_changes_nothing() -> None:
    found = []
    for doubled in (False, True):
        simulation = of(linkage(36, doubled=doubled), tolerance=1e-7)
        assert simulation.advance(0.5).ok
        found.append(row(simulation, "angle")[0])
    assert found[0] == pytest.approx(found[1], abs=1e-5)
    assert found[0] == pytest.approx(exact_crank(0.5, 0.2), abs=6e-6)


def test_factors_outlast_loads_that_jump() -> None:
    """A torque set each millisecond: as fast as the motion lets it, and as exact as the held torque is."""
    simulation = of(swings(torque=True), tolerance=1e-6)
    angle, rate, inertia = -1.5 + 0.5 * (MANY - 1) / MANY, 0.0, 0.5 * 0.4**2 / 3.0
    for k in range(50):
        torque = 2.0 * np.sin(40.0 * (k + 1) * 1e-3)
        simulation.set_input("torque", torque)
        assert simulation.advance((k + 1) * 1e-3).ok

        def rates(_t: float, y: NDArray[np.float64], torque: float = torque) -> list[float]:
            return [y[1], (torque - 30.0 * y[0] - 0.5 * 9.81 * 0.2 * np.cos(y[0])) / inertia]

        angle, rate = solve_ivp(rates, (0.0, 1e-3), [angle, rate], rtol=1e-11, atol=1e-12).y[:, -1]
    assert row(simulation, "angle")[0] == pytest.approx(angle, abs=1e-5)
    assert simulation.statistics.rhs_evals < 12 * simulation.statistics.steps
    assert simulation.compiled.system.tangent.factored <= 10  # type: ignore[attr-defined]


def test_two_of_one_system_do_not_use_each_others_factors() -> None:
    model = Sheet(nx=7, nz=5)
    alone, one = (Simulation(model, Settings(solver="esdirk", tolerance=1e-5)) for _ in range(2))
    other = type(one.stepper)(one.compiled.system, 0.0, *one.compiled.assemble())  # type: ignore[arg-type]
    for t in (0.01, 0.02, 0.03):
        assert alone.advance(t).ok
        assert one.advance(t).ok
        assert other.advance(t).ok
    np.testing.assert_array_equal(one.stepper.q, alone.stepper.q)


def test_a_stiff_sheet_takes_a_fraction_of_an_explicit_methods_steps() -> None:
    simulation = Simulation(Sheet(nx=9, nz=7), Settings(solver="esdirk", tolerance=1e-4))
    assert simulation.advance(0.1).ok
    explicit = Simulation(Sheet(nx=9, nz=7), Settings(solver="adams", tolerance=1e-5))
    assert explicit.advance(0.1).ok
    tip = [v.name for v in simulation.variables].index("tip.y")
    assert simulation.outputs()[tip] == pytest.approx(explicit.outputs()[tip], abs=5e-4)
    assert 20 * simulation.statistics.steps < explicit.statistics.steps
    assert simulation.warning == ""


def test_small_mechanisms_are_refused_with_what_to_take() -> None:
    m = Mechanism()
    m.body("arm", m.ground, Revolute(), **rod(mass=1.0, length=1.0))
    text = r"solver 'esdirk' is for large models only, .* \(this model: joint coordinates 1, .*\); use 'ida'"
    with pytest.raises(UserError, match=text):
        of(m)
