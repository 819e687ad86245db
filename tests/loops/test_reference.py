"""The reference of closed loops against closed forms, numbers of the literature, and identities."""

from __future__ import annotations

from dataclasses import replace
from math import cos, pi, sin
from typing import Any

import numpy as np
import pytest
from formulation import formulate
from hypothesis import given, settings
from judge import judge, truth
from maximal import Maximal
from mechanisms import (
    CASES,
    SQUEEZER_END,
    Case,
    Scale,
    crane,
    double_parallelogram,
    grashof,
    ladder,
    n_four_bar,
    parallelogram,
    slider_crank,
    squeezer,
    swinging,
    table,
    three_cranks,
)
from planar import Planar
from random_loops import Drawn, draw, loops
from reference import distance, integrate, reference
from spatial import Spatial
from tree import backward, forward, units

from mbfmu.mechanics import (
    CompiledMechanism,
    Floating,
    Mechanism,
    Polynomial,
    Revolute,
    RevoluteCutJoint,
    Spherical,
    Translational,
    rod,
)


def coordinates(mechanism: Mechanism) -> tuple[Maximal, Any, Any]:
    """The maximal coordinates of a mechanism as it assembles."""
    start = CompiledMechanism(mechanism).assemble()
    unit = units(mechanism, start[1])
    body = formulate(mechanism, unit, 0.0, forward(mechanism, 0.0, *start))
    return body, *body.start()


def error(case: Case, times: Any) -> float:
    """How far the reference is from the exact motion."""
    assert case.exact is not None
    start = CompiledMechanism(case.mechanism).assemble()
    run = integrate(case.mechanism, times, start)
    assert not run.ended
    return float(distance(case.mechanism, start[1], run.q, case.exact(times)[0]).max())


@pytest.mark.parametrize(
    "case",
    [
        three_cranks(),
        three_cranks(start=-70.0, scale=Scale(1e-3, 1e3, 0.1)),
        table(),
        double_parallelogram(),
        ladder(4, start=(-80.0, -60.0, -100.0, -110.0)),
    ],
    ids=["three cranks", "three small cranks", "table", "double parallelogram", "ladder"],
)
def test_parallel_cranks_off_their_singular_positions(case: Case) -> None:
    assert error(case, np.linspace(0.0, 0.4 * case.stop_time, 9)) < 1e-10


@pytest.mark.parametrize("start", [20.0, 100.0])
def test_slider_crank_up_to_its_singular_position(start: float) -> None:
    assert error(slider_crank(start=start), np.linspace(0.0, 0.3, 7)) < 1e-10


def test_a_pendulum_turns_and_is_counted_in_whole_turns() -> None:
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    m.body("bob", m.ground, Revolute(start=0.3, rate=9.0), **rod(mass=2.0, length=1.5))
    times = np.linspace(0.0, 8.0, 5)
    exact = swinging(2.0 * 1.5**2 / 3.0, 2.0 * 9.81 * 0.75, (0.3, 9.0), lambda a, b: (a[:, None], b[:, None]))
    run = integrate(m, times, (np.array([0.3]), np.array([9.0])))
    q, v = exact(times)
    assert q[-1, 0] > 8.0 * pi
    np.testing.assert_allclose(run.q, q, atol=1e-9)
    np.testing.assert_allclose(run.v, v, atol=1e-8)


def test_squeezer_ends_where_the_test_set_has_it() -> None:
    case = squeezer()
    run = integrate(case.mechanism, np.array((0.0, 0.03)), CompiledMechanism(case.mechanism).assemble())
    np.testing.assert_allclose(run.q[-1], SQUEEZER_END, atol=1e-8)


def test_a_driven_slider_crank_is_where_its_formula_has_it() -> None:
    r, L, speed = 0.3, 1.1, 7.0
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    crank = m.body("crank", m.ground, Revolute(drive=Polynomial((0.2, speed, 3.0))), **rod(mass=1.0, length=r))
    link = m.body("rod", crank, Revolute(at=(r, 0.0, 0.0), start=-0.3), **rod(mass=1.0, length=L))
    slider = m.body("slider", m.ground, Translational(axis="x", start=r + L), mass=1.0)
    m.cut("pin", RevoluteCutJoint(at_a=(L, 0.0, 0.0)), link, slider)
    times = np.linspace(0.0, 2.0, 11)
    run = integrate(m, times, CompiledMechanism(m).assemble())
    angle = 0.2 + speed * times + 3.0 * times**2
    np.testing.assert_allclose(run.q[:, 1], r * np.cos(angle) + np.sqrt(L**2 - (r * np.sin(angle)) ** 2), atol=1e-10)


