"""IDA with eliminated constraints: exact motions, Lagrange equations with SciPy, stiffness, singular configurations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from judge import judge, truth
from mechanisms import CASES, Scale, ladder, n_four_bar, parallelogram
from scipy.integrate import solve_ivp

import solvers.steppers
from mbfmu.mechanics import CompiledMechanism, JointSpring, Mechanism, Revolute, RevoluteCutJoint, rod
from mbfmu.mechanics.signals import Harmonic
from solvers import Options, stepper
from solvers.energy_account import WORK
from solvers.outcome import Code
from solvers.steppers.eliminated import EliminatedFormulation
from solvers.steppers.ida.eliminated import EliminatedIDAStepper


def started(compiled: CompiledMechanism, rtol: float) -> Any:
    """A stepper from the assembled start."""
    return stepper("ida", compiled.system, 0.0, *compiled.assembly.assemble(0.0), Options(rtol=rtol))


@pytest.mark.parametrize(
    "make",
    [
        lambda s: n_four_bar(40, scale=s),
        lambda s: n_four_bar(40, grounded=True, scale=s),
        lambda s: ladder(25, scale=s),
    ],
)
@pytest.mark.parametrize("length", [1e-3, 1.0, 1e3])
def test_large_mechanisms_with_loops_follow_the_exact_motion(make: Any, length: float) -> None:
    case = make(Scale(lengths=length))
    compiled, times = CompiledMechanism(case.mechanism), np.linspace(0.0, 0.2 * case.stop_time, 11)
    run = started(compiled, 1e-7)
    assert isinstance(run, EliminatedIDAStepper)
    found, exact = run.sample(times[1:]), case.exact(times)[0][1:]
    np.testing.assert_allclose(found.q, exact, atol=3e-5)


def sprung(loops: int, stiffness: float, damping: float) -> Mechanism:
    """A row of four-bars, links of 1 m and 1 kg, with springs and dampers between columns and couplers."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    first = Revolute(start=1.2, fixed=True)
    column, top = m.body("column0", m.ground, first, **rod(mass=1.0, length=1.0)), (1.0, 0.0, 0.0)
    for i in range(1, loops + 1):
        coupler = m.body(f"coupler{i}", column, Revolute(at=top, start=-1.2), **rod(mass=1.0, length=1.0))
        m.force(f"spring{i}", JointSpring(stiffness=stiffness, damping=damping, free=-1.0), coupler)
        hinge = Revolute(at=(1.0, 0.0, 0.0), start=1.2)
        column = m.body(f"column{i}", coupler, hinge, **rod(mass=1.0, length=-1.0))
        m.cut(f"foot{i}", RevoluteCutJoint(at_a=(-1.0, 0.0, 0.0), at_b=(float(i), 0.0, 0.0)), column, m.ground)
        top = (0.0, 0.0, 0.0)
    return m


@pytest.mark.parametrize(("stiffness", "damping"), [(50.0, 1.0), (1e5, 1e4)])
def test_springs_and_dampers_in_loops(stiffness: float, damping: float) -> None:
    """All columns have one angle x: ((n + 1) / 3 + n) x'' = -g ((n + 1) / 2 + n) cos x - n (k (x - 1) + d x')."""
    n, times = 35, np.linspace(0.0, 2.0, 11)
    inertia, weight = (n + 1) / 3.0 + n, 9.81 * (0.5 * (n + 1) + n)

    def right(_: float, y: Any) -> Any:
        return [y[1], -(weight * np.cos(y[0]) + n * (stiffness * (y[0] - 1.0) + damping * y[1])) / inertia]

    exact = solve_ivp(right, (0.0, 2.0), [1.2, 0.0], "Radau", times, rtol=1e-10, atol=1e-12).y[0]
    run = started(CompiledMechanism(sprung(n, stiffness, damping)), 1e-6)
    assert isinstance(run, EliminatedIDAStepper)
    found = run.sample(times[1:])
    np.testing.assert_allclose(found.q[:, 0], exact[1:], atol=2e-5)
    assert run.statistics.steps < 1000  # an explicit method takes 1e5 in the stiff case


def test_fast_vibrations_of_links_in_loops_do_not_limit_the_steps() -> None:
    """Arms on stiff springs without damping: their vibrations of 1e4 rad/s are not excited."""
    m = sprung(30, 0.0, 0.1)
    for i in range(1, 31):
        arm = m.body(f"arm{i}", m.bodies[2 * i + 1], Revolute(at=(-0.5, 0.0, 0.0)), **rod(mass=0.2, length=0.3))
        m.force(f"stiff{i}", JointSpring(stiffness=6e5, damping=10.0), arm)
    compiled = CompiledMechanism(m)
    run = started(compiled, 1e-5)
    assert isinstance(run, EliminatedIDAStepper)
    assert run.advance(1.0).ok
    assert run.statistics.steps < 600
    assert max(compiled.residuals(1.0, run.q, run.v)) < 1e-9


def test_a_long_row_of_loops() -> None:
    case = n_four_bar(200)
    compiled = CompiledMechanism(case.mechanism)
    run = started(compiled, 1e-6)
    assert run.advance(1.5).ok  # through the first crossing of all loops
    np.testing.assert_allclose(run.q, case.exact(np.array([0.0, 1.5]))[0][1], atol=1e-4)
    assert run.freedom == 1


