"""Mass matrices that are nearly singular at times: light bodies that carry heavy ones, against motions of SciPy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hard_trees import chain, light_cart, light_cart_among, light_gimbal, light_link, pendulum_among, turning_rods
from judge import Truth, judge, truth
from mechanisms import Case, G

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism, Mechanism, Revolute, Translational, rod
from mbfmu.util.diagnostics import without_details
from solvers import Options, stepper
from solvers.compiled.kernel import COMPILED, kernel
from solvers.inertia import LARGE_GROWTH

pytestmark = pytest.mark.skipif(not COMPILED, reason="takes minutes without a compiler")

SOLVERS = ["adams", "hybrid", "radau", "ida"]
ALLOWED = 12.0  # tolerances, times the growth of errors in the motion: 18 to 47 where rates have their usual tolerance
ENERGY = 0.2  # tolerances; 1 to 4 where rates have their usual tolerance
CASES: dict[str, Callable[[], Case]] = {
    "cart of 1e-4 kg": lambda: light_cart(1e-4),
    "cart of 1e-6 kg": light_cart,
    "cart of 1e-6 kg, 1 mm": lambda: light_cart(size=1e-3),
    "cart of 1e-6 kg, 1 km": lambda: light_cart(size=1e3),
    "cart of 1e-8 kg": lambda: light_cart(1e-8),
    "link of 1e-4 kg": lambda: light_link(1e-4),
    "link of 1e-6 kg": light_link,
    "link of 1e-8 kg": lambda: light_link(1e-8),
}
_known: dict[str, tuple[Case, Truth]] = {}


def known(name: str) -> tuple[Case, Truth]:
    """Return a case and its motion, which is integrated once; half of it where bodies are light."""
    if name not in _known:
        case = CASES[name]()
        part = 0.5 if "cart" in name and "1e-8" in name else 1.0
        _known[name] = case, truth(case.mechanism, np.linspace(0.0, part * case.stop_time, 41), case.exact)
    return _known[name]


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("rtol", [1e-4, 1e-6, 1e-8])
@pytest.mark.parametrize("name", CASES)
def test_errors_do_not_grow_with_the_rates(name: str, rtol: float, solver: str) -> None:
    case, motion = known(name)
    verdict = judge(case.mechanism, motion, solver, rtol, factor=ALLOWED if rtol < 1e-4 else 2.0 * ALLOWED)
    assert verdict.word == "right", verdict


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("ratio", [1e-6, 1e-8])
def test_energy_is_kept_near_gimbal_lock(ratio: float, solver: str) -> None:
    case = light_gimbal(ratio)
    motion = truth(case.mechanism, np.linspace(0.0, case.stop_time, 21), case.exact)
    verdict = judge(case.mechanism, motion, solver, 1e-6)
    assert verdict.word == "right", verdict
    assert verdict.energy <= ENERGY * 1e-6, verdict


@pytest.mark.parametrize("rtol", [1e-4, 1e-6])
@pytest.mark.parametrize(("solver", "allowed"), [("adams", 20.0), ("ida", 60.0), ("esdirk", 100.0)])
def test_errors_do_not_grow_in_large_trees(solver: str, allowed: float, rtol: float) -> None:
    """They were 46 to 160 times the tolerance, and 3000 to 5000 times with 'esdirk'."""
    case = light_cart_among(61)
    motion = truth(case.mechanism, np.linspace(0.0, case.stop_time, 21), case.exact)
    verdict = judge(case.mechanism, motion, solver, rtol, factor=allowed)
    assert verdict.word == "right", verdict


def test_esdirk_reports_that_its_order_is_low() -> None:
    result = mb.simulate(light_cart_among(61).mechanism, 0.5, solver="esdirk")
    assert any(
        "mass matrix is nearly singular" in remark and "Use 'adams'" in remark
        for remark in map(str, result.diagnostics)
    )
    assert mb.simulate(light_cart_among(61).mechanism, 0.5, solver="adams").diagnostics == ()


def test_parts_of_the_inertia_are_those_of_the_energy() -> None:
    """The energy is quadratic in the rates of the free joints, whatever the drives do."""
    m, rng = Mechanism(gravity=(0.0, -G, 0.0)), np.random.default_rng(3)
    bodies = [m.ground]
    for k in range(60):
        at, axis = tuple(rng.normal(size=3)), tuple(rng.normal(size=3))
        drive = mb.Polynomial((0.0, 2.0)) if k % 9 == 1 else None
        joint: Any = mb.Spherical(at=at) if k % 5 == 0 else Revolute(at=at, axis=axis, drive=drive)
        inertia, com = (1.0, 1.1, 1.2), tuple(rng.normal(size=3))
        bodies.append(m.body(f"b{k}", bodies[k // 2], joint, mass=rng.uniform(0.1, 2.0), com=com, inertia=inertia))
        if k % 4 == 0:
            joint = Translational(at=at, axis=axis)
            bodies[-1] = m.body(f"s{k}", bodies[-1], joint, mass=1.0, com=com, inertia=inertia)
    compiled = CompiledMechanism(m)
    system: Any = compiled.system
    assert not system.has_matrices
    q, _ = compiled.assemble()
    v, rest = rng.normal(size=system.n), np.zeros(system.n)

    def quadratic(x: Any) -> float:
        return compiled.energy(0.3, q, x) + compiled.energy(0.3, q, -x) - 2.0 * compiled.energy(0.3, q, rest)

    parts, qdot, tau = np.zeros(1 + system.n), np.zeros(system.nq), np.zeros(system.n)
    call_parts(system.inverse, system.inertia_parts, q, v, system.pinned_data, qdot, tau, parts)
    np.testing.assert_allclose(parts[0], quadratic(v), rtol=1e-10)
    np.testing.assert_allclose(parts[1:], [quadratic(row) for row in np.eye(system.n)], rtol=1e-9)


@kernel
def call_parts(inverse: Any, parts_of: Any, q: Any, v: Any, data: Any, qdot: Any, tau: Any, parts: Any) -> None:
    """Fill parts at (q, v) at 0.3 s."""
    inverse(0.3, q, v, tau, tau[:0], data, qdot, tau)
    parts_of(data, parts)


def growth(mechanism: Mechanism, stop_time: float, solver: str = "adams") -> float:
    """Return the largest rate growth of a run."""
    compiled = CompiledMechanism(mechanism)
    motion = stepper(solver, compiled.system, 0.0, *compiled.assemble(), Options(rtol=1e-6))
    assert motion.advance(stop_time).ok
    return motion.statistics.rate_growth


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_growth_has_no_unit(size: float, solver: str) -> None:
    """At the first passage all of the energy is in the cart and the turning pole: (m / M)^1/2 times the usual rate."""
    assert growth(light_cart(1e-6, size).mechanism, 0.6 * size**0.5, solver) == pytest.approx(1e3, rel=0.1)


@pytest.mark.parametrize("solver", ["adams", "ida", "esdirk"])
def test_growth_is_computed_in_large_trees(solver: str) -> None:
    """Absolute tolerances of rates have larger units there, below which rates do not count."""
    assert 400.0 < growth(light_cart_among(61).mechanism, 0.6, solver) < 1100.0


def alternating_chain(links: int, ratio: float) -> Mechanism:
    """A hanging chain whose rods have 1 and ``ratio`` kg by turns, bent at every joint."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    body = m.ground
    for k in range(links):
        joint = Revolute(at=(0.2 if k else 0.0, 0.0, 0.0), start=0.2 if k else -0.5 * np.pi, fixed=True)
        body = m.body(f"link{k}", body, joint, **rod(mass=ratio if k % 2 else 1.0, length=0.2))
    return m