def test_a_free_body_keeps_its_angular_momentum_and_falls() -> None:
    m = Mechanism(gravity=(0.0, 0.0, -9.81))
    inertia = np.array((1.0, 2.0, 2.5))
    m.body("stone", m.ground, Floating(rate=(1.0, 0.0, 3.0, 0.1, 2.0, 0.1)), mass=1.0, inertia=inertia)
    times = np.linspace(0.0, 5.0, 6)
    run = integrate(m, times, CompiledMechanism(m).assemble())
    np.testing.assert_allclose(run.q[:, 0], times, atol=1e-9)
    np.testing.assert_allclose(run.q[:, 2], 3.0 * times - 0.5 * 9.81 * times**2, atol=1e-9)
    for q, v in zip(run.q, run.v, strict=True):
        pose = forward(m, 0.0, q, v)[1]
        np.testing.assert_allclose(pose.R @ (inertia * v[3:]), inertia * (0.1, 2.0, 0.1), atol=1e-9)


def test_a_conical_pendulum_goes_round() -> None:
    """A rod on a ball joint at a constant lean a to the vertical: rate^2 = 3 g / (2 l cos a)."""
    l, lean = 1.2, 0.7
    m = Mechanism(gravity=(0.0, 0.0, -9.81))
    turn = np.array((cos(0.5 * lean), 0.0, -sin(0.5 * lean), 0.0))  # z to (-sin, 0, cos)
    rate = np.sqrt(1.5 * 9.81 / (l * cos(lean)))
    spin = rate * np.array((sin(lean), 0.0, cos(lean)))  # of the vertical, in the body
    thin = (l**2 / 12.0, l**2 / 12.0, 1e-9)
    joint = Spherical(start=turn, rate=spin)
    m.body("rod", m.ground, joint, mass=1.0, com=(0.0, 0.0, -0.5 * l), inertia=thin)
    times = np.linspace(0.0, 4.0 * 2.0 * pi / rate, 5)
    run = integrate(m, times, CompiledMechanism(m).assemble())
    for q, v in zip(run.q, run.v, strict=True):
        tip = forward(m, 0.0, q, v)[1].R[:, 2]
        np.testing.assert_allclose(tip, (-sin(lean), 0.0, cos(lean)), atol=1e-6)


@pytest.mark.parametrize("eps", [1e-3, -1e-4, 1e-6])
@pytest.mark.parametrize("make", [parallelogram, grashof])
def test_near_singular_positions_two_runs_agree_and_keep_their_energy(make: Any, eps: float) -> None:
    case = make(eps)
    run = reference(case.mechanism, np.linspace(0.0, 1.25, 6))
    assert not run.ended
    assert run.difference.max() < 1e-8 + 1e-14 / abs(eps) ** 1.5
    assert run.trusted_until(1e-4) == 1.25
    assert run.trusted_until(0.0) < 1.25
    assert np.abs(run.energy - run.energy[0]).max() < 1e-7 * 54.6


@pytest.mark.parametrize("make", [parallelogram, n_four_bar, slider_crank])
def test_no_exact_singular_position_is_passed(make: Any) -> None:
    case = make()
    run = integrate(case.mechanism, np.linspace(0.0, 1.0, 101), CompiledMechanism(case.mechanism).assemble())
    assert "singular" in run.ended
    q, _ = case.exact(run.times)
    np.testing.assert_allclose(run.q, q, atol=1e-9)


@pytest.mark.parametrize("drive", ["constant", "run-up", "harmonic"])
def test_a_crane_is_independent_of_its_slewing_angle(drive: str) -> None:
    """Gravity acts along the axis of the base."""
    times = np.linspace(0.0, 1.25, 4)
    runs = []
    for start in (0.0, -45.0):
        m = crane(drive=drive, start=start).mechanism
        runs.append(integrate(m, times, CompiledMechanism(m).assemble()).q)
    assert np.ptp(runs[0], axis=0).max() > 0.05
    np.testing.assert_allclose(runs[1], runs[0], atol=1e-9)


@pytest.mark.parametrize("name", ["grashof + 1e-2", "bricard", "crane, harmonic", "squeezer", "double parallelogram"])
def test_scaled_copies_move_alike(name: str) -> None:
    scale, runs = Scale(1e-3, 20.0, 0.05), []
    for own in (Scale(), scale):
        case = CASES[name](scale=own)
        start = CompiledMechanism(case.mechanism).assemble()
        run = integrate(case.mechanism, np.linspace(0.0, 0.3 * case.stop_time, 5), start)
        lengths = np.array(
            [
                own.lengths if u == "m" else 1.0
                for b in case.mechanism.bodies[1:]
                if not b.joint.drive
                for u in b.joint.units
            ]
        )
        runs.append(run.q / lengths)
    np.testing.assert_allclose(runs[1], runs[0], atol=1e-7)


