"""Solvers from outside the package: that of the documentation against exact motions, and what may be wrong with one."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import mbfmu as mb
from fmus.fourbar import FourBar
from mbfmu.cli import main
from mbfmu.fmi.harness import Fmu
from mbfmu.mechanics import JointForce, JointSpring, PointForce, Spherical, Step, Translational
from mbfmu.modeling.model import as_model
from mbfmu.modeling.scene import default_scene
from mbfmu.modeling.settings import offered_solvers
from mbfmu.session.simulation import Simulation
from mbfmu.studies.comparison_report import as_text
from solvers import OneStepSolver, Options, Statistics, Stepper, stepper
from solvers.outcome import Code
from solvers.steppers import plugins, solver_names
from solvers.steppers.formulation import formulate

PAGE = (Path(__file__).parents[1] / "docs" / "extending.md").read_text()
(TEXT,) = re.findall(r"```python file=rk4.py\n(.*?)```", PAGE, flags=re.DOTALL)
SPACE: dict[str, Any] = {"__name__": "rk4"}
exec(compile(TEXT, "rk4.py", "exec"), SPACE)
RK4: type[OneStepSolver] = SPACE["RK4"]

MASS, STIFFNESS, AMPLITUDE = 2.0, 50.0, 0.3
RATE = np.sqrt(STIFFNESS / MASS)


@pytest.fixture(autouse=True, scope="module")
def _classes_of_this_file_alone() -> Iterator[None]:
    """Other tests of this process may have given the RK4 of the page, which is another class."""
    before = plugins._given.copy()
    plugins._given.clear()
    yield
    plugins._given.clear()
    plugins._given.update(before)


def oscillator(damping: float = 0.0) -> mb.Mechanism:
    m = mb.Mechanism(gravity=(0, 0, 0))
    slider = m.body("slider", m.ground, Translational(axis="x", start=AMPLITUDE), mass=MASS)
    m.force("spring", JointSpring(stiffness=STIFFNESS, damping=damping), slider)
    m.output("x", slider.coordinate())
    return m


def error_of_steps(h: float) -> float:
    """Largest error of positions with steps of h and no control of the error."""
    compiled = as_model(oscillator()).compile()
    motion = stepper("rk4", compiled.system, 0.0, *compiled.assemble(), Options(rtol=1e-2, atol=1e3, max_step=h))
    motion._control["h"] = h
    times = np.arange(1, 11) / 10.0
    samples = motion.sample(times)
    assert motion.statistics.steps == round(1.0 / h)
    return float(np.abs(samples.q[:, 0] - AMPLITUDE * np.cos(RATE * times)).max())


def test_the_example_has_the_order_four() -> None:
    mb.Settings(solver=RK4)  # the name is known from here on
    errors = np.array([error_of_steps(h) for h in (0.1, 0.05, 0.025, 0.0125)])
    orders = np.log2(errors[:-1] / errors[1:])
    np.testing.assert_allclose(orders, 4.0, atol=0.1)


class Buffered(RK4):  # type: ignore[misc, valid-type]
    """Returns the same array after every step."""

    name = "rk4-buffered"

    def step(self, f: Any, t: float, y: Any, h: float) -> Any:
        if not hasattr(self, "memory"):
            self.memory = np.zeros(len(y))
        self.memory[:] = super().step(f, t, y, h)
        return self.memory


def test_a_result_in_an_array_that_is_used_again_has_its_error_estimated() -> None:
    result = mb.simulate(oscillator(), 2.0, interval=1.0, solver=Buffered, tolerance=1e-8)
    assert not result.failure
    assert np.abs(result["x"] - AMPLITUDE * np.cos(RATE * result.t)).max() < 1e-6 * AMPLITUDE


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
def test_an_undamped_oscillation_is_exact_to_the_tolerance(tolerance: float) -> None:
    result = mb.simulate(oscillator(), 2.0, interval=0.1, solver=RK4, tolerance=tolerance)
    assert not result.failure
    assert not result.warning
    assert result.settings.solver == "rk4"
    exact = AMPLITUDE * np.cos(RATE * result.t)
    assert np.abs(result["x"] - exact).max() < 100.0 * tolerance * AMPLITUDE


def test_the_work_of_a_damper_is_in_the_energy_account() -> None:
    damping, tolerance = 4.0, 1e-8
    result = mb.simulate(oscillator(damping), 3.0, interval=0.1, solver=RK4, tolerance=tolerance)
    decay = 0.5 * damping / MASS
    rate = np.sqrt(RATE**2 - decay**2)
    t = result.t
    exact = AMPLITUDE * np.exp(-decay * t) * (np.cos(rate * t) + decay / rate * np.sin(rate * t))
    energy = 0.5 * STIFFNESS * AMPLITUDE**2
    assert np.abs(result["x"] - exact).max() < 1e-6 * AMPLITUDE
    assert np.abs(result["energy_error"]).max() < 1e-6 * energy
    assert result["energy_throughput"][-1] > 0.9 * energy  # nearly all is dissipated
    assert not result.warning


def test_a_wrong_power_raises_the_warning_of_the_energy_check() -> None:
    class Gaining(RK4):  # type: ignore[misc, valid-type]
        name = "gaining"
        error_order = 1

        def step(self, f: Any, t: float, y: Any, h: float) -> Any:
            end = super().step(f, t, y, h)
            return end * (1.0 + 0.05 * h), np.zeros(len(y))

    result = mb.simulate(oscillator(), 2.0, interval=0.1, solver=Gaining, tolerance=1e-6, max_step=0.01)
    assert "[energy-balance]" in result.warning


def test_a_force_that_jumps_at_a_known_time_is_followed() -> None:
    m = mb.Mechanism(gravity=(0, 0, 0))
    slider = m.body("slider", m.ground, Translational(axis="x"), mass=MASS)
    m.force("push", PointForce(magnitude=Step(begin=0.3037, height=3.0), axis="x"), slider)
    m.output("x", slider.coordinate())
    result = mb.simulate(m, 1.0, interval=0.25, solver=RK4, tolerance=1e-8)
    later = np.maximum(0.0, result.t - 0.3037)
    np.testing.assert_allclose(result["x"], 0.5 * 3.0 / MASS * later**2, atol=1e-7)


def equal_crank(model: FourBar, torque: Callable[[float], float], step: float, end: float) -> tuple[float, float]:
    """Angle and rate at the end: the coupler translates, so that the four-bar is one inertia about its pivot."""
    length = model.crank_length
    inertia = (model.crank_mass + model.rocker_mass) / 3.0 + model.coupler_mass
    weight = (0.5 * (model.crank_mass + model.rocker_mass) + model.coupler_mass) * model.gravity
    y: NDArray[np.float64] = np.array([model.start_angle, 0.0])
    for k in range(round(end / step)):
        held = torque(k * step)

        def rates(_t: float, y: NDArray[np.float64], held: float = held) -> list[float]:
            return [y[1], (held / length**2 - weight / length * np.cos(y[0])) / inertia]

        y = solve_ivp(rates, (0.0, step), y, rtol=1e-12, atol=1e-14, method="DOP853").y[:, -1]
    return float(y[0]), float(y[1])


def torque_at(t: float) -> float:
    return 3.0 * np.sin(7.0 * t)


def driven(end: float, step: float = 0.05, solver: Any = RK4) -> Simulation:
    simulation = Simulation(FourBar(start_angle=0.4), mb.Settings(solver=solver, tolerance=1e-8))
    for k in range(round(end / step)):
        simulation.set_input("crank.torque", torque_at(k * step))
        simulation.advance((k + 1) * step)
        assert not simulation.failure
    return simulation


def test_a_loop_with_an_input_that_is_set_at_every_communication_point() -> None:
    simulation = driven(1.0)
    found = dict(zip([v.name for v in simulation.variables], simulation.outputs(), strict=True))
    angle, rate = equal_crank(FourBar(start_angle=0.4), torque_at, 0.05, 1.0)
    assert abs(found["crank.angle"] - angle) < 1e-6
    assert abs(found["crank.rate"] - rate) < 1e-6
    assert found["position_residual"] < 1e-12
    assert not simulation.warning
    assert abs(found["energy_error"]) < 1e-5


def test_states_that_were_saved_continue_bit_for_bit() -> None:
    simulation = driven(0.5)
    checkpoint, saved = simulation.checkpoint(), simulation.save()
    simulation.advance(0.8)
    expected = simulation.outputs().copy()
    simulation.rollback(checkpoint)
    simulation.advance(0.8)
    np.testing.assert_array_equal(simulation.outputs(), expected)
    other = Simulation(FourBar(start_angle=0.4), mb.Settings(solver=RK4, tolerance=1e-8))
    other.restore(saved)
    other.advance(0.8)
    np.testing.assert_array_equal(other.outputs(), expected)


def test_a_free_symmetric_top_precesses_as_euler_found() -> None:
    m = mb.Mechanism(gravity=(0, 0, 0))
    inertia, spin = (0.3, 0.3, 0.5), (0.4, 0.0, 3.0)
    top = m.body("top", m.ground, Spherical(rate=spin), mass=1.0, inertia=inertia)
    for axis in "xyz":
        m.output(axis, top.angular_velocity(axis))
    result = mb.simulate(m, 2.0, interval=0.1, solver=RK4, tolerance=1e-9)
    # angular momentum, constant in global axes, and a steady rotation about it: Landau and Lifshitz, Mechanics, 33
    momentum = np.array([inertia[0] * spin[0], 0.0, inertia[2] * spin[2]])
    precession = momentum / inertia[0]
    figure = np.array([0.0, 0.0, 1.0])
    angles = np.linalg.norm(precession) * result.t
    n = precession / np.linalg.norm(precession)
    turned = np.array([
        figure * np.cos(a) + np.cross(n, figure) * np.sin(a) + n * (n @ figure) * (1.0 - np.cos(a)) for a in angles
    ])  # fmt: skip
    along = (1.0 / inertia[2] - 1.0 / inertia[0]) * momentum[2]
    expected = precession + along * turned
    found = np.stack([result[axis] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(found, expected, atol=1e-7)


def test_a_large_model_is_integrated_by_its_recursions() -> None:
    m = mb.Mechanism(gravity=(0, 0, 0))
    rates = np.linspace(1.0, 6.0, 70)
    for k, rate in enumerate(rates):
        slider = m.body(f"s{k}", m.ground, Translational(axis="x", start=0.1), mass=1.0)
        m.force(f"f{k}", JointSpring(stiffness=rate**2), slider)
        m.output(f"x{k}", slider.coordinate())
    result = mb.simulate(m, 1.0, interval=0.25, solver=RK4, tolerance=1e-7)
    assert not result.warning
    for k, rate in enumerate(rates):
        np.testing.assert_allclose(result[f"x{k}"], 0.1 * np.cos(rate * result.t), atol=1e-6)


def test_it_is_compared_with_the_other_solvers() -> None:
    scene = default_scene(as_model(oscillator(4.0))).changed(stop_time=3.0, output_interval=1.0)  # s, longer than steps
    found = mb.compare(scene, solvers=["adams", RK4], tolerances=[1e-4, 1e-6], repeats=1, outputs=["x"])
    errors = {(row.solver, row.rtol): row.error or 0.0 for row in found.rows}
    assert set(errors) == {("adams", 1e-4), ("adams", 1e-6), ("rk4", 1e-4), ("rk4", 1e-6)}
    assert 0.0 < errors["rk4", 1e-6] < 0.1 * errors["rk4", 1e-4] < 1e-3
    assert all(row.trusted for row in found.rows)
    assert "rk4" in found.energies
    assert "rk4" in as_text(found)


def test_a_check_of_a_model_runs_it() -> None:
    found = mb.check(FourBar(), 0.1, solver=RK4)
    assert found.solver == "rk4"
    assert found.statistics is not None
    assert found.statistics.steps > 0


class Short(RK4):  # type: ignore[misc, valid-type]
    name = "short"

    def step(self, f: Any, t: float, y: Any, h: float) -> Any:
        return y[:1]


class Unfinished(OneStepSolver):
    order = 1


class Orderless(OneStepSolver):
    def step(self, f: Any, t: float, y: Any, h: float) -> Any:
        return y + h * f(t, y)


class Constructed(RK4):  # type: ignore[misc, valid-type]
    name = "constructed"

    def __init__(self) -> None:
        """Take no arguments."""


class Complex(RK4):  # type: ignore[misc, valid-type]
    def step(self, f: Any, t: float, y: Any, h: float) -> Any:
        return y + 0j


class Calling(RK4):  # type: ignore[misc, valid-type]
    def step(self, f: Any, t: float, y: Any, h: float) -> Any:
        return y + h * f(t, y[:2])


class Dividing(RK4):  # type: ignore[misc, valid-type]
    def step(self, f: Any, t: float, y: Any, h: float) -> Any:
        return y + np.nan


class Silent(RK4):  # type: ignore[misc, valid-type]
    def advance_to(self, t: float) -> Any:
        super().advance_to(t)


class NamedIda(RK4):  # type: ignore[misc, valid-type]
    name = "ida"


@pytest.mark.parametrize(
    ("given", "parts"),
    [
        (Unfinished, ("Unfinished has no step", "documentation")),
        (Orderless, ("Orderless has no order",)),
        (dict, ("solver is <class 'dict'>", "OneStepSolver")),
        (3, ("solver is 3", "allowed: the name of a solver, or a class")),
        (NamedIda, ("has the name 'ida'", "another attribute name")),
        ("rk5x", ("solver is 'rk5x'", "allowed: adams, auto, esdirk")),
        (Constructed, ("'constructed'", "TypeError")),
    ],
)
def test_what_is_wrong_with_a_solver_is_in_the_message(given: Any, parts: tuple[str, ...]) -> None:
    with pytest.raises(mb.UserError) as error:
        mb.simulate(oscillator(), 1.0, solver=given)
    for part in parts:
        assert part in str(error.value)


def direct(**methods: Any) -> type[Stepper]:
    """A solver with its own steps: Heun's, of 1 ms; ``methods`` replace its own."""

    class Direct(Stepper):
        def __init__(self, system: Any, *state: Any) -> None:
            super().__init__(system, *state)
            self.form = formulate(system, self._t, self._q, self._v, self.options)
            self.count = np.zeros(1)

        def limit_step(self, longest: float) -> None:
            pass

        def _rates(self, t: float, q: Any, v: Any) -> tuple[Any, Any]:
            self.form.evaluate(t, q, v)
            return self.form.qdot.copy(), self.form.a.copy()

        def advance_to(self, t: float) -> Code:
            while self._t < t:
                h = min(1e-3, t - self._t)
                dq, dv = self._rates(self._t, self._q, self._v)
                dq2, dv2 = self._rates(self._t + h, self._q + h * dq, self._v + h * dv)
                self._q, self._v = self._q + 0.5 * h * (dq + dq2), self._v + 0.5 * h * (dv + dv2)
                self._t = t if t - self._t <= 1e-3 else self._t + h
                self.count += 1.0
            return Code.OK

        def evaluate(self) -> Any:
            return self.form.evaluate(self._t, self._q, self._v), self.form.a.copy(), self.form.lam.copy()

        def restart(self) -> None:
            pass

        def arrays(self) -> Any:
            return [self.clock, self._q, self._v, self.count]

        @property
        def statistics(self) -> Statistics:
            return Statistics(steps=int(self.count[0]))

    own = {key: (lambda self, *given, call=call: call(Direct, self, *given)) for key, call in methods.items()}
    return type(
        "Direct",
        (Direct,),
        {"__module__": __name__, "name": f"direct-{'-'.join(methods)}-{len(plugins._given)}", **own},
    )


