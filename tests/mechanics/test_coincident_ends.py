"""Springs whose ends coincide: the damper acts along the relative velocity, the elastic force has no direction."""

from typing import Any

import numpy as np
import pytest

import mbfmu as mb

K, C, MASS = 50.0, 4.0, 2.0


def held(axes: str, size: float = 1.0, others: int = 0, *, start: float = 0.0, rate: float = 0.0, **given: Any) -> Any:
    """A mass that slides along axes, on a spring from the origin that is unloaded at no length."""
    m, last = mb.Mechanism(), None
    for k, axis in enumerate(axes):
        mass = MASS if k == len(axes) - 1 else 0.0
        joint = mb.Translational(axis=axis, start=start, rate=rate)
        last = m.body(axis, last or m.ground, joint, mass=mass)
    assert last is not None
    m.force("s", mb.Spring(**{"stiffness": K, "damping": C, "free": 0.0, "at_a": (0, 0, 0)} | given), m.ground, last)
    for k in range(others):
        other = m.body(f"other{k}", m.ground, mb.Translational(axis="x", at=(size, 0, 0)), mass=MASS)
        m.force(f"o{k}", mb.JointSpring(stiffness=4.0 * K), other)
    m.output("x", last.position(axes[0]))
    return m


@pytest.mark.parametrize("axes", ["x", "y", "xy", "xyz"])
@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_the_damper_is_in_the_linearized_motion(axes: str, size: float) -> None:
    """-k / m and -c / m along every axis, as any small motion through the point has it; at other sizes too."""
    space, n = mb.linearize(held(axes, stiffness=K * size, damping=C * size)), len(axes)
    np.testing.assert_allclose(space.A[n:, :n], -K * size / MASS * np.eye(n), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(space.A[n:, n:], -C * size / MASS * np.eye(n), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("stiffness", [mb.Table([-1.0, 0.0, 1.0], [-K, 0.0, K], "linear"), "50 * x"])
def test_tables_and_functions_are_damped_too(stiffness: Any) -> None:
    space = mb.linearize(held("x", stiffness=stiffness))
    assert space.A[1, 1] == pytest.approx(-C / MASS)


def test_a_large_tree_loses_its_energy_there() -> None:
    """61 coordinates: the mode of the spring decays with c / 2 m, those next to it do not."""
    found = mb.modes(held("x", others=60), count=61)
    rates = np.sort([shape.mode.eigenvalue.real for shape in found])
    assert rates[0] == pytest.approx(-C / (2.0 * MASS), rel=1e-6)
    np.testing.assert_allclose(rates[1:], 0.0, atol=1e-9)


@pytest.mark.parametrize("solver", ["adams", "ida", "radau"])
def test_a_motion_from_the_point_is_the_closed_form(solver: str) -> None:
    w, d = K / MASS, C / (2.0 * MASS)
    found = mb.simulate(held("x", rate=1.0), 2.0, interval=0.05, solver=solver, tolerance=1e-8)
    damped = np.sqrt(w - d * d)
    np.testing.assert_allclose(found["x"], np.exp(-d * found.t) * np.sin(damped * found.t) / damped, atol=2e-6)
    assert not [d for d in found.diagnostics if d.code != "assumed-length"]
    assert not found.warning


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_an_elastic_force_without_direction_is_reported(size: float) -> None:
    m = held("x", free=0.3 * size)
    (told,) = [text for text in map(str, mb.simulate(m, 0.1, solver="adams").diagnostics) if "coincide" in text]
    assert "the ends of force 's' coincide" in told
    assert f"its free length is {0.3 * size:g} m" in told
    assert abs(mb.equilibrium(m).outputs["x"]) == pytest.approx(0.3 * size)  # where it is unloaded
    apart = held("x", start=1e-6 * size, free=0.3 * size)
    assert not [text for text in map(str, mb.simulate(apart, 0.1, solver="adams").diagnostics) if "coincide" in text]


def test_a_buffer_without_direction_is_reported() -> None:
    """And pushes nowhere, damped or not."""
    m = mb.Mechanism()
    body = m.body("b", m.ground, mb.Translational(axis="x"), mass=1.0)
    m.force("stop", mb.DistanceStop(lower=0.1, stiffness=10.0, damping=0.5), m.ground, body)
    m.output("x", body.coordinate())
    found = mb.simulate(m, 0.1, solver="adams")
    assert any(
        "the ends of force 'stop' coincide at the start, but its lower limit is 0.1 m" in text
        for text in map(str, found.diagnostics)
    )
    np.testing.assert_array_equal(found["x"], 0.0)
