"""How modes and the stability of states are shown: both frequencies, and the same words in tables and pictures."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.plotting import steady_states
from mbfmu.steady.linear import modes_as_text
from mbfmu.steady.sweep import Branch

K, C, MASS = 100.0, 6.0, 2.0


def oscillator(damping: float = C) -> mb.Mechanism:
    m = mb.Mechanism()
    body = m.body("b", m.ground, mb.Translational(axis="x"), mass=MASS)
    m.force("k", mb.JointSpring(stiffness=K, damping=damping), body)
    m.output("x", body.coordinate())
    return m


def test_both_frequencies_of_a_damped_oscillator() -> None:
    """sqrt(k / m), sqrt(k / m - (c / 2 m)^2), c / 2 sqrt(k m)."""
    (shape,) = mb.modes(oscillator())
    natural, damped, ratio = np.sqrt(K / MASS), np.sqrt(K / MASS - (C / (2 * MASS)) ** 2), C / (2 * np.sqrt(K * MASS))
    assert shape.mode.natural_frequency == pytest.approx(natural)
    assert shape.mode.frequency == pytest.approx(damped)
    assert shape.mode.damping_ratio == pytest.approx(ratio)
    text = modes_as_text([shape.mode])
    for word in ("damped frequency |Im s|", "natural frequency |s|", f"{natural:.6g}", f"{damped:.6g}", f"{ratio:.4g}"):
        assert word in text


def test_pictures_have_the_terms_of_the_table(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    labels: list[str] = []

    def note(figure: Any, path: Path) -> None:
        labels.extend(text.get_text() for text in figure.axes[0].get_legend().get_texts())

    monkeypatch.setattr(steady_states, "finish", note)
    states = [mb.equilibrium(oscillator(damping)) for damping in (0.0, C)]
    assert [state.stability for state in states] == ["undamped", "stable"]
    steady_states.plot_branches([Branch([0.0, C], states)], "damping", "x", "title", tmp_path / "x.png")
    assert sorted(labels) == ["stable", "undamped"]
