"""Joint friction in proportion to the reaction of the joint, against closed forms; accelerations of random mechanisms
are compared in tests/mechanics/test_reaction_friction.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism
from mbfmu.util.errors import EquilibriumError, UserError

G = 9.81
MU, LENGTH = 0.3, 0.4  # coefficient of friction and m of the guide


def run(m: mb.Mechanism, end: float, solver: str = "radau", tolerance: float = 1e-6) -> mb.Simulation:
    """Simulate until a time, s."""
    simulation = mb.Simulation(m, mb.Settings(solver=solver, tolerance=tolerance))
    simulation.advance(end)
    return simulation


def acceleration(m: mb.Mechanism, z: Any) -> Any:
    """Accelerations of the coordinates at rest in the start positions, with the bristles at z."""
    compiled = CompiledMechanism(m)
    system, terms = compiled.system, compiled.system.allocate_terms()
    v = np.concatenate((np.zeros(system.n_velocities), np.atleast_1d(z)))
    system.fill(0.0, compiled.assembly.start_positions(), v, terms)
    K = np.block([[terms.M, terms.J.T], [terms.J, np.zeros((system.m, system.m))]])
    return np.linalg.solve(K, np.concatenate((-terms.h, terms.gamma)))[: system.n_velocities]


def drawer(offset: float, size: float = 1.0, center: float = 0.0, rate: float = 0.0, torque: float = 0.0) -> Any:
    """A drawer of 2 kg, pulled by 10 N at an offset from its guide; lengths and forces in ``size``."""
    m = mb.Mechanism(gravity=(0.0, 0.0, 0.0))
    joint = mb.Translational(axis="x", nominal=size, rate=rate * size)
    inertia = (size**2,) * 3
    body = m.body("drawer", m.ground, joint, mass=2.0, com=(0.0, center * size, 0.0), inertia=inertia)
    bearings = mb.Reaction(length=LENGTH * size)
    friction = m.force("friction", mb.JointFriction(coulomb=MU, normal_force=bearings), body)
    if offset:
        m.force("pull", mb.PointForce(magnitude=10.0 * size, axis="x", at_a=(0.0, offset * size, 0.0)), body)
    if torque:
        m.force("torque", mb.Torque(magnitude=torque * size**2, axis="z"), body)
    m.output("friction", friction.effort())
    return m


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("solver", ["radau", "ida"])
def test_drawer_jams_if_it_is_pulled_too_far_from_its_guide(solver: str, size: float) -> None:
    """The normal forces on the guide are 2 F c / l: it jams if the offset c is larger than l / (2 mu)."""
    limit = LENGTH / (2.0 * MU)
    jammed = run(drawer(1.1 * limit, size), 1.0, solver)
    place = float(jammed.stepper.q[0])
    assert abs(place) < 3e-5 * size  # deflections of the bristle
    jammed.advance(3600.0)
    assert jammed.stepper.q[0] == pytest.approx(place, abs=1e-9 * size)
    assert not jammed.inaccurate
    sliding = run(drawer(0.5 * limit, size), 1.0, solver)
    released = np.sqrt(5.0 * 1e-5 / 2.0)  # speed, by the energy that bends the bristle
    assert sliding.stepper.q[0] / size == pytest.approx(0.5 * 5.0 / 2.0, abs=released)
    assert sliding.outputs()[0] == pytest.approx(-5.0 * size, rel=1e-6)
    assert not sliding.inaccurate


@pytest.mark.parametrize("solver", ["radau", "ida"])
@pytest.mark.parametrize("kappa", [-1.5, -0.5, 0.5, 0.9])
def test_drawer_with_its_mass_off_the_guide_stops(solver: str, kappa: float) -> None:
    """a = -mu 2 |M - m a c| / l with a constant torque M: the reaction of the inertia m a c reduces or increases the
    friction by kappa = 2 mu m c / l.
    """
    center = kappa * LENGTH / (2.0 * MU)
    stopped = run(drawer(0.0, center=center, rate=2.0, torque=-4.0), 3.0, solver)
    deceleration = MU * 2.0 / LENGTH * 4.0 / 2.0 / (1.0 - kappa)
    assert stopped.stepper.q[0] == pytest.approx(2.0**2 / (2.0 * deceleration), abs=6e-5)
    assert stopped.stepper.energy_account[0] == pytest.approx(-0.5 * 2.0 * 2.0**2, abs=1e-4)  # the work: heat
    assert not stopped.inaccurate


@pytest.mark.parametrize("solver", ["radau", "ida"])
def test_drawer_whose_friction_has_no_solution_stops_with_a_message(solver: str) -> None:
    center = 1.5 * LENGTH / (2.0 * MU)
    jammed = run(drawer(0.0, center=center, rate=2.0, torque=-4.0), 3.0, solver)
    assert [found.code for found in jammed.diagnostics if found.severity == "error"] == ["jammed-joint"]
    assert "force 'friction' jams at t = " in jammed.failure
    assert jammed.stepper.q[0] < 1e-4


def block(slope: float, size: float = 1.0) -> mb.Mechanism:
    """A block on an incline of this slope, rad."""
    m = mb.Mechanism(gravity=(G * size * np.sin(slope), 0.0, -G * size * np.cos(slope)))
    body = m.body("block", m.ground, mb.Translational(axis="x", nominal=size), mass=2.0)
    m.force("friction", mb.JointFriction(coulomb=MU, normal_force=mb.Reaction()), body)
    return m


def test_block_on_an_incline_slides_if_the_slope_exceeds_the_angle_of_friction() -> None:
    angle = np.arctan(MU)
    assert abs(run(block(0.95 * angle), 100.0).stepper.q[0]) < 3e-5
    expected = 0.5 * G * (np.sin(1.5 * angle) - MU * np.cos(1.5 * angle))
    assert run(block(1.5 * angle), 1.0).stepper.q[0] == pytest.approx(expected, abs=np.sqrt(MU * G * 1e-5))
    assert acceleration(block(angle), 1.0) == pytest.approx([0.0], abs=1e-14 * G)


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize(
    ("joint", "radii", "normal"),
    [
        ("Spherical", {"radius": 0.05}, 2.0 * G + 1.0),
        ("Universal", {"radius": 0.01, "thrust_radius": 0.05}, 2.0 * G + 0.2),
    ],
)
def test_top_that_hangs_from_a_joint_is_braked_by_its_weight(
    joint: str, radii: Any, normal: float, size: float
) -> None:
    """I w' = -mu r N about the vertical, by the force on a ball or by the thrust on the pin of a cross."""
    m = mb.Mechanism(gravity=(0.0, 0.0, -G * size))
    given = {"rate": (0.0, 0.0, 2.0)} if joint == "Spherical" else {"axis": "z", "second": "x", "rate": (2.0, 0.0)}
    shape: Any = {"mass": 2.0, "com": (0.0, 0.0, -0.3 * size), "inertia": (0.2 * size**2, 0.2 * size**2, 0.1 * size**2)}
    top = m.body("top", m.ground, getattr(mb, joint)(**given), **shape)
    bearings = mb.Reaction(preload=size, **{name: size * value for name, value in radii.items()})
    law = mb.SphericalFriction if joint == "Spherical" else mb.JointFriction
    m.force("friction", law(coulomb=0.2, normal_force=bearings), top)
    m.output("rate", top.angular_velocity("z"))
    braked = run(m, 0.5)
    deceleration = 0.2 * 0.05 * normal / 0.1
    assert braked.outputs()[0] == pytest.approx(2.0 - 0.5 * deceleration, abs=2.0 * 1e-5 / 2.0 * deceleration)
    assert run(m, 3.0).outputs()[0] == pytest.approx(0.0, abs=1e-9)
    assert not braked.inaccurate


