"""Closed loops on bases that move: the equations of a loop for its joints do not depend on the base."""

from __future__ import annotations

from collections.abc import Callable
from math import pi
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mbfmu.mechanics import (
    CompiledMechanism,
    Floating,
    Harmonic,
    Input,
    JointSpring,
    Mechanism,
    Polynomial,
    Revolute,
    RevoluteCutJoint,
    RunUp,
    SpeedInput,
    SphericalCutJoint,
    Translational,
    Weld,
    WeldCutJoint,
    rod,
)
from mbfmu.mechanics.cuts import DistanceCutJoint, RollingWheel
from mbfmu.mechanics.dispatch import signal as signal_at
from mbfmu.util.errors import AssemblyError
from solvers import Options, stepper

from .random_mechanisms import CUTS, JOINTS, random_inertia, random_joint, random_rotation

DRIVES: dict[str, Callable[[], Any]] = {
    "constant speed": lambda: Polynomial((0.3, 1.7)),
    "harmonic": lambda: Harmonic(amplitude=4.0 * pi, frequency=0.2, phase=0.4),
    "run-up": lambda: RunUp(speed=3.0, duration=2.0, start=-0.4),
}
TURNED = np.linspace(0.0, 8.0, 9)  # s, more than 720 deg with each of them
MOVING = [joint for joint in JOINTS if joint.nv > 0]


def on_base(joint: Any, seed: int, kinds: list[Any], cuts: list[Any]) -> CompiledMechanism:
    """Random joints and cut joints above a base on ``joint``; the same at the same seed."""
    rng = np.random.default_rng(seed)
    m = Mechanism(gravity=rng.normal(size=3))
    m.body("base", m.ground, joint, mass=1.0, inertia=(0.2, 0.2, 0.2))
    for i, kind in enumerate(kinds):
        parent = m.bodies[rng.integers(1, i + 2)]
        options = {"mass": rng.uniform(0.5, 2.0), "com": rng.normal(size=3), "inertia": random_inertia(rng)}
        m.body(f"b{i}", parent, random_joint(kind, rng, False), **options)
    for i, cut in enumerate(cuts):
        frames = {"rotation_a": random_rotation(rng), "rotation_b": random_rotation(rng)}
        length = {"length": rng.uniform(0.5, 2.0)} if cut is DistanceCutJoint else {}
        length |= {"radius": rng.uniform(0.5, 2.0)} if cut is RollingWheel else {}
        pair = [m.bodies[-1], m.bodies[rng.integers(1, len(m.bodies) - 1)]]
        rng.shuffle(pair)
        m.cut(f"c{i}", cut(at_a=rng.normal(size=3), at_b=rng.normal(size=3), **frames, **length), *pair)
    return CompiledMechanism(m)


@pytest.mark.parametrize("drive", DRIVES)
@settings(max_examples=15)
@given(
    seed=st.integers(0, 2**32 - 1),
    kinds=st.lists(st.sampled_from(JOINTS), max_size=3),
    last=st.sampled_from([joint for joint in MOVING if joint.nv >= 3]),
    cuts=st.lists(st.sampled_from(CUTS), min_size=1, max_size=2),
    axis=st.sampled_from(["x", "y", "z"]),
)
def test_constraints_do_not_know_how_the_base_moves(
    drive: str, seed: int, kinds: list[Any], last: Any, cuts: list[Any], axis: str
) -> None:
    """Phi, J, nu and gamma of loops that close on the base are those on a base at rest, also where they are open."""
    moving = on_base(Revolute(axis=axis, drive=DRIVES[drive]()), seed, [*kinds, last], cuts)
    resting = on_base(Weld(), seed, [*kinds, last], cuts)
    assert moving.vanishing_rows == resting.vanishing_rows
    system, rng = resting.system, np.random.default_rng(seed)
    expected, found = system.allocate_terms(), system.allocate_terms()
    q, v = resting.assembly.start_positions(), rng.normal(size=system.n)
    system.apply(q, rng.normal(size=system.n))
    system.fill(0.0, q, v, expected)
    scale = 1.0 + max(np.abs(x).max(initial=0.0) for x in (expected.Phi, expected.J, expected.gamma))
    for t in TURNED:
        moving.system.fill(t, q, v, found)
        for name in ("Phi", "J", "gamma"):
            np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=0, atol=1e-10 * scale)
        np.testing.assert_allclose(found.nu, 0.0, atol=1e-11 * scale)