@pytest.mark.parametrize("length", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("off", [1e-2, 3e-3, 1e-3, 4e-4])
def test_states_next_to_a_crossing_of_many_loops_are_closed_to_rounding(off: float, length: float) -> None:
    """A residual that counts as rounding elsewhere makes accelerations wrong by the residual / off^3."""
    loops, speed = 40, 1.0
    compiled = CompiledMechanism(n_four_bar(loops, scale=Scale(lengths=length)).mechanism)
    signs = np.array([1.0, *(-1.0, 1.0) * loops])
    form = EliminatedFormulation(compiled.system, 0.0, off * signs, speed * signs, Options(rtol=1e-8))
    gravity = 9.81 * length  # m/s^2; at an inertia of (41 / 3 + 40) m l^2 and a weight moment of (41 / 2 + 40) m g l
    exact = -(0.5 * (loops + 1) + loops) * gravity * np.cos(off) / (((loops + 1) / 3.0 + loops) * length)
    for residual in (1e-13, 1e-12, 3e-12):  # of one loop, in its lengths; the unit of the equations is 40 lengths
        q, v = off * signs, speed * signs
        q[-2] += residual / off  # the last coupler and column turn
        assert form.project(0.0, q, v) is Code.OK
        assert form.evaluate(0.0, q, v) is Code.OK
        np.testing.assert_allclose(signs * form.a, exact, rtol=1e-14 / off**3 + 1e-10)


SMALL = (
    "grashof + 1e-2", "parallelogram + 1e-5", "three cranks, singular", "table, singular",
    "double parallelogram, singular", "slider-crank", "crane", "bricard", "squeezer",
)  # fmt: skip


@pytest.fixture
def everywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small mechanisms are eliminated too."""
    monkeypatch.setattr(solvers.steppers, "MIN_ELIMINATION_COORDINATES", 0)
    monkeypatch.setattr(solvers.steppers, "MIN_ELIMINATION_CONSTRAINTS", 0)


@pytest.mark.usefixtures("everywhere")
@pytest.mark.parametrize("name", SMALL)
def test_motions_near_and_through_singular_configurations(name: str) -> None:
    case = CASES[name]()
    motion = truth(case.mechanism, np.linspace(0.0, min(case.stop_time, 2.0), 21), case.exact)
    for rtol in (1e-6, 1e-8):
        verdict = judge(case.mechanism, motion, "ida", rtol)
        assert verdict.word == "right", verdict


def test_a_tolerance_below_the_smallest_one_is_run_as_this_one_and_reported() -> None:
    """31 loops that are singular at the same instant, where rounding errors of the accelerations are large."""
    case = n_four_bar(31)
    motion = truth(case.mechanism, np.linspace(0.0, 2.0, 21), case.exact)
    verdict = judge(case.mechanism, motion, "ida", 1e-10)
    assert (verdict.word, verdict.rtol) == ("right", 1e-8), verdict
    compiled, states = CompiledMechanism(case.mechanism), []
    for rtol in (1e-8, 1e-10):
        run = started(compiled, rtol)
        assert run.advance(0.5).ok
        states.append(run.q.tobytes())
        assert [d.code for d in run.diagnostics] == ["limited-tolerance"] * (rtol < 1e-8)
    assert states[0] == states[1]


@pytest.mark.usefixtures("everywhere")
def test_a_near_miss_that_rounding_hides_is_refused() -> None:
    compiled = CompiledMechanism(parallelogram(1e-11).mechanism)
    run = started(compiled, 1e-8)
    assert isinstance(run, EliminatedIDAStepper)
    assert run.advance(1.0).code is Code.BRANCHES
    assert run.t < 0.2


def driven_row() -> tuple[CompiledMechanism, Any, Any]:
    """A row of four-bars with dampers in its hinges, whose first column is driven; and its state at the start."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    drive = Harmonic(amplitude=0.4, frequency=0.5, mean=1.2)
    column, top = m.body("column0", m.ground, Revolute(drive=drive), **rod(mass=1.0, length=1.0)), (1.0, 0.0, 0.0)
    for i in range(1, 33):
        coupler = m.body(f"coupler{i}", column, Revolute(at=top), **rod(mass=1.0, length=1.0))
        column = m.body(f"column{i}", coupler, Revolute(at=(1.0, 0.0, 0.0)), **rod(mass=1.0, length=-1.0))
        m.force(f"damper{i}", JointSpring(damping=0.1), coupler)
        m.cut(f"foot{i}", RevoluteCutJoint(at_a=(-1.0, 0.0, 0.0), at_b=(i, 0.0, 0.0)), column, m.ground)
        top = (0.0, 0.0, 0.0)
    compiled = CompiledMechanism(m)
    q, v = compiled.assembly.close(0.0, np.tile([-1.2, 1.2], 32), np.zeros(64, bool)), np.zeros(64)
    return compiled, q, v


def test_the_work_of_drives_and_dampers_is_the_change_of_energy() -> None:
    compiled, q, v = driven_row()
    run = stepper("ida", compiled.system, 0.0, q, v, Options(rtol=1e-9))
    assert isinstance(run, EliminatedIDAStepper)
    before = compiled.energy(0.0, run.q, run.v)
    assert run.advance(0.7).ok
    changed = compiled.energy(0.7, run.q, run.v) - before
    assert abs(changed) > 1.0
    np.testing.assert_allclose(run.energy_account[WORK], changed, rtol=1e-5)


def test_a_restored_run_continues_within_the_tolerance() -> None:
    compiled = CompiledMechanism(n_four_bar(31).mechanism)
    first, other = started(compiled, 1e-7), started(compiled, 1e-7)
    first.advance(0.7)
    other.restore(first.save())
    first.advance(1.0)
    other.advance(1.0)
    np.testing.assert_allclose(first.q, other.q, atol=1e-5)