@pytest.mark.parametrize("up", [True, False])
def test_wedge_lifts_and_releases_a_block_at_the_forces_of_statics(up: bool) -> None:
    """The wedge transmits its force at the angle of friction to the normal of its face, and rubs on the floor."""
    slope, angle, block_weight, weight = 0.3, np.arctan(MU), 5.0 * G, 2.0 * G
    sign = 1.0 if up else -1.0
    push = block_weight * np.tan(slope + sign * angle) + sign * MU * (block_weight + weight)
    m = mb.Mechanism(gravity=(0.0, 0.0, -G))
    wedge = m.body("wedge", m.ground, mb.Translational(axis="x", nominal=1.0), mass=2.0)
    along = (np.cos(slope), 0.0, np.sin(slope))
    load = m.body("block", wedge, mb.Translational(axis=along, nominal=1.0), mass=5.0)
    m.cut("wall", mb.PlaneCutJoint(axis="x"), m.ground, load)
    m.force("floor", mb.JointFriction(coulomb=MU, normal_force=mb.Reaction()), wedge)
    m.force("face", mb.JointFriction(coulomb=MU, normal_force=mb.Reaction()), load)
    m.force("push", mb.PointForce(magnitude=-push, axis="x"), wedge)
    assert acceleration(m, [-sign, sign]) == pytest.approx([0.0, 0.0], abs=1e-12)
    assert np.abs(acceleration(m, [0.0, 0.0])).min() > 1.0


