"""What a user may write by mistake, through the Python API: a sentence, whatever it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fmus.fourbar import FourBar
from mbfmu.mechanics import (
    Box,
    CompiledMechanism,
    CutHandle,
    DistanceCutJoint,
    Input,
    JointForce,
    Mechanism,
    Revolute,
    RevoluteCutJoint,
    SpeedInput,
    SphericalCutJoint,
    Translational,
    rod,
)
from mbfmu.modeling import Model
from mbfmu.session.run import communication_points, run
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.sheets import Support, add_sheet
from mbfmu.util.errors import UserError

TIMES = np.linspace(0.0, 0.1, 3)


@dataclass(frozen=True, kw_only=True)
class Made(Model):
    """Whatever a function adds to a swinging rod."""

    name = "made"
    more: Any = None

    def __post_init__(self) -> None:
        """Take anything."""

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        bar = m.body("bar", m.ground, Revolute(start=0.3), **rod(mass=1.0, length=1.0))
        m.output("angle", bar.angle())
        if self.more is not None:
            self.more(m, bar)
        return m


def other() -> Mechanism:
    """Another mechanism with two bodies."""
    m = Mechanism()
    m.body("other", m.body("first", m.ground, Revolute(), mass=1.0), Revolute(), mass=1.0)
    return m


def foreign_cut() -> CutHandle:
    """A cut joint of another mechanism."""
    m = other()
    return m.cut("pin", SphericalCutJoint(), m.bodies[-1], m.ground)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (lambda m, bar: m.output("a", 5), "output 'a' is 5"),
        (lambda m, bar: m.output(5, bar.angle()), "output is named 5"),
        (lambda m, bar: m.output("a\nb", bar.angle()), "output is named"),
        (lambda m, bar: m.output("a", bar.coordinate("x")), "no joint coordinate 'x'"),
        (lambda m, bar: m.output("a", bar.coordinate(0.5)), "no joint coordinate 0.5"),
        (lambda m, bar: m.output("a", other().bodies[-1].angle()), "not a body of this mechanism"),
        (lambda m, bar: m.output("a", other().ground.position("x")), "not a body of this mechanism"),
        (lambda m, bar: m.output("a", foreign_cut().force("x")), "'pin', which is not a constraint of this mechanism"),
        (
            lambda m, bar: (m.load("f", JointForce(magnitude=1.0), bar), m.force("f", JointForce(magnitude=1.0), bar)),
            "force is named 'f'",
        ),
        (lambda m, bar: m.shape(bar, Box(size="x")), "size of a box is 'x'"),
        (lambda m, bar: m.shape(bar, Box(size=(1, 1, 1), rotation=np.diag((1, 1, -1)))), "rotation of a box"),
        (lambda m, bar: m.surface("s", [[m.ground, bar], [m.ground, bar]], color=5), "color is 5"),
        (lambda m, bar: m.output("time", bar.angle()), "2 variables are named 'time'"),
        (lambda m, bar: m.output("energy_error", bar.rate()), "2 variables are named 'energy_error'"),
        (
            lambda m, bar: m.force("f", JointForce(magnitude=Input(name="angle", unit="N.m")), bar),
            "2 variables are named 'angle'",
        ),
        (lambda m, bar: Input(name="push", unit="N", start=float("nan")), "start of input 'push' is nan"),
        (lambda m, bar: Input(name="push", unit="N", start="x"), "start of input 'push' is 'x'"),
        (lambda m, bar: SpeedInput(name="speed", unit="rad/s", start=float("inf")), "start of input 'speed' is inf"),
        (lambda m, bar: m.body("b", bar, Translational(nominal="x"), mass=1.0), "nominal of body 'b' is 'x'"),
        (
            lambda m, bar: m.cut("far", RevoluteCutJoint(at_a=(1e160, 0.0, 0.0)), bar, m.ground),
            "largest length of the mechanism",
        ),
    ],
)
def test_a_mechanism_with_something_odd(more: Callable[[Mechanism, Any], None], message: str) -> None:
    with pytest.raises(UserError, match=message):
        run(Made(more=more), Settings(), TIMES)


@pytest.mark.parametrize(
    "times",
    [[], None, 0.5, [[0.0, 1.0]], "soon", [0.0, float("nan")], [0.0, 1.0, 0.5], [0.0, 0.0], [float("nan"), 1.0]],
)
def test_times_that_are_none(times: Any) -> None:
    with pytest.raises(UserError, match=r"times (is|are)"):
        run(Made(), Settings(), times)


@pytest.mark.parametrize(
    "odd",
    [
        {"solver": None},
        {"solver": ["ida"]},
        {"solver": 5},
        {"energy_check": None},
        {"absolute_tolerance": 1e-300},
        {"max_order": 2.5},
        {"start_at_equilibrium": "x"},
    ],
)
def test_settings_of_another_kind(odd: dict[str, Any]) -> None:
    with pytest.raises(UserError, match=f"{next(iter(odd))} is"):
        Settings(**odd)


def test_settings_accept_numbers_of_numpy_and_copy_them() -> None:
    settings = Settings(tolerance=np.float64(1e-8), max_steps=np.int64(500))
    assert repr((settings.tolerance, settings.max_steps)) == "(1e-08, 500)"


@pytest.mark.parametrize("key", [-1, 0, 99, "torque", None, 1.5])
def test_an_input_that_is_not_there(key: Any) -> None:
    with pytest.raises(UserError, match="no input"):
        Simulation(Made(), Settings()).set_input(key, 1.0)
    with pytest.raises(UserError, match="no input"):
        Simulation(Made(), Settings(), inputs={key: 1.0})


def test_inputs_that_are_no_mapping() -> None:
    with pytest.raises(UserError, match="inputs are"):
        Simulation(Made(), Settings(), inputs=[1.0])  # type: ignore[arg-type]


@pytest.mark.parametrize("value", ["a lot", None, float("nan"), [1.0]])
def test_values_of_an_input_that_are_no_numbers(value: Any) -> None:
    with pytest.raises(UserError, match=r"input 'crank\.torque' is"):
        Simulation(FourBar(), Settings(solver="adams")).set_input("crank.torque", value)


def test_an_advance_to_nowhere_or_back() -> None:
    simulation = Simulation(Made(), Settings())
    with pytest.raises(UserError, match="time to advance to is nan"):
        simulation.advance(float("nan"))
    simulation.advance(0.1)
    with pytest.raises(UserError, match=r"time to advance to is 0\.05 s, but the simulation has reached 0\.1 s"):
        simulation.advance(0.05)


def test_a_state_and_a_table_of_another_kind() -> None:
    simulation = Simulation(Made(), Settings())
    with pytest.raises(UserError, match="a saved state is None; allowed: bytes"):
        simulation.restore(None)  # type: ignore[arg-type]
    with pytest.raises(UserError, match="values have the shape"):
        simulation.record(TIMES, np.zeros((1, 1)))


class Raises(Model):
    """Cannot be built."""

    def build(self) -> Mechanism:
        raise ZeroDivisionError("by nothing")


class Nothing(Model):
    """Builds nothing."""

    def build(self) -> Mechanism:
        return None  # type: ignore[return-value]


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (Raises(), r"'raises': build\(\) fails with ZeroDivisionError: by nothing \(test_odd_inputs.py, line \d+\)"),
        (Nothing(), r"'nothing': build\(\) returns None; it must return a Mechanism"),
        (Model(), "has no method build()"),
        (FourBar, r"model is the class FourBar; give an instance of it: FourBar\(\)"),
        (Mechanism(), "the mechanism has no bodies"),
        ("fourbar", "model is 'fourbar'; allowed: a Mechanism, or an instance"),
    ],
)
def test_models_that_are_none(model: Any, message: str) -> None:
    with pytest.raises(UserError, match=message):
        run(model, Settings(), TIMES)


def test_a_rod_of_no_length_and_a_place_that_is_none() -> None:
    m = Mechanism()
    bar = m.body("bar", m.ground, Revolute(), **rod(mass=1.0, length=1.0))
    with pytest.raises(UserError, match="length of cut 'tie' is 1e-300 m; allowed: 1e-50 to"):
        m.cut("tie", DistanceCutJoint(length=1e-300), bar, m.ground)
    with pytest.raises(UserError, match=r"supports of sheet 'paper' are .* a list"):
        add_sheet(m, "paper", length=1.0, width=1.0, density=1.0, thickness=1e-3, youngs_modulus=1e9, poisson=0.3,
                  grid=(4, 4), supports=Support("x0", "clamped"))  # fmt: skip


@pytest.mark.parametrize(
    "given",
    [(1.0, 0.0), (1.0, -1.0), (-1.0, 0.1), (float("nan"), 0.1), ("a", 1.0), (1e9, 1e-9), (1e-300, 1e-300)],
)
def test_points_that_there_are_none_or_too_many_of(given: Any) -> None:
    allowed = r"(stop time|interval) is .*; allowed: (finite and greater than zero|at most|at least)"
    with pytest.raises(UserError, match=allowed):
        communication_points(*given)


@pytest.mark.parametrize(
    "odd", [{"tolerance": "1e-6"}, {"tolerance": 1.0}, {"max_step": float("nan")}, {"max_step": -1}]
)
def test_numbers_of_settings_that_are_out_of_range(odd: dict[str, Any]) -> None:
    with pytest.raises(UserError, match=f"{next(iter(odd))} is .*; allowed: "):
        Settings(**odd)


def test_an_infinite_largest_step_is_refused() -> None:
    with pytest.raises(UserError, match="max_step is inf; allowed: finite, at least 0 s"):
        Settings(max_step=float("inf"))


@pytest.mark.parametrize("solver", ["ida", "adams", "hybrid"])
@pytest.mark.parametrize("start", [1.7e9, 1e11, 1e17])
def test_a_start_so_late_that_time_is_too_coarse(start: float, solver: str) -> None:
    with pytest.raises(UserError, match="start time nearer to zero"):
        run(Made(), Settings(solver=solver, tolerance=1e-9), start + 1e6 * np.arange(3))
    at_last = run(Made(), Settings(solver=solver, tolerance=1e-9), 1e6 + TIMES)
    np.testing.assert_allclose(at_last["angle"], run(Made(), Settings(), TIMES)["angle"], atol=1e-5)


@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e-6])
def test_an_inertia_that_no_body_has_is_refused_at_any_size(scale: float) -> None:
    for odd in ([0.1, 0.1, -0.1], [0.1, 0.1, 0.5], [[0.1, 0.05, 0.0], [-0.05, 0.1, 0.0], [0.0, 0.0, 0.1]]):
        m = Mechanism()
        with pytest.raises(UserError, match="inertia of body 'b'"):
            m.body("b", m.ground, Revolute(), mass=1.0, inertia=scale**5 * np.array(odd))


def test_light_bodies_may_move_with_heavy_ones() -> None:
    def more(m: Mechanism, bar: Any) -> None:
        tiny = m.body("tiny", m.ground, Revolute(at=(3.0, 0.0, 0.0)), **rod(mass=1e-9, length=1e-4))
        m.output("tiny", tiny.angle())

    result = run(Made(more=more), Settings(solver="adams", tolerance=1e-8), TIMES)
    assert not result.failure
    pace = 1.5 * 9.81 / 1e-4
    swing = solve_ivp(lambda t, y: (y[1], -pace * np.cos(y[0])), (0.0, 0.1), (0.0, 0.0), "DOP853", TIMES, rtol=1e-11)
    np.testing.assert_allclose(result["tiny"], swing.y[0], atol=1e-5)


@pytest.mark.parametrize("mass", [1e-20, 1.0, 1e20])
def test_a_mass_on_the_axis_but_for_rounding_moves_no_mass(mass: float) -> None:
    m = Mechanism()
    m.body("arm", m.ground, Revolute(), **rod(mass=mass, length=1.0))
    away = Revolute(at=(0.1 + 0.2, 0.0, 0.0), axis="z")
    m.body("pin", m.bodies[-1], away, mass=mass, com=(0.1 + 0.2 - 0.3, 0.0, 0.0))  # 5.6e-17 m off
    with pytest.raises(UserError, match="'pin' can move without moving mass"):
        CompiledMechanism(m).assemble()


def test_a_start_in_a_singular_position_is_reported() -> None:
    @dataclass(frozen=True, kw_only=True)
    class Flat(Model):
        name = "flat"
        off: float = 0.0

        def build(self) -> Mechanism:
            m = Mechanism()
            crank = m.body(
                "crank", m.ground, Revolute(start=self.off, rate=1.0, fixed=True), **rod(mass=1.0, length=1.0)
            )
            bar = m.body("bar", crank, Revolute(at=(1.0, 0.0, 0.0), start=-self.off), **rod(mass=1.0, length=3.0))
            rocker = m.body(
                "rocker", m.ground, Revolute(at=(3.0, 0.0, 0.0), start=self.off), **rod(mass=1.0, length=1.0)
            )
            m.cut("pin", RevoluteCutJoint(at_a=(3.0, 0.0, 0.0), at_b=(1.0, 0.0, 0.0)), bar, rocker)
            m.output("angle", crank.angle())
            return m

    with pytest.raises(UserError, match=r"the start is a singular configuration.*Give the rates of 'bar' and 'rocker'"):
        Simulation(Flat(), Settings(solver="adams"))
    found = Simulation(Flat(off=0.1), Settings(solver="adams")).diagnostics
    assert [d.code for d in found] == ["removed-constraints"]


@pytest.mark.parametrize("given", [{"start": 0.3}, {"rate": 1.0}, {"fixed": True}, {"start": 0.0, "rate": 0.0}])
def test_a_joint_that_is_driven_takes_no_start(given: dict[str, Any]) -> None:
    with pytest.raises(UserError, match=f"drive and {' and '.join(given)} are given; leave out"):
        Revolute(drive=SpeedInput(name="speed", unit="rad/s"), **given)
