"""Steady states: closed forms, stability, failures, linearization, sweeps."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from math import degrees, pi, radians, sqrt
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from mbfmu.cli.equilibrium import branches_as_text
from mbfmu.mechanics import (
    DistanceCutJoint,
    Input,
    JointSpring,
    Mechanism,
    Revolute,
    RevoluteCutJoint,
    Translational,
    rod,
)
from mbfmu.modeling import Model, parameter
from mbfmu.session.run import run
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.steady.equilibrium import build_problem, equilibrium
from mbfmu.steady.sweep import Branch, sweep
from mbfmu.util.errors import EquilibriumError, UserError


@pytest.mark.parametrize(
    ("gravity", "angle", "distance"),
    [(9.81, 45.017925783771, 0.15002611560088), (0.0, 29.668519449609, 0.12384249833332)],
)
def test_governor_stands_where_its_potential_does(gravity: float, angle: float, distance: float) -> None:
    found = equilibrium(Governor(gravity=gravity))
    assert degrees(found.outputs["arm1.angle"]) == pytest.approx(angle, rel=1e-12)
    assert degrees(found.outputs["arm2.angle"]) == pytest.approx(angle, rel=1e-12)
    assert found.outputs["collar.distance"] == pytest.approx(distance, rel=1e-12)
    assert found.iterations < 15
    assert found.found_from == "the model's start"
    assert found.outputs["spindle.effort"] == pytest.approx(0.0, abs=1e-12)


def test_governor_forces_balance_the_collar() -> None:
    found = equilibrium(Governor())
    s, y = found.outputs, found.outputs["collar.distance"]
    a = radians(45.017925783771)
    rod_down = (y - 0.08 * np.sin(a)) / 0.10922  # cosine of the rod to the vertical
    lift = 2.0 * s["rod1.force"] * rod_down  # the rods push the collar down where positive
    assert lift + 9.81 * 1.0 - 1000.0 * (y - 0.15) == pytest.approx(0.0, abs=1e-9)


def test_pendulum_stands_where_spring_and_centrifugal_force_balance() -> None:
    found = equilibrium(SwingPendulum())
    assert found.outputs["rod.angle"] == pytest.approx(0.0, abs=1e-14)
    assert found.outputs["slider.distance"] == pytest.approx(50400.0 / 49600.0, rel=1e-12)
    assert found.iterations < 15


@pytest.mark.parametrize("speed", [0.0, 4.0, 10.0, 12.0, 40.0, 1000.0])
@pytest.mark.parametrize("start", [0.0, 1.0, 1.4, -0.5])
def test_governor_from_many_starts_is_stationary_in_the_hand_derived_force(speed: float, start: float) -> None:
    model = Governor(spindle_speed=speed, start_angle=start)
    found = equilibrium(model)
    phi = found.outputs["arm1.angle"]
    assert found.outputs["arm2.angle"] == pytest.approx(phi, abs=1e-12)
    assert found.stability == "undamped"
    if found.outputs["collar.distance"] > 0.0 and abs(phi) < pi / 2:  # the branch the closed form is written for
        stiffness = abs(model.minimal(0.0, [phi + 1e-6, 0.0])[1]) / 1e-6
        assert model.minimal(0.0, [phi, 0.0])[1] == pytest.approx(0.0, abs=1e-12 * max(1.0, stiffness))


def minimal_eigenvalues(model: Any, state: list[float]) -> Any:
    """Eigenvalues of the hand-derived motion about a steady state, by central differences."""
    f = len(state) // 2
    h, A = 1e-5, np.zeros((2 * f, 2 * f))
    for k in range(2 * f):
        up, down = list(state), list(state)
        up[k] += h
        down[k] -= h
        A[:, k] = (np.array(model.minimal(0.0, up)) - np.array(model.minimal(0.0, down))) / (2.0 * h)
    return np.linalg.eigvals(A)


@pytest.mark.parametrize("model", [Governor(), Governor(gravity=0.0), Governor(spindle_speed=20.0), SwingPendulum()])
def test_eigenvalues_are_those_of_the_hand_derived_motion(model: Any) -> None:
    found = equilibrium(model)
    position = (
        [found.outputs["rod.angle"], found.outputs["slider.distance"]]
        if isinstance(model, SwingPendulum)
        else [found.outputs["arm1.angle"]]
    )
    expected = np.sort(np.abs(minimal_eigenvalues(model, position + [0.0] * len(position)).imag))[::2]
    assert found.stability == "undamped"
    np.testing.assert_allclose([m.frequency for m in found.modes], expected, rtol=1e-7)


def test_damping_makes_it_stable_and_a_mode_decays_according_to_its_eigenvalue() -> None:
    model = Governor(damping=30.0, start_angle=0.80)
    found = equilibrium(model)
    assert found.stability == "stable"
    (mode,) = found.modes
    result = run(model, Settings(solver="adams", tolerance=1e-10), np.linspace(0.0, 12.0, 4801))
    away = np.abs(result["arm1.angle"] - found.outputs["arm1.angle"])
    peaks = [i for i in range(1, 4800) if away[i] >= away[i - 1] and away[i] > away[i + 1]][-6:]
    rate = np.polyfit(result.t[peaks], np.log(away[peaks]), 1)[0]
    assert rate == pytest.approx(mode.eigenvalue.real, rel=2e-3)
    assert mode.damping_ratio == pytest.approx(-mode.eigenvalue.real / abs(mode.eigenvalue))


def test_inverted_fourbar_is_an_equilibrium_and_unstable() -> None:
    upright = equilibrium(FourBar(), {"crank": 1.5})
    assert upright.outputs["crank.angle"] == pytest.approx(pi / 2, abs=1e-12)
    assert upright.stability == "unstable"
    growth = max(mode.eigenvalue.real for mode in upright.modes)
    assert growth == pytest.approx(sqrt(4.0 * 9.81 / (11.0 / 3.0)), rel=1e-10)  # pendulum upside down
    hanging = equilibrium(FourBar(), {"crank": -1.5})
    assert hanging.outputs["crank.angle"] == pytest.approx(-pi / 2, abs=1e-12)
    assert hanging.stability == "undamped"


def test_folded_swing_without_its_spring_is_a_saddle() -> None:
    folded = equilibrium(SwingPendulum(swing_stiffness=0.0, start_angle=3.1))
    assert abs(folded.outputs["rod.angle"]) == pytest.approx(pi, abs=1e-9)
    assert folded.stability == "unstable"


@dataclass(frozen=True, kw_only=True)
class Overbraced(Model):
    """A parallelogram with a third bar that carries nothing new, on a torsion spring."""

    name = "overbraced"
    bars: int = parameter(3, min=2, max=3)

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        crank = m.body("crank", m.ground, Revolute(start=0.2, fixed=True), **rod(mass=1.0, length=1.0))
        table = m.body("table", crank, Revolute(at=(1.0, 0.0, 0.0), start=-0.2), **rod(mass=2.0, length=2.0))
        for k in range(1, self.bars):
            bar = m.body(f"bar{k}", table, Revolute(at=(float(k), 0.0, 0.0), start=0.2))
            m.cut(f"pivot{k}", RevoluteCutJoint(at_a=(-1.0, 0.0, 0.0), at_b=(float(k), 0.0, 0.0)), bar, m.ground)
        m.force("spring", JointSpring(stiffness=60.0), crank)
        m.output("angle", crank.angle())
        return m


def test_redundant_constraints_change_nothing() -> None:
    braced, plain = equilibrium(Overbraced()), equilibrium(Overbraced(bars=2))
    assert braced.outputs["angle"] == pytest.approx(plain.outputs["angle"], abs=1e-12)
    angle = plain.outputs["angle"]
    assert 60.0 * angle + 9.81 * (0.5 + 2.0) * np.cos(angle) == pytest.approx(0.0, abs=1e-10)
    assert braced.modes[0].frequency == pytest.approx(plain.modes[0].frequency, rel=1e-10)


@dataclass(frozen=True, kw_only=True)
class DrivenLoop(Model):
    """A slider-crank whose crank is driven: with the slider at rest the loop would open."""

    name = "drivenloop"

    def build(self) -> Mechanism:
        from mbfmu.mechanics import Polynomial

        m = Mechanism()
        crank = m.body("crank", m.ground, Revolute(drive=Polynomial((1.0, 3.0))), **rod(mass=1.0, length=0.3))
        slider = m.body("slider", m.ground, Translational(axis="x", start=1.0), mass=1.0)
        m.cut("rod", DistanceCutJoint(at_a=(0.3, 0.0, 0.0), length=0.9), crank, slider)
        m.output("x", slider.coordinate())
        return m


@pytest.mark.parametrize(
    ("model", "words"),
    [
        (SwingPendulum(gravity=9.81), ["no steady state", "slider", "gravity"]),
        (SwingPendulum(drive_speed=sqrt(50000.0)), ["no steady state", "% of the drive speed", "slider", "singular"]),
        (Governor(start_angle=pi / 2), ["singular configuration", "--from"]),
        (DrivenLoop(), ["no steady state", "violates the constraints of a loop"]),
    ],
)
def test_what_is_no_steady_state_is_refused_with_its_residual(model: Model, words: list[str]) -> None:
    with pytest.raises(EquilibriumError) as caught:
        equilibrium(model)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("off", [0.0, 1e-9])
@pytest.mark.parametrize("locked", [False, True])
def test_a_loop_whose_only_constraint_is_singular_at_rest_is_refused(scale: float, off: float, locked: bool) -> None:
    """Two cranks and a rod between their tips in line: two branches cross there, or it is the one position there is."""
    m, (at, tip) = Mechanism(gravity=(9.81, 0.0, 0.0)), (4.0, -scale) if locked else (2.0, scale)
    left = m.body("left", m.ground, Revolute(start=off), **rod(mass=1.0, length=scale))
    right = m.body("right", m.ground, Revolute(at=(at * scale, 0.0, 0.0), start=off), **rod(mass=1.0, length=tip))
    m.cut("rod", DistanceCutJoint(at_a=(scale, 0, 0), at_b=(tip, 0, 0), length=2.0 * scale), left, right)
    with pytest.raises(EquilibriumError, match="singular configuration"):
        equilibrium(m)


def test_unknown_coordinates_and_bad_starts_are_named() -> None:
    with pytest.raises(UserError, match=r"no coordinate 'arm3'.*did you mean 'arm"):
        equilibrium(Governor(), {"arm3": 1.0})
    with pytest.raises(UserError, match="must be a finite number"):
        equilibrium(Governor(), {"arm1": float("nan")})


@pytest.mark.parametrize("model", [Governor(damping=20.0), Governor(driven=False, spindle_speed=0.0, damping=20.0)])
def test_state_matrices_are_differences_of_the_simulation(model: Governor) -> None:
    found = equilibrium(model)
    space = found.state_space
    f, h = space.coordinates.shape[1], 1e-4

    def rates(x: Any, u: float) -> tuple[Any, Any]:
        simulation = Simulation(model, Settings(solver="adams"), 0.0, {0: found.compiled.inputs.variables[0].start + u})
        names = simulation.compiled.system.coordinate_names
        line = [names.index(name) for name in space.states[:f]]
        compiled = simulation.compiled
        q, held = found.q.copy(), np.zeros(len(names), bool)
        q[line] += x[:f]
        held[line] = True
        q = compiled.assembly.close(0.0, q, held)
        terms = compiled.system.allocate_terms()
        compiled.system.fill_position(0.0, q, terms)
        v = np.zeros(len(names))
        v[line] = x[f:]
        v[~held] = np.linalg.solve(terms.J[:, ~held], -terms.J[:, held] @ v[held])
        stepper = type(simulation.stepper)(compiled.system, 0.0, q, v, Settings(solver="adams").options())
        simulation.stepper = stepper
        a, _ = stepper.accelerations()
        return np.concatenate((stepper.v[line], a[line])), simulation.outputs()[:-2].copy()

    for k in range(2 * f + 1):
        x, u = np.zeros(2 * f), 0.0
        if k < 2 * f:
            x[k] = h
        else:
            u = h
        up, down = rates(x, u), rates(-x, -u)
        slope = [(a - b) / (2.0 * h) for a, b in zip(up, down, strict=True)]
        A, C = (space.A[: 2 * f, k], space.C[:, k]) if k < 2 * f else (space.B[: 2 * f, 0], space.D[:, 0])
        keep = [not name.endswith("residual") for name in space.outputs]
        np.testing.assert_allclose(A, slope[0], rtol=1e-6, atol=1e-5)
        np.testing.assert_allclose(C[keep], slope[1][: len(keep)][keep], rtol=1e-6, atol=2e-3)


def test_scipy_reads_the_state_matrices(tmp_path: Path, command: Callable[..., Any]) -> None:
    from scipy import signal
    from scipy.io import loadmat

    npz, mat = tmp_path / "g.npz", tmp_path / "g.mat"
    for path in (npz, mat):
        code, out, _ = command("linearize", "governor", "--set", "damping=20", "-o", str(path))
        assert code == 0
        assert "damping ratio" in out
    with np.load(npz) as z:
        system = signal.StateSpace(z["A"], z["B"], z["C"], z["D"])
        assert list(z["states"]) == ["arm2", "der(arm2)", "spindle"]
    t, y = signal.step(system, T=np.linspace(0.0, 40.0, 400))
    assert np.isfinite(y).all()
    assert loadmat(mat)["A"].shape == (3, 3)
    assert len(t) == 400


@dataclass(frozen=True, kw_only=True)
class Tilted(Model):
    """A rod that hangs down, with gravity along x by an input."""

    name = "tilted"

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(Input(name="gravity.x", unit="m/s2"), -9.81, 0.0))
        bar = m.body("bar", m.ground, Revolute(start=-0.5 * pi), **rod(mass=2.0, length=1.0))
        m.output("support", bar.joint_force("x"))
        return m


def test_linearized_response_to_gravity_by_an_input() -> None:
    """A slender rod turns by 3/2 g / L and pulls on its support with a quarter of the force on it."""
    space = equilibrium(Tilted()).state_space
    np.testing.assert_allclose(space.B, [[0.0], [1.5]], atol=1e-12)
    np.testing.assert_allclose(space.D, [[-0.5]], atol=1e-12)


def test_a_step_of_the_drive_speed_moves_the_collar_according_to_the_gain() -> None:
    model = Governor(damping=60.0)
    space = equilibrium(model).state_space
    free = len(space.free)  # without the angle of the spindle, on which the height does not depend
    settled = np.linalg.solve(space.free, space.B[:free])
    gain = (space.D - space.C[:, :free] @ settled)[space.outputs.index("collar.height"), 0]
    h = 1e-3
    up, down = (equilibrium(Governor(damping=60.0, spindle_speed=11.0174 + d)) for d in (h, -h))
    assert gain == pytest.approx((up.outputs["collar.height"] - down.outputs["collar.height"]) / (2 * h), rel=1e-6)


def test_sweep_follows_the_speed_curve() -> None:
    values = [5.0 + k for k in range(16)]
    branches = sweep(Governor(), "spindle_speed", values)
    main = next(b for b in branches if b.states[0].outputs["arm1.angle"] > 0 and b.values == values)
    heights = [state.outputs["collar.height"] for state in main.states]
    assert heights == sorted(heights)
    model = Governor()
    for value, state in zip(main.values, main.states, strict=True):
        own = model.with_values({"spindle_speed": value})
        assert own.minimal(0.0, [state.outputs["arm1.angle"], 0.0])[1] == pytest.approx(0.0, abs=1e-9)


def test_scattered_starts_find_both_sides_once() -> None:
    problem = build_problem(FourBar())
    found = problem.solve()
    others = problem.others(found, 40)
    states = [found, *others]
    assert {"unstable", "undamped"} <= {state.stability for state in states}
    for i, a in enumerate(states):
        for b in states[:i]:
            assert not problem.same(a.q, b.q)


@pytest.mark.parametrize("solver", ["ida", "adams", "hybrid"])
@pytest.mark.parametrize("model", [Governor(damping=80.0), SwingPendulum(swing_damping=30.0, slider_damping=200.0)])
def test_damped_motion_settles_there(model: Model, solver: str) -> None:
    found = equilibrium(model)
    result = run(model, Settings(solver=solver, tolerance=1e-8), np.array([0.0, 5.0, 20.0, 40.0]))
    assert not result.failure
    name = "collar.distance" if isinstance(model, Governor) else "slider.distance"
    assert result[name][-1] == pytest.approx(found.outputs[name], rel=1e-6)


def test_starting_there_stays_there() -> None:
    result = run(Governor(), Settings(start_at_equilibrium=True), np.linspace(0.0, 5.0, 51))
    angle = result["arm1.angle"]
    assert degrees(angle[0]) == pytest.approx(45.017925783771, rel=1e-12)
    assert np.abs(angle - angle[0]).max() < 1e-6


def test_command_prints_and_writes_json(tmp_path: Path, command: Callable[..., Any]) -> None:
    code, out, _ = command("equilibrium", "governor")
    assert code == 0
    assert "marginally stable" in out
    code, out, _ = command("equilibrium", "governor", "--json")
    content = json.loads(out)
    assert content["stable"] is True
    assert content["positions"]["arm1"] == pytest.approx(radians(45.017925783771), rel=1e-12)
    assert len(content["eigenvalues"]) == 1
    target = tmp_path / "sweep.json"
    code, out, _ = command(
        "equilibrium", "governor", "--sweep", "spindle_speed=8:12:1", "--json", str(target), "-o", str(tmp_path)
    )
    assert code == 0
    folder = tmp_path / "governor" / "default-sweep-spindle_speed"
    assert sorted(path.name for path in folder.iterdir()) == ["branches.csv", "branches.json", "branches.png"]
    assert target.read_text() == (folder / "branches.json").read_text()
    branches = json.loads(target.read_text())["branches"]
    assert len(branches[0]) == 5
    with (folder / "branches.csv").open() as file:
        rows = list(csv.DictReader(file))
    states = [state for branch in branches for state in branch]
    assert [float(row["collar.height [m]"]) for row in rows] == [s["outputs"]["collar.height"] for s in states]
    table = out.splitlines()
    assert table[0].split("  ")[0] == "branch"
    assert len(table) == 2 + len(branches) + 1, "a line a branch, and where the rest is"
    assert re.match(r"1 +5 +8 to 12 +0\.0\S+ to 0\.0\S+ +undamped$", table[2])


def test_a_branch_reports_where_its_stability_changes() -> None:
    def state(stability: str) -> Any:
        return SimpleNamespace(stability=stability, outputs={"x": 1.0})

    branch = Branch([1.0, 2.0, 3.0, 4.0], [state(s) for s in ("stable", "stable", "unstable", "stable")])
    told = branches_as_text([branch], "speed [rad/s]", "x [m]", "x").splitlines()
    assert told[2].split("  ")[-1].strip() == "stable, unstable from 3, stable from 4"
    assert len(told) == 3


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["pendulum", "--set", "gravity=9.81"], "no steady state"),
        (["governor", "--from", "arm1"], "allowed: NAME=VALUE"),
        (["governor", "--from", "arm1=x"], "'x' is not a number"),
        (["governor", "--sweep", "spindle_speed=1:2"], "FROM:TO:STEP"),
        (["governor", "--sweep", "spindel_speed=1:2:1"], "spindel_speed"),
        (["governor", "--sweep", "spindle_speed=1:2:1", "--plot", "height"], "there is no output"),
        (["governor", "--others", "-1"], "--others"),
    ],
)
def test_mistakes_are_named(command: Callable[..., Any], arguments: list[str], words: str) -> None:
    code, _, err = command("equilibrium", *arguments)
    assert code == 2
    assert words in err
    assert "Traceback" not in err


def test_free_governor_spins_on_in_balance() -> None:
    free = Governor(driven=False, damping=20.0)
    found = equilibrium(free)
    assert degrees(found.outputs["arm1.angle"]) == pytest.approx(45.017925783771, rel=1e-12)
    assert found.outputs["spindle.speed"] == pytest.approx(11.0174)
    assert found.stability == "neutral"  # its speed and angle
    result = run(free, Settings(start_at_equilibrium=True, solver="adams", tolerance=1e-11), np.linspace(0.0, 5.0, 6))
    np.testing.assert_allclose(result["arm1.angle"], found.outputs["arm1.angle"], atol=1e-10)
    np.testing.assert_allclose(result["spindle.speed"], 11.0174, rtol=1e-10)


def test_a_coordinate_that_matters_does_not_spin_on() -> None:
    swinging = SwingPendulum(start_angle=0.1)
    assert not equilibrium(swinging).v.any()
