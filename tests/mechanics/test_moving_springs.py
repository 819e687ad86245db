"""Springs whose free length is a signal, against the closed form of an oscillator whose support moves."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism, Mechanism
from mbfmu.util.errors import UserError
from solvers import Options, stepper

MASS, STIFFNESS, AMPLITUDE, FREQUENCY, LENGTH = 2.0, 50.0, 0.1, 0.5, 1.0


def oscillator(kind: str, free: Any) -> Mechanism:
    """A mass on a spring between points, or on a spring of its joint."""
    m = Mechanism()
    slider = m.body("slider", m.ground, mb.Translational(axis="x", start=LENGTH, fixed=True), mass=MASS)
    springs = {"Spring": mb.Spring, "JointSpring": mb.JointSpring}
    m.force("spring", springs[kind](stiffness=STIFFNESS, free=free), slider)
    m.output("x", slider.coordinate())
    return m


@pytest.mark.parametrize("kind", ["Spring", "JointSpring"])
@pytest.mark.parametrize("solver", ["adams", "ida"])
def test_mass_follows_the_free_length_as_its_closed_form(kind: str, solver: str) -> None:
    """x'' = w^2 (L + a sin(W t) - x) from rest at L."""
    free = mb.Harmonic(amplitude=AMPLITUDE, frequency=FREQUENCY, mean=LENGTH)
    compiled = CompiledMechanism(oscillator(kind, free))
    run = stepper(solver, compiled.system, 0.0, *compiled.assemble(), Options(rtol=1e-9))
    w, W, t = np.sqrt(STIFFNESS / MASS), 2.0 * np.pi * FREQUENCY, 1.3
    factor = AMPLITUDE * w**2 / (w**2 - W**2)
    assert run.advance(t).ok
    rate = factor * W * (np.cos(W * t) - np.cos(w * t))
    assert run.q[0] == pytest.approx(LENGTH + factor * (np.sin(W * t) - W / w * np.sin(w * t)), abs=1e-7)
    assert run.v[0] == pytest.approx(rate, abs=1e-6)
    assert run.energy_account[0] == pytest.approx(0.5 * MASS * rate**2, abs=1e-6)  # the work of the spring


def test_free_length_may_be_an_input_and_the_stiffness_a_table() -> None:
    table = mb.Table([-1.0, 0.0, 0.5], [-50.0, 0.0, 100.0], "linear")
    m = Mechanism(gravity=(-10.0, 0.0, 0.0))
    slider = m.body("slider", m.ground, mb.Translational(axis="x", start=1.0), mass=MASS)
    m.force(
        "spring", mb.JointSpring(stiffness=table, damping=1.0, free=mb.Input(name="free", unit="m", start=1.5)), slider
    )
    found = mb.equilibrium(m)
    assert found.positions()["slider"] == pytest.approx(1.1, abs=1e-9)  # 20 N compress it by 0.4 m


def test_coincident_ends_of_a_spring_with_a_signal_are_reported() -> None:
    m = Mechanism()
    slider = m.body("slider", m.ground, mb.Translational(axis="x", start=0.0, fixed=True), mass=MASS)
    m.force("spring", mb.Spring(stiffness=STIFFNESS, free="0.1 * sin(t)"), slider)
    texts = [found.text for found in mb.Simulation(m, mb.Settings(solver="adams")).diagnostics]
    assert any("but its free length is a signal: its elastic force" in text for text in texts)


@pytest.mark.parametrize(
    ("spring", "message"),
    [
        (lambda: mb.JointSpring(stiffness="3 * x", free="sin(t)"), "allowed: one of the two"),
        (lambda: mb.JointSpring(stiffness=1.0, free=np.nan), "free of force 'spring' is nan"),
        (lambda: mb.JointSpring(stiffness=1.0, free=[1.0]), "free of force 'spring' is"),
    ],
)
def test_wrong_free_lengths_are_refused(spring: Any, message: str) -> None:
    m = Mechanism()
    slider = m.body("slider", m.ground, mb.Translational(), mass=1.0)
    with pytest.raises(UserError, match=message):
        m.force("spring", spring(), slider)
