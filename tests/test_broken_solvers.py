"""User-defined solvers with a mistake: the message names the solver, the mistake and the time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from user_solvers import AMPLITUDE, RATE, RK4, classes_of_one_file, oscillator  # noqa: F401  # classes_of_one_file is a fixture

import mbfmu as mb
from mbfmu.mechanics import JointForce, Step
from mbfmu.session.simulation import Simulation
from solvers import OneStepSolver, Statistics, Stepper
from solvers.outcome import Code
from solvers.steppers import plugins
from solvers.steppers.formulation import formulate


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
        (lambda: late(raises), ("LookupError: a table ends", "test_broken_solvers.py, line")),
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
    assert "test_broken_solvers.py, line" in failed.failure


def test_the_last_good_state_remains_when_a_step_raises() -> None:
    simulation = Simulation(oscillator(), mb.Settings(solver=Raising, tolerance=1e-8, max_step=0.01))
    assert not simulation.advance(1.0).ok
    assert 0.495 <= simulation.t < 0.51  # from there, half a step leads to 0.5 s or beyond
    assert f"after t = {simulation.t:.9g} s" in simulation.failure
    found = dict(zip([v.name for v in simulation.variables], simulation.outputs(), strict=True))
    assert abs(found["x"] - AMPLITUDE * np.cos(RATE * simulation.t)) < 1e-6 * AMPLITUDE
    assert abs(found["energy_error"]) < 1e-6
