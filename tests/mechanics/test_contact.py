"""Contact of a sheet: identities of the patch, the surfaces and the laws, and closed forms of what comes out."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism, Floating, Mechanism, PointForce, Polynomial, Revolute, Translational
from mbfmu.mechanics.arrays import systems
from mbfmu.mechanics.dispatch import apply_load, load_tangent
from mbfmu.mechanics.kind import record_of
from mbfmu.mechanics.records import to_complex_state
from mbfmu.mechanics.recursions.active_loads import longest_load_step
from mbfmu.mechanics.recursions.dynamics import update_kinematics
from mbfmu.mechanics.steps import COMPLEX_STEP_SIZE, step
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.sheets import Drum, Guide, Surface, Trough, Wall, add_contact, add_nip, add_sheet, contact_pressure
from mbfmu.sheets.contact import patch
from mbfmu.sheets.contact.scratch import CONTACT_SCRATCH
from mbfmu.sheets.contact.stations import clamped_beam_compliance
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import kernel, records
from solvers.compiled.tuple_pointer import pin, unpin

from . import test_power
from .random_mechanisms import Case, random_rotation
from .test_power import check
from .test_tangent import inverse

PAPER: dict[str, Any] = {
    "length": 0.297, "width": 0.21, "thickness": 1e-4, "youngs_modulus": 4e9, "density": 800.0,
    "tree": "master", "membrane": True, "damping": 5e-4,
}  # fmt: skip
SURFACES: dict[str, Surface] = {
    "wall": Wall(at=(0.1, 0.0, 0.2), normal=(0.1, 1.0, -0.2)),
    "drum": Drum(radius=0.2, length=0.5, at=(0.15, -0.2, 0.1), axis=(0.1, 0.0, 1.0)),
    "trough": Trough(radius=0.4, length=0.5, angle=2.5, towards=(0.0, -1.0, 0.0), at=(0.15, 0.4, 0.1)),
    "guide": Guide(start=(0.05, -0.01, 0.1), end=(0.2, -0.01, 0.1), radius=0.01, width=0.5),
}


def nodes(rng: Any) -> list[Any]:
    """Four bodies in random attitudes near the corners of a cell, moving."""
    corners = np.array([[0.0, 0.0, 0.0], [0.03, 0.0, 0.0], [0.03, 0.0, 0.02], [0.0, 0.0, 0.02]])
    return [
        SimpleNamespace(
            r=corner + 0.005 * rng.normal(size=3), A=random_rotation(rng), Y=rng.normal(size=6), F=np.zeros(6)
        )
        for corner in corners
    ]


@kernel
def distance(gap: Any, surface: Any, state: Any) -> float:
    return gap(surface, state)


CELL = SimpleNamespace(node=(0, 1, 2, 3), a=0.03, b=0.02)
PLAIN = {name: getattr(getattr(patch, name), "py_func", getattr(patch, name)) for name in patch.__dict__}


def at(bodies: list[Any], xi: float, zeta: float, way: int | None) -> tuple[Any, Any, Any, Any]:
    """Weights, point, velocity of a point of the patch, and derivatives of the weights of the straight one."""
    c, cx, cz, r, v = np.zeros((4, 3)), np.zeros((4, 3)), np.zeros((4, 3)), np.zeros(3), np.zeros(3)
    if way is None:
        PLAIN["evaluate_weights"](CELL, xi, zeta, c)
    else:
        PLAIN["evaluate_ruled_weights"](CELL, way, xi, zeta, c, cx, cz)
    PLAIN["interpolate_point"](CELL, c, bodies, r)
    PLAIN["point_velocity"](CELL, c, bodies, v)
    return c, r, v, (cx, cz)


@pytest.mark.parametrize("way", [None, 0, 1])
def test_a_force_on_the_patch_is_the_same_on_its_nodes(way: int | None) -> None:
    rng = np.random.default_rng(1)
    for _ in range(5):
        bodies, f = nodes(rng), rng.normal(size=3)
        c, r, v, _ = at(bodies, rng.uniform(), rng.uniform(), way)
        PLAIN["apply_to_nodes"](CELL, c, bodies, f)
        total = sum(b.F[:3] for b in bodies)
        moment = sum(np.cross(b.r, b.F[:3]) + b.F[3:] for b in bodies)
        np.testing.assert_allclose(total, f, atol=1e-14)
        np.testing.assert_allclose(moment, np.cross(r, f), atol=1e-15)
        assert sum(b.F @ b.Y for b in bodies) == pytest.approx(f @ v, rel=1e-12)


@pytest.mark.parametrize("way", [None, 0, 1])
def test_the_patch_moves_like_a_rigid_body_and_is_smooth_over_a_border(way: int | None) -> None:
    rng = np.random.default_rng(2)
    bodies = nodes(rng)
    Q, w, shift = random_rotation(rng), rng.normal(size=3), rng.normal(size=3)
    _, r, _, _ = at(bodies, 0.3, 0.6, way)
    for b in bodies:
        b.r, b.A = Q @ b.r + shift, Q @ b.A
        b.Y = np.concatenate((np.cross(w, b.r), w))
    _, moved, v, _ = at(bodies, 0.3, 0.6, way)
    np.testing.assert_allclose(moved, Q @ r + shift, atol=1e-14)
    np.testing.assert_allclose(v, np.cross(w, moved), atol=1e-13)
    # the cell beyond the border along x has the second and third node as its first and last
    other = nodes(rng)
    other[0], other[3] = bodies[1], bodies[2]
    h, here, there = 1e-5, at(bodies, 1.0, 0.6, way)[1], at(other, 0.0, 0.6, way)[1]
    np.testing.assert_allclose(here, there, atol=1e-15)
    one, two = (at(bodies, 1.0 - k * h, 0.6, way)[1] for k in (1, 2))
    three, four = (at(other, k * h, 0.6, way)[1] for k in (1, 2))
    slope = (3.0 * here - 4.0 * one + two) / (2.0 * h), (4.0 * three - four - 3.0 * there) / (2.0 * h)
    if way != 1:  # straight across x, it has a corner there
        np.testing.assert_allclose(*slope, atol=1e-8)


def test_points_on_lines_are_those_of_the_patch_and_none_dips_deeper_than_its_bound() -> None:
    """Nodes turned anyhow, and against a normal anyhow: further than cells of a sheet ever are."""
    rng = np.random.default_rng(4)
    for _ in range(50):
        bodies, n, middle = nodes(rng), rng.normal(size=3), np.zeros(3)
        n /= np.linalg.norm(n)
        PLAIN["evaluate_center"](CELL, bodies, middle)
        deepest = PLAIN["sagitta"](CELL, bodies, middle, n)
        for xi in np.linspace(0.0, 1.0, 11):
            line, r = np.zeros((4, 3)), np.zeros(3)
            PLAIN["evaluate_line"](CELL, xi, bodies, line)
            for zeta in np.linspace(0.0, 1.0, 11):
                PLAIN["evaluate_on_line"](line, zeta, r)
                np.testing.assert_allclose(r, at(bodies, xi, zeta, None)[1], atol=1e-16)
                assert n @ (middle - r) <= deepest + 1e-15
    for b, corner in zip(bodies, ((0.0, 0.0), (CELL.a, 0.0), (CELL.a, CELL.b), (0.0, CELL.b)), strict=True):
        b.r, b.A = np.array([corner[0], 0.0, corner[1]]), np.eye(3)
    PLAIN["evaluate_center"](CELL, bodies, middle)
    assert PLAIN["sagitta"](CELL, bodies, middle, np.array([0.0, 1.0, 0.0])) == 0.0  # a flat cell does not dip at all


def test_derivatives_of_the_straight_patch() -> None:
    bodies, h = nodes(np.random.default_rng(3)), 1e-6
    for way in (0, 1):
        cx, cz = at(bodies, 0.3, 0.6, way)[3]
        for c, dx, dz in ((cx, h, 0.0), (cz, 0.0, h)):
            found = (at(bodies, 0.3 + dx, 0.6 + dz, way)[0] - at(bodies, 0.3 - dx, 0.6 - dz, way)[0]) / (2.0 * h)
            np.testing.assert_allclose(c, found, atol=1e-9)


def test_a_clamped_beam_gives_way_according_to_its_equation() -> None:
    """w'''' = 0 but for a jump of one in w''' at the force, w and w' zero at both ends; the slope by differences."""
    plain = getattr(clamped_beam_compliance, "py_func", clamped_beam_compliance)
    x, h = np.linspace(0.0, 1.0, 2001), 1e-6
    for u in (0.2, 0.5, 0.83):
        w = np.array([plain(s, u)[0] for s in x])
        slopes = [plain(s, u)[1] for s in (0.1, u, 0.9)]
        np.testing.assert_allclose([w[0], w[-1], plain(0.0, u)[1], plain(1.0, u)[1]], 0.0, atol=1e-15)
        for s, slope in zip((0.1, u, 0.9), slopes, strict=True):
            assert slope == pytest.approx((plain(s + h, u)[0] - plain(s - h, u)[0]) / (2.0 * h), abs=1e-8)
        third = [np.polyfit(x[part], w[part], 3)[0] * 6.0 for part in (x < u - 0.01, x > u + 0.01)]
        assert third[1] - third[0] == pytest.approx(1.0, rel=1e-6)
        assert plain(0.3, u)[0] == pytest.approx(plain(u, 0.3)[0], rel=1e-12)


