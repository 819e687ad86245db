"""Joints of several coordinates, screws, and cut joints about any axis: against chains, loops and closed forms."""

from __future__ import annotations

from collections.abc import Callable
from math import atan2, cos, pi, sin, tau
from typing import Any

import numpy as np
import pytest
from random_mechanisms import random_inertia, random_rotation
from reference import integrate
from scipy.spatial.transform import Rotation

from mbfmu.mechanics import (
    CompiledMechanism,
    Cylindrical,
    CylindricalCutJoint,
    DistanceCutJoint,
    Floating,
    Harmonic,
    JointForce,
    Mechanism,
    Planar,
    PlanarCutJoint,
    PlaneCutJoint,
    Polynomial,
    Revolute,
    RevoluteCutJoint,
    Screw,
    Spherical,
    SphericalCutJoint,
    Translational,
    TranslationalCutJoint,
    Universal,
    Weld,
    WeldCutJoint,
)
from mbfmu.mechanics.builder.bodies import Body
from mbfmu.util.errors import AssemblyError, UserError
from mbfmu.viewer.drawing import draw
from solvers import Options, stepper

AXES: tuple[Any, ...] = ("x", "y", "z", (1.0, -2.0, 0.5))
SIZES = (1e-3, 1.0, 1e3)  # m
G = 9.81


def accelerations(compiled: CompiledMechanism, q: Any, v: Any) -> tuple[Any, Any]:
    """Accelerations and multipliers at t = 0 of the equations of motion as one dense system, in units of the compiled
    mechanism.
    """
    s = compiled.system
    terms = s.allocate_terms()
    s.fill(0.0, q, v, terms)
    J = terms.J * s.size / s.row_size[:, np.newaxis]
    M = terms.M * np.outer(s.size, s.size)
    scale = float(np.abs(M).max(initial=0.0)) or 1.0
    K = np.block([[M / scale, J.T], [J, np.zeros((s.m, s.m))]])
    x = np.linalg.solve(K, np.concatenate((-terms.h * s.size / scale, terms.gamma / s.row_size)))
    return x[: s.n] * s.size, x[s.n :] * scale / s.row_size


def seen(compiled: CompiledMechanism, q: Any, v: Any) -> dict[str, float]:
    """All outputs at t = 0 by name."""
    out = np.zeros(len(compiled.outputs))
    compiled.observe(0.0, q, v, *accelerations(compiled, q, v), out)
    return {variable.name: float(x) for variable, x in zip(compiled.outputs, out, strict=True)}


def assert_same(found: dict[str, float], expected: dict[str, float], tolerance: float = 1e-10) -> None:
    """Agree relative to the largest of those whose names begin alike."""
    assert found.keys() == expected.keys()
    largest: dict[str, float] = {}
    for name, x in expected.items():
        group = name.rpartition(".")[0]
        largest[group] = max(largest.get(group, 0.0), abs(x))
    assert all(size > 0.0 for size in largest.values())
    for name, x in expected.items():
        assert found[name] == pytest.approx(x, rel=0.0, abs=tolerance * largest[name.rpartition(".")[0]]), name


def observed(m: Mechanism, name: str, body: Body, point: Any) -> None:
    """Return how a point of a body moves."""
    for axis in "xyz":
        m.output(f"{name}.position.{axis}", body.position(axis, point))
        m.output(f"{name}.velocity.{axis}", body.velocity(axis, point))
        m.output(f"{name}.acceleration.{axis}", body.point_acceleration(axis, point))


def swung(m: Mechanism, L: float, rng: np.random.Generator) -> Body:
    """A base in an odd attitude that is driven to and fro."""
    drive = Harmonic(amplitude=0.7, frequency=0.3, phase=0.4, mean=0.2)
    joint = Revolute(at=L * rng.normal(size=3), rotation=random_rotation(rng), axis=(1.0, 2.0, -1.0), drive=drive)
    return m.body("base", m.ground, joint, mass=1.0)


def massive(rng: np.random.Generator, L: float) -> dict[str, Any]:
    """Mass properties of a body of size L."""
    return {"mass": rng.uniform(0.5, 2.0), "com": 0.3 * L * rng.normal(size=3), "inertia": L * L * random_inertia(rng)}


# -- tree joints ---------------------------------------------------------------------------------------------------