def wheel(reaction: mb.Reaction, center: tuple[float, float, float], gravity: Any, rate: float = 0.0) -> mb.Mechanism:
    """A wheel of 3 kg about the z axis, with 0.1 kg m^2 about its center of mass."""
    m = mb.Mechanism(gravity=gravity)
    body = m.body("wheel", m.ground, mb.Revolute(rate=rate), mass=3.0, com=center, inertia=(0.1, 0.1, 0.1))
    m.force("friction", mb.JointFriction(coulomb=MU, normal_force=reaction), body)
    m.output("angle", body.angle())
    return m


def test_friction_of_journals_is_that_of_radial_and_axial_forces() -> None:
    """The friction circle has the radius mu r. A load between two bearings and overhung; a thrust bearing."""
    journal = mb.Reaction(radius=0.02)
    assert acceleration(wheel(journal, (MU * 0.02, 0.0, 0.0), (0.0, -G, 0.0)), -1.0) == pytest.approx([0.0], abs=1e-13)
    for place, factor in ((0.03, 1.0), (0.2, 2.0 * 0.2 / 0.1)):
        two = wheel(mb.Reaction(radius=0.02, length=0.1), (0.0, 0.0, place), (0.0, -G, 0.0))
        assert acceleration(two, 0.5) == pytest.approx([-MU * 0.02 * 0.5 * 3.0 * G * factor / 0.1])
    thrust = wheel(mb.Reaction(radius=0.02, thrust_radius=0.05), (0.0, 0.0, 0.0), (0.0, 0.0, -G))
    assert acceleration(thrust, -0.5) == pytest.approx([MU * 0.05 * 0.5 * 3.0 * G / 0.1])
    preloaded = wheel(mb.Reaction(radius=0.02, preload=7.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert acceleration(preloaded, 0.5) == pytest.approx([-MU * 0.02 * 0.5 * 7.0 / 0.1])


@pytest.mark.parametrize("solver", ["radau", "ida", "adams"])
def test_unbalanced_wheel_is_braked_by_the_reaction_of_its_unbalance(solver: str) -> None:
    """w' = -k (w^4 + w'^2)^(1/2) with k = mu r m e / I, so that 1 / w grows at the rate k / (1 - k^2)^(1/2)."""
    e, radius, rate = 0.05, 0.1, 20.0
    end = 0.05 if solver == "adams" else 5.0  # explicit steps resolve the bristle
    k = MU * radius * 3.0 * e / (0.1 + 3.0 * e * e)
    c = k / np.sqrt(1.0 - k * k)
    done = run(wheel(mb.Reaction(radius=radius), (e, 0.0, 0.0), (0.0, 0.0, 0.0), rate), end, solver, 1e-8)
    assert done.stepper.v[0] == pytest.approx(rate / (1.0 + c * rate * end), rel=1e-5)
    assert done.stepper.q[0] == pytest.approx(np.log1p(c * rate * end) / c, rel=1e-5)
    lost = 0.5 * (0.1 + 3.0 * e * e) * (rate**2 - done.stepper.v[0] ** 2)
    assert done.stepper.energy_account[0] == pytest.approx(-lost, rel=1e-6)


def test_explicit_solvers_do_not_use_recursions_without_a_mass_matrix() -> None:
    """These would leave the friction out; mechanisms with a given normal force have them."""
    m = wheel(mb.Reaction(radius=0.02), (0.0, 0.0, 0.0), (0.0, -G, 0.0))
    assert CompiledMechanism(m).system.recursions is None
    given = mb.Mechanism()
    body = given.body("wheel", given.ground, mb.Revolute(), mass=3.0, inertia=(0.1, 0.1, 0.1))
    given.force("friction", mb.JointFriction(coulomb=MU), body)
    assert CompiledMechanism(given).system.recursions is not None


def screw(slope: float, torque: float = 0.0) -> mb.Mechanism:
    """A nut of 2 kg on a vertical thread with a mean radius of 10 mm and this lead angle, rad."""
    m = mb.Mechanism(gravity=(0.0, 0.0, -G))
    lead = 2.0 * np.pi * 0.01 * np.tan(slope)
    nut = m.body("nut", m.ground, mb.Screw(lead=lead), mass=2.0, inertia=(1e-4, 1e-4, 1e-4))
    m.force("thread", mb.JointFriction(coulomb=MU, normal_force=mb.Reaction(radius=0.01)), nut)
    m.force("motor", mb.JointForce(torque), nut)
    return m


@pytest.mark.parametrize("slope", [0.1, -0.1, 0.6])
def test_torque_of_a_screw_is_that_of_statics(slope: float) -> None:
    """W r tan(slope + angle of friction) raises the weight W, and W r tan(slope - angle of friction) holds it."""
    angle, side = np.arctan(MU), np.sign(slope)
    for direction in (1.0, -1.0):
        torque = side * 2.0 * G * 0.01 * np.tan(abs(slope) + direction * angle)
        assert acceleration(screw(slope, torque), side * direction) == pytest.approx([0.0], abs=1e-9)


def test_screw_locks_itself_if_its_lead_angle_is_below_the_angle_of_friction() -> None:
    angle = np.arctan(MU)
    assert abs(run(screw(0.9 * angle), 10.0).stepper.q[0]) < 3e-5
    slope = 1.2 * angle
    driving = 0.01 * np.tan(slope - angle)
    expected = -0.5 * 2.0 * G * driving / (1e-4 + 2.0 * 0.01 * np.tan(slope) * driving)
    sliding = run(screw(slope), 1.0)
    assert sliding.stepper.q[0] == pytest.approx(expected, rel=5e-3)
    assert not sliding.inaccurate


def strut(slope: float, force: float) -> mb.Mechanism:
    """A rod that a slider presses onto another one, which rubs; ``slope``: of the rod to the normal of the latter."""
    m = mb.Mechanism(gravity=(0.0, 0.0, 0.0))
    upper = m.body("upper", m.ground, mb.Translational(axis="y", start=np.cos(slope), nominal=1.0), mass=1.0)
    joint = mb.Revolute(start=slope - np.pi / 2.0)
    rod = m.body("rod", upper, joint, mass=0.1, com=(0.5, 0.0, 0.0), inertia=(0.01, 0.01, 0.01))
    lower = m.body("lower", m.ground, mb.Translational(axis="x", start=np.sin(slope), nominal=1.0), mass=1.0)
    m.cut("pin", mb.RevoluteCutJoint(at_a=(1.0, 0.0, 0.0)), rod, lower)
    m.force("friction", mb.JointFriction(coulomb=MU, normal_force=mb.Reaction()), lower)
    m.force("press", mb.PointForce(magnitude=-force, axis="y"), upper)
    return m


@pytest.mark.parametrize("force", [10.0, 1e4])
def test_strut_holds_any_force_within_the_friction_cone(force: float) -> None:
    angle = np.arctan(MU)
    for slope in (0.3 * angle, angle):
        z = np.tan(slope) / MU
        assert acceleration(strut(slope, force), z) == pytest.approx([0.0, 0.0, 0.0], abs=1e-11 * force)
    held, sliding = run(strut(0.9 * angle, force), 10.0), run(strut(1.1 * angle, force), 10.0 / np.sqrt(force))
    assert held.stepper.q[2] == pytest.approx(np.sin(0.9 * angle), abs=1e-4)
    assert abs(sliding.stepper.q[2] - np.sin(1.1 * angle)) > 0.05
    assert not held.inaccurate
    assert not sliding.inaccurate


@pytest.mark.parametrize("solver", ["radau", "ida"])
def test_energy_of_a_four_bar_becomes_heat(solver: str) -> None:
    """Its pins rub until it stands still; the energy error is that of the tolerance, which the run checks."""
    m = mb.Mechanism(gravity=(0.0, 0.0, 0.0))
    crank = m.body("crank", m.ground, mb.Revolute(start=1.2, rate=8.0, fixed=True), **mb.rod(mass=1.0, length=0.5))
    coupler = m.body("coupler", crank, mb.Revolute(at=(0.5, 0, 0), start=-1.2), **mb.rod(mass=2.0, length=1.0))
    rocker = m.body("rocker", m.ground, mb.Revolute(at=(1.1, 0, 0), start=1.2), **mb.rod(mass=1.0, length=0.8))
    m.cut("pin", mb.RevoluteCutJoint(at_a=(1.0, 0, 0), at_b=(0.8, 0, 0)), coupler, rocker)
    for body in (crank, coupler, rocker):
        pin = mb.Reaction(radius=0.05, preload=3.0)
        m.force(f"{body.name} pin", mb.JointFriction(coulomb=MU, normal_force=pin), body)
    simulation = mb.Simulation(m, mb.Settings(solver=solver, tolerance=1e-7))
    start = float(simulation.energy())
    simulation.advance(30.0)
    assert np.abs(simulation.stepper.v).max() < 1.0 + 1e-9  # the states of the bristles
    assert np.abs(simulation.stepper.v[:3]).max() < 1e-6
    assert simulation.stepper.energy_account[0] == pytest.approx(-start, rel=1e-6)
    assert not simulation.inaccurate


def test_steady_state_and_linear_model() -> None:
    """The friction exerts no force in the steady state; the bristle of a journal is a spring of mu r m g / d."""
    m = wheel(mb.Reaction(radius=0.02), (0.1, 0.0, 0.0), (G, 0.0, 0.0))
    found = mb.equilibrium(m)
    assert found.positions()["wheel"] == pytest.approx(0.0, abs=1e-9)
    assert "'friction.bristle' keeps its start value" in str(found.diagnostics[0])
    inertia = 0.1 + 3.0 * 0.01
    friction = MU * 0.02 * 3.0 * G
    w = np.sqrt(friction / (1e-5 * inertia))
    pair = max((mode.eigenvalue for mode in found.modes), key=abs)
    assert abs(pair) == pytest.approx(w, rel=1e-4)
    assert -pair.real / abs(pair) == pytest.approx(0.7, rel=1e-3)
    with pytest.raises(EquilibriumError, match="friction cannot hold the start"):
        mb.equilibrium(block(1.01 * np.arctan(MU)))
    held = mb.equilibrium(block(0.1))
    assert held.states()["friction.bristle"] == pytest.approx(np.tan(0.1) / MU, rel=1e-9)


def test_reactions_that_are_not_determined_end_the_run_with_a_message() -> None:
    """A coupler on three parallel rockers is held twice."""
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    rockers = [
        m.body(f"rocker {k}", m.ground, mb.Revolute(at=(k, 0, 0), start=1.0), **mb.rod(mass=1.0, length=0.5))
        for k in range(3)
    ]
    coupler = m.body("coupler", rockers[0], mb.Revolute(at=(0.5, 0, 0), start=-1.0), **mb.rod(mass=1.0, length=2.0))
    for k in (1, 2):
        m.cut(f"pin {k}", mb.RevoluteCutJoint(at_a=(k, 0, 0), at_b=(0.5, 0, 0)), coupler, rockers[k])
    m.force("friction", mb.JointFriction(coulomb=MU, normal_force=mb.Reaction(radius=0.01)), rockers[1])
    done = run(m, 1.0)
    errors = {found.code: found for found in done.diagnostics if found.severity == "error"}
    assert "force 'friction' follows a reaction that is not determined" in str(errors["undetermined-forces"])


def test_refusals() -> None:
    m = mb.Mechanism()
    wheel = m.body("wheel", m.ground, mb.Revolute(), mass=1.0, inertia=(1.0, 1.0, 1.0))
    ball = m.body("ball", m.ground, mb.Spherical(), mass=1.0, inertia=(1.0, 1.0, 1.0))
    slider = m.body("slider", m.ground, mb.Translational(), mass=1.0)
    sleeve = m.body("sleeve", m.ground, mb.Cylindrical(), mass=1.0, inertia=(1.0, 1.0, 1.0))
    free = m.body("free", m.ground, mb.Planar(), mass=1.0, inertia=(1.0, 1.0, 1.0))

    def friction(**given: Any) -> mb.JointFriction:
        return mb.JointFriction(coulomb=MU, normal_force=mb.Reaction(**given))

    with pytest.raises(UserError, match="radius of the Reaction of force 'f' is not given"):
        m.force("f", friction(), wheel)
    with pytest.raises(UserError, match="has a width; allowed for this joint: radius, thrust_radius, length, preload"):
        m.force("f", friction(radius=0.1, width=0.1), wheel)
    with pytest.raises(UserError, match="has a thrust_radius; allowed for this joint: length, width, preload, on"):
        m.force("f", friction(thrust_radius=0.1), slider)
    with pytest.raises(UserError, match="has a thrust_radius; allowed for this joint: radius, length, preload, on"):
        m.force("f", friction(radius=0.1, thrust_radius=0.1), sleeve)
    with pytest.raises(UserError, match="length of the Reaction of force 'f' is -1"):
        m.force("f", friction(length=-1.0), slider)
    with pytest.raises(UserError, match="on of the Reaction of force 'f' is 'c'; allowed: 'a', 'b'"):
        m.force("f", friction(on="c"), slider)
    with pytest.raises(UserError, match="needs a translational, revolute, cylindrical, screw or universal joint"):
        m.force("f", friction(), free)
    with pytest.raises(UserError, match="radius of the Reaction of force 'f' is not given"):
        m.force("f", mb.SphericalFriction(coulomb=MU, normal_force=mb.Reaction()), ball)
    with pytest.raises(UserError, match="is a Reaction and `uses` is given; allowed: a Reaction without `uses`"):
        m.force("f", mb.JointFriction(coulomb=MU, normal_force=mb.Reaction(), uses={"n": 1.0}), slider)
