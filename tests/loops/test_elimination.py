"""Constraints eliminated along the tree, against dense linear algebra of NumPy, exact motions, and hand-made cases."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from judge import judge, truth
from mechanisms import CASES, ladder, n_four_bar, parallelogram

import solvers.steppers
from mbfmu.mechanics import CompiledMechanism, Gear, JointSpring, Mechanism, Revolute, RevoluteCutJoint, cuts, rod
from mbfmu.mechanics.cuts import CutJoint, RollingWheel
from mbfmu.mechanics.elimination.plan import Elimination, find_capacity, motion
from mbfmu.mechanics.elimination.records import reduce_graph
from mbfmu.mechanics.joints import Cylindrical, Floating, Planar, Spherical, Universal
from mbfmu.mechanics.kind import element_types_of
from mbfmu.mechanics.signals import Harmonic
from solvers import Options, stepper
from solvers.compiled.kernel import kernel
from solvers.energy_account import WORK
from solvers.outcome import Code
from solvers.steppers.adams.eliminated import EliminatedAdamsStepper
from solvers.system import DROPPED, ELIMINATION_REPORT_SIZE, RANK, SHORTEST, System

CUTS = sorted(
    (kind for kind in element_types_of(cuts, CutJoint) if not issubclass(kind, RollingWheel)),
    key=lambda kind: kind.__name__,
)  # wheels are in small models only
DROP = 1e-10


@kernel
def _accelerate(eqs: Any, t: float, q: Any, v: Any, qdot: Any, a: Any, lam: Any, report: Any) -> int:
    return eqs.accelerate(t, q, v, eqs.elimination, DROP, True, qdot, a, lam, report)


@kernel
def _correct(eqs: Any, t: float, q: Any, v: Any, dq: Any, dv: Any, report: Any) -> None:
    eqs.correct_position(t, q, eqs.elimination, DROP, -1.0, dq, report)
    eqs.correct_velocity(t, q, v, eqs.elimination, DROP, dv, report)


class Solved:
    """Accelerations, multipliers and corrections of a mechanism at one state, and its matrices there."""

    def __init__(self, compiled: CompiledMechanism, t: float, q: Any, v: Any) -> None:
        system = compiled.system
        self.size, self.v = system.size, v
        z = np.zeros
        self.a, self.lam, self.dq, self.dv = z(system.n), z(system.m), z(system.n), z(system.n)
        self.report, qdot, eqs = z(ELIMINATION_REPORT_SIZE), z(system.nq), system.elimination()
        _correct(eqs, t, q, v, self.dq, self.dv, self.report)
        assert _accelerate(eqs, t, q, v, qdot, self.a, self.lam, self.report) == 0
        dense: System = system if system.has_matrices else system.dense()
        self.terms = dense.allocate_terms()
        dense.fill(t, q, v, self.terms)
        np.testing.assert_allclose(qdot, self.terms.qdot, atol=1e-13 * max(1.0, np.abs(qdot).max()))

    def expected(self, redundant: float = 1e-9) -> Any:
        """Accelerations by a basis of the allowed motions from the singular value decomposition of J."""
        T, size = self.terms, self.size
        J = T.J * size
        _, sigma, V = np.linalg.svd(J)
        rank = int(np.count_nonzero(sigma > redundant * sigma[0]))
        P = size[:, None] * V[rank:].T
        a = size * (np.linalg.pinv(J, rcond=redundant) @ T.gamma)
        return a - P @ np.linalg.solve(P.T @ T.M @ P, P.T @ (T.M @ a + T.h)) if P.size else a

    def check(self, tolerance: float, redundant: float = 1e-9) -> None:
        """Compare everything with NumPy."""
        T, size = self.terms, self.size
        a = self.expected(redundant)
        np.testing.assert_allclose(self.a, a, atol=tolerance * max(1.0, np.abs(a).max()))
        off = T.J.T @ self.lam + T.M @ a + T.h
        assert np.abs(off / size).max() <= tolerance * np.abs(np.r_[1.0, T.h, T.M @ a] / np.r_[1.0, size, size]).max()
        for found, residual in ((self.dq, -T.Phi), (self.dv, T.nu - T.J @ self.v)):
            best = size * (np.linalg.pinv(T.J * size, rcond=redundant) @ residual)
            np.testing.assert_allclose(found, best, atol=tolerance * max(1e-3, np.abs(best).max()))


def random_graph(seed: int) -> tuple[list[int], list[set[tuple[int, int]]]]:
    """Parents and equations of a random tree with random loops and couplings."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 40))
    parents = [0, *(int(rng.integers(max(0, i - 4), i)) for i in range(1, count))]
    found = []
    for _ in range(int(rng.integers(0, 30))):
        a, b = (int(i) for i in rng.integers(0, count, 2))
        kind = rng.integers(2)
        ends = {(i, 0) if kind else motion(i) for i in (a, b) if i > 0}
        if a != b and ends:
            found.append(ends)
    return parents, found