def crane(base: Any, axis: str = "y", gravity: float = -9.81) -> Mechanism:
    """A jib that a ram lifts, in a plane of a base: a planar loop of four bodies with a spring in the ram."""
    m = Mechanism(gravity=tuple(gravity * np.eye(3)["xyz".index(axis)]))
    post = m.body("base", m.ground, base, mass=50.0, inertia=(9.0, 9.0, 9.0))
    jib = m.body("jib", post, Revolute(at=(0.2, 1.0, 0.1), start=0.4, fixed=True), **rod(mass=20.0, length=3.0))
    tube = m.body("tube", post, Revolute(at=(0.6, 0.0, 0.1), start=1.0), **rod(mass=4.0, length=0.7))
    ram = m.body("ram", tube, Translational(axis="x", start=1.5), **rod(mass=3.0, length=-0.7))
    pin = m.cut("pin", RevoluteCutJoint(at_b=(1.4, 0.0, 0.0)), ram, jib)
    for axis_ in "xyz":
        m.output(f"pin.{axis_}", pin.joint_force(axis_))
        m.output(f"pin.a.{axis_}", pin.joint_force(axis_, on="a"))
    m.output("jib", jib.angle())
    m.output("along", pin.force("x"))
    m.output("across", pin.force("y"))
    m.output("gap", m.position_residual)
    m.output("jacobi", m.jacobi_integral)
    return m


def accelerations(compiled: CompiledMechanism, t: float, q: Any, v: Any) -> tuple[Any, Any]:
    """Accelerations and multipliers of the equations of motion as one dense system."""
    s = compiled.system
    terms = s.allocate_terms()
    s.fill(t, q, v, terms)
    K = np.block([[terms.M, terms.J.T], [terms.J, np.zeros((s.m, s.m))]])
    x = np.linalg.solve(K, np.concatenate((-terms.h, terms.gamma)))
    return x[: s.n], x[s.n :]


def turn_about(axis: str, angle: float) -> Any:
    """Rotation matrix."""
    k = "xyz".index(axis)
    i, j = (k + 1) % 3, (k + 2) % 3
    R = np.eye(3)
    R[i, i] = R[j, j] = np.cos(angle)
    R[j, i], R[i, j] = np.sin(angle), -np.sin(angle)
    return R


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_the_crane_is_the_same_in_every_attitude(drive: str, axis: str) -> None:
    """A base that has turned and one that is drawn turned: the same motion, and forces that turn with it."""
    compiled = CompiledMechanism(crane(Revolute(axis=axis, drive=DRIVES[drive]()), axis))
    assert compiled.vanishing_rows == ["pin.z", "pin.zx", "pin.zy"]
    q, v = compiled.assemble()
    terms = compiled.system.allocate_terms()
    for t in TURNED:
        compiled.system.fill(t, q, v, terms)
        assert np.linalg.svd(terms.J, compute_uv=False)[-1] > 0.1  # 90 deg away an equation along a global axis is zero
        assert np.abs(terms.Phi).max() < 1e-12
        signal = np.array(signal_at(0, t, compiled.kernel_data.arrays))
        a, lam = accelerations(compiled, t, q, v)
        out = np.zeros(len(compiled.outputs))
        compiled.observe(t, q, v, a, lam, out)
        drawn = Polynomial((0.0, signal[1], 0.5 * signal[2]))
        turned = CompiledMechanism(crane(Revolute(axis=axis, rotation=turn_about(axis, signal[0]), drive=drawn), axis))
        a2, lam2 = accelerations(turned, 0.0, q, v)
        np.testing.assert_allclose(a2, a, rtol=1e-9)
        other, unturned = np.zeros(len(out)), np.zeros(len(out))
        turned.observe(0.0, q, v, a2, lam2, other)
        np.testing.assert_allclose(out[6:9], other[6:9], rtol=1e-9)
        np.testing.assert_allclose(out[:6], other[:6], rtol=0, atol=1e-9 * np.abs(out[:6]).max())
        np.testing.assert_allclose(out[:6:2], -out[1:6:2], rtol=1e-12)  # on body a what is on b, reversed
        same = CompiledMechanism(crane(Revolute(axis=axis, drive=drawn), axis))
        same.observe(0.0, q, v, *accelerations(same, 0.0, q, v), unturned)
        np.testing.assert_allclose(
            turn_about(axis, signal[0]) @ unturned[:6:2], out[:6:2], rtol=0, atol=1e-9 * np.abs(out[:6]).max()
        )


