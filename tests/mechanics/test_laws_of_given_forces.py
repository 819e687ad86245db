"""Given forces on bodies whose magnitude is a law, a state, a block or a sensor, against SciPy and closed forms."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism
from mbfmu.util.errors import UserError

Array = NDArray[np.float64]
MASS, CENTER, INERTIA, GRAVITY = 80.0, 1.2, 30.0, 9.81  # of the boom: kg, m, kg m2 about its center; m/s2
FOOT, EYE = (0.5, -0.8), (0.9, 0.1)  # pins of the cylinder on the ground and on the boom, m
PINS = {"at_a": (*FOOT, 0), "at_b": (*EYE, 0)}


def length(angle: Any) -> Any:
    """Return the length of the cylinder, m."""
    c, s = np.cos(angle), np.sin(angle)
    return np.hypot(c * EYE[0] - s * EYE[1] - FOOT[0], s * EYE[0] + c * EYE[1] - FOOT[1])


def lever(angle: float, h: float = 1e-5) -> float:
    """Return the derivative of the length by the angle, m."""
    return float(length(angle + h) - length(angle - h)) / (2.0 * h)


@pytest.mark.parametrize("how", ["block", "law"])
def test_a_boom_with_a_controlled_cylinder_moves_as_by_scipy(how: str) -> None:
    m = mb.Mechanism(gravity=(0.0, -GRAVITY, 0.0))
    joint = mb.Revolute(start=0.4)
    arm = m.body("boom", m.ground, joint, mass=MASS, com=(CENTER, 0, 0), inertia=(0.0, INERTIA, INERTIA))
    gains = {"proportional": 2e4, "integral": 3e4}
    if how == "block":
        force = mb.LineForce(magnitude=m.pid("control", 0.7, arm.angle(), **gains), **PINS)
    else:
        error = m.state("error", "0.7 - q", uses={"q": arm.angle()}, nominal=0.1)
        uses = {"z": error, "q": arm.angle(), "p": gains["proportional"]}
        force = mb.LineForce(magnitude="p * (0.7 - q) + 3e4 * z", uses=uses, **PINS)
    m.force("cylinder", force, m.ground, arm)
    m.force("damping", mb.LineForce(magnitude=lambda v: -6e3 * v, **PINS), m.ground, arm)
    m.output("angle", arm.angle())
    result = mb.simulate(m, 3.0, solver="radau", tolerance=1e-8)
    assert not result.warning

    def rates(t: float, y: Array) -> list[float]:
        arm_of_force = lever(y[0])
        push = 2e4 * (0.7 - y[0]) + 3e4 * y[2] - 6e3 * arm_of_force * y[1]
        moment = push * arm_of_force - MASS * GRAVITY * CENTER * np.cos(y[0])
        return [y[1], moment / (INERTIA + MASS * CENTER**2), 0.7 - y[0]]

    exact = solve_ivp(rates, (0.0, 3.0), [0.4, 0.0, 0.0], "DOP853", result.t, rtol=1e-11, atol=1e-12).y
    assert np.ptp(exact[0]) > 0.1
    np.testing.assert_allclose(result["angle"], exact[0], atol=3e-6)


@pytest.mark.parametrize("limits", [{}, {"lower": 0.1, "upper": 9.0, "stop_stiffness": 1.0}])
def test_laws_exert_the_force_of_a_number_with_their_value(limits: dict[str, float]) -> None:
    rng = np.random.default_rng(4)
    q, v, t = np.array((0.3, -0.7)), np.array((0.8, 0.5)), 0.6
    at_a, at_b = rng.normal(size=(2, 3))

    def forces(line: Any, point: Any, torque: Any) -> Array:
        m = mb.Mechanism()
        slide = m.body("slide", m.ground, mb.Translational(axis="y"), mass=0.5)
        arm = m.body("arm", slide, mb.Revolute(axis="x"), mass=1.0, com=(0, 0, 0.2), inertia=(0.2, 0.3, 0.1))
        y, w = slide.coordinate(), arm.rate()

        others = {"uses": {"y": y, "w": w}} if isinstance(line, str) else {}
        m.force("line", mb.LineForce(magnitude=line, at_a=at_a, at_b=at_b, **limits, **others), m.ground, arm)
        m.force("point", mb.PointForce(magnitude=w if point is None else point, at_a=at_b), arm)
        others = {"uses": {"y": y}} if isinstance(torque, str) else {}
        m.force("torque", mb.Torque(magnitude=torque, axis="x", fixed_in="body", **others), arm)
        compiled = CompiledMechanism(m)
        terms = compiled.system.allocate_terms()
        compiled.system.fill(t, q, v, terms)
        return np.array(terms.h)

    def end(q: Array) -> Array:
        c, s = np.cos(q[1]), np.sin(q[1])
        turned = np.array((at_b[0], c * at_b[1] - s * at_b[2], s * at_b[1] + c * at_b[2]))
        return np.asarray(turned + np.array((0.0, q[0], 0.0)) - at_a)

    h = 1e-6
    x = float(np.linalg.norm(end(q)))
    rate = float(np.linalg.norm(end(q + h * v)) - np.linalg.norm(end(q - h * v))) / (2.0 * h)
    by_laws = forces("x * v - 2 * w * y + t", None, "y * y - t")
    by_values = forces(x * rate - 2.0 * v[1] * q[0] + t, v[1], q[0] ** 2 - t)
    nothing = forces(0.0, 0.0, 0.0)
    assert np.abs(by_values - nothing).min() > 0.1
    np.testing.assert_allclose(by_laws, by_values, rtol=1e-8)


def test_a_law_of_the_length_has_the_steady_state_and_the_eigenvalues_of_a_spring() -> None:
    m = mb.Mechanism(gravity=(0.0, 0.0, -GRAVITY))
    body = m.body("body", m.ground, mb.Translational(axis="z", start=0.9), mass=2.0)
    m.output("z", body.coordinate())
    m.force("legs", mb.LineForce(magnitude="300 * (1 - x) - 5 * v"), m.ground, body)
    found = mb.equilibrium(m)
    height = 1.0 - 2.0 * GRAVITY / 300.0
    assert found.outputs["z"] == pytest.approx(height, rel=1e-9)
    values = np.linalg.eigvals(mb.linearize(m).A)
    np.testing.assert_allclose(np.sort_complex(values), np.sort_complex(np.roots([2.0, 5.0, 300.0])), rtol=1e-6)


@pytest.mark.parametrize("solver", ["esdirk", "ida"])
def test_large_models_with_laws_between_points_move_as_by_the_matrix_exponential(solver: str) -> None:
    """Sliders in a row, each pushed apart from the next by a law of the distance, and the last by its velocity."""
    n, k, c = 70, 400.0, 3.0
    m = mb.Mechanism()
    bodies = [
        m.body(f"b{i}", m.ground, mb.Translational(axis="x", at=(i, 0, 0), rate=0.1 * (i == 0)), mass=1.0)
        for i in range(n)
    ]
    for i in range(n - 1):
        m.force(f"f{i}", mb.LineForce(magnitude=f"{k} * (1 - x) - {c} * v"), bodies[i], bodies[i + 1])
    m.force("end", mb.PointForce(magnitude="-7 * w", uses={"w": bodies[-1].rate()}, axis="x"), bodies[-1])
    m.output("x", bodies[0].coordinate())
    result = mb.simulate(m, 1.0, solver=solver, tolerance=1e-7, interval=0.25)
    assert not result.warning
    K = np.diag(np.full(n - 1, -1.0), 1)
    K = K + K.T
    K -= np.diag(K.sum(axis=1))
    end = np.zeros((n, n))
    end[-1, -1] = 7.0
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-k * K, -c * K - end]])
    start = np.zeros(2 * n)
    start[n] = 0.1
    exact = [(expm(A * t) @ start)[0] for t in result.t]
    np.testing.assert_allclose(result["x"], exact, atol=1e-5)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (
            lambda s: mb.LineForce(magnitude="k * x"),
            "magnitude of a LineForce is 'k .*' is not known; allowed: t, x, v",
        ),
        (lambda s: mb.LineForce(magnitude=lambda x, speed: x), "argument 'speed'; allowed: 't', 'x', 'v'"),
        (lambda s: mb.Torque(magnitude=s, uses={"s": s}), "a Torque has uses, and its magnitude is no function"),
        (lambda s: mb.PointForce(magnitude="2 * t", uses={"s": s}), "has 's', which the law does not contain"),
        (lambda s: mb.LineForce(magnitude="x + s", uses={"s": s, "x": 1.0}), "name 'x', which means something else"),
    ],
)
def test_wrong_laws_are_refused(make: Callable[[Any], Any], said: str) -> None:
    m = mb.Mechanism()
    body = m.body("b", m.ground, mb.Translational(axis="x"), mass=1.0)
    with pytest.raises(UserError, match=said):
        make(body.coordinate())