@pytest.mark.parametrize("seed", range(30))
def test_every_body_and_every_equation_has_one_front(seed: int) -> None:
    parents, equations = random_graph(seed)
    fronts = Elimination(parents, equations).order()
    at = {front.body: k for k, front in enumerate(fronts)}
    assert sorted(at) == list(range(1, len(parents)))
    assert all(at[i] < at[parents[i]] for i in at if parents[i] > 0)
    assert sorted(e for front in fronts for e in front.equations) == list(range(len(equations)))
    capacity = find_capacity(fronts, [0, *(1 for _ in parents[1:])])
    for k, front in enumerate(fronts):
        own = {v for e in front.equations for v in equations[e]}
        sent = {v for i in front.messages for v in fronts[i].interface}
        known = {motion(parents[front.body])} if parents[front.body] > 0 else set()
        assert set(front.interface) == {v for v in own | sent | known if v[0] != front.body}
        assert all(at[v[0]] > k for v in front.interface)
        assert front.target == min((at[v[0]] for v in front.interface), default=-1)
        assert all(fronts[i].target == k for i in front.messages)
        assert capacity.delayed[k] <= front.interface_width


@pytest.mark.parametrize(
    ("make", "width"), [(n_four_bar, 6), (lambda n: n_four_bar(n, grounded=True), 6), (ladder, 12)]
)
def test_interfaces_of_chains_of_loops_are_as_narrow_in_long_ones(make: Any, width: int) -> None:
    for loops in (3, 30):
        reduced = reduce_graph(CompiledMechanism(make(loops).mechanism).data.arrays)
        assert max(front.interface_width for front in reduced.fronts) == width
        assert reduced.capacity.coordinates.max() <= 6 + 2 * width


def turned(rng: np.random.Generator) -> Any:
    Q, R = np.linalg.qr(rng.normal(size=(3, 3)))
    Q = Q * np.sign(np.diag(R))
    return Q if np.linalg.det(Q) > 0 else -Q


def random_mechanism(seed: int) -> Mechanism:
    """A tree of all kinds of joints, one of them driven; loops between any bodies, one of them twice; and a gear."""
    rng = np.random.default_rng(seed)
    m = Mechanism(gravity=rng.normal(size=3))
    kinds = [Floating, *rng.choice(np.array([Revolute, Cylindrical, Planar, Spherical, Universal, Floating]), 7)]
    for i, kind in enumerate(kinds):
        options: dict[str, Any] = {"at": rng.normal(size=3), "rotation": turned(rng)}
        if kind is Revolute and not any(body.joint.drive for body in m.bodies[1:]):
            options["drive"] = Harmonic(amplitude=0.5, frequency=0.3, phase=rng.normal())
        if kind is Revolute:
            options |= {"armature": abs(options["at"][0]), "nominal": 0.3}
        points = rng.normal(size=(4, 3))
        inertia = sum((p @ p) * np.eye(3) - np.outer(p, p) for p in points)
        massless = i == 3 and kind is Revolute
        shape: dict[str, Any] = {} if massless else {"mass": rng.uniform(0.5, 2.0), "inertia": inertia}
        m.body(f"b{i}", m.bodies[rng.integers(0, i + 1)], kind(**options), com=rng.normal(size=3), **shape)
    tip = m.body("tip", m.bodies[-1], Spherical(at=rng.normal(size=3)), mass=1.0, inertia=(1.0, 1.5, 2.0))
    for i, kind in enumerate(rng.choice(np.array(CUTS), 2)):
        options = {"at_a": rng.normal(size=3), "at_b": rng.normal(size=3), "rotation_a": turned(rng)}
        options |= {"rotation_b": turned(rng)} | ({"length": 1.3} if "length" in kind.__dataclass_fields__ else {})
        other = m.bodies[rng.integers(0, len(m.bodies) - 1)]
        for copy in range(2 if i == 0 else 1):
            m.cut(f"c{i}.{copy}", kind(**options), tip if i == 0 else m.bodies[1], other if i == 0 else tip)
    plain = [(b, k) for b in m.bodies[2:-1] for k in range(b.joint.nv - 3 * b.joint.quaternion)]
    if len(plain) > 1:
        (a, k), (b, l) = (plain[j] for j in rng.permutation(len(plain))[:2])
        m.couple("g", Gear(ratio=0.7, offset=0.1), a, b, coordinate_a=k, coordinate_b=l)
    return m


