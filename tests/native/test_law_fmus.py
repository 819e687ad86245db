"""Laws in FMUs: expressions of sensors, force laws with inputs, tables, noise and first-order states.

References are closed forms, central differences of the functions of the FMU, and the state matrices of ``linearize``.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from binding import Binary
from fmpy import read_model_description, simulate_fmu
from importer import importing
from linear_importer import Linear, on_the_constraints, relative_errors

import mbfmu as mb
from mbfmu.fmi.export import export

needs_compiler = pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="needs a C compiler")
SETTINGS = mb.Settings(solver="adams", tolerance=1e-8)
MASS, GAIN, G = 2.0, 8.0, 9.81
NOISE = mb.Noise(density=lambda f: 1e-2 / f, lowest=0.5, highest=2.0, period=2.0, seed=3)


@dataclass(frozen=True, kw_only=True)
class LawCart(mb.Model):
    """A cart on a spring towards an input, and a second one that a table and noise move; no gravity."""

    gain: float = mb.parameter(GAIN, unit="N/m", min=1.0, doc="Stiffness of the law")
    size: float = mb.parameter(1.0, unit="m", min=1e-9, doc="Change of the target over which a law changes")

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0.0, 0.0, 0.0))
        cart = m.body("cart", m.ground, mb.Translational(axis="x", nominal=1.0), mass=MASS)
        target = mb.Input(name="target", unit="m", start=0.5)
        uses = {"k": self.gain, "target": target, "x": cart.coordinate()}
        pull = m.expression("k * (target - x)", uses=uses, unit="N")
        spring = m.force("spring", mb.JointForce("pull + 0 * v", uses={"pull": pull}), cart)
        m.output("x", cart.coordinate())
        m.output("power", m.expression("F * v", uses={"F": spring.effort(), "v": cart.rate()}, unit="W"))
        lagged = m.state("lagged", "(target**2 - z) / 0.5", uses={"target": target}, unit="m2")
        m.output("lagged", lagged.value())
        m.state("bump", "exp(-((target / size) ** 2)) - z", uses={"target": target, "size": self.size})
        other = m.body("other", m.ground, mb.Translational(axis="x", nominal=1.0), mass=MASS)
        table = mb.Table([0.0, 1.0, 2.0], [0.0, 3.0, 3.0], kind="linear")
        m.force("table", mb.JointForce("2 * F + w", uses={"F": table, "w": NOISE}), other)
        m.output("force", m.expression("2 * F + w", uses={"F": table, "w": NOISE}, unit="N"))
        m.output("rate", other.rate())
        braked = m.body("braked", m.ground, mb.Translational(axis="x", rate=1.0, nominal=1.0), mass=MASS)
        pressing = mb.Input(name="pressing", unit="N", start=1.0)
        m.force("brake", mb.JointFriction(coulomb=0.3, normal_force=pressing, deflection=0.5), braked)
        product = m.expression("x * v", uses={"x": cart.coordinate(), "v": cart.rate()}, unit="m2/s")
        m.event("falls", product, direction="down", then=mb.SetInput("target", 0.0))
        return m


def expected(t: Any, gain: float = GAIN) -> dict[str, Any]:
    """x = (1 - cos w t) / 2 until v = 0 at pi / w, where the target becomes 0: then x = -cos(w t)."""
    w = np.sqrt(gain / MASS)
    before, at = t < np.pi / w, np.pi / w
    x = np.where(before, 0.5 * (1.0 - np.cos(w * t)), -np.cos(w * t))
    v = np.where(before, 0.5 * w * np.sin(w * t), w * np.sin(w * t))
    force = gain * (np.where(before, 0.5, 0.0) - x)
    first = 0.25 * (1.0 - np.exp(-2.0 * t))
    lagged = np.where(before, first, 0.25 * (1.0 - np.exp(-2.0 * at)) * np.exp(-2.0 * (t - at)))
    return {"x": x, "power": force * v, "lagged": lagged}


def given_force(t: Any) -> Any:
    """Return the force of the table and the noise: cosines at 0.5, 1, 1.5 and 2 Hz with the density 1e-2 / f."""
    frequencies = np.array([0.5, 1.0, 1.5, 2.0])
    phases = np.random.default_rng(3).uniform(0.0, 2.0 * np.pi, 4)
    cosines = np.sqrt(2.0 * 1e-2 / frequencies / 2.0) * np.cos(2.0 * np.pi * np.outer(t, frequencies) + phases)
    return 2.0 * np.interp(t, [0.0, 1.0, 2.0], [0.0, 3.0, 3.0]) + cosines.sum(axis=1)


@pytest.fixture(scope="module")
def native(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(LawCart(), tmp_path_factory.mktemp("laws") / "cart.fmu", SETTINGS, native=True)


def assert_cart_moves(path: Path, kind: str, values: dict[str, float]) -> None:
    found = simulate_fmu(
        str(path), stop_time=3.0, output_interval=0.05, start_values=values, fmi_type=kind, relative_tolerance=1e-8
    )
    bound = 5e-6 if kind == "ModelExchange" else 5e-7
    for name, row in expected(found["time"], **values).items():
        assert found[name] == pytest.approx(row, abs=bound * np.abs(row).max()), name
    assert found["force"] == pytest.approx(given_force(found["time"]), abs=1e-10)
    force = given_force(np.linspace(0.0, 3.0, 30001))
    assert found["rate"][-1] == pytest.approx(np.trapezoid(force, dx=1e-4) / MASS, rel=bound)


@needs_compiler
@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
def test_laws_in_native_fmus_move_as_in_closed_form(native: Path, kind: str) -> None:
    assert_cart_moves(native, kind, {"gain": 18.0} if kind == "ModelExchange" else {})


def test_laws_in_fmus_that_call_python_move_as_in_closed_form(tmp_path: Path) -> None:
    assert_cart_moves(export(LawCart(), tmp_path / "cart.fmu", SETTINGS, native=False), "CoSimulation", {"gain": 18.0})


@needs_compiler
def test_derivatives_of_laws_are_those_of_the_functions(native: Path) -> None:
    """By states, and by inputs in which laws and frictions are not linear."""
    with importing(Binary(native, native.parent / "unpacked")) as own:
        own.start()
        linear, rng = Linear(own), np.random.default_rng(1)
        described = read_model_description(str(native)).derivatives
        lagged = [v.variable.name for v in described].index("der(state.value.lagged)")
        for values in ({"target": 0.7, "pressing": 2.0}, {"target": -1.3, "pressing": 0.5}):
            x = own.states() + 0.1 * rng.normal(size=own.count)
            u = np.array([values[name] for name in linear.input_names])
            linear.evaluate(0.3, x, u)
            found = linear.matrix()
            differences = linear.differences(0.3, x, u, np.full(len(x) + len(u), 2e-3))
            known = np.isfinite(differences).all(axis=1)
            assert relative_errors(found[known], differences[known]).max() < 1e-8
            by_target = found[lagged, own.count + linear.input_names.index("target")]
            assert by_target == pytest.approx(4.0 * values["target"], rel=1e-11)  # of (target^2 - z) / 0.5


@needs_compiler
@pytest.mark.parametrize("size", [1e-6, 1e-3, 1.0, 1e3, 1e6])
def test_derivatives_by_inputs_are_right_at_every_size(native: Path, size: float) -> None:
    names = [v.variable.name for v in read_model_description(str(native)).derivatives]
    with importing(Binary(native, native.parent / f"{size}")) as own:
        own.start(values={"size": size})
        linear, x = Linear(own), own.states()
        for part in (-2.0, -0.3, 0.7, 1.1, 2.5):
            u = np.array([{"target": part * size, "pressing": 1.0}[name] for name in linear.input_names])
            linear.evaluate(0.0, x, u)
            found = linear.matrix()[
                names.index("der(state.value.bump)"), own.count + linear.input_names.index("target")
            ]
            assert found * size == pytest.approx(-2.0 * part * np.exp(-(part**2)), rel=1e-8)


@dataclass(frozen=True, kw_only=True)
class AllLaws(mb.Model):
    """A pendulum on a cart, with a law in every element that takes one."""

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0.0, -G, 0.0))
        cart = m.body("cart", m.ground, mb.Translational(axis="x", start=0.2, rate=0.3, nominal=1.0), mass=MASS)
        arm = m.body("arm", cart, mb.Revolute(start=0.4, rate=0.5), **mb.rod(mass=1.0, length=0.8))
        wheel = m.body("wheel", m.ground, mb.Revolute(at=(0.0, 2.0, 0.0), start=0.1), mass=1.0, inertia=(0.1, 0.1, 0.1))
        slide = m.body("slide", m.ground, mb.Translational(axis="y", at=(1.0, 2.0, 0.0)), mass=0.7)
        m.couple("cam", mb.Cam("0.2 * sin(q)", width=0.5), slide, wheel)
        ends: dict[str, Any] = {"at_a": (0.0, 1.5, 0.0), "at_b": (0.8, 0.0, 0.0)}
        free = mb.Input(name="free", unit="m", start=1.0)
        use = {"p": mb.Input(name="pressure", unit="Pa", start=0.6), "a": arm.angle()}
        m.force("spring", mb.Spring(stiffness="30 * x + 9 * x**3", damping=0.2, **ends), m.ground, arm)
        m.force(
            "servo", mb.JointSpring(stiffness=mb.Table([-1.0, 0.0, 1.0], [-9.0, 0.0, 7.0], "spline"), free=free), arm
        )
        m.force("damper", mb.Damper(damping="0.5 * v + v * abs(v)", **ends), m.ground, arm)
        m.force("joint spring", mb.JointSpring(stiffness="4 * x + sin(x)", damping=0.1), arm)
        m.force("joint damper", mb.JointDamper(damping="0.3 * v**3"), arm)
        m.force(
            "table", mb.JointSpring(stiffness=mb.Table([-1.0, 0.0, 0.5, 1.0], [-9.0, 0.0, 1.0, 7.0], "spline")), arm
        )
        m.force("actuator", mb.LineForce(magnitude="p**2 * x - 0.3 * v", uses={"p": use["p"]}, **ends), m.ground, arm)
        m.force("point", mb.PointForce(magnitude="p * cos(a)", uses=use, axis="y", at_a=(0.8, 0.0, 0.0)), arm)
        m.force("torque", mb.Torque(magnitude="sqrt(p) + a**2", uses=use, axis="z"), arm)
        pressed = {"normal_force": "5 + p * a", "uses": use, "deflection": 0.5}
        m.force("friction", mb.JointFriction(coulomb=0.3, **pressed), cart)
        m.force("plain", mb.JointForce("-0.2 * v * abs(v) + cos(q)"), wheel)
        m.output("angle", arm.angle())
        m.output("load", m.expression("F * a", uses={"F": cart.joint_force("y"), "a": use["a"]}))
        return m


@needs_compiler
def test_derivatives_of_laws_of_all_elements_are_those_of_the_functions(tmp_path: Path) -> None:
    path = export(AllLaws(), tmp_path / "all.fmu", SETTINGS, native=True)
    with importing(Binary(path, tmp_path / "unpacked")) as own:
        own.start()
        linear = Linear(own)
        x, u = on_the_constraints(own, 0.05), np.array([{"free": 0.9, "pressure": 0.7}[n] for n in linear.input_names])
        linear.evaluate(0.0, x, u)
        found, differences = linear.matrix(), linear.differences(0.0, x, u, np.full(len(x) + len(u), 2e-3))
        known = np.isfinite(differences).all(axis=1)
        assert known.sum() > own.count
        assert relative_errors(found[known], differences[known]).max() < 1e-8


# ---- steady states --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class RegulatedArm(mb.Model):
    """An arm that a controller with a sensor and an integral holds against its weight and a jet with a valve."""

    gain: float = mb.parameter(60.0, unit="N.m", min=1.0, doc="Gain of the integral")
    mass: float = mb.parameter(1.0, unit="kg", min=0.1, doc="Mass of the arm")

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0.0, -G, 0.0))
        arm = m.body("arm", m.ground, mb.Revolute(start=0.3), **mb.rod(mass=self.mass, length=1.0))
        target = mb.Input(name="target", unit="rad", start=0.5)
        sensor = m.state("sensor", "(a - z) / 0.05", uses={"a": arm.angle()}, unit="rad")
        integral = m.state("integral", "target - x", uses={"target": target, "x": sensor}, unit="rad.s")
        uses = {"i": integral, "x": sensor, "target": target, "ki": self.gain}
        text = "30 * sin(target - x) + ki * i - 6 * v - 0.1 * v * abs(v)"
        motor = m.force("motor", mb.JointForce(text, uses=uses), arm)
        valve = m.limiter("valve", mb.Input(name="opening", unit="1", start=0.4), lower=-0.5, upper=0.5)
        m.force("jet", mb.JointForce("2 * p * p", uses={"p": valve}), arm)
        m.output("angle", arm.angle())
        m.output("integral", integral.value())
        m.output("torque", motor.effort())
        m.output("sine", m.expression("sin(2 * a)", uses={"a": arm.angle()}))
        return m


@pytest.fixture(scope="module")
def steady(tmp_path_factory: pytest.TempPathFactory) -> Path:
    settings = mb.Settings(solver="adams", start_at_equilibrium=True)
    return export(RegulatedArm(), tmp_path_factory.mktemp("steady") / "arm.fmu", settings, native=True)


@needs_compiler
@pytest.mark.parametrize(
    "values", [{}, {"target": 0.9, "gain": 20.0}, {"opening": 0.3, "mass": 2.0}, {"opening": 0.7, "target": -0.2}]
)
def test_the_steady_state_of_a_controller_is_that_of_the_values_set(steady: Path, values: dict[str, float]) -> None:
    known = {"target": 0.5, "opening": 0.4, "gain": 60.0, "mass": 1.0} | values
    jet = 2.0 * min(known["opening"], 0.5) ** 2
    torque = known["mass"] * G * 0.5 * np.cos(known["target"]) - jet
    wanted = [known["target"], torque / known["gain"], torque, np.sin(2.0 * known["target"])]
    found = simulate_fmu(str(steady), stop_time=1.0, output_interval=1.0, start_values=values)
    for row, bound in ((0, 1e-9), (-1, 1e-5)):
        assert [found[name][row] for name in ("angle", "integral", "torque", "sine")] == pytest.approx(
            wanted, rel=bound
        )


@needs_compiler
def test_derivatives_in_the_steady_state_are_the_matrices_of_linearize(steady: Path) -> None:
    space = mb.equilibrium(RegulatedArm()).state_space
    expected = np.block([[space.A, space.B], [space.C, space.D]])
    assert list(space.inputs) == ["target", "opening"]
    for opening in (0.4, 0.7):  # within the limits of the valve, and beyond
        with importing(Binary(steady, steady.parent / f"{opening}")) as own:
            own.start()
            linear, x = Linear(own), own.states()
            linear.evaluate(
                0.0, x, np.array([{"target": 0.5, "opening": opening}[name] for name in linear.input_names])
            )
            found = linear.matrix()[: len(expected)]
        if opening > 0.5:
            k = len(x) + linear.input_names.index("opening")
            assert np.abs(found[:, k]).max() < 1e-12
            found[:, k] = expected[:, k]
        assert relative_errors(found, expected).max() < 1e-9