def carried(chain: list[Any], L: float) -> CompiledMechanism:
    """A body at the end of a chain of joints on a swung base, the others without mass, and a flap on the body."""
    rng = np.random.default_rng(5)
    m = Mechanism(gravity=L * rng.normal(size=3))
    body = swung(m, L, rng)
    for k, joint in enumerate(chain[:-1]):
        body = m.body(f"massless{k}", body, joint)
    body = m.body("body", body, chain[-1], **massive(rng, L))
    flap = Revolute(at=L * rng.normal(size=3), rotation=random_rotation(rng))
    observed(m, "flap", m.body("flap", body, flap, **massive(rng, L)), L * rng.normal(size=3))
    observed(m, "body", body, L * rng.normal(size=3))
    for axis in "xyz":
        m.output(f"force.{axis}", body.joint_force(axis))
        m.output(f"moment.{axis}", body.joint_moment(axis))
    m.output("energy", m.energy)
    return CompiledMechanism(m)


def placement(L: float) -> dict[str, Any]:
    """Some place and attitude of a joint frame."""
    rng = np.random.default_rng(8)
    return {"at": L * rng.normal(size=3), "rotation": random_rotation(rng)}


X, Y, Z = np.eye(3)
OBLIQUE = np.array([2.0, -1.0, 2.0])  # of length 3; x less its part along it is (5, 2, -4) / 9
PLANES = [
    ("z", X, Y),
    ("y", X, -Z),
    ("x", Y, Z),
    ((0.0, 0.0, -2.0), X, -Y),
    ((-1.0, 0.0, 0.0), Y, -Z),
    ((0.0, 1.0, 1.0), X, Y - Z),
    (OBLIQUE, np.array([5.0, 2.0, -4.0]), np.cross(OBLIQUE, [5.0, 2.0, -4.0])),
]
CHAINS: list[tuple[str, Callable[[dict[str, Any]], Any], Callable[[dict[str, Any]], list[Any]]]] = [
    ("universal", lambda at: Universal(**at), lambda at: [Revolute(axis="x", **at), Revolute(axis="y")]),
    (
        "universal of other axes",
        lambda at: Universal(axis=OBLIQUE, second=(1.0, 2.0, 0.0), **at),
        lambda at: [Revolute(axis=OBLIQUE, **at), Revolute(axis=(1.0, 2.0, 0.0))],
    ),
    *(
        (
            f"cylindrical {axis}",
            lambda at, n=axis: Cylindrical(axis=n, **at),
            lambda at, n=axis: [Revolute(axis=n, **at), Translational(axis=n)],
        )
        for axis in AXES
    ),
    *(
        (
            f"planar {n}",
            lambda at, n=n: Planar(axis=n, **at),
            lambda at, n=n, x=x, y=y: [Translational(axis=x, **at), Translational(axis=y), Revolute(axis=n)],
        )
        for n, x, y in PLANES
    ),
]


@pytest.mark.parametrize("L", SIZES)
@pytest.mark.parametrize(("joint", "chain"), [c[1:] for c in CHAINS], ids=[c[0] for c in CHAINS])
def test_a_joint_is_a_chain_of_single_ones(joint: Any, chain: Any, L: float) -> None:
    one, many = carried([joint(placement(L))], L), carried(chain(placement(L)), L)
    units = [unit for body in one.mechanism.bodies[2:] for unit in body.joint.units]
    unit = np.array([L if name == "m" else 1.0 for name in units])
    q, v = unit * np.linspace(0.4, 1.1, one.system.n), unit * np.linspace(1.3, -0.9, one.system.n)
    found, expected = (accelerations(compiled, q, v)[0] / unit for compiled in (one, many))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(expected).max())
    assert_same(seen(one, q, v), seen(many, q, v))