def test_the_ram_carries_the_jib_according_to_statics() -> None:
    """A crane that stands still and one that has slewed by 90 deg: the ram's force from the jib's moment balance."""
    for angle in (0.0, 0.5 * pi, 2.0):
        compiled = CompiledMechanism(crane(Revolute(axis="y", drive=angle)))
        q, _ = compiled.assemble()
        terms = compiled.system.allocate_terms()
        compiled.system.fill(0.0, q, np.zeros(3), terms)
        balance = np.column_stack((terms.J.T, [0.0, 0.0, -1.0]))  # the forces at the pin, and one that holds the ram
        lam = np.linalg.solve(balance, -terms.h)[:2]
        out = np.zeros(len(compiled.outputs))
        compiled.observe(0.0, q, np.zeros(3), np.zeros(3), lam, out)
        outward, up = out[0:6:2] @ turn_about("y", angle)[:, 0], out[2]
        moment = 1.4 * (np.cos(q[0]) * up - np.sin(q[0]) * outward)
        assert moment == pytest.approx(20.0 * 9.81 * 1.5 * np.cos(q[0]), rel=1e-10)


@pytest.mark.parametrize(("solver", "same"), [("adams", 1e-7), ("hybrid", 1e-7), ("ida", 1e-5)])
@pytest.mark.parametrize("drive", DRIVES)
def test_a_crane_swings_alike_from_every_attitude(drive: str, solver: str, same: float) -> None:
    """Runs through 720 deg from two attitudes: the same motion in the crane, loops closed all the way.

    Gravity is along the axis of the base. 90 deg from where it starts, an equation along a global axis would be zero.
    """
    motions = []
    for attitude in (0.0, 0.25 * pi):
        base = Revolute(axis="y", rotation=turn_about("y", attitude), drive=DRIVES[drive]())
        m = crane(base)
        m.force("cylinder", JointSpring(stiffness=8000.0, damping=50.0, free=1.5), m.bodies[-1])
        compiled = CompiledMechanism(m)
        motion = stepper(solver, compiled.system, 0.0, *compiled.assemble(), Options(rtol=1e-9))
        samples = motion.sample(TURNED[1:])
        assert motion.status.ok, motion.status.message
        terms = compiled.system.allocate_terms()
        for t, q in zip(TURNED[1:], samples.q, strict=True):
            compiled.system.fill_position(float(t), q, terms)
            assert np.abs(terms.Phi).max() < 0.1 * same
            gap = compiled.data.state.bodies["r"][4] - pin_on_the_jib(compiled)
            assert np.linalg.norm(gap) < 0.1 * same  # whatever the rows say
        motions.append(samples.q)
    assert np.ptp(motions[0][:, 0]) > 0.01
    np.testing.assert_allclose(motions[0], motions[1], rtol=0, atol=same)