def flag(
    surface: Surface | None = None, *, moving: bool = False, nip: bool = False, idle: bool = False,
    carried: bool = False, grid: Any = (4, 3), deflection: float | None = None,
) -> Mechanism:  # fmt: skip
    """A sheet in contact, with all outputs."""
    m = Mechanism(gravity=(0.3, -9.81, 0.2))
    paper = PAPER | {"length": 0.3, "width": 0.2, "youngs_modulus": 4e7, "thickness": 1e-3}
    sheet = add_sheet(m, "paper", grid=grid, rate=(0.1, 0.0, 0.0, 0.0, 0.0, 0.0), **paper)
    if surface is not None:
        body = m.body("carrier", m.ground, Floating(), mass=0.3, inertia=(0.1, 0.2, 0.15)) if moving else None
        law = {"stiffness": 1e5, "depth": 2e-3, "friction": 0.3, "creep": 0.05, "damping": 0.4}
        contact = add_contact(m, "contact", sheet, surface, body=body, points=(2, 3), deflection=deflection, **law)
        m.output("force.y", contact.force("y"))
        m.output("depth", contact.depth())
    if nip:
        turning: dict[str, Any] = {"rate": -2.0} if idle else {"drive": Polynomial((0.0, -2.0))}
        inertia: dict[str, Any] = {"mass": 0.1, "inertia": (1e-4,) * 3}
        carrier = m.body("carriage", m.ground, Translational(axis=(1.0, 1.0, 0.0)), **inertia) if carried else m.ground
        roller = m.body("roller", carrier, Revolute(at=(0.12, -0.05, 0.1), **turning), **inertia)
        axle = Revolute(at=(0.12, 0.03, 0.1), rate=1.0)
        idler = m.body("idler", m.ground, axle, mass=0.1, inertia=(1e-4,) * 3) if idle else None
        held = add_nip(
            m, "nip", sheet, roller, radius=0.05, at=(0.12, 0.0, 0.1), width=0.05, force=3.0, stiffness=300.0,
            damping=0.2, least=0.05, contact=0.02, idler=idler, idler_radius=0.03 if idle else None,
            deflection=deflection,
        )  # fmt: skip
        m.output("slip", held.slip())
        m.output("loaded", held.loaded())
    m.output("energy", m.energy)
    return m


