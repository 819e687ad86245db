"""Mechanisms declared as a graph: joints in any order and direction, whichever of them close the loops."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, permutations
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism, Joint
from mbfmu.mechanics.builder.spanning_tree import Edge, Rank, choose_tree
from mbfmu.testing import check_element

Array = NDArray[np.float64]
G = 9.81
BARS = {"crank": (1.0, 1.0), "coupler": (3.0, 2.0), "rocker": (2.0, 1.5)}  # lengths, m, and masses, kg
GROUND = 3.0  # m
ENDS = {  # joints: bodies a and b, and their points, m
    "A": ("ground", "crank", 0.0, 0.0),
    "B": ("crank", "coupler", 1.0, 0.0),
    "C": ("coupler", "rocker", 3.0, 2.0),
    "D": ("ground", "rocker", GROUND, 0.0),
}
CRANK = 1.0  # rad, at the start


def four_bar(
    order: Sequence[str] = "ABCD", reverse: str = "", damping: float = 0.0, outputs: str = "A"
) -> mb.Mechanism:
    """Four-bar linkage in the x-y plane; joints in ``reverse`` are declared from b to a."""
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    bodies = {"ground": m.ground}
    for name, (length, mass) in BARS.items():
        bodies[name] = m.body(name, **mb.rod(mass=mass, length=length))
    for name in order:
        a, b, at_a, at_b = ENDS[name]
        sign = 1.0
        if name in reverse:
            a, b, at_a, at_b, sign = b, a, at_b, at_a, -1.0
        start: dict[str, Any] = {"start": sign * CRANK, "fixed": True} if name == "A" else {}
        if name == "D":
            start = {"start": sign * 1.5}
        joint = m.joint(name, bodies[a], bodies[b], mb.Revolute(at=(at_a, 0, 0), **start), at_b=(at_b, 0, 0))
        if damping:
            m.force(f"{name}.damper", mb.JointSpring(stiffness=0.0, damping=damping), joint)
        if name in outputs:
            m.output(f"{name}.angle", joint.angle())
            m.output(f"{name}.rate", joint.rate())
        for axis in "xy":
            m.output(f"{name}.{axis}", joint.force(axis, on="b" if name not in reverse else "a"))
    return m


class FourBar:
    """The same linkage in coordinates of its bars (x, y, angle of each), with the pins as constraints."""

    def __init__(self, damping: float) -> None:
        self.names, self.damping = list(BARS), damping
        self.M = np.diag([x for length, mass in BARS.values() for x in (mass, mass, mass * length**2 / 12.0)])
        self.weight = np.array([x for _, mass in BARS.values() for x in (0.0, -G * mass, 0.0)])

    def _point(self, body: str, along: float, y: Array, v: Array) -> tuple[Array, Array, Array]:
        """Position (2,), Jacobian (2, 9) and velocity-dependent acceleration (2,) of a point of a bar."""
        J = np.zeros((2, 9))
        if body == "ground":
            return np.array((along, 0.0)), J, np.zeros(2)
        k = 3 * self.names.index(body)
        off = along - 0.5 * BARS[body][0]
        axis, normal = np.array((np.cos(y[k + 2]), np.sin(y[k + 2]))), np.array((-np.sin(y[k + 2]), np.cos(y[k + 2])))
        J[:, k : k + 2], J[:, k + 2] = np.eye(2), off * normal
        return y[k : k + 2] + off * axis, J, -off * v[k + 2] ** 2 * axis

    def constraints(self, y: Array, v: Array) -> tuple[Array, Array, Array]:
        """Gaps (8,), Jacobian (8, 9), and velocity-dependent accelerations (8,) of the pins."""
        parts = []
        for a, b, at_a, at_b in ENDS.values():
            (pa, Ja, ga), (pb, Jb, gb) = self._point(a, at_a, y, v), self._point(b, at_b, y, v)
            parts.append((pb - pa, Jb - Ja, gb - ga))
        gap, J, g = (np.concatenate(part) for part in zip(*parts, strict=True))
        return gap, J, g

    def accelerations(self, y: Array, v: Array) -> tuple[Array, Array]:
        """Accelerations (9,) and forces of the pins on the bodies b (4, 2)."""
        _, J, g = self.constraints(y, v)
        force = self.weight.copy()
        for a, b, _, _ in ENDS.values():
            rate = [0.0 if body == "ground" else v[3 * self.names.index(body) + 2] for body in (a, b)]
            for body, sign in ((a, 1.0), (b, -1.0)):
                if body != "ground":
                    force[3 * self.names.index(body) + 2] += sign * self.damping * (rate[1] - rate[0])
        K = np.block([[self.M, J.T], [J, np.zeros((8, 8))]])
        found = np.linalg.solve(K, np.concatenate((force, -g)))
        return found[:9], -found[9:].reshape(4, 2)

    def start(self) -> Array:
        """Closed position with the given angle of the crank, and at rest."""
        pin = np.array((np.cos(CRANK), np.sin(CRANK)))

        def gap(rocker: float) -> float:
            end = np.array((GROUND + 2.0 * np.cos(rocker), 2.0 * np.sin(rocker)))
            return float(np.linalg.norm(end - pin) - BARS["coupler"][0])

        rocker = brentq(gap, 0.8, 2.0, xtol=1e-15)
        end = np.array((GROUND + 2.0 * np.cos(rocker), 2.0 * np.sin(rocker)))
        coupler = np.arctan2(*(end - pin)[::-1])
        return np.array(
            (*(0.5 * pin), CRANK, *(0.5 * (pin + end)), coupler, *(0.5 * (end + np.array((GROUND, 0.0)))), rocker)
        )

    def motion(self, times: Array) -> tuple[Array, Array, Array]:
        """Angles (k, 3), rates (k, 3), and forces (k, 4, 2)."""

        def right(_: float, x: Array) -> Array:
            return np.concatenate((x[9:], self.accelerations(x[:9], x[9:])[0]))

        x0 = np.concatenate((self.start(), np.zeros(9)))
        found = solve_ivp(right, (0.0, times[-1]), x0, t_eval=times, method="DOP853", rtol=1e-12, atol=1e-13).y.T
        forces = np.array([self.accelerations(x[:9], x[9:])[1] for x in found])
        return found[:, 2:9:3], found[:, 11::3], forces


TIMES = np.linspace(0.0, 1.0, 11)


def check_four_bar(m: mb.Mechanism, damping: float, reverse: str = "", outputs: str = "A") -> None:
    """Compare angles, rates and forces with the reference."""
    angles, rates, forces = FourBar(damping).motion(TIMES)
    result = mb.simulate(m, 1.0, interval=0.1, solver="adams", tolerance=1e-9)
    of = {"ground": -1, "crank": 0, "coupler": 1, "rocker": 2}
    turned = np.column_stack((angles, np.zeros(len(TIMES)))), np.column_stack((rates, np.zeros(len(TIMES))))
    for k, (name, (a, b, _, _)) in enumerate(ENDS.items()):
        np.testing.assert_allclose(result[f"{name}.x"], forces[:, k, 0], atol=2e-6)
        np.testing.assert_allclose(result[f"{name}.y"], forces[:, k, 1], atol=2e-6)
        if name in outputs:
            sign = -1.0 if name in reverse else 1.0
            for what, value in zip(("angle", "rate"), turned, strict=True):
                expected = sign * (value[:, of[b]] - value[:, of[a]])
                np.testing.assert_allclose(result[f"{name}.{what}"], expected, atol=1e-7)


@pytest.mark.parametrize(("order", "reverse"), [("ABCD", ""), ("DCBA", "C"), ("CADB", "BD"), ("BCDA", "ABCD")])
def test_a_four_bar_moves_alike_in_every_order_and_direction(order: str, reverse: str) -> None:
    check_four_bar(four_bar(order, reverse), 0.0, reverse)


def test_all_coordinates_of_a_loop_are_used() -> None:
    m = four_bar("DACB", "BD", damping=0.7, outputs="ABCD")
    compiled = CompiledMechanism(m)
    assert len(compiled.mechanism.cuts) == 1
    assert "is divided into parts" in m.tree_notes[0].text
    assert sum(body.mass for body in m.bodies) == pytest.approx(sum(mass for _, mass in BARS.values()))
    check_four_bar(m, 0.7, "BD", "ABCD")


def test_the_same_bodies_without_a_graph_move_alike() -> None:
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    crank = m.body("crank", m.ground, mb.Revolute(start=CRANK, fixed=True), **mb.rod(mass=1.0, length=1.0))
    coupler = m.body("coupler", crank, mb.Revolute(at=(1.0, 0, 0)), **mb.rod(mass=2.0, length=3.0))
    rocker = m.body("rocker", m.ground, mb.Revolute(at=(GROUND, 0, 0), start=1.5), **mb.rod(mass=1.5, length=2.0))
    m.joint("C", coupler, rocker, mb.Revolute(at=(3.0, 0, 0)), at_b=(2.0, 0, 0))
    m.output("A.angle", crank.angle())
    m.output("A.rate", crank.rate())
    m.output("C.x", m.joints[0].force("x"))
    angles, _, forces = FourBar(0.0).motion(TIMES)
    result = mb.simulate(m, 1.0, interval=0.1, solver="adams", tolerance=1e-9)
    np.testing.assert_allclose(result["A.angle"], angles[:, 0], atol=1e-7)
    np.testing.assert_allclose(result["C.x"], forces[:, 2, 0], atol=2e-6)


def pose(joint: Joint, q: Array) -> tuple[Array, Array]:
    """Origin (3,) and axes (3, 3) of the second frame of a joint in its first."""
    n = joint.direction
    origin, turn = np.zeros(3), Rotation.identity()
    if isinstance(joint, mb.Revolute | mb.Screw | mb.Cylindrical):
        turn = Rotation.from_rotvec(q[0] * n)
    if isinstance(joint, mb.Screw):
        origin = joint.lead * q[0] / (2.0 * np.pi) * n
    if isinstance(joint, mb.Cylindrical):
        origin = q[1] * n
    if isinstance(joint, mb.Translational):
        origin = q[0] * n
    if isinstance(joint, mb.Planar):
        origin, turn = np.array((q[0], q[1], 0.0)), Rotation.from_rotvec(q[2] * n)
    if isinstance(joint, mb.Universal):
        turn = Rotation.from_rotvec((q[0], 0, 0)) * Rotation.from_rotvec((0, q[1], 0))
    if isinstance(joint, mb.Spherical | mb.Floating):
        turn = Rotation.from_quat(np.roll(q[-4:], -1))
    if isinstance(joint, mb.Floating):
        origin = q[:3]
    return origin, turn.as_matrix()


TURNED_A, TURNED_B = Rotation.from_rotvec((0.3, -0.5, 0.7)), Rotation.from_rotvec((-0.4, 0.9, 0.2))
AT_A, AT_B = np.array((0.4, -0.3, 0.2)), np.array((-0.2, 0.5, 0.6))
PLACED: dict[str, Any] = {"at": AT_A, "rotation": TURNED_A}
EVERY_JOINT = (
    mb.Weld(**PLACED),
    mb.Revolute(axis=(1, 2, -1), **PLACED),
    mb.Translational(axis=(2, 1, 1), **PLACED),
    mb.Cylindrical(axis="y", **PLACED),
    mb.Screw(axis=(0, 1, 1), lead=0.7, **PLACED),
    mb.Planar(**PLACED),
    mb.Universal(**PLACED),
    mb.Spherical(**PLACED),
    mb.Floating(**PLACED),
)


def solid(m: mb.Mechanism, name: str) -> Any:
    """Return a body without symmetry."""
    inertia = np.array(((2.0, 0.3, -0.2), (0.3, 1.5, 0.1), (-0.2, 0.1, 1.1)))
    return m.body(name, mass=1.3, com=(0.2, -0.1, 0.3), inertia=inertia)


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("joint", EVERY_JOINT, ids=lambda joint: type(joint).__name__)
def test_every_joint_has_frames_on_both_bodies_and_both_directions(joint: Joint, reverse: bool) -> None:
    m = mb.Mechanism(gravity=(0.3, -9.81, 2.0))
    far, near = solid(m, "far"), solid(m, "near")
    ends = (far, near) if reverse else (near, far)
    tested = m.joint("tested", *ends, joint, at_b=AT_B, rotation_b=TURNED_B)
    m.joint("first", m.ground, near, mb.Revolute(axis=(1, 1, 2)), at_b=(0.1, 0.2, -0.1))
    if joint.nv < 6:
        m.output("force", tested.force("y", on="a"))
        m.output("moment", tested.moment("z"))
        for axis in "xyz":
            m.output(f"on.far.{axis}", tested.force(axis, on="a" if reverse else "b"))
            m.output(f"reaction.{axis}", tested.force(axis, on="b" if reverse else "a"))
            m.output(f"far.{axis}", far.point_acceleration(axis, (0.2, -0.1, 0.3)))
    check_element(m, states=3)
    compiled = CompiledMechanism(m)
    assert (far.parent, far.reversed) == (near.index, reverse)
    q, random = compiled.assembly.start_positions(), np.random.default_rng(1)
    compiled.system.apply(q, random.normal(size=compiled.system.n))
    r, A = compiled.poses(0.0, q)
    if joint.nv < 6:
        out, v = np.zeros(len(compiled.outputs)), random.normal(size=(2, compiled.system.n))
        compiled.observe(0.0, q, *v, np.zeros(0), out)
        force, reaction, acceleration = out[2:].reshape(3, 3, order="F")
        np.testing.assert_allclose(force, 1.3 * (acceleration - np.array((0.3, -9.81, 2.0))), atol=1e-12)
        np.testing.assert_allclose(reaction, -force, atol=1e-12)
    (a, b), own = (end.index for end in ends), compiled.data.arrays.bodies[far.index]
    origin, axes = pose(joint, compiled.data.state.q[own["qi"] : own["qi"] + joint.nq])
    first = A[a] @ TURNED_A.as_matrix()
    np.testing.assert_allclose(A[b] @ TURNED_B.as_matrix(), first @ axes, atol=1e-14)
    np.testing.assert_allclose(r[b] + A[b] @ AT_B, r[a] + A[a] @ AT_A + first @ origin, atol=1e-14)


def test_a_drive_has_its_sign_in_both_directions() -> None:
    for ends, sign in (((0, 1), 1.0), ((1, 0), -1.0)):
        m = mb.Mechanism()
        bodies = (m.ground, m.body("arm", **mb.rod(mass=1.0, length=2.0)))
        joint = m.joint("motor", *(bodies[k] for k in ends), mb.Revolute(drive=mb.Polynomial((0.0, 0.0, 0.5))))
        m.output("torque", joint.effort())
        m.output("y", bodies[1].position("y", (1, 0, 0)))
        m.output("on.arm", joint.moment("z", on="b" if sign > 0 else "a"))
        result = mb.simulate(m, 1.0, interval=0.5, solver="adams")
        inertia = 1.0 * 2.0**2 / 3.0
        np.testing.assert_allclose(result["torque"], inertia, rtol=1e-9)
        np.testing.assert_allclose(result["on.arm"], sign * inertia, rtol=1e-9)
        np.testing.assert_allclose(result["y"][-1], sign * np.sin(0.5), rtol=1e-7)


def rssr(order: Sequence[int]) -> mb.Mechanism:
    """Spatial four-bar: crank about z, rocker about y, and a rod of 2.5 m with spherical joints."""
    m = mb.Mechanism(gravity=(0.0, 0.0, -G))
    crank, rocker = (m.body(name, **mb.rod(mass=1.0, length=x)) for name, x in (("crank", 0.5), ("rocker", 1.5)))
    rod = m.body("rod", mass=1.0, com=(1.25, 0.0, 0.0), inertia=(0.01, 0.5, 0.5))
    declared = (
        lambda: m.joint("crank", m.ground, crank, mb.Revolute(drive=mb.Polynomial((0.3, 2.0)))),
        lambda: m.joint("ball1", crank, rod, mb.Spherical(at=(0.5, 0, 0))),
        lambda: m.joint("ball2", rocker, rod, mb.Spherical(at=(1.5, 0, 0)), at_b=(2.5, 0, 0)),
        lambda: m.joint("rocker", rocker, m.ground, mb.Revolute(axis="y", start=-1.2), at_b=(2.0, 0.3, 0.0)),
    )
    joints = {k: declared[k]() for k in order}
    m.output("rocker.angle", joints[3].angle())
    return m


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (2, 3, 1, 0), (3, 1, 0, 2)])
def test_a_spatial_four_bar_has_the_angle_of_its_closed_form(order: tuple[int, ...]) -> None:
    m = rssr(order)
    result = mb.simulate(m, 2.0, interval=0.25, solver="adams", tolerance=1e-9)
    assert [handle.cut.rows for handle in m.cuts] == [("x", "y", "z")]  # a spherical joint: fewest equations
    for t, angle in zip(result.t, result["rocker.angle"], strict=True):
        pin = 0.5 * np.array((np.cos(0.3 + 2.0 * t), np.sin(0.3 + 2.0 * t), 0.0))
        end = np.array((2.0, 0.3, 0.0)) + Rotation.from_rotvec((0.0, -angle, 0.0)).apply((1.5, 0.0, 0.0))
        assert np.linalg.norm(end - pin) == pytest.approx(2.5, abs=1e-8)
    assert np.all(result["rocker.angle"] < -1.0)  # the branch of the start value


def columns(loops: int, order: Sequence[int]) -> mb.Mechanism:
    """Four-bars in a row with columns on the ground (benchmark A02 of the IFToMM library)."""
    m, calls = mb.Mechanism(gravity=(0.0, -G, 0.0)), []
    column = [m.body(f"column{i}", **mb.rod(mass=1.0, length=1.0)) for i in range(loops + 1)]
    beam = [m.body(f"beam{i}", **mb.rod(mass=1.0, length=1.0)) for i in range(loops)]
    for i in range(loops + 1):
        start: dict[str, Any] = {"start": 0.5 * np.pi, "rate": -1.0, "fixed": True} if i == 0 else {}
        calls.append((f"foot{i}", m.ground, column[i], mb.Revolute(at=(float(i), 0, 0), **start), None))
    for i in range(loops):
        calls.append((f"left{i}", column[i], beam[i], mb.Revolute(at=(1.0, 0, 0)), None))
        calls.append((f"right{i}", beam[i], column[i + 1], mb.Revolute(at=(1.0, 0, 0)), (1.0, 0, 0)))
    for k in order:
        name, a, b, joint, at_b = calls[k]
        m.joint(name, a, b, joint, at_b=at_b)
    return m


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_loops_of_a_row_are_as_short_as_possible(seed: int) -> None:
    loops = 12
    m = columns(loops, np.random.default_rng(seed).permutation(3 * loops + 1).tolist())
    compiled = CompiledMechanism(m)
    assert len(m.cuts) == loops
    depth = [0] * len(m.bodies)
    for body in m.bodies[1:]:
        depth[body.index] = depth[body.parent] + 1
    assert max(depth) == 2
    assert compiled.system.n == 2 * loops + 1


def ladder(loops: int) -> list[Edge]:
    """Rungs between two rails that both start at the ground."""
    rails = [0, 0]
    edges = []
    for i in range(loops):
        new = (1 + 2 * i, 2 + 2 * i)
        edges += [Edge(rails[k], new[k], Rank.FREE, 5) for k in range(2)]
        edges.append(Edge(*new, Rank.FREE, 5))
        rails = [*new]
    return edges


def loop_lengths(edges: Sequence[Edge], inside: Sequence[int]) -> list[int]:
    """Lengths of the loops that the other edges close, by a search of the tree."""
    near: dict[int, list[int]] = {}
    for e in inside:
        near.setdefault(edges[e].a, []).append(edges[e].b)
        near.setdefault(edges[e].b, []).append(edges[e].a)
    found = []
    for edge in (edge for e, edge in enumerate(edges) if e not in set(inside)):
        distance, waiting = {edge.a: 0}, [edge.a]
        for i in waiting:
            for j in near[i]:
                if j not in distance:
                    distance[j] = distance[i] + 1
                    waiting.append(j)
        found.append(distance[edge.b] + 1)
    return found


def test_the_tree_of_a_ladder_has_loops_of_four_joints() -> None:
    edges = ladder(30)
    tree = choose_tree(61, edges)
    assert sorted(loop_lengths(edges, tree.inside)) == [3, *[4] * 29]


@pytest.mark.parametrize("rank", [Rank.START, Rank.FREE])
def test_of_joints_alike_the_one_with_the_fewest_equations_is_cut(rank: Rank) -> None:
    rows = (5, 5, 3, 5)
    edges = [Edge(a, b, rank, n) for (a, b), n in zip(((0, 1), (1, 2), (2, 3), (0, 3)), rows, strict=True)]
    assert choose_tree(4, edges).closing == [2]
    free = [edge._replace(rank=Rank.FREE) if e == 1 else edge for e, edge in enumerate(edges)]
    assert choose_tree(4, free).closing == [1 if rank == Rank.START else 2]


def test_joints_whose_coordinates_are_used_stay_in_the_tree() -> None:
    edges = [edge._replace(rank=Rank.COORDINATE) if e % 3 == 2 else edge for e, edge in enumerate(ladder(10))]
    tree = choose_tree(21, edges)
    assert set(range(2, 30, 3)) <= set(tree.inside)
    assert len(tree.inside) == 20


def test_the_choice_does_not_depend_on_chance_and_is_best_for_small_graphs() -> None:
    random = np.random.default_rng(3)
    for _ in range(10):
        pairs = [(int(random.integers(0, i)), i) for i in range(1, 7)]
        pairs += [tuple(sorted(random.choice(7, 2, replace=False).tolist())) for _ in range(3)]
        edges = [Edge(a, b, Rank.FREE, 5) for a, b in pairs]
        tree = choose_tree(7, edges)
        assert tree == choose_tree(7, edges)
        assert len(tree.inside) == 6
        assert sum(loop_lengths(edges, tree.inside)) <= 1.35 * shortest(edges)


def shortest(edges: Sequence[Edge]) -> int:
    """Least total length of the loops of all spanning trees of seven bodies."""
    best = 10**6
    for inside in combinations(range(len(edges)), 6):
        parts = list(range(7))
        for e in inside:
            a, b = parts[edges[e].a], parts[edges[e].b]
            parts = [a if p == b else p for p in parts]
        if len(set(parts)) == 1:
            best = min(best, sum(loop_lengths(edges, inside)))
    return best


def test_start_values_of_joints_that_close_loops_are_reported() -> None:
    m = mb.Mechanism()
    bars = [m.body(n, **mb.rod(mass=1.0, length=1.0)) for n in "abc"]
    ends = [(m.ground, bars[0]), (bars[0], bars[1]), (bars[1], bars[2]), (m.ground, bars[2])]
    places = [((0, 0, 0), None), ((1, 0, 0), None), ((1, 0, 0), (1, 0, 0)), ((1, 0, 0), None)]
    for name, (a, b), (at, at_b), start in zip("ABCD", ends, places, (1.2, -1.2, 1.2, 1.2), strict=True):
        m.joint(name, a, b, mb.Revolute(at=at, start=start), at_b=at_b)
    compiled = CompiledMechanism(m)
    q, _ = compiled.assemble()
    texts = [str(note) for note in compiled.assembly.notes(0.0, q)]
    assert texts[0] == "joint 'C' closes a loop (cut joint); the other joints form the tree [chosen-tree]"
    assert texts[1].startswith("start values of joint 'C' are not used")


def test_a_joint_of_six_coordinates_that_closes_a_loop_is_reported_with_its_start() -> None:
    m = mb.Mechanism()
    ball = m.body("ball", **mb.sphere(mass=1.0, radius=0.1))
    m.joint("hinge", m.ground, ball, mb.Revolute(start=0.0))
    m.joint("free", m.ground, ball, mb.Floating(start=(1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0)))
    compiled = CompiledMechanism(m)
    q, _ = compiled.assemble()
    texts = [str(note) for note in compiled.assembly.notes(0.0, q)]
    assert texts[0].startswith("joint 'free' of six coordinates has no effect; the other joints form the tree")
    assert texts[1].startswith("start values of joint 'free' are not used")


def test_names_of_coordinates_and_constraints_are_those_of_the_joints() -> None:
    compiled = CompiledMechanism(four_bar("DCBA"))
    assert sorted(compiled.system.coordinate_names) == ["A", "C", "D"]
    assert {name.split(".")[0] for name in compiled.system.constraint_names} == {"B"}


def declare(change: Any) -> None:
    """Compile a mechanism of two connected bodies after a change."""
    m = mb.Mechanism()
    one, two = (m.body(name, **mb.rod(mass=1.0, length=1.0)) for name in ("one", "two"))
    m.joint("A", m.ground, one, mb.Revolute())
    m.joint("B", one, two, mb.Revolute(at=(1, 0, 0)))
    change(m, one, two)
    CompiledMechanism(m)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda m, a, b: m.joint("C", a, a, mb.Weld()), "joint 'C' connects body 'one' to itself"),
        (lambda m, a, b: m.joint("A", a, b, mb.Weld()), "joint is named 'A'; allowed"),
        (lambda m, a, b: m.cut("A", mb.SphericalCutJoint(), a, b), "cut is named 'A'; allowed"),
        (lambda m, a, b: m.joint("C", a, "two", mb.Weld()), "body b of joint 'C' is 'two', which is not a body"),
        (lambda m, a, b: m.joint("C", a, b, mb.SphericalCutJoint()), "joint 'C' is SphericalCutJoint"),
        (
            lambda m, a, b: m.joint("C", a, b, mb.Spherical(drive=1.0)),
            "joint 'C' has 3 coordinates and cannot be driven",
        ),
        (lambda m, a, b: m.joint("C", a, b, mb.Weld(), at_b=(1, 2)), "at_b of joint 'C' is"),
        (lambda m, a, b: m.joint("C", a, b, mb.Weld(), rotation_b=np.ones((3, 3))), "rotation_b of joint 'C' is"),
        (lambda m, a, b: m.body("three"), "body 'three' is not connected to the ground; allowed"),
        (
            lambda m, a, b: m.joint("C", m.body("three"), m.body("four"), mb.Weld()),
            "bodies 'three', 'four' are not connected to the ground",
        ),
        (lambda m, a, b: m.body("three", a), "body 'three' is given a parent and no joint"),
        (
            lambda m, a, b: m.body("C", a, mb.Weld()) and m.joint("C", a, b, mb.Weld()),
            "joint 'C' has the name of a body",
        ),
        (lambda m, a, b: m.output("x", a.angle()), "body 'one' is declared without a joint"),
        (lambda m, a, b: m.output("x", a.joint_force("x")), "body 'one' is declared without a joint"),
        (lambda m, a, b: m.force("F", mb.JointForce(1.0), a), "force 'F' needs a joint of one coordinate"),
        (
            lambda m, a, b: m.force("F", mb.PointForce(magnitude=1.0), m.joints[0]),
            "force 'F' acts on bodies, and is given",
        ),
        (lambda m, a, b: m.couple("G", mb.Gear(ratio=2.0), a, m.joints[1]), "body 'one' is declared without a joint"),
        (lambda m, a, b: m.joints[0].coordinate(1), "joint 'A' has no coordinate 1; it has 1"),
        (lambda m, a, b: m.joints[0].force("n"), "component of joint 'A' is 'n'"),
        (lambda m, a, b: m.joint("C", a, b, mb.Floating()).force("x"), "joint 'C' does not constrain its bodies"),
        (lambda m, a, b: m.output("x", mb.Mechanism().ground.position("x")), "is not a body of this mechanism"),
    ],
)
def test_what_cannot_be_is_refused_with_what_to_do(change: Any, text: str) -> None:
    with pytest.raises(mb.UserError, match=text.replace("(", r"\(")):
        declare(change)


def test_a_parent_that_is_connected_to_its_child_is_refused() -> None:
    m = mb.Mechanism()
    one = m.body("one", **mb.rod(mass=1.0, length=1.0))
    two = m.body("two", one, mb.Revolute(), **mb.rod(mass=1.0, length=1.0))
    m.joint("A", m.ground, two, mb.Revolute())
    with pytest.raises(mb.UserError, match="body 'two' is declared with body 'one' as its parent"):
        CompiledMechanism(m)


def test_a_loop_of_driven_massless_bodies_cannot_be_opened() -> None:
    m = mb.Mechanism()
    one = m.body("one")
    m.joint("A", m.ground, one, mb.Revolute(drive=mb.Polynomial((0.0, 1.0))))
    m.joint("B", m.ground, one, mb.Revolute(drive=mb.Polynomial((0.0, 1.0))))
    with pytest.raises(mb.UserError, match="joint 'B' and all other joints of its loop have coordinates that are used"):
        CompiledMechanism(m)


def test_a_gear_couples_joints() -> None:
    m = mb.Mechanism()
    wheels = [m.body(name, mass=1.0, inertia=(J, J, J)) for name, J in (("one", 1.0), ("two", 2.0))]
    one = m.joint("one", m.ground, wheels[0], mb.Revolute())
    two = m.joint("two", wheels[1], m.ground, mb.Revolute())
    gear = m.couple("gear", mb.Gear(ratio=-2.0), one, two)
    m.force("motor", mb.JointForce(3.0), one)
    m.output("angle", two.angle())
    m.output("effort", gear.effort())
    result = mb.simulate(m, 1.0, interval=0.5, solver="adams")
    acceleration = 3.0 / (1.0 + 2.0 / 4.0)  # of wheel one; wheel two has half of it
    np.testing.assert_allclose(result["angle"][-1], -0.25 * acceleration, rtol=1e-6)
    np.testing.assert_allclose(result["effort"], acceleration - 3.0, rtol=1e-6)


def test_orders_of_few_joints_give_the_same_number_of_coordinates() -> None:
    assert {CompiledMechanism(four_bar(order, outputs="")).system.n for order in permutations("ABCD")} == {3}