def late(change: Callable[[Any, float], Any]) -> type[Stepper]:
    """A user-defined solver that behaves differently from 0.5 s on."""

    def advance_to(base: Any, self: Any, t: float) -> Any:
        code = base.advance_to(self, t)
        return code if t < 0.5 else change(self, t)

    return direct(advance_to=advance_to)


def leave(**state: Any) -> Callable[[Any, float], Code]:
    """Leave attributes of a solver changed."""

    def change(self: Any, t: float) -> Code:
        for name, value in state.items():
            setattr(self, name, value(t) if callable(value) else value)
        return Code.OK

    return change


def raises(*_: Any) -> Any:
    raise LookupError("a table ends")


def requires_good_rows(result: mb.Result, last: float) -> None:
    """The rows up to the last good one are those of the exact motion."""
    assert result.t[-1] == pytest.approx(last)
    assert np.abs(result["x"] - AMPLITUDE * np.cos(RATE * result.t)).max() < 1e-3 * AMPLITUDE


@pytest.mark.parametrize(
    ("solver", "parts"),
    [
        (Short, ("'short'", "shape (1,)", "allowed: that of y, (3,)")),
        (Complex, ("'complex'", "type complex128", "of real numbers")),
        (Calling, ("'calling'", "Calling calls f(t, y) with", "shape (2,)", "(3,)")),
        (Dividing, ("'dividing'", "step() of Dividing returned a value that is not finite")),
        (Silent, ("'silent'", "advance_to() of Silent returned None", "Code.OK")),
    ],
)
def test_what_is_wrong_in_the_first_step_is_the_failure_of_the_result(solver: Any, parts: tuple[str, ...]) -> None:
    result = mb.simulate(oscillator(), 1.0, solver=solver)
    requires_good_rows(result, 0.0)
    for part in (*parts, "Correct the solver, or use another one [broken-solver]"):
        assert part in result.failure


