"""ESDIRK with eliminated constraints: exact motions, order, stiffness, work, saved states, singular configurations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from judge import judge, truth
from mechanisms import CASES, Scale, ladder, n_four_bar, parallelogram
from scipy.integrate import solve_ivp
from test_eliminated_ida import driven_row, sprung

import solvers.steppers
from mbfmu.mechanics import CompiledMechanism
from solvers import Options, stepper
from solvers.energy_account import WORK
from solvers.outcome import Code
from solvers.steppers.esdirk.eliminated import EliminatedESDIRKStepper


def started(compiled: CompiledMechanism, rtol: float, max_step: float = np.inf) -> Any:
    """A stepper from the assembled start."""
    options = Options(rtol=rtol, max_step=max_step)
    run = stepper("esdirk", compiled.system, 0.0, *compiled.assembly.assemble(0.0), options)
    assert isinstance(run, EliminatedESDIRKStepper)
    return run


@pytest.mark.parametrize(
    "make",
    [
        lambda: n_four_bar(40),
        lambda: n_four_bar(40, grounded=True, scale=Scale(lengths=1e3)),
        lambda: ladder(25, scale=Scale(lengths=1e-3)),
    ],
)
def test_large_mechanisms_with_loops_follow_the_exact_motion(make: Any) -> None:
    """The rows pass a configuration in which all loops are singular."""
    case = make()
    compiled, times = CompiledMechanism(case.mechanism), np.linspace(0.0, 0.1 * case.stop_time, 6)
    found, exact = started(compiled, 1e-5).sample(times[1:]), case.exact(times)[0][1:]
    np.testing.assert_allclose(found.q, exact, atol=5e-4)
    assert max(compiled.residuals(times[-1], found.q[-1], found.v[-1])) < 1e-9


def test_a_ladder_of_200_loops() -> None:
    case, times = ladder(200), np.array([0.0, 0.2, 0.4])
    run = started(CompiledMechanism(case.mechanism), 1e-4)
    found = run.sample(times[1:])
    assert np.abs(found.q - case.exact(times)[0][1:]).max() < 2e-3
    assert run.statistics.steps < 30


def test_the_order_is_three() -> None:
    """In steps of constant length, of which the last one ends at the time of the comparison."""
    case, stop, errors = n_four_bar(31), 0.512, []
    compiled, exact = CompiledMechanism(case.mechanism), case.exact(np.array([0.0, stop]))[0][1]
    for count in (8, 16, 32):
        run = started(compiled, 1e-2, stop / count)
        run.continue_after_event()  # steps end at the requested times
        for k in range(count):
            assert run.advance(stop * (k + 1) / count).ok
            run.continue_after_event()
        assert run.statistics.steps == count
        errors.append(np.abs(run.q - exact).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(orders > 2.6), (errors, orders)


@pytest.mark.parametrize(("stiffness", "damping"), [(50.0, 1.0), (1e5, 1e4)])
def test_springs_and_dampers_in_loops(stiffness: float, damping: float) -> None:
    """All columns have one angle x: ((n + 1) / 3 + n) x'' = -g ((n + 1) / 2 + n) cos x - n (k (x - 1) + d x')."""
    n, times = 35, np.linspace(0.0, 2.0, 11)
    inertia, weight = (n + 1) / 3.0 + n, 9.81 * (0.5 * (n + 1) + n)

    def right(_: float, y: Any) -> Any:
        return [y[1], -(weight * np.cos(y[0]) + n * (stiffness * (y[0] - 1.0) + damping * y[1])) / inertia]

    exact = solve_ivp(right, (0.0, 2.0), [1.2, 0.0], "Radau", times, rtol=1e-10, atol=1e-12).y[0]
    run = started(CompiledMechanism(sprung(n, stiffness, damping)), 1e-5)
    found = run.sample(times[1:])
    np.testing.assert_allclose(found.q[:, 0], exact[1:], atol=1e-4)
    assert run.statistics.steps < 500  # an explicit method takes 1e5 in the stiff case


def test_the_work_of_drives_and_dampers_is_the_change_of_energy() -> None:
    compiled, q, v = driven_row()
    run = stepper("esdirk", compiled.system, 0.0, q, v, Options(rtol=1e-7))
    assert isinstance(run, EliminatedESDIRKStepper)
    before = compiled.energy(0.0, run.q, run.v)
    assert run.advance(0.7).ok
    changed = compiled.energy(0.7, run.q, run.v) - before
    assert abs(changed) > 1.0
    np.testing.assert_allclose(run.energy_account[WORK], changed, rtol=1e-5)


def test_a_restored_run_continues_with_the_same_bits() -> None:
    compiled = CompiledMechanism(n_four_bar(31).mechanism)
    first, other = started(compiled, 1e-5), started(compiled, 1e-5)
    first.advance(0.4)
    other.restore(first.save())
    first.advance(1.0)
    other.advance(1.0)
    np.testing.assert_array_equal(first.q, other.q)
    np.testing.assert_array_equal(first.v, other.v)


SMALL = ("parallelogram + 1e-5", "three cranks, singular", "table, singular", "slider-crank", "bricard")


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
    verdict = judge(case.mechanism, motion, "esdirk", 1e-6)
    assert verdict.word == "right", verdict


@pytest.mark.usefixtures("everywhere")
def test_a_near_miss_that_rounding_hides_is_refused() -> None:
    run = started(CompiledMechanism(parallelogram(1e-11).mechanism), 1e-6)
    assert run.advance(1.0).code is Code.BRANCHES
    assert run.t < 0.2