def pin_on_the_jib(compiled: CompiledMechanism) -> Any:
    """Global position of the jib's end of the loop."""
    jib = compiled.data.state.bodies[2]
    return jib["r"] + jib["A"] @ np.array([1.4, 0.0, 0.0])


def four_bar_on(base: Any, **frames: Any) -> Mechanism:
    """A planar loop on a base."""
    m = Mechanism()
    post = m.body("base", m.ground, base, mass=1.0, inertia=(1, 1, 1))
    crank = m.body("crank", post, Revolute(start=0.9, fixed=True), **rod(mass=1, length=1))
    coupler = m.body("coupler", crank, Revolute(at=(1, 0, 0), start=-0.6), **rod(mass=3, length=3))
    rocker = m.body("rocker", coupler, Revolute(at=(3, 0, 0), start=1.2), **rod(mass=1, length=-2))
    m.cut("pivot", RevoluteCutJoint(at_a=(-2, 0, 0), at_b=(3, 0, 0), **frames), rocker, post)
    return m


@pytest.mark.parametrize("start", [0.0, -0.25 * pi, 0.5 * pi])
@pytest.mark.parametrize("axis", ["x", "y", (1.0, 2.0, 3.0)])
def test_vanishing_rows_of_a_turning_loop_are_those_of_its_plane(start: float, axis: Any) -> None:
    compiled = CompiledMechanism(four_bar_on(Revolute(axis=axis, drive=Polynomial((start, 1.0)))))
    assert compiled.vanishing_rows == ["pivot.z", "pivot.zx", "pivot.zy"]


@pytest.mark.parametrize(
    "drive",
    [
        Polynomial((0.0, 0.0, 1e-3)),
        Harmonic(amplitude=1.0, frequency=1e-4),
        RunUp(speed=1e-3, duration=5.0),
        Input(name="u", unit="rad"),
        SpeedInput(name="w", unit="rad/s"),
    ],
)
def test_a_row_that_the_drive_will_work_against_is_kept(drive: Any) -> None:
    """A link on a slewing base, tied to the ground on its axis: out of plane at first, not once the base has turned."""
    m = Mechanism()
    base = m.body("base", m.ground, Revolute(axis="y", drive=drive), mass=1.0)
    crank = m.body("crank", base, Revolute(start=0.3), **rod(mass=1, length=1))
    link = m.body("link", crank, Revolute(at=(1, 0, 0), start=2.0), **rod(mass=1, length=1))
    m.cut("pin", SphericalCutJoint(at_b=(1, 0, 0)), m.ground, link)
    compiled = CompiledMechanism(m)
    assert compiled.vanishing_rows == []
    (signal,) = compiled.signals(compiled.data)
    if "c" in signal.record.dtype.names:
        assert signal.record["c"][0] == 0.0  # inputs are where they were
    turned = Mechanism()
    base = turned.body("base", turned.ground, Revolute(axis="y", drive=drive), mass=1.0)
    crank = turned.body("crank", base, Revolute(start=0.3), **rod(mass=1, length=1))
    link = turned.body("link", crank, Revolute(at=(1, 0, 0), start=2.0), **rod(mass=1, length=1))
    turned.cut("pin", SphericalCutJoint(at_a=(1, 0, 0)), link, turned.ground)  # rows turn with the link
    assert CompiledMechanism(turned).vanishing_rows == ["pin.z"]


def test_a_drive_that_opens_a_loop_is_refused() -> None:
    m = Mechanism()
    lift = m.body("lift", m.ground, Translational(axis="z", drive=Polynomial((0.0, 0.1))), mass=1.0)
    crank = m.body("crank", lift, Revolute(start=0.3), **rod(mass=1, length=1))
    link = m.body("link", crank, Revolute(at=(1, 0, 0), start=2.0), **rod(mass=1, length=1))
    m.cut("pin", SphericalCutJoint(at_a=(1, 0, 0)), link, m.ground)
    with pytest.raises(
        AssemblyError, match=r"the drives open a loop: when they move, constraint 'pin\.z' is violated by .* m and no"
    ):
        CompiledMechanism(m)