@given(loops())
@settings(max_examples=10)
def test_rows_are_the_derivatives_of_each_other(drawn: Drawn) -> None:
    """Along any motion Phi' = J v - nu, and (J v - nu)' = J v' - gamma."""
    body, x, v = coordinates(drawn.case.mechanism)
    rng, h = np.random.default_rng(drawn.seed), 1e-3
    v, a = rng.normal(size=v.shape), rng.normal(size=v.shape)
    off = rng.normal(size=v.shape)
    base = body.move(x, 0.1 * off)  # not closed

    def at(s: float) -> tuple[Any, Any]:
        place, steps = base, 8
        for i in range(steps):  # midpoint steps: even in s to sixth order is not needed, h^2 / 64 is small
            place = body.move(place, s / steps * (v + (i + 0.5) * s / steps * a))
        rows = body.rows(0.3 + s, place, v + s * a)
        return rows.Phi, rows.J @ (v + s * a) - rows.nu

    (phi, rate), (phi_, rate_) = at(h), at(-h)
    here = body.rows(0.3, base, v)
    size = 1.0 + max(np.abs(here.J @ a - here.gamma).max(), np.abs(here.gamma).max())
    np.testing.assert_allclose((phi - phi_) / (2 * h), here.J @ v - here.nu, atol=2e-5 * size)
    np.testing.assert_allclose((rate - rate_) / (2 * h), here.J @ a - here.gamma, atol=2e-4 * size)


@given(loops())
@settings(max_examples=10)
def test_positions_come_back_as_they_were_given(drawn: Drawn) -> None:
    m = drawn.case.mechanism
    q, v = CompiledMechanism(m).assemble()
    body, x, u = coordinates(m)
    assert isinstance(body, Planar | Spatial)
    back, rates = backward(m, body.poses(x, u), q)
    size = drawn.scale.lengths
    np.testing.assert_allclose(back, q, atol=1e-10 * max(1.0, size))
    np.testing.assert_allclose(rates, v, atol=1e-9 * (1.0 + np.abs(v).max()) * max(1.0, size))
    assert np.abs(body.rows(0.0, x, u).Phi).max(initial=0.0) < 1e-8


@pytest.mark.parametrize("seed", [0, 1])
def test_in_space_a_planar_mechanism_moves_as_in_its_plane(seed: int) -> None:
    drawn = draw(seed, "planar")
    m, times = drawn.case.mechanism, np.linspace(0.0, 0.3 * drawn.case.stop_time, 4)
    start = CompiledMechanism(m).assemble()
    runs = [integrate(m, times, start).q]
    drawn = draw(seed, "planar")
    m = drawn.case.mechanism
    m.body("stone", m.ground, Floating(), mass=1.0, inertia=(1.0, 1.0, 1.0))  # moves as it likes: no plane for all
    q, v = CompiledMechanism(m).assemble()
    n = len(start[0])
    assert isinstance(coordinates(m)[0], Spatial)
    runs.append(integrate(m, times, (np.r_[start[0], q[n:]], np.r_[start[1], v[len(start[1]) :]])).q[:, :n])
    assert distance(drawn.case.mechanism, v, *(np.c_[r, np.tile(q[n:], (4, 1))] for r in runs)).max() < 1e-8


def test_right_refused_and_wrong_runs_are_distinguished() -> None:
    case = three_cranks()
    known = truth(case.mechanism, np.linspace(0.0, 2.0, 21), case.exact)
    assert judge(case.mechanism, known, "adams", 1e-6).word == "right"
    stopped = judge(case.mechanism, known, "adams", 1e-6, max_steps=3)
    assert stopped.word == "stopped"
    assert "steps" in stopped.why
    moved = replace(known, q=known.q + np.linspace(0.0, 0.01, 21)[:, None])
    assert judge(case.mechanism, moved, "adams", 1e-6).word == "wrong"


def test_errors_grow_in_a_chaotic_motion_and_little_in_a_regular_one() -> None:
    regular, chaotic = three_cranks(), double_parallelogram(start=(60.0, 50.0))
    times = np.linspace(0.0, 10.0, 41)
    calm = truth(regular.mechanism, times, regular.exact)
    wild = truth(chaotic.mechanism, times, chaotic.exact)
    assert calm.amplification[-1] < 200.0
    assert wild.amplification[-1] > 10.0 * calm.amplification[-1]