@pytest.mark.parametrize("L", SIZES)
@pytest.mark.parametrize("lead", [0.7, -2.0])
@pytest.mark.parametrize("axis", AXES)
def test_a_screw_is_a_cylindrical_joint_held_by_its_thread(axis: Any, lead: float, L: float) -> None:
    """Its equation is that of both coordinates, projected onto what the thread allows."""
    screw = carried([Screw(axis=axis, lead=lead * L, **placement(L))], L)
    both = carried([Cylindrical(axis=axis, **placement(L))], L)
    T = np.array([[1.0, 0.0], [lead * L / tau, 0.0], [0.0, 1.0]])  # angle and flap -> angle, displacement, flap
    q, v = np.array([0.9, -0.4]), np.array([1.7, 0.8])
    terms = both.system.allocate_terms()
    both.system.fill(0.0, T @ q, T @ v, terms)
    expected = -np.linalg.solve(T.T @ terms.M @ T, T.T @ terms.h)
    a, _ = accelerations(screw, q, v)
    np.testing.assert_allclose(a, expected, rtol=0, atol=1e-10 * np.abs(expected).max())
    found, alike = np.zeros(len(screw.outputs)), np.zeros(len(screw.outputs))
    screw.observe(0.0, q, v, a, np.zeros(0), found)
    both.observe(0.0, T @ q, T @ v, T @ a, np.zeros(0), alike)
    names = [variable.name for variable in screw.outputs]
    assert_same(dict(zip(names, found, strict=True)), dict(zip(names, alike, strict=True)))


def falling(L: float, lead: float, **options: Any) -> tuple[Mechanism, float, float]:
    """A nut of size L that falls on an upright screw, its mass and its inertia."""
    mass, J = 2.0, 0.3 * L * L
    m = Mechanism(gravity=(0.0, -G * L, 0.0))
    nut = m.body("nut", m.ground, Screw(axis="y", lead=lead, **options), mass=mass, inertia=(J, J, J))
    m.output("angle", nut.angle())
    m.output("height", nut.position("y"))
    if nut.joint.drive is not None:
        m.output("effort", nut.effort())
    return m, mass, J


@pytest.mark.parametrize("L", SIZES)
@pytest.mark.parametrize("lead", [0.5, -3.0])
def test_a_nut_falls_on_its_screw(lead: float, L: float) -> None:
    m, mass, J = falling(L, lead * L)
    compiled = CompiledMechanism(m)
    fall = G * L / (1.0 + J * (tau / (lead * L)) ** 2 / mass)
    motion = stepper("adams", compiled.system, 0.0, *compiled.assemble(), Options(rtol=1e-10))
    samples = motion.sample(np.array([1.0, 5.0]))
    assert motion.status.ok, motion.status.message
    for t, q, v in zip((1.0, 5.0), samples.q, samples.v, strict=True):
        a, lam = accelerations(compiled, q, v)
        out = np.zeros(2)
        compiled.observe(t, q, v, a, lam, out)
        np.testing.assert_allclose(out, [-0.5 * fall * t * t * tau / (lead * L), -0.5 * fall * t * t], rtol=1e-8)
        assert a[0] * lead * L / tau == pytest.approx(-fall, rel=1e-12)


@pytest.mark.parametrize("L", SIZES)
def test_what_turns_a_screw_lifts_the_nut(L: float) -> None:
    """Torque of a drive: (m g + m h angle'') h + J angle'' with h = lead / 2 pi."""
    lead, curve = 0.4 * L, 3.0
    m, mass, J = falling(L, lead, drive=Polynomial((0.2, 0.5, 0.5 * curve)))
    compiled, h = CompiledMechanism(m), lead / tau
    found = seen(compiled, np.zeros(0), np.zeros(0))
    assert found["height"] == pytest.approx(0.2 * h, rel=1e-14)
    assert found["effort"] == pytest.approx(mass * (G * L + h * curve) * h + J * curve, rel=1e-12)
    m, mass, J = falling(L, lead)
    m.force("motor", JointForce(magnitude=mass * G * L * h), m.bodies[-1])
    compiled = CompiledMechanism(m)
    terms = compiled.system.allocate_terms()
    compiled.system.fill(0.0, np.array([0.3]), np.zeros(1), terms)
    assert abs(terms.h[0]) < 1e-14 * mass * G * L * h