def somewhere(compiled: CompiledMechanism, rng: Any) -> Case:
    """A state not far from flat, in motion."""
    q, n = compiled.assembly.start_positions(), compiled.system.n
    compiled.system.apply(q, 0.004 * rng.normal(size=n))
    return Case(compiled, 0.3, q, 0.05 * rng.normal(size=n), rng.normal(size=n))


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("name", SURFACES)
def test_power_of_a_touch_is_the_rate_of_its_energy(name: str, moving: bool, monkeypatch: Any) -> None:
    monkeypatch.setattr(systems, "MAX_DENSE_TREE_COORDINATES", 10**6)
    monkeypatch.setattr(test_power, "TOLERANCE", 1e-5)  # points that come into touch within the stencil of differences
    compiled, rng, touched = CompiledMechanism(flag(SURFACES[name], moving=moving)), np.random.default_rng(4), 0
    for _ in range(4):
        case = somewhere(compiled, rng)
        out = np.zeros(len(compiled.outputs))
        compiled.observe(case.t, case.q, case.v, case.a, np.zeros(0), out)
        touched += out[1] > 0.0
        check(case, np.zeros(0))
    assert touched > 1


@pytest.mark.parametrize("idle", [False, True])
def test_power_of_a_nip_is_the_rate_of_its_energy_while_its_stations_are_held(idle: bool, monkeypatch: Any) -> None:
    """But for what the share of a station does that comes in: there is none in the middle of the sheet."""
    monkeypatch.setattr(systems, "MAX_DENSE_TREE_COORDINATES", 10**6)
    monkeypatch.setattr(test_power, "TOLERANCE", 1e-8)  # the differences of a sheet so bent, without a nip too
    compiled, rng = CompiledMechanism(flag(nip=True, idle=idle)), np.random.default_rng(5)
    for _ in range(4):
        case = somewhere(compiled, rng)
        out = np.zeros(len(compiled.outputs))
        compiled.observe(case.t, case.q, case.v, case.a, np.zeros(0), out)
        assert out[1] == pytest.approx(1.0)
        check(case, np.zeros(0))