@pytest.mark.parametrize("seed", range(40))
def test_random_loops_are_solved_as_by_dense_matrices(seed: int) -> None:
    compiled, rng = CompiledMechanism(random_mechanism(seed)), np.random.default_rng(seed)
    system = compiled.system
    q, v = compiled.assembly.start_positions(), rng.normal(size=system.n)
    system.apply(q, rng.normal(size=system.n))
    solved = Solved(compiled, 0.3, q, v)
    T = solved.terms
    J = T.J * solved.size
    tolerance = 1e-9 * np.linalg.norm(J, 2)
    rank = np.linalg.matrix_rank(J, tol=tolerance)
    assert solved.report[RANK] == rank
    assert solved.report[RANK] + solved.report[DROPPED] == system.m
    right = np.c_[T.gamma, T.Phi, T.nu - T.J @ v]
    if np.linalg.matrix_rank(np.c_[J, right], tol=tolerance) == rank:  # else redundant equations contradict each other
        solved.check(1e-10)


def bent(loops: int, off: float) -> tuple[CompiledMechanism, Any]:
    """A chain of four-bars with a hinge of each column fixed to the ground; every coupler and the column behind it are
    in line but for the angle ``off``: no loop is singular, as the column before them has another direction.
    """
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    body = m.body("column0", m.ground, Revolute(start=1.1), **rod(mass=1.0, length=1.0))
    angle, end = 1.1, np.array([np.cos(1.1), np.sin(1.1)])
    q = [1.1]
    for i in range(1, loops + 1):
        line = 0.1 if i % 2 else 1.2
        for name, length, to in (("coupler", 1.2, line), ("column", 0.8, line + off)):
            joint = Revolute(at=((1.0 if i == 1 else 0.0) if name == "coupler" else 1.2, 0.0, 0.0), start=to - angle)
            body = m.body(f"{name}{i}", body, joint, **rod(mass=1.0, length=length))
            q.append(to - angle)
            angle = to
            if name == "coupler":
                end = end + 1.2 * np.array([np.cos(to), np.sin(to)])
        foot = end + 0.8 * np.array([np.cos(angle), np.sin(angle)])
        m.cut(f"foot{i}", RevoluteCutJoint(at_a=(0.8, 0.0, 0.0), at_b=(*foot, 0.0)), body, m.ground)
    return CompiledMechanism(m), np.array(q)


@pytest.mark.parametrize("off", [1e-1, 1e-2, 1e-4, 1e-6, 1e-8, 0.0])
def test_dead_centers_of_many_loops_cost_no_accuracy(off: float) -> None:
    """Elimination without delayed pivots would lose a power of 1 / off in every loop."""
    compiled, q = bent(12, off)
    solved = Solved(compiled, 0.0, q, np.random.default_rng(1).normal(size=len(q)))
    assert solved.report[RANK] == compiled.system.m
    solved.check(1e-11)


@pytest.mark.parametrize("loops", [1, 5, 40])
def test_the_shortest_equation_is_the_distance_from_the_crossing_for_any_number_of_loops(loops: int) -> None:
    compiled = CompiledMechanism(n_four_bar(loops).mechanism)
    signs = np.array([1.0, *(-1.0, 1.0) * loops])
    shortest = []
    for angle in (1e-2, 1e-4, 1e-6):
        solved = Solved(compiled, 0.0, angle * signs, signs)
        shortest.append(float(solved.report[SHORTEST] / angle))
        assert solved.report[RANK] == compiled.system.m
    assert max(shortest) < 1.05 * min(shortest)
    assert 0.3 < min(shortest) < 3.0
    assert Solved(compiled, 0.0, 0.0 * signs, signs).report[RANK] < compiled.system.m
    assert Solved(compiled, 0.0, 0.5 * np.pi * signs, signs).report[SHORTEST] > 0.1


