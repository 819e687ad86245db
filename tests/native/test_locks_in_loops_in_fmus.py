"""Native FMUs whose events lock and release joints of loops, and joints with friction by their reactions."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import simulate_fmu

import mbfmu as mb
from mbfmu.fmi import Fmu
from mbfmu.fmi.export import export
from mbfmu.modeling.model import as_model

sys.path.insert(0, str(Path(__file__).parents[1] / "loops"))
from test_random_locks_in_loops import ERROR, GROWTH, RODS, SMALL, STOP_TIME, G, Loop

pytestmark = pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="needs a C compiler")
TOLERANCE = 1e-9
NAMES = [f"rod{k}" for k in range(RODS)]


def export_loop(loop: Loop, solver: str, folder: Path, copies: int = 1) -> Path:
    """Export ``copies`` loops, of which the first is locked."""
    m = mb.Mechanism(gravity=(0.0, -G * loop.scale, 0.0))
    for k in range(copies):
        loop.add_to(m, f"free{k}_" if k else "rod", k == 0)
    return export(as_model(m), folder / "loop.fmu", mb.Settings(solver=solver, tolerance=TOLERANCE), native=True)


def check(loop: Loop, path: Path, ways: tuple[tuple[str, float], ...], tolerance: float = TOLERANCE) -> None:
    """Compare runs of FMI types with output intervals (s) with SciPy in absolute coordinates."""
    for kind, interval in ways:
        rows = simulate_fmu(
            str(path), stop_time=STOP_TIME, output_interval=interval, output=NAMES, fmi_type=kind,
            relative_tolerance=1e-10 if kind == "ModelExchange" else None, record_events=False,
        )  # fmt: skip
        found = np.array([[row[name] for name in NAMES] for row in rows])
        expected, _ = loop.motion(rows["time"])
        allowed = ERROR * tolerance * np.exp(GROWTH * rows["time"])
        assert np.all(np.abs(found - expected).max(axis=1) <= allowed)


SEEDS = [pytest.param(seed, marks=() if seed in (0, 1) else pytest.mark.campaign) for seed in range(60)]


@pytest.mark.parametrize("seed", SEEDS)
def test_joints_of_a_random_loop_are_locked_and_released(seed: int, tmp_path: Path) -> None:
    """Against SciPy in absolute coordinates: steps of 0.05 s, one step, and model exchange."""
    loop = Loop.random(seed)
    path = export_loop(loop, SMALL[seed % len(SMALL)], tmp_path)
    check(loop, path, (("CoSimulation", 0.05), ("CoSimulation", STOP_TIME), ("ModelExchange", 0.05)))


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("solver", ["adams", "ida"])
def test_joints_of_one_of_many_loops_are_locked_and_released(solver: str, seed: int, tmp_path: Path) -> None:
    """Constraints are eliminated along the tree: 17 loops of 85 coordinates and 34 constraint equations."""
    loop = Loop.random(seed)
    path = export_loop(loop, solver, tmp_path, copies=17)
    check(loop, path, (("CoSimulation", 0.05), ("CoSimulation", STOP_TIME), ("ModelExchange", 0.05)))


@pytest.mark.campaign
@pytest.mark.parametrize("solver", ["adams", "ida"])
def test_states_with_locked_joints_of_many_loops_are_saved(solver: str, tmp_path: Path) -> None:
    """A state with locked joints leads to the same bits in two instances."""
    path = export_loop(Loop.random(0), solver, tmp_path, copies=17)
    with Fmu(path) as first, Fmu(path) as second:
        ends = []
        first.step(0.45)
        saved = first.save()
        for fmu in (first, second, first):
            fmu.restore(saved)
            fmu.t = 0.45
            fmu.step(0.3)
            ends.append(fmu.reals().tolist())
        assert ends[0] == ends[1] == ends[2]


def test_states_with_locked_joints_of_a_loop_are_saved(tmp_path: Path) -> None:
    """States before, between and after locks lead to the same bits in two instances."""
    path = export_loop(Loop.random(0), "adams", tmp_path)
    with Fmu(path) as first, Fmu(path) as second:
        states, reached = [], []
        for _ in range(8):
            states.append(first.save())
            first.step(0.1)
            reached.append(first.reals().tolist())
        second.step(0.8)
        for fmu in (second, first):
            for k in (4, 1, 7, 0):
                fmu.restore(states[k])
                fmu.t = 0.1 * k
                for i in range(k, 8):
                    fmu.step(0.1)
                    assert fmu.reals().tolist() == reached[i]


def geared(ratio: float) -> mb.Mechanism:
    """Two flywheels of 1 kg m^2 and 2 kg m^2 with a gear v_b = ratio v_a, and a flywheel of 3 kg m^2 on the second."""
    m = mb.Mechanism()
    first = m.body("first", m.ground, mb.Revolute(rate=6.0, fixed=True), inertia=(1.0, 1.0, 1.0))
    second = m.body("second", m.ground, mb.Revolute(rate=6.0 * ratio), inertia=(1.0, 1.0, 2.0))
    third = m.body("third", second, mb.Revolute(rate=-6.0 * ratio, fixed=True), inertia=(2.0, 2.0, 3.0))
    m.couple("gear", mb.Gear(ratio=1.0 / ratio), first, second)
    m.event("clutch", at=0.23, then=mb.Lock(third))
    m.event("brake", at=0.41, then=mb.Lock(first))
    m.event("again", at=0.52, then=mb.Lock(second))
    m.event("free", at=0.64, then=[mb.Release(first), mb.Release(second), mb.Impulse(first, 0.9)])
    for name, body in (("first", first), ("second", second), ("third", third)):
        m.output(name, body.rate())
    return m


@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
def test_geared_joints_are_locked_and_released(kind: str, tmp_path: Path) -> None:
    """Closed form: momentum seen from the first flywheel; the second one is locked while the gear holds it at rest."""
    m, ratio = geared(2.0), 2.0
    inertia = 1.0 + ratio**2 * (2.0 + 3.0)
    clutched = 6.0 * (1.0 + ratio**2 * 2.0) / inertia
    path = export(as_model(m), tmp_path / "gear.fmu", mb.Settings(solver="adams", tolerance=1e-8), native=True)
    rows = simulate_fmu(
        str(path), stop_time=1.0, output_interval=0.1, output=["first", "second", "third"], fmi_type=kind,
        record_events=False,
    )  # fmt: skip
    for row in rows:
        t = row["time"]
        rate = 6.0 if t < 0.23 else clutched if t < 0.41 else 0.0 if t < 0.64 else 0.9 / inertia
        third = -6.0 * ratio if t < 0.23 else 0.0
        np.testing.assert_allclose(
            [row["first"], row["second"], row["third"]], [rate, ratio * rate, third], rtol=0.0, atol=1e-7
        )


def carts() -> mb.Mechanism:
    """A cart with a second one on it, both with friction in proportion to the reactions of their guides."""
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    cart = m.body("cart", m.ground, mb.Translational(axis="x", rate=3.0), mass=2.0, inertia=(1.0, 1.0, 1.0))
    top = m.body("top", cart, mb.Translational(axis="x", rate=1.5), mass=1.0, inertia=(1.0, 1.0, 1.0))
    for name, coulomb, body in (("rail", 0.1, cart), ("guide", 0.3, top)):
        m.force(name, mb.JointFriction(coulomb=coulomb, normal_force=mb.Reaction(length=0.4)), body)
    m.event("lock", at=0.2, then=mb.Lock(top))
    m.event("go", at=0.5, then=[mb.Release(top), mb.Impulse(top, 0.7)])
    m.output("cart", cart.rate())
    m.output("top", top.rate())
    return m


@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
def test_joints_with_friction_by_reactions_are_locked(kind: str, tmp_path: Path) -> None:
    """Closed form: both slide with -mu g while locked; then the second pushes the first by its friction of 0.3 g m."""
    settings = mb.Settings(solver="radau", tolerance=1e-8)
    path = export(as_model(carts()), tmp_path / "carts.fmu", settings, native=True)
    rows = simulate_fmu(
        str(path), stop_time=0.6, output_interval=0.05, output=["cart", "top"], fmi_type=kind,
        relative_tolerance=1e-9, record_events=False,
    )  # fmt: skip
    at: dict[float, Any] = {round(float(row["time"]), 6): row for row in rows}
    assert at[0.45]["cart"] - at[0.25]["cart"] == pytest.approx(-0.1 * G * 0.2, abs=1e-7)
    assert [at[t]["top"] for t in (0.25, 0.45)] == pytest.approx([0.0, 0.0], abs=1e-12)
    pushed = (-0.1 * 3.0 * G + 0.3 * G) / 2.0
    assert at[0.6]["cart"] - at[0.55]["cart"] == pytest.approx(pushed * 0.05, abs=1e-7)
    assert at[0.6]["top"] - at[0.55]["top"] == pytest.approx((-0.3 * G - pushed) * 0.05, abs=1e-7)
    result = mb.simulate(carts(), 0.6, interval=0.05, solver="radau", tolerance=1e-8)
    np.testing.assert_allclose(rows["cart"][:13], result["cart"], rtol=0.0, atol=1e-6)