@pytest.mark.parametrize("name", [*SURFACES, "nip", "idler", "carried"])
def test_the_structured_tangent_of_contact(name: str, monkeypatch: Any) -> None:
    """With a roller and an idler that turn freely too, which no group has."""
    monkeypatch.setattr(systems, "MAX_DENSE_TREE_COORDINATES", 0)
    nip, idle = name not in SURFACES, name in ("idler", "carried")
    compiled = CompiledMechanism(flag(nip=True, idle=idle, carried=name == "carried") if nip else flag(SURFACES[name]))
    case, n, h = somewhere(compiled, np.random.default_rng(6)), compiled.system.n, 1e-7
    T = np.zeros((n, n))
    for k, e in enumerate(h * np.eye(n)):
        there, back = case.q.copy(), case.q.copy()
        compiled.system.apply(there, e)
        compiled.system.apply(back, -e)
        T[:, k] = (inverse(compiled, there, 900.0 * e) - inverse(compiled, back, -900.0 * e)) / (2.0 * h)
    inverse(compiled, case.q, np.zeros(n))
    tangent = compiled.tangent()
    assert tangent.layout.columns.sum() == {"idler": 2, "carried": 7}.get(name, 0)
    assert tangent.factor(0.0, 900.0)
    x = tangent.solve(case.a)
    np.testing.assert_allclose(T @ x, case.a, atol=1e-5 * np.abs(T).max() * np.abs(x).max())