@pytest.mark.parametrize(
    ("make", "stop_time"),
    [
        (lambda: chain(2).mechanism, 2.0),
        (lambda: chain(30).mechanism, 0.5),
        (lambda: chain(59).mechanism, 0.1),
        (lambda: pendulum_among(59).mechanism, 0.5),
        (lambda: pendulum_among(61).mechanism, 0.5),
        (lambda: chain(61).mechanism, 0.1),
        (lambda: turning_rods(20).mechanism, 0.5),
        (lambda: alternating_chain(6, 1e-3), 1.0),
        (lambda: alternating_chain(6, 1e3), 1.0),
        (lambda: alternating_chain(20, 1e-3), 0.5),
    ],
)
def test_growth_of_other_mechanisms_is_small(make: Any, stop_time: float) -> None:
    assert growth(make(), stop_time) < 0.5 * LARGE_GROWTH


def test_light_bodies_are_reported_by_check_and_leave_a_run_silent() -> None:
    found = mb.check(light_cart().mechanism, 1.0)
    assert "its mass matrix is nearly singular at times" in found.hard
    assert "mass matrix: nearly singular at t = 0.45" in found.as_text()
    assert "mass matrix" not in mb.check(chain(3).mechanism, 1.0).as_text()
    result = mb.simulate(light_cart().mechanism, 1.0)
    assert without_details(result.diagnostics) == []
    assert not result.warning


@pytest.mark.parametrize("solver", ["adams", "radau"])
def test_growth_is_saved_with_the_state(solver: str) -> None:
    """A restored run continues with the tolerance it had, here in the middle of a passage."""
    compiled = CompiledMechanism(light_cart().mechanism)
    motion = stepper(solver, compiled.system, 0.0, *compiled.assemble(), Options(rtol=1e-6))
    assert motion.advance(0.4514).ok
    saved = motion.save()
    assert motion.advance(1.0).ok
    other = stepper(solver, compiled.system, 0.0, *compiled.assemble(), Options(rtol=1e-6))
    other.restore(saved)
    assert other.advance(1.0).ok
    np.testing.assert_array_equal(other.q, motion.q)


def test_a_massless_cart_is_refused_with_the_reason() -> None:
    result = mb.simulate(light_cart(1e-14).mechanism, 1.0)
    assert result.t[-1] < 0.46
    assert "body 'cart' of 1e-14 kg" in result.failure