def test_drives_that_move_together_break_no_loop() -> None:
    """Two lifts of the same speed carry a planar loop between them."""
    m = Mechanism()
    lifts = [
        m.body(
            f"lift{i}", m.ground, Translational(at=(2.0 * i, 0, 0), axis="z", drive=Polynomial((0.0, 0.1))), mass=1.0
        )
        for i in range(2)
    ]
    crank = m.body("crank", lifts[0], Revolute(start=0.3), **rod(mass=1, length=1))
    link = m.body("link", crank, Revolute(at=(1, 0, 0), start=0.1), **rod(mass=1, length=1.5))
    m.cut("pin", SphericalCutJoint(at_a=(1.5, 0, 0)), link, lifts[1])
    assert CompiledMechanism(m).vanishing_rows == ["pin.z"]


@pytest.mark.parametrize(
    ("angle", "axis", "words"),
    [
        (
            120.0,
            (1, 1, 1),
            "loop 'glue' closes with a wrong orientation: the frames of its cut joint are rotated by 120 deg",
        ),
        (
            180.0,
            (1, 0, 0),
            "loop 'glue' closes with a wrong orientation: the frames of its cut joint are rotated by 180 deg",
        ),
        (
            -120.0,
            (1, 1, 1),
            "'glue.*' is violated by 1 .*; in the start positions the frames of cut joint 'glue' are rotated by 120",
        ),
    ],
)
def test_a_weld_that_closes_turned_is_refused(angle: float, axis: Any, words: str) -> None:
    """Its products of axes are zero for frames turned by 120 deg about their diagonal, and by 180 deg about an axis."""
    half = 0.5 * np.radians(angle)
    e = (np.cos(half), *(np.sin(half) * np.array(axis) / np.linalg.norm(axis)))
    m = Mechanism()
    box = m.body("box", m.ground, Floating(start=(0, 0, 0, *e)), mass=1.0, inertia=(1, 1, 1))
    m.cut("glue", WeldCutJoint(), m.ground, box)
    with pytest.raises(AssemblyError, match=words):
        CompiledMechanism(m).assemble()


def test_a_hinge_whose_axis_is_flipped_is_refused() -> None:
    flipped = np.diag([1.0, -1.0, -1.0])
    compiled = CompiledMechanism(four_bar_on(Weld(), rotation_b=flipped))
    with pytest.raises(
        AssemblyError,
        match=r"'pivot' closes .*: the z axes .* 180 deg from each other \(180 deg "
        r"in the start positions\)",
    ):
        compiled.assemble()
    CompiledMechanism(four_bar_on(Weld(), rotation_a=flipped, rotation_b=flipped)).assemble()


def test_loops_close_alike_at_every_size() -> None:
    """An angle, a length: the least change is that of the same mechanism in another unit of length."""

    def closed(scale: float) -> Any:
        m = Mechanism()
        crank = m.body("crank", m.ground, Revolute(start=1.2), **rod(mass=1, length=0.1 * scale))
        link = m.body("link", crank, Revolute(at=(0.1 * scale, 0, 0), start=-1.0), **rod(mass=1, length=0.4 * scale))
        slider = m.body("slider", m.ground, Translational(axis="x", start=0.3 * scale, rate=0.2 * scale), mass=1.0)
        m.cut("pin", RevoluteCutJoint(at_a=(0.4 * scale, 0, 0)), link, slider)
        q, v = CompiledMechanism(m).assemble()
        return np.concatenate((q / [1.0, 1.0, scale], v / [1.0, 1.0, scale]))

    expected = closed(1.0)
    assert expected[2] == pytest.approx(0.1 * np.cos(expected[0]) + np.sqrt(0.16 - (0.1 * np.sin(expected[0])) ** 2))
    for scale in (1e-4, 1e-2, 1e3):
        np.testing.assert_allclose(closed(scale), expected, rtol=1e-8)