@pytest.mark.parametrize("deflection", [None, 5e-3])
@pytest.mark.parametrize("name", [*SURFACES, "nip", "idler"])
def test_tangents_of_touch_and_nip_are_complex_steps_of_what_they_apply(
    name: str, deflection: float | None, monkeypatch: Any
) -> None:
    """On a body that moves too, and by velocities; with bristles that were anchored at another state, too."""
    monkeypatch.setattr(systems, "MAX_DENSE_TREE_COORDINATES", 10**6)
    nip, given = name in ("nip", "idler"), {"deflection": deflection}
    compiled = CompiledMechanism(
        flag(nip=True, idle=name == "idler", **given) if nip else flag(SURFACES[name], moving=True, **given)
    )
    rng = np.random.default_rng(8)
    case, c1, found = somewhere(compiled, rng), 3.0, 0
    _, state = compiled.kernel_data
    if deflection:
        update_kinematics(0.0, case.q, case.v, *compiled.kernel_data)
        longest_load_step(0.1, *compiled.kernel_data)
        case = somewhere(compiled, rng)
    update_kinematics(0.0, case.q, case.v, *compiled.kernel_data)
    compiled.data.state.time[0] = 1.0
    arrays, twin = pin(compiled.tangent_arrays()), pin(to_complex_state(compiled.data.state))
    system = compiled.complex_system()
    others, there = unpin(system.pinned_data)
    for e, acting in enumerate(compiled.mechanism.loads()):
        bodies = [body.index for body in acting.bodies]
        if len(bodies) < 5:
            continue
        count = 6 * len(bodies)
        K, expected = np.zeros((count, count)), np.zeros((count, count))
        load_tangent(compiled.data.arrays.loads[e], c1, arrays, state, twin, K)
        for j in range(count):
            for p, i in enumerate(bodies):
                step(compiled.data.state.bodies[i], system.data.state.bodies[i], j - 6 * p, c1)
            apply_load(system.data.arrays.loads[e], 1.0, others, there)
            expected[:, j] = -np.concatenate(
                [system.data.state.bodies["F"][i].imag / COMPLEX_STEP_SIZE for i in bodies]
            )
        found += np.any(expected != 0.0)
        np.testing.assert_allclose(K, expected, atol=1e-12 * np.abs(expected).max())
    assert found > 0


@pytest.mark.parametrize("name", SURFACES)
def test_distance_and_normal_of_a_surface(name: str) -> None:
    """The normal is the gradient of the distance; as far along it the surface is met."""
    surface, rng = SURFACES[name], np.random.default_rng(7)
    record, contact = records(1, record_of(surface)), records(1, CONTACT_SCRATCH)
    surface.fill(record[0], None)  # type: ignore[arg-type]

    def met(p: Any) -> tuple[float, Any]:
        contact["p"][0] = p
        return float(distance(type(surface).gap, record[0], contact[0])), contact["n"][0].copy()

    middle = np.array((0.12, 0.0, 0.1))
    for _ in range(20):
        p = middle + 0.03 * rng.normal(size=3)
        g, n = met(p)
        assert np.linalg.norm(n) == pytest.approx(1.0)
        slope = [(met(p + h)[0] - met(p - h)[0]) / 2e-6 for h in 1e-6 * np.eye(3)]
        np.testing.assert_allclose(slope, n, atol=1e-6)
        assert met(p - g * n)[0] == pytest.approx(0.0, abs=1e-12)


def test_a_thrown_sheet_slides_as_far_as_friction_allows() -> None:
    """v^2 / (2 mu g), but for what creep smears; A4 paper, thrown at 0.5 m/s on a table."""
    m, k, d0 = Mechanism(gravity=(0.0, -9.81, 0.0)), 2e6, 2e-5
    sunk = np.sqrt(2.0 * d0 * 800.0 * 9.81 * 1e-4 / k)
    sheet = add_sheet(m, "s", at=(0.0, -sunk, 0.0), grid=(5, 4), rate=(0.5, 0.0, 0.0, 0.0, 0.0, 0.0), **PAPER)
    contact = add_contact(m, "table", sheet, Wall(at=(0.0, -5e-5, 0.0)), stiffness=k, depth=d0, friction=0.3)
    m.output("x", sheet.node(0, 0).position("x"))
    m.output("pressing", contact.force("y"))
    m.output("heat", contact.heat())
    m.output("energy", m.energy)
    found = mb.simulate(m, stop_time=0.25, interval=0.001, solver="esdirk", tolerance=1e-5)
    assert found["x"][-1] - found["x"][0] == pytest.approx(0.5**2 / (2.0 * 0.3 * 9.81), rel=2e-3)
    assert found["pressing"].mean() == pytest.approx(0.297 * 0.21 * 1e-4 * 800.0 * 9.81, rel=2e-2)  # it rocks a little
    lost = found["energy"][0] - found["energy"][-1]
    assert np.trapezoid(found["heat"], found.t) == pytest.approx(lost, rel=2e-3)


