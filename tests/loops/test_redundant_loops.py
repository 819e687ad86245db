"""Many cranks on one rail: all but one of the loops are redundant. References: the motion of one angle, and NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism
from solvers import Options
from solvers.outcome import Code
from solvers.steppers.eliminated import EliminatedFormulation

ANGLE, GRAVITY = -0.5, 9.81  # rad at the start, m/s^2
RAIL = 2.0  # kg; the cranks have 1 kg
SWING = mb.Harmonic(amplitude=0.3, frequency=1.0, mean=-ANGLE)  # of a drive, rad


def cranks(
    count: int, seed: int | None = None, *, scale: float = 1.0, doubled: int = 0, stiffness: float = 0.0,
    driven: bool = False,
) -> mb.Mechanism:  # fmt: skip
    """Equal cranks of ``scale`` m between the ground and a rail.

    ``seed`` of the directions and of the order of the joints; None: cranks to the ground and rail to the cranks. The
    first ``doubled`` pins exist twice. The first foot has a spring of ``stiffness`` (N m/rad) or is ``driven``.
    """
    rng, m = np.random.default_rng(seed), mb.Mechanism(gravity=(0.0, -GRAVITY * scale, 0.0))
    rail = m.body("rail", mass=RAIL, com=(scale, 0.0, 0.0), inertia=(0.1 * scale**2,) * 3)
    bars = [m.body(f"crank{i}", **mb.rod(mass=1.0, length=scale)) for i in range(count)]
    foot, top, joints = (0.0, 0.0, 0.0), (scale, 0.0, 0.0), []
    for i in range(count):
        at = (i * scale, 0.0, 0.0)
        joints.append((f"foot{i}", bars[i], m.ground, foot, at, -ANGLE))
        joints += [(f"pin{i}.{k}", rail, bars[i], at, top, ANGLE) for k in range(2 if i < doubled else 1)]
    for k in range(len(joints)) if seed is None else rng.permutation(len(joints)):
        name, a, b, at_a, at_b, start = joints[k]
        if seed is not None and rng.random() < 0.5 and not (driven and name == "foot0"):
            a, b, at_a, at_b, start = b, a, at_b, at_a, -start
        if driven and name == "foot0":
            hinge = mb.Revolute(at=at_a, drive=SWING)
        else:
            hinge = mb.Revolute(at=at_a, start=start)
        joint = m.joint(name, a, b, hinge, at_b=at_b)
        if stiffness and name == "foot0":
            m.force("spring", mb.JointSpring(stiffness=stiffness), joint)
    m.output("x", rail.position("x"))
    m.output("y", rail.position("y"))
    return m


def exact_angles(count: int, stiffness: float, times: Any) -> Any:
    """Angle of the cranks (rad): (n / 3 + M) x'' = -(n / 2 + M) g cos x - k x, with lengths of 1 m."""
    inertia, weight = count / 3.0 + RAIL, (0.5 * count + RAIL) * GRAVITY

    def right(_: float, y: Any) -> Any:
        return [y[1], -(weight * np.cos(y[0]) + stiffness * y[0]) / inertia]

    return solve_ivp(right, (0.0, times[-1]), [ANGLE, 0.0], "DOP853", times, rtol=1e-11, atol=1e-13).y[0]


CASES: tuple[tuple[int, int | None, dict[str, Any]], ...] = (
    (60, None, {}),
    (60, 0, {}),
    (62, 1, {"scale": 1e3, "doubled": 20}),
    (62, None, {"scale": 1e-3, "stiffness": 2e-4}),
    (62, 2, {"driven": True, "doubled": 5}),
)
MORE = [pytest.param(solver, *case, marks=pytest.mark.campaign) for solver in ("esdirk", "adams") for case in CASES]
MORE += [pytest.param("ida", *case, marks=pytest.mark.campaign) for case in CASES[3:]]


@pytest.mark.parametrize(("solver", "count", "seed", "own"), [*(("ida", *case) for case in CASES[:3]), *MORE])
def test_every_output_is_accurate(solver: str, count: int, seed: int | None, own: dict[str, Any]) -> None:
    scale, stiffness, tolerance = own.get("scale", 1.0), own.get("stiffness", 0.0), 1e-6
    result = mb.simulate(cranks(count, seed, **own), 0.2, interval=2e-3, solver=solver, tolerance=tolerance)
    assert not result.failure
    assert not result.warning
    if own.get("driven"):
        angle = ANGLE - 0.3 * np.sin(2.0 * np.pi * result.t)
    else:
        angle = exact_angles(count, stiffness / scale**2, result.t)
    off = np.hypot(result["x"] / scale - np.cos(angle), result["y"] / scale - np.sin(angle))
    assert off.max() < 5.0 * tolerance
    assert result.statistics.steps < 300


@pytest.mark.parametrize("seed", [None, 0, 1])
def test_states_off_the_constraints_are_closed_by_the_least_change(seed: int | None) -> None:
    """Redundant equations are as long there as the state is off: rounding errors divided by that are no correction."""
    compiled, rng = CompiledMechanism(cranks(60, seed)), np.random.default_rng(5)
    q, v = compiled.assembly.assemble(0.0)
    form = EliminatedFormulation(compiled.system, 0.0, q.copy(), v.copy(), Options(rtol=1e-8))
    terms = compiled.system.allocate_terms()
    for off in (1e-12, 1e-11, 1e-10, 1e-9, 1e-8, 1e-7):
        found = q + off * rng.normal(size=len(q))
        best = found.copy()
        assert form.project(0.0, found, np.zeros(len(q))) is Code.OK
        for _ in range(4):  # Gauss-Newton with the rank that is known
            compiled.system.fill_position(0.0, best, terms)
            U, sigma, W = np.linalg.svd(terms.J)
            r = form.rank
            best -= W[:r].T @ ((U[:, :r].T @ terms.Phi) / sigma[:r])
        np.testing.assert_allclose(found, best, rtol=0.0, atol=1e-12 + 20.0 * off**2)


@pytest.mark.parametrize("seed", [None, 0])
def test_starts_are_closed_by_the_least_change(seed: int | None) -> None:
    compiled, rng = CompiledMechanism(cranks(102, seed)), np.random.default_rng(6)
    system, (closed, _) = compiled.system, compiled.assembly.assemble(0.0)
    terms, free = system.allocate_terms(), np.zeros(system.n, bool)
    for off in (1e-11, 1e-10, 1e-9, 1e-8, 1e-7):
        start = closed + off * rng.normal(size=system.n)
        found, best = compiled.assembly.close(0.0, start, free), start.copy()
        for _ in range(4):
            system.fill_position(0.0, best, terms)
            U, sigma, W = np.linalg.svd(terms.J)
            best -= W[: system.n - 1].T @ ((U[:, : system.n - 1].T @ terms.Phi) / sigma[: system.n - 1])
        np.testing.assert_allclose(found, best, rtol=0.0, atol=1e-10 + 20.0 * off**2)