@pytest.mark.parametrize(
    ("solver", "parts"),
    [
        (lambda: late(raises), ("LookupError: a table ends", "test_user_solvers.py, line")),
        (lambda: late(leave(_q=np.zeros(2))), ("has reported q of the shape (2,)", "allowed: (1,), of real numbers")),
        (lambda: late(leave(_v=np.zeros(1, complex))), ("reported v of the shape (1,) and the type complex128",)),
        (lambda: late(leave(_v=np.array([np.nan]))), ("has reported v = [nan]; allowed: finite numbers",)),
        (lambda: late(leave(_energy_account=np.zeros(3))), ("has reported energy_account of the shape (3,)",)),
        (lambda: late(leave(_t=0.25)), ("has reported the time 0.25; allowed: 0.5 s",)),
        (lambda: late(leave(_t=lambda t: t + 0.01)), ("has reported the time 0.51; allowed: 0.5 s",)),
        (lambda: late(leave(_t="0.5")), ("has reported the time '0.5'",)),
        (lambda: late(lambda *_: None), ("advance_to() of Direct returned None; allowed: a solvers.outcome.Code",)),
    ],
)
def test_the_run_so_far_is_the_result_if_a_solver_fails_later(
    solver: Callable[[], Any], parts: tuple[str, ...]
) -> None:
    result = mb.simulate(oscillator(), 1.0, interval=0.1, solver=solver(), tolerance=1e-4, max_step=0.01)
    requires_good_rows(result, 0.4)
    (error,) = (d for d in result.diagnostics if d.severity == "error")
    assert error.code == "broken-solver"
    assert error.subject == result.settings.solver
    assert error.time is not None
    assert 0.4 <= error.time <= 0.5
    for part in parts:
        assert part in result.failure