@pytest.fixture
def everywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small mechanisms are eliminated too."""
    monkeypatch.setattr(solvers.steppers, "MIN_ELIMINATION_COORDINATES", 0)


SMALL = (
    "grashof + 1e-2", "grashof - 1e-5", "parallelogram + 1e-5", "slider-crank + 1e-5", "three cranks, singular",
    "table, singular", "double parallelogram, singular", "slider-crank", "crane", "bricard", "squeezer",
)  # fmt: skip


@pytest.mark.usefixtures("everywhere")
@pytest.mark.parametrize("name", SMALL)
def test_motions_near_and_through_singular_configurations(name: str) -> None:
    case = CASES[name]()
    motion = truth(case.mechanism, np.linspace(0.0, min(case.stop_time, 2.0), 21), case.exact)
    for rtol in (1e-6, 1e-8):
        verdict = judge(case.mechanism, motion, "adams", rtol)
        assert verdict.word == "right", verdict


@pytest.mark.usefixtures("everywhere")
def test_a_near_miss_that_rounding_hides_is_refused() -> None:
    compiled = CompiledMechanism(parallelogram(1e-11).mechanism)
    run = stepper("adams", compiled.system, 0.0, *compiled.assembly.assemble(0.0), Options(rtol=1e-8))
    assert run.advance(1.0).code is Code.BRANCHES
    assert run.t < 0.2


@pytest.mark.usefixtures("everywhere")
@pytest.mark.parametrize("longer", [{1: 1e-3}, {1: 3e-3, 3: -2e-3}])
def test_a_crossing_next_to_a_near_miss(longer: dict[int, float]) -> None:
    case = n_four_bar(max(2, *longer), longer=longer)
    motion = truth(case.mechanism, np.linspace(0.0, 1.0, 21), case.exact)
    for rtol in (1e-6, 1e-8):
        verdict = judge(case.mechanism, motion, "adams", rtol)
        assert verdict.word in ("right", "stopped"), verdict


@pytest.mark.parametrize("make", [lambda: n_four_bar(40), lambda: n_four_bar(40, grounded=True), lambda: ladder(40)])
def test_large_mechanisms_with_loops_follow_the_exact_motion(make: Any) -> None:
    case = make()
    compiled, times = CompiledMechanism(case.mechanism), np.linspace(0.0, 2.0, 21)
    run = stepper("adams", compiled.system, 0.0, *compiled.assembly.assemble(0.0), Options(rtol=1e-8))
    assert isinstance(run, EliminatedAdamsStepper)
    found, exact = run.sample(times[1:]), case.exact(times)[0][1:]
    np.testing.assert_allclose(found.q, exact, atol=2e-6)


def test_a_saved_run_continues_as_it_would_have() -> None:
    compiled = CompiledMechanism(n_four_bar(31).mechanism)
    start = compiled.assembly.assemble(0.0)
    first, other = (stepper("adams", compiled.system, 0.0, *start, Options(rtol=1e-6)) for _ in range(2))
    first.advance(0.7)
    other.restore(first.save())
    first.advance(1.0)
    other.advance(1.0)
    np.testing.assert_array_equal(first.q, other.q)


def test_the_work_of_drives_and_dampers_is_the_change_of_energy() -> None:
    """A row of four-bars with dampers in its hinges, whose first column is driven."""
    drive = Harmonic(amplitude=0.4, frequency=0.5, mean=1.2)
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    column, top = m.body("column0", m.ground, Revolute(drive=drive), **rod(mass=1.0, length=1.0)), (1.0, 0.0, 0.0)
    for i in range(1, 33):
        coupler = m.body(f"coupler{i}", column, Revolute(at=top), **rod(mass=1.0, length=1.0))
        column = m.body(f"column{i}", coupler, Revolute(at=(1.0, 0.0, 0.0)), **rod(mass=1.0, length=-1.0))
        m.force(f"damper{i}", JointSpring(damping=0.1), coupler)
        feet = {"at_a": (-1.0, 0.0, 0.0), "at_b": (i, 0.0, 0.0)}
        m.cut(f"foot{i}", RevoluteCutJoint(**feet), column, m.ground)
        top = (0.0, 0.0, 0.0)
    compiled = CompiledMechanism(m)
    q, v = compiled.assembly.close(0.0, np.tile([-1.2, 1.2], 32), np.zeros(64, bool)), np.zeros(64)
    run = stepper("adams", compiled.system, 0.0, q, v, Options(rtol=1e-9))
    assert isinstance(run, EliminatedAdamsStepper)
    before = compiled.energy(0.0, run.q, run.v)
    assert run.freedom == 0
    assert run.advance(0.7).ok
    changed = compiled.energy(0.7, run.q, run.v) - before
    assert abs(changed) > 1.0
    np.testing.assert_allclose(run.energy_account[WORK], changed, rtol=1e-6)


def test_the_hybrid_eliminates_too() -> None:
    compiled = CompiledMechanism(n_four_bar(31).mechanism)
    start = compiled.assembly.assemble(0.0)
    assert isinstance(stepper("hybrid", compiled.system, 0.0, *start), EliminatedAdamsStepper)
