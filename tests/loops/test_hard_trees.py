"""Trees on both sides of the limit between dense and structured equations, against motions that SciPy integrates."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hard_trees import bouncing, chain, pendulum_among, turning_pendulum_on_stops, turning_rods
from judge import Truth, judge, truth
from mechanisms import Case, G

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism, JointForce, JointSpring, Mechanism, Revolute, Translational, rod
from mbfmu.util.diagnostics import without_details
from solvers import Options, stepper
from solvers.compiled.kernel import COMPILED

pytestmark = pytest.mark.skipif(not COMPILED, reason="takes minutes without a compiler")

ALLOWED = 3.0  # tolerances, times the growth of errors in the motion
LARGEST_ERROR = 50.0  # tolerances
CASES = {
    **{f"pendulum among {n}": (pendulum_among, n) for n in (59, 61, 131)},
    **{f"turning rods {n}": (turning_rods, n) for n in (59, 61)},
    "chain 61": (chain, 61),
}
_known: dict[str, tuple[Case, Truth]] = {}


def known(name: str) -> tuple[Case, Truth]:
    """Return a case and its motion, which is integrated once."""
    if name not in _known:
        make, count = CASES[name]
        case: Any = make(count)
        stop_time = 0.3 * case.stop_time
        _known[name] = case, truth(case.mechanism, np.linspace(0.0, stop_time, 21), case.exact)
    return _known[name]


@pytest.mark.parametrize("rtol", [1e-4, 1e-6, 1e-8])
@pytest.mark.parametrize("name", CASES)
def test_ida_keeps_its_tolerance_at_any_size(name: str, rtol: float) -> None:
    case, motion = known(name)
    verdict = judge(case.mechanism, motion, "ida", rtol, factor=ALLOWED)
    assert verdict.word == "right", verdict
    assert verdict.until == motion.times[-1], verdict
    assert verdict.error <= LARGEST_ERROR * rtol, verdict


def springs(links: int, stiffness: float, damping: float = 0.0) -> Mechanism:
    """A cantilever of rods, 1 m long and of 1 kg in all, on a free hinge: joints of this stiffness, N m/rad."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    body = m.ground
    for k in range(links):
        joint = Revolute(at=(1.0 / links if k else 0.0, 0.0, 0.0), start=0.0 if k else -0.3, fixed=True)
        body = m.body(f"link{k}", body, joint, **rod(mass=1.0 / links, length=1.0 / links))
        if k:
            m.force(f"spring{k}", JointSpring(stiffness=stiffness, damping=damping), body)
    m.output("height", body.position("y"), "height of the last link")
    return m


def test_undamped_motions_that_are_not_resolved_limit_the_order_and_are_reported() -> None:
    """Orders from 3 on took 400 000 residuals here, see the reason in solvers/steppers/ida/tree.py."""
    result = mb.simulate(springs(70, 1e3), 0.3, solver="ida", tolerance=1e-4)
    assert not result.failure
    assert result.statistics.rhs_evals < 2000
    assert any("orders 1 and 2 only" in remark and "rad/s" in remark for remark in map(str, result.diagnostics))


@pytest.mark.parametrize("make", [lambda: chain(61).mechanism, lambda: springs(61, 1e-1, 10.0)])
def test_orders_are_not_limited_where_fast_motions_are_followed_or_damped(make: Any) -> None:
    result = mb.simulate(make(), 0.02, solver="ida", tolerance=1e-6)
    assert not any("orders 1 and 2" in remark for remark in map(str, result.diagnostics))


def test_a_state_that_ida_does_not_have_is_not_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """The code that IDA returns was not read: after a restart the state of another time was reported."""
    compiled = CompiledMechanism(pendulum_among(61).mechanism)
    motion: Any = stepper("ida", compiled.system, 0.0, *compiled.assemble(), Options(rtol=1e-6))
    assert motion.advance(0.5).ok
    before = motion.q.copy()
    interpolate = motion._ida.interpolate
    monkeypatch.setattr(motion._ida, "interpolate", lambda _: interpolate(0.1))
    assert not motion.advance(0.6).ok
    assert motion.t == 0.5
    np.testing.assert_array_equal(motion.q, before)


def test_masses_at_rest_that_a_force_moves_later_do_not_limit_the_order() -> None:
    """Nothing moves and nothing is elastic: eigenvalues are rounding errors, and there is nothing to compare with."""
    m = Mechanism()
    for k in range(70):
        body = m.body(f"mass{k}", m.ground, Translational(axis="x"), mass=1.0)
    m.force("push", JointForce(mb.Polynomial((0.0, 2.0))), body)
    m.output("rate", body.rate())
    result = mb.simulate(m, 1.0, solver="ida", tolerance=1e-6)
    assert [d.code for d in without_details(result.diagnostics)] == ["assumed-length"]
    np.testing.assert_allclose(result["rate"], result.t**2, atol=LARGEST_ERROR * 1e-6)


STOPS: dict[str, Callable[[], Case]] = {
    "damped stop": bouncing,
    "soft stop": lambda: bouncing(1e3, 0.0),
    "stiff stop": lambda: bouncing(1e5, 0.5),
    "between soft stops": lambda: turning_pendulum_on_stops(1e3),
}


@pytest.mark.parametrize("solver", ["radau", "adams", "ida"])
@pytest.mark.parametrize("kind", STOPS)
def test_stops_are_as_accurate_as_smooth_forces(kind: str, solver: str) -> None:
    """The estimate of 'radau' is of order 3: where a force has a corner the motion is no more accurate than that."""
    case = STOPS[kind]()
    motion = truth(case.mechanism, np.linspace(0.0, case.stop_time, 81), case.exact)
    for rtol in (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12):
        verdict = judge(case.mechanism, motion, solver, rtol, max_steps=200_000)
        assert verdict.word == "right", (rtol, str(verdict))


def test_esdirk_keeps_small_tolerances_and_reports_those_that_it_does_not_use() -> None:
    """What Newton left of a stage was limited from below, and added up to 40 tolerances at 1e-10, 2900 at 1e-11."""
    case = chain(61)
    motion = truth(case.mechanism, np.linspace(0.0, 0.1, 9), case.exact)
    for rtol in (1e-9, 1e-10):
        verdict = judge(case.mechanism, motion, "esdirk", rtol, factor=10.0)
        assert verdict.word == "right", (rtol, str(verdict))
    result = mb.simulate(case.mechanism, 1e-3, interval=1e-3, solver="esdirk", tolerance=1e-12)
    assert any("a tolerance of 1e-10 instead of 1e-12" in remark for remark in map(str, result.diagnostics))
    assert result.statistics.coarser == pytest.approx(100.0)