@pytest.mark.parametrize(
    ("returned", "part"),
    [
        ((Code.OK, np.zeros(2), np.zeros(0)), "returned v' of the shape (2,)"),
        ((Code.OK, np.array([np.inf]), np.zeros(0)), "returned v' = [inf]; allowed: finite numbers"),
        ((Code.OK, np.zeros(1), np.zeros(3)), "returned lambda of the shape (3,)"),
        ((0, np.zeros(1), np.zeros(0)), "returned the code 0; allowed: a solvers.outcome.Code"),
    ],
)
def test_wrong_accelerations_end_the_run(returned: Any, part: str) -> None:
    solver = direct(evaluate=lambda base, self: returned if self._t > 0.45 else base.evaluate(self))
    result = mb.simulate(oscillator(), 1.0, interval=0.1, solver=solver)
    requires_good_rows(result, 0.4)
    assert f"evaluate() of Direct {part}" in result.failure


@pytest.mark.parametrize("method", ["restart", "continue_after_event"])
def test_an_exception_while_a_solver_is_made_is_that_of_the_solver(method: str) -> None:
    def fails(_self: Any) -> None:
        raise ValueError("no table for this size")

    solver = type(f"Unmade_{method}", (RK4,), {method: fails})
    with pytest.raises(mb.UserError, match=r"solver '.*' \(class .* with ValueError: no table .*\[broken-solver\]"):
        mb.simulate(oscillator(), 1.0, solver=solver)