@pytest.mark.parametrize("L", SIZES)
@pytest.mark.parametrize("angle", [0.0, 0.6, 0.5 * pi, 2.5, -1.2])
def test_a_bent_shaft_turns_unevenly(angle: float, L: float) -> None:
    """Hooke: tan(out) = tan(in) / cos(bend); the second shaft is held along its axis by a cylindrical cut."""
    bend, speed = 0.5, 2.0
    frame = random_rotation(np.random.default_rng(2))
    m = Mechanism()
    drive = Polynomial((angle, speed))
    first = m.body("first", m.ground, Revolute(axis="x", rotation=frame, drive=drive), mass=1.0)
    cross = Universal(at=(L, 0.0, 0.0), axis="y", second="z", start=(-bend * sin(angle), bend * cos(angle)))
    second = m.body("second", first, cross, mass=1.0, com=(0.5 * L, 0.0, 0.0), inertia=L * L * np.ones(3))
    sleeve = Rotation.from_rotvec((0.0, 0.0, bend)).as_matrix()  # its x is along the second shaft
    m.cut(
        "sleeve",
        CylindricalCutJoint(axis="x", at_a=(2.0 * L, 0.0, 0.0), at_b=frame @ [L, 0.0, 0.0], rotation_b=frame @ sleeve),
        second,
        m.ground,
    )
    compiled = CompiledMechanism(m)
    q, v = compiled.assemble()
    compiled.system.fill(0.0, q, v, compiled.system.allocate_terms())
    shaft = compiled.data.state.bodies[2]
    turned = (frame @ sleeve).T @ shaft["A"]
    np.testing.assert_allclose(turned[:, 0], X, atol=1e-10)
    out = atan2(turned[2, 1], turned[1, 1])
    assert sin(out) * cos(bend) * cos(angle) == pytest.approx(cos(out) * sin(angle), abs=1e-10)
    assert cos(out - angle) > 0.5  # and not half a turn on
    rate = speed * cos(bend) / ((cos(bend) * cos(angle)) ** 2 + sin(angle) ** 2)
    np.testing.assert_allclose((frame @ sleeve).T @ shaft["Y"][3:], [rate, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize(
    ("joint", "message"),
    [
        (
            Universal(second="x"),
            "second axis of joint of body 'b' is 'x', 0 deg from its axis 'x'; allowed: an axis perp",
        ),
        (
            Universal(axis="z", second=(0, 1, 1)),
            r"second axis of joint of body 'b' is \(0, 1, 1\), 45 deg from its axis 'z'",
        ),
        (Universal(second="w"), "second axis of joint of body 'b' is 'w'; allowed: 'x', 'y', 'z' or three numbers"),
        (Universal(axis=(0, 0, 0)), r"^axis of joint of body 'b' is \(0, 0, 0\); it needs three finite numbers"),
        (Screw(lead=0.0), r"lead of joint of body 'b' is 0\.0 m per turn; allowed: 1e-50 to 1e\+50, of either sign"),
        (Screw(lead=float("nan")), "lead of joint of body 'b' is nan m per turn"),
        (Screw(lead=(1.0, 2.0)), r"lead of joint of body 'b' is \(1\.0, 2\.0\) m per turn"),  # type: ignore[arg-type]
        (Screw(lead="1"), "lead of joint of body 'b' is '1' m per turn"),  # type: ignore[arg-type]
        (Cylindrical(drive=1.0), "joint of body 'b' has 2 coordinates and cannot be driven"),
    ],
)
def test_what_is_no_such_joint_is_refused(joint: Any, message: str) -> None:
    m = Mechanism()
    with pytest.raises(UserError, match=message):
        m.body("b", m.ground, joint, mass=1.0)


def test_coordinates_have_names_and_units() -> None:
    m = Mechanism()
    body = m.ground
    for name, joint in (("u", Universal()), ("c", Cylindrical()), ("p", Planar()), ("s", Screw(lead=2.0))):
        body = m.body(name, body, joint, mass=1.0, com=(0.1, 0.2, 0.3), inertia=(1.0, 1.0, 1.0))
    assert CompiledMechanism(m).system.coordinate_names == (
        "u.first", "u.second", "c.angle", "c.displacement", "p.x", "p.y", "p.angle", "s",
    )  # fmt: skip
    assert [m.bodies[3].coordinate(k).unit for k in range(3)] == ["m", "m", "rad"]
    assert [m.bodies[2].rate(k).unit for k in range(2)] == ["rad/s", "m/s"]


# -- cut joints ----------------------------------------------------------------------------------------------------

PAIRS: list[tuple[Any, Any]] = [
    (Revolute, RevoluteCutJoint),
    (Translational, TranslationalCutJoint),
    (Cylindrical, CylindricalCutJoint),
    (Planar, PlanarCutJoint),
]


def crank(L: float, close: Callable[[Mechanism, Body, dict[str, Any]], Body]) -> Mechanism:
    """A crank, a link on a ball joint and what a ball joint at its end pulls: ``close`` makes that on the base."""
    rng = np.random.default_rng(3)
    m = Mechanism(gravity=L * rng.normal(size=3))
    base = swung(m, L, rng)
    arm = m.body("crank", base, Revolute(at=L * X, axis=(1.0, 0.3, 2.0), start=0.3, rate=1.1), **massive(rng, L))
    ball = Spherical(at=0.6 * L * X, start=(0.8, 0.0, 0.6, 0.0), rate=(0.3, -0.5, 0.2))
    link = m.body("link", arm, ball, **massive(rng, L))
    held = close(m, base, massive(rng, L))
    m.cut("ball", SphericalCutJoint(at_a=(1.5 * L, 0.0, 0.0), at_b=(0.8 * L, 0.5 * L, -0.4 * L)), link, held)
    for body in (arm, link, held):
        observed(m, body.name, body, (0.3 * L, -0.2 * L, 0.5 * L))
    m.output("energy", m.energy)
    return m


@pytest.mark.parametrize("L", SIZES)
@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize(("joint", "cut"), PAIRS)
def test_a_cut_joint_is_the_tree_joint_of_its_name(joint: Any, cut: Any, axis: Any, L: float) -> None:
    """A body on this joint, and one that floats and is held by the cut: the same motion, force and moment."""
    where, local = placement(L), random_rotation(np.random.default_rng(4))
    where["at"] = L * np.array([2.2, 0.5, 0.4])  # within reach

    def in_tree(m: Mechanism, base: Body, mass: dict[str, Any]) -> Body:
        turned = axis if isinstance(axis, str) else np.array(axis)
        held = m.body("held", base, joint(axis=turned, rate=np.linspace(0.5, 0.9, joint.nv), **where), **mass)
        for a in "xyz":
            m.output(f"force.{a}", held.joint_force(a))
        return held

    tree = CompiledMechanism(crank(L, in_tree))
    q, v = tree.assemble()
    tree.system.fill(0.0, q, v, tree.system.allocate_terms())
    base, held = tree.data.state.bodies[1], tree.data.state.bodies[4]
    F = base["A"] @ where["rotation"]
    quaternion = np.roll(Rotation.from_matrix(F.T @ held["A"]).as_quat(), 1)
    arm, w = held["r"] - base["r"], base["Y"][3:]
    place = F.T @ (arm - base["A"] @ where["at"])
    moving = F.T @ (held["Y"][:3] - base["Y"][:3] - np.cross(w, arm))
    turning = held["A"].T @ (held["Y"][3:] - w)

    def floating(m: Mechanism, base: Body, mass: dict[str, Any]) -> Body:
        start = {"start": (*place, *quaternion), "rate": (*moving, *turning)}
        held = m.body("held", base, Floating(**start, **where), **mass)
        frames = {"rotation_a": where["rotation"] @ local, "rotation_b": local}
        given = axis
        if isinstance(axis, str):  # frames whose axis of that name is the joint's
            frames = {"rotation_a": where["rotation"], "rotation_b": None}
        else:
            given = local.T @ np.array(axis)
        handle = m.cut("cut", cut(at_a=where["at"], axis=given, **frames), base, held)
        for a in "xyz":
            m.output(f"force.{a}", handle.joint_force(a))
        return held

    free = CompiledMechanism(crank(L, floating))
    assert not free.vanishing_rows
    assert free.system.m == 3 + len(cut(axis=axis).rows)
    start = free.assembly.start_positions()
    start[:5] = q[:5]  # crank and link are as assembled
    velocities = np.concatenate((v[:4], moving, turning))
    assert np.abs(free.system.n - free.system.m - (tree.system.n - tree.system.m)) == 0
    terms = free.system.allocate_terms()
    free.system.fill(0.0, start, velocities, terms)
    assert np.abs(terms.Phi / free.system.row_size).max() < 1e-10
    assert np.abs((terms.J @ velocities - terms.nu) / free.system.row_size).max() < 1e-9
    assert_same(seen(free, start, velocities), seen(tree, q, v), 1e-8)


def rail(slider: str, L: float) -> Mechanism:
    """A crank, a link and a slider on a rail along y' of an odd frame, in the tree or held by a cut."""
    rng = np.random.default_rng(6)
    frame = random_rotation(rng)
    m = Mechanism(gravity=frame @ [G * L, 0.5 * L, 0.2 * L])
    base = m.body("base", m.ground, Weld(rotation=frame))
    arm = m.body("crank", base, Revolute(start=0.4, rate=1.5, fixed=True), **massive(rng, L))
    link = m.body("link", arm, Revolute(at=(0.5 * L, 0.0, 0.0), start=1.2), **massive(rng, L))
    mass, tip, at = massive(rng, L), {"at_a": (2.0 * L, 0.0, 0.0)}, (0.1 * L, 0.0, 0.0)
    if slider == "tree":
        block = m.body("block", base, Translational(axis="y", at=at, start=2.2 * L), **mass)
        m.cut("pin", RevoluteCutJoint(**tip), link, block)
        m.output("normal", block.joint_force("x"))
    elif slider == "planar":
        block = m.body("block", base, Planar(start=(0.1 * L, 2.2 * L, 0.0)), **mass)
        m.cut("pin", RevoluteCutJoint(**tip), link, block)
    else:
        block = m.body("block", link, Revolute(at=tip["at_a"], start=-1.6), **mass)
    if slider != "tree":
        guide = m.cut("rail", TranslationalCutJoint(axis="y", at_a=at), base, block)
        m.output("normal.x", guide.force("x"))
    observed(m, "crank", arm, (L, 0.0, 0.0))
    observed(m, "block", block, (L, 0.0, 0.0))
    return m


@pytest.mark.parametrize("L", SIZES)
@pytest.mark.parametrize("slider", ["planar", "end of the chain"])
def test_a_slider_crank_closed_by_its_rail(slider: str, L: float) -> None:
    tree, other = CompiledMechanism(rail("tree", L)), CompiledMechanism(rail(slider, L))
    assert {"rail.z", "rail.yz", "rail.zx"} <= set(other.vanishing_rows)
    assert not {"rail.x", "rail.xy"} & set(other.vanishing_rows)
    expected, found = seen(tree, *tree.assemble()), seen(other, *other.assemble())
    found.pop("normal.x")
    expected.pop("normal")
    assert_same(found, expected, 1e-8)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
@pytest.mark.parametrize("cut", [TranslationalCutJoint, CylindricalCutJoint])
def test_a_rail_carries_what_leans_on_it(cut: Any, axis: str) -> None:
    """A block that falls along its rail: what holds it across and level, by the axes of the frame in body a."""
    frame, along, weight = random_rotation(np.random.default_rng(1)), np.eye(3)["xyz".index(axis)], [3.0, 6.0, 12.0]
    com = np.array([0.3, -0.5, 0.7]) if cut is TranslationalCutJoint else 0.4 * along  # a sleeve would turn else
    m = Mechanism(gravity=frame @ np.array(weight) / 3.0)
    block = m.body("block", m.ground, Floating(rotation=frame), mass=3.0, com=com, inertia=(1.0, 1.0, 1.0))
    rail = m.cut("rail", cut(axis=axis, rotation_a=frame), m.ground, block)
    for row in rail.cut.rows:
        m.output(row, rail.force(row))
    m.output("along", block.acceleration("xyz".index(axis)))
    compiled = CompiledMechanism(m)
    found = seen(compiled, *compiled.assemble())
    assert found.pop("along") == pytest.approx(along @ weight / 3.0, rel=1e-12)
    force = along * (along @ weight) - weight
    moment = np.cross(com, force)
    for row, value in found.items():
        ways = [np.eye(3)["xyz".index(letter)] for letter in row]
        expected = force @ ways[0] if len(row) == 1 else moment @ np.cross(ways[1], ways[0])  # "zx" is about x cross z
        assert value == pytest.approx(expected, rel=1e-12, abs=1e-12)
    assert len(found) == (5 if cut is TranslationalCutJoint else 4)
    with pytest.raises(UserError, match=f"cut 'rail' has no component '{axis}'"):
        rail.force(axis)


TURNED = {  # an axis, and the frame whose z it is
    "x": np.column_stack((Y, Z, X)),
    "y": np.column_stack((Z, X, Y)),
    "z": np.eye(3),
    (2.0, -1.0, 2.0): np.column_stack(
        (np.array([5.0, 2.0, -4.0]) / 45**0.5, np.cross(OBLIQUE, [5.0, 2.0, -4.0]) / (3.0 * 45**0.5), OBLIQUE / 3.0)
    ),
}
NAMES = {"x": "yzx", "y": "zxy", "z": "xyz", (2.0, -1.0, 2.0): "stn"}
BY_AXIS: list[Any] = [RevoluteCutJoint, PlanarCutJoint, PlaneCutJoint, TranslationalCutJoint, CylindricalCutJoint]


@pytest.mark.parametrize("axis", TURNED, ids=str)
@pytest.mark.parametrize("cut", BY_AXIS)
def test_an_axis_of_the_frames_is_the_z_axis_of_turned_frames(cut: Any, axis: Any) -> None:
    rng = np.random.default_rng(9)
    Ra, Rb, at_a, at_b = random_rotation(rng), random_rotation(rng), rng.normal(size=3), rng.normal(size=3)

    def terms(joint: Any) -> Any:
        m = Mechanism()
        body = m.body("b", m.ground, Floating(start=(0.3, 0.2, 0.1, 0.5, 0.5, -0.5, 0.5)), mass=1.0, inertia=(1, 1, 1))
        m.cut("c", joint, m.ground, body)
        compiled = CompiledMechanism(m)
        found = compiled.system.allocate_terms()
        compiled.system.fill(0.0, compiled.assembly.start_positions(), np.arange(6.0), found)
        return found, compiled.system.constraint_names

    found, names = terms(cut(at_a=at_a, at_b=at_b, rotation_a=Ra, rotation_b=Rb, axis=axis))
    turned = {"rotation_a": Ra @ TURNED[axis], "rotation_b": Rb @ TURNED[axis]}
    expected, plain = terms(cut(at_a=at_a, at_b=at_b, **turned))
    for name in ("Phi", "J", "gamma"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=0, atol=1e-13)
    called = dict(zip("xyz", NAMES[axis], strict=True))
    assert names == tuple("c." + "".join(called[a] for a in name[2:]) for name in plain)


def test_rows_of_a_cut_joint_about_z_are_called_as_ever() -> None:
    assert RevoluteCutJoint().rows == RevoluteCutJoint(axis="z").rows == ("x", "y", "z", "zx", "zy")
    assert PlanarCutJoint().rows == ("z", "xz", "yz")
    assert PlaneCutJoint().rows == ("z",)
    assert PlaneCutJoint(axis="y").rows == ("y",)
    assert TranslationalCutJoint(axis="x").rows == ("y", "z", "yz", "zx", "xy")
    assert CylindricalCutJoint(axis=(0, 0, 1)).rows == ("s", "t", "ns", "nt")


@pytest.mark.parametrize(
    ("cut", "turn", "words"),
    [
        (RevoluteCutJoint(axis="x"), pi * Y, "the x axes of its cut joint are rotated by 180 deg"),
        (RevoluteCutJoint(axis=(0, 1, 1)), pi * X, "the n axes of its cut joint are rotated by 180 deg"),
        (CylindricalCutJoint(axis="y"), pi * X, "the y axes of its cut joint are rotated by 180 deg"),
        (TranslationalCutJoint(axis="y"), pi * Y, "the frames of its cut joint are rotated by 180 deg"),
        (RevoluteCutJoint(axis="x"), 2.0 * X, ""),
        (RevoluteCutJoint(axis=(0, 1, 1)), pi / 2**0.5 * (Y + Z), ""),
        (PlanarCutJoint(axis="y"), -1.5 * Y, ""),
        (CylindricalCutJoint(axis="y"), pi * Y, ""),
        (TranslationalCutJoint(axis="y"), 0.0 * X, ""),
    ],
    ids=str,
)
def test_frames_agree_about_the_given_axis(cut: Any, turn: Any, words: str) -> None:
    quaternion = np.roll(Rotation.from_rotvec(turn).as_quat(), 1)
    m = Mechanism()
    m.body("box", m.ground, Floating(start=(0, 0, 0, *quaternion)), mass=1.0, inertia=(1, 1, 1))
    m.cut("c", cut, m.ground, m.bodies[1])
    if words:
        with pytest.raises(AssemblyError, match=f"loop 'c' closes with a wrong orientation: {words}"):
            CompiledMechanism(m).assemble()
    else:
        q, _ = CompiledMechanism(m).assemble()
        np.testing.assert_allclose(q[3:], quaternion, atol=1e-12)


@pytest.mark.parametrize("cut", BY_AXIS)
@pytest.mark.parametrize("axis", ["w", "xy", (0.0, 0.0, 0.0), (1.0, 2.0), None])
def test_what_is_no_axis_of_a_cut_joint_is_refused(cut: Any, axis: Any) -> None:
    m = Mechanism()
    body = m.body("b", m.ground, Floating(), mass=1.0)
    with pytest.raises(UserError, match="axis of cut 'c' is"):
        m.cut("c", cut(axis=axis), m.ground, body)


@pytest.mark.parametrize("L", SIZES)
@pytest.mark.parametrize("axis", ["x", "y", (1.0, -2.0, 0.5)])
@pytest.mark.parametrize("cut", BY_AXIS)
def test_what_a_cut_joint_lets_go_moves_as_in_maximal_coordinates(cut: Any, axis: Any, L: float) -> None:
    """A block that tumbles on an arm which swings: against SciPy's integration of six coordinates a body."""
    rng = np.random.default_rng(12)
    frame = random_rotation(rng)
    m = Mechanism(gravity=L * np.array([1.0, -2.0, 1.5]))
    arm = m.body("arm", m.ground, Revolute(axis=(1.0, 2.0, 2.0), rotation=frame, rate=2.0), **massive(rng, L))
    turn = np.roll(Rotation.from_matrix(frame).as_quat(), 1)
    floating = Floating(start=(*(frame @ [L, 0.0, 0.0]), *turn), rate=(0.3 * L, 0.2 * L, -0.1 * L, 0.5, -0.8, 1.1))
    block = m.body("block", m.ground, floating, **massive(rng, L))
    m.cut("cut", cut(axis=axis, at_a=(L, 0.0, 0.0)), arm, block)
    compiled = CompiledMechanism(m)
    start, times = compiled.assemble(), np.linspace(0.0, 0.6, 4)
    expected = integrate(m, times, start)
    assert not expected.ended
    motion = stepper("adams", compiled.system, 0.0, *start, Options(rtol=1e-10))
    samples = motion.sample(times[1:])
    assert motion.status.ok, motion.status.message
    unit = np.array([1.0, L, L, L, 1.0, 1.0, 1.0, 1.0])
    moved = np.abs((samples.q - start[0]) / unit).max(axis=0)
    assert np.count_nonzero(moved > 0.05) > 4
    np.testing.assert_allclose(samples.q / unit, expected.q[1:] / unit, rtol=0, atol=1e-7)


# -- pictures ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("L", SIZES)
def test_every_joint_has_its_picture(L: float) -> None:
    m = Mechanism(gravity=(0.0, -G, 0.0))
    for k, joint in enumerate((Universal, Cylindrical, Planar, Screw)):
        lead = {"lead": L} if joint is Screw else {}
        m.body(f"b{k}", m.ground, joint(at=(k * L, 0.0, 0.0), axis="z", **lead), mass=1.0, com=(L, 0.0, 0.0))
    picture = draw(m, L)
    assert {(link.a, link.b) for link in picture.links} == {(0, 2), (0, 4)}  # what slides along an axis has a rod
    assert {part.body for part in picture.parts} == {0, 1, 2, 3, 4}
    for part in picture.parts:
        assert np.all(np.isfinite(part.at + part.axes))


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("cut", [*BY_AXIS, WeldCutJoint])
def test_a_cut_joint_is_drawn_along_its_axis(cut: Any, axis: Any) -> None:
    frame = random_rotation(np.random.default_rng(1))
    m = Mechanism()
    a, b = (m.body(name, m.ground, Floating(), mass=1.0, com=X) for name in "ab")
    before = len(draw(m, 1.0).parts)
    m.cut("rod", DistanceCutJoint(length=1.0), a, m.ground)
    options = {} if cut is WeldCutJoint else {"axis": axis}
    m.cut("c", cut(at_a=(0.1, 0.2, 0.3), rotation_a=frame, **options), a, b)
    found = [part for part in draw(m, 1.0).parts if part.at == (0.1, 0.2, 0.3) and part.solid == "cylinder"]
    assert len(found) == 1
    assert before > 0
    along = np.reshape(found[0].axes, (3, 3))[2]
    if cut is WeldCutJoint:
        expected = frame[:, 2]
    else:
        expected = frame @ (np.eye(3)["xyz".index(axis)] if isinstance(axis, str) else np.array(axis))
    expected = expected / np.linalg.norm(expected)
    np.testing.assert_allclose(along / np.linalg.norm(along), expected, atol=1e-12)
