"""Natural modes of flexible bodies: frequencies and shapes against closed forms, and what the command shows."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from examples.spinning_arm import SpinningArm
from fmus.fourbar import FourBar
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.steady.equilibrium import equilibrium
from mbfmu.steady.state import Equilibrium
from mbfmu.viewer.drawing import draw
from mbfmu.viewer.mode_shapes import displacements

DOWN = {"crank": -1.5, "coupler": 1.5, "rocker": -1.5}


@pytest.fixture(scope="module")
def hanging() -> Equilibrium:
    return equilibrium(FourBar(coupler_modes=2), DOWN)


def test_hanging_fourbar_swings_as_a_pendulum_and_its_coupler_as_a_pinned_beam(hanging: Equilibrium) -> None:
    m = FourBar()
    bars = m.crank_mass + m.rocker_mass
    swing = np.sqrt((0.5 * bars + m.coupler_mass) * m.gravity / (bars / 3.0 + m.coupler_mass) / m.crank_length)
    stiffness = m.youngs_modulus * m.coupler_width * m.coupler_height**3 / 12.0
    beam = [(k * np.pi) ** 2 * np.sqrt(stiffness / (m.coupler_mass * m.coupler_length**3)) for k in (1, 2)]
    frequencies = [mode.frequency for mode in hanging.modes]
    assert frequencies[0] == pytest.approx(swing, rel=1e-9)
    assert frequencies[1:] == pytest.approx(beam, rel=2e-4)  # ten elements
    assert hanging.stability == "undamped"


def test_shapes_are_sines_and_keep_the_loop_closed(hanging: Equilibrium) -> None:
    shapes = hanging.shapes(8)
    assert [shape.mode for shape in shapes] == hanging.modes
    compiled = hanging.compiled
    terms = compiled.system.allocate_terms()
    compiled.system.fill(0.0, hanging.q, hanging.v, terms)
    (bar,) = draw(compiled.mechanism, 0.0).bars
    moved = []
    for shape in shapes:
        size = np.abs(shape.motion).max()
        assert np.abs(terms.J @ shape.motion).max() < 1e-10 * size
        phase = np.exp(-1j * np.angle(shape.motion[np.argmax(np.abs(shape.motion))]))
        moved.append(displacements(compiled, hanging.q, (phase * shape.motion).real, bar))
    x = np.array(bar.x) / 3.0
    swing, first, second = moved
    assert np.ptp(swing[:, 0]) < 1e-6 * np.abs(swing[:, 0]).max()
    assert np.abs(swing[:, 1]).max() < 1e-6 * np.abs(swing[:, 0]).max()
    for k, bending in ((1, first[:, 1]), (2, second[:, 1])):
        sine = np.sin(k * np.pi * x)
        cubic = (k * np.pi * 0.1) ** 4 / 384.0  # error of Hermite's cubics on ten elements
        assert bending / (bending @ sine / (sine @ sine)) == pytest.approx(sine, abs=cubic)


@pytest.mark.parametrize(("eta", "flap"), [(0.0, 3.5160), (3.0, 4.7973), (6.0, 7.3604)])
def test_rotating_cantilever(eta: float, flap: float) -> None:
    """Flapping frequencies of Wright, Smith, Thresher and Wang (1982); in the plane of rotation eta^2 less."""
    arm = SpinningArm(modes=6)
    unit = np.sqrt(arm.bending_stiffness / (arm.mass * arm.length**3))
    found = equilibrium(SpinningArm(modes=6, speed=eta * unit))
    assert found.modes[0].frequency / unit == pytest.approx(np.sqrt(flap**2 - eta**2), rel=2e-4)


def test_arm_that_does_not_stiffen_is_unstable_at_full_speed() -> None:
    assert equilibrium(SpinningArm(stiffening=False)).stability == "unstable"


def test_run_starts_in_the_state_before_a_run_up() -> None:
    """An arm at rest without gravity is straight."""
    simulation = Simulation(SpinningArm(), Settings(start_at_equilibrium=True))
    np.testing.assert_allclose(simulation.start[0], 0.0, atol=1e-12)


def test_command_draws_beams(command: Any, tmp_path: Path) -> None:
    start = [f"--from={name}={value}" for name, value in DOWN.items()]
    code, out, _ = command("modes", "fourbar", "--set=coupler_modes=2", *start, "-o", str(tmp_path))
    assert code == 0
    assert "0.520654" in out
    assert "unstable" not in out
    assert re.search(r"^0 ± 3\.27136i +3\.27136 +0\.520654 +3\.27136 +0$", out, re.MULTILINE), "nothing damps it"
    assert (tmp_path / "fourbar" / "default-modes" / "shapes.png").stat().st_size > 10_000
    code, out, _ = command("modes", "fourbar", "--set=coupler_modes=1", "-n=2", "-o", str(tmp_path))
    assert code == 0
    assert "--from COORDINATE=VALUE starts next to another" in out