def test_a_solver_that_never_advances_ends_where_a_signal_limits_the_steps() -> None:
    m = oscillator()
    m.force("push", JointForce(Step(begin=0.3, height=1.0)), m.bodies[1])
    result = mb.simulate(m, 1.0, interval=0.5, solver=direct(advance_to=lambda *_: Code.OK))
    assert "has reported the time 0.0" in result.failure
    assert list(result.t) == [0.0]


@pytest.mark.parametrize("method", ["limit_step", "evaluate", "restart"])
def test_an_exception_in_another_method_ends_the_run(method: str, caplog: pytest.LogCaptureFixture) -> None:
    def fails_later(base: Any, self: Any, *given: Any) -> Any:
        return raises() if self._t > 0.35 else getattr(base, method)(self, *given)

    caplog.set_level("INFO", "solvers")
    simulation = Simulation(oscillator(), mb.Settings(solver=direct(**{method: fails_later})))
    for k in range(1, 5):
        assert simulation.advance(0.1 * k).ok
    if method == "restart":
        simulation.retune(simulation.model)
    elif method == "evaluate":
        with pytest.raises(mb.UserError, match=r"LookupError: a table ends .*\[broken-solver\]"):
            simulation.outputs()
    else:
        assert not simulation.advance(0.5).ok
    assert simulation.t == pytest.approx(0.4)
    assert "after t = 0.4 s with LookupError: a table ends" in simulation.failure
    assert isinstance(simulation.stepper.status.error.__cause__, LookupError)
    assert "in raises" in caplog.text


