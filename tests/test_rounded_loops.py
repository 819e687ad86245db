"""Loops whose combined constraint equations are redundant, with joints that are off by a rounding: they move as exact
ones do.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import overconstrained
import pytest
from judge import truth
from mechanisms import Scale
from scipy.integrate import solve_ivp
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

import mbfmu as mb
from mbfmu.mechanics import (
    CompiledMechanism,
    Mechanism,
    Revolute,
    RevoluteCutJoint,
    SphericalCutJoint,
    Translational,
    Weld,
    rod,
)
from mbfmu.mechanics.arrays.redundant import connected_parts
from mbfmu.verification.mechanisms import spatial

MASS, INERTIA = 1.0, 0.1 + 0.25
ASKEW = Rotation.from_rotvec((0.7, -1.1, 0.4)).as_matrix()


class Rounded(Mechanism):
    """A mechanism whose joints are shifted and turned at random by ``off``, in units of ``size`` and rad."""

    def __init__(self, off: float, size: float = 1.0, **given: Any) -> None:
        super().__init__(**given)
        self._off, self._size, self._random = off, size, np.random.default_rng(0)

    def _turned(self, R: Any) -> Any:
        off = Rotation.from_rotvec(self._off * self._random.uniform(-1.0, 1.0, 3)).as_matrix()
        return (np.eye(3) if R is None else np.asarray(R)) @ off

    def _shifted(self, at: Any) -> Any:
        return np.asarray(at, float) + self._off * self._size * self._random.uniform(-1.0, 1.0, 3)

    def body(self, name: str, parent: Any, joint: Any, **given: Any) -> Any:
        if not isinstance(joint, Weld):
            joint = replace(joint, at=self._shifted(joint.at), rotation=self._turned(joint.rotation))
        return super().body(name, parent, joint, **given)

    def cut(self, name: str, cut: Any, a: Any, b: Any) -> Any:
        at_a, at_b = self._shifted(cut.at_a), self._shifted(cut.at_b)
        return super().cut(name, replace(cut, at_a=at_a, at_b=at_b, rotation_a=self._turned(cut.rotation_a)), a, b)


def cranks(off: float, size: float = 1.0, *, count: int = 3, frame: Any = None, **given: Any) -> Mechanism:
    """Parallel cranks that carry one coupler: two hold it already, and in a ``frame`` that is turned out of the plane
    of the motion every equation of a ball depends on the coordinates.
    """
    m = Rounded(off, size, gravity=(3.0 * size, 0, -9.81 * size), **given)

    def crank(k: int, x: float, z: float) -> Any:
        joint = Revolute(axis="y", at=(x * size, 0, z * size), **({"start": 0.4, "fixed": True} if k == 0 else {}))
        return m.body(
            f"crank{k}", m.ground, joint, mass=MASS, com=(0, 0, 0.5 * size), inertia=np.full(3, 0.1) * size**2
        )

    first = crank(0, 0.0, 0.0)
    joint = Revolute(axis="y", at=(0, 0, size))
    coupler = m.body("coupler", first, joint, mass=1, com=(size, 0, 0), inertia=np.full(3, 0.3) * size**2)
    for k in range(1, count):
        x, z = 2.0 * k, 0.2 * k * k
        at: Any = {"at_a": (x * size, 0, z * size), "at_b": (0, 0, size)}
        cut = RevoluteCutJoint(axis="y", **at) if frame is None else SphericalCutJoint(rotation_a=frame, **at)
        m.cut(f"pin{k}", cut, coupler, crank(k, x, z))
    m.output("angle", first.angle())
    return m


def swing(end: float, count: int) -> float:
    """Angle of the exact cranks, with a coupler that keeps its direction."""
    inertia, moment = count * INERTIA + 1.0, 0.5 * count + 1.0

    def slope(t: float, x: Any) -> Any:
        return x[1], (3.0 * np.cos(x[0]) + 9.81 * np.sin(x[0])) * moment / inertia

    return float(solve_ivp(slope, (0.0, end), (0.4, 0.0), rtol=1e-10, atol=1e-12).y[0, -1])


LOOPS = {
    "three cranks": ({"count": 3}, 1),
    "four cranks": ({"count": 4}, 2),
    "three cranks on balls": ({"count": 3, "frame": ASKEW}, 3),
    "two cranks on a ball": ({"count": 2, "frame": ASKEW}, 1),
}


@pytest.mark.parametrize("name", LOOPS)
@pytest.mark.parametrize(("off", "size"), [(1e-11, 1.0), (1e-8, 1e-3), (3e-6, 1e3)])
def test_parallel_cranks_move_as_exact_ones(name: str, off: float, size: float) -> None:
    given, redundant = LOOPS[name]
    run = mb.simulate(cranks(off, size, **given), 0.35, interval=0.07, solver="adams", tolerance=1e-8)
    assert not run.failure
    assert run["angle"][-1] == pytest.approx(swing(0.35, given["count"]), abs=3e-8 + 3.0 * off)
    told = [text for text in map(str, run.diagnostics) if "not satisfied by the given numbers" in text]
    assert len(told) == (off > 1e-9)
    assert all(text.startswith(f"{redundant} redundant constraint") for text in told)


def test_of_many_messages_the_first_are_given() -> None:
    """Nine cranks leave out three equations at each of eight pins."""
    compiled = CompiledMechanism(cranks(3e-6, count=9))
    left_out = [d for d in compiled.rounding if d.code == "nearly-parallel-axes"]
    assert len(compiled.rounded_rows) == 24
    assert len(left_out) == 5
    assert left_out[-1].text.startswith("20 more constraints are left out")


@pytest.mark.parametrize("solver", ["hybrid", "ida", "radau"])
def test_every_solver_moves_them_so(solver: str) -> None:
    for off in (1e-11, 3e-6):
        run = mb.simulate(cranks(off, frame=ASKEW), 0.35, interval=0.07, solver=solver, tolerance=1e-8)
        assert not run.failure
        assert run["angle"][-1] == pytest.approx(swing(0.35, 3), abs=1e-6 + 3.0 * off)


def test_they_pass_a_whole_turn() -> None:
    """The cranks of a locomotive: each pair of them is singular twice a turn, the three are not."""
    run = mb.simulate(cranks(3e-6), 2.0, interval=0.1, solver="adams", tolerance=1e-8)
    assert not run.failure
    assert np.ptp(run["angle"]) > 4.0
    exact = [swing(t, 3) for t in (1.0, 2.0)]
    assert run["angle"][[10, 20]] == pytest.approx(exact, abs=1e-3)


def locked(tilt: float, size: float = 1.0, off: float = 0.0, **given: Any) -> Mechanism:
    """A parallelogram that a ball closes, the axis of its rocker off by ``tilt``; three cranks on one coupler, one of
    them longer by ``off``; and a pendulum.
    """
    m = Mechanism(gravity=(3.0 * size, 0, -9.81 * size), **given)
    for k, cut in (("", SphericalCutJoint), ("2", RevoluteCutJoint)):
        lean = tilt if cut is SphericalCutJoint else 0.0
        axis = np.array((lean / 3.0, 1.0, lean)) / np.linalg.norm((lean / 3.0, 1.0, lean))
        arm = {"mass": 1, "com": (0, 0, 0.5 * size), "inertia": np.full(3, 0.1) * size**2}
        crank = m.body(f"crank{k}", m.ground, Revolute(axis="y"), **arm)
        coupler = m.body(f"coupler{k}", crank, Revolute(axis="y", at=(0, 0, size)), **rod(mass=1, length=4 * size))
        rockers = [m.body(f"rocker{k}", m.ground, Revolute(axis=tuple(axis), at=(2 * size, 0, 0)), **arm)]
        if cut is RevoluteCutJoint:
            rockers.append(m.body("third", m.ground, Revolute(axis="y", at=(4 * size, 0, 0.2 * size)), **arm))
        for i, rocker in enumerate(rockers):
            at: Any = {"at_a": (2 * (i + 1) * size, 0, 0.2 * i * size), "at_b": (0, 0, (1.0 + i * off) * size)}
            m.cut(f"pin{k}{i or ''}", cut(axis="y", **at) if cut is RevoluteCutJoint else cut(**at), coupler, rocker)
    m.output("pendulum", m.body("pendulum", m.ground, Revolute(axis="y"), **rod(mass=1, length=size)).angle())
    m.output("angle", m.bodies[1].angle())
    return m


def needed(text: str) -> float:
    """The tolerance that a message recommends."""
    return float(text.split("to at least ")[1].split(maxsplit=1)[0])


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_locked_loops_are_named_where_other_parts_move(size: float) -> None:
    free = mb.simulate(locked(0.0, size), 0.1, solver="adams")
    assert not any("cannot move" in text for text in map(str, free.diagnostics))
    run = mb.simulate(locked(2e-4, size), 0.1, solver="adams")
    (text,) = [text for text in map(str, run.diagnostics) if "cannot move" in text]
    assert text.startswith("joints 'crank', 'coupler', 'rocker' cannot move: 1 constraint is redundant except for")
    assert "'pin.y' is violated by up to" in text
    assert "joint 'rocker' are 0.000211 rad from parallel" in text
    assert run["pendulum"][-1] == pytest.approx(free["pendulum"][-1], abs=1e-6)
    again = mb.simulate(locked(2e-4, size, assembly_tolerance=needed(text)), 0.1, solver="adams")
    assert not any("cannot move" in text for text in map(str, again.diagnostics))
    assert again["angle"][-1] == pytest.approx(free["angle"][-1], abs=1e-4)


def test_check_warns_of_locked_loops() -> None:
    assert "'crank', 'coupler', 'rocker' cannot move" in mb.check(locked(2e-4), 0.1, solver="adams").as_text()


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_lengths_that_do_not_close_are_refused_with_the_tolerance_that_accepts_them(size: float) -> None:
    with pytest.raises(mb.UserError, match=r"1 constraint is redundant except for .*'pin2.* is violated by") as said:
        CompiledMechanism(locked(0.0, size, 1e-3)).assemble()
    run = mb.simulate(locked(0.0, size, 1e-3, assembly_tolerance=needed(str(said.value))), 0.1, solver="adams")
    assert not run.failure
    assert any("1 redundant constraint is not satisfied" in text for text in map(str, run.diagnostics))


def test_trusses_and_dead_centers_with_moving_parts_are_not_reported() -> None:
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    a = m.body("a", m.ground, Revolute(start=1.0471), **rod(mass=1, length=1))
    b = m.body("b", a, Revolute(at=(1, 0, 0), start=-2.0943), **rod(mass=1, length=1))
    m.cut("pin", RevoluteCutJoint(at_a=(1, 0, 0), at_b=(1, 0, 0)), b, m.ground)
    crank = m.body(
        "crank", m.ground, Revolute(start=0.0, rate=1.0, fixed=True, at=(3, 0, 0)), **rod(mass=1, length=0.3)
    )
    link = m.body("link", crank, Revolute(at=(0.3, 0, 0), start=0.0), **rod(mass=1, length=1))
    slide = m.body("slide", m.ground, Translational(axis="x", at=(3, 0, 0), start=1.3), mass=1)
    m.cut("wrist", RevoluteCutJoint(at_a=(1, 0, 0)), link, slide)
    m.output("angle", crank.angle())
    run = mb.simulate(m, 0.1, solver="adams")
    assert not any("cannot move" in text for text in map(str, run.diagnostics))
    assert abs(run["angle"][-1]) > 0.05


@pytest.mark.parametrize("name", ["bennett", "sarrus"])
@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_overconstrained_linkages_move_with_rounded_numbers(
    name: str, size: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    exact = overconstrained.OVERCONSTRAINED[name](scale=Scale(size, 1.0, np.sqrt(size)))
    motion = truth(exact.mechanism, np.linspace(0.0, 0.3 * np.sqrt(size), 4), exact.exact)
    monkeypatch.setattr(spatial, "Mechanism", lambda **given: Rounded(2e-6, size, **given))
    rounded = overconstrained.OVERCONSTRAINED[name](scale=Scale(size, 1.0, np.sqrt(size))).mechanism
    for k, body in enumerate(rounded.bodies[1:]):
        rounded.output(f"q{k}", body.angle())
    run = mb.simulate(rounded, float(motion.times[-1]), interval=float(motion.times[1]), tolerance=1e-8)
    assert not run.failure
    found = np.column_stack([run[f"q{k}"] for k in range(motion.q.shape[1])])
    np.testing.assert_allclose(found, motion.q, atol=1e-4)


@pytest.mark.parametrize("density", [0.0, 0.02, 0.1, 1.0])
def test_parts_of_equations_and_coordinates_are_the_connected_components_of_their_graph(density: float) -> None:
    """SciPy finds the components; each equation is in one part, a coordinate in one or none."""
    random = np.random.default_rng(3)
    for _ in range(20):
        m, n = random.integers(1, 40, 2)
        tied = random.random((m, n)) < density
        graph = np.block([[np.zeros((m, m)), tied], [tied.T, np.zeros((n, n))]])
        count, labels = connected_components(graph, directed=False)
        expected = [(np.flatnonzero(labels[:m] == k), np.flatnonzero(labels[m:] == k)) for k in range(count)]
        found = list(connected_parts(tied))
        assert [tuple(map(list, part)) for part in found] == [
            tuple(map(list, part)) for part in expected if len(part[0])
        ]