def test_pressure_is_the_force_on_a_cell_over_its_area() -> None:
    """Of a flat sheet: that of the law in every cell, larger where it slides; points on a border are of both cells."""
    m, k, d0, d, mu = Mechanism(), 2e6, 2e-5, 3e-5, 0.3
    sheet = add_sheet(m, "s", at=(0.0, -d, 0.0), grid=(4, 3), rate=(0.5, 0.0, 0.0, 0.0, 0.0, 0.0), **PAPER)
    wall = Wall(at=(0.0, -5e-5, 0.0))
    contact = add_contact(m, "table", sheet, wall, stiffness=k, depth=d0, friction=mu, points=(4, 2))
    for i, j in np.ndindex(3, 2):
        m.output(f"pressure[{i},{j}]", contact.pressure(i, j))
    m.output("pressing", contact.force("y"))
    found = mb.simulate(m, stop_time=1e-4, interval=1e-4, solver="radau", tolerance=1e-4)
    told = np.array([[found[f"pressure[{i},{j}]"][0] for j in range(2)] for i in range(3)])
    slid = np.sqrt(1.0 + mu**2 * 0.5**2 / (0.5**2 + 1e-3**2))
    np.testing.assert_allclose(told, k * (d - 0.5 * d0) * slid, rtol=1e-9)
    assert told.mean() * 0.297 * 0.21 == pytest.approx(slid * found["pressing"][0], rel=1e-12)
    with pytest.raises(UserError, match=r"sheet 's' has no cell \(3, 0\); allowed: \(2, 1\) at most"):
        contact.pressure(3, 0)


def test_pressure_of_touches_on_both_sides_adds_up() -> None:
    """A cell that two walls pinch, and turned ones next to it; without friction all of it is their forces."""
    m = Mechanism()
    sheet = add_sheet(m, "s", at=(0.0, 0.0, 0.0), grid=(4, 3), **PAPER)
    m.force("weight", PointForce(magnitude=1.0, axis="y"), sheet.node(0, 0))  # loads of other kinds come before
    kind = {"stiffness": 2e6, "depth": 2e-5}
    walls = {
        "below": Wall(at=(0.0, -4e-5, 0.0)),
        "above": Wall(at=(0.0, 2e-5, 0.0), normal=(0.0, -1.0, 0.0)),
        "edge": Wall(at=(0.297, 0.0, 0.0), normal=(-1.0, 1.0, 0.0)),
        "far": Wall(at=(0.0, -1.0, 0.0)),
    }
    contacts = [add_contact(m, name, sheet, wall, **kind) for name, wall in walls.items()]  # type: ignore[arg-type]
    for contact in contacts:
        for axis in "xyz":
            m.output(f"{contact.name}.{axis}", contact.force(axis))
    for i, k in sheet.cells:
        m.output(f"pressure[{i},{k}]", contact_pressure(contacts, i, k))
    found = Simulation(m, Settings(solver="radau"))
    told = dict(zip((variable.name for variable in found.variables), found.outputs(), strict=True))
    forces = {name: np.linalg.norm([told[f"{name}.{axis}"] for axis in "xyz"]) for name in walls}
    assert min(forces[name] for name in ("below", "above", "edge")) > 0.0
    assert forces["far"] == 0.0
    total = sum(told[f"pressure[{i},{k}]"] for i, k in sheet.cells) * sheet.a * sheet.b
    assert total == pytest.approx(sum(forces.values()), rel=1e-12)
    assert told["pressure[2,0]"] > told["pressure[1,0]"] > 0.0  # the wall at the edge meets the last row alone


def test_pressure_is_of_touches_of_one_sheet() -> None:
    m = Mechanism()
    contacts = [
        add_contact(m, f"{name}.table", add_sheet(m, name, grid=(4, 3), **PAPER), Wall(at=(0.0, -5e-5, 0.0)))
        for name in ("s", "t")
    ]
    with pytest.raises(UserError, match=r"contacts that press are \[\]; allowed: a list of what add_contact returns"):
        contact_pressure([], 0, 0)
    with pytest.raises(
        UserError, match=r"contact 't.table' is one of sheet 't'; allowed together with 's.table': contacts of 's'"
    ):
        contact_pressure(contacts, 0, 0)