@pytest.mark.parametrize(
    ("attribute", "value"),
    [(a, x) for a in ("order", "error_order") for x in (0, -2, np.nan, 1000, "4", True)]
    + [("order", None), ("order", 2.5), ("error_order", np.inf)],
)
def test_an_order_that_is_no_order_is_refused(attribute: str, value: Any) -> None:
    with pytest.raises(mb.UserError) as error:
        mb.Settings(solver=type("Ordered", (RK4,), {attribute: value}))
    for part in (f"Ordered has the {attribute} {value!r}", "allowed: a", "20", "[broken-solver]"):
        assert part in str(error.value)


def test_two_classes_of_one_name_are_refused_and_the_first_keeps_it() -> None:
    first, second = (type("Twin", (RK4,), {"order": order}) for order in (4, 3))
    with pytest.raises(mb.UserError, match=r"Twin has the name 'twin' of another class that this program uses.*Give"):
        mb.compare(oscillator(), solvers=[first, second], tolerances=[1e-4])
    result = mb.simulate(oscillator(), 0.1, solver="twin")
    assert result.statistics.order == 4


def test_a_class_that_is_defined_again_takes_the_place_of_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    for order in (4, 3):
        again = type("Again", (RK4,), {"order": order, "__module__": __name__})
        monkeypatch.setitem(globals(), "Again", again)
        assert mb.simulate(oscillator(), 0.1, solver=again).statistics.order == order


class Raising(RK4):  # type: ignore[misc, valid-type]
    name = "raising"

    def step(self, f: Any, t: float, y: Any, h: float) -> Any:
        return super().step(f, t, y, h) if t < 0.5 else y + 1 // 0


