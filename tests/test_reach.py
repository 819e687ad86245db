"""Drives that loops cannot follow, and rates that they leave open: every solver reports the same reason."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism
from mbfmu.session.failure_diagnosis import explain_failure
from solvers.outcome import Code, Status

SOLVERS = ("ida", "adams", "hybrid", "radau")


def pushed(scale: float, rate: float, arms: int) -> mb.Mechanism:
    """A pivot is pushed away from the ground at ``rate`` m/s, with arms of 1 m between, from 1 m on."""
    m = mb.Mechanism(gravity=(0.0, -9.81 * scale, 0.0))
    drive = mb.Polynomial((scale, rate * scale))
    on = m.body("pusher", m.ground, mb.Translational(axis="x", drive=drive), mass=1.0)
    for k in range(arms):
        at = (scale, 0.0, 0.0) if k else (0.0, 0.0, 0.0)
        on = m.body(f"arm{k}", on, mb.Revolute(at=at, start=1.2), **mb.rod(mass=1.0, length=scale))
    rocker = m.body("rocker", m.ground, mb.Revolute(start=1.0), **mb.rod(mass=1.0, length=scale))
    m.cut("pin", mb.RevoluteCutJoint(at_a=(scale, 0.0, 0.0), at_b=(scale, 0.0, 0.0)), on, rocker)
    return m


@pytest.mark.parametrize("arms", [1, 2])  # no freedom is left, or one
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_drive_out_of_reach_is_called_that(solver: str, scale: float, arms: int) -> None:
    simulation = mb.Simulation(pushed(scale, 0.5 * arms, arms), mb.Settings(solver=solver))
    assert not simulation.advance(4.0).ok
    assert simulation.failure.startswith("the drive of 'pusher' requires a position that the loops cannot reach after")
    told = float(simulation.failure.partition("after t = ")[2].partition(" s")[0])
    assert told == pytest.approx(2.0, abs=1e-4)  # stretched out
    assert "Shorten the motion of the drive" in simulation.failure


def contradicted(scale: float, others: int) -> mb.Mechanism:
    """A parallelogram whose crank is held and whose rocker leaves its place in a pulse about 1 s, and pendulums."""
    m = mb.Mechanism(gravity=(0.0, -9.81 * scale, 0.0))
    crank = m.body("crank", m.ground, mb.Revolute(drive=mb.Polynomial((1.0,))), **mb.rod(mass=1.0, length=scale))
    pin = mb.Revolute(at=(scale, 0.0, 0.0), start=-1.0)
    bar = m.body("coupler", crank, pin, **mb.rod(mass=1.0, length=2.5 * scale))
    pulse = mb.Function(lambda t: 1.0 + 0.3 * np.exp(-(((t - 1.0) / 0.1) ** 2)), time=0.1)
    pin = mb.Revolute(at=(2.5 * scale, 0.0, 0.0), drive=pulse)
    rocker = m.body("rocker", m.ground, pin, **mb.rod(mass=1.0, length=scale))
    m.cut("pin", mb.RevoluteCutJoint(at_a=(2.5 * scale, 0.0, 0.0), at_b=(scale, 0.0, 0.0)), bar, rocker)
    for k in range(others):
        m.body(f"p{k}", m.ground, mb.Revolute(start=0.1), **mb.rod(mass=1.0, length=scale))
    return m


@pytest.mark.parametrize("others", [0, 1])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("solver", SOLVERS)
def test_drives_that_contradict_each_other_between_outputs_are_found(solver: str, scale: float, others: int) -> None:
    result = mb.simulate(contradicted(scale, others), 2.0, interval=2.0, solver=solver)
    assert result.failure.startswith("the drives require a position that the loops cannot reach after")
    found = float(result.failure.partition("after t = ")[2].partition(" s")[0])
    pulse = 0.3 * np.exp(-(((found - 1.0) / 0.1) ** 2))  # rad
    assert 1e-12 < pulse < 1e-6  # it is found where it begins


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("solver", ["ida", "adams", "esdirk"])
def test_contradicting_drives_are_found_in_large_models(solver: str, scale: float) -> None:
    result = mb.simulate(contradicted(scale, 110), 2.0, interval=2.0, solver=solver)
    assert result.failure.startswith("no position or velocity near the present one satisfies the constraints")


def contradicted_row(scale: float, loops: int) -> mb.Mechanism:
    """A row of parallelograms: the first and the last column are driven alike, but for a pulse of the last one."""
    m = mb.Mechanism(gravity=(0.0, -9.81 * scale, 0.0))
    bar, top = mb.rod(mass=1.0, length=scale), (scale, 0.0, 0.0)
    pulse = mb.Function(lambda t: 1.2 + 1e-3 * np.exp(-(((t - 1.0) / 0.1) ** 2)), time=0.1)
    column = m.body("column0", m.ground, mb.Revolute(drive=mb.Polynomial((1.2,))), **bar)
    for i in range(1, loops + 1):
        coupler = m.body(f"coupler{i}", column, mb.Revolute(at=top, start=-1.2), **bar)
        at = (i * scale, 0.0, 0.0)
        pin = mb.Revolute(at=at, drive=pulse) if i == loops else mb.Revolute(at=at, start=1.2)
        column = m.body(f"column{i}", m.ground, pin, **bar)
        m.cut(f"pin{i}", mb.RevoluteCutJoint(at_a=top, at_b=top), coupler, column)
    return m


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("solver", ["ida", "adams"])
def test_contradicting_drives_are_found_in_large_models_with_many_loops(solver: str, scale: float) -> None:
    result = mb.simulate(contradicted_row(scale, 33), 2.0, interval=2.0, solver=solver)
    assert result.failure.startswith("the drives require a position that the loops cannot reach after")
    found = float(result.failure.partition("after t = ")[2].partition(" s")[0])
    assert 1e-12 < 1e-3 * np.exp(-(((found - 1.0) / 0.1) ** 2)) < 1e-6


def test_it_is_called_that_where_a_run_ends_right_there() -> None:
    found = mb.check(pushed(1.0, 0.5, 1), 2.0)
    assert "the drive of 'pusher' requires a position that the loops cannot reach after t = 2 s" in found.failure


def flat(coupler: float | None = None, rocker: float | None = None) -> mb.Mechanism:
    """A parallelogram that starts flat."""
    m = mb.Mechanism()
    crank = m.body("crank", m.ground, mb.Revolute(start=0.0, rate=1.0, fixed=True), **mb.rod(mass=1.0, length=1.0))
    pin = mb.Revolute(at=(1.0, 0.0, 0.0), start=0.0, rate=coupler)
    bar = m.body("coupler", crank, pin, **mb.rod(mass=1.0, length=2.5))
    pin = mb.Revolute(at=(2.5, 0.0, 0.0), start=0.0, rate=rocker)
    other = m.body("rocker", m.ground, pin, **mb.rod(mass=1.0, length=1.0))
    m.cut("pin", mb.RevoluteCutJoint(at_a=(2.5, 0.0, 0.0), at_b=(1.0, 0.0, 0.0)), bar, other)
    return m


def flat_row(rates: Sequence[float | None], scale: float, others: int = 0) -> mb.Mechanism:
    """A parallelogram that starts flat, with bars of ``scale`` m, tilted about y, and pendulums next to it."""
    m = mb.Mechanism()
    stand = m.body("stand", m.ground, mb.Weld(rotation=Rotation.from_rotvec([0.0, 0.7, 0.0]).as_matrix()))
    crank = m.body("crank", stand, mb.Revolute(start=0.0, rate=rates[0]), **mb.rod(mass=1.0, length=scale))
    pin = mb.Revolute(at=(scale, 0.0, 0.0), start=0.0, rate=rates[1])
    bar = m.body("coupler", crank, pin, **mb.rod(mass=1.0, length=2.5 * scale))
    pin = mb.Revolute(at=(2.5 * scale, 0.0, 0.0), start=0.0, rate=rates[2])
    other = m.body("rocker", stand, pin, **mb.rod(mass=1.0, length=scale))
    m.cut("pin", mb.RevoluteCutJoint(at_a=(2.5 * scale, 0.0, 0.0), at_b=(scale, 0.0, 0.0)), bar, other)
    for k in range(others):
        m.body(f"p{k}", stand, mb.Revolute(rate=0.1 * k), **mb.rod(mass=1.0, length=scale))
    return m


@pytest.mark.parametrize("others", [0, 20])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("solver", ["ida", "adams", "hybrid", "radau"])
def test_rates_that_belong_to_no_branch_are_refused(solver: str, scale: float, others: int) -> None:
    """Loops determine one of three rates; the two branches, one more."""
    settings = mb.Settings(solver=solver)
    advice = "Give the rates of 'coupler' and 'rocker' to choose the branch"
    for rates, last in (((1.0, None, None), advice), ((1.0, 0.0, 0.0), "Give other rates")):
        with pytest.raises(mb.UserError, match="the given rates are not those of any branch") as told:
            mb.Simulation(flat_row(rates, scale, others), settings)
        assert str(told.value).endswith(f"{last} [singular-start]")


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("solver", ["ida", "adams", "hybrid", "radau"])
@pytest.mark.parametrize("rates", [(1.0, -1.0, 1.0), (1.0, -7 / 3, -7 / 3)])
def test_rates_of_either_branch_are_kept_silently(solver: str, scale: float, rates: tuple[float, float, float]) -> None:
    """With w of the coupler in the ground: 1 + 2.5 w = b and 1 + 2.5 w^2 = b^2 have w = 0 and w = -4/3."""
    simulation = mb.Simulation(flat_row(rates, scale), mb.Settings(solver=solver))
    assert all(d.severity == "note" for d in simulation.diagnostics)
    assert simulation.advance(0.01).ok
    np.testing.assert_allclose(simulation.stepper.q[:3], 0.01 * np.array(rates), rtol=1e-3)


def test_one_of_two_open_rates_is_asked_for() -> None:
    one = mb.Simulation(flat(coupler=-1.0), mb.Settings(solver="adams"))
    assert str(one.diagnostics[0]).endswith("Give the rate of 'rocker' to choose the branch [singular-start]")


def test_with_all_rates_given_nothing_is_asked_for() -> None:
    simulation = mb.Simulation(flat(coupler=-1.0, rocker=1.0), mb.Settings(solver="ida"))
    assert all("Give the rate" not in text for text in map(str, simulation.diagnostics))
    assert simulation.advance(1.0).ok
    np.testing.assert_allclose(simulation.stepper.q, [1.0, -1.0, 1.0], atol=1e-5)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("early", [1e-4, 1e-3, 1e-2])  # s
def test_a_singular_position_that_is_passed_is_not_called_out_of_reach(scale: float, early: float) -> None:
    """A driven parallelogram with three cranks reaches every angle of them, whatever stops a run before it is flat."""
    m = mb.Mechanism()
    drive = mb.Polynomial((np.pi - 1.7, 1.0))
    crank = m.body("crank", m.ground, mb.Revolute(drive=drive), **mb.rod(mass=1.0, length=0.78 * scale))
    start = mb.Revolute(at=(0.78 * scale, 0.0, 0.0), start=1.7 - np.pi)
    bar = m.body("coupler", crank, start, **mb.rod(mass=1.0, length=2.18 * scale))
    for k in (1, 2):
        x = 1.09 * k * scale
        joint = mb.Revolute(at=(x, 0.0, 0.0), start=np.pi - 1.7)
        rocker = m.body(f"rocker{k}", m.ground, joint, **mb.rod(mass=1.0, length=0.78 * scale))
        m.cut(f"pin{k}", mb.RevoluteCutJoint(at_a=(x, 0.0, 0.0), at_b=(0.78 * scale, 0.0, 0.0)), bar, rocker)
    t = 1.7 - early
    q = np.array([early - np.pi, np.pi - early, np.pi - early])
    for code in (Code.BRANCHES, Code.NOT_CLOSED):
        assert "[unreachable-drive]" not in str(
            explain_failure(CompiledMechanism(m), Status(code, t), q, 2.0, starts_singular=False)
        )
