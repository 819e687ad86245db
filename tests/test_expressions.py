"""Expressions of sensors as outputs, quantities of events and arguments of laws, against closed forms and NumPy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism
from mbfmu.modeling.settings import Settings
from mbfmu.native.exchange_states import describe_real_kernels
from mbfmu.session.simulation import Simulation
from mbfmu.util.errors import UserError

FUNCTIONS = {name: getattr(np, name) for name in ("sin", "cos", "exp", "sqrt", "arctan")} | {"abs": np.abs}


def cart(start: float = 0.0) -> tuple[mb.Mechanism, Any]:
    """A cart of 2 kg without gravity."""
    m = mb.Mechanism(gravity=(0.0, 0.0, 0.0))
    return m, m.body("cart", m.ground, mb.Translational(axis="x", start=start, nominal=1.0), mass=2.0)


def test_power_of_a_force_is_force_times_velocity() -> None:
    m, body = cart()
    push = m.force("push", mb.JointForce(mb.Input(name="force", unit="N", start=3.0)), body)
    m.output("power", m.expression("F * v", uses={"F": push.effort(), "v": body.rate()}, unit="W"))
    m.output("work", m.expression("E - E0", uses={"E": m.kinetic_energy, "E0": 0.0}, unit="J"))
    m.output("late", m.expression("t * F", uses={"F": push.effort()}, unit="N.s"))
    result = mb.simulate(m, 2.0, solver="adams", tolerance=1e-9)
    np.testing.assert_allclose(result["power"], 4.5 * result.t, atol=1e-8)  # F^2 t / m
    np.testing.assert_allclose(result["work"], 2.25 * result.t**2, atol=1e-8)
    np.testing.assert_allclose(result["late"], 3.0 * result.t, atol=1e-12)
    assert [own.unit for own in CompiledMechanism(m).outputs] == ["W", "J", "N.s"]
    assert CompiledMechanism(m).feedthrough() == [(0,), (), (0,)]


def random_text(random: np.random.Generator, names: list[str], depth: int) -> str:
    """Return a random expression without poles."""
    if depth == 0:
        return str(random.choice([*names, f"{random.normal():.3f}"]))
    a, b = (random_text(random, names, depth - 1) for _ in range(2))
    function = random.choice(list(FUNCTIONS))
    inner = f"abs({a})" if function == "sqrt" else f"-abs({a})" if function == "exp" else a
    return str(
        random.choice([f"({a} + {b})", f"{a} * {b}", f"({a} - {b})", f"{a} / (2 + {b}**2)", f"{function}({inner})"])
    )


@pytest.mark.parametrize("links", [3, 70])
def test_random_expressions_of_sensors_have_the_values_of_numpy(links: int) -> None:
    """Small models, and large ones that are solved by recursions."""
    random = np.random.default_rng(links)
    m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
    target = mb.Input(name="target", unit="rad", start=0.7)
    link, at = m.ground, (0.0, 0.0, 0.0)
    for k in range(links):
        own = mb.rod(mass=1.0, length=1.0)
        link = m.body(f"link{k}", link, mb.Revolute(at=at, start=-1.0 if k == 0 else 0.01 * k), **own)
        at = (1.0, 0.0, 0.0)
    first = m.bodies[1]
    motor = m.force("motor", mb.JointForce("-0.5 * v", uses={}), first)
    lag = m.lag("lag", first.angle(), time_constant=0.1, unit="rad")
    sensors = {
        "angle": first.angle(), "rate": first.angular_velocity("z"), "turn": first.acceleration(),
        "height": link.position("y"), "torque": motor.effort(), "filtered": lag.value(),
    }  # fmt: skip
    for name, sensor in sensors.items():
        m.output(name, sensor)
    known = {**sensors, "filtered": lag, "target": target}
    texts: dict[str, str] = {}
    while len(texts) < 6:
        text = random_text(random, list(known), 3)
        names = {name for name in known if name in text}
        if names:
            inner = m.expression(text, uses={name: known[name] for name in sorted(names)})
            texts[f"e{len(texts)}"] = text
            m.output(f"e{len(texts) - 1}", m.expression("2 * inner + 1", uses={"inner": inner}))
    result = mb.simulate(m, 0.05, solver="adams", tolerance=1e-5)
    values = {name: result[name] for name in sensors} | {"target": np.full(len(result.t), 0.7)}
    for name, text in texts.items():
        expected = 2.0 * eval(text, dict(FUNCTIONS), values) + 1.0
        np.testing.assert_allclose(result[name], expected, rtol=1e-12, atol=1e-12, err_msg=text)


@pytest.mark.parametrize(
    ("solver", "others"), [("adams", 0), ("ida", 0), ("radau", 0), ("adams", 60), ("ida", 60), ("esdirk", 60)]
)
def test_events_of_expressions_with_time_and_inputs_are_located(solver: str, others: int) -> None:
    """Closed forms: x = t meets t^2 / 2 + u at 2 (1 - 0.3) for u = 0.3 t; zeros of sin(7 t). A jump of the input across
    the position is no event; after it, u = -3, they meet at 1 + sqrt(7). Small models, and large ones of more carts.
    """
    m, body = cart(0.0)
    for k in range(others):
        m.body(f"other{k}", m.ground, mb.Translational(axis="x", nominal=1.0), mass=1.0)
    m.event("push", at=0.0, then=mb.Impulse(body, 2.0))
    target = mb.Input(name="target", unit="m", start=0.0)
    gap = m.expression("x - 0.5 * t * t - u", uses={"x": body.coordinate(), "u": target}, unit="m")
    m.event("meet", gap)
    m.event("clock", m.expression("sin(7 * t)"), within=0.2)
    result = mb.simulate(m, 2.5, solver=solver, tolerance=1e-9, inputs={"target": "0.3 * t"})
    times = {name: [e.time for e in result.events if e.name == name] for name in ("meet", "clock")}
    np.testing.assert_allclose(times["meet"], [1.4], atol=1e-7)
    np.testing.assert_allclose(times["clock"], np.pi / 7.0 * np.arange(1, 6), atol=1e-9)
    simulation = Simulation(m, Settings(solver=solver, tolerance=1e-9))
    simulation.advance(1.0)
    for value, end in ((0.7, 1.2), (-3.0, 4.0)):  # the gap jumps from 0.5 to -0.2, and back
        simulation.set_input("target", value)
        simulation.advance(end)
    found = [e.time for e in simulation.events if e.name == "meet"]
    np.testing.assert_allclose(found, [1.0 + np.sqrt(7.0)], atol=1e-7)


def test_events_of_expressions_are_located() -> None:
    """x = cos t, v = -sin t: x v = -sin(2 t) / 2 falls through -1/4 at pi / 12 + k pi."""
    m, body = cart(1.0)
    m.force("spring", mb.JointSpring(stiffness=2.0), body)
    product = m.expression("x * v", uses={"x": body.coordinate(), "v": body.rate()}, unit="m2/s")
    m.event("falls", product, crosses=-0.25, direction="down")
    result = mb.simulate(m, 7.0, solver="adams", tolerance=1e-10)
    np.testing.assert_allclose([e.time for e in result.events], np.pi / 12.0 + np.arange(3) * np.pi, atol=1e-7)


def test_events_accept_blocks_and_states_by_their_handles() -> None:
    m, _ = cart(1.0)
    m.event("block", m.limiter("half", mb.Polynomial((0.0, 0.5)), lower=0.0, upper=0.4), crosses=0.2)
    m.event("state", m.state("clock", "1.0"), crosses=0.7)
    result = mb.simulate(m, 1.0, solver="adams")
    assert [event.name for event in result.events] == ["block", "state"]
    np.testing.assert_allclose([event.time for event in result.events], [0.4, 0.7], atol=1e-9)


@pytest.mark.parametrize("way", ["magnitude", "uses", "block"])
def test_laws_and_blocks_use_expressions(way: str) -> None:
    """A spring towards an input: x = 0.5 (1 - cos(2 t)) with k = 8 N/m and 2 kg."""
    m, body = cart()
    uses = {"k": 8.0, "target": mb.Input(name="target", unit="m", start=0.5), "x": body.coordinate()}
    pull = m.expression("k * (target - x)", uses=uses, unit="N")
    if way == "magnitude":
        law = mb.JointForce(pull)
    elif way == "uses":
        law = mb.JointForce("pull + 0 * t", uses={"pull": pull})
    else:
        law = mb.JointForce(m.limiter("limited", pull, lower=-100.0, upper=100.0, unit="N"))
    m.force("spring", law, body)
    m.output("x", body.coordinate())
    result = mb.simulate(m, 2.0, solver="adams", tolerance=1e-9)
    np.testing.assert_allclose(result["x"], 0.5 * (1.0 - np.cos(2.0 * result.t)), atol=1e-7)


def long_text(first: int) -> str:
    """Return an expression of x and w that is so long that compiled code calls it and does not contain it."""
    return " + ".join(f"0.1 * sin({first + k} * x) * exp(-(w**2) / {first + k})" for k in range(1, 60))


def test_long_laws_with_the_same_arguments_are_not_mistaken_for_each_other() -> None:
    m = mb.Mechanism(gravity=(0.0, 0.0, 0.0))
    for first in (1, 20):
        body = m.body(f"cart{first}", m.ground, mb.Translational(axis="x", start=0.3, nominal=1.0), mass=2.0)
        uses = {"x": body.coordinate(), "w": body.rate()}
        force = m.force(f"force{first}", mb.JointForce(long_text(first), uses=uses), body)
        for name, sensor in (("x", body.coordinate()), ("w", body.rate()), ("force", force.effort())):
            m.output(f"{name}{first}", sensor)
        m.output(f"seen{first}", m.expression(long_text(first), uses=uses, unit="N"))
    result = mb.simulate(m, 0.5, solver="adams")
    for first in (1, 20):
        expected = eval(long_text(first), dict(FUNCTIONS), {name: result[f"{name}{first}"] for name in ("x", "w")})
        for name in ("force", "seen"):
            np.testing.assert_allclose(result[f"{name}{first}"], expected, rtol=1e-12, atol=1e-12)


def test_native_exports_have_derivatives_of_functions_and_expressions() -> None:
    m, body = cart()
    m.force("pull", mb.JointForce("-k * q", uses={"k": 8.0}), body)
    m.state("lag", "x - z", uses={"x": body.coordinate()})
    m.output("twice", m.expression("2 * x", uses={"x": body.coordinate()}))
    m.force("drag", mb.JointForce(m.expression("-v", uses={"v": body.rate()})), body)
    assert not describe_real_kernels(CompiledMechanism(m))


def test_inputs_in_which_a_model_is_not_linear_are_known() -> None:
    """Those of laws, blocks and frictions; forces are linear in their magnitudes, also in parts of a sum."""
    m, body = cart()
    inputs = {name: mb.Input(name=name, unit="N") for name in ("force", "part", "law", "block", "normal", "seen")}
    m.force("force", mb.JointForce(inputs["force"]), body)
    m.force("sum", mb.JointForce(mb.Sum(inputs["part"], mb.Harmonic(amplitude=1.0, frequency=1.0))), body)
    m.force("law", mb.JointForce("F * abs(F)", uses={"F": inputs["law"]}), body)
    m.force("block", mb.JointForce(m.limiter("limited", inputs["block"], lower=-1.0, upper=1.0, unit="N")), body)
    m.force("brake", mb.JointFriction(coulomb=0.3, normal_force=inputs["normal"]), body)
    m.output("seen", m.expression("2 * F", uses={"F": inputs["seen"]}))
    compiled = CompiledMechanism(m)
    known = [compiled.inputs.variables[k].name for k in compiled.nonlinear_inputs()]
    assert sorted(known) == ["block", "law", "normal", "seen"]


@pytest.mark.parametrize(
    ("declare", "message"),
    [
        (
            lambda m, body: mb.JointForce("k*(target - crank.angle)"),
            r"""contains 'crank.angle'; names in expressions have no dots. Give other quantities with `uses`: """
            r""""k * (target - crank_angle)", uses={'crank_angle': crank.angle(), 'k': ..., 'target': ...}""",
        ),
        (lambda m, body: mb.JointForce("gain * q"), """'gain' is not known; allowed: t, q, v, sin"""),
        (
            lambda m, body: mb.LineForce(magnitude="k * rope.length"),
            """magnitude of a LineForce is 'k * rope.length', which contains 'rope.length'; names""",
        ),
        (lambda m, body: mb.Torque(magnitude="c * (sin(t) + drum)"), """{'c': ..., 'drum': ...}"""),
        (lambda m, body: m.expression("cart.rate()"), """"cart_rate", uses={'cart_rate': cart.rate()}"""),
        (lambda m, body: m.expression("x", uses={"x": body.rate(), "y": 1.0}), "has 'y', which the law does not"),
        (lambda m, body: m.expression("x", uses={"x": cart()[1].rate()}), "which is not a body of this mechanism"),
        (lambda m, body: m.expression("x", uses="x"), "is 'x'; allowed: quantities by names such as 'angle'"),
        (lambda m, body: m.expression("2 * t", unit="foo"), "unit is 'foo'"),
        (
            lambda m, body: m.event("e", m.expression("t + a", uses={"a": body.acceleration()})),
            "Expression, whose value depends on forces or",
        ),
        (
            lambda m, body: mb.JointForce(m.expression("2 * a", uses={"a": body.acceleration()})),
            "Expression, whose value depends on forces or",
        ),
    ],
)  # fmt: skip
def test_what_an_expression_cannot_contain_is_refused(declare: Callable[..., Any], message: str) -> None:
    m, body = cart()
    with pytest.raises(UserError) as error:
        declare(m, body)
    assert message in str(error.value)