def test_an_exception_in_a_step_names_the_solver_the_time_and_the_line_and_others_are_compared() -> None:
    chosen = ["adams", Raising]
    found = mb.compare(oscillator(4.0), solvers=chosen, tolerances=[1e-4], repeats=1, outputs=["x"])
    good, failed = found.rows
    assert (good.solver, failed.solver) == ("adams", "raising")
    assert not good.failed
    assert f"'raising' (class {__name__}.Raising) fails after t = " in failed.failure
    assert "ZeroDivisionError" in failed.failure
    assert "test_user_solvers.py, line" in failed.failure


def test_the_last_good_state_remains_when_a_step_raises() -> None:
    simulation = Simulation(oscillator(), mb.Settings(solver=Raising, tolerance=1e-8, max_step=0.01))
    assert not simulation.advance(1.0).ok
    assert 0.495 <= simulation.t < 0.51  # from there, half a step leads to 0.5 s or beyond
    assert f"after t = {simulation.t:.9g} s" in simulation.failure
    found = dict(zip([v.name for v in simulation.variables], simulation.outputs(), strict=True))
    assert abs(found["x"] - AMPLITUDE * np.cos(RATE * simulation.t)) < 1e-6 * AMPLITUDE
    assert abs(found["energy_error"]) < 1e-6


def test_a_class_given_to_a_program_is_not_exported(tmp_path: Path) -> None:
    with pytest.raises(mb.UserError, match=r"solver 'rk4' is a class of this program.*entry point"):
        mb.export(FourBar(), tmp_path / "out.fmu", mb.Settings(solver=RK4), native=False)


PACKAGE = {
    "rk4_plugin.py": TEXT + "\n\nnumber = 3\n",
    "ending_plugin.py": TEXT.replace(
        "return y", "if t > 0.05:\n            raise LookupError('a table ends')\n        return y"
    ),
    "broken_plugin.py": "import a_module_that_nobody_has\n",
    "plugins-1.0.dist-info/METADATA": "Metadata-Version: 2.1\nName: plugins\nVersion: 1.0\n",
    "plugins-1.0.dist-info/entry_points.txt": """[mbfmu.solvers]
installed-rk4 = rk4_plugin:RK4
ending = ending_plugin:RK4
broken = broken_plugin:Solver
number = rk4_plugin:number
twice = rk4_plugin:RK4
""",
    "others-1.0.dist-info/METADATA": "Metadata-Version: 2.1\nName: others\nVersion: 1.0\n",
    "others-1.0.dist-info/entry_points.txt": "[mbfmu.solvers]\ntwice = rk4_plugin:RK4\n",
}


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two packages, as pip installs them."""
    for name, text in PACKAGE.items():
        path = tmp_path / "site" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    monkeypatch.syspath_prepend(tmp_path / "site")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_an_installed_solver_is_listed_and_runs(packages: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "installed-rk4" in solver_names()
    result = mb.simulate(oscillator(), 1.0, interval=0.5, solver="installed-rk4", tolerance=1e-8)
    np.testing.assert_allclose(result["x"], AMPLITUDE * np.cos(RATE * result.t), atol=1e-6)
    assert main(["run", "pendulum", "--direct", "--solver", "installed-rk4", "--stop-time", "0.1"]) == 0
    capsys.readouterr()
    with pytest.raises(SystemExit):
        main(["run", "--help"])
    assert "installed-rk4" in capsys.readouterr().out


def test_a_command_fails_with_the_message_of_a_solver(packages: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "pendulum", "--direct", "--solver", "ending", "--stop-time", "0.2"]) == 1
    assert "LookupError: a table ends (ending_plugin.py, line" in capsys.readouterr().err


def test_an_fmu_with_an_installed_solver_runs(packages: Path) -> None:
    path = mb.export(FourBar(), packages / "crank.fmu", mb.Settings(solver="installed-rk4"), native=False)
    with Fmu(path) as fmu:
        fmu.step(0.1)
        found = fmu["crank.angle"]
    assert found == pytest.approx(mb.simulate(FourBar(), 0.1, interval=0.1)["crank.angle"][-1], abs=1e-5)


def test_an_fmu_whose_solver_is_not_installed_reports_it_without_logging(packages: Path) -> None:
    path = mb.export(FourBar(), packages / "crank.fmu", mb.Settings(solver="installed-rk4"), native=False)
    script = "import fmpy, sys; fmpy.simulate_fmu(sys.argv[1], stop_time=0.1, debug_logging=False)"
    done = subprocess.run([sys.executable, "-c", script, str(path)], capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "solver is 'installed-rk4'; allowed:" in done.stderr


SAVES = """
import sys
import numpy as np
import mbfmu as mb
from mbfmu.session.simulation import Simulation
from solvers import OneStepSolver
SCALE = {scale}
class Euler(OneStepSolver):
    order = 1
    weights = np.array([{weight}])
    def step(self, f, t, y, h):
        return y + h * SCALE * self.weights[0] * f(t, y), np.zeros(len(y))
