"""Attitudes, pairs of bodies and what forces exert, against NumPy on the positions and attitudes of the bodies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from random_mechanisms import Case, random_inertia, random_rotation
from scipy.spatial.transform import Rotation
from test_identities import along, derivative

from mbfmu import linearize, simulate
from mbfmu.mechanics import (
    BeamElement,
    Bushing,
    CompiledMechanism,
    Floating,
    Input,
    JointForce,
    JointSpring,
    JointStop,
    Mechanism,
    PointForce,
    Polynomial,
    Revolute,
    Spherical,
    Spring,
    Torque,
    TorsionSpring,
    Translational,
)
from mbfmu.mechanics.sensors import Follows
from mbfmu.util.errors import UserError

E = 1e-30
P, Q = np.array((0.3, -0.2, 0.5)), np.array((-0.4, 0.1, 0.7))
N, M = np.array((1.0, 2.0, -2.0)) / 3.0, np.array((0.6, 0.0, 0.8))


@dataclass
class Observed(Case):
    """A mechanism in a random state, and the numbers of its outputs."""

    def read(self, t: float, q: Any, v: Any) -> Any:
        out = np.zeros(len(self.compiled.outputs))
        self.compiled.observe(t, q, v, self.a, np.zeros(0), out)
        return out

    def told(self) -> dict[str, float]:
        names = [variable.name for variable in self.compiled.outputs]
        return dict(zip(names, self.read(self.t, self.q, self.v).tolist(), strict=True))

    def rates(self) -> dict[str, float]:
        names = [variable.name for variable in self.compiled.outputs]
        return dict(zip(names, derivative(self, self.read).tolist(), strict=True))


def tree(m: Mechanism, rng: Any, size: float = 1.0) -> list[Any]:
    """Bodies on joints of several kinds, two branches."""
    bodies, parent = [m.ground], (0, 1, 0, 3)
    for i, kind in enumerate((Floating, Revolute, Spherical, Translational)):
        joint = kind(at=size * rng.normal(size=3), rotation=random_rotation(rng))
        inertia = size**2 * random_inertia(rng)
        bodies.append(
            m.body(f"b{i}", bodies[parent[i]], joint, mass=1.5, com=size * rng.normal(size=3), inertia=inertia)
        )
    return bodies


def in_motion(m: Mechanism, rng: Any, size: float = 1.0) -> Observed:
    """Somewhere, moving."""
    compiled = CompiledMechanism(m)
    n = compiled.system.n
    scale = compiled.system.size
    q = compiled.assembly.start_positions()
    compiled.system.apply(q, scale * rng.normal(size=n))
    return Observed(compiled, 0.7, q, scale * rng.normal(size=n), scale * rng.normal(size=n))


def pose(case: Observed, body: Any) -> tuple[Any, Any, Any, Any]:
    """Position, axes, velocity and angular velocity of a body as the recursions have left them."""
    here = case.compiled.data.state.bodies[body.index]
    return here["r"].copy(), here["A"].copy(), here["Y"][:3].copy(), here["Y"][3:].copy()


@pytest.mark.parametrize("seed", range(6))
def test_attitudes_are_those_of_the_axes(seed: int) -> None:
    rng, m = np.random.default_rng(seed), Mechanism()
    bodies = tree(m, rng)
    for body in bodies:
        for k in range(4):
            m.output(f"{body.name}.e{k}", body.quaternion(k))
        for i in "xyz":
            m.output(f"{body.name}.w{i}", body.angular_velocity(i))
            m.output(f"{body.name}.u{i}", body.angular_velocity(i, frame="body"))
            for j in "xyz":
                m.output(f"{body.name}.{i}{j}", body.direction(i, j))
    case = in_motion(m, rng)
    rates = case.rates()
    told = case.told()  # last: the state is there now
    for body in bodies:
        _, A, _, w = pose(case, body)
        e = Rotation.from_matrix(A).as_quat(canonical=True, scalar_first=True)
        found = [told[f"{body.name}.e{k}"] for k in range(4)]
        np.testing.assert_allclose(found, e, atol=1e-14)
        for i, x in enumerate("xyz"):
            assert told[f"{body.name}.w{x}"] == pytest.approx(w[i], abs=1e-14)
            assert told[f"{body.name}.u{x}"] == pytest.approx(A[:, i] @ w, abs=1e-13)
            for j, y in enumerate("xyz"):
                assert told[f"{body.name}.{x}{y}"] == A[i, j]
                spun = np.cross(w, A[:, j])[i]
                assert rates[f"{body.name}.{x}{y}"] == pytest.approx(spun, abs=1e-8)
        # e' = (0, w) e / 2, with the product of quaternions
        spun = 0.5 * np.r_[-w @ e[1:], e[0] * w + np.cross(w, e[1:])]
        np.testing.assert_allclose([rates[f"{body.name}.e{k}"] for k in range(4)], spun, atol=1e-8)


@pytest.mark.parametrize("given", [(0, 1, 0, 0), (0, 0, -1, 0), (0, 0, 0, 1), (0, -0.6, 0.8, 0), (1, 0, 0, 0),
                                   (1e-9, 1, 0, 0), (-1e-9, 1, 0, 0), (0.5, 0.5, -0.5, 0.5), (0.0, 0.0, 0.6, -0.8),
                                   (-0.1, 0.2, -0.3, 0.9273618495495704), (3e-17, -1.0, 0.0, 0.0)])  # fmt: skip
def test_a_quaternion_is_of_the_attitude_and_its_first_component_positive(given: Any) -> None:
    found = []
    for sign in (1.0, -1.0):
        m = Mechanism()
        body = m.body("b", m.ground, Spherical(start=sign * np.array(given)), mass=1.0, inertia=(1.0, 1.0, 1.0))
        for k in range(4):
            m.output(f"e{k}", body.quaternion(k))
        compiled, out = CompiledMechanism(m), np.zeros(4)
        compiled.observe(0.0, compiled.assembly.start_positions(), np.zeros(3), np.zeros(3), np.zeros(0), out)
        found.append(out)
        assert out[np.flatnonzero(out)[0]] > 0.0
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_allclose(np.abs(found[0] @ np.array(given)), 1.0, rtol=1e-14)
    np.testing.assert_allclose(np.abs(found[0]), np.abs(given), atol=1e-15)  # also what is small is not lost


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("pair", [(1, 4), (2, 1), (0, 3), (4, 0)])
def test_pairs_of_bodies_follow_from_their_positions_and_axes(pair: tuple[int, int], size: float) -> None:
    rng, m = np.random.default_rng(sum(pair)), Mechanism()
    bodies = tree(m, rng, size)
    a, b = (bodies[k] for k in pair)
    at = {"at_a": size * P, "at_b": size * Q}
    m.output("distance", m.distance(a, b, **at))
    m.output("closing", m.distance_rate(a, b, **at))
    m.output("angle", m.angle_between(a, 2.0 * N, b, M))
    for axis in "xyz":
        m.output(f"r{axis}", m.relative_position(b, a, axis, **at))
        m.output(f"v{axis}", m.relative_velocity(b, a, axis, **at))
    case = in_motion(m, rng, size)
    rates = case.rates()
    told = case.told()  # last: the state is there now
    (ra, A, _, _), (rb, B, _, _) = pose(case, a), pose(case, b)
    way = rb + B @ (size * Q) - ra - A @ (size * P)
    close = {"rel": 1e-12, "abs": 1e-13 * size}
    assert told["distance"] == pytest.approx(np.linalg.norm(way), **close)
    assert told["angle"] == pytest.approx(np.arccos((A @ N) @ (B @ M)), rel=1e-10)
    seen = A.T @ way
    for k, axis in enumerate("xyz"):
        assert told[f"r{axis}"] == pytest.approx(seen[k], **close)
        assert told[f"v{axis}"] == pytest.approx(rates[f"r{axis}"], rel=1e-8, abs=1e-8 * size)
    assert told["closing"] == pytest.approx(rates["distance"], rel=1e-8, abs=1e-8 * size)
    units = {variable.name: variable.unit for variable in case.compiled.outputs}
    assert (units["distance"], units["closing"], units["angle"]) == ("m", "m/s", "rad")
    assert (units["rx"], units["vx"]) == ("m", "m/s")


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, np.pi - 1e-9, np.pi])
def test_angles_between_axes_are_exact_where_their_cosine_is_flat(angle: float) -> None:
    m = Mechanism()
    arm = m.body("arm", m.ground, Revolute(axis="z", start=angle), mass=1.0)
    m.output("angle", m.angle_between(m.ground, "x", arm, "x"))
    compiled, out = CompiledMechanism(m), np.zeros(1)
    compiled.observe(0.0, np.array([angle]), np.zeros(1), np.zeros(1), np.zeros(0), out)
    assert out[0] == pytest.approx(angle, rel=1e-6, abs=1e-15)


def test_points_that_coincide_are_at_no_distance_and_have_no_rate() -> None:
    m = Mechanism()
    slider = m.body("slider", m.ground, Translational(axis="x"), mass=1.0)
    m.output("distance", m.distance(m.ground, slider))
    m.output("rate", m.distance_rate(m.ground, slider))
    compiled, out = CompiledMechanism(m), np.ones(2)
    compiled.observe(0.0, np.zeros(1), np.ones(1), np.zeros(1), np.zeros(0), out)
    np.testing.assert_array_equal(out, 0.0)


def loaded(m: Mechanism, rng: Any) -> dict[str, Any]:
    """A tree with forces of every kind on it; their handles by name."""
    _, first, hinged, ball, slider = tree(m, rng)
    at = {"at_a": P, "at_b": Q}
    axes = {"rotation_a": random_rotation(rng), "rotation_b": random_rotation(rng)}
    ramp = Polynomial((0.4, 1.3))
    bush = Bushing(
        stiffness=(3, 4, 5), damping=0.3, rotational_stiffness=(1, 2, 3), rotational_damping=0.2, **at, **axes
    )
    beam = BeamElement(length=1.5, axial=2.0, torsion=1.0, bending_y=0.5, bending_z=0.4, damping=0.2)
    twist = TorsionSpring(axis=N, stiffness=2.0, damping=0.3, free=0.2)
    given = {
        "spring": (Spring(stiffness=3.0, damping=0.4, free=0.5, **at), first, ball),
        "anchor": (Spring(stiffness=2.0, **at), first, None),
        "push": (PointForce(magnitude=ramp, axis=N, at_a=P), first, None),
        "thrust": (PointForce(magnitude=ramp, axis=M, at_a=Q, fixed_in="body"), first, None),
        "torque": (Torque(magnitude=-2.0, axis=M, fixed_in="body"), first, None),
        "moment": (Torque(magnitude=1.5, axis=N), first, None),
        "bush": (bush, first, ball),
        "twist": (twist, slider, first),
        "beam": (beam, first, slider),
        "hinge": (JointSpring(stiffness=2.0, damping=0.3, free=0.1), hinged, None),
        "stop": (JointStop(lower=-0.1, upper=0.1, stiffness=20.0, damping=0.05), slider, None),
        "motor": (JointForce(magnitude=ramp), hinged, None),
    }
    return {name: m.force(name, *what) for name, what in given.items()}


def test_a_floating_body_moves_by_the_forces_and_its_child() -> None:
    """Newton and Euler about its center of mass, with what sensors say that each force exerts on it."""
    rng, m = np.random.default_rng(11), Mechanism()
    handles = loaded(m, rng)
    first, hinged = m.bodies[1], m.bodies[2]
    on = [(h, side) for h in handles.values() for side, b in (("a", h.a), ("b", h.b))
          if b is first and not h.load.on_joint]  # fmt: skip
    assert len(on) == 9
    for k, (handle, side) in enumerate(on):
        for axis in "xyz":
            m.output(f"f{k}{axis}", handle.force(axis, on=side))
            m.output(f"m{k}{axis}", handle.moment(axis, on=side))
    for axis in "xyz":
        m.output(f"joint.f{axis}", hinged.joint_force(axis))
        m.output(f"joint.m{axis}", hinged.joint_moment(axis))
        m.output(f"a{axis}", first.point_acceleration(axis, first.com))
        m.output(f"r{axis}", hinged.position(axis))
    case = in_motion(m, rng)
    system = case.compiled.system
    terms = system.allocate_terms()
    system.fill(case.t, case.q, case.v, terms)
    case.a = np.linalg.solve(terms.M, -terms.h)  # moved by these forces, and by no others
    told = case.told()

    def three(name: str) -> Any:
        return np.array([told[f"{name}{axis}"] for axis in "xyz"])

    here = case.compiled.data.state.bodies[1]
    r, A, w, alpha = here["r"], here["A"], here["Y"][3:], here["dY"][3:]
    force = sum(three(f"f{k}") for k in range(len(on))) - three("joint.f")
    moment = sum(three(f"m{k}") for k in range(len(on))) - three("joint.m")
    moment -= np.cross(three("r") - r, three("joint.f"))
    J, com = A @ first.inertia @ A.T, A @ first.com
    np.testing.assert_allclose(force, first.mass * three("a"), atol=1e-11 * np.abs(force).max())
    np.testing.assert_allclose(
        moment - np.cross(com, force), J @ alpha + np.cross(w, J @ w), atol=1e-11 * np.abs(moment).max()
    )


def test_what_acts_between_bodies_is_a_reaction_about_every_point() -> None:
    rng, m = np.random.default_rng(12), Mechanism()
    pairs = [h for n, h in loaded(m, rng).items() if n in ("spring", "anchor", "bush", "twist", "beam")]
    for handle in pairs:
        for on in "ab":
            for axis in "xyz":
                m.output(f"{handle.name}.f{on}{axis}", handle.force(axis, on=on))
                m.output(f"{handle.name}.m{on}{axis}", handle.moment(axis, on=on))
    case = in_motion(m, rng)
    told = case.told()

    def three(name: str) -> Any:
        return np.array([told[f"{name}{axis}"] for axis in "xyz"])

    for handle in pairs:
        ra, rb = pose(case, handle.a)[0], pose(case, handle.b)[0]
        fa, fb = three(f"{handle.name}.fa"), three(f"{handle.name}.fb")
        np.testing.assert_allclose(fa, -fb, atol=1e-13)
        total = three(f"{handle.name}.ma") + three(f"{handle.name}.mb") + np.cross(ra, fa) + np.cross(rb, fb)
        np.testing.assert_allclose(total, 0.0, atol=1e-12 * (1.0 + np.abs(np.cross(rb, fb)).max()))
        assert np.abs(np.r_[fa, three(f"{handle.name}.ma")]).max() > 0.1


def test_given_forces_and_joint_forces_are_returned_as_given() -> None:
    rng, m = np.random.default_rng(13), Mechanism()
    handles = loaded(m, rng)
    for axis in "xyz":
        m.output(f"push{axis}", handles["push"].force(axis))
        m.output(f"none{axis}", handles["push"].force(axis, on="b"))
        m.output(f"lever{axis}", handles["push"].moment(axis))
        m.output(f"thrust{axis}", handles["thrust"].force(axis))
        m.output(f"torque{axis}", handles["torque"].moment(axis))
    for name in ("hinge", "stop", "motor"):
        m.output(name, handles[name].effort())
    case = in_motion(m, rng)
    case.q[-1], case.v[-1] = 0.35, 0.8  # slider, in its stop
    told, size = case.told(), 0.4 + 1.3 * 0.7
    _, A, _, _ = pose(case, m.bodies[1])
    for k, axis in enumerate("xyz"):
        assert told[f"push{axis}"] == pytest.approx(size * N[k], rel=1e-13)
        assert told[f"none{axis}"] == 0.0
        assert told[f"lever{axis}"] == pytest.approx(size * np.cross(A @ P, N)[k], rel=1e-12)
        assert told[f"thrust{axis}"] == pytest.approx(size * (A @ M)[k], rel=1e-12)
        assert told[f"torque{axis}"] == pytest.approx(-2.0 * (A @ M)[k], rel=1e-12)
    assert told["motor"] == pytest.approx(size, rel=1e-14)
    assert told["hinge"] == pytest.approx(-2.0 * (case.q[7] - 0.1) - 0.3 * case.v[6], rel=1e-13)
    assert told["stop"] == pytest.approx(-20.0 * 0.25 * (1.0 + 0.05 * 0.8), rel=1e-12)
    units = {variable.name: variable.unit for variable in case.compiled.outputs}
    assert (units["hinge"], units["stop"], units["pushx"], units["leverx"]) == ("N.m", "N", "N", "N.m")


def test_reading_a_force_leaves_the_state_as_it_was() -> None:
    """Also twice, before and after others."""
    states, wrenches = [], []
    for read in (False, True):
        rng, m = np.random.default_rng(14), Mechanism(gravity=(0.0, 0.0, -9.81))
        handles = loaded(m, rng)
        for again in "01" if read else "":
            for name, handle in handles.items():
                m.output(f"{name}{again}", handle.effort() if handle.load.on_joint else handle.moment("y"))
        m.output("joint", m.bodies[4].joint_force("x"))
        case = in_motion(m, rng)
        told = case.told()
        if read:
            assert all(told[f"{name}0"] == told[f"{name}1"] for name in handles)
            assert any(told[f"{name}0"] for name in handles)
        state = case.compiled.data.state
        states.append({name: np.array(getattr(state, name)) for name in ("Q", "tau", "cached_power", "v", "q", "time")})
        wrenches.append((state.bodies["F"].copy(), told["joint"]))
    for name, before in states[0].items():
        np.testing.assert_array_equal(before, states[1][name], err_msg=name)
    np.testing.assert_array_equal(wrenches[0][0], wrenches[1][0])
    assert np.abs(wrenches[0][0]).max() > 0.0
    assert wrenches[0][1] == wrenches[1][1]


def test_derivatives_of_all_outputs_by_complex_steps() -> None:
    rng, m = np.random.default_rng(15), Mechanism(gravity=(0.3, -1.0, 0.2))
    handles = loaded(m, rng)
    a, b = m.bodies[1], m.bodies[4]
    for name, handle in handles.items():
        if handle.load.on_joint:
            m.output(name, handle.effort())
        else:
            m.output(f"{name}.f", handle.force("x"))
            m.output(f"{name}.m", handle.moment("z"))
    for k in range(4):
        m.output(f"e{k}", b.quaternion(k))
    m.output("direction", b.direction("x", "y"))
    m.output("spin", b.angular_velocity("y", frame="body"))
    m.output("distance", m.distance(a, b, at_a=P, at_b=Q))
    m.output("closing", m.distance_rate(a, b, at_a=P, at_b=Q))
    m.output("angle", m.angle_between(a, N, b, M))
    m.output("place", m.relative_position(b, a, "y", at_a=P, at_b=Q))
    m.output("speed", m.relative_velocity(b, a, "y", at_a=P, at_b=Q))
    case = in_motion(m, rng)
    case.q[-1] = 0.4  # slider, in its stop
    compiled, system = case.compiled, case.compiled.complex_system()
    dq, dv = rng.normal(size=system.n), rng.normal(size=system.n)
    q: Any = case.q.astype(complex)
    step: Any = 1j * E * dq
    system.apply(q, step)
    zero: Any = np.zeros(system.n, complex)
    found = compiled.observe_complex(system, case.t, q, case.v + 1j * E * dv, zero + case.a, np.zeros(0, complex))
    h, stencil = 1e-3, {-2: 1 / 12, -1: -8 / 12, 1: 8 / 12, 2: -1 / 12}

    def moved(s: float) -> Any:
        there = case.q.copy()
        compiled.system.apply(there, s * dq)
        return case.read(case.t, there, case.v + s * dv)

    slopes = sum(weight * moved(k * h) for k, weight in stencil.items()) / h
    np.testing.assert_allclose(found.real, case.read(case.t, case.q, case.v), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found.imag / E, slopes, rtol=1e-7, atol=1e-7)
    moving = {"torque.f", "moment.f", "moment.m", "push.f", "motor", "twist.f"}  # constant: no force, or a given one
    names = [variable.name for variable in compiled.outputs]
    assert all((slope != 0.0) != (name in moving) for name, slope in zip(names, found.imag, strict=True))


def test_a_force_follows_an_input_at_once_and_what_moves_does_not() -> None:
    m = Mechanism()
    slider = m.body("slider", m.ground, Translational(axis="x"), mass=2.0)
    push = m.force("push", PointForce(magnitude=Input(name="f", unit="N"), axis="x"), slider)
    motor = m.force("motor", JointForce(magnitude=Input(name="g", unit="N")), slider)
    m.output("push", push.force("x"))
    m.output("motor", motor.effort())
    m.output("distance", m.distance(m.ground, slider))
    compiled = CompiledMechanism(m)
    assert push.force("x").follows is Follows.FORCES
    assert compiled.feedthrough() == [(0,), (1,), ()]  # each its own input alone
    assert compiled.has_force_outputs
    result = simulate(m, 1.0, interval=0.25, solver="adams", tolerance=1e-9, inputs={"f": lambda t: 3.0 * t, "g": 2.0})
    np.testing.assert_allclose(result["push"], 3.0 * result.t, atol=1e-12)
    np.testing.assert_allclose(result["motor"], 2.0)
    line = linearize(m)
    assert line.D[0, 0] == pytest.approx(1.0)
    assert line.D[1, 1] == pytest.approx(1.0)
    assert line.D[0, 1] == 0.0


def test_a_run_reports_power_and_energy_of_a_spring() -> None:
    """On a slider from rest: force -k x0 cos(omega t)."""
    m = Mechanism()
    slider = m.body("slider", m.ground, Translational(axis="x", start=1.2), mass=2.0)
    spring = m.force("spring", Spring(stiffness=8.0, free=1.0), m.ground, slider)
    m.output("force", spring.force("x", on="b"))
    m.output("length", m.distance(m.ground, slider))
    result = simulate(m, 2.0, interval=0.1, solver="adams", tolerance=1e-10)
    np.testing.assert_allclose(result["force"], -8.0 * 0.2 * np.cos(2.0 * result.t), atol=1e-7)
    np.testing.assert_allclose(result["length"], 1.0 + 0.2 * np.cos(2.0 * result.t), atol=1e-8)


def test_ambiguous_arguments_are_refused() -> None:
    m, other = Mechanism(), Mechanism()
    arm = m.body("arm", m.ground, Revolute(), mass=1.0)
    stranger = other.body("stranger", other.ground, Revolute(), mass=1.0)
    spring = m.force("spring", Spring(stiffness=1.0), m.ground, arm)
    motor = m.force("motor", JointForce(magnitude=1.0), arm)
    theirs = other.force("theirs", Torque(magnitude=1.0), stranger)
    for make, message in (
        (lambda: arm.quaternion(4), "component of the quaternion of body 'arm' is 4; allowed: 0, 1, 2, 3"),
        (lambda: arm.quaternion(True), "component of the quaternion of body 'arm' is True; allowed: 0, 1, 2, 3"),
        (lambda: arm.angle(False), "body 'arm' has no joint coordinate False"),
        (lambda: arm.direction("x", "q"), "component of body 'arm' is 'q'"),
        (
            lambda: arm.angular_velocity("x", frame="joint"),
            "frame of the angular velocity of body 'arm' is 'joint'; allowed: 'global'",
        ),
        (
            lambda: m.distance(m.ground, arm, at_a=3.0),
            "at_a of the distance between 'ground' and 'arm' is 3.0; it needs three",
        ),
        (lambda: m.angle_between(m.ground, "u", arm, "x"), "axis_a of the angle between 'ground' and 'arm' is 'u'"),
        (lambda: m.relative_position(arm, m.ground, "u"), "component of 'arm' relative to 'ground' is 'u'"),
        (
            lambda: m.output("o", m.distance(m.ground, stranger)),
            "(?s)body of output 'o' is .* not a body of this mechanism",
        ),
        (lambda: m.output("o", theirs.force("x")), "body of output 'o' is"),
        (lambda: spring.force("x", on="c"), "body of force 'spring' is 'c'; allowed: 'a', 'b'"),
        (lambda: spring.force("r"), "component of force 'spring' is 'r'"),
        (spring.effort, "force 'spring' acts on bodies and not along a joint coordinate"),
        (lambda: motor.moment("x"), "force 'motor' acts along a joint coordinate; use effort()"),
    ):
        with pytest.raises(UserError, match=message):
            make()


def test_the_path_of_a_case_is_that_of_its_velocities() -> None:
    """What rates are compared with above: the derivative of the joint positions along it."""
    rng, m = np.random.default_rng(16), Mechanism()
    tree(m, rng)
    case = in_motion(m, rng)
    terms = case.compiled.system.allocate_terms()
    case.compiled.system.fill(case.t, case.q, case.v, terms)
    ahead, back = along(case, 1e-5)[1], along(case, -1e-5)[1]
    np.testing.assert_allclose((ahead - back) / 2e-5, terms.qdot, atol=1e-8)
