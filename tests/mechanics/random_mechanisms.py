"""Random mechanisms: every joint, cut joint and force on trees and forests, for identities that hold for all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from hypothesis import strategies as st

from mbfmu.mechanics import Cam, CompiledMechanism, Mechanism, Screw, Table, Universal, couplings, cuts, joints, loads
from mbfmu.mechanics.couplings import Coupling
from mbfmu.mechanics.cuts import CutJoint, DistanceCutJoint, RollingWheel
from mbfmu.mechanics.cuts.base import AxisCut
from mbfmu.mechanics.joints import Joint
from mbfmu.mechanics.joints.base import AxisJoint
from mbfmu.mechanics.kind import element_types_of
from mbfmu.mechanics.loads import (
    Damper,
    DistanceStop,
    Force,
    JointStop,
    LineForce,
    SlippingWheel,
    Spring,
    TorsionSpring,
)
from mbfmu.mechanics.loads.bristle import BristleFriction
from mbfmu.mechanics.signals import Harmonic, Polynomial
from mbfmu.sheets import joints as sheet_joints

Generator = np.random.Generator
JOINTS, CUTS, COUPLINGS = (
    sorted(element_types_of(joints, Joint) + element_types_of(sheet_joints, Joint), key=lambda kind: kind.__name__),
    element_types_of(cuts, CutJoint),
    element_types_of(couplings, Coupling),
)
FORCES = [  # without first-order states
    kind for kind in element_types_of(loads, Force) if not issubclass(kind, BristleFriction | SlippingWheel)
]
TURNING = ("rotational_stiffness", "rotational_damping")
NUMBERS = ("stiffness", "damping", *TURNING, "free", "axial", "torsion", "bending_y", "bending_z")


@dataclass
class Case:
    """A compiled mechanism with a random state."""

    compiled: CompiledMechanism
    t: float
    q: Any
    v: Any
    a: Any


def random_rotation(rng: Generator) -> Any:
    """A uniformly random rotation matrix."""
    Q, R = np.linalg.qr(rng.normal(size=(3, 3)))
    Q = Q * np.sign(np.diag(R))
    return Q if np.linalg.det(Q) > 0 else -Q


def random_inertia(rng: Generator) -> Any:
    """Inertia of a random mass distribution: fulfils the triangle inequality."""
    points = rng.normal(size=(5, 3))
    return sum((p @ p) * np.eye(3) - np.outer(p, p) for p in points) * 0.1


def random_joint(kind: type[Joint], rng: Generator, driven: bool) -> Joint:
    """A joint of this kind at a random placement."""
    options: dict[str, Any] = {"at": rng.normal(size=3), "rotation": random_rotation(rng)}
    if kind.nv == 1:
        options["armature"] = abs(options["at"][0])
    if issubclass(kind, AxisJoint):
        options["axis"] = rng.normal(size=3)
        if kind is Universal:
            options["second"] = np.cross(options["axis"], rng.normal(size=3))
        if kind is Screw:
            options["lead"] = rng.normal()
        if driven:
            options["drive"] = Harmonic(amplitude=rng.normal(), frequency=0.5, phase=rng.normal(), mean=rng.normal())
    return kind(**options)


def add_forces(m: Mechanism, rng: Generator) -> None:
    """One force of every kind that finds a place."""
    for kind in FORCES:
        body = m.bodies[rng.integers(1, len(m.bodies))]
        other = m.bodies[rng.integers(0, body.index)]
        if kind.on_joint and body.joint.nv != 1:
            continue
        names = kind.__dataclass_fields__
        options: dict[str, Any] = {k: rng.uniform(0.1, 2.0) for k in (*NUMBERS, "length") if k in names}
        options |= {k: rng.normal(size=3) for k in ("at_a", "at_b", "axis") if k in names}
        if "magnitude" in names:
            options["magnitude"] = Polynomial(rng.normal(size=3))
        if "fixed_in" in names:
            options["fixed_in"] = str(rng.choice(["ground", "body"]))
        options |= {k: random_rotation(rng) for k in ("rotation", "rotation_a", "rotation_b") if k in names}
        if kind is JointStop:  # mostly beyond a limit; damped so little that it never comes to where it would pull
            lower, upper = ((0.5, None), (None, -0.5), (-1.0, 0.5))[rng.integers(3)]
            options |= {"lower": lower, "upper": upper, "damping": rng.uniform(0.05, 0.3)}
        if kind is DistanceStop:
            lower, upper = ((None, 0.7), (5.0, None), (0.5, 1.5))[rng.integers(3)]
            options |= {"lower": lower, "upper": upper, "damping": rng.uniform(0.005, 0.02)}
        m.force(kind.__name__, kind(**options), body, other)


def add_couplings(m: Mechanism, rng: Generator, kinds: list[type[Coupling]]) -> None:
    """Couplings of these kinds between random coordinates, as far as there are two."""
    plain = [(b, k) for b in m.bodies[1:] for k in range(b.joint.nv - 3 * b.joint.quaternion)]
    for i, kind in enumerate(kinds if len(plain) > 1 else []):
        (a, k), (b, l) = (plain[j] for j in rng.permutation(len(plain))[:2])
        law = Table([-30.0, -10.0, 10.0, 30.0], 20.0 * rng.normal(size=4))  # no point is near where it is taken
        coupling = kind(law=law) if kind is Cam else kind(ratio=rng.normal(), offset=rng.normal())
        m.couple(f"g{i}", coupling, a, b, coordinate_a=k, coordinate_b=l)


def smooth(case: Case) -> bool:
    """Whether no load is about to jump, to bend or to turn fast: differences would not be derivatives."""
    compiled, state = case.compiled, case.compiled.data.state
    compiled.energy(case.t, case.q, case.v)
    lines = [f for kind in (Spring, Damper, LineForce, DistanceStop) for f in compiled.records(kind)]
    if any(line_velocity(f, *(state.bodies[int(f[k])] for k in "ab")) > 5.0 for f in lines):
        return False
    lengths = [(f, *distance(f, *(state.bodies[int(f[k])] for k in "ab"))) for f in compiled.records(DistanceStop)]
    coordinates = [(f, state.q[int(f["q"])], state.v[int(f["v"])]) for f in compiled.records(JointStop)]
    for f, q, rate in lengths + coordinates:
        v = abs(rate)
        if min(abs(q - f["lower"]), abs(q - f["upper"])) < 0.05 * (1.0 + v) or f["damping"] * v > 0.9:
            return False
    bodies = state.bodies["A"]
    wheels = [handle for handle in compiled.mechanism.cuts if isinstance(handle.cut, RollingWheel)]
    for wheel, f in zip(wheels, compiled.records(RollingWheel), strict=True):
        normal, axle = (bodies[end.index] @ f[R][:, 2] for end, R in ((wheel.a, "Ra"), (wheel.b, "Rb")))
        if np.linalg.norm(np.cross(normal, axle)) < 0.3:  # a wheel that lies nearly flat changes its direction fast
            return False
    for f in compiled.records(TorsionSpring):
        A, B = state.bodies["A"][int(f["a"])], state.bodies["A"][int(f["b"])]
        R = f["Ea"] @ A.T @ B @ f["Eb"].T
        if R[2, 2] < -0.4 or abs(np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])) > 2.8:
            return False
    return True


def between(f: Any, A: Any, B: Any) -> tuple[Any, Any]:
    """Vector between the points of a load, and its rate."""
    at_a, at_b = A["A"] @ f["Pa"], B["A"] @ f["Pb"]
    way = B["r"] + at_b - A["r"] - at_a
    rate = B["Y"][:3] + np.cross(B["Y"][3:], at_b) - A["Y"][:3] - np.cross(A["Y"][3:], at_a)
    return way, rate


def distance(f: Any, A: Any, B: Any) -> tuple[float, float]:
    """Distance between the points of a load, and its rate."""
    way, rate = between(f, A, B)
    length = np.linalg.norm(way)
    return float(length), float(way @ rate / length)


def line_velocity(f: Any, A: Any, B: Any) -> float:
    """Rate of the vector between the points of a load over its length [1/s]: how soon its direction may change."""
    way, rate = between(f, A, B)
    return float(np.linalg.norm(rate) / np.linalg.norm(way))


def build(seed: int, kinds: list[type[Joint]], closing: list[type], driven: bool, forces: bool) -> Case:
    """A mechanism of these joints, cuts and couplings in a random state where nothing jumps."""
    case = drawn(seed, kinds, closing, driven, forces)
    while not smooth(case):
        seed += 1
        case = drawn(seed, kinds, closing, driven, forces)
    return case


def drawn(seed: int, kinds: list[type[Joint]], closing: list[type], driven: bool, forces: bool) -> Case:
    """A mechanism of these joints, cuts and couplings in a random state."""
    rng = np.random.default_rng(seed)
    m = Mechanism(gravity=rng.normal(size=3))
    for i, kind in enumerate(kinds):
        parent = m.bodies[rng.integers(0, i + 1)]
        joint = random_joint(kind, rng, driven and i == 0)
        mass = rng.uniform(0.5, 2.0)
        m.body(f"b{i}", parent, joint, mass=mass, com=rng.normal(size=3), inertia=random_inertia(rng))
    for i, cut in enumerate(kind for kind in closing if issubclass(kind, CutJoint)):
        options: dict[str, Any] = {"at_a": rng.normal(size=3), "at_b": rng.normal(size=3)}
        options |= {"rotation_a": random_rotation(rng), "rotation_b": random_rotation(rng)}
        if cut is DistanceCutJoint:
            options["length"] = rng.uniform(0.5, 2.0)
        if cut is RollingWheel:
            options |= {"radius": rng.uniform(0.5, 2.0), "crown_radius": rng.uniform(0.0, 0.4)}
        if issubclass(cut, AxisCut):
            options["axis"] = ("x", "y", "z", rng.normal(size=3))[rng.integers(4)]
        m.cut(f"c{i}", cut(**options), m.bodies[-1], m.bodies[rng.integers(0, len(m.bodies) - 1)])
    add_couplings(m, rng, [kind for kind in closing if issubclass(kind, Coupling)])
    if forces:
        add_forces(m, rng)
    for body in m.bodies[1:]:
        for axis in "xyz":
            m.output(f"{body.name}.r{axis}", body.position(axis, (0.3, -0.2, 0.5)))
            m.output(f"{body.name}.v{axis}", body.velocity(axis, (0.3, -0.2, 0.5)))
            m.output(f"{body.name}.a{axis}", body.point_acceleration(axis, (0.3, -0.2, 0.5)))
        if body.joint.drive is not None:
            m.output(f"{body.name}.effort", body.effort())
            m.output(f"{body.name}.drive_rate", body.rate())
    m.output("energy", m.energy)
    m.output("jacobi", m.jacobi_integral)
    compiled = CompiledMechanism(m)
    n = compiled.system.n
    q = compiled.assembly.start_positions()
    compiled.system.apply(q, rng.normal(size=n))
    return Case(compiled, float(rng.normal()), q, rng.normal(size=n), rng.normal(size=n))


MOVING = [joint for joint in JOINTS if joint.nv > 0]


@st.composite
def cases(draw: Any, *, cuts: bool = False, driven: bool = False, forces: bool = False) -> Case:
    """Draw a random mechanism and state; the last body always moves."""
    kinds = draw(st.lists(st.sampled_from(JOINTS), min_size=0, max_size=4))
    kinds.append(draw(st.sampled_from([j for j in MOVING if j.nv >= 3] if cuts else MOVING)))
    if driven:
        kinds.insert(0, draw(st.sampled_from([j for j in MOVING if j.nv == 1])))
    closing = draw(st.lists(st.sampled_from(CUTS), min_size=1, max_size=2)) if cuts else []
    closing += draw(st.lists(st.sampled_from(COUPLINGS), max_size=2)) if cuts else []
    return build(draw(st.integers(0, 2**32 - 1)), kinds, closing, driven, forces)