m = mb.Mechanism()
m.body("arm", m.ground, mb.Revolute(start=0.3), **mb.rod(mass=1.0, length=1.0))
run = Simulation(m, mb.Settings(solver=Euler, tolerance=1e-3))
if sys.argv[1] == "save":
    run.advance(0.01)
    open("state", "wb").write(run.save())
else:
    run.restore(open("state", "rb").read())
"""


def test_a_state_belongs_to_the_class_that_saved_it(tmp_path: Path) -> None:
    """In another process; classes of the same name differ in a number of theirs, or of their module."""

    def end(what: str, scale: float = 1.0, weight: float = 1.0) -> tuple[int, str]:
        (tmp_path / "steps.py").write_text(SAVES.format(scale=scale, weight=weight))
        command = [sys.executable, "steps.py", what]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        return done.returncode, done.stderr

    assert end("save")[0] == end("restore")[0] == 0
    for other in ({"scale": 0.5}, {"weight": 0.5}):
        code, text = end("restore", **other)
        assert code == 1
        assert "a saved state belongs to another model" in text


def test_an_fmu_whose_solver_fails_reports_the_exception(packages: Path) -> None:
    path = mb.export(FourBar(), packages / "crank.fmu", mb.Settings(solver="ending"), native=False)
    with Fmu(path) as fmu:
        fmu.step(0.04)
        with pytest.raises(mb.UserError, match=r"LookupError: a table ends \(ending_plugin.py, line"):
            fmu.step(0.1)


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("broken", ("'broken'", "'broken_plugin:Solver' of package 'plugins'", "ModuleNotFoundError", "uninstall")),
        ("number", ("'number'", "'rk4_plugin:number'", "is 3", "OneStepSolver")),
        ("twice", ("'twice'", "package 'others'", "package 'plugins'", "Uninstall")),
        ("nowhere", ("'nowhere'", "installed-rk4", "adams")),
    ],
)
def test_a_broken_package_is_named_and_concerns_nothing_else(packages: Path, name: str, parts: tuple[str, ...]) -> None:
    with pytest.raises(mb.UserError) as error:
        mb.simulate(oscillator(), 1.0, solver=name)
    for part in parts:
        assert part in str(error.value)
    assert not mb.simulate(oscillator(), 0.1, solver="installed-rk4").failure


def test_a_comparison_leaves_a_broken_package_out(packages: Path) -> None:
    found = mb.compare(oscillator(4.0), solvers=["adams", "broken"], tolerances=[1e-4], repeats=1, outputs=["x"])
    assert [row.solver for row in found.rows] == ["adams"]
    assert any("broken_plugin" in d.text for d in found.diagnostics)


@pytest.mark.parametrize("name", ["adams", "auto"])
def test_a_package_with_the_name_of_a_solver_is_reported_and_not_used(packages: Path, name: str) -> None:
    entries = packages / "site" / "others-1.0.dist-info" / "entry_points.txt"
    entries.write_text(f"[mbfmu.solvers]\n{name} = broken_plugin:Solver\n")
    with pytest.warns(RuntimeWarning, match=f"solver '{name}' .*package 'others'.* is not used.*another name"):
        assert offered_solvers().count(name) == 1
    with pytest.warns(RuntimeWarning, match="is not used"):
        assert not mb.simulate(oscillator(), 0.1, solver="installed-rk4").failure
